"""Kinematics of a point's path: speed, acceleration and distance from a cubic spline.

The spline goes through every frame that has the point (not-a-knot ends, as scipy's `CubicSpline`) and is evaluated at
ten times the frame rate. Nothing is extrapolated, and a gap longer than `MAX_GAP_S` is not bridged: there, all is NaN.
Frames that are missing in a shorter gap are interpolated. An exact spline turns a jitter of s metres in a coordinate
into one of about 6 s fps^2 in its acceleration. Frame-by-frame poses jitter in depth by decimetres, which makes an
exact path too long and too fast: `smoothing_m=frame_jitter_m(points)` smooths by as much.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from recon.arrays import Array, Index

MAX_GAP_S = 0.2
"""Missing frames are bridged if the frames on their two sides are not further apart than this."""
MIN_POINTS = 4
"""A cubic needs this many."""
NEAR_S, ASIDE = 0.25, 2**0.5
"""An animal that is this much faster than it gets on, within the time on either side, moves across its way as fast as
along it. Trunks of real cheetahs and dogs that walk or run are 1.02 to 1.34 times as fast at their peaks."""
STEADY = 0.1
"""How much of a peak speed may be due to how strongly the path is smoothed."""


@dataclass(frozen=True, eq=False)
class PathKinematics:
    """A path on a fine time grid: N = (T - 1) oversampling + 1 times, in as many dimensions d as its points. All NaN
    where the path is unknown."""

    time_s: Array
    """(N,), every `oversampling`-th is a frame."""
    position_m: Array
    """(N, d)"""
    velocity_m_s: Array
    """(N, d)"""
    speed_m_s: Array
    """(N,)"""
    acceleration_m_s2: Array
    """(N,): norm of the second derivative."""
    distance_m: float
    """Arc length over the stretches that are known."""
    peak_speed_m_s: float
    """NaN without any."""
    mean_speed_m_s: float
    """Over the time that the known stretches take."""
    oversampling: int
    smoothing_m: float | Array | None
    """As given, None for the exact spline."""


def path_kinematics(
    time_s: Array, points_m: Array, oversampling: int = 10, smoothing_m: float | Array | None = None
) -> PathKinematics:
    """Kinematics of a path given at T frames: time_s (T,), increasing, points_m (T, d), NaN where missing.

    smoothing_m: expected standard deviation of the coordinates' noise, metres, one for all or (d,); each coordinate
    then has the smoothest spline whose squared residuals sum to no more than n smoothing_m^2 (scipy's
    `UnivariateSpline`). None: exact.
    Fewer than four points in a stretch without a long gap give NaN. Raises ValueError for times that do not increase.
    """
    if np.any(np.diff(time_s) <= 0):
        raise ValueError("times must increase")
    T, d = points_m.shape
    N = (T - 1) * oversampling + 1 if T else 0
    fine_s = np.interp(np.arange(N) / oversampling, np.arange(T), time_s) if T else np.empty(0)
    position, velocity, acceleration = (np.full((N, d), np.nan) for _ in range(3))
    distance = covered = 0.0
    for rows in stretches(time_s, points_m):
        where = slice(rows[0] * oversampling, rows[-1] * oversampling + 1)
        curve = _spline(time_s[rows], points_m[rows], smoothing_m)
        position[where], velocity[where], acceleration[where] = (curve(fine_s[where], order) for order in range(3))
        distance += float(np.linalg.norm(np.diff(position[where], axis=0), axis=1).sum())
        covered += float(time_s[rows[-1]] - time_s[rows[0]])
    speed = np.linalg.norm(velocity, axis=1)
    return PathKinematics(
        time_s=fine_s,
        position_m=position,
        velocity_m_s=velocity,
        speed_m_s=speed,
        acceleration_m_s2=np.linalg.norm(acceleration, axis=1),
        distance_m=distance if covered else np.nan,
        peak_speed_m_s=float(np.nanmax(speed)) if covered else np.nan,
        mean_speed_m_s=distance / covered if covered else np.nan,
        oversampling=oversampling,
        smoothing_m=smoothing_m,
    )


def peak_doubt(time_s: Array, points_m: Array, smoothing_m: Array | None) -> str | None:
    """Why the peak speed of a path is not to be trusted, None where it is; arguments as `path_kinematics`.

    It is the jitter's where the path moves across its way as fast as along it, and where it changes with the smoothing:
    the jitter's size is known from some dozens of frames, and not to a factor of two.
    """
    path = path_kinematics(time_s, points_m, smoothing_m=smoothing_m)
    peak = path.peak_speed_m_s
    if not np.isfinite(peak):
        return None
    at_s = path.time_s[int(np.nanargmax(path.speed_m_s))]
    near = np.flatnonzero((np.abs(path.time_s - at_s) <= NEAR_S + 1e-9) & np.isfinite(path.speed_m_s))
    first, last = near[[0, -1]]
    way_m = float(np.linalg.norm(path.position_m[last] - path.position_m[first]))
    along = way_m / (path.time_s[last] - path.time_s[first])
    if peak > ASIDE * along:
        return f"at its peak it moves at {peak:.1f} m/s, but gets on at {along:.1f} m/s"
    if smoothing_m is not None:
        smoother = path_kinematics(time_s, points_m, smoothing_m=2 * smoothing_m).peak_speed_m_s
        if abs(smoother - peak) > STEADY * peak:
            return f"its peak is {peak:.1f} m/s, but {smoother:.1f} m/s where it is smoothed by twice its jitter"
    return None


def speed_at_frames(time_s: Array, points_m: Array, smoothing_m: float | Array | None = None) -> Array:
    """Speed (T,) in m/s of a path at its frames: as `path_kinematics`, for time series."""
    return path_kinematics(time_s, points_m, 1, smoothing_m).speed_m_s


def frame_jitter_m(points_m: Array) -> Array:
    """Standard deviation (d,) of what is independent from frame to frame in each coordinate of points (T, d), metres.

    Robust (median absolute value), from third differences over four frames in a row, in which a smooth motion nearly
    vanishes and white noise has a standard deviation of sqrt(20). NaN with fewer than three of them.
    """
    differences = np.diff(points_m, 3, axis=0)
    differences = differences[np.isfinite(differences).all(axis=1)]
    if len(differences) < 3:
        return np.full(points_m.shape[1], np.nan)
    return np.median(np.abs(differences), axis=0) / (0.6745 * np.sqrt(20.0))


def stretches(time_s: Array, values: Array, max_gap_s: float = MAX_GAP_S, min_points: int = MIN_POINTS) -> list[Index]:
    """Rows of the known values (T, d), split at the gaps that are too long; those with enough of them."""
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    too_long = (np.diff(known) > 1) & (np.diff(time_s[known]) > max_gap_s * (1 + 1e-9))
    return [rows for rows in np.split(known, np.flatnonzero(too_long) + 1) if len(rows) >= min_points]


def _spline(time_s: Array, points_m: Array, smoothing_m: float | Array | None) -> Callable[[Array, int], Array]:
    """curve(time (M,), order of the derivative) -> (M, d)."""
    if smoothing_m is None:
        return _exact_spline(time_s, points_m)
    from scipy.interpolate import UnivariateSpline  # slow to import

    allowed = len(time_s) * np.broadcast_to(smoothing_m, points_m.shape[1]) ** 2
    with warnings.catch_warnings():
        # FITPACK warns where rounding keeps it from spending exactly what is allowed.
        warnings.simplefilter("ignore")
        curves = [UnivariateSpline(time_s, x, k=3, s=s) for x, s in zip(points_m.T, allowed, strict=True)]
    return lambda t, order: np.stack([curve(t, nu=order) for curve in curves], axis=1)


def _exact_spline(time_s: Array, points_m: Array) -> Callable[[Array, int], Array]:
    """The cubic spline through n >= 4 points (n, d) whose third derivative is the same on the first two intervals, and
    on the last two: `CubicSpline` without scipy.interpolate, which takes longer to import than a short clip to fit."""
    h = np.diff(time_s)
    chord = np.diff(points_m, axis=0) / h[:, None]
    slope = _not_a_knot_slopes(h, chord)
    # On each interval, in the time u since its start: points + slope u + bend u^2 + twist u^3.
    twist = (slope[:-1] + slope[1:] - 2 * chord) / h[:, None] ** 2
    bend = (chord - slope[:-1]) / h[:, None] - twist * h[:, None]

    def curve(t: Array, order: int) -> Array:
        i = np.clip(np.searchsorted(time_s, t, side="right") - 1, 0, len(h) - 1)
        u = (t - time_s[i])[:, None]
        if order == 0:
            return points_m[i] + u * (slope[i] + u * (bend[i] + u * twist[i]))
        if order == 1:
            return slope[i] + u * (2 * bend[i] + u * 3 * twist[i])
        return 2 * bend[i] + u * 6 * twist[i]

    return curve


def _not_a_knot_slopes(h: Array, chord: Array) -> Array:
    """(n, d): first derivatives at the points, from the n - 1 intervals and the slopes of their chords (n - 1, d).

    One equation a point, with its two neighbours: lower s_before + middle s + upper s_after = right.
    """
    n = len(h) + 1
    lower, middle, upper = np.zeros((3, n))
    right = np.empty((n, chord.shape[1]))
    lower[1:-1], upper[1:-1] = h[1:], h[:-1]
    middle[1:-1] = 2 * (h[:-1] + h[1:])
    right[1:-1] = 3 * (h[1:, None] * chord[:-1] + h[:-1, None] * chord[1:])
    first, last = h[0] + h[1], h[-2] + h[-1]
    middle[0], upper[0] = h[1], first
    right[0] = ((h[0] + 2 * first) * h[1] * chord[0] + h[0] ** 2 * chord[1]) / first
    middle[-1], lower[-1] = h[-2], last
    right[-1] = (h[-1] ** 2 * chord[-2] + (2 * last + h[-1]) * h[-2] * chord[-1]) / last
    for i in range(1, n):  # elimination, which needs no pivoting here
        factor = lower[i] / middle[i - 1]
        middle[i] -= factor * upper[i - 1]
        right[i] -= factor * right[i - 1]
    slope = right
    slope[-1] /= middle[-1]
    for i in range(n - 2, -1, -1):
        slope[i] = (slope[i] - upper[i] * slope[i + 1]) / middle[i]
    return slope
