"""The objectives f1 to f5 and the priors: the terms of the least-squares problem of one frame.

Each term is one small class. It reads the pose of one frame and, if it `ties` frames, the pose of the frame before,
which is fixed. It returns residuals without unit (differences divided by a standard deviation) and their exact
Jacobian. A new term is one class here and one line in the list of `tests/thesis/test_objectives.py`.

f1 to f5 are those of C. van der Leek, MSc(Eng), University of Cape Town, 2022. `form` chooses between a penalty outside
the range only ("deadband"), which is meant, and the two-sided penalty as published ("printed"), which pulls towards the
edge of the range. The Gaussian priors are needed besides: the pixels of one frame leave open the scale, a roll of the
chain about its axis, one mode of depth, and depth flips of every link.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from recon.animal.chain import AngleRanges
from recon.base.arrays import Array
from recon.geometry.camera import Camera
from recon.thesis.chain import ChainPose, UnknownsChain
from recon.thesis.start import Travel

Form = Literal["deadband", "printed"]
ResidualAndJacobian = tuple[Array, Array]

PLAIN_C = 1e6
"""In place of `FrameOptions.robust_c` where f1 is as printed: no residual saturates."""


@dataclass(frozen=True)
class FrameOptions:
    """Set how the frame method weighs its objectives and searches for their minimum."""

    form: Form = "deadband"
    """The form of f2 to f5."""
    reprojection: Literal["robust", "printed"] = "robust"
    """f1 robust and weighted by confidence, or as printed."""
    angle_prior: Literal["gaussian", "none"] = "gaussian"
    """The Gaussian priors on angles, roll and heading, or none of them."""
    camera_rotation: Literal["free", "fixed"] = "free"
    """R of every frame by itself, or fixed to the first frame's."""
    base_length_m: float | None = None
    """In place of the skeleton's base length."""
    base_sigma_m: float | None = None
    """In place of the skeleton's standard deviation of the base length."""
    sigma_px: float = 3.0
    """The detector's noise."""
    keypoint_sigma_m: float | None = None
    """Distance of keypoints from the model's joints, in place of the skeleton's."""
    keypoint_sigma_max_px: float = 12.0
    """The largest that this distance is in the picture."""
    robust_c: float = 4.5
    """Residuals of this many standard deviations count half."""
    path: Literal["smooth", "free"] = "smooth"
    """The reference joint's path as smooth as an animal moves (`recon.thesis.path`), or every frame by itself."""
    start_angles: str | None = None
    """Angles of the first frame's start, measured by hand (`recon.thesis.start.parse_start_angles`)."""
    initial_damping: float | None = None
    """First damping of a search (`recon.thesis.levenberg`); None: MINPACK finds its own."""
    damping_factor: float = 10.0
    """Factor by which that damping changes."""
    tolerance: float = 1e-8
    """Relative change of cost, step and gradient at which a search ends."""
    max_evaluations: int = 400
    """Residual evaluations in one search."""

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> FrameOptions:
        """Return the options among the settings of a fit, as a motion keeps them."""
        values = {field.name: settings.get(field.name) for field in fields(cls)}
        return cls(**{name: value for name, value in values.items() if value is not None})


class Objective:
    """One term of the problem."""

    name: str
    ties: bool = False

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        """Return residuals (M,) and their Jacobian (M, D) with respect to the state.

        Parameters
        ----------
        pose : one state with its Jacobians
        previous : the pose of the frame before; None at the start
        frame : row of the clip
        dt_s : time between the two frames
        """
        raise NotImplementedError


def _diagonal(values: Array, columns: slice, n_state: int) -> Array:
    """Return the Jacobian (M, D) whose row m has values[m] in column columns.start + m."""
    jacobian = np.zeros((len(values), n_state))
    np.fill_diagonal(jacobian[:, columns], values)
    return jacobian


@dataclass(frozen=True)
class JointReprojection(Objective):
    """f1: projected minus detected position, robust.

    With u = sqrt(confidence) (projected - detected) / sigma_px, the two rows of a joint are u / sqrt(1 + |u|^2 / c^2)
    (Geman-McClure as a squared residual). They saturate at c, so that the pull of a wrong point is bounded. Missing
    points are zero rows. Joints that the camera cannot project (behind it, outside the lens model) stand at the limit
    c, because a zero would reward a solution that leaves the picture.
    """

    camera: Camera
    xy_px: Array
    """(T, J, 2), NaN where missing."""
    confidence: Array
    """(T, J)"""
    sigma_px: float
    c: float
    """In standard deviations."""
    name: str = "reprojection"

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert pose.joints_jacobian is not None
        projected, by_point, valid = self.camera.project_with_jacobian(pose.joints_m[0])
        detected = self.xy_px[frame]
        present = np.isfinite(detected[:, 0])
        usable = valid & present
        weight = np.sqrt(self.confidence[frame]) / self.sigma_px
        u = np.where(usable[:, None], projected - detected, 0.0) * weight[:, None]
        shrink = 1.0 / np.sqrt(1.0 + np.sum(u * u, axis=-1, keepdims=True) / self.c**2)
        # d(s u) = s (I - s^2 u u' / c^2) du, s the factor that shrinks u
        by_u = (shrink * usable[:, None])[..., None] * (
            np.eye(2) - (shrink**2)[..., None] * u[:, :, None] * u[:, None, :] / self.c**2
        )
        jacobian = (by_u * weight[:, None, None]) @ by_point @ pose.joints_jacobian[0]
        residual = np.where((present & ~valid)[:, None], self.c / np.sqrt(2.0), shrink * u)
        return residual.ravel(), jacobian.reshape(residual.size, -1)


@dataclass(frozen=True)
class _Limit(Objective):
    """A limit on the size of some unknowns (A,): (size - limit) / softness; deadband: only where positive."""

    name: str
    columns: slice
    softness_rad: float
    form: Form

    def excess(self, size: Array, slope: Array, limit: Array, n_state: int) -> ResidualAndJacobian:
        """Return residuals for sizes (A,) and their derivatives (A,) by the unknowns."""
        residual, slope = (size - limit) / self.softness_rad, slope / self.softness_rad
        if self.form == "deadband":
            residual, slope = np.maximum(residual, 0.0), np.where(residual > 0, slope, 0.0)
        return residual, _diagonal(slope, self.columns, n_state)


@dataclass(frozen=True)
class AngleRange(_Limit):
    """f2 (theta) and f3 (phi): (|angle - mean| - tolerance) / softness."""

    ranges: AngleRanges

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        deviation = pose.state[0, self.columns] - self.ranges.mean_rad
        size, slope = np.abs(deviation), np.sign(deviation)
        return self.excess(size, slope, self.ranges.tolerance_rad, pose.state.shape[1])


@dataclass(frozen=True)
class RateLimit(_Limit):
    """f4 (theta) and f5 (phi): the speed of a link's tip stays below length times max_rate.

    For a relative angle change a over the interval dt the tip moves along a chord of 2 r |sin(a / 2)|. deadband: that
    chord over dt, beyond the limit only (a link that turns over is seen). printed: the chord's rate of change,
    r |cos(a / 2)| |a| / dt, two-sided, with the publication's missing da/dt and squared limit corrected. The excess is
    weighed as an angle over the interval: divided by r softness / dt, which cancels the length.
    """

    max_rate_rad_s: Array
    ties = True

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert previous is not None
        a = (pose.state - previous.state)[0, self.columns]
        if self.form == "deadband":
            swept = 2.0 * np.abs(np.sin(a / 2))
            slope = np.sign(np.sin(a / 2)) * np.cos(a / 2)
        else:
            swept = np.abs(np.cos(a / 2) * a)
            slope = np.sign(np.cos(a / 2) * a) * (np.cos(a / 2) - 0.5 * a * np.sin(a / 2))
        return self.excess(swept, slope, self.max_rate_rad_s * dt_s, pose.state.shape[1])


@dataclass(frozen=True)
class GaussianPrior(Objective):
    """A prior on some unknowns (A,): (unknown - mean) / sigma. The one on the base length fixes the metric scale."""

    name: str
    columns: slice
    mean: Array | float
    sigma: float

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        residual = (pose.state[0, self.columns] - self.mean) / self.sigma
        return residual, _diagonal(np.full_like(residual, 1.0 / self.sigma), self.columns, pose.state.shape[1])


@dataclass(frozen=True)
class DirectionPrior(Objective):
    """A prior on the direction of one of the root's axes: components (axis - expected) / sigma.

    The components are measured against the vertical and not as R's angles: R's axes are the camera's, and mean roll
    only for an animal seen from the side.
    """

    name: str
    axis: int
    """0 is forward, U; 2 is lateral, W."""
    components: Array
    """(M, 3): rows that the difference is projected on."""
    expected: Array | None
    """(T, 3): unit vectors in the camera frame, NaN where none is expected (zero rows). None: the axis of the frame
    before; sigma is then that of a random walk, per root of a second."""
    sigma: float
    euler: slice

    @property
    def ties(self) -> bool:  # type: ignore[override]
        """Whether the frame before is read."""
        return self.expected is None

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert pose.rotation_jacobian is not None
        if self.expected is None:
            assert previous is not None
            expected, weight = previous.rotation[0, :, self.axis], 1.0 / (self.sigma * np.sqrt(dt_s))
        else:
            expected, weight = self.expected[frame], 1.0 / self.sigma
        jacobian = np.zeros((len(self.components), pose.state.shape[1]))
        if not np.isfinite(expected[0]):
            return np.zeros(len(self.components)), jacobian
        jacobian[:, self.euler] = self.components @ pose.rotation_jacobian[0, ..., self.axis].T * weight
        return self.components @ (pose.rotation[0, :, self.axis] - expected) * weight, jacobian


def base_length(chain: UnknownsChain, options: FrameOptions) -> tuple[float, float]:
    """Return the nominal base length and its standard deviation, metres."""
    nominal = options.base_length_m or chain.nominal_base_length_m
    relative = chain.file.base_length.sigma_m / chain.nominal_base_length_m
    return nominal, options.base_sigma_m or relative * nominal


def frame_objectives(
    camera: Camera, chain: UnknownsChain, xy_px: Array, confidence: Array, travel: Travel, options: FrameOptions
) -> tuple[Objective, ...]:
    """Return f1 to f5, the prior on the base length, and the Gaussian priors if they are on.

    Parameters
    ----------
    xy_px : (T, J, 2), NaN where missing
    confidence : (T, J)

    Returns
    -------
    The objectives, f1 first.
    """
    softness_rad, prior, form, up = chain.file.softness_rad, chain.file.prior, options.form, camera.up
    is_printed = options.reprojection == "printed"
    weights, robust_c = (np.ones_like(confidence), PLAIN_C) if is_printed else (confidence, options.robust_c)
    terms: list[Objective] = [
        JointReprojection(camera, xy_px, weights, options.sigma_px, robust_c),
        AngleRange("theta range", chain.theta_slice, softness_rad, form, chain.theta),
        AngleRange("phi range", chain.phi_slice, softness_rad, form, chain.phi),
        RateLimit("theta rate", chain.theta_slice, softness_rad, form, chain.theta.max_rate_rad_s),
        RateLimit("phi rate", chain.phi_slice, softness_rad, form, chain.phi.max_rate_rad_s),
        GaussianPrior("base length prior", slice(chain.base_index, chain.base_index + 1), *base_length(chain, options)),
    ]
    if options.angle_prior == "gaussian":
        level, euler = np.eye(3) - np.outer(up, up), chain.euler_slice
        heading = np.where(travel.speed_m_s[:, None] > 0, travel.heading, np.nan)
        terms += [
            GaussianPrior("theta prior", chain.theta_slice, chain.theta.mean_rad, prior.theta_sigma_rad),
            GaussianPrior("phi prior", chain.phi_slice, chain.phi.mean_rad, prior.phi_sigma_rad),
            DirectionPrior("roll prior", 2, up[None], np.zeros_like(heading), prior.roll_sigma_rad, euler),
            DirectionPrior("heading tie", 0, level, None, prior.heading_sigma_rad_per_sqrt_s, euler),
            DirectionPrior("travel prior", 0, level, heading, prior.travel_sigma_rad, euler),
        ]
    return tuple(terms)
