"""Chains from Denavit-Hartenberg parameters, in both conventions, for `recon.robotics.ik`.

modified (Craig):  T_{i-1, i} = Rx(alpha_{i-1}) Tx(a_{i-1}) Rz(theta_i) Tz(d_i)
standard:          T_{i-1, i} = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)

A joint that turns adds q to theta, one that slides to d. A row of the modified convention holds a and alpha of the link
before the joint, of the standard one those of the link after it, as the tables in print do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, StrictBool
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array
from recon.robotics.ik.chain import SerialChain, joint_chain
from recon.robotics.robot.leg import Length, Limits

Convention = Literal["modified", "standard"]
_PARALLEL = 1e-9
"""Sine of the angle between axes."""


@dataclass(frozen=True)
class DHRow:
    """One link of a table of Denavit and Hartenberg."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    a_m: Length = 0.0
    """The length of the link."""
    alpha_rad: Length = 0.0
    """The twist of the link."""
    d_m: Length = 0.0
    """The offset along the joint's axis, with q = 0."""
    theta_rad: Length = 0.0
    """The angle about the joint's axis, with q = 0."""
    slides: StrictBool = False
    """q adds to d, not to theta."""
    limits: Limits | None = None
    """The limits of q."""


def dh_chain(rows: Sequence[DHRow], convention: Convention) -> SerialChain:
    """The chain of the rows from the base. Raises ValueError."""
    if convention not in ("modified", "standard") or not rows:
        raise ValueError(f"rows and the convention, modified or standard, expected, got {len(rows)}, {convention!r}")
    link = [_along("x", row.a_m, row.alpha_rad) for row in rows]
    joint = [_along("z", row.d_m, row.theta_rad) for row in rows]
    nothing = RigidTransform.identity()
    before, tool = (link, nothing) if convention == "modified" else ([nothing, *link[:-1]], link[-1])
    placed = [a * b for a, b in zip(before, joint, strict=True)]
    lower, upper = np.transpose([row.limits or (-np.inf, np.inf) for row in rows])
    return joint_chain(
        np.array([t.translation for t in placed]),
        np.tile([0.0, 0.0, 1.0], (len(rows), 1)),
        Rotation.concatenate([t.rotation for t in placed]),
        [row.slides for row in rows],
        tool.translation,
        tool.rotation,
        (lower, upper),
    )


def dh_table(chain: SerialChain) -> tuple[RigidTransform, tuple[DHRow, ...], RigidTransform]:
    """Any chain as base * rows * tool, the rows modified (Craig) with a_m and alpha_rad 0 in the first: base and tool
    are what the parameters leave out. z goes along each joint's axis, x along the common normal to the next; where axes
    are parallel, through the origin before."""
    zero = np.zeros(chain.n)
    axes, places = chain.joint_axes(zero), chain.positions(zero)
    end = _transform(*chain.pose(zero))
    frames, x = [], _across(axes[0])
    for j, z in enumerate(axes):
        if j + 1 == chain.n:
            origin, normal = (places[j] if j == 0 else _nearest_on_axis(places[j], z, frames[-1].translation)), x
        else:
            origin, normal = _common_normal(places[j], z, places[j + 1], axes[j + 1], frames)
        # The same x as before where the normal leaves it open: theta is 0 then.
        x = normal if normal is not None else x
        x = x - (x @ z) * z
        size = float(np.linalg.norm(x))
        x = x / size if size > 1e-6 else _across(z)
        frames.append(_transform(np.column_stack([x, np.cross(z, x), z]), origin))
    steps = [a.inv() * b for a, b in pairwise(frames)]
    rows = [DHRow(slides=bool(chain.sliding[0])), *map(_row, steps, chain.sliding[1:])]
    return frames[0], tuple(rows), frames[-1].inv() * end


def _row(step: RigidTransform, slides: bool) -> DHRow:
    """Rx(alpha) Tx(a) Rz(theta) Tz(d), read off its matrix."""
    T = step.as_matrix()
    alpha = np.arctan2(-T[1, 2], T[2, 2])
    d = -np.sin(alpha) * T[1, 3] + np.cos(alpha) * T[2, 3]
    theta = np.arctan2(-T[0, 1], T[0, 0])
    return DHRow(float(T[0, 3]), float(alpha), float(d), float(theta), bool(slides))


def _transform(R: Any, p: Array) -> RigidTransform:
    return RigidTransform.from_components(p, Rotation.from_matrix(R))


def _nearest_on_axis(place: Array, z: Array, near: Array) -> Array:
    """The point of the axis through place along z that is nearest."""
    return place + ((near - place) @ z) * z


def _common_normal(
    place: Array, z: Array, after: Array, z_after: Array, before: list[RigidTransform]
) -> tuple[Array, Array | None]:
    """Where on the axis the common normal with the next one starts, and its direction, None where it is free."""
    across = np.cross(z, z_after)
    size = np.linalg.norm(across)
    if size < _PARALLEL:
        origin = _nearest_on_axis(place, z, before[-1].translation) if before else place
        way = _nearest_on_axis(after, z_after, origin) - origin
        return origin, way if np.linalg.norm(way) > 1e-9 else None
    # (after - place) = s z + t across - u z_after
    along = np.linalg.solve(np.column_stack([z, across, -z_after]), after - place)
    return place + along[0] * z, across if along[1] >= -1e-12 else -across


def _across(z: Array) -> Array:
    """A unit vector at right angles to z: x where z is not along it."""
    x = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]
    x = x - (x @ z) * z
    return x / np.linalg.norm(x)


def _along(axis: Literal["x", "z"], distance_m: float, angle_rad: float) -> RigidTransform:
    """A screw: the translation along an axis and the rotation about it, which commute."""
    shift = distance_m * np.eye(3)["xyz".index(axis)]
    return RigidTransform.from_components(shift, Rotation.from_euler(axis, angle_rad))
