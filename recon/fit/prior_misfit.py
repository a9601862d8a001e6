"""How surprising a fitted motion is under the prior, and how far the prior counts after that.

At a minimum the angles lie off what the prior expects of poses and changes by whitened residuals r. With P the prior's
curvature, H that of all terms and n unknowns, pixels that say nothing leave r = 0, and pixels that say all leave one
sigma for each unknown: where the prior fits, |r|^2 is n - tr(H^-1 P), the number of unknowns that the pixels say, times
for how many frames an error lasts (D. MacKay, *Bayesian interpolation*, 1992). What it is relative to that is the scale
of the prior's variances that is most likely.
"""

from __future__ import annotations

from dataclasses import dataclass

from recon.animal.prior import ANGLES
from recon.fit.banded import eliminated
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.terms import PRIOR_TERMS

LASTS_S = 0.04
"""How long a surprise lasts: so that clips of a motion that the prior fits, but was not made from, have a level of
about 1 (benchmarks/mismatch.py)."""
LEVEL, SIGMAS = 2.0, 2.33
"""A motion is unlike those that the prior knows from this level on, if one that fits would by chance be as far off in 1
of 100 clips."""


@dataclass(frozen=True)
class PriorMisfit:
    """level: the squared residuals against the prior, relative to what is expected where it fits, 1; freedom: how many
    unknowns the pixels say."""

    level: float
    freedom: float

    @property
    def prior_weight(self) -> float:
        """The part of its weight that the prior keeps: one over the scale, 1 at most."""
        return 1.0 / max(self.level, 1.0)

    @property
    def unlike(self) -> bool:
        """Whether the motion is none that the prior knows."""
        variance = 2.0 / (9.0 * self.freedom)  # a chi square's cube root is nearly normal (Wilson and Hilferty)
        by_chance = (1.0 - variance + SIGMAS * variance**0.5) ** 3
        return self.level >= max(LEVEL, by_chance)


def prior_misfit_of(problem: LeastSquares, found: Estimate, fps: float) -> PriorMisfit:
    """Of the prior as the problem weighs it, at its minimum."""
    prior, said = problem.only(PRIOR_TERMS), 0.0
    windows = eliminated(problem.normals(found.states, found.shared), bounded=True)
    for window, of_prior in zip(windows, prior.normals(found.states), strict=True):
        both = window.marginal_blocks() * of_prior.H.blocks
        said += float(both[:, 0].sum() + 2 * both[:, 1:].sum())
    freedom = max(found.states[:, ANGLES].size - said, 1.0)
    return PriorMisfit(prior.squares(found.states) / freedom / max(LASTS_S * fps, 1.0), freedom)
