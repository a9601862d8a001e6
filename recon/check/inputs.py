"""Input findings: copied coordinates, a camera that moves, left-right swaps, gross outliers, a picture turned over,
another camera's by its file's name, a wrong frame rate.

What was copied, and how no animal moves, is said first. Detections that are the same to the last digit were copied, not
measured. Under a camera that pans, feet that stand slide, all of them alike. The rest is recognised by how much
likelier the clip is with it undone (`recon.check.likelihood`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.ndimage import median_filter
from threadpoolctl import threadpool_limits

from recon.animal import opposites
from recon.animal.prior import NONE, MotionPrior, mean_speed_m_s
from recon.base.arrays import Array, Bools
from recon.check.codes import FLAG_OF, finding
from recon.check.likelihood import CLEAR, baseline_of, log_tail, of_lens, of_other_picture, of_unit_square, other_rate
from recon.check.swaps import swap_finding, swaps
from recon.clip import Keypoints, Source, View, frame_ranges, leave_out
from recon.fit import REFERENCE_HZ, ClipProblem, Finding, Motion, TrajectoryOptions, TrajectorySolution
from recon.geometry.kinematics import ROOT

FASTEST_M_S = 40.0
"""No animal runs as fast: cheetahs reach 29 m/s (N. Sharp, *Timed running speed of a cheetah*, J. Zool. 1997)."""

MOSTLY_POOR = 0.9
"""The share of frames of which little or nothing is seen from which the motion is the prior's, and so is its rate."""
MOVES = ("animal_still", "time_reversed", "camera_moves")
"""What makes sides doubtful by itself."""


def input_findings(
    motion: Motion,
    prior: MotionPrior,
    options: TrajectoryOptions,
    named: Sequence[str | None],
    stated_hz: float | None = None,
    seek_swaps: bool = True,
) -> tuple[Finding, ...]:
    """The findings on the keypoints that a motion was fitted to. named: by view, the other camera that its file's name
    says. stated_hz: the frame rate that a file states. seek_swaps: whether swaps are looked for, which takes longest.
    """
    solution, body, fps = motion.solution, motion.body, motion.fps
    assert isinstance(solution, TrajectorySolution)
    clip = ClipProblem.from_views(solution.views, body, prior, fps, options)
    weighed = replace(clip, prior_weight=min((segment.prior_weight for segment in solution.segments), default=1.0))
    too_fast = mean_speed_m_s(solution.states, fps) > FASTEST_M_S  # nor does the prior know it
    unlike = too_fast or any(segment.unlike_prior for segment in solution.segments)
    found = [*copies(motion.sources, resampled=bool(motion.settings.get("camera_fps")))]
    certain = any(one.severity == "error" for one in found)
    moves = [] if certain else [*movement(motion)]
    stated = certain or any(one.code in MOVES for one in moves)
    learned = prior.name != NONE and bool(solution.posed.any())
    elsewhere = any(segment.ground and segment.ground.near_zero is False for segment in solution.segments)
    on_ground = replace(weighed, ground_near_zero=weighed.ground_near_zero and not elsewhere)
    pictures: list[Finding] = []
    with threadpool_limits(1, user_api="blas"):
        for number, source in enumerate(motion.sources):
            camera, as_given = source.camera.name, baseline_of(clip, number, solution.states, solution.size)
            if named[number] is not None:
                pictures.append(finding("other_camera_named", camera=camera, given=camera, other=named[number]))
            elif of_picture := of_unit_square(as_given) or of_other_picture(as_given):
                pictures.append(of_picture)
            elif learned and not stated:
                given = baseline_of(on_ground, number, solution.states, solution.size)
                swapped = [swap_finding(trial, source, body) for trial in (swaps(given, unlike) if seek_swaps else ())]
                found += swapped
                if len(motion.sources) == 1 and not (swapped or moves):
                    moves += of_lens(given, solution.noise_px[number])
        found += pictures
        slides = [one.numbers.get("slide_m_s") for one in moves]
        glides = any(isinstance(one, float) and one > 0 for one in slides)  # as at a rate that is too high
        if glides or not (stated or pictures):
            found += _of_rate(clip, solution, stated_hz)
    if not pictures and not any(one.code.startswith("frame_rate") for one in found):
        found += moves
    return tuple(found)


def _of_rate(clip: ClipProblem, solution: TrajectorySolution, stated_hz: float | None) -> Sequence[Finding]:
    posed = np.isfinite(solution.states[:, 0])
    segments = [segment.rows for segment in solution.segments if posed[segment.rows].all()]
    if not segments:
        return ()
    longest = max(segments, key=lambda rows: rows.stop - rows.start)
    states = solution.states[longest].copy()
    states[:, ROOT] = (states[:, ROOT] - clip.origin_m) / solution.size
    poor = np.mean([bool({*flags} & {"no data", "data poor"}) for flags in solution.flags[longest]]) > MOSTLY_POOR
    found = other_rate(clip.part(longest), states, stated_hz, by_motion=not poor)
    return () if found is None else (found,)


def flagged(motion: Motion, findings: Sequence[Finding]) -> Motion:
    """A motion with the flags of the frames that findings are about."""
    flags = [*motion.flags]
    for one in findings:
        name = FLAG_OF.get(one.code)
        if name is not None and one.frames is not None:
            for t in range(*np.searchsorted(motion.frames, one.frames)):
                flags[t] = flags[t] if name in flags[t] else (*flags[t], name)
    return replace(motion, solution=replace(motion.solution, flags=tuple(flags)))


# -- copied coordinates ------------------------------------------------------------------------------------------------

SHARE = 0.2
"""So many identical coordinates, of those that could be, are no chance: hand labels in whole pixels may have a few."""
FRAMES = 0.05
"""The least share of a clip's frames: fewer that repeat the one before are a hiccup of a camera."""
FEWEST = 4
"""Fewer keypoints of a frame may be identical by chance."""
STRAIGHT_PX, STRAIGHT = 0.01, 0.02
"""A point lies on the line between its neighbours within the digits of a file, and within this part of its way."""
LONG, SHORT, SHARE_LONG = 1.45, 0.5, 0.13
"""Times that a step is as long as the steps around it, and the share of steps that are longer: where so many are, and
less than half as many shorter, frames were left out. At most 0.12 of the steps are long in 32 real views, also with
half of their points missing, a side hidden, or an animal that comes into the picture; 0.2 where a quarter of the frames
is."""
ALONE, SHARE_ALONE = 1.3, 0.4
"""So many times as long as both steps beside it, and the share of the long steps that are: legs that swing, seen alone
or by a camera that follows, are fast for some frames. Chosen on simulated cameras and noise (cheetahs, dogs)."""
AROUND, LEAST_STEP_PX, LEAST_STEPS = 7, 5.0, 20
"""Steps of a keypoint that are compared with each other; shorter ones, or fewer in all, say nothing."""


def copies(sources: Sequence[Source], resampled: bool = False) -> Iterator[Finding]:
    """Findings on points that are copies of others. resampled: points were taken between frames: lines say nothing."""
    for source in sources:
        keypoints, camera = source.keypoints, source.camera.name
        if not resampled:
            yield from (
                _interpolated(keypoints, camera) or [*_repeated(keypoints, camera)] or _left_out(keypoints, camera)
            )
        yield from _copied_sides(keypoints, camera)
    for a, b in combinations(sources, 2):
        identical, both = _identical(a.keypoints.xy_px, b.keypoints.xy_px)
        if _many(identical, both):
            names, share = (a.camera.name, b.camera.name), float(identical.sum() / both.sum())
            yield finding("same_keypoints", cameras=names, share=share)


def _identical(a: np.ndarray, b: np.ndarray) -> tuple[Bools, Bools]:
    """For points (..., 2): which are the same in both, and which are in both."""
    both = np.asarray(np.isfinite(a + b).all(axis=-1))
    return both & np.asarray((a == b).all(axis=-1)), both


def _many(identical: Bools, of: Bools) -> bool:
    return bool(identical.sum() > SHARE * of.sum() and identical.sum() >= FEWEST)


def _repeated(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    """Frames whose points are those of the frame before: every second, as of a video at twice its rate, or some."""
    identical, both = _identical(keypoints.xy_px[1:], keypoints.xy_px[:-1])
    count = identical.sum(axis=1)
    repeats = np.append(False, (count >= FEWEST) & (2 * count > both.sum(axis=1)))
    if repeats.sum() <= FRAMES * len(repeats):
        return
    new = np.flatnonzero(~repeats)
    times = int(np.median(np.diff(new))) if len(new) > 2 else 1
    if times > 1 and repeats.mean() < 1 - 0.5 / times:
        numbers = {"times": times, "given_hz": keypoints.fps or np.nan, "other_hz": (keypoints.fps or np.nan) / times}
        yield finding("detections_repeated", camera=camera, **numbers)
        return
    runs = frame_ranges(np.flatnonzero(repeats))
    first, stop = max(runs, key=lambda run: run[1] - run[0])
    frames = (int(keypoints.frames[first - 1]), int(keypoints.frames[stop - 1]) + 1)
    yield finding("detections_frozen", frames, camera, count=int(repeats.sum()), frames_total=len(repeats))


def _interpolated(keypoints: Keypoints, camera: str) -> list[Finding]:
    """Points halfway between those before and after, although they move."""
    xy_px = keypoints.xy_px
    bend = np.linalg.norm(xy_px[2:] - 2 * xy_px[1:-1] + xy_px[:-2], axis=-1)
    way = 0.5 * np.linalg.norm(xy_px[2:] - xy_px[:-2], axis=-1)
    moving = way > 0
    straight = moving & (bend < np.minimum(STRAIGHT_PX, STRAIGHT * way))
    if not _many(straight, moving):
        return []
    return [finding("detections_interpolated", camera=camera, share=float(straight.sum() / moving.sum()))]


def _left_out(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    """Steps from frame to frame that are twice as long as those around, each keypoint's own: which of them are seen
    changes, and a paw is faster than a trunk."""
    steps = np.diff(keypoints.xy_px, axis=0)
    times = np.full(steps.shape[:2], np.nan)
    for j in range(steps.shape[1]):
        known = np.flatnonzero(np.isfinite(steps[:, j, 0]))
        usual_px = median_filter(steps[known, j], size=(AROUND, 1), mode="nearest")
        length_px = np.linalg.norm(usual_px, axis=1)
        along = np.sum(steps[known, j] * usual_px, axis=1) / np.maximum(length_px, 1e-9) ** 2
        times[known, j] = np.where(length_px > LEAST_STEP_PX, along, np.nan)
    times = times[np.isfinite(times).sum(axis=1) >= FEWEST]
    if len(times) < LEAST_STEPS:
        return
    each = np.nanmedian(times, axis=1)
    long, short = each > LONG, each < SHORT
    alone = long[1:-1] & (each[1:-1] > ALONE * np.maximum(each[:-2], each[2:]))
    if long.mean() > SHARE_LONG and long.sum() > 2 * short.sum() and alone.sum() > SHARE_ALONE * long.sum():
        yield finding("frames_dropped", camera=camera, share=float(long.mean()))


def _copied_sides(keypoints: Keypoints, camera: str) -> Iterator[Finding]:
    places = opposites(keypoints.names)
    one = np.flatnonzero(np.arange(len(places)) < places)
    identical, both = _identical(keypoints.xy_px[:, one], keypoints.xy_px[:, places[one]])
    if _many(identical, both):
        yield finding("far_side_copied", camera=camera, share=float(identical.sum() / both.sum()))


# -- how no animal moves ----------------------------------------------------------------------------------------------

LEAST_S = 0.25
"""Motions that are shorter say nothing."""
STILL, STILL_M_S, STILL_RAD_S, STILL_TRUNKS = 0.95, 0.3, 0.6, 0.5
"""An animal that stands still is not faster in so many frames, nor goes by its trunk's length in a second, nor are its
joints' angular speeds larger, by their median, nor does it leave its place by half its trunk's length."""
BACKWARDS_M_S, BACKWARDS = 1.0, 0.9
"""No animal runs backwards as fast, for so much of a clip."""
SLOWEST = 0.1
"""The part of the feet, over all frames, that has the speeds of feet that stand, or less."""
SLIDE_M_S, GLIDE_M_S = -2.5, 8.0
"""Feet that stand are not as fast, backwards or forwards. 32 real views of running cheetahs: -0.7 to 4.1 m/s."""
JOLTS = {"root acceleration": 1.0, "heading": 0.55, "climb": 1.1}
"""Costs in 1/90 s, half squared sigmas, from which a body's path is no animal's; up to 0.5, 0.35 and 0.7 in real views,
and 0.8 of the first in the drawn film (benchmarks/wrong_inputs.py)."""


def movement(motion: Motion) -> Iterator[Finding]:
    """At most one: the clearest."""
    solution, posed = motion.solution, motion.solved
    assert isinstance(solution, TrajectorySolution)
    if posed.sum() < max(LEAST_S * motion.fps, 3):
        return
    forward, feet = _along(motion)
    turns = np.abs(np.diff(motion.states[:, 6:], axis=0)) * motion.fps
    middle_m = solution.joints_m.mean(axis=1)
    speed = np.linalg.norm(np.gradient(middle_m, axis=0), axis=1) * motion.fps
    rear, front = motion.forward
    trunk_m = float(np.nanmedian(np.linalg.norm(solution.joints_m[:, rear] - solution.joints_m[:, front], axis=1)))
    stays = np.linalg.norm(np.nanmax(middle_m, axis=0) - np.nanmin(middle_m, axis=0)) < STILL_TRUNKS * trunk_m
    if stays and np.nanquantile(speed, STILL) < min(STILL_M_S, trunk_m) and np.nanmedian(turns) < STILL_RAD_S:
        yield finding("animal_still", speed_m_s=float(np.nanmedian(speed)))
    elif np.mean(forward[np.isfinite(forward)] < -BACKWARDS_M_S) > BACKWARDS:
        yield finding("time_reversed", speed_m_s=-float(np.nanmedian(forward)))
    elif len(feet[0]) and not SLIDE_M_S < (slowest := float(np.nanquantile(feet, SLOWEST))) < GLIDE_M_S:
        yield finding("camera_moves", slide_m_s=slowest, speed_m_s=float(np.nanmedian(forward)))
    else:
        frames = REFERENCE_HZ * float(posed.sum()) / motion.fps
        costs = {name: float(solution.cost_by_term.get(name, 0.0)) / frames for name in JOLTS}
        worst = max(JOLTS, key=lambda name: costs[name] / JOLTS[name])
        if costs[worst] > JOLTS[worst]:
            yield finding("path_jolts", of=worst, cost=costs[worst])


def _along(motion: Motion) -> tuple[Array, Array]:
    """Speeds (T,) of the body and (T, F) of the feet along the trunk, over the ground; NaN without a pose."""
    rear, front = motion.forward
    joints_m = motion.solution.joints_m
    trunk = (joints_m[:, front] - joints_m[:, rear])[:, :2]
    trunk = trunk / np.maximum(np.linalg.norm(trunk, axis=1, keepdims=True), 1e-9)
    velocity = np.gradient(joints_m, axis=0)[..., :2] * motion.fps
    along = np.einsum("tja,ta->tj", velocity, trunk)
    return along.mean(axis=1), along[:, motion.feet]


# -- gross outliers ---------------------------------------------------------------------------------------------------

_WHY = "in frames whose detections are gross outliers"
MOST = 0.5
"""Where more of the frames are, the fit is wrong, or another mistake was made."""


def outlier_ratios(view: View, markers_m: Array, noise_px: Array) -> Array:
    """(T,): how much likelier a frame's keypoints are if each lies anywhere in the picture rather than at its marker
    (T, J, 3) with noise (T, J), as a logarithm; NaN without keypoints or a pose."""
    projected, valid = view.project(view.shift_to_exposure(markers_m))
    density = -2.0 * np.log(noise_px) - np.log(2 * np.pi) - log_tail((projected - view.xy_px) / noise_px[..., None])
    width, height = view.camera.image_size_px
    anywhere = -float(np.log(width * height))
    known = view.present & np.isfinite(markers_m[:, :1, 0])
    each = np.where(known, anywhere - np.where(valid, density, -np.inf), 0.0)
    return np.where(known.any(axis=1), each.sum(axis=1), np.nan)


def without_gross_outliers(
    sources: Sequence[Source], solution: TrajectorySolution
) -> tuple[tuple[Source, ...], tuple[Finding, ...]]:
    """The sources without the detections of frames that are gross outliers as a whole, and which those were."""
    kept, found = [], []
    for source, view, noise_px in zip(sources, solution.views, solution.noise_px, strict=True):
        ratios = outlier_ratios(view, solution.markers_m, noise_px)
        rows: Bools = ratios > CLEAR
        rows &= rows.sum() <= MOST * view.present.any(axis=1).sum()
        points, numbers = source.keypoints.present & rows[:, None], source.keypoints.frames
        keypoints, cleaning = leave_out(source.keypoints, source.cleaning, points, _WHY)
        kept.append(replace(source, keypoints=keypoints, cleaning=cleaning))
        for first, stop in frame_ranges(np.flatnonzero(rows)):
            frames, ratio = (int(numbers[first]), int(numbers[stop - 1]) + 1), float(ratios[first:stop].sum())
            found.append(finding("gross_outliers", frames, source.camera.name, log_likelihood_ratio=ratio))
    return tuple(kept), tuple(found)
