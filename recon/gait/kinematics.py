"""Compute the velocities and accelerations of joints, joint angles and their rates, each with standard deviations.

All derivatives are computed from splines through the values in the frames (`recon.gait.series`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from recon.base.arrays import Array, Bools, Brief, Index
from recon.base.errors import InputError, Problem
from recon.fit.result import ReferencePath
from recon.gait.series import (
    MAX_GAP_S,
    MIN_SMOOTHING_POINTS,
    OVERSAMPLING,
    Errors,
    Series,
    jitter_errors,
    parabola_acceleration,
    series_kinematics,
    spans_of,
)
from recon.gait.spline import MIN_POINTS
from recon.io.common import Pose3D

Angle = Callable[[Array, Array, Array], Array]
"""Function that returns an angle in each frame, rad, shape (T,), from the positions of three points, each (T, 3)."""
STRAIGHT_SIGMAS = 2.0
"""Minimum deviation of a joint from straight, in standard deviations, at which the side of its bend is known."""


@dataclass(frozen=True, eq=False, repr=False)
class JointKinematics(Brief):
    """Motion of a point in the world frame at N times; NaN at times without a known position."""

    series: Series
    """Position (m), velocity (m/s) and acceleration (m/s^2), each of shape (N, 3)."""
    speed_m_s: Array
    """Magnitude of the velocity, shape (N,)."""
    acceleration_m_s2: Array
    """Magnitude of the acceleration, shape (N,)."""
    speed_sigma_m_s: Array
    """Standard deviation of the speed by linear propagation, shape (N,); NaN without errors.

    Noise also raises the speed itself by about sigma^2 / speed. This bias is not subtracted.
    """
    acceleration_sigma_m_s2: Array
    """Standard deviation of `acceleration_m_s2`, shape (N,)."""
    distance_m: float
    """Length of the path over all spans in which the position is known."""
    mean_speed_m_s: float
    """Mean speed over all spans in which the position is known."""
    peak_speed_m_s: float
    peak_speed_sigma_m_s: float
    """Standard deviation of the peak speed; NaN without errors."""
    peak_speed_time_s: float
    peak_acceleration_m_s2: float
    peak_acceleration_sigma_m_s2: float
    """Standard deviation of the peak acceleration; NaN without errors."""

    @property
    def why_no_acceleration(self) -> str:
        """Return a sentence that figures show instead of an acceleration that is too uncertain.

        Return an empty string if the acceleration is certain enough to be shown.
        """
        values, is_known = self.acceleration_m_s2, np.isfinite(self.acceleration_m_s2)
        if is_known.any() and np.mean(self.acceleration_sigma_m_s2[is_known] > values[is_known]) <= 0.5:
            return ""
        return "The instantaneous acceleration is not shown, because it is mostly smaller than its standard deviation."


@dataclass(frozen=True, eq=False, repr=False)
class AngleKinematics(Brief):
    """An angle at N times; NaN at times at which the angle is unknown."""

    series: Series
    """Angle (rad), rate (rad/s) and acceleration (rad/s^2), each of shape (N, 1)."""
    range_rad: tuple[float, float]
    """Smallest and largest angle in the clip."""
    peak_rate_rad_s: float
    """Largest absolute rate in the clip."""
    peak_acceleration_rad_s2: float
    """Largest absolute angular acceleration in the clip."""

    @property
    def range_of_motion_rad(self) -> float:
        """Return the difference between the largest and the smallest angle."""
        return self.range_rad[1] - self.range_rad[0]


_Kind = TypeVar("_Kind", Series, JointKinematics)


def at_frames(motion: _Kind) -> _Kind:
    """Return the motion without the samples between frames, which saves nine tenths of the memory.

    Means and peaks are still computed from all samples.
    """
    series = motion if isinstance(motion, Series) else motion.series
    changed = {
        name: values[:: series.oversampling].copy()
        for name, values in vars(motion).items()
        if isinstance(values, np.ndarray)
    }
    return replace(motion, **changed, **({"oversampling": 1} if motion is series else {"series": at_frames(series)}))


def frame_times(frames: Array | Index, fps: float) -> Array:
    """Return the time of each frame, s, shape (T,); frame 0 is at 0 s.

    `frames` are the frame numbers, shape (T,).

    Raises
    ------
    ValueError
        If the frame rate is not positive.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"a positive frame rate is needed, got {fps}")
    return np.asarray(frames, float) / fps


def joint_index(pose: Pose3D, names: tuple[str, ...]) -> list[int]:
    """Return the indices of the named joints in a pose.

    Raises
    ------
    InputError
        If the pose lacks joints. The error names all missing joints.
    """
    lacking = [name for name in dict.fromkeys(names) if name not in pose.names]
    if lacking:
        source = pose.source or "pose"
        shown = ", ".join(pose.names)
        raise InputError([Problem(source, "joints", f"no '{name}'", f"one of {shown}") for name in lacking])
    return [pose.names.index(name) for name in names]


def point_kinematics(time_s: Array, xyz_m: Array, errors: Sequence[Errors] = (), **options) -> JointKinematics:
    """Return the speed, acceleration and distance travelled of a point, given its positions.

    Parameters
    ----------
    time_s : ndarray
        Increasing times, s, shape (T,).
    xyz_m : ndarray
        Positions, metres, shape (T, 3); NaN for missing frames.
    errors : sequence of Errors
        Independent errors of the positions, with `sigma` of shape (T, 3).
    **options
        As in `series_kinematics`.
    """
    series = series_kinematics(time_s, xyz_m, errors, **options)
    return _kinematics_of(
        series, _norm(series.rate, series.rate_sigma), _norm(series.acceleration, series.acceleration_sigma)
    )


def path_kinematics(
    time_s: Array, path: ReferencePath, is_known: Bools, with_size: bool = True, oversampling: int = OVERSAMPLING
) -> JointKinematics:
    """Return the speed, acceleration and distance travelled of the reference joint, given its positions and velocities.

    Between two frames, the path is the polynomial of degree five that has their positions, velocities and
    accelerations.

    Parameters
    ----------
    time_s : ndarray
        Increasing times, s, shape (T,).
    path : ReferencePath
        The path at these times.
    is_known : ndarray
        Frames with a pose, shape (T,). The result is NaN before the first, after the last and in long gaps.
    with_size : bool
        Whether the standard deviations include the uncertainty of the animal's size.
    oversampling : int
        Samples per frame.
    """
    from scipy.interpolate import BPoly  # slow to import

    T = len(time_s)
    fine_s = np.interp(np.arange((T - 1) * oversampling + 1) / oversampling, np.arange(T), time_s)
    state = np.stack([path.position_m, path.velocity_m_s, path.acceleration_m_s2], axis=1)
    curve = BPoly.from_derivatives(time_s, state)
    curves = np.stack([curve(fine_s), curve(fine_s, 1), curve(fine_s, 2)])
    by_size = state - np.stack([np.broadcast_to(path.centre_m, (T, 3)), *np.zeros((2, T, 3))], axis=1)
    by_size = path.size_sigma * with_size * by_size
    blocks = path.covariance.reshape(T, 3, 3, 3, 3)[:, [0, 1, 2], :, [0, 1, 2]]
    covariance = blocks + np.einsum("tka,tkb->ktab", by_size, by_size)
    fine = _between(time_s, covariance.swapaxes(0, 1), fine_s).swapaxes(0, 1)
    known = np.zeros(len(fine_s), bool)
    for rows in spans_of(time_s, np.where(is_known, 0.0, np.nan)[:, None], MAX_GAP_S, MIN_SMOOTHING_POINTS):
        known[rows[0] * oversampling : rows[-1] * oversampling + 1] = True
    curves[:, ~known], fine[:, ~known] = np.nan, np.nan
    sigmas = np.sqrt(np.diagonal(fine, axis1=2, axis2=3))
    series = Series(fine_s, *curves, *sigmas, oversampling=oversampling)
    return _kinematics_of(series, *(_norm_of(vector, C) for vector, C in zip(curves[1:], fine[1:], strict=True)))


def _between(time_s: Array, values: Array, fine_s: Array) -> Array:
    """Return the linear interpolation at the times `fine_s` (N,) of values (T, ...) at the times `time_s` (T,)."""
    flat = values.reshape(len(time_s), -1)
    columns = [np.interp(fine_s, time_s, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(fine_s), *values.shape[1:])


def _norm_of(vector: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the norms (N,) of vectors (N, d) with covariances (N, d, d), and their standard deviations."""
    norm = np.linalg.norm(vector, axis=1)
    unit = vector / np.maximum(norm, 1e-12)[:, None]
    return norm, np.sqrt(np.einsum("na,nab,nb->n", unit, covariance, unit))


def _kinematics_of(series: Series, speeds: tuple[Array, Array], accelerations: tuple[Array, Array]) -> JointKinematics:
    """Return the motion of a point, given its series, and its speeds and accelerations with their standard deviations.

    All four arrays have the shape (N,).
    """
    (speed, speed_sigma), (acceleration, acceleration_sigma) = speeds, accelerations
    steps_m = np.linalg.norm(np.diff(series.value, axis=0), axis=1)
    is_known = np.isfinite(steps_m)
    distance, covered = float(steps_m[is_known].sum()), float(np.diff(series.time_s)[is_known].sum())
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


def _at_peak(values: Array, quantity: Array) -> float:
    """Return the element of `quantity` (N,) at the peak of `values` (N,); NaN if no value is known."""
    return float(quantity[np.nanargmax(values)]) if np.isfinite(values).any() else np.nan


def net_acceleration(time_s: Array, xyz_m: Array, errors: Sequence[Errors] = ()) -> tuple[float, float]:
    """Return the mean acceleration of a point along its direction of travel and its standard deviation, m/s^2.

    The acceleration comes from a parabola in time, fitted by least squares to the horizontal positions along the line
    from the first to the last point. Return NaN for fewer than four frames, or if the point does not travel.

    Parameters
    ----------
    time_s : ndarray
        Times, s, shape (T,).
    xyz_m : ndarray
        Positions, metres, z up, shape (T, 3).
    errors : sequence of Errors
        Independent errors of the positions, with `sigma` of shape (T, 3). Without errors, the standard deviation is
        NaN.
    """
    known_rows = np.flatnonzero(np.isfinite(xyz_m).all(axis=1))
    travel_m = xyz_m[known_rows[-1], :2] - xyz_m[known_rows[0], :2] if len(known_rows) >= MIN_POINTS else np.zeros(2)
    if not travel_m.any():
        return np.nan, np.nan
    direction = travel_m / np.linalg.norm(travel_m)
    errors_along = [
        Errors(direction[k] * error.sigma[known_rows, k], error.correlation_s) for error in errors for k in range(2)
    ]
    return parabola_acceleration(time_s[known_rows], xyz_m[known_rows, :2] @ direction, errors_along)


def speed_at_frames(time_s: Array, xyz_m: Array, smooth: bool = False) -> Array:
    """Return the speed of a point in each frame, m/s, shape (T,), given its positions (T, 3), metres.

    If `smooth` is true, the positions are first smoothed according to their jitter.
    """
    errors = jitter_errors(xyz_m) if smooth else ()
    return point_kinematics(time_s, xyz_m, errors, smooth=smooth, propagate=(), oversampling=1).speed_m_s


def joint_kinematics(pose: Pose3D, joint: str, fps: float, errors: Sequence[Errors] = (), **options) -> JointKinematics:
    """Return the speed, acceleration and distance travelled of one joint of a pose.

    `errors` are the independent errors of all joints' positions, each (T, J, 3), metres. `options` are passed to
    `series_kinematics`.

    Raises
    ------
    InputError
        If the pose lacks the joint.
    """
    (j,) = joint_index(pose, (joint,))
    joint_errors = [error[:, j] for error in errors]
    return point_kinematics(frame_times(pose.frames, fps), pose.xyz_m[:, j], joint_errors, **options)


def _norm(vector: Array, sigma: Array) -> tuple[Array, Array]:
    """Return the norms (N,) of vectors (N, d) and their standard deviations, sqrt(sum((v_k / |v|)^2 sigma_k^2))."""
    norm = np.linalg.norm(vector, axis=1)
    # At rest the direction is unknown, so the mean over all directions is used.
    fraction = np.divide(
        vector, norm[:, None], out=np.full_like(vector, vector.shape[1] ** -0.5), where=norm[:, None] > 0
    )
    return norm, np.sqrt(np.sum((fraction * sigma) ** 2, axis=1))


def angle_between(a_m: Array, b_m: Array, c_m: Array) -> Array:
    """Return the angle (0 to pi) at the point b between the points a and c in each frame, shape (T,), rad.

    The positions have the shape (T, 3). The angle is NaN where b coincides with a or c.
    """
    u, v = a_m - b_m, c_m - b_m
    # atan2 keeps its precision near 0 and pi, where arccos loses half the digits.
    angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.sum(u * v, axis=1))
    return np.where((np.linalg.norm(u, axis=1) > 0) & (np.linalg.norm(v, axis=1) > 0), angle, np.nan)


def sagittal_flexion(rear_m: Array, middle_m: Array, front_m: Array) -> Array:
    """Return the flexion of the back in the sagittal plane in each frame, shape (T,), rad in (-pi, pi].

    The flexion is the inclination of the line from rear to middle, minus the inclination of the line from middle to
    front. It is 0 for a straight back, positive for a back that is arched upwards, and negative for a hollow back. The
    sagittal plane is taken as the vertical plane through rear and front, so roll is neglected. The positions have the
    shape (T, 3), with z up.
    """
    forward = (front_m - rear_m)[:, :2]
    length = np.linalg.norm(forward, axis=1, keepdims=True)
    forward = np.divide(forward, length, out=np.full_like(forward, np.nan), where=length > 0)
    links = (middle_m - rear_m, front_m - middle_m)
    inclinations = [np.arctan2(link[:, 2], np.sum(link[:, :2] * forward, axis=1)) for link in links]
    return np.pi - np.mod(np.pi - (inclinations[0] - inclinations[1]), 2 * np.pi)


def angle_kinematics(time_s: Array, angle_rad: Array, errors: Sequence[Errors] = (), **options) -> AngleKinematics:
    """Return an angle over time with its rate and acceleration.

    Jumps of 2 pi between known frames are removed.

    Parameters
    ----------
    time_s : ndarray
        Increasing times, s, shape (T,).
    angle_rad : ndarray
        The angle, rad, shape (T,); NaN where unknown.
    errors : sequence of Errors
        Independent errors of the angle (rad) with `sigma` of shape (T,).
    **options
        As in `series_kinematics`.
    """
    angle = np.array(angle_rad, float)
    is_known = np.isfinite(angle)
    angle[is_known] = np.unwrap(angle[is_known])
    series = series_kinematics(time_s, angle[:, None], [error[:, None] for error in errors], **options)
    value = series.value[np.isfinite(series.value)]
    low, high = (float(value.min()), float(value.max())) if len(value) else (np.nan, np.nan)
    return AngleKinematics(series, (low, high), _greatest(series.rate), _greatest(series.acceleration))


def _greatest(values: Array) -> float:
    magnitudes = np.abs(values[np.isfinite(values)])
    return float(magnitudes.max()) if len(magnitudes) else np.nan


def joint_angle(
    pose: Pose3D,
    joints: tuple[str, str, str],
    fps: float,
    errors: Sequence[Errors] = (),
    angle_of: Angle = angle_between,
    **options,
) -> AngleKinematics:
    """Return the angle at the second of three joints over time, with its rate and acceleration.

    The rate of an angle between 0 and pi (`angle_between`) changes sign when the joint passes through straight. With
    errors, its peaks are therefore taken only at times at which the angle is at least `STRAIGHT_SIGMAS` standard
    deviations from straight.

    Parameters
    ----------
    pose : Pose3D
        T frames of J joints.
    joints : tuple of str
        Names of the three joints, of which the second has the angle.
    fps : float
        Frames per second.
    errors : sequence of Errors
        Errors of the positions, metres, with `sigma` of shape (T, J, 3), independent between joints.
    angle_of : callable
        Function that returns the angle (T,), rad, from the three joints' positions (T, 3); by default `angle_between`.
    **options
        As in `series_kinematics`.

    Raises
    ------
    InputError
        If the pose lacks a joint.
    """
    joint_rows = joint_index(pose, joints)
    points = pose.xyz_m[:, joint_rows]
    angle = angle_of(*np.moveaxis(points, 1, 0))
    angle_errors = [
        Errors(angle_sigma(angle_of, points, error.sigma[:, joint_rows]), error.correlation_s) for error in errors
    ]
    for stated in angle_errors:
        # At a nearly straight joint the angle cannot be differentiated, so its linearised sigma is unknown.
        angle = np.where(np.isfinite(stated.sigma) & (stated.sigma > 0), angle, np.nan)
    result = angle_kinematics(frame_times(pose.frames, fps), angle, angle_errors, **options)
    if angle_of is not angle_between or not errors:
        return result
    series = result.series
    is_bent = np.minimum(series.value, np.pi - series.value) >= STRAIGHT_SIGMAS * series.value_sigma
    peaks = _greatest(series.rate[is_bent]), _greatest(series.acceleration[is_bent])
    return replace(result, peak_rate_rad_s=peaks[0], peak_acceleration_rad_s2=peaks[1])


def spine_flexion(
    pose: Pose3D,
    fps: float,
    errors: Sequence[Errors] = (),
    joints: tuple[str, str, str] = ("tail_base", "spine", "neck_base"),
    **options,
) -> AngleKinematics:
    """Return the flexion of the back over time, positive for a back that is arched upwards (`sagittal_flexion`).

    `joints` are the names of the rear, the middle and the front joint of the back. The other parameters are as in
    `joint_angle`.
    """
    return joint_angle(pose, joints, fps, errors, sagittal_flexion, **options)


def angle_sigma(angle_of: Angle, points_m: Array, sigma_m: Array) -> Array:
    """Return the standard deviation of an angle of three points in each frame, shape (T,), rad.

    The positions of the points and their standard deviations have the shape (T, 3, 3), metres. The propagation is
    linear, with central differences over one micrometre as derivatives.
    """
    step, variance = 1e-6, np.zeros(len(points_m))
    for shift_m in step * np.eye(9).reshape(9, 3, 3):
        forward, backward = (angle_of(*np.moveaxis(points_m + by_m, 1, 0)) for by_m in (shift_m, -shift_m))
        change = np.mod(forward - backward + np.pi, 2 * np.pi) - np.pi
        variance += (change / (2 * step) * sigma_m[:, shift_m > 0][:, 0]) ** 2
    return np.sqrt(variance)
