"""Compute the joint angles of a robot's three-joint leg in closed form.

The joints are swing, flap and knee, with offsets at the knee and the foot. Leg axes have their origin at the hip. At
the right front leg, x is lateral (outwards), y forward and z up. For the other legs x, y or both are mirrored, and the
angles have the same meaning. In the formulas, a, b and s are the angles of swing, flap and knee. l1 and l2 are the
lengths of thigh and shin, and uo and lo the offsets at the knee and the foot. In the plane of the leg, the foot is P
forward of the hip and Q below the hip:

    P = lo cos s + l2 sin s + uo        Q = l1 + l2 cos s - lo sin s

If the swing joint comes first and carries the flap joint (as in the Sony Aibo):

    x = Q sin b        y = Q cos b sin a + P cos a        z = P sin a - Q cos a cos b

If the flap joint comes first and the swing joint is `lateral_m` = d further out (as in most modern robots), Y and Z are
the position in the plane that the flap joint turns:

    Y = Q sin a + P cos a        Z = P sin a - Q cos a
    x = d cos b - Z sin b        y = Y        z = d sin b + Z cos b

The inverse starts at the knee, from P^2 + Q^2 = n^2, the squared distance of the foot from the swing joint:

    s = atan2(q, p) -+ acos(-r / sqrt(p^2 + q^2))
    p = 2 (uo lo + l1 l2)    q = 2 (l2 uo - l1 lo)    r = lo^2 + l2^2 + uo^2 + l1^2 - n^2

The two signs are the two ways to bend the knee. The solution with s above atan2(q, p), the angle of the stretched leg,
is used, so that the knee never bends backwards. The other angles follow from pairs of linear equations. Two flap angles
reach a foot, one with the leg pointing down and the other with the leg pointing up. The angle within 90 degrees of down
is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from recon.base.arrays import Array
from recon.base.documents import FileTable
from recon.ik.chain import SerialChain, joint_chain

LEG_ANGLES = ("swing", "flap", "knee")
Length = Annotated[float, Field(strict=True, gt=-1e6, lt=1e6, allow_inf_nan=False)]
PositiveLength = Annotated[float, Field(strict=True, gt=1e-6, lt=1e6, allow_inf_nan=False)]
"""Positive length, angle, speed, mass or torque in a file about a robot. The limits reject damaged files."""


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError("the lower limit first")
    return limits


Limits = Annotated[tuple[Length, Length], AfterValidator(_ordered)]

_ROUNDING = 1e-12
"""Largest distance beyond the reach that still counts as reached, as a fraction of the leg's length.

Without this tolerance, rounding would put the foot of a stretched leg out of reach.
"""


@dataclass(frozen=True)
class Leg:
    """A leg with a thigh and a shin.

    Feet have the shape (..., 3), in leg axes, metres. Angles are swing, flap and knee, shape (..., 3), rad.
    """

    __pydantic_config__ = FileTable.model_config
    first: Literal["swing", "flap"]
    """Joint next to the body."""
    thigh_m: PositiveLength
    shin_m: PositiveLength
    knee_offset_m: Length = 0.0
    """Forward offset of the knee, perpendicular to the thigh, metres."""
    foot_offset_m: Length = 0.0
    """Forward offset of the foot, perpendicular to the shin, metres."""
    lateral_m: Length = 0.0
    """Outward distance from the flap joint to the swing joint in metres, if the flap joint comes first."""
    mirror: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factor 1 or -1 for each leg axis: 1 as in the right front leg, -1 mirrored."""

    @property
    def order(self) -> list[int]:
        """Return the indices of the joints in (swing, flap, knee), in their order from the hip down."""
        return [0, 1, 2] if self.first == "swing" else [1, 0, 2]

    @cached_property
    def chain(self) -> SerialChain:
        """Return the leg without mirroring as a chain of joints from the hip down."""
        out, swing, flap = (self.lateral_m, 0.0, 0.0), (1, 0, 0), (0, -1, 0)
        return joint_chain(
            [(0, 0, 0), out, (0.0, self.knee_offset_m, -self.thigh_m)],
            [swing, flap, swing] if self.first == "swing" else [flap, swing, swing],
            tool_m=(0.0, self.foot_offset_m, -self.shin_m),
        )

    @property
    def stretched_rad(self) -> float:
        """Return the knee angle at which the foot is farthest from the swing joint, rad."""
        p, q, _ = self._pqr
        return float(np.arctan2(q, p))

    @property
    def distances_m(self) -> tuple[float, float]:
        """Return the smallest and the largest distance of the foot from the swing joint, metres."""
        upper, lower = np.hypot(self.thigh_m, self.knee_offset_m), np.hypot(self.shin_m, self.foot_offset_m)
        return float(abs(upper - lower)), float(upper + lower)

    @property
    def _pqr(self) -> tuple[float, float, float]:
        """Return p, q and c, m^2, in n^2 = p cos(knee) + q sin(knee) + c, with n from the swing joint to the foot."""
        l1, l2, uo, lo = self.thigh_m, self.shin_m, self.knee_offset_m, self.foot_offset_m
        return 2 * (uo * lo + l1 * l2), 2 * (l2 * uo - l1 * lo), lo * lo + l2 * l2 + uo * uo + l1 * l1

    def in_plane(self, knee_rad: Array) -> tuple[Array, Array]:
        """Return the foot's coordinates P and Q (...) in the plane of the leg, in metres."""
        c, s = np.cos(knee_rad), np.sin(knee_rad)
        P = self.foot_offset_m * c + self.shin_m * s + self.knee_offset_m
        return P, self.thigh_m + self.shin_m * c - self.foot_offset_m * s

    def forward(self, angles_rad: ArrayLike) -> Array:
        """Return the positions (..., 3) of the feet relative to the hip in metres, for angles (..., 3) in rad."""
        return self.chain.end(np.asarray(angles_rad, float)[..., self.order]) * self.mirror

    def inverse(self, feet_m: ArrayLike) -> Array:
        """Return joint angles in rad, shape (..., 3), for feet (..., 3), without limits; NaN if out of reach."""
        x, y, z = np.moveaxis(np.asarray(feet_m, float) * self.mirror, -1, 0)
        d, swing_first = self.lateral_m, self.first == "swing"
        z2 = x * x + z * z - d * d
        n2 = x * x + y * y + z * z if swing_first else np.maximum(z2, 0.0) + y * y
        p, q, r_plus_n2 = self._pqr
        cosine = (n2 - r_plus_n2) / np.hypot(p, q)
        s = np.arctan2(q, p) + np.arccos(np.clip(cosine, -1.0, 1.0))
        P, Q = self.in_plane(s)
        # Use atan2 with U^2 = y^2 + z^2 - P^2, because asin(x / Q) would lose half the digits at 90 degrees.
        square = y * y + z * z - P * P if swing_first else z2
        root = np.sqrt(np.maximum(square, 0.0))
        if swing_first:
            up = np.where(Q < 0, -1.0, 1.0)
            a, b = _wrapped(np.arctan2(z, y) + np.arctan2(up * root, P)), np.arctan2(up * x, root)
        else:
            # (x, z) is (d, Z) turned by b; (y, Z) is (P, -Q) turned by a.
            a = _wrapped(np.arctan2(-root, y) + np.arctan2(Q, P))
            b = _wrapped(np.arctan2(z, x) - np.arctan2(-root, d))
        longest = np.hypot(self.distances_m[1], d)
        reached = (np.abs(cosine) <= 1 + _ROUNDING) & (square >= -_ROUNDING * longest**2)
        return np.where(reached[..., None], np.stack([a, b, s], axis=-1), np.nan)

    def slack_m(self, feet_m: Array) -> Array:
        """Return the distance of feet (..., 3) from the edge of the reach in metres, shape (...), negative outside.

        The swing joint of the leg has to come first.
        """
        distance, (shortest, longest) = np.linalg.norm(feet_m, axis=-1), self.distances_m
        p, q, r_plus_n2 = self._pqr
        bend = np.arccos(np.clip((distance**2 - r_plus_n2) / np.hypot(p, q), -1.0, 1.0))
        # The foot of a bent leg cannot come closer than P to the axis of the swing joint.
        beyond_axis = np.hypot(feet_m[..., 1], feet_m[..., 2]) - np.abs(self.in_plane(self.stretched_rad + bend)[0])
        return np.minimum(np.minimum(distance - shortest, longest - distance), beyond_axis)


def _wrapped(angle: Array) -> Array:
    """Return an angle in [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
