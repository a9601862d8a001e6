"""Compute the motion of links relative to their parents (vector field), phase portraits and the degree of closure.

For each link of a chain but the first, the vector field holds the position and velocity of the link's tip in the frame
of the preceding link, its parent. The origin of this frame is the joint between the two links. The x axis points along
the parent. The z axis is the horizontal direction across the travel, to the animal's right, made perpendicular to x.
The y axis is the cross product of z and x. If the parent points forwards, y is up; if the parent hangs down, y is
forwards. In polar form, the motion in the plane of x and y is

    r = |(x, y)|,   dr = (x dx + y dy) / r,   dtheta = (x dy - y dx) / r^2

so a rigid link in this plane has dr = 0 and the speed r |dtheta|. The frame turns with the parent, and (dx, dy, dz) are
the derivatives of the coordinates in this frame. The first link has no parent, and therefore no vector field (published
tables give zero for it).

The degree of closure of a path in phase space is D = 100 (1 - d / d_max), in percent. Here d is the distance between
the start and the end of the path, and d_max is the diameter of the path, the largest distance between any two of its
points. D is 100 for a path that ends at its start, and 0 for a path whose ends are as far apart as any two of its
points. The publication does not define d_max.

If the angles have standard deviations, so do the degrees of closure. They are computed from `RANDOM_PATHS` paths, which
are drawn at random from the errors of the angles. An error of the angle is sigma(t) z(t), with z smooth noise of unit
variance, and the error of the rate is proportional to z'. The ratio of the two standard deviations gives the time over
which z changes. The errors of start, end and turning points are therefore correlated realistically.

References
----------
C. van der Leek, MSc(Eng), University of Cape Town, 2022.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from recon.base.arrays import Array, Brief, mean
from recon.gait.kinematics import AngleKinematics, frame_times, joint_index
from recon.gait.series import series_kinematics
from recon.io.common import Pose3D

if TYPE_CHECKING:
    import pandas as pd

FORWARD = ("tail_base", "neck_base")
CHUNK_POINTS = 1000
RANDOM_PATHS = 100
"""Number of random paths from which the standard deviation of a degree of closure is computed."""
_WAVES = 50
"""Number of sine waves whose sum is the noise of a random path."""
_DIRECTIONS = 32
"""Number of directions in which the extent of a random path is measured to find its diameter."""


@dataclass(frozen=True, eq=False, repr=False)
class LinkField(Brief):
    """Motion of a link's tip in the frame of the preceding link, its parent, over T frames; NaN where unknown."""

    link: tuple[str, str]
    """Start and end joint of the link."""
    parent: tuple[str, str]
    """Start and end joint of the link's parent."""
    position_m: Array
    """Coordinates x, y, z of the tip, shape (T, 3)."""
    velocity_m_s: Array
    """Derivatives of x, y, z with respect to time, shape (T, 3)."""
    radius_m: Array
    """Distance of the tip from the link's start in the plane of x and y, shape (T,)."""
    dr_m_s: Array
    """Radial velocity of the link's tip, shape (T,)."""
    dtheta_rad_s: Array
    """Angular velocity of the link relative to its parent, shape (T,)."""
    speed_m_s: Array
    """Speed of the tip in the plane of x and y, the norm of (dr, r dtheta), shape (T,)."""
    dr_sigma_m_s: Array | float = np.nan
    """Standard deviation of `dr_m_s` (`field_with_sigma`), shape (T,); NaN if unknown."""
    dtheta_sigma_rad_s: Array | float = np.nan
    """Standard deviation of `dtheta_rad_s`, shape (T,); NaN if unknown."""
    speed_sigma_m_s: Array | float = np.nan
    """Standard deviation of `speed_m_s`, shape (T,); NaN if unknown."""


@dataclass(frozen=True)
class Closure:
    """Degrees of closure of a phase portrait, percent; NaN if the angle does not change."""

    angle: float
    """Degree of closure of the angle alone."""
    plane: float
    """Degree of closure in the plane of angle and rate, with both axes divided by their ranges."""
    angle_sigma: float = np.nan
    """Standard deviation of `angle`, NaN if unknown."""
    plane_sigma: float = np.nan
    """Standard deviation of `plane`, NaN if unknown."""
    unscaled: float = np.nan
    """Degree of closure in the plane of the angle, rad, and the rate, rad/s, without scaling, as published."""


@dataclass(frozen=True, eq=False, repr=False)
class Portrait(Brief):
    """Path of an angle and its rate in phase space, at N times."""

    time_s: Array
    """The times of the N samples, shape (N,)."""
    angle_rad: Array
    """The angle at the N times, shape (N,), NaN where it is unknown."""
    rate_rad_s: Array
    """The rate of the angle at the N times, shape (N,), NaN where it is unknown."""
    angle_sigma_rad: Array | float = np.nan
    """Standard deviation of the angle, shape (N,); NaN if unknown."""
    rate_sigma_rad_s: Array | float = np.nan
    """Standard deviation of the rate, shape (N,); NaN if unknown."""


def vector_field(time_s: Array, joints_m: Array, names: tuple[str, ...], forward_m: Array) -> tuple[LinkField, ...]:
    """Return the vector fields of a chain's links from the second on, J - 2 for J joints.

    Parameters
    ----------
    time_s : ndarray
        Times, s, shape (T,).
    joints_m : ndarray
        Positions of J >= 3 joints in the order of the chain, metres, shape (T, J, 3).
    names : tuple of str
        Names of the joints.
    forward_m : ndarray
        Any vector from rear to front, shape (T, 3); only its horizontal part is used.

    Raises
    ------
    ValueError
        If there are fewer than three joints, or the shapes differ.
    """
    if len(names) < 3 or joints_m.shape != (len(time_s), len(names), 3):
        raise ValueError(f"positions (T, J, 3) of at least three joints expected, got {joints_m.shape} of {len(names)}")
    along = np.moveaxis(tips(joints_m, forward_m), 1, 0)
    return tuple(_link_field(time_s, tip, (names[i], names[i + 1], names[i + 2])) for i, tip in enumerate(along))


def pose_vector_field(
    pose: Pose3D, chain: tuple[str, ...], fps: float, forward: tuple[str, str] = FORWARD
) -> tuple[LinkField, ...]:
    """Return the vector fields of the links from the second on, along a chain of joints.

    `chain` names the joints in order, such as (spine, tail_base, l_back_knee, l_back_ankle, l_back_paw). `forward`
    names a rear and a front joint, which define the direction of travel.

    Raises
    ------
    InputError
        If the pose lacks joints. The error names all missing joints.
    ValueError
        If the chain has fewer than three joints.
    """
    joint_rows, (rear, front) = joint_index(pose, (*chain, *forward))[: len(chain)], joint_index(pose, forward)
    forward_m = pose.xyz_m[:, front] - pose.xyz_m[:, rear]
    return vector_field(frame_times(pose.frames, fps), pose.xyz_m[:, joint_rows], chain, forward_m)


class FieldMeans(NamedTuple):
    """Mean velocities of a link's tip relative to its parent link, over the frames in which they are known.

    The means are NaN if there are no such frames.
    """

    link: str
    parent: str
    speed_m_s: float
    """Mean speed of the tip in the plane of x and y."""
    speed_3d_m_s: float
    """Mean speed of the tip in all three dimensions."""
    dr_m_s: float
    """Mean absolute radial velocity of the link's tip."""
    dtheta_rad_s: float
    """Mean absolute angular velocity of the link relative to its parent."""
    speed_sigma_m_s: float
    """Root mean square over the frames of the speed's standard deviation."""
    frames: int


def means_of_field(field: LinkField) -> FieldMeans:
    """Return the mean velocities of a link's tip over the frames in which they are known."""
    space = np.linalg.norm(field.velocity_m_s, axis=1)
    values = np.abs(np.stack([field.speed_m_s, space, field.dr_m_s, field.dtheta_rad_s]))
    is_known = np.isfinite(values).all(axis=0)
    speed, speed_3d, dr, dtheta = (mean(quantity[is_known]) for quantity in values)
    sigma = float(np.sqrt(mean(np.broadcast_to(field.speed_sigma_m_s, is_known.shape)[is_known] ** 2)))
    names = "-".join(field.link), "-".join(field.parent)
    return FieldMeans(*names, speed, speed_3d, dr, dtheta, sigma, int(is_known.sum()))


def field_means(fields: Sequence[LinkField]) -> pd.DataFrame:
    """Return a table of the mean velocities of each link's tip (`FieldMeans`), with a row for each link."""
    import pandas as pd  # slow to import

    return pd.DataFrame([means_of_field(field) for field in fields], columns=list(FieldMeans._fields))


def tips(joints_m: Array, forward_m: Array) -> Array:
    """Return the positions of the links' tips in their parents' frames, metres, shape (T, J - 2, 3).

    `joints_m` are the positions of the chain's joints, shape (T, J, 3). `forward_m` are vectors from rear to front,
    shape (T, 3).
    """
    right, result = _to_right(forward_m), []
    for parent, start, end in zip(*(np.moveaxis(joints_m, 1, 0)[i:] for i in range(3)), strict=False):
        result.append(np.einsum("tij,tj->ti", _parent_axes(start - parent, right), end - start))
    return np.stack(result, axis=1)


def tip_changes(joints_m: Array, forward_m: Array, moved_m: Array, forward_moved_m: Array) -> Array:
    """Return how much the x and y of the links' tips change if the joints move a little.

    Parameters
    ----------
    joints_m, forward_m : ndarray
        As in `tips`.
    moved_m : ndarray
        Changes of the joints' positions in each of K small motions, shape (T, J, 3, K).
    forward_moved_m : ndarray
        Changes of `forward_m`, shape (T, 3, K).

    Returns
    -------
    ndarray
        Changes of x and y, shape (T, J - 2, 2, K).
    """
    right, right_moved = _to_right(forward_m), _to_right(forward_moved_m)
    links_m, links_moved_m = np.diff(joints_m, axis=1), np.diff(moved_m, axis=1)
    changes = np.empty((len(joints_m), links_m.shape[1] - 1, 2, moved_m.shape[-1]))
    for i in range(links_m.shape[1] - 1):
        axes = _parent_axes(links_m[:, i], right)
        x, y, z = np.einsum("tij,tj->it", axes, links_m[:, i + 1])[..., None]
        along, _, across = np.einsum("tij,tj->it", axes, right)[..., None]
        parent, link = (np.einsum("tij,tjk->itk", axes, links_moved_m[:, part]) for part in (i, i + 1))
        turned = parent / np.linalg.norm(links_m[:, i], axis=1)[:, None]  # the x axis turns by this much to y and to z
        rolled = (along * turned[1] - np.einsum("tj,tjk->tk", axes[:, 1], right_moved)) / across
        changes[:, i, 0] = link[0] + y * turned[1] + z * turned[2]
        changes[:, i, 1] = link[1] - x * turned[1] + z * rolled
    return changes


def _to_right(forward_m: Array) -> Array:
    """Return the horizontal vectors (T, 3, ...), m, to the right of vectors (T, 3, ...) from rear to front."""
    return np.stack([forward_m[:, 1], -forward_m[:, 0], np.zeros_like(forward_m[:, 0])], axis=1)


def _parent_axes(parent_m: Array, right: Array) -> Array:
    """Return the axes x, y, z of the frame of a link (T, 3), m, in the rows of (T, 3, 3).

    `right` are vectors to the animal's right, shape (T, 3).
    """
    x_axis = _unit(parent_m)
    z_axis = _unit(right - np.sum(right * x_axis, axis=1, keepdims=True) * x_axis)
    return np.stack([x_axis, np.cross(z_axis, x_axis), z_axis], axis=1)


def field_with_sigma(field: LinkField, moved_m_s: Array) -> LinkField:
    """Return the vector field with standard deviations, which are propagated linearly.

    `moved_m_s` are the changes of the tip's dx and dy due to one standard deviation of each of K independent errors,
    shape (T, 2, K). The standard deviations are NaN if the tip does not move, or if its radius is 0.
    """
    (x, y), (dx, dy) = field.position_m[:, :2, None].swapaxes(0, 1), field.velocity_m_s[:, :2, None].swapaxes(0, 1)
    ex, ey = moved_m_s.swapaxes(0, 1)

    def sigma(change: Array, divisor: Array) -> Array:
        total = np.sqrt(np.sum(change**2, axis=1))
        return np.divide(total, divisor, out=np.full_like(total, np.nan), where=divisor > 0)

    return replace(
        field,
        dr_sigma_m_s=sigma(x * ex + y * ey, field.radius_m),
        dtheta_sigma_rad_s=sigma(x * ey - y * ex, field.radius_m**2),
        speed_sigma_m_s=sigma(dx * ex + dy * ey, field.speed_m_s),
    )


def _link_field(time_s: Array, tip_m: Array, names: tuple[str, str, str]) -> LinkField:
    series = series_kinematics(time_s, tip_m, oversampling=1)
    position, velocity = series.value, series.rate
    (x, y), (dx, dy) = position[:, :2].T, velocity[:, :2].T
    radius = np.hypot(x, y)
    is_known = radius > 0
    dr = np.divide(x * dx + y * dy, radius, out=np.full_like(radius, np.nan), where=is_known)
    dtheta = np.divide(x * dy - y * dx, radius**2, out=np.full_like(radius, np.nan), where=is_known)
    return LinkField(
        link=(names[1], names[2]),
        parent=(names[0], names[1]),
        position_m=position,
        velocity_m_s=velocity,
        radius_m=radius,
        dr_m_s=dr,
        dtheta_rad_s=dtheta,
        speed_m_s=np.hypot(dx, dy),
    )


def _unit(vectors: Array) -> Array:
    """Return the vectors (T, 3), metres, divided by their lengths; NaN for vectors shorter than a nanometre."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.full_like(vectors, np.nan), where=length > 1e-9)


def phase_portrait(angle: AngleKinematics, start_s: float = -np.inf, end_s: float = np.inf) -> Portrait:
    """Return the phase portrait of an angle between two times (s), which are included."""
    s = angle.series
    # The margin allows for rounding errors of the times.
    is_inside = (s.time_s >= start_s - 1e-9) & (s.time_s <= end_s + 1e-9)
    columns = (values[is_inside, 0] for values in (s.value, s.rate, s.value_sigma, s.rate_sigma))
    return Portrait(s.time_s[is_inside], *columns)


def closure(portrait: Portrait) -> Closure:
    """Return the degrees of closure of a phase portrait.

    Raises
    ------
    ValueError
        If there are fewer than two points, or if a point is unknown, because it may be a turning point of the path.
    """
    path = np.column_stack([portrait.angle_rad, portrait.rate_rad_s])
    if len(path) < 2 or not np.isfinite(path).all():
        raise ValueError("a closure needs a path of two points or more without gaps")
    degrees = degree_of_closure(path[:, :1]), degree_of_closure(scaled(path))
    return Closure(*degrees, *_closure_sigma(portrait), unscaled=degree_of_closure(path))


def _closure_sigma(portrait: Portrait) -> tuple[float, float]:
    """Return the standard deviations of the degrees of closure of the angle alone and in the plane, percent."""
    sums = np.sum(portrait.angle_sigma_rad), np.sum(portrait.rate_sigma_rad_s)
    if not sums[1] > 0:  # `not >` also catches NaN
        return np.nan, np.nan
    correlation_s = sums[0] / sums[1]
    # The angular frequencies give smooth noise with a correlation time of 1.
    turn_rates = np.array([NormalDist().inv_cdf((k + 0.5) / _WAVES) for k in range(_WAVES)])
    phase = np.outer(turn_rates, portrait.time_s / correlation_s)
    a, b = np.random.default_rng(0).normal(0, _WAVES**-0.5, (2, RANDOM_PATHS, _WAVES))
    noise = a @ np.cos(phase) + b @ np.sin(phase)
    change = (b * turn_rates) @ np.cos(phase) - (a * turn_rates) @ np.sin(phase)
    angle = portrait.angle_rad + portrait.angle_sigma_rad * noise
    rate = portrait.rate_rad_s + portrait.rate_sigma_rad_s * change
    angle_gap = np.abs(angle[:, -1] - angle[:, 0]) / np.ptp(angle, axis=1)
    plane = np.stack([values / np.ptp(values, axis=1, keepdims=True) for values in (angle, rate)], axis=2)
    directions_rad = np.linspace(0, np.pi, _DIRECTIONS, endpoint=False)
    extent = np.ptp(plane @ np.stack([np.cos(directions_rad), np.sin(directions_rad)]), axis=1).max(axis=1)
    plane_gap = np.linalg.norm(plane[:, -1] - plane[:, 0], axis=1) / extent
    return float(100 * angle_gap.std()), float(100 * plane_gap.std())


def degree_of_closure(path: Array) -> float:
    """Return the degree of closure D = 100 (1 - d / d_max) of a path (N, dim), percent; NaN if all points coincide."""
    extent = diameter(path)
    return float(100 * (1 - np.linalg.norm(path[-1] - path[0]) / extent)) if extent > 0 else np.nan


def scaled(path: Array) -> Array:
    """Return the path (N, dim) with each coordinate shifted and divided by its range, so that it is between 0 and 1."""
    span = np.ptp(path, axis=0)
    return np.divide(path - path.min(axis=0), span, out=np.zeros_like(path), where=span > 0)


def diameter(path: Array) -> float:
    """Return the largest distance between any two points of a path (N, dim)."""
    if path.shape[1] == 1:
        return float(np.ptp(path))
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    with suppress(QhullError):  # all points are on a line
        path = path[ConvexHull(path).vertices]  # the farthest two points are vertices of the hull
    rows = [path[i : i + CHUNK_POINTS] for i in range(0, len(path), CHUNK_POINTS)]
    return max(float(np.sqrt(np.sum((a[:, None] - b) ** 2, axis=2)).max()) for a in rows for b in rows)
