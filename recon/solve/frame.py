"""Objectives -> states: the only place that calls an optimiser.

The frame method solves the 21 unknowns of the 8U chain one frame after the other with scipy's Levenberg-Marquardt
(`least_squares(method="lm")`, MINPACK) on the stacked residuals of all objectives. A frame starts from the solution of
the frame before, its place carried on along its path; the first starts from geometry (`recon.initialise`). Frames whose
solution leaves points unexplained get further starts, and the lowest cost wins.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from recon.camera import Camera
from recon.initialise import Travel, estimate_travel, geometric_start, state_from_joints
from recon.objectives import (
    AnglePrior,
    AngleRange,
    BaseLengthPrior,
    Form,
    HeadingTie,
    JointPositions,
    Objective,
    RateLimit,
    Reprojection,
    RollPrior,
    TravelPrior,
)
from recon.skeleton import MIN_JOINTS, MIN_REACH_PX, Posed, Skeleton

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

Array = NDArray[np.float64]
Status = Literal["converged", "not_converged", "no_data"]

CONVERGED = (1, 2, 3, 4)
"""Status values of scipy's least_squares that name a tolerance that was met."""

MOST_SIZE = 10.0
"""A base length so many times larger or smaller than expected is no animal's."""
SPARE_SEARCHES = 4
"""A clip may take `FrameOptions.max_evaluations` for each of its frames, and so many times that for all of them."""


@dataclass(frozen=True)
class FrameOptions:
    """How the frame method weighs and searches.

    form: of f1-f5, see `recon.objectives`. angle_prior: the Gaussian priors on angles, roll and heading, or none of
    them. camera_rotation: "fixed" holds R at the first frame's. base_length_m, base_sigma_m: in place of the
    skeleton's. sigma_px: the detector's noise; keypoint_sigma_m: how far keypoints lie from the model's joints, in
    place of the skeleton's, and at most keypoint_sigma_max_px in the picture. robust_c: residuals of this many sigmas
    count half. max_evaluations: of the residuals, in one search, and a frame on average (`SPARE_SEARCHES`).
    """

    form: Form = "deadband"
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


@dataclass(frozen=True)
class FrameReport:
    """What the optimiser did for one frame (all residuals without unit).

    starts: how many starts were solved. iterations: Levenberg-Marquardt iterations of the start that won, counted by
    their Jacobian evaluations; these and the function evaluations include its approach with a wide loss. cost_shares:
    each term's part of the squared norm. sigma_px: standard deviation of a detection. data_share (D,) and
    joint_data_share (J,): the part of the posterior precision that comes from the pixels, 0 to 1, NaN where data and
    priors together leave a quantity undetermined. joint_sigma_m (J, 3): posterior standard deviation in the camera
    frame, given the frame before. mean_weight: how far the detections were trusted, 0 to 1. place_sigma_m: standard
    deviation of the mean of all joints along the line of sight; relative_rms_m: what is expected of a joint's distance
    from its true place once both poses are centred, root mean square over the joints. solve_s: time spent on the frame,
    all starts. in_view: the camera can see the pose, and it has an animal's size; a pose that ran away is not
    converged, not part of the solution, and has no shares and sigmas (NaN). stopped: the evaluations that the clip may
    take up to this frame were spent before the frame's searches ended.
    """

    status: Status
    starts: int
    iterations: int
    function_evaluations: int
    jacobian_evaluations: int
    optimizer_status: int
    message: str
    squared_norm: float
    mean_residual: float
    cost_shares: dict[str, float]
    optimality: float
    step_norm: float
    jacobian_mean_abs: float
    jacobian_sparsity: float
    gradient: Array
    sigma_px: float
    data_share: Array
    joint_data_share: Array
    joint_sigma_m: Array
    mean_weight: float
    place_sigma_m: float
    relative_rms_m: float
    solve_s: float
    in_view: bool
    stopped: bool


@dataclass(frozen=True)
class Solution:
    """states (T, D), NaN where a frame has no data or its pose ran away; one report a frame, None without data; the
    travel that the start came from."""

    states: Array
    reports: tuple[FrameReport | None, ...]
    travel: Travel
    objectives: tuple[str, ...]


def frame_objectives(
    camera: Camera, skeleton: Skeleton, xy_px: Array, confidence: Array, travel: Travel, options: FrameOptions
) -> tuple[Objective, ...]:
    """f1-f5, the prior of the base length, and the Gaussian priors if they are on. Reprojection comes first.

    xy_px (T, J, 2), NaN where missing; confidence (T, J).
    """
    s, form = skeleton.scales, options.form
    terms: list[Objective] = [
        Reprojection(camera, xy_px, confidence, np.full(len(xy_px), options.sigma_px), options.robust_c),
        AngleRange("theta range", skeleton.theta_slice, skeleton.theta, s.softness_rad, form),
        AngleRange("phi range", skeleton.phi_slice, skeleton.phi, s.softness_rad, form),
        RateLimit("theta rate", skeleton.theta_slice, skeleton.theta.max_rate_rad_s, s.softness_rad, form),
        RateLimit("phi rate", skeleton.phi_slice, skeleton.phi.max_rate_rad_s, s.softness_rad, form),
        BaseLengthPrior(*base_length(skeleton, options)),
    ]
    if options.angle_prior == "gaussian":
        moving = np.where(travel.speed_m_s[:, None] > 0, travel.heading, np.nan)
        terms += [
            AnglePrior("theta prior", skeleton.theta_slice, skeleton.theta.mean_rad, s.theta_rad),
            AnglePrior("phi prior", skeleton.phi_slice, skeleton.phi.mean_rad, s.phi_rad),
            RollPrior(camera.up, s.roll_rad, skeleton.euler_slice),
            HeadingTie(camera.up, s.heading_rad_per_sqrt_s, skeleton.euler_slice),
            TravelPrior(camera.up, moving, s.travel_rad, skeleton.euler_slice),
        ]
    return tuple(terms)


def base_length(skeleton: Skeleton, options: FrameOptions) -> tuple[float, float]:
    """Nominal value and standard deviation of the base length, metres."""
    nominal = options.base_length_m or skeleton.nominal_base_length_m
    relative = skeleton.scales.base_length_m / skeleton.nominal_base_length_m
    return nominal, options.base_sigma_m or relative * nominal


def solve_frames(
    camera: Camera,
    skeleton: Skeleton,
    xy_px: Array,
    confidence: Array,
    fps: float,
    options: FrameOptions,
    progress: Callable[[int], None] = lambda frame: None,
) -> Solution:
    """Fit the chain frame by frame to detections xy_px (T, J, 2), NaN where missing, confidence (T, J).

    The joints are in the skeleton's order, frames fps apart. Never raises for a frame that cannot be solved: its report
    says so. Detections that no detector can have found in the camera's picture are left out (`Camera.sees`). progress
    is called with the count of frames, the one in hand included.
    """
    xy_px = np.where(camera.sees(xy_px)[..., None], xy_px, np.nan)
    skeleton = replace(skeleton, nominal_base_length_m=base_length(skeleton, options)[0])
    travel = estimate_travel(camera, skeleton, xy_px, fps)
    objectives = frame_objectives(camera, skeleton, xy_px, confidence, travel, options)
    solver = _FrameSolver(camera, skeleton, objectives, options)
    rays, _ = camera.rays(xy_px)
    seen = np.isfinite(rays[..., 0]).sum(axis=1)

    states = np.full((len(xy_px), skeleton.n_state), np.nan)
    reports: list[FrameReport | None] = []
    before: list[int] = []  # the last two solved frames, newest last
    for frame in range(len(xy_px)):
        progress(frame + 1)
        if seen[frame] < MIN_JOINTS:
            reports.append(None)
            continue
        state, report = solver.solve(frame, rays[frame], travel.heading[frame], states, before, fps)
        reports.append(report)
        if report.in_view:  # a pose that ran away is no start for the next frame
            states[frame] = state
            before = [*before[-1:], frame]
    return Solution(states, tuple(reports), travel, tuple(term.name for term in objectives))


def solve_joints(skeleton: Skeleton, joints_m: Array, up: Array, tolerance: float = 1e-15) -> Array:
    """States (T, D) whose joints are nearest to known ones, joints_m (T, J, 3) in the camera frame.

    For joints from several cameras or motion capture. The roll about the first link is not determined by joints and
    stays near zero against the unit vector up (3,). NaN for frames in which a joint is missing.
    """
    from scipy.optimize import least_squares  # slow to import

    target = JointPositions(joints_m, sigma_m=0.01)
    states = np.full((len(joints_m), skeleton.n_state), np.nan)
    for frame in np.flatnonzero(np.isfinite(joints_m).all(axis=(1, 2))):
        start = state_from_joints(skeleton, joints_m[frame], up)
        result = least_squares(
            lambda x, f=frame: evaluate((target,), skeleton, f, x, None, 0.0)[0],
            start,
            lambda x, f=frame: evaluate((target,), skeleton, f, x, None, 0.0)[1],
            method="lm",
            ftol=tolerance,
            xtol=tolerance,
            gtol=tolerance,
        )
        states[frame] = result.x
    return states


@dataclass(frozen=True)
class _Candidate:
    """One start that was solved."""

    x: Array
    cost: float
    result: OptimizeResult
    step_norm: float
    function_evaluations: int
    jacobian_evaluations: int


@dataclass(frozen=True)
class _Given:
    """What does not change while a frame is solved. previous: the pose before, dt_s earlier, None at the start."""

    frame: int
    previous: Posed | None
    dt_s: float
    sigma_px: float


class _FrameSolver:
    def __init__(
        self, camera: Camera, skeleton: Skeleton, objectives: Sequence[Objective], options: FrameOptions
    ) -> None:
        self.camera, self.skeleton, self.options = camera, skeleton, options
        reprojection, *self.others = objectives
        assert isinstance(reprojection, Reprojection)
        self.reprojection = reprojection
        self.focal_px = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
        self.evaluations_left = SPARE_SEARCHES * options.max_evaluations
        self.stopped = False

    def solve(
        self, frame: int, rays: Array, heading: Array, states: Array, before: Sequence[int], fps: float
    ) -> tuple[Array, FrameReport]:
        began = time.perf_counter()
        self.evaluations_left = max(self.evaluations_left + self.options.max_evaluations, 1)
        self.stopped = False
        starts = [self._carried_on(frame, states, before)] if before else self._first_starts(rays, heading)
        fixed = _Given(
            frame=frame,
            previous=self.skeleton.pose(states[before[-1]][None]) if before else None,
            dt_s=(frame - before[-1]) / fps if before else 1.0 / fps,
            sigma_px=self._noise_px(starts[0]),
        )
        tried = self._tried(starts, fixed)
        best = self._best(fixed, tried)
        if before and not self._explained(fixed, best):
            tried += self._tried(self._more_starts(rays, heading, states[before[-1]]), fixed)
            best = self._best(fixed, tried)
        return best.x, self._report(fixed, best, len(tried), began)

    # -- starts ---------------------------------------------------------------------------------------------------

    def _first_starts(self, rays: Array, heading: Array) -> list[Array]:
        """The mean pose along the direction of travel, and turned half a radian to either side of it."""
        across = np.cross(self.camera.up, heading)
        return [
            geometric_start(self.camera, self.skeleton, rays, np.cos(turn) * heading + np.sin(turn) * across)
            for turn in (0.0, 0.5, -0.5)
        ]

    def _carried_on(self, frame: int, states: Array, before: Sequence[int]) -> Array:
        """The state before, its root moved on along its path. The place R p0 is moved, never p0: R turns it."""
        last = self.skeleton.pose(states[before])
        place = last.joints_m[-1, 0]
        if len(before) == 2:
            place = place + (place - last.joints_m[0, 0]) * (frame - before[1]) / (before[1] - before[0])
        return self._placed(states[before[-1]], place if place[2] > 0 else last.joints_m[-1, 0])

    def _more_starts(self, rays: Array, heading: Array, last: Array) -> list[Array]:
        """The mean pose along the direction of travel, and the last pose where the rays put that."""
        mean = geometric_start(self.camera, self.skeleton, rays, heading)
        if self.options.camera_rotation == "fixed":
            mean[self.skeleton.euler_slice] = last[self.skeleton.euler_slice]
        place = self.skeleton.pose(mean[None]).joints_m[0, 0]
        return [mean, self._placed(last, place)]

    def _placed(self, state: Array, place_m: Array) -> Array:
        moved = state.copy()
        moved[self.skeleton.place_slice] = self.skeleton.pose(state[None]).rotation[0].T @ place_m
        return moved

    # -- one optimisation -----------------------------------------------------------------------------------------

    def _tried(self, starts: Sequence[Array], fixed: _Given) -> list[_Candidate]:
        """The minima from the starts, as far as the evaluations go; at a frame's beginning there are some."""
        tried = []
        for start in starts:
            if self.evaluations_left <= 0:
                self.stopped = True
                break
            tried.append(self._solve_from(start, fixed))
        return tried

    def _solve_from(self, start: Array, fixed: _Given) -> _Candidate:
        """The minimum from one start, approached with a wide loss where the start is far off for the noise.

        Geman-McClure residuals beyond c sigma hardly pull: a start that far off would stay there.
        """
        off = float(np.nanmedian(self._distances_px(fixed, start))) / fixed.sigma_px
        if not off <= self.options.robust_c / 2:
            wide = fixed.sigma_px * min(off, 50.0) if np.isfinite(off) else fixed.sigma_px * 10.0
            near = self._minimise(start, replace(fixed, sigma_px=wide), tolerance=1e-3)
            best = self._minimise(near.x, fixed, self.options.tolerance)
            return replace(
                best,
                function_evaluations=near.function_evaluations + best.function_evaluations,
                jacobian_evaluations=near.jacobian_evaluations + best.jacobian_evaluations,
            )
        return self._minimise(start, fixed, self.options.tolerance)

    def _minimise(self, start: Array, fixed: _Given, tolerance: float) -> _Candidate:
        terms = self._terms(fixed)
        free = np.ones(self.skeleton.n_state, dtype=bool)
        if self.options.camera_rotation == "fixed" and fixed.previous is not None:
            free[self.skeleton.euler_slice] = False
        x = start.copy()
        last: dict[str, Array] = {}
        steps: list[Array] = []

        def residual(y: Array) -> Array:
            x[free] = y
            last["y"] = y.copy()
            last["r"], last["J"] = evaluate(terms, self.skeleton, fixed.frame, x, fixed.previous, fixed.dt_s)
            return last["r"]

        def jacobian(y: Array) -> Array:
            # MINPACK asks for the Jacobian at accepted points only: their differences are the steps taken.
            steps.append(y.copy())
            if not np.array_equal(last["y"], y):
                residual(y)
            return last["J"][:, free]

        from scipy.optimize import least_squares  # slow to import

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
            max_nfev=max(min(self.options.max_evaluations, self.evaluations_left), 1),
        )
        self.evaluations_left -= int(result.nfev)
        self.stopped |= self.evaluations_left <= 0 and result.status not in CONVERGED
        x[free] = result.x
        moves = np.linalg.norm(np.diff([*steps, result.x], axis=0), axis=1)
        step_norm = float(moves[moves > 0][-1]) if np.any(moves > 0) else 0.0
        return _Candidate(x.copy(), float(result.cost), result, step_norm, int(result.nfev), int(result.njev or 0))

    def _noise_px(self, start: Array) -> float:
        """Standard deviation of a detection: the detector's noise and, at a start's distance, the keypoints'."""
        o = self.options
        depth = max(float(self.skeleton.pose(start[None]).joints_m[0, :, 2].mean()), 0.1)
        keypoint_m = self.skeleton.scales.keypoint_m if o.keypoint_sigma_m is None else o.keypoint_sigma_m
        return float(np.hypot(o.sigma_px, min(keypoint_m * self.focal_px / depth, o.keypoint_sigma_max_px)))

    def _terms(self, fixed: _Given) -> tuple[Objective, ...]:
        """The objectives with this frame's noise; without a frame before, no ties to it."""
        sigma_px = np.broadcast_to(fixed.sigma_px, self.reprojection.sigma_px.shape)
        terms = (replace(self.reprojection, sigma_px=sigma_px), *self.others)
        return terms if fixed.previous is not None else tuple(t for t in terms if t.stencil == (0,))

    def _distances_px(self, fixed: _Given, state: Array) -> Array:
        """(n,) from the frame's detections to the state's reprojections, infinite where a joint cannot be projected."""
        pixels, valid = self.camera.project(self.skeleton.pose(state[None]).joints_m[0])
        detected = self.reprojection.xy_px[fixed.frame]
        off = np.where(valid, np.linalg.norm(pixels - detected, axis=1), np.inf)
        return off[np.isfinite(detected[:, 0])]

    def _best(self, fixed: _Given, tried: Sequence[_Candidate]) -> _Candidate:
        """The lowest cost among the poses that the camera can see, or among all if it can see none."""
        return min(tried, key=lambda c: (not self._in_view(fixed, c.x), c.cost))

    def _in_view(self, fixed: _Given, state: Array) -> bool:
        """Whether every detected joint can be projected, and the animal has a size (MOST_SIZE) and is near enough to be
        seen (MIN_REACH_PX)."""
        base, nominal = float(state[self.skeleton.base_index]), self.skeleton.nominal_base_length_m
        if not nominal / MOST_SIZE < base < nominal * MOST_SIZE:
            return False
        depth = float(np.median(self.skeleton.pose(state[None]).joints_m[0, :, 2]))
        seen = float(self.skeleton.length_ratios.sum()) * base * self.focal_px > MIN_REACH_PX * depth
        return seen and bool(np.all(np.isfinite(self._distances_px(fixed, state))))

    def _explained(self, fixed: _Given, candidate: _Candidate) -> bool:
        """Converged, and no detection further off than c sigma."""
        within = self._distances_px(fixed, candidate.x) < self.options.robust_c * fixed.sigma_px
        return candidate.result.status in CONVERGED and bool(np.all(within))

    # -- report ---------------------------------------------------------------------------------------------------

    def _report(self, fixed: _Given, best: _Candidate, starts: int, began: float) -> FrameReport:
        result, terms = best.result, self._terms(fixed)
        now = self.skeleton.pose_with_jacobian(best.x[None])
        assert now.joints_jacobian is not None
        frames, dt = np.array([fixed.frame]), np.array([fixed.dt_s])
        parts = [term.evaluate(window_of(term, (fixed.previous, now)), frames, dt) for term in terms]
        costs = {term.name: float(np.sum(r**2)) for term, (r, _) in zip(terms, parts, strict=True)}
        total = sum(costs.values())
        J = np.concatenate([j[0, :, -1] for _, j in parts])
        r = np.concatenate([r[0] for r, _ in parts])
        in_view = self._in_view(fixed, best.x)
        C = posterior_covariance(J) if in_view else np.full((len(best.x), len(best.x)), np.nan)
        data_share, joint_share, joint_sigma = precision_shares(C, parts[0][1][0, :, -1], now.joints_jacobian[0])
        place_sigma, relative_rms = place_and_shape(C, now.joints_jacobian[0], now.joints_m[0])
        far = self._distances_px(fixed, best.x) / fixed.sigma_px
        return FrameReport(
            status="converged" if result.status in CONVERGED and in_view else "not_converged",
            starts=starts,
            iterations=best.jacobian_evaluations,
            function_evaluations=best.function_evaluations,
            jacobian_evaluations=best.jacobian_evaluations,
            optimizer_status=int(result.status),
            message=str(result.message)
            + (" The evaluations that the clip may take up to here were spent." if self.stopped else "")
            + ("" if in_view else " The pose left the camera's view, or ended out of sight."),
            squared_norm=total,
            mean_residual=float(np.mean(np.abs(r))),
            cost_shares={name: cost / total if total > 0 else 0.0 for name, cost in costs.items()},
            optimality=float(np.max(np.abs(J.T @ r))),
            step_norm=best.step_norm,
            jacobian_mean_abs=float(np.mean(np.abs(J))),
            jacobian_sparsity=float(np.mean(J == 0)),
            gradient=J.T @ r,
            sigma_px=fixed.sigma_px,
            data_share=data_share,
            joint_data_share=joint_share,
            joint_sigma_m=joint_sigma,
            mean_weight=float(np.mean((1.0 + (far / self.options.robust_c) ** 2) ** -2.0)) if in_view else np.nan,
            place_sigma_m=place_sigma,
            relative_rms_m=relative_rms,
            solve_s=time.perf_counter() - began,
            in_view=in_view,
            stopped=self.stopped,
        )


def window_of(term: Objective, window: tuple[Posed | None, Posed]) -> tuple[Posed, ...]:
    """The poses that a term reads, from the frame before (if any) and this one."""
    before, now = window
    return (now,) if before is None or len(term.stencil) == 1 else (before, now)


def evaluate(
    terms: Sequence[Objective], skeleton: Skeleton, frame: int, x: Array, previous: Posed | None, dt_s: float
) -> tuple[Array, Array]:
    """Stacked residuals (M,) of one frame and their Jacobian (M, D) with respect to its state x (D,).

    previous: the frame before, held fixed, dt_s earlier; None for terms that read this frame only.
    """
    now = skeleton.pose_with_jacobian(x[None])
    frames, dt = np.array([frame]), np.array([dt_s])
    residuals, jacobians = [], []
    for term in terms:
        r, J = term.evaluate(window_of(term, (previous, now)), frames, dt)
        residuals.append(r[0])
        jacobians.append(J[0, :, -1])
    return np.concatenate(residuals), np.concatenate(jacobians)


def posterior_covariance(J: Array) -> Array:
    """(D, D): C = (J'J)^-1 for the Jacobian J (M, D) of all residuals; all NaN where J'J is singular."""
    from scipy.linalg import eigh  # slow to import

    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-12)
    values, vectors = eigh((J / scale).T @ (J / scale))
    if values[0] < 1e-10 * values[-1]:
        return np.full((J.shape[1], J.shape[1]), np.nan)
    return (vectors / values) @ vectors.T / np.outer(scale, scale)


def precision_shares(C: Array, J_data: Array, joints_jacobian: Array) -> tuple[Array, Array, Array]:
    """What the pixels contribute: shares of the unknowns (D,), of the joints (J,), and the joints' sigmas (J, 3) in m.

    With C^-1 = H_data + H_priors, C = C H_data C + C H_priors C splits every variance of the posterior covariance
    C (D, D) into two non-negative parts; the share is the first one's. J_data: the reprojection's rows of the Jacobian.
    joints_jacobian (J, 3, D). All NaN where C is.
    """
    from_data = C @ (J_data.T @ J_data) @ C
    variance = np.einsum("jad,de,jae->ja", joints_jacobian, C, joints_jacobian)
    data_variance = np.einsum("jad,de,jae->ja", joints_jacobian, from_data, joints_jacobian)
    share = np.diag(from_data) / np.diag(C)
    joint_share = data_variance.sum(axis=1) / variance.sum(axis=1)
    return np.clip(share, 0, 1), np.clip(joint_share, 0, 1), np.sqrt(variance)


def place_and_shape(C: Array, joints_jacobian: Array, joints_m: Array) -> tuple[float, float]:
    """Standard deviation of the mean of all joints along the line of sight, and of the joints relative to their mean,
    root mean square; from the covariance C (D, D) of the state, joints_jacobian (J, 3, D), joints_m (J, 3)."""
    mean = joints_jacobian.mean(axis=0)
    middle = joints_m.mean(axis=0)
    along = middle / np.linalg.norm(middle) @ mean
    apart = joints_jacobian - mean
    relative = np.einsum("jad,de,jae->j", apart, C, apart)
    return float(np.sqrt(along @ C @ along)), float(np.sqrt(relative.mean()))
