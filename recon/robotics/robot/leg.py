"""Legs of three joints in closed form: swing, flap and knee, with offsets at the knee and the foot.

Leg axes, at the hip: x lateral (outwards), y forward, z up, written for the right front leg; the others mirror x, y or
both, and keep the same angles. a swing, b flap, s knee; l1 thigh, l2 shin, uo offset at the knee, lo at the foot. In
the plane of the leg the foot lies P forward and Q below the hip,

    P = lo cos s + l2 sin s + uo        Q = l1 + l2 cos s - lo sin s

With the swing joint first, the flap joint on it (the Sony Aibo's):

    x = Q sin b        y = Q cos b sin a + P cos a        z = P sin a - Q cos b cos a

With the flap joint first and the swing joint `lateral_m` = d further out (most robots of today), Y and Z the place in
the plane that the flap joint turns:

    Y = Q sin a + P cos a        Z = P sin a - Q cos a
    x = d cos b - Z sin b        y = Y        z = d sin b + Z cos b

The inverse starts with the knee, from P^2 + Q^2 = n^2, the squared distance of the foot from the swing joint:

    s = atan2(q, p) -+ acos(-r / sqrt(p^2 + q^2))
    p = 2 (uo lo + l1 l2)    q = 2 (l2 uo - l1 lo)    r = lo^2 + l2^2 + uo^2 + l1^2 - n^2

The two signs are the two ways to bend the knee; taken is the one beyond the stretched leg, atan2(q, p), so the knee is
never bent backwards. The other angles follow from linear pairs. Of the two flaps that reach a foot, the leg pointing
down or up, taken is the one within 90 degrees of down.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, ConfigDict, Field

from recon.base.arrays import Array
from recon.robotics.ik.chain import SerialChain, joint_chain

LEG_ANGLES = ("swing", "flap", "knee")
Length = Annotated[float, Field(gt=-1e6, lt=1e6, allow_inf_nan=False)]
PositiveLength = Annotated[float, Field(gt=1e-6, lt=1e6, allow_inf_nan=False)]
"""Metres or radians in a file; more, or less, can only be damage."""


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError("the lower one first")
    return limits


Limits = Annotated[tuple[Length, Length], AfterValidator(_ordered)]

_ROUNDING = 1e-12
"""Share of the leg by which a target may lie outside the reach: a stretched leg must reach its own foot."""


@dataclass(frozen=True)
class Leg:
    """A leg with a thigh and a shin; feet are (..., 3) in leg axes, angles swing, flap and knee (..., 3)."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    first: Literal["swing", "flap"]
    """The joint next to the body."""
    thigh_m: PositiveLength
    shin_m: PositiveLength
    knee_offset_m: Length = 0.0
    """Forwards, at right angles to the thigh."""
    foot_offset_m: Length = 0.0
    """Forwards, at right angles to the shin."""
    lateral_m: Length = 0.0
    """From the flap joint out to the swing joint, where the flap joint is the first."""
    mirror: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """1 or -1 for each axis, 1 for the right front leg."""

    @property
    def order(self) -> list[int]:
        """The angles in the order of the joints from the hip down."""
        return [0, 1, 2] if self.first == "swing" else [1, 0, 2]

    @cached_property
    def chain(self) -> SerialChain:
        """The same leg joint by joint, its joints in the order in which they follow each other, not mirrored."""
        out, swing, flap = (self.lateral_m, 0.0, 0.0), (1, 0, 0), (0, -1, 0)
        return joint_chain(
            [(0, 0, 0), out, (0.0, self.knee_offset_m, -self.thigh_m)],
            [swing, flap, swing] if self.first == "swing" else [flap, swing, swing],
            tool_m=(0.0, self.foot_offset_m, -self.shin_m),
        )

    @property
    def stretched_rad(self) -> float:
        """The knee's angle with the foot farthest from the swing joint."""
        p, q, _ = self._pqr
        return float(np.arctan2(q, p))

    @property
    def distances_m(self) -> tuple[float, float]:
        """Least and largest distance of the foot from the swing joint."""
        upper, lower = np.hypot(self.thigh_m, self.knee_offset_m), np.hypot(self.shin_m, self.foot_offset_m)
        return float(abs(upper - lower)), float(upper + lower)

    @property
    def _pqr(self) -> tuple[float, float, float]:
        """p, q, and r + n^2."""
        l1, l2, uo, lo = self.thigh_m, self.shin_m, self.knee_offset_m, self.foot_offset_m
        return 2 * (uo * lo + l1 * l2), 2 * (l2 * uo - l1 * lo), lo * lo + l2 * l2 + uo * uo + l1 * l1

    def in_plane(self, knee_rad: Array) -> tuple[Array, Array]:
        """The coordinates P and Q (...) of the foot in the leg's plane, in metres."""
        c, s = np.cos(knee_rad), np.sin(knee_rad)
        P = self.foot_offset_m * c + self.shin_m * s + self.knee_offset_m
        return P, self.thigh_m + self.shin_m * c - self.foot_offset_m * s

    def forward(self, angles_rad: ArrayLike) -> Array:
        """The places of the feet from the hip, for these angles."""
        a, b, s = np.moveaxis(np.asarray(angles_rad, float), -1, 0)
        P, Q = self.in_plane(s)
        if self.first == "swing":
            U = Q * np.cos(b)
            foot = Q * np.sin(b), U * np.sin(a) + P * np.cos(a), P * np.sin(a) - U * np.cos(a)
        else:
            Z, d = P * np.sin(a) - Q * np.cos(a), self.lateral_m
            foot = d * np.cos(b) - Z * np.sin(b), Q * np.sin(a) + P * np.cos(a), d * np.sin(b) + Z * np.cos(b)
        return np.stack(foot, axis=-1) * self.mirror

    def inverse(self, feet_m: ArrayLike) -> Array:
        """Angles, whatever the limits, NaN out of reach."""
        x, y, z = np.moveaxis(np.asarray(feet_m, float) * self.mirror, -1, 0)
        d, swing_first = self.lateral_m, self.first == "swing"
        z2 = x * x + z * z - d * d
        n2 = x * x + y * y + z * z if swing_first else np.maximum(z2, 0.0) + y * y
        p, q, rest = self._pqr
        cosine = (n2 - rest) / np.hypot(p, q)
        s = np.arctan2(q, p) + np.arccos(np.clip(cosine, -1.0, 1.0))
        P, Q = self.in_plane(s)
        # U^2 = y^2 + z^2 - P^2 and atan2 in place of asin(x / Q), which loses half the digits at 90 degrees.
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
        """How far feet are within the reach of a leg whose swing joint is the first (...), negative outside."""
        distance, (least, most) = np.linalg.norm(feet_m, axis=-1), self.distances_m
        p, q, rest = self._pqr
        bend = np.arccos(np.clip((distance**2 - rest) / np.hypot(p, q), -1.0, 1.0))
        # A bent leg does not come nearer to the axis of its swing joint than P.
        aside = np.hypot(feet_m[..., 1], feet_m[..., 2]) - np.abs(self.in_plane(self.stretched_rad + bend)[0])
        return np.minimum(np.minimum(distance - least, most - distance), aside)


def _wrapped(angle: Array) -> Array:
    """In [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
