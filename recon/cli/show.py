"""The commands `recon overlay`, `recon report` and `recon view`, which import what they need when they are called."""

from __future__ import annotations

from rich.console import Console

from recon.base.progress import Progress, silent
from recon.cli.answers import Answer
from recon.cli.look_options import OverlaySettings, PageSettings, ViewSettings


def overlay(settings: OverlaySettings, progress: Progress = silent) -> Answer:
    """Draw a reconstruction on its video: detections, skeleton, uncertain frames, and the pose from three sides.

    Example: recon overlay results/clip --video clip.mp4 --out overlay.mp4
    """
    from recon.cli.look import draw_overlay

    return draw_overlay(settings, progress)


def report(settings: PageSettings, progress: Progress = silent) -> Answer:
    """Make a page of a result to view and to share: report.html in its folder, which opens in any browser.

    For a batch's folder, make the pages of all clips, and summary.html with links to them. Earlier pages are replaced.

    Example: recon report results/clip --video clip.mp4

    Exit code 1: a page of a batch could not be made; the others were written.
    """
    from recon.cli.look import make_page

    return make_page(settings, progress)


def view(settings: ViewSettings, console: Console) -> Answer:
    """Open the playback of a reconstruction in the rerun viewer, with the plots of its analysis.

    Example: recon view results/clip --video clip.mp4
    """
    from recon.cli.look import show_playback

    return show_playback(settings, console)
