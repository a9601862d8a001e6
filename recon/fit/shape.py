"""The shape of one animal and its detector, from clips that several cameras filmed.

What all clips share are the lengths of the body's segments, left equal to right, as factors on the skeleton's, and how
far the detector's keypoints lie from the markers. Each clip is solved for a given shape; at its minimum the states are
eliminated from the normal equations (`recon.fit.banded`), S = C - B' H^-1 B, and the shape takes the Gauss-Newton step
of the sum over the clips and of what is expected of shapes. A few rounds of both lead to the minimum over all unknowns.
The inverse of the sum is the shape's covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from threadpoolctl import threadpool_limits

from recon.animal.body import Body, other_side, side_of
from recon.base.arrays import Array
from recon.fit.banded import eliminated
from recon.fit.clip_problem import ClipProblem
from recon.fit.terms import OnGround, Reprojection, Span, StanceVelocity
from recon.fit.trajectory import SegmentFit, in_step, refined, solve_segments
from recon.geometry.kinematics import TreePose

LENGTH_SIGMA = 0.05
"""How far single lengths of an animal are from its size times the skeleton's, relative."""
OFFSET_SIGMA_M = 0.01
"""How far a keypoint is expected to lie from its marker along each axis. Keypoints lie further off than that, but a
body that is fitted to them adapts; of the values tried, this one lets single cameras of runs that were left out find
the published poses best (docs/benchmarks.md)."""
POSED_OFFSET_SIGMA_M = 0.02
"""The same where the poses are known, and an offset cannot be another pose."""
SIZE_HELD = 1e-4
"""Sigma of the size, which the lengths stand for."""
_AS_EXPECTED = 8
"""Views' worth of what is expected of a keypoint's spread."""
ROUNDS, CLOSE_ENOUGH = 8, 0.05
"""Rounds at most, and the step, in standard deviations, that ends them."""


@dataclass(frozen=True, eq=False)
class Shape:
    """The K unknowns of a body's shape: factors on lengths, by the logarithm, and then offsets of keypoints, metres."""

    body: Body
    lengths: tuple[str, ...] = ()
    """Segments and markers whose distance from their origin is unknown; the right side's follow the left's."""
    offsets: tuple[str, ...] = ()
    """Markers whose keypoints' offsets are unknown, each with x, y and z; the right side's are mirrored."""
    offset_sigma_m: float = OFFSET_SIGMA_M

    @classmethod
    def of(cls, body: Body, lengths: bool = True, offsets: bool = False) -> Shape:
        items = (*body.tree.segments[1:], *body.tree.markers) if lengths else ()
        named = (item.name for item in items if any(item.offset_m) and not _follows(item.name, body))
        return cls(body, tuple(named), tuple(m for m in body.markers if offsets and not _follows(m, body)))

    def __len__(self) -> int:
        """K"""
        return len(self.lengths) + 3 * len(self.offsets)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the K lengths that are estimated."""
        return (*self.lengths, *(f"{name}_{axis}" for name in self.offsets for axis in "xyz"))

    def expected_precision(self, size_sigma: float) -> Array:
        """(K, K): lengths share the animal's size, and differ a little from it."""
        n = len(self.lengths)
        covariance = np.diag(np.repeat([LENGTH_SIGMA**2, self.offset_sigma_m**2], [n, len(self) - n]))
        covariance[:n, :n] += size_sigma**2
        return np.linalg.inv(covariance)

    def applied(self, body: Body, values: Array) -> Body:
        """A body of this kind with that shape, values (K,), on top of its own."""
        factors = dict(zip(self.lengths, np.exp(values[: len(self.lengths)]), strict=True))
        shifts = dict(zip(self.offsets, values[len(self.lengths) :].reshape(-1, 3), strict=True))

        tree = body.tree.lengthened(lambda name: factors.get(self.leader(name), 1.0))
        offsets = dict(body.keypoint_offset_m)
        for name in self.body.markers:
            if (leader := self.leader(name)) in shifts:
                x, y, z = (float(v) for v in shifts[leader] * self._mirror(name))
                old = offsets.get(name, (0.0, 0.0, 0.0))
                offsets[name] = (old[0] + x, old[1] + y, old[2] + z)
        return replace(body, tree=tree, keypoint_offset_m=offsets)

    def jacobian(self, body: Body, states: Array) -> Array:
        """(N, J, 3, K): of the detected markers of a body with some shape, at nominal size, by the shape."""
        tree, n = body.tree, len(self.lengths)
        R = tree.orientations(states)
        frame = {segment.name: R[:, i] for i, segment in enumerate(tree.segments)}
        segments = {segment.name: segment for segment in tree.segments}
        by_shape = np.zeros((len(states), len(tree.markers), 3, len(self)))
        for j, marker in enumerate(tree.markers):
            name, at, on = marker.name, marker.offset_m, marker.segment
            while on is not None:
                if (leader := self.leader(name)) in self.lengths:
                    by_shape[:, j, :, self.lengths.index(leader)] += frame[on] @ np.array(at)
                segment = segments[on]
                name, at, on = segment.name, segment.offset_m, segment.parent
            if (leader := self.leader(marker.name)) in self.offsets:
                first = n + 3 * self.offsets.index(leader)
                by_shape[:, j, :, first : first + 3] = frame[marker.segment] * self._mirror(marker.name)
        return by_shape

    def leader(self, name: str) -> str:
        """The name whose unknowns this one's follow."""
        return other_side(name) if _follows(name, self.body) else name

    def _mirror(self, name: str) -> Array:
        return np.array([1.0, -1.0, 1.0]) if _follows(name, self.body) else np.ones(3)


def _follows(name: str, body: Body) -> bool:
    """Whether it is of the right side and has a counterpart on the left."""
    names = {*body.markers, *(segment.name for segment in body.tree.segments)}
    return side_of(name) == "right" and other_side(name) in names


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """The lengths of an animal that were found, with their covariance."""

    shape: Shape
    values: Array
    """The lengths that were found, shape (K,)."""
    covariance: Array
    """The covariance of the lengths, shape (K, K)."""
    converged: bool
    """Whether the last step was small."""
    keypoint_sigma_m: float
    """How far keypoints lie off in a single frame, what is left of the offsets included."""
    noise_m: dict[str, float]
    """The same by marker of the left and the middle."""
    spread_m: dict[str, float]
    """By marker of the left and the middle: how far off the offset its keypoints lie in one clip and camera, along each
    axis, the same all the time."""

    @cached_property
    def sigma(self) -> Array:
        """The standard deviations of the K lengths, shape (K,)."""
        return np.sqrt(np.diagonal(self.covariance))

    def seen(self, body: Body) -> Body:
        """A body of that shape with what was found of the detector, the right side as the left."""
        spread_m, noise_m = (
            {name: of[self.shape.leader(name)] for name in body.markers} for of in (self.spread_m, self.noise_m)
        )
        shaped, sigma_m = self.shape.applied(body, self.values), self.keypoint_sigma_m
        return replace(shaped, keypoint_sigma_m=sigma_m, keypoint_spread_m=spread_m, keypoint_noise_m=noise_m)


def fit_shape(shape: Shape, clips: Sequence[ClipProblem]) -> ShapeFit:
    """The shape of the animal in several clips.

    Each setting's body has the segments and markers of `shape.body`, and its own lengths; its size is not free.

    Raises ValueError without any clip that can be solved.
    """
    expected = shape.expected_precision(clips[0].size_sigma)
    given = [replace(one, options=replace(one.options, size_sigma=SIZE_HELD)) for one in clips]
    values, converged, total = np.zeros(len(shape)), False, expected
    with threadpool_limits(1, user_api="blas"):
        solved = [(one, segment) for one in given for segment in solve_segments(one)]
        firsts = [one for one, _ in solved]
        if not solved:
            raise ValueError("no clip has a frame with enough detections")
        for _ in range(ROUNDS):
            total, pull = expected.copy(), expected @ values
            for one, segment in solved:
                curvature, gradient = _reduced(shape, one, segment)
                total += curvature / one.correlation_frames
                pull += gradient / one.correlation_frames
            step = -np.linalg.solve(total, pull)
            values = values + step
            solved = [
                (now := replace(one, body=shape.applied(first.body, values)), refined(now, segment))
                for first, (one, segment) in zip(firsts, solved, strict=True)
            ]
            converged = bool(step @ total @ step < CLOSE_ENOUGH**2 * len(step))
            if converged:
                break
    covariance = np.asarray(np.linalg.inv(total), dtype=float)
    # (J, views), of each marker's logarithm
    noise_m = np.concatenate([np.log(one.in_frame_m) + 0.5 * np.log(segment.noise) for one, segment in solved]).T
    by_marker: dict[str, list[Array]] = {}
    for name, of in zip(shape.body.markers, noise_m, strict=True):
        by_marker.setdefault(shape.leader(name), []).append(of)
    each_m = {name: float(np.exp(np.mean(of))) for name, of in by_marker.items()}
    sigma_m, spread_m = float(np.exp(noise_m.mean())), _spread_m(shape.body, solved)
    return ShapeFit(shape, values, covariance, converged, sigma_m, each_m, spread_m)


def _spread_m(body: Body, solved: Sequence[tuple[ClipProblem, SegmentFit]]) -> dict[str, float]:
    """From the mean residuals of every marker in every view, less what all markers of the view share, and as if as many
    more had been as is expected: few say little."""
    clip = solved[0][0]
    expected_m = clip.keypoint_bias_m
    squares: dict[str, list[float]] = {name: [] for name in body.markers if not _follows(name, body)}
    for one, segment in solved:
        part = in_step(one.part(segment.rows), segment)
        points_m = one.markers(segment.estimate.states)
        world_m, px_per_m = part.in_world(points_m, segment.size), part.px_per_m(points_m, segment.size)
        terms = [term for term in segment.problem.terms if isinstance(term, Reprojection)]
        for view, term, scale in zip(part.views, terms, px_per_m, strict=True):
            at = view.shift_to_exposure(world_m)
            weight = np.nan_to_num(term.weights(at))[..., None]
            off_m = np.where(weight > 0, view.xy_px - view.project(at)[0], 0.0) / scale[:, None, None]
            seen = np.flatnonzero(view.present.sum(axis=0) >= one.correlation_frames)
            mean_m = (weight * off_m).sum(axis=0)[seen] / np.maximum(weight.sum(axis=0)[seen], 1e-9)
            shared_m = np.median(mean_m, axis=0) if len(seen) else 0.0
            for j, own in zip(seen, mean_m - shared_m, strict=True):
                name = body.markers[j]
                squares[other_side(name) if _follows(name, body) else name].append(float(own @ own) / 2)
    return {
        name: float(np.sqrt((sum(of) + _AS_EXPECTED * expected_m**2) / (len(of) + _AS_EXPECTED)))
        for name, of in squares.items()
    }


def _reduced(shape: Shape, clip: ClipProblem, solved: SegmentFit) -> tuple[Array, Array]:
    """Curvature (K, K) and gradient (K,) of a segment's cost by the shape, the states eliminated."""
    states, problem = solved.estimate.states, solved.problem
    normal = problem.normal(states, solved.estimate.shared)
    K = len(shape)
    border, corner, gradient = np.zeros((*states.shape, K)), np.zeros((K, K)), np.zeros(K)
    pose = problem.tree.pose_with_jacobian(states)
    by_shape = shape.jacobian(clip.body, states)
    for term in problem.terms:
        if not isinstance(term, Reprojection | StanceVelocity | OnGround):
            continue
        shared = solved.estimate.shared
        by_state = term.evaluate(Span(0, states, pose, True, shared), jacobian=True)
        rows = term.evaluate(Span(0, states, TreePose(pose.points_m, by_shape), True, shared), jacobian=True)
        of_shape = rows.jacobian.sum(axis=2)
        for slot, offset in enumerate(term.stencil):
            border[offset : offset + len(of_shape)] += by_state.jacobian[:, :, slot].swapaxes(1, 2) @ of_shape
        corner += np.tensordot(of_shape, of_shape, ((0, 1), (0, 1)))
        gradient += np.tensordot(of_shape, rows.residual, ((0, 1), (0, 1)))
    by_shape = replace(normal, border=border, corner=corner, shared_gradient=gradient)
    (window,) = eliminated([by_shape])
    reduced = window.reduced()
    return reduced[:, :-1], reduced[:, -1]
