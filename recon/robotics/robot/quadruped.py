"""Four-legged robots: hips, legs with their joints' names, limits and rates, from a TOML file or a URDF file.

Body axes: x forwards, y left, z up. Legs are LF, RF, LH, RH (left or right, fore or hind). Joint angles are the robot's
own: of the bundled robots, and of others described by their dimensions, those of `recon.robotics.robot.leg` with signs;
of URDF files, the file's.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from recon.base.arrays import Array
from recon.robotics.ik.chain import SerialChain, joint_chain
from recon.robotics.ik.drive import drive_to
from recon.robotics.ik.methods import LeastNorm
from recon.robotics.robot.leg import FlapLeg, Leg
from recon.robotics.robot.solutions import all_solutions

LEGS = ("LF", "RF", "LH", "RH")
IK_TOLERANCE_M = 1e-5
_BISECTIONS = 12


@dataclass(frozen=True, eq=False)
class RobotLeg(ABC):
    """n joints, in their order from the hip down; feet are points in body axes, from the body's origin."""

    joints: tuple[str, ...]
    """Their names."""
    chain: SerialChain
    """Joint by joint in body axes, its end effector the foot."""
    neutral_m: Array
    """(3,): the foot of the standing leg."""

    @property
    def lower_rad(self) -> Array:
        return self.chain.lower_rad

    @property
    def upper_rad(self) -> Array:
        return self.chain.upper_rad

    @property
    def max_rate_rad_s(self) -> Array:
        return self.chain.max_rate_rad_s

    def points(self, angles_rad: Array) -> Array:
        """The hip, the joints after it and the foot (T, n + 1, 3)."""
        return self.chain.positions(angles_rad)

    @abstractmethod
    def foot(self, angles_rad: Array) -> Array:
        """(T, 3)"""

    @abstractmethod
    def angles(self, feet_m: Array) -> Array:
        """Angles (T, n) of feet (T, 3) that follow each other, NaN where there are none within the limits."""

    @abstractmethod
    def solutions(self, foot_m: Array) -> Array:
        """All angles (m, n) of one foot (3,), whatever the limits."""


@dataclass(frozen=True, eq=False)
class ClosedLeg(RobotLeg):
    """A leg in closed form."""

    leg: Leg
    """In leg axes."""
    hip_m: Array
    """(3,), in body axes."""
    signs: Array
    """(3,): of the joints' own angles, in the order of the joints."""

    @classmethod
    def of(
        cls, leg: Leg, hip_m: Array, joints: tuple[str, ...], signs: Array, max_rate_rad_s: Array, stand_m: float
    ) -> ClosedLeg:
        """signs, max_rate_rad_s (3,): in the order of the joints; stand_m: the height that the hip stands at."""
        straight, order = leg.geometry.chain(), list(leg.geometry.order)
        places = hip_m + _from_leg_axes(straight.positions(np.zeros(3)) * leg.mirror)
        # A rotation's axis is mirrored with the opposite sign.
        axes = _from_leg_axes(straight.joint_axes(np.zeros(3)) * leg.mirror) * np.prod(leg.mirror)
        offsets = np.diff(places, axis=0, prepend=0.0)
        lower, upper = np.sort(np.stack([leg.lower_rad, leg.upper_rad])[:, order] * signs, axis=0)
        chain = joint_chain(
            offsets[:3],
            axes * signs[:, None],
            tool_m=offsets[3],
            limits_rad=(lower, upper),
            max_rate_rad_s=max_rate_rad_s,
        )
        lateral = leg.geometry.lateral_m if isinstance(leg.geometry, FlapLeg) else 0.0
        neutral = hip_m + _from_leg_axes(np.array([lateral, 0.0, -stand_m]) * leg.mirror)
        return cls(joints, chain, neutral, leg, hip_m, signs)

    @cached_property
    def _order(self) -> list[int]:
        return list(self.leg.geometry.order)

    def angles(self, feet_m: Array) -> Array:
        solved = self.leg.inverse(_to_leg_axes(feet_m - self.hip_m)).angles_rad
        inside = np.all(self.leg.margins(solved) >= 0, axis=-1)
        return np.where(inside[..., None], solved[..., self._order] * self.signs, np.nan)

    def foot(self, angles_rad: Array) -> Array:
        swing_flap_knee = np.empty_like(angles_rad)
        swing_flap_knee[..., self._order] = angles_rad * self.signs
        return self.hip_m + _from_leg_axes(self.leg.forward(swing_flap_knee))

    def solutions(self, foot_m: Array) -> Array:
        found = self.leg.solutions(_to_leg_axes(foot_m - self.hip_m))
        return found[:, self._order] * self.signs


@dataclass(frozen=True, eq=False)
class ChainLeg(RobotLeg):
    """A leg of any joints, from the body's origin on, solved by `recon.robotics.ik`."""

    home_rad: Array
    """(n,): the standing leg."""

    def angles(self, feet_m: Array) -> Array:
        out, q = np.full((len(feet_m), self.chain.n), np.nan), self.home_rad
        for k, foot in enumerate(feet_m):
            found = reach(self.chain, q, foot)
            if found is None and q is not self.home_rad:
                found = reach(self.chain, self.home_rad, foot)
            if found is not None:
                out[k] = q = found
        return out

    def solutions(self, foot_m: Array) -> Array:
        return all_solutions(self.chain, foot_m).q

    def foot(self, angles_rad: Array) -> Array:
        return self.chain.end(angles_rad)


@dataclass(frozen=True, eq=False)
class Quadruped:
    """A robot with four legs."""

    name: str
    title: str
    legs: Mapping[str, RobotLeg]
    """By LF, RF, LH, RH."""
    stand_m: float
    """The height that its hips stand at."""
    source: str = ""

    @property
    def joints(self) -> tuple[str, ...]:
        """All legs', in the order of `LEGS`."""
        return tuple(name for label in LEGS for name in self.legs[label].joints)

    @cached_property
    def ground_m(self) -> float:
        """Of the standing robot, in body axes: the mean of the feet."""
        return float(np.mean([leg.neutral_m[2] for leg in self.legs.values()]))

    @cached_property
    def folding_m(self) -> Array:
        """(4,): how high the legs lift their feet straight up from where they stand, in the order of `LEGS`."""
        heights = []
        for leg in (self.legs[label] for label in LEGS):
            near, far = 0.0, -float(leg.neutral_m[2])
            for _ in range(_BISECTIONS):
                height = (near + far) / 2
                reached = np.isfinite(leg.angles((leg.neutral_m + np.array([0.0, 0.0, height]))[None])).all()
                near, far = (height, far) if reached else (near, height)
            heights.append(near)
        return np.array(heights)


def reach(chain: SerialChain, q: Array, foot_m: Array) -> Array | None:
    """Angles (n,) within the limits that put the end effector there, from nearby ones; None if they are not found."""
    # Rates do not limit a single place: an iteration is given the time that the slowest joint takes for a turn.
    interval = 2 * np.pi / float(chain.max_rate_rad_s.min())
    run = drive_to(chain, q, foot_m, LeastNorm(), IK_TOLERANCE_M, max_iterations=200, interval_s=interval)
    return run.q[-1] if run.reached else None


def standing(chain: SerialChain, foot_m: Array) -> Array | None:
    """Angles (n,) of the standing leg: reached from the middle of the limits, or else from random places in them."""
    lower, upper = np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)
    starts = [(lower + upper) / 2, *np.random.default_rng(0).uniform(lower, upper, (30, chain.n))]
    found = (reach(chain, q, foot_m) for q in starts)
    return next((q for q in found if q is not None), None)


def _to_leg_axes(v: Array) -> Array:
    return np.stack([-v[..., 1], v[..., 0], v[..., 2]], axis=-1)


def _from_leg_axes(v: ArrayLike) -> Array:
    v = np.asarray(v, float)
    return np.stack([v[..., 1], -v[..., 0], v[..., 2]], axis=-1)
