"""Potential fields of a torso on four feet: energy, wrench and its exact Jacobian, and where they hold the torso.

Body axes: x to the right, y forward, z up, at the centre of mass. r is a leg's vector from hip to foot in body axes, X
and Y the lateral and the forward axis. Every leg has three fields of one form, that of a `Well`,

    slope(q) = gain (q - natural) (exp(high (q - most)) + exp(low (least - q)))

almost flat between least and most (the dead zone) and steep beyond:

    radial  q = |r|                    the hip is pushed along r
    swing   q = atan2(y, -z) of r      along X x r: from straight down, forwards, in the plane whose normal is lateral
    flap    q = atan2(x, -z) of r      along r x Y: outwards (x mirrored on the left), in the plane whose normal is Y

and the balance field pulls the centre of mass to the level centroid of the planted feet, at distance d, with
gain tanh(sharpness d).

The publication (D. Cohen, SUNFEST, University of Pennsylvania, 2005) leaves open how an angle's force is divided by
the length of the leg, and what it does to the torso's rotation. Here each field is the gradient of one energy in all of
the torso's degrees of freedom, so that there is a minimum: the force of an angle is slope (X x r) / |X x r|^2, and its
moment that of the same force at the foot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array

LARGEST = 1e9
Number = Annotated[float, Field(strict=True, gt=-LARGEST, lt=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, lt=LARGEST, allow_inf_nan=False)]
"""In a recipe's file: what more or less than these would be can only be damage."""
FORBID = ConfigDict(extra="forbid", frozen=True)
"""How tables are checked: a name that is not known is a mistake."""

PLANAR = (0, 1, 2, 3)
"""Degrees of freedom of a torso that only pitches: x, y, z, pitch."""
SPATIAL = (0, 1, 2, 3, 4, 5)
"""And roll (about y) and yaw (about z)."""

MAX_EVALUATIONS = 100
"""The most evaluations of the fields in one frame."""
SETTLED_M = 1e-8
"""A torso whose next step is shorter, turns included, stands still."""
TRUST_M = 0.03
"""Longest Newton step, turns included."""
GIVE_UP = 1e12
"""Damping, relative to the stiffness."""

_EYE = np.eye(3)


def _all_legs(given: Any) -> Any:
    """One number for all legs, or two: of the front and of the rear legs."""
    front, rear = given if isinstance(given, list) and len(given) == 2 else (given, given)
    return (front, rear, front, rear)


_Legs = Annotated[tuple[Number, Number, Number, Number], BeforeValidator(_all_legs)]
_PositiveLegs = Annotated[tuple[Positive, Positive, Positive, Positive], BeforeValidator(_all_legs)]


@dataclass(frozen=True)
class Well:
    """A potential of a coordinate q of each leg, with a wall at either end. Raises ValueError."""

    __pydantic_config__ = FORBID
    gain: _PositiveLegs
    """Slope per unit of q."""
    natural: _Legs
    """The q of the least energy."""
    least: _Legs
    """The q of the lower wall."""
    most: _Legs
    """The q of the upper wall."""
    low: _PositiveLegs
    """Sharpness of the lower wall, per unit of q."""
    high: _PositiveLegs
    """Sharpness of the upper wall, per unit of q."""

    def __post_init__(self) -> None:
        if any(not a <= b <= c for a, b, c in zip(self.least, self.natural, self.most, strict=True)):
            raise ValueError("least <= natural <= most")

    def of(self, q: Array) -> tuple[Array, Array, Array]:
        """Energy, slope and curvature at q (..., legs)."""
        gain, natural, least, most, low, high = np.array([getattr(self, name) for name in self.__dataclass_fields__])
        off = q - natural
        up, down = gain * np.exp(high * (q - most)), gain * np.exp(low * (least - q))
        energy = up * (off - 1 / high) / high - down * (off + 1 / low) / low
        return energy, off * (up + down), up * (1 + high * off) + down * (1 - low * off)


@dataclass(frozen=True)
class _Balance:
    """What pulls the torso over its feet."""

    __pydantic_config__ = FORBID
    gain: Positive
    """Force far from the centroid."""
    sharpness: Positive
    """Per metre."""


@dataclass(frozen=True)
class Fields:
    """The wells of the legs, and what balances the torso."""

    __pydantic_config__ = FORBID
    radial: Well
    swing: Well
    flap: Well
    balance: _Balance


class Torso(NamedTuple):
    """The position and rotation of a robot's torso in the world."""

    position_m: Array
    """(..., 3), of the centre of mass in the world."""
    rotation: Array
    """(..., 3, 3), body to world."""

    def moved(self, step: Array) -> Torso:
        """Shifted in world axes and turned (rotation vector) in body axes by the step (..., 6)."""
        turn = Rotation.from_rotvec(step[..., 3:]).as_matrix()
        return Torso(self.position_m + step[..., :3], self.rotation @ turn)

    def step_to(self, other: Torso) -> Array:
        """(..., 6): the step that moves it there."""
        vector = Rotation.from_matrix(np.swapaxes(self.rotation, -1, -2) @ other.rotation).as_rotvec()
        return np.concatenate([other.position_m - self.position_m, vector], axis=-1)


@dataclass(frozen=True, eq=False)
class Stand:
    """What holds a torso, and where."""

    fields: Fields
    hips_m: Array
    """(4, 3), in body axes."""
    side: Array
    """(4,), 1 for legs on the right, -1 on the left."""
    feet_m: Array
    """(4, 3), in the world."""
    target_m: Array
    """(2,), the centroid to which balance pulls, in the world."""


def leg_vectors(torso: Torso, hips_m: Array, feet_m: Array) -> Array:
    """(..., 4, 3): from hip to foot in body axes."""
    return (feet_m - torso.position_m[..., None, :]) @ torso.rotation - hips_m


def evaluate(stand: Stand, torso: Torso) -> tuple[Array, Array, Array]:
    """Energy (...) of a torso, the wrench (..., 6) on it, force in world axes and moment about the centre of mass in
    body axes, and its derivative (..., 6, 6) by a shift in world axes and a turn (rotation vector) in body axes."""
    position, rotation = torso
    arm = leg_vectors(torso, np.zeros(3), stand.feet_m)
    energy, gradient, hessian = _legs(stand, arm - stand.hips_m)
    force = gradient.sum(axis=-2)

    # dr = -R' dp + arm x dphi, and so with H the Hessian of the legs' energy:
    turned = _cross_matrix(arm)
    hessian_turned = hessian @ turned
    pp = rotation @ hessian.sum(axis=-3) @ np.swapaxes(rotation, -1, -2)
    pf = rotation @ (hessian_turned.sum(axis=-3) - _cross_matrix(force))
    along = (gradient * arm).sum(axis=(-1, -2))
    ff = (turned @ hessian_turned).sum(axis=-3) - (np.swapaxes(arm, -1, -2) @ gradient - along[..., None, None] * _EYE)

    held, pull, stiffness = _balance(stand.fields.balance, stand.target_m - position[..., :2])
    wrench = np.concatenate([(rotation @ force[..., None])[..., 0], np.cross(arm, gradient).sum(axis=-2)], axis=-1)
    wrench[..., :2] += pull
    jacobian = np.block([[-pp, pf], [np.swapaxes(pf, -1, -2), ff]])
    jacobian[..., :2, :2] -= stiffness
    return energy.sum(axis=-1) + held, wrench, jacobian


def leg_forces(stand: Stand, r: Array) -> Array:
    """(..., 3 fields, legs, 3), body axes: what the radial, the swing and the flap field do to the torso."""
    fields, (n, axes) = stand.fields, _coordinates(r, stand.side)
    slopes = [well.of(q)[1] for well, q in zip((fields.radial, fields.swing, fields.flap), n, strict=True)]
    return np.stack([s[..., None] * a for s, a in zip(slopes, axes, strict=True)], axis=-3)


def _coordinates(r: Array, side: Array) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    """The coordinates (..., legs) of the three fields and their gradients (..., legs, 3) by r."""
    x, y, z = np.moveaxis(r, -1, 0)
    zero, length = np.zeros_like(x), np.sqrt(x * x + y * y + z * z)
    swing2, flap2 = y * y + z * z, x * x + z * z
    axes = (
        r / length[..., None],
        np.stack([zero, -z, y], axis=-1) / swing2[..., None],
        np.stack([-z * side, zero, x * side], axis=-1) / flap2[..., None],
    )
    return (length, np.arctan2(y, -z), np.arctan2(side * x, -z)), axes


def _legs(stand: Stand, r: Array) -> tuple[Array, Array, Array]:
    """Energy (..., legs), gradient (..., legs, 3) and Hessian (..., legs, 3, 3) of the legs' fields by r."""
    fields, (values, axes) = stand.fields, _coordinates(r, stand.side)
    wells = [well.of(q) for well, q in zip((fields.radial, fields.swing, fields.flap), values, strict=True)]
    energy = sum((e for e, _, _ in wells), np.zeros(r.shape[:-1]))
    gradient, hessian = np.zeros(r.shape), np.zeros((*r.shape, 3))
    # Second derivatives of a distance, (1 - u u') / |r|, and of an angle: with its gradient (g, h) in its plane, 2 g h,
    # h^2 - g^2 and -2 g h.
    for kind, ((_, slope, curvature), axis) in enumerate(zip(wells, axes, strict=True)):
        gradient += slope[..., None] * axis
        outer = axis[..., :, None] * axis[..., None, :]
        hessian += curvature[..., None, None] * outer
        if kind == 0:
            hessian += (slope / values[0])[..., None, None] * (_EYE - outer)
            continue
        level, way = 2 - kind, (1.0, stand.side)[kind - 1]  # the plane's axis beside z, and its direction
        twist = 2 * slope * way * axis[..., level] * axis[..., 2]
        bend = slope * way * (axis[..., level] ** 2 - axis[..., 2] ** 2)
        hessian[..., level, level] -= twist
        hessian[..., 2, 2] += twist
        hessian[..., level, 2] += bend
        hessian[..., 2, level] += bend
    return energy, gradient, hessian


def _balance(balance: _Balance, to_target: Array) -> tuple[Array, Array, Array]:
    """The energy (...) for level vectors (..., 2), the force (..., 2) on the torso and its stiffness (..., 2, 2)."""
    gain, sharp = balance.gain, balance.sharpness
    d = np.linalg.norm(to_target, axis=-1)
    near = d < 1e-12
    safe, tanh = np.where(near, 1.0, d), np.tanh(sharp * d)
    over = gain * np.where(near, sharp, tanh / safe)
    n = to_target / safe[..., None]
    steep = gain * sharp * (1 - tanh * tanh) - over
    stiffness = over[..., None, None] * np.eye(2) + steep[..., None, None] * (n[..., :, None] * n[..., None, :])
    # ln cosh without overflow.
    energy = gain / sharp * (sharp * d + np.log1p(np.exp(-2 * sharp * d)) - np.log(2.0))
    return energy, over[..., None] * to_target, stiffness


def _cross_matrix(v: Array) -> Array:
    """(..., 3, 3): M with M u = v x u."""
    return np.cross(_EYE, v[..., None, :])


def equilibrium(stand: Stand, start: Torso, dofs: tuple[int, ...], arm_m: float) -> tuple[Torso, int, bool]:
    """The torso in the least energy next to the start, how often fields were evaluated, and whether it stands still.

    Newton steps on the balance of forces and moments, damped (Levenberg) where one would not lead downhill. dofs: which
    of x, y, z, pitch, roll, yaw are free; arm_m: a turn by one radian counts as this way.
    """
    free, pick = list(dofs), np.ix_(dofs, dofs)
    scale = np.array([1.0] * 3 + [1 / arm_m] * 3)[free]
    torso, damping = start, 0.0
    energy, wrench, jacobian = evaluate(stand, torso)
    for count in range(1, MAX_EVALUATIONS):
        force = wrench[free] * scale
        stiffness = -jacobian[pick] * (scale[:, None] * scale)
        size = float(np.trace(stiffness)) / len(free)
        way = np.linalg.solve(stiffness + damping * (size if size > 0 else 1.0) * np.eye(len(free)), force)
        length, downhill = float(np.linalg.norm(way)), float(way @ force) > 0
        if downhill and length < SETTLED_M and damping < 1:
            return torso, count, True
        step = np.zeros(6)
        step[free] = way * scale * min(1.0, TRUST_M / max(length, TRUST_M))
        there = torso.moved(step)
        then = evaluate(stand, there)
        # At the minimum the energy no longer tells two places apart.
        if downhill and then[0] <= energy + 1e-12 * abs(energy):
            torso, (energy, wrench, jacobian) = there, then
            damping = damping / 10 if damping > 1e-3 else 0.0
        else:
            damping = max(10 * damping, 1e-3)
            if damping > GIVE_UP:
                break
    return torso, MAX_EVALUATIONS, False
