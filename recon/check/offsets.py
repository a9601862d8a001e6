"""By how many frames cameras are out of step: sought in what they see, where rays of the same keypoint meet, and then
solved with the fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from recon.base.arrays import Array, Index
from recon.base.errors import InputError, Problem, refuse
from recon.check.agreement import Sight, pair_level, sights_of
from recon.clip import Source, View, together, views_of
from recon.fit import TrajectorySolution

REACH_S = 1.0
"""How far off a camera is sought, at most; and not further than half a clip."""
CLEARLY = 0.9
"""An offset counts only if it makes the level so many times as high as none does, or less."""
_ROWS = 200
"""Frames that are compared."""
_ENOUGH = 0.3
"""A lag that leaves less than this part of the most points that can be compared says nothing."""
_ROUNDS = 3
FIT_ROUNDS = 5
CLOSE_FRAMES = 0.05
"""Lags this small are left to the solver, which takes the motion for straight over them."""
MAX_SIGMA_FRAMES = 1.0
"""Offsets that are known less well, or do not settle so far, are refused."""

Solve = Callable[[tuple[Source, ...]], TrajectorySolution]


def solved_in_step(
    apart: Sequence[Source], later_frames: Sequence[float], solve: Solve, sigma_px: float, keypoint_sigma_m: float
) -> tuple[tuple[Source, ...], TrajectorySolution]:
    """Sources on their own frames put on those of one clip, with the offsets that were found, and their solution.

    later_frames: where the search begins. solve: with `find_offsets`. Raises InputError where the motion does not tell.
    """
    later, fps = np.array(later_frames), apart[0].keypoints.fps
    assert fps is not None
    begun = views_of(together(apart, later_frames))
    found = search_offsets(begun, fps, sigma_px, keypoint_sigma_m)
    names = [source.camera.name for source in apart]
    alone = [name for name, frames in zip(names, found, strict=True) if np.isnan(frames)]
    if alone:
        expected = "keypoints that it sees together with another camera, in 30 or more points"
        raise InputError(Problem("--set find-offsets", f"camera {name}", "too few", expected) for name in alone)
    later = later + found
    sources = together(apart, later.tolist())
    solution = solve(sources)
    for _ in range(1, FIT_ROUNDS):
        if np.abs(solution.time_offset_frames).max() < CLOSE_FRAMES:
            break
        later = later + solution.time_offset_frames
        sources = together(apart, later.tolist())
        solution = solve(sources)
    refuse(_problems(names, later, solution.time_offset_frames, solution.time_offset_sigma_frames))
    return sources, solution


def _problems(names: Sequence[str], later: Array, lags: Array, sigmas: Array) -> Iterator[Problem]:
    for name, frames, lag, sigma in zip(names, later, lags, sigmas, strict=True):
        if sigma > MAX_SIGMA_FRAMES or abs(lag) > MAX_SIGMA_FRAMES:
            found = f"{frames + lag:.1f} ± {max(sigma, abs(lag)):.1f} frames later, from a motion that hardly tells"
            expected = f"a clip that tells it to {MAX_SIGMA_FRAMES:g}, or --set offset-s as measured otherwise"
            yield Problem("--set find-offsets", f"camera {name}", found, expected)


def search_offsets(views: Sequence[View], fps: float, sigma_px: float, keypoint_sigma_m: float) -> Array:
    """(V,): how many whole frames later than said each camera's pictures were taken, beside the first's; NaN where it
    sees too little together with the others to compare.

    Of views of the same T frames; noise as in `recon.check.agreement.camera_findings`. Each camera in turn is put
    where its rays pass those of the cameras before it most closely, then, a few times, those of all others. 0 where
    nothing else is clearly better.
    """
    sights = sights_of(views, sigma_px, keypoint_sigma_m)
    T = len(views[0].xy_px)
    rows = np.arange(0, T, max(1, T // _ROWS))
    reach = max(min(round(REACH_S * fps), T // 2), 1)
    found = np.full(len(views), np.nan)
    found[0] = 0.0
    for turn in range(_ROUNDS):
        before = found.copy()
        for v in range(1, len(views)):
            others = [o for o in range(len(views)) if o != v and np.isfinite(found[o])]
            found[v] = _best(sights[v], [sights[o].later(found[o]) for o in others], reach, rows)
        if turn and np.array_equal(before, found, equal_nan=True):
            break
    return found


def _best(sight: Sight, others: Sequence[Sight], reach: int, rows: Index) -> float:
    lags = np.arange(-reach, reach + 1)
    partners = [other.part(rows) for other in others]
    pairs = np.array([[pair_level(sight.later(by).part(rows), other) for other in partners] for by in lags.tolist()])
    levels, points = pairs[..., 0], pairs[..., 2]
    compared = np.isfinite(levels) & (points >= _ENOUGH * points.max(axis=0))
    if not compared.any():
        return np.nan
    total, number = np.where(compared, levels, 0.0).sum(axis=1), compared.sum(axis=1)
    mean = np.where(number > 0, total / np.maximum(number, 1), np.inf)
    best = int(np.argmin(mean))
    return 0.0 if mean[best] > CLEARLY * mean[reach] else float(lags[best])
