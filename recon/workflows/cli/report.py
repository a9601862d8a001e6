"""`recon report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon.base.errors import InputError, Problem
from recon.workflows.cli.common import FIRST_FRAME, error_text, progress_bar, say, say_what_is_gone, terminal


def report(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of results, as in results/clip, or of a batch.")
    ],
    video: Annotated[
        Path | None,
        typer.Option(help="The video that the keypoints came from, to be seen in the pictures.", show_default=False),
    ] = None,
    camera_name: Annotated[
        str | None, typer.Option(help="Whose pictures, of a clip with several cameras, as in cam2.")
    ] = None,
    first_frame: Annotated[int, FIRST_FRAME] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Make a page of a result to look at and to pass on: report.html in its folder, one file that opens in any browser.

    In the folder of a batch, those of all clips, and summary.html with links to them. A page that was made before is
    replaced.

    Example: recon report results/clip --video clip.mp4
    """
    from recon.workflows.page import is_batch, run_batch_pages, run_page

    console = terminal(quiet=quiet)
    if is_batch(folder):
        if video is not None:
            raise InputError(Problem("--video", "file", f"{video} for many clips", "the folder of one clip's results"))
        with progress_bar(console) as progress:
            page, failed = run_batch_pages(folder, progress=progress)
        for clip, error in failed.items():
            terminal(stderr=True, soft_wrap=True).print(error_text(f"{clip}: {error}"))
        say(console, f"Open {page} in a browser.")
        return
    with progress_bar(console) as progress:
        page = run_page(folder, video=video, first_frame=first_frame, camera=camera_name, progress=progress)
    say_what_is_gone(console, folder)
    say(console, f"Open {page} in a browser.")
