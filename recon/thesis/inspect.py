"""Describe the frame method's optimisation in tables, for the command `recon solver`.

The optimiser minimises half the squared norm of the residuals r, each divided by its standard deviation. J is their
Jacobian. Robust terms enter r and J with the solver's weights, so that J'r is the gradient and J'J the curvature.
docs/solver.md explains the columns of the tables. `recon.thesis.figures` draws the figures.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.sparse import block_diag

from recon.api.clip_results import read_config
from recon.base.arrays import Array, Bools, mean
from recon.base.errors import InputError, Problem
from recon.base.files import read_manifest, write_bytes
from recon.fit.motion import Motion
from recon.fit.motion_forms import CONFIG
from recon.thesis.objectives import FrameOptions
from recon.thesis.solution import FrameSolution
from recon.thesis.solver import FrameSearch, FrameSolver, solve_frames, with_tolerance

TABLES = (
    "solver_frames.csv",
    "solver_unknowns.csv",
    "image_errors.csv",
    "solver_frame.csv",
    "variables.csv",
    "gradient.csv",
    "reference_paths.csv",
)
PUBLISHED = {
    "f1": "reprojection",
    "f2": "theta range",
    "f3": "phi range",
    "f4": "theta rate",
    "f5": "phi rate",
}
"""This project's name for each of the published objectives f1 to f5."""
COUNTS = ("iterations", "function_evaluations", "first_evaluations", "starts", "optimizer_status")
CAMERA_ANGLES = ("xi", "psi", "zeta")
EXIT_FLAGS = {
    0: "evaluations used up",
    1: "gradient small",
    2: "cost settled",
    3: "step small",
    4: "cost and step settled",
}
"""Meaning of the status values of scipy's `least_squares`."""


def read_solver(motion: Motion, folder: Path, frame: int | None = None) -> SolverRecord:
    """Rebuild the least-squares problem of a fit and evaluate it at the solution.

    Parameters
    ----------
    motion
        The fitted motion.
    folder
        Folder from which the motion was loaded, which has the settings of the fit.
    frame
        Number of the frame whose search is shown; None for the frame with the most evaluations.

    Raises
    ------
    InputError
        If the settings are missing, if the motion was fitted with the trajectory method, or if the frame has no pose.
    """
    if not isinstance(motion.solution, FrameSolution):
        raise InputError(Problem(folder, "results", "a fit of all frames at once", "results of recon frame"))
    solution = motion.solution
    read_manifest(folder).require(CONFIG)
    options = FrameOptions.from_settings(read_config(folder / CONFIG, {}).plain())
    solved = np.flatnonzero(motion.solved)
    if not len(solved):
        raise InputError(Problem(folder, "frames", "no frame with a pose", "at least one frame"))
    if frame is None:
        row = int(solved[np.argmax(solution.reported("function_evaluations")[solved])])
    elif frame in motion.frames[solved]:
        row = int(np.flatnonzero(motion.frames == frame)[0])
    else:
        expected = f"a frame with a pose, from {motion.frames[solved[0]]} to {motion.frames[solved[-1]]}"
        raise InputError(Problem("--frame", "frame", str(frame), expected))
    problem = solution.views[0], solution.chain, motion.fps
    solver = FrameSolver(
        *problem,
        with_tolerance(options),
        np.where(motion.solved[:, None], solution.chain_states, np.nan),
        solution.path,
        solution.start_states,
    )
    rotation = "free" if options.camera_rotation == "fixed" else "fixed"
    other_solution = solve_frames(*problem, replace(options, camera_rotation=rotation))
    sigma_px = solution.reported("sigma_px")
    terms = {t: solver.problem(t, sigma_px[t]).by_term(solver.states[t]) for t in solved.tolist()}
    return SolverRecord(motion, solution, terms, solver.search(row)[0], other_solution, options)


@dataclass(frozen=True, eq=False)
class SolverRecord:
    """Optimisation of T frames with D unknowns, from which `recon solver` writes its tables and figures.

    Arrays are NaN in frames without a pose.
    """

    motion: Motion
    solution: FrameSolution
    terms: dict[int, dict[str, tuple[Array, Array]]]
    """Residuals (M,) and Jacobian (M, D) at the solution, keyed by the frame's index in the clip and the term's name.

    The previous frame's pose is held fixed.
    """
    search: FrameSearch
    """Search in the frame that tables and figures show."""
    other_solution: FrameSolution
    """Solution of the same clip with the camera's rotation fixed if it is free in the fit, and vice versa."""
    options: FrameOptions
    """Options of the fit."""

    @property
    def frame(self) -> int:
        """Return the number of the frame whose search tables and figures show."""
        return int(self.motion.frames[self.search.problem.frame])

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Return the names of the chain's D unknowns."""
        return self.solution.chain.state_names

    @cached_property
    def cost(self) -> pd.DataFrame:
        """Return half the sum of squared residuals of each term (column) in each frame (row)."""
        costs = {row: {term: 0.5 * np.sum(r**2) for term, (r, _) in terms.items()} for row, terms in self.terms.items()}
        return pd.DataFrame.from_dict(costs, orient="index").fillna(0.0).reindex(range(len(self.motion.frames)))

    @cached_property
    def gradient(self) -> Array:
        """Return the gradient of the cost in each frame, shape (T, D)."""
        return self._by_frame(
            {row: np.sum([J.T @ r for r, J in terms.values()], axis=0) for row, terms in self.terms.items()}
        )

    @cached_property
    def column_norm(self) -> Array:
        """Return the norms of the Jacobian's columns in each frame, shape (T, D)."""
        return self._by_frame({row: np.linalg.norm(self.jacobian(row), axis=0) for row in self.terms})

    def jacobian(self, row: int) -> Array:
        """Return the Jacobian (M, D) of the frame with the index `row` in the clip."""
        return np.concatenate([J for _, J in self.terms[row].values()])

    def _by_frame(self, values: dict[int, Array]) -> Array:
        """Return an array (T, D) whose rows are `values` (D,), keyed by the index of the row, and NaN in other rows."""
        table = np.full((len(self.motion.frames), len(self.unknowns)), np.nan)
        table[[*values]] = np.array([*values.values()])
        return table

    @property
    def optimality(self) -> Array:
        """Return the largest absolute component of the gradient in each frame, shape (T,)."""
        return np.abs(self.gradient).max(axis=1)

    @cached_property
    def sizes(self) -> dict[str, Array]:
        """Return squared norm and mean magnitude of the residuals, and mean magnitude and sparsity of the Jacobian.

        Each array has a value for each frame, shape (T,). The keys are the names of the columns.
        """
        table = np.full((4, len(self.motion.frames)), np.nan)
        for row, terms in self.terms.items():
            residual, jacobian = np.concatenate([r for r, _ in terms.values()]), self.jacobian(row)
            means = np.abs(residual).mean(), np.abs(jacobian).mean(), np.mean(jacobian == 0)
            table[:, row] = residual @ residual, *means
        names = "squared_norm", "residual_mean_abs", "jacobian_mean_abs", "jacobian_sparsity"
        return dict(zip(names, table, strict=True))

    @property
    def image_error_px(self) -> Array:
        """Return the distances between detections and reprojections in pixels, shape (T, J); NaN if missing."""
        return self.motion.pictures[0].distance_px

    @property
    def active(self) -> dict[str, Array]:
        """Return the numbers (T,) of angles outside their ranges ("ranges") and rates above their limits ("rates")."""
        return {name: is_beyond.sum(axis=1) for name, is_beyond in self._is_beyond.items()}

    @property
    def _is_beyond(self) -> dict[str, Bools]:
        """Return masks (T, 2 A) of angles outside their ranges ("ranges") and rates above their limits ("rates")."""
        return {"ranges": self.solution.beyond_range_rad > 0, "rates": self.solution.beyond_rate_rad_s > 0}

    def summary(self) -> dict[str, object]:
        """Return the content of solver.json."""
        by_joint = np.array([mean(errors_px) for errors_px in self.image_error_px.T])
        worst = int(np.nanargmax(by_joint))
        return {
            "cost_by_term": {name: float(c) for name, c in self.cost.sum().items()},
            "largest_gradient": float(np.nanmax(self.optimality)),
            "largest_step": float(np.nanmax(self.solution.reported("step_norm"))),
            "limits_passed": {name: int(count.sum()) for name, count in self.active.items()},
            "iterations": int(np.nansum(self.solution.reported("iterations"))),
            "iterations_by_frame": self._median_and_range("iterations"),
            "evaluations_by_frame": self._median_and_range("function_evaluations"),
            "frames": len(self.motion.frames),
            "frames_converged": self.solution.status.count("converged"),
            "image_error_px": {"mean": mean(self.image_error_px)},
            "worst_joint": {"name": self.motion.names[worst], "mean_px": float(by_joint[worst])},
        }

    def _median_and_range(self, count: str) -> dict[str, float]:
        """Return the median, the minimum and the maximum of a count, such as iterations, over the solved frames."""
        counts = self.solution.reported(count)[self.motion.solved]
        return {"median": float(np.median(counts)), "min": float(counts.min()), "max": float(counts.max())}

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return every table of `recon solver`, keyed by its file name (`TABLES`)."""
        tables = (
            self._frames_table(),
            self._unknowns_table(),
            self._errors_table(),
            self._search_table(),
            self._variables_table(),
            self._gradient_table(),
            self._paths_table(),
        )
        return dict(zip(TABLES, map(pd.DataFrame, tables), strict=True))

    def _variables_table(self) -> dict[str, Any]:
        """Return the table of the unknowns under their published names, with the costs of f1 to f5."""
        columns: dict[str, Any] = {"frame": self.motion.frames, "time_s": self.motion.time_s}
        columns |= dict(zip(self.solution.chain.unknown_names, self.solution.chain_states.T, strict=True))
        return columns | {name: self.cost.get(term, 0.0) for name, term in PUBLISHED.items()}

    def _gradient_table(self) -> dict[str, Any]:
        columns: dict[str, Any] = {"frame": self.motion.frames}
        return columns | dict(zip(self.unknowns, self.gradient.T, strict=True))

    def _paths_table(self) -> dict[str, Any]:
        """Return the table of the root's position R p0 in the camera frame for a free and a fixed rotation."""
        columns: dict[str, Any] = {"frame": self.motion.frames, "time_s": self.motion.time_s}
        for name, solution in self.solutions.items():
            points_m = solution.chain.pose(solution.chain_states).joints_m[:, 0]
            columns |= {f"{axis}_{name}_m": points_m[:, k] for k, axis in enumerate("xyz")}
        return columns

    @property
    def solutions(self) -> dict[str, FrameSolution]:
        """Return the solutions with a "free" and a "fixed" camera rotation, with the one that the fit used first."""
        first, second = ("fixed", "free") if self.options.camera_rotation == "fixed" else ("free", "fixed")
        return {first: self.solution, second: self.other_solution}

    def _frames_table(self) -> dict[str, Any]:
        motion, solution = self.motion, self.solution
        columns: dict[str, Any] = {"frame": motion.frames, "time_s": motion.time_s}
        columns |= {name: solution.reported(name) for name in COUNTS}
        flags = columns["optimizer_status"]
        columns["optimizer_message"] = [EXIT_FLAGS[int(flag)] if np.isfinite(flag) else "" for flag in flags]
        columns |= {"optimality": self.optimality, "last_step": solution.reported("step_norm"), **self.sizes}
        columns |= {f"cost_{str(term).replace(' ', '_')}": cost for term, cost in self.cost.items()}
        columns |= {f"{limit}_passed": count for limit, count in self.active.items()}
        columns |= {f"{name}_rad": solution.unknown(name) for name in CAMERA_ANGLES}
        return columns | {"base_length_m": solution.unknown("base_length_m")}

    def _unknowns_table(self) -> dict[str, Any]:
        gradient, norm = np.abs(self.gradient[self.motion.solved]), self.column_norm[self.motion.solved]
        columns: dict[str, Any] = {"unknown": self.unknowns}
        columns |= {"gradient_median": np.median(gradient, 0), "gradient_max": gradient.max(0)}
        columns |= {f"column_norm_{f.__name__}": f(norm, axis=0) for f in (np.min, np.median, np.max)}
        rest = len(self.unknowns) - 2 * self.solution.chain.n_angles  # these unknowns have neither range nor limit
        return columns | {
            f"{limit}_passed": np.pad(is_beyond.sum(axis=0), (0, rest)) for limit, is_beyond in self._is_beyond.items()
        }

    def _errors_table(self) -> dict[str, Any]:
        """Return the table of reprojection errors in pixels, with distances, and differences in x and y."""
        picture, names = self.motion.pictures[0], self.motion.names
        columns: dict[str, Any] = {"camera": picture.name, "frame": self.motion.frames}
        columns |= {f"{name}_px": errors for name, errors in zip(names, self.image_error_px.T, strict=True)}
        offsets_px = dict(zip(names, np.moveaxis(picture.image_error_px, 1, 0), strict=True))
        return columns | {
            f"{name}_{axis}_px": xy[:, k] for name, xy in offsets_px.items() for k, axis in enumerate("xy")
        }

    def _search_table(self) -> dict[str, Any]:
        search = self.search
        columns: dict[str, Any] = {"frame": self.frame, "point": range(len(search.points))}
        columns |= {"evaluations": search.evaluations_at, "cost": search.costs}
        columns |= {"damping": [*search.damping, np.nan], "step": [*search.step_norms, np.nan]}
        parts = [search.problem.by_term(x) for x in search.points]
        return columns | {
            name: [0.5 * float(np.sum(terms[term][0] ** 2)) if term in terms else 0.0 for terms in parts]
            for name, term in PUBLISHED.items()
        }

    def write_jacobian(self, path: Path) -> None:
        """Write the Jacobian as an NPZ file that `scipy.sparse.load_npz` reads as a matrix (M, T D).

        Column t D + d is unknown d in row t of the clip. The file also holds the unknowns (D,) and, for every row of
        the matrix, its residual, its term, and its row of the clip.
        """
        empty = np.zeros((0, len(self.unknowns)))
        rows = range(len(self.motion.frames))
        matrix = block_diag([self.jacobian(t) if t in self.terms else empty for t in rows], "csr")
        blocks = [(t, term, r) for t, terms in self.terms.items() for term, (r, _) in terms.items()]
        content = io.BytesIO()
        np.savez_compressed(
            content,
            format=np.array(b"csr"),
            shape=np.array(matrix.shape),
            indptr=matrix.indptr,
            indices=matrix.indices,
            data=matrix.data,
            residual=np.concatenate([r for _, _, r in blocks]),
            term=np.repeat([term for _, term, _ in blocks], [len(r) for _, _, r in blocks]),
            clip_row=np.repeat([t for t, _, _ in blocks], [len(r) for _, _, r in blocks]),
            unknowns=np.array(self.unknowns),
        )
        write_bytes(path, content.getvalue())
