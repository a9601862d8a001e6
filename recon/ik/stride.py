"""Find a stride as a task for inverse kinematics: the closed path of an end effector.

Between frames, the end effector relative to the base follows a cubic spline, because the position is continuous while
the angles can jump between two pairs for the same direction. A stride begins at a frame, where the angles are known,
and may end between two frames. If a stride of nine frames were rounded to whole frames, its duration would be wrong by
up to a ninth, and the gap would be as wide as the motion of the foot in a frame.

A given stride begins at the frame closest to the given start, for instance a touch-down, and has the given duration.
Otherwise the stride is the best return of the end effector to its start. From each frame, the foot has to move away by
half the diameter of the path and return to within a quarter of it, while its direction stays within a right angle of
its first direction; the return ends at the nearest point. A return counts if it spans most of the path's diameter. The
return with the smallest gap is taken, or all frames if no return counts. The remaining gap is spread evenly over the
path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from recon.base.arrays import Array, Index
from recon.gait.phase import diameter
from recon.ik.chain import SerialChain

OVERSAMPLING = 10
"""Points of the path for each frame."""
MIN_FRAMES = 4
"""Smallest number of known frames for a spline."""
MAX_GAP_FRAMES = 4
"""Longest stretch without data that the spline bridges, frames."""
AWAY, BACK, SPAN = 0.5, 0.25, 0.8
"""Shares of the path's diameter: how far a return leads away, how near it comes back, and how much it spans."""


@dataclass(frozen=True, eq=False)
class StridePath:
    """A stride of F frames as a task, in a clip with frame 0 at 0 s.

    The end of the stride may lie between two frames.
    """

    start_s: float
    end_s: float
    origin: str
    """Origin of the stride: "given", "gait" for a complete stride, "return" or "whole clip"."""
    q: Array
    """Joint angles of the animal, shape (F, n), NaN if missing; the first row is the start."""
    path_m: Array
    """Closed path of the end effector, shape (K, dim), with points `interval_s` apart."""
    interval_s: float
    gap_m: float
    """Width of the gap that was closed."""
    gap_percent: float
    """Width of that gap in percent of the path's diameter."""
    notes: tuple[str, ...] = ()
    """Strides that do not count, each with the reason."""


def find_stride(
    chain: SerialChain,
    q: Array,
    fps: float,
    span_s: tuple[float, float] | None = None,
    lasts_s: tuple[float, float] = (0.0, np.inf),
) -> StridePath:
    """Return the stride of a chain from its joint angles; the module describes the search.

    Only the longest stretch of frames without a gap of more than `MAX_GAP_FRAMES` counts.

    Parameters
    ----------
    chain
        The chain.
    q
        Joint angles (T, n) in the frames, NaN if missing.
    fps
        Frames per second.
    span_s
        Start and end of the stride, if known.
    lasts_s
        Shortest and longest possible duration of a return, if known.

    Raises
    ------
    ValueError
        If the times are not within the clip, or if there are too few frames.
    """
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    known = max(np.split(known, np.flatnonzero(np.diff(known) > MAX_GAP_FRAMES + 1) + 1), key=np.size)
    if len(known) < MIN_FRAMES:
        raise ValueError(f"a stride needs {MIN_FRAMES} or more consecutive frames with a pose, got {len(known)}")
    ends = chain.end(q[known])
    curve = CubicSpline(known, ends)
    origin = "given"
    if span_s is not None:
        (start_s, end_s), half = span_s, 0.5 / fps
        first, last = known[0] / fps, known[-1] / fps
        if not first - half <= start_s < end_s <= last + half:
            raise ValueError(
                f"a stride within {first:.3f} to {last:.3f} s expected, got {start_s:.3f} to {end_s:.3f} s"
            )
        frames = (end_s - start_s) * fps
        # A later start would put the end of the stride after the last frame.
        begins = known[(known + frames <= known[-1] + 1e-6) | (known == known[0])]
        start = int(begins[np.argmin(np.abs(begins - start_s * fps))])
        end = min(start + frames, float(known[-1]))
    else:
        rows = _return(known, ends, lasts_s[0] * fps, lasts_s[1] * fps)
        origin = "return" if rows else "whole clip"
        i, j = rows or (0, len(known) - 1)
        start, end = int(known[i]), float(known[j])
        if rows:
            near = np.linspace(max(end - 1, start), min(end + 1, known[-1]), 20 * OVERSAMPLING + 1)
            end = float(near[np.argmin(np.linalg.norm(curve(near) - ends[i], axis=1))])
    if end <= start + 1 - 1e-6:
        raise ValueError("a stride needs two frames or more")
    points = round((end - start) * OVERSAMPLING) + 1
    path = curve(np.linspace(start, end, points))
    gap, extent = path[-1] - path[0], diameter(path)
    closed = path - np.linspace(0.0, 1.0, points)[:, None] * gap
    closed[-1] = closed[0]
    size = float(np.linalg.norm(gap))
    return StridePath(
        start_s=start / fps,
        end_s=end / fps,
        origin=origin,
        q=q[start : int(end + 1e-6) + 1],
        path_m=closed,
        interval_s=(end - start) / fps / (points - 1),
        gap_m=size,
        gap_percent=100 * size / extent if extent > 0 else 0.0,
    )


def farthest_reach(chain: SerialChain, q: Array) -> tuple[Array, Array]:
    """Return the angles q0 (n,) with the end effector rearmost, and its foremost position, the target (dim,).

    Forwards is the first axis of the base frame. q holds joint angles (K, n), for instance of a stride, NaN if missing.
    Raises ValueError if no frame is complete.
    """
    known = q[np.isfinite(q).all(axis=1)]
    if not len(known):
        raise ValueError("no frame without a missing value")
    ends = chain.end(known)
    return known[np.argmin(ends[:, 0])], ends[np.argmax(ends[:, 0])]


def _return(frames: Index, ends: Array, shortest: float, longest: float) -> tuple[int, int] | None:
    """Return the rows of the return with the smallest gap, or None if there is no return; see the module.

    ends is the path (F, dim). A return lasts `shortest` to `longest` frames.
    """
    velocity = np.gradient(ends, frames, axis=0)
    extent = diameter(ends)
    best, smallest = None, np.inf
    for i in range(len(ends)):
        distance = np.linalg.norm(ends[i:] - ends[i], axis=1)
        left = np.flatnonzero(distance >= AWAY * extent)
        if not len(left):
            continue
        back = np.flatnonzero((distance < BACK * extent) & (velocity[i:] @ velocity[i] > 0))
        lag = frames[i + back] - frames[i]
        back = back[(back > left[0]) & (lag >= shortest) & (lag <= longest)]
        if not len(back):
            continue
        # Look only as far as the next time that it leaves.
        visit = back[: np.argmax(np.append(np.diff(back), 2) > 1) + 1]
        j = int(visit[np.argmin(distance[visit])])
        if distance[j] < smallest and diameter(ends[i : i + j + 1]) >= SPAN * extent:
            best, smallest = (i, i + j), float(distance[j])
    return best
