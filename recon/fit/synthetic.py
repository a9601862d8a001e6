"""Detections as a network would give them, of points that are known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.base.arrays import Bools
from recon.clip.keypoints import Keypoints


def add_noise(
    keypoints: Keypoints, sigma_px: float = 2.0, dropout: float = 0.05, outlier: float = 0.02, seed: int = 0
) -> tuple[Keypoints, Bools]:
    """Detections as a network would give them, and which of them are gross outliers, (T, K) bool.

    sigma_px: standard deviation of the Gaussian noise of each coordinate; dropout: share of points that go missing;
    outlier: share of points that land 40 to 300 px away (uniform) in any direction, within the picture if its size is
    known. Both shares are kept to a whole point. Good points have likelihoods of 0.9 to 1, outliers 0.6 to 0.98.
    """
    rng = np.random.default_rng(seed)
    shape = keypoints.confidence.shape
    noise = rng.normal(size=(*shape, 2)) * sigma_px
    order = rng.permutation(shape[0] * shape[1]).reshape(shape)
    length, angle = rng.uniform(40, 300, shape), rng.uniform(0, 2 * np.pi, shape)
    good, poor = 1 - 0.1 * rng.uniform(size=shape) ** 3, rng.uniform(0.6, 0.98, shape)

    n_lost, n_outliers = round(dropout * order.size), round(outlier * order.size)
    lost = ~keypoints.present | (order < n_lost)
    outliers = ~lost & (order >= n_lost) & (order < n_lost + n_outliers)
    xy_px = keypoints.xy_px + noise
    jump = length[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    if keypoints.image_size_px is not None:
        beyond = (xy_px + jump < 0) | (xy_px + jump > np.array(keypoints.image_size_px) - 1)
        jump = np.where(beyond, -jump, jump)
    xy_px = np.where(outliers[..., None], xy_px + jump, xy_px)
    noisy = replace(
        keypoints,
        xy_px=np.where(lost[..., None], np.nan, xy_px),
        confidence=np.where(lost, 0.0, np.where(outliers, poor, good)),
    )
    return noisy, outliers
