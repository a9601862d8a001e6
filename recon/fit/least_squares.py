"""A clip as one non-linear least-squares problem, and its Levenberg-Marquardt solution on the banded normal equations.

Unknown are the states (T, D) of all frames, and a few quantities that all frames share. Every term reads a few
neighbouring frames, so that the curvature of the sum is block-banded, with a border for what is shared
(`recon.fit.banded`). A step solves

    (H + damping) step = -gradient

with H the Gauss-Newton curvature of all terms, reweighted for the robust ones; it is accepted on the robust cost.
The damping is the same for all unknowns, in radians and metres, and not the usual multiple of the diagonal: a slow
change of the whole path, such as its distance from the camera, is stiff in every single frame and soft only for all of
them together, and damping relative to the diagonal would freeze it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from recon.base.arrays import Array
from recon.fit.banded import BlockBanded, Normal, add_normal
from recon.fit.terms import COMMON_KEYPOINT_BIAS, Linear, Span, Term
from recon.geometry.kinematics import Tree

BANDS = 2
"""Frames before and after that a frame is coupled with."""
_FRAMES_AT_ONCE = 256
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-4, 1e6
_SHORTER = (1.0, 0.5, 0.2)
"""Steps tried along a direction before it is damped more."""


@dataclass(frozen=True)
class Shared:
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
    """tree: whose markers the terms read. linear, terms: see `recon.fit.terms`. shared: the unknowns, besides the
    states, that are free; everywhere below, `shared` are their values, by default the expected ones. doubtful: those
    that are taken for what is expected of them, and count in the posterior only."""

    tree: Tree
    linear: Sequence[Linear]
    terms: Sequence[Term]
    shared: Sequence[Shared] = ()
    doubtful: Sequence[Shared] = ()

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Which of all P shared unknowns are of each name."""
        ends = np.cumsum([len(unknown.mean) for unknown in self.shared], dtype=int)
        return {u.name: slice(int(end) - len(u.mean), int(end)) for u, end in zip(self.shared, ends, strict=True)}

    def expected(self) -> dict[str, Array]:
        """The shared unknowns' means."""
        return {unknown.name: unknown.mean for unknown in self.shared}

    def costs(self, states: Array, shared: Mapping[str, Array] | None = None) -> dict[str, float]:
        """By name of the term, and of the shared unknown."""
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
        """Of the terms with these names alone, and no shared unknowns."""
        linear = [term for term in self.linear if term.name in names]
        return LeastSquares(self.tree, linear, [term for term in self.terms if term.name in names])

    def squares(self, states: Array) -> float:
        """The sum of all squared residuals."""
        total = sum(float(np.sum(term.residual(states) ** 2)) for term in self.linear)
        for span in self.spans(states, self.expected(), jacobian=True):
            for term in self.terms:
                residual = term.evaluate(span, jacobian=True).residual
                assert residual is not None
                total += float(np.sum(residual**2))
        return total

    def cost(self, states: Array, shared: Mapping[str, Array] | None = None) -> float:
        return sum(self.costs(states, shared).values())

    def normal(self, states: Array, shared: Mapping[str, Array] | None = None) -> Normal:
        """The curvature and the gradient at a point."""
        shared = self.expected() if shared is None else shared
        (T, D), columns = states.shape, self.columns
        blocks, gradient = self._linear_blocks(T).copy(), np.zeros((T, D))
        none = np.zeros(0)
        precision = np.concatenate([none, *(unknown.sigma**-2.0 for unknown in self.shared)])
        off = np.concatenate([none, *(shared[unknown.name] - unknown.mean for unknown in self.shared)])
        border, corner, shared_gradient = np.zeros((T, D, len(off))), np.diag(precision), off * precision
        for term in self.linear:
            at, r = term.frames(T), term.residual(states)
            for offset, slot in zip(term.stencil, term.slots, strict=True):
                gradient[at + offset] += r @ slot
        for span in self.spans(states, shared, jacobian=True):
            for term in self.terms:
                rows = term.evaluate(span, jacobian=True)
                assert rows.residual is not None
                assert rows.jacobian is not None
                add_normal(blocks, gradient, rows.frames, term.stencil, rows.residual, rows.jacobian)
                for name, by_own in rows.by_shared.items():
                    own = columns[name]
                    for slot, offset in enumerate(term.stencil):
                        border[rows.frames + offset, :, own] += rows.jacobian[:, :, slot].swapaxes(1, 2) @ by_own
                    for other, by_other in rows.by_shared.items():
                        corner[own, columns[other]] += np.tensordot(by_own, by_other, ((0, 1), (0, 1)))
                    shared_gradient[own] += np.tensordot(by_own, rows.residual, ((0, 1), (0, 1)))
        return Normal(BlockBanded(blocks), gradient, border, corner, shared_gradient)

    def minimise(
        self,
        states: Array,
        tolerance: float,
        max_iterations: int,
        shared: Mapping[str, Array] | None = None,
        wanted: float = np.inf,
    ) -> Estimate:
        """The minimum from a start; stops when a step lowers the cost by less than tolerance times the cost, or times
        one: what a residual of a sigma and a half costs, below which rounding is all that is left to lower. And where
        another step like the last would not reach a wanted cost: nearly always they get smaller."""
        shared = self.expected() if shared is None else shared
        here = _Point(states, shared, self.cost(states, shared), _FIRST_DAMPING)
        for iteration in range(1, max_iterations + 1):
            lower = self._lower(here)
            done = lower is None or here.cost - lower.cost < tolerance * max(here.cost, 1.0)
            hopeless = lower is not None and 2 * lower.cost - here.cost > wanted
            here = lower or here
            if done or hopeless:  # without a direction that leads down, a minimum to rounding
                return Estimate(here.states, here.cost, iteration, done, here.shared)
        return Estimate(here.states, here.cost, max_iterations, False, here.shared)

    def _lower(self, here: _Point) -> _Point | None:
        """A point of lower cost along a step, damped as much as that needs."""
        normal, damping = self.normal(here.states, here.shared), here.damping
        while damping <= _MOST_DAMPING:
            try:
                step, shared_step = normal.step(damping)
                for share in _SHORTER:
                    trial = here.states + share * step
                    shared = {name: here.shared[name] + share * shared_step[own] for name, own in self.columns.items()}
                    cost = self.cost(trial, shared)
                    if cost < here.cost:
                        less = max(damping * (0.2 if share == 1.0 else 0.6), _LEAST_DAMPING)
                        return _Point(trial, shared, cost, less)
            except np.linalg.LinAlgError:  # not positive definite to rounding: more damping
                pass
            damping = max(20.0 * damping, _FIRST_DAMPING)
        return None

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

    @cached_property
    def _linear_cache(self) -> dict[int, Array]:
        return {}

    def _linear_blocks(self, T: int) -> Array:
        """(T, BANDS + 1, D, D): the curvature of the linear terms, the same at every point."""
        if T not in self._linear_cache:
            blocks = np.zeros((T, BANDS + 1, self.tree.n_state, self.tree.n_state))
            for term in self.linear:
                at = term.frames(T)
                for a, column in enumerate(term.stencil):
                    for b, row in enumerate(term.stencil[a:], start=a):
                        blocks[at + column, row - column] += term.slots[b].T @ term.slots[a]
            self._linear_cache[T] = blocks
        return self._linear_cache[T]


@dataclass(frozen=True, eq=False)
class _Point:
    states: Array
    shared: Mapping[str, Array]
    cost: float
    damping: float
