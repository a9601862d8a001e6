"""`recon camera-advice`."""

from __future__ import annotations

from typing import Any

from recon.workflows.camera_advice import CameraAdviceSettings, run_camera_advice
from recon.workflows.cli.common import progress_bar, say, terminal


def camera_advice(settings: CameraAdviceSettings, as_json: bool) -> Any:
    """Where to put a camera, or two, so that an angle or a joint is seen and not guessed.

    Example: recon camera-advice --skeleton cheetah-24 --angle front_trunk_yaw --out advice
    """
    with progress_bar(terminal(stderr=True)) as progress:
        report = run_camera_advice(settings, progress)
    if as_json:
        return report
    for line in report["words"]:
        say(terminal(), line)
    say(terminal(), f"The figure and the table are in {settings.out}.")
