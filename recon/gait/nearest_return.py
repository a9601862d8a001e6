"""Find the nearest return of a foot to a position, for a clip in which no stride is complete.

A return begins at a frame. The foot moves away by at least half the diameter of its path, then comes back to within a
quarter of the diameter, moving within a right angle of its initial direction. The return ends at the point nearest to
its beginning, which may lie between two frames. A return counts only if it spans most of the path's diameter. Of all
returns that count, the one whose ends are closest to each other is chosen.

Between frames, the foot follows a cubic spline. Only the longest stretch of frames without a gap of more than
`MAX_GAP_FRAMES` is searched.
"""

from __future__ import annotations

import numpy as np

from recon.base.arrays import Array, Bools, Index
from recon.gait.phase import diameter
from recon.gait.spline import MIN_POINTS, cubic_spline

MAX_GAP_FRAMES = 4
"""Largest number of successive frames without a position that the spline bridges."""
AWAY_FRACTION = 0.5
"""Smallest distance by which the foot has to move away before it returns, as a fraction of the path's diameter."""
BACK_FRACTION = 0.25
"""Largest distance from its start to which the foot has to return, as a fraction of the path's diameter."""
SPAN_FRACTION = 0.8
"""Smallest diameter of a return, as a fraction of the diameter of the whole path."""
_STEPS = 100
"""Number of points per frame at which the end of a return is searched for."""


def longest_stretch(is_known: Bools) -> Index:
    """Return the indices of the known frames in the longest stretch without a gap of more than `MAX_GAP_FRAMES`.

    `is_known` is a mask of the frames with a known position, shape (T,).
    """
    known = np.flatnonzero(is_known)
    return max(np.split(known, np.flatnonzero(np.diff(known) > MAX_GAP_FRAMES + 1) + 1), key=np.size)


def nearest_return(path_m: Array, shortest: float = 0.0, longest: float = np.inf) -> tuple[int, float] | None:
    """Return the frames at which a foot's nearest return begins and ends, or None if the foot does not return.

    In a return, the foot moves away and comes back almost to its first position. The nearest return is the return whose
    end is closest to its beginning. The end may be a fraction of a frame.

    Parameters
    ----------
    path_m : ndarray
        Positions of the foot relative to the body, metres, shape (T, dim), NaN where unknown.
    shortest, longest : float
        Shortest and longest duration of the return, frames.
    """
    frames = longest_stretch(np.array(np.isfinite(path_m).all(axis=1)))
    if len(frames) < MIN_POINTS:
        return None
    points = path_m[frames]
    rows = _best_rows(frames, points, shortest, longest)
    if rows is None:
        return None
    start, end = (int(frames[row]) for row in rows)
    near_end = np.linspace(max(end - 1, start), min(end + 1, frames[-1]), 2 * _STEPS + 1)
    gaps = np.linalg.norm(cubic_spline(frames, points)(near_end, (0,))[0] - path_m[start], axis=1)
    return start, float(near_end[np.argmin(gaps)])


def _best_rows(frames: Index, points: Array, shortest: float, longest: float) -> tuple[int, int] | None:
    """Return the indices of the points (F, dim) at which the nearest return begins and ends, or None."""
    velocity = np.gradient(points, frames, axis=0)
    extent = diameter(points)
    best, smallest = None, np.inf
    for i in range(len(points)):
        distance = np.linalg.norm(points[i:] - points[i], axis=1)
        left = np.flatnonzero(distance >= AWAY_FRACTION * extent)
        if not len(left):
            continue
        back = np.flatnonzero((distance < BACK_FRACTION * extent) & (velocity[i:] @ velocity[i] > 0))
        lag = frames[i + back] - frames[i]
        back = back[(back > left[0]) & (lag >= shortest) & (lag <= longest)]
        if not len(back):
            continue
        # A return ends when the foot moves away again, so later frames near the start belong to another return.
        visit = back[: np.argmax(np.append(np.diff(back), 2) > 1) + 1]
        j = int(visit[np.argmin(distance[visit])])
        if distance[j] < smallest and diameter(points[i : i + j + 1]) >= SPAN_FRACTION * extent:
            best, smallest = (i, i + j), float(distance[j])
    return best
