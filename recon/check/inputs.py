"""Detect wrong inputs: copies, moving cameras, swaps, gross outliers, another picture or camera, a wrong frame rate.

Copies, and motions that no animal makes, come first. Detections that are the same to the last digit were copied, not
measured. Under a camera that pans, all standing feet slide together. Other faults are recognised from how much more
likely the clip becomes when they are undone (`recon.check.likelihood`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from recon.animal.body import opposites
from recon.animal.prior import NONE, MotionPrior, mean_speed_m_s
from recon.base.arrays import Array, Bools, running_median
from recon.base.threads import one_thread
from recon.check.clocks import drift_findings
from recon.check.codes import FLAG_OF, SPEEDS, by_effect, finding
from recon.check.focal import focal_finding
from recon.check.halves import halves_finding
from recon.check.likelihood import (
    CLEAR,
    Baseline,
    baseline_of,
    frame_rate_finding,
    lens_findings,
    log_tail,
    other_picture_finding,
    unit_square_finding,
    with_calibration_at_either_end,
)
from recon.check.other_camera import other_camera_finding
from recon.check.stretch import stretch_finding
from recon.check.swaps import swap_finding, swaps
from recon.clip import Keypoints, Source, View, frame_ranges, leave_out
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.motion import Motion
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.terms import REFERENCE_HZ
from recon.geometry.camera import Camera

FASTEST_M_S = 40.0
"""Largest speed of an animal: cheetahs reach 29 m/s (N. Sharp, *Timed running speed of a cheetah*, J. Zool. 1997)."""

MOSTLY_POOR = 0.9
"""Fraction of frames with few or no detections above which the motion, and so the frame rate, follows from the prior.
"""
MOVES = ("animal_still", "no_strides", "time_reversed", "treadmill", "camera_moves")
"""Codes of motions in which left and right cannot be distinguished."""


def input_findings(
    motion: Motion,
    prior: MotionPrior,
    options: TrajectoryOptions,
    named: Sequence[str | None],
    stated_hz: float | None = None,
    seek_swaps: bool = True,
    possible: Sequence[Camera] = (),
) -> tuple[Finding, ...]:
    """Return the findings on the keypoints that a motion was fitted to.

    The tests are, in this order: copies; motions that no animal makes; for each camera, another picture, then swaps;
    for a single camera, another camera of its file, the animal's halves, the lens, the stretch and the focal length;
    for several cameras, their clocks; and the frame rate. A test is left out if an earlier finding explains what it
    would find.

    Parameters
    ----------
    motion
        The motion of the trajectory method.
    prior
        The prior used in the fit.
    options
        The options of the fit.
    named
        For each view, another camera that its file's name contains, or None.
    stated_hz
        Frame rate stated in a file, or None.
    seek_swaps
        Whether to search for swaps, which takes the longest time.
    possible
        Other cameras of the camera file that may have filmed a single camera's clip.
    """
    solution = motion.solution
    assert isinstance(solution, TrajectorySolution)
    clip = ClipProblem.from_views(solution.views, motion.body, prior, motion.fps, options)
    ground_clip = _as_solved(clip, solution)
    has_learned_prior = prior.name != NONE and bool(solution.posed.any())
    copied = [*copies(motion.sources, resampled=bool(motion.settings.get("camera_fps")))]
    has_copies = _has_error(copied)
    moves = [] if has_copies else [*movement(motion)]
    is_explained = has_copies or any(item.code in MOVES for item in moves)
    exchanged: list[Finding] = []
    drifting: list[Finding] = []
    elsewhere: list[Finding] = []
    rates: Sequence[Finding] = ()
    with one_thread():
        other_pictures = _other_pictures(motion, clip, named)
        if has_learned_prior and not is_explained:
            for number, source in enumerate(motion.sources):
                if number not in other_pictures:
                    baseline = baseline_of(ground_clip, number, solution.states, solution.size)
                    trials = swaps(baseline, _is_unlike_prior(solution, motion.fps)) if seek_swaps else ()
                    exchanged += [swap_finding(trial, source, motion.body) for trial in trials]
                    if len(motion.sources) == 1 and not exchanged:
                        moves = _explain_by_only_view(motion, ground_clip, baseline, moves)
        if possible and has_learned_prior and not (is_explained or other_pictures):
            baseline = baseline_of(clip, 0, solution.states, solution.size)
            elsewhere += other_camera_finding(baseline, solution.noise_px[0], possible)
        if len(motion.sources) > 1 and not (other_pictures or has_copies):
            names = [source.camera.name for source in motion.sources]
            drifting += drift_findings(ground_clip, solution, names, motion.fps)
        if _feet_glide(moves) or not (is_explained or other_pictures):
            rates = _rate_findings(clip, solution, stated_hz, bool(motion.settings.get("fps_known")))
    if other_pictures or _has_error(rates):
        moves = []  # the impossible motion may be a consequence of a fault found above
    return (*copied, *exchanged, *other_pictures.values(), *elsewhere, *drifting, *rates, *moves)


def _has_error(findings: Sequence[Finding]) -> bool:
    return any(item.severity == "error" for item in findings)


def _as_solved(clip: ClipProblem, solution: TrajectorySolution) -> ClipProblem:
    """Return the problem under the assumptions of its solution.

    These are the weight of the prior, and a ground near z = 0, which is assumed only if the feet stand there.
    """
    weights = [segment.prior_weight for segment in solution.segments]
    is_elsewhere = any(segment.ground and segment.ground.near_zero is False for segment in solution.segments)
    return replace(
        clip,
        prior_weight=min(weights, default=1.0),
        ground_near_zero=clip.ground_near_zero and not is_elsewhere,
    )


def _is_unlike_prior(solution: TrajectorySolution, fps: float) -> bool:
    """Return whether the animal moves in a way, or at a speed, that the prior does not contain."""
    too_fast = mean_speed_m_s(solution.states, fps) > FASTEST_M_S
    return too_fast or any(segment.unlike_prior for segment in solution.segments)


def _other_pictures(motion: Motion, clip: ClipProblem, named: Sequence[str | None]) -> dict[int, Finding]:
    """Return findings on keypoints from another camera, or from another picture of the camera, by the view's index."""
    findings = {}
    for number, source in enumerate(motion.sources):
        camera, named_camera = source.camera.name, named[number]
        if named_camera is not None:
            findings[number] = finding("other_camera_named", camera=camera, given=camera, other=named_camera)
            continue
        baseline = baseline_of(clip, number, motion.solution.states, motion.solution.size)
        picture = unit_square_finding(baseline) or other_picture_finding(baseline)
        if picture is not None:
            findings[number] = picture
    return findings


def _feet_glide(moves: Sequence[Finding]) -> bool:
    """Return whether standing feet glide forward, as they also do if the frame rate is too high."""
    slides = [item.numbers.get("slide_m_s") for item in moves]
    return any(isinstance(slide_m_s, float) and slide_m_s > 0 for slide_m_s in slides)


def _explain_by_only_view(
    motion: Motion, clip: ClipProblem, baseline: Baseline, moves: Sequence[Finding]
) -> list[Finding]:
    """Return `moves`, or findings on a single camera's view that explain them.

    If the path jolts and nothing else was found, the hind half may be another animal's. If there are no moves, the
    lens, the stretch and the focal length are tested as well.
    """
    solution = motion.solution
    assert isinstance(solution, TrajectorySolution)
    if any(item.code != "path_jolts" for item in moves):
        return [*moves]
    halves = halves_finding(clip, solution)
    if halves is not None:
        return [halves]
    return [*moves] or _single_view_findings(motion, clip, baseline)


def _single_view_findings(motion: Motion, clip: ClipProblem, baseline: Baseline) -> list[Finding]:
    """Return findings on a clip of one camera whose lens, focal length or picture is not that of the camera file."""
    solution = motion.solution
    assert isinstance(solution, TrajectorySolution)
    sigma_m = float(np.nanmean(motion.place_sigma_m[motion.solved]))
    lens = lens_findings(baseline, solution.noise_px[0])
    findings = [
        with_calibration_at_either_end(by_effect(item, motion.trunk_m, position_sigma_m=sigma_m)) for item in lens
    ]
    if all(item.severity == "note" for item in findings) and (stretched := stretch_finding(clip, solution)):
        findings.append(stretched)
    if all(item.severity == "note" for item in findings) and (focal := focal_finding(baseline, solution.noise_px[0])):
        findings.append(by_effect(focal, motion.trunk_m, position_sigma_m=sigma_m))
    return findings


def _rate_findings(
    clip: ClipProblem, solution: TrajectorySolution, stated_hz: float | None, is_known: bool
) -> Sequence[Finding]:
    """Return the finding on the frame rate, if any; only a note if the user knows the rate."""
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
    """Return a motion with frame flags for the given findings."""
    flags = [*motion.flags]
    for item in findings:
        name = FLAG_OF.get(item.code)
        if name is not None and item.frames is not None:
            for t in range(*np.searchsorted(motion.frames, item.frames)):
                flags[t] = flags[t] if name in flags[t] else (*flags[t], name)
    return replace(motion, solution=replace(motion.solution, flags=tuple(flags)))


# Copied coordinates

SHARE = 0.2
"""Smallest fraction of identical coordinates that is not chance; hand labels in whole pixels have some."""
FRAMES = 0.05
"""Largest fraction of repeated frames that is not reported, because cameras sometimes repeat a few frames."""
FEWEST = 4
"""Smallest number of identical keypoints in a frame; fewer may be chance."""
STRAIGHT_PX = 0.01
"""Largest deviation, in pixels, of an interpolated point from the line between its neighbours.

The fourth differences of points on a cubic are also below this limit.
"""
STRAIGHT = 0.02
"""Largest deviation of an interpolated point from the line between its neighbours, relative to the point's path."""
_CUBIC_FRAMES = 5
"""Number of successive frames that lie on one cubic if their fourth difference is 0."""
CURVED_PX = 0.1
"""Smallest distance, in pixels, from the line between its neighbours at which a point is tested for lying on a cubic.

Points on a straight line also lie on a cubic, but need not have been interpolated.
"""
LONG = 1.45
"""Length of a step relative to the steps around it above which the step is long.

In 32 real views at most 0.12 of the steps are long, also with half of their points missing, a side hidden, or an animal
that comes into the picture. The fraction is 0.06 to 0.29 (median 0.19) if a quarter of the frames is left out (`python
benchmarks/wrong_inputs.py --only input-limits`).
"""
SHORT = 0.5
"""Length of a step relative to the steps around it below which the step is short."""
SHARE_LONG = 0.13
"""Fraction of long steps above which frames were left out, if less than half as many steps are short.

The value is just above the fractions of correct views (see `LONG`).
"""
ALONE = 1.3
"""Smallest ratio of a long step to both its neighbours if a frame was left out.

Swinging legs, seen on their own or by a camera that follows, are fast for several frames. The step across a frame that
was left out is long by itself.
"""
SHARE_ALONE = 0.4
"""Smallest fraction of the long steps whose ratio exceeds `ALONE` if frames were left out.

The fraction is 0.33 to 1.0 (median 0.83) in 26 real views without a quarter of their frames (`python
benchmarks/wrong_inputs.py --only input-limits`).
"""
AROUND = 7
"""Number of successive steps of a keypoint whose median is the usual step."""
LEAST_STEP_PX = 5.0
"""Shortest usual step, in pixels, with which other steps are compared."""
LEAST_STEPS = 20
"""Smallest number of steps from which the ratios are computed."""


def copies(sources: Sequence[Source], resampled: bool = False) -> Iterator[Finding]:
    """Yield findings on points that are copies of others.

    If the points are `resampled`, they were interpolated between frames, so straight lines are no evidence.
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
    for a, b in combinations(sources, 2):
        identical, in_both = _identical(a.keypoints.xy_px, b.keypoints.xy_px)
        if _exceeds_chance(identical, in_both):
            names, share = (a.camera.name, b.camera.name), float(identical.sum() / in_both.sum())
            yield finding("same_keypoints", cameras=names, share=share)


def _identical(a: np.ndarray, b: np.ndarray) -> tuple[Bools, Bools]:
    """Return a mask of points (..., 2) that are equal in both arrays, and a mask of points present in both."""
    in_both = np.asarray(np.isfinite(a + b).all(axis=-1))
    return in_both & np.asarray((a == b).all(axis=-1)), in_both


def _exceeds_chance(identical: Bools, is_seen: Bools) -> bool:
    """Return whether more of the seen points are identical than happens by chance."""
    return bool(identical.sum() > SHARE * is_seen.sum() and identical.sum() >= FEWEST)


def repeats_of(values: Array) -> Bools:
    """Return a mask of frames (T,) in which most points repeat the frame before exactly; values (T, K, 2 or 3)."""
    identical, in_both = _identical(values[1:], values[:-1])
    count = identical.sum(axis=1)
    return np.append(False, (count >= FEWEST) & (2 * count > in_both.sum(axis=1)))


def _repeated(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    """Yield a finding on frames that repeat the frame before: every second frame (a doubled rate), or some."""
    repeats = repeats_of(keypoints.xy_px)
    if repeats.sum() <= FRAMES * len(repeats):
        return
    new_frames = np.flatnonzero(~repeats)
    times = int(np.median(np.diff(new_frames))) if len(new_frames) > 2 else 1
    if times > 1 and repeats.mean() < 1 - 0.5 / times:
        numbers = {"times": times, "given_hz": keypoints.fps or np.nan, "other_hz": (keypoints.fps or np.nan) / times}
        yield finding("detections_repeated", camera=camera, **numbers)
        return
    runs = frame_ranges(np.flatnonzero(repeats))
    first, stop = max(runs, key=lambda run: run[1] - run[0])
    frames = (int(keypoints.frames[first - 1]), int(keypoints.frames[stop - 1]) + 1)
    yield finding("detections_frozen", frames, camera, count=int(repeats.sum()), frames_total=len(repeats))


def _interpolated(keypoints: Keypoints, camera: str) -> list[Finding]:
    """Return a finding on moving points that lie halfway between their neighbours, or on one cubic."""
    xy_px = keypoints.xy_px
    bend = np.linalg.norm(xy_px[2:] - 2 * xy_px[1:-1] + xy_px[:-2], axis=-1)
    travel = 0.5 * np.linalg.norm(xy_px[2:] - xy_px[:-2], axis=-1)
    is_moving = travel > 0
    is_straight = is_moving & (bend < np.minimum(STRAIGHT_PX, STRAIGHT * travel))
    if _exceeds_chance(is_straight, is_moving):
        share = float(is_straight.sum() / is_moving.sum())
        return [finding("detections_interpolated", camera=camera, share=share)]
    is_curved, is_cubic = bend[1:-1] > CURVED_PX, np.zeros_like(is_moving[1:-1])
    if len(xy_px) > _CUBIC_FRAMES:
        fourth_px = np.linalg.norm(np.diff(xy_px, 4, axis=0), axis=-1)
        is_cubic = is_curved & (fourth_px < np.minimum(STRAIGHT_PX, STRAIGHT * travel[1:-1]))
    if not _exceeds_chance(is_cubic, is_curved):
        return []
    return [finding("detections_curved", camera=camera, share=float(is_cubic.sum() / is_curved.sum()))]


def step_ratios(tracks: Array) -> Array | None:
    """Return the lengths (N,) of steps between frames, relative to the steps around them.

    Each keypoint of the tracks (T, K, 2 or 3), in pixels, is compared with itself, because visibility changes and paws
    are faster than the trunk. The ratio of a step is the median over its keypoints. Steps with too few keypoints are
    left out, and the result is None if fewer than `LEAST_STEPS` remain.
    """
    steps = np.diff(tracks, axis=0)
    times = np.full(steps.shape[:2], np.nan)
    for j in range(steps.shape[1]):
        known_frames = np.flatnonzero(np.isfinite(steps[:, j, 0]))
        usual_px = running_median(steps[known_frames, j], AROUND)
        length_px = np.linalg.norm(usual_px, axis=1)
        projected = np.sum(steps[known_frames, j] * usual_px, axis=1) / np.maximum(length_px, 1e-9) ** 2
        times[known_frames, j] = np.where(length_px > LEAST_STEP_PX, projected, np.nan)
    times = times[np.isfinite(times).sum(axis=1) >= FEWEST]
    return np.nanmedian(times, axis=1) if len(times) >= LEAST_STEPS else None


def steps_are_missing(ratios: Array) -> bool:
    """Return whether so many steps are twice as long as the steps around them that frames must be missing."""
    is_long, is_short, is_alone = long_steps(ratios)
    return bool(
        is_long.mean() > SHARE_LONG
        and is_long.sum() > 2 * is_short.sum()
        and is_alone.sum() > SHARE_ALONE * is_long.sum()
    )


def long_steps(ratios: Array) -> tuple[Bools, Bools, Bools]:
    """Return masks of the long steps, of the short steps, and of the long steps between two shorter ones.

    The third mask lacks the first and the last step.
    """
    is_long = ratios > LONG
    is_alone = is_long[1:-1] & (ratios[1:-1] > ALONE * np.maximum(ratios[:-2], ratios[2:]))
    return is_long, ratios < SHORT, is_alone


def _dropped_frames(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    """Yield a finding on steps between frames that are twice as long as the steps around them."""
    ratios = step_ratios(keypoints.xy_px)
    if ratios is not None and steps_are_missing(ratios):
        yield finding("frames_dropped", camera=camera, share=float((ratios > LONG).mean()))


def _copied_sides(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    opposite = opposites(keypoints.names)
    left = np.flatnonzero(np.arange(len(opposite)) < opposite)
    identical, in_both = _identical(keypoints.xy_px[:, left], keypoints.xy_px[:, opposite[left]])
    if _exceeds_chance(identical, in_both):
        yield finding("far_side_copied", camera=camera, share=float(identical.sum() / in_both.sum()))


# Impossible motions

LEAST_S = 0.25
"""Shortest motion that is tested, in seconds."""
STILL = 0.95
"""Smallest fraction of frames in which an animal that stands still is slower than `STILL_M_S`."""
STILL_M_S = 0.3
"""Largest speed of an animal that stands still, m/s; one trunk length per second if its trunk is below 0.3 m."""
STILL_RAD_S = 0.6
"""Largest median angular speed of the joints of an animal that stands still, rad/s."""
STILL_TRUNKS = 0.5
"""Largest extent of the path of an animal that stands still, in trunk lengths."""
BACKWARDS_M_S = 1.0
"""Speed above which no animal runs backwards."""
BACKWARDS = 0.9
"""Fraction of frames faster than `BACKWARDS_M_S` backwards, above which the clip is reversed in time."""
SLOWEST = 0.1
"""Fraction of the feet, over all frames, that move at the speed of standing feet or more slowly."""
LOWEST = 0.2
"""Fraction of a foot's frames in which the foot counts as on the ground: those in which it is lowest.

On a belt or under a camera that pans, feet move in these frames at 0.55 to 1.22 times `FeetSpeeds.slowest_m_s` (42
clips of cheetahs). If a dog stands, steps or turns on the spot, the factor is -0.13 to 0.27 (11 clips; `python
benchmarks/wrong_inputs.py --only input-limits`).
"""
SLIDE_SHARE = 0.25
"""Backward speed of standing feet, relative to the body's speed over them, above which they slide.

The relative speed is 0.08 at most in 32 real views of cheetahs. It is 0.9 to 1.0 on a treadmill, except in a view along
the animal's path (0.1). Dogs on the spot reach 1.1, but the feet that are lowest then stand still, as `LOWEST` shows
(`python benchmarks/wrong_inputs.py --only input-limits`).
"""
SLIDE_LEGS_S = 0.5
"""Smallest speed of the body over the feet, in leg lengths per second, at which feet are tested for sliding.

The speed is 9 or more on a treadmill or under a camera that pans, and 1.2 to 2.3 if a dog steps or turns on the spot
(`python benchmarks/wrong_inputs.py --only input-limits`). Animals may walk slowly on a treadmill.
"""
STAYS_SHARE = 0.3
"""Speed of the body, relative to its speed over the feet, below which it stays where it is, as on a treadmill."""
SLIDE_M_S = -2.5
"""Backward speed that standing feet do not reach.

The lowest is -0.65 m/s in 32 real views of running cheetahs, and -1.05 m/s if a dog steps or turns on the spot (`python
benchmarks/wrong_inputs.py --only input-limits`).
"""
GLIDE_M_S = 8.0
"""Forward speed that standing feet do not reach.

The highest is 3.9 m/s in 32 real views of running cheetahs, and 8.7 m/s under a camera that pans against the animal
(`python benchmarks/wrong_inputs.py --only input-limits`).
"""
JOLTS = {"root acceleration": 1.0, "heading": 0.55, "climb": 1.1}
"""Costs per 1/90 s, in half squared standard deviations, above which the body's path is not that of an animal.

The costs are up to 0.53, 0.22 and 0.76 in 32 real views, and 0.69, 0.02 and 0.68 in the rendered film. They are up to
5.6, 1.2 and 4.7 (medians 3.3, 0.29 and 2.5) if a stabiliser moved the picture (`python benchmarks/wrong_inputs.py
--only input-limits`).
"""


def movement(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if no animal moves like this over the ground, or if the animal stands still; at most one."""
    solution, posed = motion.solution, motion.solved
    assert isinstance(solution, TrajectorySolution)
    if posed.sum() < max(LEAST_S * motion.fps, 3):
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
    elif is_staying and np.nanquantile(speed, STILL) < min(STILL_M_S, trunk_m) and np.nanmedian(turns) < STILL_RAD_S:
        # a motion that was fitted without a prior is not wrong because the animal stands
        yield finding("no_strides" if solution.prior == NONE else "animal_still", speed_m_s=float(np.nanmedian(speed)))
    elif np.mean(forward[np.isfinite(forward)] < -BACKWARDS_M_S) > BACKWARDS:
        yield finding("time_reversed", speed_m_s=-float(np.nanmedian(forward)))
    elif sliding is not None:
        yield sliding
    else:
        costs = jolt_costs(motion)
        worst = max(JOLTS, key=lambda name: costs[name] / JOLTS[name])
        if costs[worst] > JOLTS[worst]:
            jolts = finding("path_jolts", of=worst, cost=costs[worst])
            # the limits are those of running cheetahs: other animals turn on the spot, or sidestep
            yield replace(jolts, severity="note") if solution.prior == NONE else jolts


def jolt_costs(motion: Motion) -> dict[str, float]:
    """Return the costs of the body's path per 1/90 s, by the names of `JOLTS`."""
    solution = motion.solution
    assert isinstance(solution, TrajectorySolution)
    frames = REFERENCE_HZ * float(motion.solved.sum()) / motion.fps
    return {name: float(solution.cost_by_term.get(name, 0.0)) / frames for name in JOLTS}


@dataclass(frozen=True)
class FeetSpeeds:
    """Speeds of the body and of the standing feet over the ground, m/s along the trunk, backwards negative."""

    body_m_s: float
    slowest_m_s: float
    """Speed below which a foot moves in the fraction `SLOWEST` of all frames; about 0 if standing feet stand still."""
    slide_m_s: float
    """Median speed of the standing feet over the ground."""
    leg_m: float
    """Height of the trunk above the lowest foot, metres."""

    @property
    def over_feet_m_s(self) -> float:
        """Return the speed of the body over its standing feet."""
        return self.body_m_s - self.slowest_m_s


def feet_speeds(motion: Motion) -> FeetSpeeds | None:
    """Return the speeds of the body and of its feet over the ground; None without feet."""
    forward, feet = _along(motion)
    if not len(feet[0]):
        return None
    joints_m, trunk_ends = motion.solution.joints_m, list(motion.forward)
    leg_m = joints_m[:, trunk_ends, 2].mean(axis=1) - joints_m[:, list(motion.feet), 2].min(axis=1)
    return FeetSpeeds(
        body_m_s=float(np.nanmedian(forward)),
        slowest_m_s=float(np.nanquantile(feet, SLOWEST)),
        slide_m_s=float(np.nanquantile(feet, SLOWEST / 2)),
        leg_m=float(np.nanmedian(leg_m)),
    )


def on_ground_m_s(motion: Motion) -> float:
    """Return the median speed of the feet along the trunk in the frames in which they are lowest, m/s."""
    _, feet = _along(motion)
    heights_m = motion.solution.joints_m[:, list(motion.feet), 2]
    return float(np.nanmedian(feet[heights_m <= np.nanquantile(heights_m, LOWEST, axis=0)]))


def seem_to_slide(speeds: FeetSpeeds) -> bool:
    """Return whether standing feet seem to slide, relative to the body or faster than feet do."""
    over_feet_m_s = speeds.over_feet_m_s
    is_relative = -speeds.slowest_m_s > SLIDE_SHARE * over_feet_m_s and over_feet_m_s > SLIDE_LEGS_S * speeds.leg_m
    return is_relative or not SLIDE_M_S < speeds.slowest_m_s < GLIDE_M_S


def _sliding(motion: Motion, speeds: FeetSpeeds) -> Finding | None:
    """Return the finding on standing feet that move over the ground, or None."""
    if not seem_to_slide(speeds):
        return None
    if abs(on_ground_m_s(motion)) < 0.5 * abs(speeds.slowest_m_s):
        return None  # the lowest feet stand still, and only the other feet move
    if speeds.slowest_m_s < 0 and abs(speeds.body_m_s) < STAYS_SHARE * speeds.over_feet_m_s:
        return finding("treadmill", slide_m_s=-speeds.slide_m_s, speed_m_s=speeds.body_m_s)
    return finding("camera_moves", slide_m_s=speeds.slowest_m_s, speed_m_s=speeds.body_m_s)


def _along(motion: Motion) -> tuple[Array, Array]:
    """Return speeds of the body (T,) and of the feet (T, F) along the trunk, over the ground; NaN without a pose."""
    rear, front = motion.forward
    joints_m = motion.solution.joints_m
    trunk = (joints_m[:, front] - joints_m[:, rear])[:, :2]
    trunk = trunk / np.maximum(np.linalg.norm(trunk, axis=1, keepdims=True), 1e-9)
    velocity = np.gradient(joints_m, axis=0)[..., :2] * motion.fps
    along = np.einsum("tja,ta->tj", velocity, trunk)
    return along.mean(axis=1), along[:, motion.feet]


# Gross outliers

GROSS = "in frames whose detections are gross outliers"
"""Reason for leaving out the detections of a frame."""
MOST = 0.5
"""Largest fraction of frames that may be outliers; above it, the fit or another input is wrong."""


def outlier_ratios(view: View, markers_m: Array, noise_px: Array) -> Array:
    """Return the log-likelihood gain of each frame's keypoints if they lie anywhere in the picture, (T,).

    The gain is relative to keypoints at their markers (T, J, 3) with noise (T, J), pixels. The gain is NaN without
    keypoints or a pose.
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
    """Return the sources without frames that are gross outliers as a whole, and findings on these frames."""
    kept, findings = [], []
    for source, view, noise_px in zip(sources, solution.views, solution.noise_px, strict=True):
        ratios = outlier_ratios(view, solution.markers_m, noise_px)
        rows: Bools = ratios > CLEAR
        rows &= rows.sum() <= MOST * view.present.any(axis=1).sum()
        points, numbers = source.keypoints.present & rows[:, None], source.keypoints.frames
        keypoints, cleaning = leave_out(source.keypoints, source.cleaning, points, GROSS, source.later_frames)
        kept.append(replace(source, keypoints=keypoints, cleaning=cleaning))
        for first, stop in frame_ranges(np.flatnonzero(rows)):
            frames, ratio = (int(numbers[first]), int(numbers[stop - 1]) + 1), float(ratios[first:stop].sum())
            findings.append(finding("gross_outliers", frames, source.camera.name, log_likelihood_ratio=ratio))
    return tuple(kept), tuple(findings)
