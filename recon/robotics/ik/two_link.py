"""The planar arm of two links in closed form.

cos q2 = (x^2 + y^2 - r1^2 - r2^2) / (2 r1 r2),   q1 = atan2(y, x) - atan2(r2 sin q2, r1 + r2 cos q2)

Angle 0 lies along +x, the second is relative to the first link.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from recon.base.arrays import Array
from recon.robotics.ik.chain import planar_chain, unreachable


@dataclass(frozen=True, eq=False)
class TwoLink:
    """Both solutions of a chain of two links."""

    branches_rad: Array
    """(2, 2): (q1, q2) with q2 <= 0, then with q2 >= 0, in (-pi, pi]; NaN without a solution."""
    reason: str = ""
    """Why there is none or only one, empty for two."""

    @property
    def reachable(self) -> bool:
        return bool(np.isfinite(self.branches_rad).all())


def two_link(lengths_m: tuple[float, float], target_m: ArrayLike) -> TwoLink:
    """Both branches for a target (2,), metres. On the annulus' edges they coincide. Raises ValueError for lengths that
    are not two positive ones."""
    if len(lengths_m) != 2:
        raise ValueError(f"two lengths expected, got {len(lengths_m)}")
    target = np.asarray(target_m, float)
    # Rounding must not put the stretched arm out of its own reach.
    reason = unreachable(planar_chain(lengths_m), target, 1e-12 * sum(lengths_m))
    if reason:
        return TwoLink(np.full((2, 2), np.nan), reason)
    (r1, r2), (x, y) = lengths_m, target.tolist()
    cosine = (x * x + y * y - r1 * r1 - r2 * r2) / (2 * r1 * r2)
    bend = math.acos(max(-1.0, min(1.0, cosine)))
    branches = []
    for q2 in (-bend, bend):
        q1 = math.atan2(y, x) - math.atan2(r2 * math.sin(q2), r1 + r2 * math.cos(q2))
        branches.append((math.pi - (math.pi - q1) % (2 * math.pi), q2))
    singular = "singular: " + ("stretched" if bend < 1.0 else "folded") + ", the branches coincide"
    return TwoLink(np.array(branches), singular if math.sin(bend) < 1e-9 else "")
