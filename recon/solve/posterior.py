"""How well a trajectory is known: the Gaussian approximation of the posterior at the minimum.

The covariance C of one frame's unknowns is a block of the inverse of the normal equations' matrix, found from its
banded factor by selected inversion (`recon.banded`). A joint p (in the level frame, so from the camera) moves by J dx,
and by p ds / s when the size s changes, which scales the scene:

    cov(p) = s^2 J C J' + var(s) p p'

and relative to the mean of all joints with the means of J and p taken off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recon.banded import BlockBanded, Factor, factor
from recon.body import Body
from recon.kinematics import ROOT, YAW
from recon.solve.problem import Problem

Array = NDArray[np.float64]

_HELD = 1e8
"""Precision that holds an unknown fixed."""
_UNKNOWN = 1e-9
"""Part of its own precision that is added to an unknown where rounding leaves no covariance: nothing but a bound."""
_FRAMES_AT_ONCE = 256


@dataclass(frozen=True)
class Posterior:
    """covariance_m2, relative_covariance_m2 (T, J, 3, 3), level frame, at nominal size: of the joints, and relative to
    their mean, the size given. data_share (J,): see `data_share`."""

    covariance_m2: Array
    relative_covariance_m2: Array
    data_share: Array


def posterior(problem: Problem, body: Body, states: Array, variance_factor: float) -> Posterior:
    """variance_factor: on all variances (errors of neighbouring frames are alike, which the cost does not know)."""
    H, _ = problem.normal(states)
    absolute, relative = _joints(H, body, states, None)
    return Posterior(variance_factor * absolute, variance_factor * relative, data_share(problem, H, body, states))


def with_size(covariance_m2: Array, points_m: Array, size: float, size_sigma: float) -> Array:
    """Covariances (T, J, 3, 3) at nominal size, of points (T, J, 3), with a size and its uncertainty."""
    return size**2 * covariance_m2 + size_sigma**2 * points_m[..., :, None] * points_m[..., None, :]


def data_share(problem: Problem, H: BlockBanded, body: Body, states: Array) -> Array:
    """(J,): the part of a joint's posterior precision that comes from the pixels, 0 to 1, the median over frames.

    It is 1 - variance / variance without pixels, both of the joint relative to the mean of the joints with place and
    heading given: the priors alone say nothing of those. NaN for joints that cannot move then.
    """
    held = np.zeros(states.shape)
    held[:, ROOT] = held[:, YAW, None] = _HELD
    priors = replace(problem, terms=[term for term in problem.terms if term.name != "reprojection"])
    without, _ = priors.normal(states)
    variances = [np.trace(_joints(h, body, states, held)[1], axis1=2, axis2=3) for h in (H, without)]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.median(1.0 - variances[0] / variances[1], axis=0)
    return np.clip(share, 0.0, 1.0)


def _joints(H: BlockBanded, body: Body, states: Array, damping: Array | None) -> tuple[Array, Array]:
    """Covariances of the joints, absolute and relative, (T, J, 3, 3)."""
    own = _factored(H, damping).marginal_blocks()[:, 0]
    T, J = len(own), len(body.markers)
    absolute, relative = np.empty((T, J, 3, 3)), np.empty((T, J, 3, 3))
    for first in range(0, T, _FRAMES_AT_ONCE):
        part = slice(first, first + _FRAMES_AT_ONCE)
        jacobian = body.tree.pose_with_jacobian(states[part]).jacobian
        assert jacobian is not None
        n, _, _, D = jacobian.shape
        for result, by_state in (
            (absolute, jacobian),
            (relative, jacobian - jacobian.mean(axis=1, keepdims=True)),
        ):
            spread = (by_state.reshape(n, 3 * J, D) @ own[part]).reshape(n, J, 3, D)
            result[part] = spread @ by_state.swapaxes(2, 3)
    return absolute, relative


def _factored(H: BlockBanded, damping: Array | None) -> Factor:
    """H's factor; where nothing determines an unknown, as the place of a frame beside a single other one, it is held so
    weakly that its variance is that of nothing known."""
    try:
        return factor(H, damping)
    except np.linalg.LinAlgError:
        own = np.diagonal(H.blocks[:, 0], axis1=1, axis2=2)
        return factor(H, _UNKNOWN * np.maximum(own, 1.0) + (0.0 if damping is None else damping))
