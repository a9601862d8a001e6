"""Detect left-right swaps of a camera by what two or more other cameras see.

The other cameras predict where a camera sees the keypoints of both sides (`predicted_by_others`). Each frame then has a
log-likelihood gain from exchanging left and right, and a stretch of frames with a clear gain is a swap. No fit is
needed. A swap in one camera also spoils the predictions for the other cameras, so the clearest swap is undone first,
and the others are predicted again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.base.arrays import Array
from recon.check.likelihood import CERTAIN_GAIN, baseline_of
from recon.check.swaps import Stretch, Swap, gains_elsewhere, pairs_of, with_exchanged
from recon.clip import View
from recon.fit.clip_problem import ClipProblem
from recon.fit.result import TrajectorySolution
from recon.fit.triangulation import predicted_by_others


def swaps_between(clip: ClipProblem, solution: TrajectorySolution) -> tuple[list[list[Swap]], tuple[View, ...]]:
    """Return the swaps of each of three or more views that the other views show, and the views without these swaps.

    Parameters
    ----------
    clip
        The problem that was solved.
    solution
        The solution of all views.
    """
    kinds, views = pairs_of(clip.body), [*clip.views]
    found: list[list[Swap]] = [[] for _ in views]
    for _ in range(len(views) * len(kinds)):
        candidates = sorted(_candidates(replace(clip, views=tuple(views)), solution), key=lambda one: -one[1].ratio)
        taken = np.zeros(len(solution.states), dtype=bool)
        for number, swap in candidates:
            rows = swap.stretch.rows
            if not taken[rows].any():
                # what overlaps a clearer swap may follow from this swap: it is judged again without it
                found[number].append(swap)
                views[number] = with_exchanged(views[number], swap.stretch)
            taken[rows] = True
        if not candidates:
            break
    return found, tuple(views)


def _candidates(clip: ClipProblem, solution: TrajectorySolution) -> list[tuple[int, Swap]]:
    """Return each possible swap of each view, with the index of the view."""
    kinds = pairs_of(clip.body)
    masks = np.array([permutation != np.arange(len(permutation)) for permutation in kinds.values()])
    found = []
    for number, predicted in enumerate(predicted_by_others(clip.views, solution.markers_m, [*solution.noise_px])):
        baseline = baseline_of(clip, number, solution.states, solution.size, predicted)
        gains = np.nan_to_num(gains_elsewhere(baseline, kinds["all"])) @ masks.T
        for permutation, gain in zip(kinds.values(), gains.T, strict=True):
            for first, stop in gaining_stretches(gain, CERTAIN_GAIN):
                ratio = float(gain[first:stop].sum())
                found.append((number, Swap(Stretch(slice(first, stop), permutation), ratio)))
    return found


def gaining_stretches(gain: Array | Sequence[float], least: float) -> list[tuple[int, int]]:
    """Return the stretches of frames that maximise the sum of the gains (T,), less `least` for each stretch.

    Each stretch is a pair of the first frame and the frame after the last.
    """
    # Two sums are kept for each frame: the largest one outside and inside a stretch. Both ends cost half of `least`.
    outside, inside, begins, ends = 0.0, -np.inf, [], []
    for value in gain:
        begins.append(outside - least / 2 > inside)
        inside = max(inside, outside - least / 2) + value
        ends.append(inside - least / 2 > outside)
        outside = max(outside, inside - least / 2)
    stretches, t = [], len(ends)
    while t > 0:
        t -= 1
        if ends[t]:
            stop = t + 1
            while not begins[t]:
                t -= 1
            stretches.append((t, stop))
    return stretches[::-1]
