"""Fit a motion prior to segments of motion, and evaluate the likelihood of poses under it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from recon.animal.body import Body
from recon.animal.prior import ANGLES, MotionPrior, SegmentRow, mean_speed_m_s
from recon.base.arrays import Array, Bools
from recon.base.errors import Problem, raise_problems
from recon.base.numbers import counted

FRAMES_PER_COMPONENT = 20
"""Minimum number of frames per component of the Gaussian mixture.

A component with fewer frames could describe a short part of a single segment.
"""
POSE_FLOOR_RAD = 0.1
"""Standard deviation that is added in quadrature to every angle's own, because no reconstruction is exact.

The value maximises the likelihood of held-out segments (docs/priors.md).
"""
STILL_SIGMA_RAD = 0.15
"""Standard deviation assumed for angles that are constant in the data."""
MISSING_BELOW_RAD = 0.01
"""Standard deviation below which an angle counts as constant, because the data's skeleton does not have it."""
_EM_ITERATIONS = 30
"""Number of iterations of expectation-maximisation that fit the mixture."""
_K_MEANS_ITERATIONS = 50
"""Number of iterations of k-means, whose result initialises the mixture."""
RIDGE_PER_ROW = 0.1
"""Ridge penalty of the linear model of accelerations per frame of data.

The value maximises the likelihood of held-out accelerations (docs/priors.md).
"""
ACCELERATION_FLOOR_RAD_S2 = 10.0
"""Standard deviation that is added in quadrature to the standard deviation of every angle's acceleration."""


def fit_prior(
    body: Body,
    segments: Sequence[tuple[str, Array, float]],
    name: str = "fitted",
    source: str = "",
    components: int = 16,
    shrink: float = 0.6,
    min_speed_m_s: float = 0.0,
    apart: Sequence[str] = (),
) -> MotionPrior:
    """Return a motion prior fitted to segments of motion and to their mirror images.

    Parameters
    ----------
    body : Body
        The animal.
    segments : sequence of tuple
        Name, states (T, D) and frames per second of each segment. Frames with NaN are left out.
    name, source : str
        Name of the prior, and a description of the data.
    components : int
        Number of components of the mixture.
    shrink : float
        Weight of the mean covariance of all components in each component's covariance, 0 to 1.
    min_speed_m_s : float
        Speed below which segments are listed in the prior but not used, m/s.
    apart : sequence of str
        Segments of the body whose movement neither follows from the pose nor affects other angles, such as a tail.
        Their accelerations are modelled as noise.

    Raises
    ------
    InputError
        If there are too few frames, or `apart` names no segment with angles.
    """
    rows = tuple(
        SegmentRow(label, len(states), float(fps), speed, speed >= min_speed_m_s)
        for label, states, fps in segments
        for speed in [mean_speed_m_s(states, fps)]
    )
    used = [(states, fps) for (_, states, fps), row in zip(segments, rows, strict=True) if row.used]
    poses, inner_poses, rates, accelerations = _poses_and_changes(body, used)
    angles = body.state_names[ANGLES]
    owners = [angle.rsplit("_", 1)[0] for angle in angles]
    n_frames, problems = len(poses) // 2, []
    if n_frames < components * FRAMES_PER_COMPONENT:
        fits = n_frames // FRAMES_PER_COMPONENT
        expected = f"{FRAMES_PER_COMPONENT} frames for each component" + (
            f", so at most {fits} components" if fits else ""
        )
        problems.append(
            Problem("prior", "components", f"{counted(components, 'component')} for {n_frames} frames", expected)
        )
    expected = f"one of {', '.join(dict.fromkeys(owners))}"
    problems += [Problem("prior", "apart", repr(s), expected) for s in apart if s not in owners]
    if not len(accelerations):
        problems.append(Problem("prior", "frames", "no three consecutive frames", "segments without gaps"))
    raise_problems(problems)

    mean = poses.mean(axis=0)
    extra = np.diag(POSE_FLOOR_RAD**2 + np.where(_still(poses), STILL_SIGMA_RAD**2, 0.0))
    weights, means, covariances = _mixture(poses, components, shrink, extra, np.random.default_rng(0))
    loose = np.isin(owners, apart)
    states = np.concatenate([inner_poses - mean, rates], axis=1)
    drift, acceleration_covariance = ridge(states, accelerations, loose)
    covariance = np.cov(poses.T, bias=True) + extra
    arrays = (weights, means, covariances, mean, covariance, drift, acceleration_covariance)
    return MotionPrior(name, angles, *arrays, source=source, segments=rows)


class _PosesAndChanges(NamedTuple):
    """Poses of N frames, and the rates and accelerations in the M frames that have both neighbours."""

    poses: Array
    """Angles in all frames, rad, shape (N, A)."""
    inner_poses: Array
    """Angles in the frames with both neighbours, rad, shape (M, A)."""
    rates: Array
    """Rates of the angles in the frames with both neighbours, rad/s, shape (M, A)."""
    accelerations: Array
    """Accelerations of the angles in the frames with both neighbours, rad/s², shape (M, A)."""


def _poses_and_changes(body: Body, segments: Sequence[tuple[Array, float]]) -> _PosesAndChanges:
    """Return the poses of the segments, each followed by its mirror image, with their rates and accelerations."""
    permutation, sign = body.mirror
    empty = np.empty((0, body.n_state - 4))
    collected: tuple[list[Array], ...] = ([empty], [empty], [empty], [empty])
    for states, fps in segments:
        for z in (states[:, ANGLES], (states[:, permutation] * sign)[:, ANGLES]):
            whole = np.asarray(np.isfinite(z).all(axis=1))
            inner = np.nonzero(whole[:-2] & whole[1:-1] & whole[2:])[0] + 1
            previous, current, following = z[inner - 1], z[inner], z[inner + 1]
            moving = (following - previous) * (fps / 2), (following - 2 * current + previous) * fps**2
            for target, values in zip(collected, (z[whole], current, *moving), strict=True):
                target.append(values)
    return _PosesAndChanges(*map(np.concatenate, collected))


def _still(poses: Array) -> Bools:
    """Return a mask (A,) of the angles that are constant over poses (N, A)."""
    return poses.std(axis=0) < MISSING_BELOW_RAD


def _mixture(
    poses: Array, components: int, shrink: float, extra: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return weights (K,), means (K, A) and covariances (K, A, A) of a Gaussian mixture fitted to poses (N, A).

    `shrink` is the weight of the mean covariance of all components in each covariance. `extra` (A, A) is added to each.
    """
    scaled = poses / np.maximum(poses.std(axis=0), MISSING_BELOW_RAD)
    with warnings.catch_warnings(action="ignore"):  # repeated poses can leave a cluster empty
        _, nearest = kmeans2(scaled, components, _K_MEANS_ITERATIONS, minit="++", rng=rng)
    fraction = np.eye(components)[nearest]
    for _ in range(_EM_ITERATIONS):
        density = log_densities(poses, *_mixture_parameters(poses, fraction, shrink, extra))
        fraction = np.exp(density - logsumexp(density, axis=1, keepdims=True))
    return _mixture_parameters(poses, fraction, shrink, extra)


def _mixture_parameters(poses: Array, share: Array, shrink: float, extra: Array) -> tuple[Array, Array, Array]:
    count = np.maximum(share.sum(axis=0), 1e-9)
    means = share.T @ poses / count[:, None]
    deviations = (poses - mean for mean in means)
    scatter = np.stack(
        [
            (shares[:, None] * deviation).T @ deviation
            for shares, deviation in zip((share / count).T, deviations, strict=True)
        ]
    )
    weights = count / count.sum()
    return weights, means, (1 - shrink) * scatter + shrink * np.tensordot(weights, scatter, axes=1) + extra


def ridge(states: Array, accelerations: Array, loose: Bools) -> tuple[Array, Array]:
    """Return the drift (A, 2A) and the residual covariance (A, A) of a linear model of the accelerations (M, A).

    The model predicts accelerations from `states` (M, 2A), the deviations of the angles from their means and the rates.
    `loose` is a mask (A,) of the angles that neither follow from the others nor affect them, whose drift is 0.
    """
    scale = states.std(axis=0)
    n_angles = accelerations.shape[1]
    # An angle that is constant, or changes only by the noise of the fit, cannot predict accelerations.
    moves = np.tile(~_still(states[:, :n_angles]) & ~loose, 2) & (scale > 0)
    scaled = np.where(moves, states / np.where(moves, scale, 1.0), 0.0)
    normal = scaled.T @ scaled + RIDGE_PER_ROW * len(scaled) * np.eye(scaled.shape[1])
    drift = np.linalg.solve(normal, scaled.T @ accelerations).T / np.where(moves, scale, 1.0)
    drift[loose] = 0.0
    residuals = accelerations - states @ drift.T
    covariance = np.where(loose[:, None] == loose, residuals.T @ residuals / len(residuals), 0.0)
    return drift, covariance + ACCELERATION_FLOOR_RAD_S2**2 * np.eye(n_angles)


def as_one_gaussian(prior: MotionPrior) -> MotionPrior:
    """Return the prior with its mixture replaced by the single Gaussian of the poses."""
    return replace(prior, weights=np.ones(1), means=prior.mean[None], covariances=prior.covariance[None])


def log_likelihood(prior: MotionPrior, states: Array) -> float:
    """Return the mean over the frames of the mixture's log density (per rad^A) at states (T, D)."""
    poses = states[np.isfinite(states).all(axis=1)][:, ANGLES]
    return float(logsumexp(log_densities(poses, prior.weights, prior.means, prior.covariances), axis=1).mean())


def log_densities(poses: Array, weights: Array, means: Array, covariances: Array) -> Array:
    """Return the logarithm of each mixture component's weight times its density at poses (N, A), shape (N, K)."""
    roots = np.linalg.cholesky(covariances)
    white = (solve_triangular(L, (poses - mean).T, lower=True) for L, mean in zip(roots, means, strict=True))
    squares = np.stack([(offset**2).sum(axis=0) for offset in white], axis=1)
    constants = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1) + 0.5 * means.shape[1] * np.log(2 * np.pi)
    return np.log(np.maximum(weights, 1e-300)) - constants - 0.5 * squares
