"""Whether the cameras of a clip agree: each one's detections against the points that the others see.

Where cameras see the same keypoint in the same frame, their rays should meet. A point is triangulated from all cameras
but one, robustly and with its covariance, and compared with the direction in which that one saw it. The typical error
in units of what is expected is the camera's level, about 1 where all is well. Two cameras alone can only be compared
with each other: whether their rays lie in one plane with the line between them.

No body and no fit is needed, so that a camera which pulls the fit away from the others cannot hide. Where levels are
high, the camera is sought without which the others agree, and whether a turn of the camera, a time offset or an
exchange of two files would bring it back.

And what is solved of cameras with the fit: by how many frames they are out of step, sought first where rays of the same
keypoint meet; and whether poses that were refined are taken.

And which way is up where the cameras' poses do not say it: from the ground that the feet of an animal stand on. No body
is fitted for it either.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from recon.animal.body import Body
from recon.base import Array, Index, InputError, Problem, raise_problems
from recon.check.codes import finding
from recon.clip import Source, View, align_cameras, densest_window, views_of
from recon.fit import Finding, Motion, StanceVelocity, TrajectorySolution, constants

MAX_LEVEL = 1.6
"""A camera agrees up to this level, or more where the others are noisier than expected."""
NOISIEST = 2.0
"""Up to how many times the expected errors are taken for noise of the detector."""
NOISIEST_OF_TWO = 1.1
"""The same of two cameras, which have no third to say that it is noise: up to 1.5 of 68 real pairs' levels, and it is
only across the line between them that a turned camera is seen at all."""
EXPLAINED = 0.25
"""A cause that leaves no more than this part of a camera's level explains it, too."""
CLEAR_ROTATION_RAD, CLEAR_OFFSET, CLEAR_GAIN = np.radians(3.0), 3.0, 1.5
"""Cameras that agree are named, too, where such a turn, or time offset in frames, makes their level so many times
smaller."""
LARGEST_ROTATION_RAD = np.radians(45.0)
"""A rotation that fits better only if it is larger is no turn of the camera."""
MIN_POINTS = 30
"""Fewer points, over all frames, say nothing."""
SOUGHT_OFFSET_S, LITTLE_OFFSET = 0.5, 3
"""How far a time offset is sought: seconds for a camera that does not agree, frames for one that does."""
FRAMES = 480
"""How many frames of a longer clip are compared: the stretch in which most is seen together."""
OFFSET_S = 1.0
"""How far off a camera is sought that is known to be out of step, at most; and not further than half a clip."""
CLEARLY = 0.9
"""An offset counts only if it makes the level so many times as high as none does, or less."""
_OFFSET_ROWS = 200
"""Frames that are compared for it."""
_COMPARED = 0.3
"""A time offset that leaves less than this part of the most points that can be compared says nothing."""
_ROBUST = 3.0
"""Rays of that many sigmas count half in a point."""
_ROUNDS = 3
_MEDIAN_OF_LINE, _MEDIAN_OF_POINT = 0.4549, 1.3863
"""The medians of a squared error in sigmas with one dimension, and with two."""
_PARALLEL = 1e-4
"""Rays that fix a point less well along than across, in variances, than this make none."""


Numbers = dict[str, float]
"""What is said of one camera against those that agree with each other, NaN where it cannot be told: points, how many
were compared; error_px, the median distance from where the others say; level, the typical error in units of the
expected; turn_rad, the angle of the rotation of the camera that fits best; late_frames, how much later than said its
pictures seem to have been taken; and level_turned and level_late, what the level would be with these."""


def agreement_findings(motion: Motion, sigma_px: float, keypoint_sigma_m: float) -> tuple[Finding, ...]:
    """What two or more cameras of a motion, as they were given, say of each other (the time offsets that a fit found do
    not hide others): a note on each camera, and which do not agree with the others and why, as if their files were
    exchanged, turned, late, for a reason unknown, or, where it cannot be said which of them is off, with each other.
    Deterministic.

    sigma_px: noise of the detector; keypoint_sigma_m: how far off a keypoint's place on the body it may lie as well.
    """
    both = zip(motion.solution.views, motion.sources, strict=True)
    views = [replace(view, offset_frames=source.offset_frames) for view, source in both]
    if len(views) < 2:
        return ()
    together = (np.sum([view.present for view in views], axis=0) > 1).sum(axis=1)
    rows, fps = densest_window(together, FRAMES), motion.fps
    views = [view.part(rows) for view in views]
    compared = (int(motion.frames[rows][0]), int(motion.frames[rows][-1]) + 1)
    names, everyone = [view.camera.name for view in views], tuple(range(len(views)))
    noise = (sigma_px, keypoint_sigma_m)
    sights = _sights(views, *noise)
    levels, limit = _levels(sights, everyone), MAX_LEVEL
    exchanged, judged = None, sights
    if not _agree(levels, limit):
        pairs = [pair for pair in combinations(everyone, 2) if not _agree(levels[[*pair]], limit)]
        trials = {pair: _sights(_with_exchanged(views, *pair), *noise) for pair in pairs}
        of_trials = {pair: _levels(trial, everyone) for pair, trial in trials.items()}
        without = [_levels(sights, rest) for rest in combinations(everyone, len(everyone) - 1) if len(rest) > 1]
        noise_levels = [np.nanmedian(of) for of in (*without, *of_trials.values()) if np.isfinite(of).any()]
        limit *= float(np.clip(min(noise_levels, default=np.inf), 1.0, NOISIEST if len(views) > 2 else NOISIEST_OF_TWO))
        exchanged = _exchanged_pair(levels, of_trials, limit)
        judged = trials[exchanged] if exchanged else sights
    among = _agreeing(judged, fps, limit)
    found = _agreements(judged, among or everyone, fps)
    while len(among) > 2 and _gain(found[worst := max(among, key=lambda v: _gain(found[v]))]) >= CLEAR_GAIN:
        # about its line of sight a camera can be turned by some degrees, and its level is still low
        among = tuple(v for v in among if v != worst)
        found = _agreements(judged, among, fps)
    findings = []
    for v in (v for v in everyone if among and v not in among):
        if found[v]["level"] > limit or _gain(found[v]) >= CLEAR_GAIN:
            offset_s = motion.sources[v].offset_s + found[v]["late_frames"] / fps
            findings.append(finding(_code(found[v], limit), compared, names[v], **found[v], offset_s=offset_s))
    for v in exchanged or ():  # as it came
        found[v] = _agreement(sights[v], [judged[o] for o in among or everyone if o != v], fps, wide=False)
    for code, which in (("cameras_exchanged", exchanged), ("cameras_disagree", None if among else everyone)):
        if which:
            findings.append(finding(code, compared, None, cameras=tuple(names[v] for v in which), **found[which[0]]))
    if not any(one["points"] for one in found):
        findings.append(finding("cameras_apart_in_time", compared))
    notes = zip(names, found, strict=True)
    return (*findings, *(finding("camera_agreement", compared, name, max_level=limit, **of) for name, of in notes))


# -- who agrees ----------------------------------------------------------------------------------------------------


def _agree(levels: Array, limit: float) -> bool:
    """Whether no level is a reason to doubt: NaN is none."""
    return not (levels > limit).any()


def _is_explained(level: float, before: float, limit: float) -> bool:
    return level <= max(limit, EXPLAINED * before)


def _exchanged_pair(levels: Array, trials: Mapping[tuple[int, int], Array], limit: float) -> tuple[int, int] | None:
    """The two cameras whose levels exchanged files explain."""
    good = {
        pair: np.nansum(after)
        for pair, after in trials.items()
        if np.nansum(after) < np.nansum(levels) / 2
        and all(_is_explained(after[v], levels[v], limit) for v in pair)
        and (len(levels) > 2 or _agree(after, limit))
    }
    return min(good, key=lambda pair: good[pair], default=None)


def _agreements(sights: Sequence[_Sight], among: Sequence[int], fps: float) -> list[Numbers]:
    """Each camera with those of them that are others."""
    return [
        _agreement(sight, [sights[o] for o in among if o != v], fps, wide=v not in among)
        for v, sight in enumerate(sights)
    ]


def _causes(found: Numbers, least_rad: float = 0.0, least_frames: float = 0.0) -> dict[str, float]:
    """What the camera's level would be, by the code of what may be wrong with it, where that is as large."""
    turned, late = least_rad <= found["turn_rad"] <= LARGEST_ROTATION_RAD, abs(found["late_frames"]) >= least_frames
    levels = {"camera_late": found["level_late"]} if late else {}
    return levels | ({"camera_turned": found["level_turned"]} if turned else {})


def _gain(found: Numbers) -> float:
    """How many times as high a camera's level is as with the rotation or the time offset that fits best; 1 where both
    are small."""
    causes = _causes(found, CLEAR_ROTATION_RAD, CLEAR_OFFSET)
    return max((found["level"] / max(level, 1e-9) for level in causes.values()), default=1.0)


def _code(found: Numbers, limit: float) -> str:
    likeliest = min((level, code) for code, level in {**_causes(found), "camera_off": np.inf}.items() if level == level)
    return likeliest[1] if _is_explained(likeliest[0], found["level"], limit) else "camera_off"


def _with_exchanged(views: Sequence[View], a: int, b: int) -> list[View]:
    there = dict(enumerate(views)) | {a: views[b], b: views[a]}
    return [
        replace(view, xy_px=there[v].xy_px, confidence=there[v].confidence).mask_outside_image()
        for v, view in enumerate(views)
    ]


def _agreeing(sights: Sequence[_Sight], fps: float, limit: float) -> tuple[int, ...]:
    """The cameras that are left when those that agree least have gone one by one; () if no two agree. Of three cameras
    the two that are left can only be compared with each other, which a camera beside another may pass in spite of its
    time offset: so that one goes first which a rotation or an offset makes agree with both."""
    among = tuple(range(len(sights)))
    while not _agree(_levels(sights, among), limit):
        if len(among) == 2:
            return ()
        rests = combinations(among, len(among) - 1)
        among = min(rests, key=lambda rest: _cost_without(sights, among, rest, fps, limit))
    return among


def _cost_without(
    sights: Sequence[_Sight], among: Sequence[int], rest: Sequence[int], fps: float, limit: float
) -> tuple[bool, float]:
    """To be made small: whether nothing brings the camera that is left out back, and how well the rest agrees."""
    (v,) = {*among} - {*rest}
    if len(rest) > 2:
        return False, float(np.nansum(_levels(sights, rest)))
    points = _points([sights[o] for o in rest])
    turned, _ = _best_turned(sights[v], points)
    late, _ = _best_shifted(sights[v], points, fps, wide=True)
    levels = [_levels([*sights[:v], sight, *sights[v + 1 :]], among) for sight in (turned, late)]
    best = min(levels, key=np.nansum)
    return not _agree(best, limit), float(np.nansum(best))


# -- rays and points -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Sight:
    """The directions in which one camera saw J keypoints in T frames, as unit vectors of the world frame."""

    rays: Array
    """(T, J, 3), NaN where missing."""
    centre_m: Array
    """The camera's centre in each frame, shape (T, 3)."""
    rotation: Array
    """R_camera_world of each frame, shape (T, 3, 3)."""
    focal_px: float
    noise_rad: Array
    """The noise of a detection as an angle, shape (T, 1)."""

    def later(self, frames: float) -> _Sight:
        """If the pictures were taken that much later."""
        rays, centre_m = _shifted(self.rays, frames), _shifted(self.centre_m, frames)
        return replace(self, rays=rays, centre_m=centre_m, rotation=_shifted(self.rotation, round(frames)))

    def part(self, rows: Index) -> _Sight:
        """The same, cut to these rows."""
        parts = (self.rays[rows], self.centre_m[rows], self.rotation[rows], self.focal_px, self.noise_rad[rows])
        return _Sight(*parts)


_Points = tuple[Array, Array]
"""Places (T, J, 3) and their covariances (T, J, 3, 3), NaN where fewer than two rays meet."""


def _shifted(values: Array, frames: float) -> Array:
    """Values (T, ...) moved on by so many rows, between rows along straight lines; NaN where they come from outside."""
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


def points_m(views: Sequence[View], sigma_px: float, keypoint_sigma_m: float) -> Array:
    """(T, J, 3): where the rays of several views meet, in their world, NaN where fewer than two do."""
    return _points(_sights(views, sigma_px, keypoint_sigma_m))[0]


def _with_keypoint_noise(sight: _Sight, position_m: Array, keypoint_sigma_m: float) -> _Sight:
    """The noise with that of a keypoint's place on the body, at the points' typical distance from the camera."""
    distance = np.linalg.norm(position_m - sight.centre_m[:, None], axis=-1)
    if np.isnan(distance).all():
        return sight
    with warnings.catch_warnings(action="ignore"):  # of frames without points
        typical = np.nanmedian(distance, axis=1)
    typical = np.where(np.isnan(typical), np.nanmedian(distance), typical)
    return replace(sight, noise_rad=np.hypot(sight.noise_rad, keypoint_sigma_m / typical[:, None]))


def _points(sights: Sequence[_Sight]) -> _Points:
    """Where the rays of two or more cameras come nearest to each other, those far off counting less."""
    rays = np.array([sight.rays for sight in sights])
    centres = np.array([sight.centre_m for sight in sights])[:, :, None]
    noise = np.array([sight.noise_rad for sight in sights])
    seen = np.isfinite(rays[..., 0])
    rays, centres = np.where(seen[..., None], rays, 0.0), np.where(np.isfinite(centres), centres, 0.0)
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    weight, distance, enough = seen.astype(float), np.ones(seen.shape), seen.sum(axis=0) > 1
    position, information = np.zeros((*enough.shape, 3)), np.zeros((*enough.shape, 3, 3))
    for _ in range(_ROUNDS):
        of_rays = (weight / (noise * distance) ** 2)[..., None, None] * across
        information = of_rays.sum(axis=0)
        spread = np.linalg.eigvalsh(information)
        enough &= spread[..., 0] > _PARALLEL * spread[..., 2]
        information[~enough] = np.eye(3)
        position = np.linalg.solve(information, (of_rays @ centres[..., None]).sum(axis=0))[..., 0]
        distance = np.maximum(np.linalg.norm(position - centres, axis=-1), 1e-3)
        error = np.linalg.norm((position - centres) / distance[..., None] - rays, axis=-1)
        weight = seen / (1.0 + (error / noise / _ROBUST) ** 2)
    position[~enough] = np.nan
    covariance = np.asarray(np.linalg.inv(information), dtype=float)
    covariance[~enough] = np.nan
    return position, covariance


# -- one camera against others -------------------------------------------------------------------------------------


def _levels(sights: Sequence[_Sight], among: Sequence[int]) -> Array:
    """(V,): of each of these cameras against the others of them; NaN where too few points tell, and of the rest."""
    levels = np.full(len(sights), np.nan)
    for v in among:
        others = [sights[o] for o in among if o != v]
        levels[v] = _pair_level(sights[v], *others)[0] if len(among) == 2 else _level(sights[v], _points(others))
    return levels


def _agreement(sight: _Sight, others: Sequence[_Sight], fps: float, wide: bool) -> Numbers:
    """wide: a time offset is sought far and wide."""
    told = dict.fromkeys(("turn_rad", "level_turned", "late_frames", "level_late"), np.nan)
    if len(others) == 1:
        level, error_rad, n = _pair_level(sight, others[0])
        return {"points": n, "error_px": error_rad * sight.focal_px, "level": level} | told
    points = _points(others)
    towards, squared = _errors(sight, points)
    off_rad = np.linalg.norm(towards - sight.rays, axis=-1)
    known = np.isfinite(squared)
    error_px = float(np.median(off_rad[known])) * sight.focal_px if known.sum() >= MIN_POINTS else np.nan
    turned, told["turn_rad"] = _best_turned(sight, points)
    late, told["late_frames"] = _best_shifted(sight, points, fps, wide)
    told |= {"level_turned": _level(turned, points), "level_late": _level(late, points)}
    return {"points": int(known.sum()), "error_px": error_px, "level": _level(sight, points)} | told


def _pair_level(a: _Sight, b: _Sight) -> tuple[float, float, int]:
    """Level, median angle between a's rays and the planes through both centres and b's rays, and number of points."""
    line = b.centre_m - a.centre_m
    plane_a, plane_b = np.cross(b.rays, line[:, None]), np.cross(line[:, None], a.rays)
    size_a, size_b = np.linalg.norm(plane_a, axis=-1), np.linalg.norm(plane_b, axis=-1)
    off = np.abs(np.sum(a.rays * plane_a, axis=-1))
    known = np.isfinite(off) & (size_a > 0) & (size_b > 0)
    if known.sum() < MIN_POINTS:
        return np.nan, np.nan, int(known.sum())
    sigma = np.hypot(size_a * a.noise_rad, size_b * b.noise_rad)[known]
    level = np.sqrt(np.median((off[known] / sigma) ** 2) / _MEDIAN_OF_LINE)
    return float(level), float(np.median(off[known] / size_a[known])), int(known.sum())


def _errors(sight: _Sight, points: _Points) -> tuple[Array, Array]:
    """Unit vectors (T, J, 3) towards the points, and by how many sigmas squared (T, J) the rays lie beside them."""
    position_m, covariance_m2 = points
    off = position_m - sight.centre_m[:, None]
    distance = np.linalg.norm(off, axis=-1, keepdims=True)
    towards = off / distance
    x, y = _across(sight.rays)
    error = np.stack([np.sum((towards - sight.rays) * axis, axis=-1) for axis in (x, y)], axis=-1)
    basis = np.stack([x, y], axis=-2) / distance[..., None]
    covariance = basis @ covariance_m2 @ basis.swapaxes(-1, -2)
    a, b, c = (covariance[..., i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
    a, c = a + sight.noise_rad**2, c + sight.noise_rad**2
    squared = (c * error[..., 0] ** 2 - 2 * b * error[..., 0] * error[..., 1] + a * error[..., 1] ** 2) / (a * c - b**2)
    ahead, behind = np.sum(off * sight.rays, axis=-1) > 0, np.where(np.isnan(squared), np.nan, np.inf)
    return towards, np.where(ahead, squared, behind)


def _across(rays: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a right-angled frame with each ray."""
    helper = np.where(np.abs(rays[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    x = np.cross(helper, rays)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return x, np.asarray(np.cross(rays, x), dtype=float)


def _level(sight: _Sight, points: _Points) -> float:
    _, squared = _errors(sight, points)
    known = squared[~np.isnan(squared)]
    return float(np.sqrt(np.median(known) / _MEDIAN_OF_POINT)) if len(known) >= MIN_POINTS else np.nan


def _best_turned(sight: _Sight, points: _Points) -> tuple[_Sight, float]:
    """With the rotation of the camera that brings its rays nearest to the points, and the rotation's angle."""
    towards, _ = _errors(sight, points)
    goal, rays = (np.einsum("tij,tkj->tki", sight.rotation, v) for v in (towards, sight.rays))
    known = np.isfinite(goal[..., 0]) & np.isfinite(rays[..., 0])
    if known.sum() < MIN_POINTS:
        return sight, np.nan
    noise = np.broadcast_to(sight.noise_rad, known.shape)[known]
    turn = Rotation.identity()
    for _ in range(10):
        error = np.linalg.norm(goal[known] - turn.apply(rays[known]), axis=-1)
        scale = max(float(np.median(error / noise)), 1.0)
        weight = noise**-2 / (1.0 + (error / noise / scale / _ROBUST) ** 2)
        turn, _ = Rotation.align_vectors(goal[known], rays[known], weight)
    in_world = sight.rotation.swapaxes(-1, -2) @ turn.as_matrix() @ sight.rotation
    return replace(sight, rays=np.einsum("tij,tkj->tki", in_world, sight.rays)), float(turn.magnitude())


def _best_shifted(sight: _Sight, points: _Points, fps: float, wide: bool) -> tuple[_Sight, float]:
    """If its pictures were taken when they fit best, and how many frames later that is."""
    reach = min(max(round(SOUGHT_OFFSET_S * fps), LITTLE_OFFSET) if wide else LITTLE_OFFSET, len(sight.rays) // 2)
    levels = {float(by): _level(sight.later(by), points) for by in range(-reach, reach + 1)}
    if not np.isfinite([*levels.values()]).any():
        return sight, np.nan
    best = min(levels, key=lambda by: (np.nan_to_num(levels[by], nan=np.inf), abs(by)))
    if not wide and abs(best) == reach:
        return _best_shifted(sight, points, fps, wide=True)
    for by in (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75):
        levels[best + by] = _level(sight.later(best + by), points)
    best = min(levels, key=lambda by: (np.nan_to_num(levels[by], nan=np.inf), abs(by)))
    return sight.later(best), best


# -- cameras out of step -------------------------------------------------------------------------------------------


def search_offsets(views: Sequence[View], fps: float, sigma_px: float, keypoint_sigma_m: float) -> Array:
    """(V,): how many whole frames later than said each camera's pictures were taken, beside the first's; NaN where it
    sees too little together with the others to compare.

    Of views of the same T frames; noise as in `agreement_findings`. Each camera in turn is put
    where its rays pass those of the cameras before it most closely, then, a few times, those of all others. 0 where
    nothing else is clearly better.
    """
    sights = _sights(views, sigma_px, keypoint_sigma_m)
    T = len(views[0].xy_px)
    rows = np.arange(0, T, max(1, T // _OFFSET_ROWS))
    reach = max(min(round(OFFSET_S * fps), T // 2), 1)
    found = np.full(len(views), np.nan)
    found[0] = 0.0
    for turn in range(_ROUNDS):
        before = found.copy()
        for v in range(1, len(views)):
            others = [o for o in range(len(views)) if o != v and np.isfinite(found[o])]
            found[v] = _best_offset(sights[v], [sights[o].later(found[o]) for o in others], reach, rows)
        if turn and np.array_equal(before, found, equal_nan=True):
            break
    return found


def _best_offset(sight: _Sight, others: Sequence[_Sight], reach: int, rows: Index) -> float:
    offsets = np.arange(-reach, reach + 1)
    partners = [other.part(rows) for other in others]
    shifted = [sight.later(by).part(rows) for by in offsets.tolist()]
    pairs = np.array([[_pair_level(one, other) for other in partners] for one in shifted])
    levels, points = pairs[..., 0], pairs[..., 2]
    compared = np.isfinite(levels) & (points >= _COMPARED * points.max(axis=0))
    if not compared.any():
        return np.nan
    total, number = np.where(compared, levels, 0.0).sum(axis=1), compared.sum(axis=1)
    mean = np.where(number > 0, total / np.maximum(number, 1), np.inf)
    best = int(np.argmin(mean))
    return 0.0 if mean[best] > CLEARLY * mean[reach] else float(offsets[best])


# -- what is solved of cameras with the fit ----------------------------------------------------------------------------

FIT_ROUNDS = 5
CLOSE_FRAMES = 0.05
"""Lags this small are left to the solver, which takes the motion for straight over them."""
WORSE, BETTER, LOST, FAR = 1.1, 1.02, 5.0, 4.0
"""Times a camera's median reprojection that is no change, as what one camera gains, another may lose a little, and that
is none at all; times that of the rig's middle camera, of one that is an outlier all the time; and times the expected
turn, of one that is not where the file says."""
MAX_SIGMA_FRAMES = 1.0
"""Offsets that are known less well, or do not settle so far, are refused."""

Solve = Callable[[tuple[Source, ...]], TrajectorySolution]


def solved_in_step(
    apart: Sequence[Source], later_frames: Sequence[float], solve: Solve, sigma_px: float, keypoint_sigma_m: float
) -> tuple[tuple[Source, ...], TrajectorySolution]:
    """Sources on their own frames put on those of one clip, with the offsets that were found, and their solution.
    later_frames: where the search begins. solve: with `find_offsets`. Raises InputError where the motion does not
    tell."""
    later, fps = np.array(later_frames), apart[0].keypoints.fps
    assert fps is not None
    begun = views_of(align_cameras(apart, later_frames))
    found = search_offsets(begun, fps, sigma_px, keypoint_sigma_m)
    names = [source.camera.name for source in apart]
    alone = [name for name, frames in zip(names, found, strict=True) if np.isnan(frames)]
    if alone:
        expected = "keypoints that it sees together with another camera, in 30 or more points"
        raise InputError(Problem("--set find-offsets", f"camera {name}", "too few", expected) for name in alone)
    later = later + found
    sources = align_cameras(apart, later.tolist())
    solution = solve(sources)
    for _ in range(1, FIT_ROUNDS):
        if np.abs(solution.time_offset_frames).max() < CLOSE_FRAMES:
            break
        later = later + solution.time_offset_frames
        sources = align_cameras(apart, later.tolist())
        solution = solve(sources)
    raise_problems(_problems(names, later, solution.time_offset_frames, solution.time_offset_sigma_frames))
    return sources, solution


def _problems(names: Sequence[str], later: Array, rests: Array, sigmas: Array) -> Iterator[Problem]:
    for name, frames, lag, sigma in zip(names, later, rests, sigmas, strict=True):
        if sigma > MAX_SIGMA_FRAMES or abs(lag) > MAX_SIGMA_FRAMES:
            found = f"{frames + lag:.1f} ± {max(sigma, abs(lag)):.1f} frames later, from a motion that hardly tells"
            expected = f"a clip that tells it to {MAX_SIGMA_FRAMES:g}, or --set offset-s as measured otherwise"
            yield Problem("--set find-offsets", f"camera {name}", found, expected)


def why_not_refined(refined: TrajectorySolution, held: TrajectorySolution) -> tuple[Finding, ...]:
    """Why cameras stay as calibrated; nothing where the refined ones are to be taken. A camera that leaves its pose
    becomes an outlier as a whole, which a robust cost rewards; and where none fits better, the refined poses are only
    less certain."""
    before, after = _medians_px(held), _medians_px(refined)
    names, turns_rad = [v.camera.name for v in held.views], np.linalg.norm(refined.extrinsic_correction[:, :3], axis=1)
    lost = (after > WORSE * before) | (after > LOST * np.median(after))
    worst, far = int(np.argmax(lost * after / before)), int(np.argmax(turns_rad))
    if lost[worst]:
        return (finding("cameras_not_refined", camera=names[worst], before_px=before[worst], after_px=after[worst]),)
    if turns_rad[far] > FAR * constants.CAMERA_ROTATION_RAD:
        return (finding("camera_left_its_pose", camera=names[far], turn_deg=float(np.degrees(turns_rad[far]))),)
    if not (before > BETTER * after).any():
        return (finding("cameras_as_calibrated"),)
    return ()


def _medians_px(solution: TrajectorySolution) -> np.ndarray:
    """(V,): median distance between detections and reprojected markers; infinite where none has a pose."""
    medians = []
    for view in solution.views:
        pixels, _ = view.project(view.shift_to_exposure(solution.markers_m))
        off = np.linalg.norm(pixels - view.xy_px, axis=-1)[view.present]
        off = np.where(np.isfinite(off), off, np.inf)
        medians.append(float(np.median(off)) if off.size else 1.0)
    return np.maximum(medians, 1e-9)


# -- which way is up ------------------------------------------------------------------------------------------------

MAX_SIGMA_RAD = np.radians(10.0)
"""Less is known of a camera that is taken to be level."""
POSTURE_RAD = np.radians(15.0)
"""How far from up the body may lie from its feet, in the mean over a clip."""
FOOT_SHARE = 1 / 15
"""How far from the ground feet stand, as a part of the body's height above them: `GROUND_FOOT_M` of a cheetah."""
MIN_STANDING = 3
"""Fewer feet that stand, over all frames, say nothing: as in `recon.fit.clip_problem`."""


class _Upward(NamedTuple):
    """The unit vector (3,) that points up, a point (3,) of the ground below the animal, metres, in the poses' world,
    and the standard deviation of the direction about its less known axis."""

    up: Array
    ground_m: Array
    sigma_rad: float


def up_from_feet(views: Sequence[View], body: Body, fps: float, sigma_px: float) -> _Upward | None:
    """Up as the feet of an animal say it that several cameras saw, None where they say too little. The plane through
    the feet that stand: slow ones, and, of those, the ones that others stand with. The body, which is above them, holds
    the plane where they stand on one line."""
    positions_m = points_m(views, sigma_px, body.keypoint_sigma_m)
    feet = np.array([body.markers.index(foot) for foot in body.feet])
    if not len(feet) or len(positions_m) < 2:
        return None
    above = positions_m[:, np.setdiff1d(np.arange(len(body.markers)), feet)]
    whole = np.isfinite(positions_m[:, feet, 0]).any(axis=1) & np.isfinite(above[..., 0]).any(axis=1)
    step = 0.5 * (positions_m[1:, feet] + positions_m[:-1, feet])
    seen = np.isfinite(step[..., 0])
    if seen.sum() < MIN_STANDING or not whole.any():
        return None
    body_m = np.nanmedian(above[whole], axis=1) - np.nanmean(positions_m[whole][:, feet], axis=1)
    posture = np.median(body_m, axis=0)
    tall_m = float(np.linalg.norm(posture))
    axes = np.linalg.svd(posture[None])[2]
    axes[0] *= np.sign(axes[0] @ posture)  # up by the posture, and across it

    still = StanceVelocity(feet, fps, constants.SLIP_M_S, constants.SLIP_C).contact(positions_m, 1.0)[2][seen]
    middle = np.median(step[seen], axis=0)
    height, *across = axes @ (step[seen] - middle).T
    rows = np.stack([np.ones_like(height), *across], axis=-1)
    held = np.diag([0.0, *np.full(2, np.tan(POSTURE_RAD) ** -2.0)])
    alike = max(constants.ERROR_TIME_S * fps, 1.0)
    plane, normal, weight = np.array([np.quantile(height, 0.25), 0.0, 0.0]), np.eye(3), still
    for width_m in tall_m * np.geomspace(1.0, FOOT_SHARE, 12):
        weight = still / (1.0 + ((height - rows @ plane) / (3 * width_m)) ** 2) ** 2
        of_rows = rows.T * weight / (alike * width_m**2)
        normal = of_rows @ rows + held
        plane = np.linalg.solve(normal, of_rows @ height)
    up = axes.T @ [1.0, *-plane[1:]]
    sigma = float(np.sqrt(np.linalg.eigvalsh(np.linalg.inv(normal)[1:, 1:])[-1]))
    if not weight.sum() >= MIN_STANDING or not sigma < MAX_SIGMA_RAD:
        return None
    return _Upward(up / np.linalg.norm(up), middle + plane[0] * axes[0], sigma)
