"""`recon overlay`."""

from __future__ import annotations

from recon.workflows.cli.common import progress_bar, say, say_verdict, terminal
from recon.workflows.overlay import OverlaySettings, rate_note, run_overlay, run_sheet


def overlay(settings: OverlaySettings, quiet: bool) -> None:
    """Draw a reconstruction on its video, or some frames of it as one picture.

    Shown are detections, skeleton, doubtful frames, and in the video the pose from three sides.

    Example: recon overlay results/clip --video clip.mp4 --out overlay.mp4
    """
    console = terminal(quiet=quiet)
    if settings.sheet is not None:
        say(console, f"{run_sheet(settings)} frames are in {settings.sheet}.")
    if settings.out is None:
        return
    with progress_bar(console) as progress:
        frames, fps, speed, verdict = run_overlay(settings, progress)
    say_verdict(console, verdict)
    if settings.video and (note := rate_note(settings.video, fps / speed)):
        say(console, f"note: {note}")
    say(console, f"{frames} frames at {speed:.3g} times their speed ({fps:.4g} a second) are in {settings.out}.")
