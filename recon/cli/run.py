"""Run all stages from a video to a page.

A stage is skipped if it was done before with the same inputs. `run.jsonl` in the folder records the inputs and the
files of each stage. A stage that began and did not end is repeated. A folder of videos is run as a batch.
"""

from __future__ import annotations

import os
import shlex
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

from rich.console import Console

from recon.api.analyse import SUMMARY as ANALYSIS
from recon.api.analysis_settings import AnalyseSettings
from recon.api.batch import ClipPlan, OnEvent, Summary, results_of, run_plan, summary_output
from recon.api.batch_inputs import Clip, file_names
from recon.api.camera_motion import motion_files, settings_for_clip
from recon.api.clip_inputs import read_model_and_cameras
from recon.api.clip_results import (
    FIT,
    Record,
    digests,
    fit_into,
    identity,
    identity_of,
    output_files,
    output_of,
    read_settings,
    with_corrections_in,
)
from recon.api.settings import FitSettings
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.files import MANIFEST, read_manifest
from recon.base.locks import sole_writer
from recon.base.numbers import quantity
from recon.base.outputs import Output, adopt
from recon.base.parallel import run_tasks
from recon.base.progress import Progress, silent
from recon.base.settings import input_paths
from recon.cli.analyse import analyse_command
from recon.cli.answers import Answer, answer_of_fit, progress_bar, say
from recon.cli.batch import run_on_console
from recon.cli.cameras import camera_motion_answer
from recon.cli.look import OVERLAY, bars_note, draw_overlay, make_page, rate_note, write_recording
from recon.cli.look_options import OverlaySettings, PageSettings, ViewSettings
from recon.cli.video_options import RunSettings
from recon.fit.motion import Motion
from recon.gait.spline import MIN_POINTS
from recon.io.formats import recognised
from recon.io.video import SUFFIXES, probe, size_problems
from recon.show.page.own_page import PAGE, SUMMARY, SUMMARY_PAGE, VIDEO_PLAYBACK
from recon.show.plain import picked
from recon.show.report import build_report, is_unsolved
from recon.show.tables import TABLES

RECORD = "run.jsonl"
RECORDED_FRAMES = 1500
"""Maximum number of frames of a clip whose video is put into the recording, as a JPEG of each frame."""


@dataclass(frozen=True)
class _Job:
    """A video, and the settings of its run."""

    run: RunSettings
    settings: FitSettings
    """Settings of the fit, whose keypoints are the given file or the file that the network writes."""
    threads: int | None = None
    """Number of CPU threads of the network; None for as many as the process may use."""

    @property
    def fit(self) -> FitSettings:
        """Return the settings of the fit, with the camera track if the camera's motion is to be found."""
        return (
            replace(self.settings, camera_track=self.run.track, tilt_deg=None)
            if self.run.camera_motion
            else self.settings
        )


class _Stage(NamedTuple):
    """One stage of `recon run`, such as detect or fit."""

    work: Callable[[Progress], Answer]
    """Function that does the work, and returns the written files and notes on the video."""
    identity: Callable[[], dict[str, Any]]
    """Function that returns the inputs of the stage, once the earlier stages are done."""
    output: Output
    """Files that the stage may replace."""
    names: tuple[str, ...]
    """Files that the stage writes, as far as they are known in advance."""


class _StageOutcome(NamedTuple):
    """Status, duration and files of a stage that has ended, or was skipped."""

    stage: str
    status: Literal["done", "unchanged", "left out"]
    seconds: float
    files: tuple[str, ...] = ()
    """Files of the stage, relative to the results folder."""
    notes: tuple[str, ...] = ()
    """Notes on the video."""


def run_videos(settings: RunSettings, options: Mapping[str, Any], console: Console) -> Answer:
    """Run the stages of a video, or of each video in a folder, and return the answer."""
    if settings.video.is_dir():
        plan = jobs_of(settings, options)
        return run_on_console(console, len(plan), partial(run_folder, plan, settings.out, settings.jobs))
    with progress_bar(console) as progress:
        job = job_of(settings, options)
        outcomes, report_of_fit = run_video(job, progress, lambda stage: say(console, _outcome_line(stage)))
    of_video = [rate_note(settings.video, job.fit.fps), bars_note(settings.video)]
    notes = [*of_video, *(note for stage in outcomes for note in stage.notes)]
    for note in filter(None, dict.fromkeys(notes)):
        say(console, f"note: {note}")
    stages = [{"stage": s.stage, "status": s.status, "seconds": round(s.seconds, 3)} for s in outcomes]
    return answer_of_fit(report_of_fit, settings.out, settings.out / PAGE, stages=stages)


def _outcome_line(outcome: _StageOutcome) -> str:
    names = outcome.files[0] if len(outcome.files) == 1 else f"{len(outcome.files)} files"
    text = {
        "done": f"{names}, {quantity(outcome.seconds, 1, 's')}",
        "unchanged": f"{names}, as before",
        "left out": "left out: too few frames have a pose",
    }[outcome.status]
    return f"{outcome.stage:<14}{text}"


def _model_file(path: Path) -> Path:
    """Return the file of a network.

    The network package is imported only for jobs that use a network.
    """
    from recon.keypoint_net.network import model_file

    return model_file(path)


def job_of(run_settings: RunSettings, options: Mapping[str, Any]) -> _Job:
    """Return the job of a video.

    `options` holds the given settings of the fit, keyed by their names. Without a frame rate, the video's frame rate
    is used.

    Raises
    ------
    InputError
        If inputs cannot be used. The message lists every problem.
    """
    keypoints = run_settings.keypoints or run_settings.out / f"{run_settings.video.stem}_keypoints.csv"
    corrections = {} if run_settings.corrections is None else {"corrections": run_settings.corrections}
    info, _, settings, _ = collect_problems(
        lambda: probe(run_settings.video),
        lambda: None if run_settings.model is None else _model_file(run_settings.model),
        lambda: read_settings(run_settings.config, {**options, **corrections, "keypoints": keypoints}),
        lambda: raise_problems(_motion_problems(run_settings, options)),
    )
    if settings.fps is None:
        if info.fps is None:
            raise InputError(Problem("--fps", "fps", f"no frame rate in {run_settings.video}", "frames per second"))
        settings = replace(settings, fps=info.fps)
    return _Job(run_settings, with_corrections_in(run_settings.out, settings))


def _motion_problems(run_settings: RunSettings, options: Mapping[str, Any]) -> Iterator[Problem]:
    if run_settings.camera_motion is not None and options.get("camera") is None:
        yield Problem("--camera-motion", "camera", "no camera file", "--camera with the camera's lens")
    if run_settings.camera_motion is not None and options.get("camera_track"):
        yield Problem("--camera-motion", "motion", "--camera-track as well", "only one of the two options")


def run_video(
    job: _Job, progress: Progress = silent, ended: Callable[[_StageOutcome], None] = lambda outcome: None
) -> tuple[list[_StageOutcome], dict[str, Any]]:
    """Run all stages of a video, and return their outcomes and the report of its fit.

    `ended` is called with the outcome of each stage.

    Raises
    ------
    InputError
        If a stage cannot be done. The results of earlier stages are kept.
    """
    out, report_of_fit = job.run.out, {}
    with sole_writer(out):
        record, stages, outcomes, must_run = Record(out / RECORD), _stages(job), [], False
        for name, row in record.rows.items():  # version 0.2 recorded the files of a stage only here
            if name in stages:
                folder = stages[name].output.folder
                digests_of_stage = {
                    p: sha256 for p, sha256 in row.get("files", {}).items() if (out / p).parent == folder
                }
                adopt(
                    folder, stages[name].output.kind, {Path(p).name: sha256 for p, sha256 in digests_of_stage.items()}
                )
        for name, stage in stages.items():  # before any work is done
            must_run = must_run or name == job.run.start
            if must_run or record.why_redo(name, stage.identity(), out)[0]:
                _require_own(name, stage, job, record, must_run)
        record.tidy()
        must_run = False
        for number, (name, stage) in enumerate(stages.items()):
            must_run = must_run or name == job.run.start

            def show_progress(text: str, share: float, number: int = number, name: str = name) -> None:
                progress(f"{name}: {text}", (number + share) / len(stages))

            if name in ("analyse", "overlay", "playback") and report_of_fit["summary"]["frames_with_pose"] < MIN_POINTS:
                outcome = _StageOutcome(name, "left out", 0.0)
            else:
                outcome = _run_stage(name, stage, job, record, must_run, show_progress)
            if name == "fit":
                report_of_fit = build_report(Motion.load(out))
            outcomes.append(outcome)
            ended(outcome)
        return outcomes, report_of_fit


def _run_stage(
    name: str, stage: _Stage, job: _Job, record: Record, must_run: bool, progress: Progress
) -> _StageOutcome:
    began, made_from, out = time.perf_counter(), stage.identity(), job.run.out
    reason, _ = record.why_redo(name, made_from, out)
    status: Literal["done", "unchanged"] = "done" if reason or must_run else "unchanged"
    if status == "done":
        _require_own(name, stage, job, record, must_run)
        if name in ("detect", "camera-motion", "fit"):
            _check_inputs(job)
        record.note(name, made_from)
        progress("starting", 0.0)
        answer = stage.work(progress)
        if stage.identity() != made_from:
            expected = "files that do not change during the run: run the command again"
            raise InputError(Problem(job.run.video, name, "input files that changed during the run", expected))
        record.note(name, made_from, files=digests(answer.files, out), notes=[*answer.notes])
    row = record.rows[name]
    return _StageOutcome(name, status, time.perf_counter() - began, tuple(row["files"]), tuple(row.get("notes", ())))


def _require_own(name: str, stage: _Stage, job: _Job, record: Record, must_run: bool) -> None:
    """Raise InputError for files that the stage may not replace, or that another command made without --overwrite.

    `name` is the name of the stage. If `must_run` is true, files of other commands are not checked.
    """
    stage.output.require(stage.names)
    present = [path for path in (stage.output.folder / file for file in stage.names) if os.path.lexists(path)]
    if present and name not in record.rows and not must_run and not job.run.overwrite:
        more_files = f" (one of {len(present)} in the folder)" if len(present) > 1 else ""
        expected = "another --out, or --overwrite"
        raise InputError(Problem(present[0], "file", f"a file of another command{more_files}", expected))


def _check_inputs(job: _Job) -> None:
    """Raise InputError for inputs whose problems would otherwise appear only after minutes of work."""
    # Keypoints that do not exist yet will be named after the video.
    fit_settings = job.settings if job.run.model is None else replace(job.settings, keypoints=job.run.video)
    info, (_, _, cameras) = collect_problems(lambda: probe(job.run.video), lambda: read_model_and_cameras(fit_settings))
    raise_problems(size_problems(job.run.video, info, cameras[0][0]))


def _stages(job: _Job) -> dict[str, _Stage]:
    run_settings, fit_settings, out = job.run, job.settings, job.run.out
    manifest_file = {"fit": out / MANIFEST}
    video_file = {"video": run_settings.video}
    first_frame = {"first_frame": run_settings.first_frame}
    view_options: dict[str, Any] = {"folder": out, **video_file, **first_frame}

    def output(kind: str, folder: Path = out) -> Output:
        return Output(folder, kind, overwrite=True, inputs=input_paths(run_settings))

    def solve(progress: Progress) -> Answer:
        fit_into(out, job.fit, progress)
        return Answer({}, files=read_manifest(out).paths)

    stages = {}
    if run_settings.model is not None:
        stages["detect"] = _detection_stage(job, run_settings.model, output("predict"))
    if run_settings.camera_motion is not None and fit_settings.camera is not None:
        stages["camera-motion"] = _camera_motion_stage(job, fit_settings.camera[0], output("camera-motion"))
    analysis = AnalyseSettings(folder=out, overwrite=True)
    overlay_settings = OverlaySettings(out=out / OVERLAY, overwrite=True, **view_options)
    from_fit = partial(identity_of, manifest_file, {})
    from_video = partial(identity_of, manifest_file | video_file, first_frame)
    fit_output = output_of(job.fit, out, overwrite=True)
    tables = (ANALYSIS, *TABLES)
    recording = ViewSettings(out=out / VIDEO_PLAYBACK, overwrite=True, **view_options)
    return stages | {
        FIT: _Stage(solve, partial(identity, job.fit), fit_output, (*output_files(job.fit, out),)),
        "analyse": _Stage(partial(analyse_command, analysis), from_fit, output("analyse", analysis.out_folder), tables),
        "overlay": _Stage(partial(draw_overlay, overlay_settings), from_video, output("overlay"), (OVERLAY,)),
        "playback": _Stage(partial(_record, recording), from_video, output("view"), (VIDEO_PLAYBACK,)),
        "page": _Stage(partial(make_page, PageSettings(**view_options)), from_video, output("report"), (PAGE,)),
    }


def _detection_stage(job: _Job, model: Path, output: Output) -> _Stage:
    made_from = partial(identity_of, {"video": job.run.video, "model": _model_file(model)}, {})
    return _Stage(partial(_detect, job, output), made_from, output, (job.settings.keypoints[0].name,))


def _camera_motion_stage(job: _Job, camera: Path, output: Output) -> _Stage:
    run_settings, fit_settings = job.run, job.settings
    first_frame = {"first_frame": run_settings.first_frame}
    does_zoom = run_settings.camera_motion == "zooms"
    motion_settings = settings_for_clip(
        fit_settings, run_settings.video, run_settings.track, **first_frame, zoom=does_zoom, overwrite=True
    )
    files = {"video": run_settings.video, "camera": camera, "keypoints": fit_settings.keypoints[0]}
    parameters = (
        first_frame
        | {"motion": run_settings.camera_motion}
        | picked(fit_settings, "camera_name", "tilt_deg", "individual")
    )
    work, made_from = partial(camera_motion_answer, motion_settings, output), partial(identity_of, files, parameters)
    return _Stage(work, made_from, output, motion_files(run_settings.track))


def _detect(job: _Job, output: Output, progress: Progress) -> Answer:
    from recon.keypoint_net.network import run_prediction

    assert job.run.model is not None
    keypoints = job.settings.keypoints[0]
    parameters = {"threads": job.threads, "overwrite": True, "progress": progress, "output": output}
    prediction = run_prediction(job.run.video, job.run.model, keypoints, **parameters)
    return Answer({}, files=[keypoints], notes=prediction.notes)


def _record(settings: ViewSettings, progress: Progress) -> Answer:
    """Write the rerun recording of a result. The video is left out if the clip is long."""
    frames = len(Motion.load(settings.folder).frames)
    if frames <= RECORDED_FRAMES:
        return write_recording(settings, progress)
    answer = write_recording(replace(settings, video=None, first_frame=0), progress)
    folder, video = (shlex.quote(str(path)) for path in (settings.folder, settings.video))
    command = f"recon view {folder} --video {video}"
    text = f"the recording of {frames} frames does not contain the video; to see both: {command}"
    return replace(answer, notes=[text])


def jobs_of(run_settings: RunSettings, options: Mapping[str, Any]) -> list[_Job]:
    """Return one job per video of a folder, each with its own output folder.

    Raises
    ------
    InputError
        If inputs cannot be used. The message lists all problems.
    """
    videos = sorted(
        p for p in run_settings.video.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")
    )
    if not videos:
        raise InputError(Problem(run_settings.video, "files", "no videos", f"files that end in {', '.join(SUFFIXES)}"))
    names = file_names(videos)

    def job(video: Path) -> _Job:
        keypoints = None if run_settings.keypoints is None else keypoints_of(video, run_settings.keypoints)
        return job_of(
            replace(run_settings, video=video, out=run_settings.out / names[video], keypoints=keypoints), options
        )

    return [*collect_problems(*(partial(job, video) for video in videos))]


def keypoints_of(video: Path, folder: Path) -> Path:
    """Return the file in a folder that has the video's name, or the name that DeepLabCut gives a video's keypoints.

    If the same keypoints exist in two formats, the last one is used.

    Raises
    ------
    InputError
        If no file matches, or several files match.
    """
    if not folder.is_dir():
        raise InputError(Problem("--keypoints", "folder", str(folder), "a folder with a file for each video"))
    candidates = [p for p in sorted(folder.iterdir()) if p.stem == video.stem or p.stem.startswith(f"{video.stem}DLC")]
    files = {path.stem: path for path in candidates if path != video and recognised(path, "2D")}
    if len(files) != 1:
        actual = ", ".join(path.name for path in files.values()) or "none"
        expected = f"one keypoint file called {video.stem}, or {video.stem}DLC..."
        raise InputError(Problem(folder, f"keypoints of {video.name}", actual, expected))
    return next(iter(files.values()))


def run_folder(
    jobs: Sequence[_Job], out: Path, processes: int | None = None, on_event: OnEvent = lambda *_: None
) -> Summary:
    """Run all stages of several videos in parallel, and write summary.csv and summary.html into `out`.

    A video that fails does not stop the others. A KeyboardInterrupt is handled as in `run_batch`. `processes` is the
    number of processes, each with one thread, by default one per core.
    """
    with sole_writer(out):
        summary_output(out).require((SUMMARY, SUMMARY_PAGE))
        folders = [(job.run.out.name, job) for job in jobs]
        plan = [
            ClipPlan(Clip(name, job.settings), job.run.out, "new", "", identity(job.settings)) for name, job in folders
        ]
        tasks = [(name, replace(job, threads=1)) for name, job in folders]
        return run_plan(plan, out, partial(run_tasks, _row_of, tasks, jobs=processes), on_event)


def _row_of(job: _Job, progress: Progress) -> dict[str, Any]:
    """Process one video with `recon run`, and return the cells of its row in summary.csv."""
    stages, report_of_fit = run_video(job, progress)
    is_new = any(outcome.status == "done" for outcome in stages)
    return {
        "status": "unsolved" if is_unsolved(report_of_fit) else "done" if is_new else "done earlier",
        **results_of(report_of_fit),
    }
