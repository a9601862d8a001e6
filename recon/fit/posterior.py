"""How well a trajectory is known: the Gaussian approximation of the posterior at the minimum.

The covariance C of one frame's unknowns is a block of the inverse of the normal equations' matrix. A joint lies at
origin + s p, with s the size. It moves by s J dx with the frame's unknowns, and by p ds with the size; where the pixels
tie the two, the unknowns follow the size by -Y ds (`recon.fit.banded`), so that with q = p - s J Y

    cov(joint) = s^2 J C J' + var(s) q q'

and relative to the mean of all joints with the means of J and q taken off.

**Misfit of the prior**, and how far the prior counts after that. At a minimum the angles lie off what the prior expects
by whitened residuals r. With P the prior's curvature, H that of all terms and n unknowns, where the prior fits |r|^2 is
n - tr(H^-1 P), the number of unknowns that the pixels say, times for how many frames an error lasts (D. MacKay,
*Bayesian interpolation*, 1992). What it is relative to that is the most likely scale of the prior's variances.

**Regions and intervals.** A clip's noise and the weight of its prior are themselves estimated, which makes a Student's
t of a Gaussian: with S the covariance of an error e in k dimensions, e' S^-1 e is k (nu - 2) / nu times a variable of
Fisher's F with k and nu degrees of freedom."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from recon.animal import ANGLES, Body
from recon.base.arrays import Array
from recon.fit import constants
from recon.fit.banded import Window, eliminated
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.terms import COMMON_KEYPOINT_BIAS, PRIOR_TERMS, SIZE, Reprojection, size_of
from recon.geometry.kinematics import ROOT, YAW

_HELD = 1e8
"""Precision that holds an unknown fixed."""
_HARDLY = 1e-3
"""Precision of a place and a heading of which next to nothing is known (1 / m^2, 1 / rad^2)."""
_FRAMES_AT_ONCE = 256
_WIDER_ROUNDS, _AS_EXPECTED = 10, 8
"""Rounds of expectation and maximisation, and how many unknowns the expectation of their variance is worth."""
_NOISE_ROUNDS, _NOISE_FACTOR = 2, (0.05, 4.0)
"""The same of the noise of detections about their keypoints' bias, and what a round makes of its variance."""


@dataclass(frozen=True)
class Posterior:
    """The covariance of T frames of a body with J joints and D unknowns a frame, at nominal size about the origin."""

    covariance_m2: Array
    """(T, J, 3, 3): of the joints, the size given."""
    relative_covariance_m2: Array
    """(T, J, 3, 3): of the joints relative to their mean, the size given."""
    data_share: Array
    """How much of each joint's precision comes from the pixels, shape (J,): see `_data_share`."""
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
class _Curvature:
    """The curvature of a problem at its solution: the windows of the normal equations, a root (P, P) of the covariance
    of what all frames share besides the size, and the precision (1 + P, 1 + P) of all that is shared."""

    eliminated: Callable[[], Iterable[Window]]
    root: Array
    others_by_size: Array
    """(P,): how the others follow the size."""
    shared_precision: Array
    size_known: float
    """The size's precision by the pixels, before the factor on variances; 0 where it is not among the unknowns."""
    beyond_m2: Array | float
    """(J,): by how much the variance of the keypoint bias that all cameras share is larger than expected."""
    expected_precision: Array
    """(1 + P,): the part of the precision that is expected of each, before anything is seen."""
    pull: Array
    """(1 + P,): the gradient of all that is shared, with all else at its minimum."""

    def windows(self) -> Iterator[tuple[Window, Array, Array]]:
        """Each with how its n frames move with the P unknowns besides the size (n, D, P), and with the size (n, D)."""
        size = len(self.shared_precision) - len(self.root)  # it comes first
        for window in self.eliminated():
            follows = window.solved()[..., 1:]
            others = follows[..., size:]
            by_size = -follows[..., 0] - others @ self.others_by_size if size else np.zeros(others.shape[:2])
            yield window, others, by_size


def curvature(problem: LeastSquares, found: Estimate, variance_factor: float) -> _Curvature:
    """With the doubtful unknowns as free, and the keypoint bias that all cameras share as wide as they show it."""
    problem = replace(problem, shared=[*problem.shared, *problem.doubtful], doubtful=())
    normals = problem.normals(found.states, problem.expected() | dict(found.shared))

    def windows() -> Iterable[Window]:
        return eliminated(normals(), bounded=True)

    reduced = np.sum([window.reduced() for window in windows()], axis=0)
    S, first, beyond_m2 = reduced[:, :-1].copy(), int(SIZE in problem.columns), 0.0
    expected = np.concatenate([np.zeros(0), *(unknown.sigma**-2.0 for unknown in problem.shared)])
    if (own := problem.columns.get(COMMON_KEYPOINT_BIAS)) is not None:
        variance_m2 = 1.0 / expected[own]
        wider = _wider(S, reduced[:, -1], own, variance_m2, variance_factor)
        S[own, own] += np.diag((1.0 / wider - 1.0) / variance_m2)
        expected[own] /= wider
        beyond_m2 = (wider - 1.0) * variance_m2[::3]
    of_others, known = np.linalg.inv(S[first:, first:]), 0.0
    others_by_size = np.zeros(len(of_others))
    if first:
        others_by_size = -of_others @ S[1:, 0]
        known = float(S[0, 0] + S[0, 1:] @ others_by_size - problem.shared[0].sigma[0] ** -2)
    root = np.asarray(np.linalg.cholesky(of_others), dtype=float)
    return _Curvature(windows, root, others_by_size, S, max(known, 0.0), beyond_m2, expected, reduced[:, -1])


def _wider(S: Array, g: Array, own: slice, variance: Array, variance_factor: float) -> float:
    """The likeliest factor on the expected variances of some shared unknowns, by expectation and maximisation; 1 at
    least."""
    rest = np.delete(np.arange(len(g)), own)
    across = np.linalg.solve(S[np.ix_(rest, rest)], S[rest, own]).T
    precision, pull, wider = S[own, own] - across @ S[rest, own], g[own] - across @ g[rest], 1.0
    for _ in range(_WIDER_ROUNDS):
        of_own = np.linalg.inv(precision + np.diag((1.0 / wider - 1.0) / variance))
        squares = ((of_own @ pull) ** 2 / variance_factor + np.diagonal(of_own)) / variance
        wider = float((squares.sum() + _AS_EXPECTED) / (len(squares) + _AS_EXPECTED))
    return max(wider, 1.0)


def about_keypoint_bias(problem: LeastSquares, found: Estimate, variance_factor: float) -> LeastSquares:
    """The problem of several cameras with the noise that detections have about their keypoints' bias. A solution takes
    the bias for zero, so that its residuals hold both, and as noise the bias would be counted twice.

    The noise's variance is the likeliest one: what the squared residuals are with the bias that they ask for, over the
    number of detections less those that show the bias, as errors last."""
    if COMMON_KEYPOINT_BIAS not in [unknown.name for unknown in problem.doubtful]:
        return problem
    for _ in range(_NOISE_ROUNDS):
        known, pictures = curvature(problem, found, variance_factor), problem.only(("reprojection",))
        covariance = np.linalg.inv(known.shared_precision)
        bias, expected = covariance @ known.pull, known.expected_precision
        squares = pictures.squares(found.states, found.shared) - float(known.pull @ bias + expected @ bias**2)
        show_bias = variance_factor * (len(bias) - float(expected @ np.diagonal(covariance)))
        seen = [term for term in problem.terms if isinstance(term, Reprojection)]
        free = max(2 * sum(int(term.view.present.sum()) for term in seen) - show_bias, 1.0)
        factor = float(np.clip(constants.NOISE_ABOUT_BIAS * squares / free, *_NOISE_FACTOR))
        seen = [replace(term, view=replace(term.view, confidence=term.view.confidence / factor)) for term in seen]
        problem = replace(problem, terms=[*seen, *(t for t in problem.terms if not isinstance(t, Reprojection))])
    return problem


def posterior(problem: LeastSquares, body: Body, found: Estimate, variance_factor: float) -> Posterior:
    """variance_factor: on all variances (errors of neighbouring frames are alike, which the cost does not know)."""
    states, size, known = found.states, size_of(found.shared), curvature(problem, found, variance_factor)
    solved_for = [unknown.name for unknown in problem.shared]
    sigma = np.sqrt(variance_factor * np.diagonal(np.linalg.inv(known.shared_precision)))
    columns = replace(problem, shared=[*problem.shared, *problem.doubtful]).columns
    frames = replace(problem, shared=(), doubtful=())
    priors = replace(frames, terms=[term for term in problem.terms if term.name != "reprojection"])
    (T, D), J, without = states.shape, len(body.markers), priors.normals(states)
    place = np.isin(np.arange(D), [*range(D)[ROOT], YAW])  # a frame's, and its heading: priors say nothing of them
    absolute, relative, by_size = np.empty((T, J, 3, 3)), np.empty((T, J, 3, 3)), np.empty((T, J, 3))
    state_by_size, angles, variances = np.empty((T, D)), np.empty((2, T, D - YAW)), np.empty((2, T, J))
    for window, others, follows in known.windows():  # one after the other: a window is large
        own, rows = window.marginal_blocks()[:, 0], window.rows
        for first in range(0, len(own), _FRAMES_AT_ONCE):
            lasting = others[first : first + _FRAMES_AT_ONCE] @ known.root
            own[first : first + _FRAMES_AT_ONCE] += lasting @ lasting.swapaxes(1, 2)
        absolute[rows], relative[rows], by_size[rows] = _of_joints(body, states[rows], own, size, follows)
        angles[0, rows], state_by_size[rows] = np.diagonal(own, axis1=1, axis2=2)[:, YAW:], follows
    for of, normals in zip(variances, (frames.normals(states, found.shared)(), without()), strict=True):
        for window in eliminated(normals, np.where(place, _HELD, 0.0), bounded=True):
            of_joints = _of_joints(body, states[window.rows], window.marginal_blocks()[:, 0])
            of[window.rows] = np.trace(of_joints[1], axis1=2, axis2=3)
    for window in eliminated(without(), np.where(place, _HARDLY, 0.0), bounded=True):
        angles[1, window.rows] = np.diagonal(window.marginal_blocks()[:, 0], axis1=1, axis2=2)[:, YAW:]
    for covariance in (absolute, relative):  # in place: those of a long clip are large
        covariance += np.multiply.outer(known.beyond_m2, np.eye(3))
        covariance *= variance_factor
    return Posterior(
        covariance_m2=absolute,
        relative_covariance_m2=relative,
        data_share=_data_share(*variances),
        angle_variance=variance_factor * angles,
        state_by_size=state_by_size,
        joint_by_size_m=by_size,
        size_precision=known.size_known / variance_factor,
        shared_sigma={name: sigma[columns[name]] for name in solved_for},
    )


def with_size(covariance_m2: Array, by_size_m: Array, size: float, size_sigma: float) -> Array:
    """The covariances of joints that move by (T, J, 3) with the size, at that and with its uncertainty. In place."""
    for first in range(0, len(covariance_m2), _FRAMES_AT_ONCE):
        part = slice(first, first + _FRAMES_AT_ONCE)
        q = by_size_m[part]
        covariance_m2[part] = size_sigma**2 * q[..., :, None] * q[..., None, :] + size**2 * covariance_m2[part]
    return covariance_m2


def _data_share(with_pixels_m2: Array, without_m2: Array) -> Array:
    """(J,): the part of a joint's posterior precision that comes from the pixels, 0 to 1, the median over frames of
    1 - variance / variance without pixels, (T, J), of the joint relative to the mean of the joints with place and
    heading given. NaN for joints that cannot move then."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.median(1.0 - with_pixels_m2 / without_m2, axis=0)
    return np.clip(share, 0.0, 1.0)


def _of_joints(
    body: Body, states: Array, own: Array, size: float = 1.0, follows: Array | None = None
) -> tuple[Array, Array, Array]:
    """Covariances of the joints, absolute and relative, (T, J, 3, 3), from the states' (T, D, D); and q (T, J, 3)."""
    T, J = len(states), len(body.markers)
    absolute, relative, by_size = np.empty((T, J, 3, 3)), np.empty((T, J, 3, 3)), np.empty((T, J, 3))
    for first in range(0, T, _FRAMES_AT_ONCE):
        part = slice(first, first + _FRAMES_AT_ONCE)
        pose = body.tree.pose_with_jacobian(states[part])
        centred = pose.jacobian - pose.jacobian.mean(axis=1, keepdims=True)
        for found, jacobian in ((absolute, pose.jacobian), (relative, centred)):
            found[part] = jacobian @ own[part, None] @ jacobian.swapaxes(2, 3)
        if follows is not None:
            by_size[part] = pose.points_m + size * (pose.jacobian @ follows[part, None, :, None])[..., 0]
    return absolute, relative, by_size


@dataclass(frozen=True)
class PriorMisfit:
    """The squared residuals relative to those where the prior fits, and how many unknowns the pixels say."""

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
        by_chance = (1.0 - variance + constants.MISFIT_SIGMAS * variance**0.5) ** 3
        return self.level >= max(constants.MISFIT_LEVEL, by_chance)


def prior_misfit_of(problem: LeastSquares, found: Estimate) -> PriorMisfit:
    """The misfit of the prior as the problem weighs it, at its minimum."""
    prior, said = problem.only(PRIOR_TERMS), 0.0
    windows = eliminated(problem.normals(found.states, found.shared)(), bounded=True)
    for window, of_prior in zip(windows, prior.normals(found.states)(), strict=True):
        both = window.marginal_blocks() * of_prior.blocks
        said += float(both[:, 0].sum() + 2 * both[:, 1:].sum())
    freedom = max(found.states[:, ANGLES].size - said, 1.0)
    return PriorMisfit(prior.squares(found.states) / freedom / constants.MISFIT_USUAL, freedom)


DEGREES_OF_FREEDOM = 7.0
"""nu: the most likely one for the errors of 28 real views (`benchmarks/regions.py`)."""
_ROUNDING_M2 = 1e-12
"""Added to variances: those of a pose relative to its own middle may be singular to rounding."""


def radius(level: float, dimensions: int = 1, nu: float = DEGREES_OF_FREEDOM) -> float:
    """In standard deviations (square root of e' S^-1 e), of the region that holds a share `level` of the truth."""
    return float(np.sqrt(dimensions * fdtri(dimensions, nu, level) * (nu - 2) / nu))


def sigmas(error: Array, covariance: Array) -> Array:
    """(...): how many standard deviations errors (..., k) with covariances (..., k, k) are, NaN where not known."""
    known = np.isfinite(error).all(axis=-1) & np.isfinite(covariance).all(axis=(-2, -1))
    off = np.full(known.shape, np.nan)
    e, S = error[known], covariance[known] + _ROUNDING_M2 * np.eye(error.shape[-1])
    off[known] = np.sqrt(np.sum(e * np.linalg.solve(S, e[..., None])[..., 0], axis=-1))
    return off
