"""The command `recon solver`: its options, what it writes, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from threadpoolctl import threadpool_limits

from recon.base import Progress, silent
from recon.base.files import require_free_folder, sole_writer, staged_folder
from recon.base.settings import Integer, Option, Settings
from recon.fit.motion import Motion
from recon.show.plain import to_json
from recon.show.plots.style import save
from recon.thesis.plots import FIGURES
from recon.thesis.solver import JACOBIAN, TABLES, SolverRecord, read_solver, write_tables
from recon.workflows.cli.common import progress_bar, say, terminal

FOLDER, SUMMARY = "solver", "solver.json"
"""By default the folder lies in the results' own."""
FIGURES_BEGIN = 0.5
"""Share of the progress before the figures."""


class _SolverSettings(Settings):
    """What `recon solver` is told."""

    folder: Annotated[Path, Option("Folder of results of recon frame, as in results/clip.", argument="DIR")]
    out: Annotated[Path | None, Option("Folder for tables and figures. (default: solver in DIR)")] = None
    frame: Annotated[
        Integer | None, Option("The frame whose search is shown. (default: the one with most evaluations)")
    ] = None
    figures: Annotated[bool, Option("PNG and SVG beside the tables.")] = True
    overwrite: Annotated[bool, Option("Replace earlier tables.")] = False


def solver(settings: _SolverSettings, as_json: bool, quiet: bool) -> Any:
    """What the optimiser of `recon frame` did: cost, gradient, Jacobian, limits.

    Writes tables (CSV), the Jacobian (NPZ) and figures (PNG, SVG).

    Example: recon solver results/clip
    """
    console = terminal(quiet=quiet, stderr=as_json)
    with progress_bar(console) as progress:
        record, out, files = run_solver(settings, progress)
    if as_json:
        return record.summary()
    say(console, f"{len(files)} files are in {out}.")


def run_solver(settings: _SolverSettings, progress: Progress = silent) -> tuple[SolverRecord, Path, list[str]]:
    """`recon solver`: what was found, the folder that it was written to, and the names of its files.

    The results' own files are not written to. Raises InputError: no results of the frame method, or files in the way.
    """
    out = settings.folder / FOLDER if settings.out is None else settings.out
    progress("reading", 0.0)
    motion = Motion.load(settings.folder)
    with sole_writer(out):
        require_free_folder(out, (SUMMARY, *TABLES, JACOBIAN), settings.overwrite, "what the optimiser did")
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
            with staged_folder(out) as staging:
                for done, draw in enumerate(FIGURES):
                    progress(f"figures: {draw.__name__}", FIGURES_BEGIN + (1.0 - FIGURES_BEGIN) * done / len(FIGURES))
                    save(draw(record), staging, draw.__name__)
                files += [path.name for path in staging.iterdir()]
    return record, out, sorted(files)
