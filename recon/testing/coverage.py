"""Measure the fraction of true values inside the regions and intervals that a fit states."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr

from recon.base.arrays import Array
from recon.fit.regions import DEGREES_OF_FREEDOM, radius, sigmas


def cumulative(deviations: float) -> float:
    """Return the fraction of the fits' Student's t distribution below a value in standard deviations."""
    nu = DEGREES_OF_FREEDOM
    return float(stdtr(nu, deviations * np.sqrt(nu / (nu - 2))))


def coverage(error: Array, covariance: Array, level: float) -> float:
    """Return the fraction of errors inside the regions that should contain the fraction `level`.

    Parameters
    ----------
    error
        Estimate minus truth, shape (..., k).
    covariance
        Covariance stated by the fit, shape (..., k, k). Errors or covariances with NaN do not count.
    level
        Fraction that the regions should contain, such as 0.9.

    Returns
    -------
    float
        The fraction, about `level` if the stated uncertainty is right; NaN without errors.
    """
    deviations = sigmas(error, covariance)
    is_known = np.isfinite(deviations)
    if not is_known.any():
        return np.nan
    return float(np.mean(deviations[is_known] < radius(level, error.shape[-1])))


def coordinate_coverage(error: Array, covariance: Array, level: float) -> float:
    """Return the fraction of coordinates of errors (..., k) inside the intervals that should contain `level`."""
    sigma = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    return float(np.mean(np.abs(error) < radius(level) * sigma))
