"""From a covariance to a region, and from a standard deviation to an interval, that hold the truth as often as said.

Errors have heavier tails than a Gaussian: a clip's noise and the weight of its prior are themselves estimated, from few
independent samples, and in a clip for which they come out too small all errors are larger than stated. Such a scale
makes a Student's t of a Gaussian. Stated covariances S are covariances of these errors, too, so that e' S^-1 e of an
error e in k dimensions is k (nu - 2) / nu times a variable of Fisher's F with k and nu degrees of freedom.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtri

from recon.base.arrays import Array

DEGREES_OF_FREEDOM = 7.0
"""nu: the most likely one for the errors of 28 real views, and 5.5 to 8 without one of their five runs
(`benchmarks/regions.py`)."""
_ROUNDING_M2 = 1e-12
"""Added to variances: those of a pose relative to its own middle may be singular to rounding."""


def radius(level: float, dimensions: int = 1, nu: float = DEGREES_OF_FREEDOM) -> float:
    """In standard deviations (square root of e' S^-1 e), of the region that holds a share `level` of the truth."""
    return float(np.sqrt(dimensions * fdtri(dimensions, nu, level) * (nu - 2) / nu))


def sigmas(error: Array, covariance: Array) -> Array:
    """(...): how many standard deviations errors (..., k) with covariances (..., k, k) are, NaN where not known."""
    known = np.isfinite(error).all(axis=-1) & np.isfinite(covariance).all(axis=(-2, -1))
    off = np.full(known.shape, np.nan)
    e, S = error[known], covariance[known] + _ROUNDING_M2 * np.eye(error.shape[-1])
    off[known] = np.sqrt(np.sum(e * np.linalg.solve(S, e[..., None])[..., 0], axis=-1))
    return off
