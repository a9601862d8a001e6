"""Detect wrong inputs: copies, moving cameras, swaps, gross outliers, another picture or camera, a wrong frame rate.

Copied detections, and motions that no animal makes, are tested first. Detections that are equal to the last digit were
copied, not measured. If the camera pans, all feet in stance slide together. The other faults are detected because the
clip becomes much more likely when they are corrected (`recon.check.likelihood`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, repeat
from typing import Any

import numpy as np

from recon.animal.body import opposites
from recon.animal.prior import NONE, MotionPrior, mean_speed_m_s
from recon.base.arrays import Array, Bools, running_median
from recon.base.threads import one_thread
from recon.check.clocks import drift_findings
from recon.check.codes import FLAG_OF, SPEEDS, by_effect, finding
from recon.check.focal import assumed_lens_finding, focal_finding
from recon.check.halves import halves_finding, hind_offset
from recon.check.likelihood import (
    EXAMINED_GAIN,
    Baseline,
    baseline_of,
    common_picture_finding,
    finding_of_pictures,
    frame_rate_finding,
    lens_findings,
    log_tail,
    other_pictures,
    unit_square_finding,
    with_calibration_at_either_end,
)
from recon.check.one_step import Step, one_steps
from recon.check.other_camera import other_camera_finding
from recon.check.stretch import STRETCH, stretch_finding
from recon.check.swaps import Swap, swap_finding, swaps
from recon.check.swaps_between import swaps_between
from recon.clip import Keypoints, Source, View, frame_ranges, leave_out, longest_run
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.motion import Motion, trajectory_solution
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.terms import REFERENCE_HZ
from recon.fit.triangulation import predicted_by_others
from recon.geometry.camera import Camera

FASTEST_M_S = 40.0
"""Speed above which no animal runs.

Cheetahs reach 29 m/s (N. Sharp, *Timed running speed of a cheetah*, J. Zool. 1997).
"""

MOSTLY_POOR = 0.9
"""Fraction of frames with few or no detections above which the frame rate is not tested.

The motion then follows from the prior, and would confirm any frame rate.
"""
MOTION_CODES = ("animal_still", "no_strides", "time_reversed", "treadmill", "camera_moves")
"""Codes of findings on the motion of the whole animal, with which left and right cannot be tested."""


def input_findings(
    motion: Motion,
    prior: MotionPrior,
    options: TrajectoryOptions,
    named: Sequence[str | None],
    stated_hz: float | None = None,
    seek_swaps: bool = True,
    possible: Sequence[Camera] = (),
) -> tuple[Finding, ...]:
    """Return the findings on the inputs of a fit: keypoints, cameras and frame rate.

    The tests are, in this order:

    - copied detections
    - motions that no animal makes
    - a wide lens that was not stated
    - for each camera, another picture
    - for each camera, left-right swaps
    - for a single camera, the animal's halves, the lens, the stretch and the focal length, then another camera of its
      file
    - for several cameras, their clocks
    - the frame rate

    A test is left out if an earlier finding explains what it would find.

    Parameters
    ----------
    motion
        The result of a fit by the trajectory method.
    prior
        The prior that was used in the fit.
    options
        The options of the fit.
    named
        For each view, the name of another camera that is part of its keypoint file's name, or None.
    stated_hz
        Frame rate stated in a keypoint file, or None.
    seek_swaps
        Whether to search for left-right swaps, which takes the most time.
    possible
        Other cameras in the camera file, one of which may have filmed the clip of a single camera.
    """
    solution = trajectory_solution(motion)
    clip = ClipProblem.from_views(solution.views, motion.body, prior, motion.fps, options)
    ground_clip = _as_solved(clip, solution)
    has_learned_prior = prior.name != NONE and bool(solution.posed.any())
    copied = [*copies(motion.sources, resampled=bool(motion.settings.get("camera_fps")))]
    has_copies = _has_error(copied)
    moves = [] if has_copies else [*movement(motion)]
    is_explained = has_copies or any(item.code in MOTION_CODES for item in moves)
    exchanged: list[Finding] = []
    drifting: list[Finding] = []
    elsewhere: list[Finding] = []
    rates: Sequence[Finding] = ()
    with one_thread():
        assumed = assumed_lens_finding(clip, solution, motion.settings)
        pictures = _other_pictures(motion, clip, named)
        if has_learned_prior and not is_explained:
            unswapped = ground_clip
            swaps_of_views: list[list[Swap]] = [[] for _ in motion.sources]
            predictions: Iterable[tuple[Array, Array] | None] = repeat(None, len(motion.sources))
            if len(motion.sources) > 2 and seek_swaps:
                swaps_of_views, views = swaps_between(ground_clip, solution)
                unswapped = replace(ground_clip, views=views)
                predictions = predicted_by_others(views, solution.markers_m, [*solution.noise_px])
            for number, (source, predicted) in enumerate(zip(motion.sources, predictions, strict=True)):
                if number not in pictures:
                    baseline = baseline_of(unswapped, number, solution.states, solution.size, predicted)
                    if seek_swaps:
                        swaps_of_views[number] += swaps(baseline, _is_unlike_prior(solution, motion.fps))
                    exchanged += [swap_finding(swap, source, motion.body) for swap in swaps_of_views[number]]
                    if len(motion.sources) == 1 and not exchanged:
                        moves = _explain_by_only_view(motion, ground_clip, baseline, moves)
        if possible and has_learned_prior and not (is_explained or pictures):
            baseline = baseline_of(clip, 0, solution.states, solution.size)
            elsewhere += other_camera_finding(baseline, solution.noise_px[0], possible)
        if len(motion.sources) > 1 and not (pictures or has_copies):
            names = [source.camera.name for source in motion.sources]
            drifting += drift_findings(ground_clip, solution, names, motion.fps)
        if _feet_glide(moves) or not (is_explained or pictures):
            rates = _rate_findings(clip, solution, stated_hz, bool(motion.settings.get("fps_known")))
    if pictures or _has_error(rates):
        moves = []  # the impossible motion may be a consequence of a fault found above
    of_pictures: list[Finding] = []
    for item in pictures.values():
        if item not in of_pictures:  # a cause that all cameras have in common is stated once
            of_pictures.append(item)
    of_lens = () if assumed is None else (by_effect(assumed, motion.trunk_m),)
    return (*copied, *exchanged, *of_pictures, *elsewhere, *of_lens, *drifting, *rates, *moves)


def _has_error(findings: Sequence[Finding]) -> bool:
    return any(item.severity == "error" for item in findings)


def _as_solved(clip: ClipProblem, solution: TrajectorySolution) -> ClipProblem:
    """Return the problem with the weight of the prior and the ground that its solution assumes.

    A ground near z = 0 is assumed only if the feet stand there in the solution.
    """
    weights = [segment.prior_weight for segment in solution.segments]
    is_elsewhere = any(segment.ground and segment.ground.near_zero is False for segment in solution.segments)
    return replace(
        clip,
        prior_weight=min(weights, default=1.0),
        ground_near_zero=clip.ground_near_zero and not is_elsewhere,
    )


def _is_unlike_prior(solution: TrajectorySolution, fps: float) -> bool:
    """Return whether the motions of the prior do not include the animal's motion or its speed."""
    too_fast = mean_speed_m_s(solution.states, fps) > FASTEST_M_S
    return too_fast or any(segment.unlike_prior for segment in solution.segments)


def _other_pictures(motion: Motion, clip: ClipProblem, named: Sequence[str | None]) -> dict[int, Finding]:
    """Return a dictionary of findings on views whose keypoints are from another camera or another picture.

    The keys are the views' indices.
    """
    findings, baselines, trials = {}, [], []
    for number, source in enumerate(motion.sources):
        camera, named_camera = source.camera.name, named[number]
        if named_camera is not None:
            findings[number] = finding("other_camera_named", camera=camera, given=camera, other=named_camera)
            continue
        baseline = baseline_of(clip, number, motion.solution.states, motion.solution.size)
        picture = unit_square_finding(baseline)
        if picture is None:
            baselines.append(baseline)
            trials.append(other_pictures(baseline))
            picture = finding_of_pictures(source.camera, *trials[-1])
        if picture is not None:
            findings[number] = picture
    if len(motion.sources) > 1 and len(findings) == len(trials) == len(motion.sources):
        common = common_picture_finding(baselines, trials)
        findings = findings if common is None else dict.fromkeys(findings, common)
    return findings


def _feet_glide(moves: Sequence[Finding]) -> bool:
    """Return whether feet in stance move forwards, as they also do if the stated frame rate is too high."""
    slides = [item.numbers.get("slide_m_s") for item in moves]
    return any(isinstance(slide_m_s, float) and slide_m_s > 0 for slide_m_s in slides)


def _explain_by_only_view(
    motion: Motion, clip: ClipProblem, baseline: Baseline, moves: Sequence[Finding]
) -> list[Finding]:
    """Return the findings `moves` on the motion, or findings on the view of a single camera that explain the motion.

    If the path jolts and nothing else was found, the hind half may belong to another animal. If there are no findings
    on the motion, the lens, the stretch and the focal length are tested as well.
    """
    solution = trajectory_solution(motion)
    if any(item.code != "path_jolts" for item in moves):
        return [*moves]
    steps = one_steps(clip, solution, {"halves": hind_offset(clip), "stretch": STRETCH})
    halves = halves_finding(clip, solution, steps.get("halves"))
    if halves is not None:
        return [halves]
    return [*moves] or _single_view_findings(motion, clip, baseline, steps.get("stretch"))


def _single_view_findings(motion: Motion, clip: ClipProblem, baseline: Baseline, stretch: Step | None) -> list[Finding]:
    """Return findings on a single camera: a wrong lens or focal length in its file, or a stretched video."""
    solution = trajectory_solution(motion)
    sigma_m = float(np.nanmean(motion.place_sigma_m[motion.solved]))
    lens = lens_findings(baseline, solution.noise_px[0])
    findings = [
        with_calibration_at_either_end(by_effect(item, motion.trunk_m, position_sigma_m=sigma_m)) for item in lens
    ]
    if all(item.severity == "note" for item in findings) and (stretched := stretch_finding(clip, solution, stretch)):
        findings.append(stretched)
    if all(item.severity == "note" for item in findings) and (focal := focal_finding(baseline, solution.noise_px[0])):
        findings.append(by_effect(focal, motion.trunk_m, position_sigma_m=sigma_m))
    return findings


def _rate_findings(
    clip: ClipProblem, solution: TrajectorySolution, stated_hz: float | None, is_known: bool
) -> Sequence[Finding]:
    """Return the finding on the frame rate, if any, as a note if the user knows the rate (`is_known`)."""
    segment = solution.longest_segment
    if segment is None:
        return ()
    longest = segment.rows
    states = clip.nominal(solution.states[longest], solution.size)
    poor_share = np.mean([bool({*flags} & {"no data", "data poor"}) for flags in solution.flags[longest]]) > MOSTLY_POOR
    rate_finding = frame_rate_finding(clip.part(longest), states, stated_hz, by_motion=not poor_share)
    if rate_finding is None:
        return ()
    numbers: dict[str, Any] = rate_finding.numbers
    speed_m_s = mean_speed_m_s(solution.states[longest], clip.fps)
    speeds_m_s = speed_m_s, speed_m_s * numbers["other_hz"] / numbers["given_hz"]
    rate_finding = replace(rate_finding, numbers={**numbers, **dict(zip(SPEEDS, speeds_m_s, strict=True))})
    return (replace(rate_finding, severity="note") if is_known else rate_finding,)


def with_flags(motion: Motion, findings: Sequence[Finding]) -> Motion:
    """Return a motion whose frames have the flags that belong to the given findings (`FLAG_OF`)."""
    flags = [*motion.flags]
    for item in findings:
        name = FLAG_OF.get(item.code)
        if name is not None and item.frames is not None:
            for t in range(*np.searchsorted(motion.frames, item.frames)):
                flags[t] = flags[t] if name in flags[t] else (*flags[t], name)
    return replace(motion, solution=replace(motion.solution, flags=tuple(flags)))


# Detection of copied coordinates

IDENTICAL_FRACTION = 0.2
"""Fraction of identical points above which they count as copies. Labels in whole pixels may be equal by chance."""
MAX_REPEATED_FRACTION = 0.05
"""Fraction of repeated frames above which they are reported, because cameras sometimes repeat a few frames."""
MIN_COUNT = 4
"""Minimum number of identical keypoints in a frame that counts as a copy, because fewer may be equal by chance."""
MAX_BEND_PX = 0.01
"""Largest second difference of the positions of linearly interpolated points, pixels.

The same limit is used for the fourth differences of points that lie on a cubic.
"""
MAX_BEND_STEPS = 0.02
"""Largest second difference of the positions of linearly interpolated points, relative to the step between frames."""
_CUBIC_FRAMES = 5
"""Number of successive frames in a fourth difference, which is 0 for points on a cubic."""
CURVED_PX = 0.1
"""Smallest second difference of positions at which points are tested for lying on a cubic, pixels.

Points on a straight line also lie on a cubic, but need not have been interpolated.
"""
LONG_STEP_RATIO = 1.45
"""Length of a step between frames, relative to the steps around it, above which the step is long.

A step across one missing frame is 2 times as long as the steps around it, so the limit is about the geometric mean of 1
and 2. At twice the value, no such step would be long, and at half of it, ordinary steps would be.

In 32 real views, at most 0.12 of the steps are long, also with half of the points missing, a side hidden, or an animal
that comes into the picture. The fraction is 0.06 to 0.29 (median 0.19) if a quarter of the frames is left out (`python
benchmarks/wrong_inputs.py --only input-limits`).
"""
SHORT_STEP_RATIO = 0.5
"""Length of a step between frames, relative to the steps around it, below which the step is short."""
LONG_STEP_FRACTION = 0.13
"""Fraction of long steps above which frames are missing, provided that less than half as many steps are short.

The value is just above the fractions in correct views (see `LONG_STEP_RATIO`). At half the value, correct views with
half of their points missing would be reported (up to 0.12). At twice the value, most clips without a quarter of their
frames would not be (median 0.19).
"""
ISOLATED_STEP_RATIO = 1.3
"""Minimum ratio of a long step to each of its two neighbours, if the step is long because a frame is missing.

A step across a missing frame is 2 times as long as its neighbours. Swinging legs, seen alone or by a camera that
follows them, are fast for several frames, so the ratio is near 1. At half the value, nearly every long step would
count, and at twice the value no step across a single missing frame.
"""
ISOLATED_STEP_FRACTION = 0.4
"""Minimum fraction of the long steps that exceed both neighbours by `ISOLATED_STEP_RATIO`, if frames are missing.

The fraction is 0.33 to 1.0 (median 0.83) in 26 real views without a quarter of their frames. At half the value, all of
them would be reported, and at twice the value only those above 0.8. The fraction is 0.67 in 2 of 28 views of lower legs
alone, seen by a camera that follows them, so this limit does not exclude them (`python benchmarks/wrong_inputs.py
--only input-limits`).
"""
MEDIAN_STEPS = 7
"""Number of successive steps of a keypoint over which the median gives the usual step."""
MIN_STEP_PX = 5.0
"""Minimum length of the usual step with which a step is compared, pixels."""
MIN_STEPS = 20
"""Minimum number of steps with enough keypoints that is required to test for missing frames."""


def copies(sources: Sequence[Source], resampled: bool = False) -> Iterator[Finding]:
    """Yield findings on points that were copied from other points, frames or files, and on missing frames.

    If `resampled` is true, the points were interpolated between frames on purpose, so straight lines are no evidence.
    """
    for source in sources:
        keypoints, camera = source.keypoints, source.camera.name
        if not resampled:
            yield from (
                _interpolated(keypoints, camera)
                or [*_repeated(keypoints, camera)]
                or _dropped_frames(keypoints, camera)
            )
        yield from _copied_sides(keypoints, camera)
    for names, fraction in same_keypoints(sources):
        yield finding("same_keypoints", cameras=names, share=fraction)


def same_keypoints(sources: Sequence[Source]) -> Iterator[tuple[tuple[str, str], float]]:
    """Yield the names of each two cameras with the same points in the same order, and the fraction of equal points."""
    for a, b in combinations(sources, 2):
        identical, in_both = _identical(a.keypoints.xy_px, b.keypoints.xy_px)
        if _exceeds_chance(identical, in_both):
            yield (a.camera.name, b.camera.name), float(identical.sum() / in_both.sum())


def _identical(a: np.ndarray, b: np.ndarray) -> tuple[Bools, Bools]:
    """Return a mask of the points (..., 2) that are equal in two arrays, and a mask of those that are known in both."""
    in_both = np.asarray(np.isfinite(a + b).all(axis=-1))
    return in_both & np.asarray((a == b).all(axis=-1)), in_both


def _exceeds_chance(identical: Bools, is_seen: Bools) -> bool:
    return bool(identical.sum() > IDENTICAL_FRACTION * is_seen.sum() and identical.sum() >= MIN_COUNT)


def repeats_of(values: Array) -> Bools:
    """Return a mask (T,) of the frames in which most points have exactly the coordinates of the frame before.

    The coordinates have the shape (T, K, 2) or (T, K, 3).
    """
    identical, in_both = _identical(values[1:], values[:-1])
    count = identical.sum(axis=1)
    return np.append(False, (count >= MIN_COUNT) & (2 * count > in_both.sum(axis=1)))


def repetition(repeats: Bools, fps: float | None) -> dict[str, Any] | None:
    """Return the numbers of a finding if every frame is repeated, as in a video with a doubled frame rate.

    Return None if only some frames are repeated. `repeats` is as in `repeats_of`.
    """
    new_frames = np.flatnonzero(~repeats)
    times = int(np.median(np.diff(new_frames))) if len(new_frames) > 2 else 1
    if times > 1 and repeats.mean() < 1 - 0.5 / times:
        return {"times": times, "given_hz": fps or np.nan, "other_hz": (fps or np.nan) / times}
    return None


def _repeated(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    """Yield a finding if every frame is repeated, as in a video with a doubled frame rate, or if some frames are."""
    repeats = repeats_of(keypoints.xy_px)
    if repeats.sum() <= MAX_REPEATED_FRACTION * len(repeats):
        return
    of_all = repetition(repeats, keypoints.fps)
    if of_all is not None:
        yield finding("detections_repeated", camera=camera, **of_all)
        return
    first, stop = longest_run(repeats)
    frames = (int(keypoints.frames[first - 1]), int(keypoints.frames[stop - 1]) + 1)
    yield finding("detections_frozen", frames, camera, count=int(repeats.sum()), frames_total=len(repeats))


def _interpolated(keypoints: Keypoints, camera: str) -> list[Finding]:
    """Return a finding if many moving points lie exactly halfway between their neighbours, or on a cubic."""
    xy_px = keypoints.xy_px
    bend = np.linalg.norm(xy_px[2:] - 2 * xy_px[1:-1] + xy_px[:-2], axis=-1)
    travel = 0.5 * np.linalg.norm(xy_px[2:] - xy_px[:-2], axis=-1)
    is_moving = travel > 0
    is_straight = is_moving & (bend < np.minimum(MAX_BEND_PX, MAX_BEND_STEPS * travel))
    if _exceeds_chance(is_straight, is_moving):
        fraction = float(is_straight.sum() / is_moving.sum())
        return [finding("detections_interpolated", camera=camera, share=fraction)]
    is_curved, is_cubic = bend[1:-1] > CURVED_PX, np.zeros_like(is_moving[1:-1])
    if len(xy_px) > _CUBIC_FRAMES:
        fourth_px = np.linalg.norm(np.diff(xy_px, 4, axis=0), axis=-1)
        is_cubic = is_curved & (fourth_px < np.minimum(MAX_BEND_PX, MAX_BEND_STEPS * travel[1:-1]))
    if not _exceeds_chance(is_cubic, is_curved):
        return []
    return [finding("detections_curved", camera=camera, share=float(is_cubic.sum() / is_curved.sum()))]


def step_ratios(tracks: Array) -> Array | None:
    """Return the length of each of N steps between frames, relative to the steps around it, shape (N,).

    `tracks` are the positions of K keypoints in pixels, shape (T, K, 2) or (T, K, 3). Each keypoint is compared with
    its own steps, because visibility changes and paws are faster than the trunk. The ratio of a step is the median over
    the keypoints. Steps with too few keypoints are left out. Return None if fewer than `MIN_STEPS` remain.
    """
    steps = np.diff(tracks, axis=0)
    times = np.full(steps.shape[:2], np.nan)
    for j in range(steps.shape[1]):
        known_frames = np.flatnonzero(np.isfinite(steps[:, j, 0]))
        usual_px = running_median(steps[known_frames, j], MEDIAN_STEPS)
        length_px = np.linalg.norm(usual_px, axis=1)
        projected = np.sum(steps[known_frames, j] * usual_px, axis=1) / np.maximum(length_px, 1e-9) ** 2
        times[known_frames, j] = np.where(length_px > MIN_STEP_PX, projected, np.nan)
    times = times[np.isfinite(times).sum(axis=1) >= MIN_COUNT]
    return np.nanmedian(times, axis=1) if len(times) >= MIN_STEPS else None


def steps_are_missing(ratios: Array) -> bool:
    """Return whether so many steps are about twice as long as the steps around them that frames must be missing."""
    is_long, is_short, is_alone = long_steps(ratios)
    return bool(
        is_long.mean() > LONG_STEP_FRACTION
        and is_long.sum() > 2 * is_short.sum()
        and is_alone.sum() > ISOLATED_STEP_FRACTION * is_long.sum()
    )


def long_steps(ratios: Array) -> tuple[Bools, Bools, Bools]:
    """Return masks (N,) of the long steps and the short steps, and a mask (N - 2,) of long steps between shorter ones.

    The third mask does not contain the first and the last step.
    """
    is_long = ratios > LONG_STEP_RATIO
    is_alone = is_long[1:-1] & (ratios[1:-1] > ISOLATED_STEP_RATIO * np.maximum(ratios[:-2], ratios[2:]))
    return is_long, ratios < SHORT_STEP_RATIO, is_alone


def _dropped_frames(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    """Yield a finding on steps between frames that are twice as long as the steps around them."""
    ratios = step_ratios(keypoints.xy_px)
    if ratios is not None and steps_are_missing(ratios):
        yield finding("frames_dropped", camera=camera, share=float((ratios > LONG_STEP_RATIO).mean()))


def _copied_sides(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    opposite = opposites(keypoints.names)
    left = np.flatnonzero(np.arange(len(opposite)) < opposite)
    identical, in_both = _identical(keypoints.xy_px[:, left], keypoints.xy_px[:, opposite[left]])
    if _exceeds_chance(identical, in_both):
        yield finding("far_side_copied", camera=camera, share=float(identical.sum() / in_both.sum()))


# Detection of impossible motions

MIN_DURATION_S = 0.25
"""Minimum duration of a motion that is tested, seconds."""
STILL_FRACTION = 0.95
"""Fraction of the frames in which the speed must be below `STILL_M_S` for an animal that stands still."""
STILL_M_S = 0.3
"""Largest speed (m/s) of an animal that stands still, but at most one trunk length per second."""
STILL_RAD_S = 0.6
"""Largest median angular speed of the joints of an animal that stands still, rad/s."""
STILL_TRUNKS = 0.5
"""Largest extent of the path of an animal that stands still, in trunk lengths."""
BACKWARDS_M_S = 1.0
"""Speed above which no animal runs backwards."""
BACKWARDS_FRACTION = 0.9
"""Fraction of frames with a backward speed of more than `BACKWARDS_M_S`, above which the clip is reversed in time."""
STANDING_QUANTILE = 0.1
"""Quantile of the speeds of all feet in all frames that is taken as the speed of feet in stance."""
LOWEST_FRACTION = 0.2
"""Fraction of the frames in which a foot counts as on the ground, namely those in which the foot is lowest.

On a belt, or if the camera follows or pans, feet move in these frames at 0.55 to 1.22 times `FeetSpeeds.slowest_m_s`
(42 clips of cheetahs). If a dog stands, steps or turns on the spot, the factor is -0.13 to 0.27 (11 clips; `python
benchmarks/wrong_inputs.py --only input-limits`).
"""
SLIDE_RATIO = 0.25
"""Backward speed of feet in stance, relative to the body's speed over the feet, above which they slide.

The relative speed is at most 0.08 in 32 real views of cheetahs, and 0.11 to 0.92 (median 0.85) on a treadmill, where
the smallest value is from a view along the animal's path. The relative speed reaches 1.1 for dogs on the spot, but
their lowest feet stand still (`LOWEST_FRACTION`). At half the value, no correct view of a cheetah would be reported
either (`python benchmarks/wrong_inputs.py --only input-limits`).
"""
SLIDE_LEGS_S = 0.5
"""Minimum speed of the body over the feet, in leg lengths per second, at which feet are tested for sliding.

The limit excludes animals that hardly move. It is low, because animals may walk slowly on a treadmill. The speed is 9
or more on a treadmill or if the camera pans, and 1.2 to 2.3 if a dog steps or turns on the spot, so half or twice the
limit would change none of these clips (`python benchmarks/wrong_inputs.py --only input-limits`).
"""
TREADMILL_RATIO = 0.3
"""Speed of the body, relative to its speed over the feet, below which the body stays in place, as on a treadmill."""
SLIDE_M_S = -2.5
"""Velocity of feet in stance along the trunk below which they slide backwards.

The lowest velocity is -0.65 m/s in 32 real views of running cheetahs, and -1.05 m/s if a dog steps or turns on the spot
(`python benchmarks/wrong_inputs.py --only input-limits`).
"""
GLIDE_M_S = 8.0
"""Velocity of feet in stance along the trunk above which they glide forwards.

The highest velocity is 3.9 m/s in 32 real views of running cheetahs, and 8.7 m/s if the camera pans against the
animal's motion (`python benchmarks/wrong_inputs.py --only input-limits`).
"""
MAX_PATH_COSTS = {"root acceleration": 1.0, "heading": 0.55, "climb": 1.1}
"""Largest plausible costs of the body's path per 1/90 s, keyed by the term of the fit's cost.

The unit is half a squared standard deviation. The costs are up to 0.53, 0.22 and 0.76 in 32 real views, and 0.69, 0.02
and 0.68 in the rendered video. They are up to 5.6, 1.2 and 4.7 (medians 3.3, 0.29 and 2.5) if a stabiliser moved the
picture (`python benchmarks/wrong_inputs.py --only input-limits`).
"""


def movement(motion: Motion) -> Iterator[Finding]:
    """Yield at most one finding, on an impossible motion over the ground or on an animal that stands still."""
    solution, posed = trajectory_solution(motion), motion.solved
    if posed.sum() < max(MIN_DURATION_S * motion.fps, 3):
        return
    forward, _ = _along(motion)
    speeds = feet_speeds(motion)
    turns = np.abs(np.diff(motion.states[:, 6:], axis=0)) * motion.fps
    middle_m = solution.joints_m.mean(axis=1)
    speed = np.linalg.norm(np.gradient(middle_m, axis=0), axis=1) * motion.fps
    rear, front = motion.forward
    trunk_m = float(np.nanmedian(np.linalg.norm(solution.joints_m[:, rear] - solution.joints_m[:, front], axis=1)))
    is_staying = np.linalg.norm(np.nanmax(middle_m, axis=0) - np.nanmin(middle_m, axis=0)) < STILL_TRUNKS * trunk_m
    sliding = None if speeds is None else _sliding(motion, speeds)
    if sliding is not None and sliding.code == "treadmill":
        yield sliding
    elif (
        is_staying
        and np.nanquantile(speed, STILL_FRACTION) < min(STILL_M_S, trunk_m)
        and np.nanmedian(turns) < STILL_RAD_S
    ):
        # Only a prior learned from motions spoils the poses of an animal that stands still.
        yield finding("no_strides" if solution.prior == NONE else "animal_still", speed_m_s=float(np.nanmedian(speed)))
    elif np.mean(forward[np.isfinite(forward)] < -BACKWARDS_M_S) > BACKWARDS_FRACTION:
        yield finding("time_reversed", speed_m_s=-float(np.nanmedian(forward)))
    elif sliding is not None:
        yield sliding
    else:
        costs = jolt_costs(motion)
        worst = max(MAX_PATH_COSTS, key=lambda name: costs[name] / MAX_PATH_COSTS[name])
        if costs[worst] > MAX_PATH_COSTS[worst]:
            jolts = finding("path_jolts", of=worst, cost=costs[worst])
            # The limits hold for running cheetahs, but other animals may turn on the spot or sidestep.
            yield replace(jolts, severity="note") if solution.prior == NONE else jolts


def jolt_costs(motion: Motion) -> dict[str, float]:
    """Return a dictionary of the costs of the body's path per 1/90 s, with the same keys as `MAX_PATH_COSTS`."""
    solution = trajectory_solution(motion)
    frames = REFERENCE_HZ * float(motion.solved.sum()) / motion.fps
    return {name: float(solution.cost_by_term.get(name, 0.0)) / frames for name in MAX_PATH_COSTS}


@dataclass(frozen=True)
class FeetSpeeds:
    """Velocities of the body and of the feet in stance over the ground, along the trunk; negative means backwards."""

    body_m_s: float
    slowest_m_s: float
    """Quantile `STANDING_QUANTILE` of the feet's velocities over all frames; about 0 if feet in stance do not move."""
    slide_m_s: float
    """Median velocity of the feet in stance over the ground."""
    leg_m: float
    """Height of the trunk above the lowest foot."""

    @property
    def over_feet_m_s(self) -> float:
        """Return the velocity of the body relative to its feet in stance, m/s."""
        return self.body_m_s - self.slowest_m_s


def feet_speeds(motion: Motion) -> FeetSpeeds | None:
    """Return the velocities of the body and of its feet over the ground; None for a body without feet."""
    forward, feet = _along(motion)
    if not len(feet[0]):
        return None
    joints_m, trunk_ends = motion.solution.joints_m, list(motion.forward)
    leg_m = joints_m[:, trunk_ends, 2].mean(axis=1) - joints_m[:, list(motion.feet), 2].min(axis=1)
    return FeetSpeeds(
        body_m_s=float(np.nanmedian(forward)),
        slowest_m_s=float(np.nanquantile(feet, STANDING_QUANTILE)),
        slide_m_s=float(np.nanquantile(feet, STANDING_QUANTILE / 2)),
        leg_m=float(np.nanmedian(leg_m)),
    )


def on_ground_m_s(motion: Motion) -> float:
    """Return the median velocity of the feet along the trunk in the frames in which they are lowest, m/s."""
    _, feet = _along(motion)
    heights_m = motion.solution.joints_m[:, list(motion.feet), 2]
    return float(np.nanmedian(feet[heights_m <= np.nanquantile(heights_m, LOWEST_FRACTION, axis=0)]))


def seem_to_slide(speeds: FeetSpeeds) -> bool:
    """Return whether feet in stance seem to slide, given their velocity relative to the body and over the ground."""
    over_feet_m_s = speeds.over_feet_m_s
    is_relative = -speeds.slowest_m_s > SLIDE_RATIO * over_feet_m_s and over_feet_m_s > SLIDE_LEGS_S * speeds.leg_m
    return is_relative or not SLIDE_M_S < speeds.slowest_m_s < GLIDE_M_S


def _sliding(motion: Motion, speeds: FeetSpeeds) -> Finding | None:
    if not seem_to_slide(speeds):
        return None
    if abs(on_ground_m_s(motion)) < 0.5 * abs(speeds.slowest_m_s):
        return None  # the lowest feet stand still, and only the other feet move
    if speeds.slowest_m_s < 0 and abs(speeds.body_m_s) < TREADMILL_RATIO * speeds.over_feet_m_s:
        return finding("treadmill", slide_m_s=-speeds.slide_m_s, speed_m_s=speeds.body_m_s)
    return finding("camera_moves", slide_m_s=speeds.slowest_m_s, speed_m_s=speeds.body_m_s)


def _along(motion: Motion) -> tuple[Array, Array]:
    """Return the velocities of the body (T,) and of the feet (T, F) over the ground, along the trunk, m/s.

    The velocities are NaN in frames without a pose.
    """
    rear, front = motion.forward
    joints_m = motion.solution.joints_m
    trunk = (joints_m[:, front] - joints_m[:, rear])[:, :2]
    trunk = trunk / np.maximum(np.linalg.norm(trunk, axis=1, keepdims=True), 1e-9)
    velocity = np.gradient(joints_m, axis=0)[..., :2] * motion.fps
    along = np.einsum("tja,ta->tj", velocity, trunk)
    return along.mean(axis=1), along[:, motion.feet]


# Detection of gross outliers

GROSS_REASON = "in frames whose detections are gross outliers"
"""Reason, in words, why the detections of gross outlier frames were left out."""
MAX_OUTLIER_FRACTION = 0.5
"""Largest fraction of frames that are left out as outliers. With more, the fit or another input is wrong."""


def outlier_ratios(view: View, markers_m: Array, noise_px: Array) -> Array:
    """Return each frame's log-likelihood gain if its keypoints are unrelated to the fitted pose, shape (T,).

    Unrelated keypoints are equally likely anywhere in the picture.

    `markers_m` are the fitted markers, shape (T, J, 3), and `noise_px` the standard deviations of the detections, shape
    (T, J). The gain is NaN in frames without keypoints or without a pose.
    """
    projected, valid = view.project(view.shift_to_exposure(markers_m))
    density = -2.0 * np.log(noise_px) - np.log(2 * np.pi) - log_tail((projected - view.xy_px) / noise_px[..., None])
    width, height = view.camera.image_size_px
    uniform_density = -float(np.log(width * height))
    is_known = view.present & np.isfinite(markers_m[:, :1, 0])
    gains = np.where(is_known, uniform_density - np.where(valid, density, -np.inf), 0.0)
    return np.where(is_known.any(axis=1), gains.sum(axis=1), np.nan)


def without_gross_outliers(
    sources: Sequence[Source], solution: TrajectorySolution
) -> tuple[tuple[Source, ...], tuple[Finding, ...]]:
    """Return the sources without the detections of frames that are gross outliers, and findings on these frames."""
    kept, findings = [], []
    for source, view, noise_px in zip(sources, solution.views, solution.noise_px, strict=True):
        ratios = outlier_ratios(view, solution.markers_m, noise_px)
        rows: Bools = ratios > EXAMINED_GAIN
        rows &= rows.sum() <= MAX_OUTLIER_FRACTION * view.present.any(axis=1).sum()
        points, numbers = source.keypoints.present & rows[:, None], source.keypoints.frames
        keypoints, cleaning = leave_out(source.keypoints, source.cleaning, points, GROSS_REASON, source.later_frames)
        kept.append(replace(source, keypoints=keypoints, cleaning=cleaning))
        for first, stop in frame_ranges(np.flatnonzero(rows)):
            frames, ratio = (int(numbers[first]), int(numbers[stop - 1]) + 1), float(ratios[first:stop].sum())
            findings.append(finding("gross_outliers", frames, source.camera.name, log_likelihood_ratio=ratio))
    return tuple(kept), tuple(findings)
