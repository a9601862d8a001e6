"""Estimate the variances between animals, runs, strides and measurements in an experiment, and its power.

The model of a stride's value is y = X b + a + r + s + m. The columns of X are the groups and the speed, and b are their
effects. The deviations a, r and s of the animal, the run and the stride are independent and have unknown variances. The
measurement error m is the same for all strides of a run, and its standard deviation is known. Variances are estimated
by restricted maximum likelihood (Patterson and Thompson 1971), effects by generalised least squares. Intervals of
effects use Student's distribution, whose degrees of freedom are the number of animals minus the number of columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize

from recon.base.arrays import Array

LEVELS = "animal", "run", "stride"
_MIN_SIGMA_RATIO = 1e-4
"""Lower bound of the standard deviations between animals, runs and strides, as a fraction of that of all values."""
_MIN_REPORTED_RATIO = 1e-2
"""Smallest standard deviation between animals, runs or strides that is not reported as 0.

The unit is the standard deviation of all values.
"""


@dataclass(frozen=True)
class LevelSigmas:
    """Standard deviations between animals, runs and strides, and of the measurement, in the unit of the quantity."""

    animal: float
    run: float
    stride: float
    measurement: float = 0.0
    """Standard deviation of the measurement error, common to all strides of a run, if one camera films the run."""

    def variance_of_mean(self, runs: float, strides: float, cameras: float = 1.0) -> float:
        """Return the variance of an animal's mean value over `runs` runs with `strides` strides each.

        Every run is filmed by `cameras` cameras.
        """
        of_run = self.run**2 + self.measurement**2 / cameras + self.stride**2 / strides
        return self.animal**2 + of_run / runs

    @property
    def icc(self) -> float:
        """Return the intraclass correlation: the variance between animals divided by the variance of single strides."""
        total = self.variance_of_mean(1, 1)
        return self.animal**2 / total if total else float("nan")

    def detectable_change(self, strides: float) -> float:
        """Return the difference between two runs of an animal that chance alone exceeds with a probability of 5 %.

        Each run has `strides` strides.
        """
        return 1.96 * float(np.sqrt(2 * (self.variance_of_mean(1, strides) - self.animal**2)))


class Contrast(NamedTuple):
    """Weighted sum of the effects of a mixed model, with its standard deviation and the ends of its 90 % interval."""

    value: float
    sigma: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class MixedModel:
    """Mixed model with P effects, fitted to the strides of an experiment."""

    names: tuple[str, ...]
    """Names of the P columns of the design matrix."""
    effects: Array
    """Effect of each column of the design matrix, shape (P,)."""
    covariance: Array
    """Covariance of the effects, shape (P, P), excluding errors that all clips share."""
    sigmas: LevelSigmas
    animals: int
    runs: int
    strides: int

    def contrast(self, weights: Array | Sequence[float], shared: float = 0.0) -> Contrast:
        """Return a weighted sum of the effects with its standard deviation and 90 % interval.

        Parameters
        ----------
        weights : ndarray
            Weight of each effect, shape (P,).
        shared : float
            Relative standard deviation of an error that all clips share, such as the error of the animal's size. More
            animals do not reduce this error.
        """
        from scipy.stats import t  # slow to import

        row = np.asarray(weights, dtype=float)
        value = float(row @ self.effects)
        sigma = float(np.sqrt(row @ self.covariance @ row + (shared * value) ** 2))
        reach = float(t.ppf(0.95, max(self.animals - len(self.names), 1))) * sigma
        return Contrast(value, sigma, value - reach, value + reach)


def fit_mixed_model(
    values: Array,
    design: Array,
    names: Sequence[str],
    animals: Sequence[str],
    runs: Sequence[str],
    measurement_sigma: Array,
) -> MixedModel:
    """Return a mixed model fitted to a quantity of the N strides of an experiment.

    Parameters
    ----------
    values : ndarray
        The quantity of each stride, shape (N,).
    design : ndarray
        Design matrix of groups and covariates, shape (N, P), of full rank.
    names : sequence of str
        Names of the P columns of the design matrix.
    animals, runs : sequence of str
        Animal and run of each of the N strides. Runs of different animals are different even if they have the same
        name.
    measurement_sigma : ndarray
        Standard deviation of the measurement error that all strides of a run share, shape (N,), in the quantity's unit.

    Returns
    -------
    MixedModel
        The fitted model. A variance too small to be found in the data is 0. If there is only one run per animal, the
        variance between animals includes the variance between runs. If there is only one stride per run, the variance
        between runs includes the variance between strides.
    """
    unit = float(np.std(values)) or 1.0
    scaled, scaled_sigma = values / unit, measurement_sigma / unit
    single = [
        _block(scaled[rows], design[rows], np.asarray(runs)[rows], scaled_sigma[rows])
        for animal in dict.fromkeys(animals)
        for rows in [np.asarray(animals) == animal]
    ]

    blocks = _grouped(single)

    def cost(log_sigmas: Array) -> float:
        return _solve(blocks, np.exp(log_sigmas))[2]

    by_run = dict(zip(zip(animals, runs, strict=True), measurement_sigma, strict=True))
    is_separate = np.array([True, len(by_run) > len(single), len(values) > len(by_run)])
    least = np.log(_MIN_SIGMA_RATIO)
    bounds = [(least, np.log(10.0) if separate else least) for separate in is_separate]
    starts = np.where(is_separate, np.log([[0.5, 0.5, 0.5], [0.1, 0.3, 0.7]]), least)
    fits = [minimize(cost, start, method="L-BFGS-B", bounds=bounds) for start in starts]
    sigmas = np.exp(min(fits, key=lambda fit: fit.fun).x)
    effects, covariance, _ = _solve(blocks, sigmas)
    animal, run, stride = np.where(sigmas > _MIN_REPORTED_RATIO, sigmas, 0.0) * unit
    measured = float(np.sqrt(np.mean(np.square([*by_run.values()]))))
    sigmas = LevelSigmas(float(animal), float(run), float(stride), measured)
    counts = len(single), len(by_run), len(values)
    return MixedModel(tuple(names), effects * unit, covariance * unit**2, sigmas, *counts)


@dataclass(frozen=True, eq=False)
class _Block:
    """Strides of A animals with the same runs and measurement errors, n strides per animal.

    Several such groups of animals can be stacked, so that all arrays have the shape (B, n, ...).
    """

    columns: Array
    """Design matrix and values of the A animals, side by side, shape (n, A (P + 1))."""
    same_run: Array
    """Matrix with 1 where two strides are of the same run, otherwise 0, shape (n, n)."""
    known: Array
    """Covariance of the measurement errors, shape (n, n)."""
    animals: int = 1
    """Number of animals, A."""


def _block(values: Array, design: Array, runs: Array, sigma: Array) -> _Block:
    same_run = (runs[:, None] == runs).astype(float)
    return _Block(np.column_stack([design, values]), same_run, same_run * np.multiply.outer(sigma, sigma))


def _grouped(single: Sequence[_Block]) -> list[_Block]:
    """Join the blocks of animals that have equal covariances, and stack the blocks that have equal shapes."""
    by_covariance: dict[tuple[bytes, bytes], list[_Block]] = {}
    for block in single:
        by_covariance.setdefault((block.same_run.tobytes(), block.known.tobytes()), []).append(block)
    by_shape: dict[tuple[int, ...], list[_Block]] = {}
    for group in by_covariance.values():
        joined = replace(group[0], columns=np.hstack([block.columns for block in group]), animals=len(group))
        by_shape.setdefault(joined.columns.shape, []).append(joined)
    return [
        _Block(
            np.stack([block.columns for block in group]),
            np.stack([block.same_run for block in group]),
            np.stack([block.known for block in group]),
            group[0].animals,
        )
        for group in by_shape.values()
    ]


def _solve(blocks: Sequence[_Block], sigmas: Array) -> tuple[Array, Array, float]:
    """Return the effects (P,), their covariance (P, P) and -2 times the restricted log-likelihood.

    `sigmas` are the three standard deviations between animals, runs and strides.
    """
    animal, run, stride = sigmas**2
    columns = blocks[0].columns.shape[-1] // blocks[0].animals
    moments, log_determinant = np.zeros((columns, columns)), 0.0
    for block in blocks:
        covariance = animal + run * block.same_run + block.known + stride * np.eye(block.same_run.shape[-1])
        root = np.linalg.cholesky(covariance)
        white = np.linalg.solve(root, block.columns).reshape(-1, columns)
        moments += white.T @ white
        log_determinant += 2 * block.animals * float(np.log(np.diagonal(root, axis1=1, axis2=2)).sum())
    information, right = moments[:-1, :-1], moments[:-1, -1]
    effects = np.asarray(np.linalg.solve(information, right), dtype=float)
    misfit = float(moments[-1, -1] - right @ effects)
    covariance = np.asarray(np.linalg.inv(information), dtype=float)
    return effects, covariance, log_determinant + float(np.linalg.slogdet(information)[1]) + misfit


def power(
    effect: float,
    sigmas: LevelSigmas,
    animals: int,
    runs: int,
    strides: int,
    cameras: int = 1,
    paired: bool = False,
) -> float:
    """Return the probability that a test at the 5 % level finds a difference between two groups.

    Parameters
    ----------
    effect : float
        Difference between the means of the two groups, in the quantity's unit.
    sigmas : LevelSigmas
        Standard deviations between animals, runs and strides, and of the measurement.
    animals, runs, strides, cameras : int
        Number of animals per group, runs per animal and group, strides per run, and cameras that film a run.
    paired : bool
        Whether both groups are the same animals, as before and after a treatment.
    """
    from scipy.stats import nct, t  # slow to import

    if animals < 2:
        return 0.0
    variance = sigmas.variance_of_mean(runs, strides, cameras) - (sigmas.animal**2 if paired else 0.0)
    sigma = np.sqrt(2 * variance / animals)
    freedom = animals - 1 if paired else 2 * animals - 2
    limit, shift = t.ppf(0.975, freedom), abs(effect) / max(float(sigma), 1e-12)
    if shift > 30:
        return 1.0
    wrong_side = nct.cdf(-limit, freedom, shift) if shift < 5 else 0.0  # scipy's cdf is NaN for larger shifts
    return float(nct.sf(limit, freedom, shift) + wrong_side)


def animals_needed(
    effect: float,
    sigmas: LevelSigmas,
    runs: int,
    strides: int,
    cameras: int = 1,
    wanted: float = 0.8,
    paired: bool = False,
) -> int | None:
    """Return the number of animals per group required to find an effect with the power `wanted`.

    Return None if more than 1000 animals are required. The other parameters are as in `power`.
    """

    def is_enough(animals: int) -> bool:
        return power(effect, sigmas, animals, runs, strides, cameras, paired) >= wanted

    low, high = 2, 1000
    if not is_enough(high):
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if is_enough(middle) else (middle + 1, high)
    return low


def smallest_effect(
    sigmas: LevelSigmas,
    animals: int,
    runs: int,
    strides: int,
    cameras: int = 1,
    wanted: float = 0.8,
    paired: bool = False,
) -> float:
    """Return the smallest effect, in the quantity's unit, that is found with the power `wanted`.

    Return NaN for fewer than two animals per group. The other parameters are as in `power`.
    """
    if animals < 2:
        return float("nan")

    def lacks(effect: float) -> float:
        return power(effect, sigmas, animals, runs, strides, cameras, paired) - wanted

    highest = sigmas.variance_of_mean(runs, strides, cameras) ** 0.5 or 1.0
    while lacks(highest) < 0:
        highest *= 2
    return float(brentq(lacks, 0.0, highest))
