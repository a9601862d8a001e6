"""Many clips: `find_clips`, `plan_batch`, `run_batch`, each with what the one before gives."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from recon.base import Progress
from recon.base.files import sole_writer
from recon.base.manifest import MANIFEST
from recon.base.package import version
from recon.base.parallel import STARTING, Event, carry_out
from recon.show.page import SUMMARY_PAGE, require_own_page
from recon.show.report import is_unsolved
from recon.workflows.batch.cluster import carry_out_on_cluster
from recon.workflows.batch.inputs import Clip, find_clips
from recon.workflows.batch.plan import (
    COLUMNS,
    RECORD,
    STATUSES,
    ClipPlan,
    Summary,
    check_shared,
    input_problems,
    plan_batch,
    repeated,
    results_of,
    write_summary_page,
)
from recon.workflows.clip import fit_clip
from recon.workflows.clip_results import write_clip
from recon.workflows.made_from import Record, digest

CRASH_LOG = "crash.log"
DYING_S = 5.0
"""So long a process may hold a clip's folder after the batch that it belonged to was killed."""


def run_batch(
    plan: Sequence[ClipPlan],
    out: Path,
    jobs: int | None = None,
    retries: int = 1,
    scheduler: str | None = None,
    on_event: Callable[[Event, Summary], None] = lambda event, summary: None,
) -> Summary:
    """`recon batch`: fit what is not done, each clip in a folder of its own, and keep `out / summary.csv` up to date;
    summary.html comes last.

    jobs: processes on this machine, by default one for each core; scheduler: the address of a Dask cluster instead.
    retries: how often a clip at which a process died is tried again. A clip that fails stops nothing. KeyboardInterrupt
    stops the fits under way, writes the summary and is raised again. Raises InputError where the cluster is not there,
    or goes away, and where another batch is writing to `out`.
    """
    todo = {planned.clip.name: planned for planned in plan if planned.action != "done"}

    def note(event: Event, summary: Summary) -> None:
        planned, outcome = todo[event.name], event.outcome
        keypoints = planned.clip.settings.keypoints_from(out)
        log = planned.out / CRASH_LOG
        if event.stage == STARTING:
            record.note(event.name, planned.identity, keypoints=keypoints)
        elif event.kind == "ended" and outcome["status"] != "failed":
            log.unlink(missing_ok=True)
            row = {name: outcome[name] for name in COLUMNS if name in outcome and name != "attempts"}
            made = digest(planned.out / MANIFEST)
            record.note(event.name, planned.identity, keypoints=keypoints, made=made, row=row)
        elif "log" in outcome:
            with suppress(OSError):
                planned.out.mkdir(parents=True, exist_ok=True)
                log.write_text(f"{outcome['error']}\n\n{outcome['log']}", encoding="utf-8")
        on_event(event, summary)

    with sole_writer(out):
        require_own_page(out / SUMMARY_PAGE)
        record = Record(out / RECORD)
        record.tidy()
        tasks = [(name, replace(planned, out=planned.out.absolute())) for name, planned in todo.items()]
        run = partial(carry_out_on_cluster, scheduler) if scheduler else partial(carry_out, jobs=jobs)
        return work_off(plan, out, partial(run, fit_planned, tasks, retries=retries), note)


def work_off(
    plan: Sequence[ClipPlan],
    out: Path,
    run: Callable[[Callable[[Event], None]], None],
    on_event: Callable[[Event, Summary], None],
) -> Summary:
    """The clips of a plan by `carry_out` with its tasks given, and the summary of it all, written again and again."""
    summary = Summary(plan, out)

    def tell(event: Event) -> None:
        if event.kind == "ended":
            summary.end(event.name, event.outcome)
        on_event(event, summary)
        if event.kind == "ended":  # and all else has been told
            summary.write_now_and_then()

    summary.write()
    try:
        run(tell)
    finally:
        summary.write()
        write_summary_page(out)
    return summary


def fit_planned(planned: ClipPlan, progress: Progress) -> dict[str, Any]:
    """Fit and write one clip, in a process that does nothing else meanwhile: columns of its summary."""
    here, there = version(), planned.identity["version"]
    if here != there:
        return {"status": "failed", "error": f"recon {here} on the worker, {there} where the batch runs"}
    began = time.perf_counter()
    with sole_writer(planned.out, DYING_S), threadpool_limits(1):
        motion = fit_clip(planned.clip.settings, progress)
        solve_s = time.perf_counter() - began
        progress("writing", 1.0)
        known = planned.identity["inputs"]
        report = write_clip(motion, planned.clip.settings, planned.out, solve_s, sha256=known)
    return {"status": "unsolved" if is_unsolved(report) else "done", **results_of(report)}
