"""How far a climb is from what it must not do, in every frame: negative where it does it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from recon.base.arrays import Array, Integers
from recon.robotics.climb.equilibrium import Torso
from recon.robotics.climb.paths import Step
from recon.robotics.climb.walker import AROUND, SHIN_POINTS, Walker

NONE = -1
"""The lifted leg where all are planted."""


class Rule(NamedTuple):
    """How one kind of margin is shown and weighed."""

    what: str
    """For the table."""
    unit: str
    """How it is printed."""
    per_unit: float
    """What a value is multiplied by when it is printed."""
    scale: float
    """What counts as one unit of safety when margins of several kinds are weighed against each other."""


RULES: dict[str, Rule] = {
    "reach": Rule("foot within the leg's reach", "mm", 1e3, 0.003),
    "limits": Rule("joints within their limits", "deg", 180 / np.pi, 0.06),
    "support": Rule("centre of mass inside the polygon of the planted feet", "mm", 1e3, 0.008),
    "knees": Rule("knees above ground and step", "mm", 1e3, 0.006),
    "shins": Rule("shins above ground and step", "mm", 1e3, 0.003),
    "hips": Rule("hips above ground and step", "mm", 1e3, 0.02),
    "corner": Rule("lifted foot from the step's edge", "mm", 1e3, 0.006),
    "footing": Rule("planted feet from the step's edge", "mm", 1e3, 0.006),
}


def margins(walker: Walker, step: Step, torso: Torso, feet_m: Array, lifted: Integers) -> Mapping[str, Array]:
    """By the names of `RULES`, each (..., n). feet_m (..., 4, 3); lifted broadcasts against (...): the leg that is up,
    or `NONE`. What does not apply to a frame is infinite there."""
    posture = walker.posture(torso, feet_m)
    shape = feet_m.shape[:-2]
    up = np.broadcast_to(lifted, shape)[..., None] == np.arange(4)
    shins = np.concatenate([feet_m + f * (posture.knees_m - feet_m) for f in SHIN_POINTS], axis=-2)
    edge = feet_m[..., 1] - step.edge_m
    on_top = feet_m[..., 2] > step.height_m / 2
    return {
        "reach": posture.slack_m,
        "limits": posture.limits_rad.reshape(*shape, 12),
        "support": support_m(torso.position_m[..., :2], feet_m[..., :2], lifted),
        "knees": step.distance_m(posture.knees_m),
        "shins": step.distance_m(shins),
        "hips": step.distance_m(posture.hips_m),
        "corner": np.where(up, step.corner_m(feet_m), np.inf),
        "footing": np.where(up, np.inf, np.where(on_top, edge, -edge)),
    }


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
