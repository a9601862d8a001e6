"""The focal length beside the turn: points that a turn takes across the picture keep their angles at one length only.

Of pairs of pictures, the points that were followed from the one to the other: their rays, at a factor on the focal
lengths of both, and the rotation of each pair that takes the ones to the others best. Robust least squares of what is
left, in pixels. A small turn says little: what a wrong length leaves grows with the angle between the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.calibrate.camera_motion.features import pixels_of, rays_of
from recon.geometry.camera import Camera

MIN_POINTS, MIN_PAIRS = 30, 4
WIDEST = 0.7
"""Of the log factors that are tried."""
STEP, STEPS, ROUNDS = 1e-3, 6, 4
FLOOR_PX = 0.15
"""Of what all points of a pair may be off together."""


@dataclass(frozen=True, eq=False)
class TurnedPair:
    """Points (N, 2), (N, 2) of two pictures that were followed from one to the other, and the rotation (3, 3) that was
    found between them. key: of the earlier picture."""

    key: int
    a_px: Array
    b_px: Array
    turn: Array

    @property
    def angle_rad(self) -> float:
        return float(Rotation.from_matrix(self.turn).magnitude())


def focal_factor(camera: Camera, pairs: Sequence[TurnedPair], limit_px: float) -> tuple[float, float] | None:
    """By how much the focal length is longer than the camera file's, as a log factor, and its standard deviation.

    limit_px: what a point may be off. The deviation is that of the points and of what earlier pictures say one by one.
    None where too few pairs have points.
    """
    if len(pairs) < MIN_PAIRS:
        return None
    some = pairs[:: max(1, len(pairs) // 12)]

    def cost(log_factor: float) -> float:
        sizes = [np.linalg.norm(_left_px(camera, pair, log_factor), axis=1) for pair in some]
        return sum(float(np.minimum(size / limit_px, 1.0).mean()) for size in sizes)

    log_factor = min(np.linspace(-WIDEST, WIDEST, 29).tolist(), key=cost)
    information, pull = np.ones((2, len(pairs)))
    for _ in range(STEPS):
        information, pull = np.transpose([_told(camera, pair, log_factor) for pair in pairs])
        log_factor = float(np.clip(log_factor + pull.sum() / information.sum(), -2 * WIDEST, 2 * WIDEST))
    keys, total = np.array([pair.key for pair in pairs]), float(information.sum())
    scatter = sum(pull[keys == key].sum() ** 2 for key in np.unique(keys)) / total**2
    return log_factor, float(np.sqrt(1 / total + scatter))


def _told(camera: Camera, pair: TurnedPair, log_factor: float) -> tuple[float, float]:
    """What a pair says of the log factor: information, and pull (gradient)."""
    left, *ends = (_left_px(camera, pair, log_factor + by) for by in (0.0, STEP, -STEP))
    slope, weights, size = (ends[0] - ends[1]) / (2 * STEP), _weights(left), np.linalg.norm(left, axis=1)
    used = max(float(weights.sum()), 1.0)
    sigma2 = max(float(weights @ size**2) / (2 * used), 1e-4) + FLOOR_PX**2 * used
    return float(weights @ (slope**2).sum(axis=1)) / sigma2, -float(weights @ (slope * left).sum(axis=1)) / sigma2


def _left_px(camera: Camera, pair: TurnedPair, log_factor: float) -> Array:
    """(N, 2): how far the points of a pair are apart in its second picture, by the rotation that fits best then."""
    zoom = float(np.exp(log_factor))
    (a, known), (b, seen) = (rays_of(camera, points_px, zoom) for points_px in (pair.a_px, pair.b_px))
    known &= seen
    turn = Rotation.from_rotvec(Rotation.from_matrix(pair.turn).as_rotvec() / zoom)  # as far in the picture
    left = np.full(pair.a_px.shape, 1e9)
    for _ in range(ROUNDS):
        pixels, valid = pixels_of(camera, turn.apply(np.where(known[:, None], a, b)), zoom)
        left = np.where((known & valid)[:, None], pixels - pair.b_px, 1e9)
        turn, _ = Rotation.align_vectors(b[known], a[known], weights=_weights(left)[known])
    return left


def _weights(left_px: Array) -> Array:
    """(N,): Tukey's, of residuals (N, 2)."""
    size = np.linalg.norm(left_px, axis=1)
    return np.maximum(1 - (size / max(4 * float(np.median(size)), 1.0)) ** 2, 0) ** 2
