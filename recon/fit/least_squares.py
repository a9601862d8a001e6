"""Solve a clip as one non-linear least-squares problem, by Levenberg-Marquardt on the banded normal equations.

The unknowns are the states (T, D) of all frames and a few unknowns that all frames share. Every term reads a few
neighbouring frames, so that the Gauss-Newton curvature H is block-banded, with a border for the shared unknowns
(`recon.fit.banded`). A step solves (H + damping) step = -gradient, and is accepted on the robust cost. The damping is
the same for all unknowns, in radians and metres. Damping relative to the diagonal would freeze slow changes of the
whole path, which are stiff for every single frame and soft only for all frames together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce

import numpy as np

from recon.base.arrays import Array
from recon.fit.banded import Normal, add_normal, step
from recon.fit.body_shape import FreeShape
from recon.fit.marker_sums import ByShape, add_markers, add_to_columns
from recon.fit.terms import (
    COMMON_KEYPOINT_BIAS,
    FOOT_TERMS,
    LENGTHS,
    MARKER_TERMS,
    Linear,
    PoseMixture,
    Reprojection,
    Span,
    Term,
    TermRows,
    size_of,
    with_step,
)
from recon.geometry.kinematics import Tree, TreePose

BANDS = 2
"""Maximum distance, in frames, between two frames that a term couples."""
_FRAMES_AT_ONCE = 128
"""Number of frames whose terms are evaluated at once, few enough for the processor's cache."""
_PIECE_S = 5.5
"""Time (s) between frames at which they hardly influence each other, so that a long clip can be solved in pieces."""
_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e-4, 1e6
_MIN_EXCESS, _MAX_EXCESS = 0.1, 0.5
"""Minimum and maximum excess of a step's decrease of the cost over half the slope with which the step is extended.

The unit of the minimum is the decrease at which the search ends, and of the maximum the cost. Without longer steps,
clips that hardly determine the poses need many more iterations.
"""
_MAX_EXTENSION = 4.0
"""Maximum factor by which a step is extended."""
_STEP_FRACTIONS = (1.0, 0.5, 0.2)
"""Fractions of a step that are tried before the damping is increased."""


def frames_per_piece(fps: float) -> int:
    """Return the number of frames of a long clip that are solved at once, as one piece."""
    return _FRAMES_AT_ONCE * math.ceil(_PIECE_S * fps / _FRAMES_AT_ONCE)


@dataclass(frozen=True)
class SharedUnknown:
    """Group of P unknowns that all frames share, with a name, prior means (P,) and standard deviations (P,)."""

    name: str
    mean: Array
    sigma: Array


@dataclass(frozen=True)
class Estimate:
    """Values of all unknowns at a minimum, or at an intermediate point of the search, with their cost."""

    states: Array
    """Unknowns of each frame, shape (T, D)."""
    cost: float
    """Cost of all terms: half the squared norm of the residuals, under the robust loss."""
    iterations: int
    converged: bool
    """Whether the search ended because the cost hardly decreased any more."""
    shared: Mapping[str, Array] = field(default_factory=dict)
    """Values (P,) of each group of shared unknowns, keyed by the group's name."""


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Least-squares problem of the terms (`recon.fit.terms`) of a clip, with unknowns that all frames share.

    The attribute `shared` holds the free unknowns. The argument `shared` of the methods holds values of these unknowns,
    by default the expected values. `nuisance` unknowns stay at their expected values and count only in the posterior.
    """

    tree: Tree
    linear: Sequence[Linear]
    terms: Sequence[Term]
    shared: Sequence[SharedUnknown] = ()
    nuisance: Sequence[SharedUnknown] = ()
    piece: int = 4 * _FRAMES_AT_ONCE
    """Number of frames in a piece of a long clip, a multiple of `_FRAMES_AT_ONCE`."""
    shape: FreeShape | None = None
    """Shape of the body, if `LENGTHS` and `COMMON_KEYPOINT_BIAS` are unknowns; None if they are not.

    The attribute `tree` has the shape before any change.
    """

    @property
    def ahead(self) -> int | None:
        """Return the number of frames of the next piece that represent all later frames; None for the whole piece.

        Several cameras determine the position so well that frames after half of `_PIECE_S` have no influence. One
        camera leaves the distance uncertain, and all frames contribute to it.
        """
        is_seen_by_several = sum(isinstance(term, Reprojection) for term in self.terms) > 1
        return self.piece // 2 if is_seen_by_several else None

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Return the slice of each group of unknowns among all P shared unknowns, keyed by the group's name."""
        ends = np.cumsum([len(unknown.mean) for unknown in self.shared], dtype=int)
        return {u.name: slice(int(end) - len(u.mean), int(end)) for u, end in zip(self.shared, ends, strict=True)}

    def expected(self) -> dict[str, Array]:
        """Return the prior means of the shared unknowns, as a dictionary whose keys are their names."""
        return {unknown.name: unknown.mean for unknown in self.shared}

    # The cost

    def costs(self, states: Array, shared: Mapping[str, Array] | None = None) -> dict[str, float]:
        """Return the cost of each term and of each shared unknown's prior, keyed by the name of the term or unknown."""
        shared = self.expected() if shared is None else shared
        costs: dict[str, float] = {}
        for unknown in self.shared:
            costs[unknown.name] = 0.5 * float(np.sum(((shared[unknown.name] - unknown.mean) / unknown.sigma) ** 2))
        for term in self.linear:
            costs[term.name] = costs.get(term.name, 0.0) + 0.5 * float(np.sum(term.residual(states) ** 2))
        for span in self.spans(states, shared, jacobian=False):
            for term in self.terms:
                costs[term.name] = costs.get(term.name, 0.0) + float(term.evaluate(span, jacobian=False).cost.sum())
        return costs

    def subset(self, names: Sequence[str]) -> LeastSquares:
        """Return the problem of only the named terms, without shared unknowns."""
        linear = [term for term in self.linear if term.name in names]
        terms = [term for term in self.terms if term.name in names]
        return replace(self, linear=linear, terms=terms, shared=(), nuisance=())

    def squares(self, states: Array, shared: Mapping[str, Array] | None = None, rows: slice = slice(None)) -> float:
        """Return the sum of the squared residuals of all terms, none of which may be a `Heading` or a term of the feet.

        Terms that are not linear count only in the frames `rows`.
        """
        total = sum(float(np.sum(term.residual(states) ** 2)) for term in self.linear)
        for span in self.spans(states, self.expected() if shared is None else shared, jacobian=False, rows=rows):
            for term in self.terms:
                # The residuals of detections do not need the markers' derivatives, which take long.
                is_camera = isinstance(term, Reprojection)
                term_rows = term.point_rows(span) if is_camera else term.evaluate(span, jacobian=True)
                total += float(np.sum(term_rows.residual**2))
        return total

    def cost(self, states: Array, shared: Mapping[str, Array] | None = None) -> float:
        """Return the cost of all terms and of the priors of the shared unknowns."""
        return sum(self.costs(states, shared).values())

    # The normal equations

    def normal(self, states: Array, shared: Mapping[str, Array] | None = None, rows: slice = slice(None)) -> Normal:
        """Return the normal equations of the frames `rows` at given values of the unknowns, with other frames fixed."""
        start, stop, _ = rows.indices(len(states))
        (whole,) = self._pieces(states, shared, [stop], start)
        return whole

    def normals(self, states: Array, shared: Mapping[str, Array] | None = None) -> Callable[[], Iterable[Normal]]:
        """Return a function that gives the normal equations in pieces.

        The pieces are computed again at each call, unless the clip is short.
        """
        stops = self._stops(len(states))
        if len(stops) > 1:
            return lambda: self._pieces(states, shared, stops)
        whole = [self.normal(states, shared)]
        return lambda: whole

    def middle_piece(self, states: Array, shared: Mapping[str, Array]) -> tuple[slice, Normal]:
        """Return the slice of frames in the middle piece of a clip, and the normal equations of this piece."""
        T, stops = len(states), self._stops(len(states))
        if len(stops) == 1:
            return slice(0, T), self.normal(states, shared)
        i = next(i for i, stop in enumerate(stops) if stop > T // 2)  # the first piece ends before the middle, so i > 0
        start, stop = stops[i - 1], stops[i]
        # the terms of the previous frame read the first frame of the piece
        _, piece = self._pieces(states, shared, [start, stop], start - _FRAMES_AT_ONCE)
        return slice(start, stop), piece

    def _stops(self, T: int) -> list[int]:
        """Return the ends of the pieces of T frames, of which the last is up to twice as long as the others."""
        return [*range(self.piece, T - self.piece, self.piece), T]

    def _pieces(
        self, states: Array, shared: Mapping[str, Array] | None, stops: Sequence[int], start: int = 0
    ) -> Iterator[Normal]:
        """Yield the normal equations piece by piece, from frame `start` on.

        `stops` are the ends of the pieces, of which all but the last are multiples of `_FRAMES_AT_ONCE` after the
        start.
        """
        shared = self.expected() if shared is None else shared
        (T, D), empty = states.shape, np.zeros(0)
        precision = np.concatenate([empty, *(unknown.sigma**-2.0 for unknown in self.shared)])
        deviation = np.concatenate([empty, *(shared[unknown.name] - unknown.mean for unknown in self.shared)])
        linear = [(term, term.residual(states)) for term in self.linear]
        cost = 0.5 * float(deviation**2 @ precision + sum(np.vdot(residual, residual) for _, residual in linear))
        spans, P = self.spans(states, shared, jacobian=True, rows=slice(start, stops[-1])), len(deviation)
        span, overlap = next(spans, None), None
        for stop in stops:
            # a span includes the next frame, which the terms of its last frame may read
            n, has_next = stop - start, int(stop < T)
            blocks, gradient = np.empty((n + has_next, BANDS + 1, D, D)), np.zeros((n + has_next, D))
            border, corner, shared_gradient = np.zeros((n + has_next, D, P)), np.zeros((P, P)), np.zeros(P)
            self._linear_blocks(start, T, blocks[:n])
            blocks[n:] = 0.0
            if overlap is None:  # the priors of the shared unknowns count once, in the first piece
                corner, shared_gradient = np.diag(precision), deviation * precision
            else:
                blocks[0] += overlap[0]
                gradient[0] += overlap[1]
                border[0] += overlap[2]
            for term, residual in linear:
                _add_linear_gradient(gradient, term, residual, start, stop)
            sums = Normal(blocks, gradient, border, corner, shared_gradient)
            while span is not None and span.first < stop:
                cost += self._add_span(sums, span, start)
                span = next(spans, None)
            overlap = (blocks[n], gradient[n], border[n]) if has_next else None
            yield Normal(blocks[:n], gradient[:n], border[:n], corner, shared_gradient, cost)
            start, cost = stop, 0.0

    def _add_span(self, sums: Normal, span: Span, start: int) -> float:
        """Add the normal equations of a span's non-linear terms to `sums` in place, and return the terms' cost.

        `start` is the first frame of `sums`.
        """
        by_shape, first = self._by_shape(span), span.first - start
        cameras, cost = self._cameras_in_step(span), 0.0
        # If the common keypoint bias is an unknown of its own, only the detections depend on it.
        feet = [term for term in self.terms if isinstance(term, FOOT_TERMS) and cameras and span.rotations is None]
        merged: list[Term] = [*cameras, *feet]
        if cameras:
            every_camera = [camera.point_rows(span) for camera in cameras]
            every_foot = [foot.foot_rows(span) for foot in feet]
            cost += add_markers(sums, self.columns, every_camera, every_foot, span, start, by_shape)
        by_stencil: dict[tuple[int, ...], list[TermRows]] = {}
        for term in self.terms:
            if any(term is merged_term for merged_term in merged):
                continue
            if isinstance(term, PoseMixture):
                frames = slice(first, first + span.own_rows.stop)
                cost += float(term.add_normal(span, sums.blocks[frames, 0], sums.gradient[frames]).sum())
                continue
            by_stencil.setdefault(term.stencil, []).append(_rows_with_shape(term, span, by_shape))
        for stencil, rows_of_terms in by_stencil.items():  # the blocks are passed through only once for each stencil
            rows = _together(rows_of_terms)
            cost += float(rows.cost.sum())
            add_normal(sums.blocks, sums.gradient, first, stencil, rows.residual, rows.jacobian)
            _add_shared(self.columns, sums.border, sums.corner, sums.shared_gradient, first, stencil, rows)
        return cost

    # The search

    def minimise(
        self, states: Array, tolerance: float, max_iterations: int, shared: Mapping[str, Array] | None = None
    ) -> Estimate:
        """Return the minimum that a search reaches from given states (T, D).

        The search stops when a step lowers the cost by less than tolerance times max(|cost|, 1). After two whole steps,
        the search also stops if the ratio of the last two decreases predicts so small a decrease for the next step.
        """
        shared = self.expected() if shared is None else shared
        current, damping = Estimate(states, np.nan, 0, False, shared), _FIRST_DAMPING  # the step computes the cost
        last_decrease = 0.0
        for iteration in range(1, max_iterations + 1):
            current, lower, is_whole, damping = self._damped_step(current, damping, tolerance)
            decrease = 0.0 if lower is None else current.cost - lower.cost
            rate = decrease / last_decrease if is_whole and last_decrease else 1.0
            done = min(rate, 1.0) * decrease < _enough(current.cost, tolerance)
            current = replace(lower or current, iterations=iteration, converged=done)
            if done:  # also if no direction lowers the cost, which is a minimum to rounding
                break
            last_decrease = decrease if is_whole else 0.0
        return current

    def _damped_step(
        self, current: Estimate, damping: float, tolerance: float
    ) -> tuple[Estimate, Estimate | None, bool, float]:
        """Return the current estimate and one of lower cost along a step, whether its step is whole, and a damping.

        The current estimate may come without its cost (NaN), and is returned with it. The other estimate is None if no
        damping leads to a lower cost. Its step is whole if it was not shortened. If the cost curves less along a whole
        step than in the quadratic model, a longer step is tried as well. The damping is that of the next step.
        """
        normals = self.normals(current.states, current.shared)
        while damping <= _MAX_DAMPING:
            try:
                states_step, shared_step, slope, cost = step(normals(), damping, self.ahead)
                if math.isnan(current.cost):
                    current = replace(current, cost=cost)
                for fraction in _STEP_FRACTIONS:
                    trial = self._moved(current, states_step, shared_step, fraction)
                    if trial.cost < current.cost:
                        next_damping = max(damping * (0.2 if fraction == 1.0 else 0.6), _MIN_DAMPING)
                        if fraction < 1.0:
                            return current, trial, False, next_damping
                        # The cost of the quadratic model falls by half the slope.
                        excess = current.cost - trial.cost + 0.5 * slope
                        least = _MIN_EXCESS * _enough(current.cost, tolerance)
                        if least < excess < _enough(current.cost, _MAX_EXCESS):
                            length = _best_length(current.cost - trial.cost, slope)
                            further = self._moved(current, states_step, shared_step, length)
                            trial = further if further.cost < trial.cost else trial
                        return current, trial, True, next_damping
            except np.linalg.LinAlgError:  # the matrix is not positive definite to rounding, and needs more damping
                pass
            damping = max(20.0 * damping, _FIRST_DAMPING)
        if math.isnan(current.cost):  # no step could be computed
            current = replace(current, cost=self.cost(current.states, current.shared))
        return current, None, False, damping

    def _moved(self, current: Estimate, states_step: Array, shared_step: Array, length: float) -> Estimate:
        """Return the values of the unknowns after a step times `length`, with their cost.

        If there are several cameras, which determine the animal's position in the world, this position changes linearly
        along the step (`with_step`). With one camera, the root at nominal size changes linearly instead, because the
        picture depends more on the root than on the size.
        """
        shared = {name: current.shared[name] + length * shared_step[columns] for name, columns in self.columns.items()}
        sizes = size_of(current.shared), size_of(shared)
        if sum(isinstance(term, Reprojection) for term in self.terms) < 2:
            sizes = 1.0, 1.0
        states = with_step(current.states, length * states_step, *sizes)
        return replace(current, states=states, cost=self.cost(states, shared), shared=shared)

    # Spans of frames, and linear terms

    def spans(
        self, states: Array, shared: Mapping[str, Array], jacobian: bool, rows: slice = slice(None)
    ) -> Iterator[Span]:
        """Yield spans of the clip, or of some of its frames, that overlap by one frame."""
        tree = self.tree if self.shape is None else self.shape.applied(shared).detected
        pose = tree.pose_with_jacobian if jacobian else tree.pose
        if not any(isinstance(term, MARKER_TERMS) for term in self.terms):
            pose = _no_markers
        segment_of_marker: list[int] | None = None
        if jacobian and COMMON_KEYPOINT_BIAS in shared and self.shape is None:
            names = [segment.name for segment in tree.segments]
            segment_of_marker = [names.index(marker.segment) for marker in tree.markers]
        start, stop, _ = rows.indices(len(states))
        for first in range(start, stop, _FRAMES_AT_ONCE):
            span_states = states[first : min(first + _FRAMES_AT_ONCE, stop) + 1]
            last = first + len(span_states) == len(states)
            rotations = None if segment_of_marker is None else tree.orientations(span_states)[:, segment_of_marker]
            yield Span(first, span_states, pose(span_states), last, shared, rotations)
            if last:
                return

    def _cameras_in_step(self, span: Span) -> list[Reprojection]:
        """Return the cameras that took pictures at the frame times, for `add_markers`; empty for fewer than two."""
        cameras = [term for term in self.terms if isinstance(term, Reprojection) and len(term.stencil) == 1]
        return cameras if len(cameras) > 1 and len(span.pose.points_m[span.own_rows]) else []

    def _by_shape(self, span: Span) -> ByShape | None:
        """Return the derivatives of a span's markers with respect to the shape; None if the shape is not an unknown."""
        if self.shape is None or LENGTHS not in self.columns:
            return None
        return self.shape.derivatives(span.shared, span.states)

    def _linear_blocks(self, start: int, T: int, blocks: Array) -> None:
        """Fill blocks (n, BANDS + 1, D, D) with the linear terms' curvature, from frame `start` of T frames."""
        frames, curvature = np.arange(start, start + len(blocks)), self._linear_kinds
        if len(curvature) >= T:
            curvature, kinds = self._linear_curvature(T), frames
        else:  # the first and last frames have their own kinds, and all frames between them the kind BANDS
            kinds = np.where(frames < BANDS, frames, np.maximum(BANDS, frames - T + len(curvature)))
        curvature.take(kinds, axis=0, out=blocks, mode="clip")  # the default mode writes through a buffer

    @cached_property
    def _linear_kinds(self) -> Array:
        """Return the distinct blocks of the linear terms' curvature, (2 BANDS + 1, BANDS + 1, D, D).

        They belong to the first frames of a clip, to any middle frame, and to the last frames.
        """
        return self._linear_curvature(2 * BANDS + 1)

    def _linear_curvature(self, T: int) -> Array:
        """Return the curvature of the linear terms of a whole clip, (T, BANDS + 1, D, D), for any states."""
        blocks = np.zeros((T, BANDS + 1, self.tree.n_state, self.tree.n_state))
        for term in self.linear:
            frames = term.frames(T)
            for (column, row), block in term.curvature.items() if len(frames) else ():
                blocks[frames[0] + column : frames[-1] + column + 1, row - column] += block
        return blocks


def _no_markers(states: Array) -> TreePose:
    return TreePose(np.zeros((len(states), 0, 3)), np.zeros((len(states), 0, 3, states.shape[1])))


def _enough(cost: float, tolerance: float) -> float:
    """Return the decrease of a cost at which a search with a relative tolerance ends."""
    return tolerance * max(abs(cost), 1.0)


def _best_length(decrease: float, slope: float) -> float:
    """Return the factor on a step, at most `_MAX_EXTENSION`, that minimises a parabola through the costs."""
    bend = -decrease - slope  # the cost at length x is slope x + bend x^2
    return min(-0.5 * slope / bend, _MAX_EXTENSION) if bend > 0 else _MAX_EXTENSION


def _add_linear_gradient(gradient: Array, term: Linear, residual: Array, start: int, stop: int) -> None:
    """Add a linear term's gradient for the frames from start up to stop in place, from its residual of a whole clip."""
    for offset, slot in zip(term.stencil, term.slots, strict=True):
        row = offset - term.stencil[0] - start  # of the gradient to which the first residual belongs
        first, last = max(-row, 0), min(stop - start - row, len(residual))
        if first < last:
            gradient[row + first : row + last] += residual[first:last] @ slot


def _rows_with_shape(term: Term, span: Span, by_shape: ByShape | None) -> TermRows:
    """Return the residuals and derivatives of a term of the cost, including derivatives by the body's shape.

    The term is evaluated for its own markers only, which move with the states, the lengths and their own offsets.
    """
    if by_shape is None or not isinstance(term, MARKER_TERMS):
        return term.evaluate(span, jacobian=True)
    J, D = span.pose.points_m.shape[1], span.states.shape[1]
    markers, term = term.on_own_markers(J)
    by_length, by_offset = (values[:, markers] for values in by_shape)
    n, count, _, L = by_length.shape
    by_offsets, indices = np.zeros((n, count, 3, count, 3)), np.arange(count)
    by_offsets[:, indices, :, indices] = by_offset.swapaxes(0, 1)
    by_unknowns = [span.pose.jacobian[:, markers], by_length, by_offsets.reshape(n, count, 3, 3 * count)]
    pose = TreePose(span.pose.points_m[:, markers], np.concatenate(by_unknowns, axis=3))
    rows = term.evaluate(replace(span, pose=pose), jacobian=True)
    of_shape = rows.jacobian[..., D:].sum(axis=2)
    N, M = of_shape.shape[:2]
    of_offsets = np.zeros((N, M, J, 3))
    of_offsets[:, :, markers] = of_shape[..., L:].reshape(N, M, count, 3)
    by_shared = {LENGTHS: of_shape[..., :L], COMMON_KEYPOINT_BIAS: of_offsets.reshape(N, M, 3 * J)}
    return replace(rows, jacobian=rows.jacobian[..., :D], by_shared={**rows.by_shared, **by_shared})


def _together(rows_of_terms: Sequence[TermRows]) -> TermRows:
    """Join the residuals and derivatives of several terms with the same stencil, as if they were one term."""
    if len(rows_of_terms) == 1:
        return rows_of_terms[0]
    counts = [rows.residual.shape[1] for rows in rows_of_terms]
    ends = np.cumsum(counts)
    N, by_shared = len(rows_of_terms[0].residual), dict[str, Array]()
    for rows, count, end in zip(rows_of_terms, counts, ends, strict=True):
        for name, values in rows.by_shared.items():
            whole = by_shared.setdefault(name, np.zeros((N, int(ends[-1]), values.shape[2])))
            whole[:, end - count : end] = values
    residual = np.concatenate([rows.residual for rows in rows_of_terms], axis=1)
    jacobian = np.concatenate([rows.jacobian for rows in rows_of_terms], axis=1)
    return TermRows(reduce(np.add, (rows.cost for rows in rows_of_terms)), residual, jacobian, by_shared)


def _add_shared(
    columns: Mapping[str, slice],
    border: Array,
    corner: Array,
    shared_gradient: Array,
    first: int,
    stencil: Sequence[int],
    rows: TermRows,
) -> None:
    """Add a term's normal equations for the shared unknowns in place: J'K to border, K'K to corner, K'r to gradient.

    K holds the derivatives of the term's residuals with respect to the unknowns of `columns`. The term's first frame
    has the index `first` in the border.
    """
    by_shared = {name: rows.by_shared[name] for name in rows.by_shared if name in columns}
    if not by_shared:
        return
    shared_columns = np.concatenate([np.r_[columns[name]] for name in by_shared])
    K = np.concatenate([*by_shared.values()], axis=2)
    is_read = K.any(axis=(0, 1))  # a foot depends on few of the lengths, and on no bias but its own
    K, shared_columns = K[..., is_read], shared_columns[is_read]
    for slot, offset in enumerate(stencil):
        frames = slice(first + offset, first + offset + len(K))
        add_to_columns(border[frames], shared_columns, rows.jacobian[:, :, slot].swapaxes(1, 2) @ K)
    flat = K.reshape(rows.residual.size, len(shared_columns))
    corner[np.ix_(shared_columns, shared_columns)] += flat.T @ flat
    shared_gradient[shared_columns] += flat.T @ rows.residual.ravel()
