"""Find a stride, the closed path of an end effector, as a task for inverse kinematics.

Between frames, the end effector relative to the base follows a cubic spline, because the position is continuous.
The angles can jump, because two pairs of angles give the same direction. A stride begins at a frame, where the angles
are known, and may end between two frames. If a stride of nine frames were cut to whole frames, its duration would be
wrong by up to a ninth, and the gap would be as wide as the motion of the foot in a frame.

A given stride begins at the frame closest to the given start, such as a touch-down, and has the given duration.
Otherwise the stride is the nearest return of the end effector to its start (`recon.gait.nearest_return`), or all frames
if there is no return. The remaining gap is spread evenly over the path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from recon.base.arrays import Array
from recon.gait.gait import WHOLE_CLIP
from recon.gait.nearest_return import longest_stretch, nearest_return
from recon.gait.phase import diameter
from recon.gait.spline import MIN_POINTS
from recon.ik.chain import SerialChain

OVERSAMPLING = 10
"""Number of points of the path per frame."""


@dataclass(frozen=True, eq=False)
class StridePath:
    """A stride of F frames, as a task for an end effector, in a clip with frame 0 at 0 s.

    The end of the stride may lie between two frames.
    """

    start_s: float
    end_s: float
    origin: str
    """Origin of the stride: "given", "gait" or "end effector" for a complete stride, "return" or "whole clip"."""
    q: Array
    """Joint angles of the animal, shape (F, n), rad; NaN if missing. The first row is the start."""
    path_m: Array
    """Closed path of the end effector, shape (K, dim), metres, with points `interval_s` apart."""
    interval_s: float
    gap_m: float
    """Width of the gap that was closed, metres."""
    gap_percent: float
    """Width of the gap as a percentage of the path's diameter."""
    notes: tuple[str, ...] = ()
    """Rejected strides, each with the reason."""


def find_stride(
    chain: SerialChain,
    q: Array,
    fps: float,
    span_s: tuple[float, float] | None = None,
    duration_range_s: tuple[float, float] | None = (0.0, np.inf),
) -> StridePath:
    """Find the stride of a chain in its joint angles, and return it as a closed path of the end effector.

    Only the longest stretch of frames without a gap of more than `MAX_GAP_FRAMES` is searched.

    Parameters
    ----------
    chain
        The chain whose end effector is followed.
    q
        Joint angles (T, n) in the frames, rad; NaN if missing.
    fps
        Frames per second.
    span_s
        Start and end of the stride in seconds, if known.
    duration_range_s
        Shortest and longest possible duration of a return, seconds; None for the whole clip.

    Raises
    ------
    ValueError
        If the times are not within the clip, or if there are too few frames.
    """
    known = longest_stretch(np.array(np.isfinite(q).all(axis=1)))
    if len(known) < MIN_POINTS:
        raise ValueError(f"a stride needs {MIN_POINTS} or more consecutive frames with a pose, got {len(known)}")
    ends = chain.end(q[known])
    curve = CubicSpline(known, ends)
    origin = "given"
    if span_s is not None:
        (start_s, end_s), half = span_s, 0.5 / fps
        first, last = known[0] / fps, known[-1] / fps
        if not first - half <= start_s < end_s <= last + half:
            raise ValueError(
                f"expected a stride within {first:.3f} to {last:.3f} s, got {start_s:.3f} to {end_s:.3f} s"
            )
        frames = (end_s - start_s) * fps
        # A later start would put the end of the stride after the last frame.
        begins = known[(known + frames <= known[-1] + 1e-6) | (known == known[0])]
        start = int(begins[np.argmin(np.abs(begins - start_s * fps))])
        end = min(start + frames, float(known[-1]))
    else:
        path = np.full((len(q), chain.dim), np.nan)
        path[known] = ends
        frames_of_return = None
        if duration_range_s is not None:
            shortest_s, longest_s = duration_range_s
            frames_of_return = nearest_return(path, shortest_s * fps, longest_s * fps)
        origin = WHOLE_CLIP if frames_of_return is None else "return"
        start, end = frames_of_return or (int(known[0]), float(known[-1]))
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
    """Return the angles (n,) with the end effector at its rearmost position, and its foremost position (dim,), metres.

    Forwards is the first axis of the base frame. `q` holds joint angles (K, n), such as the angles of a stride, NaN if
    missing.

    Raises
    ------
    ValueError
        If no frame is complete.
    """
    known = q[np.isfinite(q).all(axis=1)]
    if not len(known):
        raise ValueError("no frame without a missing value")
    ends = chain.end(known)
    return known[np.argmin(ends[:, 0])], ends[np.argmax(ends[:, 0])]
