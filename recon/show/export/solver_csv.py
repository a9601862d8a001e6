"""The tables of `recon analyse --solver`, from a `SolverRecord`. Columns: docs/solver.md."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from recon.io.table import write_rows
from recon.show.export.analysis_csv import Table
from recon.thesis.solver import SolverRecord


def frames(record: SolverRecord) -> Table:
    """What the optimiser did, frame by frame."""
    results, jitters = record.results, record.results.jitters
    columns = {"time_s": results.time_s}
    if jitters:
        columns |= {name: record.of_frames(name) for name in ("iterations", "function_evaluations", "starts")}
    columns |= {"optimality": record.optimality, "last_step" if jitters else "next_step": record.step_norm}
    columns |= {f"cost_{term.replace(' ', '_')}": cost for term, cost in record.problem.cost.items()}
    columns |= {f"{limit}_passed": count for limit, count in record.active.items()}
    columns |= {f"{name}_rad": values for name, values in record.rotation_rad.items()} | record.length
    rows = zip(results.pose.frames, *(values.tolist() for values in columns.values()), strict=True)
    return ["frame", *columns], rows


def unknowns(record: SolverRecord) -> Table:
    """Gradient and Jacobian of every unknown, over the frames with a pose."""
    columns = "unknown, gradient_median, gradient_max, column_norm_min, column_norm_median, column_norm_max"
    problem = record.problem
    gradient, norm = np.abs(problem.gradient[problem.solved]), problem.column_norm[problem.solved]
    if not len(norm):
        return columns.split(", "), []
    values = (np.median(gradient, 0), gradient.max(0), norm.min(0), np.median(norm, 0), norm.max(0))
    return columns.split(", "), zip(problem.unknowns, *(v.tolist() for v in values), strict=True)


def image_errors(record: SolverRecord) -> Table:
    """Distances of detections from reprojections, a column for each joint."""
    pose = record.results.pose
    rows = [
        (camera, int(frame), *errors.tolist())
        for camera, of_camera in record.image_error_px.items()
        for frame, errors in zip(pose.frames, of_camera.T, strict=True)
    ]
    return ["camera", "frame", *(f"{name}_px" for name in pose.names)], rows


TABLES: dict[str, Callable[[SolverRecord], Table]] = {
    "solver_frames.csv": frames,
    "solver_unknowns.csv": unknowns,
    "image_errors.csv": image_errors,
}
"""By file name: columns and rows."""
JACOBIAN = "jacobian.npz"


def write(record: SolverRecord, folder: Path) -> None:
    """Every table and the Jacobian, into a folder that exists."""
    for name, table in TABLES.items():
        columns, rows = table(record)
        write_rows(folder / name, [columns], rows)
    record.problem.write_jacobian(folder / JACOBIAN)
