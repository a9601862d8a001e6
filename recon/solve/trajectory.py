"""The trajectory method: a whole animal over a whole clip, as one least-squares problem.

Everything happens in the level frame: origin in the camera's centre, x to the picture's right, y away from the camera,
z up. The body has its nominal size: a scene that is scaled about the camera gives the same picture, so that the size is
known as well as its prior says, and better only where the ground's distance below the camera is known. The result is
scaled by it in the end. The way to the minimum:

1. Starts. The prior's mean pose runs straight through about a second of clip, in 18 headings, and is fitted to the
   viewing rays (`recon.initialise`); the best headings, and the best one mirrored in depth, start the clip.
2. Approach, at a lower frame rate, each start with one Gaussian of poses and wide noise that narrows; the two best
   starts go to the end.
3. The mixture of poses takes the Gaussian's place, flattened at first.
4. Rounds of: the noise of every joint from its residuals (maximum likelihood under the robust loss), contacts and the
   ground from the feet, and the minimum again.
5. The posterior covariance from the banded factor.

Clips of several seconds are started and approached about a second at a time, and then solved as one. Where nothing is
detected for longer than `BRIDGED_S`, the clip is split.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from recon.body import Body
from recon.camera import Camera
from recon.initialise import level_axes, run_path, straight_runs
from recon.kinematics import ROOT, YAW
from recon.prior import MotionPrior
from recon.skeleton import MIN_JOINTS, MIN_REACH_PX
from recon.solve.posterior import Posterior, posterior, with_size
from recon.solve.problem import Estimate, Problem
from recon.solve.result import Ground, Spell, Start, TrajectorySolution
from recon.solve.terms import (
    ANGLES,
    REFERENCE_HZ,
    Heading,
    Linear,
    OnGround,
    PoseMixture,
    Reprojection,
    Stance,
    Term,
    climb_term,
    dynamics_term,
    pose_term,
    root_term,
)

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Called with what is being done, and how much of all is done, 0 to 1."""

BRIDGED_S = 2.0
"""Without detections for longer than this, what comes before and after are two clips."""
MARGIN_S = 0.25
"""How far a clip is carried on beyond its first and last detections."""
WINDOW_S = 1.0
APPROACH_HZ = 30.0
"""Frames a second that are enough on the way in."""
_HEADINGS = 18
_APART_RAD = 0.5
"""Starts nearer to each other than this are one."""
_WIDE = (8.0, 4.0, 2.0, 1.0)
"""Factors on the noise on the way in."""
_TEMPERATURES = (8.0, 3.0, 1.0)
"""Of the mixture of poses."""
POOR_SHARE, POORER_SHARE = 1 / 3, 0.8
"""Frames are "data poor" in which less than this part of the joints is seen and trusted, or less than this part of what
it is in the clip's good frames (their 90th percentile)."""
END_ON_RAD = np.radians(30)
"""Seen along its trunk within this angle, an animal's depth shows in its perspective only: "ambiguous depth"."""
ALTERNATIVE_M, ALTERNATIVE_COST = 0.1, 20.0
"""A second solution is worth a flag if it is further away than this, and its cost not higher than this."""


@dataclass(frozen=True)
class TrajectoryOptions:
    """How the trajectory method weighs and searches. Standard deviations unless said otherwise.

    sigma_px: the detector's noise; keypoint_sigma_m: how far keypoints lie from the markers, in place of the body's;
    size_sigma: of the size, relative, in place of the body's. robust_c: residuals of that many sigmas count half.
    pose_weight, mixture_weight, motion_weight: how many times the priors count per 1/90 s. acceleration_m_s2: of the
    root in the level frame. lateral_m_s: of the velocity across the trunk. climb_m_s: of the root. ground: "auto" uses
    contacts and a plane, "none" does not; the stance's loss saturates at slip_c slip_m_s. noise_rounds: of step 4.
    error_time_s: how long errors last; what is seen in that time counts once in the uncertainty.
    fast: fewer starts, one of them to the end, and looser tolerances.

    Where the values come from: those of the root's movement and of feet that stand have the size of what is seen in the
    reconstructions that the prior `running-cheetah` is made of; lateral_m_s is an angle of 0.05 rad at 10 m/s. The rest
    are round numbers; docs/benchmarks.md shows what they matter. error_time_s was set on the real runs of the
    benchmark, so that 90 % regions hold about 90 % of the joints.
    """

    fast: bool = False
    ground: Literal["auto", "none"] = "auto"
    sigma_px: float = 3.0
    keypoint_sigma_m: float | None = None
    size_sigma: float | None = None
    robust_c: float = 3.0
    pose_weight: float = 1.0
    mixture_weight: float = 1.0
    motion_weight: float = 1.0
    acceleration_m_s2: tuple[float, float, float] = (12.0, 12.0, 9.0)
    yaw_acceleration_rad_s2: float = 40.0
    lateral_m_s: float = 0.5
    climb_m_s: float = 0.5
    stance_weight: float = 1.0
    slip_m_s: float = 2.5
    slip_c: float = 2.0
    ground_height_m: float = 0.12
    ground_slope: float = 0.02
    ground_foot_m: float = 0.04
    error_time_s: float = 0.16
    noise_rounds: int = 3
    tolerance: float = 1e-4
    max_iterations: int = 30

    def as_run(self) -> TrajectoryOptions:
        """With what `fast` makes of the last rounds."""
        if self.fast:
            return replace(self, tolerance=10 * self.tolerance, noise_rounds=1)
        return replace(self, noise_rounds=max(self.noise_rounds, 1))


def solve_trajectory(
    camera: Camera,
    body: Body,
    prior: MotionPrior,
    xy_px: Array,
    confidence: Array,
    fps: float,
    options: TrajectoryOptions | None = None,
    progress: Progress = lambda stage, share: None,
) -> TrajectorySolution:
    """The motion of a body from detections of its markers.

    xy_px (T, J, 2), NaN where missing; confidence (T, J), 0 to 1. Deterministic. Frames too far from any detection have
    NaN states and the flag "no data", those whose pose is too far off to be seen NaN states and the flag "ran away".
    Detections that no detector can have found in the camera's picture are left out (`Camera.sees`). A minimum that was
    not reached is the solution's status, not an exception.

    Runs on one core: the matrices are small, and threads of the numerical library would wait for each other, for many
    times as long on a machine that is busy otherwise.
    """
    began = time.perf_counter()
    xy_px = np.where(camera.sees(xy_px)[..., None], xy_px, np.nan)
    clip = _Clip(camera, body, prior, xy_px, confidence, fps, options or TrajectoryOptions())
    spells = _spells(np.isfinite(xy_px[..., 0]).sum(axis=1) >= MIN_JOINTS, fps)
    solved = []
    with threadpool_limits(1, user_api="blas"):
        for i, spell in enumerate(spells):
            report = lambda stage, share, i=i: progress(stage, (i + share) / len(spells))  # noqa: E731
            solved.append((spell, _solve_spell(clip.part(spell), report)))
        return _assembled(clip, solved, began)


@dataclass(frozen=True, eq=False)
class _Clip:
    """What does not change on the way: the arguments of `solve_trajectory`, of all frames or a part of them."""

    camera: Camera
    body: Body
    prior: MotionPrior
    xy_px: Array
    confidence: Array
    fps: float
    options: TrajectoryOptions

    def part(self, frames: slice) -> _Clip:
        return replace(self, xy_px=self.xy_px[frames], confidence=self.confidence[frames])

    @property
    def level_from_camera(self) -> Array:
        """(3, 3)."""
        right, away = level_axes(self.camera.up)
        return np.stack([right, away, self.camera.up])

    @property
    def feet(self) -> NDArray[np.intp]:
        return np.array([self.body.markers.index(foot) for foot in self.body.feet], dtype=np.intp)

    @property
    def size_sigma(self) -> float:
        """Prior standard deviation of the size, around 1."""
        return self.body.size_sigma if self.options.size_sigma is None else self.options.size_sigma

    @property
    def ground_known(self) -> bool:
        """Whether the ground's distance below the camera is known: world frames have their ground near z = 0."""
        return self.camera.has_extrinsics and self.camera.world_z_up and self.options.ground == "auto"

    def present(self) -> NDArray[np.bool_]:
        """(T, J)."""
        return np.isfinite(self.xy_px[..., 0])

    def markers(self, states: Array) -> Array:
        """(T, J, 3): where the detector sees them, level frame."""
        return self.body.detected.pose(states).points_m

    def noise_px(self, points_m: Array, factor: Array) -> Array:
        """(T, J): the detector's noise, and the keypoints' at the animal's distance, times sqrt(factor) (J,)."""
        o = self.options
        depth = np.maximum(np.median(points_m @ self.level_from_camera[:, 2], axis=1), 0.3)
        focal_px = np.sqrt(self.camera.matrix[0, 0] * self.camera.matrix[1, 1])
        keypoint_m = self.body.keypoint_sigma_m if o.keypoint_sigma_m is None else o.keypoint_sigma_m
        return np.hypot(o.sigma_px, keypoint_m * focal_px / depth)[:, None] * np.sqrt(factor)

    def problem(self, noise_px: Array, temperature: float | None = None, contact_terms: Sequence[Term] = ()) -> Problem:
        """temperature: of the mixture of poses; None: one Gaussian of poses in its place."""
        o, D, T = self.options, self.body.n_state, len(self.xy_px)
        rear, front = (self.body.markers.index(marker) for marker in self.body.forward)
        linear: list[Linear] = []
        terms: list[Term] = [
            Reprojection(self.camera, self.level_from_camera.T, self.xy_px, self.confidence, noise_px, o.robust_c)
        ]
        if temperature is None:
            linear.append(pose_term(self.prior, D, self.fps, o.pose_weight))
        else:
            terms.append(PoseMixture(self.prior, self.fps, o.mixture_weight, temperature))
        if T > 1:
            linear.append(climb_term(D, self.fps, o.climb_m_s))
            terms.append(Heading(rear, front, self.fps, o.lateral_m_s))
        if T > 2:
            linear.append(dynamics_term(self.prior, D, self.fps, o.motion_weight))
            linear.append(root_term(D, self.fps, np.array(o.acceleration_m_s2), o.yaw_acceleration_rad_s2))
        return Problem(self.body.detected, linear, [*terms, *contact_terms])


def _spells(usable: NDArray[np.bool_], fps: float) -> list[slice]:
    """Stretches of frames that are solved as one clip each."""
    at = np.flatnonzero(usable)
    if len(at) == 0:
        return []
    ends = np.flatnonzero(np.diff(at) > BRIDGED_S * fps)
    margin = round(MARGIN_S * fps)
    return [
        slice(max(int(group[0]) - margin, 0), min(int(group[-1]) + margin + 1, len(usable)))
        for group in np.split(at, ends + 1)
    ]


# -- starts --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Approached:
    """A start after the approach; first_cost: of the widest fit, by which the starts are chosen; finished: it was
    carried to the end."""

    heading_rad: float
    first_cost: float
    estimate: Estimate
    finished: bool = False


def _headings(clip: _Clip) -> list[tuple[float, float, Array]]:
    """(misfit, heading, states (T, D)) of the mean pose on a straight run, for headings around the clock."""
    T, count = len(clip.xy_px), _HEADINGS // 2 if clip.options.fast else _HEADINGS
    level = clip.level_from_camera
    usable = np.flatnonzero(clip.present().sum(axis=1) >= MIN_JOINTS)
    some = usable[:: max(1, min(3, len(usable) // 6))]
    rays, _ = clip.camera.rays(clip.xy_px[some])
    time_s = np.arange(T) / clip.fps
    middle = time_s[some].mean()
    headings_rad = 2 * np.pi * np.arange(count) / count
    turned = np.zeros((count, clip.body.n_state))
    turned[:, YAW], turned[:, ANGLES] = headings_rad, clip.prior.mean
    headings = np.stack([np.cos(headings_rad), np.sin(headings_rad), np.zeros(count)], axis=1) @ level
    shapes = clip.markers(turned) @ level
    misfits, runs = straight_runs(headings, shapes, clip.camera.up, rays, time_s[some] - middle)
    found = []
    for misfit, heading, heading_rad, run, state in zip(misfits, headings, headings_rad, runs, turned, strict=True):
        states = np.repeat(state[None], T, axis=0)
        states[:, ROOT] = run_path(heading, clip.camera.up, time_s - middle) @ run @ level.T
        found.append((float(misfit), float(heading_rad), states))
    return found


def _starts(clip: _Clip) -> list[tuple[float, Array]]:
    """(heading, states) of the best runs, and of the best one's mirror image in depth."""
    found = _headings(clip)
    misfit = np.array([m for m, _, _ in found])
    best = int(np.argmin(misfit))
    dips = [i for i in range(len(found)) if misfit[i] <= misfit[i - 1] and misfit[i] <= misfit[(i + 1) % len(found)]]
    order = sorted(dips, key=lambda i: misfit[i])[: 2 if clip.options.fast else 3]
    chosen: list[int] = []
    for i in [*order, -best % len(found)]:
        apart = [abs(np.angle(np.exp(1j * (found[i][1] - found[j][1])))) for j in chosen]
        if all(a > _APART_RAD for a in apart):
            chosen.append(i)
    return [found[i][1:] for i in chosen]


def _thinned(clip: _Clip) -> tuple[_Clip, NDArray[np.intp]]:
    """A clip of fewer frames a second, each of which counts for those left out, and which frames they are (n,)."""
    step = max(1, round(clip.fps / APPROACH_HZ))
    every = np.arange(0, len(clip.xy_px), step)
    return replace(clip, xy_px=clip.xy_px[every], confidence=step * clip.confidence[every], fps=clip.fps / step), every


def _approach(clip: _Clip) -> list[_Approached]:
    """The starts of one window, approached with noise that narrows: best first, only the first ones to the end."""
    fast, ones = clip.options.fast, np.ones(len(clip.body.markers))
    thin, every = _thinned(clip)

    def minimum(states: Array, widen: float, tolerance: float, iterations: int) -> Estimate:
        noise = thin.noise_px(thin.markers(states), ones) * widen
        return thin.problem(noise).minimise(states, tolerance, iterations)

    tried = []
    for heading_rad, states in _starts(clip):
        estimate = minimum(states[every], _WIDE[0], 1e-2, 12)
        tried.append(_Approached(heading_rad, estimate.cost, estimate))
    tried.sort(key=lambda a: a.first_cost)
    for i, start in enumerate(tried[: 1 if fast else 2]):
        estimate = start.estimate
        for widen in _WIDE[1:]:
            estimate = minimum(estimate.states, widen, 3e-3 if fast else 1e-3, 15)
        full = replace(estimate, states=_between(estimate.states, every, len(clip.xy_px)))
        tried[i] = replace(start, estimate=full, finished=True)
    return sorted(tried, key=lambda a: (not a.finished, a.estimate.cost))


# -- one spell -----------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Solved:
    """A solved spell: estimate; its problem; noise_px (T, J); contact (T, F); windows: frames, starts."""

    estimate: Estimate
    problem: Problem
    noise_px: Array
    contact: Array
    ground: Ground | None
    windows: list[tuple[slice, list[_Approached]]]
    stage_s: dict[str, float] = field(default_factory=dict)
    iterations: int = 0


def _solve_spell(clip: _Clip, progress: Progress) -> _Solved:
    o, T = clip.options.as_run(), len(clip.xy_px)
    clock = time.perf_counter()
    windows = []
    parts = np.array_split(np.arange(T), min(max(1, round(T / clip.fps / WINDOW_S)), T))
    for i, part in enumerate(parts):
        frames = slice(int(part[0]), int(part[-1]) + 1)
        if np.any(clip.present()[frames].sum(axis=1) >= MIN_JOINTS):
            windows.append((frames, _approach(clip.part(frames))))
        progress("starts", 0.4 * (i + 1) / len(parts))
    states = _joined(T, windows)
    iterations = sum(a.estimate.iterations for _, starts in windows for a in starts)
    began, clock = clock, time.perf_counter()
    stage_s = {"starts": clock - began}

    ones = np.ones(len(clip.body.markers))
    estimate = Estimate(states, np.inf, 0, False)
    problem = None
    contact, ground, contact_terms = np.zeros((T, len(clip.feet))), None, ()
    noise = ones
    temperatures = [t for t in _TEMPERATURES if t > 1 and not o.fast and len(clip.prior.weights) > 1]
    steps: list[tuple[float | None, bool]] = [
        *((t, False) for t in temperatures),
        *((1.0, True) for _ in range(o.noise_rounds)),
    ]
    if len(windows) > 1:
        steps.insert(0, (None, False))
    noise_px = np.zeros(0)
    for i, (temperature, whole) in enumerate(steps):
        points = clip.markers(estimate.states)
        if whole:
            noise = _noise_factors(clip, points, noise)
            if o.ground == "auto" and len(clip.feet) and T > 2:
                contact, ground, contact_terms = _contacts(clip, points)
        noise_px = clip.noise_px(points, noise)
        problem = clip.problem(noise_px, temperature, contact_terms)
        limit = o.max_iterations if whole else 8
        estimate = problem.minimise(estimate.states, o.tolerance if whole else 1e-3, limit)
        iterations += estimate.iterations
        progress("whole clip", 0.4 + 0.6 * (i + 1) / len(steps))
    assert problem is not None
    stage_s["whole clip"] = time.perf_counter() - clock
    return _Solved(estimate, problem, noise_px, contact, ground, windows, stage_s, iterations)


def _joined(T: int, windows: Sequence[tuple[slice, list[_Approached]]]) -> Array:
    """States (T, D) of the windows' best starts, the frames between them filled up along straight lines."""
    pieces = [(frames, starts[0].estimate) for frames, starts in windows]
    at = np.concatenate([np.arange(T)[frames] for frames, _ in pieces])
    return _between(np.concatenate([estimate.states for _, estimate in pieces]), at, T)


def _between(states: Array, at: NDArray[np.intp], T: int) -> Array:
    """States (T, D) through those (n, D) at some frames (n,), along straight lines between them."""
    states = states.copy()
    states[:, YAW] = np.unwrap(states[:, YAW])
    return np.stack([np.interp(np.arange(T), at, column) for column in states.T], axis=1)


def _noise_factors(clip: _Clip, points_m: Array, factor: Array) -> Array:
    """(J,): variance of each joint's detections relative to the expected one, as the robust loss would have it.

    The mean of weight times squared residual per coordinate, with eight detections' worth of the expectation. Between
    1/4 and 6, that is half and two and a half times the expected standard deviation: a joint is neither followed
    blindly nor given up.
    """
    projected, valid = clip.camera.project(points_m @ clip.level_from_camera)
    seen = clip.present() & valid
    expected_px = clip.noise_px(points_m, np.ones_like(factor))
    q = np.where(seen, np.sum((projected - clip.xy_px) ** 2, axis=-1) / expected_px**2, 0.0)
    for _ in range(10):
        weight = seen / (1.0 + q / factor / clip.options.robust_c**2)
        factor = (np.sum(weight * q, axis=0) / 2 + 8.0) / (seen.sum(axis=0) + 8.0)
    return np.clip(factor, 0.25, 6.0)


def _contacts(clip: _Clip, points_m: Array) -> tuple[Array, Ground | None, tuple[Term, ...]]:
    """Contact (T, F) of every foot, the ground under them, and the terms that hold both."""
    o, feet = clip.options, clip.feet
    stance = Stance(feet, clip.fps, o.slip_m_s, o.slip_c, o.stance_weight)
    _, _, still = stance.contact(points_m)
    middle = 0.5 * (points_m[1:, feet] + points_m[:-1, feet])
    height, sigma = float(np.percentile(middle[..., 2], 10)), 10.0
    if clip.ground_known:
        height = -float(clip.camera.centre_world[2])
        sigma = float(np.hypot(o.ground_height_m, clip.size_sigma * height))
    spread = np.array([sigma, o.ground_slope, o.ground_slope])
    centre = np.median(middle[..., :2].reshape(-1, 2), axis=0)
    rows = np.concatenate([np.ones((*middle.shape[:2], 1)), middle[..., :2] - centre], axis=-1)
    plane, covariance, contact = np.array([height, 0.0, 0.0]), np.diag(spread**2), still
    count = REFERENCE_HZ / clip.fps / o.ground_foot_m**2
    for _ in range(5):
        above = middle[..., 2] - rows @ plane
        contact = still / (1.0 + (above / (3 * o.ground_foot_m)) ** 2) ** 2
        normal = np.einsum("tf,tfa,tfb->ab", contact, rows, rows) * count + np.diag(spread**-2.0)
        covariance = np.linalg.inv(normal)
        pull = np.einsum("tf,tfa,tf->a", contact, rows, middle[..., 2]) * count + spread**-2.0 * (height, 0.0, 0.0)
        plane = covariance @ pull
    both = np.concatenate([contact[:1], np.maximum(contact[1:], contact[:-1]), contact[-1:]])
    if contact.sum() < 3:  # no foot stands: nothing is known of the ground
        return both, None, (stance,)
    on_ground = OnGround(feet, contact, plane, centre, clip.fps, o.ground_foot_m, o.stance_weight)
    slope = plane[1:]
    sigma = float(np.sqrt(covariance[0, 0] * max(o.error_time_s * clip.fps, 1.0)))
    ground = Ground(float(plane[0] - slope @ centre), slope, sigma)
    return both, ground, (stance, on_ground)


# -- the result ----------------------------------------------------------------------------------------------------


def _assembled(clip: _Clip, solved: Sequence[tuple[slice, _Solved]], began: float) -> TrajectorySolution:
    (T, J), F, body = clip.xy_px.shape[:2], len(clip.feet), clip.body
    level = clip.level_from_camera
    clock = time.perf_counter()
    factor = max(clip.options.error_time_s * clip.fps, 1.0)
    posteriors = [posterior(one.problem, body, one.estimate.states, factor) for _, one in solved]
    size, size_sigma = _size(clip, [(one, known) for (_, one), known in zip(solved, posteriors, strict=True)])
    stage_s = {"posterior": time.perf_counter() - clock}
    states, joints = np.full((T, body.n_state), np.nan), np.full((T, J, 3), np.nan)
    covariance, relative = np.full((T, J, 3, 3), np.nan), np.full((T, J, 3, 3), np.nan)
    noise_px, weight, contact = np.full((T, J), np.nan), np.full((T, J), np.nan), np.full((T, F), np.nan)
    alternative, mirrored, extra_cost = np.full(T, np.nan), np.zeros(T, dtype=bool), np.inf
    shares, costs, starts = [], {}, []
    for (frames, one), known in zip(solved, posteriors, strict=True):
        found = one.estimate.states
        points = body.tree.pose(found).points_m
        centred = points - points.mean(axis=1, keepdims=True)
        states[frames], joints[frames] = found, size * points @ level
        covariance[frames] = level.T @ with_size(known.covariance_m2, points, size, size_sigma) @ level
        relative[frames] = level.T @ with_size(known.relative_covariance_m2, centred, size, size_sigma) @ level
        noise_px[frames], contact[frames] = one.noise_px, one.contact
        reprojection = next(term for term in one.problem.terms if isinstance(term, Reprojection))
        weight[frames] = reprojection.weights(clip.markers(found))
        for window, tried in one.windows:
            at = slice(frames.start + window.start, frames.start + window.stop)
            starts += [Start(a.heading_rad, a.first_cost, a.finished) for a in tried]
            second = _alternative(clip, points[window], tried)
            if second is not None:
                alternative[at], mirrored[at] = size * second[0], second[1]
                extra_cost = min(extra_cost, second[2])
        shares.append(known.data_share * len(points))
        for name, cost in one.problem.costs(found).items():
            costs[name] = costs.get(name, 0.0) + cost
        for name, seconds in one.stage_s.items():
            stage_s[name] = stage_s.get(name, 0.0) + seconds
    states[:, ROOT] *= size
    posed = np.isfinite(states[:, 0]).sum()
    away = _out_of_sight(clip, joints)
    flags = _flags(clip, joints, weight, alternative, mirrored, away)
    for values in (states, joints, covariance, relative, noise_px, weight, contact, alternative):
        values[away] = np.nan
    return TrajectorySolution(
        body=body,
        states=states,
        camera_from_level=level.T,
        size=size,
        size_sigma=size_sigma,
        joints_camera_m=joints,
        covariance_m2=covariance,
        relative_covariance_m2=relative,
        data_share=np.sum(shares, axis=0) / posed if shares else np.full(J, np.nan),
        noise_px=noise_px,
        weight=weight,
        flags=flags,
        alternative_m=alternative,
        alternative_cost=extra_cost if np.isfinite(extra_cost) else np.nan,
        contact=contact,
        spells=tuple(Spell(frames, one.ground and one.ground.scaled(size)) for frames, one in solved),
        prior=clip.prior.name,
        status="converged" if solved and all(one.estimate.converged for _, one in solved) else "not_converged",
        cost_by_term=costs,
        iterations=sum(one.iterations for _, one in solved),
        starts=tuple(starts),
        stage_s={**stage_s, "all": time.perf_counter() - began},
    )


def _size(clip: _Clip, solved: Sequence[tuple[_Solved, Posterior]]) -> tuple[float, float]:
    """The size and its standard deviation.

    The prior's 1 with its sigma, and where the ground's distance below the camera is known what it says: the feet on
    the ground are so far below the camera at nominal size, and the size makes that the camera's height.
    """
    precision, pull = clip.size_sigma**-2, clip.size_sigma**-2
    for one, known in solved:
        if clip.ground_known and one.ground is not None:
            at = one.contact / one.contact.sum()
            below = -float(np.sum(at * clip.markers(one.estimate.states)[:, clip.feet, 2]))
            variance = float(np.sum(at * known.covariance_m2[:, clip.feet, 2, 2])) + clip.options.ground_height_m**2
            precision += below**2 / variance
            pull += float(clip.camera.centre_world[2]) * below / variance
    return float(pull / precision), float(precision**-0.5)


def _alternative(clip: _Clip, points_m: Array, tried: Sequence[_Approached]) -> tuple[Array, Array, float] | None:
    """The second start's end: mean distance (n,) of its joints from the solution's, both centred, m; whether its order
    in depth is the other way round (n,); and its extra cost. None where only one start was carried to the end."""
    second = next((a for a in tried[1:] if a.finished), None)
    if second is None or second.estimate.cost > tried[0].estimate.cost + ALTERNATIVE_COST:
        return None
    other = clip.body.tree.pose(second.estimate.states).points_m
    here, there = (p - p.mean(axis=1, keepdims=True) for p in (points_m, other))
    apart = np.linalg.norm(here - there, axis=-1).mean(axis=1)
    return apart, np.sum(here[..., 1] * there[..., 1], axis=1) < 0, second.estimate.cost - tried[0].estimate.cost


def _out_of_sight(clip: _Clip, joints_m: Array) -> NDArray[np.bool_]:
    """(T,): whether a pose of joints (T, J, 3), camera frame, is further off than it can be seen."""
    at = clip.body.markers.index
    limbs = (joints_m[:, [at(marker) for marker in along]] for along in clip.body.limbs.values())
    reach_m = sum(np.linalg.norm(np.diff(limb, axis=1), axis=2).sum(axis=1) for limb in limbs)
    focal_px = np.sqrt(clip.camera.matrix[0, 0] * clip.camera.matrix[1, 1])
    return np.asarray(reach_m * focal_px < MIN_REACH_PX * np.median(joints_m[..., 2], axis=1))


def _flags(
    clip: _Clip,
    joints_m: Array,
    weight: Array,
    alternative_m: Array,
    mirrored: NDArray[np.bool_],
    away: NDArray[np.bool_],
) -> tuple[tuple[str, ...], ...]:
    detected, trusted = clip.present().sum(axis=1), np.nansum(weight, axis=1)
    good = np.percentile(trusted[detected > 0], 90) if detected.any() else 0.0
    rear, front = (joints_m[:, clip.body.markers.index(marker)] for marker in clip.body.forward)
    sight, trunk = joints_m.mean(axis=1), front - rear
    cosine = np.abs(np.sum(sight * trunk, axis=1)) / (np.linalg.norm(sight, axis=1) * np.linalg.norm(trunk, axis=1))
    doubtful = {
        "no data": ~np.isfinite(joints_m[:, 0, 0]) | (detected == 0),
        "ran away": away,
        "data poor": (detected > 0) & (trusted < max(POOR_SHARE * weight.shape[1], POORER_SHARE * good)),
        "ambiguous depth": (cosine > np.cos(END_ON_RAD)) | (mirrored & (alternative_m > ALTERNATIVE_M)),
        "second solution": ~mirrored & (alternative_m > ALTERNATIVE_M),
    }
    return tuple(tuple(name for name, which in doubtful.items() if which[t]) for t in range(len(joints_m)))
