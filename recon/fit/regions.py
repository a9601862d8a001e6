"""Compute regions and intervals that contain the true value with a given probability.

The noise of a clip and the weight of its prior are themselves estimated, which turns a Gaussian into a Student's t. Let
V be the covariance of an error e in k dimensions. Then e' V^-1 e is k (nu - 2) / nu times a variable that has Fisher's
F distribution with k and nu degrees of freedom.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtri

from recon.base.arrays import Array

DEGREES_OF_FREEDOM = 7.0
"""Degrees of freedom nu of Student's t, most likely for the errors of real views (`benchmarks/uncertainty.py`)."""
_ROUNDING_M2 = 1e-12
"""Variance (m^2) added to covariances, because the covariance of a pose relative to its own middle is singular."""


def radius(level: float, dimensions: int = 1, nu: float = DEGREES_OF_FREEDOM) -> float:
    """Return the radius, in standard deviations, of the region that contains the true value with probability `level`.

    The radius is the square root of e' V^-1 e at the region's edge.
    """
    return float(np.sqrt(dimensions * fdtri(dimensions, nu, level) * (nu - 2) / nu))


def sigmas(error: Array, covariance: Array) -> Array:
    """Return Mahalanobis lengths (...) of errors (..., k) with covariances (..., k, k); NaN if either is unknown."""
    is_known = np.isfinite(error).all(axis=-1) & np.isfinite(covariance).all(axis=(-2, -1))
    sizes = np.full(is_known.shape, np.nan)
    e, V = error[is_known], covariance[is_known] + _ROUNDING_M2 * np.eye(error.shape[-1])
    sizes[is_known] = np.sqrt(np.sum(e * np.linalg.solve(V, e[..., None])[..., 0], axis=-1))
    return sizes
