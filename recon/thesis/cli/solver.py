"""`recon solver`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon.workflows.cli.common import progress_bar, say, terminal


def solver(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of results, as in results/clip.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for tables and figures. (default: solver in DIR)", show_default=False)
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="PNG and SVG beside the tables.")] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier tables.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """What the optimiser did for a reconstruction: cost, gradient, Jacobian, limits.

    Writes tables (CSV), the Jacobian (NPZ), figures (PNG, SVG), and plots beside the playback. The keypoints and the
    camera of the fit have to be where they were.

    Example: recon solver results/clip
    """
    from recon.show.report import to_json
    from recon.thesis.inspection import run_solver

    console = terminal(quiet=quiet, stderr=as_json)
    with progress_bar(console) as progress:
        record, out, files = run_solver(folder, out, figures, overwrite, progress)
    if as_json:
        typer.echo(to_json(record.summary()), nl=False)
        return
    say(console, f"{len(files)} files are in {out}.")
    say(console, f"See them beside the playback with: recon view {folder} --analysis {out}")
