"""Many clips: `find_clips`, `plan_batch`, `run_batch`, each with what the one before gives."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path

from recon.base.files import sole_writer
from recon.show.page import SUMMARY_PAGE, require_own_page
from recon.workflows.batch.checks import check_shared, input_problems, repeated
from recon.workflows.batch.inputs import Clip, find_clips
from recon.workflows.batch.pool import DaskPool, Event, LocalPool, Pool, Task, carry_out
from recon.workflows.batch.record import Planned, plan_batch
from recon.workflows.batch.summary import COLUMNS, STATUSES, Summary, write_summary_page
from recon.workflows.batch.worker import task_of

__all__ = [
    "COLUMNS",
    "STATUSES",
    "Clip",
    "Event",
    "Planned",
    "Summary",
    "available_cores",
    "check_shared",
    "find_clips",
    "input_problems",
    "plan_batch",
    "repeated",
    "run_batch",
    "work_off",
]


def run_batch(
    plan: Sequence[Planned],
    out: Path,
    jobs: int | None = None,
    retries: int = 1,
    scheduler: str | None = None,
    on_event: Callable[[Event, Summary], None] = lambda event, summary: None,
) -> Summary:
    """`recon batch`: fit what is not done, each clip in a folder of its own, and keep `out / summary.csv` up to date;
    summary.html comes last.

    jobs: processes on this machine, by default one for each core; scheduler: the address of a Dask cluster instead.
    retries: how often a clip at which a worker died is tried again. A clip that fails stops nothing. KeyboardInterrupt
    stops the fits under way, writes the summary and is raised again. Raises InputError where the cluster is not there,
    or goes away, and where another batch is writing to `out`.
    """
    with sole_writer(out):
        require_own_page(out / SUMMARY_PAGE)
        run = uuid.uuid4().hex
        tasks = [(p.clip.name, task_of(p, run)) for p in plan if p.action != "done"]
        pool = DaskPool(scheduler, retries, run) if scheduler else LocalPool(jobs or available_cores(), retries)
        return work_off(plan, out, pool, tasks, on_event)


def work_off(
    plan: Sequence[Planned],
    out: Path,
    pool: Pool,
    tasks: Sequence[tuple[str, Task]],
    on_event: Callable[[Event, Summary], None],
) -> Summary:
    """The tasks of a plan, each with its clip's name, and the summary of it all, written again and again."""
    summary = Summary(plan, out)

    def tell(event: Event) -> None:
        if event.kind == "ended":
            summary.end(event.clip, event.outcome)
        on_event(event, summary)

    summary.write()
    try:
        carry_out(pool, tasks, tell, summary.write_now_and_then)
    finally:
        summary.write()
        write_summary_page(out)
    return summary


def available_cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
