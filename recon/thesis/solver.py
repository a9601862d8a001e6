"""What the optimiser of the frame method did: the problem at the solution, row by row, and its tables.

It minimises half the squared norm of residuals r, divided by their standard deviations, with a Jacobian J; of robust
terms r and J are as the solver weighs them, so that J'r is the gradient and J'J the curvature. Columns of the tables:
docs/solver.md.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import block_diag

from recon.base.arrays import Array, Bools
from recon.base.errors import InputError, Problem
from recon.base.files import write_bytes
from recon.base.manifest import read_manifest
from recon.fit.motion import Motion
from recon.io.table import write_rows
from recon.thesis.clip import frame_options
from recon.thesis.frame import CAMERA_ANGLES, FrameSearch, FrameSolution, frame_rows, frame_search, solve_frames
from recon.workflows.made_from import CONFIG, read_config

JACOBIAN = "jacobian.npz"
COUNTS = ("iterations", "function_evaluations", "starts", "optimizer_status")


def read_solver(motion: Motion, folder: Path, frame: int | None = None) -> SolverRecord:
    """folder: of the results that the motion was loaded from, for the fit's settings. frame: whose search is looked
    into, by default that with most evaluations. Raises InputError where settings are no longer there, for results of
    the other method, and for a frame without a pose."""
    if not isinstance(motion.solution, FrameSolution):
        raise InputError(Problem(folder, "results", "a fit of all frames at once", "results of recon frame"))
    solution = motion.solution
    read_manifest(folder).require(CONFIG)
    options = frame_options(read_config(folder / CONFIG, {}))
    solved = np.flatnonzero(motion.solved)
    if not len(solved):
        raise InputError(Problem(folder, "frames", "none with a pose", "one at least"))
    given = solution.views[0], solution.chain, motion.fps
    if frame is None:
        row = int(solved[np.argmax(solution.reported("function_evaluations")[solved])])
    elif frame in motion.frames[solved]:
        row = int(np.flatnonzero(motion.frames == frame)[0])
    else:
        expected = f"one with a pose, from {motion.frames[solved[0]]} to {motion.frames[solved[-1]]}"
        raise InputError(Problem("--frame", "frame", str(frame), expected))
    states = np.where(motion.solved[:, None], solution.chain_states, np.nan)
    rows = dict(frame_rows(*given, options, states, solution.reported("sigma_px")))
    other = "free" if options.camera_rotation == "fixed" else "fixed"
    otherwise = solve_frames(*given, replace(options, camera_rotation=other))
    return SolverRecord(motion, solution, rows, frame_search(*given, options, states, row), otherwise)


@dataclass(frozen=True, eq=False)
class SolverRecord:
    """What `recon solver` shows, of T frames with D unknowns each."""

    motion: Motion
    solution: FrameSolution
    rows: dict[int, dict[str, tuple[Array, Array]]]
    """Residuals (M,) and Jacobian (M, D) at the solution, by row of the clip and term, the frame before being held."""
    search: FrameSearch
    """How the frame that is looked into was solved."""
    otherwise: FrameSolution
    """The clip with the camera's rotation held still, or free where the fit held it."""

    @property
    def unknowns(self) -> tuple[str, ...]:
        """(D,): the names of the chain's unknowns."""
        return self.solution.chain.state_names

    @cached_property
    def cost(self) -> dict[str, Array]:
        """Half the squared residuals by term (T,), NaN without a pose."""
        terms = dict.fromkeys(term for of_frame in self.rows.values() for term in of_frame)
        none = np.zeros(0), np.zeros(0)
        squares = self._by_frame(lambda t: [0.5 * np.sum(self.rows[t].get(term, none)[0] ** 2) for term in terms])
        return dict(zip(terms, squares.T, strict=True))

    @cached_property
    def gradient(self) -> Array:
        """(T, D), NaN without a pose."""
        return self._by_frame(lambda t: np.sum([J.T @ r for r, J in self.rows[t].values()], axis=0))

    @cached_property
    def column_norm(self) -> Array:
        """Norms of the Jacobian's columns (T, D), NaN without a pose."""
        return self._by_frame(lambda t: np.linalg.norm(self._jacobian(t), axis=0))

    def _jacobian(self, row: int) -> Array:
        return np.concatenate([J for _, J in self.rows[row].values()])

    def _by_frame(self, value: Callable[[int], Any]) -> Array:
        found = {t: np.asarray(value(t), float) for t in self.rows}
        whole = np.full((len(self.motion.frames), *next(iter(found.values())).shape), np.nan)
        whole[[*found]] = np.array([*found.values()])
        return whole

    @cached_property
    def solved(self) -> Bools:
        """(T,): the frames with a pose."""
        return np.isfinite(self.gradient[:, 0])

    @cached_property
    def optimality(self) -> Array:
        """(T,): the largest part of the gradient."""
        return np.abs(self.gradient).max(axis=1)

    @property
    def image_error_px(self) -> Array:
        """(T, J): from detections to reprojections, NaN without one of them."""
        return self.motion.pictures[0].distance_px

    @cached_property
    def active(self) -> dict[str, Array]:
        """How many angles lie beyond their expected ranges, and rates beyond their limits, by name (T,)."""
        limits = {"ranges": self.solution.beyond_range_rad, "rates": self.solution.beyond_rate_rad_s}
        return {name: (beyond > 0).sum(axis=1) for name, beyond in limits.items()}

    def summary(self) -> dict[str, object]:
        """The figures that solver.json holds."""
        steps = self.solution.reported("step_norm")
        return {
            "cost_by_term": {name: float(np.nansum(c)) for name, c in self.cost.items()},
            "largest_gradient": float(np.nanmax(self.optimality)),
            "largest_step": float(np.nanmax(steps)),
            "limits_passed": {name: int(count.sum()) for name, count in self.active.items()},
            "iterations": int(np.nansum(self.solution.reported("iterations"))),
            "frames_converged": self.solution.status.count("converged"),
        }

    def write_jacobian(self, path: Path) -> None:
        """As NPZ that `scipy.sparse.load_npz` reads as a matrix (M, T D), column t D + d: the unknown d of row t of the
        clip; with it unknowns (D,), and of every row its residual, term, and the frame that it stands for."""
        empty = np.zeros((0, len(self.unknowns)))
        matrix = block_diag([self._jacobian(t) if t in self.rows else empty for t in range(len(self.solved))], "csr")
        told = [(t, term, r) for t, found in self.rows.items() for term, (r, _) in found.items()]
        made = io.BytesIO()
        np.savez_compressed(
            made,
            format=np.array(b"csr"),
            shape=np.array(matrix.shape),
            indptr=matrix.indptr,
            indices=matrix.indices,
            data=matrix.data,
            residual=np.concatenate([r for _, _, r in told]),
            term=np.repeat([term for _, term, _ in told], [len(r) for _, _, r in told]),
            clip_row=np.repeat([t for t, _, _ in told], [len(r) for _, _, r in told]),
            unknowns=np.array(self.unknowns),
        )
        write_bytes(path, made.getvalue())


# -- tables -----------------------------------------------------------------------------------------------------------

TABLES = ("solver_frames.csv", "solver_unknowns.csv", "image_errors.csv", "solver_frame.csv")


def write_tables(record: SolverRecord, folder: Path) -> None:
    """Every table and the Jacobian, into a folder that exists."""
    motion, solution, search, clip = record.motion, record.solution, record.search, TABLES
    columns = {"frame": motion.frames, "time_s": motion.time_s}
    columns |= {name: solution.reported(name) for name in COUNTS}
    columns |= {"optimality": record.optimality, "last_step": solution.reported("step_norm")}
    columns |= {f"cost_{term.replace(' ', '_')}": cost for term, cost in record.cost.items()}
    columns |= {f"{limit}_passed": count for limit, count in record.active.items()}
    columns |= {f"{name}_rad": solution.unknown(name) for name in CAMERA_ANGLES}
    columns["base_length_m"] = solution.unknown("base_length_m")
    write_rows(folder / clip[0], [[*columns]], zip(*(values.tolist() for values in columns.values()), strict=True))

    gradient, norm = np.abs(record.gradient[record.solved]), record.column_norm[record.solved]
    columns = {"unknown": record.unknowns}
    columns |= {"gradient_median": np.median(gradient, 0), "gradient_max": gradient.max(0)}
    columns |= {f"column_norm_{f.__name__}": f(norm, axis=0) for f in (np.min, np.median, np.max)}
    write_rows(folder / clip[1], [[*columns]], zip(*columns.values(), strict=True))

    camera = motion.pictures[0].name
    rows = ([camera, int(t), *errors] for t, errors in zip(motion.frames, record.image_error_px.tolist(), strict=True))
    write_rows(folder / clip[2], [["camera", "frame", *(f"{name}_px" for name in motion.names)]], rows)

    values = zip(search.evaluations.tolist(), search.cost.tolist(), [*search.damping.tolist(), None], strict=True)
    rows = ([int(motion.frames[search.frame]), k, *row] for k, row in enumerate(values))
    write_rows(folder / clip[3], [["frame", "point", "evaluations", "cost", "damping"]], rows)
    record.write_jacobian(folder / JACOBIAN)
