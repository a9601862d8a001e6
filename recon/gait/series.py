"""Compute the first and second derivatives of series of values, with standard deviations.

A series is interpolated at ten times the frame rate by a cubic spline through the frames that have a value. There are
two kinds of splines:

- exact (not-a-knot ends): passes through every value. White noise with the standard deviation s in the values becomes
  about 1.2 s fps in the rate and 6 s fps^2 in the acceleration.
- smoothing (natural ends): minimises sum(((x - f) / sigma)^2) + lam * integral(f''^2), with the largest lam that leaves
  the sum at no more than the number of values (Reinsch 1967). Its acceleration is zero at the ends by construction.

A gap longer than `max_gap_s` splits a series into spans, and a shorter gap is interpolated. Nothing is extrapolated.
Both ends of a span are less certain than its middle. In the first and the last frame of an exact spline, the standard
deviation of the rate is about four times as large as in the middle, and that of the acceleration 1.5 times as large. In
the next frame, the factor of the rate is 1.3. From the third frame on, both are within 10 % of their values in the
middle. The stated standard deviations include this effect.

For a given lam, a spline is a linear function of its values, so the covariance C of the values propagates exactly, C' =
W C W^T, where the columns of W are the splines through unit vectors. Coordinates are independent of one another, and so
are several `Errors` of the same values. Each of them has the covariance C_ij = sigma_i sigma_j exp(-((t_i - t_j) /
correlation_s)^2 / 2). The errors of a fit over time are smooth, so that independent errors of the frames would make the
standard deviations of the rates too large. The propagation includes neither the choice of lam nor the motion that
smoothing removes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import solveh_banded

from recon.base.arrays import Array, Brief, Index
from recon.gait.spline import MIN_POINTS, Curve, cubic_spline

MAX_GAP_S = 0.2
"""Longest time (s) between two frames with a value over which missing frames are interpolated."""
OVERSAMPLING = 10
ORDERS = (0, 1, 2)
"""Orders of the derivatives: value, rate and acceleration."""
MIN_SMOOTHING_POINTS = 5
"""Minimum number of values required for a smoothing spline."""
_LOG10_LAM = (-16.0, 8.0)
"""Range of log10 of lam / (duration / number of values)^3, from an exact spline to a straight line."""
JITTER_LASTS_S = 0.05
"""Correlation time of the lasting errors of a method that solves each frame on its own, s.

With this time and `JITTER_TIMES`, the standard deviations of speeds are accurate to 25 % in each of five real runs
(`python benchmarks/gait.py --only speeds`).
"""
JITTER_TIMES = 2.0
"""Ratio of the standard deviation of the errors that last for `JITTER_LASTS_S` to the frame-to-frame jitter."""
_WINDOW = 200
"""Number of frames for which the standard deviations of an exact spline are computed at once."""
_MARGIN = 40
"""Number of frames on either side of a window of `_WINDOW` frames from which the spline in the window is computed.

The influence of a value on the spline falls by the factor 2 - sqrt(3) from frame to frame, to 1e-23 over the margin.
"""
_REACH = 20
"""Number of frames on either side of a sample whose relative influence on an exact spline exceeds 1e-11."""
_MIN_PRODUCT = 1e-11
"""Smallest product of two frames' influences on a sample that counts, as a fraction of the largest product."""
_AT_ONCE = 1000
"""Number of frames for which the variances of an exact spline away from its ends are computed at once."""


@dataclass(frozen=True, eq=False, repr=False)
class Errors(Brief):
    """Standard deviations of the errors of a series of values, and the correlation time of the errors."""

    sigma: Array
    """Standard deviations, in the shape and unit of the values.

    For an error that lasts throughout the clip, the signs state in which direction it moves each value.
    """
    correlation_s: float = 0.0
    """Correlation time of the errors; 0 for independent frames, inf for an error that lasts throughout the clip."""

    def __getitem__(self, index) -> Errors:
        """Return the errors of the values that an index selects."""
        return Errors(self.sigma[index], self.correlation_s)


@dataclass(frozen=True, eq=False, repr=False)
class Series(Brief):
    """Values in d dimensions and their derivatives on a fine grid of times; NaN where unknown.

    The grid has N = (T - 1) oversampling + 1 times.
    """

    time_s: Array
    """Times, shape (N,); every `oversampling`-th sample is a frame."""
    value: Array
    """The values at the N times, shape (N, d)."""
    rate: Array
    """First derivatives, in the values' unit per second, shape (N, d)."""
    acceleration: Array
    """Second derivatives, in the values' unit per second^2, shape (N, d)."""
    value_sigma: Array
    """Standard deviations of the values, shape (N, d); NaN without stated errors."""
    rate_sigma: Array
    """Standard deviations of the rates, shape (N, d); NaN without stated errors."""
    acceleration_sigma: Array
    """Standard deviations of the accelerations, shape (N, d); NaN without stated errors."""
    oversampling: int


def series_kinematics(
    time_s: Array,
    values: Array,
    errors: Sequence[Errors] = (),
    *,
    smooth: bool = False,
    propagate: Sequence[int] = ORDERS,
    oversampling: int = OVERSAMPLING,
    max_gap_s: float = MAX_GAP_S,
) -> Series:
    """Return the values of a spline through a series, with its first two derivatives and their standard deviations.

    Parameters
    ----------
    time_s : ndarray
        Increasing times, s, shape (T,).
    values : ndarray
        Values, shape (T, d); a frame with NaN in any dimension is missing. A span needs four values, five with
        `smooth`.
    errors : sequence of Errors
        Independent errors of the values, with `sigma` of shape (T, d). The first item also sets the weights of
        smoothing.
    smooth : bool
        Smooth the values instead of passing through them.
    propagate : sequence of int
        Orders of the derivatives whose standard deviations are computed, 0 for the values. The standard deviations of
        the other orders are NaN. With `smooth`, each order needs 8 N T bytes of memory.
    oversampling : int
        Samples per frame.
    max_gap_s : float
        Longest gap that is interpolated, s.

    Raises
    ------
    ValueError
        If the times do not increase.
    """
    T, d = values.shape
    N = (T - 1) * oversampling + 1 if T else 0
    fine_s = np.interp(np.arange(N) / oversampling, np.arange(T), time_s) if T else np.empty(0)
    curves = np.full((3, N, d), np.nan)
    sigmas = np.full((3, N, d), np.nan) if len(errors) and propagate else np.broadcast_to(np.nan, (3, N, d))
    weight = 1.0 / errors[0].sigma if smooth else np.ones((T, d))
    for rows in spans_of(time_s, values, max_gap_s, MIN_SMOOTHING_POINTS if smooth else MIN_POINTS):
        samples = slice(rows[0] * oversampling, rows[-1] * oversampling + 1)
        t, sample_s, lam = time_s[rows], fine_s[samples], np.zeros(d)
        if not smooth:
            curves[:, samples] = cubic_spline(t, values[rows])(sample_s, ORDERS)
        for k in range(d) if smooth else ():
            lam[k] = _discrepancy_lam(t, values[rows, k], weight[rows, k])
            curves[:, samples, k] = _curve(t, values[rows, k], weight[rows, k], lam[k])(sample_s, ORDERS)
        if len(errors) and propagate:
            span_errors = [error[rows] for error in errors]
            sigmas[[*propagate], samples] = _spline_sigmas(t, sample_s, span_errors, weight[rows], lam, propagate)
    return Series(fine_s, *curves, *sigmas, oversampling=oversampling)


def spans_of(time_s: Array, values: Array, max_gap_s: float, min_points: int) -> list[Index]:
    """Return the indices of the known values (T, d) in each span, which is a stretch without a long gap.

    Spans with fewer than `min_points` values are left out.
    """
    known_rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    is_too_long = (np.diff(known_rows) > 1) & (np.diff(time_s[known_rows]) > max_gap_s * (1 + 1e-9))
    return [rows for rows in np.split(known_rows, np.flatnonzero(is_too_long) + 1) if len(rows) >= min_points]


def _curve(t: Array, x: Array, weight: Array, lam: float) -> Curve:
    """Return a smoothing spline of values x (n, ...) at times t (n,), which interpolates them if `lam` is 0."""
    known = np.isfinite(x)
    if x.ndim == 1 and known.sum() > 4:  # errors are unknown in frames without a pose, which the curve bridges
        t, x, weight = t[known], x[known], weight[known]
    if lam == 0:
        return cubic_spline(t, x)
    from scipy.interpolate import make_smoothing_spline  # slow to import

    spline = make_smoothing_spline(t, x, weight**2, lam)
    return lambda time, orders: np.stack([spline(time, order) for order in orders])


def _discrepancy_lam(t: Array, x: Array, weight: Array) -> float:
    """Return the lam of the smoothing spline f for which sum((weight (x - f))^2) equals n, the number of values.

    Return the largest lam of the range if the sum is less than n even for a straight line.
    """
    from scipy.optimize import brentq

    scale, h, variance = np.mean(weight**2) * ((t[-1] - t[0]) / len(t)) ** 3, np.diff(t), weight**-2.0
    # Reinsch's equations for the curve's second derivatives g at the inner times are (R + lam Q' W^-1 Q) g = Q' x.
    # The residuals are then x - f = lam W^-1 Q g. R and `pull`, which is Q' W^-1 Q, are stored as bands.
    left, right = 1 / h[:-1], 1 / h[1:]
    middle = -left - right
    R, pull = np.zeros((2, 3, len(middle)))
    R[1, 1:], R[2] = h[1:-1] / 6, (h[:-1] + h[1:]) / 3
    pull[0, 2:] = right[:-2] * variance[2:-2] * left[2:]
    pull[1, 1:] = middle[:-1] * variance[1:-2] * left[1:] + right[:-1] * variance[2:-1] * middle[1:]
    pull[2] = left**2 * variance[:-2] + middle**2 * variance[1:-1] + right**2 * variance[2:]
    bends = np.diff(np.diff(x) / h)

    def excess(log10_lam: float) -> float:
        lam = 10.0**log10_lam * scale
        g = solveh_banded(R + lam * pull, bends)
        residual = lam * np.diff(np.diff(g, prepend=0, append=0) / h, prepend=0, append=0)
        return float(np.sum(residual**2 * variance)) / len(t) - 1.0

    low, high = _LOG10_LAM
    if excess(high) <= 0:
        return 10.0**high * scale
    return 10.0 ** float(brentq(excess, low, high, xtol=1e-3)) * scale


def _spline_sigmas(
    t: Array, sample_s: Array, errors: Sequence[Errors], weight: Array, lam: Array, orders: Sequence[int]
) -> Array:
    """Return the standard deviations of the derivatives of O orders at times (M,) in a span of n values.

    The shape is (O, M, d).
    """
    variance = np.zeros((3, len(sample_s), len(lam)))
    smooth = bool(lam.any())
    # An error that lasts throughout the clip is propagated like a series of values.
    for lasting in (error for error in errors if error.correlation_s == np.inf):
        curves = [_curve(t, *column) for column in zip(lasting.sigma.T, weight.T, lam, strict=True)]
        variance[[*orders]] += np.stack([curve(sample_s, orders) for curve in curves], axis=-1) ** 2
    errors = [error for error in errors if error.correlation_s < np.inf]
    pieces = [(slice(None), slice(None))] if smooth else [*_windows(t, sample_s)]
    if not smooth and len(t) > 4 * _REACH and np.allclose(np.diff(t), t[1] - t[0], rtol=1e-6, atol=0):
        per_frame = (len(sample_s) - 1) // (len(t) - 1)
        first, last = _REACH * per_frame, (len(t) - 1 - _REACH) * per_frame
        _fill_interior(variance[:, first:last], t, errors, per_frame)
        pieces = [(slice(2 * _REACH), slice(first)), (slice(len(t) - 2 * _REACH, None), slice(last, None))]
    for values, samples in pieces:
        unit, operator = np.eye(len(t[values])), np.empty(0)
        for k in range(len(lam)):
            if smooth or k == 0:  # an exact spline is the same for all dimensions
                operator = _curve(t[values], unit, weight[values, k], lam[k])(sample_s[samples], orders)
            for error in errors:
                added = _propagate(operator * error.sigma[values, k], t[values], error.correlation_s)
                variance[:, samples, k][[*orders]] += added
    return np.sqrt(variance[[*orders]])


def _fill_interior(variance: Array, t: Array, errors: Sequence[Errors], per_frame: int) -> None:
    """Write the variances of an exact spline through n evenly spaced values into `variance` (3, M, d).

    There are `per_frame` samples per frame. The `_REACH` frames at either end are left out. In all other frames, the
    samples depend in the same way on the values around them.
    """
    width, step = 2 * _REACH, (t[-1] - t[0]) / (len(t) - 1)
    spline = cubic_spline(step * np.arange(2 * width), np.eye(2 * width))
    shares = spline(step * (width - 1 + np.arange(per_frame) / per_frame), ORDERS)[:, :, _REACH:-_REACH]
    shares = shares.reshape(3 * per_frame, width)
    first, second = np.triu_indices(width)
    products = shares[:, first] * shares[:, second] * np.where(first == second, 1.0, 2.0)
    least = _MIN_PRODUCT * np.max(shares**2, axis=1, keepdims=True)
    frames = len(t) - 1 - width
    by_frame = variance.reshape(3, frames, per_frame, -1)  # a view, so that assignments change `variance`
    for error in errors:
        factors = products * _correlation(step * (second - first), error.correlation_s)
        matters = (np.abs(factors) > least).any(axis=0)
        for k, sigma in enumerate(error.sigma.T):
            neighbours = sliding_window_view(sigma, frames)[1:]
            # Batches limit the memory.
            for batch in (slice(start, start + _AT_ONCE) for start in range(0, frames, _AT_ONCE)):
                added = factors[:, matters] @ (neighbours[first[matters], batch] * neighbours[second[matters], batch])
                by_frame[:, batch, :, k] += added.reshape(3, per_frame, -1).swapaxes(1, 2)
    np.maximum(variance, 0.0, out=variance)


def _windows(t: Array, sample_s: Array) -> Iterator[tuple[slice, slice]]:
    """Yield windows of the samples as slices, each with the slice of the values on which the samples depend."""
    for first in range(0, max(len(t) - 1, 1), _WINDOW):
        last = min(first + _WINDOW, len(t) - 1)
        begin, end = np.searchsorted(sample_s, [t[first], t[last]])
        is_final = last == len(t) - 1
        yield slice(max(first - _MARGIN, 0), last + _MARGIN + 1), slice(begin, len(sample_s) if is_final else end)


def _propagate(weighted: Array, t: Array, correlation_s: float) -> Array:
    """Return the variances (O, M) of linear functions of n errors with a correlation time.

    `weighted` are the functions' coefficients, multiplied by the standard deviations of the errors, shape (O, M, n).
    """
    if correlation_s == 0:
        return np.sum(weighted**2, axis=-1)
    return np.maximum(np.sum((weighted @ _correlation(t[:, None] - t, correlation_s)) * weighted, axis=-1), 0.0)


def _correlation(difference_s: Array, correlation_s: float) -> Array:
    return np.exp(-0.5 * (difference_s / correlation_s) ** 2) if correlation_s else (difference_s == 0).astype(float)


def frame_jitter_m(points_m: Array) -> Array:
    """Return the standard deviation of frame-to-frame noise in each coordinate of points (T, d), shape (d,), metres.

    The estimate is robust, because it uses the median of the absolute third differences over four consecutive frames.
    In these differences, smooth motion nearly vanishes, and white noise of unit variance has a standard deviation of
    sqrt(20). Return NaN for fewer than three differences.
    """
    differences = np.diff(points_m, 3, axis=0)
    differences = differences[np.isfinite(differences).all(axis=1)]
    if len(differences) < 3:
        return np.full(points_m.shape[1], np.nan)
    return np.median(np.abs(differences), axis=0) / (0.6745 * np.sqrt(20.0))


def jitter_errors(values: Array) -> tuple[Errors]:
    """Return errors of values (T, ...) that are as large as the jitter, and independent between frames."""
    jitter = frame_jitter_m(values.reshape(len(values), -1)).reshape(values.shape[1:])
    smallest = 1e-9  # avoids a zero sigma, as an exact series has no jitter
    return (Errors(np.broadcast_to(np.maximum(np.nan_to_num(jitter, nan=smallest), smallest), values.shape)),)


def lasting_errors(values: Array, fps: float) -> tuple[Errors, Errors]:
    """Return the errors of values (T, ...) from a method that starts each frame at the result of the previous frame.

    The errors of such a method persist for some time. The first item is `jitter_errors`, which sets the smoothing. The
    errors of the second item last for `JITTER_LASTS_S`. They are `JITTER_TIMES` as large as the jitter over this time,
    which includes single large errors.
    """
    (independent,) = jitter_errors(values)
    step = max(1, round(JITTER_LASTS_S * fps))
    differences = values[3 * step :] - 3 * values[2 * step : -step] + 3 * values[step : -2 * step] - values[: -3 * step]
    squares = np.where(np.isfinite(differences), differences**2 / 20, np.nan)
    is_known = np.isfinite(squares).any(axis=0)
    variance = np.where(is_known, np.nanmean(np.where(is_known, squares, 0.0), axis=0) if len(squares) else 0.0, 0.0)
    lasting = np.sqrt(np.maximum(JITTER_TIMES**2 * variance - independent.sigma**2, 1e-18))
    return independent, Errors(lasting, JITTER_LASTS_S)


def parabola_acceleration(time_s: Array, values: Array, errors: Sequence[Errors]) -> tuple[float, float]:
    """Return the acceleration of a parabola in time that fits values (T,) best, and its standard deviation.

    Both values are in the unit of the series per second^2. The standard deviation is NaN without errors.
    """
    t = time_s - time_s.mean()
    shares = 2 * np.linalg.pinv(np.stack([np.ones(len(t)), t, t**2], axis=1))[2]
    variance = sum(_variance_of_sum(shares * error.sigma, t, error.correlation_s) for error in errors)
    return float(shares @ values), float(np.sqrt(variance)) if len(errors) else np.nan


def _variance_of_sum(sigma: Array, t: Array, correlation_s: float) -> float:
    """Return the variance of the sum of T errors with the standard deviations `sigma` at times t, both (T,).

    The correlation of two errors decreases with the time between them.
    """
    variance = sigma @ sigma
    for lag in range(1, len(t)):
        difference_s = t[lag:] - t[:-lag]
        if difference_s.min() > 9 * correlation_s:
            break
        variance += 2 * (sigma[lag:] * sigma[:-lag]) @ _correlation(difference_s, correlation_s)
    return max(float(variance), 0.0)
