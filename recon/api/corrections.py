"""Correct detections by hand while the animal is fitted again: the session behind `recon fix`."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path

import numpy as np

from recon.animal.body import opposites
from recon.api.clip import fit_clip, refit_clip
from recon.api.clip_results import read_config
from recon.api.epipolar import epipolar_lines_px
from recon.api.settings import FitSettings
from recon.base.arrays import to_plain
from recon.base.errors import InputError, Problem
from recon.base.file_names import encodable
from recon.base.files import digest, staged_file
from recon.check.to_correct import to_correct
from recon.check.verdict import verdict_lines
from recon.fit.motion import Motion
from recon.fit.motion_forms import CONFIG
from recon.io.corrections import Correction, read_corrections, write_corrections
from recon.show.page.pages import median_error_px
from recon.show.page.player_data import player_data

MAX_CORRECTIONS = 100_000
IDLE_S = 2.0
"""Time without a change, in seconds, after which the clip is fitted from the start."""


@dataclass(eq=False)
class CorrectionSession:
    """Corrections of one result, which are saved with every change and used in a new fit.

    The fit runs in the background, and `wait_for_fit` waits until it ends. After a change, the fit begins at the
    present motion, which takes a fraction of the time. After `IDLE_S` seconds without a change, the clip is fitted from
    the start, as `recon fit --corrections` does.
    """

    folder: Path
    """Folder of the corrected result, whose files of the fit are not changed."""
    out: Path
    """File of the corrections. The session begins with the corrections in the file, if it exists."""
    motion: Motion
    """Motion of the latest fit."""
    camera: int = 0
    """Index of the camera whose video is shown."""
    corrections: list[Correction] = field(default_factory=list)
    version: int = 0
    """Number of fits so far."""
    is_whole: bool = True
    """Whether the latest fit began from the start, as `recon fit --corrections` does."""
    problem: str = ""
    """Reason why the latest corrections could not be fitted; "" if they were fitted."""

    @classmethod
    def open(cls, folder: Path, out: Path, camera: int = 0) -> CorrectionSession:
        """Open a session for a result of `recon fit`.

        Raises
        ------
        InputError
            If there is no result, its input files are missing, or `out` is not a file of corrections of this clip.
        """
        session = cls(folder, out, Motion.load(folder), camera)
        _ = session.settings
        session.corrections = session._of_this_clip(read_corrections(out)) if out.exists() else []
        session._saved = digest(out)
        return session

    def _of_this_clip(self, corrections: list[Correction]) -> list[Correction]:
        """Return corrections with the camera's name filled in, or raise InputError for a correction of another clip."""
        names = [camera.name for camera in self.motion.cameras]
        named = [replace(row, camera=names[0]) if not row.camera and len(names) == 1 else row for row in corrections]
        frames = {int(frame) for frame in self.motion.frames}
        later_frames = dict(zip(names, (source.later_frames for source in self.motion.sources), strict=True))
        foreign = [
            f"frame {row.frame}, {row.camera or 'no camera'}, {row.keypoint}"
            for row in named
            if row.camera not in later_frames
            or row.keypoint not in self.motion.names
            or row.frame + later_frames[row.camera] not in frames
        ]
        if foreign:
            expected = (
                f"frames {min(frames)} to {max(frames)}, camera {' or '.join(names)}, and keypoints of this result, "
                f"which are {', '.join(self.motion.names)}; another --out begins without corrections"
            )
            detail = f"{'; '.join(foreign[:3])}{'; ...' if len(foreign) > 3 else ''}"
            raise InputError(Problem(self.out, "corrections", detail, expected))
        return named

    def __post_init__(self) -> None:
        self.before = _summary(self.motion)
        self._suggested_from = self.motion  # fits that begin at the present motion do not change the suggestions
        self._saved = digest(self.out)
        self._change = threading.Condition()
        self._is_due, self._is_running = False, False

    @cached_property
    def settings(self) -> FitSettings:
        """Return the settings of the fit, without a corrections file."""
        return replace(read_config(self.folder / CONFIG, {}), corrections=None)

    def state(self) -> dict[str, object]:
        """Return the latest fit in JSON types: player data, suggested corrections, and errors before and after."""
        motion = self.motion
        return {
            "version": self.version,
            "clip": player_data(motion, None, self.camera),
            "later_frames": [source.later_frames for source in motion.sources],
            "queue": [to_plain(asdict(point)) for point in to_correct(self._suggested_from)],
            "pairs": _pairs(motion),
            "before": self.before,
            "now": _summary(motion),
            "is_whole": self.is_whole,
            "corrections": [asdict(correction) for correction in self.corrections],
            "file": str(self.out),
            "problem": self.problem,
        }

    def wait_for_fit(self, version: int, wait_s: float = 20.0) -> bool:
        """Wait up to `wait_s` seconds for a fit after the given version, and return whether there is one."""
        with self._change:
            return self._change.wait_for(lambda: self.version > version, wait_s)

    def lines_px(self, camera: int, row: int, joint: int) -> dict[str, object]:
        """Return the epipolar lines of a keypoint in JSON types, keyed by the name of the other camera.

        The result is empty if the clip has one camera, or an index is out of range.
        """
        motion = self.motion
        counts = len(motion.sources), len(motion.frames), len(motion.names)
        if len(motion.sources) < 2 or not all(
            0 <= i < count for i, count in zip((camera, row, joint), counts, strict=True)
        ):
            return {}
        numbers = {picture.name: number for number, picture in enumerate(motion.pictures)}
        marks_px = {
            numbers[saved.camera]: saved.now_px
            for saved in self.corrections
            if saved.camera in numbers
            and saved.keypoint == motion.names[joint]
            and saved.frame + motion.sources[numbers[saved.camera]].later_frames == motion.frames[row]
        }
        lines = epipolar_lines_px(motion, camera, row, joint, marks_px)
        return {name: np.round(line, 1).tolist() for name, line in lines.items()}

    def save(self, rows: object) -> int:
        """Save all corrections sent by the editor, start a fit with them, and return their number.

        Raises
        ------
        InputError
            If the corrections do not fit this clip, or another program has changed the file.
        """
        corrections = self._checked(rows)
        with self._change:
            if digest(self.out) != self._saved:
                expected = "the file as last saved: close the other editor, and start again"
                raise InputError(Problem(self.out, "content", "changed by another program", expected))
            with staged_file(self.out) as staged:
                write_corrections(corrections, staged)
            self.corrections, self._saved, self._is_due = corrections, digest(self.out), True
            self._change.notify_all()
            if not self._is_running:
                self._is_running = True
                threading.Thread(target=self._fit, daemon=True).start()
        return len(corrections)

    def _checked(self, rows: object) -> list[Correction]:
        if not isinstance(rows, list) or len(rows) > MAX_CORRECTIONS:
            actual = f"{len(rows)} rows" if isinstance(rows, list) else f"data of type {type(rows).__name__}"
            raise InputError(Problem("corrections", "rows", actual, f"a list of at most {MAX_CORRECTIONS} rows"))
        today = datetime.now().astimezone().isoformat(timespec="seconds")
        known = {_key(row): row for row in self.corrections}
        checked = []
        for i, row in enumerate(rows, start=1):
            correction = self._correction(row, i)
            saved = known.get(_key(correction))
            date = saved.date if saved is not None and saved.now_px == correction.now_px else today
            checked.append(replace(correction, date=date))
        return checked

    def _correction(self, row: object, number: int) -> Correction:
        cameras = [camera.name for camera in self.motion.cameras]
        fault = InputError(
            Problem("corrections", f"row {number}", repr(row)[:100], "a frame, camera and keypoint of this clip")
        )
        if not isinstance(row, Mapping) or row.get("camera") not in cameras:
            raise fault
        frame, keypoint, reason = row.get("frame"), row.get("keypoint"), row.get("reason", "")
        source = self.motion.sources[cameras.index(row["camera"])]
        if not isinstance(frame, int) or frame + source.later_frames not in self.motion.frames:
            raise fault
        if keypoint not in self.motion.names or not isinstance(reason, str) or not _is_text(reason):
            raise fault
        points = [row.get("was_px"), row.get("now_px")]
        if not all(point is None or _is_point(point) for point in points):
            raise fault
        was_px, now_px = (None if point is None else (float(point[0]), float(point[1])) for point in points)
        return Correction(frame, row["camera"], str(keypoint), was_px, now_px, reason)

    def _fit(self) -> None:
        """Fit with the saved corrections, again after every change, and from scratch once no more changes come."""
        while True:
            with self._change:
                if not self._is_due and self.is_whole:
                    self._is_running = False
                    return
                self._change.wait_for(lambda: self._is_due, IDLE_S)
                is_whole, self._is_due = not self._is_due, False
            self._fit_once(is_whole)

    def _fit_once(self, is_whole: bool) -> None:
        settings = replace(self.settings, corrections=self.out)
        try:
            motion, problem = fit_clip(settings) if is_whole else refit_clip(settings, self.motion), ""
        except InputError as error:
            motion, problem, is_whole = self.motion, str(error), True
        with self._change:
            if is_whole and not problem:
                self._suggested_from = motion
            self.motion, self.problem, self.is_whole, self.version = motion, problem, is_whole, self.version + 1
            self._change.notify_all()


def _key(correction: Correction) -> tuple[int, str, str]:
    return correction.frame, correction.camera, correction.keypoint


def _is_text(reason: str) -> bool:
    """Return whether a reason is short and without unpaired surrogates, which JSON allows and UTF-8 files do not."""
    return len(reason) <= 200 and encodable(reason) == reason


def _is_point(value: object) -> bool:
    if not isinstance(value, list) or len(value) != 2:
        return False
    return all(isinstance(x, int | float) and abs(x) < 1e6 for x in value)


def _summary(motion: Motion) -> dict[str, object]:
    """Return the verdict, the expected error (mm), the median distance of the detections (px), and the outliers."""
    verdict = motion.verdict
    error_px = median_error_px(motion)
    outliers = int(sum(picture.outliers.sum() for picture in motion.pictures))
    return {
        "level": "" if verdict is None else verdict.level,
        "lines": [*verdict_lines(verdict)],
        "expected_mm": None if verdict is None or verdict.pose_m is None else 1000.0 * verdict.pose_m.expected,
        "median_px": error_px if math.isfinite(error_px) else None,
        "outliers": outliers,
    }


def _pairs(motion: Motion) -> list[list[int]]:
    """Return the pairs of left and right keypoints, as indices."""
    return [[i, int(j)] for i, j in enumerate(opposites(motion.joints)) if i < j]
