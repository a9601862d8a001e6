"""`recon view`."""

from __future__ import annotations

import shlex

import typer

from recon.workflows.view import ViewSettings, run_view


def view(settings: ViewSettings) -> None:
    """Open the playback of a reconstruction in the rerun viewer, with the plots of its analysis.

    Example: recon view results/clip --video clip.mp4
    """

    run_view(settings)
    if settings.out is not None:
        file = settings.out
        typer.echo(f"The recording is in {file}. Watch it with: rerun {shlex.quote(str(file))}")
