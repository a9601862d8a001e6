"""Hold the data of a clip: the cleaned 2D keypoints and the view of each camera.

The keypoints of all cameras refer to the same frames. A view holds the keypoints of one camera and the camera's poses.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from recon.base.arrays import Array, Bools, Brief, Index, Integers
from recon.base.errors import InputError, Problem
from recon.geometry.camera import Camera
from recon.geometry.frames import euler_rotation, inverse, level_from_camera, rigid

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

CORNER_PX = 1.0
"""Maximum x and y, in pixels, of a constant position in the picture's corner that may stand for missing points."""
MIN_CONSTANT_FRACTION = 0.005
"""Minimum fraction of a file's points at one position for this position to stand for missing points."""
CONSTANT_KEYPOINTS = 3
"""Minimum number of keypoints at a position that stands for missing points, because one keypoint may be stuck."""


@dataclass(frozen=True, eq=False, repr=False)
class Keypoints(Brief):
    """Detections of K named keypoints in T frames of one camera.

    A reader of files returns the values that the file stores. The confidence is NaN if the file has none, and a missing
    point may have a confidence. `clean` turns the values into the form that the attributes describe.

    Raises
    ------
    ValueError
        If shapes or types do not agree, names are not unique, frame numbers do not increase, or the frame rate is not
        positive.
    """

    names: tuple[str, ...]
    """Unique names of the K keypoints."""
    xy_px: np.ndarray
    """Detections, shape (T, K, 2), float, pixels; NaN if missing."""
    confidence: np.ndarray
    """Confidence, shape (T, K), float, 0 to 1; 0 if missing."""
    frames: np.ndarray
    """Original frame numbers, shape (T,), integer, strictly increasing."""
    fps: float | None = None
    """Frame rate of the video, Hz; None if unknown."""
    stated_fps: float | None = None
    """Frame rate (Hz) that the file states, if the user gave another one; otherwise None."""
    image_size_px: tuple[int, int] | None = None
    """Width and height of the picture, pixels; None if unknown."""
    individual: str | None = None
    """Name of the animal, if the file has several animals; otherwise None."""
    source: str | None = None
    """Path of the keypoint file; None if the keypoints are from memory."""
    scorer: str | None = None
    """Name of the network or person that labelled the file; None if the file has none."""
    notes: tuple[str, ...] = ()
    """Choices that the file's reader made, in plain sentences."""
    corrected: int = 0
    """Number of detections that were corrected by hand."""

    def __post_init__(self) -> None:
        t, k = len(self.frames), len(self.names)
        if len(set(self.names)) != k or not all(self.names):
            raise ValueError(f"keypoint names must be unique and not empty: {self.names}")
        for name, shape, kind in (("xy_px", (t, k, 2), "f"), ("confidence", (t, k), "f"), ("frames", (t,), "i")):
            array = getattr(self, name)
            if array.shape != shape or array.dtype.kind != kind:
                expected = f"{'floats' if kind == 'f' else 'integers'} of shape {shape}"
                raise ValueError(f"{name}: expected {expected}, found {array.dtype} of shape {array.shape}")
        if np.any(np.diff(self.frames) <= 0):
            raise ValueError("frames must be strictly increasing")
        if self.fps is not None and not 0 < self.fps < float("inf"):
            raise ValueError(f"fps must be positive: {self.fps}")

    @classmethod
    def from_dataframe(cls, table: pd.DataFrame, fps: float | None = None, individual: str | None = None) -> Keypoints:
        """Return keypoints from a pandas table.

        Parameters
        ----------
        table : pandas.DataFrame
            Either as in DeepLabCut, with the column levels scorer, (individuals,) bodyparts and coords, and the frames
            as its index; or long, with the columns frame, keypoint (or bodypart), x, y and confidence (or likelihood).
            Positions are in pixels.
        fps : float, optional
            Frames per second.
        individual : str, optional
            Name of the animal, needed if the table has several.

        Raises
        ------
        InputError
            If the table is in neither form, or its content is not valid.
        """
        from recon.io.columns import from_dataframe

        return from_dataframe(table, fps, individual)

    @classmethod
    def from_xarray(cls, dataset: xr.Dataset, fps: float | None = None, individual: str | None = None) -> Keypoints:
        """Return keypoints from a poses dataset of the `movement` package, in pixels.

        Parameters
        ----------
        dataset : xarray.Dataset
            Poses. Their times are in seconds if the dataset has a frame rate or `fps` is given, otherwise frame
            numbers.
        fps : float, optional
            Frames per second.
        individual : str, optional
            Name of the animal, needed if the dataset has several.

        Raises
        ------
        InputError
            If the dataset is not a poses dataset of the `movement` package, or its content is not valid.
        """
        from recon.io.columns import from_xarray

        return from_xarray(dataset, fps, individual)

    @property
    def present(self) -> np.ndarray:
        """Return a mask of the points that have both coordinates, (T, K)."""
        return ~np.isnan(self.xy_px[..., 0]) & ~np.isnan(self.xy_px[..., 1])


COUNTS = (
    *("frames", "used", "missing", "rejected", "missing_zero_zero", "missing_nan_with_likelihood", "missing_empty"),
    *("missing_absent_frame", "missing_constant", "likelihood_unknown"),
)
"""Names of the counts of frames for each keypoint; used + missing + rejected = frames.

A keypoint is missing in a frame if it was stored as (0, 0) without a likelihood, as NaN with a likelihood, as an empty
cell, or at the constant position for missing points (`CleaningReport.constant_px`), or if the file lacks the frame.
`likelihood_unknown` counts used keypoints without a likelihood.
"""


@dataclass(frozen=True, eq=False, repr=False)
class LeftOut(Brief):
    """Record of N detections in a file that the fit does not use."""

    names: tuple[str, ...] = ()
    """Names of the keypoints, to which the array `keypoint` refers."""
    reasons: tuple[str, ...] = ()
    """Reasons for leaving out detections, to which the array `reason` refers."""
    frame: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    """Frame number of each detection in its file, shape (N,)."""
    keypoint: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    """Keypoint of each detection, as an index into `names`, shape (N,)."""
    reason: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    """Reason for leaving out each detection, as an index into `reasons`, shape (N,)."""
    xy_px: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    """Positions of the detections, shape (N, 2), pixels."""
    confidence: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Likelihoods of the detections, shape (N,), 0 to 1."""

    def count(self, reason: str) -> int:
        """Return the number of detections that were left out for a reason."""
        return int((self.reason == self.reasons.index(reason)).sum()) if reason in self.reasons else 0

    def with_points(self, keypoints: Keypoints, points: np.ndarray, reason: str, later_frames: int = 0) -> LeftOut:
        """Return the record after adding the detections of the mask `points` (T, K), which were left out for `reason`.

        `later_frames` is the clip's frame number minus the file's frame number.
        """
        rows, columns = np.nonzero(points)
        names = tuple(dict.fromkeys((*self.names, *keypoints.names)))
        reasons = tuple(dict.fromkeys((*self.reasons, reason)))
        index = np.array([names.index(name) for name in keypoints.names], dtype=np.int64)
        return LeftOut(
            names,
            reasons,
            np.concatenate([self.frame, keypoints.frames[rows] - later_frames]),
            np.concatenate([self.keypoint, index[columns]]),
            np.concatenate([self.reason, np.full(len(rows), reasons.index(reason))]),
            np.concatenate([self.xy_px, keypoints.xy_px[rows, columns]]),
            np.concatenate([self.confidence, keypoints.confidence[rows, columns]]),
        )


@dataclass(frozen=True, repr=False)
class CleaningReport(Brief):
    """Counts of missing and rejected points in the keypoints of one camera, as `clean` returns them.

    Frame ranges are half-open pairs (A, B) of original frame numbers: A is included, B is not.
    """

    likelihood_min: float
    frames: tuple[int, int]
    """Half-open range of frames after cleaning."""
    frames_dropped: int
    """Number of frames of the file outside the requested range."""
    inserted: tuple[tuple[int, int], ...]
    """Half-open ranges of frames that the file lacks, which were inserted with all points missing."""
    keypoints: dict[str, dict[str, int]]
    """Counts for each keypoint, keyed by the keypoint's name and then by a name in `COUNTS`."""
    notes: tuple[str, ...] = ()
    """Choices of the file's reader and of the cleaning, in plain sentences."""
    constant_px: tuple[float, float] | None = None
    """Constant position (px) that the file stores for missing points, such as (-1, -1); None if there is none."""
    left_out: LeftOut = field(default_factory=LeftOut)
    """Detections of the file that the fit does not use."""

    def total(self, count: str) -> int:
        """Return the sum of a count, such as "rejected", over the keypoints."""
        return sum(counts[count] for counts in self.keypoints.values())


def parse_frame_range(text: str) -> tuple[int | None, int | None]:
    """Parse the frame range "A:B" into (A, B), with None for an empty side.

    B is not included, as in a Python slice. A and B are the file's frame numbers, not row indices.

    Raises
    ------
    InputError
        If the text is not a frame range.
    """
    match = re.fullmatch(r"\s*(\d*)\s*:\s*(\d*)\s*", text, flags=re.ASCII)
    start, stop = (int(n) if n else None for n in match.groups()) if match else (None, None)
    if match is None or (start is not None and stop is not None and start >= stop):
        expected = "A:B with A < B, in original frame numbers, with B excluded"
        raise InputError(Problem("--frames", "range", f"'{text}'", expected))
    return start, stop


UNLIKELY = "low likelihood"
"""Reason for leaving out a detection whose likelihood is below the limit."""


def clean(
    keypoints: Keypoints, likelihood_min: float, frames: tuple[int | None, int | None] | None = None
) -> tuple[Keypoints, CleaningReport]:
    """Mark unreliable points of a file as missing (NaN with confidence 0), and insert the frames that the file lacks.

    Parameters
    ----------
    keypoints : Keypoints
        Keypoints as a reader returns them.
    likelihood_min : float
        Points with a lower likelihood are rejected.
    frames : (int or None, int or None), optional
        Half-open range (A, B) of original frame numbers; None for no limit.

    Returns
    -------
    keypoints : Keypoints
        Keypoints in consecutive frames.
    report : CleaningReport
        Counts of missing and rejected points, and the detections that were left out.

    Raises
    ------
    InputError
        If `likelihood_min` is not from 0 to 1, no frame or point is left, or a gap is far too long.
    """
    if not 0 <= likelihood_min <= 1:
        raise InputError(Problem("--set likelihood-min", "likelihood_min", str(likelihood_min), "a number from 0 to 1"))
    rows_in_file = len(keypoints.frames)
    selected = select_frames(keypoints, frames)
    marked, missing = mark_missing(selected)
    unknown = marked.present & np.isnan(marked.confidence)  # hand labels are taken as certain
    known = replace(marked, confidence=np.where(unknown, 1.0, marked.confidence))
    unlikely = known.present & (known.confidence < likelihood_min)
    likelihood_unknown, rejected = unknown.sum(axis=0), unlikely.sum(axis=0)
    cleaned, inserted = fill_gaps(_without_points(known, unlikely))

    absent = len(cleaned.frames) - len(selected.frames)
    used = cleaned.present.sum(axis=0)
    if not used.any():
        detail = f"every point of the clip missing ({rejected.sum()} with a likelihood below {likelihood_min:g})"
        expected = "a lower --set likelihood-min" if rejected.any() else "at least one usable point"
        raise InputError(Problem(_source(keypoints), "points", detail, expected))
    missing["missing_absent_frame"] = np.full(len(used), absent)
    counted = {"frames": np.full(len(used), len(cleaned.frames)), "used": used, "missing": sum(missing.values())}
    counted |= {"rejected": rejected, **missing, "likelihood_unknown": likelihood_unknown}
    counts = {name: {count: int(counted[count][k]) for count in COUNTS} for k, name in enumerate(cleaned.names)}
    report = CleaningReport(
        likelihood_min=float(likelihood_min),
        frames=(int(cleaned.frames[0]), int(cleaned.frames[-1]) + 1),
        frames_dropped=rows_in_file - len(selected.frames),
        inserted=inserted,
        keypoints=counts,
        notes=keypoints.notes,
        constant_px=constant_px(selected),
        left_out=LeftOut().with_points(known, unlikely, UNLIKELY),
    )
    return cleaned, report


def leave_out(
    keypoints: Keypoints, report: CleaningReport, points: np.ndarray, reason: str, later_frames: int = 0
) -> tuple[Keypoints, CleaningReport]:
    """Mark the cleaned keypoints of the mask `points` (T, K) as missing too, and record the reason in the report.

    `later_frames` is the clip's frame number minus the file's frame number.
    """
    if not points.any():
        return keypoints, report
    lost_points = dict(zip(keypoints.names, points.sum(axis=0).tolist(), strict=True))
    counts = {}
    for name, counted in report.keypoints.items():  # counts exist for the file's names only
        used, lost = counted["used"] - lost_points.get(name, 0), lost_points.get(name, 0)
        unknown = min(counted["likelihood_unknown"], used)
        counts[name] = {**counted, "used": used, "rejected": counted["rejected"] + lost, "likelihood_unknown": unknown}
    count, (frame, first) = int(points.sum()), np.argwhere(points)[0].tolist()
    note = (
        f"{count} {'point is' if count == 1 else 'points are'} {reason}, and left out: {keypoints.names[first]} "
        f"in frame {keypoints.frames[frame]}"
    )
    note += ", ..." if count > 1 else ""
    left_out = report.left_out.with_points(keypoints, points, reason, later_frames)
    report = replace(report, keypoints=counts, notes=(*report.notes, note), left_out=left_out)
    return _without_points(keypoints, points), report


def select_frames(keypoints: Keypoints, frames: tuple[int | None, int | None] | None) -> Keypoints:
    """Return the keypoints in frames of the half-open range (A, B), where None means no limit.

    Raises
    ------
    InputError
        If no frame is left.
    """
    start, stop = frames or (None, None)
    keep = keypoints.frames >= (-np.inf if start is None else start)
    keep &= keypoints.frames < (np.inf if stop is None else stop)
    if not keep.any():
        shown = f"{'' if start is None else start}:{'' if stop is None else stop}"
        has = f"{keypoints.frames[0]} to {keypoints.frames[-1]}" if len(keypoints.frames) else "none"
        expected = f"a range of the clip's frames ({has})"
        raise InputError(Problem(_source(keypoints), "frames", f"no frame in the range {shown}", expected))
    if keep.all():  # avoid a copy, since long clips are large
        return keypoints
    xy_px, confidence, numbers = (values[keep] for values in (keypoints.xy_px, keypoints.confidence, keypoints.frames))
    return replace(keypoints, xy_px=xy_px, confidence=confidence, frames=numbers)


def mark_missing(keypoints: Keypoints) -> tuple[Keypoints, dict[str, np.ndarray]]:
    """Set missing points to NaN with confidence 0, and count how they were stored.

    The counts (K,) have names from `COUNTS`. Some programs store a missing point as (0, 0). A point at (0, 0) counts as
    missing only if its likelihood is 0 or unknown, because the corner of the image can be a detection.
    """
    has_likelihood = keypoints.confidence > 0
    no_xy = ~keypoints.present
    zero_zero = (keypoints.xy_px == 0).all(axis=2) & ~has_likelihood
    constant = (keypoints.xy_px == (constant_px(keypoints) or np.nan)).all(axis=2) & ~zero_zero
    counts = {
        "missing_zero_zero": zero_zero.sum(axis=0),
        "missing_nan_with_likelihood": (no_xy & has_likelihood).sum(axis=0),
        "missing_empty": (no_xy & ~has_likelihood).sum(axis=0),
        "missing_constant": constant.sum(axis=0),
    }
    return _without_points(keypoints, no_xy | zero_zero | constant), counts


def constant_px(keypoints: Keypoints) -> tuple[float, float] | None:
    """Return the constant position, in pixels, that a file stores for missing points, or None.

    A detector does not put several keypoints at exactly one position in the picture's corner or outside the picture.
    """
    points, names = keypoints.xy_px[keypoints.present], np.nonzero(keypoints.present)[1]
    corner = (points <= CORNER_PX).all(axis=1) & (keypoints.confidence[keypoints.present] != 0)
    values, value_index, counts = np.unique(points[corner], axis=0, return_inverse=True, return_counts=True)
    if not len(values) or counts.max() < max(MIN_CONSTANT_FRACTION * len(points), 2 * CONSTANT_KEYPOINTS):
        return None
    commonest = int(np.argmax(counts))
    x, y = values[commonest].tolist()
    return (x, y) if len(np.unique(names[corner][value_index.ravel() == commonest])) >= CONSTANT_KEYPOINTS else None


def fill_gaps(keypoints: Keypoints) -> tuple[Keypoints, tuple[tuple[int, int], ...]]:
    """Insert missing points for absent frame numbers, so that frames are equally spaced in time.

    Returns
    -------
    keypoints : Keypoints
        Keypoints in consecutive frames.
    inserted : tuple of (int, int)
        Half-open ranges of the inserted frame numbers.

    Raises
    ------
    InputError
        If the gaps are far too long.
    """
    frames, (t, k) = keypoints.frames, keypoints.confidence.shape
    span = int(frames[-1]) - int(frames[0]) + 1
    if span - t > 10 * t + 10_000:
        detail = f"{t} frames between {frames[0]} and {frames[-1]}, which leaves {span - t} to insert as missing"
        expected = "a clip without such gaps; choose a part of it with --frames A:B"
        raise InputError(Problem(_source(keypoints), "frames", detail, expected))
    if span == t:
        return keypoints, ()
    rows = frames - frames[0]
    xy_px, confidence = np.full((span, k, 2), np.nan), np.zeros((span, k))
    xy_px[rows], confidence[rows] = keypoints.xy_px, keypoints.confidence
    regular = np.arange(frames[0], frames[-1] + 1)
    filled = replace(keypoints, xy_px=xy_px, confidence=confidence, frames=regular)
    return filled, frame_ranges(np.setdiff1d(regular, frames))


def frame_ranges(frames: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Group increasing frame numbers (T,) into half-open ranges (A, B) of consecutive numbers."""
    if not len(frames):
        return ()
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    return tuple((int(run[0]), int(run[-1]) + 1) for run in runs)


def longest_run(rows: Bools) -> tuple[int, int]:
    """Return the longest run of true elements, as the index of its first element and the index after its last."""
    return max(frame_ranges(np.flatnonzero(rows)), key=lambda run: run[1] - run[0])


def run_around(rows: Bools, row: int) -> tuple[int, int]:
    """Return the run of true elements around an element, as in `longest_run`; the element alone if it is false."""
    return next((run for run in frame_ranges(np.flatnonzero(rows)) if run[0] <= row < run[1]), (row, row + 1))


def densest_window(counts: Integers, n: int) -> slice:
    """Return the window of at most `n` frames, as a slice, with the largest sum of `counts` (T,)."""
    n, total = min(n, len(counts)), np.concatenate([[0], np.cumsum(counts)])
    first = int(np.argmax(total[n:] - total[: len(total) - n]))
    return slice(first, first + n)


def _without_points(keypoints: Keypoints, points: np.ndarray) -> Keypoints:
    if not (keypoints.present & points).any() and not keypoints.confidence[points].any():
        return keypoints
    xy_px = np.where(points[..., None], np.nan, keypoints.xy_px)
    return replace(keypoints, xy_px=xy_px, confidence=np.where(points, 0.0, keypoints.confidence))


def _source(keypoints: Keypoints) -> str:
    return keypoints.source or "keypoints"


@dataclass(frozen=True, eq=False, repr=False)
class View(Brief):
    """Keypoints of one camera in the T frames of a clip, and the camera's poses.

    Lengths are in metres, and positions in the distorted picture in pixels.
    """

    camera: Camera
    """Camera with the lens, intrinsics and picture size, whose pose is not used (see `T_camera_world`)."""
    T_camera_world: Array
    """Camera poses, shape (T, 4, 4), or (4, 4) for a static camera."""
    xy_px: Array
    """Detected keypoints, shape (T, J, 2), NaN if missing."""
    confidence: Array
    """Confidence, shape (T, J), 0 to 1."""
    intrinsics_px: Array | None = None
    """fx, fy, cx, cy of each frame, shape (T, 4), for a camera that zooms."""
    offset_frames: float = 0.0
    """Delay of the camera's pictures relative to the clip's frames, in frames; 0 to below 1 unless estimated."""
    rotation_sigma_rad: Array | None = None
    """Standard deviation of each pose's rotation about any axis, shape (T,), if the camera's track states it."""

    @property
    def is_still(self) -> bool:
        """Return whether the camera is static."""
        return self.T_camera_world.ndim == 2

    @property
    def present(self) -> Bools:
        """Return a mask of the keypoints that were detected in each frame, (T, J)."""
        return np.isfinite(self.xy_px[..., 0])

    @property
    def rotation(self) -> Array:
        """Return the rotation R_camera_world, (3, 3) or, for a moving camera and arrays of joints, (T, 1, 3, 3)."""
        return self.T_camera_world[:3, :3] if self.is_still else self.T_camera_world[:, None, :3, :3]

    @cached_property
    def centre_m(self) -> Array:
        """Return the camera's centre of projection in the world in each frame, (T, 3), metres."""
        return np.broadcast_to(inverse(self.T_camera_world)[..., :3, 3], (len(self.xy_px), 3))

    @property
    def focal_px(self) -> Array | float:
        """Return the geometric mean of fx and fy, pixels, as one number or, for a camera that zooms, (T,)."""
        if self.intrinsics_px is not None:
            return np.sqrt(self.intrinsics_px[:, 0] * self.intrinsics_px[:, 1])
        return float(np.sqrt(self.camera.matrix[0, 0] * self.camera.matrix[1, 1]))

    def rotation_covariance_m2(self, points_m: Array) -> Array:
        """Return the covariance (T, J, 3, 3) in m^2 of points (T, J, 3) due to errors of the camera's rotation."""
        arm = points_m - self.centre_m[:, None]
        variance = np.zeros(len(arm)) if self.rotation_sigma_rad is None else self.rotation_sigma_rad**2
        perpendicular = np.sum(arm * arm, axis=-1)[..., None, None] * np.eye(3) - arm[..., :, None] * arm[..., None, :]
        return variance[:, None, None, None] * perpendicular

    def part(self, frames: slice | Index) -> View:
        """Return the view of only the given frames, which are indices of the clip's T frames."""
        if isinstance(frames, slice) and frames.indices(len(self.xy_px)) == (0, len(self.xy_px), 1):
            return self
        names = ["xy_px", "confidence", "intrinsics_px", "rotation_sigma_rad"]
        names += [] if self.is_still else ["T_camera_world"]
        arrays = {name: getattr(self, name) for name in names}
        return replace(self, **{name: values[frames] for name, values in arrays.items() if values is not None})

    @property
    def turn_px(self) -> Array | float:
        """Return the standard deviation of the picture's centre due to errors of the camera's rotation, (T,), px.

        The value is 0 if these errors are unknown.
        """
        return 0.0 if self.rotation_sigma_rad is None else self.focal_px * self.rotation_sigma_rad

    @property
    def seen(self) -> Bools:
        """Return a mask (T, J) of the keypoints that are in the picture or close to it (`Camera.sees`)."""
        return self.camera.sees(self.xy_px, self._unzoomed_px)

    def corrected(self, correction: Array) -> View:
        """Return the view after a correction (6,) of its camera's poses by three Euler angles, rad, and a shift, m.

        Points in the camera frame become X_new = R(angles) X + shift.
        """
        if not correction.any():
            return self
        T_correction = rigid(euler_rotation(correction[:3]), correction[3:])
        return replace(self, T_camera_world=T_correction @ self.T_camera_world)

    def with_focal_scale(self, log_scale: float) -> View:
        """Return the view with focal lengths multiplied by exp(log_scale), for a camera without zoom."""
        return replace(self, camera=self.camera.with_focal_scale(log_scale)) if log_scale else self

    def mask_outside_image(self) -> View:
        """Return the view without keypoints that are far outside the picture (`Camera.sees`), which are errors."""
        return replace(self, xy_px=np.where(self.seen[..., None], self.xy_px, np.nan))

    def shift_to_exposure(self, points_m: Array) -> Array:
        """Return points (T, J, 3), metres, moved from the clip's frames to the times of this view's pictures.

        Points in the last frame before a gap move with the velocity of the previous frames.
        """
        if not self.offset_frames or len(points_m) < 2:
            return points_m
        steps = np.diff(points_m, axis=0)
        previous, following = (np.concatenate(pair) for pair in ((steps[:1], steps), (steps, steps[-1:])))
        return points_m + self.offset_frames * np.where(np.isnan(following), previous, following)

    def to_camera(self, points_m: Array) -> Array:
        """Transform points (T, J, 3), metres, from the world frame to the camera's frame."""
        if self.is_still:
            rotated = points_m.reshape(-1, 3) @ self.T_camera_world[:3, :3].T  # one product instead of T
            return rotated.reshape(points_m.shape) + self.T_camera_world[:3, 3]
        R, t = self.T_camera_world[:, :3, :3], self.T_camera_world[:, :3, 3]
        return points_m @ R.swapaxes(1, 2) + t[:, None]

    def project(self, points_m: Array) -> tuple[Array, Bools]:
        """Project points (T, J, 3) in the world to pixels (T, J, 2), with a mask (T, J) of valid projections."""
        pixels, valid = self.camera.project(self.to_camera(points_m))
        return self._zoomed(pixels), valid

    def project_with_jacobian(self, points_m: Array) -> tuple[Array, Array, Bools]:
        """Return pixels (T, J, 2), their derivatives (T, J, 2, 3) by the points, and a mask (T, J) of valid ones."""
        pixels, by_point, valid = self.camera.project_with_jacobian(self.to_camera(points_m))
        if self.intrinsics_px is not None:
            by_point = self._zoom[:, None, :, :2] @ by_point
        if self.is_still:
            by_world = (by_point.reshape(-1, 3) @ self.rotation).reshape(by_point.shape)
        else:
            by_world = by_point @ self.rotation
        return self._zoomed(pixels), by_world, valid

    def rays(self) -> Array:
        """Return unit vectors (T, J, 3) in the world frame from the camera to the keypoints; NaN if missing."""
        rays, _ = self.camera.rays(self._unzoomed_px)
        return rays @ self.rotation if self.is_still else (rays[..., None, :] @ self.rotation)[..., 0, :]

    @cached_property
    def _zoom(self) -> Array:
        """Return the affine map (T, 2, 3) from pixels of the camera's own matrix to pixels of each frame's matrix."""
        assert self.intrinsics_px is not None
        matrices = np.tile(np.eye(3), (len(self.intrinsics_px), 1, 1))
        matrices[:, 0, 0], matrices[:, 1, 1], matrices[:, 0, 2], matrices[:, 1, 2] = self.intrinsics_px.T
        matrices[:, 0, 1] = self.camera.matrix[0, 1] * matrices[:, 0, 0] / self.camera.matrix[0, 0]
        return (matrices @ np.linalg.inv(self.camera.matrix))[:, :2]

    @property
    def _unzoomed_px(self) -> Array:
        """Return the keypoints (T, J, 2) in px as they would be under the camera's own matrix, without zoom."""
        if self.intrinsics_px is None:
            return self.xy_px
        linear, shift = self._zoom[:, None, :, :2], self._zoom[:, None, :, 2]
        return np.asarray(np.linalg.solve(linear, (self.xy_px - shift)[..., None]), dtype=float)[..., 0]

    def _zoomed(self, pixels: Array) -> Array:
        if self.intrinsics_px is None:
            return pixels
        return (self._zoom[:, None, :, :2] @ pixels[..., None])[..., 0] + self._zoom[:, None, :, 2]


def world_from_reference(first: Camera) -> Array:
    """Return the transform (4, 4) from the frame of reference to the world, for a static first camera.

    `recon.geometry.frames` defines both frames.
    """
    return np.eye(4) if first.knows_up else rigid(level_from_camera(first.up), np.zeros(3)) @ _pose(first)


def camera_poses(cameras: Sequence[Camera]) -> list[Array]:
    """Return the pose T_camera_world (4, 4) of each static camera, in the world frame of `recon.geometry.frames`."""
    T_reference_world = inverse(world_from_reference(cameras[0]))
    return [_pose(camera) @ T_reference_world for camera in cameras]


def _pose(camera: Camera) -> Array:
    """Return a static camera's pose as the transform T_camera_reference (4, 4)."""
    rotation = np.eye(3) if camera.rotation is None else camera.rotation
    return rigid(rotation, np.zeros(3) if camera.translation_m is None else camera.translation_m)


def still_view(camera: Camera, xy_px: Array, confidence: Array) -> View:
    """Return a static camera's view of a clip, in the world that this camera defines on its own."""
    return View(camera, camera_poses([camera])[0], xy_px, confidence)


BRIDGED_S = 2.0
"""Time without detections, in seconds, above which a clip is split into two."""


@dataclass(frozen=True, eq=False, repr=False)
class FramePoses(Brief):
    """Poses of a moving camera in T frames, in a world with z up; NaN in frames without a known pose."""

    T_camera_world: Array
    """Pose of the camera in each frame, shape (T, 4, 4)."""
    intrinsics_px: Array | None = None
    """fx, fy, cx, cy of each frame, shape (T, 4), for a camera that zooms."""
    rotation_sigma_rad: Array | None = None
    """Standard deviation of each pose's rotation about any axis, shape (T,), if known."""

    @property
    def known(self) -> Bools:
        """Return a mask of the frames with a camera pose, (T,)."""
        return np.isfinite(self.T_camera_world[:, 0, 0])

    def map_arrays(self, change: Callable[[Array], Array]) -> FramePoses:
        """Return the poses with a function applied to each of the arrays."""
        zoom, sigma = (
            None if array is None else change(array) for array in (self.intrinsics_px, self.rotation_sigma_rad)
        )
        return FramePoses(change(self.T_camera_world), zoom, sigma)


@dataclass(frozen=True, eq=False, repr=False)
class Source(Brief):
    """Cleaned keypoints of one camera, with the camera, its poses, and the record of the cleaning."""

    camera: Camera
    keypoints: Keypoints
    """Cleaned keypoints to fit, in the order of the body, on the frames of the clip.

    The frame numbers are the first camera's.
    """
    cleaning: CleaningReport
    file_names: tuple[str, ...]
    """Names of all keypoints in the file, including keypoints that the body does not have."""
    offset_frames: float = 0.0
    """Delay of the pictures relative to the clip's frames, in frames, at least 0 and below 1."""
    poses: FramePoses | None = None
    """Poses of a moving camera; None for a static camera, whose pose is in `camera`.

    Frames without a pose have no detections.
    """
    offset_s: float = 0.0
    """Time from the first camera's frame 0 to this camera's frame 0, in seconds, given or estimated."""

    @property
    def moves(self) -> bool:
        """Return whether the camera moves."""
        return self.poses is not None

    @property
    def later_frames(self) -> int:
        """Return the clip's frame number minus the file's frame number."""
        return round(self.offset_s * (self.keypoints.fps or 0.0) - self.offset_frames)


def views_of(sources: Sequence[Source]) -> tuple[View, ...]:
    """Return the views of a clip's sources.

    If one camera moves, static cameras must have a pose in the same world.
    """
    still_cameras = [source.camera for source in sources if not source.moves]
    poses, views = iter(camera_poses(still_cameras) if still_cameras else ()), []
    for source in sources:
        frame_poses = FramePoses(next(poses)) if source.poses is None else source.poses.map_arrays(fill_from_nearest)
        seen = (source.keypoints.xy_px, source.keypoints.confidence, frame_poses.intrinsics_px, source.offset_frames)
        views.append(View(source.camera, frame_poses.T_camera_world, *seen, frame_poses.rotation_sigma_rad))
    return tuple(views)


def fill_from_nearest(values: Array) -> Array:
    """Return values (T, ...) with NaN replaced by the value of the nearest frame."""
    known = np.flatnonzero(np.isfinite(values.reshape(len(values), -1)[:, 0]))
    frames = np.arange(len(values))
    following = np.clip(np.searchsorted(known, frames), 0, len(known) - 1)
    previous = np.maximum(following - 1, 0)
    nearest = np.where(np.abs(known[previous] - frames) <= np.abs(known[following] - frames), previous, following)
    return values[known[nearest]]


def align_cameras(sources: Sequence[Source], later_frames: Sequence[float]) -> tuple[Source, ...]:
    """Put the keypoints of all cameras on common frames, which are all frames near a detection by any camera.

    `later_frames` is the delay, in frames, of each camera's frame 0 relative to the first camera's.
    """
    shifts = [int(np.floor(later)) for later in later_frames]
    starts = [int(s.keypoints.frames[0]) + shift for s, shift in zip(sources, shifts, strict=True)]
    stops = [int(s.keypoints.frames[-1]) + shift + 1 for s, shift in zip(sources, shifts, strict=True)]
    frames, fps = np.arange(min(starts), max(stops)), sources[0].keypoints.fps or np.nan
    near = _near_detections(sources, starts, frames, BRIDGED_S * fps)
    return tuple(
        replace(_on_frames(source, start, frames[near]), offset_frames=later - shift, offset_s=later / fps)
        for source, start, later, shift in zip(sources, starts, later_frames, shifts, strict=True)
    )


def _near_detections(sources: Sequence[Source], starts: Sequence[int], frames: Integers, bridged: float) -> Bools:
    """Return a mask (T,) of the first frame, the last frame, and all frames near a detection by any camera.

    A gap that is too long to be bridged keeps its margins and remains too long. `starts` are the sources' first frame
    numbers, and `bridged` is the maximum length, in frames, of a gap that is bridged.
    """
    seen = np.zeros(len(frames), dtype=bool)
    for source, start in zip(sources, starts, strict=True):
        seen[np.flatnonzero(source.keypoints.present.any(axis=1)) + start - frames[0]] = True
    seen_rows = np.concatenate([[-np.inf], np.flatnonzero(seen), [np.inf]])
    rows = np.arange(len(frames))
    following = np.searchsorted(seen_rows, rows)
    near = np.minimum(seen_rows[following] - rows, rows - seen_rows[following - 1]) <= bridged / 2 + 1
    near[[0, -1]] = True
    return near


def _on_frames(source: Source, start: int, frames: Integers) -> Source:
    """Return a source on the given frames, with missing points in frames that it lacks.

    The source's own frames are consecutive, from `start` on.
    """
    keypoints = source.keypoints
    rows = np.arange(start, start + len(keypoints.frames))
    present_rows, source_rows = np.intersect1d(frames, rows, assume_unique=True, return_indices=True)[1:]
    if len(present_rows) == len(frames) == len(rows):
        return replace(source, keypoints=replace(keypoints, frames=frames))

    def spread(values: Array, missing: float = np.nan) -> Array:
        result = np.full((len(frames), *values.shape[1:]), missing)
        result[present_rows] = values[source_rows]
        return result

    xy_px, confidence = spread(keypoints.xy_px), spread(keypoints.confidence, 0.0)
    keypoints = replace(keypoints, xy_px=xy_px, confidence=confidence, frames=frames)
    return replace(source, keypoints=keypoints, poses=source.poses and source.poses.map_arrays(spread))
