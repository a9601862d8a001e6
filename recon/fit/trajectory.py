"""The trajectory method: a whole animal over a whole clip, as one least-squares problem.

Everything happens in the world frame (`recon.geometry.frames`). The unknown motion is that of a body of nominal size
about the first camera's centre (`recon.fit.terms`): the size is known as its prior says, and better only where other
views or the ground's distance below the camera say it. The way to the minimum:

1. Starts. The prior's mean pose runs straight through about a second of clip, in 18 headings, and is fitted to the
   viewing rays (`recon.fit.starts`); the best headings, and the best one mirrored in depth, start the clip.
2. Approach, at a lower frame rate, each start with one Gaussian of poses and wide noise that narrows; the two best
   starts go to the end.
3. The mixture of poses takes the Gaussian's place, flattened at first.
4. Rounds of: the noise of every joint in every view from its residuals (maximum likelihood under the robust loss),
   contacts and the ground from the feet, and the minimum again, the size free where several views show it. If the
   first finds the motion surprising under the prior, this loses weight for the rest (`recon.fit.posterior`).
5. The posterior covariance from the banded factor.

Clips are started and approached about a second at a time, and then solved as one; they are split where nothing is
detected for longer than `BRIDGED_S`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from recon.animal.body import MIN_JOINTS, MIN_REACH_PX, Body
from recon.animal.prior import ANGLES, NONE, MotionPrior
from recon.base import Array, Bools, Progress, silent
from recon.clip import BRIDGED_S, View, densest_window
from recon.fit import constants
from recon.fit.banded import eliminated
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions, contacts
from recon.fit.least_squares import Estimate, LeastSquares, Unknown
from recon.fit.posterior import Posterior, PriorMisfit, about_keypoint_bias, posterior, prior_misfit_of, with_size
from recon.fit.result import SHAPES, Ground, MotionSegment, SecondCamera, TrajectorySolution
from recon.fit.starts import approach, between
from recon.fit.terms import SIDESLIP, SIZE, OnGround, Reprojection, extrinsic_correction, focal, size_of, time_offset
from recon.geometry.kinematics import ROOT, YAW

MARGIN_S = 0.25
"""How far a clip is carried on beyond its first and last detections."""
WINDOW_S = 1.0
_TEMPERATURES = (8.0, 3.0, 1.0)
"""The temperatures by which the mixture of poses is flattened, one after the other."""
_MORE_ROUNDS = 3
"""Where the prior has lost most of its weight: until noise and contacts have settled again."""
POOR_SHARE, POORER_SHARE = 1 / 3, 0.8
"""Frames are "data poor" in which less than this part of the joints is trusted, or of what is in the good frames."""
END_ON_RAD = np.radians(30)
"""Seen along its trunk within this angle, an animal's depth shows in its perspective only: "ambiguous depth"."""
JUDGED_S = 5.0
"""So much of a clip is judged whether its second camera is in its place."""
ALTERNATIVE_M, ALTERNATIVE_COST = 0.1, 20.0
"""A second solution is worth a flag if it is further away than this, and its cost not higher than this."""


def solve_trajectory(
    views: Sequence[View],
    body: Body,
    prior: MotionPrior,
    fps: float,
    options: TrajectoryOptions | None = None,
    progress: Progress = silent,
    ground_near_zero: bool | None = None,
) -> TrajectorySolution:
    """The motion of a body from detections of its markers by one or more cameras, each a view of the same T frames.

    ground_near_zero: whether the ground is known to lie near the world's z = 0; by default where the camera files say
    which way is up. Deterministic. Frames too far from any detection have NaN states and the flag "no data", those
    whose pose is too far off to be seen "diverged". Detections that no detector can have found in the camera's picture
    are left out (`Camera.sees`). A minimum that was not reached is the solution's status, not an exception. On one
    core: the matrices are small, and threads of the numerical library would wait for each other."""
    began = time.perf_counter()
    clip = ClipProblem.of(views, body, prior, fps, options or TrajectoryOptions(), ground_near_zero)
    with threadpool_limits(1, user_api="blas"):
        solved = solve_segments(clip, progress)
        return _solution(clip, solved, began)


def _segments(usable: Bools, fps: float) -> list[slice]:
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


# -- one segment -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SegmentFit:
    """A solved segment of n frames."""

    rows: slice
    """The rows of the clip that the piece covers."""
    estimate: Estimate
    problem: LeastSquares
    noise: Array
    """(V, J): variances of the detections relative to the expected ones."""
    noise_px: Array
    """(V, n, J)"""
    contact: Array
    """(n, F)"""
    ground: Ground | None
    """At nominal size about the origin."""
    prior_misfit: PriorMisfit | None = None
    """The misfit of the motion under the prior, as first found."""
    prior_weight: float = 1.0
    """The part of its weight that the prior has."""
    windows: list[tuple[slice, list[Estimate]]] = field(default_factory=list)
    iterations: int = 0

    @property
    def size(self) -> float:
        return size_of(self.estimate.shared)

    def in_world(self, clip: ClipProblem, size: float) -> MotionSegment:
        """What the solution says of the segment; at nominal size about the clip's origin until then."""
        ground, misfit = self.ground and self.ground.about(clip.origin_m, size), self.prior_misfit
        level, unlike = (None, False) if misfit is None else (misfit.level, misfit.unlike)
        held = len(clip.views) == 2 and clip.shows_size and not clip.options.refine_cameras
        second = _second_camera(clip, self) if held else None
        return MotionSegment(self.rows, ground, level, self.prior_weight, unlike, second)

    def found(self, name: str, count: int = 1) -> Array:
        """(count,): the values of shared unknowns, 0 where they are none."""
        return self.estimate.shared.get(name, np.zeros(count))


def solve_segments(clip: ClipProblem, progress: Progress = silent) -> list[SegmentFit]:
    """Every stretch of a clip between which nothing is seen for long."""
    segments = _segments(clip.present().sum(axis=1) >= MIN_JOINTS, clip.fps)
    return [
        _solve_segment(clip.part(rows), rows, lambda stage, share, i=i: progress(stage, (i + share) / len(segments)))
        for i, rows in enumerate(segments)
    ]


def refined(clip: ClipProblem, solved: SegmentFit) -> SegmentFit:
    """One more round from a solution, of the clip's setting that may have changed a little."""
    return _round(replace(clip.part(solved.rows), prior_weight=solved.prior_weight), solved, 1.0, whole=True)


def _solve_segment(clip: ClipProblem, rows: slice, progress: Progress) -> SegmentFit:
    o, T = clip.options, len(clip)
    rounds = 1 if o.fast else constants.NOISE_ROUNDS
    windows = _windows(clip, progress)
    iterations = sum(start.iterations for _, starts in windows for start in starts)

    temperatures = [t for t in _TEMPERATURES if t > 1 and not o.fast and len(clip.prior.weights) > 1]
    steps: list[tuple[float | None, bool]] = [(None, False)] if len(windows) > 1 else []
    steps += [*((t, False) for t in temperatures), *[(1.0, True)] * rounds]
    best = [(frames, starts[0].states) for frames, starts in windows]
    at = np.concatenate([np.arange(T)[frames] for frames, _ in best])
    estimate = Estimate(between(np.concatenate([states for _, states in best]), at, T), np.inf, 0, False)
    noise = np.ones((len(clip.views), len(clip.body.markers)))
    nothing = LeastSquares(clip.body.detected, [], [])
    solved = SegmentFit(rows, estimate, nothing, noise, np.zeros(0), np.zeros((T, len(clip.feet))), None)
    for i, (temperature, whole) in enumerate(steps):
        solved, last = _round(clip, solved, temperature, whole), i == len(steps) - 1
        unsettled = solved.prior_misfit is None or (solved.prior_weight < 1 and not last)
        if whole and unsettled and clip.prior.name != NONE:
            found = prior_misfit_of(solved.problem, solved.estimate)
            clip = replace(clip, prior_weight=clip.prior_weight * found.prior_weight)
            solved = replace(solved, prior_misfit=solved.prior_misfit or found, prior_weight=clip.prior_weight)
        progress("whole clip", 0.4 + 0.6 * (i + 1) / len(steps))
    settled = solved.prior_misfit is None or not solved.prior_misfit.unlike
    for _ in range(int(rounds == 1 and solved.prior_weight < 1) if settled else _MORE_ROUNDS):
        solved = _round(clip, solved, 1.0, whole=True)
    return replace(solved, windows=windows, iterations=solved.iterations + iterations)


def _round(clip: ClipProblem, solved: SegmentFit, temperature: float | None, whole: bool) -> SegmentFit:
    """The minimum from a solution; whole: with the noise, the contacts and the ground that follow from it."""
    o = clip.options
    estimate, noise, contact, ground, contact_terms = solved.estimate, solved.noise, solved.contact, solved.ground, ()
    points, size = clip.markers(estimate.states), solved.size
    if whole:
        noise = _noise_factors(in_step(clip, solved), points, size, noise)
        if o.ground == "auto" and len(clip.feet) and len(clip) > 2:
            contact, ground, contact_terms = contacts(clip, points, size)
    noise_px = clip.noise_px(points, noise, size)
    problem = clip.problem(noise_px, temperature, contact_terms, points, size)
    tolerance = 1e-3 if not whole else (10 if o.fast else 1) * constants.TOLERANCE
    limit = constants.MAX_ITERATIONS if whole else 8
    estimate = problem.minimise(estimate.states, tolerance, limit, problem.expected() | dict(estimate.shared))
    solved = replace(solved, noise=noise, noise_px=noise_px, contact=contact, ground=ground)
    return replace(solved, estimate=estimate, problem=problem, iterations=solved.iterations + estimate.iterations)


def _shared(clip: ClipProblem, solved: Sequence[SegmentFit], known: Sequence[Posterior]) -> dict[str, Any]:
    """The solution's fields of what all frames share, besides the size, weighed by how many of a segment's frames
    several cameras saw; 0 where it is no unknown."""
    V = range(len(clip.views))
    together = np.sum([view.present.any(axis=1) for view in clip.views], axis=0) > 1
    frames = np.array([together[one.rows].sum() for one in solved])
    shares = (frames / max(frames.sum(), 1))[:, None, None]

    def of_views(name: Callable[[int], str], count: int = 1) -> tuple[Array, Array]:
        """What was found for each of the V views, and its standard deviations, shape (V, count) each."""
        found = [[one.found(name(i), count) for i in V] for one in solved]
        sigmas = [[one.shared_sigma.get(name(i), np.zeros(count)) for i in V] for one in known]
        found, sigmas = (shares * np.reshape(of, (len(solved), len(V), count)) for of in (found, sigmas))
        return found.sum(axis=0), np.linalg.norm(sigmas, axis=0)

    late, longer, sideslip = of_views(time_offset), of_views(focal), of_views(lambda _: SIDESLIP)
    corrections = of_views(extrinsic_correction, 6)
    return (
        {"time_offset_frames": late[0][:, 0], "time_offset_sigma_frames": late[1][:, 0]}
        | {"extrinsic_correction": corrections[0], "extrinsic_correction_sigma": corrections[1]}
        | {"focal": longer[0][:, 0], "focal_sigma": longer[1][:, 0]}
        | {"sideslip_rad": float(sideslip[0][0, 0]), "sideslip_sigma_rad": float(sideslip[1][0, 0])}
    )


def in_step(clip: ClipProblem, solved: SegmentFit) -> ClipProblem:
    """With the lags and the cameras' places of a solution in its views."""
    V = range(len(clip.views))
    late = [float(solved.found(time_offset(i))[0]) for i in V]
    corrections = [solved.found(extrinsic_correction(i), 6) for i in V]
    return replace(clip, views=_found(clip.views, late, corrections, [float(solved.found(focal(i))[0]) for i in V]))


def _found(
    views: Sequence[View], late: Iterable[float], corrections: Iterable[Array], focal_scales: Iterable[float]
) -> tuple[View, ...]:
    return tuple(
        replace(view, offset_frames=view.offset_frames + frames).corrected(correction).with_focal_scale(factor)
        for view, frames, correction, factor in zip(views, late, corrections, focal_scales, strict=True)
    )


def _windows(clip: ClipProblem, progress: Progress) -> list[tuple[slice, list[Estimate]]]:
    """The starts of every stretch of about a second in which something is seen."""
    windows, present, T = [], clip.present(), len(clip)
    parts = np.array_split(np.arange(T), min(max(1, round(T / clip.fps / WINDOW_S)), T))
    for i, part in enumerate(parts):
        frames = slice(int(part[0]), int(part[-1]) + 1)
        if np.any(present[frames].sum(axis=1) >= MIN_JOINTS):
            windows.append((frames, approach(clip.part(frames))))
        progress("starts", 0.4 * (i + 1) / len(parts))
    return windows


def _noise_factors(clip: ClipProblem, points_m: Array, size: float, factors: Array) -> Array:
    """(V, J): variance of each joint's detections relative to the expected one, as the robust loss would have it: the
    mean of weight times squared residual per coordinate, with eight detections' worth of the expectation. Between 1/4
    and 6: a joint is neither followed blindly nor given up."""
    world = clip.in_world(points_m, size)
    found = []
    expected = clip.noise_px(points_m, np.ones_like(factors), size)
    for view, factor, expected_px in zip(clip.views, factors, expected, strict=True):
        projected, valid = view.project(view.shift_to_exposure(world))
        seen = view.present & valid
        q = np.where(seen, np.sum((projected - view.xy_px) ** 2, axis=-1) / expected_px**2, 0.0)
        for _ in range(10):
            weight = seen / (1.0 + q / factor / constants.ROBUST_C**2)
            factor = (np.sum(weight * q, axis=0) / 2 + 8.0) / (seen.sum(axis=0) + 8.0)
        found.append(np.clip(factor, 0.25, 6.0))
    return np.array(found)


# -- the result ----------------------------------------------------------------------------------------------------


def _solution(clip: ClipProblem, solved: Sequence[SegmentFit], began: float) -> TrajectorySolution:
    alike = clip.correlation_frames
    known = [
        posterior(about_keypoint_bias(one.problem, one.estimate, alike), clip.body, one.estimate, alike)
        for one in solved
    ]
    size, size_sigma, size_from = _size(clip, solved, known)
    sizes = {"T": len(clip), "J": len(clip.body.markers), "V": len(clip.views), "F": len(clip.feet), "3": 3}
    sizes |= {"D": clip.body.n_state, "A": clip.body.n_state - YAW}
    shapes = {name: tuple(sizes[letter] for letter in letters) for name, letters in SHAPES.items()}
    arrays: dict[str, Array] = {}

    def by_frame(name: str) -> Array:
        """One of the arrays, frames first; NaN where no segment has filled it."""
        if name not in arrays:
            arrays[name] = np.full(shapes[name], np.nan)
        return np.moveaxis(arrays[name], SHAPES[name].index("T"), 0)

    second_cost = np.inf
    for one, of_one in zip(solved, known, strict=True):
        for name, values in _of_segment(clip, one, of_one, size, size_sigma):
            if values.shape == shapes[name]:  # the segment is the clip: a copy of a long one's would be large
                arrays[name] = values
            else:
                by_frame(name)[one.rows] = np.moveaxis(values, SHAPES[name].index("T"), 0)
        second_cost = min(second_cost, _second(clip, one, size, by_frame("alternative_m")))
    filled = [by_frame(name) for name in SHAPES]
    posed = np.isfinite(arrays["states"][:, 0]).sum()
    away = _out_of_sight(clip, arrays["joints_m"])
    flags = _flags(clip, arrays["joints_m"], arrays["weight"], arrays["alternative_m"], away)
    for values in filled:
        values[away] = np.nan
    shares = [of_one.data_share * (one.rows.stop - one.rows.start) for one, of_one in zip(solved, known, strict=True)]
    shared = _shared(clip, solved, known)
    costs = [one.problem.costs(one.estimate.states, one.estimate.shared) for one in solved]
    names = dict.fromkeys(chain.from_iterable(costs))
    return TrajectorySolution(
        body=clip.body,
        views=_found(clip.views, shared["time_offset_frames"], shared["extrinsic_correction"], shared["focal"]),
        **arrays,
        size=size,
        size_sigma=size_sigma,
        size_prior_sigma=clip.size_sigma,
        size_from=size_from,
        data_share=np.sum(shares, axis=0) / posed if shares else np.full(len(clip.body.markers), np.nan),
        flags=flags,
        alternative_cost=second_cost if np.isfinite(second_cost) else np.nan,
        segments=tuple(one.in_world(clip, size) for one in solved if not away[one.rows].all()),
        prior=clip.prior.name,
        status="converged" if solved and all(one.estimate.converged for one in solved) else "not_converged",
        cost_by_term={name: sum(of_one.get(name, 0.0) for of_one in costs) for name in names},
        iterations=sum(one.iterations for one in solved),
        starts=sum(len(tried) for one in solved for _, tried in one.windows),
        **shared,
        stage_s={"all": time.perf_counter() - began},
    )


def _of_segment(
    clip: ClipProblem, one: SegmentFit, known: Posterior, size: float, size_sigma: float
) -> Iterator[tuple[str, Array]]:
    """The solution's arrays in the frames of one segment, one after the other: those of a long clip are large."""
    states = one.estimate.states + known.state_by_size * (size - one.size)
    points = clip.body.tree.pose(states).points_m
    by_size, markers = known.joint_by_size_m, clip.in_world(clip.markers(states), size)
    centred = by_size - by_size.mean(axis=1, keepdims=True)
    reprojections = [term for term in one.problem.terms if isinstance(term, Reprojection)]
    views = in_step(clip.part(one.rows), one).views
    seen_by = [replace(term, view=view) for term, view in zip(reprojections, views, strict=True)]
    weight = [term.weights(term.view.shift_to_exposure(markers)) for term in seen_by]
    in_world, joints_m = states.copy(), clip.in_world(points, size)
    in_world[:, ROOT] = clip.in_world(states[:, ROOT], size)
    covariance_m2 = with_size(known.covariance_m2, by_size, size, size_sigma)
    if len(views) == 1 and views[0].rotation_sigma_rad is not None:  # of several, one's turn is known by the others
        covariance_m2 += views[0].rotation_covariance_m2(joints_m)
    yield "states", in_world
    yield "joints_m", joints_m
    yield "covariance_m2", covariance_m2
    yield "relative_covariance_m2", with_size(known.relative_covariance_m2, centred, size, size_sigma)
    yield "angle_sigma_rad", np.sqrt(known.angle_variance[0] + (size_sigma * known.state_by_size[:, YAW:]) ** 2)
    yield "angle_data_share", known.angle_data_share
    yield "contact", one.contact.copy()
    yield "noise_px", one.noise_px.copy()
    yield "weight", np.array(weight)


def _size(
    clip: ClipProblem, solved: Sequence[SegmentFit], known: Sequence[Posterior]
) -> tuple[float, float, tuple[str, ...]]:
    """The size, its standard deviation, and what says it: the prior's 1; several views; and where the ground's distance
    below the camera is known, the size that makes the feet on the ground so far below it."""
    of_prior, lasting = clip.size_sigma**-2, _size_of_offsets(clip) ** 2
    precision, pull, sources = of_prior, of_prior, ["prior"]
    for one, of_one in zip(solved, known, strict=True):
        if of_one.size_precision > 0:
            # What the views alone say: the minimum is drawn to the prior's 1.
            of_views = of_one.size_precision * clip.correlation_frames
            seen = 1.0 / (1.0 / of_one.size_precision + lasting)
            precision += seen
            pull += seen * (one.size + (one.size - 1.0) * of_prior / of_views)
            sources.append("views")
        if one.ground is not None and one.ground.near_zero:
            at = one.contact / one.contact.sum()
            below = -float(np.sum(at * clip.markers(one.estimate.states)[:, clip.feet, 2]))
            variance = float(np.sum(at * of_one.covariance_m2[:, clip.feet, 2, 2]))
            variance += constants.GROUND_HEIGHT_M**2
            precision += below**2 / variance
            pull += float(clip.origin_m[2]) * below / variance
            sources.append("ground")
    return float(pull / precision), float(precision**-0.5), tuple(dict.fromkeys(sources))


def _second_camera(clip: ClipProblem, one: SegmentFit) -> SecondCamera:
    """What is likelier of the second of two cameras than that its pose and clock are as good as expected: that one axis
    about which it is turned or along which it stands, or its clock, is `MISPLACED` times as far off. All else follows,
    but for the size, which is held as expected: where rays meet in spite of a wrong pose, the animal is too large or
    too small. The ground follows the feet: as it is, it would hold the world. Judged is the stretch in which both
    cameras see most: what is not quite as the model says, and lasts, would grow with a clip's length."""
    together = np.all([view.present[one.rows] for view in clip.views], axis=0).sum(axis=1)
    rows = densest_window(together, round(JUDGED_S * clip.fps))
    if rows.stop - rows.start < len(together):
        estimate = replace(one.estimate, states=one.estimate.states[rows])
        start = one.rows.start
        one = refined(clip, replace(one, rows=slice(start + rows.start, start + rows.stop), estimate=estimate))
    root, late = clip.correlation_frames**0.5, time_offset(1)
    shared = {unknown.name: unknown for unknown in (*one.problem.shared, *one.problem.doubtful)}
    shift_m = clip.part(one.rows).shifts_m(clip.markers(one.estimate.states), one.size)[1]
    usual = np.array([*np.repeat([constants.CALIBRATED_RAD, shift_m], 3), root * shared[late].sigma[0]])
    names = (extrinsic_correction(1), late)
    free = {name: Unknown(name, np.zeros(n), np.full(n, np.inf)) for name, n in zip(names, (6, 1), strict=True)}
    size = Unknown(SIZE, np.ones(1), np.hypot([clip.size_sigma], constants.SIZE_OF_TWO_CAMERAS) / root)
    terms = [term for term in one.problem.terms if not isinstance(term, OnGround)]
    problem = replace(one.problem, terms=terms, shared=[*(free | shared | free | {SIZE: size}).values()], doubtful=())
    normals = problem.normals(one.estimate.states, problem.expected() | dict(one.estimate.shared))
    reduced = np.sum([window.reduced() for window in eliminated(normals(), bounded=True)], axis=0) / root**2
    n = len(usual)
    of_others = np.linalg.solve(reduced[n:, n:-1], np.delete(reduced[n:], np.s_[n:-1], axis=1))
    left = np.delete(reduced[:n], np.s_[n:-1], axis=1) - reduced[:n, n:-1] @ of_others
    precision, pull = left[:, :n], left[:, n] - left[:, n - 1] * one.found(late)  # where all are as said

    def evidence(sigma: Array) -> tuple[float, Array]:
        off = -np.linalg.solve(precision + np.diag(sigma**-2), pull)
        return -0.5 * float(pull @ off + np.linalg.slogdet(np.eye(n) + precision * sigma**2)[1]), off

    each = [evidence(np.where(axis, constants.MISPLACED, 1.0) * usual) for axis in np.eye(n)]
    likelier = np.array([one for one, _ in each]) - evidence(usual)[0]
    return SecondCamera(float(likelier[:-1].max()), float(likelier[-1]), float(each[-1][1][-1]))


def _size_of_offsets(clip: ClipProblem) -> float:
    """What keypoints look like as a size that lie beside their markers in the same direction all the time."""
    body = clip.body
    state = np.zeros((1, body.n_state))
    state[0, ANGLES] = clip.prior.mean
    points = body.tree.pose(state).points_m[0]
    return clip.keypoint_sigma_m / float(np.linalg.norm(points - points.mean(axis=0)))


def _second(clip: ClipProblem, one: SegmentFit, size: float, apart_m: Array) -> float:
    """The least extra cost of another start; apart_m (T,) gets the mean distance of its joints, both centred."""
    extra_cost = np.inf
    points = clip.body.tree.pose(one.estimate.states).points_m
    for window, (best, *others) in one.windows:
        if clip.options.fast or not others or others[0].cost > best.cost + ALTERNATIVE_COST:
            continue
        there = clip.body.tree.pose(others[0].states).points_m
        here, there = (p - p.mean(axis=1, keepdims=True) for p in (points[window], there))
        at = slice(one.rows.start + window.start, one.rows.start + window.stop)
        apart_m[at] = size * np.linalg.norm(here - there, axis=-1).mean(axis=1)
        extra_cost = min(extra_cost, others[0].cost - best.cost)
    return extra_cost


def _out_of_sight(clip: ClipProblem, joints_m: Array) -> Bools:
    """(T,): whether a pose of joints (T, J, 3) is further off than any camera can see it."""
    at = clip.body.markers.index
    limbs = (joints_m[:, [at(marker) for marker in along]] for along in clip.body.limbs.values())
    reach_m = sum(np.linalg.norm(np.diff(limb, axis=1), axis=2).sum(axis=1) for limb in limbs)
    away = [np.median(view.to_camera(joints_m)[..., 2], axis=1) / view.focal_px for view in clip.views]
    return np.all(reach_m < MIN_REACH_PX * np.array(away), axis=0)


def _flags(
    clip: ClipProblem, joints_m: Array, weight: Array, second_m: Array, away: Bools
) -> tuple[tuple[str, ...], ...]:
    """weight (V, T, J)."""
    detected = clip.present().sum(axis=1)
    trusted = np.where(np.isfinite(weight), weight, 0.0).max(axis=0).sum(axis=1)
    good = np.percentile(trusted[detected > 0], 90) if detected.any() else 0.0
    rear, front = (joints_m[:, clip.body.markers.index(marker)] for marker in clip.body.forward)
    trunk, middle = front - rear, joints_m.mean(axis=1)
    sees = np.array([view.present.sum(axis=1) >= MIN_JOINTS for view in clip.views])
    sight = np.array([middle - view.centre_m for view in clip.views])
    lengths = np.linalg.norm(sight, axis=2) * np.linalg.norm(trunk, axis=1)
    end_on = np.abs(np.sum(sight * trunk, axis=2)) / lengths > np.cos(END_ON_RAD)
    alone = (sees.sum(axis=0) <= 1) & np.all(end_on | (~sees & sees.any(axis=0)), axis=0)
    doubtful = {
        "no data": ~np.isfinite(joints_m[:, 0, 0]) | (detected == 0),
        "diverged": away,
        "data poor": (detected > 0) & (trusted < max(POOR_SHARE * weight.shape[2], POORER_SHARE * good)),
        "ambiguous depth": alone | (second_m > ALTERNATIVE_M),
    }
    return tuple(tuple(name for name, which in doubtful.items() if which[t]) for t in range(len(joints_m)))
