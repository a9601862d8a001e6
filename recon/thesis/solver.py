"""What the optimiser did: the problem at its solution, row by row, and what came of it frame by frame.

Both methods minimise half the squared norm of residuals r, divided by their standard deviations, with a Jacobian J; of
robust terms r and J are as the solver weighs them, so that J'r is the gradient and J'J the curvature.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from recon.animal.chain import Chain
from recon.base.arrays import Array, Bools, Index
from recon.base.files import write_bytes
from recon.clip import View
from recon.fit.clip_problem import ClipProblem
from recon.fit.contacts import contacts
from recon.fit.least_squares import LeastSquares
from recon.fit.results import Results
from recon.fit.terms import SIDESLIP, SIZE, time_offset
from recon.geometry.kinematics import ROOT, YAW
from recon.thesis.frame import FrameOptions, beyond_range_rad, beyond_rate_rad_s, frame_rows

_LEAST_DAMPING = 1e-4
"""Of the step that is left: as of the solver's last ones."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Of a term, N frames with M rows each."""

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
class Linearised:
    """The problem at the solution, of T frames with D unknowns each. What all frames share, the size, is left out."""

    unknowns: tuple[str, ...]
    """(D,)"""
    frames: int
    """T"""
    rows: Callable[[], Iterable[Rows]]
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
        """(T,)"""
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
        D, of_rows = len(self.unknowns), []
        for rows in self.rows():
            wide = rows.residual.shape[1]
            entries = np.count_nonzero(rows.jacobian, axis=(2, 3)).ravel()
            term = np.full(rows.residual.size, [*self.cost].index(rows.term))
            of_rows.append((rows.residual.ravel(), entries, term, np.repeat(rows.frames, wide)))
        residual, entries, term, frame = (np.concatenate(part) for part in zip(*of_rows, strict=True))
        ends = np.concatenate([[0], np.cumsum(entries)])

        def columns(rows: Rows) -> Index:
            n, _, s, d = np.nonzero(rows.jacobian)
            return (rows.frames[n] + np.array(rows.stencil)[s]) * D + d

        made = io.BytesIO()
        np.savez_compressed(
            made,
            format=np.array(b"csr"),
            shape=np.array([len(residual), self.frames * D]),
            indptr=ends,
            residual=residual,
            term=np.array([*self.cost])[term],
            clip_row=frame,
            unknowns=np.array(self.unknowns),
        )
        # A few frames at a time, and as fast as they can be packed: these are by far the largest.
        with zipfile.ZipFile(made, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
            _add(file, "indices", np.dtype(np.int32), ends[-1], map(columns, self.rows()))
            _add(file, "data", np.dtype(float), ends[-1], (rows.jacobian[rows.jacobian != 0] for rows in self.rows()))
        write_bytes(path, made.getvalue())


def _add(file: zipfile.ZipFile, name: str, dtype: np.dtype, length: int, parts: Iterable[Array | Index]) -> None:
    """One more array (length,) to a file of NPZ, part by part."""
    with file.open(f"{name}.npy", "w", force_zip64=True) as member:
        header = {"descr": dtype.str, "fortran_order": False, "shape": (int(length),)}
        np.lib.format.write_array_header_1_0(member, header)
        for part in parts:
            member.write(part.astype(dtype).tobytes())


def linearised_frames(view: View, chain: Chain, fps: float, options: FrameOptions, results: Results) -> Linearised:
    """Of the frame method: every frame's unknowns, the frame before being held."""
    frames, D = results.report["frames"], chain.n_state
    states = np.array([frame["unknowns"] or [np.nan] * D for frame in frames], dtype=float)
    sigma_px = np.array([frame["sigma_px"] for frame in frames], dtype=float)
    rows = [
        Rows(term, np.array([t]), (0,), np.array([0.5 * r @ r]), r[None], J[None, :, None])
        for t, by_term in frame_rows(view, chain, fps, options, states, sigma_px)
        for term, (r, J) in by_term.items()
    ]
    return Linearised(chain.state_names, len(frames), lambda: rows, np.full(states.shape, np.nan))


def linearised_clip(clip: ClipProblem, results: Results) -> Linearised:
    """Of the trajectory method. The noise of the joints is the report's, the mean of several segments; contacts follow
    from the solution. A segment with a frame that ran away is left out."""
    o, told_px = clip.options, np.array([camera["noise_px"] for camera in results.report["cameras"]], dtype=float)
    size = results.size if clip.shows_size else 1.0
    told = {
        time_offset(i): np.array([camera["time_offset_frames"]]) for i, camera in enumerate(results.report["cameras"])
    }
    told |= {SIZE: np.array([size]), SIDESLIP: np.array([results.report["heading"].get("sideslip_rad") or 0.0])}
    states = results.states.copy()
    states[:, ROOT] = (states[:, ROOT] - clip.origin_m) / results.size
    segments, step = [], np.full(states.shape, np.nan)
    for segment in results.segments:
        part, found = replace(clip.part(segment.rows), prior_weight=segment.prior_weight), states[segment.rows]
        if not np.isfinite(found).all():
            continue
        points = part.markers(found)
        noise_px = part.noise_px(points, np.ones_like(told_px), size)
        noise_px *= (told_px / noise_px.mean(axis=1))[:, None]
        stand = o.ground == "auto" and len(part.feet) > 0 and len(found) > 2
        problem = part.problem(noise_px, 1.0, contacts(part, points, size)[2] if stand else (), points, size)
        shared = {name: (problem.expected() | told)[name] for name in problem.columns}  # refined cameras are in place
        step[segment.rows] = replace(problem).normal(found, shared).step(_LEAST_DAMPING)[0]  # what a copy caches goes
        segments.append((segment.rows.start, problem, found, shared))

    def rows() -> Iterator[Rows]:
        for start, *of_spell in segments:
            for one in _rows(*of_spell):
                yield replace(one, frames=one.frames + start)

    return Linearised(clip.body.state_names, len(states), rows, step)


def _rows(problem: LeastSquares, states: Array, shared: Mapping[str, Array]) -> Iterator[Rows]:
    linear = [(term, term.frames(len(states)), term.residual(states)) for term in problem.linear]
    for span in problem.spans(states, shared, jacobian=True):
        for term, frames, residual in linear:
            own = (frames >= span.first) & (frames < span.first + len(span.states[span.own]))
            slots = term.slots.swapaxes(0, 1)
            r, jacobian = residual[own], np.broadcast_to(slots, (own.sum(), *slots.shape))
            yield Rows(term.name, frames[own], term.stencil, 0.5 * np.sum(r**2, axis=1), r, jacobian)
        for term in problem.terms:
            found = term.evaluate(span, jacobian=True)
            assert found.residual is not None
            assert found.jacobian is not None
            yield Rows(term.name, found.frames, term.stencil, found.cost, found.residual, found.jacobian)


# -- frame by frame -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SolverRecord:
    """What `recon solver` shows, of T frames. problem: at the solution. chain: of a result of a chain."""

    results: Results
    problem: Linearised
    chain: Chain | None

    @cached_property
    def optimality(self) -> Array:
        """(T,): the largest part of the gradient."""
        return np.abs(self.problem.gradient).max(axis=1)

    @cached_property
    def step_norm(self) -> Array:
        """(T,): the frame method's last step; what one more step of the trajectory method would change."""
        return self.of_frames("step_norm") if self.results.jitters else np.linalg.norm(self.problem.step, axis=1)

    def of_frames(self, field: str) -> Array:
        """(T,): a field of the report's frames, NaN where it has none."""
        return np.array([frame.get(field) for frame in self.results.report["frames"]], dtype=float)

    @cached_property
    def image_error_px(self) -> dict[str, Array]:
        """By camera (J, T): from detections to reprojections, NaN without one of them."""
        given = self.results.report["image_error_px"]
        values = [np.array(one, dtype=float) for one in (given["values"], *given.get("others", ()))]
        names = [camera.name for camera in self.results.cameras]
        return {name: np.linalg.norm(one, axis=1) for name, one in zip(names, values, strict=True)}

    @cached_property
    def rotation_rad(self) -> dict[str, Array]:
        """The root's angles by name, (T,)."""
        results = self.results
        if results.jitters:
            return self._named("xi", "psi", "zeta")
        turned = results.states[:, YAW : YAW + 3].copy()
        known = np.isfinite(turned[:, 0])
        if known.any():
            turned[known] = np.unwrap(turned[known], axis=0)
            turned -= 2 * np.pi * np.round(np.median(turned[known], axis=0) / (2 * np.pi))
        return dict(zip(("yaw", "pitch", "roll"), turned.T, strict=True))

    @cached_property
    def length(self) -> dict[str, Array]:
        """The base length, metres, or the size of all frames, by name (T,)."""
        if self.results.jitters:
            return self._named("base_length_m")
        return {"size": np.where(np.isfinite(self.results.states[:, 0]), self.results.size, np.nan)}

    @cached_property
    def limits(self) -> dict[str, Array]:
        """By name (T, A): how far the chain's angles lie beyond their expected "ranges", rad, and their "rates" beyond
        their limits, rad/s; negative within. Empty without a chain."""
        if self.chain is None:
            return {}
        states = self._unknowns if self.results.jitters else self.results.states[:, self.chain.body_angles]
        rates = beyond_rate_rad_s(self.chain, states, self.results.fps)
        return {"ranges": beyond_range_rad(self.chain, states), "rates": rates}

    @cached_property
    def active(self) -> dict[str, Array]:
        """By name of `limits` (T,): how many are passed."""
        return {name: (beyond > 0).sum(axis=1) for name, beyond in self.limits.items()}

    def _named(self, *names: str) -> dict[str, Array]:
        at = [self.results.report["skeleton"]["unknowns"].index(name) for name in names]
        return dict(zip(names, self._unknowns[:, at].T, strict=True))

    @cached_property
    def _unknowns(self) -> Array:
        """(T, D): of the frame method."""
        none = [np.nan] * len(self.results.report["skeleton"]["unknowns"])
        return np.array([frame["unknowns"] or none for frame in self.results.report["frames"]], dtype=float)

    def summary(self) -> dict[str, object]:
        """For solver.json."""
        report, cost = self.results.report, {name: float(np.nansum(c)) for name, c in self.problem.cost.items()}
        found: dict[str, object] = {
            "cost_by_term": cost,
            "largest_gradient": _largest(self.optimality),
            "largest_step": _largest(self.step_norm),
            "limits_passed": {name: int(count.sum()) for name, count in self.active.items()},
        }
        if self.results.jitters:
            found["iterations"] = int(np.nansum(self.of_frames("iterations")))
            found["frames_converged"] = report["summary"]["frames_converged"]
        else:
            found |= {name: report["convergence"][name] for name in ("iterations", "status")}
        return found


def _largest(values: Iterable[float]) -> float:
    return float(np.max([v for v in values if np.isfinite(v)], initial=0.0))
