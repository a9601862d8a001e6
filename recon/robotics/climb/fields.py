"""Potential fields of a torso on four feet: energy, wrench and its exact Jacobian.

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
the torso's degrees of freedom, so that there is a minimum to ride to: the force of an angle is
slope (X x r) / |X x r|^2, and its moment that of the same force at the foot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from recon.base.arrays import Array

Number = float | Array

PLANAR = (0, 1, 2, 3)
"""Degrees of freedom of a torso that only pitches: x, y, z, pitch."""
SPATIAL = (0, 1, 2, 3, 4, 5)
"""And roll (about y) and yaw (about z)."""

_EYE = np.eye(3)


@dataclass(frozen=True, eq=False)
class Well:
    """A potential of a coordinate q, with a wall at either end.

    All are numbers, or arrays that broadcast against the values, (..., legs).
    """

    gain: Number
    """Slope per unit of q."""
    natural: Number
    """The q of the least energy."""
    least: Number
    """The q of the lower wall."""
    most: Number
    """The q of the upper wall."""
    low: Number
    """Sharpness of the lower wall, per unit of q."""
    high: Number
    """Sharpness of the upper wall, per unit of q."""

    def of(self, q: Array) -> tuple[Array, Array, Array]:
        """Energy, slope and curvature at q."""
        off = q - self.natural
        up = self.gain * np.exp(self.high * (q - self.most))
        down = self.gain * np.exp(self.low * (self.least - q))
        energy = up * (off - 1 / self.high) / self.high - down * (off + 1 / self.low) / self.low
        return energy, off * (up + down), up * (1 + self.high * off) + down * (1 - self.low * off)


@dataclass(frozen=True, eq=False)
class Fields:
    """The wells of the legs, and what balances the torso. Arrays broadcast against (...)."""

    radial: Well
    swing: Well
    flap: Well
    balance_gain: Number
    """Force far from the centroid."""
    balance_sharpness: Number
    """Per metre."""


@dataclass(frozen=True, eq=False)
class Stand:
    """Where the torso is held."""

    hips_m: Array
    """(4, 3), in body axes."""
    side: Array
    """(4,), 1 for legs on the right, -1 on the left."""
    feet_m: Array
    """(..., 4, 3), in the world."""
    target_m: Array
    """(..., 2), the centroid to which balance pulls, in the world."""


class FieldValues(NamedTuple):
    """What the fields do to a torso."""

    energy: Array
    """(...)"""
    wrench: Array
    """(..., 6): force in world axes, moment about the centre of mass in body axes."""
    jacobian: Array
    """(..., 6, 6): the wrench's derivative by a shift in world axes and a turn (rotation vector) in body axes."""


def leg_vectors(position_m: Array, rotation: Array, hips_m: Array, feet_m: Array) -> Array:
    """(..., 4, 3): from hip to foot in body axes; position_m (..., 3), rotation (..., 3, 3) body to world."""
    return (feet_m - position_m[..., None, :]) @ rotation - hips_m


def evaluate(fields: Fields, stand: Stand, position_m: Array, rotation: Array) -> FieldValues:
    """Of the torso at position_m (..., 3), turned by rotation (..., 3, 3), body to world."""
    arm = (stand.feet_m - position_m[..., None, :]) @ rotation
    r = arm - stand.hips_m
    energy, gradient, hessian = _legs(fields, r, stand.side)
    force = gradient.sum(axis=-2)

    # dr = -R' dp + arm x dphi, and so with H the Hessian of the legs' energy:
    turned = _cross_matrix(arm)
    hessian_turned = hessian @ turned
    pp = rotation @ hessian.sum(axis=-3) @ np.swapaxes(rotation, -1, -2)
    pf = rotation @ (hessian_turned.sum(axis=-3) - _cross_matrix(force))
    along = (gradient * arm).sum(axis=(-1, -2))
    ff = (turned @ hessian_turned).sum(axis=-3) - (np.swapaxes(arm, -1, -2) @ gradient - along[..., None, None] * _EYE)

    pull, stiffness, held = _balance(fields, stand.target_m - position_m[..., :2])
    wrench = np.empty((*position_m.shape[:-1], 6))
    wrench[..., :3] = (rotation @ force[..., None])[..., 0]
    wrench[..., :2] += pull
    wrench[..., 3:] = np.cross(arm, gradient).sum(axis=-2)
    jacobian = np.empty((*position_m.shape[:-1], 6, 6))
    jacobian[..., :3, :3] = -pp
    jacobian[..., :2, :2] -= stiffness
    jacobian[..., :3, 3:] = pf
    jacobian[..., 3:, :3] = np.swapaxes(pf, -1, -2)
    jacobian[..., 3:, 3:] = ff
    return FieldValues(energy.sum(axis=-1) + held, wrench, jacobian)


def leg_forces(fields: Fields, r: Array, side: Array) -> Array:
    """(..., 3 fields, legs, 3), body axes: what the radial, the swing and the flap field do to the torso."""
    n, axes = _coordinates(r, side)
    slopes = [well.of(q)[1] for well, q in zip((fields.radial, fields.swing, fields.flap), n, strict=True)]
    return np.stack([s[..., None] * a for s, a in zip(slopes, axes, strict=True)], axis=-3)


def _coordinates(r: Array, side: Array) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    """The coordinates (..., legs) of the three fields and their gradients (..., legs, 3) by r."""
    x, y, z = r[..., 0], r[..., 1], r[..., 2]
    zero = np.zeros_like(x)
    length = np.sqrt(x * x + y * y + z * z)
    swing2, flap2 = y * y + z * z, x * x + z * z
    axes = (
        r / length[..., None],
        np.stack([zero, -z, y], axis=-1) / swing2[..., None],
        np.stack([-z * side, zero, x * side], axis=-1) / flap2[..., None],
    )
    return (length, np.arctan2(y, -z), np.arctan2(side * x, -z)), axes


def _legs(fields: Fields, r: Array, side: Array) -> tuple[Array, Array, Array]:
    """Energy (..., legs), gradient (..., legs, 3) and Hessian (..., legs, 3, 3) of the legs' fields by r."""
    (length, swing, flap), (u, a, b) = _coordinates(r, side)
    e0, s0, c0 = fields.radial.of(length)
    e1, s1, c1 = fields.swing.of(swing)
    e2, s2, c2 = fields.flap.of(flap)
    gradient = s0[..., None] * u + s1[..., None] * a + s2[..., None] * b

    rest = s0 / length
    hessian = (c0 - rest)[..., None, None] * (u[..., :, None] * u[..., None, :])
    hessian += c1[..., None, None] * (a[..., :, None] * a[..., None, :])
    hessian += c2[..., None, None] * (b[..., :, None] * b[..., None, :])
    # Second derivatives of an angle: with its gradient (g, h) in its plane, 2 g h, h^2 - g^2 and -2 g h.
    twist1, bend1 = 2 * s1 * a[..., 1] * a[..., 2], s1 * (a[..., 1] ** 2 - a[..., 2] ** 2)
    twist2, bend2 = 2 * s2 * b[..., 0] * b[..., 2], s2 * (b[..., 0] ** 2 - b[..., 2] ** 2)
    hessian[..., 0, 0] += rest - side * twist2
    hessian[..., 1, 1] += rest - twist1
    hessian[..., 2, 2] += rest + twist1 + side * twist2
    hessian[..., 1, 2] += bend1
    hessian[..., 2, 1] += bend1
    hessian[..., 0, 2] += side * bend2
    hessian[..., 2, 0] += side * bend2
    return e0 + e1 + e2, gradient, hessian


def _balance(fields: Fields, to_target: Array) -> tuple[Array, Array, Array]:
    """Force (..., 2) on the torso, its stiffness (..., 2, 2) and the energy (...), for level vectors (..., 2)."""
    gain, sharp = np.asarray(fields.balance_gain), np.asarray(fields.balance_sharpness)
    d = np.sqrt((to_target * to_target).sum(axis=-1))
    tanh = np.tanh(sharp * d)
    near = d < 1e-12
    over = gain * np.where(near, sharp, tanh / np.where(near, 1.0, d))
    n = to_target / np.where(near, 1.0, d)[..., None]
    steep = gain * sharp * (1 - tanh * tanh)
    stiffness = over[..., None, None] * _EYE[:2, :2] + (steep - over)[..., None, None] * (
        n[..., :, None] * n[..., None, :]
    )
    # ln cosh without overflow.
    energy = gain / sharp * (sharp * d + np.log1p(np.exp(-2 * sharp * d)) - np.log(2.0))
    return over[..., None] * to_target, stiffness, energy


def _cross_matrix(v: Array) -> Array:
    """(..., 3, 3): M with M u = v x u."""
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return matrix
