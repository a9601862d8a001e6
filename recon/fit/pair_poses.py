"""Weigh explanations of the poses of two cameras: as calibrated, or turned about some of their axes.

The detections of two cameras leave some errors of their poses open. A turn of one camera about the vertical is visible
only in the animal's apparent size, and it is often open which of the two cameras is turned. The errors have heavy
tails: about each axis of each camera, the rotation is that of usual calibrations or, with probability
`constants.TURNED_SHARE`, much larger. An explanation says about which axes the cameras are turned. Under each
explanation the likelihood and the prior of the errors are Gaussian, so the marginal likelihood and the posterior of the
errors have a closed form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from recon.base.arrays import Array, Bools, Index
from recon.fit import constants
from recon.fit.least_squares import LeastSquares
from recon.fit.terms import extrinsic_correction

_ROTATIONS = np.tile([True, True, True, False, False, False], 2)
"""Which of the twelve errors of two poses are rotations."""


@dataclass(frozen=True, eq=False)
class PairPoses:
    """Explanations of the errors (12,) of two cameras' poses: three angles and a shift each, as in `View.corrected`."""

    is_turned: Bools
    """(E, 2, 3): about which axes each of the two cameras is turned, for each of E explanations."""
    weight: Array
    """(E,): probabilities of the explanations."""
    mean: Array
    """(E, 12): expected errors."""
    covariance: Array
    """(E, 12, 12): covariances of the errors."""

    @classmethod
    def weigh(cls, precision: Array, pull: Array, usual_sigma: Array) -> PairPoses:
        """Weigh all explanations.

        Parameters
        ----------
        precision, pull
            (12, 12), (12,): curvature and gradient of the negative log-likelihood at errors of 0.
        usual_sigma
            (12,): usual standard deviations of the errors.
        """
        is_turned = np.array([*product([False, True], repeat=6)]).reshape(-1, 2, 3)
        sigma = np.repeat(usual_sigma[None], len(is_turned), axis=0)
        sigma[:, _ROTATIONS] = np.where(is_turned.reshape(-1, 6), constants.MISPLACED_RAD, sigma[:, _ROTATIONS])
        covariance = np.asarray(np.linalg.inv(precision + np.eye(12) * sigma[:, None] ** -2.0), dtype=float)
        mean = -covariance @ pull
        log_det = np.linalg.slogdet(np.eye(12) + precision * sigma[:, None] ** 2)[1]
        share = np.where(is_turned, constants.TURNED_SHARE, 1.0 - constants.TURNED_SHARE)
        log_weight = np.log(share).sum(axis=(1, 2)) - 0.5 * (mean @ pull + log_det)
        weight = np.exp(log_weight - log_weight.max())
        return cls(is_turned, weight / weight.sum(), mean, covariance)

    def covariance_about(self, value: Array) -> Array:
        """Return the second moments (12, 12) of the errors about a value (12,)."""
        deviation = self.mean - value
        products = self.covariance + deviation[:, :, None] * deviation[:, None]
        return np.asarray(np.einsum("e,eij->ij", self.weight, products))

    @property
    def first_is_turned(self) -> bool:
        """Return whether the first camera is turned with a probability above `constants.FIRST_TURNED`."""
        return float(self.weight @ self.is_turned[:, 0].any(axis=1)) > constants.FIRST_TURNED

    def rotations_rad(self) -> Array:
        """Return the standard deviations (2, 3) of the two cameras' rotations about each axis, rad.

        The first camera defines the world unless it is turned. If it is open which of the two is turned, the second one
        is assumed to be.
        """
        turned = np.einsum("e,eca->ca", self.weight, self.is_turned)
        if not self.first_is_turned:
            turned = np.array([np.zeros(3), np.minimum(turned.sum(axis=0), 1.0)])
        usual_rad = constants.SHARE_OF_PAIR * constants.CALIBRATED_RAD
        return np.sqrt(turned * constants.MISPLACED_RAD**2 + (1.0 - turned) * usual_rad**2)


def pair_poses(
    problem: LeastSquares, shared: Mapping[str, Array], normal: tuple[Array, Array], variance_factor: float
) -> tuple[PairPoses, Index, Array] | None:
    """Return the weighed explanations of two cameras' poses, the poses' columns, and their marginal precision.

    Parameters
    ----------
    problem
        A problem in which the poses of both cameras are shared unknowns. Otherwise there is no result.
    shared
        Values of the shared unknowns.
    normal
        (P, P), (P,): precision and gradient of all shared unknowns at these values.
    variance_factor
        Factor on all variances, which the problem does not know.
    """
    names = [extrinsic_correction(i) for i in range(2)]
    if not all(name in problem.columns for name in names):
        return None
    S, gradient = normal
    columns = np.concatenate([np.arange(len(S), dtype=np.intp)[problem.columns[name]] for name in names])
    rest = np.delete(np.arange(len(S)), columns)
    by_rest = np.linalg.solve(S[np.ix_(rest, rest)], S[np.ix_(rest, columns)]).T
    precision = S[np.ix_(columns, columns)] - by_rest @ S[np.ix_(rest, columns)]
    value = np.concatenate([shared[name] for name in names])
    pull = gradient[columns] - by_rest @ gradient[rest] - precision @ value
    expected = np.concatenate([unknown.sigma for unknown in problem.shared if unknown.name in names])
    likelihood = precision - np.diag(expected**-2.0)
    usual_sigma = expected * np.sqrt(variance_factor)
    usual_sigma[_ROTATIONS] = constants.SHARE_OF_PAIR * constants.CALIBRATED_RAD
    poses = PairPoses.weigh(likelihood / variance_factor, pull / variance_factor, usual_sigma)
    return poses, columns, precision


def with_uncertain_poses(
    problem: LeastSquares, shared: Mapping[str, Array], normal: tuple[Array, Array], variance_factor: float
) -> Array:
    """Return the precision of the shared unknowns (P, P) with two poses as uncertain as all explanations leave them.

    Parameters are as in `pair_poses`.
    """
    weighed = pair_poses(problem, shared, normal, variance_factor)
    if weighed is None:
        return normal[0]
    poses, columns, precision = weighed
    value = np.concatenate([shared[extrinsic_correction(i)] for i in range(2)])
    S = normal[0].copy()
    S[np.ix_(columns, columns)] += variance_factor * np.linalg.inv(poses.covariance_about(value)) - precision
    return S
