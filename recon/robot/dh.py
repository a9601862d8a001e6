"""Chains from Denavit-Hartenberg parameters, in both conventions, for `recon.ik`.

modified (Craig):  T_{i-1, i} = Rx(alpha_{i-1}) Tx(a_{i-1}) Rz(theta_i) Tz(d_i)
standard:          T_{i-1, i} = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)

A joint that turns adds q to theta, one that slides to d. A row of the modified convention holds a and alpha of the link
before the joint, of the standard one those of the link after it, as the tables in print do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from recon.ik.chain import MAX_RATE_RAD_S
from recon.ik.joint_chain import JointChain

Convention = Literal["modified", "standard"]


@dataclass(frozen=True)
class DHRow:
    """a_m, alpha_rad of the link; d_m, theta_rad: with q = 0; slides: q adds to d, not to theta."""

    a_m: float = 0.0
    alpha_rad: float = 0.0
    d_m: float = 0.0
    theta_rad: float = 0.0
    slides: bool = False


def dh_chain(
    rows: Sequence[DHRow],
    convention: Convention,
    limits_rad: tuple[ArrayLike, ArrayLike] | None = None,
    max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S,
) -> JointChain:
    """The chain of the rows from the base. limits_rad, max_rate_rad_s: as `JointChain`. Raises ValueError."""
    if convention not in ("modified", "standard") or not rows:
        raise ValueError(f"rows and the convention, modified or standard, expected, got {len(rows)}, {convention!r}")
    link = [_along("x", row.a_m, row.alpha_rad) for row in rows]
    joint = [_along("z", row.d_m, row.theta_rad) for row in rows]
    nothing = RigidTransform.identity()
    before, tool = (link, nothing) if convention == "modified" else ([nothing, *link[:-1]], link[-1])
    placed = [a * b for a, b in zip(before, joint, strict=True)]
    return JointChain(
        np.array([t.translation for t in placed]),
        np.tile([0.0, 0.0, 1.0], (len(rows), 1)),
        Rotation.concatenate([t.rotation for t in placed]),
        [row.slides for row in rows],
        tool.translation,
        tool.rotation,
        limits_rad,
        max_rate_rad_s,
    )


def _along(axis: Literal["x", "z"], distance_m: float, angle_rad: float) -> RigidTransform:
    """A screw: the translation along an axis and the rotation about it, which commute."""
    shift = distance_m * np.eye(3)["xyz".index(axis)]
    return RigidTransform.from_components(shift, Rotation.from_euler(axis, angle_rad))
