"""`recon solver`."""

from __future__ import annotations

from typing import Any

from recon.thesis.inspection import SolverSettings, run_solver
from recon.workflows.cli.common import progress_bar, say, terminal


def solver(settings: SolverSettings, as_json: bool, quiet: bool) -> Any:
    """What the optimiser did for a reconstruction: cost, gradient, Jacobian, limits.

    Writes tables (CSV), the Jacobian (NPZ), figures (PNG, SVG), and plots beside the playback.

    Example: recon solver results/clip
    """
    console = terminal(quiet=quiet, stderr=as_json)
    with progress_bar(console) as progress:
        record, out, files = run_solver(settings, progress)
    if as_json:
        return record.summary()
    say(console, f"{len(files)} files are in {out}.")
    say(console, f"See them beside the playback with: recon view {settings.folder} --analysis {out}")
