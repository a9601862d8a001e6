"""`recon camera-motion`."""

from __future__ import annotations

from typing import Any

from recon.workflows.camera_motion import NOTES, CameraMotionSettings, run_camera_motion
from recon.workflows.cli.common import counted, progress_bar, say, terminal


def camera_motion(settings: CameraMotionSettings, as_json: bool) -> Any:
    """Find how a camera turned (and zoomed) from the background of its video: a camera track.

    Example: recon camera-motion clip.mp4 --camera camera.toml --keypoints clip.csv --out track.csv
    """
    with progress_bar(terminal(stderr=True)) as progress:
        report, files = run_camera_motion(settings, progress)
    if as_json:
        return report
    console = terminal()
    lost = len(report["frames_without_background"])
    keyframes = counted(len(report["keyframes"]), "keyframe")
    say(console, f"{report['frames'] - lost} of {report['frames']} frames placed, {keyframes}.")
    if lost:
        say(console, f"{lost} frames have too little background: no pose there.")
    say(console, f"Off by {report['residual_px']:.2f} px, turned to {report['sigma_deg']:.3f} degrees.")
    for note in report["notes"][len(NOTES) :]:
        say(console, f"Note: {note}.")
    say(console, f"Level: {report['level']}. A rolling shutter is not modelled.")
    say(console, "Written: " + ", ".join(map(str, files)))
