"""Test whether the cameras of a clip agree: compare each camera's detections with points from the other cameras.

**Points and levels.** If cameras see the same keypoint in the same frame, their rays should meet. For each camera, the
points are triangulated from all other cameras, robustly and with their covariance (`_points`), and compared with the
directions in which this camera saw them (`_errors`). An error in standard deviations accounts for the noise of both.
The median error, divided by the median that pure noise has, is the camera's level: about 1 if the cameras agree. Two
cameras alone have no third camera to triangulate with, so they are compared with each other by the epipolar planes of
their rays (`_pair_level`).

The test uses no body and no fit, so it also detects a camera that pulls the fit away from the others.

**Which camera is off.** If levels are too high, cameras are left out one by one until the rest agrees
(`_largest_agreeing_group`). For each camera left out, the best rotation and the best time offset are determined
(`_best_turned`, `_best_shifted`). If the rotation or the offset lowers the level enough, it is named as the cause;
otherwise the cause is unknown. Exchanged files of two cameras are tried first, since they explain two cameras at once
(`_exchanged_pair`). If no two of the cameras agree, one error names all of them.

**Time offsets and refined poses.** The same levels are used to search for offsets between cameras whose clocks differ
(`search_offsets`), before the fit solves for them (`solve_time_offsets`). After a fit that refined poses,
`why_not_refined` decides whether the refined poses are used.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from recon.animal.body import MIN_JOINTS
from recon.base.arrays import Array, Index
from recon.base.errors import InputError, Problem, raise_problems
from recon.check.codes import EFFECTS, by_effect, finding
from recon.clip import Source, View, align_cameras, densest_window, views_of
from recon.fit import constants
from recon.fit.motion import Motion
from recon.fit.result import Finding, TrajectorySolution

MAX_LEVEL = 1.6
"""Largest level at which a camera agrees; larger if the other cameras are noisier than expected."""
MAX_NOISE_FACTOR = 2.0
"""Largest factor on the expected errors that is attributed to noise of the detector."""
MAX_NOISE_FACTOR_OF_TWO = 1.1
"""Largest factor for two cameras, without a third camera to show that the errors are noise.

Levels of 68 real pairs are up to 1.5. A rotation of one of two cameras is visible only across the line between them.
"""
EXPLAINED = 0.25
"""Fraction of a camera's level; a cause that reduces the level to this fraction or less explains it."""
CLEAR_ROTATION_RAD = np.radians(3.0)
"""Rotation from which a camera that agrees is still reported, if its level improves by `CLEAR_GAIN`."""
CLEAR_OFFSET = 3.0
"""Time offset, in frames, from which a camera that agrees is still reported, if its level improves by `CLEAR_GAIN`."""
CLEAR_GAIN = 1.5
"""Smallest factor by which a rotation or time offset reduces the level of a camera that agrees, to be reported."""
LARGEST_ROTATION_RAD = np.radians(45.0)
"""Largest best-fitting rotation that is attributed to the camera."""
MIN_POINTS = 30
"""Smallest number of points, over all frames, from which a level is computed."""
WIDE_OFFSET_S = 0.5
"""Largest time offset, in seconds, that is tried for a camera that does not agree."""
NARROW_OFFSET = 3
"""Largest time offset, in frames, that is tried for a camera that agrees."""
FRAMES = 480
"""Largest number of frames that are compared: those of a longer clip with the most detections in common."""
OFFSET_S = 1.0
"""Largest time offset, in seconds, in the search for a camera that is out of step; at most half the clip."""
MAX_OFFSET_RATIO = 0.9
"""Largest ratio of the level with a time offset to the level without it at which the offset counts."""
_OFFSET_ROWS = 200
"""Number of frames that are compared for an offset."""
_COMPARED = 0.3
"""Smallest fraction of the comparable points that must remain for a time offset."""
_ROBUST = 3.0
"""Number of standard deviations at which the robust weight of a residual is 0.5."""
_POINT_ROUNDS = 3
"""Number of rounds of reweighting, in which outliers lose their weight in a point."""
_OFFSET_ROUNDS = 3
"""Largest number of rounds over the cameras in the search for time offsets."""
_MEDIAN_OF_LINE = 0.4549
"""Median of the squared length of a normal error in one dimension, in units of its variance."""
_MEDIAN_OF_POINT = 1.3863
"""Median of the squared length of a normal error in two dimensions, in units of its variance along an axis."""
_KEPT_POINTS = 16
"""Number of groups of cameras whose points are kept for further comparisons."""
_PARALLEL = 1e-4
"""Smallest ratio of the precision of a point along its rays to that across them."""


Comparison = dict[str, float]
"""Comparison of one camera with the cameras that agree with each other; NaN if it cannot be determined.

- points: number of points compared
- error_px: median distance from the positions at which the others see the points
- level: typical error relative to the expected error
- turn_rad: angle of the best rotation of the camera
- late_frames: delay of its pictures relative to the stated times
- level_turned, level_late: level after that rotation, and after that delay
"""


def agreement_findings(motion: Motion, sigma_px: float, keypoint_sigma_m: float) -> tuple[Finding, ...]:
    """Return the findings on a motion's two or more cameras, compared with each other at their given poses.

    There is a note on each camera, and an error for each camera that is exchanged, turned, late, or off for an unknown
    reason. If no two cameras agree, one error names all cameras. The result is deterministic.

    Parameters
    ----------
    motion
        The motion, with its sources and views.
    sigma_px
        Standard deviation of the detector's noise, pixels.
    keypoint_sigma_m
        Standard deviation of a keypoint's position on the body, m.
    """
    views_and_sources = zip(motion.solution.views, motion.sources, strict=True)
    views = [replace(view, offset_frames=source.offset_frames) for view, source in views_and_sources]
    if len(views) < 2:
        return ()
    seen_together = (np.sum([view.present for view in views], axis=0) > 1).sum(axis=1)
    rows, fps = densest_window(seen_together, FRAMES), motion.fps
    views = [view.part(rows) for view in views]
    frames = (int(motion.frames[rows][0]), int(motion.frames[rows][-1]) + 1)
    names = [view.camera.name for view in views]
    given_sights = _sights(views, sigma_px, keypoint_sigma_m)
    points_of = lru_cache(maxsize=_KEPT_POINTS)(_points)
    sights, exchanged, limit = _without_exchange(views, given_sights, sigma_px, keypoint_sigma_m, points_of)
    agreeing, comparisons = _compare_with_agreeing(sights, fps, limit, points_of)

    findings = []
    for v in (v for v in range(len(views)) if agreeing and v not in agreeing):
        comparison = comparisons[v]
        if comparison["level"] > limit or _gain(comparison) >= CLEAR_GAIN:
            offset_s = motion.sources[v].offset_s + comparison["late_frames"] / fps
            effect = _effect_m(given_sights, v, [o for o in agreeing if o != v])
            numbers = comparison | effect | {"offset_s": offset_s}
            item = finding(_code(comparison, limit), frames, names[v], **numbers)
            findings.append(
                by_effect(item, motion.trunk_m, is_gross=comparison["level"] > MAX_LEVEL * MAX_NOISE_FACTOR)
            )
    for v in exchanged:  # as given, so that the levels show the exchange
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
    views: Sequence[View], sights: list[_Sight], sigma_px: float, keypoint_sigma_m: float, points_of: _PointsOf
) -> tuple[list[_Sight], tuple[int, ...], float]:
    """Return the sights with exchanged cameras corrected, the two exchanged cameras, and the limit for levels.

    Without exchanged cameras, the pair is (). The limit is higher than `MAX_LEVEL` if the cameras that agree best are
    noisier than expected.
    """
    everyone = tuple(range(len(views)))
    levels = _levels(sights, everyone, points_of)
    if _are_within(levels, MAX_LEVEL):
        return sights, (), MAX_LEVEL
    pairs = [pair for pair in combinations(everyone, 2) if not _are_within(levels[[*pair]], MAX_LEVEL)]
    trials = {pair: _sights(_with_exchanged(views, *pair), sigma_px, keypoint_sigma_m) for pair in pairs}
    trial_levels = {pair: _levels(trial, everyone, points_of) for pair, trial in trials.items()}
    rests = [_levels(sights, rest, points_of) for rest in combinations(everyone, len(everyone) - 1) if len(rest) > 1]
    medians = [np.nanmedian(values) for values in (*rests, *trial_levels.values()) if np.isfinite(values).any()]
    max_factor = MAX_NOISE_FACTOR if len(views) > 2 else MAX_NOISE_FACTOR_OF_TWO
    limit = MAX_LEVEL * float(np.clip(min(medians, default=np.inf), 1.0, max_factor))
    exchanged = _exchanged_pair(levels, trial_levels, limit)
    return (sights, (), limit) if exchanged is None else (trials[exchanged], exchanged, limit)


def swaps_by_effect(
    findings: Sequence[Finding], motion: Motion, sigma_px: float, keypoint_sigma_m: float
) -> tuple[Finding, ...]:
    """Return findings in which the severity of swaps follows from their effect, for three or more cameras.

    A swap in one camera has little effect if the others agree, because the robust fit follows them. Parameters are as
    in `agreement_findings`.
    """
    names = [view.camera.name for view in motion.solution.views]
    if len(names) < 3 or not any(item.code.startswith("left_right_swap") for item in findings):
        return tuple(findings)
    weighed = []
    for item in findings:
        if item.code in ("left_right_swap", "left_right_swap_possible") and item.frames and item.camera:
            rows = slice(*np.searchsorted(motion.frames, item.frames))
            views = [view.part(rows) for view in motion.solution.views]
            v, sights = names.index(item.camera), _sights(views, sigma_px, keypoint_sigma_m)
            effect = _effect_m(sights, v, [o for o in range(len(names)) if o != v])
            item = by_effect(replace(item, numbers=item.numbers | effect), motion.trunk_m)
        weighed.append(item)
    return tuple(weighed)


def _effect_m(sights: Sequence[_Sight], v: int, partners: Sequence[int]) -> dict[str, float]:
    """Return how far camera v moves the points that the other cameras see, in metres.

    The first number is the movement about the middle of the points, the second the movement of this middle. Both are
    means over joints and frames, and NaN if the other cameras alone see too few points.
    """
    effects = dict.fromkeys(EFFECTS, np.nan)
    if len(partners) < 2:
        return effects
    without_m, _ = _points([sights[o] for o in partners])
    with_m, _ = _points([sights[o] for o in sorted({*partners, v})])
    shift_m = with_m - without_m
    is_known = np.isfinite(shift_m[..., 0])
    is_enough = is_known.sum(axis=1) >= MIN_JOINTS
    if is_known[is_enough].sum() < MIN_POINTS:
        return effects
    shift_m = shift_m[is_enough]
    middle_m = np.nanmean(shift_m, axis=1, keepdims=True)
    pose_m = float(np.nanmean(np.linalg.norm(shift_m - middle_m, axis=-1)))
    return dict(zip(EFFECTS, (pose_m, float(np.linalg.norm(middle_m, axis=-1).mean())), strict=True))


def _compare_with_agreeing(
    sights: Sequence[_Sight], fps: float, limit: float, points_of: _PointsOf
) -> tuple[tuple[int, ...], list[Comparison]]:
    """Return the cameras that agree, and the comparison of each camera with them, or with all if none agree.

    A camera can be turned by some degrees about its line of sight while its level is still low. Agreeing cameras that a
    rotation or a time offset clearly improves are therefore removed as well.
    """
    agreeing = _largest_agreeing_group(sights, fps, limit, points_of)
    comparisons = _compare_each(sights, agreeing or range(len(sights)), fps, points_of)
    while len(agreeing) > 2:
        worst = max(agreeing, key=lambda v: _gain(comparisons[v]))
        if _gain(comparisons[worst]) < CLEAR_GAIN:
            break
        agreeing = tuple(v for v in agreeing if v != worst)
        comparisons = _compare_each(sights, agreeing, fps, points_of)
    return agreeing, comparisons


# Agreeing cameras


def _are_within(levels: Array, limit: float) -> bool:
    """Return whether all known levels are at most the limit; unknown levels are NaN."""
    return not (levels > limit).any()


def _is_explained(level: float, previous: float, limit: float) -> bool:
    return level <= max(limit, EXPLAINED * previous)


def _exchanged_pair(levels: Array, trials: Mapping[tuple[int, int], Array], limit: float) -> tuple[int, int] | None:
    """Return the two cameras whose levels are explained by exchanged files."""
    explained = {
        pair: np.nansum(after_exchange)
        for pair, after_exchange in trials.items()
        if np.nansum(after_exchange) < np.nansum(levels) / 2
        and all(_is_explained(after_exchange[v], levels[v], limit) for v in pair)
        and (len(levels) > 2 or _are_within(after_exchange, limit))
    }
    return min(explained, key=lambda pair: explained[pair], default=None)


def _compare_each(
    sights: Sequence[_Sight], agreeing: Sequence[int], fps: float, points_of: _PointsOf
) -> list[Comparison]:
    """Compare each camera with all others that agree."""
    return [
        _compare(sight, [sights[o] for o in agreeing if o != v], fps, points_of, wide=v not in agreeing)
        for v, sight in enumerate(sights)
    ]


def _causes(comparison: Comparison, least_rad: float = 0.0, least_frames: float = 0.0) -> dict[str, float]:
    """Return the camera's level after each possible cause is undone, by the cause's code.

    A rotation or delay below `least_rad` or `least_frames` is not a possible cause.
    """
    is_turned = least_rad <= comparison["turn_rad"] <= LARGEST_ROTATION_RAD
    is_late = abs(comparison["late_frames"]) >= least_frames
    levels = {"camera_late": comparison["level_late"]} if is_late else {}
    return levels | ({"camera_turned": comparison["level_turned"]} if is_turned else {})


def _gain(comparison: Comparison) -> float:
    """Return the factor by which the best rotation or time offset lowers a camera's level; 1 if both are small."""
    causes = _causes(comparison, CLEAR_ROTATION_RAD, CLEAR_OFFSET)
    return max((comparison["level"] / max(level, 1e-9) for level in causes.values()), default=1.0)


def _code(comparison: Comparison, limit: float) -> str:
    """Return the code of a camera's finding: the cause that leaves the lowest level, if it explains the level."""
    likeliest = min(
        (level, code) for code, level in {**_causes(comparison), "camera_off": np.inf}.items() if not np.isnan(level)
    )
    return likeliest[1] if _is_explained(likeliest[0], comparison["level"], limit) else "camera_off"


def _with_exchanged(views: Sequence[View], a: int, b: int) -> list[View]:
    exchanged = dict(enumerate(views)) | {a: views[b], b: views[a]}
    return [
        replace(view, xy_px=exchanged[v].xy_px, confidence=exchanged[v].confidence).mask_outside_image()
        for v, view in enumerate(views)
    ]


def _largest_agreeing_group(
    sights: Sequence[_Sight], fps: float, limit: float, points_of: _PointsOf
) -> tuple[int, ...]:
    """Return the cameras left after removing the least agreeing cameras one by one, or () if no two agree.

    The last two of three cameras can only be compared with each other, and a camera next to another one may pass in
    spite of its time offset. The first camera to be removed is therefore one that a rotation or an offset would bring
    into agreement with both.
    """
    agreeing = tuple(range(len(sights)))
    while not _are_within(_levels(sights, agreeing, points_of), limit):
        if len(agreeing) == 2:
            return ()
        rests = combinations(agreeing, len(agreeing) - 1)
        agreeing = min(rests, key=lambda rest: _cost_of_removal(sights, agreeing, rest, fps, limit, points_of))
    return agreeing


class _RemovalCost(NamedTuple):
    """Cost of removing a camera from those that agree; the camera with the lowest cost is removed first."""

    is_unexplained: bool
    """Whether neither a rotation nor a time offset makes the camera agree."""
    level_sum: float
    """Sum of the levels of the cameras after the removal or the correction."""


def _cost_of_removal(
    sights: Sequence[_Sight],
    agreeing: Sequence[int],
    rest: Sequence[int],
    fps: float,
    limit: float,
    points_of: _PointsOf,
) -> _RemovalCost:
    """Return the cost of removing the camera that is missing from the rest.

    A rotation and a time offset are tried only if there are three cameras.
    """
    (v,) = {*agreeing} - {*rest}
    if len(rest) > 2:
        return _RemovalCost(is_unexplained=False, level_sum=float(np.nansum(_levels(sights, rest, points_of))))
    points = points_of(tuple(sights[o] for o in rest))
    turned, _ = _best_turned(sights[v], points)
    shifted, _ = _best_shifted(sights[v], points, fps, wide=True)
    levels = [_levels([*sights[:v], sight, *sights[v + 1 :]], agreeing, points_of) for sight in (turned, shifted)]
    best = min(levels, key=np.nansum)
    return _RemovalCost(is_unexplained=not _are_within(best, limit), level_sum=float(np.nansum(best)))


# Rays and points


@dataclass(frozen=True, eq=False)
class _Sight:
    """Directions in which one camera saw J keypoints in T frames, as unit vectors in the world frame."""

    rays: Array
    """Directions, shape (T, J, 3); NaN if missing."""
    centre_m: Array
    """Centre of the camera, shape (T, 3)."""
    rotation: Array
    """Rotation R_camera_world, shape (T, 3, 3)."""
    focal_px: float
    noise_rad: Array
    """Noise of a detection as an angle, shape (T, 1)."""

    def later(self, frames: float) -> _Sight:
        """Return the directions for pictures that were taken some frames later."""
        rays, centre_m = _shifted(self.rays, frames), _shifted(self.centre_m, frames)
        return replace(self, rays=rays, centre_m=centre_m, rotation=_shifted(self.rotation, round(frames)))

    def part(self, rows: Index) -> _Sight:
        """Return the directions of some rows."""
        parts = (self.rays[rows], self.centre_m[rows], self.rotation[rows], self.focal_px, self.noise_rad[rows])
        return _Sight(*parts)


_Points = tuple[Array, Array]
"""Positions (T, J, 3) and their covariances (T, J, 3, 3); NaN if fewer than two rays meet."""
_PointsOf = Callable[[tuple[_Sight, ...]], _Points]
"""Form of `_points` that keeps its last results, because several comparisons need the points of the same cameras."""


def _shifted(values: Array, frames: float) -> Array:
    """Return values (T, ...) shifted by a number of rows, with linear interpolation, and NaN beyond the ends."""
    whole, T = int(np.floor(frames)), len(values)
    rows = np.arange(T) - np.array([[whole], [whole + 1]])
    inside = ((rows >= 0) & (rows < T)).reshape(2, T, *[1] * (values.ndim - 1))
    first, second = np.where(inside, values[rows.clip(0, T - 1)], np.nan)
    share = frames - whole
    return (1 - share) * first + share * second if share else first


def _sights(views: Sequence[View], sigma_px: float, keypoint_sigma_m: float) -> list[_Sight]:
    T = len(views[0].xy_px)
    sights = []
    for view in views:
        focal_px = float(np.mean(view.focal_px))
        rotation = np.broadcast_to(view.T_camera_world[..., :3, :3], (T, 3, 3))
        sight = _Sight(view.rays(), view.centre_m, rotation, focal_px, np.full((T, 1), sigma_px / focal_px))
        sights.append(sight.later(view.offset_frames))
    position_m, _ = _points(sights)
    return [_with_keypoint_noise(sight, position_m, keypoint_sigma_m) for sight in sights]


def triangulated_m(views: Sequence[View], sigma_px: float, keypoint_sigma_m: float) -> Array:
    """Return the points (T, J, 3) at which the rays of several views meet; NaN if fewer than two rays do."""
    return _points(_sights(views, sigma_px, keypoint_sigma_m))[0]


def _with_keypoint_noise(sight: _Sight, position_m: Array, keypoint_sigma_m: float) -> _Sight:
    """Return the directions with added noise of the keypoints' positions on the body, at a typical distance."""
    distance = np.linalg.norm(position_m - sight.centre_m[:, None], axis=-1)
    if np.isnan(distance).all():
        return sight
    with warnings.catch_warnings(action="ignore"):  # some frames have no points
        typical = np.nanmedian(distance, axis=1)
    typical = np.where(np.isnan(typical), np.nanmedian(distance), typical)
    return replace(sight, noise_rad=np.hypot(sight.noise_rad, keypoint_sigma_m / typical[:, None]))


def _points(sights: Sequence[_Sight]) -> _Points:
    """Return the points nearest to the rays of two or more cameras, with outliers down-weighted."""
    rays = np.array([sight.rays for sight in sights])
    centres = np.array([sight.centre_m for sight in sights])[:, :, None]
    noise = np.array([sight.noise_rad for sight in sights])
    seen = np.isfinite(rays[..., 0])
    rays, centres = np.where(seen[..., None], rays, 0.0), np.where(np.isfinite(centres), centres, 0.0)
    across_rays = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    weight, distance, enough_rays = seen.astype(float), np.ones(seen.shape), seen.sum(axis=0) > 1
    position, information = np.zeros((*enough_rays.shape, 3)), np.zeros((*enough_rays.shape, 3, 3))
    for _ in range(_POINT_ROUNDS):
        ray_information = (weight / (noise * distance) ** 2)[..., None, None] * across_rays
        information = ray_information.sum(axis=0)
        spread = np.linalg.eigvalsh(information)
        enough_rays &= spread[..., 0] > _PARALLEL * spread[..., 2]
        information[~enough_rays] = np.eye(3)
        position = np.linalg.solve(information, (ray_information @ centres[..., None]).sum(axis=0))[..., 0]
        distance = np.maximum(np.linalg.norm(position - centres, axis=-1), 1e-3)
        error = np.linalg.norm((position - centres) / distance[..., None] - rays, axis=-1)
        weight = seen / (1.0 + (error / noise / _ROBUST) ** 2)
    position[~enough_rays] = np.nan
    covariance = np.asarray(np.linalg.inv(information), dtype=float)
    covariance[~enough_rays] = np.nan
    return position, covariance


# One camera compared with others


def drift_by_rays(views: Sequence[View], markers_m: Array, v: int) -> tuple[float, float]:
    """Estimate the drift of a camera's clock from rays alone: frames over the clip, and its standard deviation.

    The drift that best moves the camera's rays into the epipolar planes of the other cameras' rays is estimated
    together with a time offset and a constant angle. The animal's lengths, which are wrong in a rough skeleton, are not
    used. The values are NaN for fewer than `MIN_POINTS` points.

    Parameters
    ----------
    views
        Views of the same T frames.
    markers_m : (T, J, 3)
        Markers of a fit in the world frame, metres. Only the velocities of their projections are used.
    v
        Index of the camera.
    """
    sights = _sights(views, sigma_px=1.0, keypoint_sigma_m=0.0)  # the spread of the errors replaces this noise
    sight, T = sights[v], len(markers_m)
    towards = markers_m - sight.centre_m[:, None]
    speed = np.gradient(towards / np.linalg.norm(towards, axis=-1, keepdims=True), axis=0)
    time = ((np.arange(T) - 0.5 * (T - 1)) / T)[:, None]
    columns, errors = [], []
    for partner in sights[:v] + sights[v + 1 :]:
        normal = np.cross((sight.centre_m - partner.centre_m)[:, None], partner.rays)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        error, by_frame = (np.sum(vectors * normal, axis=-1) for vectors in (sight.rays, speed))
        is_known = np.isfinite(error) & np.isfinite(by_frame)
        derivatives = (by_frame * time, by_frame, np.ones_like(by_frame))
        columns.append(np.stack(derivatives, axis=-1)[is_known])
        errors.append(error[is_known])
    A, error = np.concatenate(columns), np.concatenate(errors)
    if len(error) < MIN_POINTS:
        return np.nan, np.nan
    weight, scale = np.ones(len(error)), 1.0
    estimate = covariance = np.full((3, 3), np.nan)
    for _ in range(_POINT_ROUNDS):
        covariance = np.linalg.pinv((A * weight[:, None]).T @ A)
        estimate = covariance @ (A * weight[:, None]).T @ error
        rest = error - A @ estimate
        scale = max(float(np.median(np.abs(rest))) / np.sqrt(_MEDIAN_OF_LINE), 1e-12)
        weight = 1.0 / (1.0 + (rest / scale / _ROBUST) ** 2)
    return float(estimate[0]), float(scale * np.sqrt(covariance[0, 0]))


def _levels(sights: Sequence[_Sight], agreeing: Sequence[int], points_of: _PointsOf) -> Array:
    """Return the level of each agreeing camera compared with the other agreeing ones, (V,); NaN for the rest."""
    levels = np.full(len(sights), np.nan)
    for v in agreeing:
        partners = tuple(sights[o] for o in agreeing if o != v)
        levels[v] = (
            _pair_level(sights[v], *partners)[0] if len(agreeing) == 2 else _level(sights[v], points_of(partners))
        )
    return levels


def _compare(sight: _Sight, partners: Sequence[_Sight], fps: float, points_of: _PointsOf, wide: bool) -> Comparison:
    """Compare a camera with others; with `wide`, search a long range of time offsets."""
    corrected = dict.fromkeys(("turn_rad", "level_turned", "late_frames", "level_late"), np.nan)
    if len(partners) == 1:
        level, error_rad, n = _pair_level(sight, partners[0])
        return {"points": n, "error_px": error_rad * sight.focal_px, "level": level} | corrected
    points = points_of(tuple(partners))
    towards, squared = _errors(sight, points)
    off_rad = np.linalg.norm(towards - sight.rays, axis=-1)
    known = np.isfinite(squared)
    error_px = float(np.median(off_rad[known])) * sight.focal_px if known.sum() >= MIN_POINTS else np.nan
    turned, corrected["turn_rad"] = _best_turned(sight, points)
    shifted, corrected["late_frames"] = _best_shifted(sight, points, fps, wide)
    corrected |= {"level_turned": _level(turned, points), "level_late": _level(shifted, points)}
    return {"points": int(known.sum()), "error_px": error_px, "level": _level(sight, points)} | corrected


def _pair_level(a: _Sight, b: _Sight) -> tuple[float, float, int]:
    """Return the level of two cameras, the median angle between a's rays and b's planes, and the number of points.

    Each plane contains both centres and one of b's rays.
    """
    line = b.centre_m - a.centre_m
    plane_of_b, plane_of_a = np.cross(b.rays, line[:, None]), np.cross(line[:, None], a.rays)
    size_a, size_b = np.linalg.norm(plane_of_b, axis=-1), np.linalg.norm(plane_of_a, axis=-1)
    off_plane = np.abs(np.sum(a.rays * plane_of_b, axis=-1))
    is_known = np.isfinite(off_plane) & (size_a > 0) & (size_b > 0)
    if is_known.sum() < MIN_POINTS:
        return np.nan, np.nan, int(is_known.sum())
    sigma = np.hypot(size_a * a.noise_rad, size_b * b.noise_rad)[is_known]
    level = np.sqrt(np.median((off_plane[is_known] / sigma) ** 2) / _MEDIAN_OF_LINE)
    return float(level), float(np.median(off_plane[is_known] / size_a[is_known])), int(is_known.sum())


def _errors(sight: _Sight, points: _Points) -> tuple[Array, Array]:
    """Return unit vectors (T, J, 3) towards the points, and squared errors of the rays in sigmas (T, J)."""
    position_m, covariance_m2 = points
    offset_m = position_m - sight.centre_m[:, None]
    distance = np.linalg.norm(offset_m, axis=-1, keepdims=True)
    towards = offset_m / distance
    x, y = _across(sight.rays)
    error = np.stack([np.sum((towards - sight.rays) * axis, axis=-1) for axis in (x, y)], axis=-1)
    basis = np.stack([x, y], axis=-2) / distance[..., None]
    covariance = basis @ covariance_m2 @ basis.swapaxes(-1, -2)
    a, b, c = (covariance[..., i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
    a, c = a + sight.noise_rad**2, c + sight.noise_rad**2
    squared = (c * error[..., 0] ** 2 - 2 * b * error[..., 0] * error[..., 1] + a * error[..., 1] ** 2) / (a * c - b**2)
    is_ahead, squared_behind = np.sum(offset_m * sight.rays, axis=-1) > 0, np.where(np.isnan(squared), np.nan, np.inf)
    return towards, np.where(is_ahead, squared, squared_behind)


def _across(rays: Array) -> tuple[Array, Array]:
    """Return two unit vectors that are orthogonal to each ray and to each other."""
    helper = np.where(np.abs(rays[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    x = np.cross(helper, rays)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return x, np.asarray(np.cross(rays, x), dtype=float)


def _level(sight: _Sight, points: _Points) -> float:
    _, squared = _errors(sight, points)
    known_squares = squared[~np.isnan(squared)]
    return float(np.sqrt(np.median(known_squares) / _MEDIAN_OF_POINT)) if len(known_squares) >= MIN_POINTS else np.nan


def _best_turned(sight: _Sight, points: _Points) -> tuple[_Sight, float]:
    """Return the directions after the rotation that brings a camera's rays nearest to the points, and its angle."""
    towards, _ = _errors(sight, points)
    goal, rays = (np.einsum("tij,tkj->tki", sight.rotation, v) for v in (towards, sight.rays))
    is_known = np.isfinite(goal[..., 0]) & np.isfinite(rays[..., 0])
    if is_known.sum() < MIN_POINTS:
        return sight, np.nan
    noise = np.broadcast_to(sight.noise_rad, is_known.shape)[is_known]
    rotation = Rotation.identity()
    for _ in range(10):
        error = np.linalg.norm(goal[is_known] - rotation.apply(rays[is_known]), axis=-1)
        scale = max(float(np.median(error / noise)), 1.0)
        weight = noise**-2 / (1.0 + (error / noise / scale / _ROBUST) ** 2)
        rotation, _ = Rotation.align_vectors(goal[is_known], rays[is_known], weight)
    in_world = sight.rotation.swapaxes(-1, -2) @ rotation.as_matrix() @ sight.rotation
    return replace(sight, rays=np.einsum("tij,tkj->tki", in_world, sight.rays)), float(rotation.magnitude())


def _best_shifted(sight: _Sight, points: _Points, fps: float, wide: bool) -> tuple[_Sight, float]:
    """Return the directions with the time offset that fits best, and the offset in frames."""
    reach = min(max(round(WIDE_OFFSET_S * fps), NARROW_OFFSET) if wide else NARROW_OFFSET, len(sight.rays) // 2)
    levels = {float(frames): _level(sight.later(frames), points) for frames in range(-reach, reach + 1)}
    if not np.isfinite([*levels.values()]).any():
        return sight, np.nan
    best = min(levels, key=lambda frames: (np.nan_to_num(levels[frames], nan=np.inf), abs(frames)))
    if not wide and abs(best) == reach:
        return _best_shifted(sight, points, fps, wide=True)
    for frames in (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75):
        levels[best + frames] = _level(sight.later(best + frames), points)
    best = min(levels, key=lambda frames: (np.nan_to_num(levels[frames], nan=np.inf), abs(frames)))
    return sight.later(best), best


# Cameras out of step


def search_offsets(views: Sequence[View], fps: float, sigma_px: float, keypoint_sigma_m: float) -> Array:
    """Return the time offset of each camera from the first, in whole frames beyond the stated offset, (V,).

    Views have the same T frames; the noise is as in `agreement_findings`. Each camera in turn gets the offset at which
    its rays pass closest to those of the cameras before it. A few rounds with the rays of all other cameras follow. The
    offset is 0 if no other value is clearly better, and NaN if a camera shares too few points with the others.
    """
    sights = _sights(views, sigma_px, keypoint_sigma_m)
    T = len(views[0].xy_px)
    rows = np.arange(0, T, max(1, T // _OFFSET_ROWS))
    reach = max(min(round(OFFSET_S * fps), T // 2), 1)
    offsets = np.full(len(views), np.nan)
    offsets[0] = 0.0
    for round_number in range(_OFFSET_ROUNDS):
        previous = offsets.copy()
        for v in range(1, len(views)):
            partners = [o for o in range(len(views)) if o != v and np.isfinite(offsets[o])]
            offsets[v] = _best_offset(sights[v], [sights[o].later(offsets[o]) for o in partners], reach, rows)
        if round_number and np.array_equal(previous, offsets, equal_nan=True):
            break
    return offsets


def _best_offset(sight: _Sight, partner_sights: Sequence[_Sight], reach: int, rows: Index) -> float:
    offsets = np.arange(-reach, reach + 1)
    partners = [partner.part(rows) for partner in partner_sights]
    shifted_sights = [sight.later(by).part(rows) for by in offsets.tolist()]
    pairs = np.array([[_pair_level(shifted, partner) for partner in partners] for shifted in shifted_sights])
    levels, points = pairs[..., 0], pairs[..., 2]
    compared = np.isfinite(levels) & (points >= _COMPARED * points.max(axis=0))
    if not compared.any():
        return np.nan
    sums, number = np.where(compared, levels, 0.0).sum(axis=1), compared.sum(axis=1)
    mean = np.where(number > 0, sums / np.maximum(number, 1), np.inf)
    best = int(np.argmin(mean))
    return 0.0 if mean[best] > MAX_OFFSET_RATIO * mean[reach] else float(offsets[best])


# Camera parameters that are estimated in the fit

FIT_ROUNDS = 5
"""Largest number of solutions in the search for time offsets."""
CLOSE_FRAMES = 0.05
"""Largest time offset, in frames, that is left to the solver, which treats the motion as straight over this time."""
UNCHANGED_FACTOR = 1.1
"""Growth of a camera's median reprojection error up to which refined poses count as no worse for it.

The errors of some cameras may grow a little if those of another camera decrease.
"""
BETTER_FACTOR = 1.02
"""Ratio of a camera's error before the refinement to the error after it, above which the camera has improved."""
OUTLIER_FACTOR = 5.0
"""Ratio of a camera's error to the median over the cameras, above which the camera is an outlier as a whole."""
MAX_ROTATION_FACTOR = 4.0
"""Ratio of a rotation to the expected one, above which a camera has left the pose in the file."""
MAX_SIGMA_FRAMES = 1.0
"""Largest uncertainty of an estimated offset in frames.

A less certain offset is refused, as is an offset that would still change by more.
"""

SolveSources = Callable[[tuple[Source, ...]], TrajectorySolution]


def solve_time_offsets(
    sources_apart: Sequence[Source],
    later_frames: Sequence[float],
    solve: SolveSources,
    sigma_px: float,
    keypoint_sigma_m: float,
) -> tuple[tuple[Source, ...], TrajectorySolution]:
    """Estimate the time offsets of sources; return the sources on the frames of one clip, and their solution.

    Parameters
    ----------
    sources_apart
        Sources on their own frames.
    later_frames
        Offset of each camera, in frames, at which the search begins, (V,).
    solve
        Function that solves sources with the option `find_offsets`.
    sigma_px, keypoint_sigma_m
        Noise, as in `agreement_findings`.

    Raises
    ------
    InputError
        If the motion does not determine the offsets.
    """
    offsets, fps = np.array(later_frames), sources_apart[0].keypoints.fps
    assert fps is not None
    first_views = views_of(align_cameras(sources_apart, later_frames))
    search_result = search_offsets(first_views, fps, sigma_px, keypoint_sigma_m)
    names = [source.camera.name for source in sources_apart]
    unmatched = [name for name, frames in zip(names, search_result, strict=True) if np.isnan(frames)]
    if unmatched:
        expected = "30 or more points that this camera and another see together"
        raise InputError(
            Problem("--set find-offsets", f"camera {name}", "too few points in common", expected) for name in unmatched
        )
    offsets = offsets + search_result
    sources = align_cameras(sources_apart, offsets.tolist())
    solution = solve(sources)
    for _ in range(1, FIT_ROUNDS):
        if np.abs(solution.time_offset_frames).max() < CLOSE_FRAMES:
            break
        offsets = offsets + solution.time_offset_frames
        sources = align_cameras(sources_apart, offsets.tolist())
        solution = solve(sources)
    raise_problems(_problems(names, offsets, solution.time_offset_frames, solution.time_offset_sigma_frames))
    return sources, solution


def _problems(names: Sequence[str], offsets: Array, rest_frames: Array, sigmas: Array) -> Iterator[Problem]:
    for name, frames, lag, sigma in zip(names, offsets, rest_frames, sigmas, strict=True):
        if sigma > MAX_SIGMA_FRAMES or abs(lag) > MAX_SIGMA_FRAMES:
            lag_text = f"{frames + lag:.1f} ± {max(sigma, abs(lag)):.1f} frames later, hardly determined by the motion"
            expected = f"a clip that determines it to {MAX_SIGMA_FRAMES:g} frame, or a measured offset (--set offset-s)"
            yield Problem("--set find-offsets", f"camera {name}", lag_text, expected)


def why_not_refined(
    refined: TrajectorySolution,
    fixed: TrajectorySolution,
    better_below_rad: float = np.inf,
    *,
    may_fit_worse: bool = False,
) -> tuple[Finding, ...]:
    """Return the reasons to keep the calibrated cameras, or nothing if the refined poses are to be used.

    A camera that leaves its pose may become an outlier as a whole, which lowers a robust cost. If no camera fits
    better, the refined poses are only less certain. Rotations above `better_below_rad` are used even then, because a
    wrong size of the animal can hide them. If `may_fit_worse` is true, the fixed cameras may fit better for another
    reason, and then only a camera that becomes an outlier as a whole counts.
    """
    fixed_px, refined_px = _medians_px(fixed), _medians_px(refined)
    names, turns_rad = [v.camera.name for v in fixed.views], np.linalg.norm(refined.extrinsic_correction[:, :3], axis=1)
    growth = OUTLIER_FACTOR if may_fit_worse else UNCHANGED_FACTOR
    lost = (refined_px > growth * fixed_px) | (refined_px > OUTLIER_FACTOR * np.median(refined_px))
    worst_lost, most_turned = int(np.argmax(lost * refined_px / fixed_px)), int(np.argmax(turns_rad))
    if lost[worst_lost]:
        return (
            finding(
                "cameras_not_refined",
                camera=names[worst_lost],
                before_px=fixed_px[worst_lost],
                after_px=refined_px[worst_lost],
            ),
        )
    if turns_rad[most_turned] > MAX_ROTATION_FACTOR * constants.CAMERA_ROTATION_RAD:
        return (
            finding(
                "camera_left_its_pose", camera=names[most_turned], turn_deg=float(np.degrees(turns_rad[most_turned]))
            ),
        )
    if turns_rad[most_turned] <= better_below_rad and not (fixed_px > BETTER_FACTOR * refined_px).any():
        return (finding("cameras_as_calibrated"),)
    return ()


def pair_is_turned(refined: TrajectorySolution) -> bool:
    """Return whether one of two refined cameras is turned by more than twice the usual error of a calibration."""
    return bool(np.linalg.norm(refined.extrinsic_correction[:, :3], axis=1).max() > 2.0 * constants.CALIBRATED_RAD)


def pair_refined(refined: TrajectorySolution, is_misplaced: bool) -> Finding:
    """Return the finding on two cameras whose poses were refined without a request by the user.

    The finding names the camera that was turned more, and is a warning if one of the cameras is more likely turned or
    moved than well calibrated.
    """
    turns_rad, shifts_m = np.linalg.norm(refined.extrinsic_correction.reshape(-1, 2, 3), axis=-1).T
    most_turned = int(np.argmax(turns_rad))
    cameras = tuple(view.camera.name for view in refined.views)
    return finding(
        "pair_refined" if is_misplaced else "pair_adjusted",
        camera=cameras[most_turned],
        cameras=cameras,
        turn_rad=float(turns_rad[most_turned]),
        shift_m=float(shifts_m[most_turned]),
    )


def _medians_px(solution: TrajectorySolution) -> np.ndarray:
    """Return the median distance between detections and reprojected markers, (V,), pixels.

    The distance is infinite if most detections have no pose, and 1 without detections.
    """
    medians = []
    for view in solution.views:
        pixels, _ = view.project(view.shift_to_exposure(solution.markers_m))
        distances = np.linalg.norm(pixels - view.xy_px, axis=-1)[view.present]
        distances = np.where(np.isfinite(distances), distances, np.inf)
        medians.append(float(np.median(distances)) if distances.size else 1.0)
    return np.maximum(medians, 1e-9)
