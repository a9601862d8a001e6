"""A climb frame by frame: the feet follow their paths, the fields carry the torso.

Before each footfall the torso shifts over the three other feet, all four planted, at the pace of its caps; then the
foot rises, crosses and sinks at the speeds of the phases, while the torso stays in the equilibrium of its fields. Where
the caps of a frame hold the torso back, the foot waits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recon.base.arrays import Array, Bools, Integers
from recon.robotics.climb.equilibrium import Torso, between, capped, moved, ride, solve
from recon.robotics.climb.fields import Fields, Stand
from recon.robotics.climb.margins import NONE
from recon.robotics.climb.paths import PHASES, along, corners
from recon.robotics.climb.recipe import Footfall, Primitive, Recipe
from recon.robotics.climb.walker import Walker

SHIFT = "shift"
MAX_WAIT = 400
"""Frames."""

Method = Literal["solve", "ride"]
"""How the torso's equilibrium is found, from frame to frame: solved for, or ridden to, as published."""


@dataclass(frozen=True, eq=False)
class Climb:
    """A planned climb of T frames."""

    walker: Walker
    recipe: Recipe
    time_s: Array
    """(T,)"""
    position_m: Array
    """(T, 3), of the centre of mass."""
    rotation: Array
    """(T, 3, 3), body to world."""
    feet_m: Array
    """(T, 4, 3), in the world."""
    angles_rad: Array
    """(T, 4, 3): swing, flap and knee of each leg, NaN where a foot is out of reach."""
    lifted: Integers
    """(T,): the leg that is up, or -1."""
    primitive: Integers
    """(T,): index, counted through the recipe; the last for the final shift."""
    footfall: Integers
    """(T,): index, counted through the recipe; the last for the final shift."""
    phase: NDArray[np.str_]
    """(T,): "shift", "rise", "traverse" or "lower"."""
    evaluations: Integers
    """(T,), of the fields."""
    settled: Bools
    """(T,): whether the minimum was found."""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def torso(self) -> Torso:
        return Torso(self.position_m, self.rotation)

    @property
    def pitch_rad(self) -> Array:
        """(T,): nose up."""
        return np.arcsin(np.clip(self.rotation[:, 2, 1], -1, 1))


def plan(walker: Walker, recipe: Recipe, method: Method = "solve") -> Climb:
    """The climb of the recipe. Whether it is a valid one, `margins.check` says."""
    frames = _Frames(walker, recipe, method)
    number = 0
    for k, primitive in enumerate(recipe.primitives):
        for footfall in primitive.footfalls:
            frames.shift(primitive.fields, footfall.leg, k, number)
            frames.swing(primitive, footfall, k, number)
            number += 1
    frames.shift(recipe.primitives[-1].fields, NONE, len(recipe.primitives) - 1, number - 1)
    return frames.climb()


def start(walker: Walker, recipe: Recipe) -> tuple[Torso, Array]:
    """The torso in equilibrium over the stance, and the feet (4, 3)."""
    feet = np.column_stack([recipe.stance_m, np.zeros(4)])
    fields = recipe.primitives[0].fields
    height = float(np.mean(fields.radial.natural))
    guess = Torso(np.array([*feet[:, :2].mean(axis=0), height]) - [0, 0, walker.hips_m[:, 2].mean()], np.eye(3))
    return solve(fields, _stand(walker, feet, NONE), guess, recipe.motion).torso, feet


def field_at(climb: Climb, frame: int) -> tuple[Fields, Stand]:
    """The fields that hold the torso in a frame, and where: before a footfall already those without its foot."""
    lifted, number = int(climb.lifted[frame]), int(climb.footfall[frame])
    if lifted == NONE and (climb.lifted[frame:] != NONE).any():
        lifted = climb.recipe.footfalls[number].leg
    fields = climb.recipe.primitives[int(climb.primitive[frame])].fields
    return fields, _stand(climb.walker, climb.feet_m[frame], lifted)


def _stand(walker: Walker, feet_m: Array, lifted: int) -> Stand:
    planted = np.arange(4) != lifted
    return Stand(walker.hips_m, walker.side, feet_m, feet_m[..., planted, :2].mean(axis=-2))


class _Frames:
    """The frames so far; the torso and the feet are those of the last."""

    def __init__(self, walker: Walker, recipe: Recipe, method: Method) -> None:
        self.walker, self.recipe, self.motion = walker, recipe, recipe.motion
        self.method = method
        self.torso, self.feet = start(walker, recipe)
        self.goal = self.torso
        self.rows: list[tuple] = []

    def shift(self, fields: Fields, lifted: int, primitive: int, footfall: int) -> None:
        self._settle(fields, _stand(self.walker, self.feet, lifted), (NONE, primitive, footfall, SHIFT))

    def swing(self, primitive: Primitive, footfall: Footfall, which: int, number: int) -> None:
        s, leg = self.recipe.swing, footfall.leg
        end = self.feet[leg] + footfall.vector_m
        path = corners(self.feet[leg], end, s.clearance_m, primitive.rise_rad, primitive.lower_rad)
        points, phases = [], []
        for k, (phase, speed) in enumerate(zip(PHASES, (s.rise_m_s, s.traverse_m_s, s.lower_m_s), strict=True)):
            way = float(np.linalg.norm(path[k + 1] - path[k]))
            n = int(np.ceil(way / speed * self.recipe.fps - 1e-9))
            points.append(along(path, k, np.arange(1, n + 1) / max(n, 1)))
            phases += [phase] * n
        for point, phase in zip(np.concatenate(points), phases, strict=True):
            self.feet = self.feet.copy()
            self.feet[leg] = point
            self._settle(primitive.fields, _stand(self.walker, self.feet, leg), (leg, which, number, phase))

    def _settle(self, fields: Fields, stand: Stand, label: tuple[int, int, int, str]) -> None:
        """One frame, and more while the caps hold the torso back: the feet wait for it."""
        for _ in range(MAX_WAIT):
            if self.method == "ride":
                held = ride(fields, stand, self.torso, self.motion)
            else:
                held = solve(fields, stand, self.goal, self.motion)
            self.goal = held.torso
            step = between(self.torso, held.torso)
            short = capped(step, self.motion.max_step_m, self.motion.max_turn_rad)
            self.torso = moved(self.torso, short)
            self.rows.append((*self.torso, self.feet, *label, held.evaluations, held.settled))
            if np.array_equal(short, step):
                return

    def climb(self) -> Climb:
        position, rotation, feet, lifted, primitive, footfall, phase, count, settled = (
            np.array(column) for column in zip(*self.rows, strict=True)
        )
        torso = Torso(position, rotation)
        posture = self.walker.posture(torso, feet)
        return Climb(
            self.walker,
            self.recipe,
            np.arange(len(position)) / self.recipe.fps,
            position,
            rotation,
            feet,
            np.where(posture.slack_m[..., None] >= 0, posture.angles_rad, np.nan),
            lifted,
            primitive,
            footfall,
            phase,
            count,
            settled,
        )
