"""Label frames of a video by hand: choose frames that differ, and save the labels at every change."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from recon.animal.skeleton_file import load_skeleton
from recon.api.label_export import labels_output
from recon.base.arrays import Array, Index
from recon.base.errors import InputError, Problem
from recon.base.outputs import Output
from recon.fit import constants
from recon.fit.motion import Motion
from recon.io.formats import read_keypoints
from recon.io.label_files import LabelledFrames, require_label_names, write_label_files, write_label_pictures
from recon.io.video import probe, read_frames

THUMBNAIL_PX = 24
"""Longer side of the reduced pictures by which `choose_frames` compares frames, px."""
MAX_COMPARED = 600
"""Number of frames that `choose_frames` compares in a long video, approximately."""
SEED = 0
Point = tuple[float, float]


def choose_frames(video: Path, count: int) -> list[int]:
    """Return the numbers of `count` frames whose pictures differ from each other.

    The pictures, reduced in size, are divided into `count` groups by k-means, and the frame nearest to the centre of
    each group is chosen. If there are fewer groups because pictures are equal, evenly spaced frames are added. The same
    video gives the same frames.

    Raises
    ------
    InputError
        If no frame can be decoded.
    """
    from scipy.cluster.vq import kmeans2

    step = max(1, (probe(video).stated_frames or 0) // MAX_COMPARED)
    numbers, pictures = [], []
    for number, picture in read_frames(video, step=step):
        scale = THUMBNAIL_PX / max(picture.shape[:2])
        size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
        numbers.append(number)
        pictures.append(cv2.resize(picture, size, interpolation=cv2.INTER_AREA).ravel().astype(float))
    if not numbers:
        raise InputError(Problem(video, "frames", "no frame that can be decoded", "a video"))
    if count >= len(numbers):
        return numbers
    points = np.array(pictures)
    groups = min(count, len(np.unique(points, axis=0)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a group can become empty
        centres, group = kmeans2(points, groups, minit="++", rng=np.random.default_rng(SEED))
    distance = np.linalg.norm(points - centres[group], axis=1)
    chosen = {int(members[np.argmin(distance[members])]) for members in _groups(np.asarray(group, dtype=np.intp))}
    return sorted(
        [numbers[i] for i in chosen]
        + _spread([n for i, n in enumerate(numbers) if i not in chosen], count - len(chosen))
    )


def frames_by_gain(motion: Motion, camera: int, count: int) -> list[int]:
    """Return the frames whose labels would lower the expected error of the pose most, the most useful first.

    Frames are numbered as in the camera's keypoint file. The gain of a frame is the sum over its keypoints. Errors last
    for about `ERROR_TIME_S`, so a chosen frame lowers the gain of the frames around it. There are fewer than `count`
    frames if no further frame has a gain.

    Raises
    ------
    InputError
        If the motion is from the frame method, which computes no expected gain.
    """
    if motion.correction_gain_m2 is None:
        actual = "a result of the frame method, which does not compute the expected gain"
        raise InputError(Problem("--result", "method", actual, "a result of recon fit"))
    left_m2 = np.nansum(motion.correction_gain_m2[camera], axis=1)
    rows, chosen = np.arange(len(left_m2)), list[int]()
    tau = max(constants.ERROR_TIME_S * motion.fps, 1.0)
    while len(chosen) < count and left_m2.max() > 0:
        row = int(np.argmax(left_m2))
        chosen.append(row)
        left_m2 = left_m2 * (1.0 - np.exp(-(((rows - row) / tau) ** 2)))
    later = motion.sources[camera].later_frames
    return [int(motion.frames[row]) - later for row in chosen]


def _groups(group: Index) -> list[Index]:
    return [np.flatnonzero(group == number) for number in np.unique(group)]


def _spread(numbers: Sequence[int], count: int) -> list[int]:
    """Return up to `count` of the numbers, evenly spaced."""
    if count <= 0:
        return []
    return [numbers[i] for i in np.unique(np.linspace(0, len(numbers) - 1, count).round().astype(int))]


@dataclass(eq=False)
class LabelSession:
    """Labels of chosen frames of a video, which are saved in DeepLabCut's label files at every change."""

    video: Path
    names: tuple[str, ...]
    frames: tuple[int, ...]
    scorer: str
    output: Output
    edges: tuple[tuple[int, int], ...] = ()
    """Pairs of keypoints joined by a bone, as indices."""
    points_px: dict[tuple[int, int], Point] = field(default_factory=dict)
    """Labelled positions (x, y), keyed by frame number and index of the keypoint."""

    @classmethod
    def open(
        cls,
        video: Path,
        out: Path,
        names: Sequence[str],
        scorer: str,
        count: int,
        skeleton: str | None = None,
        preferred: Sequence[int] = (),
    ) -> LabelSession:
        """Choose frames, write their pictures, and read the labels of an earlier session, if there are any.

        Parameters
        ----------
        video
            Video file whose frames are labelled.
        out
            Folder of the project, which contains labeled-data.
        names
            Names of the keypoints.
        scorer
            Name of the labeller.
        count
            Number of frames.
        skeleton
            The skeleton whose bones are drawn, if any.
        preferred
            Frames of the video to choose before those that differ, the most useful first.

        Raises
        ------
        InputError
            If a file would be replaced that recon did not write, or the earlier labels have other keypoints.
        """
        require_label_names(video.stem, scorer)
        if len({*names}) != len(names) or not all(name.strip() and name.isprintable() for name in names) or not names:
            raise InputError(
                Problem("--names", "names", ", ".join(names)[:100] or "no names", "a unique name for each keypoint")
            )
        output = labels_output(out, video.stem, "label", "--out", True, [video])
        edges = () if skeleton is None else _edges(skeleton, names)
        session = cls(video, tuple(names), (), scorer, output, edges)
        table = output.folder / f"CollectedData_{scorer}.csv"
        if table.is_file():
            output.require((table.name,))  # refuse a table that the user made
            earlier = read_keypoints(table)
            if earlier.names != session.names:
                actual = ", ".join(earlier.names)[:200]
                raise InputError(
                    Problem(table, "bodyparts", actual, f"the keypoints of this session: {', '.join(names)[:200]}")
                )
            labels = np.argwhere(np.isfinite(earlier.xy_px).all(axis=2))
            session.points_px = {
                (int(earlier.frames[i]), int(k)): (float(earlier.xy_px[i, k, 0]), float(earlier.xy_px[i, k, 1]))
                for i, k in labels
            }
        labelled = {frame for frame, _ in session.points_px}
        wanted = max(0, count - len(labelled))
        new_frames = [frame for frame in preferred if frame not in labelled][:wanted]
        if len(new_frames) < wanted:
            taken = {*labelled, *new_frames}
            candidates = [frame for frame in choose_frames(video, count) if frame not in taken]
            new_frames += _spread(candidates, wanted - len(new_frames))
        session.frames = tuple(sorted([*labelled, *new_frames]))
        session._write_pictures()
        return session

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        info = probe(self.video)
        self._size_px, self._digits = info.size_px, max(4, len(str(info.stated_frames or 0)))

    def state(self) -> dict[str, object]:
        """Return what the labelling page shows, in JSON types: names, frames, bones, labels and the folder."""
        return {
            "names": [*self.names],
            "frames": [*self.frames],
            "edges": [[*edge] for edge in self.edges],
            "size_px": [*self._size_px],
            "points": [[frame, k, *point] for (frame, k), point in self.points_px.items()],
            "folder": str(self.output.folder),
        }

    def picture(self, frame: int) -> Path | None:
        """Return the file of a frame's picture, or None if the session does not have the frame."""
        path = self.output.folder / self._labels().picture(frame)
        return path if frame in self.frames and path.is_file() else None

    def save(self, rows: object) -> int:
        """Save all labels sent by the page, each with frame, index of the keypoint, x and y, and return their number.

        Raises
        ------
        InputError
            If the labels are not of this video, or if somebody has changed the files.
        """
        points_px = self._checked(rows)
        with self._lock:
            previous_px, self.points_px = self.points_px, points_px
            try:
                with self.output.staged(adds=True) as folder:
                    write_label_files(self._labels(), folder)
            except BaseException:
                self.points_px = previous_px
                raise
        return len(points_px)

    def _checked(self, rows: object) -> dict[tuple[int, int], Point]:
        if not isinstance(rows, list) or len(rows) > len(self.frames) * len(self.names):
            actual = f"{len(rows)} rows" if isinstance(rows, list) else f"data of type {type(rows).__name__}"
            expected = "a list with at most one row for each keypoint of a frame"
            raise InputError(Problem("labels", "rows", actual, expected))
        points_px: dict[tuple[int, int], Point] = {}
        for number, row in enumerate(rows, start=1):
            is_row = isinstance(row, list) and len(row) == 4 and all(isinstance(x, int | float) for x in row)
            if (
                not is_row
                or row[0] not in self.frames
                or row[1] not in range(len(self.names))
                or not self._is_inside(row[2:])
            ):
                expected = "a frame, a keypoint, and a position in the picture"
                raise InputError(Problem("labels", f"row {number}", repr(row)[:100], expected))
            points_px[int(row[0]), int(row[1])] = float(row[2]), float(row[3])
        return points_px

    def _is_inside(self, point: Sequence[float]) -> bool:
        return all(-0.5 <= x <= size - 0.5 for x, size in zip(point, self._size_px, strict=True))

    def _labels(self) -> LabelledFrames:
        """Return the labels of the frames that have labels, or of the first frame if there are none."""
        frames = sorted({frame for frame, _ in self.points_px}) or [self.frames[0]]
        row_of = {frame: i for i, frame in enumerate(frames)}
        xy_px: Array = np.full((len(frames), len(self.names), 2), np.nan)
        for (frame, k), point in self.points_px.items():
            xy_px[row_of[frame], k] = point
        numbers = np.array(frames, dtype=np.int64)
        properties = {"edges": self.edges, "size_px": self._size_px, "digits": self._digits}
        return LabelledFrames(self.video.stem, self.scorer, self.names, numbers, xy_px, **properties)

    def _write_pictures(self) -> None:
        labels = self._labels()
        lacking = [f for f in self.frames if not (self.output.folder / labels.picture(f)).is_file()]
        if not lacking:
            return
        pictures = ((n, p) for n, p in read_frames(self.video, lacking[0], lacking[-1] + 1) if n in {*lacking})
        with self.output.staged(adds=True) as folder:
            for _ in write_label_pictures(labels, pictures, folder):
                pass


def _edges(skeleton: str, names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return the skeleton's bones between named keypoints, as pairs of indices."""
    limbs: Mapping[str, Sequence[str]] = load_skeleton(skeleton).limbs
    index = {name: k for k, name in enumerate(names)}
    pairs = {pair for limb in limbs.values() for pair in pairwise(limb)}
    return tuple(sorted((index[a], index[b]) for a, b in pairs if a in index and b in index))
