"""Estimate the time offsets of cameras whose clocks differ.

Offsets of whole frames are found first, by the error ratios of rays that should meet (`search_offsets`). The fit then
solves for the remaining fractions of a frame (`solve_time_offsets`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from recon.base.arrays import Array, Index
from recon.base.errors import InputError, Problem, raise_problems
from recon.check.sights import Sight, error_ratio_of_pair, sights_of
from recon.clip import Source, View, align_cameras, views_of
from recon.fit.result import TrajectorySolution

OFFSET_S = 1.0
"""Largest time offset that is searched for, seconds; at most half the duration of the clip."""
MAX_OFFSET_RATIO = 0.9
"""Largest ratio of the error ratios with and without a time offset for which the offset is used."""
_OFFSET_ROWS = 200
"""Maximum number of frames from which the error ratio of a time offset is computed."""
_COMPARED = 0.3
"""Minimum fraction of the comparable points that must remain comparable at a time offset."""
_OFFSET_ROUNDS = 3
"""Maximum number of rounds over all cameras in the search for whole frames."""
FIT_ROUNDS = 5
"""Maximum number of fits that solve for the time offsets."""
CLOSE_FRAMES = 0.05
"""Change of a time offset in a fit below which no further fit is needed, frames.

The fit assumes that the motion is straight over this time.
"""
MAX_SIGMA_FRAMES = 1.0
"""Largest standard deviation of an estimated time offset that is accepted, frames.

An offset that still changes by more than this in the last fit is not accepted either.
"""

SolveSources = Callable[[tuple[Source, ...]], TrajectorySolution]


def search_offsets(views: Sequence[View], fps: float, sigma_px: float, keypoint_sigma_m: float) -> Array:
    """Return the time offset of each camera from the first, in whole frames beyond the stated offset, shape (V,).

    The V views have the same T frames. Each camera in turn gets the offset at which its rays pass closest to those of
    the cameras before it. A few rounds with the rays of all other cameras follow. The offset is 0 if no other value is
    clearly better, and NaN if a camera shares too few points with the others. `sigma_px` and `keypoint_sigma_m` are as
    in `agreement_findings`.
    """
    sights = sights_of(views, sigma_px, keypoint_sigma_m)
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


def _best_offset(sight: Sight, partner_sights: Sequence[Sight], reach: int, rows: Index) -> float:
    """Return the time offset, up to ±`reach` frames, with the lowest mean error ratio; NaN if unknown.

    The offset is 0 unless another offset is clearly better.

    Only the frames `rows` are compared.
    """
    offsets = np.arange(-reach, reach + 1)
    partners = [partner.part(rows) for partner in partner_sights]
    shifted_sights = [sight.later(by).part(rows) for by in offsets.tolist()]
    pairs = np.array([[error_ratio_of_pair(shifted, partner) for partner in partners] for shifted in shifted_sights])
    ratios, points = pairs[..., 0], pairs[..., 2]
    compared = np.isfinite(ratios) & (points >= _COMPARED * points.max(axis=0))
    if not compared.any():
        return np.nan
    sums, number = np.where(compared, ratios, 0.0).sum(axis=1), compared.sum(axis=1)
    mean = np.where(number > 0, sums / np.maximum(number, 1), np.inf)
    best = int(np.argmin(mean))
    without_offset = mean[reach]
    return 0.0 if mean[best] > MAX_OFFSET_RATIO * without_offset else float(offsets[best])


def solve_time_offsets(
    sources_apart: Sequence[Source],
    later_frames: Sequence[float],
    solve: SolveSources,
    sigma_px: float,
    keypoint_sigma_m: float,
) -> tuple[tuple[Source, ...], TrajectorySolution]:
    """Return the sources with their time offsets corrected, on the frames of a single clip, and their solution.

    Parameters
    ----------
    sources_apart
        Sources whose frames are numbered by each camera's own clock.
    later_frames
        Time offset (frames) of each of the V cameras at which the search begins.
    solve
        Function that solves sources with the option `find_offsets`.
    sigma_px, keypoint_sigma_m
        Standard deviations of detections and of keypoint positions, as in `agreement_findings`.

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
        expected = "30 or more points that this camera and another camera see together"
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
            offset_text = f"{frames + lag:.1f} ± {max(sigma, abs(lag)):.1f} frames"
            lag_text = f"an offset of {offset_text}, which the motion hardly determines"
            limit = f"{MAX_SIGMA_FRAMES:g} frame"
            expected = f"a clip that determines the offset to {limit}, or a measured offset (--set offset-s)"
            yield Problem("--set find-offsets", f"camera {name}", lag_text, expected)
