"""Gaussian mixtures of poses, by expectation-maximisation."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from recon.animal.prior.model import ANGLES, MotionPrior
from recon.base.arrays import Array, Bools

MISSING_BELOW_RAD = 0.01
"""Angles that spread by less are no part of the model that the poses come from."""
_EM_ITERATIONS, _K_MEANS_ITERATIONS = 30, 50


def still(poses: Array) -> Bools:
    """(A,): angles of poses (N, A) that do not move."""
    return poses.std(axis=0) < MISSING_BELOW_RAD


def mixture(
    poses: Array, components: int, shrink: float, extra: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Weights (K,), means (K, A), covariances (K, A, A) of poses (N, A).

    shrink: how far each covariance is moved towards the average within all components; extra (A, A): added to it.
    """
    scaled = poses / np.maximum(poses.std(axis=0), MISSING_BELOW_RAD)
    with warnings.catch_warnings(action="ignore"):  # of a cluster that stays empty, where poses repeat
        _, nearest = kmeans2(scaled, components, _K_MEANS_ITERATIONS, minit="++", rng=rng)
    share = np.eye(components)[nearest]
    for _ in range(_EM_ITERATIONS):
        density = _log_densities(poses, *_mixture_parameters(poses, share, shrink, extra))
        share = np.exp(density - logsumexp(density, axis=1, keepdims=True))
    return _mixture_parameters(poses, share, shrink, extra)


def log_likelihood(prior: MotionPrior, states: Array) -> float:
    """Mean over frames of the natural logarithm of the mixture's density (per rad^A) at states (T, D)."""
    poses = states[np.isfinite(states).all(axis=1)][:, ANGLES]
    return float(logsumexp(_log_densities(poses, prior.weights, prior.means, prior.covariances), axis=1).mean())


def _mixture_parameters(poses: Array, share: Array, shrink: float, extra: Array) -> tuple[Array, Array, Array]:
    count = np.maximum(share.sum(axis=0), 1e-9)
    means = share.T @ poses / count[:, None]
    off = (poses - mean for mean in means)
    own = np.stack([(part[:, None] * one).T @ one for part, one in zip((share / count).T, off, strict=True)])
    weights = count / count.sum()
    return weights, means, (1 - shrink) * own + shrink * np.tensordot(weights, own, axes=1) + extra


def _log_densities(poses: Array, weights: Array, means: Array, covariances: Array) -> Array:
    """(N, K): the logarithm of each component's density times its weight."""
    roots = np.linalg.cholesky(covariances)
    white = (solve_triangular(L, (poses - mean).T, lower=True) for L, mean in zip(roots, means, strict=True))
    squares = np.stack([(one**2).sum(axis=0) for one in white], axis=1)
    constants = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1) + 0.5 * means.shape[1] * np.log(2 * np.pi)
    return np.log(np.maximum(weights, 1e-300)) - constants - 0.5 * squares
