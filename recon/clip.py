"""What a clip consists of: for each camera its 2D keypoints, cleaned and on the frames that all cameras share, and its
view: what it saw, and from where."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.arrays import Array, Bools, Brief, Index, Integers
from recon.base.errors import InputError, Problem
from recon.geometry.camera import Camera
from recon.geometry.frames import euler_rotation, inverse, level_from_camera, rigid

if TYPE_CHECKING:
    import pandas as pd

IN_MEMORY = "recon.io.columns"
"""What reads tables in memory as it reads files. It is imported by its name: the readers are built on this room."""
CORNER_PX, CONSTANT_SHARE, CONSTANT_KEYPOINTS = 1.0, 0.005, 3
"""A point stands for missing ones this near the corner, with so many of all points and of the keypoints just there."""


@dataclass(frozen=True, eq=False, repr=False)
class Keypoints(Brief):
    """Detections of K named keypoints in T frames of one camera. A reader hands over what its file says: a confidence
    of NaN means that the file has none, and a missing point may still carry one. `clean` turns this into the form
    below. Raises ValueError where names, shapes or types do not fit together."""

    names: tuple[str, ...]
    """The unique names of the K keypoints."""
    xy_px: np.ndarray
    """(T, K, 2) float, pixels, NaN = missing."""
    confidence: np.ndarray
    """(T, K) float in 0 to 1, 0 where missing."""
    frames: np.ndarray
    """(T,) int, original frame numbers, strictly increasing."""
    fps: float | None = None
    """How many frames there are in a second, where it is known."""
    stated_fps: float | None = None
    """What the file says of itself, where another rate was given."""
    image_size_px: tuple[int, int] | None = None
    """The size of the picture (width, height), where it is known."""
    individual: str | None = None
    """The animal's name in a file of several."""
    source: str | None = None
    """The file they came from."""
    scorer: str | None = None
    """Who found them, as the file names the network or the labeller; None where it does not."""
    notes: tuple[str, ...] = ()
    """What the reader had to decide, in plain sentences."""

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
        """Keypoints from a pandas table: as DeepLabCut's (levels scorer, bodyparts, coords, and individuals where there
        are several), its index the frames; or long, with columns frame, keypoint (or bodypart), x, y and confidence (or
        likelihood). Pixels. individual: which of several animals. Raises InputError."""
        return import_module(IN_MEMORY).from_dataframe(table, fps, individual)

    @classmethod
    def from_xarray(cls, dataset: Any, fps: float | None = None, individual: str | None = None) -> Keypoints:
        """Keypoints from movement's dataset of poses, in pixels; its times are seconds where it, or fps, says the frame
        rate. individual: which of several animals. Raises InputError."""
        return import_module(IN_MEMORY).from_xarray(dataset, fps, individual)

    @property
    def present(self) -> np.ndarray:
        """(T, K) bool: both coordinates are known."""
        return ~np.isnan(self.xy_px[..., 0]) & ~np.isnan(self.xy_px[..., 1])


COUNTS = (
    *("frames", "used", "missing", "rejected", "missing_zero_zero", "missing_nan_with_likelihood", "missing_empty"),
    *("missing_absent_frame", "missing_constant", "likelihood_unknown"),
)
"""What is counted of a keypoint, in frames, used + missing + rejected = frames. Missing is what was stored as (0, 0)
without a likelihood, as NaN with one, or as nothing, a frame that the file lacks, and what was stored as the one point
that stands for missing ones (`CleaningReport.constant_px`). The last are used points without a likelihood."""


@dataclass(frozen=True, repr=False)
class CleaningReport(Brief):
    """What `clean` did. Frame ranges are half-open pairs (A, B) of original frame numbers: A is in, B is not."""

    likelihood_min: float
    frames: tuple[int, int]
    """The range of frames that is left after cleaning."""
    frames_dropped: int
    """Rows of the file outside the range that was asked for."""
    inserted: tuple[tuple[int, int], ...]
    """Ranges of frames that the file lacks, now all missing."""
    keypoints: dict[str, dict[str, int]]
    """What became of each keypoint, by `COUNTS`."""
    notes: tuple[str, ...] = ()
    """What the reader had to decide."""
    constant_px: tuple[float, float] | None = None
    """The point, such as (-1, -1), that stands for missing ones although it has a likelihood; None: there is none."""

    def total(self, count: str) -> int:
        """Sum over the keypoints of one count, such as "rejected"."""
        return sum(counts[count] for counts in self.keypoints.values())


def parse_frame_range(text: str) -> tuple[int | None, int | None]:
    """The frame range "A:B" as (A, B); either side may be empty (None). Like a Python slice, B is not included. The
    numbers are those of the file, not positions in it. Raises InputError."""
    match = re.fullmatch(r"\s*(\d*)\s*:\s*(\d*)\s*", text, flags=re.ASCII)
    start, stop = (int(n) if n else None for n in match.groups()) if match else (None, None)
    if match is None or (start is not None and stop is not None and start >= stop):
        expected = "A:B with A < B, original frame numbers, B not included"
        raise InputError(Problem("--frames", "range", f"'{text}'", expected))
    return start, stop


def clean(
    keypoints: Keypoints, likelihood_min: float, frames: tuple[int | None, int | None] | None = None
) -> tuple[Keypoints, CleaningReport]:
    """Turns what a file says into points that can be trusted: missing is NaN with confidence 0, time is regular.
    frames: half-open range of original numbers. Raises InputError if no frame or point is left, or for absurd gaps."""
    if not 0 <= likelihood_min <= 1:
        raise InputError(Problem("--set likelihood-min", "likelihood_min", str(likelihood_min), "a number from 0 to 1"))
    rows_in_file = len(keypoints.frames)
    selected = select_frames(keypoints, frames)
    marked, missing = mark_missing(selected)
    unknown = marked.present & np.isnan(marked.confidence)  # as of hand labels, which are certain
    known = replace(marked, confidence=np.where(unknown, 1.0, marked.confidence))
    unlikely = known.present & (known.confidence < likelihood_min)
    likelihood_unknown, rejected = unknown.sum(axis=0), unlikely.sum(axis=0)
    cleaned, inserted = fill_gaps(_without_points(known, unlikely))

    absent = len(cleaned.frames) - len(selected.frames)
    used = cleaned.present.sum(axis=0)
    if not used.any():
        found = f"every point of the clip missing ({rejected.sum()} rejected as less likely than {likelihood_min:g})"
        expected = "a lower --set likelihood-min" if rejected.any() else "at least one point to work with"
        raise InputError(Problem(_source(keypoints), "points", found, expected))
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
    )
    return cleaned, report


def leave_out(
    keypoints: Keypoints, report: CleaningReport, points: np.ndarray, why: str
) -> tuple[Keypoints, CleaningReport]:
    """Further points (T, K) of a cleaned clip become missing, count as rejected, and a note says why."""
    if not points.any():
        return keypoints, report
    out = dict(zip(keypoints.names, points.sum(axis=0).tolist(), strict=True))
    counts = {}
    for name, of in report.keypoints.items():  # those of the file; the clip may have more
        used, lost = of["used"] - out.get(name, 0), out.get(name, 0)
        unknown = min(of["likelihood_unknown"], used)
        counts[name] = {**of, "used": used, "rejected": of["rejected"] + lost, "likelihood_unknown": unknown}
    frame, first = (int(i) for i in np.argwhere(points)[0])
    note = f"{points.sum()} points are {why}, and left out: {keypoints.names[first]} in frame {keypoints.frames[frame]}"
    note += ", ..." if points.sum() > 1 else ""
    report = replace(report, keypoints=counts, notes=(*report.notes, note))
    return _without_points(keypoints, points), report


def select_frames(keypoints: Keypoints, frames: tuple[int | None, int | None] | None) -> Keypoints:
    """The rows with frame numbers in the half-open range (A, B); None: no limit. Raises InputError if there is none."""
    start, stop = frames or (None, None)
    keep = keypoints.frames >= (-np.inf if start is None else start)
    keep &= keypoints.frames < (np.inf if stop is None else stop)
    if not keep.any():
        shown = f"{'' if start is None else start}:{'' if stop is None else stop}"
        has = f"{keypoints.frames[0]} to {keypoints.frames[-1]}" if len(keypoints.frames) else "none"
        expected = f"a range within its frames ({has})"
        raise InputError(Problem(_source(keypoints), "frames", f"none in the range {shown}", expected))
    if keep.all():  # as below: of half an hour each copy takes 100 MB
        return keypoints
    xy_px, confidence, numbers = (of[keep] for of in (keypoints.xy_px, keypoints.confidence, keypoints.frames))
    return replace(keypoints, xy_px=xy_px, confidence=confidence, frames=numbers)


def mark_missing(keypoints: Keypoints) -> tuple[Keypoints, dict[str, np.ndarray]]:
    """Missing points become NaN in both coordinates with confidence 0. Also how many they are of each keypoint, (K,) by
    the way they are stored, as `COUNTS` calls it. Some tools store a missing point as (0, 0): it is one only where the
    likelihood is 0 or unknown, because the corner of the image can be a detection like any other."""
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
    """The point in the picture's corner, or outside it, that several keypoints have to the last digit: no detector
    finds that, and it stands for missing points; None where there is none."""
    points, names = keypoints.xy_px[keypoints.present], np.nonzero(keypoints.present)[1]
    corner = (points <= CORNER_PX).all(axis=1) & (keypoints.confidence[keypoints.present] != 0)
    values, which, counts = np.unique(points[corner], axis=0, return_inverse=True, return_counts=True)
    if not len(values) or counts.max() < max(CONSTANT_SHARE * len(points), 2 * CONSTANT_KEYPOINTS):
        return None
    most = int(np.argmax(counts))
    x, y = values[most].tolist()
    return (x, y) if len(np.unique(names[corner][which.ravel() == most])) >= CONSTANT_KEYPOINTS else None


def fill_gaps(keypoints: Keypoints) -> tuple[Keypoints, tuple[tuple[int, int], ...]]:
    """All-missing rows for the frame numbers absent between the first and the last, so that time is regular. Returns
    the half-open ranges that were inserted. Raises InputError if they would dwarf the clip."""
    frames, (t, k) = keypoints.frames, keypoints.confidence.shape
    span = int(frames[-1]) - int(frames[0]) + 1
    if span - t > 10 * t + 10_000:
        found = f"{t} frames between {frames[0]} and {frames[-1]}, which leaves {span - t} to insert as missing"
        expected = "a clip without such gaps; choose a part of it with --frames A:B"
        raise InputError(Problem(_source(keypoints), "frames", found, expected))
    if span == t:
        return keypoints, ()
    rows = frames - frames[0]
    xy_px, confidence = np.full((span, k, 2), np.nan), np.zeros((span, k))
    xy_px[rows], confidence[rows] = keypoints.xy_px, keypoints.confidence
    regular = np.arange(frames[0], frames[-1] + 1)
    filled = replace(keypoints, xy_px=xy_px, confidence=confidence, frames=regular)
    return filled, frame_ranges(np.setdiff1d(regular, frames))


def frame_ranges(frames: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Increasing frame numbers (T,) as half-open ranges (A, B) of consecutive ones."""
    if not len(frames):
        return ()
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    return tuple((int(run[0]), int(run[-1]) + 1) for run in runs)


def densest_window(counts: Integers, n: int) -> slice:
    """The stretch of so many rows, at most, in which the sum is largest."""
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


# -- views and sources ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class View(Brief):
    """What one camera saw in the T frames of a clip, and from where. Metres, pixels of the distorted picture."""

    camera: Camera
    """Lens, intrinsics and the picture's size; a still camera's pose in the camera file is not read from here."""
    T_camera_world: Array
    """(T, 4, 4), or (4, 4) of a camera that stands still."""
    xy_px: Array
    """(T, J, 2): where the detector saw each keypoint, NaN where it did not."""
    confidence: Array
    """(T, J), 0 to 1."""
    intrinsics_px: Array | None = None
    """(T, 4): fx, fy, cx, cy of each frame, of a camera that zooms."""
    offset_frames: float = 0.0
    """Its pictures were taken that much later than the clip's frames: 0 up to 1 as given."""
    rotation_sigma_rad: Array | None = None
    """(T,): standard deviation of each pose's rotation about any axis, of a camera whose track says it."""

    @property
    def still(self) -> bool:
        return self.T_camera_world.ndim == 2

    @property
    def present(self) -> Bools:
        """Which of the J keypoints were detected in each of the T frames, shape (T, J)."""
        return np.isfinite(self.xy_px[..., 0])

    @property
    def rotation(self) -> Array:
        """R_camera_world (3, 3), or (T, 1, 3, 3) of a camera that moves: what it is multiplied with has joints, too."""
        return self.T_camera_world[:3, :3] if self.still else self.T_camera_world[:, None, :3, :3]

    @cached_property
    def centre_m(self) -> Array:
        """(T, 3): centre of projection, world frame."""
        return np.broadcast_to(inverse(self.T_camera_world)[..., :3, 3], (len(self.xy_px), 3))

    @property
    def focal_px(self) -> Array | float:
        """Geometric mean of fx and fy; (T,) of a camera that zooms."""
        if self.intrinsics_px is not None:
            return np.sqrt(self.intrinsics_px[:, 0] * self.intrinsics_px[:, 1])
        return float(np.sqrt(self.camera.matrix[0, 0] * self.camera.matrix[1, 1]))

    def rotation_covariance_m2(self, points_m: Array) -> Array:
        """(T, J, 3, 3): the uncertainty of each pose's rotation, in points (T, J, 3)."""
        off = points_m - self.centre_m[:, None]
        variance = np.zeros(len(off)) if self.rotation_sigma_rad is None else self.rotation_sigma_rad**2
        across = np.sum(off * off, axis=-1)[..., None, None] * np.eye(3) - off[..., :, None] * off[..., None, :]
        return variance[:, None, None, None] * across

    def part(self, frames: slice | Index) -> View:
        """The same view, cut to these frames."""
        names = ["xy_px", "confidence", "intrinsics_px", "rotation_sigma_rad"]
        names += [] if self.still else ["T_camera_world"]
        given = {name: getattr(self, name) for name in names}
        return replace(self, **{name: values[frames] for name, values in given.items() if values is not None})

    @property
    def turn_px(self) -> Array | float:
        """What the uncertainty of each pose's rotation moves in the picture's middle: (T,), or 0."""
        return 0.0 if self.rotation_sigma_rad is None else self.focal_px * self.rotation_sigma_rad

    @property
    def seen(self) -> Bools:
        """(T, J): keypoints that a detector can have found in the picture (`Camera.sees`)."""
        return self.camera.sees(self.xy_px, self._unzoomed_px)

    def corrected(self, correction: Array) -> View:
        """With an extrinsic correction (6,): X_camera = R(angles) X + metres (`recon.geometry.frames`)."""
        if not correction.any():
            return self
        by = rigid(euler_rotation(correction[:3]), correction[3:])
        return replace(self, T_camera_world=by @ self.T_camera_world)

    def with_focal_scale(self, log_scale: float) -> View:
        """With a camera whose focal lengths are longer by a factor, given by its logarithm; not of one that zooms."""
        return replace(self, camera=self.camera.with_focal_scale(log_scale)) if log_scale else self

    def mask_outside_image(self) -> View:
        """Without what no detector can have found in the picture (`Camera.sees`)."""
        return replace(self, xy_px=np.where(self.seen[..., None], self.xy_px, np.nan))

    def shift_to_exposure(self, points_m: Array) -> Array:
        """Points (T, J, 3) of the clip's frames when this view's pictures were taken."""
        if not self.offset_frames or len(points_m) < 2:
            return points_m
        step = np.diff(points_m, axis=0)
        before, after = (np.concatenate(pair) for pair in ((step[:1], step), (step, step[-1:])))
        return points_m + self.offset_frames * np.where(np.isnan(after), before, after)  # goes on where a gap begins

    # -- projection; points are those of all T frames ---------------------------------------------------------------

    def to_camera(self, points_m: Array) -> Array:
        """Points (T, J, 3) of the world frame in the camera frame."""
        if self.still:
            return points_m @ self.T_camera_world[:3, :3].T + self.T_camera_world[:3, 3]
        R, t = self.T_camera_world[:, :3, :3], self.T_camera_world[:, :3, 3]
        return points_m @ R.swapaxes(1, 2) + t[:, None]

    def project(self, points_m: Array) -> tuple[Array, Bools]:
        """Pixels (T, J, 2) and validity (T, J), as `Camera.project`, of points (T, J, 3) of the world frame."""
        pixels, valid = self.camera.project(self.to_camera(points_m))
        return self._zoomed(pixels), valid

    def project_with_jacobian(self, points_m: Array) -> tuple[Array, Array, Bools]:
        """The same, with the pixels' exact derivatives (T, J, 2, 3) by the points, second."""
        pixels, by_point, valid = self.camera.project_with_jacobian(self.to_camera(points_m))
        if self.intrinsics_px is not None:
            by_point = self._zoom[:, None, :, :2] @ by_point
        return self._zoomed(pixels), by_point @ self.rotation, valid

    def rays(self) -> Array:
        """(T, J, 3): unit vectors in the world frame towards the keypoints, NaN where there is none."""
        rays, _ = self.camera.rays(self._unzoomed_px)
        return rays @ self.rotation if self.still else (rays[..., None, :] @ self.rotation)[..., 0, :]

    @cached_property
    def _zoom(self) -> Array:
        """(T, 2, 3): pixels of the camera's own matrix in the frame's pixels. The lens bends before either."""
        assert self.intrinsics_px is not None
        matrices = np.tile(np.eye(3), (len(self.intrinsics_px), 1, 1))
        matrices[:, 0, 0], matrices[:, 1, 1], matrices[:, 0, 2], matrices[:, 1, 2] = self.intrinsics_px.T
        matrices[:, 0, 1] = self.camera.matrix[0, 1] * matrices[:, 0, 0] / self.camera.matrix[0, 0]
        return (matrices @ np.linalg.inv(self.camera.matrix))[:, :2]

    @property
    def _unzoomed_px(self) -> Array:
        """(T, J, 2): the keypoints in pixels of the camera's own matrix."""
        if self.intrinsics_px is None:
            return self.xy_px
        linear, shift = self._zoom[:, None, :, :2], self._zoom[:, None, :, 2]
        return np.asarray(np.linalg.solve(linear, (self.xy_px - shift)[..., None]), dtype=float)[..., 0]

    def _zoomed(self, pixels: Array) -> Array:
        if self.intrinsics_px is None:
            return pixels
        return (self._zoom[:, None, :, :2] @ pixels[..., None])[..., 0] + self._zoom[:, None, :, 2]


def world_from_reference(first: Camera) -> Array:
    """T_world_reference (4, 4) of `recon.geometry.frames`, of a clip whose first camera stands still."""
    return np.eye(4) if first.knows_up else rigid(level_from_camera(first.up), np.zeros(3)) @ _pose(first)


def camera_poses(cameras: Sequence[Camera]) -> list[Array]:
    """T_camera_world (4, 4) of still cameras, in the world frame of `recon.geometry.frames`."""
    T_reference_world = inverse(world_from_reference(cameras[0]))
    return [_pose(camera) @ T_reference_world for camera in cameras]


def _pose(camera: Camera) -> Array:
    """T_camera_reference (4, 4)."""
    rotation = np.eye(3) if camera.rotation is None else camera.rotation
    return rigid(rotation, np.zeros(3) if camera.translation_m is None else camera.translation_m)


def still_view(camera: Camera, xy_px: Array, confidence: Array) -> View:
    """The only view of a clip, by a camera that stands still."""
    return View(camera, camera_poses([camera])[0], xy_px, confidence)


BRIDGED_S = 2.0
"""Without detections for longer than this, what comes before and after are two clips."""


@dataclass(frozen=True, eq=False, repr=False)
class FramePoses(Brief):
    """Where a camera that moves was in T frames, in a world with z up; NaN where that is not known."""

    T_camera_world: Array
    """Where the camera is in each frame, shape (T, 4, 4)."""
    intrinsics_px: Array | None = None
    """(T, 4): fx, fy, cx, cy, of a camera that zooms."""
    rotation_sigma_rad: Array | None = None
    """(T,): standard deviation of each pose's rotation about any axis, where that is known."""

    @property
    def known(self) -> Bools:
        """Which of the T frames have a camera pose, shape (T,)."""
        return np.isfinite(self.T_camera_world[:, 0, 0])

    def map_arrays(self, change: Callable[[Array], Array]) -> FramePoses:
        """With all that there is changed."""
        zoom, sigma = (None if a is None else change(a) for a in (self.intrinsics_px, self.rotation_sigma_rad))
        return FramePoses(change(self.T_camera_world), zoom, sigma)


@dataclass(frozen=True, eq=False, repr=False)
class Source(Brief):
    """One camera's keypoints and what became of them."""

    camera: Camera
    keypoints: Keypoints
    """Cleaned, those that are fitted in their order, on the clip's frames: the first camera's numbers."""
    cleaning: CleaningReport
    file_names: tuple[str, ...]
    """All keypoints of the file."""
    offset_frames: float = 0.0
    """0 up to 1: its pictures were taken that much later than the clip's frames."""
    poses: FramePoses | None = None
    """The poses of a camera that moves, which itself has none; where they are not known, nothing is detected."""
    offset_s: float = 0.0
    """How much later than the first camera's frame 0 its own was taken, as given or found."""

    @property
    def moves(self) -> bool:
        return self.poses is not None


def views_of(sources: Sequence[Source]) -> tuple[View, ...]:
    """Where a camera moves, those that stand still must know their place in the same world."""
    still = [source.camera for source in sources if not source.moves]
    poses, views = iter(camera_poses(still) if still else ()), []
    for source in sources:
        where = FramePoses(next(poses)) if source.poses is None else source.poses.map_arrays(fill_from_nearest)
        seen = (source.keypoints.xy_px, source.keypoints.confidence, where.intrinsics_px, source.offset_frames)
        views.append(View(source.camera, where.T_camera_world, *seen, where.rotation_sigma_rad))
    return tuple(views)


def fill_from_nearest(values: Array) -> Array:
    """Values (T, ...), where they are NaN those of the nearest frame that has some."""
    known = np.flatnonzero(np.isfinite(values.reshape(len(values), -1)[:, 0]))
    frames = np.arange(len(values))
    after = np.clip(np.searchsorted(known, frames), 0, len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(known[before] - frames) <= np.abs(known[after] - frames), before, after)
    return values[known[nearest]]


def align_cameras(sources: Sequence[Source], later_frames: Sequence[float]) -> tuple[Source, ...]:
    """Sources on all frames that one of them has, but those far from all that was seen. later_frames: how much later
    each camera's frame 0 was taken than the first's."""
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
    """(T,): the first and the last of consecutive frames, and those near ones in which something is seen: of a stretch
    in which nothing is, so many are left that it is still not bridged."""
    seen = np.zeros(len(frames), dtype=bool)
    for source, start in zip(sources, starts, strict=True):
        seen[np.flatnonzero(source.keypoints.present.any(axis=1)) + start - frames[0]] = True
    at = np.concatenate([[-np.inf], np.flatnonzero(seen), [np.inf]])
    rows = np.arange(len(frames))
    after = np.searchsorted(at, rows)
    near = np.minimum(at[after] - rows, rows - at[after - 1]) <= bridged / 2 + 1
    near[[0, -1]] = True
    return near


def _on_frames(source: Source, start: int, frames: Integers) -> Source:
    """What was seen in consecutive frames from `start` on, in these; missing before and after."""
    keypoints = source.keypoints
    rows = np.arange(start, start + len(keypoints.frames))
    has, own = np.intersect1d(frames, rows, assume_unique=True, return_indices=True)[1:]
    if len(has) == len(frames) == len(rows):
        return replace(source, keypoints=replace(keypoints, frames=frames))

    def spread(values: Array, missing: float = np.nan) -> Array:
        spread = np.full((len(frames), *values.shape[1:]), missing)
        spread[has] = values[own]
        return spread

    xy_px, confidence = spread(keypoints.xy_px), spread(keypoints.confidence, 0.0)
    keypoints = replace(keypoints, xy_px=xy_px, confidence=confidence, frames=frames)
    return replace(source, keypoints=keypoints, poses=source.poses and source.poses.map_arrays(spread))
