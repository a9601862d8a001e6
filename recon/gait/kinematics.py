"""Compute the velocities and accelerations of joints, joint angles and their rates, each with standard deviations.

All derivatives are those of splines through the values of the frames (`recon.gait.series`).
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
"""Function of three points' positions, each (T, 3), that returns an angle (T,), rad."""
STRAIGHT_SIGMAS = 2.0
"""Deviation from straight, in standard deviations, below which a joint may be bent to either side."""


@dataclass(frozen=True, eq=False, repr=False)
class JointKinematics(Brief):
    """Motion of a point in the world frame, NaN if unknown."""

    series: Series
    """Position (m), velocity (m/s) and acceleration (m/s^2), each of shape (N, 3)."""
    speed_m_s: Array
    """Magnitude of the velocity, shape (N,)."""
    acceleration_m_s2: Array
    """Magnitude of the acceleration, shape (N,)."""
    speed_sigma_m_s: Array
    """Standard deviation of the speed by linear propagation, shape (N,); NaN without errors.

    Noise also raises the speed itself by about sigma^2 / speed; this bias is not subtracted.
    """
    acceleration_sigma_m_s2: Array
    """Standard deviation of `acceleration_m_s2`, shape (N,)."""
    distance_m: float
    """Length of the path over all known spans."""
    mean_speed_m_s: float
    """Mean speed over all known spans."""
    peak_speed_m_s: float
    peak_speed_sigma_m_s: float
    """Standard deviation of the peak speed; NaN without errors."""
    peak_speed_time_s: float
    peak_acceleration_m_s2: float
    peak_acceleration_sigma_m_s2: float
    """Standard deviation of the peak acceleration; NaN without errors."""

    @property
    def why_no_acceleration(self) -> str:
        """Return the sentence that figures show instead of an acceleration that is too uncertain.

        The sentence is empty if the acceleration is known well enough.
        """
        values, is_known = self.acceleration_m_s2, np.isfinite(self.acceleration_m_s2)
        if is_known.any() and np.mean(self.acceleration_sigma_m_s2[is_known] > values[is_known]) <= 0.5:
            return ""
        return "The instantaneous acceleration is not shown, because it is mostly smaller than its standard deviation."


@dataclass(frozen=True, eq=False, repr=False)
class AngleKinematics(Brief):
    """An angle over time, NaN if unknown."""

    series: Series
    """Angle (rad), rate (rad/s) and acceleration (rad/s^2), each of shape (N, 1)."""
    range_rad: tuple[float, float]
    """Smallest and largest angle."""
    peak_rate_rad_s: float
    """Largest absolute rate."""
    peak_acceleration_rad_s2: float
    """Largest absolute acceleration."""

    @property
    def range_of_motion_rad(self) -> float:
        """Return the difference between the largest and the smallest angle."""
        return self.range_rad[1] - self.range_rad[0]


_Kind = TypeVar("_Kind", Series, JointKinematics)


def at_frames(motion: _Kind) -> _Kind:
    """Return the motion at the frames only, which needs a tenth of the memory.

    Means and peaks remain those of all samples.
    """
    series = motion if isinstance(motion, Series) else motion.series
    changed = {
        name: values[:: series.oversampling].copy()
        for name, values in vars(motion).items()
        if isinstance(values, np.ndarray)
    }
    return replace(motion, **changed, **({"oversampling": 1} if motion is series else {"series": at_frames(series)}))


def frame_times(frames: Array | Index, fps: float) -> Array:
    """Return the times (T,) of frame numbers (T,), s; frame 0 is at 0 s.

    Raises
    ------
    ValueError
        If the frame rate is not positive.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"a positive frame rate is needed, got {fps}")
    return np.asarray(frames, float) / fps


def joint_index(pose: Pose3D, names: tuple[str, ...]) -> list[int]:
    """Return the indices of joints in a pose.

    Raises
    ------
    InputError
        If the pose lacks joints. The error names all of them.
    """
    lacking = [name for name in dict.fromkeys(names) if name not in pose.names]
    if lacking:
        source = pose.source or "pose"
        shown = ", ".join(pose.names)
        raise InputError([Problem(source, "joints", f"no '{name}'", f"one of {shown}") for name in lacking])
    return [pose.names.index(name) for name in names]


def point_kinematics(time_s: Array, xyz_m: Array, errors: Sequence[Errors] = (), **options) -> JointKinematics:
    """Return speed, acceleration and distance of a point's path.

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
    """Return speed, acceleration and distance of the reference joint from a path that includes velocities.

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
        Include the uncertainty of the animal's size.
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
    """Return values (T, ...) at times (T,) interpolated linearly at finer times (N,)."""
    flat = values.reshape(len(time_s), -1)
    columns = [np.interp(fine_s, time_s, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(fine_s), *values.shape[1:])


def _norm_of(vector: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the norms (N,) of vectors (N, d) with covariances (N, d, d), and their standard deviations."""
    norm = np.linalg.norm(vector, axis=1)
    unit = vector / np.maximum(norm, 1e-12)[:, None]
    return norm, np.sqrt(np.einsum("na,nab,nb->n", unit, covariance, unit))


def _kinematics_of(series: Series, speeds: tuple[Array, Array], accelerations: tuple[Array, Array]) -> JointKinematics:
    """Return a point's motion from its series, and from speeds and accelerations (N,) with standard deviations (N,)."""
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
    """Return the element of a quantity (N,) at the largest of values (N,); NaN if no value is known."""
    return float(quantity[np.nanargmax(values)]) if np.isfinite(values).any() else np.nan


def net_acceleration(time_s: Array, xyz_m: Array, errors: Sequence[Errors] = ()) -> tuple[float, float]:
    """Return the acceleration along the direction of travel over a whole clip and its standard deviation, m/s^2.

    A parabola in time is fitted by least squares to a path (T, 3), metres, z up, along the horizontal direction from
    the first to the last point. `errors` (T, 3) are as in `series_kinematics`; without errors the standard deviation is
    NaN. The result is NaN with fewer than four frames or without any travel.
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
    """Return the speed (T,) of a path (T, 3) at its frames, m/s; `smooth` smooths the path according to its jitter."""
    errors = jitter_errors(xyz_m) if smooth else ()
    return point_kinematics(time_s, xyz_m, errors, smooth=smooth, propagate=(), oversampling=1).speed_m_s


def joint_kinematics(pose: Pose3D, joint: str, fps: float, errors: Sequence[Errors] = (), **options) -> JointKinematics:
    """Return the motion of one joint of a pose.

    `errors` (T, J, 3) are those of all joints, metres; the options are those of `series_kinematics`.

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
    share = np.divide(vector, norm[:, None], out=np.full_like(vector, vector.shape[1] ** -0.5), where=norm[:, None] > 0)
    return norm, np.sqrt(np.sum((share * sigma) ** 2, axis=1))


def angle_between(a_m: Array, b_m: Array, c_m: Array) -> Array:
    """Return the angle (T,) at b between a and c, rad, 0 to pi, from positions (T, 3); NaN if b is at a or c."""
    u, v = a_m - b_m, c_m - b_m
    # atan2 keeps its precision near 0 and pi, where arccos loses half the digits.
    angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.sum(u * v, axis=1))
    return np.where((np.linalg.norm(u, axis=1) > 0) & (np.linalg.norm(v, axis=1) > 0), angle, np.nan)


def sagittal_flexion(rear_m: Array, middle_m: Array, front_m: Array) -> Array:
    """Return the flexion (T,) of the back in the sagittal plane, rad in (-pi, pi], 0 when straight.

    Positions (T, 3) have z up. The sagittal plane is the vertical plane through rear and front, so roll is neglected.
    Positive means flexed: the back is arched upwards, and the middle is above the line from rear to front. Negative
    means extended: the back is hollow. The flexion is the inclination of the line from rear to middle minus that of the
    line from middle to front.
    """
    forward = (front_m - rear_m)[:, :2]
    length = np.linalg.norm(forward, axis=1, keepdims=True)
    forward = np.divide(forward, length, out=np.full_like(forward, np.nan), where=length > 0)
    links = (middle_m - rear_m, front_m - middle_m)
    inclinations = [np.arctan2(link[:, 2], np.sum(link[:, :2] * forward, axis=1)) for link in links]
    return np.pi - np.mod(np.pi - (inclinations[0] - inclinations[1]), 2 * np.pi)


def angle_kinematics(time_s: Array, angle_rad: Array, errors: Sequence[Errors] = (), **options) -> AngleKinematics:
    """Return an angle (T,), rad, over times (T,), s, with its rate and acceleration.

    `errors` (T,) are in rad. Jumps of 2 pi between known frames are removed. Options are those of `series_kinematics`.
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
    """Return the angle at the second of three joints over time.

    The rate of an angle between 0 and pi changes its sign when the joint passes through a straight line. Peaks are
    therefore taken only at times at which the angle is at least two standard deviations from straight.

    Parameters
    ----------
    pose : Pose3D
        T frames of J joints.
    joints : tuple of str
        Three joints; the angle is at the second, 0 to pi.
    fps : float
        Frames per second.
    errors : sequence of Errors
        Errors of the positions, metres, with `sigma` of shape (T, J, 3), independent between joints.
    angle_of : callable
        Function of the three joints' positions (T, 3); `angle_between` by default.
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
    """Return the flexion of the back over time, positive when arched upwards (`sagittal_flexion`).

    `joints` are the rear, the middle and the front joint of the back.
    """
    return joint_angle(pose, joints, fps, errors, sagittal_flexion, **options)


def angle_sigma(angle_of: Angle, points_m: Array, sigma_m: Array) -> Array:
    """Return the standard deviation (T,), rad, of an angle of three points (T, 3, 3) by linear propagation.

    `sigma_m` (T, 3, 3) are the standard deviations of the coordinates. The derivatives with respect to the nine
    coordinates are central differences with a step of one micrometre.
    """
    step, variance = 1e-6, np.zeros(len(points_m))
    for shift_m in step * np.eye(9).reshape(9, 3, 3):
        forward, backward = (angle_of(*np.moveaxis(points_m + by_m, 1, 0)) for by_m in (shift_m, -shift_m))
        change = np.mod(forward - backward + np.pi, 2 * np.pi) - np.pi
        variance += (change / (2 * step) * sigma_m[:, shift_m > 0][:, 0]) ** 2
    return np.sqrt(variance)
