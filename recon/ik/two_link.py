"""Solve the planar arm of two links in closed form."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from recon.base.arrays import Array
from recon.ik.chain import planar_chain, unreachable


def two_link(lengths_m: tuple[float, float], target_m: ArrayLike) -> tuple[Array, str]:
    """Return the joint angles (2, 2) of both solutions for a target (2,), m, and the reason if there are fewer.

    Each row is a solution (q1, q2), in rad in (-pi, pi]. The first row has q2 <= 0. All angles are NaN if the target is
    out of reach. If the two solutions are the same, both rows hold it. The reason is "" if there are two solutions.

        cos q2 = (x^2 + y^2 - r1^2 - r2^2) / (2 r1 r2),   q1 = atan2(y, x) - atan2(r2 sin q2, r1 + r2 cos q2)

    Angle 0 is along +x, and the second angle is relative to the first link.

    Raises
    ------
    ValueError
        If a length is not positive.
    """
    target = np.asarray(target_m, float)
    # Rounding must not put the stretched arm out of its own reach.
    reason = unreachable(planar_chain(lengths_m), target, 1e-12 * sum(lengths_m))
    if reason:
        return np.full((2, 2), np.nan), reason
    (r1, r2), (x, y) = lengths_m, target.tolist()
    cosine = (x * x + y * y - r1 * r1 - r2 * r2) / (2 * r1 * r2)
    bend = math.acos(max(-1.0, min(1.0, cosine)))
    q2 = np.array([-bend, bend])
    q1 = math.atan2(y, x) - np.arctan2(r2 * np.sin(q2), r1 + r2 * np.cos(q2))
    singular = "singular: " + ("stretched" if bend < 1.0 else "folded") + ", the branches coincide"
    branches = np.column_stack([math.pi - (math.pi - q1) % (2 * math.pi), q2])
    return branches, singular if math.sin(bend) < 1e-9 else ""
