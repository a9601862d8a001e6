"""Links' motion relative to their parents (vector field), phase portraits and the degree of closure.

Vector field of a chain of joints: for each link but the first, its tip's position and velocity in the frame of the link
before it. That frame's origin is the joint between the two, x along the parent, z to the animal's right, normal to x
(the part of the level direction across the travel that is), y = z x x. For a parent that runs forwards y is up, for one
that hangs down it is forwards. In the plane of x and y, in polar form,

    r = |(x, y)|,   dr = (x dx + y dy) / r,   dtheta = (x dy - y dx) / r^2

so that a rigid link in the plane has dr = 0 and moves with r |dtheta|. What leaves the plane is `z`. The frame turns
with the parent: (dx, dy, dz) are the derivatives of the coordinates. The first link is the reference of the second and
has no motion of its own (zero by definition in published tables).

Degree of closure of a path in phase space, D = 100 (1 - d / d_max) in percent: d is the distance between the path's
start and its end, d_max its diameter, the largest distance between any two of its points. A path that ends where it
began has 100, one that ends as far away as it ever gets 0. Source: C. van der Leek, MSc(Eng), University of Cape Town,
2022, which leaves d_max open.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from recon.analysis.kinematics import AngleKinematics, frame_times, joint_index, series_kinematics
from recon.arrays import Array
from recon.io.pose3d import Pose3D

FORWARD = ("tail_base", "neck_base")
CHUNK = 1000


@dataclass(frozen=True, eq=False)
class LinkField:
    """One link's tip in its parent's frame, at the T frames, NaN where unknown.

    link, parent: (start, end) joints. position_m, velocity_m_s (T, 3): x, y, z; radius_m, dr_m_s, dtheta_rad_s (T,):
    polar, in the plane of x and y; speed_m_s (T,): in that plane, the norm of (dr, r dtheta).
    """

    link: tuple[str, str]
    parent: tuple[str, str]
    position_m: Array
    velocity_m_s: Array
    radius_m: Array
    dr_m_s: Array
    dtheta_rad_s: Array
    speed_m_s: Array


@dataclass(frozen=True)
class LinkMeans:
    """Means over a link's known frames: of the speed in the plane, of the speed in space, of |dr| and of |dtheta|; NaN
    without any. frames: their number."""

    link: tuple[str, str]
    parent: tuple[str, str]
    speed_m_s: float
    speed_3d_m_s: float
    dr_m_s: float
    dtheta_rad_s: float
    frames: int


@dataclass(frozen=True)
class Closure:
    """Degrees of closure in percent. angle: of the angle alone; plane: in the (angle, rate) plane, both axes divided by
    their ranges. NaN for a path that does not move."""

    angle: float
    plane: float


@dataclass(frozen=True, eq=False)
class Portrait:
    """A path in phase space: time_s, angle_rad, rate_rad_s, all (N,), NaN where unknown."""

    time_s: Array
    angle_rad: Array
    rate_rad_s: Array


# -- vector field ----------------------------------------------------------------------------------------------------


def vector_field(time_s: Array, joints_m: Array, names: tuple[str, ...], forward_m: Array) -> tuple[LinkField, ...]:
    """Fields of the links of a chain of J >= 3 joints (T, J, 3) in order, J - 2 links; forward_m (T, 3): any vector
    from rear to front (its horizontal part counts). Raises ValueError."""
    if len(names) < 3 or joints_m.shape != (len(time_s), len(names), 3):
        raise ValueError(f"positions (T, J, 3) of at least three joints expected, got {joints_m.shape} of {len(names)}")
    right = np.stack([forward_m[:, 1], -forward_m[:, 0], np.zeros(len(time_s))], axis=1)
    return tuple(
        _link_field(time_s, joints_m[:, i : i + 3], (names[i], names[i + 1], names[i + 2]), right)
        for i in range(len(names) - 2)
    )


def pose_vector_field(
    pose: Pose3D, chain: tuple[str, ...], fps: float, forward: tuple[str, str] = FORWARD
) -> tuple[LinkField, ...]:
    """The field of a chain of a pose's joints, as (spine, tail_base, l_back_knee, l_back_ankle, l_back_paw); forward:
    two joints, from rear to front. Raises InputError with every joint that the pose lacks, ValueError."""
    where, (rear, front) = joint_index(pose, (*chain, *forward))[: len(chain)], joint_index(pose, forward)
    ahead = pose.xyz_m[:, front] - pose.xyz_m[:, rear]
    return vector_field(frame_times(pose.frames, fps), pose.xyz_m[:, where], chain, ahead)


def field_means(fields: tuple[LinkField, ...]) -> tuple[LinkMeans, ...]:
    """The table of mean magnitudes, one row per link."""
    rows = []
    for field in fields:
        space = np.linalg.norm(field.velocity_m_s, axis=1)
        values = np.abs(np.stack([field.speed_m_s, space, field.dr_m_s, field.dtheta_rad_s]))
        known = np.isfinite(values).all(axis=0)
        speed, speed_3d, dr, dtheta = values[:, known].mean(axis=1) if known.any() else np.full(4, np.nan)
        n = int(known.sum())
        rows.append(LinkMeans(field.link, field.parent, float(speed), float(speed_3d), float(dr), float(dtheta), n))
    return tuple(rows)


def _link_field(time_s: Array, joints_m: Array, names: tuple[str, str, str], right: Array) -> LinkField:
    x_axis = _unit(joints_m[:, 1] - joints_m[:, 0])
    z_axis = _unit(right - np.sum(right * x_axis, axis=1, keepdims=True) * x_axis)
    axes = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis], axis=1)
    tip = np.einsum("tij,tj->ti", axes, joints_m[:, 2] - joints_m[:, 1])
    series = series_kinematics(time_s, tip, oversampling=1)
    position, velocity = series.value, series.rate
    (x, y), (dx, dy) = position[:, :2].T, velocity[:, :2].T
    radius = np.hypot(x, y)
    known = radius > 0
    dr = np.divide(x * dx + y * dy, radius, out=np.full_like(radius, np.nan), where=known)
    dtheta = np.divide(x * dy - y * dx, radius**2, out=np.full_like(radius, np.nan), where=known)
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
    """Unit vectors (T, 3), NaN for those shorter than a nanometre (a parent that points exactly across, say)."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.full_like(vectors, np.nan), where=length > 1e-9)


# -- phase space -----------------------------------------------------------------------------------------------------


def phase_portrait(angle: AngleKinematics) -> Portrait:
    """The path of (angle, rate), on the fine grid of `angle`."""
    return Portrait(angle.series.time_s, angle.series.value[:, 0], angle.series.rate[:, 0])


def portrait_between(portrait: Portrait, start_s: float, end_s: float) -> Portrait:
    """The part of a path between two times, both inclusive, as a stride's start and end."""
    # The times of a grid carry rounding errors.
    inside = (portrait.time_s >= start_s - 1e-9) & (portrait.time_s <= end_s + 1e-9)
    return Portrait(portrait.time_s[inside], portrait.angle_rad[inside], portrait.rate_rad_s[inside])


def closure(portrait: Portrait) -> Closure:
    """Degrees of closure of a path, from its first to its last point. Raises ValueError if a point in it is unknown or
    it has fewer than two: what is missing may have been the turning point."""
    path = np.column_stack([portrait.angle_rad, portrait.rate_rad_s])
    if len(path) < 2 or not np.isfinite(path).all():
        raise ValueError("a closure needs a path of two points or more without gaps")
    return Closure(degree_of_closure(path[:, :1]), degree_of_closure(scaled(path)))


def degree_of_closure(path: Array) -> float:
    """D = 100 (1 - d / d_max) of a path (N, d) as it stands, in percent; NaN if all points coincide."""
    extent = diameter(path)
    return float(100 * (1 - np.linalg.norm(path[-1] - path[0]) / extent)) if extent > 0 else np.nan


def scaled(path: Array) -> Array:
    """The path (N, d) with each axis divided by its range; an axis without range becomes 0."""
    span = np.ptp(path, axis=0)
    return np.divide(path - path.min(axis=0), span, out=np.zeros_like(path), where=span > 0)


def diameter(path: Array) -> float:
    """Largest distance between any two points of a path (N, d)."""
    if path.shape[1] == 1:
        return float(np.ptp(path))
    with suppress(QhullError):  # flat
        path = path[ConvexHull(path).vertices]  # two of its corners are the farthest from each other
    rows = [path[i : i + CHUNK] for i in range(0, len(path), CHUNK)]
    return max(float(np.sqrt(np.sum((a[:, None] - b) ** 2, axis=2)).max()) for a in rows for b in rows)
