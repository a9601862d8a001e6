"""A clip in which left and right are swapped: whether it is likelier with them swapped back, and how it is then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.animal import Body, opposites
from recon.check import likelihood
from recon.check.codes import finding
from recon.check.swaps import PARTS, exchanged_rows
from recon.clip import Source
from recon.fit import Finding, TrajectorySolution


def mends(mended: TrajectorySolution, given: TrajectorySolution) -> bool:
    """Whether a fit of a clip with its swaps undone is clearly likelier as a whole than that of the clip as it came."""
    return likelihood.believed(likelihood.whole_ratio(mended, given), surely=True)


def doubted(one: Finding) -> Finding:
    """A swap that does not make the whole clip likelier is only to be looked at."""
    if one.code != "left_right_swap":
        return one
    return finding("left_right_swap_possible", one.frames, one.camera, **one.numbers)


def without_swaps(
    sources: Sequence[Source], findings: Sequence[Finding], body: Body
) -> tuple[tuple[Source, ...], tuple[Finding, ...]]:
    """The sources with left and right swapped back where a finding says so, and the findings, which say that, too."""
    mended, marked, places = [*sources], [*findings], opposites(body.markers)
    for i, one in enumerate(findings):
        if one.code != "left_right_swap" or one.frames is None:
            continue
        number = next(v for v, source in enumerate(sources) if source.camera.name == one.camera)
        keypoints = mended[number].keypoints
        rows = slice(*np.searchsorted(keypoints.frames, one.frames))
        named = np.isin(keypoints.names, one.names("keypoints"))
        back = exchanged_rows(keypoints, rows, np.where(named, places, np.arange(len(places))))
        mended[number] = replace(mended[number], keypoints=replace(keypoints, **back))
        most = one.numbers["part"] == PARTS["all"] and 2 * (rows.stop - rows.start) > len(keypoints.frames)
        code = "clip_swapped_back" if most else "left_right_swap_mended"  # a mirrored video looks like a swapped clip
        marked[i] = finding(code, one.frames, one.camera, **one.numbers)
    return tuple(mended), tuple(marked)
