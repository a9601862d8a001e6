"""Keypoints without what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.animal.body import Body
from recon.check.mistakes.garbage import garbage_frames, garbage_ratios
from recon.check.mistakes.sides import opposites
from recon.clip import Source
from recon.clip.keypoints import frame_ranges, leave_out
from recon.fit import TrajectorySolution
from recon.fit.mistake import Mistake

_GARBAGE = "in frames whose detections are garbage"


def without_garbage(
    sources: Sequence[Source], solution: TrajectorySolution
) -> tuple[tuple[Source, ...], tuple[Mistake, ...]]:
    """Without the detections of frames that are garbage altogether."""
    kept, found = [], []
    for number, (source, view) in enumerate(zip(sources, solution.views, strict=True)):
        ratios = garbage_ratios(view, solution.markers_m, solution.noise_px[number])
        frames = garbage_frames(view, ratios)
        points = source.keypoints.present & frames[:, None]
        keypoints, cleaning = leave_out(source.keypoints, source.cleaning, points, _GARBAGE)
        kept.append(replace(source, keypoints=keypoints, cleaning=cleaning))
        for first, stop in frame_ranges(np.flatnonzero(frames)):
            ratio = float(ratios[first:stop].sum())
            found.append(Mistake("garbage", ratio, number, (first, stop), mended=False))
    return tuple(kept), tuple(found)


def with_sides_mended(
    sources: Sequence[Source], mistakes: Sequence[Mistake], body: Body
) -> tuple[tuple[Source, ...], tuple[Mistake, ...]]:
    """With left and right exchanged back where they are exchanged."""
    mended, places = [*sources], opposites(body)
    for one in mistakes:
        if one.kind == "sides" and one.rows is not None and one.view is not None:
            source = mended[one.view]
            xy_px, confidence = source.keypoints.xy_px.copy(), source.keypoints.confidence.copy()
            rows, to = slice(*one.rows), [*one.markers]
            for values in (xy_px, confidence):
                values[rows, to] = values[rows][:, places[to]]
            keypoints = replace(source.keypoints, xy_px=xy_px, confidence=confidence)
            mended[one.view] = replace(source, keypoints=keypoints)
    marked = tuple(replace(one, mended=True) if one.kind == "sides" else one for one in mistakes)
    return tuple(mended), marked
