"""The command `recon batch`: how the work goes, a line a clip, and what became of all."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from rich.console import Console
from rich.table import Table
from rich.text import Text

from recon.api.batch import ClipPlan, OnEvent, Problems, Summary, input_problems, plan_batch, repeated, run_batch
from recon.api.batch_inputs import find_clips
from recon.api.settings import OF_ANY_CLIP, FitSettings
from recon.base.errors import raise_problems
from recon.base.numbers import counted
from recon.base.parallel import Event
from recon.base.settings import Count, Integer, OneOrMore, Option, Settings
from recon.check.verdict import NOTHING_AGAINST
from recon.cli.answers import Answer, progress_bar, say, stop, table_of, terminal
from recon.cli.commands import OptionsOf
from recon.show.console import STYLES
from recon.show.page.own_page import SUMMARY_PAGE

CANNOT = "cannot be fitted"
NAMED = 3
"""Clips with the same problem are named up to this number."""
_STYLES = {"unsolved": "red", "failed": "red", "pending": "yellow"}
"""Styles of the statuses; what is done has a verdict."""
_COMMON, _WORK = "Settings of every clip", "How the work is done"
_OfFits = Annotated[dict[str, Any], OptionsOf(FitSettings, OF_ANY_CLIP, _COMMON)]


class _BatchSettings(Settings):
    """The settings of `recon batch` beside those of every clip's fit."""

    inputs: Annotated[OneOrMore[str], Option(argument="INPUT")]
    """Keypoint files, quoted patterns as in 'clips/*.csv', folders, also projects of DeepLabCut and Anipose, or
    manifests: CSV tables with a column keypoints, and one for each setting that differs."""
    out: Path
    """Folder for the results: one folder a clip, and summary.csv."""
    config: Annotated[Path | None, Option(panel=_COMMON)] = None
    """config.toml of a fit; options here overrule it."""
    cameras_by: Annotated[str, Option(metavar="auto|none|PATTERN", panel=_COMMON)] = "auto"
    """Which files are one clip. auto: names that differ by a camera's only; none: each; or a regular expression for the
    camera's name in a file's, as in '-cam([A-Z])'."""
    recursive: Annotated[bool, Option(panel=_COMMON)] = False
    """Read the folders within a folder, too."""
    jobs: Annotated[Count | None, Option(panel=_WORK)] = None
    """Clips at a time. (default: one for each core)"""
    scheduler: Annotated[str | None, Option(panel=_WORK)] = None
    """A Dask cluster instead, as in tcp://host:8786."""
    retries: Annotated[Annotated[Integer, Field(ge=0)], Option(panel=_WORK)] = 1
    """Tries more where a worker died."""
    overwrite: Annotated[bool, Option(panel=_WORK)] = False
    """Fit everything again, and replace results of other fits that nobody changed."""
    dry_run: Annotated[bool, Option(panel=_WORK)] = False
    """Only look: what would be done, and what inputs lack."""
    strict: Annotated[bool, Option(panel=_WORK)] = False
    """Exit code 1 if any clip failed or is unsolved."""


def batch(settings: _BatchSettings, given: _OfFits, console: Console) -> Answer:
    """Reconstruct many clips in parallel. The same command again goes on where it was stopped.

    A clip is done when its folder holds results of the same keypoints, camera and other files (by their content), the
    same settings and the same version of recon. Where one of these has changed it is fitted again and its results are
    replaced. Folders with results that are not of a batch, or of another clip, are never touched without --overwrite.

    Example: recon batch 'clips/*.csv' --camera camera.toml --fps 120 --out results

    Exit code 0: done, whatever became of single clips (see --strict). 2: the input as a whole cannot be used; nothing
    was done. 130: stopped with Ctrl-C; what is done is kept.
    """
    clips, notes = find_clips(
        settings.inputs, given, settings.config, settings.cameras_by, recursive=settings.recursive
    )
    for note in notes:
        say(console, note, "yellow")
    plan = plan_batch(clips, settings.out, settings.overwrite)
    if settings.dry_run:
        return _only_looked(plan, input_problems(clips), settings.strict)
    shared = repeated(input_problems(clips, shared_only=True))  # be it each with a file of its own
    raise_problems(problem for problem, places in shared if len(places) == len(clips))
    left = sum(planned.action != "done" for planned in plan)
    if left < len(plan):
        are = "clip is" if len(plan) == 1 else "clips are"
        console.print(f"{len(plan) - left} of {len(plan)} {are} done already.")
    how = settings.jobs, settings.retries, settings.scheduler
    answer = shown_batch(console, left, lambda tell: run_batch(plan, settings.out, *how, tell), PAGE_OF_A_CLIP)
    failed = any(row["status"] in ("failed", "unsolved") for row in answer.data["clips"])
    return replace(answer, code=int(settings.strict and failed))


PAGE_OF_A_CLIP = "recon report {out}/CLIP, a page of one clip; "


def shown_batch(console: Console, left: int, work: Callable[[OnEvent], Summary], of_a_clip: str = "") -> Answer:
    """Do what tells of its events, and say how it goes, a line a clip and a bar on a terminal; how it went. left: how
    many clips there are to do. of_a_clip: the command that is next for one of them, with {out} for the folder."""
    summaries: list[Summary] = []
    began, ended = time.monotonic(), 0
    # Trouble is said even where nothing else is.
    errors = terminal(stderr=True, soft_wrap=True) if console.quiet or not console.is_terminal else console
    try:
        with progress_bar(console) as progress:

            def tell(event: Event, so_far: Summary) -> None:
                nonlocal ended
                summaries[:] = [so_far]
                if event.kind == "progress":
                    progress(f"{ended}/{left} {event.name}: {event.stage}", ended / max(left, 1))
                    return
                ended, row = ended + 1, so_far.rows[event.name]
                where = errors if row["status"] == "failed" else console
                say(where, Text(f"[{ended}/{left}] ").append_text(_row_text(row)))

            summary = work(tell)
    except KeyboardInterrupt:
        counts = summaries[0].counts() if summaries else {}
        said = ", ".join(f"{n} {status}" for status, n in counts.items()) or "nothing was done"
        stop(f"Stopped: {said}. What is done is kept: the same command again goes on from here.")
    counts = summary.counts()
    parts = [Text(f"{n} {level}", STYLES[level]) for level, n in reversed(summary.verdicts().items())]
    parts += [Text(f"{n} {status}", style) for status, n in counts.items() if (style := _STYLES.get(status))]
    seconds = time.monotonic() - began
    said = Text.assemble(Text(", ").join(parts), f" in {seconds:.0f} s. Summary: {summary.path}")
    out, lines = summary.path.parent, [said, f"Open {summary.path.with_name(SUMMARY_PAGE)} in a browser."]
    if summary.verdicts():
        lines.append(f"Next: {of_a_clip.format(out=out)}recon compare {out} --out FOLDER, all of them.")
    return Answer({"summary": summary.path, "counts": counts, "clips": [*summary.rows.values()]}, lines)


def _only_looked(plan: Sequence[ClipPlan], problems: Sequence[Problems], strict: bool) -> Answer:
    """What would be done with each clip, and what inputs lack."""
    rows: list[dict[str, Any]] = [
        {
            "clip": planned.clip.name,
            "keypoints": planned.clip.settings.keypoints_text,
            "cameras": list(planned.clip.settings.camera_name or ()),
            "camera": planned.clip.settings.camera_text,
            "fps": planned.clip.settings.fps,
            "out": str(planned.out),
            "action": planned.action if planned.action == "done" or not found else CANNOT,
            "reason": planned.reason,
            "problems": [str(problem) for problem in found],
        }
        for planned, found in zip(plan, problems, strict=True)
    ]
    cells = []
    for row in rows:
        what = row["action"] + f" ({row['reason']})" * bool(row["reason"])
        camera = ", ".join(row["cameras"] or [Path(row["camera"]).name or "--hfov-deg"])
        fps = "the file's" if row["fps"] is None else f"{row['fps']:g}"
        cells.append((row["clip"], camera, fps, row["out"], what))
    lines: list[str | Text | Table] = [table_of("clip", "camera", "fps", "out", "what", rows=cells)]
    if len(rows) > 1 and len({(row["camera"], row["fps"]) for row in rows}) == 1:
        other = "Where they differ, give a CSV table with columns keypoints, camera and fps instead."
        lines.append(f"All clips have the same --camera and --fps. {other}")
    for problem, places in repeated(problems):
        names = ", ".join(rows[place]["clip"] for place in places[:NAMED])
        more = "" if len(places) <= NAMED else f" and {len(places) - NAMED} more clips"
        lines.append(Text.assemble((f"{names}{more}: ", "bold red"), str(problem)))
    of = Counter(row["action"] for row in rows)
    bad = f", {of[CANNOT]} that {CANNOT}" if of[CANNOT] else ""
    said = f"{of['new']} new, {of['refit']} to fit again, {of['done']} done{bad}"
    lines.append(f"{counted(len(rows), 'clip')}: {said}")
    return Answer({"clips": rows}, lines, code=int(strict and any(problems)))


def _row_text(row: Mapping[str, Any]) -> Text:
    """One clip's end in a line."""
    level = row["verdict"] or ""
    text = Text.assemble((row["status"], _STYLES.get(row["status"], "")), f"  {row['clip']}")
    if row["error"]:
        return text.append(f": {row['error']}")
    pose = "" if row["pose_mm"] is None else f", pose off by {row['pose_mm']:.0f} mm"
    why = "" if row["reason"] in (None, NOTHING_AGAINST) else f": {row['reason']}"
    text.append("  ").append(level, STYLES.get(level, ""))
    return text.append(f"{pose}, {row['frames']} frames, {row['seconds']:.1f} s{why}")
