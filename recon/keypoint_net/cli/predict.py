"""`recon predict`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from recon.workflows.cli.common import number_option, progress_bar, say, terminal


def predict(
    video: Annotated[Path, typer.Argument(help="The video, as in run.mp4.")],
    model: Annotated[Path, typer.Option(metavar="DIR", help="Folder of a trained network, as in models/run.")],
    out: Annotated[Path, typer.Option(help="The keypoint file, .csv or .h5, in DeepLabCut's layout.")],
    overlay: Annotated[
        Path | None, typer.Option(help="A new video with the points drawn, .mp4 (MPEG-4) or .avi (Motion JPEG).")
    ] = None,
    quality: Annotated[
        str,
        typer.Option(
            help="fast, or best: averaged over three scales and, if trained with them, mirror pictures; three to six "
            "times the work."
        ),
    ] = "fast",
    likelihood_min: Annotated[
        float,
        number_option(
            "Points less likely than this are small rings in the overlay; the file has them all.",
            "a number from 0 to 1",
        ),
    ] = 0.5,
    background: Annotated[
        bool,
        typer.Option("--background/--no-background", help="Use the still background of a camera that stands still."),
    ] = True,
    half: Annotated[
        bool, typer.Option("--half/--no-half", help="Compute in 16 bits where the device is faster with them.")
    ] = True,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda or mps.")] = "auto",
    threads: Annotated[int | None, typer.Option(help="Threads on the CPU. (default: the fastest)")] = None,
    partial: Annotated[
        bool, typer.Option("--partial", help="Accept a video of which fewer frames can be decoded than it states.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that are there.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Find the keypoints in every frame of a video, with a network that `recon train` made.

    Example: recon predict run.mp4 --model models/run --out run.csv --overlay run_points.mp4
    """
    from recon.keypoint_net.workflows import run_prediction

    console = terminal(quiet=quiet)
    start = time.monotonic()
    with progress_bar(console, "predicting: ") as progress:
        keypoints = run_prediction(
            video,
            model,
            out,
            overlay=overlay,
            quality=quality,
            likelihood_min=likelihood_min,
            half=half,
            still_background=background,
            device=device,
            threads=threads,
            partial=partial,
            overwrite=overwrite,
            progress=progress,
        )
    frames, seconds = len(keypoints.frames), time.monotonic() - start
    sure = float((keypoints.confidence >= likelihood_min).mean())
    drawn = f", drawn on the video in {overlay}" if overlay else ""
    say(
        console,
        f"{frames} frames in {seconds:.1f} s ({frames / seconds:.0f} a second); {sure:.0%} of the points have a "
        f"likelihood of {likelihood_min:g} or more. They are in {out}{drawn}.",
    )
