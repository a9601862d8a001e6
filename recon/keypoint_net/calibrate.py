"""What a likelihood means: the share of points that are right, among those with this likelihood.

A network is surer on the pictures that it knows than it may be on others. On the validation pictures it is known which
points are right (within the tolerance of their label); a logistic function of the raw likelihood's logit is fitted to
them, and a table of reliability says how well it holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from recon.base.arrays import Array, Bools

BINS = 10
_EDGE = 1e-4
_PRIOR = (1.0, 0.0)
_PRIOR_SIGMA = (0.5, 2.0)


@dataclass(frozen=True)
class LikelihoodCalibration:
    """likelihood = expit(slope * logit(raw) + offset)."""

    slope: float = 1.0
    offset: float = 0.0
    points: int = 0
    """How many it was fitted to; 0: it changes nothing."""

    def apply(self, raw: Array) -> Array:
        """Of raw likelihoods; NaN stays NaN."""
        if not self.points:
            return np.clip(raw, 0.0, 1.0)
        return expit(self.slope * logit(np.clip(raw, _EDGE, 1 - _EDGE)) + self.offset)


def fit_calibration(raw: Array, right: Bools) -> LikelihoodCalibration:
    """From raw likelihoods (N,) and whether their points are right (N,), by maximum likelihood with a weak prior on
    slope and offset, which keeps both finite where all points are right."""
    if not len(raw):
        return LikelihoodCalibration()
    x, y = logit(np.clip(raw, _EDGE, 1 - _EDGE)), right.astype(float)
    mean, sigma = np.array(_PRIOR), np.array(_PRIOR_SIGMA)

    def cost(p: Array) -> tuple[float, Array]:
        z = p[0] * x + p[1]
        value = float((np.logaddexp(0, z) - y * z).sum() + 0.5 * (((p - mean) / sigma) ** 2).sum())
        slack = expit(z) - y
        return value, np.array([(slack * x).sum(), slack.sum()]) + (p - mean) / sigma**2

    found = minimize(cost, mean, jac=True, method="L-BFGS-B", bounds=[(0.05, 5.0), (-10.0, 10.0)])
    return LikelihoodCalibration(float(found.x[0]), float(found.x[1]), len(raw))


def reliability(likelihood: Array, right: Bools, bins: int = BINS) -> dict[str, Any]:
    """Of likelihoods (N,) in 0 to 1 and whether their points are right (N,): how many `points` they are; their
    `expected_calibration_error`, the mean difference of likelihood and share of right points, NaN without any; and for
    the `bins` of equal width with points in them how many; low and high, between which their likelihoods lie; their
    mean; and the share of them that is right."""
    which = np.minimum((likelihood * bins).astype(int), bins - 1)
    rows = []
    for b in np.unique(which):
        here = which == b
        ends = {"low": float(b / bins), "high": float((b + 1) / bins), "points": int(here.sum())}
        rows.append(ends | {"likelihood": float(likelihood[here].mean()), "right": float(right[here].mean())})
    total = len(likelihood)
    error = sum(r["points"] * abs(r["likelihood"] - r["right"]) for r in rows) / total if total else float("nan")
    return {"points": total, "expected_calibration_error": float(error), "bins": rows}
