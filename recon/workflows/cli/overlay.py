"""`recon overlay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon.base.errors import InputError, Problem
from recon.workflows.cli.common import FIRST_FRAME, number_option, progress_bar, say, terminal


def overlay(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of results, as in results/clip.")],
    video: Annotated[
        Path | None,
        typer.Option(help="The video that the keypoints came from, as in clip.mp4.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="The new video, .mp4 (MPEG-4) or .avi (Motion JPEG), as in overlay.mp4.", show_default=False),
    ] = None,
    sheet: Annotated[
        Path | None,
        typer.Option(help="Stills side by side, as in sheet.png; without --video plain.", show_default=False),
    ] = None,
    count: Annotated[int, typer.Option(help="Of the stills.")] = 12,
    camera_name: Annotated[
        str | None,
        typer.Option(
            help="Whose video it is, of a clip with several cameras, as in cam2. (default: whose name the video's has; "
            "of plain stills the first)",
            show_default=False,
        ),
    ] = None,
    first_frame: Annotated[int, FIRST_FRAME] = 0,
    speed: Annotated[
        float | None,
        number_option(
            "Of the playback, 1 is real time. (default: so that 30 frames are shown in a second)",
            "a number above 0, as in 0.25",
        ),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the new files.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Draw a reconstruction on its video, or some frames of it as one picture.

    Shown are detections, skeleton, doubtful frames, and in the video the pose from three sides.

    Example: recon overlay results/clip --video clip.mp4 --out overlay.mp4
    """
    from recon.workflows.overlay import run_overlay, run_sheet

    console = terminal(quiet=quiet)
    _require(video, out, sheet)
    if sheet is not None:
        shown = run_sheet(
            folder,
            sheet,
            video=video,
            first_frame=first_frame,
            camera=camera_name,
            count=count,
            overwrite=overwrite,
        )
        say(console, f"{shown} frames are in {sheet}.")
    if video is None or out is None:
        return
    with progress_bar(console) as progress:
        run = run_overlay(
            folder,
            video,
            out,
            first_frame=first_frame,
            camera=camera_name,
            speed=speed,
            overwrite=overwrite,
            progress=progress,
        )
    say(console, f"{run.frames} frames at {run.speed:.3g} times their speed ({run.fps:.4g} a second) are in {out}.")


def _require(video: Path | None, out: Path | None, sheet: Path | None) -> None:
    """Raises InputError unless there is something to draw, on what it needs."""
    if out is None and sheet is None:
        raise InputError(Problem("--out", "file", "nothing", "the new video, or --sheet with a picture"))
    if out is not None and video is None:
        raise InputError(Problem("--video", "file", "nothing", "the video that the keypoints came from"))
