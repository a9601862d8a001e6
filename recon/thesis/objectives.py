"""Define the terms of one frame's least-squares problem: the objectives f1 to f5 and the priors.

Each term is a small class. A term reads the pose of one frame and, if it `ties` frames, the fixed pose of the previous
frame. Terms return residuals without a unit (differences divided by a standard deviation) and their exact Jacobian. A
new term needs one class here and one line in the list in `tests/thesis/test_objectives.py`.

f1 to f5 are the objectives of C. van der Leek, MSc(Eng), University of Cape Town, 2022. `form` selects the penalty.
"deadband" penalises only values outside the range, as the publication intends. "printed" is the published formula,
which is two-sided and pulls values towards the edge of the range. The Gaussian priors are necessary as well, because
the pixels of one frame do not determine the scale, the roll of the chain about its axis, one mode of depth, and the
sign of each link's depth.
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
"""Value of `FrameOptions.robust_c` if f1 is used as printed, so large that no residual saturates."""


@dataclass(frozen=True)
class FrameOptions:
    """Weights of the frame method's objectives, and limits of its search."""

    form: Form = "deadband"
    """Form of f2 to f5, which is "deadband" (penalises only values outside ranges) or "printed" (as published)."""
    reprojection: Literal["robust", "printed"] = "robust"
    """Form of f1, which is "robust" (and weighted by confidence) or "printed" (as published)."""
    angle_prior: Literal["gaussian", "none"] = "gaussian"
    """Whether angles, roll and heading have Gaussian priors."""
    camera_rotation: Literal["free", "fixed"] = "free"
    """Rotation of the camera, which is "free" in every frame or "fixed" to the first frame's rotation."""
    base_length_m: float | None = None
    """Expected base length in metres; None for the skeleton's value."""
    base_sigma_m: float | None = None
    """Standard deviation of the base length in metres; None for the skeleton's value."""
    sigma_px: float = 3.0
    """Standard deviation of the detector's noise in pixels."""
    keypoint_sigma_m: float | None = None
    """Standard deviation of keypoints about the model's joints in metres; None for the skeleton's value."""
    keypoint_sigma_max_px: float = 12.0
    """Upper limit of `keypoint_sigma_m` after its projection into the picture, in pixels."""
    robust_c: float = 4.5
    """Error in standard deviations at which the robust penalty on a point is half of the squared error."""
    path: Literal["smooth", "free"] = "smooth"
    """Path of the reference joint, "smooth" over all frames (`recon.thesis.path`) or "free" in every frame."""
    path_sigma_m: float = 0.5
    """Standard deviation of the reference joint about a smooth path in metres.

    A smaller value makes the poses smoother, but fits the pixels less well. Speeds are computed from the path, so the
    value does not affect them (`python benchmarks/thesis.py --only path-ties`).
    """
    start_angles: str | None = None
    """Start angles of the first frame, measured by hand (`recon.thesis.start.parse_start_angles`)."""
    initial_damping: float | None = None
    """Initial damping of a search (`recon.thesis.levenberg`); None to use MINPACK, which finds its own."""
    damping_factor: float = 10.0
    """Factor by which the damping changes after each step, if `initial_damping` is given."""
    tolerance: float = 1e-8
    """Relative change of the cost, relative length of a step, or relative gradient at which a search ends."""
    max_evaluations: int = 400
    """Largest number of residual evaluations in one search."""

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> FrameOptions:
        """Return the options contained in the stored settings of a fit."""
        values = {field.name: settings.get(field.name) for field in fields(cls)}
        return cls(**{name: value for name, value in values.items() if value is not None})


class Objective:
    """One term of a frame's least-squares problem."""

    name: str
    ties: bool = False
    """Whether the term depends on the pose of the previous frame."""

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        """Return the term's residuals (M,) and their Jacobian (M, D) with respect to the state.

        Parameters
        ----------
        pose
            One state with its Jacobians.
        previous
            The pose of the previous frame; None in the first frame.
        frame
            Index of the frame in the clip.
        dt_s
            Time between the two frames in seconds.
        """
        raise NotImplementedError


def _diagonal(values: Array, columns: slice, n_state: int) -> Array:
    """Return the Jacobian (M, D) whose row m has values[m] in column columns.start + m."""
    jacobian = np.zeros((len(values), n_state))
    np.fill_diagonal(jacobian[:, columns], values)
    return jacobian


@dataclass(frozen=True)
class JointReprojection(Objective):
    """Robust penalty on the distance between projected and detected positions (f1).

    The two rows of a joint are u / sqrt(1 + |u|^2 / c^2), where u = sqrt(confidence) (projected - detected) / sigma_px
    (Geman-McClure as a squared residual). The rows saturate at c, which bounds the pull of a wrong point. Missing
    points have rows of zeros. Joints that the camera cannot project (behind the camera, or outside the lens model) have
    a residual of c, because a zero would reward a solution outside the picture.
    """

    camera: Camera
    xy_px: Array
    """Detections in pixels, shape (T, J, 2), NaN if missing."""
    confidence: Array
    """Confidence of the detections from 0 to 1, shape (T, J)."""
    sigma_px: float
    c: float
    """Limit in standard deviations at which residuals saturate."""
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
        # d(s u) = s (I - s^2 u u' / c^2) du, where s is the factor that shrinks u
        by_u = (shrink * usable[:, None])[..., None] * (
            np.eye(2) - (shrink**2)[..., None] * u[:, :, None] * u[:, None, :] / self.c**2
        )
        jacobian = (by_u * weight[:, None, None]) @ by_point @ pose.joints_jacobian[0]
        residual = np.where((present & ~valid)[:, None], self.c / np.sqrt(2.0), shrink * u)
        return residual.ravel(), jacobian.reshape(residual.size, -1)


@dataclass(frozen=True)
class _Limit(Objective):
    """Penalty on A quantities that exceed their limits, with residuals (size - limit) / softness.

    If `form` is "deadband", only positive residuals count.
    """

    name: str
    columns: slice
    softness_rad: float
    form: Form

    def excess(self, size: Array, slope: Array, limit: Array, n_state: int) -> ResidualAndJacobian:
        """Return the residuals (A,) of sizes (A,) whose derivatives are `slope` (A,), and their Jacobian (A, D)."""
        residual, slope = (size - limit) / self.softness_rad, slope / self.softness_rad
        if self.form == "deadband":
            residual, slope = np.maximum(residual, 0.0), np.where(residual > 0, slope, 0.0)
        return residual, _diagonal(slope, self.columns, n_state)


@dataclass(frozen=True)
class AngleRange(_Limit):
    """Penalty on angles outside their range, (|angle - mean| - tolerance) / softness (f2 for theta, f3 for phi)."""

    ranges: AngleRanges

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        deviation = pose.state[0, self.columns] - self.ranges.mean_rad
        size, slope = np.abs(deviation), np.sign(deviation)
        return self.excess(size, slope, self.ranges.tolerance_rad, pose.state.shape[1])


@dataclass(frozen=True)
class RateLimit(_Limit):
    """Penalty on the speed of a link's tip above the link's length r times max_rate (f4 for theta, f5 for phi).

    If a relative angle changes by a within the interval dt, the tip moves along a chord of 2 r |sin(a / 2)|. "deadband"
    divides this chord by dt and penalises it only beyond the limit, so a link that flips is penalised. "printed" is the
    rate of change of the chord, r |cos(a / 2)| |a| / dt, two-sided. Two errors of the publication are corrected: its
    missing da/dt and its squared limit. The excess is divided by r softness / dt, so that it is
    weighted like an angle over the interval and the length cancels.
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
    """Gaussian prior on A unknowns, with residuals (unknown - mean) / sigma.

    The prior on the base length fixes the metric scale.
    """

    name: str
    columns: slice
    mean: Array | float
    sigma: float

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        residual = (pose.state[0, self.columns] - self.mean) / self.sigma
        return residual, _diagonal(np.full_like(residual, 1.0 / self.sigma), self.columns, pose.state.shape[1])


@dataclass(frozen=True)
class DirectionPrior(Objective):
    """Prior on the direction of one axis of the root, with the residuals (axis - expected) / sigma.

    The residuals refer to the vertical, because the angles of R turn about the camera's axes. These angles measure roll
    only if the animal is seen from the side.
    """

    name: str
    axis: int
    """Index of the root's axis, which is 0 for U (forwards) or 2 for W (lateral)."""
    components: Array
    """Directions (M, 3) onto which the difference between the axis and the expected axis is projected."""
    expected: Array | None
    """Expected unit vectors (T, 3) in the camera frame, NaN where the residuals are 0.

    None stands for the axis in the previous frame. The standard deviation `sigma` then belongs to a random walk over
    one second.
    """
    sigma: float
    euler: slice

    @property
    def ties(self) -> bool:  # type: ignore[override]
        """Return whether the term depends on the pose of the previous frame."""
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
    """Return the expected base length and its standard deviation in metres."""
    nominal = options.base_length_m or chain.nominal_base_length_m
    relative = chain.file.base_length.sigma_m / chain.nominal_base_length_m
    return nominal, options.base_sigma_m or relative * nominal


def frame_objectives(
    camera: Camera, chain: UnknownsChain, xy_px: Array, confidence: Array, travel: Travel, options: FrameOptions
) -> tuple[Objective, ...]:
    """Return the objectives f1 to f5, the prior on the base length, and the Gaussian priors if they are on.

    Parameters
    ----------
    camera, chain
        Camera of the clip, and the chain that is fitted.
    xy_px
        Detections (T, J, 2) in pixels; NaN if missing.
    confidence
        Confidence (T, J) of the detections.
    travel
        Direction of travel in each frame.
    options
        Options of the fit.

    Returns
    -------
    tuple
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
