"""Compute the cubic spline through values.

The result is identical, to the last bit, to the result of scipy's `CubicSpline`. The import of `CubicSpline` would slow
down short fits, because it also imports all optimisers of scipy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import solve_banded

from recon.base.arrays import Array, Index

Curve = Callable[[Array, Sequence[int]], Array]
"""Function that returns the derivatives of O orders of a curve at times (M,), shape (O, M, ...); order 0 is a value."""
MIN_POINTS = 4
"""Minimum number of values required for a cubic spline."""


def cubic_spline(t: Array | Index, values: Array) -> Curve:
    """Return the cubic spline through values, with not-a-knot ends.

    Parameters
    ----------
    t : ndarray
        Increasing times, shape (n,), with n of at least `MIN_POINTS`.
    values : ndarray
        Finite values at these times, shape (n, ...).

    Raises
    ------
    ValueError
        If there are too few times, they do not increase, or a value is not finite.
    """
    t = np.asarray(t, dtype=float)
    dt = np.diff(t)
    if len(t) < MIN_POINTS or not (dt > 0).all() or not np.isfinite(values).all():
        raise ValueError(f"expected at least {MIN_POINTS} finite values at strictly increasing times")
    h = dt.reshape(-1, *[1] * (values.ndim - 1))
    slope = np.diff(values, axis=0) / h
    # The rates are the solution of a tridiagonal system. Its first and last rows make the third derivative continuous
    # at the second and the last but one time.
    bands, right = np.zeros((3, len(t))), np.empty_like(values, dtype=float)
    bands[1, 1:-1], bands[0, 2:], bands[2, :-2] = 2 * (dt[:-1] + dt[1:]), dt[:-1], dt[1:]
    right[1:-1] = 3 * (h[1:] * slope[:-1] + h[:-1] * slope[1:])
    first, last = t[2] - t[0], t[-1] - t[-3]
    bands[1, 0], bands[0, 1], bands[1, -1], bands[2, -2] = dt[1], first, dt[-2], last
    right[0] = ((h[0] + 2 * first) * h[1] * slope[0] + h[0] ** 2 * slope[1]) / first
    right[-1] = (h[-1] ** 2 * slope[-2] + (2 * last + h[-1]) * h[-2] * slope[-1]) / last
    rate = solve_banded((1, 1), bands, right.reshape(len(t), -1), check_finite=False).reshape(right.shape)
    bend = (rate[:-1] + rate[1:] - 2 * slope) / h
    powers = values[:-1], rate[:-1], (slope - rate[:-1]) / h - bend, bend / h

    def curve(time: Array, orders: Sequence[int]) -> Array:
        piece = np.clip(np.searchsorted(t, time, side="right") - 1, 0, len(t) - 2)
        since = (time - t[piece]).reshape(-1, *h.shape[1:])
        factors, since_powers = [power[piece] for power in powers], (1.0, since, since * since, since * since * since)
        derivatives = []
        for order in orders:
            derivative = np.zeros((len(piece), *values.shape[1:]))
            for exponent in range(order, len(powers)):
                constant = np.prod(np.arange(exponent - order + 1, exponent + 1, dtype=float))
                derivative = derivative + factors[exponent] * since_powers[exponent - order] * constant
            derivatives.append(derivative)
        return np.stack(derivatives)

    return curve
