"""Fit a motion prior to segments of motion, and evaluate its likelihood of poses."""

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

FRAMES_PER_COMPONENT = 20
"""Smallest number of frames for each component of the mixture.

A smaller component could be one short piece of one segment.
"""
POSE_FLOOR_RAD = 0.1
"""Amount added to the spread of every angle, because no reconstruction is exact.

The value maximises the likelihood of held-out segments (docs/priors.md).
"""
STILL_SIGMA_RAD = 0.15
"""Spread of angles that are constant in the data."""
MISSING_BELOW_RAD = 0.01
"""Spread below which an angle does not exist in the model behind the poses."""
_EM_ITERATIONS = 30
"""Iterations of expectation-maximisation for a mixture."""
_K_MEANS_ITERATIONS = 50
"""Iterations of k-means, from which a mixture starts."""
RIDGE_PER_ROW = 0.1
"""Ridge for each row; the value maximises the likelihood of held-out accelerations (docs/priors.md)."""
ACCELERATION_FLOOR_RAD_S2 = 10.0
"""Amount added to the spread of every acceleration."""


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
    """Fit a prior to segments of motion.

    Every segment is used a second time, mirrored left to right.

    Parameters
    ----------
    body
        The animal.
    segments
        Name, states (T, D) and frames per second of each segment. NaN frames are left out.
    name, source
        Name of the prior, and origin of the poses.
    components
        Number of components of the mixture.
    shrink
        How far the covariance of a component is moved towards the average covariance of all components, 0 to 1.
    min_speed_m_s
        Speed below which segments are listed, but not used.
    apart
        Segments of the body, such as a tail, whose movement neither follows from the pose nor affects the other angles;
        their acceleration is noise.

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
        expected = f"{FRAMES_PER_COMPONENT} frames for each component" + (f", so at most {fits}" if fits else "")
        problems.append(Problem("prior", "components", f"{components} for {n_frames} frames", expected))
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
    """Poses of N frames, of which M are inner frames, with a frame before and a frame after."""

    poses: Array
    """Angles, rad, shape (N, A)."""
    inner_poses: Array
    """Angles of the inner frames, rad, shape (M, A)."""
    rates: Array
    """Rates of the angles in the inner frames, rad/s, shape (M, A)."""
    accelerations: Array
    """Accelerations of the angles in the inner frames, rad/s², shape (M, A)."""


def _poses_and_changes(body: Body, segments: Sequence[tuple[Array, float]]) -> _PosesAndChanges:
    """Return the poses of the segments, each followed by its mirror image, and how they change."""
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
    """Return whether each angle of poses (N, A) is constant, (A,)."""
    return poses.std(axis=0) < MISSING_BELOW_RAD


def _mixture(
    poses: Array, components: int, shrink: float, extra: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return weights (K,), means (K, A) and covariances (K, A, A) of poses (N, A).

    `shrink` moves each covariance towards the average of all components; `extra` (A, A) is added.
    """
    scaled = poses / np.maximum(poses.std(axis=0), MISSING_BELOW_RAD)
    with warnings.catch_warnings(action="ignore"):  # repeated poses can leave a cluster empty
        _, nearest = kmeans2(scaled, components, _K_MEANS_ITERATIONS, minit="++", rng=rng)
    share = np.eye(components)[nearest]
    for _ in range(_EM_ITERATIONS):
        density = log_densities(poses, *_mixture_parameters(poses, share, shrink, extra))
        share = np.exp(density - logsumexp(density, axis=1, keepdims=True))
    return _mixture_parameters(poses, share, shrink, extra)


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
    """Return the drift (A, 2A) from states (M, 2A) to accelerations (M, A), and the residual covariance (A, A).

    `loose` (A,) marks the angles that neither follow from the others nor affect them; they are left out.
    """
    scale = states.std(axis=0)
    n_angles = accelerations.shape[1]
    # An angle that does not change, or changes only by the noise of the fit, explains nothing.
    moves = np.tile(~_still(states[:, :n_angles]) & ~loose, 2) & (scale > 0)
    scaled = np.where(moves, states / np.where(moves, scale, 1.0), 0.0)
    normal = scaled.T @ scaled + RIDGE_PER_ROW * len(scaled) * np.eye(scaled.shape[1])
    drift = np.linalg.solve(normal, scaled.T @ accelerations).T / np.where(moves, scale, 1.0)
    drift[loose] = 0.0
    residuals = accelerations - states @ drift.T
    covariance = np.where(loose[:, None] == loose, residuals.T @ residuals / len(residuals), 0.0)
    return drift, covariance + ACCELERATION_FLOOR_RAD_S2**2 * np.eye(n_angles)


def as_one_gaussian(prior: MotionPrior) -> MotionPrior:
    """Return a prior with a single Gaussian of poses instead of the mixture."""
    return replace(prior, weights=np.ones(1), means=prior.mean[None], covariances=prior.covariance[None])


def log_likelihood(prior: MotionPrior, states: Array) -> float:
    """Return the mean over frames of the mixture's log density (per rad^A) at states (T, D)."""
    poses = states[np.isfinite(states).all(axis=1)][:, ANGLES]
    return float(logsumexp(log_densities(poses, prior.weights, prior.means, prior.covariances), axis=1).mean())


def log_densities(poses: Array, weights: Array, means: Array, covariances: Array) -> Array:
    """Return the log of each component's density times its weight, (N, K)."""
    roots = np.linalg.cholesky(covariances)
    white = (solve_triangular(L, (poses - mean).T, lower=True) for L, mean in zip(roots, means, strict=True))
    squares = np.stack([(offset**2).sum(axis=0) for offset in white], axis=1)
    constants = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1) + 0.5 * means.shape[1] * np.log(2 * np.pi)
    return np.log(np.maximum(weights, 1e-300)) - constants - 0.5 * squares
