"""The statistics that a prior is made of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from recon.animal.body import Body
from recon.base.arrays import Array

ANGLES = slice(4, None)
"""The angles that a prior is about, in the state."""
NONE = "none"
"""The name of the prior that knows the body's own expectations only."""
LARGEST = 1e12
"""Of a number in a prior: more can only be damage."""
SHAPES = {
    "weights": "K",
    "means": "KA",
    "covariances": "KAA",
    "mean": "A",
    "covariance": "AA",
    "drift": "AB",  # B: 2A
    "acceleration_covariance": "AA",
}
"""The arrays of a prior, with their shapes."""


@dataclass(frozen=True)
class SegmentRow:
    """One continuous piece of motion that was at hand; used: whether the prior was fitted to it."""

    name: str
    frames: int
    fps: float
    speed_m_s: float
    used: bool


@dataclass(frozen=True, eq=False)
class MotionPrior:
    """Statistics of A angles in rad, with K components. Raises ValueError, naming everything that does not fit."""

    name: str
    angles: tuple[str, ...]
    """(A,): state_names[4:] of the body."""
    weights: Array
    """(K,), means (K, A) and covariances (K, A, A): Gaussian mixture of the poses."""
    means: Array
    covariances: Array
    mean: Array
    """(A,), and covariance (A, A): one Gaussian of the same poses."""
    covariance: Array
    drift: Array
    """(A, 2A): d2z/dt2 = drift @ [z - mean, dz/dt] + noise, in rad and s."""
    acceleration_covariance: Array
    """(A, A): of that noise."""
    source: str
    """Where the poses come from."""
    segments: tuple[SegmentRow, ...] = ()
    """What was at hand."""

    def __post_init__(self) -> None:
        wrong = misfits({name: getattr(self, name) for name in SHAPES}, len(self.angles))
        if wrong:
            raise ValueError("; ".join(f"{field}: {found}, expected {expected}" for field, found, expected in wrong))


def misfits(arrays: dict[str, Array], n_angles: int) -> list[tuple[str, str, str]]:
    """(field, found, expected) of everything that keeps arrays from being a prior of that many angles."""
    problems = []
    lengths = {"A": n_angles, "B": 2 * n_angles, "K": len(np.atleast_1d(arrays["weights"]))}
    if not lengths["K"]:
        return [("weights", "none", "one for each component")]
    for name, shape in SHAPES.items():
        array, expected = arrays[name], tuple(lengths[letter] for letter in shape)
        if array.shape != expected:
            problems.append((name, f"shape {array.shape}", f"{expected} for {lengths['K']} components"))
        elif not (np.abs(array) < LARGEST).all():
            problems.append((name, "numbers that are not finite, or beyond all reason", "finite numbers"))
        elif shape.endswith("AA") and not _is_positive_definite(array):
            problems.append((name, "a matrix that is not positive definite", "covariances"))
        elif name == "weights" and ((array < 0).any() or abs(array.sum() - 1) > 1e-5):
            problems.append((name, f"{array.min():g} and more, {array.sum():g} in all", "shares of 1"))
    return problems


def _is_positive_definite(matrices: Array) -> bool:
    symmetric = np.allclose(matrices, matrices.swapaxes(-1, -2), rtol=0, atol=1e-6 * np.abs(matrices).max())
    return symmetric and bool(np.linalg.eigvalsh(matrices).min() > 0)


def prior_from_body(body: Body) -> MotionPrior:
    """What is used where no prior was learned: each angle on its own, as the skeleton file expects it."""
    mean, covariance, n = body.mean_rad, np.diag(body.sigma_rad**2), len(body.mean_rad)
    dynamics = np.zeros((n, 2 * n)), np.diag(body.acceleration_rad_s2**2)
    arrays = (np.ones(1), mean[None], covariance[None], mean, covariance, *dynamics)
    return MotionPrior(NONE, body.state_names[ANGLES], *arrays, source=f"skeleton {body.name}")


def as_one_gaussian(prior: MotionPrior) -> MotionPrior:
    """The same prior with its one Gaussian of poses in the place of the mixture."""
    return replace(prior, weights=np.ones(1), means=prior.mean[None], covariances=prior.covariance[None])


def mean_speed_m_s(states: Array, fps: float) -> float:
    """Mean horizontal speed of the root over states (T, D), 0 if no two frames follow each other."""
    steps = np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1) * fps
    return float(np.nanmean(steps)) if np.isfinite(steps).any() else 0.0


def log_likelihood(prior: MotionPrior, states: Array) -> float:
    """Mean over frames of the natural logarithm of the mixture's density (per rad^A) at states (T, D)."""
    poses = states[np.isfinite(states).all(axis=1)][:, ANGLES]
    return float(logsumexp(log_densities(poses, prior.weights, prior.means, prior.covariances), axis=1).mean())


def log_densities(poses: Array, weights: Array, means: Array, covariances: Array) -> Array:
    """(N, K): the logarithm of each component's density times its weight."""
    roots = np.linalg.cholesky(covariances)
    white = (solve_triangular(L, (poses - mean).T, lower=True) for L, mean in zip(roots, means, strict=True))
    squares = np.stack([(one**2).sum(axis=0) for one in white], axis=1)
    constants = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1) + 0.5 * means.shape[1] * np.log(2 * np.pi)
    return np.log(np.maximum(weights, 1e-300)) - constants - 0.5 * squares
