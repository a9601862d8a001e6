"""How much of the truth lies in the regions and intervals of `recon.fit.posterior`."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr

from recon.fit.posterior import DEGREES_OF_FREEDOM, radius, sigmas


def share_below(off: float) -> float:
    """The share of the distribution of one quantity that lies below `off` standard deviations from its middle."""
    nu = DEGREES_OF_FREEDOM
    return float(stdtr(nu, off * np.sqrt(nu / (nu - 2))))


def share_inside(error: np.ndarray, covariance: np.ndarray, level: float) -> float:
    """The part of the known errors (..., k) inside the regions that are to hold the share `level`; NaN of none."""
    off = sigmas(error, covariance)
    return float(np.mean(off[np.isfinite(off)] < radius(level, error.shape[-1]))) if np.isfinite(off).any() else np.nan
