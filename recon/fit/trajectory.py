"""Solve for the motion of a whole animal over a whole clip, as one least-squares problem.

Three objects appear throughout. `clip` is the `ClipProblem`, the fixed inputs of one fit. A *segment* (`SegmentFit`) is
a part of the clip that is solved separately, with its solution. `problem` is the `LeastSquares` problem of one segment.
Everything is in the world frame (`recon.geometry.frames`). The unknowns describe the motion of a body of nominal size
about the first camera's centre (`recon.fit.terms`). The size follows from its prior, and from other views or the
ground's distance below the camera if they determine it. The steps to the minimum are:

1. Starts. The prior's mean pose runs straight through about a second of the clip, in 18 headings, and is fitted to the
viewing rays (`recon.fit.starts`). The two best headings start the clip. With one camera, the best heading mirrored in
depth is a third start.
2. Approach, at a lower frame rate. Each start is solved with one Gaussian of poses and with noise that is large at
first. Only the two best starts are solved down to the final noise.
3. The mixture of poses replaces the Gaussian, flattened at first, still at the lower frame rate.
4. Rounds. Each round estimates the noise of every joint in every view from its residuals (maximum likelihood under the
robust loss), and contacts and the ground from the feet, and solves for the minimum again. The size is free where
several views show it. If the motion is unlikely under the prior in the first round, the prior loses weight for the rest
(`recon.fit.posterior`).
5. Result. The posterior covariance is computed from the banded factor, and all segments are combined
(`recon.fit.solution`).

Steps 1 and 2 work on windows of about a second, and the later steps solve each segment as a whole. A clip is split into
segments where nothing is detected for longer than `BRIDGED_S`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.animal.body import MIN_JOINTS, Body
from recon.animal.prior import NONE, MotionPrior
from recon.base.arrays import Bools
from recon.base.progress import Progress, silent
from recon.base.threads import one_thread
from recon.clip import BRIDGED_S, View, densest_window
from recon.fit import constants
from recon.fit.body_shape import FreeShape
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions, contacts
from recon.fit.least_squares import Estimate
from recon.fit.posterior import pair_poses_of, prior_misfit_of
from recon.fit.result import TrajectorySolution
from recon.fit.segment import SegmentFit, refined, solve_round
from recon.fit.smoothness import likely_scale
from recon.fit.solution import solution_of
from recon.fit.starts import APPROACH_HZ, approach, interpolate_states
from recon.fit.terms import COMMON_KEYPOINT_BIAS, LENGTHS, SIZE, extrinsic_correction, size_of, time_offset

MARGIN_S = 0.25
"""Time by which a segment extends beyond its first and last detections, s."""
WINDOW_S = 1.0
"""Approximate length (s) of the windows for which starts are found separately."""
STARTS_END = 0.2
"""Fraction of the solver's time after which the starts are done, for the progress bar."""
ROUNDS_END = 0.8
"""Fraction of the solver's time after which the rounds are done and the posterior begins, for the progress bar."""
FLATTENED_FRACTION = 0.1
"""Fraction of the time between starts and posterior that step 3 takes, for the progress bar."""
SHAPE_S = 45.0
"""Maximum duration (s) of the part of a clip from which the lengths and offsets of an unknown shape are estimated.

A larger animal whose lengths are all shorter has the same markers, so only priors determine the common factor. The
priors of the motion, which belong to the nominal size, count in every frame, and outweigh the prior of the lengths in a
long clip. An animal of size 1, simulated with six cameras (`benchmarks/parts/long_clips.py`), had a size of 1.02 from
44 s, but 1.18 from 67 s and 1.37 from 89 s.
"""
_TEMPERATURES = (8.0, 3.0)
"""Temperatures that flatten the mixture of poses in step 3, in the order in which they are used."""
_FLATTENED_TOLERANCE = 5e-3
"""Minimum relative decrease of the cost with which the search at one temperature of the mixture continues."""
_FLATTENED_ITERATIONS = 8
"""Maximum number of iterations of the search at one temperature of the mixture."""
_MORE_ROUNDS = 3
"""Number of further rounds if the motion is unlike the prior's motions, so that noise and contacts can settle again."""


def solve_trajectory(
    views: Sequence[View],
    body: Body,
    prior: MotionPrior,
    fps: float,
    options: TrajectoryOptions | None = None,
    progress: Progress = silent,
    ground_near_zero: bool | None = None,
    start: TrajectorySolution | None = None,
) -> TrajectorySolution:
    """Return the motion of a body from detections of its markers by one or more cameras.

    The solution is deterministic. It uses one core, because the matrices are small and threads of the numerical library
    would wait for each other. Frames too far from any detection have NaN states and the flag "no data". Frames whose
    pose is too far away to be visible have the flag "diverged". Detections outside the camera's picture are left out
    (`Camera.sees`). A search that does not converge is reported by the solution's `status`, not as an exception.

    Parameters
    ----------
    views
        V views of the same T frames.
    body
        The body, with J markers.
    prior
        The prior of the body's poses and motion.
    fps
        Frames per second.
    options
        Options of the fit; None for the defaults.
    progress
        Function that is called with the name of the stage and the fraction that is done.
    ground_near_zero
        Whether the ground is known to be near z = 0. None means that it is, if all camera files state which way is up.
    start
        Solution for nearly the same detections of the same frames, from which the search begins; None for a full
        search. No other start is tried, which is several times faster, but correct only if the solution is near.

    Returns
    -------
    TrajectorySolution
        Motion in the world frame, metres, with its posterior and flags.
    """
    began = time.perf_counter()
    clip = ClipProblem.from_views(views, body, prior, fps, options or TrajectoryOptions(), ground_near_zero)
    clip = clip.with_free_shape()
    with one_thread():
        clip = _with_shape_of_part(clip)
        segments = solve_segments(clip, progress) if start is None else _solve_segments_from(clip, start)
        clip, segments = _with_one_shape(clip, segments)
        solution = solution_of(clip, segments, body, began)
    return solution if start is None else _with_misfit_of(start, solution)


def solve_segments(clip: ClipProblem, progress: Progress = silent) -> list[SegmentFit]:
    """Solve the segments of a clip, which long gaps without detections separate."""
    segments = _segments(clip.present().sum(axis=1) >= MIN_JOINTS, clip.fps)
    return [
        _solve_segment(clip.part(rows), rows, lambda stage, share, i=i: progress(stage, (i + share) / len(segments)))
        for i, rows in enumerate(segments)
    ]


def _segments(usable: Bools, fps: float) -> list[slice]:
    """Return the parts of the clip that are solved separately, as slices of its frames."""
    seen_frames = np.flatnonzero(usable)
    if len(seen_frames) == 0:
        return []
    ends = np.flatnonzero(np.diff(seen_frames) > BRIDGED_S * fps)
    margin = round(MARGIN_S * fps)
    return [
        slice(max(int(stretch[0]) - margin, 0), min(int(stretch[-1]) + margin + 1, len(usable)))
        for stretch in np.split(seen_frames, ends + 1)
    ]


def _solve_segment(clip: ClipProblem, rows: slice, progress: Progress) -> SegmentFit:
    """Solve one segment without an earlier solution, from the search for starts to the last estimate of the noise."""
    options, T = clip.options, len(clip)
    rounds = constants.NOISE_ROUNDS
    if options.fast:  # if the shape is estimated, a first round is needed to estimate the noise
        rounds = 1 if clip.shape is None or not clip.solves_shape else 2
    windows = _windows(clip, progress)
    iterations = sum(start.iterations for _, starts in windows for start in starts)

    temperatures: list[float | None] = [None] if len(windows) > 1 else []
    if not options.fast and len(clip.prior.weights) > 1:
        temperatures += _TEMPERATURES
    first_states = [(frames, starts[0].states) for frames, starts in windows]
    start_frames = np.concatenate([np.arange(T)[frames] for frames, _ in first_states])
    estimate = Estimate(
        interpolate_states(np.concatenate([states for _, states in first_states]), start_frames, T), np.inf, 0, False
    )
    segment = _solve_flattened(clip, SegmentFit.unsolved(clip, rows, estimate), temperatures)
    rounds_began = STARTS_END + (ROUNDS_END - STARTS_END) * FLATTENED_FRACTION
    progress("whole clip", rounds_began)
    if options.refine_cameras:  # the ground under a motion seen by misplaced cameras would keep them misplaced
        segment = solve_round(replace(clip.without_ground(), shape=None), segment)
    for i in range(rounds):
        is_last = i == rounds - 1
        # A shape measured with the detector is close enough for the first round.
        keeps_shape = i == 0 and clip.detector_is_measured
        segment = solve_round(replace(clip, shape=None) if keeps_shape else clip, segment, roughly=not is_last)
        if LENGTHS in segment.estimate.shared:
            clip = clip.with_likely_shape_spread(segment.estimate.shared)
        if not is_last:
            clip = _with_likely_accelerations(clip, segment)
        unsettled = segment.prior_misfit is None or (segment.prior_weight < 1 and not is_last)
        if unsettled and clip.prior.name != NONE:
            misfit = prior_misfit_of(segment.problem, segment.estimate)
            clip = replace(clip, prior_weight=clip.prior_weight * misfit.prior_weight)
            segment = replace(segment, prior_misfit=segment.prior_misfit or misfit, prior_weight=clip.prior_weight)
        progress("whole clip", rounds_began + (ROUNDS_END - rounds_began) * (i + 1) / rounds)
    # The only round of a fast fit gave the prior its full weight.
    more_rounds = 1 if rounds == 1 and segment.prior_weight < 1 else 0
    if segment.prior_misfit is not None and segment.prior_misfit.unlike:
        more_rounds = _MORE_ROUNDS
    for _ in range(more_rounds):
        segment = solve_round(clip, segment)
    return replace(segment, windows=windows, iterations=segment.iterations + iterations)


def _windows(clip: ClipProblem, progress: Progress) -> list[tuple[slice, list[Estimate]]]:
    """Return the frames and the starts of every window that has detections."""
    windows, is_present, T = [], clip.present(), len(clip)
    windows_of_frames = np.array_split(np.arange(T), min(max(1, round(T / clip.fps / WINDOW_S)), T))
    for i, window_frames in enumerate(windows_of_frames):
        frames = slice(int(window_frames[0]), int(window_frames[-1]) + 1)
        if np.any(is_present[frames].sum(axis=1) >= MIN_JOINTS):
            windows.append((frames, approach(clip.part(frames))))
        progress("starts", STARTS_END * (i + 1) / len(windows_of_frames))
    return windows


def _solve_flattened(clip: ClipProblem, segment: SegmentFit, temperatures: Sequence[float | None]) -> SegmentFit:
    """Solve a segment at a lower frame rate with a mixture of poses, flattened by each of several temperatures.

    A temperature of None means a single Gaussian of poses.
    """
    if not temperatures:
        return segment
    step, T = max(1, round(clip.fps / APPROACH_HZ)), len(clip)
    kept_frames, thin = np.arange(0, T, step), replace(clip.thinned(step), shape=None)
    estimate, iterations = segment.estimate, 0
    estimate = replace(estimate, states=estimate.states[kept_frames])
    for temperature in temperatures:
        points, size = thin.markers(estimate.states), size_of(estimate.shared)
        problem = thin.problem(thin.noise_px(points, segment.noise, size), temperature, (), points, size)
        shared = problem.expected() | dict(estimate.shared)
        estimate = problem.minimise(estimate.states, _FLATTENED_TOLERANCE, _FLATTENED_ITERATIONS, shared)
        iterations += estimate.iterations
    offsets = {time_offset(i) for i in range(len(clip.views))}
    shared = {name: step * values if name in offsets else values for name, values in estimate.shared.items()}
    estimate = replace(estimate, states=interpolate_states(estimate.states, kept_frames, T), shared=shared)
    return replace(segment, estimate=estimate, iterations=segment.iterations + iterations)


def _with_likely_accelerations(clip: ClipProblem, segment: SegmentFit) -> ClipProblem:
    """Return the problem with the likeliest spread of accelerations, if several cameras and no prior determine it."""
    if len(clip.views) == 1 or clip.prior.name != NONE or clip.known_states is not None:
        return clip
    scale = clip.acceleration_scale if clip.acceleration_scale is not None else np.ones(clip.body.n_state)
    scale = likely_scale(segment.problem, segment.estimate.states, segment.estimate.shared, scale)
    return replace(clip, acceleration_scale=scale)


def _solve_segments_from(clip: ClipProblem, start: TrajectorySolution) -> list[SegmentFit]:
    """Solve every segment from an earlier solution, with the noise and prior weights of the earlier solution.

    A segment without a pose in the earlier solution is solved from the beginning.
    """
    states = clip.nominal(start.states, start.size)
    shared = {SIZE: np.array([start.size])} if clip.shows_size else {}
    if clip.options.refine_cameras:
        refined_views = range(0 if clip.options.refine_first else 1, len(clip.views))
        shared |= {extrinsic_correction(i): start.extrinsic_correction[i] for i in refined_views}
    weights = {(part.rows.start, part.rows.stop): part.prior_weight for part in start.segments}
    segments = []
    for rows in _segments(clip.present().sum(axis=1) >= MIN_JOINTS, clip.fps):
        part, weight = clip.part(rows), weights.get((rows.start, rows.stop))
        if weight is None or not np.isfinite(states[rows]).all():
            segments.append(_solve_segment(part, rows, silent))
            continue
        estimate = Estimate(states[rows], np.inf, 0, False, shared)
        part = replace(part, prior_weight=weight)
        segment = replace(SegmentFit.unsolved(part, rows, estimate), noise_px=start.noise_px[:, rows])
        if part.options.refine_cameras:
            segment = _solve_with_noise(part.without_ground(), segment)
            if part.options.refine_first:
                part = _with_likely_poses(part, segment)
                segment = _solve_with_noise(part.without_ground(), segment)
                part = _with_likely_poses(part, segment)
            segment = solve_round(part, segment)
        else:
            segment = _solve_with_noise(part, segment)
        segments.append(replace(segment, prior_weight=weight))
    return segments


def _solve_with_noise(clip: ClipProblem, segment: SegmentFit) -> SegmentFit:
    """Solve a segment again from its fit, with the fit's noise and the contacts that follow from the fit."""
    points, size = clip.markers(segment.estimate.states), segment.size
    contact, ground, contact_terms = contacts(clip, points, size)
    problem = clip.problem(segment.noise_px, 1.0, contact_terms, points, size)
    shared = problem.expected() | dict(segment.estimate.shared)
    estimate = problem.minimise(segment.estimate.states, constants.TOLERANCE, constants.MAX_ITERATIONS, shared)
    fit = replace(segment, contact=contact, ground=ground, estimate=estimate, problem=problem)
    return replace(fit, iterations=estimate.iterations)


def _with_likely_poses(clip: ClipProblem, segment: SegmentFit) -> ClipProblem:
    """Return the problem with prior means of two cameras' poses that lead to the poses expected over all hypotheses."""
    weighed = pair_poses_of(segment.problem, segment.estimate, clip.correlation_frames)
    return clip if weighed is None else replace(clip, pose_means=weighed.prior_mean.reshape(2, 6))


def _with_misfit_of(start: TrajectorySolution, solution: TrajectorySolution) -> TrajectorySolution:
    """Return a solution with the prior misfits of an earlier solution, for segments that have none."""
    known = {(part.rows.start, part.rows.stop): part for part in start.segments}
    segments = []
    for segment in solution.segments:
        earlier = known.get((segment.rows.start, segment.rows.stop))
        if segment.prior_misfit is None and earlier is not None:
            segment = replace(segment, prior_misfit=earlier.prior_misfit, unlike_prior=earlier.unlike_prior)
        segments.append(segment)
    return replace(solution, segments=tuple(segments))


def _with_shape_of_part(clip: ClipProblem) -> ClipProblem:
    """Return the problem with the shape of the part with the most detections, if the clip is longer than `SHAPE_S`."""
    n = round(SHAPE_S * clip.fps)
    if clip.shape is None or not clip.solves_shape or len(clip) <= n:
        return clip
    part = clip.part(densest_window(clip.present().sum(axis=1), n))
    shaped = [segment for segment in solve_segments(part) if LENGTHS in segment.estimate.shared]
    if not shaped:
        return clip
    known = _with_mean_shape(part, shaped)
    return replace(clip, body=known.body, shape=known.shape, solves_shape=False)


def _with_one_shape(clip: ClipProblem, segments: list[SegmentFit]) -> tuple[ClipProblem, list[SegmentFit]]:
    """Return the problem and the segments, solved again with the mean of the segments' body shapes."""
    shaped = [segment for segment in segments if LENGTHS in segment.estimate.shared]
    if clip.shape is None or len(shaped) < 2:
        return clip, segments
    clip = _with_mean_shape(clip, shaped)
    return clip, [refined(clip, _without_shape(segment)) for segment in segments]


def _with_mean_shape(clip: ClipProblem, shaped: Sequence[SegmentFit]) -> ClipProblem:
    """Return the problem with the mean of the body shapes of some segments, weighted by their detections."""
    assert clip.shape is not None
    counts = np.array([sum(view.present[segment.rows].sum() for view in clip.views) for segment in shaped], dtype=float)
    shares = counts / counts.sum()
    mean = {
        name: np.sum(
            [fraction * segment.estimate.shared[name] for fraction, segment in zip(shares, shaped, strict=True)], axis=0
        )
        for name in (LENGTHS, COMMON_KEYPOINT_BIAS)
        if name in shaped[0].estimate.shared
    }
    body = clip.shape.applied(mean)
    return replace(clip, body=body, shape=FreeShape.of_body(body), solves_shape=False)


def _without_shape(segment: SegmentFit) -> SegmentFit:
    shared = {
        name: values for name, values in segment.estimate.shared.items() if name not in (LENGTHS, COMMON_KEYPOINT_BIAS)
    }
    return replace(segment, estimate=replace(segment.estimate, shared=shared))
