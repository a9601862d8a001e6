"""Convert times of frames, as files state them, to frame numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from recon.base.errors import InputError, Problem, raise_problems
from recon.io.common import MAX_FRAME, StoredPoints

MAX_IRREGULARITY = 0.25
"""Largest difference, in frames, between a time step and a whole number of frames at which times count as regular."""
EVEN_MIN = 10
"""Minimum number of times required to estimate a frame rate despite rounding or jitter."""
EVEN_STEP = 1.75
"""Smallest step between two times, in frames, that may be a gap of missing frames instead of jitter."""
EVEN_OFF = 0.75
"""Largest deviation of a time from evenly spaced times, in frames, at which no frame counts as missing."""
JITTER_RMS = 0.2
"""Largest root mean square distance, in frames, of times with gaps from the nearest frames.

Uniformly random times have a root mean square distance of 0.29.
"""
ROUNDED_GAPS = 3
"""Minimum number of steps longer than 1.5 units of time (such as 1 ms) at which times count as rounded to the unit."""
ROUNDED_OFF = 0.6
"""Largest deviation of rounded times from evenly spaced times, in units, of which rounding alone explains 0.5."""
PHASE_SHARED = 0.5
"""Largest mean resultant length, 0 to 1, of the times' phases within a frame at which no common offset is assumed."""
_WINDOW = 16
"""Number of times from which the frame rate is first estimated."""
PER_SECOND = {"ns": 1e9, "us": 1e6, "µs": 1e6, "ms": 1e3}
"""Number of each unit of time in a second."""
EPOCH_S = 9e8, 1e10
"""Range of plausible time stamps in seconds since 1970, which are the years 1998 to 2286."""


def frames_of_numbers(path: Path, numbers: np.ndarray) -> np.ndarray:
    """Return times in units of frames as frame numbers, shape (T,) int.

    Raises
    ------
    InputError
        If the times are not increasing whole numbers.
    """
    _require_order(path, numbers, strict=True)
    return frames_of_times(path, numbers, 1.0)[0]


def frames_of_times(path: Path, times_s: np.ndarray, fps: float | None) -> tuple[np.ndarray, float | None]:
    """Return frame numbers (T,) int from times, and the frame rate.

    The frame rate is `fps`, or, if it is None, estimated from the times, which may be rounded or jittered. Frame 0 is
    at 0 s. A gap must be a whole number of frames. If `fps` is None, a single time is frame 0.

    Raises
    ------
    InputError
        If the times do not increase, or fit no frame rate.
    """
    frames, fps, _ = _frames_of_times(path, times_s, fps)
    return frames, fps


def with_times(path: Path, stored: StoredPoints, times_s: np.ndarray, fps: float | None) -> StoredPoints:
    """Return points with frame numbers computed from their times (T,) in seconds, and a note if the times are uneven.

    Uneven times are kept for `with_rate`. If the times fit no frame rate, the result stores the error, and `with_rate`
    raises it unless the user gives a frame rate.
    """
    try:
        frames, fps, note = _frames_of_times(path, times_s, fps)
    except InputError as error:
        frames = np.arange(len(times_s))
        return replace(stored, frames=frames, fps=fps, times_s=times_s, time_problems=error.problems)
    if not note:
        return replace(stored, frames=frames, fps=fps)
    return replace(stored, frames=frames, fps=fps, times_s=times_s, notes=(*stored.notes, note))


def with_rate(path: Path, stored: StoredPoints, fps: float | None) -> StoredPoints:
    """Convert uneven times of points to frame numbers at a frame rate, and return other points unchanged.

    Raises
    ------
    InputError
        If the times fit no frame rate and `fps` is None.
    """
    if stored.times_s is None or fps is None or (fps == stored.fps and not stored.time_problems):
        raise_problems(stored.time_problems)
        return stored
    frames = nearest_frames(path, stored.times_s, fps)
    return replace(stored, frames=frames, fps=fps, time_problems=())


def nearest_frames(path: Path, times_s: np.ndarray, fps: float) -> np.ndarray:
    """Return the frame number nearest to each time at a frame rate, shape (T,).

    Times that all lie within `EVEN_OFF` of evenly spaced times are consecutive frames. If other times share an offset
    from whole frames, it is subtracted first.

    Raises
    ------
    InputError
        If the times do not increase, or if two times are in one frame.
    """
    _require_order(path, times_s, strict=len(times_s) < EVEN_MIN)
    position = times_s * fps
    _require_clip(path, times_s, float(np.abs(position).max(initial=0.0)))
    rows = np.arange(len(position))
    ahead = position - rows
    if len(rows) and np.abs(ahead - np.median(ahead)).max() <= EVEN_OFF:
        return rows + round(float(np.median(ahead)))
    common_phase = complex(np.exp(2j * np.pi * position).mean()) if len(position) else 0j
    phase = float(np.angle(common_phase)) / (2 * np.pi) if abs(common_phase) > PHASE_SHARED else 0.0
    nearest = np.rint(position - phase)
    # jitter can put two times in one frame
    frames = rows + np.maximum.accumulate(nearest - rows) if len(rows) else nearest
    if (np.abs(frames - (position - phase)) > 1).any():
        detail = f"{_steps_text(times_s)} between times, so that some share a frame at {fps:g} frames per second"
        raise InputError(Problem(path, "time", detail, "a frame rate with one frame for each time (--fps)"))
    return frames.astype(np.int64)


def since_first(times: np.ndarray, unit: str | None = None) -> np.ndarray:
    """Return times in seconds, counted from the first one if they are Unix timestamps.

    Parameters
    ----------
    times : (T,)
        Times in a unit of `PER_SECOND`; NaN if unknown.
    unit : str, optional
        Unit stated in the file. If None, Unix timestamps have the unit that gives plausible dates, and other times are
        in seconds.
    """
    largest = float(np.nanmax(times)) if np.isfinite(times).any() else 0.0
    is_stamp = {name: EPOCH_S[0] <= largest / by < EPOCH_S[1] for name, by in (PER_SECOND | {"s": 1.0}).items()}
    if unit is None:
        unit = next((name for name, is_date in is_stamp.items() if is_date), "s")
    origin = float(np.nanmin(times)) if is_stamp.get(unit, False) else 0.0
    return (times - origin) / PER_SECOND.get(unit, 1.0)


def seconds(cells: Iterable[object]) -> np.ndarray | None:
    """Return time stamps as seconds after the first, or None if any cell is not a time stamp.

    Time stamps are ISO 8601, or have a date in any format that is the same in all cells. Times of the day,
    such as 00:01:02.500 or 01:02.500, are seconds after midnight.
    """
    texts = [str(cell).strip() for cell in cells]
    clocks = _clocks(texts)
    if clocks is not None:
        return clocks
    stamps = [_stamp(text) for text in texts]
    if not stamps or any(stamp is None for stamp in stamps):
        return _clocks_of_one_day(texts)
    known = [stamp for stamp in stamps if stamp is not None]
    first = known[0][0]
    try:
        return np.array([(moment - first).total_seconds() + fraction for moment, fraction in known])
    except TypeError:  # some times have a time zone, others have none
        return None


def _clocks(texts: Sequence[str]) -> np.ndarray | None:
    """Return times of the day in seconds after midnight, or None if any string is not a time of the day."""
    clocks = [re.fullmatch(r"(?:(\d{1,2}):)?([0-5]?\d):([0-5]\d(?:[.,]\d+)?)", text) for text in texts]
    # two numbers can be hours and minutes, unless the second has a fraction
    if not texts or not all(clock and (clock[1] or re.search("[.,]", clock[3])) for clock in clocks):
        return None
    parts = [[float((part or "0").replace(",", ".")) for part in clock.groups()] for clock in clocks if clock]
    return np.array(parts) @ [3600.0, 60.0, 1.0]


def _clocks_of_one_day(texts: Sequence[str]) -> np.ndarray | None:
    """Return the times in strings such as 30/11/2026 10:15:00.5 in seconds after the first, or None.

    The result is None unless every string has a date and a time, all with the same date and the same half of the day
    (AM or PM). The date's format does not matter.
    """
    matches = [re.fullmatch(r"(\d+[./-]\d+[./-]\d+)[T ]+(\S+)( ?[AaPp][Mm])?", text) for text in texts]
    dated = [match for match in matches if match is not None]
    if len(dated) < len(texts) or len({(match[1], match[3]) for match in dated}) != 1:
        return None
    clocks = _clocks([match[2] for match in dated])
    return None if clocks is None else clocks - clocks[0]


def _stamp(text: str) -> tuple[datetime, float] | None:
    """Return a time stamp without its fraction of a second, and the fraction, or None if it is not a time stamp."""
    match = re.fullmatch(r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d)(?:[.,](\d+))?(Z|[+-]\d\d:?\d\d)?", text)
    if match is None:
        return None
    try:
        return datetime.fromisoformat(match[1] + (match[3] or "")), float(f"0.{match[2] or 0}")
    except ValueError:
        return None


def _frames_of_times(path: Path, times_s: np.ndarray, fps: float | None) -> tuple[np.ndarray, float | None, str]:
    """Return frame numbers, the frame rate, and a note about uneven times, which may be empty."""
    if not len(times_s):
        return np.zeros(0, np.int64), fps, ""
    if fps is None and len(times_s) == 1:
        return np.zeros(1, np.int64), None, ""
    _require_order(path, times_s)
    steps_s, rounded = np.diff(times_s), False
    step_s = 1 / fps if fps is not None else float(np.median(steps_s))
    if step_s > 0:
        steps = np.rint(steps_s / step_s)
        _require_clip(path, times_s, max(steps.sum(), abs(float(times_s[0])) / step_s))
        since_start = np.concatenate([[0.0], np.cumsum(steps)]).astype(np.int64)
        misses = np.abs(steps_s / step_s - np.diff(since_start))
        rounded = fps is None and _is_rounded_to(step_s, times_s)
        if (np.diff(since_start) >= 1).all() and (misses <= MAX_IRREGULARITY).all() and not rounded:
            drifts = fps is None and len(times_s) >= EVEN_MIN and _off_frames(since_start, times_s) > EVEN_OFF
            if not drifts:
                fps = float(f"{since_start[-1] / (times_s[-1] - times_s[0]):.9g}") if fps is None else fps
                return since_start + round(float(times_s[0]) * fps), fps, ""
    if fps is not None:
        frames = nearest_frames(path, times_s, fps)
        deviation = times_s * fps - frames
        counted = (frames, 1 / fps) if deviation.std() <= JITTER_RMS else None
    else:
        counted = _even_count(times_s, rounded) if len(times_s) >= EVEN_MIN else None
    if counted is None:
        if (steps_s <= 0).any():
            raise InputError(_unordered(path))
        expected = "even times: convert the video to a constant frame rate, or use its nearest frames (--fps)"
        raise InputError(
            Problem(path, "time", f"a variable frame rate: {_steps_text(times_s)} between times", expected)
        )
    since_start, period_s = counted
    if fps is not None:
        return (
            since_start,
            fps,
            f"Times are uneven ({_steps_text(times_s)} apart): each is assigned to the nearest frame.",
        )
    fps = float(f"{1 / period_s:.6g}")
    note = f"Times are uneven ({_steps_text(times_s)} apart): frames are numbered at {fps:g} per second (or at --fps)."
    return since_start + round(float(times_s[0]) * fps), fps, note


def _even_count(times_s: np.ndarray, rounded: bool) -> tuple[np.ndarray, float] | None:
    """Return frame numbers from 0, and the period, of rounded or jittered times; None for a variable rate.

    If `rounded` is true, steps longer than a period are not taken as gaps.
    """
    rows = np.arange(len(times_s))
    period_s, start_s = np.polyfit(rows, times_s, 1)
    if period_s > 0 and (rounded or np.diff(times_s).max() < EVEN_STEP * period_s):
        deviation = np.abs((times_s - start_s) / period_s - rows)
        if deviation.max() <= EVEN_OFF:
            return rows, float(period_s)
    return _count_with_gaps(times_s)


def _off_frames(frames: np.ndarray, times_s: np.ndarray) -> float:
    """Return the largest deviation of the times from evenly spaced times, in frames."""
    period_s, start_s = np.polyfit(frames, times_s, 1)
    return float(np.abs((times_s - start_s) / period_s - frames).max())


def _is_rounded_to(unit_s: float, times_s: np.ndarray) -> bool:
    """Return whether rounding of evenly spaced times to a unit explains steps that look like gaps.

    If frames were missing, the times would not stay within half a unit of evenly spaced times.
    """
    longer = np.diff(times_s) > 1.5 * unit_s
    if longer.sum() < ROUNDED_GAPS or len(times_s) < EVEN_MIN:
        return False
    rows = np.arange(len(times_s))
    period_s, start_s = np.polyfit(rows, times_s, 1)
    return bool(np.abs(times_s - start_s - period_s * rows).max() <= ROUNDED_OFF * unit_s)


def _count_with_gaps(times_s: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Return frame numbers from 0, and the period, of jittered times with missing frames.

    The frame rate is estimated from the first times, and refined as later times are added, so that no frame is
    miscounted.
    """
    steps_s = np.diff(times_s)
    usual_s = steps_s[steps_s <= 1.5 * np.median(steps_s)]
    period_s, start_s = float(usual_s.mean()), float(times_s[0])
    count = min(_WINDOW, len(times_s))
    while True:
        if not period_s > 0:
            return None
        frames = np.rint((times_s[:count] - start_s) / period_s)
        if len(np.unique(frames)) < 2:
            return None
        period_s, start_s = (float(value) for value in np.polyfit(frames, times_s[:count], 1))
        if count == len(times_s):
            break
        count = min(2 * count, len(times_s))
    position = (times_s - start_s) / period_s
    frames = np.rint(position)
    if (np.diff(frames) < 1).any() or np.sqrt(np.mean((position - frames) ** 2)) > JITTER_RMS:
        return None
    return (frames - frames[0]).astype(np.int64), period_s


def _require_order(path: Path, times_s: np.ndarray, strict: bool = False) -> None:
    steps_s = np.diff(times_s)
    if not np.isfinite(times_s).all() or (steps_s < 0).any() or (strict and (steps_s == 0).any()):
        raise InputError(_unordered(path))


def _unordered(path: Path) -> Problem:
    return Problem(path, "time", "times that do not increase", "one increasing time for each frame")


def _require_clip(path: Path, times_s: np.ndarray, frames: float) -> None:
    if frames > MAX_FRAME:
        raise InputError(Problem(path, "time", f"{times_s[0]:g} to {times_s[-1]:g} s", "the times of a clip"))


def _steps_text(times_s: np.ndarray) -> str:
    steps_s = np.diff(times_s)
    return f"{1e3 * steps_s.min():.3g} to {1e3 * steps_s.max():.3g} ms"
