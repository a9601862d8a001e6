"""`recon view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon.errors import InputError, Problem


def view(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of results, as in results/clip.")],
    video: Annotated[
        Path | None, typer.Option(help="Put the frames of this video into the playback first, as in clip.mp4.")
    ] = None,
    first_frame: Annotated[
        int, typer.Option(help="Number that the video's first frame has in the keypoint file, if the video was cut.")
    ] = 0,
) -> None:
    """Open the playback of a reconstruction in the rerun viewer.

    Example: recon view results/clip --video clip.mp4
    """
    from recon.view import open_viewer

    if video is not None:
        from recon.view.video import add_video

        add_video(folder / "motion.rrd", video, first_frame)
    elif first_frame:
        raise InputError(Problem("--first-frame", "video", "no --video", "one beside the other"))
    open_viewer(folder / "motion.rrd")
