"""The focal length beside the turn: points that a turn takes across the picture keep their angles at one length only.

Of pairs of pictures, the points that were followed from the one to the other: their rays, at a factor on the focal
lengths of both, and a rotation for each pair that takes the ones to the others. Robust least squares of all pairs, in
pixels. A small turn says little: what a wrong length leaves grows with the angle between the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.calibrate.camera_motion.features import pixels_of, rays_of
from recon.calibrate.camera_motion.rotation import normal_equations
from recon.geometry.camera import Camera

MIN_POINTS, MIN_PAIRS = 30, 4
WIDEST = 0.7
"""Of the log factors that are tried."""
STEP, STEPS = 1e-4, 8
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
    tried = [_solved(camera, some, start, limit_px, 2) for start in np.linspace(-WIDEST, WIDEST, 15)]
    nearest = min(tried, key=lambda one: one[2])[0]
    log_factor, (information, pull), _ = _solved(camera, pairs, nearest, limit_px, STEPS)
    keys = np.array([pair.key for pair in pairs])
    of_key = [(information[keys == key].sum(), pull[keys == key].sum()) for key in np.unique(keys)]
    total = float(information.sum())
    scatter = sum(p * p for _, p in of_key) / total**2
    return log_factor, float(np.sqrt(1 / total + scatter))


def _solved(
    camera: Camera, pairs: Sequence[TurnedPair], log_factor: float, limit_px: float, steps: int
) -> tuple[float, tuple[Array, Array], float]:
    """The factor after so many steps; by pair what it says of it, information and pull (gradient); the cost."""
    ways = [Rotation.from_matrix(pair.turn).as_rotvec() for pair in pairs]
    turns = [Rotation.from_rotvec(np.exp(-log_factor) * way).as_matrix() for way in ways]  # as far in the picture
    information, pull = np.zeros((2, len(pairs)))
    cost = 0.0
    for _ in range(steps + 1):
        cost = 0.0
        for i, pair in enumerate(pairs):
            turns[i], *_ = _turned(camera, pair, turns[i], log_factor)
            turns[i], H, g, size, weights = _turned(camera, pair, turns[i], log_factor)
            used = max(float(weights.sum()), 1.0)
            sigma2 = max(float((weights * size**2).sum()) / (2 * used), 1e-4) + FLOOR_PX**2 * used
            information[i] = (H[3, 3] - H[3, :3] @ np.linalg.solve(H[:3, :3], H[:3, 3])) / sigma2
            pull[i] = (g[3] - H[3, :3] @ np.linalg.solve(H[:3, :3], g[:3])) / sigma2
            cost += float(np.minimum(size / limit_px, 1.0).mean())
        if information.sum() > 0:
            log_factor = float(np.clip(log_factor + pull.sum() / information.sum(), -2 * WIDEST, 2 * WIDEST))
    return log_factor, (information, pull), cost


def _turned(
    camera: Camera, pair: TurnedPair, turn: Array, log_factor: float
) -> tuple[Array, Array, Array, Array, Array]:
    """The turn after a step, for it follows the factor; the normal equations H (4, 4) and g (4,) before it; sizes of
    the residuals (N,), in pixels, and their weights (N,)."""
    r, J = _linearised(camera, pair, turn, log_factor)
    size = np.linalg.norm(r, axis=1)
    limit = max(4 * float(np.median(size)), 1.0)
    weights = np.maximum(1 - (size / limit) ** 2, 0) ** 2
    H, g = normal_equations(J, weights, r)
    return Rotation.from_rotvec(np.linalg.solve(H[:3, :3], g[:3])).as_matrix() @ turn, H, g, size, weights


def _linearised(camera: Camera, pair: TurnedPair, turn: Array, log_factor: float) -> tuple[Array, Array]:
    """Residuals (N, 2) and their derivatives (N, 2, 4) of the expected pixels, by a small turn and the log factor."""

    def expected(turn: Array, log_factor: float) -> Array:
        rays, valid = rays_of(camera, pair.a_px, np.exp(log_factor))
        pixels, seen = pixels_of(camera, rays @ turn.T, np.exp(log_factor))
        return np.where((valid & seen)[:, None], pixels, np.nan)

    at = expected(turn, log_factor)
    ends = [(Rotation.from_rotvec(STEP * axis).as_matrix() @ turn, log_factor) for axis in np.eye(3)]
    ends.append((turn, log_factor + STEP))
    J = np.stack([(expected(*end) - at) / STEP for end in ends], axis=2)
    known = np.asarray(np.isfinite(J).all(axis=(1, 2)))
    return np.where(known[:, None], pair.b_px - at, 1e9), np.where(known[:, None, None], J, 0.0)
