"""Frames whose detections are gross outliers as a whole, as of an animal that has left the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.base.arrays import Array, Bools
from recon.check.codes import finding
from recon.check.inputs.likelihood import CLEAR, TAILS
from recon.clip import Source, View
from recon.clip.keypoints import frame_ranges, leave_out
from recon.fit import TrajectorySolution
from recon.fit.result import Finding

_WHY = "in frames whose detections are gross outliers"
MOST = 0.5
"""Where more of the frames are, the fit is wrong, or another mistake was made."""


def outlier_ratios(view: View, markers_m: Array, noise_px: Array) -> Array:
    """(T,): how many times as likely a frame's keypoints are if each lies anywhere in the picture rather than where the
    motion has its marker, as a logarithm; NaN without keypoints or a pose. markers_m, world (T, J, 3); noise_px (T, J).
    """
    projected, valid = view.project(view.at_its_time(markers_m))
    q = np.sum((projected - view.xy_px) ** 2, axis=-1) / noise_px**2
    density = -2.0 * np.log(noise_px) - np.log(2 * np.pi) - (TAILS + 2) / 2 * np.log1p(q / TAILS)
    width, height = view.camera.image_size_px
    anywhere = -float(np.log(width * height))
    known = view.present & np.isfinite(markers_m[:, :1, 0])
    each = np.where(known, anywhere - np.where(valid, density, -np.inf), 0.0)
    return np.where(known.any(axis=1), each.sum(axis=1), np.nan)


def outlier_frames(view: View, ratios: Array) -> Bools:
    """(T,): frames of gross outliers, by their `outlier_ratios`; none where most are."""
    found: Bools = ratios > CLEAR
    return found if found.sum() <= MOST * view.present.any(axis=1).sum() else np.zeros(len(found), dtype=bool)


def without_gross_outliers(
    sources: Sequence[Source], solution: TrajectorySolution
) -> tuple[tuple[Source, ...], tuple[Finding, ...]]:
    """The sources without the detections of frames that are gross outliers as a whole, and which those were."""
    kept, found = [], []
    for source, view, noise_px in zip(sources, solution.views, solution.noise_px, strict=True):
        ratios = outlier_ratios(view, solution.markers_m, noise_px)
        rows = outlier_frames(view, ratios)
        points, numbers = source.keypoints.present & rows[:, None], source.keypoints.frames
        keypoints, cleaning = leave_out(source.keypoints, source.cleaning, points, _WHY)
        kept.append(replace(source, keypoints=keypoints, cleaning=cleaning))
        for first, stop in frame_ranges(np.flatnonzero(rows)):
            frames, ratio = (int(numbers[first]), int(numbers[stop - 1]) + 1), float(ratios[first:stop].sum())
            found.append(finding("gross_outliers", frames, source.camera.name, log_likelihood_ratio=ratio))
    return tuple(kept), tuple(found)
