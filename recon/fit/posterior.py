"""How well a trajectory is known: the Gaussian approximation of the posterior at the minimum.

The covariance C of one frame's unknowns is a block of the inverse of the normal equations' matrix, found from its
banded factor by selected inversion (`recon.fit.banded`). A joint lies at origin + s p, with s the size. It moves by s J
dx with the frame's unknowns, and by p ds with the size; where the pixels tie the two, the unknowns follow the size by
-Y ds (`recon.fit.banded`), so that with q = p - s J Y

    cov(joint) = s^2 J C J' + var(s) q q'

and relative to the mean of all joints with the means of J and q taken off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recon.animal.body import Body
from recon.base.arrays import Array
from recon.fit.banded import BlockBanded, Factor, factor
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.terms import SIZE, size_of
from recon.geometry.kinematics import ROOT, YAW

_HELD = 1e8
"""Precision that holds an unknown fixed."""
_UNKNOWN = 1e-9
"""Part of its own precision that is added to an unknown where rounding leaves no covariance: nothing but a bound."""
_HARDLY = 1e-3
"""Precision of a place and a heading of which next to nothing is known (1 / m^2, 1 / rad^2)."""
_FRAMES_AT_ONCE = 256


@dataclass(frozen=True)
class Posterior:
    """Of T frames of a body with J joints and D unknowns a frame, at nominal size about the origin."""

    covariance_m2: Array
    """(T, J, 3, 3): of the joints, the size given."""
    relative_covariance_m2: Array
    """(T, J, 3, 3): of the joints relative to their mean, the size given."""
    data_share: Array
    """(J,): see `_data_share`."""
    angle_variance: Array
    """(2, T, D - 3): of the root's rotation and the joints' angles, the size given; and what it is without pixels."""
    state_by_size: Array
    """(T, D): how the states follow the size."""
    joint_by_size_m: Array
    """(T, J, 3): q of the module's text."""
    size_precision: float
    """What the pixels say of the size; 0 where they say nothing."""
    shared_sigma: dict[str, Array]
    """Standard deviations (P,) of the shared unknowns that were solved, by name."""

    @property
    def angle_data_share(self) -> Array:
        """(T, D - 3): the part of the angles' posterior precision that comes from the pixels, 0 to 1."""
        with_pixels, without = self.angle_variance
        return np.clip(1.0 - with_pixels / without, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Curvature:
    """Of a problem at its solution, T frames with D unknowns each: the factored normal equations, how the states move
    with the P unknowns that all frames share besides the size (T, D, P), a root (P, P) of their covariance, the
    precision (1 + P, 1 + P) of all that is shared, and how the states follow the size (T, D)."""

    solved: Factor
    H: BlockBanded
    others: Array
    root: Array
    shared_precision: Array
    state_by_size: Array
    size_known: float
    """The size's precision by the pixels, before the factor on variances; 0 where it is not among the unknowns."""

    def draw(self, rng: np.random.Generator) -> Array:
        """(T, D): a step from the solution, at the solution's size."""
        return self.solved.coloured(rng.normal(size=self.solved.shape)) - self.others @ (
            self.root @ rng.normal(size=len(self.root))
        )


def curvature(problem: LeastSquares, found: Estimate) -> Curvature:
    """With the unknowns that are taken for what is expected of them (`LeastSquares.doubtful`) as free."""
    problem = replace(problem, shared=[*problem.shared, *problem.doubtful], doubtful=())
    normal = problem.normal(found.states, problem.expected() | dict(found.shared))
    solved = factored(normal.H)
    Y = solved.solve_many(normal.border)
    S = normal.corner - np.tensordot(normal.border, Y, ((0, 1), (0, 1)))
    first = int(SIZE in problem.columns)  # the size comes first
    others, of_others = Y[..., first:], np.linalg.inv(S[first:, first:])
    follows, known = np.zeros(found.states.shape), 0.0
    if first:
        others_by_size = -of_others @ S[1:, 0]
        follows = -Y[..., 0] - others @ others_by_size
        known = float(S[0, 0] + S[0, 1:] @ others_by_size - problem.shared[0].sigma[0] ** -2)
    return Curvature(
        solved, normal.H, others, np.asarray(np.linalg.cholesky(of_others), dtype=float), S, follows, max(known, 0.0)
    )


def posterior(problem: LeastSquares, body: Body, found: Estimate, variance_factor: float) -> Posterior:
    """variance_factor: on all variances (errors of neighbouring frames are alike, which the cost does not know)."""
    states, size, known = found.states, size_of(found.shared), curvature(problem, found)
    solved_for = [unknown.name for unknown in problem.shared]
    problem = replace(problem, shared=[*problem.shared, *problem.doubtful], doubtful=())
    sigma = np.sqrt(variance_factor * np.diagonal(np.linalg.inv(known.shared_precision)))
    held = np.zeros(states.shape)
    held[:, ROOT] = held[:, YAW, None] = _HELD
    priors = replace(problem, terms=[term for term in problem.terms if term.name != "reprojection"], shared=())
    blocks = [known.solved.marginal_blocks()[:, 0].copy()]
    for start in range(0, len(states), _FRAMES_AT_ONCE):
        lasting = known.others[start : start + _FRAMES_AT_ONCE] @ known.root
        blocks[0][start : start + _FRAMES_AT_ONCE] += lasting @ lasting.swapaxes(1, 2)
    without = priors.normal(states).H
    blocks += [factored(H, held).marginal_blocks()[:, 0] for H in (known.H, without)]
    (absolute, relative), *shares, by_size = _of_joints(body, states, blocks, size, known.state_by_size)
    return Posterior(
        covariance_m2=variance_factor * absolute,
        relative_covariance_m2=variance_factor * relative,
        data_share=_data_share(*shares),
        angle_variance=variance_factor * _of_angles(blocks[0], without),
        state_by_size=known.state_by_size,
        joint_by_size_m=by_size,
        size_precision=known.size_known / variance_factor,
        shared_sigma={name: sigma[problem.columns[name]] for name in solved_for},
    )


def with_size(covariance_m2: Array, by_size_m: Array, size: float, size_sigma: float) -> Array:
    """Covariances (T, J, 3, 3) at nominal size, of joints that move by (T, J, 3) with it, with its uncertainty."""
    return size**2 * covariance_m2 + size_sigma**2 * by_size_m[..., :, None] * by_size_m[..., None, :]


def _data_share(with_pixels_m2: Array, without_m2: Array) -> Array:
    """(J,): the part of a joint's posterior precision that comes from the pixels, 0 to 1, the median over frames.

    It is 1 - variance / variance without pixels, both (T, J) of the joint relative to the mean of the joints with place
    and heading given: the priors alone say nothing of those. NaN for joints that cannot move then.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.median(1.0 - with_pixels_m2 / without_m2, axis=0)
    return np.clip(share, 0.0, 1.0)


def _of_angles(with_pixels: Array, without: BlockBanded) -> Array:
    """(2, T, D - 3): variances of the angles, from the states' covariance (T, D, D) and from the priors' curvature,
    which says nothing of place and heading."""
    free = np.zeros(with_pixels.shape[:2])
    free[:, ROOT] = free[:, YAW, None] = _HARDLY
    expected = factored(without, free).marginal_blocks()[:, 0]
    return np.stack([np.diagonal(C, axis1=1, axis2=2)[:, YAW:] for C in (with_pixels, expected)])


def _of_joints(
    body: Body, states: Array, blocks: list[Array], size: float, follows: Array
) -> tuple[tuple[Array, Array], Array, Array, Array]:
    """Covariances of the joints, absolute and relative, (T, J, 3, 3), from the first of the states' (T, D, D);
    variances (T, J) of the joints relative to their mean from the others; and q (T, J, 3)."""
    (T, D), J = states.shape, len(body.markers)
    absolute, relative = np.empty((T, J, 3, 3)), np.empty((T, J, 3, 3))
    variances, by_size = np.empty((2, T, J)), np.empty((T, J, 3))
    for first in range(0, T, _FRAMES_AT_ONCE):
        part = slice(first, first + _FRAMES_AT_ONCE)
        pose = body.tree.pose_with_jacobian(states[part])
        assert pose.jacobian is not None
        centred = pose.jacobian - pose.jacobian.mean(axis=1, keepdims=True)
        n = len(centred)

        def spread(jacobian: Array, own: Array, n: int = n) -> Array:
            return (jacobian.reshape(n, 3 * J, D) @ own).reshape(n, J, 3, D)

        absolute[part] = spread(pose.jacobian, blocks[0][part]) @ pose.jacobian.swapaxes(2, 3)
        relative[part] = spread(centred, blocks[0][part]) @ centred.swapaxes(2, 3)
        for variance, own in zip(variances, blocks[1:], strict=True):
            variance[part] = np.sum(spread(centred, own[part]) * centred, axis=(2, 3))
        by_size[part] = pose.points_m + size * (pose.jacobian @ follows[part, None, :, None])[..., 0]
    return (absolute, relative), variances[0], variances[1], by_size


def factored(H: BlockBanded, damping: Array | None = None) -> Factor:
    """H's factor; where nothing determines an unknown, as the place of a frame beside a single other one, it is held so
    weakly that its variance is that of nothing known."""
    try:
        return factor(H, damping)
    except np.linalg.LinAlgError:
        own = np.diagonal(H.blocks[:, 0], axis1=1, axis2=2)
        return factor(H, _UNKNOWN * np.maximum(own, 1.0) + (0.0 if damping is None else damping))
