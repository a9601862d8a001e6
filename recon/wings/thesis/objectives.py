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
from typing import Literal

import numpy as np

from recon.animal.chain import AngleRanges, ChainPose
from recon.base.arrays import Array
from recon.geometry.camera import Camera

Form = Literal["deadband", "printed"]
ResidualAndJacobian = tuple[Array, Array]


class Objective:
    """A term of the problem: see the module's text."""

    name: str
    ties: bool = False

    def evaluate(self, now: ChainPose, before: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
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

    def evaluate(self, now: ChainPose, before: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
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
class _Limit(Objective):
    """What one of some unknowns (A,) is beyond its limit: (size - limit) / softness; deadband: only where positive."""

    name: str
    where: slice
    softness_rad: float
    form: Form

    def beyond(self, size: Array, slope: Array, limit: Array, n_state: int) -> ResidualAndJacobian:
        """How far sizes (A,) with their derivatives (A,) by the unknowns are beyond the limit."""
        residual, slope = (size - limit) / self.softness_rad, slope / self.softness_rad
        if self.form == "deadband":
            residual, slope = np.maximum(residual, 0.0), np.where(residual > 0, slope, 0.0)
        return residual, _diagonal(slope, self.where, n_state)


@dataclass(frozen=True)
class AngleRange(_Limit):
    """f2 (theta) and f3 (phi): (|angle - mean| - tolerance) / softness."""

    ranges: AngleRanges

    def evaluate(self, now: ChainPose, before: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        off = now.state[0, self.where] - self.ranges.mean_rad
        return self.beyond(np.abs(off), np.sign(off), self.ranges.tolerance_rad, now.state.shape[1])


@dataclass(frozen=True)
class RateLimit(_Limit):
    """f4 (theta) and f5 (phi): the speed of a link's tip stays below length times max_rate.

    For a relative angle change a over the interval dt the tip moves along a chord of 2 r |sin(a / 2)|. deadband: that
    chord over dt, beyond the limit only (a link that turns over cannot hide). printed: the chord's rate of change,
    r |cos(a / 2)| |a| / dt, two-sided; the publication's missing da/dt and squared limit are mended. The excess is
    weighed as what it is over the interval, an angle: divided by r softness / dt, which cancels the length.
    """

    max_rate_rad_s: Array
    ties = True

    def evaluate(self, now: ChainPose, before: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert before is not None
        a = (now.state - before.state)[0, self.where]
        if self.form == "deadband":
            swept = 2.0 * np.abs(np.sin(a / 2))
            slope = np.sign(np.sin(a / 2)) * np.cos(a / 2)
        else:
            swept = np.abs(np.cos(a / 2) * a)
            slope = np.sign(np.cos(a / 2) * a) * (np.cos(a / 2) - 0.5 * a * np.sin(a / 2))
        return self.beyond(swept, slope, self.max_rate_rad_s * dt_s, now.state.shape[1])


@dataclass(frozen=True)
class GaussianPrior(Objective):
    """On some unknowns (A,): (unknown - mean) / sigma. That on the base length fixes the metric scale."""

    name: str
    where: slice
    mean: Array | float
    sigma: float

    def evaluate(self, now: ChainPose, before: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        residual = (now.state[0, self.where] - self.mean) / self.sigma
        return residual, _diagonal(np.full_like(residual, 1.0 / self.sigma), self.where, now.state.shape[1])


@dataclass(frozen=True)
class DirectionPrior(Objective):
    """Where one of the root's axes points: part (axis - expected) / sigma, of rows part (M, 3).

    Axis 0 is forward, U, and axis 2 lateral, W. The parts are measured against the vertical and not as R's angles,
    because R's axes are the camera's and mean roll only for an animal seen from the side. expected (T, 3): unit
    vectors, camera frame, NaN where nothing is (zero rows); None: the axis of the frame before, of which it is a random
    walk, sigma times the root of the interval.
    """

    name: str
    axis: int
    part: Array
    expected: Array | None
    sigma: float
    euler: slice

    @property
    def ties(self) -> bool:  # type: ignore[override]
        return self.expected is None

    def evaluate(self, now: ChainPose, before: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert now.rotation_jacobian is not None
        if self.expected is None:
            assert before is not None
            expected, weight = before.rotation[0, :, self.axis], 1.0 / (self.sigma * np.sqrt(dt_s))
        else:
            expected, weight = self.expected[frame], 1.0 / self.sigma
        jacobian = np.zeros((len(self.part), now.state.shape[1]))
        if not np.isfinite(expected[0]):
            return np.zeros(len(self.part)), jacobian
        jacobian[:, self.euler] = self.part @ now.rotation_jacobian[0, ..., self.axis].T * weight
        return self.part @ (now.rotation[0, :, self.axis] - expected) * weight, jacobian
