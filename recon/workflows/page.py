"""`recon report`: pages to look at, `report.html` of a result, `summary.html` of a batch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from recon.base import Progress, silent
from recon.base.errors import InputError, Problem
from recon.base.files import sole_writer, staged_file
from recon.base.manifest import MANIFEST, read_manifest
from recon.base.parallel import Event, carry_out
from recon.base.settings import Option
from recon.show.overlay import draw_tiles
from recon.show.page import PAGE, require_own_page
from recon.show.page.clip import clip_page
from recon.show.page.render import jpeg
from recon.show.report import REPORT
from recon.workflows.batch import write_summary_page
from recon.workflows.batch.inputs import SUMMARY
from recon.workflows.cli.common import error_text, progress_bar, say, terminal
from recon.workflows.overlay import result_and_video, stills
from recon.workflows.settings import ResultSettings

STILLS = 9
BESIDE = ("overlay.mp4", "analysis/analysis.json")
"""Files that a page has links to, besides the fit's own, where they are there when it is made."""


class PageSettings(ResultSettings):
    """The settings of `recon report`."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Folder of results, as in results/clip, or of a batch."""


def report(settings: PageSettings, quiet: bool) -> None:
    """Make a page of a result to look at and to pass on: report.html in its folder, one file that opens in any browser.

    In the folder of a batch, those of all clips, and summary.html with links to them. A page that was made before is
    replaced.

    Example: recon report results/clip --video clip.mp4
    """
    console, folder = terminal(quiet=quiet), settings.folder
    of_batch = (folder / SUMMARY).is_file() and not (folder / REPORT).is_file()
    if of_batch and settings.video is not None:
        raise InputError(
            Problem("--video", "file", f"{settings.video} for many clips", "the folder of one clip's results")
        )
    with progress_bar(console) as progress:
        page, failed = _batch_pages(folder, progress) if of_batch else (run_page(settings, progress), {})
    for clip, error in failed.items():
        terminal(stderr=True, soft_wrap=True).print(error_text(f"{clip}: {error}"))
    say(console, f"Open {page} in a browser.")


def run_page(settings: PageSettings, progress: Progress = silent) -> Path:
    """The page of a result, in its folder; an earlier one is replaced. Raises InputError, with every problem."""
    page, video = settings.folder / PAGE, settings.video
    motion, number, _ = result_and_video(settings, lambda: require_own_page(page))
    progress("pictures", 0.1)
    drawn, rows, pictures = stills(motion, number, settings, STILLS)
    tiles = draw_tiles(drawn, rows, pictures) if len(rows) else []
    shown = [(jpeg(tile), f"frame {drawn.frames[t]}") for tile, t in zip(tiles, rows, strict=True)]
    progress("figures", 0.3)
    html = clip_page(motion, shown, None if video is None else video.name, _files(settings.folder), number)
    with staged_file(page) as staged:
        staged.write_text(html, encoding="utf-8")
    return page


def _files(folder: Path) -> list[str]:
    names = [*BESIDE, *(sorted(read_manifest(folder).files) if (folder / MANIFEST).is_file() else ())]
    return [name for name in names if (folder / name).is_file()]


def _batch_pages(out: Path, progress: Progress) -> tuple[Path, dict[str, str]]:
    """The page of every result in the folder of a batch, in parallel, and the summary's page; its path, and what went
    wrong by clip."""
    failed: dict[str, str] = {}
    with sole_writer(out):
        clips = [path.parent for path in sorted(out.glob(f"*/{REPORT}"))]
        done = 0

        def tell(event: Event) -> None:
            nonlocal done
            if event.kind == "ended":
                done += 1
                if event.outcome["status"] == "failed":
                    failed[event.name] = event.outcome["error"]
                progress(f"{done} of {len(clips)} pages", done / len(clips))

        carry_out(_page_of, [(clip.name, clip.absolute()) for clip in clips], tell)
        return write_summary_page(out), failed


def _page_of(folder: Path, progress: Progress) -> dict[str, str]:
    run_page(PageSettings(folder=folder), progress)
    return {"status": "done"}
