"""The frame method, a reference: what was published, repaired where it has to be.

It solves the 21 unknowns of the 8U chain one frame after the other with scipy's Levenberg-Marquardt
(`least_squares(method="lm")`, MINPACK) on the stacked residuals of all objectives. A frame starts from the solution of
the frame before, its place carried on along its path; the first starts from geometry alone, the direction of travel and
a rough placement of the chain. Frames whose solution leaves points unexplained get further starts, and the lowest cost
wins.

The mean pose is put at the detections' bearings (`recon.fit.starts`), over many headings and all frames of a
stretch: the heading is chosen whose chain fits and which agrees with the path that it implies.

Each term of the least-squares problem is one small class. It reads the pose of one frame and, if it `ties` frames, that
of the one before, which is held. It gives a residual without unit (differences divided by a standard deviation) with
its exact Jacobian. With M rows and D unknowns:

    evaluate(now, before, frame, dt_s) -> residual (M,), jacobian (M, D) by the state of now

now and before are a Posed of one state each, before None at the start; frame is the row number of the clip, dt_s the
time between the two. A new term is one class here and one line in the tests' list.

f1 to f5 and their names are those of C. van der Leek, MSc(Eng), University of Cape Town, 2022. `form` chooses between
what is meant, a penalty outside the range only ("deadband"), and the two-sided penalty as published ("printed"), which
pulls towards the edge of the range. The Gaussian priors are needed besides, because one frame's pixels leave the scale,
a roll of the chain about its axis and one mode of depth undetermined, and depth flips of every link.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import least_squares

from recon.animal.body import MIN_JOINTS, MIN_REACH_PX
from recon.animal.chain import AngleRanges, Chain, ChainPose, euler_angles, upright_rotation
from recon.base.arrays import Array, Index, median
from recon.check import Finding, finding
from recon.clip import View
from recon.fit.motion import Motion
from recon.fit.result import OUTLIER_SIGMAS, MotionSegment, Solution
from recon.fit.starts import constant_velocity, position_on_rays
from recon.geometry.camera import Camera
from recon.geometry.frames import inverse, level_axes, moved
from recon.geometry.kinematics import ROLL, YAW

# -- the terms -------------------------------------------------------------------------------------------------------

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


# -- the method ------------------------------------------------------------------------------------------------------

Status = Literal["converged", "not_converged", "no_data"]

CONVERGED = (1, 2, 3, 4)
"""Status values of scipy's least_squares that name a tolerance that was met."""

FEW_POINTS_SHARE = 0.75
"""Frames with a smaller part of the joints detected are flagged "few points"."""
GOOD_SHARE = 1 / 3
"""Frames with a smaller part of the joints detected and trusted are flagged "data poor"."""
WARN_LIMITS = 0.25
"""Share of the solved frames from which angles beyond their ranges are a finding."""
MOST_SIZE = 10.0
"""A base length so many times larger or smaller than expected is no animal's."""
PLAIN_C = 1e6
"""In place of `FrameOptions.robust_c` where f1 is as printed: nothing saturates."""


@dataclass(frozen=True)
class FrameOptions:
    """How the frame method weighs and searches.

    form: of f2-f5, see the terms. reprojection: f1 robust and weighted by confidence, or as
    printed. angle_prior: the Gaussian priors on angles, roll and heading, or none of them. camera_rotation: "fixed"
    holds R at the first frame's. base_length_m, base_sigma_m: in place of the skeleton's. sigma_px: the detector's
    noise; keypoint_sigma_m: how far keypoints lie from the model's joints, in place of the skeleton's, and at most
    keypoint_sigma_max_px in the picture. robust_c: residuals of this many sigmas count half. max_evaluations: of
    the residuals, in one search.
    """

    form: Form = "deadband"
    reprojection: Literal["robust", "printed"] = "robust"
    angle_prior: Literal["gaussian", "none"] = "gaussian"
    camera_rotation: Literal["free", "fixed"] = "free"
    base_length_m: float | None = None
    base_sigma_m: float | None = None
    sigma_px: float = 3.0
    keypoint_sigma_m: float | None = None
    keypoint_sigma_max_px: float = 12.0
    robust_c: float = 4.5
    tolerance: float = 1e-8
    max_evaluations: int = 400

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> FrameOptions:
        """The options among the settings of a fit, as a motion keeps them."""
        given = {field.name: settings.get(field.name) for field in fields(cls)}
        return cls(**{name: value for name, value in given.items() if value is not None})


@dataclass(frozen=True)
class _FrameReport:
    """What the optimiser did for one frame; all residuals are without unit."""

    status: Status
    starts: int
    """How many were solved."""
    iterations: int
    """Levenberg-Marquardt iterations of the start that won, counted by their Jacobian evaluations; these and the
    function evaluations include its approach with a wide loss."""
    function_evaluations: int
    optimizer_status: int
    """The status of scipy's least_squares."""
    squared_norm: float
    cost_shares: dict[str, float]
    """Each term's part of the squared norm."""
    step_norm: float
    """Length of the last step."""
    sigma_px: float
    """Standard deviation of a detection."""
    data_share: Array
    """(D,): the part of the posterior precision that comes from the pixels, 0 to 1, NaN where data and priors together
    leave an unknown undetermined."""
    mean_weight: float
    """How far the detections were trusted, 0 to 1."""
    solve_s: float
    """Time spent on the frame, all starts."""
    in_view: bool
    """The camera can see the pose, and it has an animal's size; a pose that diverged is not converged, not part of the
    solution, and has no shares and covariance (NaN)."""


@dataclass(frozen=True, eq=False, repr=False)
class FrameSolution(Solution):
    """A solution of the frame method, with D unknowns of the chain. Covariances are given the frame before."""

    chain: Chain
    chain_states: Array
    """(T, D): as published (`recon.animal.chain`), NaN where a frame has no data or its pose diverged."""
    reports: tuple[_FrameReport | None, ...]
    """One a frame, None without data."""
    travel: Travel
    """What the start came from."""
    objectives: tuple[str, ...]
    fps: float

    method: ClassVar = "frame"
    described_by: ClassVar = "recon.thesis.clip"
    jitters: ClassVar = True

    @property
    def constant_velocity_m_s(self) -> Array:
        return self.travel.speed_m_s

    def reported(self, field: str) -> Array:
        """(T,): what is reported of each frame, NaN without data."""
        return np.array([np.nan if one is None else getattr(one, field) for one in self.reports], dtype=float)

    def unknown(self, name: str) -> Array:
        """(T,): one of the chain's unknowns, NaN without a pose."""
        return self.chain_states[:, self.chain.state_names.index(name)]

    @cached_property
    def status(self) -> tuple[Status, ...]:
        """The status of each of the T frames: converged, not_converged or no_data."""
        return tuple("no_data" if r is None else r.status for r in self.reports)

    def findings(self) -> tuple[Finding, ...]:
        """Findings on frames that were not solved well."""
        total, failed = len(self.flags), self.status.count("not_converged")
        solved, found = total - self.status.count("no_data"), []
        if failed:
            found.append(finding("frames_not_converged", count=failed, frames_total=total))
        at_limit = sum("at range limit" in flags for flags in self.flags)
        if at_limit > WARN_LIMITS * solved:
            found.append(finding("at_range_limits", count=at_limit, frames_total=solved))
        return tuple(found)

    def _expected(self, field: str) -> Array:
        """(2 A,): what the skeleton expects of theta and phi."""
        return np.concatenate([getattr(ranges, field) for ranges in (self.chain.theta, self.chain.phi)])

    @cached_property
    def beyond_range_rad(self) -> Array:
        """(T, 2 A): how far angles lie beyond their expected ranges; negative inside, NaN without a pose."""
        angles = self.chain_states[:, : 2 * self.chain.n_angles]
        return np.abs(angles - self._expected("mean_rad")) - self._expected("tolerance_rad")

    @cached_property
    def beyond_rate_rad_s(self) -> Array:
        """(T, 2 A): chord rate since the solved frame before, above its limit; NaN for the first and without a pose."""
        angles = self.chain_states[:, : 2 * self.chain.n_angles]
        rows = np.flatnonzero(np.isfinite(angles[:, 0]))
        beyond = np.full(angles.shape, np.nan)
        chord = 2 * np.abs(np.sin(np.diff(angles[rows], axis=0) / 2)) * self.fps / np.diff(rows)[:, None]
        beyond[rows[1:]] = chord - self._expected("max_rate_rad_s")
        return beyond


def frame_solution(motion: Motion) -> FrameSolution:
    """The solution of a motion that the frame method found."""
    assert isinstance(motion.solution, FrameSolution)
    return motion.solution


def frame_objectives(
    camera: Camera, chain: Chain, xy_px: Array, confidence: Array, travel: Travel, options: FrameOptions
) -> tuple[Objective, ...]:
    """f1-f5, the prior of the base length, and the Gaussian priors if they are on. Reprojection comes first.

    xy_px (T, J, 2), NaN where missing; confidence (T, J).
    """
    softness_rad, prior, form, up = chain.file.softness_rad, chain.file.prior, options.form, camera.up
    printed = options.reprojection == "printed"
    weights, robust_c = (np.ones_like(confidence), PLAIN_C) if printed else (confidence, options.robust_c)
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
        moving = np.where(travel.speed_m_s[:, None] > 0, travel.heading, np.nan)
        terms += [
            GaussianPrior("theta prior", chain.theta_slice, chain.theta.mean_rad, prior.theta_sigma_rad),
            GaussianPrior("phi prior", chain.phi_slice, chain.phi.mean_rad, prior.phi_sigma_rad),
            DirectionPrior("roll prior", 2, up[None], np.zeros_like(moving), prior.roll_sigma_rad, euler),
            DirectionPrior("heading tie", 0, level, None, prior.heading_sigma_rad_per_sqrt_s, euler),
            DirectionPrior("travel prior", 0, level, moving, prior.travel_sigma_rad, euler),
        ]
    return tuple(terms)


def base_length(chain: Chain, options: FrameOptions) -> tuple[float, float]:
    """Nominal value and standard deviation of the base length, metres."""
    nominal = options.base_length_m or chain.nominal_base_length_m
    relative = chain.file.base_length.sigma_m / chain.nominal_base_length_m
    return nominal, options.base_sigma_m or relative * nominal


def solve_frames(
    view: View,
    chain: Chain,
    fps: float,
    options: FrameOptions,
    progress: Callable[[int], None] = lambda frame: None,
) -> FrameSolution:
    """Fit the chain frame by frame to what a still camera saw: keypoints in the order of its joints, frames fps apart.

    Never raises for a frame that cannot be solved: its report says so. Detections that no detector can have found in
    the camera's picture are left out (`Camera.sees`). progress is called with the count of frames, the one in hand
    included.
    """
    view = view.mask_outside_image()
    solver = FrameSolver(view, chain, fps, options)
    covariance = np.full((*solver.states.shape, chain.n_state), np.nan)
    reports: list[_FrameReport | None] = []
    for frame, seen in enumerate(np.isfinite(solver.rays[..., 0]).sum(axis=1)):
        progress(frame + 1)
        if seen < MIN_JOINTS:
            reports.append(None)
            continue
        state, C, report = solver.solve(frame)
        reports.append(report)
        if report.in_view:  # a pose that diverged is no start for the next frame
            solver.states[frame], covariance[frame] = state, C
    names = tuple(term.name for term in solver.objectives)
    told = {"reports": tuple(reports), "travel": solver.travel, "objectives": names, "fps": fps}
    return in_world(view, chain, solver.states, covariance, **told)


def in_world(view: View, chain: Chain, states: Array, covariance: Array, **told: Any) -> FrameSolution:
    """What was solved, in the world. states (T, D) and their covariance (T, D, D) are the chain's; told: reports,
    travel, objectives and fps of the solution."""
    (T, J), reports = view.present.shape, told["reports"]
    T_world_camera = inverse(view.T_camera_world)
    posed = chain.pose_with_jacobian(states)
    assert posed.joints_jacobian is not None
    by_state = T_world_camera[:3, :3] @ posed.joints_jacobian
    absolute, relative = (
        np.einsum("tjad,tde,tjbe->tjab", jacobian, covariance, jacobian, optimize=True)
        for jacobian in (by_state, by_state - by_state.mean(axis=1, keepdims=True))
    )
    body_states, sizes = chain.to_body(states, T_world_camera)
    shares = np.array([np.full(chain.n_state, np.nan) if r is None else r.data_share for r in reports])
    angle_sigma, angle_share = _of_angles(chain, states, covariance, shares, T_world_camera)
    sigma_px, trusted = (
        np.array([np.nan if r is None else getattr(r, field) for r in reports]) for field in ("sigma_px", "mean_weight")
    )
    found = FrameSolution(
        body=chain.body,
        views=(view,),
        states=body_states,
        size=median(sizes) if np.isfinite(sizes).any() else 1.0,
        joints_m=moved(T_world_camera, posed.joints_m),
        covariance_m2=absolute,
        relative_covariance_m2=relative,
        angle_sigma_rad=angle_sigma,
        angle_data_share=angle_share,
        noise_px=np.repeat(sigma_px[None, :, None], J, axis=2),
        weight=np.where(view.present, trusted[:, None], np.nan)[None],
        flags=(),
        alternative_m=np.full(T, np.nan),  # of all starts only the best is kept
        contact=np.zeros((T, len(chain.body.feet))),
        segments=(MotionSegment(slice(0, T), None),),
        stage_s={},
        chain=chain,
        chain_states=states,
        **told,
    )
    return replace(found, flags=_flags(found))


def _of_angles(
    chain: Chain, states: Array, covariance: Array, shares: Array, T_world_camera: Array
) -> tuple[Array, Array]:
    """Standard deviations and the pixels' shares (N, D' - 3) of the body's angles, from the chain's states (N, D),
    their covariance (N, D, D) and shares (N, D). The root's rotation follows the Euler angles: its shares are theirs,
    weighted by what they contribute to its variance."""
    angles, step = np.arange(2 * chain.n_angles), 1e-6
    by_state = np.zeros((len(states), chain.body.n_state - YAW, chain.n_state))
    by_state[:, chain.body_angles - YAW, angles] = 1.0
    for k in range(chain.n_state)[chain.euler_slice]:
        unit = step * np.eye(chain.n_state)[k]
        before, after = (
            chain.to_body(end, T_world_camera)[0][:, YAW : ROLL + 1] for end in (states - unit, states + unit)
        )
        by_state[:, :3, k] = (np.mod(after - before + np.pi, 2 * np.pi) - np.pi) / (2 * step)
    weight = by_state**2 * np.diagonal(covariance, axis1=1, axis2=2)[:, None]
    variance = np.einsum("nik,nkl,nil->ni", by_state, covariance, by_state)
    return np.sqrt(variance), np.sum(weight * shares[:, None], axis=2) / np.sum(weight, axis=2)


def _flags(solution: FrameSolution) -> tuple[tuple[str, ...], ...]:
    """What is doubtful about each of the T frames."""
    (view,), reports, J = solution.views, solution.reports, len(solution.chain.joints)
    sigma_px, trusted = solution.noise_px[0], solution.reported("mean_weight")
    present = view.present.sum(axis=1)
    off_px = np.linalg.norm(view.project(solution.joints_m)[0] - view.xy_px, axis=-1)
    doubtful = {
        "no data": [r is None for r in reports],
        "diverged": [r is not None and not r.in_view for r in reports],
        "few points": [r is not None for r in reports] & (present < FEW_POINTS_SHARE * J),
        "data poor": present * trusted < GOOD_SHARE * J,
        "outliers": (off_px > OUTLIER_SIGMAS * sigma_px).any(axis=1),
        "not converged": [status == "not_converged" for status in solution.status],
        "at range limit": (solution.beyond_range_rad > 0).any(axis=1),
        "at rate limit": (solution.beyond_rate_rad_s > 0).any(axis=1),
    }
    return tuple(tuple(name for name, which in doubtful.items() if which[t]) for t in range(len(reports)))


# -- one frame after the other ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FrameProblem:
    """The least-squares problem of one frame, of whose unknowns x (D,) the residuals are functions."""

    chain: Chain
    terms: tuple[Objective, ...]
    """Reprojection comes first."""
    frame: int
    """The row of the clip."""
    previous: ChainPose | None
    """The frame before, dt_s earlier, which is held; None for terms that read this frame only."""
    dt_s: float

    def by_term(self, x: Array) -> dict[str, tuple[Array, Array]]:
        """By term its residuals (M,) and their Jacobian (M, D)."""
        now = self.chain.pose_with_jacobian(x[None])
        return {term.name: term.evaluate(now, self.previous, self.frame, self.dt_s) for term in self.terms}

    def at(self, x: Array) -> tuple[Array, Array]:
        """The same of all terms, stacked."""
        residuals, jacobians = zip(*self.by_term(x).values(), strict=True)
        return np.concatenate(residuals), np.concatenate(jacobians)

    @property
    def pixels(self) -> JointReprojection:
        first = self.terms[0]
        assert isinstance(first, JointReprojection)
        return first

    def with_noise(self, sigma_px: float) -> FrameProblem:
        """With another standard deviation of the detections."""
        return replace(self, terms=(replace(self.pixels, sigma_px=sigma_px), *self.terms[1:]))

    def sigmas_off(self, x: Array) -> Array:
        """(n,) from the frame's detections to the reprojections in standard deviations, infinite where a joint cannot
        be projected."""
        pixels, valid = self.pixels.camera.project(self.chain.pose(x[None]).joints_m[0])
        detected = self.pixels.xy_px[self.frame]
        off = np.where(valid, np.linalg.norm(pixels - detected, axis=1), np.inf)
        return off[np.isfinite(detected[:, 0])] / self.pixels.sigma_px

    def in_view(self, x: Array) -> bool:
        """Whether every detected joint can be projected, and the animal has a size (MOST_SIZE) and is near enough to be
        seen (MIN_REACH_PX)."""
        base, nominal = float(x[self.chain.base_index]), self.chain.nominal_base_length_m
        if not nominal / MOST_SIZE < base < nominal * MOST_SIZE:
            return False
        depth = float(np.median(self.chain.pose(x[None]).joints_m[0, :, 2]))
        reach = sum(link.length_ratio for link in self.chain.links) * base * _focal_px(self.pixels.camera)
        return reach > MIN_REACH_PX * depth and bool(np.all(np.isfinite(self.sigmas_off(x))))


@dataclass(frozen=True, eq=False)
class FrameSearch:
    """The way of one frame from a start to its minimum, K accepted points, the approach with a wide loss included."""

    problem: FrameProblem
    cost: float
    """Half the squared residuals at the minimum."""
    status: int
    """The status of scipy's least_squares."""
    evaluations: int
    iterations: int
    points: Array
    """(K, D), from the start on."""
    evaluations_at: Index
    """(K,): of the residuals, when the point was accepted."""
    sigma_px: Array
    """(K,): of the loss that the step from there had, the last ones' the detections' own."""

    @property
    def x(self) -> Array:
        return self.points[-1]

    @property
    def step_norm(self) -> float:
        """Length of the last step that moved something."""
        moves = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return float(np.append(0.0, moves[moves > 0])[-1])

    def after(self, earlier: FrameSearch) -> FrameSearch:
        """With the way that led to its start."""
        spent = earlier.evaluations_at[-1]
        return replace(
            self,
            evaluations=earlier.evaluations + self.evaluations,
            iterations=earlier.iterations + self.iterations,
            points=np.concatenate([earlier.points[:-1], self.points]),
            evaluations_at=np.concatenate([earlier.evaluations_at[:-1], spent + self.evaluations_at]),
            sigma_px=np.concatenate([earlier.sigma_px[:-1], self.sigma_px]),
        )

    @cached_property
    def costs(self) -> Array:
        """(K,): half the squared residuals, of the last loss."""
        return np.array([0.5 * float(np.sum(self.problem.at(x)[0] ** 2)) for x in self.points])

    @cached_property
    def damping(self) -> Array:
        """(K - 1,): lambda of the step from each point, (J'J + lambda S) step = -J'r, S with the largest squared norms
        that columns of J have had: MINPACK's, found from the step that it took."""
        damping, scale, sigma_px = [], np.zeros(self.points.shape[1]), 0.0
        for x, step, own_px in zip(self.points, np.diff(self.points, axis=0), self.sigma_px, strict=False):
            r, J = self.problem.with_noise(own_px).at(x)
            scale = np.maximum(scale if own_px == sigma_px else 0.0, np.sum(J**2, axis=0))
            scaled, sigma_px = np.where(scale > 0, scale, 1.0) * step, own_px
            damping.append(max(float(-(scaled @ J.T @ (r + J @ step)) / max(float(scaled @ scaled), 1e-300)), 0.0))
        return np.array(damping)


class FrameSolver:
    """Solves a clip frame by frame. states (T, D) are those that it has found, or had found before, NaN elsewhere."""

    def __init__(
        self, view: View, chain: Chain, fps: float, options: FrameOptions, states: Array | None = None
    ) -> None:
        view = view.mask_outside_image()
        nominal, sigma = base_length(chain, options)
        self.chain, self.options = replace(chain, nominal_base_length_m=nominal), replace(options, base_sigma_m=sigma)
        self.camera, self.fps = view.camera, fps
        self.states = np.full((len(view.xy_px), chain.n_state), np.nan) if states is None else states
        self.rays, _ = view.camera.rays(view.xy_px)
        self.travel = estimate_travel(view.camera, self.chain, view.xy_px, fps)
        self.objectives = frame_objectives(
            view.camera, self.chain, view.xy_px, view.confidence, self.travel, self.options
        )

    def before(self, frame: int) -> list[int]:
        """The last two solved frames, newest last."""
        return np.flatnonzero(np.isfinite(self.states[:frame, 0]))[-2:].tolist()

    def problem(self, frame: int, sigma_px: float) -> FrameProblem:
        """A frame's problem with its noise; without a frame before, no ties to it."""
        if before := self.before(frame):
            previous, dt_s = self.chain.pose(self.states[before[-1]][None]), (frame - before[-1]) / self.fps
        else:
            previous, dt_s = None, 1.0 / self.fps
        terms = tuple(term for term in self.objectives if previous is not None or not term.ties)
        return FrameProblem(self.chain, terms, frame, previous, dt_s).with_noise(sigma_px)

    def solve(self, frame: int) -> tuple[Array, Array, _FrameReport]:
        """State (D,), its covariance (D, D) given the frame before, and what was done."""
        began = time.perf_counter()
        best, starts = self.search(frame)
        problem, parts = best.problem, best.problem.by_term(best.x)
        costs = {name: float(np.sum(r**2)) for name, (r, _) in parts.items()}
        total, in_view = sum(costs.values()), problem.in_view(best.x)
        C = posterior_covariance(np.concatenate([J for _, J in parts.values()]))
        C = C if in_view else np.full_like(C, np.nan)
        far = problem.sigmas_off(best.x)
        report = _FrameReport(
            status="converged" if best.status in CONVERGED and in_view else "not_converged",
            starts=starts,
            iterations=best.iterations,
            function_evaluations=best.evaluations,
            optimizer_status=best.status,
            squared_norm=total,
            cost_shares={name: cost / total if total > 0 else 0.0 for name, cost in costs.items()},
            step_norm=best.step_norm,
            sigma_px=problem.pixels.sigma_px,
            data_share=precision_shares(C, parts[problem.pixels.name][1]),
            mean_weight=float(np.mean((1.0 + (far / self.options.robust_c) ** 2) ** -2.0)) if in_view else np.nan,
            solve_s=time.perf_counter() - began,
            in_view=in_view,
        )
        return best.x, C, report

    def search(self, frame: int) -> tuple[FrameSearch, int]:
        """The best of the minima, and from how many starts."""
        rays, heading, before = self.rays[frame], self.travel.heading[frame], self.before(frame)
        starts = [self._carried_on(frame, before)] if before else self._first_starts(rays, heading)
        problem = self.problem(frame, self._noise_px(starts[0]))
        tried = [self._solve_from(start, problem) for start in starts]
        # Converged, and no detection further off than c sigma: nothing is left to explain.
        within = problem.sigmas_off(tried[0].x) < self.options.robust_c
        if before and not (tried[0].status in CONVERGED and within.all()):
            more = self._more_starts(rays, heading, self.states[before[-1]])
            tried += [self._solve_from(start, problem) for start in more]
        # The lowest cost among the poses that the camera can see, or among all if it can see none.
        return min(tried, key=lambda one: (not one.problem.in_view(one.x), one.cost)), len(tried)

    # -- starts ---------------------------------------------------------------------------------------------------

    def _first_starts(self, rays: Array, heading: Array) -> list[Array]:
        """The mean pose along the direction of travel, and turned half a radian to either side of it."""
        across = np.cross(self.camera.up, heading)
        return [
            geometric_start(self.camera, self.chain, rays, np.cos(turn) * heading + np.sin(turn) * across)
            for turn in (0.0, 0.5, -0.5)
        ]

    def _carried_on(self, frame: int, before: Sequence[int]) -> Array:
        """The state before, its root moved on along its path. The place R p0 is moved, never p0: R turns it."""
        last = self.chain.pose(self.states[before])
        place = last.joints_m[-1, 0]
        if len(before) == 2:
            place = place + (place - last.joints_m[0, 0]) * (frame - before[1]) / (before[1] - before[0])
        return self._placed(self.states[before[-1]], place if place[2] > 0 else last.joints_m[-1, 0])

    def _more_starts(self, rays: Array, heading: Array, last: Array) -> list[Array]:
        """The mean pose along the direction of travel, and the last pose where the rays put that."""
        mean = geometric_start(self.camera, self.chain, rays, heading)
        if self.options.camera_rotation == "fixed":
            mean[self.chain.euler_slice] = last[self.chain.euler_slice]
        place = self.chain.pose(mean[None]).joints_m[0, 0]
        return [mean, self._placed(last, place)]

    def _placed(self, state: Array, place_m: Array) -> Array:
        moved = state.copy()
        moved[self.chain.place_slice] = self.chain.pose(state[None]).rotation[0].T @ place_m
        return moved

    def _noise_px(self, start: Array) -> float:
        """Standard deviation of a detection: the detector's noise and, at a start's distance, the keypoints'."""
        o = self.options
        depth = max(float(self.chain.pose(start[None]).joints_m[0, :, 2].mean()), 0.1)
        keypoint_m = self.chain.file.keypoint_sigma_m if o.keypoint_sigma_m is None else o.keypoint_sigma_m
        return float(np.hypot(o.sigma_px, min(keypoint_m * _focal_px(self.camera) / depth, o.keypoint_sigma_max_px)))

    # -- one optimisation -----------------------------------------------------------------------------------------

    def _solve_from(self, start: Array, problem: FrameProblem) -> FrameSearch:
        """The minimum from one start, approached with a wide loss where the start is far off for the noise.

        Geman-McClure residuals beyond c sigma hardly pull: a start that far off would stay there.
        """
        off = float(np.nanmedian(problem.sigmas_off(start)))
        if off <= self.options.robust_c / 2:
            return self._minimise(start, problem, self.options.tolerance)
        wide = problem.pixels.sigma_px * (min(off, 50.0) if np.isfinite(off) else 10.0)
        near = self._minimise(start, problem.with_noise(wide), tolerance=1e-3)
        return self._minimise(near.x, problem, self.options.tolerance).after(near)

    def _minimise(self, start: Array, problem: FrameProblem, tolerance: float) -> FrameSearch:
        free = np.ones(self.chain.n_state, dtype=bool)
        if self.options.camera_rotation == "fixed" and problem.previous is not None:
            free[self.chain.euler_slice] = False
        x, last, evaluations = start.copy(), (start, start, start), 0
        steps: list[Array] = []
        counts: list[int] = []

        def residual(y: Array) -> Array:
            nonlocal evaluations, last
            evaluations += 1
            x[free] = y
            last = y.copy(), *problem.at(x)
            return last[1]

        def jacobian(y: Array) -> Array:
            # MINPACK asks for the Jacobian at accepted points only: their differences are the steps taken.
            steps.append(y.copy())
            counts.append(evaluations)
            if not np.array_equal(last[0], y):
                residual(y)
            return last[2][:, free]

        tolerance = max(tolerance, float(np.finfo(float).eps))  # less is the same to MINPACK
        result = least_squares(
            residual,
            start[free],
            jacobian,  # type: ignore[arg-type]  # the stubs want a function of any array type
            method="lm",
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=tolerance,
            max_nfev=self.options.max_evaluations,
        )
        if not np.array_equal(steps[-1], result.x):
            steps.append(result.x)
            counts.append(evaluations)
        points = np.tile(start, (len(steps), 1))
        points[:, free] = steps
        spent = int(result.nfev), int(result.njev or 0)
        noise_px = np.full(len(points), problem.pixels.sigma_px)
        return FrameSearch(problem, float(result.cost), int(result.status), *spent, points, np.array(counts), noise_px)


def _focal_px(camera: Camera) -> float:
    return float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))


def posterior_covariance(J: Array) -> Array:
    """(D, D): C = (J'J)^-1 for the Jacobian J (M, D) of all residuals; all NaN where J'J is singular."""
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-12)
    values, vectors = eigh((J / scale).T @ (J / scale))
    if values[0] < 1e-10 * values[-1]:
        return np.full((J.shape[1], J.shape[1]), np.nan)
    return (vectors / values) @ vectors.T / np.outer(scale, scale)


def precision_shares(C: Array, J_data: Array) -> Array:
    """(D,): what the pixels contribute to the unknowns.

    With C^-1 = H_data + H_priors, C = C H_data C + C H_priors C splits every variance of the posterior covariance
    C (D, D) into two non-negative parts; the share is the first one's. J_data: the reprojection's rows of the Jacobian.
    All NaN where C is.
    """
    return np.clip(np.diag(C @ (J_data.T @ J_data) @ C) / np.diag(C), 0, 1)


# -- where it starts ---------------------------------------------------------------------------------------------------

_HEADINGS = 36
_STRETCH_S = 1.0
_MIN_SPEED_M_S = 1.0
_MIN_STRETCH_S = 0.15
"""Slower, or over a shorter time (half a stride), the path says nothing about the heading."""


@dataclass(frozen=True)
class Travel:
    """heading (T, 3): level unit vector in the camera frame, the way the animal faces; speed_m_s (T,): along its path,
    0 where it is too slow or too rarely seen to have one."""

    heading: Array
    speed_m_s: Array


def mean_pose(chain: Chain) -> Array:
    """State (D,) with expected angles and nominal size, at the origin."""
    state = np.zeros(chain.n_state)
    state[chain.theta_slice] = chain.theta.mean_rad
    state[chain.phi_slice] = chain.phi.mean_rad
    state[chain.base_index] = chain.nominal_base_length_m
    return state


def estimate_travel(camera: Camera, chain: Chain, xy_px: Array, fps: float) -> Travel:
    """Heading and speed over the clip from detections (T, J, 2), about one second of straight path at a time.

    Stretches without five joints in at least five frames take the heading of the nearest stretch that has them.
    """
    T = len(xy_px)
    rays, _ = camera.rays(xy_px)
    usable = np.isfinite(rays[..., 0]).sum(axis=1) >= MIN_JOINTS
    right, away = level_axes(camera.up)
    angle = 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    headings = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * away
    shapes = chain.local_joints(mean_pose(chain)[None])[0] @ upright_rotation(headings, camera.up).transpose(0, 2, 1)

    stretches = np.array_split(np.arange(T), max(1, round(T / fps / _STRETCH_S)))
    found = np.full((len(stretches), 4), np.nan)
    for s, rows in enumerate(stretches):
        rows = rows[usable[rows]]
        if len(rows) >= MIN_JOINTS:
            found[s] = _stretch_travel(headings, shapes, camera.up, rays[rows], rows / fps)
    known = np.flatnonzero(np.isfinite(found[:, 0]))
    if len(known) == 0:
        return Travel(np.tile(right, (T, 1)), np.zeros(T))
    nearest = known[np.argmin(np.abs(np.arange(len(stretches))[:, None] - known), axis=1)]
    speed = np.where(np.isfinite(found[:, 3]), found[:, 3], 0.0)
    lengths = [len(rows) for rows in stretches]
    return Travel(np.repeat(found[nearest, :3], lengths, axis=0), np.repeat(speed, lengths))


def _stretch_travel(headings: Array, shapes: Array, up: Array, rays: Array, time_s: Array) -> Array:
    """(4,): heading and speed of one stretch; the speed is NaN where it says nothing.

    For every heading the mean pose runs straight ahead, with a constant acceleration and a slope of the ground; the
    heading whose run fits all the rays best decides. It is seen in the shape's foreshortening and in the path alike.
    """
    time_s = time_s - time_s.mean()
    misfit, runs = constant_velocity(headings, shapes, up, rays, time_s)
    speeds = np.abs(runs[:, 3])
    best = int(np.argmin(misfit))
    # The minimum between grid points, from the parabola through the best three.
    left, here, right = misfit[[best - 1, best, (best + 1) % len(headings)]]
    bend = left - 2 * here + right
    turn = 0.5 * (left - right) / bend * 2 * np.pi / len(headings) if bend > 0 else 0.0
    heading = np.cos(turn) * headings[best] + np.sin(turn) * np.cross(up, headings[best])
    moves = speeds[best] >= _MIN_SPEED_M_S and np.ptp(time_s) >= _MIN_STRETCH_S
    return np.append(heading, speeds[best] if moves else np.nan)


def geometric_start(camera: Camera, chain: Chain, rays: Array, heading: Array) -> Array:
    """State (D,): the mean pose facing `heading` (3,), placed on one frame's rays (J, 3)."""
    state = mean_pose(chain)
    rotation = upright_rotation(heading, camera.up)
    place = position_on_rays(chain.local_joints(state[None])[0] @ rotation.T, rays[None])
    # Contradictory rays can meet behind the camera; the solver needs a start that is in view.
    in_front = place[0] if place[0, 2] > 0 else -place[0]
    state[chain.place_slice] = rotation.T @ in_front
    state[chain.euler_slice] = euler_angles(rotation)
    return state
