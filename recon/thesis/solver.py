"""Solve the published problem of 21 unknowns frame by frame, by Levenberg-Marquardt.

scipy's `least_squares(method="lm")` (MINPACK) minimises the stacked residuals of all objectives. A frame starts from
the solution of the previous frame, with its position extrapolated along the path. The first frame starts from geometry
alone (`recon.thesis.start`). Frames whose solution leaves points unexplained get further starts, and the solution with
the lowest cost is kept.

Depths jitter from frame to frame. By default all frames are therefore solved a second time, from their first solutions,
with the reference joint tied to a smooth path through all frames (`recon.thesis.path`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import least_squares

from recon.animal.body import MIN_JOINTS, MIN_REACH_PX
from recon.base.arrays import Array, Index
from recon.clip import View
from recon.geometry.camera import Camera
from recon.thesis.chain import ChainPose, UnknownsChain
from recon.thesis.levenberg import minimise
from recon.thesis.objectives import FrameOptions, JointReprojection, Objective, base_length, frame_objectives
from recon.thesis.path import Path, PathTie, path_of
from recon.thesis.solution import FrameSolution, _FrameReport, in_world
from recon.thesis.start import estimate_travel, geometric_start, parse_start_angles

CONVERGED = (1, 2, 3, 4)
"""Status values of scipy's `least_squares` that mean that a tolerance was met."""
MAX_SIZE = 10.0
"""Factor by which the base length may differ from its expected value before a pose counts as diverged."""
_WIDE_MAX = 50.0
"""Largest factor by which the assumed noise is raised in the first search from a distant start."""
_WIDE_UNSEEN = 10.0
"""Factor by which the assumed noise is raised if joints of the start cannot be projected."""
_WIDE_TOLERANCE = 1e-3
"""Tolerance of the first search from a distant start, with raised noise."""
_FIRST_TOLERANCE = 1e-3
"""Tolerance of the first solution of all frames, from which the second solution starts."""
_SECOND_TOLERANCE = 1e-5
"""Tolerance of the second solution of all frames."""
_FIRST_TURNS_RAD = (0.0, 0.5, -0.5)
"""Angles in rad between the direction of travel and the headings from which the search in the first frame starts."""


def solve_frames(
    view: View,
    chain: UnknownsChain,
    fps: float,
    options: FrameOptions,
    progress: Callable[[int], None] = lambda frame: None,
) -> FrameSolution:
    """Fit the chain frame by frame to the view of a static camera.

    A frame that cannot be solved raises no error, and its report states the failure. Detections outside the camera's
    picture are left out (`Camera.sees`).

    Parameters
    ----------
    view
        Keypoints in the order of the chain's joints.
    chain
        The chain to fit.
    fps
        Frames per second.
    options
        Options of the fit.
    progress
        Called before each frame with its number, counted from 1.
    """
    view = view.mask_outside_image()
    passes = 2 if options.path == "smooth" else 1
    first_options, options = with_tolerance(options, _FIRST_TOLERANCE), with_tolerance(options)
    solver = FrameSolver(view, chain, fps, first_options)
    covariance, reports = _solve_all(solver, lambda count: progress(max(count // passes, 1)))
    fields: dict[str, Any] = {}
    if passes == 2 and (path := path_of(solver.chain, solver.states, covariance, fps)) is not None:
        T, first_states, first_reports = len(reports), solver.states, reports
        solver = FrameSolver(view, chain, fps, options, path=path, starts=first_states)
        covariance, reports = _solve_all(solver, lambda count: progress((T + count) // passes), first_reports)
        fields = {"path": path, "start_states": first_states, "path_sigma_m": options.path_sigma_m}
    names = tuple(term.name for term in solver.objectives)
    fields |= {"reports": tuple(reports), "travel": solver.travel, "objectives": names, "fps": fps}
    return in_world(view, chain, solver.states, covariance, **fields)


def with_tolerance(options: FrameOptions, least: float = _SECOND_TOLERANCE) -> FrameOptions:
    """Return the options, with a tolerance of at least `least` if all frames are solved a second time."""
    return replace(options, tolerance=max(options.tolerance, least)) if options.path == "smooth" else options


def _solve_all(
    solver: FrameSolver, progress: Callable[[int], None], first: Sequence[_FrameReport | None] | None = None
) -> tuple[Array, list[_FrameReport | None]]:
    """Solve every frame, store the states in the solver, and return covariances (T, D, D) and reports.

    In the second round, `first` holds the reports of the first solutions. Frames without a first pose are not solved.
    """
    covariance = np.full((*solver.states.shape, solver.chain.n_state), np.nan)
    reports: list[_FrameReport | None] = []
    for frame, detections in enumerate(np.isfinite(solver.rays[..., 0]).sum(axis=1)):
        progress(frame + 1)
        earlier = None if first is None else first[frame]
        if detections < MIN_JOINTS or (earlier is not None and not earlier.in_view):
            reports.append(earlier)
            continue
        state, C, report = solver.solve(frame)
        reports.append(report if earlier is None else _total(earlier, report))
        if report.in_view:  # a pose that diverged is no start for the next frame
            solver.states[frame], covariance[frame] = state, C
    return covariance, reports


def _total(first: _FrameReport, second: _FrameReport) -> _FrameReport:
    """Return the report on a frame's second solution, with the effort of both solutions."""
    return replace(
        second,
        iterations=first.iterations + second.iterations,
        function_evaluations=first.function_evaluations + second.function_evaluations,
        first_evaluations=first.function_evaluations,
        solve_s=first.solve_s + second.solve_s,
        starts=max(first.starts, second.starts),
    )


@dataclass(frozen=True, eq=False)
class FrameProblem:
    """Least-squares problem of one frame, with residuals as functions of its unknowns x (D,)."""

    chain: UnknownsChain
    terms: tuple[Objective, ...]
    """Terms of the problem, of which the first is f1, the reprojection."""
    frame: int
    """Index of the frame in the clip."""
    previous: ChainPose | None
    """Fixed pose of the previous frame, `dt_s` earlier; None if the terms depend on this frame only."""
    dt_s: float

    def by_term(self, x: Array) -> dict[str, tuple[Array, Array]]:
        """Return a dictionary from each term's name to its residuals (M,) and their Jacobian (M, D)."""
        pose = self.chain.pose_with_jacobian(x[None])
        return {term.name: term.evaluate(pose, self.previous, self.frame, self.dt_s) for term in self.terms}

    def at(self, x: Array) -> tuple[Array, Array]:
        """Return the stacked residuals (M,) and Jacobian (M, D) of all terms."""
        residuals, jacobians = zip(*self.by_term(x).values(), strict=True)
        return np.concatenate(residuals), np.concatenate(jacobians)

    @property
    def pixels(self) -> JointReprojection:
        """Return the objective f1, which holds the reprojection errors."""
        first = self.terms[0]
        assert isinstance(first, JointReprojection)
        return first

    def with_noise(self, sigma_px: float) -> FrameProblem:
        """Return this problem with another standard deviation of the detections, in pixels."""
        return replace(self, terms=(replace(self.pixels, sigma_px=sigma_px), *self.terms[1:]))

    def sigmas_off(self, x: Array) -> Array:
        """Return the distances (n,) between detections and reprojections, in standard deviations.

        The distance is infinite for a joint that cannot be projected.
        """
        pixels, valid = self.pixels.camera.project(self.chain.pose(x[None]).joints_m[0])
        detected = self.pixels.xy_px[self.frame]
        distance = np.where(valid, np.linalg.norm(pixels - detected, axis=1), np.inf)
        return distance[np.isfinite(detected[:, 0])] / self.pixels.sigma_px

    def in_view(self, x: Array) -> bool:
        """Return whether all detected joints can be projected, and the animal has a plausible size and distance."""
        base, nominal = float(x[self.chain.base_index]), self.chain.nominal_base_length_m
        if not nominal / MAX_SIZE < base < nominal * MAX_SIZE:
            return False
        depth = float(np.median(self.chain.pose(x[None]).joints_m[0, :, 2]))
        reach = sum(link.length_ratio for link in self.chain.links) * base * _focal_px(self.pixels.camera)
        return reach > MIN_REACH_PX * depth and bool(np.all(np.isfinite(self.sigmas_off(x))))


@dataclass(frozen=True, eq=False)
class FrameSearch:
    """Accepted points of one frame's search from its start to its minimum, including points with raised noise."""

    problem: FrameProblem
    cost: float
    """Half the sum of squared residuals at the minimum."""
    status: int
    """Status of scipy's `least_squares`."""
    evaluations: int
    iterations: int
    points: Array
    """Accepted points, shape (K, D), beginning with the start."""
    evaluations_at: Index
    """Number of evaluations of the residuals when each point was accepted, shape (K,)."""
    sigma_px: Array
    """Noise assumed for the step from each point in pixels, shape (K,), last the detections' noise."""

    @property
    def x(self) -> Array:
        """Return the unknowns at the minimum, shape (D,)."""
        return self.points[-1]

    @property
    def step_norms(self) -> Array:
        """Return the length of the step from each point, shape (K - 1,)."""
        return np.asarray(np.linalg.norm(np.diff(self.points, axis=0), axis=1), dtype=float)

    @property
    def step_norm(self) -> float:
        """Return the length of the last step that is not zero, in the space of the unknowns."""
        steps = self.step_norms
        return float(np.append(0.0, steps[steps > 0])[-1])

    def after(self, earlier: FrameSearch) -> FrameSearch:
        """Return this search together with the earlier one that led to its start."""
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
        """Return half the sum of squared residuals at each point with the detections' noise, shape (K,)."""
        return np.array([0.5 * float(np.sum(self.problem.at(x)[0] ** 2)) for x in self.points])

    @cached_property
    def damping(self) -> Array:
        """Return the damping lambda of the step from each point, shape (K - 1,).

        The damping is computed from (J'J + lambda S) step = -J'r, as MINPACK does not report it. S contains the largest
        squared norms that the columns of J have had.
        """
        damping, scale, sigma_px = [], np.zeros(self.points.shape[1]), 0.0
        for x, step, step_sigma_px in zip(self.points, np.diff(self.points, axis=0), self.sigma_px, strict=False):
            r, J = self.problem.with_noise(step_sigma_px).at(x)
            scale = np.maximum(scale if step_sigma_px == sigma_px else 0.0, np.sum(J**2, axis=0))
            scaled, sigma_px = np.where(scale > 0, scale, 1.0) * step, step_sigma_px
            damping.append(max(float(-(scaled @ J.T @ (r + J @ step)) / max(float(scaled @ scaled), 1e-300)), 0.0))
        return np.array(damping)


class FrameSolver:
    """Solver that fits the chain to a clip frame by frame.

    Parameters
    ----------
    view
        Detections, in the order of the chain's joints.
    chain
        The chain to fit.
    fps
        Frames per second.
    options
        Options of the fit.
    states
        Earlier solutions (T, D), NaN elsewhere; None if there are none.
    path
        Path to which the reference joint is tied; None if there is none.
    starts
        First solutions (T, D) from which the frames start, NaN where missing; None to start from the previous frame.
    """

    def __init__(
        self,
        view: View,
        chain: UnknownsChain,
        fps: float,
        options: FrameOptions,
        states: Array | None = None,
        path: Path | None = None,
        starts: Array | None = None,
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
        self.path, self.starts = path, starts
        if path is not None:
            self.objectives += (PathTie(path.position_m, nominal, self.chain.base_index, self.options.path_sigma_m),)

    def solved_before(self, frame: int) -> list[int]:
        """Return the indices of the last two solved frames before a frame, in ascending order."""
        return np.flatnonzero(np.isfinite(self.states[:frame, 0]))[-2:].tolist()

    def problem(self, frame: int, sigma_px: float) -> FrameProblem:
        """Return the least-squares problem of a frame with a noise of `sigma_px` pixels.

        Terms that depend on the previous frame are left out of the first frame.
        """
        if earlier := self.solved_before(frame):
            previous, dt_s = self.chain.pose(self.states[earlier[-1]][None]), (frame - earlier[-1]) / self.fps
        else:
            previous, dt_s = None, 1.0 / self.fps
        terms = tuple(term for term in self.objectives if previous is not None or not term.ties)
        return FrameProblem(self.chain, terms, frame, previous, dt_s).with_noise(sigma_px)

    def solve(self, frame: int) -> tuple[Array, Array, _FrameReport]:
        """Return a frame's state (D,), its covariance (D, D) given the previous frame, and its report."""
        began = time.perf_counter()
        best, starts = self.search(frame)
        problem, parts = best.problem, best.problem.by_term(best.x)
        costs = {name: float(np.sum(r**2)) for name, (r, _) in parts.items()}
        total, in_view = sum(costs.values()), problem.in_view(best.x)
        C = posterior_covariance(np.concatenate([J for _, J in parts.values()]))
        C = C if in_view else np.full_like(C, np.nan)
        distance = problem.sigmas_off(best.x)
        trust = (1.0 + (distance / self.options.robust_c) ** 2) ** -2.0
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
            mean_weight=float(np.mean(trust)) if in_view else np.nan,
            solve_s=time.perf_counter() - began,
            in_view=in_view,
        )
        return best.x, C, report

    def search(self, frame: int) -> tuple[FrameSearch, int]:
        """Return the best search of a frame and the number of starts."""
        rays, heading, earlier = self.rays[frame], self.travel.heading[frame], self.solved_before(frame)
        if self.path is not None and self.starts is not None and np.isfinite(self.starts[frame, 0]):
            starts = [self._on_path(frame)]
        else:
            starts = [self._extrapolated(frame, earlier)] if earlier else self._first_starts(rays, heading)
        problem = self.problem(frame, self._noise_px(starts[0]))
        searches = [self._solve_from(start, problem) for start in starts]
        # Detections further off than c sigma are unexplained, and the frame needs more starts.
        is_explained = problem.sigmas_off(searches[0].x) < self.options.robust_c
        if earlier and not (searches[0].status in CONVERGED and is_explained.all()):
            more_starts = self._more_starts(rays, heading, self.states[earlier[-1]])
            searches += [self._solve_from(start, problem) for start in more_starts]
        # Choose the lowest cost among the poses that the camera can see, or among all poses if it can see none.
        best = min(searches, key=lambda search: (not search.problem.in_view(search.x), search.cost))
        return best, len(searches)

    def _first_starts(self, rays: Array, heading: Array) -> list[Array]:
        """Return mean poses along the direction of travel and to either side, or the pose set by hand."""
        if self.options.start_angles is not None:
            angles = parse_start_angles(self.options.start_angles, self.chain)
            return [geometric_start(self.camera, self.chain, rays, heading, angles)]
        across = np.cross(self.camera.up, heading)
        return [
            geometric_start(self.camera, self.chain, rays, np.cos(turn) * heading + np.sin(turn) * across)
            for turn in _FIRST_TURNS_RAD
        ]

    def _on_path(self, frame: int) -> Array:
        """Return a frame's solution from the first pass, with its root moved onto the smooth path of all frames."""
        assert self.starts is not None
        assert self.path is not None
        state = self.starts[frame]
        size = state[self.chain.base_index] / self.chain.nominal_base_length_m
        return self._moved_to(state, size * self.path.position_m[frame])

    def _extrapolated(self, frame: int, earlier: Sequence[int]) -> Array:
        """Return the previous state with its root extrapolated at constant velocity.

        The point R p0 is moved instead of p0, because R turns p0 with a long lever arm.
        """
        poses = self.chain.pose(self.states[earlier])
        position = poses.joints_m[-1, 0]
        if len(earlier) == 2:
            step = position - poses.joints_m[0, 0]
            position = position + step * (frame - earlier[1]) / (earlier[1] - earlier[0])
        return self._moved_to(self.states[earlier[-1]], position if position[2] > 0 else poses.joints_m[-1, 0])

    def _more_starts(self, rays: Array, heading: Array, last: Array) -> list[Array]:
        """Return the mean pose facing the direction of travel, and the last pose moved to the mean pose's position."""
        mean = geometric_start(self.camera, self.chain, rays, heading)
        if self.options.camera_rotation == "fixed":
            mean[self.chain.euler_slice] = last[self.chain.euler_slice]
        position = self.chain.pose(mean[None]).joints_m[0, 0]
        return [mean, self._moved_to(last, position)]

    def _moved_to(self, state: Array, position_m: Array) -> Array:
        """Return the state with its root at a position (3,) in the camera frame."""
        moved = state.copy()
        moved[self.chain.position_slice] = self.chain.pose(state[None]).rotation[0].T @ position_m
        return moved

    def _noise_px(self, start: Array) -> float:
        """Return the standard deviation of a detection in pixels.

        The variances of the detector's noise and of the keypoints about the joints, as seen at the start's distance,
        are added.
        """
        options = self.options
        depth = max(float(self.chain.pose(start[None]).joints_m[0, :, 2].mean()), 0.1)
        keypoint_m = self.chain.file.keypoint_sigma_m if options.keypoint_sigma_m is None else options.keypoint_sigma_m
        keypoint_px = min(keypoint_m * _focal_px(self.camera) / depth, options.keypoint_sigma_max_px)
        return float(np.hypot(options.sigma_px, keypoint_px))

    def _solve_from(self, start: Array, problem: FrameProblem) -> FrameSearch:
        """Search from one start, with raised noise at first if the start is far from the detections.

        Geman-McClure residuals beyond c sigma hardly pull, so the search would not leave a distant start.
        """
        distance = float(np.nanmedian(problem.sigmas_off(start)))
        if distance <= self.options.robust_c / 2:
            return self._minimise(start, problem, self.options.tolerance)
        factor = min(distance, _WIDE_MAX) if np.isfinite(distance) else _WIDE_UNSEEN
        wide_px = problem.pixels.sigma_px * factor
        approach = self._minimise(start, problem.with_noise(wide_px), _WIDE_TOLERANCE)
        return self._minimise(approach.x, problem, self.options.tolerance).after(approach)

    def _minimise(self, start: Array, problem: FrameProblem, tolerance: float) -> FrameSearch:
        """Search from one start, without the camera's rotation as an unknown if it is fixed."""
        free = np.ones(self.chain.n_state, dtype=bool)
        if self.options.camera_rotation == "fixed" and (problem.previous is not None or self.starts is not None):
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
            # The Jacobian is computed at accepted points only, so their differences are the steps taken.
            steps.append(y.copy())
            counts.append(evaluations)
            if not np.array_equal(last[0], y):
                residual(y)
            return last[2][:, free]

        tolerance = max(tolerance, float(np.finfo(float).eps))  # MINPACK does not distinguish smaller values
        options = self.options
        if options.initial_damping is not None:
            damping = options.initial_damping, options.damping_factor
            result = minimise(residual, jacobian, start[free], tolerance, options.max_evaluations, *damping)
        else:
            result = least_squares(
                residual,
                start[free],
                jacobian,  # type: ignore[arg-type]  # the stubs want a function of any array type
                method="lm",
                x_scale="jac",
                ftol=tolerance,
                xtol=tolerance,
                gtol=tolerance,
                max_nfev=options.max_evaluations,
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
    """Return the covariance (J'J)^-1 (D, D) for the Jacobian J (M, D) of all residuals; NaN if singular."""
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-12)
    values, vectors = eigh((J / scale).T @ (J / scale))
    if values[0] < 1e-10 * values[-1]:
        return np.full((J.shape[1], J.shape[1]), np.nan)
    return (vectors / values) @ vectors.T / np.outer(scale, scale)


def precision_shares(C: Array, J_data: Array) -> Array:
    """Return the fraction (D,) of each unknown's precision that comes from the pixels.

    Since C^-1 = H_data + H_priors, the sum C = C H_data C + C H_priors C splits each variance into two parts that are
    not negative. The first part is returned as a fraction of the variance, NaN if C is NaN.

    Parameters
    ----------
    C
        Posterior covariance (D, D).
    J_data
        Rows (M, D) of the Jacobian that belong to the reprojection.
    """
    return np.clip(np.diag(C @ (J_data.T @ J_data) @ C) / np.diag(C), 0, 1)
