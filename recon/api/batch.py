"""Fit many clips with `find_clips`, `plan_batch` and `run_batch`, each of which takes the result of the previous one.

The batch's folder holds three files: `batch.jsonl` records the inputs that each clip's results were made from,
`summary.csv` has one row per clip and is rewritten as clips finish, and `summary.html` is made from `summary.csv`.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

from pydantic import create_model
from threadpoolctl import threadpool_limits

from recon.api.batch_inputs import Clip
from recon.api.clip_cameras import read_clip_cameras
from recon.api.clip_inputs import SharedInputs, prepare, read_model
from recon.api.clip_results import (
    Record,
    digests,
    fit_into,
    identity,
    output_files,
    output_of,
    require_same_inputs,
    setting_in_folder,
    with_corrections_in,
)
from recon.api.settings import FitSettings
from recon.base.arrays import Brief
from recon.base.documents import validated
from recon.base.errors import InputError, Problem, collect_problems, problems_of
from recon.base.files import MANIFEST, relative_path
from recon.base.locks import sole_writer
from recon.base.numbers import counted
from recon.base.outputs import Output
from recon.base.package import version
from recon.base.parallel import STARTING, Event, EventCallback, run_tasks, run_tasks_on_cluster
from recon.base.progress import Progress
from recon.base.tables import guarded, unguarded
from recon.fit.result import LEVELS
from recon.io.common import text_rows
from recon.show.page.own_page import SUMMARY, SUMMARY_PAGE
from recon.show.report import is_unsolved, warnings

BATCH = "batch"
"""Command under which the manifest lists the batch's own files, such as summary.csv."""
RECORD, CRASH_LOG = "batch.jsonl", "crash.log"
Problems = tuple[Problem, ...]
RESULTS = (
    *("verdict", "reason", "reason_code"),
    *(f"{error}{end}" for error in ("pose_mm", "position_m") for end in ("", "_low", "_high")),
    *("frames", "frames_with_pose", "warnings", "outliers", "corrected", "mean_reprojection_px"),
    *("mean_speed_m_s", "peak_speed_m_s", "size"),
)
COLUMNS = (
    *("clip", "keypoints", "cameras", "out", "status", "error"),
    *RESULTS,
    *("seconds", "attempts", "settings_hash", "inputs_hash"),
)
_TEXTS = ("keypoints", "out", "error", "verdict", "reason", "reason_code", "settings_hash", "inputs_hash")
_CELLS: dict[str, Any] = {name: (str | None if name in _TEXTS else float | None, None) for name in COLUMNS}
_CELLS |= {"clip": (str, ...), "status": (str, ...)}
_Row = create_model("_Row", **_CELLS)
"""Row of summary.csv, with the types of its cells."""
STATUSES = ("done", "done earlier", "unsolved", "failed", "pending")
"""Possible statuses of a clip.

An "unsolved" clip was fitted, but no frame has a pose. A "pending" clip was not tried, because the batch was
interrupted.
"""
WRITE_EVERY_S = 0.5
DYING_S = 5.0
"""Time (s) for which a process may still use a clip's folder after its batch was killed."""


OnEvent = Callable[[Event, "Summary"], None]
"""Function called at each event of a clip, with the current summary."""


@dataclass(frozen=True, repr=False)
class ClipPlan(Brief):
    """Planned action of a batch for one clip, and the reason."""

    clip: Clip
    out: Path
    action: Literal["new", "refit", "done"]
    reason: str
    identity: Mapping[str, Any]
    """Input digests, settings and version that determine the clip's results."""
    row: Mapping[str, Any] | None = None
    """Row of summary.csv, if the clip is already done."""


def plan_batch(clips: Sequence[Clip], out: Path, overwrite: bool = False) -> list[ClipPlan]:
    """Plan what a batch does with each clip, whose results go into `out / clip.name`.

    A clip is done if its folder holds results from the same input files, settings and version. The clip is fitted again
    if a batch fitted the same keypoints, or some of the clip's cameras, with other settings.

    Raises
    ------
    InputError
        If a folder holds other results and `overwrite` is false. Also if a fit would replace files that no fit wrote,
        or that were changed after the fit, even if `overwrite` is true.
    """
    summary_output(out).require((SUMMARY, SUMMARY_PAGE))
    record = Record(out / RECORD)
    return [*collect_problems(*(partial(_planned, clip, out / clip.name, record, overwrite) for clip in clips))]


def _planned(clip: Clip, out: Path, record: Record, overwrite: bool) -> ClipPlan:
    clip = replace(clip, settings=with_corrections_in(out, clip.settings))
    made_from, row = identity(clip.settings), record.rows.get(clip.name)
    names, output = output_files(clip.settings, out), output_of(clip.settings, out, overwrite=True)
    if not any(os.path.lexists(out / name) for name in names):
        return ClipPlan(clip, out, "new", "", made_from)
    if overwrite:
        output.require(names)
        return ClipPlan(clip, out, "refit", "--overwrite", made_from)
    expected = "a folder without results or with those of an earlier batch of this clip, or --overwrite"
    reason, changed = record.why_redo(clip.name, made_from, out)
    if row is None or (out / MANIFEST in changed and (out / MANIFEST).exists()):
        raise InputError(Problem(out, "folder", "results that no batch has written", expected))
    earlier_keypoints = setting_in_folder(out.parent, "keypoints", row.get("keypoints", ()))
    same_names = {*earlier_keypoints} & {*map(str, clip.settings.keypoints)}
    if not same_names and not _keypoint_digests(row["identity"]) & _keypoint_digests(made_from):
        raise InputError(Problem(out, "folder", f"results of {', '.join(earlier_keypoints)}", expected))
    if reason or "row" not in row:
        output.require(names)
        return ClipPlan(clip, out, "refit", reason, made_from)
    validated(_Row, {"clip": clip.name, **row["row"]}, f"{record.path}, row of {clip.name}")
    return ClipPlan(clip, out, "done", "", made_from, row["row"])


def _keypoint_digests(made_from: Mapping[str, Any]) -> set[str]:
    return {sha256 for role, sha256 in made_from["inputs"].items() if role.split()[0] == "keypoints" and sha256}


def input_problems(clips: Sequence[Clip], shared_only: bool = False) -> list[Problems]:
    """Return, for each clip, all problems with its inputs that its fit would raise before solving.

    If `shared_only` is true, only problems with cameras, skeletons, subjects and priors are returned.
    """
    model_of, cameras_of = cache(read_model), cache(read_clip_cameras)

    def read_once(settings: FitSettings) -> SharedInputs:
        """Return the body, the prior and the cameras of a clip.

        Inputs that several clips share are read only once.
        """
        numbers = [str(i) for i, _ in enumerate(settings.keypoints)]
        numbered = replace(settings, keypoints=numbers, individual=None, frames=None)
        # If no cameras are named, the names of the keypoint files decide which cameras are used.
        named = numbered if settings.camera_name else replace(numbered, keypoints=settings.keypoints)
        model, cameras = collect_problems(lambda: model_of(numbered), lambda: cameras_of(named))
        return *model, cameras

    check = read_once if shared_only else partial(prepare, read_shared=read_once)
    return [problems_of(partial(check, clip.settings)) for clip in clips]


def distinct_problems(problems_by_clip: Sequence[Problems]) -> list[tuple[Problem, tuple[int, ...]]]:
    """Return each distinct problem once, with the indices of the clips that have it.

    Problems that differ only in the file name count as one, which names the first file and the number of others.
    """
    indices_by_content: dict[tuple[str, str, str], list[tuple[int, Problem]]] = {}
    for index, problems in enumerate(problems_by_clip):
        for problem in problems:
            indices_by_content.setdefault((problem.field, problem.found, problem.expected), []).append((index, problem))
    merged = []
    for occurrences in indices_by_content.values():
        file, *more_files = dict.fromkeys(str(problem.file) for _, problem in occurrences)
        named = f"{file} and {counted(len(more_files), 'more file')}" if more_files else file
        merged.append((replace(occurrences[0][1], file=named), tuple(dict.fromkeys(index for index, _ in occurrences))))
    return merged


def run_batch(
    plan: Sequence[ClipPlan],
    out: Path,
    jobs: int | None = None,
    retries: int = 1,
    scheduler: str | None = None,
    on_event: OnEvent = lambda *_: None,
) -> Summary:
    """Fit every clip that is not done into its own folder, and keep `out / summary.csv` up to date.

    A clip that fails does not stop the others. `summary.html` is written last. A KeyboardInterrupt stops the running
    fits and is raised again after the summary has been written.

    Parameters
    ----------
    plan
        The result of `plan_batch`.
    out
        Folder of the batch.
    jobs
        Number of processes on this machine; by default one per core.
    retries
        Number of further attempts at a clip whose process died or crashed.
    scheduler
        Address of a Dask cluster to use instead of this machine.
    on_event
        Called at each event of a clip.

    Raises
    ------
    InputError
        If the cluster cannot be reached or is lost, or another batch is writing to `out`.
    """
    todo = {planned.clip.name: planned for planned in plan if planned.action != "done"}

    def note(event: Event, summary: Summary) -> None:
        planned, outcome = todo[event.name], event.outcome
        keypoints = planned.clip.settings.keypoints_from(out)
        log = Output(planned.out, BATCH, overwrite=True)
        if event.stage == STARTING:
            record.note(event.name, planned.identity, keypoints=keypoints)
        elif event.kind == "ended" and outcome["status"] != "failed":
            with suppress(OSError, InputError):
                log.remove(CRASH_LOG)
            row = {name: outcome[name] for name in COLUMNS if name in outcome and name != "attempts"}
            record.note(event.name, outcome["identity"], keypoints=keypoints, files=outcome["files"], row=row)
        elif "log" in outcome:
            with suppress(OSError, InputError):
                log.write(CRASH_LOG, f"{outcome['error']}\n\n{outcome['log']}")
        on_event(event, summary)

    with sole_writer(out):
        summary_output(out).require((SUMMARY, SUMMARY_PAGE))
        record = Record(out / RECORD)
        record.tidy()
        tasks = [(name, replace(planned, out=planned.out.absolute())) for name, planned in todo.items()]
        run = partial(run_tasks_on_cluster, scheduler) if scheduler else partial(run_tasks, jobs=jobs)
        return run_plan(plan, out, partial(run, fit_planned, tasks, retries=retries), note)


def run_plan(plan: Sequence[ClipPlan], out: Path, run: Callable[[EventCallback], None], on_event: OnEvent) -> Summary:
    """Run the tasks of a plan by calling `run` with a callback, and keep summary.csv up to date."""
    summary = Summary(plan, out)

    def update(event: Event) -> None:
        if event.kind == "ended":
            summary.end(event.name, event.outcome)
        on_event(event, summary)
        if event.kind == "ended":  # after on_event, which records the outcome
            summary.write_if_due()

    summary.write()
    try:
        run(update)
    finally:
        summary.write()
        write_summary_page(out)
    return summary


def fit_planned(planned: ClipPlan, progress: Progress) -> dict[str, Any]:
    """Fit one clip and write its results, in a process that does nothing else at the same time.

    Returns
    -------
    dict
        The clip's cells of the summary, with three further entries: `files` has the digest of the clip's manifest, and
        `identity` and `inputs_hash` identify the inputs at the time of the fit, which may have changed since the batch
        was planned. If the worker has another version of recon, the result has only `status` ("failed") and `error`.
    """
    own_version, planned_version = version(), planned.identity["version"]
    if own_version != planned_version:
        return {
            "status": "failed",
            "error": f"the worker has recon {own_version}, not {planned_version} like the batch: install that version",
        }
    with sole_writer(planned.out, DYING_S), threadpool_limits(1):
        made_from = identity(planned.clip.settings)
        report = fit_into(planned.out, planned.clip.settings, progress)
        require_same_inputs(planned.clip.settings, made_from["inputs"])
        files = digests([planned.out / MANIFEST], planned.out)
    status = "unsolved" if is_unsolved(report) else "done"
    inputs = {"identity": made_from, "inputs_hash": _hash(made_from["inputs"])}
    return {"status": status, **results_of(report), "files": files, **inputs}


def results_of(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return the cells of a summary row that come from the report of a fit (columns `RESULTS`).

    Speeds are those of the root, m/s, from the smoothed path if the report has one. `warnings` is the number of
    warnings. `size` is the ratio of the animal's lengths to the skeleton's; None unless the trajectory method was used.
    """
    summary, path, verdict = report["summary"], report["root_path"], report["verdict"] or {}
    speeds = path["smoothed"] or path["exact"]
    errors = {}
    for name, field, unit in (("pose_mm", "pose_m", 1000.0), ("position_m", "position_m", 1.0)):
        error = verdict.get(field)
        for end, key in (("", "expected"), ("_low", "low"), ("_high", "high")):
            errors[name + end] = None if error is None else float(f"{unit * error[key]:.4g}")
    return {
        "verdict": verdict.get("level"),
        "reason": verdict.get("reason"),
        "reason_code": verdict.get("reason_code"),
        **errors,
        **{name: summary[name] for name in ("frames", "frames_with_pose", "outliers", "corrected")},
        "warnings": len(warnings(report)),
        "mean_reprojection_px": summary["reprojection_px"]["mean"],
        **{name: speeds[name] for name in ("mean_speed_m_s", "peak_speed_m_s")},
        "size": report["size"]["factor"] if report["method"] == "trajectory" else None,
    }


def summary_output(out: Path) -> Output:
    """Return the output through which a batch may replace its own summary.csv and summary.html."""
    return Output(out, BATCH, overwrite=True)


class Summary:
    """Summary table of a batch, with one row for each clip, and the file summary.csv to which it is written.

    Clips that an earlier run finished are included from the start.
    """

    def __init__(self, plan: Sequence[ClipPlan], out: Path) -> None:
        self.path = out / SUMMARY
        self._output = summary_output(out)
        self.rows: dict[str, dict[str, Any]] = {planned.clip.name: _row(planned, out) for planned in plan}
        self._written_s = -WRITE_EVERY_S

    def end(self, clip: str, outcome: Mapping[str, Any]) -> None:
        """Add the outcome of a clip to its row."""
        self.rows[clip] |= {column: outcome[column] for column in COLUMNS if column in outcome}

    def write_if_due(self) -> None:
        """Write summary.csv, unless it was written in the last `WRITE_EVERY_S` or another program holds it open."""
        if time.monotonic() - self._written_s >= WRITE_EVERY_S:
            with suppress(PermissionError):
                self.write()

    def counts(self) -> dict[str, int]:
        """Return the number of clips with each status that occurs, in the order of `STATUSES`."""
        count = Counter(row["status"] for row in self.rows.values())
        return {status: count[status] for status in STATUSES if count[status]}

    def verdicts(self) -> dict[str, int]:
        """Return the number of fitted clips with each verdict that occurs, in the order of `LEVELS`."""
        count = Counter(row["verdict"] for row in self.rows.values() if row["status"].startswith("done"))
        return {level: count[level] for level in LEVELS if count[level]}

    def write(self) -> None:
        """Write summary.csv, with the clips that need attention at the top."""
        with self._output.staged(adds=True) as folder, (folder / SUMMARY).open("w", encoding="utf-8", newline="") as f:
            writer = csv.DictWriter(f, COLUMNS, lineterminator="\n")
            writer.writeheader()
            rank = {level: number for number, level in enumerate(LEVELS)}
            for row in sorted(self.rows.values(), key=lambda row: rank.get(row["verdict"], -1)):
                writer.writerow({name: guarded(cell) for name, cell in row.items()})
        self._written_s = time.monotonic()


def write_summary_page(out: Path) -> Path:
    """Write summary.html from the summary.csv in the same folder.

    Raises
    ------
    InputError
        If summary.csv is not the summary of a batch.
    """
    from recon.show.page.pages import batch_page  # imports matplotlib, which the fitting processes do not need

    summary_output(out).write(SUMMARY_PAGE, batch_page(out, read_rows(out / SUMMARY)))
    return out / SUMMARY_PAGE


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a summary.csv, undoing the escapes that `Summary.write` put before formulas.

    Raises
    ------
    InputError
        If the file is not the summary of a batch.
    """
    (_, header), *rows = [*text_rows(path)] or [(1, [])]
    texts = ([*map(unguarded, cells)] for _, cells in rows)
    named_rows = [{name: x for name, x in zip(header, row, strict=False) if x} for row in texts]
    locations = (f"{path}, line {line}" for line, _ in rows)
    collect_problems(
        *(partial(validated, _Row, *row_and_location) for row_and_location in zip(named_rows, locations, strict=True))
    )
    return [dict.fromkeys(COLUMNS, "") | row for row in named_rows]


def _row(planned: ClipPlan, out: Path) -> dict[str, Any]:
    settings, made_from = planned.clip.settings, planned.identity
    row = dict.fromkeys(COLUMNS) | {
        "clip": planned.clip.name,
        "keypoints": ", ".join(settings.keypoints_from(out)),
        "cameras": len(settings.keypoints),
        "out": relative_path(out, planned.out),
        "status": "pending",
        "attempts": 0,
    }
    for name, content in (("settings", [made_from["settings"], made_from["version"]]), ("inputs", made_from["inputs"])):
        row[f"{name}_hash"] = _hash(content)
    earlier = dict(planned.row or {})
    return row | earlier | ({"status": "done earlier"} if earlier.get("status") == "done" else {})


def _hash(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
