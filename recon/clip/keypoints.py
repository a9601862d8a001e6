"""2D keypoints of one animal in one camera, and the steps that clean them."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.errors import InputError, Problem

if TYPE_CHECKING:
    import pandas as pd

IN_MEMORY = "recon.io.in_memory"
"""What reads tables in memory as it reads files. It is imported by its name: the readers are built on this room."""
CORNER_PX, CONSTANT_SHARE, CONSTANT_KEYPOINTS = 1.0, 0.005, 3
"""A point stands for missing ones this near the corner, with so many of all points and of the keypoints just there."""


@dataclass(frozen=True, eq=False)
class Keypoints:
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
        if self.xy_px.shape != (t, k, 2) or self.confidence.shape != (t, k) or self.frames.shape != (t,):
            raise ValueError(
                f"expected xy_px {(t, k, 2)}, confidence {(t, k)}, frames {(t,)}; "
                f"found {self.xy_px.shape}, {self.confidence.shape}, {self.frames.shape}"
            )
        if self.xy_px.dtype.kind != "f" or self.confidence.dtype.kind != "f" or self.frames.dtype.kind != "i":
            raise ValueError("xy_px and confidence must be floats, frames integers")
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


@dataclass(frozen=True)
class CleaningReport:
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
    known = dataclasses.replace(marked, confidence=np.where(unknown, 1.0, marked.confidence))
    unlikely = known.present & (known.confidence < likelihood_min)
    likelihood_unknown, rejected = unknown.sum(axis=0), unlikely.sum(axis=0)
    cleaned, inserted = fill_gaps(_without_points(known, unlikely))

    absent = len(cleaned.frames) - len(selected.frames)
    used = cleaned.present.sum(axis=0)
    if not used.any():
        found = f"every point of the clip missing ({rejected.sum()} rejected as less likely than {likelihood_min:g})"
        raise InputError(Problem(_source(keypoints), "points", found, "at least one point to work with"))
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
    report = dataclasses.replace(report, keypoints=counts, notes=(*report.notes, note))
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
    return dataclasses.replace(keypoints, xy_px=xy_px, confidence=confidence, frames=numbers)


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
    filled = dataclasses.replace(keypoints, xy_px=xy_px, confidence=confidence, frames=regular)
    return filled, frame_ranges(np.setdiff1d(regular, frames))


def frame_ranges(frames: np.ndarray) -> tuple[tuple[int, int], ...]:
    """Increasing frame numbers (T,) as half-open ranges (A, B) of consecutive ones."""
    if not len(frames):
        return ()
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    return tuple((int(run[0]), int(run[-1]) + 1) for run in runs)


def _without_points(keypoints: Keypoints, points: np.ndarray) -> Keypoints:
    if not (keypoints.present & points).any() and not keypoints.confidence[points].any():
        return keypoints
    xy_px, confidence = (
        np.where(points[..., None], np.nan, keypoints.xy_px),
        np.where(points, 0.0, keypoints.confidence),
    )
    return dataclasses.replace(keypoints, xy_px=xy_px, confidence=confidence)


def _source(keypoints: Keypoints) -> str:
    return keypoints.source or "keypoints"
