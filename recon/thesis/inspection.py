"""What the optimiser did for a result: its problem again, at the solution; tables and figures.

Columns of the tables: docs/solver.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from threadpoolctl import threadpool_limits

from recon.base import Progress, silent
from recon.base.errors import InputError, Problem
from recon.base.files import require_free_folder, sole_writer, staged_folder
from recon.base.manifest import read_manifest
from recon.base.settings import Integer, Option, Settings
from recon.fit.motion import Motion
from recon.io.table import write_rows
from recon.show import plots
from recon.show.export.analysis_csv import Table
from recon.show.plain import to_json
from recon.thesis.clip import frame_options
from recon.thesis.frame import frame_search, solve_frames
from recon.thesis.plots import (
    image_errors,
    solver_evaluations,
    solver_frame,
    solver_matrices,
    solver_root,
    solver_rotation,
    solver_search,
    solver_unknowns,
)
from recon.thesis.solver import SolverRecord, frame_solution, linearised_clip, linearised_frames, trajectory_solution
from recon.workflows.made_from import AS_THEY_WERE, CONFIG, problem_of, read_config

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER, SUMMARY, JACOBIAN = "solver", "solver.json", "jacobian.npz"
SEARCH = "solver_frame.csv"
"""By default the folder lies in the results' own."""
FIGURES_BEGIN = 0.5
"""The share of the progress at which the figures begin."""
_ALIKE = 2.0
"""Costs that differ by a larger factor are of another prior, or other settings."""


class SolverSettings(Settings):
    """What `recon solver` is told."""

    folder: Annotated[Path, Option("Folder of results, as in results/clip.", argument="DIR")]
    out: Annotated[Path | None, Option("Folder for tables and figures. (default: solver in DIR)")] = None
    frame: Annotated[
        Integer | None, Option("Of the frame method: whose search is shown. (default: the one with most evaluations)")
    ] = None
    figures: Annotated[bool, Option("PNG and SVG beside the tables.")] = True
    overwrite: Annotated[bool, Option("Replace earlier tables.")] = False


def run_solver(settings: SolverSettings, progress: Progress = silent) -> tuple[SolverRecord, Path, list[str]]:
    """`recon solver`: what was found, the folder that it was written to, and the names of its files.

    out: by default the folder "solver" in the results' own, which are not written to otherwise. Raises InputError: no
    results, another prior than that of the fit, or files in the way.
    """
    out = settings.folder / FOLDER if settings.out is None else settings.out
    progress("reading", 0.0)
    motion = Motion.load(settings.folder)
    with sole_writer(out):
        require_free_folder(out, (SUMMARY, *TABLES, SEARCH, JACOBIAN), settings.overwrite, "what the optimiser did")
        progress("problem", 0.1)
        with threadpool_limits(1, user_api="blas"):  # of small matrices, threads cost more than they bring
            record = read_solver(motion, settings.folder, settings.frame)
            summary = record.summary()
        progress("tables", FIGURES_BEGIN - 0.1)
        with staged_folder(out) as staging:
            write_tables(record, staging)
            (staging / SUMMARY).write_text(to_json(summary), encoding="utf-8")
            files = [path.name for path in staging.iterdir()]
        if settings.figures:
            drawn = solver_figures(record)
            with staged_folder(out) as staging:
                for done, (name, draw) in enumerate(drawn.items()):
                    progress(f"figures: {name}", FIGURES_BEGIN + (1.0 - FIGURES_BEGIN) * done / len(drawn))
                    plots.save(draw(), staging, name)
                files += [path.name for path in staging.iterdir()]
    return record, out, sorted(files)


def read_solver(motion: Motion, folder: Path, frame: int | None = None) -> SolverRecord:
    """folder: of the results that the motion was loaded from, for the fit's settings. frame: whose search is looked
    into, of the frame method; by default that with most evaluations. Raises InputError where settings or the prior are
    no longer there, or are others, and for a frame without a pose."""
    config = folder / CONFIG
    if motion.jitters:
        read_manifest(folder).require(CONFIG)
        problem = linearised_frames(motion, frame_options(read_config(config, {})))
        posed = [one for one, solved in zip(frame_solution(motion).reports, motion.solved, strict=True) if solved]
        told = 0.5 * sum(one.squared_norm for one in posed if one is not None)
    else:
        problem = linearised_clip(problem_of(motion, folder), motion)
        told = sum(trajectory_solution(motion).cost_by_term.values())
    if not problem.solved.any():
        expected = "one between two gaps, at least, with a pose in every frame"
        raise InputError(Problem(folder, "segments", "none with a pose throughout", expected))
    cost = sum(float(np.nansum(of_term)) for of_term in problem.cost.values())
    if problem.solved.all() and max(cost, told) > _ALIKE * max(min(cost, told), 1.0):
        raise InputError(
            Problem(config, "settings", f"a cost of {cost:.4g}, where the fit had {told:.4g}", AS_THEY_WERE)
        )
    if not motion.jitters:
        if frame is not None:
            raise InputError(Problem("--frame", "frame", str(frame), "none: all frames were solved at once"))
        return SolverRecord(motion, problem, motion.chain)
    solution, options = frame_solution(motion), frame_options(read_config(config, {}))
    given = solution.views[0], solution.chain, motion.fps
    search = frame_search(*given, options, solution.chain_states, _looked_into(motion, frame))
    other = "free" if options.camera_rotation == "fixed" else "fixed"
    otherwise = solve_frames(*given, replace(options, camera_rotation=other))
    return SolverRecord(motion, problem, motion.chain, search, otherwise)


def _looked_into(motion: Motion, frame: int | None) -> int:
    """Its row."""
    if frame is None:
        spent = [-1 if one is None or not solved else one.function_evaluations
                 for one, solved in zip(frame_solution(motion).reports, motion.solved, strict=True)]  # fmt: skip
        return int(np.argmax(spent))
    rows = np.flatnonzero((motion.frames == frame) & motion.solved)
    if not len(rows):
        posed = motion.frames[motion.solved]
        raise InputError(Problem("--frame", "frame", str(frame), f"one with a pose, from {posed[0]} to {posed[-1]}"))
    return int(rows[0])


# -- tables -------------------------------------------------------------------------------------------------------


def _frames(record: SolverRecord) -> Table:
    """What the optimiser did, frame by frame."""
    motion, jitters = record.motion, record.motion.jitters
    columns = {"time_s": motion.time_s}
    if jitters:
        counts = ("iterations", "function_evaluations", "starts", "optimizer_status")
        columns |= {name: record.of_frames(name) for name in counts}
    columns |= {"optimality": record.optimality, "last_step" if jitters else "next_step": record.step_norm}
    columns |= {f"cost_{term.replace(' ', '_')}": cost for term, cost in record.problem.cost.items()}
    columns |= {f"{limit}_passed": count for limit, count in record.active.items()}
    columns |= {f"{name}_rad": values for name, values in record.rotation_rad.items()} | record.length
    rows = zip(motion.frames, *(values.tolist() for values in columns.values()), strict=True)
    return ["frame", *columns], rows


def _unknowns(record: SolverRecord) -> Table:
    """Gradient and Jacobian of every unknown, over the frames with a pose."""
    columns = "unknown, gradient_median, gradient_max, column_norm_min, column_norm_median, column_norm_max"
    problem = record.problem
    gradient, norm = np.abs(problem.gradient[problem.solved]), problem.column_norm[problem.solved]
    if not len(norm):
        return columns.split(", "), []
    values = (np.median(gradient, 0), gradient.max(0), norm.min(0), np.median(norm, 0), norm.max(0))
    return columns.split(", "), zip(problem.unknowns, *(v.tolist() for v in values), strict=True)


def _image_errors(record: SolverRecord) -> Table:
    """Distances of detections from reprojections, a column for each joint."""
    pose = record.motion.upright
    rows = [
        (camera, int(frame), *errors.tolist())
        for camera, of_camera in record.image_error_px.items()
        for frame, errors in zip(pose.frames, of_camera.T, strict=True)
    ]
    return ["camera", "frame", *(f"{name}_px" for name in pose.names)], rows


def _search(record: SolverRecord) -> Table:
    """From point to point of one frame's search."""
    search = record.search
    assert search is not None
    frame, damping = int(record.motion.frames[search.frame]), [*search.damping.tolist(), None]
    rows = zip(search.evaluations.tolist(), search.cost.tolist(), damping, strict=True)
    return ["frame", "point", "evaluations", "cost", "damping"], ((frame, k, *row) for k, row in enumerate(rows))


TABLES: dict[str, Callable[[SolverRecord], Table]] = {
    "solver_frames.csv": _frames,
    "solver_unknowns.csv": _unknowns,
    "image_errors.csv": _image_errors,
}
"""By file name: columns and rows."""


def write_tables(record: SolverRecord, folder: Path) -> None:
    """Every table and the Jacobian, into a folder that exists."""
    tables = TABLES if record.search is None else TABLES | {SEARCH: _search}
    for name, table in tables.items():
        columns, rows = table(record)
        write_rows(folder / name, [columns], rows)
    record.problem.write_jacobian(folder / JACOBIAN)


# -- figures -----------------------------------------------------------------------------------------


def solver_figures(record: SolverRecord) -> dict[str, Callable[[], Figure]]:
    """By file name, what draws it."""
    draw = (solver_search, solver_root, solver_unknowns, image_errors)
    if record.search is not None:
        draw = (*draw, solver_evaluations, solver_frame, solver_matrices, solver_rotation)
    return {one.__name__: partial(one, record) for one in draw}
