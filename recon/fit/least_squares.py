"""A clip as one non-linear least-squares problem, and its Levenberg-Marquardt solution on the banded normal equations.

Unknown are the states (T, D) of all frames, and a few quantities that all frames share. Every term reads a few
neighbouring frames, so that the Gauss-Newton curvature H is block-banded, with a border for what is shared
(`recon.fit.banded`). A step solves (H + damping) step = -gradient, and is accepted on the robust cost. The damping is
the same for all unknowns, in radians and metres: relative to the diagonal it would freeze slow changes of the whole
path, which are stiff in every single frame and soft only for all of them together."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from recon.base.arrays import Array
from recon.fit.banded import Normal, add_normal, step
from recon.fit.terms import COMMON_KEYPOINT_BIAS, Linear, Span, Term
from recon.geometry.kinematics import Tree

BANDS = 2
"""Frames before and after that a frame is coupled with."""
_FRAMES_AT_ONCE = 256
_PIECE_S = 5.5
"""Frames so far apart do not matter for each other: a clip solved in pieces has the states of the whole to 1e-6."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-4, 1e6
_SHORTER = (1.0, 0.5, 0.2)
"""Steps tried along a direction before it is damped more."""


def piece_of(fps: float) -> int:
    """How many frames of a long clip are solved at once."""
    return _FRAMES_AT_ONCE * math.ceil(_PIECE_S * fps / _FRAMES_AT_ONCE)


@dataclass(frozen=True)
class Unknown:
    """Unknowns (P,) of one name that all frames share, and what is expected of each."""

    name: str
    mean: Array
    sigma: Array


@dataclass(frozen=True)
class Estimate:
    """states (T, D); cost: half the squared norm, robust; iterations; converged: the tolerance was met; shared: the
    values (P,) of the shared unknowns, by name."""

    states: Array
    cost: float
    iterations: int
    converged: bool
    shared: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Terms (`recon.fit.terms`) that read a tree's markers, and the shared unknowns: those that are free (everywhere
    below, `shared` are their values, by default the expected ones), and the doubtful, which are taken for what is
    expected of them and count in the posterior only."""

    tree: Tree
    linear: Sequence[Linear]
    terms: Sequence[Term]
    shared: Sequence[Unknown] = ()
    doubtful: Sequence[Unknown] = ()
    piece: int = 2 * _FRAMES_AT_ONCE
    """Frames of a piece of a long clip, a multiple of `_FRAMES_AT_ONCE`, which takes as many along."""

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Which of all P shared unknowns are of each name."""
        ends = np.cumsum([len(unknown.mean) for unknown in self.shared], dtype=int)
        return {u.name: slice(int(end) - len(u.mean), int(end)) for u, end in zip(self.shared, ends, strict=True)}

    def expected(self) -> dict[str, Array]:
        return {unknown.name: unknown.mean for unknown in self.shared}

    def costs(self, states: Array, shared: Mapping[str, Array] | None = None) -> dict[str, float]:
        """Half the squared norm, robust, by name of the term and of the shared unknown."""
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

    def only(self, names: Sequence[str]) -> LeastSquares:
        """The problem of the terms with these names alone, without shared unknowns."""
        linear = [term for term in self.linear if term.name in names]
        terms = [term for term in self.terms if term.name in names]
        return replace(self, linear=linear, terms=terms, shared=(), doubtful=())

    def squares(self, states: Array, shared: Mapping[str, Array] | None = None) -> float:
        """The sum of all squared residuals."""
        total = sum(float(np.sum(term.residual(states) ** 2)) for term in self.linear)
        for span in self.spans(states, self.expected() if shared is None else shared, jacobian=True):
            for term in self.terms:
                total += float(np.sum(term.evaluate(span, jacobian=True).residual ** 2))
        return total

    def cost(self, states: Array, shared: Mapping[str, Array] | None = None) -> float:
        return sum(self.costs(states, shared).values())

    def normal(self, states: Array, shared: Mapping[str, Array] | None = None) -> Normal:
        """The curvature and the gradient at a point."""
        (whole,) = self._pieces(states, shared, [len(states)])
        return whole

    def normals(self, states: Array, shared: Mapping[str, Array] | None = None) -> Callable[[], Iterable[Normal]]:
        """The same in pieces, which are made anew with each call, unless the clip is short."""
        T = len(states)
        if 2 * self.piece < T:
            return lambda: self._pieces(states, shared, [*range(self.piece, T - self.piece, self.piece), T])
        whole = [self.normal(states, shared)]
        return lambda: whole

    def _pieces(self, states: Array, shared: Mapping[str, Array] | None, stops: Sequence[int]) -> Iterator[Normal]:
        """stops: where each piece ends; all but the last are multiples of `_FRAMES_AT_ONCE`."""
        shared = self.expected() if shared is None else shared
        (T, D), columns, none = states.shape, self.columns, np.zeros(0)
        precision = np.concatenate([none, *(unknown.sigma**-2.0 for unknown in self.shared)])
        off = np.concatenate([none, *(shared[unknown.name] - unknown.mean for unknown in self.shared)])
        linear = [(term, term.residual(states)) for term in self.linear]
        spans, start, P = self.spans(states, shared, jacobian=True), 0, len(off)
        span, over = next(spans, None), None
        for stop in stops:
            n, more = stop - start, int(stop < T)  # terms of the last frame may reach one further
            blocks, gradient = np.zeros((n + more, BANDS + 1, D, D)), np.zeros((n + more, D))
            border, corner, shared_gradient = np.zeros((n + more, D, P)), np.zeros((P, P)), np.zeros(P)
            self._linear_blocks(start, T, blocks[:n])
            if over is None:
                corner, shared_gradient = np.diag(precision), off * precision
            else:
                blocks[0] += over[0]
                gradient[0] += over[1]
                border[0] += over[2]
            for term, residual in linear:
                at = term.frames(T)
                for offset, slot in zip(term.stencil, term.slots, strict=True):
                    first, last = np.searchsorted(at + offset, [start, stop])
                    gradient[at[first:last] + offset - start] += residual[first:last] @ slot
            while span is not None and span.first < stop:
                for term in self.terms:
                    rows = term.evaluate(span, jacobian=True)
                    first = span.first - start
                    add_normal(blocks, gradient, first, term.stencil, rows.residual, rows.jacobian)
                    by_shared = {name: rows.by_shared[name] for name in rows.by_shared if name in columns}
                    for name, by_own in by_shared.items():
                        for slot, offset in enumerate(term.stencil):
                            at = slice(first + offset, first + offset + len(by_own))
                            border[at, :, columns[name]] += rows.jacobian[:, :, slot].swapaxes(1, 2) @ by_own
                    if by_shared:
                        own = np.concatenate([np.r_[columns[name]] for name in by_shared])
                        flat = np.concatenate([*by_shared.values()], axis=2).reshape(-1, len(own))
                        corner[np.ix_(own, own)] += flat.T @ flat
                        shared_gradient[own] += flat.T @ rows.residual.ravel()
                span = next(spans, None)
            over = (blocks[n], gradient[n], border[n]) if more else None
            yield Normal(blocks[:n], gradient[:n], border[:n], corner, shared_gradient)
            start = stop

    def minimise(
        self, states: Array, tolerance: float, max_iterations: int, shared: Mapping[str, Array] | None = None
    ) -> Estimate:
        """The minimum from a start; stops when a step lowers the cost by less than tolerance times the cost, or one."""
        shared = self.expected() if shared is None else shared
        here, damping = Estimate(states, self.cost(states, shared), 0, False, shared), _FIRST_DAMPING
        for iteration in range(1, max_iterations + 1):
            lower, damping = self._lower(here, damping)
            done = lower is None or here.cost - lower.cost < tolerance * max(here.cost, 1.0)
            here = replace(lower or here, iterations=iteration, converged=done)
            if done:  # without a direction that leads down, a minimum to rounding
                break
        return here

    def _lower(self, here: Estimate, damping: float) -> tuple[Estimate | None, float]:
        """A point of lower cost along a step, damped as much as that needs, and the damping to go on with."""
        normals = self.normals(here.states, here.shared)
        while damping <= _MOST_DAMPING:
            try:
                moved, shared_step = step(normals(), damping)
                for share in _SHORTER:
                    trial = here.states + share * moved
                    shared = {name: here.shared[name] + share * shared_step[own] for name, own in self.columns.items()}
                    cost = self.cost(trial, shared)
                    if cost < here.cost:
                        less = max(damping * (0.2 if share == 1.0 else 0.6), _LEAST_DAMPING)
                        return replace(here, states=trial, cost=cost, shared=shared), less
            except np.linalg.LinAlgError:  # not positive definite to rounding: more damping
                pass
            damping = max(20.0 * damping, _FIRST_DAMPING)
        return None, damping

    def spans(self, states: Array, shared: Mapping[str, Array], jacobian: bool) -> Iterator[Span]:
        """The clip in pieces that overlap by one frame."""
        pose = self.tree.pose_with_jacobian if jacobian else self.tree.pose
        names = [segment.name for segment in self.tree.segments]
        at = [names.index(marker.segment) for marker in self.tree.markers]
        for first in range(0, len(states), _FRAMES_AT_ONCE):
            piece = states[first : first + _FRAMES_AT_ONCE + 1]
            last = first + len(piece) == len(states)
            turned = self.tree.orientations(piece)[:, at] if jacobian and COMMON_KEYPOINT_BIAS in shared else None
            yield Span(first, piece, pose(piece), last, shared, turned)
            if last:
                return

    def _linear_blocks(self, start: int, T: int, blocks: Array) -> None:
        """Fill blocks (n, BANDS + 1, D, D) with the linear terms' curvature in frames from `start` of a clip of T."""
        at, own = np.arange(start, start + len(blocks)), self._linear_kinds
        if len(own) >= T:
            own, kinds = self._linear_curvature(T), at
        else:
            kinds = np.where(at < BANDS, at, np.maximum(BANDS, at - T + len(own)))
        own.take(kinds, axis=0, out=blocks, mode="clip")

    @cached_property
    def _linear_kinds(self) -> Array:
        """(2 BANDS + 1, BANDS + 1, D, D): the same in the first frames of a clip, in one amid it, and in the last."""
        return self._linear_curvature(2 * BANDS + 1)

    def _linear_curvature(self, T: int) -> Array:
        """(T, BANDS + 1, D, D): of the linear terms, the same at every point, of a whole clip."""
        blocks = np.zeros((T, BANDS + 1, self.tree.n_state, self.tree.n_state))
        for term in self.linear:
            for a, column in enumerate(term.stencil):
                for b, row in enumerate(term.stencil[a:], start=a):
                    blocks[term.frames(T) + column, row - column] += term.slots[b].T @ term.slots[a]
        return blocks
