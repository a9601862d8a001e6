"""The command `recon solver`: its options, and what it prints."""

from __future__ import annotations

from typing import Any

from recon.thesis.inspection import SolverSettings, run_solver
from recon.workflows.cli.common import progress_bar, say, terminal


def solver(settings: SolverSettings, as_json: bool, quiet: bool) -> Any:
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
