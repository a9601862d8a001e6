"""Compare hypotheses about the poses of two cameras: well calibrated, turned about some of their axes, or moved.

The detections of two cameras do not determine all errors of the cameras' poses. For example, a turn of one camera about
the vertical is visible only in the animal's apparent size, and it often remains unclear which of the two cameras is
turned.

**Hypotheses.** A hypothesis states about which axes the two cameras are turned, and whether one of the cameras was
moved. The error of a rotation about an axis is either small, as after a good calibration, or much larger, with the
probability `constants.TURNED_SHARE`.

**Idea.** Under each hypothesis, the likelihood and the prior of the errors are Gaussian, so the marginal likelihood and
the posterior of the errors have a closed form. The poses are then the mean over all hypotheses, which has the smallest
expected error. If it is unclear which of the two cameras is turned, each is turned by half.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from recon.base.arrays import Array, Bools, Index
from recon.fit import constants
from recon.fit.least_squares import LeastSquares
from recon.fit.terms import SIZE, extrinsic_correction

_ROTATIONS = np.tile([True, True, True, False, False, False], 2)
"""Mask of the rotations among the twelve errors of two poses."""
_TURNED = np.array([*product([False, True], repeat=6)]).reshape(-1, 2, 3)
"""All choices of the axes about which two cameras are turned, (64, 2, 3)."""
_MOVED = np.array([[False, False], [True, False], [False, True]])
"""All choices of the camera that was moved: neither, the first or the second, (3, 2)."""


@dataclass(frozen=True, eq=False)
class PairPoses:
    """Hypotheses about the errors of two cameras' poses.

    The twelve errors are three angles and a shift for each camera, as in `View.corrected`.
    """

    is_turned: Bools
    """Mask of the axes about which each of the two cameras is turned, under each of E hypotheses, shape (E, 2, 3)."""
    is_moved: Bools
    """Mask of the camera that was moved, if any, under each hypothesis, shape (E, 2)."""
    weight: Array
    """Posterior probabilities of the hypotheses, shape (E,)."""
    mean: Array
    """Expected errors under each hypothesis, rad and m, shape (E, 12)."""
    covariance: Array
    """Covariances of the errors under each hypothesis, shape (E, 12, 12)."""

    @classmethod
    def weigh(cls, precision: Array, pull: Array, calibrated_sigma: Array, misplaced_sigma: Array) -> PairPoses:
        """Return all hypotheses with their posterior probabilities.

        Parameters
        ----------
        precision, pull
            Curvature (12, 12) and gradient (12,) of the negative log-likelihood at errors of 0.
        calibrated_sigma
            Standard deviations (12,) of the errors of well calibrated cameras, rad and m.
        misplaced_sigma
            Standard deviations (12,) of the errors of cameras that were turned and moved, rad and m.
        """
        is_turned = np.repeat(_TURNED, len(_MOVED), axis=0)
        is_moved = np.tile(_MOVED, (len(_TURNED), 1))
        is_misplaced = np.concatenate([is_turned, np.repeat(is_moved[..., None], 3, axis=2)], axis=2).reshape(-1, 12)
        sigma = np.where(is_misplaced, misplaced_sigma, calibrated_sigma)
        covariance = np.asarray(np.linalg.inv(precision + np.eye(12) * sigma[:, None] ** -2.0), dtype=float)
        mean = -covariance @ pull
        log_det = np.linalg.slogdet(np.eye(12) + precision * sigma[:, None] ** 2)[1]
        turned, moved = constants.TURNED_SHARE, constants.MOVED_SHARE
        log_prior = np.log(np.where(is_turned, turned, 1.0 - turned)).sum(axis=(1, 2))
        log_prior += np.log(np.where(is_moved.any(axis=1), moved, 1.0 - 2.0 * moved))
        log_weight = log_prior - 0.5 * (mean @ pull + log_det)
        weight = np.exp(log_weight - log_weight.max())
        return cls(is_turned, is_moved, weight / weight.sum(), mean, covariance)

    def covariance_about(self, value: Array) -> Array:
        """Return the second moments (12, 12) of the poses' errors about a value (12,), over all hypotheses."""
        deviation = self.mean - value
        products = self.covariance + deviation[:, :, None] * deviation[:, None]
        return np.asarray(np.einsum("e,eij->ij", self.weight, products))

    @property
    def expected(self) -> Array:
        """Return the mean errors (12,) of the poses over all hypotheses, rad and m."""
        return self.weight @ self.mean


@dataclass(frozen=True, eq=False)
class WeighedPair:
    """Hypotheses about the errors of two cameras' poses in a problem, with the marginal precision of the errors."""

    poses: PairPoses
    columns: Index
    """Columns of the errors among the shared unknowns, shape (12,)."""
    precision: Array
    """Marginal precision of the errors in the problem, including the precision of their prior, shape (12, 12)."""
    prior_mean: Array
    """Prior mean of the errors that puts the minimum at their mean over all hypotheses, rad and m, shape (12,)."""


def pair_poses(
    problem: LeastSquares, shared: Mapping[str, Array], normal: tuple[Array, Array], variance_factor: float
) -> WeighedPair | None:
    """Return the hypotheses about two cameras' poses with their posterior probabilities; None if the poses are known.

    The animal's size has one error for the whole clip. Like the errors of the poses, it counts once for any number of
    frames.

    Parameters
    ----------
    problem
        The problem. If the poses of both cameras are not among its shared unknowns, the result is None.
    shared
        Values of the shared unknowns, as a dictionary whose keys are their names.
    normal
        Precision (P, P) and gradient (P,) of all shared unknowns at the values `shared`.
    variance_factor
        Factor on all variances, which the problem itself does not contain.
    """
    names = [extrinsic_correction(i) for i in range(2)]
    if not all(name in problem.columns for name in names):
        return None
    S, gradient = normal
    columns = np.concatenate([np.arange(len(S), dtype=np.intp)[problem.columns[name]] for name in names])
    unknowns = {unknown.name: unknown for unknown in problem.shared}
    value = np.concatenate([shared[name] for name in names])
    mean = np.concatenate([unknowns[name].mean for name in names])
    sigma = np.concatenate([unknowns[name].sigma for name in names])

    def likelihood(S: Array, gradient: Array) -> tuple[Array, Array, Array]:
        """Return the marginal precision of the errors, and the curvature and gradient at 0 of their likelihood."""
        rest = np.delete(np.arange(len(S)), columns)
        by_rest = np.linalg.solve(S[np.ix_(rest, rest)], S[np.ix_(rest, columns)]).T
        precision = S[np.ix_(columns, columns)] - by_rest @ S[np.ix_(rest, columns)]
        pull = gradient[columns] - by_rest @ gradient[rest] - precision @ value + mean * sigma**-2.0
        return precision, precision - np.diag(sigma**-2.0), pull

    sized_S, sized_gradient = S.copy(), gradient.copy()  # the variance factor does not widen the size's prior
    if SIZE in unknowns:
        column, added = problem.columns[SIZE], (variance_factor - 1.0) * unknowns[SIZE].sigma ** -2.0
        sized_S[column, column] += added
        sized_gradient[column] += added * (shared[SIZE] - unknowns[SIZE].mean)
    _, curvature, pull = likelihood(sized_S, sized_gradient)
    usual_sigma = sigma * np.sqrt(variance_factor)
    misplaced_sigma = np.where(_ROTATIONS, constants.MISPLACED_RAD, constants.MOVED_FACTOR * usual_sigma)
    poses = PairPoses.weigh(
        curvature / variance_factor,
        pull / variance_factor,
        constants.WELL_CALIBRATED * usual_sigma,
        misplaced_sigma,
    )
    precision, curvature, pull = likelihood(S, gradient)
    # at the minimum, the gradient of the prior is the negative gradient of the likelihood
    prior_mean = poses.expected + sigma**2 * (curvature @ poses.expected + pull)
    return WeighedPair(poses, columns, precision, prior_mean)


def with_uncertain_poses(
    problem: LeastSquares, shared: Mapping[str, Array], normal: tuple[Array, Array], variance_factor: float
) -> Array:
    """Return the precision of the shared unknowns (P, P) with the uncertainty of two poses under all hypotheses.

    Parameters are as in `pair_poses`.
    """
    weighed = pair_poses(problem, shared, normal, variance_factor)
    if weighed is None:
        return normal[0]
    value = np.concatenate([shared[extrinsic_correction(i)] for i in range(2)])
    S, block = normal[0].copy(), np.ix_(weighed.columns, weighed.columns)
    S[block] += variance_factor * np.linalg.inv(weighed.poses.covariance_about(value)) - weighed.precision
    return S
