"""`recon demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon.workflows.cli.common import finish, leave_pandas_out, progress_bar, terminal


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("demo-output"),
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace results in the folder.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report's summary as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Reconstruct the bundled sample, a noisy synthetic gallop, and compare it with its truth.

    Example: recon demo --out demo-output
    """
    from recon.workflows.demo import run_demo

    console = terminal(quiet=quiet, stderr=as_json)
    leave_pandas_out()
    with progress_bar(console, "fitting: ") as progress:
        report, evaluation = run_demo(out, overwrite, progress)
    finish(console, report, out, as_json, mpjpe_mm=1000 * evaluation.mpjpe_m.mean)
    if not as_json:
        console.print(f"Error against the sample's truth: {1000 * evaluation.mpjpe_m.mean:.0f} mm (MPJPE)")
