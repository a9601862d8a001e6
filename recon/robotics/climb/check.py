"""Whether a climb may be climbed: every rule in every frame, with its least margin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.robotics.climb.margins import RULES, margins
from recon.robotics.climb.plan import Climb
from recon.robotics.climb.walker import LEGS

ROUNDING_M = 1e-9
"""A planted foot may be this far under the surface that it stands on."""


@dataclass(frozen=True)
class LeastMargin:
    """The least margin of one rule."""

    what: str
    value: float
    """In `unit`."""
    unit: str
    frame: int
    """In which it is least."""
    lifted: str
    """Which leg was up then, or none."""


@dataclass(frozen=True, eq=False)
class ClimbCheck:
    """What a plan's margins are."""

    rows: dict[str, LeastMargin]
    """By the names of `RULES`."""
    deepest_m: float
    """How far a foot came under the ground or the step."""
    on_top: bool
    """All feet end on the step."""
    settled: bool
    """All frames in equilibrium."""
    rate_share: float
    """The fastest joint's rate over its limit."""

    @property
    def valid(self) -> bool:
        return not self.problems()

    def problems(self) -> list[str]:
        """What is wrong, in words."""
        found = [f"{r.what}: {r.value:.2f} {r.unit} in frame {r.frame}" for r in self.rows.values() if not r.value >= 0]
        if self.deepest_m > ROUNDING_M:
            found.append(f"a foot is {1000 * self.deepest_m:.2f} mm under the surface")
        if not self.on_top:
            found.append("not all feet end on top of the step")
        return found


def check(climb: Climb) -> ClimbCheck:
    """Of a planned climb."""
    step = climb.recipe.step
    rows = {}
    for name, values in margins(climb.walker, step, climb.torso, climb.feet_m, climb.lifted).items():
        rule, least = RULES[name], values.min(axis=-1)
        frame = int(least.argmin())
        lifted = LEGS[climb.lifted[frame]] if climb.lifted[frame] >= 0 else "none"
        rows[name] = LeastMargin(rule.what, float(least[frame]) * rule.per_unit, rule.unit, frame, lifted)
    last = climb.feet_m[-1]
    rates = np.abs(np.diff(climb.angles_rad, axis=0)) * climb.recipe.fps
    return ClimbCheck(
        rows,
        max(0.0, -float(step.distance_m(climb.feet_m).min())),
        bool(np.all((last[:, 1] > step.edge_m) & (np.abs(last[:, 2] - step.height_m) < ROUNDING_M))),
        bool(climb.settled.all()),
        float(np.max(rates / climb.walker.max_rate_rad_s)),
    )
