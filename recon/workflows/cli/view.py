"""`recon view`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from recon.workflows.cli.common import FIRST_FRAME


def view(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of results, as in results/clip.")],
    analysis: Annotated[
        Path | None,
        typer.Option(help="Folder of recon analyse. (default: analysis in DIR, if there is one)", show_default=False),
    ] = None,
    video: Annotated[
        Path | None, typer.Option(help="Show the frames of this video with it from now on, as in clip.mp4.")
    ] = None,
    first_frame: Annotated[int, FIRST_FRAME] = 0,
    camera_name: Annotated[
        str | None, typer.Option(help="Whose video it is, of a clip with several cameras, as in cam2.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write all that is shown as one recording, and open nothing, as in clip.rrd.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the recording of --out.")] = False,
) -> None:
    """Open the playback of a reconstruction in the rerun viewer, with the plots of its analysis.

    Example: recon view results/clip --video clip.mp4
    """
    from recon.workflows.view import run_view

    def note(text: str) -> None:
        typer.echo(text, err=True)

    run_view(folder, analysis, video, first_frame, camera_name, out, overwrite, note)
    if out is not None:
        typer.echo(f"The recording is in {out}. Watch it with: rerun {shlex.quote(str(out))}")
