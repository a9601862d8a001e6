"""Fit the shape of one animal and the offsets of its detector to clips filmed by several cameras.

**Input and output.** The clips show the same animal. `fit_shape` returns the lengths of the body's segments and the
offsets of the detector's keypoints from the markers, with their covariance (`ShapeFit`). Lengths are factors on the
lengths of the skeleton, and equal on the left and on the right.

**Method.** Each clip is solved for a given shape. At the minimum, the states are eliminated from the normal equations
(`recon.fit.banded`), S = C - B' H^-1 B. The shape then takes the Gauss-Newton step of the sum over all clips and the
prior of the shape. A few rounds of solving the clips and changing the shape lead to the minimum over all unknowns. The
inverse of the summed curvature is the covariance of the shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from recon.animal.body import Body, other_side
from recon.base.arrays import Array
from recon.base.threads import one_thread
from recon.fit.banded import eliminated
from recon.fit.body_shape import Shape, follows
from recon.fit.clip_problem import ClipProblem
from recon.fit.segment import SegmentFit, refined, with_solved_cameras
from recon.fit.terms import OnGround, Reprojection, Span, StanceVelocity
from recon.fit.trajectory import solve_segments
from recon.geometry.kinematics import TreePose

MODEL_SIGMA = 0.04
"""Relative standard deviation of a measured length due to effects that a rigid skeleton cannot describe.

Examples are sliding shoulders, and keypoints that are not at their joints. `python benchmarks/parts/bone_lengths.py`
measures how many lengths are within the 90 % intervals.
"""
POSED_OFFSET_SIGMA_M = 0.02
"""Standard deviation (m) of a keypoint's offset along each axis if the poses are known and cannot absorb a part of it.
"""
FIXED_SIZE_SIGMA = 1e-4
"""Relative standard deviation of the animal's size, so small that the size is fixed and only lengths change."""
_PRIOR_COUNT = 8
"""Weight of the expected spread of a keypoint's bias in the estimate of this spread, as an equivalent number of views.
"""
ROUNDS = 8
"""Maximum number of rounds of solving the clips and changing the shape."""
CLOSE_ENOUGH = 0.05
"""Root mean square step of the unknowns, in standard deviations, that is small enough to end the rounds."""


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """Lengths and keypoint offsets of a body that were fitted to clips, with their covariance."""

    shape: Shape
    values: Array
    """Fitted values of the shape's unknowns, shape (K,)."""
    covariance: Array
    """Covariance of the shape's unknowns, shape (K, K)."""
    converged: bool
    """Whether the last step of the unknowns was below `CLOSE_ENOUGH`."""
    keypoint_sigma_m: float
    """Standard deviation of keypoints in a single frame about their fitted offsets, m, as one value for all markers."""
    noise_m: dict[str, float]
    """Standard deviation (m) of a keypoint in a single frame, keyed by marker (left side and middle only)."""
    spread_m: dict[str, float]
    """Standard deviation (m) of the keypoint bias along each axis, for each marker of the left side and the middle.

    The bias is constant in a clip for each camera.
    """

    @cached_property
    def sigma(self) -> Array:
        """Return the standard deviations of the shape's unknowns, (K,)."""
        return np.sqrt(np.diagonal(self.covariance))

    def length_of(self, names: Sequence[str], prior_size_sigma: float) -> tuple[float, float, float]:
        """Return the total length of connected segments (m), its standard deviation (m), and its information fraction.

        Parameters
        ----------
        names
            Segments or markers of `shape.lengths` whose offsets, end to end, make up the length.
        prior_size_sigma
            Relative standard deviation of the animal's size before the fit.

        Returns
        -------
        length_m, sigma_m, data_share : float
            Length, m, its standard deviation, m, including `MODEL_SIGMA`, and the information fraction, 0 to 1.
        """
        body = self.shape.applied(self.shape.body, self.values)
        offset_m = {item.name: item.offset_m for item in (*body.tree.segments, *body.tree.markers)}
        lengths_m = np.array([np.linalg.norm(offset_m[name]) for name in names])
        rows = [self.shape.lengths.index(name) for name in names]
        expected = np.linalg.inv(self.shape.expected_precision(prior_size_sigma))[np.ix_(rows, rows)]
        variance = float(lengths_m @ self.covariance[np.ix_(rows, rows)] @ lengths_m)
        length_m = float(lengths_m.sum())
        sigma_m = float(np.sqrt(variance + (MODEL_SIGMA * length_m) ** 2))
        return length_m, sigma_m, max(1.0 - variance / float(lengths_m @ expected @ lengths_m), 0.0)

    def seen(self, body: Body) -> Body:
        """Return a body with the fitted shape and the detector's fitted noise and bias, the same on both sides."""
        spread_m, noise_m = (
            {name: by_leader[self.shape.leader(name)] for name in body.markers}
            for by_leader in (self.spread_m, self.noise_m)
        )
        shaped, sigma_m = self.shape.applied(body, self.values), self.keypoint_sigma_m
        return replace(shaped, keypoint_sigma_m=sigma_m, keypoint_spread_m=spread_m, keypoint_noise_m=noise_m)


def fit_shape(shape: Shape, clips: Sequence[ClipProblem]) -> ShapeFit:
    """Fit the shape of one animal to several clips.

    Parameters
    ----------
    shape
        Unknown lengths and keypoint offsets of the animal's body.
    clips
        Clips whose bodies have the segments and markers of `shape.body`, and may have other lengths. Their size is held
        fixed.

    Raises
    ------
    ValueError
        If no clip can be solved.
    """
    expected = shape.expected_precision(clips[0].size_sigma)
    fixed_size_clips = [replace(clip, options=replace(clip.options, size_sigma=FIXED_SIZE_SIGMA)) for clip in clips]
    values, converged, total = np.zeros(len(shape)), False, expected
    with one_thread():
        solved = [(clip, segment) for clip in fixed_size_clips for segment in solve_segments(clip)]
        first_clips = [clip for clip, _ in solved]
        if not solved:
            raise ValueError("no clip has a frame with enough detections")
        for _ in range(ROUNDS):
            total, pull = expected.copy(), expected @ values
            for clip, segment in solved:
                curvature, gradient = _reduced(shape, clip, segment)
                total += curvature / clip.correlation_frames
                pull += gradient / clip.correlation_frames
            step = -np.linalg.solve(total, pull)
            values = values + step
            shaped_clips = [replace(clip, body=shape.applied(clip.body, values)) for clip in first_clips]
            solved = [(clip, refined(clip, segment)) for clip, (_, segment) in zip(shaped_clips, solved, strict=True)]
            converged = bool(step @ total @ step < CLOSE_ENOUGH**2 * len(step))
            if converged:
                break
    covariance = np.asarray(np.linalg.inv(total), dtype=float)
    # logarithm of each marker's noise in each view, (J, views)
    noise_m = np.concatenate([np.log(clip.in_frame_m) + 0.5 * np.log(segment.noise) for clip, segment in solved]).T
    by_marker: dict[str, list[Array]] = {}
    for name, log_noise in zip(shape.body.markers, noise_m, strict=True):
        by_marker.setdefault(shape.leader(name), []).append(log_noise)
    noise_by_marker_m = {name: float(np.exp(np.mean(log_noise))) for name, log_noise in by_marker.items()}
    sigma_m, spread_m = float(np.exp(noise_m.mean())), _spread_m(shape.body, solved)
    return ShapeFit(shape, values, covariance, converged, sigma_m, noise_by_marker_m, spread_m)


def _spread_m(body: Body, solved: Sequence[tuple[ClipProblem, SegmentFit]]) -> dict[str, float]:
    """Estimate the standard deviation (m) of each marker's keypoint bias from its mean residual in every view.

    The part common to all markers of a view is removed. The expected spread counts as `_PRIOR_COUNT` views, because a
    few views are not enough to estimate it.
    """
    clip = solved[0][0]
    expected_m = clip.keypoint_bias_m
    squares: dict[str, list[float]] = {name: [] for name in body.markers if not follows(name, body)}
    for fitted_clip, segment in solved:
        part = with_solved_cameras(fitted_clip.part(segment.rows), segment)
        points_m = fitted_clip.markers(segment.estimate.states)
        world_m, px_per_m = part.in_world(points_m, segment.size), part.px_per_m(points_m, segment.size)
        terms = [term for term in segment.problem.terms if isinstance(term, Reprojection)]
        for view, term, scale in zip(part.views, terms, px_per_m, strict=True):
            shifted_m = view.shift_to_exposure(world_m)
            weight = np.nan_to_num(term.weights(shifted_m))[..., None]
            residual_m = np.where(weight > 0, view.xy_px - view.project(shifted_m)[0], 0.0) / scale[:, None, None]
            seen_markers = np.flatnonzero(view.present.sum(axis=0) >= fitted_clip.correlation_frames)
            mean_m = (weight * residual_m).sum(axis=0)[seen_markers] / np.maximum(
                weight.sum(axis=0)[seen_markers], 1e-9
            )
            shared_m = np.median(mean_m, axis=0) if len(seen_markers) else 0.0
            for j, own_m in zip(seen_markers, mean_m - shared_m, strict=True):
                name = body.markers[j]
                squares[other_side(name) if follows(name, body) else name].append(float(own_m @ own_m) / 2)
    return {
        name: float(np.sqrt((sum(values) + _PRIOR_COUNT * expected_m**2) / (len(values) + _PRIOR_COUNT)))
        for name, values in squares.items()
    }


def _reduced(shape: Shape, clip: ClipProblem, segment: SegmentFit) -> tuple[Array, Array]:
    """Return the curvature (K, K) and gradient (K,) of a segment's cost for the shape, with the states eliminated."""
    states, problem = segment.estimate.states, segment.problem
    normal = problem.normal(states, segment.estimate.shared)
    K = len(shape)
    border, corner, gradient = np.zeros((*states.shape, K)), np.zeros((K, K)), np.zeros(K)
    pose = problem.tree.pose_with_jacobian(states)
    by_shape = shape.jacobian(clip.body, states)
    for term in problem.terms:
        if not isinstance(term, Reprojection | StanceVelocity | OnGround):
            continue
        shared = segment.estimate.shared
        by_state = term.evaluate(Span(0, states, pose, True, shared), jacobian=True)
        by_shape_rows = term.evaluate(Span(0, states, TreePose(pose.points_m, by_shape), True, shared), jacobian=True)
        of_shape = by_shape_rows.jacobian.sum(axis=2)
        for slot, offset in enumerate(term.stencil):
            border[offset : offset + len(of_shape)] += by_state.jacobian[:, :, slot].swapaxes(1, 2) @ of_shape
        corner += np.tensordot(of_shape, of_shape, ((0, 1), (0, 1)))
        gradient += np.tensordot(of_shape, by_shape_rows.residual, ((0, 1), (0, 1)))
    with_shape = replace(normal, border=border, corner=corner, shared_gradient=gradient)
    (window,) = eliminated([with_shape])
    reduced = window.reduced()
    return reduced[:, :-1], reduced[:, -1]
