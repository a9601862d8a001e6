"""How poses change: a ridge regression of accelerations on poses and rates."""

from __future__ import annotations

import numpy as np

from recon.animal.prior.mixture import still
from recon.base.arrays import Array, Bools

RIDGE_PER_ROW = 0.1
"""Held-out accelerations like it best (docs/priors.md)."""
ACCELERATION_FLOOR_RAD_S2 = 10.0
"""Added to the spread of every acceleration."""


def ridge(states: Array, accelerations: Array, loose: Bools) -> tuple[Array, Array]:
    """Drift (A, 2A) from states (M, 2A) to accelerations (M, A), and the covariance of what is left (A, A). The loose
    angles (A,) have no part in it."""
    scale = states.std(axis=0)
    n_angles = accelerations.shape[1]
    # What does not move, or only by the noise of the fit, explains nothing.
    moves = np.tile(~still(states[:, :n_angles]) & ~loose, 2) & (scale > 0)
    scaled = np.where(moves, states / np.where(moves, scale, 1.0), 0.0)
    normal = scaled.T @ scaled + RIDGE_PER_ROW * len(scaled) * np.eye(scaled.shape[1])
    drift = np.linalg.solve(normal, scaled.T @ accelerations).T / np.where(moves, scale, 1.0)
    drift[loose] = 0.0
    left = accelerations - states @ drift.T
    covariance = np.where(loose[:, None] == loose, left.T @ left / len(left), 0.0)
    return drift, covariance + ACCELERATION_FLOOR_RAD_S2**2 * np.eye(n_angles)
