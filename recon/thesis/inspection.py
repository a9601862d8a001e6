"""What the optimiser did for a result: its problem again, from the files that it was fitted to; tables and figures.

Columns of the tables: docs/solver.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from threadpoolctl import threadpool_limits

from recon.animal.skeleton_file import load_chain
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.files import require_free_folder, sole_writer, staged_folder
from recon.base.progress import Progress, silent
from recon.base.settings import Option, Settings
from recon.clip import Source, together, views_of
from recon.fit.clip_problem import ClipProblem
from recon.fit.results import Results, read_results
from recon.io.calibration import read_cameras
from recon.io.table import write_rows
from recon.show import plots
from recon.show.export.analysis_csv import Table
from recon.show.report import to_json
from recon.thesis.clip import frame_options
from recon.thesis.plots import image_errors, solver_root, solver_search, solver_unknowns
from recon.thesis.solver import SolverRecord, linearised_clip, linearised_frames
from recon.workflows.analyse import PLAYBACK, PLOTS
from recon.workflows.clip import REFINED_CAMERAS, prepare
from recon.workflows.made_from import read_config
from recon.workflows.overlay import overlay_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from recon.show.view.added import AddedSeries

FOLDER, SUMMARY, JACOBIAN = "solver", "solver.json", "jacobian.npz"
"""By default the folder lies in the results' own."""
FIGURES_BEGIN = 0.5
"""Of the progress."""
CONFIG = "config.toml"
EXPECTED = "the keypoints and cameras of the fit, as they were: fit the clip again"
_ALIKE, _ALIKE_PX = 2.0, 0.1
"""Costs that differ by a larger factor are of another camera, and points that differ by more are other keypoints."""


class SolverSettings(Settings):
    """What `recon solver` is told."""

    folder: Annotated[Path, Option("Folder of results, as in results/clip.", argument="DIR")]
    out: Annotated[Path | None, Option("Folder for tables and figures. (default: solver in DIR)")] = None
    figures: Annotated[bool, Option("PNG and SVG beside the tables.")] = True
    overwrite: Annotated[bool, Option("Replace earlier tables.")] = False


def run_solver(settings: SolverSettings, progress: Progress = silent) -> tuple[SolverRecord, Path, list[str]]:
    """`recon solver`: what was found, the folder that it was written to, and the names of its files.

    out: by default the folder "solver" in the results' own, which are not written to otherwise. Raises InputError: no
    results, other inputs than those of the fit, or files in the way.
    """
    out = settings.folder / FOLDER if settings.out is None else settings.out
    progress("reading", 0.0)
    results = read_results(settings.folder)
    with sole_writer(out):
        require_free_folder(out, (SUMMARY, PLOTS, *TABLES, JACOBIAN), settings.overwrite, "what the optimiser did")
        progress("problem", 0.1)
        with threadpool_limits(1, user_api="blas"):  # of small matrices, threads cost more than they bring
            record = read_solver(results)
            summary = record.summary()
        progress("tables", FIGURES_BEGIN - 0.1)
        with staged_folder(out) as staging:
            write_tables(record, staging)
            (staging / SUMMARY).write_text(to_json(summary), encoding="utf-8")
            if (settings.folder / PLAYBACK).is_file():
                _write_plots(record, settings.folder / PLAYBACK, staging / PLOTS)
            files = [path.name for path in staging.iterdir()]
        if settings.figures:
            drawn = solver_figures(record)
            with staged_folder(out) as staging:
                for done, (name, draw) in enumerate(drawn.items()):
                    progress(f"figures: {name}", FIGURES_BEGIN + (1.0 - FIGURES_BEGIN) * done / len(drawn))
                    plots.save(draw(), staging, name)
                files += [path.name for path in staging.iterdir()]
    return record, out, sorted(files)


def read_solver(results: Results) -> SolverRecord:
    """Raises InputError where the keypoints or the camera of the fit are no longer there, or are others."""
    results.manifest.require(CONFIG)
    config = results.folder / CONFIG
    settings = read_config(config, {})
    given = prepare(settings)
    model, sources = given.model, given.sources
    if settings.find_offsets:
        later = [round(camera["offset_s"] * given.fps, 9) for camera in results.report["cameras"]]
        sources = together(given.apart, later)
    if settings.seeks_cameras:
        results.manifest.require(REFINED_CAMERAS)
        cameras = read_cameras(results.folder / REFINED_CAMERAS)
        sources = tuple(replace(source, camera=camera) for source, camera in zip(sources, cameras, strict=True))
    views = views_of(sources)
    _require_the_same(sources, results)
    chain = load_chain(results.skeleton_name) if results.body.one_sided else None
    if chain is not None and settings.method == "frame":
        problem = linearised_frames(views[0], chain, given.fps, frame_options(settings), results)
        told = 0.5 * sum(frame["squared_norm"] for frame in results.report["frames"] if frame["unknowns"])
    else:
        assert model.prior is not None
        setting = ClipProblem.of(views, model.body, model.prior, given.fps, settings.trajectory_options())
        problem = linearised_clip(setting, results)
        told = sum(results.report["convergence"]["cost_by_term"].values())
    if not problem.solved.any():
        expected = "one between two gaps, at least, with a pose in every frame"
        raise InputError(Problem(results.folder, "segments", "none with a pose throughout", expected))
    cost = sum(float(np.nansum(of_term)) for of_term in problem.cost.values())
    if problem.solved.all() and max(cost, told) > _ALIKE * max(min(cost, told), 1.0):
        raise InputError(Problem(config, "camera", f"a cost of {cost:.4g}, where the fit had {told:.4g}", EXPECTED))
    return SolverRecord(results, problem, chain)


def _require_the_same(sources: Sequence[Source], results: Results) -> None:
    """Raises InputError unless these are the detections of the fit."""
    for number, source in enumerate(sources):
        keypoints, detected_px = source.keypoints, overlay_of(results, number=number).detected_px
        known = np.isfinite(detected_px)
        solved = np.isfinite(results.states[:, 0])
        if (
            not np.array_equal(keypoints.frames, results.pose.frames)
            or not np.array_equal(known[solved], np.isfinite(keypoints.xy_px[solved]))
            or np.abs(detected_px - keypoints.xy_px)[known].max(initial=0.0) > _ALIKE_PX
        ):
            path = keypoints.source or results.folder / CONFIG
            raise InputError(Problem(path, "keypoints", "others than those of the fit", EXPECTED))


# -- tables -------------------------------------------------------------------------------------------------------


def _frames(record: SolverRecord) -> Table:
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
    pose = record.results.pose
    rows = [
        (camera, int(frame), *errors.tolist())
        for camera, of_camera in record.image_error_px.items()
        for frame, errors in zip(pose.frames, of_camera.T, strict=True)
    ]
    return ["camera", "frame", *(f"{name}_px" for name in pose.names)], rows


TABLES: dict[str, Callable[[SolverRecord], Table]] = {
    "solver_frames.csv": _frames,
    "solver_unknowns.csv": _unknowns,
    "image_errors.csv": _image_errors,
}
"""By file name: columns and rows."""


def write_tables(record: SolverRecord, folder: Path) -> None:
    """Every table and the Jacobian, into a folder that exists."""
    for name, table in TABLES.items():
        columns, rows = table(record)
        write_rows(folder / name, [columns], rows)
    record.problem.write_jacobian(folder / JACOBIAN)


# -- figures and playback -----------------------------------------------------------------------------------------


def solver_figures(record: SolverRecord) -> dict[str, Callable[[], Figure]]:
    """By file name, what draws it."""
    draw = (solver_search, solver_root, solver_unknowns, image_errors)
    return {one.__name__: partial(one, record) for one in draw}


def _write_plots(record: SolverRecord, playback: Path, path: Path) -> None:
    from recon.show.view.added import write_plots  # rerun is slow to import

    record.results.manifest.require(PLAYBACK)
    write_plots(path, playback, [*playback_series(record)], [])


def playback_series(record: SolverRecord) -> Iterator[AddedSeries]:
    """The plots that go with the playback; what is of very different sizes in powers of ten."""
    from recon.show.view.added import AddedSeries  # rerun is slow to import
    from recon.show.view.series import LINE_COLOURS

    cost = {name: _log10(of_term) for name, of_term in record.problem.cost.items() if np.nansum(of_term) > 0}
    search = {"largest of the gradient": _log10(record.optimality), "step": _log10(record.step_norm)}
    worst = {name: np.fmax.reduce(values, axis=0) for name, values in record.image_error_px.items()}
    rotation = {name: np.degrees(values) for name, values in record.rotation_rad.items()}
    shown = [
        ("cost", "Cost by term (log10)", cost),
        ("optimality", "Gradient and step (log10)", search),
        ("iterations", "Iterations", {"iterations": record.of_frames("iterations")} if record.results.jitters else {}),
        ("limits", "Limits passed", {name: count.astype(float) for name, count in record.active.items()}),
        ("image_error", "Error in the picture (px), worst joint", worst),
        ("rotation", "Rotation of the root (°)", rotation),
        ("length", "Base length (m)" if record.results.jitters else "Size", record.length),
    ]
    for entity, title, lines in shown:
        if not lines:
            continue
        yield AddedSeries(
            entity=f"solver/{entity}",
            title=title,
            names=[*lines],
            colours=[LINE_COLOURS[i % len(LINE_COLOURS)] for i in range(len(lines))],
            values=np.stack([*lines.values()], axis=1),
            time_s=record.results.time_s,
            tab="Picture and root" if entity in ("image_error", "rotation", "length") else "Solver",
        )


def _log10(values: Array) -> Array:
    """NaN where there is nothing."""
    return np.log10(np.where(values > 0, values, np.nan))
