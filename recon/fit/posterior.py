"""Compute the uncertainty of a trajectory, as a Gaussian approximation of the posterior at the minimum.

**Input and output.** A fit calls `posterior_with_reestimated_noise` with the problem and the minimum of each segment.
The resulting `Posterior` has the covariances of the joints, the variances of the angles and their information
fractions, for a given size of the animal. `with_size` adds the uncertainty of the size.

**Idea.** Near its minimum the cost is almost quadratic, so that the inverse of its curvature is the covariance of all
unknowns (part 1). Derivatives of the joints turn it into the covariance of the joints (part 2). Errors that persist
over many frames are added (part 3), and a comparison with the variances without pixels gives the information fractions
(part 4). The angles' covariances give the variances of the flexions of the anatomical joints, most of which follow
from several angles whose errors are correlated.

During a fit, `prior_misfit_of` gives the new weight of the prior (part 5), and `pair_poses_of` the probabilities of
hypotheses about the poses of two cameras (`recon.fit.pair_poses`). Regions and
intervals follow from the covariances by `recon.fit.regions`.

**1. Covariance of the states.** Let H be the curvature of the cost at the minimum with respect to the states x of all
frames, B the mixed curvature between x and the shared unknowns s, Y = H^-1 B, and S the curvature with respect to s
with x eliminated (`recon.fit.banded`). The covariance of s is S^-1. If s changes by ds, x changes by -Y ds. The
covariance of a frame is therefore its block of H^-1, for a fixed s, plus Y S^-1 Y'. The size is one of the shared
unknowns. It is kept separate, because the ground may determine it further. `curvature` computes these parts, and
`posterior` adds them up frame by frame.

**2. Covariance of the joints.** A joint lies at origin + size p. Let G be the Jacobian of p with respect to the frame's
unknowns, and let a be the derivative of these unknowns with respect to the size (`state_by_size`). With q = p + size G
a,

    cov(joint) = size^2 G C G' + var(size) q q'

where C is the frame's covariance at a given size. The covariance relative to the mean of all joints is the same with G
and q minus their means over the joints. Unknown lengths are appended to the frame's unknowns in G, C and a. Two parts
are the same in every frame: the variance of the common keypoint bias beyond its expected variance (`excess_bias_m2`),
and the variance of a marker about the same point of the real animal (`Body.marker_sigma_m`).

**3. Persistent errors.** The cost treats the errors of neighbouring frames as independent, but they are correlated. All
variances except that of a marker are therefore multiplied by `variance_factor`, the correlation time in frames. A
keypoint bias is constant over the whole clip. Each camera has a bias of its own, and several cameras also have a common
bias. A camera's own bias is an unknown of the posterior only, and so is the common bias unless the fit estimates the
body's shape. The expected variance of the common bias is increased if the detections show a larger bias
(`_bias_scale`). The noise of the detections is estimated again about the best common bias (`with_reestimated_noise`),
because the residuals at the minimum contain bias and noise, and the bias would count twice.

**4. Information fraction.** The variance of a joint or an angle is compared with its variance without the pixels, which
follows from the other terms alone. The information fraction is 1 - variance / variance without pixels.

**5. Prior misfit and prior weight.** At a minimum, let r be the deviations of the angles from the prior, in standard
deviations. Let P be the prior's curvature, H the curvature of all terms, and n the number of unknowns. If the prior
fits, |r|^2 is n - tr(H^-1 P), the number of unknowns that the pixels determine, times a usual mean square
(`MISFIT_USUAL`), which is above 1 because errors persist over many frames (D. MacKay, *Bayesian interpolation*, Neural
Computation 4, 1992). The ratio of the two is the most likely scale of the prior's variances, and its inverse is the new
weight of the prior.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.blas import dtrmm

from recon.animal.body import Body
from recon.animal.flexion import flexion_by_angles
from recon.animal.prior import ANGLES
from recon.base.arrays import Array
from recon.clip import densest_window
from recon.fit import constants
from recon.fit.banded import Normal, Window, doubled, eliminated
from recon.fit.body_shape import Shape
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.pair_poses import WeighedPair, pair_poses, with_uncertain_poses
from recon.fit.terms import COMMON_KEYPOINT_BIAS, LENGTHS, PRIOR_TERMS, SIZE, Reprojection, size_of
from recon.geometry.kinematics import YAW

_NEARLY_FREE = 1e-3
"""Precision of an almost unknown position, 1/m^2, and heading, 1/rad^2."""
_FRAMES_AT_ONCE = 64
"""Number of frames whose covariances are computed at once, few enough for the processor's cache."""
_BIAS_ROUNDS = 10
"""Number of rounds of expectation-maximisation for the spread of the keypoint bias."""
_PRIOR_COUNT = 8
"""Weight of the expected variance of the keypoint bias in the estimated variance, as a number of unknowns."""
_NOISE_ROUNDS = 2
"""Maximum number of rounds that estimate the noise of detections about their keypoint bias."""
_MAX_EXPLAINED = 0.05
"""Maximum fraction of the squared residuals that shared unknowns may explain if one round estimates the noise.

The limit also applies to the fraction of the detections that determine the shared unknowns. A second round corrects
only the explained part, and hardly changes the noise if this part is small.
"""
_NOISE_FACTOR = (0.05, 4.0)
"""Minimum and maximum factor on the variance of the noise in one round."""


@dataclass(frozen=True)
class Posterior:
    """Posterior covariances of T frames with J joints and D unknowns each, at a given size of the animal.

    The joints belong to an animal of the skeleton's size, relative to the origin about which the size scales them.
    `with_size` applies the size and its uncertainty.
    """

    covariance_m2: Array
    """Covariances of the joints, m^2, shape (T, J, 3, 3), for a given size."""
    relative_covariance_m2: Array
    """Covariances of the joints relative to their mean, m^2, shape (T, J, 3, 3), for a given size."""
    data_share: Array
    """Information fraction of each joint, 0 to 1, shape (J,)."""
    angle_variance: Array
    """Variances of the root's rotation and the joints' angles for a given size, rad^2, shape (2, T, D - 3).

    The first index is 0 for variances with the pixels, and 1 for variances without them.
    """
    flexion_variance: Array
    """Variances of the flexions of the A anatomical joints for a given size, rad^2, shape (2, T, A).

    The first index is as in `angle_variance`.
    """
    flexion_by_size: Array
    """Derivatives of the flexions with respect to the animal's size, shape (T, A), rad."""
    state_by_size: Array
    """Derivatives of the states with respect to the size, shape (T, D).

    The other shared unknowns follow the size to their minimum.
    """
    state_by_size_alone: Array
    """Derivatives of the states with respect to the size, shape (T, D), with the other shared unknowns fixed."""
    joint_by_size_m: Array
    """Derivatives of the joints' positions with respect to the animal's size, a factor, shape (T, J, 3), m."""
    size_precision: float
    """Precision of the size from all terms without its prior, nearly all from the pixels; 0 if the size is fixed."""
    shared_sigma: dict[str, Array]
    """Standard deviations (P,) of the estimated shared unknowns, of lengths and of offsets, keyed by their names.

    The uncertainty of the lengths includes the uncertainty of the size.
    """

    @property
    def angle_data_share(self) -> Array:
        """Return the information fraction of the angles, (T, D - 3), 0 to 1."""
        with_pixels, without = self.angle_variance
        return np.clip(1.0 - with_pixels / without, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Curvature:
    """Curvature of a problem at its solution, with P shared unknowns other than the size.

    The size, if it is free, is the first of the 1 + P shared unknowns.
    """

    eliminated: Callable[[], Iterable[Window]]
    """Function that returns the windows of the normal equations (`recon.fit.banded.Window`)."""
    shared_precision: Array
    """Precision S of all shared unknowns, with the states eliminated, shape (1 + P, 1 + P)."""
    shared_gradient: Array
    """Gradient of the cost by the shared unknowns, with the states at their minimum, shape (1 + P,)."""
    covariance_root: Array
    """Cholesky factor of the covariance of the unknowns other than the size, for a given size, shape (P, P)."""
    others_by_size: Array
    """Derivatives of the unknowns other than the size with respect to the size, shape (P,)."""
    size_precision: float
    """Precision of the size from all terms, without its prior, before the variance factor; 0 if the size is fixed."""
    excess_bias_m2: Array | float
    """Variance of the common keypoint bias minus its expected variance, m^2, shape (J,); 0 if the bias was estimated.
    """
    lengths: slice | None = None
    """Indices of the lengths among the P unknowns; None if lengths are known."""

    def windows(self) -> Iterator[tuple[Window, Array, Array]]:
        """Yield the windows with the derivatives of their n frames with respect to the shared unknowns.

        The first array is Y (n, D, P) for the P unknowns other than the size, whose change moves the frames by -Y. The
        second array is the derivative (n, D) with respect to the size.
        """
        n_size = len(self.shared_precision) - len(self.covariance_root)  # the size comes first
        for window in self.eliminated():
            derivatives = window.solved()[..., 1:]
            by_others = derivatives[..., n_size:]
            by_size = (
                -derivatives[..., 0] - by_others @ self.others_by_size if n_size else np.zeros(by_others.shape[:2])
            )
            yield window, by_others, by_size
            del window, derivatives, by_others  # frees memory before the next window is computed


class _SharedCurvature(NamedTuple):
    """Curvature of the P shared unknowns, including the nuisance unknowns, with the states eliminated."""

    windows: Callable[[], Iterable[Window]]
    precision: Array
    """Precision of the unknowns, shape (P, P), for the estimated variance of the common keypoint bias."""
    gradient: Array
    """Gradient of the cost with respect to the unknowns, shape (P,)."""
    expected_precision: Array
    """Contribution of each unknown's prior to its precision, shape (P,)."""
    excess_bias_m2: Array | float
    """Variance of the common keypoint bias minus its expected variance, as in `Curvature`."""


def curvature(
    problem: LeastSquares, estimate: Estimate, variance_factor: float, normal: Normal | None = None
) -> Curvature:
    """Return the curvature of a problem at its solution, with the nuisance unknowns free.

    The variance of the common keypoint bias is estimated from the detections. Either of two cameras may have been
    turned or moved, which makes their poses more uncertain (`recon.fit.pair_poses`). `normal` holds the problem's
    normal equations with the nuisance unknowns, if they have been computed already.
    """
    problem = _with_free_nuisance(problem)
    shared_curvature = _shared_curvature(problem, estimate, variance_factor, normal)
    shared = problem.expected() | dict(estimate.shared)
    S = with_uncertain_poses(problem, shared, (shared_curvature.precision, shared_curvature.gradient), variance_factor)
    n_size = int(SIZE in problem.columns)
    others_covariance, size_precision = np.linalg.inv(S[n_size:, n_size:]), 0.0
    others_by_size = np.zeros(len(others_covariance))
    if n_size:
        others_by_size = -others_covariance @ S[1:, 0]
        size_precision = float(S[0, 0] + S[0, 1:] @ others_by_size - problem.shared[0].sigma[0] ** -2)
    columns = problem.columns.get(LENGTHS)
    return Curvature(
        eliminated=shared_curvature.windows,
        shared_precision=S,
        shared_gradient=shared_curvature.gradient,
        covariance_root=np.asarray(np.linalg.cholesky(others_covariance), dtype=float),
        others_by_size=others_by_size,
        size_precision=max(size_precision, 0.0),
        excess_bias_m2=shared_curvature.excess_bias_m2,
        lengths=None if columns is None else slice(columns.start - n_size, columns.stop - n_size),
    )


def _shared_curvature(
    problem: LeastSquares, estimate: Estimate, variance_factor: float, normal: Normal | None
) -> _SharedCurvature:
    """Return the curvature of the shared unknowns of a problem, in which the nuisance unknowns are already free."""
    shared = problem.expected() | dict(estimate.shared)
    normals = problem.normals(estimate.states, shared) if normal is None else lambda: [normal]

    def new_windows() -> Iterator[Window]:
        # an undetermined unknown gets a large variance, not an error
        return eliminated(normals(), bounded=True, ahead=problem.ahead)

    is_short = len(estimate.states) <= 2 * problem.piece
    kept = [*new_windows()] if is_short else []  # the windows of a long clip need too much memory

    def windows() -> Iterable[Window]:
        return kept or new_windows()

    reduced = np.sum([window.reduced() for window in windows()], axis=0)
    S, expected_precision, excess_bias_m2 = _with_likely_bias(problem, estimate, reduced, variance_factor)
    return _SharedCurvature(windows, S, reduced[:, -1], expected_precision, excess_bias_m2)


def _with_likely_bias(
    problem: LeastSquares, estimate: Estimate, reduced: Array, variance_factor: float
) -> tuple[Array, Array, Array | float]:
    """Return the precision of the shared unknowns with the variance of the common keypoint bias estimated.

    `reduced` holds the precision and the gradient for the expected variance. The second result is the contribution of
    the priors to the precision, and the third is `Curvature.excess_bias_m2`.
    """
    S, gradient = reduced[:, :-1].copy(), reduced[:, -1]
    expected_precision = np.concatenate([np.zeros(0), *(unknown.sigma**-2.0 for unknown in problem.shared)])
    if (bias := problem.columns.get(COMMON_KEYPOINT_BIAS)) is None:
        return S, expected_precision, 0.0
    variance_m2 = 1.0 / expected_precision[bias]
    solved_bias = estimate.shared.get(COMMON_KEYPOINT_BIAS)
    gradient_at_no_bias = gradient if solved_bias is None else gradient - S[:, bias] @ solved_bias
    scale = _bias_scale(S, gradient_at_no_bias, bias, variance_m2, variance_factor)
    S[bias, bias] += np.diag((1.0 / scale - 1.0) / variance_m2)
    expected_precision[bias] /= scale
    # the joints' covariances already include a bias that was estimated
    return S, expected_precision, (scale - 1.0) * variance_m2[::3] if solved_bias is None else 0.0


def pair_poses_of(problem: LeastSquares, estimate: Estimate, variance_factor: float) -> WeighedPair | None:
    """Return the hypotheses about the poses of two cameras at a minimum; None unless both poses are unknowns."""
    problem, normal = _with_reestimated_noise(problem, estimate, variance_factor)
    problem = _with_free_nuisance(problem)
    shared_curvature = _shared_curvature(problem, estimate, variance_factor, normal)
    shared = problem.expected() | dict(estimate.shared)
    return pair_poses(problem, shared, (shared_curvature.precision, shared_curvature.gradient), variance_factor)


def _with_free_nuisance(problem: LeastSquares) -> LeastSquares:
    return replace(problem, shared=[*problem.shared, *problem.nuisance], nuisance=())


def _bias_scale(S: Array, g: Array, columns: slice, variance: Array, variance_factor: float) -> float:
    """Return the most likely factor, at least 1, on the expected variances of the shared unknowns in `columns`.

    The factor is found by expectation-maximisation. The expected squares of the unknowns under their posterior give the
    factor, which in turn gives their posterior.
    """
    rest = np.delete(np.arange(len(g)), columns)
    by_rest = np.linalg.solve(S[np.ix_(rest, rest)], S[rest, columns]).T
    precision, pull, scale = S[columns, columns] - by_rest @ S[rest, columns], g[columns] - by_rest @ g[rest], 1.0
    for _ in range(_BIAS_ROUNDS):
        covariance = np.linalg.inv(precision + np.diag((1.0 / scale - 1.0) / variance))
        squares = ((covariance @ pull) ** 2 / variance_factor + np.diagonal(covariance)) / variance
        scale = float((squares.sum() + _PRIOR_COUNT) / (len(squares) + _PRIOR_COUNT))
    return max(scale, 1.0)


def with_reestimated_noise(problem: LeastSquares, estimate: Estimate, variance_factor: float) -> LeastSquares:
    """Return the problem with the noise of the detections estimated again, without their keypoint bias.

    A solution that does not estimate the bias assumes a bias of 0, so its residuals contain bias and noise. If all of
    the residuals counted as noise, the bias would count twice. The most likely variance of the noise is the sum of
    squared residuals about the best bias, divided by the number of detections minus the number that determines the
    bias. Without a common keypoint bias, as for a single camera, the problem is returned unchanged.
    """
    return _with_reestimated_noise(problem, estimate, variance_factor)[0]


def _with_reestimated_noise(
    problem: LeastSquares, estimate: Estimate, variance_factor: float
) -> tuple[LeastSquares, Normal | None]:
    """Return the problem of `with_reestimated_noise`, and, for a short clip, its normal equations with all unknowns."""
    if COMMON_KEYPOINT_BIAS not in [unknown.name for unknown in (*problem.shared, *problem.nuisance)]:
        return problem, None
    equations, shared = _EquationsByNoise.of_problem(problem, estimate), dict(estimate.shared)
    counts = np.sum([term.view.present.sum(axis=1) for term in _reprojections(problem)], axis=0)
    rows = densest_window(counts, 2 * problem.piece)  # so many frames also show the noise of a longer clip
    all_squares = problem.subset(("reprojection",)).squares(estimate.states, estimate.shared, rows)
    detections = 2 * int(counts[rows].sum())
    factor, scaled = 1.0, problem
    for _ in range(_NOISE_ROUNDS):
        freed = _with_free_nuisance(scaled)
        normal = equations.normal(factor) or freed.normal(estimate.states, freed.expected() | shared, rows)
        shared_curvature = _shared_curvature(freed, estimate, variance_factor, normal)
        covariance = np.linalg.inv(shared_curvature.precision)
        gradient, expected = shared_curvature.gradient, shared_curvature.expected_precision
        step = covariance @ gradient  # this step leads to the best bias
        shared_squares = float(gradient @ step + expected @ step**2)
        squares = all_squares / factor - shared_squares
        shared_detections = variance_factor * (len(step) - float(expected @ np.diagonal(covariance)))
        noise_detections = max(detections - shared_detections, 1.0)
        explained = max(shared_squares * factor / max(all_squares, 1.0), shared_detections / max(detections, 1))
        factor *= float(np.clip(constants.NOISE_ABOUT_BIAS * squares / noise_detections, *_NOISE_FACTOR))
        scaled = _with_noise_factor(problem, factor)
        if explained < _MAX_EXPLAINED:
            break
    return scaled, equations.normal(factor)


def _reprojections(problem: LeastSquares) -> list[Reprojection]:
    return [term for term in problem.terms if isinstance(term, Reprojection)]


def _with_noise_factor(problem: LeastSquares, factor: float) -> LeastSquares:
    """Return the problem with the variance of all detections multiplied by a factor."""
    # The confidence is scaled instead of the noise, because a larger noise would also widen the robust loss.
    reprojections = [
        replace(term, view=replace(term.view, confidence=term.view.confidence / factor))
        for term in _reprojections(problem)
    ]
    other_terms = [term for term in problem.terms if not isinstance(term, Reprojection)]
    return replace(problem, terms=[*reprojections, *other_terms])


@dataclass(frozen=True)
class _EquationsByNoise:
    """Normal equations of a short clip, which can be rescaled to another noise of the detections."""

    whole: Normal | None
    """Normal equations of all terms; None for a long clip, for which they would need too much memory."""
    undetected: Normal | None
    """Normal equations of all terms except the detections; None for a long clip."""

    @classmethod
    def of_problem(cls, problem: LeastSquares, estimate: Estimate) -> _EquationsByNoise:
        """Compute the normal equations at a solution, including nuisance unknowns; both are None for a long clip."""
        if len(estimate.states) > problem.piece:
            return cls(None, None)
        problem = _with_free_nuisance(problem)
        shared = problem.expected() | dict(estimate.shared)
        undetected = replace(problem, terms=[term for term in problem.terms if not isinstance(term, Reprojection)])
        return cls(problem.normal(estimate.states, shared), undetected.normal(estimate.states, shared))

    def normal(self, factor: float) -> Normal | None:
        """Return the normal equations with the variance of all detections times a factor; None for a long clip."""
        whole, undetected = self.whole, self.undetected
        if whole is None or undetected is None:
            return None

        def scaled(name: str) -> Any:
            rest = getattr(undetected, name)
            return (getattr(whole, name) - rest) / factor + rest

        return Normal(*(scaled(field.name) for field in fields(Normal)))


def posterior_with_reestimated_noise(
    problem: LeastSquares, body: Body, estimate: Estimate, variance_factor: float
) -> Posterior:
    """Estimate the noise of the detections again at a minimum, and return the posterior covariances."""
    problem, normal = _with_reestimated_noise(problem, estimate, variance_factor)
    return posterior(problem, body, estimate, variance_factor, normal)


def posterior(
    problem: LeastSquares, body: Body, estimate: Estimate, variance_factor: float, normal: Normal | None = None
) -> Posterior:
    """Return the posterior covariances of a clip at the minimum of its least-squares problem.

    Parameters
    ----------
    problem
        The problem, whose nuisance unknowns are freed.
    body
        The body, with J joints and D unknowns per frame.
    estimate
        The minimum of the problem.
    variance_factor
        Factor on the variances, the correlation time of the errors in frames, which the cost ignores.
    normal
        The normal equations with the nuisance unknowns, if they have been computed already.
    """
    states, size = estimate.states, size_of(estimate.shared)
    (T, D), J = states.shape, len(body.markers)
    at_minimum = curvature(problem, estimate, variance_factor, normal)
    absolute, relative, by_size = np.empty((T, J, 3, 3)), np.empty((T, J, 3, 3)), np.empty((T, J, 3))
    state_by_size, by_size_alone, angle_variance = np.empty((T, D)), np.empty((T, D)), np.empty((2, T, D - YAW))
    flexion_variance, flexion_by_size = np.empty((2, T, len(body.anatomy))), np.empty((T, len(body.anatomy)))

    def filled() -> Iterator[Normal]:
        """Fill the arrays window by window, and yield each window's normal equations without shared unknowns."""
        for window, by_others, window_by_size in at_minimum.windows():  # one after the other, because a window is large
            rows, state_covariance = window.rows, window.marginal_blocks()[:, 0]
            absolute[rows], relative[rows], by_size[rows] = _joint_covariances(
                at_minimum, body, states[rows], state_covariance, by_others, window_by_size, size
            )
            angle_variance[0, rows] = np.diagonal(state_covariance, axis1=1, axis2=2)[:, YAW:]
            by_angles = flexion_by_angles(body, states[rows])
            flexion_variance[0, rows] = _flexion_variances(by_angles, state_covariance)
            flexion_by_size[rows] = (by_angles @ window_by_size[:, YAW:, None])[..., 0]
            state_by_size[rows] = window_by_size
            by_size_alone[rows] = window_by_size + by_others @ at_minimum.others_by_size
            piece = window.piece.without_shared()
            del window, by_others, by_angles  # frees memory before the next window is computed
            yield piece

    data_share, angle_variance[1], flexion_variance[1] = _without_pixels(problem, body, estimate, filled())
    for covariance in (absolute, relative):  # added in place, because the covariances of a long clip are large
        covariance += np.multiply.outer(at_minimum.excess_bias_m2, np.eye(3))
        covariance *= variance_factor
        covariance += body.marker_sigma_m**2 * np.eye(3)
    return Posterior(
        covariance_m2=absolute,
        relative_covariance_m2=relative,
        data_share=data_share,
        angle_variance=variance_factor * angle_variance,
        flexion_variance=variance_factor * flexion_variance,
        flexion_by_size=flexion_by_size,
        state_by_size=state_by_size,
        state_by_size_alone=by_size_alone,
        joint_by_size_m=by_size,
        size_precision=at_minimum.size_precision / variance_factor,
        shared_sigma=_shared_sigma(problem, at_minimum, body.subject is not None, variance_factor),
    )


def _joint_covariances(
    at_minimum: Curvature,
    body: Body,
    states: Array,
    state_covariance: Array,
    by_others: Array,
    state_by_size: Array,
    size: float,
) -> tuple[Array, Array, Array]:
    """Return the joints' absolute and relative covariances (n, J, 3, 3), m^2, and derivatives by size (n, J, 3), m.

    Relative covariances are those of the positions relative to the mean of the joints. The uncertainty of all shared
    unknowns except the size is added to the covariance of the states (n, D, D), in place. `by_others` and
    `state_by_size` are the derivatives of `Curvature.windows`.

    Let X (3, D + L) be the derivatives of a joint with respect to states and unknown lengths, and V (D + L, D + L) the
    covariance of both. The joint's covariance is X V X'.
    """
    n, J, root = len(states), len(body.markers), at_minimum.covariance_root
    shape = Shape.of_body(body)
    absolute, relative, by_size = np.empty((n, J, 3, 3)), np.empty((n, J, 3, 3)), np.empty((n, J, 3))
    for first in range(0, n, _FRAMES_AT_ONCE):
        rows = slice(first, first + _FRAMES_AT_ONCE)
        root_of_states = _times_root(by_others[rows], root)
        state_covariance[rows] += root_of_states @ root_of_states.swapaxes(1, 2)
        pose = body.tree.pose_with_jacobian(states[rows])
        X, V = pose.jacobian, state_covariance[rows]
        by_size[rows] = pose.points_m + size * (X @ state_by_size[rows, None, :, None])[..., 0]
        if at_minimum.lengths is not None:
            root_of_lengths = root[at_minimum.lengths]
            by_length = shape.jacobian(body, states[rows])
            by_size[rows] += size * by_length @ at_minimum.others_by_size[at_minimum.lengths]
            X = np.concatenate([X, by_length], axis=3)
            across = root_of_states @ -root_of_lengths.T
            of_lengths = np.broadcast_to(root_of_lengths @ root_of_lengths.T, (len(V), *2 * across.shape[2:]))
            V = np.block([[V, across], [across.swapaxes(1, 2), of_lengths]])
        moved = _times(X, V)
        absolute[rows] = moved @ X.swapaxes(2, 3)
        X, moved = (values - values.mean(axis=1, keepdims=True) for values in (X, moved))
        relative[rows] = moved @ X.swapaxes(2, 3)
    return absolute, relative, by_size


def _without_pixels(
    problem: LeastSquares, body: Body, estimate: Estimate, with_pixels: Iterable[Normal]
) -> tuple[Array, Array, Array]:
    """Return the joints' information fraction, and the variances of angles and flexions without the detections.

    The shapes are (J,), (T, D - 3) and (T, A), the units of the variances rad^2.

    `with_pixels` are the pieces of the normal equations with the detections, without shared unknowns. Priors do not
    determine a frame's position and heading. Position and heading are therefore fixed for the information fraction,
    which compares joints within the body, and nearly free for the angles.
    """
    states, (T, D) = estimate.states, estimate.states.shape
    terms = [term for term in problem.terms if term.name != "reprojection"]
    prior = replace(problem, terms=terms, shared=(), nuisance=())
    without_pixels, same_pieces = doubled(prior.normals(states)())
    nearly_free = np.zeros(D)
    nearly_free[: ANGLES.start] = _NEARLY_FREE
    ahead = problem.piece // 4  # frames at fixed positions hardly inform each other
    windows = zip(
        eliminated(map(_at_fixed_position, with_pixels), bounded=True, ahead=ahead),
        eliminated(map(_at_fixed_position, without_pixels), bounded=True, ahead=ahead),
        eliminated(same_pieces, nearly_free, bounded=True),
        strict=True,
    )
    variances, angle_variance = np.empty((2, T, len(body.markers))), np.empty((T, D - YAW))
    flexion_variance = np.empty((T, len(body.anatomy)))
    for *of_fixed, free in windows:
        rows, covariances = free.rows, [window.marginal_blocks()[:, 0] for window in of_fixed]
        variances[:, rows] = _relative_variances(body, states[rows], covariances)
        state_covariance = free.marginal_blocks()[:, 0]
        angle_variance[rows] = np.diagonal(state_covariance, axis1=1, axis2=2)[:, YAW:]
        flexion_variance[rows] = _flexion_variances(flexion_by_angles(body, states[rows]), state_covariance)
    return _data_share(*variances), angle_variance, flexion_variance


def _at_fixed_position(piece: Normal) -> Normal:
    """Return the normal equations of the angles, with position and heading fixed in all frames."""
    return replace(
        piece,
        blocks=piece.blocks[..., ANGLES, ANGLES],
        gradient=piece.gradient[:, ANGLES],
        border=piece.border[:, ANGLES],
    )


def _shared_sigma(
    problem: LeastSquares, at_minimum: Curvature, is_measured: bool, variance_factor: float
) -> dict[str, Array]:
    """Return the standard deviations (P,) of the shared unknowns, keyed by their names, for `Posterior.shared_sigma`.

    `is_measured` states whether the animal's lengths were measured. If they were not, the prior standard deviation of
    lengths is at least `constants.LENGTH_SIGMA`, because an individual may differ from the skeleton by more than the
    fit assumed.
    """
    unknowns = {unknown.name: unknown for unknown in (*problem.shared, *problem.nuisance)}
    columns, precision = replace(problem, shared=[*unknowns.values()]).columns, at_minimum.shared_precision
    sigma = np.sqrt(variance_factor * np.diagonal(np.linalg.inv(precision)))
    solved = [unknown.name for unknown in problem.shared]
    by_name = {name: sigma[columns[name]] for name in (*solved, *(unknowns.keys() & {LENGTHS, COMMON_KEYPOINT_BIAS}))}
    if LENGTHS not in by_name:
        return by_name
    lengths, precision = columns[LENGTHS], precision.copy()
    if not is_measured:
        wide = np.maximum(unknowns[LENGTHS].sigma, constants.LENGTH_SIGMA / np.sqrt(variance_factor))
        precision[lengths, lengths] += np.diag(wide**-2.0 - unknowns[LENGTHS].sigma ** -2.0)
    covariance = variance_factor * np.linalg.inv(precision)
    variance = np.diagonal(covariance)[lengths].copy()
    if SIZE in columns:  # the logarithms of a length and of the size add up
        size = columns[SIZE].start
        variance += 2.0 * covariance[lengths, size] + covariance[size, size]
    return by_name | {LENGTHS: np.sqrt(np.maximum(variance, 0.0))}


def with_size(covariance_m2: Array, by_size_m: Array, size: float, size_sigma: float) -> Array:
    """Scale covariances of joints (T, J, 3, 3), m^2, to a size in place, add the size's uncertainty, and return them.

    `covariance_m2` belongs to a skeleton of size 1, and `by_size_m` (T, J, 3) holds the derivatives of the joints with
    respect to the size, m.
    """
    for first in range(0, len(covariance_m2), _FRAMES_AT_ONCE):
        rows = slice(first, first + _FRAMES_AT_ONCE)
        q = by_size_m[rows]
        covariance_m2[rows] = size_sigma**2 * q[..., :, None] * q[..., None, :] + size**2 * covariance_m2[rows]
    return covariance_m2


def _data_share(with_pixels_m2: Array, without_m2: Array) -> Array:
    """Return the information fraction of each joint, (J,), 0 to 1.

    The fraction is the median over the frames of 1 - v / v0, where v is the variance with the detections, and v0 the
    variance from the other terms alone. Both variances (T, J) belong to a joint's position relative to the mean of the
    joints, at a given position and heading. The fraction is NaN for joints that cannot move relative to the mean.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = np.median(1.0 - with_pixels_m2 / without_m2, axis=0)
    return np.clip(fraction, 0.0, 1.0)


def _relative_variances(body: Body, states: Array, angle_covariances: Sequence[Array]) -> Array:
    """Return the traces (C, T, J) in m^2 of the joints' covariances relative to the mean of the joints.

    `angle_covariances` are C covariances (T, A, A) of the A angles, at a given position and heading.
    """
    variances = np.empty((len(angle_covariances), len(states), len(body.markers)))
    for first in range(0, len(states), _FRAMES_AT_ONCE):
        rows = slice(first, first + _FRAMES_AT_ONCE)
        by_angles = body.tree.pose_with_jacobian(states[rows]).jacobian[..., ANGLES]
        by_angles = by_angles - by_angles.mean(axis=1, keepdims=True)
        for variance, covariance in zip(variances, angle_covariances, strict=True):
            variance[rows] = np.einsum("tjad,tjad->tj", _times(by_angles, covariance[rows]), by_angles)
    return variances


def _flexion_variances(by_angles: Array, state_covariance: Array) -> Array:
    """Return the variances (n, A) in rad^2 of flexions with the derivatives (n, A, D - 3) by the angles.

    `state_covariance` are the covariances (n, D, D) of the frames' unknowns.
    """
    variances = np.empty(by_angles.shape[:2])
    for first in range(0, len(variances), _FRAMES_AT_ONCE):
        rows = slice(first, first + _FRAMES_AT_ONCE)
        variances[rows] = np.sum(by_angles[rows] @ state_covariance[rows, YAW:, YAW:] * by_angles[rows], axis=2)
    return variances


def _times_root(by_others: Array, root: Array) -> Array:
    """Multiply derivatives (n, D, P) with respect to shared unknowns by the Cholesky factor (P, P) of a covariance."""
    n, D, P = by_others.shape
    transposed = np.array(by_others, order="C").reshape(n * D, P).T  # `dtrmm` overwrites this copy
    # The triangular product takes half the time of a full one.
    return dtrmm(1.0, root.T, transposed, overwrite_b=1).T.reshape(n, D, P)


def _times(by_states: Array, state_covariance: Array) -> Array:
    """Multiply derivatives (T, J, 3, D) by covariances (T, D, D)."""
    T, J, _, D = by_states.shape
    return (by_states.reshape(T, 3 * J, D) @ state_covariance).reshape(T, J, 3, D)


@dataclass(frozen=True)
class PriorMisfit:
    """Deviation of a motion from its prior, compared with the deviation expected if the prior fits."""

    level: float
    """Sum of the prior's squared residuals, relative to its expectation (about 1 for a prior that fits)."""
    freedom: float
    """Number of unknowns of the motion that the pixels determine."""

    @property
    def prior_weight(self) -> float:
        """Return the factor, at most 1, by which the prior's weight is multiplied to allow for the misfit."""
        return 1.0 / max(self.level, 1.0)

    @property
    def unlike(self) -> bool:
        """Return whether the misfit is too large for motions like those from which the prior was learned."""
        variance = 2.0 / (9.0 * self.freedom)  # a chi square's cube root is nearly normal (Wilson and Hilferty)
        by_chance = (1.0 - variance + constants.MISFIT_SIGMAS * variance**0.5) ** 3
        return self.level >= max(constants.MISFIT_LEVEL, by_chance)


def prior_misfit_of(problem: LeastSquares, estimate: Estimate) -> PriorMisfit:
    """Return the misfit of the prior at the minimum of a problem, under the prior's present weight."""
    prior, by_prior = problem.subset(PRIOR_TERMS), 0.0
    frames = replace(problem, shared=(), nuisance=())  # a frame's covariance is taken with the shared unknowns fixed
    windows = eliminated(frames.normals(estimate.states, estimate.shared)(), bounded=True, ahead=problem.ahead)
    for window, prior_normal in zip(windows, prior.normals(estimate.states)(), strict=True):
        overlap = window.marginal_blocks() * prior_normal.blocks
        by_prior += float(overlap[:, 0].sum() + 2 * overlap[:, 1:].sum())
    freedom = max(estimate.states[:, ANGLES].size - by_prior, 1.0)
    return PriorMisfit(prior.squares(estimate.states) / freedom / constants.MISFIT_USUAL, freedom)
