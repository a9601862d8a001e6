"""Correct left-right swaps in a clip, and decide whether the clip becomes more likely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.animal.body import Body
from recon.check import likelihood
from recon.check.codes import finding
from recon.check.swaps import PARTS, with_exchanged_names
from recon.clip import Source
from recon.fit.result import Finding, TrajectorySolution


def swap_improves(mended: TrajectorySolution, original: TrajectorySolution) -> bool:
    """Return whether the clip is clearly more likely after correcting the swaps, given the fits after and before."""
    return likelihood.exceeds_margin(likelihood.whole_fit_gain(mended, original), surely=True)


def downgrade_swap(swap: Finding) -> Finding:
    """Return the finding on a swap as one on a possible swap, and any other finding unchanged.

    A swap counts as possible if correcting it does not make the whole clip more likely.
    """
    if swap.code != "left_right_swap":
        return swap
    return finding("left_right_swap_possible", swap.frames, swap.camera, **swap.numbers)


def without_swaps(
    sources: Sequence[Source], findings: Sequence[Finding], body: Body
) -> tuple[tuple[Source, ...], tuple[Finding, ...]]:
    """Return the sources with the detected swaps corrected, and the findings with a mark on each corrected swap."""
    mended, marked = [*sources], [*findings]
    for i, swap in enumerate(findings):
        if swap.code != "left_right_swap" or swap.frames is None:
            continue
        number = next(v for v, source in enumerate(sources) if source.camera.name == swap.camera)
        keypoints = mended[number].keypoints
        rows = slice(*np.searchsorted(keypoints.frames, swap.frames))
        exchanged_back = with_exchanged_names(keypoints, rows, swap.names("keypoints"), body)
        mended[number] = replace(mended[number], keypoints=replace(keypoints, **exchanged_back))
        is_most_of_clip = swap.numbers["part"] == PARTS["all"] and 2 * (rows.stop - rows.start) > len(keypoints.frames)
        # A swap of most of a clip may also be a mirrored video.
        code = "clip_swapped_back" if is_most_of_clip else "left_right_swap_mended"
        marked[i] = finding(code, swap.frames, swap.camera, **swap.numbers)
    return tuple(mended), tuple(marked)
