"""`recon run`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from recon.base.errors import InputError, Problem
from recon.base.settings import Count, Integer, Option, Settings
from recon.workflows.cli.batch import shown_batch
from recon.workflows.cli.command import OptionsOf
from recon.workflows.cli.common import finish, progress_bar, say, terminal
from recon.workflows.settings import FIRST_FRAME, SETTINGS, FitSettings

if TYPE_CHECKING:
    from recon.workflows.run import Done

_OF_THE_FIT = tuple(name for name in SETTINGS if name != "keypoints")
_STAGES = "detect, camera-motion, fit, analyse, overlay, page"


class _RunSettings(Settings):
    """What `recon run` is told besides the settings of the fit."""

    video: Annotated[Path, Option("The video, as in run.mp4, or a folder of videos.", argument="VIDEO")]
    out: Annotated[Path, Option("Folder for everything; of a folder of videos one in it for each.")]
    model: Annotated[Path | None, Option("Folder of a trained network, as in models/run.", metavar="DIR")] = None
    keypoints: Annotated[
        Path | None,
        Option("Instead of a network: the keypoint file; of a folder of videos the folder with a file for each."),
    ] = None
    camera_motion: Annotated[
        str | None,
        Option(
            "Find how the camera turned, or turned and zoomed, from the background. (default: it stands still)",
            metavar="turns|zooms",
        ),
    ] = None
    start: Annotated[
        str | None, Option(f"Do this stage again, and all after it: {_STAGES}.", metavar="STAGE", name="--from")
    ] = None
    first_frame: Annotated[Integer, FIRST_FRAME] = 0
    quality: Annotated[str, Option("Of the network's points: fast, or best.")] = "fast"
    jobs: Annotated[
        Count | None, Option("Of a folder: videos at a time, each in a process. (default: one for each core)")
    ] = None
    config: Annotated[Path | None, Option("Settings as in the config.toml of a fit; options here overrule it.")] = None
    overwrite: Annotated[bool, Option("Replace files that no run has made, or that were changed since.")] = False


def run(
    settings: _RunSettings,
    given: Annotated[dict[str, Any], OptionsOf(FitSettings, _OF_THE_FIT, "Settings of the fit")],
    as_json: bool,
    quiet: bool,
) -> None:
    """From a video to a page: find the keypoints, fit, analyse, draw the overlay, and write report.html.

    What has been done with the same files and settings is not done again. The frame rate is the video's unless --fps is
    given.

    Example: recon run run.mp4 --camera camera.toml --model models/run --out results/run

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used; what was done before stays.
    """
    names = ("model", "keypoints", "camera_motion", "first_frame", "start", "quality", "overwrite")
    more = {name: getattr(settings, name) for name in names}
    video, out, jobs, config = settings.video, settings.out, settings.jobs, settings.config
    console = terminal(quiet=quiet, stderr=as_json)
    if video.is_dir():
        from recon.workflows.run_folder import jobs_of, run_folder

        plan = jobs_of(video, out, given, config, **more)
        shown_batch(console, len(plan), as_json, lambda tell: run_folder(plan, out, jobs, tell))
        return
    if jobs is not None:
        raise InputError(Problem("--jobs", "processes", f"{jobs} for one video", "a folder of videos"))
    from recon.workflows.overlay import rate_note
    from recon.workflows.run import job_of, run_video

    with progress_bar(console) as progress:
        job = job_of(video, out, given, config, **more)
        done, report = run_video(job, progress, lambda stage: _say_stage(console, stage))
    if note := rate_note(video, job.settings.fps):
        say(console, f"note: {note}")
    stages = [{"stage": s.stage, "status": s.status, "seconds": round(s.seconds, 3)} for s in done]
    finish(console, report, out, as_json, stages=stages)
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
