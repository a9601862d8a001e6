"""What the optimiser did: the problem at its solution, row by row, and what came of it frame by frame.

Both methods minimise half the squared norm of residuals r, divided by their standard deviations, with a Jacobian J; of
robust terms r and J are as the solver weighs them, so that J'r is the gradient and J'J the curvature.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array, vstack

from recon.animal.chain import Chain
from recon.base.arrays import Array, Bools, Index
from recon.base.files import write_bytes
from recon.fit import TrajectorySolution
from recon.fit.banded import step as newton_step
from recon.fit.clip_problem import ClipProblem
from recon.fit.draws import at_solution
from recon.fit.least_squares import LeastSquares
from recon.fit.motion import Motion
from recon.geometry.kinematics import YAW
from recon.thesis.frame import FrameOptions, FrameSearch, FrameSolution, beyond_range_rad, beyond_rate_rad_s, frame_rows

CAMERA_ANGLES = ("xi", "psi", "zeta")
_LEAST_DAMPING = 1e-4
"""The least damping of the step that is left: that of the solver's last ones."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of a term, M for each of N frames."""

    term: str
    frames: Index
    """(N,), rows of the clip, all distinct."""
    stencil: tuple[int, ...]
    cost: Array
    """(N,)"""
    residual: Array
    """(N, M)"""
    jacobian: Array
    """(N, M, S, D), by the unknowns of the frames at the S offsets of the stencil."""


@dataclass(frozen=True, eq=False)
class _Linearised:
    """The problem at the solution, of T frames with D unknowns each. What all frames share, the size, is left out."""

    unknowns: tuple[str, ...]
    """(D,)"""
    frames: int
    """T"""
    rows: Callable[[], Iterable[_Rows]]
    """All rows, a few frames at a time: of a long clip they take gigabytes together."""
    step: Array
    """(T, D): what one more step would change, by the method that has one for the clip; NaN of the other."""

    @cached_property
    def cost(self) -> dict[str, Array]:
        """By term (T,), robust; NaN without a pose."""
        return self._sums[0]

    @cached_property
    def gradient(self) -> Array:
        """(T, D), NaN without a pose."""
        return self._sums[1]

    @cached_property
    def column_norm(self) -> Array:
        """(T, D): of the Jacobian's columns, NaN without a pose."""
        return np.sqrt(self._sums[2])

    @cached_property
    def solved(self) -> Bools:
        """Which of the T frames were solved, shape (T,)."""
        return np.isfinite(self.gradient[:, 0])

    @cached_property
    def _sums(self) -> tuple[dict[str, Array], Array, Array]:
        """The cost, the gradient, and the squared norms of columns."""
        cost: dict[str, Array] = {}
        solved, (gradient, squares) = np.zeros(self.frames, dtype=bool), np.zeros((2, self.frames, len(self.unknowns)))
        for rows in self.rows():
            solved[rows.frames] = True
            cost.setdefault(rows.term, np.zeros(self.frames))[rows.frames] += rows.cost
            for slot, offset in enumerate(rows.stencil):
                jacobian = rows.jacobian[:, :, slot]
                gradient[rows.frames + offset] += np.einsum("nm,nmd->nd", rows.residual, jacobian)
                squares[rows.frames + offset] += np.einsum("nmd,nmd->nd", jacobian, jacobian)
        for values in (*cost.values(), gradient, squares):
            values[~solved] = np.nan
        return cost, gradient, squares

    def write_jacobian(self, path: Path) -> None:
        """As NPZ that `scipy.sparse.load_npz` reads as a matrix (M, T D), column t D + d: the unknown d of row t of the
        clip; with it unknowns (D,), and of every row its residual, term, and the frame that it stands for."""
        D, parts, residual, term, frame = len(self.unknowns), [], [], [], []
        for rows in self.rows():
            n, m, slot, d = np.nonzero(rows.jacobian)
            columns = (rows.frames[n] + np.array(rows.stencil)[slot]) * D + d
            shape = rows.residual.size, self.frames * D
            row = n * rows.residual.shape[1] + m
            parts.append(csr_array((rows.jacobian[n, m, slot, d], (row, columns)), shape))
            residual.append(rows.residual.ravel())
            term += [rows.term] * rows.residual.size
            frame.append(np.repeat(rows.frames, rows.residual.shape[1]))
        matrix = vstack(parts, "csr")
        made = io.BytesIO()
        np.savez_compressed(
            made,
            format=np.array(b"csr"),
            shape=np.array(matrix.shape),
            indptr=matrix.indptr,
            indices=matrix.indices,
            data=matrix.data,
            residual=np.concatenate(residual),
            term=np.array(term),
            clip_row=np.concatenate(frame),
            unknowns=np.array(self.unknowns),
        )
        write_bytes(path, made.getvalue())


def linearised_frames(motion: Motion, options: FrameOptions) -> _Linearised:
    """The linearised frame method: every frame's unknowns, the frame before being held."""
    solution = frame_solution(motion)
    chain, (view,) = solution.chain, solution.views
    states = _unknowns(motion)
    sigma_px = np.array([np.nan if one is None else one.sigma_px for one in solution.reports])
    rows = [
        _Rows(term, np.array([t]), (0,), np.array([0.5 * r @ r]), r[None], J[None, :, None])
        for t, by_term in frame_rows(view, chain, motion.fps, options, states, sigma_px)
        for term, (r, J) in by_term.items()
    ]
    return _Linearised(chain.state_names, len(states), lambda: rows, np.full(states.shape, np.nan))


def linearised_clip(clip: ClipProblem, motion: Motion) -> _Linearised:
    """The linearised trajectory method. The noise of the joints is the solution's, the mean of several segments;
    contacts follow from the solution. A segment with a frame that ran away is left out."""
    states = motion.states
    segments, step = [], np.full(states.shape, np.nan)
    for segment, problem, found in at_solution(clip, trajectory_solution(motion)):
        rows_of = segment.rows
        # Of a copy: what a problem caches goes.
        step[rows_of] = newton_step(replace(problem).normals(found.states, found.shared)(), _LEAST_DAMPING)[0]
        segments.append((rows_of.start, problem, found.states, found.shared))

    def rows() -> Iterator[_Rows]:
        for start, *of_spell in segments:
            for one in _rows(*of_spell):
                yield replace(one, frames=one.frames + start)

    return _Linearised(clip.body.state_names, len(states), rows, step)


def _rows(problem: LeastSquares, states: Array, shared: Mapping[str, Array]) -> Iterator[_Rows]:
    linear = [(term, term.frames(len(states)), term.residual(states)) for term in problem.linear]
    for span in problem.spans(states, shared, jacobian=True):
        for term, frames, residual in linear:
            own = (frames >= span.first) & (frames < span.first + len(span.states[span.own]))
            slots = term.slots.swapaxes(0, 1)
            r, jacobian = residual[own], np.broadcast_to(slots, (own.sum(), *slots.shape))
            yield _Rows(term.name, frames[own], term.stencil, 0.5 * np.sum(r**2, axis=1), r, jacobian)
        for term in problem.terms:
            found = term.evaluate(span, jacobian=True)
            frames = np.arange(span.first, span.first + len(found.cost))
            yield _Rows(term.name, frames, term.stencil, found.cost, found.residual, found.jacobian)


# -- frame by frame -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SolverRecord:
    """What `recon solver` shows, of T frames. problem: at the solution. chain: of a result of a chain. Of the frame
    method: search, of the frame that is looked into, and otherwise, the clip with the camera's rotation held still, or
    free where the fit held it."""

    motion: Motion
    problem: _Linearised
    chain: Chain | None
    search: FrameSearch | None = None
    otherwise: FrameSolution | None = None

    @cached_property
    def optimality(self) -> Array:
        """(T,): the largest part of the gradient."""
        return np.abs(self.problem.gradient).max(axis=1)

    @cached_property
    def step_norm(self) -> Array:
        """(T,): the frame method's last step; what one more step of the trajectory method would change."""
        return self.of_frames("step_norm") if self.motion.jitters else np.linalg.norm(self.problem.step, axis=1)

    def of_frames(self, field: str) -> Array:
        """(T,): what the frame method reports of each frame, NaN where it does not, as by the other method."""
        reports = getattr(self.motion.solution, "reports", (None,) * len(self.motion.frames))
        return np.array([np.nan if one is None else getattr(one, field) for one in reports], dtype=float)

    @cached_property
    def image_error_px(self) -> dict[str, Array]:
        """By camera (J, T): from detections to reprojections, NaN without one of them."""
        return {picture.name: picture.distance_px.T for picture in self.motion.pictures}

    @cached_property
    def rotation_rad(self) -> dict[str, Array]:
        """The root's angles by name, (T,)."""
        motion = self.motion
        if motion.jitters:
            return named_unknowns(frame_solution(motion), *CAMERA_ANGLES)
        turned = motion.states[:, YAW : YAW + 3].copy()
        known = np.isfinite(turned[:, 0])
        if known.any():
            turned[known] = np.unwrap(turned[known], axis=0)
            turned -= 2 * np.pi * np.round(np.median(turned[known], axis=0) / (2 * np.pi))
        return dict(zip(("yaw", "pitch", "roll"), turned.T, strict=True))

    @cached_property
    def length(self) -> dict[str, Array]:
        """The base length, metres, or the size of all frames, by name (T,)."""
        if self.motion.jitters:
            return named_unknowns(frame_solution(self.motion), "base_length_m")
        return {"size": np.where(np.isfinite(self.motion.states[:, 0]), self.motion.size, np.nan)}

    @cached_property
    def limits(self) -> dict[str, Array]:
        """By name (T, A): how far the chain's angles lie beyond their expected "ranges", rad, and their "rates" beyond
        their limits, rad/s; negative within. Empty without a chain."""
        if self.chain is None:
            return {}
        states = _unknowns(self.motion) if self.motion.jitters else self.motion.states[:, self.chain.body_angles]
        rates = beyond_rate_rad_s(self.chain, states, self.motion.fps)
        return {"ranges": beyond_range_rad(self.chain, states), "rates": rates}

    @cached_property
    def active(self) -> dict[str, Array]:
        """By name of `limits` (T,): how many are passed."""
        return {name: (beyond > 0).sum(axis=1) for name, beyond in self.limits.items()}

    def summary(self) -> dict[str, object]:
        """The record in short, as solver.json holds it."""
        cost = {name: float(np.nansum(c)) for name, c in self.problem.cost.items()}
        found: dict[str, object] = {
            "cost_by_term": cost,
            "largest_gradient": _largest(self.optimality),
            "largest_step": _largest(self.step_norm),
            "limits_passed": {name: int(count.sum()) for name, count in self.active.items()},
        }
        if self.motion.jitters:
            found["iterations"] = int(np.nansum(self.of_frames("iterations")))
            found["frames_converged"] = frame_solution(self.motion).status.count("converged")
        else:
            solution = trajectory_solution(self.motion)
            found |= {"iterations": solution.iterations, "status": solution.status}
        return found


def frame_solution(motion: Motion) -> FrameSolution:
    assert isinstance(motion.solution, FrameSolution)
    return motion.solution


def named_unknowns(solution: FrameSolution, *names: str) -> dict[str, Array]:
    """(T,) each, NaN without a pose."""
    at = [solution.chain.state_names.index(name) for name in names]
    return dict(zip(names, solution.chain_states[:, at].T, strict=True))


def trajectory_solution(motion: Motion) -> TrajectorySolution:
    assert isinstance(motion.solution, TrajectorySolution)
    return motion.solution


def _unknowns(motion: Motion) -> Array:
    """(T, D): of the frame method, NaN without a pose."""
    return np.where(motion.solved[:, None], frame_solution(motion).chain_states, np.nan)


def _largest(values: Iterable[float]) -> float:
    return float(np.max([v for v in values if np.isfinite(v)], initial=0.0))
