"""Rank the detections of a clip by how much a correction by hand would improve its 3D motion.

**Input and output.** `correction_gain_m2` takes a solution. For each detection it returns the expected decrease of the
pose's mean squared error, m^2, if a person corrected this detection.

**Idea.** No fit is repeated, because the curvature at the minimum already determines the effect of a single detection.
A correction removes two parts of the squared error: variance, because the corrected detection gets its full weight, and
the displacement of the pose by the wrong detection.

**Notation.** H is the curvature of the cost at the minimum with respect to the states of all frames, and Z = H^-1 their
covariance. If the states of a frame change by dx, the squared displacements of its joints relative to their mean add up
to dx' G dx. A detection moves in the picture by A dx, where A is (2, D). Its noise is sigma and its weight w, which is
0 if the detection is missing or was left out.

**1. Variance.** With full weight, the precision of the detection grows by d = (1 - w) / sigma^2, and the covariance of
the states decreases by Z A' (I / d + A Z A')^-1 A Z. The squared error of the joints decreases by

    tr((I / d + A Z A')^-1 A Q A'),   Q = Z G Z

times the correlation time of the errors, in frames.

**2. Displacement.** Without the detection, the states would move by Z A' (I sigma^2 / w - A Z A')^-1 r, where r is the
residual. This is the effect of deleting an observation (R. D. Cook, *Detection of influential observation in linear
regression*, Technometrics 19, 1977). The squared displacements of the joints add up to

    r' P A Q A' P r,   P = (I sigma^2 / w - A Z A')^-1

Only the blocks of Z and Q within each frame are needed. To first order, Z(H) - Z(H + e G) = e Q. The recursion that
gives Z (`recon.fit.banded`) therefore gives Q as well, if it is repeated with H + e G. The step e follows from the
solution's covariances.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from recon.animal.prior import MotionPrior
from recon.base.arrays import Array
from recon.base.threads import one_thread
from recon.clip import View
from recon.fit.banded import Normal, doubled, eliminated
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions, contacts
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.result import TrajectorySolution
from recon.fit.terms import SIDESLIP, SIZE, offset_values

_MAX_WEIGHT = 0.99
"""Maximum weight w of a detection in the displacement, because P may not exist for a weight of 1."""
_FRAMES_AT_ONCE = 128
"""Number of frames whose derivatives are computed at once, to limit the memory."""
_RELATIVE_STEP = 1e-4
"""Approximate trace of e Z G in the frame where it is largest, which sets the step e of the derivative of Z."""


def correction_gain_m2(
    solution: TrajectorySolution, prior: MotionPrior, fps: float, options: TrajectoryOptions
) -> Array:
    """Return the expected decrease of the pose's mean squared error if a detection were corrected, (V, T, J), m^2.

    The error is that of the joints' positions relative to the mean of the joints, averaged over all frames and joints.
    The decrease is NaN in frames without a pose, and if the camera cannot see the joint.

    Parameters
    ----------
    solution
        The solution of a clip, with V views of T frames and J markers.
    prior
        Prior with which the solution was fitted.
    fps
        Frames per second.
    options
        Options with which the solution was fitted.
    """
    clip = ClipProblem.from_views(solution.views, solution.body, prior, fps, options)
    gain_m2 = np.full(solution.weight.shape, np.nan)
    # One thread is faster, because the matrices are small. The squares of points from a damaged file may overflow.
    with one_thread(), np.errstate(over="ignore", invalid="ignore"):
        for rows, segment_clip, problem, estimate in problems_at(clip, solution):
            segment_gain_m2 = _segment_gain(segment_clip, problem, estimate, solution, rows)
            gain_m2[:, rows] = np.where(np.isfinite(segment_gain_m2), segment_gain_m2, np.nan)
    gain_m2 /= max(int(solution.posed.sum()) * len(solution.body.markers), 1)
    return gain_m2.astype(np.float32).astype(float)  # values of single precision halve the size of the file


def problems_at(
    clip: ClipProblem, solution: TrajectorySolution
) -> Iterator[tuple[slice, ClipProblem, LeastSquares, Estimate]]:
    """Yield each segment's slice of frames, clip problem, least-squares problem and minimum, for a solution.

    The views of each clip include the estimated time offsets and corrections of the cameras.
    """
    size = solution.size if clip.shows_size else 1.0
    values = {SIZE: np.array([size]), SIDESLIP: np.array([solution.sideslip_rad])}
    values |= offset_values(solution.time_offset_frames)
    nominal = clip.nominal(solution.states, solution.size)
    for segment in solution.segments:
        rows, states = segment.rows, nominal[segment.rows]
        part = replace(clip.part(rows), prior_weight=segment.prior_weight)
        if not np.isfinite(states).all():
            continue
        points = part.markers(states)
        *_, contact_terms = contacts(part, points, size)
        in_step = part.before_offsets(solution.time_offset_frames)
        problem = in_step.problem(solution.noise_px[:, rows], 1.0, contact_terms, points, size)
        shared = {name: (problem.expected() | values)[name] for name in problem.columns}
        yield rows, part, problem, Estimate(states, 0.0, 0, True, shared)


def _segment_gain(
    clip: ClipProblem, problem: LeastSquares, estimate: Estimate, solution: TrajectorySolution, rows: slice
) -> Array:
    """Return the gain (V, n, J) in m^2 of each detection of a segment, summed over its n frames and joints."""
    states, size = estimate.states, solution.size
    (n, D), V, J = states.shape, len(clip.views), len(clip.body.markers)
    gains = np.empty((V, n, J))

    def curvature(frames: slice) -> Array:
        """Return G (N, D, D), with dx' G dx the squared displacements of the joints, relative to their mean, for dx."""
        jacobian = clip.body.tree.pose_with_jacobian(states[frames]).jacobian
        flat = (size * (jacobian - jacobian.mean(axis=1, keepdims=True))).reshape(len(jacobian), -1, D)
        return flat.swapaxes(1, 2) @ flat

    variance_m2 = np.trace(solution.relative_covariance_m2[rows], axis1=2, axis2=3).sum(axis=1)  # about tr(Z G)
    step = _RELATIVE_STEP / max(float(variance_m2.max()) / clip.correlation_frames, 1e-12)
    world_m = clip.in_world(clip.body.detected.pose(states).points_m, size)
    views = [(view, view.shift_to_exposure(world_m)) for view in clip.views]
    for part, of_states in _covariances_and_derivatives(problem, estimate, step, curvature):
        of_points = _of_points(size * clip.body.detected.pose_with_jacobian(states[part]).jacobian, of_states)
        for number, (view, points_m) in enumerate(views):
            noise_px, weight = solution.noise_px[number, rows][part], solution.weight[number, rows][part]
            gains[number, part] = _gain_of_frames(
                view.part(part), points_m[part], of_points, (noise_px, weight), clip.correlation_frames
            )
    return gains


def _of_points(by_state: Array, of_states: Array) -> Array:
    """Return Z and Q of points (2, N, J, 3, 3), from those of states (2, N, D, D) and the derivatives (N, J, 3, D)."""
    N, J, _, D = by_state.shape
    moved = (by_state.reshape(N, 3 * J, D) @ of_states).reshape(2, N, J, 3, D)
    return moved @ by_state.swapaxes(2, 3)


def _gain_of_frames(
    view: View,
    points_m: Array,
    of_points: Array,
    noise_and_weight: tuple[Array, Array],
    correlation_frames: float,
) -> Array:
    """Return the gain (N, J) in m^2 of each detection in N frames of a view.

    `points_m` (N, J, 3) are the markers, and `of_points` (2, N, J, 3, 3) their blocks of Z and of Q. `noise_and_weight`
    are the standard deviations (N, J), px, and the weights (N, J) of the detections.
    """
    projected, by_point, valid = view.project_with_jacobian(points_m)
    A_Z_A, A_Q_A = by_point @ of_points @ by_point.swapaxes(-1, -2)
    eye = np.eye(2)
    noise_px, weight = noise_and_weight
    w = np.where(view.present, np.nan_to_num(weight) * view.confidence, 0.0)[..., None, None]
    variance_px2 = noise_px[..., None, None] ** 2
    precision = np.maximum(1.0 - w, 0.0) / variance_px2
    fall = precision[..., 0, 0] * np.trace(np.linalg.solve(eye + precision * A_Z_A, A_Q_A), axis1=-2, axis2=-1)
    residual_px = np.where(view.present[..., None], projected - view.xy_px, 0.0)[..., None]
    # if the pose depends on a single detection, P does not exist
    w_left = np.minimum(w, _MAX_WEIGHT) / variance_px2
    pulled = w_left * np.linalg.solve(eye - w_left * A_Z_A, residual_px)
    pull = (pulled.swapaxes(-1, -2) @ A_Q_A @ pulled)[..., 0, 0]
    return np.where(valid, correlation_frames * fall + pull, np.nan)


def _covariances_and_derivatives(
    problem: LeastSquares, estimate: Estimate, step: float, curvature: Callable[[slice], Array]
) -> Iterator[tuple[slice, Array]]:
    """Yield slices of N frames, and the states' blocks of Z and of Q in these frames, (2, N, D, D).

    `step` is the step e of the derivative, and `curvature` returns the blocks (N, D, D) of G.
    """
    pieces, same_pieces = doubled(replace(problem, shared=(), nuisance=()).normals(estimate.states, estimate.shared)())
    windows = (
        eliminated(pieces, bounded=True, ahead=problem.ahead),
        eliminated(_stiffened(same_pieces, step, curvature), bounded=True, ahead=problem.ahead),
    )
    for window, stiffened in zip(*windows, strict=True):
        Z, stiffened_Z = window.marginal_blocks()[:, 0], stiffened.marginal_blocks()[:, 0]
        for first in range(0, len(Z), _FRAMES_AT_ONCE):
            part = slice(first, min(first + _FRAMES_AT_ONCE, len(Z)))
            frames = slice(window.rows.start + part.start, window.rows.start + part.stop)
            yield frames, np.stack([Z[part], (Z[part] - stiffened_Z[part]) / step])


def _stiffened(pieces: Iterable[Normal], step: float, curvature: Callable[[slice], Array]) -> Iterator[Normal]:
    """Yield the normal equations with `step` times the curvature (N, D, D) of N frames added to their blocks."""
    first = 0
    for piece in pieces:
        blocks = piece.blocks.copy()
        blocks[:, 0] += step * curvature(slice(first, first + len(blocks)))
        first += len(blocks)
        yield replace(piece, blocks=blocks)
