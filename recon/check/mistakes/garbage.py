"""Frames whose detections are garbage altogether, as of an animal that has left the picture."""

from __future__ import annotations

import numpy as np

from recon.base.arrays import Array, Bools
from recon.clip import View
from recon.fit.mistake import CLEAR

_TAILS = 3.0
"""Degrees of freedom of Student's distribution, which the keypoints' errors have."""
MOST = 0.5
"""Where more of the frames are, the fit is wrong, or another mistake was made."""


def garbage_ratios(view: View, markers_m: Array, noise_px: Array) -> Array:
    """(T,): how many times as likely a frame's keypoints are if each lies anywhere in the picture rather than where the
    motion has its marker, as a logarithm; NaN without keypoints or a pose. markers_m, world (T, J, 3); noise_px (T, J).
    """
    projected, valid = view.project(view.at_its_time(markers_m))
    q = np.sum((projected - view.xy_px) ** 2, axis=-1) / noise_px**2
    density = -2.0 * np.log(noise_px) - np.log(2 * np.pi) - (_TAILS + 2) / 2 * np.log1p(q / _TAILS)
    width, height = view.camera.image_size_px
    anywhere = -float(np.log(width * height))
    known = view.present & np.isfinite(markers_m[:, :1, 0])
    each = np.where(known, anywhere - np.where(valid, density, -np.inf), 0.0)
    return np.where(known.any(axis=1), each.sum(axis=1), np.nan)


def garbage_frames(view: View, ratios: Array) -> Bools:
    """(T,): frames that are garbage, by their `garbage_ratios`; none where most are."""
    found: Bools = ratios > CLEAR
    return found if found.sum() <= MOST * view.present.any(axis=1).sum() else np.zeros(len(found), dtype=bool)
