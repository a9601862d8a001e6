"""`recon run`: from a video to a page. Stages in their order, each left out if it has been done with the same inputs.

`run.jsonl` in the folder says of each stage what it was made from and what it wrote. A stage that has begun and not
ended has written nothing down, and is done again. A folder of videos is a batch of it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from rich.console import Console

from recon.api.analyse import FOLDER, AnalyseSettings
from recon.api.analyse import SUMMARY as ANALYSIS
from recon.api.batch import ClipPlan, OnEvent, Summary, results_of, summary_output, work_off
from recon.api.batch_inputs import SUMMARY, Clip, file_names
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
)
from recon.api.settings import FIRST_FRAME, OF_ANY_CLIP, FitSettings
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.files import MANIFEST, read_manifest
from recon.base.locks import sole_writer
from recon.base.outputs import Output, adopt
from recon.base.parallel import carry_out
from recon.base.progress import Progress, silent
from recon.base.settings import Count, Integer, Option, Settings, input_paths
from recon.cli.analyse import analyse_command
from recon.cli.answers import Answer, answer_of_fit, progress_bar, say
from recon.cli.batch import shown_batch
from recon.cli.cameras import camera_motion_answer
from recon.cli.commands import OptionsOf
from recon.cli.look import OverlaySettings, PageSettings, overlay, rate_note, report
from recon.fit.motion import Motion
from recon.gait.kinematics import MIN_POINTS
from recon.io.formats import recognised
from recon.io.video import SUFFIXES, probe, size_problems
from recon.show.page.own_page import PAGE, SUMMARY_PAGE
from recon.show.plain import picked
from recon.show.report import build_report, is_unsolved
from recon.show.tables import TABLES

RECORD = "run.jsonl"
Stage = Literal["detect", "camera-motion", "fit", "analyse", "overlay", "page"]
OVERLAY = "overlay.mp4"
_OfFit = Annotated[dict[str, Any], OptionsOf(FitSettings, OF_ANY_CLIP, "Settings of the fit")]


class _RunSettings(Settings):
    """What `recon run` is told besides the settings of the fit."""

    video: Annotated[Path, Option(argument="VIDEO")]
    """The video, as in run.mp4, or a folder of videos."""
    out: Path
    """Folder for everything; of a folder of videos one in it for each."""
    model: Annotated[Path | None, Option(metavar="DIR")] = None
    """Folder of a trained network, as in models/run."""
    keypoints: Path | None = None
    """Instead of a network: the keypoint file, or of a folder of videos the folder with them."""
    camera_motion: Literal["turns", "zooms"] | None = None
    """How the camera moves; found from the background. (default: not)"""
    start: Annotated[Stage | None, Option(metavar="STAGE", name="--from")] = None
    """Do this stage again, and all after it."""
    first_frame: Annotated[Integer, FIRST_FRAME] = 0
    jobs: Count | None = None
    """Videos at a time, of a folder. (default: one for each core)"""
    config: Path | None = None
    """Settings as in the config.toml of a fit; options here overrule it."""
    overwrite: bool = False
    """Replace what recon fit, analyse and others made in DIR; never a file that was changed since, or is your own."""

    def problems(self) -> Iterator[Problem]:
        if (self.model is None) == (self.keypoints is None):
            found = "nothing" if self.model is None else f"{self.keypoints} beside --model"
            yield Problem("--keypoints", "keypoints", found, "a keypoint file, or --model with a network")
        if {"detect": self.model, "camera-motion": self.camera_motion}.get(self.start or "", ()) is None:
            yield Problem("--from", "stage", repr(self.start), "a stage that this run has")

    @property
    def track(self) -> Path:
        """Where the camera's motion goes."""
        return self.out / f"{self.video.stem}_camera.csv"


@dataclass(frozen=True)
class _Job:
    """A video and what is to be done with it."""

    run: _RunSettings
    given: FitSettings
    """Its keypoints are those that were given, or where those that are found go."""
    threads: int | None = None
    """How many threads the network uses."""

    @property
    def fit(self) -> FitSettings:
        """With the track that is found, if the camera's motion is to be."""
        return replace(self.given, camera_track=self.run.track, tilt_deg=None) if self.run.camera_motion else self.given


class _Stage(NamedTuple):
    """A part of the work."""

    work: Callable[[Progress], Answer]
    """Does it, over what is there, and gives the files that it wrote, and notes on the video."""
    identity: Callable[[], dict[str, Any]]
    """What it is made from, once the stages before it are done."""
    output: Output
    """What it may replace."""
    names: tuple[str, ...]
    """Files that it writes, as far as they are known."""


class _StageOutcome(NamedTuple):
    """What became of a stage."""

    stage: str
    status: Literal["done", "unchanged", "left out"]
    seconds: float
    files: tuple[str, ...] = ()
    """The files of the stage, relative to the folder."""
    notes: tuple[str, ...] = ()
    """What is wrong with the video, as the stage found."""


def run(settings: _RunSettings, given: _OfFit, console: Console) -> Answer:
    """From a video to a page: find the keypoints, fit, analyse, draw the overlay, and write report.html.

    What has been done with the same files and settings is not done again. The frame rate is the video's unless --fps is
    given. The stages: detect, camera-motion, fit, analyse, overlay, page.

    Example: recon run run.mp4 --camera camera.toml --model models/run --out results/run

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used; what was done before stays.
    """
    if settings.video.is_dir():
        plan = jobs_of(settings, given)
        return shown_batch(console, len(plan), partial(run_folder, plan, settings.out, settings.jobs))
    with progress_bar(console) as progress:
        job = job_of(settings, given)
        done, found = run_video(job, progress, lambda stage: say(console, _line(stage)))
    notes = [rate_note(settings.video, job.fit.fps), *(note for stage in done for note in stage.notes)]
    for note in filter(None, dict.fromkeys(notes)):
        say(console, f"note: {note}")
    stages = [{"stage": s.stage, "status": s.status, "seconds": round(s.seconds, 3)} for s in done]
    return answer_of_fit(found, settings.out, settings.out / PAGE, stages=stages)


def _line(done: _StageOutcome) -> str:
    names = done.files[0] if len(done.files) == 1 else f"{len(done.files)} files"
    text = {
        "done": f"{names}, {done.seconds:.1f} s",
        "unchanged": f"{names}, as before",
        "left out": "left out: too few frames have a pose",
    }[done.status]
    return f"{done.stage:<14}{text}"


def _model_file(path: Path) -> Path:
    """Return the file of a network. It is imported where a job has one: no other job needs the package."""
    from recon.keypoint_net.network import model_file

    return model_file(path)


def job_of(run: _RunSettings, given: Mapping[str, Any]) -> _Job:
    """given: settings of the fit by name. The frame rate is the video's own unless it is given. Raises InputError with
    every problem."""
    keypoints = run.keypoints or run.out / f"{run.video.stem}_keypoints.csv"
    info, _, settings, _ = collect_problems(
        lambda: probe(run.video),
        lambda: None if run.model is None else _model_file(run.model),
        lambda: read_settings(run.config, {**given, "keypoints": keypoints}),
        lambda: raise_problems(_motion_problems(run, given)),
    )
    if settings.fps is None:
        if info.fps is None:
            raise InputError(Problem("--fps", "fps", f"nothing, and {run.video} does not say", "frames per second"))
        settings = replace(settings, fps=info.fps)
    return _Job(run, settings)


def _motion_problems(run: _RunSettings, given: Mapping[str, Any]) -> Iterator[Problem]:
    if run.camera_motion is not None and given.get("camera") is None:
        yield Problem("--camera-motion", "camera", "nothing", "--camera with the camera's lens")
    if run.camera_motion is not None and given.get("camera_track"):
        yield Problem("--camera-motion", "motion", "a camera track beside it", "one of the two")


# -- the work ---------------------------------------------------------------------------------------------------------


def run_video(
    job: _Job, progress: Progress = silent, ended: Callable[[_StageOutcome], None] = lambda done: None
) -> tuple[list[_StageOutcome], dict[str, Any]]:
    """All stages of a video, and the report of its fit; ended: told of each. Raises InputError where one cannot be
    done; what was done before stays."""
    out, found = job.run.out, {}
    with sole_writer(out):
        record, stages, dones, again = Record(out / RECORD), _stages(job), [], False
        for name, row in record.rows.items():  # version 0.2 had no other record of them
            if name in stages:
                folder = stages[name].output.folder
                own = {p: sha256 for p, sha256 in row.get("files", {}).items() if (out / p).parent == folder}
                adopt(folder, stages[name].output.kind, {Path(p).name: sha256 for p, sha256 in own.items()})
        for name, stage in stages.items():  # before any work
            again = again or name == job.run.start
            if again or record.look(name, stage.identity(), out)[0]:
                _require_own(name, stage, job, record, again)
        record.tidy()
        again = False
        for number, (name, stage) in enumerate(stages.items()):
            again = again or name == job.run.start

            def tell(what: str, share: float, number: int = number, name: str = name) -> None:
                progress(f"{name}: {what}", (number + share) / len(stages))

            if name in ("analyse", "overlay") and found["summary"]["frames_with_pose"] < MIN_POINTS:
                done = _StageOutcome(name, "left out", 0.0)
            else:
                done = _carry_out(name, stage, job, record, again, tell)
            if name == "fit":
                found = build_report(Motion.load(out))
            dones.append(done)
            ended(done)
        return dones, found


def _carry_out(name: str, stage: _Stage, job: _Job, record: Record, again: bool, progress: Progress) -> _StageOutcome:
    began, known, out = time.perf_counter(), stage.identity(), job.run.out
    why, _ = record.look(name, known, out)
    status: Literal["done", "unchanged"] = "done" if why or again else "unchanged"
    if status == "done":
        _require_own(name, stage, job, record, again)
        if name in ("detect", "camera-motion", "fit"):
            _check_inputs(job)
        record.note(name, known)
        progress("starting", 0.0)
        made = stage.work(progress)
        if stage.identity() != known:
            expected = "files that nobody changes meanwhile: run the command again"
            raise InputError(Problem(job.run.video, name, "input files that were changed meanwhile", expected))
        record.note(name, known, files=digests(made.files, out), notes=[*made.notes])
    row = record.rows[name]
    return _StageOutcome(name, status, time.perf_counter() - began, tuple(row["files"]), tuple(row.get("notes", ())))


def _require_own(name: str, stage: _Stage, job: _Job, record: Record, again: bool) -> None:
    """Raise InputError for files that the stage may not replace, or without --overwrite, that another command made."""
    stage.output.require(stage.names)
    present = [path for path in (stage.output.folder / file for file in stage.names) if os.path.lexists(path)]
    if present and name not in record.rows and not again and not job.run.overwrite:
        more = f", and so are {len(present) - 1} more" if len(present) > 1 else ""
        expected = "another --out, or --overwrite"
        raise InputError(Problem(present[0], "file", "one that recon run has not made" + more, expected))


def _check_inputs(job: _Job) -> None:
    """What would only be said after minutes of work. Raises InputError."""
    # Keypoints that are not there yet are called as the video.
    given = job.given if job.run.model is None else replace(job.given, keypoints=job.run.video)
    info, (_, _, cameras) = collect_problems(lambda: probe(job.run.video), lambda: read_model_and_cameras(given))
    raise_problems(size_problems(job.run.video, info, cameras[0][0]))


def _stages(job: _Job) -> dict[str, _Stage]:
    """The stages that this job has, by name."""
    run, given, out = job.run, job.given, job.run.out
    keypoints = given.keypoints[0]
    fit, film, first = {"fit": out / MANIFEST}, {"video": run.video}, {"first_frame": run.first_frame}
    shown: dict[str, Any] = {"folder": out, **film, **first}

    def output(kind: str, folder: Path = out) -> Output:
        return Output(folder, kind, overwrite=True, inputs=input_paths(run))

    def detect(progress: Progress) -> Answer:
        from recon.keypoint_net.network import run_prediction

        assert run.model is not None  # without a network there is no such stage
        how = {"threads": job.threads, "overwrite": True, "progress": progress, "output": output("predict")}
        prediction = run_prediction(run.video, run.model, keypoints, **how)
        return Answer({}, files=[keypoints], notes=prediction.notes)

    def solve(progress: Progress) -> Answer:
        fit_into(out, job.fit, progress)
        return Answer({}, files=read_manifest(out).paths)

    stages = {}
    if run.model is not None:
        network = film | {"model": _model_file(run.model)}
        made_of = partial(identity_of, network, {})
        stages["detect"] = _Stage(detect, made_of, output("predict"), (keypoints.name,))
    if run.camera_motion is not None and given.camera is not None:
        turning = settings_for_clip(
            given, run.video, run.track, **first, zoom=run.camera_motion == "zooms", overwrite=True
        )
        files = film | {"camera": given.camera[0], "keypoints": keypoints}
        how = first | {"motion": run.camera_motion} | picked(given, "camera_name", "tilt_deg", "individual")
        track = output("camera-motion")
        work, made_of = partial(camera_motion_answer, turning, track), partial(identity_of, files, how)
        stages["camera-motion"] = _Stage(work, made_of, track, motion_files(run.track))
    analysis = AnalyseSettings(folder=out, overwrite=True)
    drawn = OverlaySettings(out=out / OVERLAY, overwrite=True, **shown)
    of_fit, of_film = partial(identity_of, fit, {}), partial(identity_of, fit | film, first)
    fitted = output_of(job.fit, out, overwrite=True)
    tables = (ANALYSIS, *TABLES)
    return stages | {
        FIT: _Stage(solve, partial(identity, job.fit), fitted, (*output_files(job.fit, out),)),
        "analyse": _Stage(partial(analyse_command, analysis), of_fit, output("analyse", out / FOLDER), tables),
        "overlay": _Stage(partial(overlay, drawn), of_film, output("overlay"), (OVERLAY,)),
        "page": _Stage(partial(report, PageSettings(**shown)), of_film, output("report"), (PAGE,)),
    }


# -- a folder of videos -----------------------------------------------------------------------------------------------


def jobs_of(run: _RunSettings, given: Mapping[str, Any]) -> list[_Job]:
    """One for each video of a folder, into a folder with its name. Raises InputError with the problems of all."""
    videos = sorted(p for p in run.video.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
    if not videos:
        raise InputError(Problem(run.video, "files", "no videos", f"files that end in {', '.join(SUFFIXES)}"))
    names = file_names(videos)

    def job(video: Path) -> _Job:
        keypoints = None if run.keypoints is None else keypoints_of(video, run.keypoints)
        return job_of(replace(run, video=video, out=run.out / names[video], keypoints=keypoints), given)

    return [*collect_problems(*(partial(job, video) for video in videos))]


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
    jobs: Sequence[_Job], out: Path, processes: int | None = None, on_event: OnEvent = lambda *_: None
) -> Summary:
    """`run_video` for all jobs, and summary.csv and summary.html of them in `out`. processes: at a time, by default one
    for each core, each with one thread. A video that fails stops nothing; KeyboardInterrupt as in `run_batch`."""
    with sole_writer(out):
        summary_output(out).require((SUMMARY, SUMMARY_PAGE))
        folders = [(job.run.out.name, job) for job in jobs]
        plan = [ClipPlan(Clip(name, job.given), job.run.out, "new", "", identity(job.given)) for name, job in folders]
        tasks = [(name, replace(job, threads=1)) for name, job in folders]
        return work_off(plan, out, partial(carry_out, _row_of, tasks, jobs=processes), on_event)


def _row_of(job: _Job, progress: Progress) -> dict[str, Any]:
    """All of `recon run` on one video: columns of its summary."""
    stages, found = run_video(job, progress)
    new = any(done.status == "done" for done in stages)
    return {"status": "unsolved" if is_unsolved(found) else "done" if new else "done earlier", **results_of(found)}
