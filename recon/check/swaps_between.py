"""Detect left-right swaps of a camera by what two or more other cameras see.

The other cameras predict where a camera sees the keypoints of both sides (`predicted_by_others`). Each frame then has a
log-likelihood gain from exchanging left and right. A stretch of frames with a clear gain is a swap, and no fit is
needed. A swap in one camera also spoils the predictions for the other cameras, so the clearest swap is undone first,
and the others are predicted again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.base.arrays import Array
from recon.check.likelihood import CERTAIN_GAIN, baseline_of
from recon.check.swaps import Stretch, Swap, gains_elsewhere, jumps, pairs_of, with_exchanged
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
    swaps_of_views: list[list[Swap]] = [[] for _ in views]
    for _ in range(len(views) * len(kinds)):
        candidates = sorted(
            _candidates(replace(clip, views=tuple(views)), solution), key=lambda candidate: -candidate[1].ratio
        )
        taken = np.zeros(len(solution.states), dtype=bool)
        for number, swap in candidates:
            rows = swap.stretch.rows
            if not taken[rows].any():
                # A candidate that overlaps a clearer swap may be a consequence of it, and is judged again without it.
                swaps_of_views[number].append(swap)
                views[number] = with_exchanged(views[number], swap.stretch)
            taken[rows] = True
        if not candidates:
            break
    return swaps_of_views, tuple(views)


def _candidates(clip: ClipProblem, solution: TrajectorySolution) -> list[tuple[int, Swap]]:
    """Return each possible swap of each view, with the index of the view.

    The evidence of the other cameras must be clear on its own. The jumps of the tracks only move the ends of a swap,
    and distinguish a swap of all keypoints from a swap of one pair of legs.
    """
    kinds, candidates = pairs_of(clip.body), []
    for number, predicted in enumerate(predicted_by_others(clip.views, solution.markers_m, [*solution.noise_px])):
        baseline = baseline_of(clip, number, solution.states, solution.size, predicted)
        gains = np.nan_to_num(gains_elsewhere(baseline, kinds["all"]))
        for permutation in kinds.values():
            gain = gains[:, permutation != np.arange(len(permutation))].sum(axis=1)
            at_ends = np.append(jumps(baseline.view, permutation), 0.0)
            at_ends[0] = 0.0
            at_ends[~np.isfinite(at_ends)] = 0.0  # frames without detections show no jump
            for first, stop in gaining_stretches(gain, at_ends, CERTAIN_GAIN):
                ratio = float(gain[first:stop].sum())
                if ratio > CERTAIN_GAIN:
                    ratio += float(at_ends[first] + at_ends[stop])
                    candidates.append((number, Swap(Stretch(slice(first, stop), permutation), ratio)))
    return candidates


def gaining_stretches(gain: Array, at_ends: Array, least: float) -> list[tuple[int, int]]:
    """Return the stretches of frames that maximise the sum of their gains, less `least` for each stretch.

    Parameters
    ----------
    gain
        Gain of each frame in a stretch, shape (T,).
    at_ends
        Gain of a stretch that begins at a frame or ends before it, shape (T + 1,).
    least
        Smallest gain of a stretch.

    Returns
    -------
    list of (int, int)
        First frame of each stretch, and the frame after its last.
    """
    # The best sums up to a frame are kept for two cases: the frame is outside a stretch, or inside. Both ends of a
    # stretch cost half of `least`.
    outside, inside, begins, ends = 0.0, -np.inf, [], []
    for value, at_end in zip(gain, at_ends[:-1] - least / 2, strict=True):
        begins.append(outside + at_end > inside)
        ends.append(inside + at_end > outside)
        outside, inside = max(outside, inside + at_end), max(inside, outside + at_end) + value
    stretches, stop = [], len(gain)
    is_inside = inside + at_ends[-1] - least / 2 > outside
    for t in reversed(range(len(gain))):
        if is_inside and begins[t]:
            stretches.append((t, stop))
            is_inside = False
        elif not is_inside and ends[t]:
            stop, is_inside = t, True
    return stretches[::-1]
