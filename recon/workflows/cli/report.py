"""`recon report`."""

from __future__ import annotations

from recon.base.errors import InputError, Problem
from recon.workflows.cli.common import error_text, progress_bar, say, say_what_is_gone, terminal
from recon.workflows.page import PageSettings, is_batch, run_batch_pages, run_page


def report(settings: PageSettings, quiet: bool) -> None:
    """Make a page of a result to look at and to pass on: report.html in its folder, one file that opens in any browser.

    In the folder of a batch, those of all clips, and summary.html with links to them. A page that was made before is
    replaced.

    Example: recon report results/clip --video clip.mp4
    """
    console = terminal(quiet=quiet)
    folder = settings.folder
    if is_batch(folder):
        if settings.video is not None:
            raise InputError(
                Problem("--video", "file", f"{settings.video} for many clips", "the folder of one clip's results")
            )
        with progress_bar(console) as progress:
            page, failed = run_batch_pages(folder, progress=progress)
        for clip, error in failed.items():
            terminal(stderr=True, soft_wrap=True).print(error_text(f"{clip}: {error}"))
        say(console, f"Open {page} in a browser.")
        return
    with progress_bar(console) as progress:
        page = run_page(settings, progress)
    say_what_is_gone(console, folder)
    say(console, f"Open {page} in a browser.")
