"""`recon run`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from recon.base.errors import InputError, Problem
from recon.workflows.cli.batch import shown_batch
from recon.workflows.cli.common import FIRST_FRAME, finish, progress_bar, say, terminal
from recon.workflows.cli.settings import OPTIONS, takes_settings

if TYPE_CHECKING:
    from recon.workflows.run import Done

_STAGES = "detect, camera-motion, fit, analyse, overlay, page"


@takes_settings([name for name in OPTIONS if name != "keypoints"], "Settings of the fit")
def run(
    *,
    video: Annotated[Path, typer.Argument(metavar="VIDEO", help="The video, as in run.mp4, or a folder of videos.")],
    out: Annotated[Path, typer.Option(help="Folder for everything; of a folder of videos one in it for each.")],
    model: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of a trained network, as in models/run.", show_default=False),
    ] = None,
    keypoints: Annotated[
        Path | None,
        typer.Option(
            help="Instead of a network: the keypoint file; of a folder of videos the folder with a file for each.",
            show_default=False,
        ),
    ] = None,
    camera_motion: Annotated[
        str | None,
        typer.Option(
            metavar="turns|zooms",
            help="Find how the camera turned, or turned and zoomed, from the background. (default: it stands still)",
            show_default=False,
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="STAGE", help=f"Do this stage again, and all after it: {_STAGES}."),
    ] = None,
    first_frame: Annotated[int, FIRST_FRAME] = 0,
    quality: Annotated[str, typer.Option(help="Of the network's points: fast, or best.")] = "fast",
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Of a folder: videos at a time, each in a process. (default: one for each core)"),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Settings as in the config.toml of a fit; options here overrule it.")
    ] = None,
    given: dict[str, Any],
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files that no run has made, or that were changed since.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was done, and the report's summary, as JSON.")] = (
        False
    ),
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """From a video to a page: find the keypoints, fit, analyse, draw the overlay, and write report.html.

    What has been done with the same files and settings is not done again. The frame rate is the video's unless --fps is
    given.

    Example: recon run run.mp4 --camera camera.toml --model models/run --out results/run

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used; what was done before stays.
    """
    more = {
        "model": model,
        "keypoints": keypoints,
        "camera_motion": camera_motion,
        "first_frame": first_frame,
        "start": start,
        "quality": quality,
        "overwrite": overwrite,
    }
    console = terminal(quiet=quiet, stderr=as_json)
    if video.is_dir():
        from recon.workflows.run_folder import jobs_of, run_folder

        plan = jobs_of(video, out, given, config, **more)
        shown_batch(console, len(plan), as_json, lambda tell: run_folder(plan, out, jobs, tell))
        return
    if jobs is not None:
        raise InputError(Problem("--jobs", "processes", f"{jobs} for one video", "a folder of videos"))
    from recon.workflows.run import job_of, run_video

    with progress_bar(console) as progress:
        done = run_video(job_of(video, out, given, config, **more), progress, lambda stage: _say_stage(console, stage))
    stages = [{"stage": s.stage, "status": s.status, "seconds": round(s.seconds, 3)} for s in done.stages]
    finish(console, done.report, out, as_json, stages=stages)
    if not as_json:
        say(console, f"Open {out / 'report.html'} in a browser.")


def _say_stage(console: Any, done: Done) -> None:
    names = done.files[0] if len(done.files) == 1 else f"{len(done.files)} files"
    text = {
        "done": f"{names}, {done.seconds:.1f} s",
        "unchanged": f"{names}, as before",
        "left out": "left out: too few frames have a pose",
    }[done.status]
    say(console, f"{done.stage:<14}{text}")
