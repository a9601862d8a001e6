"""A stride as a task: the closed path of an end effector.

Between frames the end effector, relative to the base, follows a cubic spline (angles can jump between two pairs for the
same direction, the position does not). A stride begins at a frame, where the angles are known. It may end between two
frames: rounded to frames, a stride of nine frames would be wrong by up to a ninth, with a gap as wide as the foot moves
in a frame.

A given stride begins at the frame next to the given start, the touch-down of a foot for instance, and has the given
duration. Otherwise the stride is the best return of the end effector to its start. From each frame the foot moves away
by half the path's diameter and returns to within a quarter of it, moving less than a right angle off its first
direction; the return ends at the nearest point. It counts if it spans most of the path's diameter. The one with the
smallest gap at a frame is taken; in a clip without any, all frames. The remaining gap is spread evenly over the path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from recon.base.arrays import Array, Index
from recon.gait.phase import diameter
from recon.ik.chain import SerialChain

OVERSAMPLING = 10
"""Points of the path in a frame."""
MIN_FRAMES = 4
"""Fewer known frames do not make a spline."""
MAX_GAP_FRAMES = 4
"""Longest stretch without data that the spline bridges."""
AWAY, BACK, SPAN = 0.5, 0.25, 0.8
"""Shares of the path's diameter: how far a return leads away and how near back, and how much of it it spans."""


@dataclass(frozen=True, eq=False)
class StridePath:
    """Hold a stride of F frames as a task, in a clip whose frame 0 is at 0 s; its end may lie between two frames."""

    start_s: float
    end_s: float
    origin: str
    """What it comes from: "given", "gait" where it is a complete one, "return" or "whole clip"."""
    q: Array
    """(F, n): the animal's joint angles, NaN where missing, of which the first is to start from."""
    path_m: Array
    """(K, dim): the end effector's path, closed, its points `interval_s` apart."""
    interval_s: float
    gap_m: float
    """The gap that was closed."""
    gap_percent: float
    """The same, of the path's diameter."""
    notes: tuple[str, ...] = ()
    """Strides that do not count, and why."""


def find_stride(
    chain: SerialChain,
    q: Array,
    fps: float,
    span_s: tuple[float, float] | None = None,
    lasts_s: tuple[float, float] = (0.0, np.inf),
) -> StridePath:
    """Return the stride of a chain's joint angles q (T, n) at the frames, NaN where missing; see the module.

    span_s: from when to when, where that is known; lasts_s: how long a return may take, as far as that is known. Only
    the longest stretch of frames without a gap of more than `MAX_GAP_FRAMES` counts. Raises ValueError for times that
    it does not hold, or too few frames.
    """
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    known = max(np.split(known, np.flatnonzero(np.diff(known) > MAX_GAP_FRAMES + 1) + 1), key=np.size)
    if len(known) < MIN_FRAMES:
        raise ValueError(f"a stride needs {MIN_FRAMES} known frames in a row or more, got {len(known)}")
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
        # Not so late that it would end after the last frame.
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

    q: joint angles (K, n), for instance of a stride, NaN where missing. Forwards is the base frame's first axis. Raises
    ValueError.
    """
    known = q[np.isfinite(q).all(axis=1)]
    if not len(known):
        raise ValueError("no frame without a missing value")
    ends = chain.end(known)
    return known[np.argmin(ends[:, 0])], ends[np.argmax(ends[:, 0])]


def _return(frames: Index, ends: Array, shortest: float, longest: float) -> tuple[int, int] | None:
    """Return the rows of the return (see the module) with the smallest gap; None without any.

    ends: the path (F, dim). A return lasts `shortest` to `longest` frames.
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
        # Up to where it leaves again.
        visit = back[: np.argmax(np.append(np.diff(back), 2) > 1) + 1]
        j = int(visit[np.argmin(distance[visit])])
        if distance[j] < smallest and diameter(ends[i : i + j + 1]) >= SPAN * extent:
            best, smallest = (i, i + j), float(distance[j])
    return best
