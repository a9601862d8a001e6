"""What a path's kinematics begin with: its stretches without a long gap, the exact cubic spline, and its jitter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_banded

from recon.base.arrays import Array, Index

MAX_GAP_S = 0.2
"""Missing frames are bridged if the frames on their two sides are not further apart than this."""
MIN_POINTS = 4
"""A cubic needs this many."""


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


def exact_spline(time_s: Array, values: Array) -> Callable[[Array, int], Array]:
    """curve(time (M,), order of the derivative) -> (M, d), the cubic spline through n >= 4 values (n, d) whose third
    derivative is the same on the first two intervals, and on the last two: `CubicSpline` without scipy.interpolate,
    which takes longer to import than a short clip to fit."""
    h = np.diff(time_s)
    chord = np.diff(values, axis=0) / h[:, None]
    slope = _not_a_knot_slopes(h, chord)
    # On each interval, in the time u since its start: values + slope u + bend u^2 + twist u^3.
    twist = (slope[:-1] + slope[1:] - 2 * chord) / h[:, None] ** 2
    bend = (chord - slope[:-1]) / h[:, None] - twist * h[:, None]

    def curve(t: Array, order: int) -> Array:
        i = np.clip(np.searchsorted(time_s, t, side="right") - 1, 0, len(h) - 1)
        u = (t - time_s[i])[:, None]
        if order == 0:
            return values[i] + u * (slope[i] + u * (bend[i] + u * twist[i]))
        if order == 1:
            return slope[i] + u * (2 * bend[i] + u * 3 * twist[i])
        return 2 * bend[i] + u * 6 * twist[i]

    return curve


def _not_a_knot_slopes(h: Array, chord: Array) -> Array:
    """(n, d): first derivatives at the points, from the n - 1 intervals and the slopes of their chords (n - 1, d).

    One equation a point, with its two neighbours: lower s_before + middle s + upper s_after = right.
    """
    n = len(h) + 1
    upper, middle, lower = bands = np.zeros((3, n))  # as scipy has them: the upper one column later, the lower earlier
    right = np.empty((n, chord.shape[1]))
    upper[2:], lower[:-2] = h[:-1], h[1:]
    middle[1:-1] = 2 * (h[:-1] + h[1:])
    right[1:-1] = 3 * (h[1:, None] * chord[:-1] + h[:-1, None] * chord[1:])
    first, last = h[0] + h[1], h[-2] + h[-1]
    middle[0], upper[1] = h[1], first
    right[0] = ((h[0] + 2 * first) * h[1] * chord[0] + h[0] ** 2 * chord[1]) / first
    middle[-1], lower[-2] = h[-2], last
    right[-1] = (h[-1] ** 2 * chord[-2] + (2 * last + h[-1]) * h[-2] * chord[-1]) / last
    return solve_banded((1, 1), bands, right)
