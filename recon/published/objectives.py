"""The terms of the least-squares problem: one small class each.

A term reads the poses of a few frames (its stencil, offsets relative to the frame it stands for, 0 last), and gives a
residual without unit (differences divided by a standard deviation) with its exact Jacobian. With N frames, S offsets,
M rows and D unknowns a frame:

    evaluate(window, frames, dt_s) -> residual (N, M), jacobian (N, M, S, D)

window holds one Posed of N states per offset, frames (N,) are row numbers of the clip, and dt_s (N,) is the time
between the first and the last offset. A new term is one class here and one line in the tests' list.

f1 to f5 and their names are those of C. van der Leek, MSc(Eng), University of Cape Town, 2022. `form` chooses between
what is meant, a penalty outside the range only ("deadband"), and the two-sided penalty as published ("printed"), which
pulls towards the edge of the range. The Gaussian priors are needed besides, because one frame's pixels leave the scale,
a roll of the chain about its axis and one mode of depth undetermined, and depth flips of every link.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from recon.camera import Camera
from recon.chain import AngleRanges, Posed

Array = NDArray[np.float64]
Form = Literal["deadband", "printed"]
Window = tuple[Posed, ...]


class Objective(Protocol):
    """A term of the problem: see the module's text."""

    @property
    def name(self) -> str: ...
    @property
    def stencil(self) -> tuple[int, ...]: ...
    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]: ...


def _diagonal(values: Array, where: slice, n_state: int) -> Array:
    """(N, M) derivatives of row m by unknown where.start + m -> Jacobian (N, M, 1, D)."""
    N, M = values.shape
    jacobian = np.zeros((N, M, 1, n_state))
    rows = np.arange(M)
    jacobian[:, rows, 0, where.start + rows] = values
    return jacobian


@dataclass(frozen=True)
class Reprojection:
    """f1: projected minus detected position, robust.

    With u = sqrt(confidence) (projected - detected) / sigma_px, the row pair of a joint is u / sqrt(1 + |u|^2 / c^2)
    (Geman-McClure as a squared residual): it saturates at c, so that a wrong point cannot pull without bound. Missing
    points are zero rows. Joints that the camera cannot project (behind it, outside the lens model) stand at the limit
    c, because a zero would reward a solution that leaves the picture.

    xy_px (T, J, 2), NaN where missing; confidence (T, J); sigma_px (T,); c without unit.
    """

    camera: Camera
    xy_px: Array
    confidence: Array
    sigma_px: Array
    c: float
    name: str = "reprojection"
    stencil: tuple[int, ...] = (0,)

    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]:
        posed = window[0]
        assert posed.joints_jacobian is not None
        projected, d_point, valid = self.camera.project_with_jacobian(posed.joints_m)
        detected = self.xy_px[frames]
        present = np.isfinite(detected[..., 0])
        seen = valid & present
        weight = np.sqrt(self.confidence[frames]) / self.sigma_px[frames, None]
        u = np.where(seen[..., None], projected - detected, 0.0) * weight[..., None]
        shrink = 1.0 / np.sqrt(1.0 + np.sum(u * u, axis=-1, keepdims=True) / self.c**2)
        # d(s u) = s (I - s^2 u u' / c^2) du with s the factor of shrinking
        d_u = (shrink * seen[..., None])[..., None] * (
            np.eye(2) - (shrink**2)[..., None] * u[..., :, None] * u[..., None, :] / self.c**2
        )
        jacobian = (d_u * weight[..., None, None]) @ d_point @ posed.joints_jacobian
        residual = np.where((present & ~valid)[..., None], self.c / np.sqrt(2.0), shrink * u)
        N, J, _, D = jacobian.shape
        return residual.reshape(N, 2 * J), jacobian.reshape(N, 2 * J, 1, D)


@dataclass(frozen=True)
class AngleRange:
    """f2 (theta) and f3 (phi): (|angle - mean| - tolerance) / softness; deadband: only where that is positive."""

    name: str
    where: slice
    ranges: AngleRanges
    softness_rad: float
    form: Form
    stencil: tuple[int, ...] = (0,)

    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]:
        state = window[0].state
        off = state[:, self.where] - self.ranges.mean_rad
        residual = (np.abs(off) - self.ranges.tolerance_rad) / self.softness_rad
        slope = np.sign(off) / self.softness_rad
        if self.form == "deadband":
            slope = np.where(residual > 0, slope, 0.0)
            residual = np.maximum(residual, 0.0)
        return residual, _diagonal(slope, self.where, state.shape[1])


@dataclass(frozen=True)
class RateLimit:
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
    stencil: tuple[int, ...] = (-1, 0)

    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]:
        before, now = window[0].state, window[1].state
        a = now[:, self.where] - before[:, self.where]
        if self.form == "deadband":
            swept = 2.0 * np.abs(np.sin(a / 2))
            slope = np.sign(np.sin(a / 2)) * np.cos(a / 2)
        else:
            swept = np.abs(np.cos(a / 2) * a)
            slope = np.sign(np.cos(a / 2) * a) * (np.cos(a / 2) - 0.5 * a * np.sin(a / 2))
        residual = (swept - self.max_rate_rad_s * dt_s[:, None]) / self.softness_rad
        slope = slope / self.softness_rad
        if self.form == "deadband":
            slope = np.where(residual > 0, slope, 0.0)
            residual = np.maximum(residual, 0.0)
        jacobian = _diagonal(slope, self.where, now.shape[1])
        return residual, np.concatenate([-jacobian, jacobian], axis=2)


@dataclass(frozen=True)
class AnglePrior:
    """Gaussian prior on angles: (angle - mean) / sigma. mean_rad (A,)."""

    name: str
    where: slice
    mean_rad: Array
    sigma_rad: float
    stencil: tuple[int, ...] = (0,)

    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]:
        state = window[0].state
        residual = (state[:, self.where] - self.mean_rad) / self.sigma_rad
        return residual, _diagonal(np.full_like(residual, 1.0 / self.sigma_rad), self.where, state.shape[1])


@dataclass(frozen=True)
class BaseLengthPrior:
    """Gaussian prior on the base length, which fixes the metric scale: (base_length - nominal) / sigma."""

    nominal_m: float
    sigma_m: float
    name: str = "base length prior"
    stencil: tuple[int, ...] = (0,)

    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]:
        state = window[0].state
        jacobian = np.zeros((len(state), 1, 1, state.shape[1]))
        jacobian[..., -1] = 1.0 / self.sigma_m
        return (state[:, -1:] - self.nominal_m) / self.sigma_m, jacobian


@dataclass(frozen=True)
class RollPrior:
    """Gaussian prior on the roll: the lateral axis W is level, (W . up) / sigma = sin(roll) cos(pitch) / sigma.

    up (3,): unit vector, camera frame. Measured against the vertical and not as one of R's angles, because R's axes
    are the camera's and mean roll only for an animal seen from the side.
    """

    up: Array
    sigma_rad: float
    euler: slice
    name: str = "roll prior"
    stencil: tuple[int, ...] = (0,)

    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]:
        posed = window[0]
        assert posed.rotation_jacobian is not None
        jacobian = np.zeros((len(posed.state), 1, 1, posed.state.shape[1]))
        jacobian[:, 0, 0, self.euler] = self.up @ posed.rotation_jacobian[..., 2].transpose(0, 2, 1) / self.sigma_rad
        return (posed.rotation[:, :, 2] @ self.up / self.sigma_rad)[:, None], jacobian


@dataclass(frozen=True)
class HeadingTie:
    """The heading, the level part of the forward axis U, walks randomly: (h_now - h_before) / (sigma sqrt(dt)).

    up (3,): unit vector, camera frame. Three rows of rank two.
    """

    up: Array
    sigma_rad_per_sqrt_s: float
    euler: slice
    name: str = "heading tie"
    stencil: tuple[int, ...] = (-1, 0)

    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]:
        before, now = window
        level = np.eye(3) - np.outer(self.up, self.up)
        weight = 1.0 / (self.sigma_rad_per_sqrt_s * np.sqrt(dt_s))
        residual = (now.rotation[:, :, 0] - before.rotation[:, :, 0]) @ level * weight[:, None]
        jacobian = np.zeros((len(now.state), 3, 2, now.state.shape[1]))
        for slot, (posed, sign) in enumerate(((before, -1.0), (now, 1.0))):
            if posed.rotation_jacobian is not None:  # a frame that is held fixed has none
                d = level @ posed.rotation_jacobian[..., 0].transpose(0, 2, 1)
                jacobian[:, :, slot, self.euler] = sign * d * weight[:, None, None]
        return residual, jacobian


@dataclass(frozen=True)
class TravelPrior:
    """The animal faces the way it travels: (level part of U - direction) / sigma.

    direction (T, 3): level unit vectors, camera frame, NaN where the travel says nothing (zero rows). up (3,).
    """

    up: Array
    direction: Array
    sigma_rad: float
    euler: slice
    name: str = "travel prior"
    stencil: tuple[int, ...] = (0,)

    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]:
        posed = window[0]
        assert posed.rotation_jacobian is not None
        level = np.eye(3) - np.outer(self.up, self.up)
        direction = self.direction[frames]
        known = np.isfinite(direction[:, :1])
        residual = np.where(known, posed.rotation[:, :, 0] @ level - direction, 0.0) / self.sigma_rad
        jacobian = np.zeros((len(posed.state), 3, 1, posed.state.shape[1]))
        d = level @ posed.rotation_jacobian[..., 0].transpose(0, 2, 1) / self.sigma_rad
        jacobian[:, :, 0, self.euler] = d * known[..., None]
        return residual, jacobian


@dataclass(frozen=True)
class JointPositions:
    """Joints against known places in the camera frame, as from several cameras: (joint - target) / sigma.

    target_m (T, J, 3), NaN where unknown (zero rows).
    """

    target_m: Array
    sigma_m: float
    name: str = "joint positions"
    stencil: tuple[int, ...] = (0,)

    def evaluate(self, window: Window, frames: NDArray[np.intp], dt_s: Array) -> tuple[Array, Array]:
        posed = window[0]
        assert posed.joints_jacobian is not None
        target = self.target_m[frames]
        known = np.isfinite(target)
        residual = np.where(known, posed.joints_m - target, 0.0) / self.sigma_m
        jacobian = posed.joints_jacobian * known[..., None] / self.sigma_m
        N, J, _, D = jacobian.shape
        return residual.reshape(N, 3 * J), jacobian.reshape(N, 3 * J, 1, D)
