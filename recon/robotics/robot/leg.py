"""Legs of three joints in closed form: swing, flap and knee, with offsets at the knee and the foot.

Leg axes, at the hip: x lateral (outwards), y forward, z up, written for the right front leg; the others mirror x, y or
both, and keep the same angles. a swing, b flap, s knee; l1 thigh, l2 shin, uo offset at the knee, lo at the foot. In
the plane of the leg the foot lies P forward and Q below the hip,

    P = lo cos s + l2 sin s + uo        Q = l1 + l2 cos s - lo sin s

With the swing joint first, the flap joint on it (`SwingLeg`, the Sony Aibo's):

    x = Q sin b        y = Q cos b sin a + P cos a        z = P sin a - Q cos b cos a

With the flap joint first and the swing joint `lateral_m` = d further out (`FlapLeg`, most robots of today), Y and Z the
place in the plane that the flap joint turns:

    Y = Q sin a + P cos a        Z = P sin a - Q cos a
    x = d cos b - Z sin b        y = Y        z = d sin b + Z cos b

The inverse starts with the knee, from P^2 + Q^2 = n^2, the squared distance of the foot from the swing joint:

    s = atan2(q, p) -+ acos(-r / sqrt(p^2 + q^2))
    p = 2 (uo lo + l1 l2)    q = 2 (l2 uo - l1 lo)    r = lo^2 + l2^2 + uo^2 + l1^2 - n^2

The two signs are the two ways to bend the knee; taken is the one beyond the stretched leg, atan2(q, p), so the knee is
never bent backwards. The other angles follow from linear pairs. Of the two flaps that reach a foot, the leg pointing
down or up, taken is the one within 90 degrees of down. `solutions` has all four.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from recon.base.arrays import Array, Bools, Integers
from recon.robotics.ik.chain import SerialChain, joint_chain
from recon.robotics.robot.solutions import distinct_angles

LEG_ANGLES = ("swing", "flap", "knee")

REACHED, NOT_FINITE, TOO_FAR, TOO_NEAR, TOO_LATERAL = range(5)
REASONS = (
    "",
    "unreachable: the target is not finite",
    "unreachable: too far from the hip",
    "unreachable: too near the hip",
    "unreachable: too close to the axis of the hip",
)
"""By code."""

_ROUNDING = 1e-12
"""Share of the leg by which a target may lie outside the reach: a stretched leg must reach its own foot."""


@dataclass(frozen=True, eq=False)
class LegAngles:
    """The angles that put a leg's foot where it is to be."""

    angles_rad: Array
    """(..., 3): swing, flap, knee, NaN where there are none."""
    code: Integers
    """(...): index into `REASONS`."""

    @property
    def reached(self) -> Bools:
        """(...)"""
        return self.code == REACHED

    def reasons(self) -> list[str]:
        """In the order of the raveled targets; empty where one is reached."""
        return [REASONS[code] for code in np.ravel(self.code)]


@dataclass(frozen=True)
class LegGeometry(ABC):
    """A leg with a thigh and a shin, in the leg axes of the right front leg. Raises ValueError.

    All metres and radians, over any leading dimensions.
    """

    thigh_m: float
    shin_m: float
    knee_offset_m: float = 0.0
    """Forwards, at right angles to the thigh."""
    foot_offset_m: float = 0.0
    """Forwards, at right angles to the shin."""

    order: ClassVar[tuple[int, int, int]]
    """The angles in the order of the joints from the hip down."""

    @property
    @abstractmethod
    def reach_m(self) -> float:
        """The longest distance of the foot from the hip."""

    @abstractmethod
    def forward(self, angles_rad: Array) -> Array:
        """Feet (..., 3) of the angles (..., 3)."""

    @abstractmethod
    def inverse(self, feet_m: Array, knee: int = 1, down: int = 1) -> LegAngles:
        """Angles of the feet (..., 3); a target out of reach gets NaN and a code, no error. knee, down: -1 for the knee
        bent the other way, for the flap that points the leg up."""

    @abstractmethod
    def chain(self) -> SerialChain:
        """The same leg joint by joint, in leg axes, its joints in the order in which they follow each other."""

    def __post_init__(self) -> None:
        lengths = (self.thigh_m, self.shin_m, self.knee_offset_m, self.foot_offset_m)
        if not np.isfinite(lengths).all() or min(self.thigh_m, self.shin_m) <= 0:
            raise ValueError(f"positive lengths and finite offsets expected: {lengths}")

    @property
    def stretched_rad(self) -> float:
        """The knee's angle with the foot farthest from the swing joint."""
        l1, l2, uo, lo = self.thigh_m, self.shin_m, self.knee_offset_m, self.foot_offset_m
        return float(np.arctan2(l2 * uo - l1 * lo, uo * lo + l1 * l2))

    @property
    def distances_m(self) -> tuple[float, float]:
        """Least and largest distance of the foot from the swing joint."""
        upper, lower = np.hypot(self.thigh_m, self.knee_offset_m), np.hypot(self.shin_m, self.foot_offset_m)
        return float(abs(upper - lower)), float(upper + lower)

    def in_plane(self, knee_rad: Array) -> tuple[Array, Array]:
        """P and Q (...)."""
        c, s = np.cos(knee_rad), np.sin(knee_rad)
        P = self.foot_offset_m * c + self.shin_m * s + self.knee_offset_m
        return P, self.thigh_m + self.shin_m * c - self.foot_offset_m * s

    def _knee(self, n2: Array, sign: int) -> tuple[Array, Integers]:
        """Knee (...) at squared distances n2 (...) from the swing joint, and the codes."""
        l1, l2, uo, lo = self.thigh_m, self.shin_m, self.knee_offset_m, self.foot_offset_m
        p, q = 2 * (uo * lo + l1 * l2), 2 * (l2 * uo - l1 * lo)
        r = lo * lo + l2 * l2 + uo * uo + l1 * l1 - n2
        cosine = -r / np.hypot(p, q)
        code = np.where(cosine > 1 + _ROUNDING, TOO_FAR, np.where(cosine < -1 - _ROUNDING, TOO_NEAR, REACHED))
        return np.arctan2(q, p) + sign * np.arccos(np.clip(cosine, -1.0, 1.0)), code


@dataclass(frozen=True)
class SwingLeg(LegGeometry):
    """Swing joint first."""

    order = (0, 1, 2)

    @property
    def reach_m(self) -> float:
        return self.distances_m[1]

    def forward(self, angles_rad: Array) -> Array:
        a, b, s = np.moveaxis(np.asarray(angles_rad, float), -1, 0)
        P, Q = self.in_plane(s)
        U = Q * np.cos(b)
        return np.stack([Q * np.sin(b), U * np.sin(a) + P * np.cos(a), P * np.sin(a) - U * np.cos(a)], axis=-1)

    def inverse(self, feet_m: Array, knee: int = 1, down: int = 1) -> LegAngles:
        x, y, z = feet = np.moveaxis(np.asarray(feet_m, float), -1, 0)
        s, code = self._knee(x * x + y * y + z * z, knee)
        P, Q = self.in_plane(s)
        # U^2 = y^2 + z^2 - P^2 and atan2 in place of asin(x / Q), which loses half the digits at 90 degrees.
        u2 = y * y + z * z - P * P
        slack = _ROUNDING * self.reach_m**2
        code = np.where((code == REACHED) & (u2 < -slack), TOO_LATERAL, code)
        up = np.where(Q < 0, -1.0, 1.0)
        U = down * np.sqrt(np.maximum(u2, 0.0))
        b = np.arctan2(up * x, U)
        a = _wrapped(np.arctan2(z, y) + np.arctan2(up * U, P))
        return _leg_angles(np.stack([a, b, s], axis=-1), code, feet)

    def chain(self) -> SerialChain:
        offset = (0.0, self.knee_offset_m, -self.thigh_m)
        return joint_chain(
            [(0, 0, 0), (0, 0, 0), offset],
            [(1, 0, 0), (0, -1, 0), (1, 0, 0)],
            tool_m=(0.0, self.foot_offset_m, -self.shin_m),
        )


@dataclass(frozen=True)
class FlapLeg(LegGeometry):
    """Flap joint first, about the forward axis, and the swing joint lateral_m further out."""

    lateral_m: float = 0.0

    order = (1, 0, 2)

    @property
    def reach_m(self) -> float:
        return float(np.hypot(self.distances_m[1], self.lateral_m))

    def forward(self, angles_rad: Array) -> Array:
        a, b, s = np.moveaxis(np.asarray(angles_rad, float), -1, 0)
        P, Q = self.in_plane(s)
        Z = P * np.sin(a) - Q * np.cos(a)
        sin, cos = np.sin(b), np.cos(b)
        y = Q * np.sin(a) + P * np.cos(a)
        return np.stack([self.lateral_m * cos - Z * sin, y, self.lateral_m * sin + Z * cos], axis=-1)

    def inverse(self, feet_m: Array, knee: int = 1, down: int = 1) -> LegAngles:
        x, y, z = feet = np.moveaxis(np.asarray(feet_m, float), -1, 0)
        d = self.lateral_m
        z2 = x * x + z * z - d * d
        s, code = self._knee(np.maximum(z2, 0.0) + y * y, knee)
        slack = _ROUNDING * self.reach_m**2
        code = np.where(z2 < -slack, TOO_LATERAL, code)
        P, Q = self.in_plane(s)
        Z = -down * np.sqrt(np.maximum(z2, 0.0))
        # (x, z) is (d, Z) turned by b; (y, Z) is (P, -Q) turned by a.
        b = _wrapped(np.arctan2(z, x) - np.arctan2(Z, d))
        a = _wrapped(np.arctan2(Z, y) + np.arctan2(Q, P))
        return _leg_angles(np.stack([a, b, s], axis=-1), code, feet)

    def chain(self) -> SerialChain:
        return joint_chain(
            [(0, 0, 0), (self.lateral_m, 0, 0), (0.0, self.knee_offset_m, -self.thigh_m)],
            [(0, -1, 0), (1, 0, 0), (1, 0, 0)],
            tool_m=(0.0, self.foot_offset_m, -self.shin_m),
        )


@dataclass(frozen=True, eq=False)
class Leg:
    """One of four legs, its feet in body axes from its hip: x to the right, y forward, z up."""

    geometry: LegGeometry
    mirror: Array
    """(3,): 1 or -1 per axis, 1 for the right front leg."""
    lower_rad: Array
    """(3,): limits of swing, flap, knee."""
    upper_rad: Array
    """(3,): limits of swing, flap, knee."""

    def __init__(
        self,
        geometry: LegGeometry,
        mirror: ArrayLike = (1.0, 1.0, 1.0),
        limits_rad: tuple[ArrayLike, ArrayLike] = (-np.pi, np.pi),
    ) -> None:
        lower, upper = (np.array(np.broadcast_to(np.asarray(x, float), 3)) for x in limits_rad)
        mirror = np.array(mirror, float)
        if mirror.shape != (3,) or not np.isin(mirror, (-1.0, 1.0)).all() or not np.all(lower <= upper):
            raise ValueError(f"signs (3,) and lower limits below the upper ones expected: {mirror}, {limits_rad}")
        for name, value in {"geometry": geometry, "mirror": mirror, "lower_rad": lower, "upper_rad": upper}.items():
            object.__setattr__(self, name, value)

    def forward(self, angles_rad: Array) -> Array:
        """Feet (..., 3) of the angles (..., 3)."""
        return self.geometry.forward(angles_rad) * self.mirror

    def inverse(self, feet_m: ArrayLike) -> LegAngles:
        """Angles of the feet (..., 3), whatever the limits: `margins` compares them."""
        return self.geometry.inverse(np.asarray(feet_m, float) * self.mirror)

    def solutions(self, foot_m: ArrayLike) -> Array:
        """All angles (m, 3), at most four, of one foot (3,), whatever the limits, in [-pi, pi)."""
        foot = np.asarray(foot_m, float) * self.mirror
        every = [self.geometry.inverse(foot, knee, down).angles_rad for down in (1, -1) for knee in (1, -1)]
        return distinct_angles([_wrapped(q) for q in every if np.isfinite(q).all()], np.ones(3, bool))

    def margins(self, angles_rad: Array) -> Array:
        """(..., 3), rad: how far each angle is within its limits, negative outside, NaN without an angle."""
        return np.minimum(angles_rad - self.lower_rad, self.upper_rad - angles_rad)

    def allowed(self, feet_m: ArrayLike, margin_rad: float = 0.0) -> Bools:
        """(...): which feet (..., 3) lie in the configuration space, every joint at least the margin within its
        limits."""
        return np.all(self.margins(self.inverse(feet_m).angles_rad) >= margin_rad, axis=-1)


def _wrapped(angle: Array) -> Array:
    """In [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _leg_angles(angles: Array, code: Integers, feet: Array) -> LegAngles:
    code = np.where(np.isfinite(feet).all(axis=0), code, NOT_FINITE)
    return LegAngles(np.where((code == REACHED)[..., None], angles, np.nan), code)
