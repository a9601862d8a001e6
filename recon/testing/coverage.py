"""Count how much of a known truth lies in the regions and intervals that a fit states."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr

from recon.base.arrays import Array
from recon.fit.posterior import DEGREES_OF_FREEDOM, radius, sigmas


def cumulative(deviations: float) -> float:
    """Return the share of one quantity's distribution below a number of standard deviations from its middle."""
    nu = DEGREES_OF_FREEDOM
    return float(stdtr(nu, deviations * np.sqrt(nu / (nu - 2))))


def coverage(error: Array, covariance: Array, level: float) -> float:
    """Return the share of errors inside the regions that should contain the share `level`.

    Parameters
    ----------
    error
        Estimate minus truth, (..., k).
    covariance
        As the fit states it, (..., k, k). Errors or covariances that are NaN do not count.
    level
        Share that the regions should contain, as in 0.9.

    Returns
    -------
    float
        The share, about `level` if the stated uncertainty is right; NaN without any error.
    """
    deviations = sigmas(error, covariance)
    is_known = np.isfinite(deviations)
    if not is_known.any():
        return np.nan
    return float(np.mean(deviations[is_known] < radius(level, error.shape[-1])))


def coordinate_coverage(error: Array, covariance: Array, level: float) -> float:
    """Return the share of single coordinates of errors (..., k) inside their intervals that should contain `level`."""
    sigma = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    return float(np.mean(np.abs(error) < radius(level) * sigma))
