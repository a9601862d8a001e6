"""What a path's kinematics begin with: its stretches without a long gap, and its jitter."""

from __future__ import annotations

import numpy as np

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
