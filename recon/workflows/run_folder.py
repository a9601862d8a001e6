"""`recon run` on a folder of videos: a batch of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import sole_writer
from recon.base.parallel import Event, carry_out
from recon.base.progress import Progress
from recon.io import recognised
from recon.io.video import SUFFIXES
from recon.show.page import SUMMARY_PAGE, require_own_page
from recon.show.report import is_unsolved
from recon.workflows.batch import Clip, Planned, Summary, work_off
from recon.workflows.batch.inputs import file_names
from recon.workflows.batch.record import identity
from recon.workflows.batch.summary import results_of
from recon.workflows.run import Job, job_of, run_video


def jobs_of(
    folder: Path,
    out: Path,
    given: Mapping[str, Any],
    config: Path | None = None,
    *,
    keypoints: Path | None = None,
    **more: Any,
) -> list[Job]:
    """One for each video of a folder, into a folder with its name. keypoints: a folder with the file of each video;
    the others: see `job_of`. Raises InputError with the problems of all."""
    videos = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
    if not videos:
        raise InputError(Problem(folder, "files", "no videos", f"files that end in {', '.join(SUFFIXES)}"))
    names = file_names(videos)
    jobs, problems = [], []
    for video in videos:
        try:
            own = None if keypoints is None else keypoints_of(video, keypoints)
            jobs.append(job_of(video, out / names[video], given, config, keypoints=own, **more))
        except InputError as error:
            problems += error.problems
    refuse(dict.fromkeys(problems))  # what all videos have in common is said once
    return jobs


def keypoints_of(video: Path, folder: Path) -> Path:
    """The file of a folder that is called as the video, or as DeepLabCut calls its keypoints; of the same in two
    formats the last. Raises InputError where there is none, or several."""
    if not folder.is_dir():
        raise InputError(Problem("--keypoints", "folder", str(folder), "a folder with a file for each video"))
    called = [p for p in sorted(folder.iterdir()) if p.stem == video.stem or p.stem.startswith(f"{video.stem}DLC")]
    files = {path.stem: path for path in called if path != video and recognised(path, "2D")}
    if len(files) != 1:
        found = ", ".join(path.name for path in files.values()) or "none"
        expected = f"one keypoint file called {video.stem}, or {video.stem}DLC..."
        raise InputError(Problem(folder, f"keypoints of {video.name}", found, expected))
    return next(iter(files.values()))


def run_folder(
    jobs: Sequence[Job],
    out: Path,
    processes: int | None = None,
    on_event: Callable[[Event, Summary], None] = lambda event, summary: None,
) -> Summary:
    """`run_video` for all jobs, and summary.csv and summary.html of them in `out`. processes: at a time, by default one
    for each core, each with one thread. A video that fails stops nothing; KeyboardInterrupt as in `run_batch`."""
    with sole_writer(out):
        require_own_page(out / SUMMARY_PAGE)
        plan = [Planned(Clip(job.out.name, job.settings), job.out, "new", "", identity(job.settings)) for job in jobs]
        tasks = [(job.out.name, replace(job, threads=1)) for job in jobs]
        return work_off(plan, out, partial(carry_out, _row_of, tasks, jobs=processes), on_event)


def _row_of(job: Job, progress: Progress) -> dict[str, Any]:
    """All of `recon run` on one video: columns of its summary."""
    stages, report = run_video(job, progress)
    new = any(done.status == "done" for done in stages)
    return {"status": "unsolved" if is_unsolved(report) else "done" if new else "done earlier", **results_of(report)}
