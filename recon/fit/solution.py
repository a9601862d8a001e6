"""Combine the solved segments of a clip into one solution in the world, with its posterior, flags and tests."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations
from typing import Any

import numpy as np

from recon.animal.body import MIN_JOINTS, MIN_REACH_PX, Body
from recon.animal.prior import ANGLES
from recon.base.arrays import Array, Bools
from recon.clip import densest_window
from recon.fit import constants
from recon.fit.banded import eliminated
from recon.fit.clip_problem import ClipProblem
from recon.fit.least_squares import LeastSquares, SharedUnknown
from recon.fit.posterior import Posterior, posterior_with_reestimated_noise, with_size
from recon.fit.result import SINGLE, TRAJECTORY_SHAPES, MotionSegment, SecondCamera, SolvedShape, TrajectorySolution
from recon.fit.segment import SegmentFit, refined, solved_views, with_solved_cameras, with_solved_shape
from recon.fit.starts import ALTERNATIVE_COST
from recon.fit.terms import (
    COMMON_KEYPOINT_BIAS,
    LENGTHS,
    SIDESLIP,
    SIZE,
    OnGround,
    Reprojection,
    extrinsic_correction,
    focal_scale,
    time_offset,
    with_step,
)
from recon.geometry.kinematics import ROOT, YAW

_FRAMES_AT_ONCE = 4096
"""Number of frames that are rounded to single precision at once, to limit the memory."""
MIN_JOINT_FRACTION = 1 / 3
"""Minimum sum of a frame's weights, as a fraction of the number of joints, without the flag "data poor"."""
MIN_WEIGHT_FRACTION = 0.8
"""Minimum sum of a frame's weights, as a fraction of a good frame's sum, without the flag "data poor".

The sum of a good frame is the 90th percentile over the frames.
"""
END_ON_RAD = np.radians(25)
"""Minimum angle (rad) between the line of sight and the trunk without the flag "ambiguous depth".

Only perspective then shows the depth of the trunk, and errors grow as the angle decreases.
"""
TESTED_S = 5.0
"""Length, in seconds, of the part of a clip in which the second camera is tested.

Errors of the model persist, and over a longer time would look like evidence against the camera.
"""
ALTERNATIVE_M = 0.1
"""Maximum mean distance (m) between the joints of two solutions without the flag "ambiguous depth"."""


def solution_of(clip: ClipProblem, segments: Sequence[SegmentFit], expected: Body, began: float) -> TrajectorySolution:
    """Return the solution of a whole clip from its solved segments.

    `expected` is the body before its shape was estimated, and `began` the time at which the fit began, in seconds.
    """
    unshaped = clip
    clip = with_solved_shape(clip, segments[0]) if segments else clip
    posteriors = [_posterior_of(unshaped, clip.body, segment) for segment in segments]
    size, size_sigma, size_from = _estimate_size(clip, segments, posteriors)
    clip_arrays = _ClipArrays(clip)
    alternative_cost = np.inf
    for segment, segment_posterior in zip(segments, posteriors, strict=True):
        for name, values in _segment_arrays(clip, segment, segment_posterior, size, size_sigma):
            clip_arrays.fill(name, segment.rows, values)
        alternative_m = clip_arrays.by_frame("alternative_m")
        alternative_cost = min(alternative_cost, _alternative_cost(clip, segment, size, alternative_m))
    clip_arrays.complete()
    arrays = clip_arrays.arrays
    posed = np.isfinite(arrays["states"][:, 0]).sum()
    out_of_sight = _out_of_sight(clip, arrays["joints_m"])
    flags = _frame_flags(clip, arrays["joints_m"], arrays["weight"], arrays["alternative_m"], out_of_sight)
    clip_arrays.clear(out_of_sight)
    shares = [
        segment_posterior.data_share * (segment.rows.stop - segment.rows.start)
        for segment, segment_posterior in zip(segments, posteriors, strict=True)
    ]
    shared = _shared_fields(clip, segments, posteriors)
    return TrajectorySolution(
        body=clip.body,
        views=solved_views(clip.views, shared["time_offset_frames"], shared["extrinsic_correction"], shared["focal"]),
        **arrays,
        size=size,
        size_sigma=size_sigma,
        size_prior_sigma=clip.size_sigma,
        size_from=size_from,
        data_share=np.sum(shares, axis=0) / posed if shares else np.full(len(clip.body.markers), np.nan),
        flags=flags,
        alternative_cost=alternative_cost if np.isfinite(alternative_cost) else np.nan,
        segments=tuple(
            _segment_in_world(unshaped, segment, size) for segment in segments if not out_of_sight[segment.rows].all()
        ),
        prior=clip.prior.name,
        status="converged" if segments and all(segment.estimate.converged for segment in segments) else "not_converged",
        cost_by_term=_cost_by_term(segments),
        iterations=sum(segment.iterations for segment in segments),
        starts=sum(len(tried) for segment in segments for _, tried in segment.windows),
        **shared,
        shape=_solved_shape(unshaped, clip.body, expected, segments, posteriors, size),
        stage_s={"all": time.perf_counter() - began},
    )


def _shared_fields(
    clip: ClipProblem, segments: Sequence[SegmentFit], posteriors: Sequence[Posterior]
) -> dict[str, Any]:
    """Return the solution's values of the shared unknowns other than the size, by field; 0 if not estimated.

    The values are means over the segments, weighted by the number of frames that several cameras saw.
    """
    V = range(len(clip.views))
    several_see = np.sum([view.present.any(axis=1) for view in clip.views], axis=0) > 1
    frames = np.array([several_see[fit.rows].sum() for fit in segments])
    shares = (frames / max(frames.sum(), 1))[:, None, None]

    def of_views(name: Callable[[int], str], count: int = 1) -> tuple[Array, Array]:
        """Return the mean values of the views' unknowns and their standard deviations, (V, count) each."""
        values = [[fit.shared_values(name(i), count) for i in V] for fit in segments]
        sigmas = [[segment.shared_sigma.get(name(i), np.zeros(count)) for i in V] for segment in posteriors]
        values, sigmas = (shares * np.reshape(parts, (len(segments), len(V), count)) for parts in (values, sigmas))
        return values.sum(axis=0), np.linalg.norm(sigmas, axis=0)

    offsets, offset_sigmas = of_views(time_offset)
    focals, focal_sigmas = of_views(focal_scale)
    sideslip, sideslip_sigma = of_views(lambda _: SIDESLIP)
    corrections, correction_sigmas = of_views(extrinsic_correction, 6)
    return {
        "time_offset_frames": offsets[:, 0],
        "time_offset_sigma_frames": offset_sigmas[:, 0],
        "extrinsic_correction": corrections,
        "extrinsic_correction_sigma": correction_sigmas,
        "focal": focals[:, 0],
        "focal_sigma": focal_sigmas[:, 0],
        "sideslip_rad": float(sideslip[0, 0]),
        "sideslip_sigma_rad": float(sideslip_sigma[0, 0]),
    }


def _posterior_of(unshaped: ClipProblem, body: Body, segment: SegmentFit) -> Posterior:
    """Return the posterior of a segment for the estimated body, from the problem `unshaped` with the expected body."""
    problem = _with_free_world(_with_expected_shape_spread(unshaped, segment.problem))
    return posterior_with_reestimated_noise(problem, body, segment.estimate, unshaped.correlation_frames)


class _ClipArrays:
    """Arrays of a solution (`TRAJECTORY_SHAPES`), filled segment by segment; NaN in frames outside all segments."""

    def __init__(self, clip: ClipProblem) -> None:
        sizes = {"T": len(clip), "J": len(clip.body.markers), "V": len(clip.views), "F": len(clip.feet), "3": 3}
        sizes |= {"D": clip.body.n_state, "A": clip.body.n_state - YAW, "K": len(clip.body.anatomy)}
        self.shapes = {name: tuple(sizes[letter] for letter in letters) for name, letters in TRAJECTORY_SHAPES.items()}
        self.arrays: dict[str, Array] = {}

    def by_frame(self, name: str) -> Array:
        """Return a view of the named array with the frames on the first axis."""
        if name not in self.arrays:
            self.arrays[name] = np.full(self.shapes[name], np.nan)
        return np.moveaxis(self.arrays[name], TRAJECTORY_SHAPES[name].index("T"), 0)

    def fill(self, name: str, rows: slice, values: Array) -> None:
        """Set the named array in the frames `rows` to `values`.

        The array `values` may be rounded in place and stored without a copy. Callers must not use it afterwards.
        """
        if name in SINGLE:
            _round_to_single(values)
        if values.shape == self.shapes[name]:  # stored without a copy, which would be large for a whole clip
            self.arrays[name] = values
        else:
            self.by_frame(name)[rows] = np.moveaxis(values, TRAJECTORY_SHAPES[name].index("T"), 0)

    def complete(self) -> None:
        """Add every array that no segment has filled, with NaN in all frames."""
        for name in TRAJECTORY_SHAPES:
            self.by_frame(name)

    def clear(self, frames: Bools) -> None:
        """Set all arrays to NaN in the frames of a mask (T,)."""
        for name in TRAJECTORY_SHAPES:
            self.by_frame(name)[frames] = np.nan


def _cost_by_term(segments: Sequence[SegmentFit]) -> dict[str, float]:
    costs = [segment.problem.costs(segment.estimate.states, segment.estimate.shared) for segment in segments]
    names = dict.fromkeys(chain.from_iterable(costs))
    return {name: sum(by_name.get(name, 0.0) for by_name in costs) for name in names}


def _round_to_single(values: Array) -> None:
    """Round values to single precision in place, to halve their files, and make matrices exactly symmetric."""
    for first in range(0, len(values), _FRAMES_AT_ONCE):
        rows = slice(first, first + _FRAMES_AT_ONCE)
        values[rows] = values[rows].astype(np.float32)
    if values.ndim > 3 and values.shape[-2] == values.shape[-1]:
        for row, column in combinations(range(values.shape[-1]), 2):
            values[..., column, row] = values[..., row, column]


def _solved_shape(
    clip: ClipProblem,
    body: Body,
    expected: Body,
    segments: Sequence[SegmentFit],
    posteriors: Sequence[Posterior],
    size: float,
) -> SolvedShape | None:
    """Return the estimated lengths and offsets of the body; None if they were not estimated.

    Standard deviations belong to the mean over the segments, weighted by their numbers of frames.
    """
    if clip.shape is None or len(clip.views) == 1 or not segments:
        return None
    frames = np.array([segment.rows.stop - segment.rows.start for segment in segments])
    shares, J = (frames / frames.sum())[:, None], len(body.markers)
    sigmas = {}
    for name, n in ((LENGTHS, len(clip.shape.lengths)), (COMMON_KEYPOINT_BIAS, 3 * J)):
        of_segments = [segment_posterior.shared_sigma.get(name, np.zeros(n)) for segment_posterior in posteriors]
        sigmas[name] = np.linalg.norm(shares * of_segments, axis=0)
    names = clip.shape.lengths.lengths
    lengths_m, expected_lengths_m = (_lengths_m(shown, names) for shown in (body, expected))
    offsets_m, expected_offsets_m = (
        np.array([shown.keypoint_offset_m.get(marker, (0.0, 0.0, 0.0)) for marker in body.markers])
        for shown in (body, expected)
    )
    return SolvedShape(
        names,
        size * lengths_m,
        size * lengths_m * sigmas[LENGTHS],
        expected_lengths_m,
        size * offsets_m,
        size * sigmas[COMMON_KEYPOINT_BIAS].reshape(J, 3),
        expected_offsets_m,
    )


def _lengths_m(body: Body, names: Sequence[str]) -> Array:
    """Return the distances (L,) of the named segments and markers from the origins of their parent segments, m."""
    items = {item.name: item for item in (*body.tree.markers, *body.tree.segments)}
    return np.array([np.linalg.norm(items[name].offset_m) for name in names], dtype=np.float64)


def _with_expected_shape_spread(clip: ClipProblem, problem: LeastSquares) -> LeastSquares:
    """Return the problem with lengths and offsets at least as uncertain as expected.

    The solver uses smaller standard deviations, so that the pose explains as much as possible.
    """
    if problem.shape is None:
        return problem
    _, unknowns = replace(clip, solves_shape=False, shape_scale=(1.0, 1.0)).shared_unknowns()
    expected = {unknown.name: unknown.sigma for unknown in unknowns if unknown.name in (LENGTHS, COMMON_KEYPOINT_BIAS)}
    shared = [
        replace(unknown, sigma=np.maximum(unknown.sigma, expected[unknown.name]))
        if unknown.name in expected
        else unknown
        for unknown in problem.shared
    ]
    return replace(problem, shared=shared)


def _with_free_world(problem: LeastSquares) -> LeastSquares:
    """Return the problem without the ground, which would fix the world, if all cameras' poses are uncertain."""
    names = [unknown.name for unknown in (*problem.shared, *problem.nuisance)]
    if extrinsic_correction(0) not in names:
        return problem
    return replace(problem, terms=[term for term in problem.terms if not isinstance(term, OnGround)])


def states_at_size(states: Array, by_size: Array, size: float, other_size: float) -> Array:
    """Extrapolate states (T, D) at nominal size to another size of the animal, with their derivatives (T, D).

    `by_size` holds the derivatives with respect to the size, at `size`. The animal's position in the world changes
    linearly with the size (`with_step`).
    """
    return with_step(states, by_size * (other_size - size), size, other_size)


def _segment_arrays(
    clip: ClipProblem, segment: SegmentFit, segment_posterior: Posterior, size: float, size_sigma: float
) -> Iterator[tuple[str, Array]]:
    """Yield the name and values of each array of a segment, one after the other to limit the memory."""
    # With several cameras the other shared unknowns, such as the cameras' poses, stay fixed, so that rays still meet.
    state_by_size = segment_posterior.state_by_size if len(clip.views) == 1 else segment_posterior.state_by_size_alone
    states = states_at_size(segment.estimate.states, state_by_size, segment.size, size)
    points = clip.body.tree.pose(states).points_m
    by_size, markers = segment_posterior.joint_by_size_m, clip.in_world(clip.markers(states), size)
    centred = by_size - by_size.mean(axis=1, keepdims=True)
    reprojections = [term for term in segment.problem.terms if isinstance(term, Reprojection)]
    views = with_solved_cameras(clip.part(segment.rows), segment).views
    view_terms = [replace(term, view=view) for term, view in zip(reprojections, views, strict=True)]
    weight = [term.weights(term.view.shift_to_exposure(markers)) for term in view_terms]
    in_world, joints_m = states.copy(), clip.in_world(points, size)
    in_world[:, ROOT] = clip.in_world(states[:, ROOT], size)
    covariance_m2 = with_size(segment_posterior.covariance_m2, by_size, size, size_sigma)
    # with several cameras, the rotation of each is determined by the other cameras
    if len(views) == 1 and views[0].rotation_sigma_rad is not None:
        covariance_m2 += views[0].rotation_covariance_m2(joints_m)
    yield "states", in_world
    yield "joints_m", joints_m
    yield "covariance_m2", covariance_m2
    yield "relative_covariance_m2", with_size(segment_posterior.relative_covariance_m2, centred, size, size_sigma)
    yield (
        "angle_sigma_rad",
        np.sqrt(segment_posterior.angle_variance[0] + (size_sigma * segment_posterior.state_by_size[:, YAW:]) ** 2),
    )
    yield "angle_data_share", segment_posterior.angle_data_share
    yield (
        "flexion_sigma_rad",
        np.sqrt(segment_posterior.flexion_variance[0] + (size_sigma * segment_posterior.flexion_by_size) ** 2),
    )
    yield "contact", segment.contact.copy()
    yield "noise_px", segment.noise_px.copy()
    yield "weight", np.array(weight)


def _estimate_size(
    clip: ClipProblem, segments: Sequence[SegmentFit], posteriors: Sequence[Posterior]
) -> tuple[float, float, tuple[str, ...]]:
    """Return the animal's size, its standard deviation, and the names of its sources.

    The prior expects a size of 1. Several views are a further source. The ground is another source if its distance
    below the camera is known, because the size has to put the feet at this distance.
    """
    prior_precision, bias_variance = clip.size_sigma**-2, _size_error_of_bias(clip) ** 2
    precision, pull, sources = prior_precision, prior_precision, ["prior"]
    for segment, segment_posterior in zip(segments, posteriors, strict=True):
        if segment_posterior.size_precision > 0:
            # Use the estimate from the views alone, because the prior draws the minimum towards 1.
            view_precision = segment_posterior.size_precision * clip.correlation_frames
            seen_precision = 1.0 / (1.0 / segment_posterior.size_precision + bias_variance)
            precision += seen_precision
            pull += seen_precision * (segment.size + (segment.size - 1.0) * prior_precision / view_precision)
            sources.append("views")
        if segment.ground is not None and segment.ground.near_zero:
            contact_share = segment.contact / segment.contact.sum()
            below_m = -float(np.sum(contact_share * clip.markers(segment.estimate.states)[:, clip.feet, 2]))
            variance = float(np.sum(contact_share * segment_posterior.covariance_m2[:, clip.feet, 2, 2]))
            variance += constants.GROUND_HEIGHT_M**2
            precision += below_m**2 / variance
            pull += float(clip.origin_m[2]) * below_m / variance
            sources.append("ground")
    return float(pull / precision), float(precision**-0.5), tuple(dict.fromkeys(sources))


def _segment_in_world(clip: ClipProblem, segment: SegmentFit, size: float) -> MotionSegment:
    ground, misfit = segment.ground and segment.ground.about(clip.origin_m, size), segment.prior_misfit
    level, unlike = (None, False) if misfit is None else (misfit.level, misfit.unlike)
    pair_fixed = len(clip.views) == 2 and clip.shows_size and not clip.options.refine_cameras
    second_camera = _test_second_camera(clip, segment) if pair_fixed else None
    return MotionSegment(segment.rows, ground, level, segment.prior_weight, unlike, second_camera)


def _test_second_camera(clip: ClipProblem, segment: SegmentFit) -> SecondCamera:
    """Test whether the second of two cameras is turned, moved or late.

    The alternatives are that the camera is turned about one axis, displaced along one axis, or late, by
    `MISPLACED_FACTOR` times the expected error. All other unknowns are eliminated from the normal equations, so that
    the cost is a quadratic function of the camera's seven errors. Its evidence under a Gaussian of any width has a
    closed form.
    """
    segment = _seen_by_both(clip, segment)
    problem, usual_sigma = _pair_problem(clip, segment)
    correlation_frames, n = clip.correlation_frames, len(usual_sigma)
    normals = problem.normals(segment.estimate.states, problem.expected() | dict(segment.estimate.shared))
    windows = eliminated(normals(), bounded=True)
    reduced = np.sum([window.reduced() for window in windows], axis=0) / correlation_frames
    by_others = np.linalg.solve(reduced[n:, n:-1], np.delete(reduced[n:], np.s_[n:-1], axis=1))
    remaining = np.delete(reduced[:n], np.s_[n:-1], axis=1) - reduced[:n, n:-1] @ by_others
    precision = remaining[:, :n]
    # gradient extrapolated from the estimated time offset to 0
    pull = remaining[:, n] - remaining[:, n - 1] * segment.shared_values(time_offset(1))

    def evidence(sigma: Array) -> tuple[float, Array]:
        deviation = -np.linalg.solve(precision + np.diag(sigma**-2), pull)
        return -0.5 * float(pull @ deviation + np.linalg.slogdet(np.eye(n) + precision * sigma**2)[1]), deviation

    alternatives = [evidence(np.where(axis, constants.MISPLACED_FACTOR, 1.0) * usual_sigma) for axis in np.eye(n)]
    gains = np.array([log_evidence for log_evidence, _ in alternatives]) - evidence(usual_sigma)[0]
    return SecondCamera(float(gains[:-1].max()), float(gains[-1]), float(alternatives[-1][1][-1]))


def _seen_by_both(clip: ClipProblem, segment: SegmentFit) -> SegmentFit:
    """Return the part of a segment in which both cameras see most joints, solved again.

    Errors of the model persist over many frames, and over a whole clip would look like evidence against the camera.
    """
    seen_by_both = np.all([view.present[segment.rows] for view in clip.views], axis=0).sum(axis=1)
    rows = densest_window(seen_by_both, round(TESTED_S * clip.fps))
    if rows.stop - rows.start == len(seen_by_both):
        return segment
    start, estimate = segment.rows.start, replace(segment.estimate, states=segment.estimate.states[rows])
    return refined(clip, replace(segment, rows=slice(start + rows.start, start + rows.stop), estimate=estimate))


def _pair_problem(clip: ClipProblem, segment: SegmentFit) -> tuple[LeastSquares, Array]:
    """Return the problem with a free second camera, and the usual standard deviations (7,) of this camera's errors.

    The seven errors are the first of the shared unknowns. The size is kept near the expected size, because rays that
    meet in spite of a wrong pose show an animal that is too large or too small. The ground is left out, because a fixed
    plane would fix the world's tilt.
    """
    root_correlation, offset_name = clip.correlation_frames**0.5, time_offset(1)
    shared = {unknown.name: unknown for unknown in (*segment.problem.shared, *segment.problem.nuisance)}
    markers_m = with_solved_shape(clip, segment).markers(segment.estimate.states)
    shift_m = clip.part(segment.rows).shifts_m(markers_m, segment.size)[1]
    offset_sigma = root_correlation * shared[offset_name].sigma[0]
    usual_sigma = np.array([*np.repeat([constants.CALIBRATED_RAD, shift_m], 3), offset_sigma])
    counts = {extrinsic_correction(1): 6, offset_name: 1}
    free = {name: SharedUnknown(name, np.zeros(n), np.full(n, np.inf)) for name, n in counts.items()}
    size_sigma = np.hypot([clip.size_sigma], constants.SIZE_OF_TWO_CAMERAS) / root_correlation
    size = SharedUnknown(SIZE, np.ones(1), size_sigma)
    terms = [term for term in segment.problem.terms if not isinstance(term, OnGround)]
    unknowns = free | shared | free | {SIZE: size}  # the camera's errors come first
    unknowns.pop(extrinsic_correction(0), None)  # a turn of the first camera is treated as one of the second
    return replace(segment.problem, terms=terms, shared=[*unknowns.values()], nuisance=()), usual_sigma


def _size_error_of_bias(clip: ClipProblem) -> float:
    """Return the relative standard deviation of the size due to independent offsets of keypoints from markers."""
    body = clip.body
    state = np.zeros((1, body.n_state))
    state[0, ANGLES] = clip.prior.mean
    points = body.tree.pose(state).points_m[0]
    return clip.keypoint_sigma_m / float(np.linalg.norm(points - points.mean(axis=0)))


def _alternative_cost(clip: ClipProblem, segment: SegmentFit, size: float, distance_m: Array) -> float:
    """Return the minimum extra cost of a second solution in any window of a segment, infinite if there is none.

    The mean distance between the joints of the two solutions, both centred, is written to `distance_m` (T,).
    """
    extra_cost = np.inf
    points = clip.body.tree.pose(segment.estimate.states).points_m
    for window, (best, *alternatives) in segment.windows:
        if clip.options.fast or not alternatives or alternatives[0].cost > best.cost + ALTERNATIVE_COST:
            continue
        alternative = clip.body.tree.pose(alternatives[0].states).points_m
        solution_points, alternative = (p - p.mean(axis=1, keepdims=True) for p in (points[window], alternative))
        clip_rows = slice(segment.rows.start + window.start, segment.rows.start + window.stop)
        distance_m[clip_rows] = size * np.linalg.norm(solution_points - alternative, axis=-1).mean(axis=1)
        extra_cost = min(extra_cost, alternatives[0].cost - best.cost)
    return extra_cost


def _out_of_sight(clip: ClipProblem, joints_m: Array) -> Bools:
    """Return a mask (T,) of the frames whose joints (T, J, 3) are too far away for any camera to see."""
    marker_index = clip.body.markers.index
    limbs = (joints_m[:, [marker_index(marker) for marker in limb]] for limb in clip.body.limbs.values())
    reach_m = sum(np.linalg.norm(np.diff(limb, axis=1), axis=2).sum(axis=1) for limb in limbs)
    depth_by_focal = [np.median(view.to_camera(joints_m)[..., 2], axis=1) / view.focal_px for view in clip.views]
    return np.all(reach_m < MIN_REACH_PX * np.array(depth_by_focal), axis=0)


def _frame_flags(
    clip: ClipProblem, joints_m: Array, weight: Array, alternative_m: Array, out_of_sight: Bools
) -> tuple[tuple[str, ...], ...]:
    """Return the flags of each frame, (T,), from arrays of the solution and a mask (T,) of frames out of sight."""
    detected = clip.present().sum(axis=1)
    trusted = np.where(np.isfinite(weight), weight, 0.0).max(axis=0).sum(axis=1)
    usual_trusted = np.percentile(trusted[detected > 0], 90) if detected.any() else 0.0
    rear, front = (joints_m[:, clip.body.markers.index(marker)] for marker in clip.body.forward)
    trunk, middle = front - rear, joints_m.mean(axis=1)
    camera_sees = np.array([view.present.sum(axis=1) >= MIN_JOINTS for view in clip.views])
    sight = np.array([middle - view.centre_m for view in clip.views])
    lengths = np.linalg.norm(sight, axis=2) * np.linalg.norm(trunk, axis=1)
    end_on = np.abs(np.sum(sight * trunk, axis=2)) / lengths > np.cos(END_ON_RAD)
    end_on_alone = (camera_sees.sum(axis=0) <= 1) & np.all(end_on | (~camera_sees & camera_sees.any(axis=0)), axis=0)
    flagged = {
        "no data": ~np.isfinite(joints_m[:, 0, 0]) | (detected == 0),
        "diverged": out_of_sight,
        "data poor": (detected > 0)
        & (trusted < max(MIN_JOINT_FRACTION * weight.shape[2], MIN_WEIGHT_FRACTION * usual_trusted)),
        "ambiguous depth": end_on_alone | (alternative_m > ALTERNATIVE_M),
    }
    return tuple(tuple(name for name, frames in flagged.items() if frames[t]) for t in range(len(joints_m)))
