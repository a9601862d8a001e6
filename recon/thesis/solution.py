"""Hold the result of the frame method, with a state and a report for each frame and the solution in the world."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from recon.base.arrays import Array, median
from recon.check.codes import finding
from recon.clip import View
from recon.fit.motion import Motion
from recon.fit.result import OUTLIER_SIGMAS, Finding, MotionSegment, ReferencePath, Solution
from recon.geometry.frames import inverse, moved
from recon.geometry.kinematics import ROLL, YAW
from recon.thesis.chain import AnyChain, UnknownsChain
from recon.thesis.path import Path
from recon.thesis.start import Travel

Status = Literal["converged", "not_converged", "no_data"]

FEW_POINTS_FRACTION = 0.75
"""Fraction of a frame's joints that are detected, below which the frame is flagged "few points"."""
GOOD_FRACTION = 1 / 3
"""Fraction of detected joints times the detections' mean weight below which a frame is flagged "data poor"."""
WARN_LIMITS = 0.25
"""Fraction of solved frames with angles beyond their ranges above which a finding is reported."""
FRAME_BY_FRAME = 1.87
"""Factor by which the frame method understates the uncertainty of poses for the verdict.

The verdict's formula comes from the trajectory method. This factor makes the median error of 28 views equal to the
expected error (1.85 to 1.99 with one of the five runs left out; `python benchmarks/thesis.py --only frame`).
"""
POSE_PRIORS = ("theta prior", "phi prior", "roll prior")
USUAL_PRIOR_COST = 2.4
"""Usual squared norm of the Gaussian priors' residuals in a frame, which is the median over 28 views of five runs.

In views with twice this value, the error of the poses is more than twice the posterior standard deviation
(`python benchmarks/thesis.py --only frame`).
"""
UNUSUAL_PRIOR_COST = 2.0
"""Multiple of `USUAL_PRIOR_COST` above which unusual angles are reported."""
_DIFFERENCE_RAD = 1e-6
"""Step of the numerical derivative of the root's rotation with respect to the Euler angles."""


@dataclass(frozen=True)
class _FrameReport:
    """Report on the optimisation of one frame."""

    status: Status
    starts: int
    """Number of starting points that were tried."""
    iterations: int
    """Levenberg-Marquardt iterations from the best start, counted by their Jacobian evaluations.

    Iterations and function evaluations include the first search with raised noise.
    """
    function_evaluations: int
    optimizer_status: int
    """Status value of scipy's `least_squares`, such as 1 if the gradient is small."""
    squared_norm: float
    cost_shares: dict[str, float]
    """Fraction of the residuals' squared norm that each term contributes, keyed by the term's name."""
    step_norm: float
    """Length of the search's last step in the space of the unknowns."""
    sigma_px: float
    """Standard deviation of a detection in pixels, including the keypoint's distance from the joint."""
    data_share: Array
    """Fraction of the posterior precision of each unknown that comes from the pixels, shape (D,), 0 to 1.

    The fraction is NaN if data and priors together do not determine the unknown.
    """
    mean_weight: float
    """Mean weight of the detections, 0 to 1."""
    solve_s: float
    """Time spent on all starts of the frame, in seconds."""
    in_view: bool
    """Whether the camera can see the pose, and the pose has the size of an animal.

    A pose that diverged counts as not converged and is left out of the solution. Its fractions and covariance are NaN.
    """
    first_evaluations: int = 0
    """Function evaluations of the first solution, if all frames are solved a second time."""


@dataclass(frozen=True, eq=False, repr=False)
class FrameSolution(Solution):
    """Solution of a clip by the frame method, with D unknowns of the chain in each frame.

    Covariances assume that the previous frame is known exactly.
    """

    chain: AnyChain
    chain_states: Array
    """States as published (`recon.thesis.chain`), shape (T, D); NaN if a frame has no data or its pose diverged."""
    reports: tuple[_FrameReport | None, ...]
    """Report on the optimisation of each frame; None for a frame without data."""
    travel: Travel
    """Direction of travel and speed from which the search started."""
    objectives: tuple[str, ...]
    fps: float
    size_sigma: float | None = None
    """Posterior standard deviation of the animal's size relative to the skeleton; None if no frame has a pose."""
    path: Path | None = None
    """Path to which the reference joint is tied; None if every frame was solved on its own."""
    path_sigma_m: float = 0.01
    """Standard deviation of the reference joint about the path in metres; 0.01 in files of earlier versions."""
    start_states: Array | None = None
    """First solutions (T, D), from which the path was estimated; None without a path."""

    method: ClassVar = "frame"
    record_tag: ClassVar = "frame"
    jitters: ClassVar = True

    @property
    def constant_velocity_m_s(self) -> Array:
        """Return the speed in m/s, shape (T,), of the straight run from which the search started."""
        return self.travel.speed_m_s

    @property
    def position_error_time_s(self) -> float | None:
        """Return the correlation time of the error of the smoothed path, s, or None without a smoothed path."""
        if self.path is None:
            return None
        variance = np.diagonal(self.path.covariance, axis1=1, axis2=2)
        ratio = variance[:, :3].sum(axis=1) / variance[:, 3:6].sum(axis=1)
        return float(np.sqrt(np.median(ratio)))

    @property
    def reference_path(self) -> ReferencePath | None:
        """Return the path of the reference joint in the world, scaled to the animal's size."""
        path = self.path
        if path is None:
            return None
        T, size = len(path.position_m), self.size
        T_world_camera = np.broadcast_to(inverse(self.views[0].T_camera_world), (T, 4, 4))
        R, centre_m = T_world_camera[:, :3, :3], T_world_camera[:, :3, 3]
        acceleration_m_s2, covariance = path.acceleration_m_s2, path.covariance
        if acceleration_m_s2 is None:
            acceleration_m_s2 = self.fps * np.gradient(path.velocity_m_s, axis=0)
            unknown = np.full((T, 9, 9), np.nan)
            unknown[:, :6, :6] = covariance
            covariance = unknown
        blocks = covariance.reshape(T, 3, 3, 3, 3)
        rotated = np.einsum("tab,tibjc,tdc->tiajd", R, blocks, R).reshape(T, 9, 9)
        position, velocity, acceleration = (
            size * np.einsum("tab,tb->ta", R, values)
            for values in (path.position_m, path.velocity_m_s, acceleration_m_s2)
        )
        # in the frame of a treadmill's belt, the camera moves
        camera_m_s = self.fps * np.gradient(centre_m, axis=0)
        relative_sigma = (self.size_sigma or 0.0) / size
        derivatives = position + centre_m, velocity + camera_m_s, acceleration
        return ReferencePath(*derivatives, size**2 * rotated, centre_m, relative_sigma)

    @property
    def prior_misfit(self) -> float:
        """Return the mean squared norm of the priors' residuals relative to its usual value, or 1 without priors."""
        costs = [
            report.squared_norm * sum(report.cost_shares.get(name, 0.0) for name in POSE_PRIORS)
            for report in self.reports
            if report is not None and report.in_view
        ]
        return float(np.mean(costs)) / USUAL_PRIOR_COST if costs and {*POSE_PRIORS} & {*self.objectives} else 1.0

    @property
    def posterior_factor(self) -> float:
        """Return the factor on the poses' uncertainty, which grows with the priors' misfit."""
        return FRAME_BY_FRAME * max(1.0, self.prior_misfit)

    def reported(self, field: str) -> Array:
        """Return the values of one field of `_FrameReport` in all frames, shape (T,); NaN for frames without data."""
        return np.array([np.nan if report is None else getattr(report, field) for report in self.reports], dtype=float)

    def unknown(self, name: str) -> Array:
        """Return one unknown of the chain in all frames, shape (T,); NaN for frames without a pose."""
        return self.chain_states[:, self.chain.state_names.index(name)]

    @cached_property
    def status(self) -> tuple[Status, ...]:
        """Return the status of each of the T frames: converged, not_converged or no_data."""
        return tuple("no_data" if report is None else report.status for report in self.reports)

    def findings(self) -> tuple[Finding, ...]:
        """Return findings on frames that did not converge or have unusual angles."""
        total, failed = len(self.flags), self.status.count("not_converged")
        solved, findings = total - self.status.count("no_data"), []
        if failed:
            findings.append(finding("frames_not_converged", count=failed, frames_total=total))
        at_limit = sum("at range limit" in flags for flags in self.flags)
        if at_limit > WARN_LIMITS * solved:
            findings.append(finding("at_range_limits", count=at_limit, frames_total=solved))
        if self.prior_misfit > UNUSUAL_PRIOR_COST:
            findings.append(finding("angles_unusual", times=self.prior_misfit))
        return tuple(findings)

    def report_sections(self) -> tuple[object, ...]:
        """Return the frame method's sections of the report."""
        from recon.thesis.report import SECTIONS

        return SECTIONS

    def _expected(self, field: str) -> Array:
        """Return one field of the skeleton's expected ranges of theta and phi, shape (2 A,)."""
        return np.concatenate([getattr(ranges, field) for ranges in (self.chain.theta, self.chain.phi)])

    @property
    def _angles_rad(self) -> Array:
        """Return theta and phi of the A free links in rad, shape (T, 2 A)."""
        return self.chain_states[:, : 2 * self.chain.n_angles]

    @cached_property
    def beyond_range_rad(self) -> Array:
        """Return the excess of angles over their ranges, rad, shape (T, 2 A); NaN without a pose."""
        return np.abs(self._angles_rad - self._expected("mean_rad")) - self._expected("tolerance_rad")

    @cached_property
    def beyond_rate_rad_s(self) -> Array:
        """Return the excess of chord rates since the previous solved frame over their limits, rad/s, shape (T, 2 A).

        The excess is negative below the limit, and NaN for the first frame and frames without a pose.
        """
        angles = self._angles_rad
        rows = np.flatnonzero(np.isfinite(angles[:, 0]))
        beyond = np.full(angles.shape, np.nan)
        chord = 2 * np.abs(np.sin(np.diff(angles[rows], axis=0) / 2)) * self.fps / np.diff(rows)[:, None]
        beyond[rows[1:]] = chord - self._expected("max_rate_rad_s")
        return beyond


def frame_solution(motion: Motion) -> FrameSolution:
    """Return the solution of a motion that the frame method solved."""
    assert isinstance(motion.solution, FrameSolution)
    return motion.solution


def in_world(view: View, chain: UnknownsChain, states: Array, covariance: Array, **fields: Any) -> FrameSolution:
    """Convert the chain's states to a solution in the world frame.

    Parameters
    ----------
    view
        Detections of the camera.
    chain
        The fitted chain.
    states
        States (T, D) of the chain.
    covariance
        Covariances (T, D, D) of the states.
    fields
        Reports, travel, objectives and fps of the solution. If there is a path, also the path, the standard deviation
        about the path, and the first states.
    """
    (T, J), reports = view.present.shape, fields["reports"]
    T_world_camera = inverse(view.T_camera_world)
    pose = chain.pose_with_jacobian(states)
    assert pose.joints_jacobian is not None
    by_state = T_world_camera[:3, :3] @ pose.joints_jacobian
    absolute, relative = (
        np.einsum("tjad,tde,tjbe->tjab", jacobian, covariance, jacobian, optimize=True)
        for jacobian in (by_state, by_state - by_state.mean(axis=1, keepdims=True))
    )
    path: Path | None = fields.get("path")
    # The frames were solved with the path held fixed. The path's error is therefore added. It moves all joints
    # together, by a fraction that depends on how tightly the root is tied to the path.
    if path is not None:
        R = T_world_camera[:3, :3]
        fraction = absolute[:, 0] / fields["path_sigma_m"] ** 2
        absolute = absolute + (fraction @ R @ path.covariance[:, :3, :3] @ R.T @ fraction.swapaxes(1, 2))[:, None]
    body_states, sizes = chain.to_body(states, T_world_camera)
    base_sigma = np.sqrt(covariance[:, chain.base_index, chain.base_index]) / chain.nominal_base_length_m
    no_share = np.full(chain.n_state, np.nan)
    shares = np.array([no_share if report is None else report.data_share for report in reports])
    angle_sigma, angle_share = _body_angles(chain, states, covariance, shares, T_world_camera)
    sigma_px, trust = (
        np.array([np.nan if report is None else getattr(report, field) for report in reports])
        for field in ("sigma_px", "mean_weight")
    )
    solution = FrameSolution(
        body=chain.body,
        views=(view,),
        states=body_states,
        size=median(sizes) if np.isfinite(sizes).any() else 1.0,
        joints_m=moved(T_world_camera, pose.joints_m),
        covariance_m2=absolute,
        relative_covariance_m2=relative,
        angle_sigma_rad=angle_sigma,
        angle_data_share=angle_share,
        noise_px=np.repeat(sigma_px[None, :, None], J, axis=2),
        weight=np.where(view.present, trust[:, None], np.nan)[None],
        flags=(),
        alternative_m=np.full(T, np.nan),  # results of other starts are not kept
        contact=np.zeros((T, len(chain.body.feet))),
        segments=(MotionSegment(slice(0, T), None),),
        stage_s={},
        chain=chain,
        chain_states=states,
        size_sigma=median(base_sigma) if np.isfinite(base_sigma).any() else None,
        **fields,
    )
    return replace(solution, flags=_flags(solution))


def _body_angles(
    chain: UnknownsChain, states: Array, covariance: Array, shares: Array, T_world_camera: Array
) -> tuple[Array, Array]:
    """Return standard deviations of the body's angles, and fractions of their precision that come from the pixels.

    Both results have the shape (T, D' - 3). `states` (T, D), `covariance` (T, D, D) and the fractions `shares` (T, D)
    describe the chain's unknowns. The rotation of the root depends on the Euler angles, so its fraction is the mean of
    the Euler angles' fractions, weighted by their contributions to its variance.
    """
    angles = np.arange(2 * chain.n_angles)
    by_state = np.zeros((len(states), chain.body.n_state - YAW, chain.n_state))
    by_state[:, chain.body_angles - YAW, angles] = 1.0
    for k in range(chain.n_state)[chain.euler_slice]:
        unit = _DIFFERENCE_RAD * np.eye(chain.n_state)[k]
        lower, upper = (
            chain.to_body(end, T_world_camera)[0][:, YAW : ROLL + 1] for end in (states - unit, states + unit)
        )
        by_state[:, :3, k] = (np.mod(upper - lower + np.pi, 2 * np.pi) - np.pi) / (2 * _DIFFERENCE_RAD)
    weight = by_state**2 * np.diagonal(covariance, axis1=1, axis2=2)[:, None]
    variance = np.einsum("nik,nkl,nil->ni", by_state, covariance, by_state)
    return np.sqrt(variance), np.sum(weight * shares[:, None], axis=2) / np.sum(weight, axis=2)


def _flags(solution: FrameSolution) -> tuple[tuple[str, ...], ...]:
    (view,), reports, J = solution.views, solution.reports, len(solution.chain.joints)
    sigma_px, trust = solution.noise_px[0], solution.reported("mean_weight")
    present = view.present.sum(axis=1)
    distance_px = np.linalg.norm(view.project(solution.joints_m)[0] - view.xy_px, axis=-1)
    is_flagged: dict[str, Any] = {
        "no data": [report is None for report in reports],
        "diverged": [report is not None and not report.in_view for report in reports],
        "few points": [report is not None for report in reports] & (present < FEW_POINTS_FRACTION * J),
        "data poor": present * trust < GOOD_FRACTION * J,
        "outliers": (distance_px > OUTLIER_SIGMAS * sigma_px).any(axis=1),
        "not converged": [status == "not_converged" for status in solution.status],
        "at range limit": (solution.beyond_range_rad > 0).any(axis=1),
        "at rate limit": (solution.beyond_rate_rad_s > 0).any(axis=1),
    }
    return tuple(tuple(name for name, frames in is_flagged.items() if frames[t]) for t in range(len(reports)))
