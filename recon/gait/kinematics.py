"""Velocity, acceleration, joint angles and their rates, with standard deviations.

A series is a cubic spline through the frames that have a value, evaluated at ten times the frame rate. Two kinds:

- exact (not-a-knot ends): passes through every value. White noise of s in the values becomes
  about 1.2 s fps in the rate and 6 s fps^2 in the acceleration.
- smoothing (natural ends): minimises sum(((x - f) / sigma)^2) + lam * integral(f''^2),
  with the largest lam that leaves the sum at no more than the number of values (Reinsch 1967). Its acceleration is zero
  at the ends by construction.

Both ends of a span are weaker than its middle. Of an exact spline, the rate at the very end is about four times as
uncertain and that of the next frame 1.3 times, the acceleration at the end 1.5 times; from the third frame on, all is
within 10 %. The standard deviations say so. Nothing is extrapolated, and a gap longer than `max_gap_s` splits a series
into spans; a shorter one is interpolated.

For a given lam a spline is linear in its values, so that their covariance C propagates exactly: C' = W C W^T, with W
the splines through unit vectors. Coordinates are independent of one another, and so are the `Errors` that add up; each
has C_ij = sigma_i sigma_j exp(-((t_i - t_j) / correlation_s)^2 / 2). What a fit over time leaves is smooth: taken for
independent frames, the rates' deviations would be too large. The choice of lam is not part of the propagation, nor is
what smoothing takes away from the motion itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import CubicSpline, make_smoothing_spline
from scipy.linalg import solveh_banded
from scipy.optimize import brentq

from recon.base import Array, Brief, Index, InputError, Problem
from recon.io.common import Pose3D

Curve = Callable[[Array, int], Array]
Angle = Callable[[Array, Array, Array], Array]
"""An angle (T,) of three points (T, 3)."""

MAX_GAP_S = 0.2
"""Missing frames are bridged if the frames on their two sides are not further apart than this."""
MIN_POINTS = 4
"""A cubic needs this many."""
OVERSAMPLING = 10
MIN_SMOOTHING_POINTS = 5
"""Series of fewer points are not smoothed."""
_LOG10_LAM = (-16.0, 8.0)
"""Range of lam, relative to (span / number of values)^3: from an exact spline to a straight line."""
JITTER_LASTS_S, JITTER_TIMES = 0.05, 2.0
"""How long errors of a method last that solves frame by frame, and how much larger they are than what jitters in that
time: with both the deviations of its speeds are right in each of five real runs to a quarter
(`python benchmarks/speeds.py`)."""

_WINDOW, _MARGIN = 200, 40
"""Frames of an exact spline whose deviations are worked out at once, and how many on either side count: a value's share
in the spline falls by 2 - sqrt(3) from frame to frame, to 1e-23 over the margin."""
_REACH, _LEAST_PRODUCT, _AT_ONCE = 20, 1e-11, 1000
"""The same of evenly spaced frames away from the ends, 1e-11 over the reach; which products of two values' shares
count, relative to the largest; and of how many frames they are worked out at once."""

STRAIGHT_SIGMAS = 2.0
"""An angle that is less from straight may be bent to either side."""


@dataclass(frozen=True, eq=False, repr=False)
class Errors(Brief):
    """How far values may be wrong."""

    sigma: Array
    """Standard deviations of the values, in their shape and unit; of one error that lasts, with its signs."""
    correlation_s: float = 0.0
    """How long an error lasts (see the module), 0 for frames that have nothing to do with each other, inf for one."""

    def __getitem__(self, at) -> Errors:
        """The errors of a part of the values."""
        return Errors(self.sigma[at], self.correlation_s)


@dataclass(frozen=True, eq=False, repr=False)
class Series(Brief):
    """Values in d dimensions and their derivatives on a fine grid, N = (T - 1) oversampling + 1 times. NaN where
    unknown."""

    time_s: Array
    """(N,), every `oversampling`-th is a frame."""
    value: Array
    """The values at the N times, shape (N, d)."""
    rate: Array
    """(N, d), per second in the values' unit."""
    acceleration: Array
    """(N, d), per second^2 in the values' unit."""
    value_sigma: Array
    """(N, d): one standard deviation, as the next two NaN where no errors were given."""
    rate_sigma: Array
    """Standard deviations of the rates, shape (N, d)."""
    acceleration_sigma: Array
    """Standard deviations of the accelerations, shape (N, d)."""
    oversampling: int


@dataclass(frozen=True, eq=False, repr=False)
class JointKinematics(Brief):
    """A point's motion, world frame. NaN where nothing is known."""

    series: Series
    """Position (m), velocity (m/s) and acceleration (m/s^2) vectors, (N, 3)."""
    speed_m_s: Array
    """(N,): norm of the velocity."""
    acceleration_m_s2: Array
    """(N,): norm of the acceleration."""
    speed_sigma_m_s: Array
    """(N,): linear, NaN without errors (noise also biases a norm upwards, by about sigma^2 / norm, which is not
    taken out)."""
    acceleration_sigma_m_s2: Array
    """Standard deviations of the acceleration, shape (N,)."""
    distance_m: float
    """Arc length of the known spans."""
    mean_speed_m_s: float
    """Over the time the known spans take."""
    peak_speed_m_s: float
    peak_speed_sigma_m_s: float
    """The standard deviation of the peak speed; NaN without errors."""
    peak_speed_time_s: float
    peak_acceleration_m_s2: float
    peak_acceleration_sigma_m_s2: float
    """The standard deviation of the peak acceleration; NaN without errors."""

    @property
    def why_no_acceleration(self) -> str:
        """What figures say in place of an acceleration that is hardly known, or not at all."""
        values, known = self.acceleration_m_s2, np.isfinite(self.acceleration_m_s2)
        if known.any() and np.mean(self.acceleration_sigma_m_s2[known] > values[known]) <= 0.5:
            return ""
        return "The acceleration is hardly known, most of the time less than its standard deviation, and not shown."


@dataclass(frozen=True, eq=False, repr=False)
class AngleKinematics(Brief):
    """An angle over time. NaN where nothing is known."""

    series: Series
    """(N, 1), rad, rad/s, rad/s^2."""
    range_rad: tuple[float, float]
    """The least and the greatest angle."""
    peak_rate_rad_s: float
    """The greatest magnitude of the rate."""
    peak_acceleration_rad_s2: float
    """The greatest magnitude of the acceleration."""

    @property
    def range_of_motion_rad(self) -> float:
        """The difference between the greatest and the least angle."""
        return self.range_rad[1] - self.range_rad[0]


_Kind = TypeVar("_Kind", Series, JointKinematics)


def at_frames(of: _Kind) -> _Kind:
    """The same without the samples between frames, which take ten times the memory; means and peaks are those of all
    samples."""
    series = of if isinstance(of, Series) else of.series
    changed = {k: a[:: series.oversampling].copy() for k, a in vars(of).items() if isinstance(a, np.ndarray)}
    return replace(of, **changed, **({"oversampling": 1} if of is series else {"series": at_frames(series)}))


# -- series ----------------------------------------------------------------------------------------------------------


def series_kinematics(
    time_s: Array,
    values: Array,
    errors: Sequence[Errors] = (),
    *,
    smooth: bool = False,
    propagate: bool = True,
    oversampling: int = OVERSAMPLING,
    max_gap_s: float = MAX_GAP_S,
) -> Series:
    """Values (T, d) at increasing times (T,) -> their spline; NaN in any dimension is a missing frame.

    errors: what adds up to the values' errors, sigma (T, d) each; with smooth, the first is the weights as
    well. A span needs four values (five with smooth). propagate: whether to work out deviations, which with smooth
    takes memory of 8 bytes x N x T, and a spline for each value. Raises ValueError where times do not increase.
    """
    T, d = values.shape
    N = (T - 1) * oversampling + 1 if T else 0
    fine_s = np.interp(np.arange(N) / oversampling, np.arange(T), time_s) if T else np.empty(0)
    out = np.full((3, N, d), np.nan)
    spread = np.full((3, N, d), np.nan) if len(errors) and propagate else np.broadcast_to(np.nan, (3, N, d))
    weight = 1.0 / errors[0].sigma if smooth else np.ones((T, d))
    for rows in _stretches(time_s, values, max_gap_s, MIN_SMOOTHING_POINTS if smooth else MIN_POINTS):
        where = slice(rows[0] * oversampling, rows[-1] * oversampling + 1)
        t, at, lam = time_s[rows], fine_s[where], np.zeros(d)
        if not smooth:
            out[:, where] = _evaluate(CubicSpline(t, values[rows]), at)
        for k in range(d) if smooth else ():
            lam[k] = _discrepancy_lam(t, values[rows, k], weight[rows, k])
            out[:, where, k] = _evaluate(_curve(t, values[rows, k], weight[rows, k], lam[k]), at)
        if len(errors) and propagate:
            spread[:, where] = _spline_sigmas(t, at, [e[rows] for e in errors], weight[rows], lam)
    return Series(fine_s, *out, *spread, oversampling=oversampling)


def _stretches(time_s: Array, values: Array, max_gap_s: float, min_points: int) -> list[Index]:
    """Rows of the known values (T, d), split at the gaps that are too long; those with enough of them."""
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    too_long = (np.diff(known) > 1) & (np.diff(time_s[known]) > max_gap_s * (1 + 1e-9))
    return [rows for rows in np.split(known, np.flatnonzero(too_long) + 1) if len(rows) >= min_points]


def _curve(t: Array, x: Array, weight: Array, lam: float) -> Curve:
    """curve(time (M,), order of the derivative) -> (M, ...) through x (n, ...); lam 0: exact."""
    return make_smoothing_spline(t, x, weight**2, lam) if lam else CubicSpline(t, x)


def _evaluate(curve: Curve, at: Array) -> Array:
    """(3, M, ...): value, rate and acceleration."""
    return np.stack([curve(at, order) for order in range(3)])


def _discrepancy_lam(t: Array, x: Array, weight: Array) -> float:
    """The lam with sum((weight (x - f))^2) = n; the largest in range where a straight line is as close as that."""
    scale, h, variance = np.mean(weight**2) * ((t[-1] - t[0]) / len(t)) ** 3, np.diff(t), weight**-2.0
    # Reinsch's equations of the curve's second derivatives g at the inner times: (R + lam Q' W^-1 Q) g = Q' x, whose
    # bands are these, and x - f = lam W^-1 Q g
    before, after = 1 / h[:-1], 1 / h[1:]
    at = -before - after
    R, pull = np.zeros((2, 3, len(at)))
    R[1, 1:], R[2] = h[1:-1] / 6, (h[:-1] + h[1:]) / 3
    pull[0, 2:] = after[:-2] * variance[2:-2] * before[2:]
    pull[1, 1:] = at[:-1] * variance[1:-2] * before[1:] + after[:-1] * variance[2:-1] * at[1:]
    pull[2] = before**2 * variance[:-2] + at**2 * variance[1:-1] + after**2 * variance[2:]
    bends = np.diff(np.diff(x) / h)

    def excess(log10_lam: float) -> float:
        lam = 10.0**log10_lam * scale
        g = solveh_banded(R + lam * pull, bends)
        off = lam * np.diff(np.diff(g, prepend=0, append=0) / h, prepend=0, append=0)
        return float(np.sum(off**2 * variance)) / len(t) - 1.0

    low, high = _LOG10_LAM
    if excess(high) <= 0:
        return 10.0**high * scale
    return 10.0 ** float(brentq(excess, low, high, xtol=1e-3)) * scale


def _spline_sigmas(t: Array, at: Array, errors: Sequence[Errors], weight: Array, lam: Array) -> Array:
    """Standard deviations (3, M, d) of value, rate and acceleration at times (M,) of the splines of a span (n,)."""
    variance = np.zeros((3, len(at), len(lam)))
    smooth = bool(lam.any())
    for lasting in (error for error in errors if error.correlation_s == np.inf):  # one error is a curve itself
        curves = [_curve(t, *of) for of in zip(lasting.sigma.T, weight.T, lam, strict=True)]
        variance += np.stack([_evaluate(curve, at) for curve in curves], axis=-1) ** 2
    errors = [error for error in errors if error.correlation_s < np.inf]
    pieces = [(slice(None), slice(None))] if smooth else [*_windows(t, at)]
    if not smooth and len(t) > 4 * _REACH and np.allclose(np.diff(t), t[1] - t[0], rtol=1e-6, atol=0):
        per = (len(at) - 1) // (len(t) - 1)
        first, last = _REACH * per, (len(t) - 1 - _REACH) * per
        _fill_amid(variance[:, first:last], t, errors, per)
        pieces = [(slice(2 * _REACH), slice(first)), (slice(len(t) - 2 * _REACH, None), slice(last, None))]
    for values, samples in pieces:
        unit, operator = np.eye(len(t[values])), np.empty(0)
        for k in range(len(lam)):
            if smooth or k == 0:  # an exact spline is the same for all dimensions
                operator = _evaluate(_curve(t[values], unit, weight[values, k], lam[k]), at[samples])
            for error in errors:
                variance[:, samples, k] += _propagate(operator * error.sigma[values, k], t[values], error.correlation_s)
    return np.sqrt(variance, out=variance)


def _fill_amid(variance: Array, t: Array, errors: Sequence[Errors], per: int) -> None:
    """Fill the variances (3, M, d) of an exact spline through evenly spaced values (n,), `per` samples a frame, without
    the `_REACH` frames at either end: there every frame's samples depend correlated on the values about it."""
    wide, step = 2 * _REACH, (t[-1] - t[0]) / (len(t) - 1)
    spline = CubicSpline(step * np.arange(2 * wide), np.eye(2 * wide))
    shares = _evaluate(spline, step * (wide - 1 + np.arange(per) / per))[:, :, _REACH:-_REACH].reshape(3 * per, wide)
    first, second = np.triu_indices(wide)
    products = shares[:, first] * shares[:, second] * np.where(first == second, 1.0, 2.0)
    least = _LEAST_PRODUCT * np.max(shares**2, axis=1, keepdims=True)
    frames = len(t) - 1 - wide
    by_frame = variance.reshape(3, frames, per, -1)  # a view
    for error in errors:
        factors = products * _correlation(step * (second - first), error.correlation_s)
        counts = (np.abs(factors) > least).any(axis=0)
        for k, sigma in enumerate(error.sigma.T):
            about = sliding_window_view(sigma, frames)[1:]
            for at in (slice(start, start + _AT_ONCE) for start in range(0, frames, _AT_ONCE)):  # each takes memory
                added = factors[:, counts] @ (about[first[counts], at] * about[second[counts], at])
                by_frame[:, at, :, k] += added.reshape(3, per, -1).swapaxes(1, 2)
    np.maximum(variance, 0.0, out=variance)


def _windows(t: Array, at: Array) -> Iterator[tuple[slice, slice]]:
    """Pieces of the times `at`, each with the values of a span that its samples depend on."""
    for first in range(0, max(len(t) - 1, 1), _WINDOW):
        last = min(first + _WINDOW, len(t) - 1)
        begin, end = np.searchsorted(at, [t[first], t[last]])
        final = last == len(t) - 1
        yield slice(max(first - _MARGIN, 0), last + _MARGIN + 1), slice(begin, len(at) if final else end)


def _propagate(weighted: Array, t: Array, correlation_s: float) -> Array:
    """Variances (3, M) of operators (3, M, n), already times sigma."""
    if correlation_s == 0:
        return np.sum(weighted**2, axis=-1)
    return np.maximum(np.sum((weighted @ _correlation(t[:, None] - t, correlation_s)) * weighted, axis=-1), 0.0)


def _correlation(apart_s: Array, lasts_s: float) -> Array:
    return np.exp(-0.5 * (apart_s / lasts_s) ** 2) if lasts_s else (apart_s == 0).astype(float)


# -- points ----------------------------------------------------------------------------------------------------------


def frame_times(frames: Array | Index, fps: float) -> Array:
    """Times (T,) of frame numbers, seconds; frame 0 is at 0. Raises ValueError unless fps is positive."""
    if not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"a positive frame rate is needed, got {fps}")
    return np.asarray(frames, float) / fps


def joint_index(pose: Pose3D, names: tuple[str, ...]) -> list[int]:
    """Where the joints stand in a pose. Raises InputError with every one that it lacks."""
    lacking = [name for name in dict.fromkeys(names) if name not in pose.names]
    if lacking:
        where = pose.source or "pose"
        shown = ", ".join(pose.names)
        raise InputError([Problem(where, "joints", f"no '{name}'", f"one of {shown}") for name in lacking])
    return [pose.names.index(name) for name in names]


def point_kinematics(time_s: Array, xyz_m: Array, errors: Sequence[Errors] = (), **options) -> JointKinematics:
    """A point's path (T, 3) in metres at times (T,), errors (T, 3); options as `series_kinematics`."""
    series = series_kinematics(time_s, xyz_m, errors, **options)
    speed, speed_sigma = _norm(series.rate, series.rate_sigma)
    acceleration, acceleration_sigma = _norm(series.acceleration, series.acceleration_sigma)
    steps_m = np.linalg.norm(np.diff(series.value, axis=0), axis=1)
    known = np.isfinite(steps_m)
    distance, covered = float(steps_m[known].sum()), float(np.diff(series.time_s)[known].sum())
    return JointKinematics(
        series=series,
        speed_m_s=speed,
        acceleration_m_s2=acceleration,
        speed_sigma_m_s=speed_sigma,
        acceleration_sigma_m_s2=acceleration_sigma,
        distance_m=distance if covered else np.nan,
        mean_speed_m_s=distance / covered if covered else np.nan,
        peak_speed_m_s=_at_peak(speed, speed),
        peak_speed_sigma_m_s=_at_peak(speed, speed_sigma),
        peak_speed_time_s=_at_peak(speed, series.time_s),
        peak_acceleration_m_s2=_at_peak(acceleration, acceleration),
        peak_acceleration_sigma_m_s2=_at_peak(acceleration, acceleration_sigma),
    )


def _at_peak(values: Array, others: Array) -> float:
    """The others (N,), where values (N,) are largest; NaN without."""
    return float(others[np.nanargmax(values)]) if np.isfinite(values).any() else np.nan


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


def jitter_errors(values: Array) -> tuple[Errors]:
    """Independent errors of the size that values (T, ...) jitter with from frame to frame."""
    jitter = frame_jitter_m(values.reshape(len(values), -1)).reshape(values.shape[1:])
    smallest = 1e-9  # an exact series has none
    return (Errors(np.broadcast_to(np.maximum(np.nan_to_num(jitter, nan=smallest), smallest), values.shape)),)


def lasting_errors(values: Array, fps: float) -> tuple[Errors, Errors]:
    """The errors of values (T, ...) of a method that starts a frame from the one before and repeats its errors for some
    time: `jitter_errors`, which smoothing goes by, and what comes with `JITTER_TIMES` the jitter from one
    `JITTER_LASTS_S` to the next, single large errors included."""
    (independent,) = jitter_errors(values)
    step = max(1, round(JITTER_LASTS_S * fps))
    differences = values[3 * step :] - 3 * values[2 * step : -step] + 3 * values[step : -2 * step] - values[: -3 * step]
    squares = np.where(np.isfinite(differences), differences**2 / 20, np.nan)
    known = np.isfinite(squares).any(axis=0)
    variance = np.where(known, np.nanmean(np.where(known, squares, 0.0), axis=0) if len(squares) else 0.0, 0.0)
    lasting = np.sqrt(np.maximum(JITTER_TIMES**2 * variance - independent.sigma**2, 1e-18))
    return independent, Errors(lasting, JITTER_LASTS_S)


def net_acceleration(time_s: Array, xyz_m: Array, errors: Sequence[Errors] = ()) -> tuple[float, float]:
    """Acceleration along the way over a whole clip, m/s^2, and its standard deviation, NaN without errors: of the
    parabola in time through a path (T, 3), z up, along its level direction from first to last, by least squares.
    errors (T, 3): as of `series_kinematics`. NaN with fewer than four frames, or without a way."""
    known = np.flatnonzero(np.isfinite(xyz_m).all(axis=1))
    way = xyz_m[known[-1], :2] - xyz_m[known[0], :2] if len(known) >= MIN_POINTS else np.zeros(2)
    if not way.any():
        return np.nan, np.nan
    ahead = way / np.linalg.norm(way)
    along = [Errors(ahead[k] * e.sigma[known, k], e.correlation_s) for e in errors for k in range(2)]
    return parabola_acceleration(time_s[known], xyz_m[known, :2] @ ahead, along)


def parabola_acceleration(time_s: Array, values: Array, errors: Sequence[Errors]) -> tuple[float, float]:
    """The acceleration of the parabola in time through values (T,), by least squares, and its standard deviation, NaN
    without errors."""
    t = time_s - time_s.mean()
    shares = 2 * np.linalg.pinv(np.stack([np.ones(len(t)), t, t**2], axis=1))[2]
    variance = sum(_variance_of_sum(shares * e.sigma, t, e.correlation_s) for e in errors)
    return float(shares @ values), float(np.sqrt(variance)) if len(errors) else np.nan


def _variance_of_sum(sigma: Array, t: Array, lasts_s: float) -> float:
    """The variance of the sum of errors (T,), of which those of times further apart have nothing in common."""
    variance = sigma @ sigma
    for lag in range(1, len(t)):
        apart_s = t[lag:] - t[:-lag]
        if apart_s.min() > 9 * lasts_s:
            break
        variance += 2 * (sigma[lag:] * sigma[:-lag]) @ _correlation(apart_s, lasts_s)
    return max(float(variance), 0.0)


def speed_at_frames(time_s: Array, xyz_m: Array, smooth: bool = False) -> Array:
    """Speed (T,) in m/s of a path (T, 3) at its frames; smooth: by its jitter."""
    errors = jitter_errors(xyz_m) if smooth else ()
    return point_kinematics(time_s, xyz_m, errors, smooth=smooth, propagate=False, oversampling=1).speed_m_s


def joint_kinematics(pose: Pose3D, joint: str, fps: float, errors: Sequence[Errors] = (), **options) -> JointKinematics:
    """Motion of one joint of a pose; errors (T, J, 3) of all, metres. Raises InputError, ValueError."""
    (j,) = joint_index(pose, (joint,))
    of_joint = [error[:, j] for error in errors]
    return point_kinematics(frame_times(pose.frames, fps), pose.xyz_m[:, j], of_joint, **options)


def _norm(vector: Array, sigma: Array) -> tuple[Array, Array]:
    """Norms (N,) of vectors (N, d), and their standard deviations: sum((v_k / |v|)^2 sigma_k^2)."""
    norm = np.linalg.norm(vector, axis=1)
    # At rest the direction is unknown: the mean over the directions.
    share = np.divide(vector, norm[:, None], out=np.full_like(vector, vector.shape[1] ** -0.5), where=norm[:, None] > 0)
    return norm, np.sqrt(np.sum((share * sigma) ** 2, axis=1))


# -- angles ----------------------------------------------------------------------------------------------------------


def angle_between(a_m: Array, b_m: Array, c_m: Array) -> Array:
    """The angle (T,) at b between a and c, 0 to pi, from positions (T, 3); NaN where two of them coincide."""
    u, v = a_m - b_m, c_m - b_m
    # atan2 keeps its precision near 0 and pi, where arccos loses half the digits.
    angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.sum(u * v, axis=1))
    return np.where((np.linalg.norm(u, axis=1) > 0) & (np.linalg.norm(v, axis=1) > 0), angle, np.nan)


def sagittal_flexion(rear_m: Array, middle_m: Array, front_m: Array) -> Array:
    """Flexion (T,) of the back in the sagittal plane from positions (T, 3), z up: 0 when straight, rad in (-pi, pi].

    The sagittal plane is the vertical one through rear and front, so that roll is neglected. Positive: flexed, the back
    arched upwards, the middle above the line from rear to front; negative: extended, the back hollow. It is the
    inclination of rear -> middle less that of middle -> front.
    """
    ahead = (front_m - rear_m)[:, :2]
    length = np.linalg.norm(ahead, axis=1, keepdims=True)
    ahead = np.divide(ahead, length, out=np.full_like(ahead, np.nan), where=length > 0)
    links = (middle_m - rear_m, front_m - middle_m)
    rise = [np.arctan2(link[:, 2], np.sum(link[:, :2] * ahead, axis=1)) for link in links]
    return np.pi - np.mod(np.pi - (rise[0] - rise[1]), 2 * np.pi)


def angle_kinematics(time_s: Array, angle_rad: Array, errors: Sequence[Errors] = (), **options) -> AngleKinematics:
    """An angle (T,) over times (T,), errors (T,) in rad, jumps of 2 pi between known frames taken out; options as
    `series_kinematics`."""
    angle = np.array(angle_rad, float)
    known = np.isfinite(angle)
    angle[known] = np.unwrap(angle[known])
    series = series_kinematics(time_s, angle[:, None], [error[:, None] for error in errors], **options)
    value = series.value[np.isfinite(series.value)]
    low, high = (float(value.min()), float(value.max())) if len(value) else (np.nan, np.nan)
    return AngleKinematics(series, (low, high), _greatest(series.rate), _greatest(series.acceleration))


def _greatest(of: Array) -> float:
    known = np.abs(of[np.isfinite(of)])
    return float(known.max()) if len(known) else np.nan


def joint_angle(
    pose: Pose3D,
    joints: tuple[str, str, str],
    fps: float,
    errors: Sequence[Errors] = (),
    angle_of: Angle = angle_between,
    **options,
) -> AngleKinematics:
    """The angle at joints[1] between joints[0] and joints[2], 0 to pi, or another one of three joints. errors
    (T, J, 3), metres, of joints independent of each other. Raises InputError.

    An angle between 0 and pi turns round where the joint goes on through a straight line: its peaks are of the times at
    which it is two standard deviations or more away from there.
    """
    where = joint_index(pose, joints)
    points = pose.xyz_m[:, where]
    angle = angle_of(*np.moveaxis(points, 1, 0))
    of_angle = [Errors(angle_sigma(angle_of, points, e.sigma[:, where]), e.correlation_s) for e in errors]
    for error in of_angle:
        # Where the angle has no first derivative there is no linear deviation either.
        angle = np.where(np.isfinite(error.sigma) & (error.sigma > 0), angle, np.nan)
    found = angle_kinematics(frame_times(pose.frames, fps), angle, of_angle, **options)
    if angle_of is not angle_between or not errors:
        return found
    series = found.series
    bent = np.minimum(series.value, np.pi - series.value) >= STRAIGHT_SIGMAS * series.value_sigma
    peaks = _greatest(series.rate[bent]), _greatest(series.acceleration[bent])
    return replace(found, peak_rate_rad_s=peaks[0], peak_acceleration_rad_s2=peaks[1])


def spine_flexion(
    pose: Pose3D,
    fps: float,
    errors: Sequence[Errors] = (),
    joints: tuple[str, str, str] = ("tail_base", "spine", "neck_base"),
    **options,
) -> AngleKinematics:
    """Flexion of the back, positive when arched upwards (`sagittal_flexion`); joints: rear, middle, front."""
    return joint_angle(pose, joints, fps, errors, sagittal_flexion, **options)


def angle_sigma(angle_of: Angle, points_m: Array, sigma_m: Array) -> Array:
    """Linear standard deviation (T,) of an angle of three points (T, 3, 3), whose nine coordinates have sigma_m.

    The derivatives are central differences over a micrometre.
    """
    step, variance = 1e-6, np.zeros(len(points_m))
    for way in step * np.eye(9).reshape(9, 3, 3):
        ahead, behind = (angle_of(*np.moveaxis(points_m + one, 1, 0)) for one in (way, -way))
        change = np.mod(ahead - behind + np.pi, 2 * np.pi) - np.pi
        variance += (change / (2 * step) * sigma_m[:, way > 0][:, 0]) ** 2
    return np.sqrt(variance)
