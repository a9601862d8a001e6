"""The terms of the least-squares problem: one small class each.

A term reads the pose of one frame and, if it `ties` frames, that of the one before, which is held. It gives a residual
without unit (differences divided by a standard deviation) with its exact Jacobian. With M rows and D unknowns:

    evaluate(now, before, frame, dt_s) -> residual (M,), jacobian (M, D) by the state of now

now and before are a Posed of one state each, before None at the start; frame is the row number of the clip, dt_s the
time between the two. A new term is one class here and one line in the tests' list.

f1 to f5 and their names are those of C. van der Leek, MSc(Eng), University of Cape Town, 2022. `form` chooses between
what is meant, a penalty outside the range only ("deadband"), and the two-sided penalty as published ("printed"), which
pulls towards the edge of the range. The Gaussian priors are needed besides, because one frame's pixels leave the scale,
a roll of the chain about its axis and one mode of depth undetermined, and depth flips of every link.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from recon.animal.chain import AngleRanges, Posed
from recon.base.arrays import Array
from recon.geometry.camera import Camera

Form = Literal["deadband", "printed"]
ResidualAndJacobian = tuple[Array, Array]


class Objective:
    """A term of the problem: see the module's text."""

    name: str
    ties: ClassVar[bool] = False

    def evaluate(self, now: Posed, before: Posed | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        raise NotImplementedError


def _diagonal(values: Array, where: slice, n_state: int) -> Array:
    """(M,) derivatives of row m by unknown where.start + m -> Jacobian (M, D)."""
    jacobian = np.zeros((len(values), n_state))
    np.fill_diagonal(jacobian[:, where], values)
    return jacobian


@dataclass(frozen=True)
class JointReprojection(Objective):
    """f1: projected minus detected position, robust.

    With u = sqrt(confidence) (projected - detected) / sigma_px, the row pair of a joint is u / sqrt(1 + |u|^2 / c^2)
    (Geman-McClure as a squared residual): it saturates at c, so that a wrong point cannot pull without bound. Missing
    points are zero rows. Joints that the camera cannot project (behind it, outside the lens model) stand at the limit
    c, because a zero would reward a solution that leaves the picture.

    xy_px (T, J, 2), NaN where missing; confidence (T, J); c without unit.
    """

    camera: Camera
    xy_px: Array
    confidence: Array
    sigma_px: float
    c: float
    name: str = "reprojection"

    def evaluate(self, now: Posed, before: Posed | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert now.joints_jacobian is not None
        projected, d_point, valid = self.camera.project_with_jacobian(now.joints_m[0])
        detected = self.xy_px[frame]
        present = np.isfinite(detected[:, 0])
        seen = valid & present
        weight = np.sqrt(self.confidence[frame]) / self.sigma_px
        u = np.where(seen[:, None], projected - detected, 0.0) * weight[:, None]
        shrink = 1.0 / np.sqrt(1.0 + np.sum(u * u, axis=-1, keepdims=True) / self.c**2)
        # d(s u) = s (I - s^2 u u' / c^2) du with s the factor of shrinking
        d_u = (shrink * seen[:, None])[..., None] * (
            np.eye(2) - (shrink**2)[..., None] * u[:, :, None] * u[:, None, :] / self.c**2
        )
        jacobian = (d_u * weight[:, None, None]) @ d_point @ now.joints_jacobian[0]
        residual = np.where((present & ~valid)[:, None], self.c / np.sqrt(2.0), shrink * u)
        return residual.ravel(), jacobian.reshape(residual.size, -1)


@dataclass(frozen=True)
class AngleRange(Objective):
    """f2 (theta) and f3 (phi): (|angle - mean| - tolerance) / softness; deadband: only where that is positive."""

    name: str
    where: slice
    ranges: AngleRanges
    softness_rad: float
    form: Form

    def evaluate(self, now: Posed, before: Posed | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        state = now.state[0]
        off = state[self.where] - self.ranges.mean_rad
        residual = (np.abs(off) - self.ranges.tolerance_rad) / self.softness_rad
        slope = np.sign(off) / self.softness_rad
        if self.form == "deadband":
            slope = np.where(residual > 0, slope, 0.0)
            residual = np.maximum(residual, 0.0)
        return residual, _diagonal(slope, self.where, len(state))


@dataclass(frozen=True)
class RateLimit(Objective):
    """f4 (theta) and f5 (phi): the speed of a link's tip stays below length times max_rate.

    For a relative angle change a over the interval dt the tip moves along a chord of 2 r |sin(a / 2)|. deadband: that
    chord over dt, beyond the limit only (a link that turns over cannot hide). printed: the chord's rate of change,
    r |cos(a / 2)| |a| / dt, two-sided; the publication's missing da/dt and squared limit are mended. The excess is
    weighed as what it is over the interval, an angle: divided by r softness / dt, which cancels the length.
    """

    name: str
    where: slice
    max_rate_rad_s: Array
    softness_rad: float
    form: Form
    ties = True

    def evaluate(self, now: Posed, before: Posed | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert before is not None
        a = (now.state - before.state)[0, self.where]
        if self.form == "deadband":
            swept = 2.0 * np.abs(np.sin(a / 2))
            slope = np.sign(np.sin(a / 2)) * np.cos(a / 2)
        else:
            swept = np.abs(np.cos(a / 2) * a)
            slope = np.sign(np.cos(a / 2) * a) * (np.cos(a / 2) - 0.5 * a * np.sin(a / 2))
        residual = (swept - self.max_rate_rad_s * dt_s) / self.softness_rad
        slope = slope / self.softness_rad
        if self.form == "deadband":
            slope = np.where(residual > 0, slope, 0.0)
            residual = np.maximum(residual, 0.0)
        return residual, _diagonal(slope, self.where, now.state.shape[1])


@dataclass(frozen=True)
class GaussianPrior(Objective):
    """On some unknowns (A,): (unknown - mean) / sigma. That on the base length fixes the metric scale."""

    name: str
    where: slice
    mean: Array | float
    sigma: float

    def evaluate(self, now: Posed, before: Posed | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        residual = (now.state[0, self.where] - self.mean) / self.sigma
        return residual, _diagonal(np.full_like(residual, 1.0 / self.sigma), self.where, now.state.shape[1])


@dataclass(frozen=True)
class RollPrior(Objective):
    """Gaussian prior on the roll: the lateral axis W is level, (W . up) / sigma = sin(roll) cos(pitch) / sigma.

    up (3,): unit vector, camera frame. Measured against the vertical and not as one of R's angles, because R's axes
    are the camera's and mean roll only for an animal seen from the side.
    """

    up: Array
    sigma_rad: float
    euler: slice
    name: str = "roll prior"

    def evaluate(self, now: Posed, before: Posed | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert now.rotation_jacobian is not None
        jacobian = np.zeros_like(now.state)
        jacobian[0, self.euler] = self.up @ now.rotation_jacobian[0, ..., 2].T / self.sigma_rad
        return now.rotation[:, :, 2] @ self.up / self.sigma_rad, jacobian


@dataclass(frozen=True)
class HeadingTie(Objective):
    """The heading, the level part of the forward axis U, walks randomly: (h_now - h_before) / (sigma sqrt(dt)).

    up (3,): unit vector, camera frame. Three rows of rank two.
    """

    up: Array
    sigma_rad_per_sqrt_s: float
    euler: slice
    name: str = "heading tie"
    ties = True

    def evaluate(self, now: Posed, before: Posed | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert before is not None
        assert now.rotation_jacobian is not None
        level = np.eye(3) - np.outer(self.up, self.up)
        weight = 1.0 / (self.sigma_rad_per_sqrt_s * np.sqrt(dt_s))
        residual = (now.rotation - before.rotation)[0, :, 0] @ level * weight
        jacobian = np.zeros((3, now.state.shape[1]))
        jacobian[:, self.euler] = level @ now.rotation_jacobian[0, ..., 0].T * weight
        return residual, jacobian


@dataclass(frozen=True)
class TravelPrior(Objective):
    """The animal faces the way it travels: (level part of U - direction) / sigma.

    direction (T, 3): level unit vectors, camera frame, NaN where the travel says nothing (zero rows). up (3,).
    """

    up: Array
    direction: Array
    sigma_rad: float
    euler: slice
    name: str = "travel prior"

    def evaluate(self, now: Posed, before: Posed | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert now.rotation_jacobian is not None
        residual, jacobian = np.zeros(3), np.zeros((3, now.state.shape[1]))
        direction = self.direction[frame]
        if np.isfinite(direction[0]):
            level = np.eye(3) - np.outer(self.up, self.up)
            residual = (now.rotation[0, :, 0] @ level - direction) / self.sigma_rad
            jacobian[:, self.euler] = level @ now.rotation_jacobian[0, ..., 0].T / self.sigma_rad
        return residual, jacobian


@dataclass(frozen=True)
class JointPositions(Objective):
    """Joints against known places in the camera frame, as from several cameras: (joint - target) / sigma.

    target_m (T, J, 3), NaN where unknown (zero rows).
    """

    target_m: Array
    sigma_m: float
    name: str = "joint positions"

    def evaluate(self, now: Posed, before: Posed | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert now.joints_jacobian is not None
        target = self.target_m[frame]
        known = np.isfinite(target)
        residual = np.where(known, now.joints_m[0] - target, 0.0) / self.sigma_m
        jacobian = now.joints_jacobian[0] * known[..., None] / self.sigma_m
        return residual.ravel(), jacobian.reshape(residual.size, -1)
