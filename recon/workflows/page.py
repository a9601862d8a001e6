"""Pages to look at: `report.html` of a result, `summary.html` of a batch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from recon.base.files import sole_writer, staged_file
from recon.base.manifest import MANIFEST, read_manifest
from recon.base.parallel import Event, carry_out
from recon.base.progress import Progress, silent
from recon.base.settings import Option
from recon.fit.motion import Motion
from recon.show.overlay import draw_tiles
from recon.show.page import PAGE, require_own_page
from recon.show.page.clip import clip_page
from recon.show.page.render import jpeg
from recon.show.report import REPORT
from recon.workflows.batch.inputs import SUMMARY
from recon.workflows.batch.summary import write_summary_page
from recon.workflows.overlay import overlay_of, pictures_of, result_and_video, rows_to_show
from recon.workflows.settings import ResultSettings

STILLS = 9
BESIDE = ("overlay.mp4", "analysis/analysis.json")
"""Files that a page has links to, besides the fit's own, where they are there when it is made."""


class PageSettings(ResultSettings):
    """What `recon report` is told."""

    folder: Annotated[Path, Option("Folder of results, as in results/clip, or of a batch.", argument="DIR")]


def run_page(settings: PageSettings, progress: Progress = silent) -> Path:
    """`recon report`: the page of a result, in its folder; an earlier one is replaced. video: what is behind the
    pictures, plain without one; the others: see `run_overlay`. Raises InputError, with every problem."""
    page = settings.folder / PAGE
    motion, number, _ = result_and_video(settings, lambda: require_own_page(page))
    progress("pictures", 0.1)
    stills = _stills(motion, settings.video, settings.first_frame, number)
    progress("figures", 0.3)
    html = clip_page(
        motion, stills, None if settings.video is None else settings.video.name, _files(settings.folder), number
    )
    with staged_file(page) as staged:
        staged.write_text(html, encoding="utf-8")
    return page


def _stills(motion: Motion, video: Path | None, first_frame: int, number: int) -> list[tuple[str, str]]:
    overlay = overlay_of(motion, number=number)
    rows = rows_to_show(overlay, STILLS)
    if not len(rows):
        return []
    pictures = None if video is None else pictures_of(video, motion, rows, first_frame)
    tiles = draw_tiles(overlay, rows, pictures)
    return [(jpeg(tile), f"frame {overlay.frames[t]}") for tile, t in zip(tiles, rows, strict=True)]


def _files(folder: Path) -> list[str]:
    names = [*BESIDE, *(sorted(read_manifest(folder).files) if (folder / MANIFEST).is_file() else ())]
    return [name for name in names if (folder / name).is_file()]


def is_batch(folder: Path) -> bool:
    """Whether a folder holds results of many clips, rather than of one."""
    return (folder / SUMMARY).is_file() and not (folder / REPORT).is_file()


def run_batch_pages(out: Path, progress: Progress = silent) -> tuple[Path, dict[str, str]]:
    """`recon report` on the folder of a batch: the page of every result in it, in parallel, and the summary's page; its
    path, and what went wrong by clip."""
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
