"""The command `recon batch`: print the progress, one line per clip, and a summary."""

from __future__ import annotations

import shlex
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field
from rich.console import Console
from rich.table import Table
from rich.text import Text

from recon.api.settings import OF_ANY_CLIP, FitSettings
from recon.base.errors import raise_problems
from recon.base.numbers import counted, quantity
from recon.base.parallel import Event
from recon.base.settings import Count, Integer, OneOrMore, Option, Settings
from recon.cli.answers import Answer, progress_bar, say, stop, table_of, terminal
from recon.cli.commands import OptionsOf
from recon.fit.result import LEVELS
from recon.show.console import STYLES
from recon.show.page.own_page import SUMMARY_PAGE

if TYPE_CHECKING:
    from recon.api.batch import ClipPlan, OnEvent, Problems, Summary

CANNOT_FIT = "cannot be fitted"
SOLVING_FRACTION = 0.5
"""Fraction of a clip's time in which its fit reports progress. Checks and files take the rest."""
MAX_LISTED = 20
"""Maximum number of clips in the table that is printed at the end."""
MAX_NAMED = 3
"""Maximum number of clips with the same problem that are listed by name."""
_STYLES = {"unsolved": "red", "failed": "red", "pending": "yellow"}
"""Styles of the statuses. A clip that is done has the style of its verdict."""
_COMMON, _WORK = "Settings of every clip", "Execution"
_FitOptions = Annotated[dict[str, Any], OptionsOf(FitSettings, OF_ANY_CLIP, _COMMON)]


class _BatchSettings(Settings):
    """Settings of `recon batch` in addition to the settings of a fit."""

    inputs: Annotated[OneOrMore[str], Option(argument="INPUT")]
    """Keypoint files, quoted patterns such as 'clips/*.csv', folders, projects of DeepLabCut and Anipose, or manifests:
    CSV tables with a column keypoints, and one column for each setting that differs between clips.
    """
    out: Path
    """Folder for the results: one folder per clip, and summary.csv."""
    config: Annotated[Path | None, Option(panel=_COMMON)] = None
    """config.toml of an earlier fit. Options given here override it."""
    cameras_by: Annotated[str, Option(metavar="auto|none|PATTERN", panel=_COMMON)] = "auto"
    """How to join the files of one clip from several cameras: auto by file names that differ only in the camera's
    name, none to make every file a clip, or a regular expression for the camera's name, such as '-cam([A-Z])'.
    """
    recursive: Annotated[bool, Option(panel=_COMMON)] = False
    """Read subfolders too."""
    jobs: Annotated[Count | None, Option(panel=_WORK)] = None
    """Number of clips to fit at the same time. (default: one per core)"""
    scheduler: Annotated[str | None, Option(panel=_WORK)] = None
    """Dask cluster to use instead of this machine, such as tcp://host:8786."""
    retries: Annotated[Annotated[Integer, Field(ge=0)], Option(panel=_WORK)] = 1
    """Number of further attempts at a clip after its worker died."""
    overwrite: Annotated[bool, Option(panel=_WORK)] = False
    """Fit everything again, and replace results of other fits unless they were changed by hand."""
    dry_run: Annotated[bool, Option(panel=_WORK)] = False
    """Fit nothing: list what would be done, and any problems with the inputs."""
    strict: Annotated[bool, Option(panel=_WORK)] = False
    """Exit with code 1 if any clip failed or is unsolved."""


def batch(settings: _BatchSettings, options: _FitOptions, console: Console) -> Answer:
    """Reconstruct many clips in parallel. Run the same command again to continue after an interruption.

    A clip is done when its folder holds results from the same keypoints, camera and other files (compared by content),
    the same settings and the same version of recon. If one of these has changed, the clip is fitted again and its
    results are replaced. Folders with results of another clip, or not from a batch, are never touched without
    --overwrite.

    Example: recon batch 'clips/*.csv' --camera camera.toml --fps 120 --out results

    Exit code 0: finished, even if some clips failed (see --strict). 2: the input as a whole cannot be used; nothing
    was done. 130: stopped with Ctrl-C; finished clips are kept.
    """
    from recon.api.batch import distinct_problems, input_problems, plan_batch, run_batch
    from recon.api.batch_inputs import find_clips

    clips, notes = find_clips(
        settings.inputs, options, settings.config, settings.cameras_by, recursive=settings.recursive
    )
    for note in notes:
        say(console, note, "yellow")
    plan = plan_batch(clips, settings.out, settings.overwrite)
    if settings.dry_run:
        return _dry_run_answer(plan, input_problems(clips), settings.strict)
    # a problem that all clips share ends the batch, even if each clip has a file of its own
    shared = distinct_problems(input_problems(clips, shared_only=True))
    raise_problems(problem for problem, clip_indices in shared if len(clip_indices) == len(clips))
    left = sum(planned.action != "done" for planned in plan)
    if left < len(plan):
        clips_are = "clip is" if len(plan) == 1 else "clips are"
        console.print(f"{len(plan) - left} of {len(plan)} {clips_are} done already.")
    work_options = settings.jobs, settings.retries, settings.scheduler
    answer = run_on_console(
        console, left, lambda on_event: run_batch(plan, settings.out, *work_options, on_event), PAGE_OF_A_CLIP
    )
    failed = any(row["status"] in ("failed", "unsolved") for row in answer.data["clips"])
    return replace(answer, code=int(settings.strict and failed))


PAGE_OF_A_CLIP = "recon report {out}/CLIP (the page of one clip), or "


def run_on_console(console: Console, left: int, work: Callable[[OnEvent], Summary], clip_command: str = "") -> Answer:
    """Run a batch, print one line per clip and a progress bar on a terminal, and return the answer.

    Parameters
    ----------
    console
        Console to print to.
    left
        Number of clips that are not done yet.
    work
        Function that does the work and calls its argument at each event.
    clip_command
        Command to suggest for one of the clips, with {out} for the folder.
    """
    summaries: list[Summary] = []
    underway: dict[str, float] = {}
    began, ended = time.monotonic(), 0
    # Failures are printed even with --quiet.
    errors = terminal(stderr=True, soft_wrap=True) if console.quiet or not console.is_terminal else console
    try:
        with progress_bar(console) as progress:

            def show_event(event: Event, so_far: Summary) -> None:
                nonlocal ended
                summaries[:] = [so_far]
                if event.kind == "progress":
                    underway[event.name] = SOLVING_FRACTION * event.share
                    done = ended + sum(underway.values())
                    progress(f"{ended}/{left} {event.name}: {event.stage}", done / max(left, 1))
                    return
                underway.pop(event.name, None)
                ended, row = ended + 1, so_far.rows[event.name]
                target = errors if row["status"] == "failed" else console
                say(target, Text(f"[{ended}/{left}] ").append_text(_row_text(row)))

            summary = work(show_event)
    except KeyboardInterrupt:
        counts = summaries[0].counts() if summaries else {}
        status_text = ", ".join(f"{n} {status}" for status, n in counts.items()) or "nothing was done"
        stop(f"Stopped: {status_text}. Finished clips are kept: run the same command again to continue.")
    counts = summary.counts()
    parts = [Text(f'{n} "{level}"', STYLES[level]) for level, n in reversed(summary.verdicts().items())]
    parts += [Text(f"{n} {status}", style) for status, n in counts.items() if (style := _STYLES.get(status))]
    seconds = time.monotonic() - began
    status_text = Text.assemble(
        f"{counted(len(summary.rows), 'clip')}: ",
        Text(", ").join(parts),
        f", in {quantity(seconds, 0, 's')}. Summary: {summary.path}",
    )
    out = shlex.quote(str(summary.path.parent))
    lines = [*_table(summary), status_text, f"Open {summary.path.with_name(SUMMARY_PAGE)} in a browser."]
    if summary.verdicts():
        lines.append(f"Next: {clip_command.format(out=out)}recon compare {out} --out FOLDER (all clips).")
    return Answer({"summary": summary.path, "counts": counts, "clips": [*summary.rows.values()]}, lines)


def _table(summary: Summary) -> list[Table | str]:
    """Return a table of the clips, with clips that need attention at the top, or nothing for a single clip."""
    rank = {level: order for order, level in enumerate(LEVELS)}
    rows = sorted(summary.rows.values(), key=lambda row: (rank.get(row["verdict"] or "", -1), row["clip"]))
    if len(rows) < 2:
        return []
    cells = []
    for row in rows[:MAX_LISTED]:
        state = row["verdict"] if row["status"].startswith("done") and row["verdict"] else row["status"]
        pose = "" if row["pose_mm"] is None else f"{float(row['pose_mm']):.0f}"
        speed = "" if row["mean_speed_m_s"] is None else f"{float(row['mean_speed_m_s']):.1f}"
        frames = "" if row["frames"] is None else f"{float(row['frames']):.0f}"
        styled = Text(state, STYLES.get(state, _STYLES.get(state, "")))
        cells.append((row["clip"], styled, frames, pose, speed))
    table = table_of("clip", "verdict", numbers=("frames", "pose error, mm", "mean speed, m/s"), rows=cells)
    notes = [f"{counted(len(rows) - MAX_LISTED, 'more clip')}: see the summary."] if len(rows) > MAX_LISTED else []
    return [table, *notes]


def _dry_run_answer(plan: Sequence[ClipPlan], problems: Sequence[Problems], strict: bool) -> Answer:
    """Return the actions planned for each clip, and the problems with the inputs.

    If `strict` is true, the exit code is 1 if any clip has problems.
    """
    from recon.api.batch import distinct_problems

    rows: list[dict[str, Any]] = [
        {
            "clip": planned.clip.name,
            "keypoints": planned.clip.settings.keypoints_text,
            "cameras": list(planned.clip.settings.camera_name or ()),
            "camera": planned.clip.settings.camera_text,
            "fps": planned.clip.settings.fps,
            "out": str(planned.out),
            "action": planned.action if planned.action == "done" or not clip_problems else CANNOT_FIT,
            "reason": planned.reason,
            "problems": [str(problem) for problem in clip_problems],
        }
        for planned, clip_problems in zip(plan, problems, strict=True)
    ]
    cells = []
    for row in rows:
        action_text = row["action"] + f" ({row['reason']})" * bool(row["reason"])
        camera = ", ".join(row["cameras"] or [Path(row["camera"]).name or "--hfov-deg"])
        fps = "the file's" if row["fps"] is None else f"{row['fps']:g}"
        cells.append((row["clip"], camera, fps, row["out"], action_text))
    lines: list[str | Text | Table] = [table_of("clip", "camera", "fps", "out", "action", rows=cells)]
    if len(rows) > 1 and len({(row["camera"], row["fps"]) for row in rows}) == 1:
        advice = "If they differ, give a CSV table with columns keypoints, camera and fps instead."
        lines.append(f"All clips have the same --camera and --fps. {advice}")
    for problem, clip_indices in distinct_problems(problems):
        names = ", ".join(rows[index]["clip"] for index in clip_indices[:MAX_NAMED])
        more_clips = "" if len(clip_indices) <= MAX_NAMED else f" and {len(clip_indices) - MAX_NAMED} more clips"
        lines.append(Text.assemble((f"{names}{more_clips}: ", "bold red"), str(problem)))
    counts = Counter(row["action"] for row in rows)
    bad = f", {counts[CANNOT_FIT]} that {CANNOT_FIT}" if counts[CANNOT_FIT] else ""
    count_text = f"{counts['new']} new, {counts['refit']} to fit again, {counts['done']} done{bad}"
    lines.append(f"{counted(len(rows), 'clip')}: {count_text}")
    return Answer({"clips": rows}, lines, code=int(strict and any(problems)))


def _row_text(row: Mapping[str, Any]) -> Text:
    from recon.check.verdict import reason_in_list

    level = row["verdict"] or ""
    text = Text.assemble((row["status"], _STYLES.get(row["status"], "")), f"  {row['clip']}")
    if row["error"]:
        return text.append(f": {row['error']}")
    pose = "" if row["pose_mm"] is None else f", pose error {quantity(row['pose_mm'], 0, 'mm')}"
    reason = f": {listed}" if (listed := reason_in_list(row["reason"], row["reason_code"])) else ""
    text.append("  ").append(level, STYLES.get(level, ""))
    return text.append(f"{pose}, {row['frames']} frames, {quantity(row['seconds'], 1, 's')}{reason}")
