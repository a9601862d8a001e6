"""Export corrections for the detector: as labels for training, and as a corrected table of detections."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from recon.animal.naming import load_names, new_names
from recon.api.clip import fit_clip
from recon.api.clip_results import read_config
from recon.api.settings import FitSettings
from recon.base.errors import InputError, Problem
from recon.base.outputs import Output
from recon.clip import Keypoints
from recon.fit.motion import Motion
from recon.fit.motion_forms import CONFIG
from recon.io.corrections import Correction, read_corrections, with_corrections
from recon.io.formats import read_keypoints
from recon.io.label_files import (
    LABELED_DATA,
    LabelledFrames,
    require_label_names,
    require_label_writer,
    write_label_files,
    write_label_pictures,
)
from recon.io.video import Image, probe, read_frames

ACCEPTED = "accepted"
"""Reason of a correction that only accepted the position expected by the model."""
BY_HAND, FROM_MODEL, DETECTED = "by hand", "accepted from the model", "detected, and the pose agrees"


@dataclass(frozen=True)
class CorrectedClip:
    """Corrections of the keypoints of one camera, and the fit of the clip with them."""

    settings: FitSettings
    motion: Motion
    number: int
    """Index of the camera."""
    corrections: tuple[Correction, ...]
    """The corrections of this camera."""
    names: Mapping[str, str]
    """Name of each keypoint in the keypoint file, keyed by its name in the fit."""
    file: Keypoints
    """Keypoints as in the file, without corrections."""

    @classmethod
    def read(cls, folder: Path, path: Path, number: int = 0) -> CorrectedClip:
        """Return the corrections of a file, and fit the clip with them.

        Parameters
        ----------
        folder
            Folder of results of `recon fit`.
        path
            File of the corrections.
        number
            Index of the camera.

        Raises
        ------
        InputError
            If there are no corrections of this camera, or if the clip cannot be fitted with them.
        """
        settings = replace(read_config(folder / CONFIG, {}), corrections=path)
        all_rows = read_corrections(path)
        motion = fit_clip(settings)
        camera = motion.cameras[number].name
        rows = tuple({(row.frame, row.keypoint): row for row in all_rows if row.camera in ("", camera)}.values())
        if not rows:
            raise InputError(
                Problem(path, "corrections", f"no corrections for {camera}", "corrections made with recon fix")
            )
        source = settings.keypoints[number]
        file = read_keypoints(source, settings.individual, settings.fps)
        names = {name: name for name in file.names}
        if settings.rename is not None:
            keep, renamed, _ = new_names(file.names, load_names(settings.rename), str(source))
            names = dict(zip(renamed, (file.names[k] for k in keep), strict=True))
        return cls(settings, motion, number, rows, names, file)

    def keypoints(self) -> Keypoints:
        """Return the keypoints of the file, with its names and with the corrections.

        Corrected keypoints have the likelihood 1.
        """
        camera, rows = self.motion.cameras[self.number].name, self._rows_as_in_file()
        (corrected,) = with_corrections([self.file], [camera], rows, self._corrections_file)
        return corrected

    def labels(self, video: str, scorer: str, with_accepted: bool = False) -> LabelledFrames:
        """Return the labels of the frames that were corrected by hand.

        The labels are the corrected points, and the detections in the same frames that the fit uses and the pose
        explains.

        Parameters
        ----------
        video
            The video's name without its suffix.
        scorer
            Name of the labeller.
        with_accepted
            Whether points that were only accepted from the model count as labels.
        """
        require_label_names(video, scorer)
        file_names, row_of = self.file.names, {int(frame): t for t, frame in enumerate(self.motion.frames)}
        later = self.motion.sources[self.number].later_frames
        frames = sorted({row.frame for row in self.corrections if row.reason != ACCEPTED or with_accepted})
        frames = [frame for frame in frames if frame + later in row_of]
        if not frames:
            expected = "at least one frame that was corrected by hand, or --with-accepted"
            raise InputError(Problem(self._corrections_file, "corrections", "accepted positions only", expected))
        xy_px = np.full((len(frames), len(file_names), 2), np.nan)
        origins = [[""] * len(file_names) for _ in frames]
        picture = self.motion.pictures[self.number]
        is_trusted = picture.present & ~picture.outliers & np.isfinite(picture.distance_px)
        for i, frame in enumerate(frames):
            t = row_of[frame + later]
            for j in np.flatnonzero(is_trusted[t]):
                name = self.names.get(self.motion.names[j])
                if name is not None:
                    k = file_names.index(name)
                    xy_px[i, k], origins[i][k] = picture.detected_px[t, j], DETECTED
        for row in self.corrections:
            if row.frame not in frames:
                continue
            i, k = frames.index(row.frame), file_names.index(self.names[row.keypoint])
            is_label = row.now_px is not None and (row.reason != ACCEPTED or with_accepted)
            xy_px[i, k] = row.now_px if is_label and row.now_px is not None else np.nan
            origins[i][k] = "" if not is_label else FROM_MODEL if row.reason == ACCEPTED else BY_HAND
        digits = max(4, len(str(int(self.file.frames.max()))))
        size_px = self.motion.cameras[self.number].image_size_px
        frames_array = np.array(frames, dtype=np.int64)
        origin_rows = tuple(map(tuple, origins))
        return LabelledFrames(
            video, scorer, file_names, frames_array, xy_px, origin_rows, tuple(self._edges()), size_px, digits
        )

    @property
    def _corrections_file(self) -> Path:
        assert self.settings.corrections is not None
        return self.settings.corrections

    def _rows_as_in_file(self) -> list[Correction]:
        return [replace(row, keypoint=self.names[row.keypoint]) for row in self.corrections]

    def _edges(self) -> Iterator[tuple[int, int]]:
        """Yield the bones between keypoints of the file, as pairs of indices."""
        for limb in self.motion.limbs.values():
            ends = [self.names.get(self.motion.names[j]) for j in limb]
            for a, b in pairwise(ends):
                if a is not None and b is not None:
                    yield self.file.names.index(a), self.file.names.index(b)


def labels_output(folder: Path, video: str, kind: str, option: str, overwrite: bool, inputs: Sequence[Path]) -> Output:
    """Return the output for the label files of a video in a folder, such as the folder of a DeepLabCut project.

    Raises
    ------
    InputError
        If the package that writes DeepLabCut's files is not installed, or the names cannot be file names.
    """
    require_label_writer()
    require_label_names(video, "labels")
    return Output(folder / LABELED_DATA / video, kind, overwrite, inputs, content="labels", option=option)


def write_labels(labels: LabelledFrames, video: Path, number_of_first: int, output: Output) -> None:
    """Write label files and the pictures of their frames.

    Parameters
    ----------
    labels
        Labels of the video.
    video
        Video file from which the labelled pictures are taken.
    number_of_first
        Frame number of the video's first frame, in the numbering of the labels.
    output
        Output of the files.

    Raises
    ------
    InputError
        If the video lacks a frame, or if a file would replace one that recon did not write.
    """
    with output.staged() as staged:
        written = {
            frame for frame, _ in write_label_pictures(labels, _pictures(labels, video, number_of_first), staged)
        }
        missing = [frame for frame in labels.frames.tolist() if frame not in written]
        if missing:
            actual = f"no frame {', '.join(map(str, missing[:5]))}, of {probe(video).stated_frames or 'its'} frames"
            raise InputError(
                Problem(video, "video", actual, "the video of the labels (--first-frame, if the video was cut)")
            )
        write_label_files(labels, staged)


def _pictures(labels: LabelledFrames, video: Path, number_of_first: int) -> Iterator[tuple[int, Image]]:
    wanted = {int(frame) - number_of_first for frame in labels.frames}
    first = max(min(wanted), 0)
    for index, picture in read_frames(video, first, max(wanted) + 1):
        if index in wanted:
            yield index + number_of_first, picture
