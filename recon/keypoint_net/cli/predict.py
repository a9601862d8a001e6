"""The command `recon predict`: its options, and what it prints."""

from __future__ import annotations

import time

from recon.keypoint_net.predict import LIKELY, PredictSettings
from recon.keypoint_net.workflows import run_prediction
from recon.workflows.cli.common import progress_bar, say, terminal


def predict(settings: PredictSettings, quiet: bool) -> None:
    """Find the keypoints in every frame of a video, with a network that `recon train` made.

    Example: recon predict run.mp4 --model models/run --out run.csv --overlay run_points.mp4
    """
    console = terminal(quiet=quiet)
    start = time.monotonic()
    with progress_bar(console, "predicting: ") as progress:
        keypoints = run_prediction(**{name: getattr(settings, name) for name in settings.infos()}, progress=progress)
    frames, seconds = len(keypoints.frames), time.monotonic() - start
    sure = float((keypoints.confidence >= LIKELY).mean())
    drawn = f", drawn on the video in {settings.overlay}" if settings.overlay else ""
    say(
        console,
        f"{frames} frames in {seconds:.1f} s ({frames / seconds:.0f} a second); {sure:.0%} of the points have a "
        f"likelihood of {LIKELY:g} or more. They are in {settings.out}{drawn}.",
    )
