"""The commands `recon run`, `recon fix` and `recon label`, which import what they need when they are called."""

from __future__ import annotations

from typing import Annotated, Any

from rich.console import Console

from recon.api.settings import OF_ANY_CLIP, FitSettings
from recon.cli.answers import Answer
from recon.cli.commands import OptionsOf
from recon.cli.video_options import FixSettings, LabelSettings, RunSettings

_FitOptions = Annotated[dict[str, Any], OptionsOf(FitSettings, OF_ANY_CLIP, "Settings of the fit")]


def run(settings: RunSettings, options: _FitOptions, console: Console) -> Answer:
    """Make a page from a video: find the keypoints, fit, analyse, draw the overlay, record, and write report.html.

    Stages that were done before with the same files and settings are skipped. The frame rate is the video's unless
    --fps is given. The stages are detect, camera-motion, fit, analyse, overlay, playback and page.

    Example: recon run run.mp4 --camera camera.toml --model models/run --out results/run

    Exit code 0: finished. 1: no frame could be solved. 2: the input cannot be used; earlier results are kept.
    """
    from recon.cli.run import run_videos

    return run_videos(settings, options, console)


def fix(settings: FixSettings, console: Console) -> Answer:
    """Correct wrong keypoints in a browser, while the animal is fitted again.

    The page is served on this machine only, until you press Ctrl-C. Every change is saved to the corrections file, and
    the results stay unchanged. --export-labels and --export-table write the corrections for training the detector, and
    do not open the page.

    Example: recon fix results/clip --video clip.mp4
    """
    from recon.cli.fix import fix_or_export

    return fix_or_export(settings, console)


def label(settings: LabelSettings, console: Console) -> Answer:
    """Label frames of a video in a browser, for recon train and DeepLabCut.

    The frames are chosen so that they differ, or with --result so that a fit gains most. The page is served on this
    machine only, until you press Ctrl-C. Labels are saved with every click. Run the same command again to continue.

    Example: recon label run.mp4 --skeleton cheetah-24 --out project
    """
    from recon.cli.label import label_video

    return label_video(settings, console)
