"""By how many frames cameras are out of step, sought in what they see: where rays of the same keypoint meet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from recon.base.arrays import Array, Index
from recon.check.agreement import Sight, pair_level, sights_of
from recon.clip import View

REACH_S = 1.0
"""How far off a camera is sought, at most; and not further than half a clip."""
CLEARLY = 0.9
"""An offset counts only if it makes the level so many times as high as none does, or less."""
_ROWS = 200
"""Frames that are compared."""
_ENOUGH = 0.3
"""A lag that leaves less than this part of the most points that can be compared says nothing."""
_ROUNDS = 3


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
