"""A climb frame by frame: the feet follow their paths, the fields carry the torso.

Before each footfall the torso shifts over the three other feet, all four planted, at the pace of its caps; then the
foot rises, crosses and sinks at the speeds of the phases, while the torso stays in the equilibrium of its fields. Where
the caps of a frame hold the torso back, the foot waits.

Body axes are those of the legs: x to the right, y forward, z up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from recon.base.arrays import Array, Bools, Integers
from recon.base.errors import InputError, Problem
from recon.robotics.climb.fields import Fields, Stand, Torso, equilibrium, leg_vectors
from recon.robotics.climb.recipe import Footfall, Primitive, Recipe
from recon.robotics.robot.leg import Leg
from recon.robotics.robot.quadruped import Quadruped

LEGS = ("left front", "left rear", "right front", "right rear")
"""Numbered from 1 in this order, as the published footfalls are."""
LABELS = ("LF", "LH", "RF", "RH")
"""Their names in a robot's description."""
AROUND = (0, 1, 3, 2)
"""The legs counterclockwise, seen from above."""
NONE = -1
"""The lifted leg where all are planted."""
MAX_WAIT = 400
"""Frames."""


@dataclass(frozen=True, eq=False)
class Walker:
    """A robot as a climb sees it, its centre of mass in the origin of its body. Raises InputError for legs of another
    kind than swing, flap, knee in closed form."""

    robot: Quadruped

    def __post_init__(self) -> None:
        if any(leg.closed is None or leg.closed.first != "swing" for leg in self.robot.legs.values()):
            expected = "a robot whose legs are given by dimensions, their swing joint first (aibo is one)"
            raise InputError(Problem(self.robot.name, "legs", "other legs", expected))

    @cached_property
    def legs(self) -> list[Leg]:
        """Four, in the order of `LEGS`."""
        return [leg for label in LABELS if (leg := self.robot.legs[label].closed) is not None]

    @cached_property
    def hips_m(self) -> Array:
        """(4, 3): in body axes."""
        hips = np.array([self.robot.legs[label].hip_m for label in LABELS])
        return np.stack([-hips[:, 1], hips[:, 0], hips[:, 2]], axis=1)

    @property
    def side(self) -> Array:
        """(4,): 1 on the right, -1 on the left."""
        return np.array([leg.mirror[0] for leg in self.legs])

    def posture(self, torso: Torso, feet_m: Array) -> tuple[Array, Array, Array, Array]:
        """The posture of feet (T, 4, 3) in the world under torsos (T): swing, flap and knee (T, 4, 3); how far each
        foot is within its leg's reach (T, 4), negative outside; hips and knees (T, 4, 3) in the world. A foot out of
        reach has the angles of the reach's end."""
        r = leg_vectors(torso, self.hips_m, feet_m)
        angles, slack, knees = np.empty_like(r), np.empty(r.shape[:-1]), np.empty_like(r)
        for k, leg in enumerate(self.legs):
            angles[:, k], slack[:, k] = _bent_leg(leg, r[:, k])
            knees[:, k] = leg.chain.positions(angles[:, k])[:, 2] * leg.mirror
        back = np.swapaxes(torso.rotation, -1, -2)
        hips = torso.position_m[:, None] + self.hips_m @ back
        return angles, slack, hips, hips + knees @ back


def _bent_leg(leg: Leg, foot_m: Array) -> tuple[Array, Array]:
    """Angles (T, 3) and slack (T,) of feet (T, 3) from the hip."""
    x, y, z = np.moveaxis(foot_m * leg.mirror, -1, 0)
    distance, (least, most) = np.linalg.norm(foot_m, axis=-1), leg.distances_m
    inside = np.clip(distance, least * (1 + 1e-9), most * (1 - 1e-9))
    angles = leg.inverse(foot_m * (inside / distance)[..., None])
    middle, half = (most**2 + least**2) / 2, (most**2 - least**2) / 2
    knee = leg.stretched_rad + np.arccos(np.clip((inside**2 - middle) / half, -1, 1))
    # A bent leg does not come nearer to the axis of its swing joint than P.
    aside = np.hypot(y, z) - np.abs(leg.in_plane(knee)[0])
    lying = np.stack([np.arctan2(z, y), np.copysign(np.pi / 2, x), knee], axis=-1)
    slack = np.min([distance - least, most - distance, aside], axis=0)
    return np.where(np.isnan(angles), lying, angles), slack


@dataclass(frozen=True, eq=False)
class Climb:
    """A planned climb of T frames. World: x to the right, y forward, z up."""

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
    lifted: Integers
    """(T,): the leg that is up, or `NONE`."""
    primitive: Integers
    """(T,): index, counted through the recipe; the last for the final shift."""
    footfall: Integers
    """(T,): index, counted through the recipe; the last for the final shift."""
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
        """The pitch of the torso in each of the T frames, shape (T,), positive with the nose up."""
        return np.arcsin(np.clip(self.rotation[:, 2, 1], -1, 1))

    @cached_property
    def posture(self) -> tuple[Array, Array, Array, Array]:
        """Angles, reach, hips and knees of the climb, as `Walker.posture` gives them."""
        return self.walker.posture(self.torso, self.feet_m)

    @property
    def angles_rad(self) -> Array:
        """(T, 4, 3): swing, flap and knee of each leg, NaN where a foot is out of reach."""
        angles, slack, _, _ = self.posture
        return np.where(slack[..., None] >= 0, angles, np.nan)

    def stand(self, frame: int) -> Stand:
        """What holds the torso in a frame: before a footfall already the fields without its foot."""
        lifted = int(self.lifted[frame])
        if lifted == NONE and (self.lifted[frame:] != NONE).any():
            lifted = self.recipe.footfalls[int(self.footfall[frame])].leg
        fields = self.recipe.primitives[int(self.primitive[frame])].fields
        return _stand(self.walker, fields, self.feet_m[frame], lifted)


def plan(walker: Walker, recipe: Recipe) -> Climb:
    """The climb of the recipe. Whether it is a valid one, `check` says."""
    frames, number = _Frames(walker, recipe), 0
    for k, primitive in enumerate(recipe.primitives):
        for footfall in primitive.footfalls:
            frames.settle(primitive.fields, footfall.leg, (NONE, k, number))
            for point in swing_path(recipe, primitive, footfall, frames.feet[footfall.leg]):
                frames.feet = frames.feet.copy()
                frames.feet[footfall.leg] = point
                frames.settle(primitive.fields, footfall.leg, (footfall.leg, k, number))
            number += 1
    frames.settle(recipe.primitives[-1].fields, NONE, (NONE, len(recipe.primitives) - 1, number - 1))
    columns = [np.array(column) for column in zip(*frames.rows, strict=True)]
    return Climb(walker, recipe, np.arange(len(columns[0])) / recipe.fps, *columns)


def start(walker: Walker, recipe: Recipe) -> tuple[Torso, Array]:
    """The torso in equilibrium over the stance, and the feet (4, 3)."""
    feet = np.column_stack([recipe.stance_m, np.zeros(4)])
    fields = recipe.primitives[0].fields
    height = float(np.mean(fields.radial.natural)) - walker.hips_m[:, 2].mean()
    guess = Torso(np.array([*feet[:, :2].mean(axis=0), height]), np.eye(3))
    return equilibrium(_stand(walker, fields, feet, NONE), guess, recipe.free, recipe.motion.arm_m)[0], feet


def _stand(walker: Walker, fields: Fields, feet_m: Array, lifted: int) -> Stand:
    planted = feet_m[np.arange(4) != lifted, :2]
    return Stand(fields, walker.hips_m, walker.side, feet_m, planted.mean(axis=0))


def swing_path(recipe: Recipe, primitive: Primitive, footfall: Footfall, start_m: Array) -> Array:
    """(n, 3): where a foot is in the frames of its step: up at one angle, across, down at another."""
    s, end = recipe.swing, start_m + footfall.vector_m
    corners = path_corners(start_m, end, s.clearance_m, primitive.rise_rad, primitive.lower_rad)
    points = []
    for a, b, speed in zip(corners, corners[1:], (s.rise_m_s, s.traverse_m_s, s.lower_m_s), strict=False):
        n = int(np.ceil(float(np.linalg.norm(b - a)) / speed * recipe.fps - 1e-9))
        points.append(a + (np.arange(1, n + 1) / max(n, 1))[:, None] * (b - a))
    return np.concatenate(points)


def path_corners(start_m: Array, end_m: Array, clearance_m: float, rise_rad: float, lower_rad: float) -> Array:
    """(4, 3): the corners of the path of a foot from start_m (3,) to end_m (3,), like a trapezoid.

    The foot rises at rise_rad above the forward direction (more than a right angle: leaning back) and sinks at
    lower_rad above the backward direction, in the plane of forward (y) and up; between them it crosses, sideways too,
    clearance_m above the higher end. Where both slopes take up more than the way there is, they are steeper, and meet.
    """
    top = max(start_m[2], end_m[2]) + clearance_m
    ahead, back = (top - start_m[2]) / np.tan(rise_rad), (top - end_m[2]) / np.tan(lower_rad)
    way = max(end_m[1] - start_m[1], 0.0)
    over = way / max(ahead + back, 1e-12) if ahead + back > way else 1.0
    first = [start_m[0], start_m[1] + over * ahead, top]
    second = [end_m[0], end_m[1] - over * back, top]
    return np.array([start_m, first, second, end_m])


def capped(step: Array, max_step_m: float, max_turn_rad: float) -> Array:
    """The step (6,), shortened as a whole until its shift and its turn are within the caps."""
    shift, turn = float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:]))
    return step / max(1.0, shift / max_step_m, turn / max_turn_rad)


class _Frames:
    """The frames so far; the torso and the feet are those of the last."""

    def __init__(self, walker: Walker, recipe: Recipe) -> None:
        self.walker, self.recipe = walker, recipe
        self.torso, self.feet = start(walker, recipe)
        self.goal = self.torso
        self.rows: list[tuple] = []

    def settle(self, fields: Fields, without: int, label: tuple[int, int, int]) -> None:
        """One frame in the fields without a leg, and more while the caps hold the torso back: the feet wait for it."""
        stand, pace = _stand(self.walker, fields, self.feet, without), self.recipe.motion
        for _ in range(MAX_WAIT):
            self.goal, count, settled = equilibrium(stand, self.goal, self.recipe.free, pace.arm_m)
            step = self.torso.step_to(self.goal)
            short = capped(step, pace.max_step_m, pace.max_turn_rad)
            self.torso = self.torso.moved(short)
            self.rows.append((*self.torso, self.feet, *label, count, settled))
            if np.array_equal(short, step):
                return
