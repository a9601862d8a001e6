"""How far a climb is from what it must not do, in every frame, and whether it may be climbed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from recon.base.arrays import Array, Integers
from recon.robotics.climb.plan import AROUND, LABELS, Climb

SHIN_POINTS = (0.25, 0.5, 0.75)
"""Shares of the way from foot to knee at which a shin must not touch the ground or the step."""
ROUNDING_M = 1e-9
"""A planted foot may be this far under the surface that it stands on."""


class _Rule(NamedTuple):
    """How one kind of margin is shown and weighed."""

    what: str
    """For the table."""
    unit: str
    """How it is printed."""
    per_unit: float
    """What a value is multiplied by when it is printed."""
    scale: float
    """What counts as one unit of safety when margins of several kinds are weighed against each other."""


RULES = {
    "reach": _Rule("foot within the leg's reach", "mm", 1e3, 0.003),
    "limits": _Rule("joints within their limits", "deg", 180 / np.pi, 0.06),
    "support": _Rule("centre of mass inside the polygon of the planted feet", "mm", 1e3, 0.008),
    "knees": _Rule("knees above ground and step", "mm", 1e3, 0.006),
    "shins": _Rule("shins above ground and step", "mm", 1e3, 0.003),
    "hips": _Rule("hips above ground and step", "mm", 1e3, 0.02),
    "corner": _Rule("lifted foot from the step's edge", "mm", 1e3, 0.006),
    "footing": _Rule("planted feet from the step's edge", "mm", 1e3, 0.006),
}


@dataclass(frozen=True, eq=False)
class ClimbCheck:
    """What a plan's margins are."""

    climb: Climb

    @cached_property
    def margins(self) -> dict[str, Array]:
        """By rule the least margin in every frame (T,), negative where it is broken, infinite where it does not
        apply."""
        climb, step = self.climb, self.climb.recipe.step
        feet, (angles, slack, hips, knees) = climb.feet_m, climb.posture
        up = climb.lifted[:, None] == np.arange(4)
        shins = np.concatenate([feet + f * (knees - feet) for f in SHIN_POINTS], axis=1)
        edge = np.where(feet[..., 2] > step.height_m / 2, 1, -1) * (feet[..., 1] - step.edge_m)
        legs = [climb.walker.robot.legs[label] for label in LABELS]
        limits = [leg.margins(leg.own(angles[:, k])) for k, leg in enumerate(legs)]
        found = {
            "reach": slack,
            "limits": np.concatenate(limits, axis=1),
            "support": support_m(climb.position_m[:, :2], feet[..., :2], climb.lifted),
            "knees": step.distance_m(knees),
            "shins": step.distance_m(shins),
            "hips": step.distance_m(hips),
            "corner": np.where(up, step.corner_m(feet), np.inf),
            "footing": np.where(up, np.inf, edge),
        }
        return {name: values.min(axis=1) for name, values in found.items()}

    @property
    def tightest(self) -> Array:
        """(T,): of all rules, in units of their kind, so that they can be compared."""
        return np.min([self.margins[name] / rule.scale for name, rule in RULES.items()], axis=0)

    @property
    def least(self) -> dict[str, tuple[float, int]]:
        """By rule the least margin, in its unit, and the frame."""
        frames = {name: int(values.argmin()) for name, values in self.margins.items()}
        return {name: (float(self.margins[name][k]) * RULES[name].per_unit, k) for name, k in frames.items()}

    @property
    def rate_share(self) -> float:
        """The fastest joint's rate over its limit."""
        rates = np.abs(np.diff(self.climb.angles_rad, axis=0)) * self.climb.recipe.fps
        legs = [self.climb.walker.robot.legs[label] for label in LABELS]
        return float(max((rates[:, k] / leg.chain.max_rate_rad_s).max() for k, leg in enumerate(legs)))

    def problems(self) -> list[str]:
        """What is wrong, in words; nothing of a climb that is valid."""
        step, feet = self.climb.recipe.step, self.climb.feet_m
        least = ((RULES[name], *of) for name, of in self.least.items())
        found = [f"{rule.what}: {value:.2f} {rule.unit} in frame {k}" for rule, value, k in least if not value >= 0]
        deepest = -float(step.distance_m(feet).min())
        if deepest > ROUNDING_M:
            found.append(f"a foot is {1000 * deepest:.2f} mm under the surface")
        if not np.all((feet[-1, :, 1] > step.edge_m) & (np.abs(feet[-1, :, 2] - step.height_m) < ROUNDING_M)):
            found.append("not all feet end on top of the step")
        return found


def support_m(centre_m: Array, feet_m: Array, lifted: Integers) -> Array:
    """(..., 8): from the centre of mass (..., 2) to the sides of the polygon of the planted feet, feet (..., 4, 2);
    infinite for lines between feet that are not its sides."""
    feet = feet_m[..., AROUND, :]
    up = np.asarray(lifted)[..., None] == np.array(AROUND)
    found = []
    for apart in (1, 2):
        a, b = feet, np.roll(feet, -apart, axis=-2)
        way, there = b - a, centre_m[..., None, :] - a
        # The legs go round counterclockwise: inside is on the left of every side.
        left = (way[..., 0] * there[..., 1] - way[..., 1] * there[..., 0]) / np.linalg.norm(way, axis=-1)
        applies = ~(up | np.roll(up, -1, axis=-1)) if apart == 1 else np.roll(up, -1, axis=-1)
        found.append(np.where(applies, left, np.inf))
    return np.concatenate(found, axis=-1)
