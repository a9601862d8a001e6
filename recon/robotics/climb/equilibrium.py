"""Where the fields hold the torso: ridden to, as published, and solved for.

`ride` moves the torso at force / mass and turns it at moment / inertia, one evaluation of the fields after the other.
`solve` finds the same minimum of the energy by Newton steps on the balance of forces and moments with its exact
Jacobian, damped (Levenberg) where one would not lead downhill. Both start where they are told: frame to frame, at the
torso before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools, Integers
from recon.robotics.climb.fields import PLANAR, Fields, Stand, evaluate
from recon.robotics.climb.numbers import FORBID, Positive

MAX_EVALUATIONS = 100
"""Of the fields, in one frame."""
SETTLED_M = 1e-8
"""A torso whose next step is shorter, turns included, stands still."""
TRUST_M = 0.03
"""Longest Newton step, turns included."""
GIVE_UP = 1e12
"""Damping, relative to the stiffness."""


class Torso(NamedTuple):
    """Where a torso is."""

    position_m: Array
    """(..., 3), of the centre of mass in the world."""
    rotation: Array
    """(..., 3, 3), body to world."""


@dataclass(frozen=True)
class TorsoDynamics:
    """How a torso follows the fields, an evaluation being the unit of time."""

    __pydantic_config__ = FORBID
    mass: Positive
    """Force over speed."""
    inertia: Positive
    """Moment over rate."""
    max_step_m: Positive
    """Cap of a frame."""
    max_turn_rad: Positive
    """Cap of a frame."""
    dofs: tuple[int, ...] = PLANAR
    """Which of x, y, z, pitch, roll, yaw are free."""
    arm_m: Positive = 0.065
    """A turn by one radian counts as this way."""


class Held(NamedTuple):
    """A torso that has followed the fields."""

    torso: Torso
    evaluations: Integers
    """(...), how often the fields were evaluated."""
    settled: Bools
    """(...), whether the torso stands still in them."""


def moved(torso: Torso, step: Array) -> Torso:
    """Shifted in world axes and turned (rotation vector) in body axes by the step (..., 6)."""
    turn = Rotation.from_rotvec(step[..., 3:].reshape(-1, 3)).as_matrix().reshape(*step.shape[:-1], 3, 3)
    return Torso(torso.position_m + step[..., :3], torso.rotation @ turn)


def between(a: Torso, b: Torso) -> Array:
    """(..., 6): the step that moves a to b."""
    turn = np.swapaxes(a.rotation, -1, -2) @ b.rotation
    vector = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(*turn.shape[:-2], 3)
    return np.concatenate([b.position_m - a.position_m, vector], axis=-1)


def capped(step: Array, max_step_m: float, max_turn_rad: float) -> Array:
    """The step (6,), shortened as a whole until its shift and its turn are within the caps."""
    shift, turn = float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:]))
    return step / max(1.0, shift / max_step_m, turn / max_turn_rad)


def ride(
    fields: Fields, stand: Stand, start: Torso, motion: TorsoDynamics, max_evaluations: int = MAX_EVALUATIONS
) -> Held:
    """One torso rides down the energy, until it stands still or has used up its evaluations. Within a frame neither its
    speed nor its rate exceeds the cap."""
    torso, dofs = start, list(motion.dofs)
    over = np.array([motion.mass] * 3 + [motion.inertia] * 3)[dofs]
    for k in range(max_evaluations):
        step = np.zeros(6)
        step[dofs] = evaluate(fields, stand, *torso).wrench[dofs] / over
        step = capped(step, motion.max_step_m, motion.max_turn_rad)
        if np.hypot(np.linalg.norm(step[:3]), motion.arm_m * np.linalg.norm(step[3:])) < SETTLED_M:
            return Held(torso, np.array(k + 1), np.array(True))
        torso = moved(torso, step)
    return Held(torso, np.array(max_evaluations), np.array(False))


def solve(
    fields: Fields, stand: Stand, start: Torso, motion: TorsoDynamics, max_evaluations: int = MAX_EVALUATIONS
) -> Held:
    """The equilibrium next to the start, of one torso or of many at once (leading dimensions)."""
    dofs = list(motion.dofs)
    pick = np.ix_(dofs, dofs)
    scale = np.array([1.0] * 3 + [1 / motion.arm_m] * 3)[dofs]
    shape = np.broadcast_shapes(start.position_m.shape[:-1], stand.feet_m.shape[:-2], stand.target_m.shape[:-1])
    torso = Torso(
        np.broadcast_to(start.position_m, (*shape, 3)).copy(), np.broadcast_to(start.rotation, (*shape, 3, 3)).copy()
    )
    damping, settled, count = np.zeros(shape), np.zeros(shape, bool), np.ones(shape, np.int64)
    now = evaluate(fields, stand, *torso)
    for _ in range(max_evaluations - 1):
        force = now.wrench[..., dofs] * scale
        stiffness = -now.jacobian[(..., *pick)] * (scale[:, None] * scale)
        size = np.trace(stiffness, axis1=-2, axis2=-1) / len(dofs)
        size = np.where(size > 0, size, 1.0)
        damped = stiffness + (damping * size)[..., None, None] * np.eye(len(dofs))
        free = np.linalg.solve(damped, force[..., None])[..., 0]
        length = np.linalg.norm(free, axis=-1)
        downhill = (free * force).sum(axis=-1) > 0
        settled |= downhill & (length < SETTLED_M) & (damping < 1)
        if settled.all():
            break
        step = np.zeros((*shape, 6))
        step[..., dofs] = free * scale * np.minimum(1.0, TRUST_M / np.maximum(length, TRUST_M))[..., None]
        there = moved(torso, step)
        then = evaluate(fields, stand, *there)
        # At the minimum the energy no longer tells two places apart.
        better = downhill & (then.energy <= now.energy + 1e-12 * np.abs(now.energy)) & ~settled
        count = count + ~settled
        damping = np.where(better, np.where(damping > 1e-3, damping / 10, 0.0), np.maximum(10 * damping, 1e-3))
        torso = Torso(
            np.where(better[..., None], there.position_m, torso.position_m),
            np.where(better[..., None, None], there.rotation, torso.rotation),
        )
        if better.all():
            now = then
        else:
            now = type(now)(
                *(
                    np.where(better.reshape(better.shape + (1,) * (new.ndim - better.ndim)), new, old)
                    for new, old in zip(then, now, strict=True)
                )
            )
        if np.all(settled | (damping > GIVE_UP)):
            break
    return Held(torso, count, settled)
