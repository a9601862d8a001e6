"""Test whether the cameras of a clip agree, by comparing each camera's detections with points seen by the others.

The rays of the cameras are compared by their error ratios (`recon.check.sights`). The test uses no body and no fitted
pose, so it also detects a camera that pulls the fit away from the others. The cameras' poses come from the fit, which
may have refined them.

If error ratios are too high, an exchange of two cameras' files is tried first, because it explains the errors of two
cameras at once (`_exchanged_pair`). Cameras are then left out one by one until the others agree (`_agreeing_group`).
For each camera left out, the best rotation and the best time offset are determined (`best_turned`, `best_shifted`). If
the rotation or the offset lowers the error ratio enough, it is reported as the cause. Otherwise the cause is unknown.
If no two cameras agree, a single error names all of them. Without a third camera, no rotation or offset can be found,
so two cameras that disagree are always reported together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np

from recon.base.arrays import Array
from recon.check.codes import by_effect, finding
from recon.check.likelihood import effects_m
from recon.check.sights import (
    MIN_POINTS,
    PointsOf,
    Sight,
    best_shifted,
    best_turned,
    error_ratio,
    error_ratio_of_pair,
    error_ratios,
    meeting_points,
    sights_of,
    squared_errors,
)
from recon.check.swaps import with_exchanged_names
from recon.clip import View, densest_window
from recon.fit.motion import Motion
from recon.fit.result import Finding, TrajectorySolution

MAX_ERROR_RATIO = 1.6
"""Largest error ratio at which a camera counts as agreeing with the others.

The limit is raised if the other cameras are noisier than expected (`MAX_NOISE_FACTOR`).
"""
MAX_NOISE_FACTOR = 2.0
"""Largest factor by which `MAX_ERROR_RATIO` is raised for a noisy detector, with three or more cameras."""
MAX_NOISE_FACTOR_OF_TWO = 1.1
"""Largest factor by which `MAX_ERROR_RATIO` is raised for a noisy detector, with two cameras.

The factor is smaller than `MAX_NOISE_FACTOR`, because no third camera shows that the errors are noise.
"""
MAX_REMAINING_FRACTION = 0.25
"""Largest fraction of a camera's error ratio that may remain after correcting a cause that explains the error."""
CLEAR_ROTATION_RAD = np.radians(3.0)
"""Minimum rotation (rad) for which an agreeing camera is still reported, if the gain is at least `CLEAR_GAIN`."""
CLEAR_OFFSET = 3.0
"""Minimum offset in frames for which an agreeing camera is still reported, if the gain is at least `CLEAR_GAIN`."""
CLEAR_GAIN = 1.5
"""Minimum factor by which a rotation or a time offset must reduce the error ratio of a camera that agrees."""
MAX_ROTATION_RAD = np.radians(45.0)
"""Largest rotation (rad) of a camera that is reported as a cause. A larger rotation is more likely another fault."""
MAX_FRAMES = 480
"""Maximum number of frames in which cameras are compared.

In a longer clip, the stretch of frames with the most detections in common is used.
"""
SWAPS = ("left_right_swap", "left_right_swap_possible")
"""Codes of findings on left-right swaps that the result contains."""
_FRAMES_BESIDE_SWAP = 10
"""Number of frames before and after a swap in the fit that determines its effect. Farther frames hardly matter."""
_KEPT_POINTS = 16
"""Number of groups of cameras whose triangulated points are cached for further comparisons."""
Comparison = dict[str, float]
"""Comparison of one camera with the cameras that agree with each other; NaN if unknown.

- points: number of points that were compared
- error_px: median distance of the detections from the positions at which the other cameras see the points
- level: error ratio of the camera
- turn_rad: angle of the rotation that makes the camera agree best
- late_frames: delay of the camera's pictures that makes it agree best
- level_turned, level_late: error ratio after this rotation, and after this delay
"""


Fitted = Callable[[Sequence[View]], TrajectorySolution]
"""Function that fits the motion to some of the clip's views, as the clip was fitted."""


def agreement_findings(
    motion: Motion, sigma_px: float, keypoint_sigma_m: float, fitted: Fitted | None = None
) -> tuple[Finding, ...]:
    """Return the findings from a comparison of a motion's cameras with each other.

    There is a note on each camera, and an error for each camera that is exchanged, turned, late, or off for an unknown
    reason. If no two cameras agree, a single error names all cameras. The result is deterministic.

    Parameters
    ----------
    motion
        The motion, with its sources and with the views of its solution. Poses and focal lengths are taken from the
        views, which a fit may have refined, and time offsets from the sources.
    sigma_px
        Standard deviation of the detector's noise, pixels.
    keypoint_sigma_m
        Standard deviation of a keypoint's position on the body, m.
    fitted
        Function that fits the cameras that agree, to determine the effect of the others on the result. If it is None,
        this effect is unknown.
    """
    views_and_sources = zip(motion.solution.views, motion.sources, strict=True)
    views = [replace(view, offset_frames=source.offset_frames) for view, source in views_and_sources]
    if len(views) < 2:
        return ()
    seen_together = (np.sum([view.present for view in views], axis=0) > 1).sum(axis=1)
    rows, fps = densest_window(seen_together, MAX_FRAMES), motion.fps
    views = [view.part(rows) for view in views]
    frames = (int(motion.frames[rows][0]), int(motion.frames[rows][-1]) + 1)
    names = [view.camera.name for view in views]
    given_sights = sights_of(views, sigma_px, keypoint_sigma_m)
    points_of = lru_cache(maxsize=_KEPT_POINTS)(meeting_points)
    sights, exchanged, limit = _without_exchange(views, given_sights, sigma_px, keypoint_sigma_m, points_of)
    agreeing, comparisons = _compare_with_agreeing(sights, fps, limit, points_of)

    findings = []
    left_out = [v for v in range(len(views)) if agreeing and v not in agreeing]
    wrong = [v for v in left_out if comparisons[v]["level"] > limit or _gain(comparisons[v]) >= CLEAR_GAIN]
    if wrong:
        # The effect is measured on the fit, which also knows the body and estimates small time offsets. The rays of two
        # remaining cameras may hardly determine a triangulated point.
        kept = [view for v, view in enumerate(views) if v not in wrong]
        effect = {} if fitted is None else effects_m(motion.solution.joints_m[rows], fitted(kept).joints_m)
        for v in wrong:
            comparison = comparisons[v]
            offset_s = motion.sources[v].offset_s + comparison["late_frames"] / fps
            numbers = comparison | effect | {"offset_s": offset_s}
            item = finding(_code(comparison, limit), frames, names[v], **numbers)
            findings.append(
                by_effect(item, motion.trunk_m, is_gross=comparison["level"] > MAX_ERROR_RATIO * MAX_NOISE_FACTOR)
            )
    for v in exchanged:  # compared before the correction, so that the error ratios show the exchange
        partners = [sights[o] for o in agreeing or range(len(views)) if o != v]
        comparisons[v] = _compare(given_sights[v], partners, fps, points_of, wide=False)
    disagreeing = () if agreeing else tuple(range(len(views)))
    for code, members in (("cameras_exchanged", exchanged), ("cameras_disagree", disagreeing)):
        if members:
            cameras = tuple(names[v] for v in members)
            findings.append(finding(code, frames, None, cameras=cameras, **comparisons[members[0]]))
    if not any(comparison["points"] for comparison in comparisons):
        findings.append(finding("cameras_apart_in_time", frames))
    for name, comparison in zip(names, comparisons, strict=True):
        findings.append(finding("camera_agreement", frames, name, max_level=limit, **comparison))
    return tuple(findings)


def _without_exchange(
    views: Sequence[View], sights: list[Sight], sigma_px: float, keypoint_sigma_m: float, points_of: PointsOf
) -> tuple[list[Sight], tuple[int, ...], float]:
    """Return the sights after undoing an exchange of two cameras' files, these cameras, and the limit of error ratios.

    The pair of cameras is () if no files are exchanged. The limit is higher than `MAX_ERROR_RATIO` if the cameras that
    agree best are noisier than expected.
    """
    everyone = tuple(range(len(views)))
    ratios = error_ratios(sights, everyone, points_of)
    if _are_within(ratios, MAX_ERROR_RATIO):
        return sights, (), MAX_ERROR_RATIO
    pairs = [pair for pair in combinations(everyone, 2) if not _are_within(ratios[[*pair]], MAX_ERROR_RATIO)]
    trials = {pair: sights_of(_with_exchanged(views, *pair), sigma_px, keypoint_sigma_m) for pair in pairs}
    trial_ratios = {pair: error_ratios(trial, everyone, points_of) for pair, trial in trials.items()}
    rests = [
        error_ratios(sights, rest, points_of) for rest in combinations(everyone, len(everyone) - 1) if len(rest) > 1
    ]
    medians = [np.nanmedian(values) for values in (*rests, *trial_ratios.values()) if np.isfinite(values).any()]
    max_factor = MAX_NOISE_FACTOR if len(views) > 2 else MAX_NOISE_FACTOR_OF_TWO
    limit = MAX_ERROR_RATIO * float(np.clip(min(medians, default=np.inf), 1.0, max_factor))
    exchanged = _exchanged_pair(ratios, trial_ratios, limit)
    return (sights, (), limit) if exchanged is None else (trials[exchanged], exchanged, limit)


def swaps_by_effect(findings: Sequence[Finding], motion: Motion, fitted: Fitted) -> tuple[Finding, ...]:
    """Return the findings, with the severity of each left-right swap reduced if it hardly changes the fit.

    A swap in one camera has little effect if the other cameras agree, because the robust fit follows them. The effect
    of a swap is the change of a fit of the frames around it, in which all swaps are exchanged back. With fewer than
    three cameras, the findings are not changed. `fitted` is the function that fits views.
    """
    views = motion.solution.views
    swaps = [item for item in findings if item.code in SWAPS and item.frames and item.names("keypoints")]
    if len(views) < 3 or not swaps:
        return tuple(findings)
    exchanged_back = _without_swaps(motion, swaps)
    weighed = []
    for item in findings:
        if item in swaps:
            first, stop = np.searchsorted(motion.frames, item.frames or ())
            stop = min(stop, first + MAX_FRAMES)
            around = slice(max(first - _FRAMES_BESIDE_SWAP, 0), stop + _FRAMES_BESIDE_SWAP)
            joints_m = fitted([view.part(around) for view in exchanged_back]).joints_m
            inside = slice(first - around.start, stop - around.start)
            effect = effects_m(motion.solution.joints_m[first:stop], joints_m[inside])
            item = by_effect(replace(item, numbers=item.numbers | effect), motion.trunk_m)
        weighed.append(item)
    return tuple(weighed)


def _without_swaps(motion: Motion, swaps: Sequence[Finding]) -> list[View]:
    """Return the views of a motion with left and right exchanged in the frames and keypoints of the swaps."""
    views = [*motion.solution.views]
    names = [view.camera.name for view in views]
    for swap in swaps:
        v, rows = names.index(str(swap.camera)), slice(*np.searchsorted(motion.frames, swap.frames or ()))
        views[v] = replace(views[v], **with_exchanged_names(views[v], rows, swap.names("keypoints"), motion.body))
    return views


def _compare_with_agreeing(
    sights: Sequence[Sight], fps: float, limit: float, points_of: PointsOf
) -> tuple[tuple[int, ...], list[Comparison]]:
    """Return the agreeing cameras, and the comparison of each camera with them, or with all cameras if none agree.

    A camera can be turned by some degrees about its line of sight while its error ratio is still low. Agreeing cameras
    that a rotation or a time offset clearly improves are therefore removed as well.
    """
    agreeing = _agreeing_group(sights, fps, limit, points_of)
    comparisons = _compare_each(sights, agreeing or range(len(sights)), fps, points_of)
    while len(agreeing) > 2:
        worst = max(agreeing, key=lambda v: _gain(comparisons[v]))
        if _gain(comparisons[worst]) < CLEAR_GAIN:
            break
        agreeing = tuple(v for v in agreeing if v != worst)
        comparisons = _compare_each(sights, agreeing, fps, points_of)
    return agreeing, comparisons


def _are_within(ratios: Array, limit: float) -> bool:
    """Return whether no error ratio exceeds the limit, ignoring unknown ratios, which are NaN."""
    return not (ratios > limit).any()


def _is_explained(ratio: float, previous: float, limit: float) -> bool:
    return ratio <= max(limit, MAX_REMAINING_FRACTION * previous)


def _exchanged_pair(ratios: Array, trials: Mapping[tuple[int, int], Array], limit: float) -> tuple[int, int] | None:
    """Return the two cameras whose error ratios are best explained by exchanged files, or None.

    `trials` has the error ratios of all cameras after exchanging the files of each pair.

    `limit` is the largest error ratio of cameras that agree.
    """
    explained = {
        pair: np.nansum(after_exchange)
        for pair, after_exchange in trials.items()
        if np.nansum(after_exchange) < np.nansum(ratios) / 2
        and all(_is_explained(after_exchange[v], ratios[v], limit) for v in pair)
        and (len(ratios) > 2 or _are_within(after_exchange, limit))
    }
    return min(explained, key=lambda pair: explained[pair], default=None)


def _compare_each(
    sights: Sequence[Sight], agreeing: Sequence[int], fps: float, points_of: PointsOf
) -> list[Comparison]:
    return [
        _compare(sight, [sights[o] for o in agreeing if o != v], fps, points_of, wide=v not in agreeing)
        for v, sight in enumerate(sights)
    ]


def _causes(comparison: Comparison, least_rad: float = 0.0, least_frames: float = 0.0) -> dict[str, float]:
    """Return a dictionary of the camera's error ratio after correcting each possible cause, by the cause's code.

    A rotation below `least_rad`, or a delay below `least_frames`, is not a possible cause.
    """
    is_turned = least_rad <= comparison["turn_rad"] <= MAX_ROTATION_RAD
    is_late = abs(comparison["late_frames"]) >= least_frames
    ratios = {"camera_late": comparison["level_late"]} if is_late else {}
    return ratios | ({"camera_turned": comparison["level_turned"]} if is_turned else {})


def _gain(comparison: Comparison) -> float:
    """Return the factor by which the best rotation or time offset reduces the error ratio; 1 if both are small."""
    causes = _causes(comparison, CLEAR_ROTATION_RAD, CLEAR_OFFSET)
    return max((comparison["level"] / max(ratio, 1e-9) for ratio in causes.values()), default=1.0)


def _code(comparison: Comparison, limit: float) -> str:
    """Return the code of the cause that leaves the smallest error ratio; "camera_off" if no cause explains enough.

    `limit` is the largest error ratio of cameras that agree.
    """
    likeliest = min(
        (ratio, code) for code, ratio in {**_causes(comparison), "camera_off": np.inf}.items() if not np.isnan(ratio)
    )
    return likeliest[1] if _is_explained(likeliest[0], comparison["level"], limit) else "camera_off"


def _with_exchanged(views: Sequence[View], a: int, b: int) -> list[View]:
    exchanged = dict(enumerate(views)) | {a: views[b], b: views[a]}
    return [
        replace(view, xy_px=exchanged[v].xy_px, confidence=exchanged[v].confidence).mask_outside_image()
        for v, view in enumerate(views)
    ]


def _agreeing_group(sights: Sequence[Sight], fps: float, limit: float, points_of: PointsOf) -> tuple[int, ...]:
    """Return the cameras that agree after the others were removed one by one, or () if no two agree.

    The last two of three cameras can only be compared with each other, and two cameras that stand side by side may
    agree in spite of a time offset. The first camera to be removed is therefore one that a rotation or an offset would
    bring into agreement with both others.

    `limit` is the largest error ratio of cameras that agree.
    """
    agreeing = tuple(range(len(sights)))
    while not _are_within(error_ratios(sights, agreeing, points_of), limit):
        if len(agreeing) == 2:
            return ()
        rests = combinations(agreeing, len(agreeing) - 1)
        agreeing = min(rests, key=lambda rest: _cost_of_removal(sights, agreeing, rest, fps, limit, points_of))
    return agreeing


class _RemovalCost(NamedTuple):
    """Cost of removing a camera from a group. The camera with the lowest cost is removed first."""

    is_unexplained: bool
    """Whether neither a rotation nor a time offset makes the camera agree."""
    ratio_sum: float
    """Sum of the error ratios that remain after the camera is removed, or after its best correction."""


def _cost_of_removal(
    sights: Sequence[Sight],
    agreeing: Sequence[int],
    rest: Sequence[int],
    fps: float,
    limit: float,
    points_of: PointsOf,
) -> _RemovalCost:
    """Return the cost of removing a camera from the group `agreeing`, which leaves the cameras `rest`.

    A rotation and a time offset of the camera are tried only if the group has three cameras.
    """
    (v,) = {*agreeing} - {*rest}
    if len(rest) > 2:
        return _RemovalCost(is_unexplained=False, ratio_sum=float(np.nansum(error_ratios(sights, rest, points_of))))
    points = points_of(tuple(sights[o] for o in rest))
    turned, _ = best_turned(sights[v], points)
    shifted, _ = best_shifted(sights[v], points, fps, wide=True)
    ratios = [error_ratios([*sights[:v], sight, *sights[v + 1 :]], agreeing, points_of) for sight in (turned, shifted)]
    best = min(ratios, key=np.nansum)
    return _RemovalCost(is_unexplained=not _are_within(best, limit), ratio_sum=float(np.nansum(best)))


def _compare(sight: Sight, partners: Sequence[Sight], fps: float, points_of: PointsOf, wide: bool) -> Comparison:
    """Return the comparison of a camera with others; `wide` selects the wider range of time offsets."""
    corrected = dict.fromkeys(("turn_rad", "level_turned", "late_frames", "level_late"), np.nan)
    if len(partners) == 1:
        ratio, error_rad, n = error_ratio_of_pair(sight, partners[0])
        return {"points": n, "error_px": error_rad * sight.focal_px, "level": ratio} | corrected
    points = points_of(tuple(partners))
    towards, squared = squared_errors(sight, points)
    off_rad = np.linalg.norm(towards - sight.rays, axis=-1)
    known = np.isfinite(squared)
    error_px = float(np.median(off_rad[known])) * sight.focal_px if known.sum() >= MIN_POINTS else np.nan
    turned, corrected["turn_rad"] = best_turned(sight, points)
    shifted, corrected["late_frames"] = best_shifted(sight, points, fps, wide)
    corrected |= {"level_turned": error_ratio(turned, points), "level_late": error_ratio(shifted, points)}
    return {"points": int(known.sum()), "error_px": error_px, "level": error_ratio(sight, points)} | corrected
