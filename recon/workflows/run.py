"""`recon run`: from a video to a page. Stages in their order, each left out if it has been done with the same inputs.

`run.json` in the folder says of each stage what it was made from (the content of its input files, its settings, the
version of recon) and what it wrote. A stage that has begun and not ended has written nothing down, and is done again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from recon.base.errors import InputError, Problem, all_of, refuse
from recon.base.files import sole_writer, staged_file
from recon.base.manifest import MANIFEST, read_manifest, sha256_of
from recon.base.progress import Progress, silent
from recon.fit.motion import Motion
from recon.gait.path import MIN_POINTS
from recon.io.video import probe
from recon.show.page import PAGE
from recon.show.report import build_report
from recon.workflows.batch.record import file_sha256, identity, identity_of
from recon.workflows.clip import fit_clip, read_model_and_cameras
from recon.workflows.clip_results import output_files, write_clip
from recon.workflows.overlay import OverlaySettings, run_overlay
from recon.workflows.settings import FitSettings, read_settings

RECORD = "run.json"
SCHEMA = {"name": "recon.run", "version": 1}
STAGES = ("detect", "camera-motion", "fit", "analyse", "overlay", "page")
OVERLAY = "overlay.mp4"
DETECTOR = "recon.keypoint_net"
"""The package that finds keypoints. It is imported by its name, where a job has a network: no room needs a wing."""
CameraMotion = Literal["turns", "zooms"]
Status = Literal["done", "unchanged", "left out"]


@dataclass(frozen=True)
class Job:
    """What is to be done with a video."""

    video: Path
    out: Path
    settings: FitSettings
    """Of the fit. Its keypoints are those that were given, or where those that are found go; its track, if the camera's
    motion is to be found, is still missing."""
    model: Path | None = None
    """Folder of the network that finds the keypoints."""
    quality: str = "fast"
    """Of that."""
    threads: int | None = None
    """Of that."""
    camera_motion: CameraMotion | None = None
    """What the camera does, if that is to be found."""
    first_frame: int = 0
    """The number that the video's first frame has in the keypoint file."""
    start: str | None = None
    """The stage from which on all is done again."""
    overwrite: bool = False
    """Whether files that no run has made, or that were changed since, may be replaced."""

    @property
    def track(self) -> Path:
        return self.out / f"{self.video.stem}_camera.csv"

    @property
    def fitted(self) -> FitSettings:
        """With the track that is found."""
        if self.camera_motion is None:
            return self.settings
        return replace(self.settings, camera_track=(self.track,), tilt_deg=None)


@dataclass(frozen=True)
class _Stage:
    """A part of the work."""

    name: str
    identity: Callable[[], dict[str, Any]]
    """What it is made from."""
    places: tuple[Path, ...]
    """Files that are in its way, unless a run has made them; none where it looks for itself what it may replace."""
    work: Callable[[Job, Progress], Iterable[Path]]
    """Does it, over what is there, and gives the files that it wrote."""


@dataclass(frozen=True)
class Done:
    """What became of a stage."""

    stage: str
    status: Status
    seconds: float
    files: tuple[str, ...] = ()
    """Relative to the folder."""


def job_of(
    video: Path,
    out: Path,
    given: Mapping[str, Any],
    config: Path | None = None,
    *,
    model: Path | None = None,
    keypoints: Path | None = None,
    **more: Any,
) -> Job:
    """given: settings of the fit by name, None where not given; more: other fields of `Job`. The frame rate is the
    video's own unless it is given. Raises InputError with every problem."""
    if (model is None) == (keypoints is None):
        found = "nothing" if model is None else f"{keypoints} beside --model"
        raise InputError(Problem("--keypoints", "keypoints", found, "a keypoint file, or --model with a network"))
    found_here = out / f"{video.stem}_keypoints.csv"
    info, _, settings, _ = all_of(
        lambda: probe(video),
        lambda: None if model is None else import_module(DETECTOR).model_file(model),
        lambda: read_settings(config, {**given, "keypoints": keypoints or found_here}),
        lambda: _check(given, more.get("camera_motion"), more.get("start"), more.get("quality"), model),
    )
    if settings.fps is None:
        if info.fps is None:
            raise InputError(Problem("--fps", "fps", f"nothing, and {video} does not say", "frames per second"))
        settings = replace(settings, fps=info.fps)
    return Job(video, out, settings, model, **more)


def _check(
    given: Mapping[str, Any],
    camera_motion: CameraMotion | None,
    start: str | None,
    quality: str | None,
    model: Path | None,
) -> None:
    """Raises InputError for options that cannot be used, or not with each other."""
    problems = []
    if quality not in (None, "fast", "best"):
        problems.append(Problem("--quality", "quality", repr(quality), "fast or best"))
    if camera_motion is not None and camera_motion not in ("turns", "zooms"):
        problems.append(Problem("--camera-motion", "motion", repr(camera_motion), "turns or zooms"))
    if camera_motion is not None and given.get("camera") is None:
        problems.append(Problem("--camera-motion", "camera", "nothing", "--camera with the camera's lens"))
    if camera_motion is not None and given.get("camera_track"):
        problems.append(Problem("--camera-motion", "motion", "a camera track beside it", "one of the two"))
    left_out = {"detect": model is None, "camera-motion": camera_motion is None}
    stages = [name for name in STAGES if not left_out.get(name)]
    if start is not None and start not in stages:
        problems.append(Problem("--from", "stage", repr(start), f"one of {', '.join(stages)}"))
    refuse(problems)


# -- the work ---------------------------------------------------------------------------------------------------------


def run_video(
    job: Job, progress: Progress = silent, ended: Callable[[Done], None] = lambda done: None
) -> tuple[list[Done], dict[str, Any]]:
    """`recon run`: all stages of a video, and the report of its fit; ended: told of each. Raises InputError where one
    cannot be done; what was done before stays."""
    file_sha256.cache_clear()  # files may have changed since
    with sole_writer(job.out):
        record = _read_record(job.out)
        result = _Result(job.out)
        stages, dones, again = [*_stages(job, result)], [], False
        for number, stage in enumerate(stages):
            again = again or stage.name == job.start

            def tell(what: str, share: float, number: int = number, name: str = stage.name) -> None:
                progress(f"{name}: {what}", (number + share) / len(stages))

            if stage.name in ("analyse", "overlay") and result.frames_with_pose < MIN_POINTS:
                done = Done(stage.name, "left out", 0.0)
            else:
                done = _carry_out(stage, job, record, again, tell)
            dones.append(done)
            ended(done)
        return dones, result.report


def _carry_out(stage: _Stage, job: Job, record: dict[str, Any], again: bool, progress: Progress) -> Done:
    began, known, before = time.perf_counter(), stage.identity(), record.get(stage.name)
    changed = _changed(job.out, before)
    if not again and not job.overwrite:
        _require_own(stage, before, changed)
    if before is not None and before["identity"] == known and not again and before["files"] and not changed:
        return Done(stage.name, "unchanged", time.perf_counter() - began, tuple(before["files"]))
    if stage.name in ("detect", "camera-motion", "fit"):
        _check_inputs(job)
    record[stage.name] = {"identity": known, "files": None}
    _write_record(job.out, record)
    progress("starting", 0.0)
    folder, paths = job.out.absolute(), [path.absolute() for path in stage.work(job, progress)]
    files = {path.relative_to(folder).as_posix(): sha256_of(path) for path in paths}
    record[stage.name] = {"identity": known, "files": files}
    _write_record(job.out, record)
    return Done(stage.name, "done", time.perf_counter() - began, tuple(files))


def _check_inputs(job: Job) -> None:
    """What would only be said after minutes of work. Raises InputError."""
    info, (_, _, cameras) = all_of(lambda: probe(job.video), lambda: read_model_and_cameras(job.settings))
    size = cameras[0][0].image_size_px
    if info.size_px != size:
        found = "{}x{}".format(*info.size_px)
        expected = "{}x{}, the size that the camera is calibrated for".format(*size)
        raise InputError(Problem(job.video, "size", found, expected))


def _stages(job: Job, result: _Result) -> Iterator[_Stage]:
    """Those that this job has."""
    keypoints = job.settings.keypoints[0]
    if job.model is not None:
        files = {"video": job.video, "model": import_module(DETECTOR).model_file(job.model)}
        yield _Stage("detect", lambda: identity_of(files, {"quality": job.quality}), (keypoints,), _detection)
    if job.camera_motion is not None:
        yield _Stage("camera-motion", lambda: _motion_identity(job), (job.track,), _camera_motion)
    places = tuple(job.out / name for name in output_files(job.out) if name != PAGE)
    yield _Stage("fit", lambda: identity(job.fitted), places, result.fit)
    fit, film = {"fit": job.out / MANIFEST}, {"video": job.video}
    options = {"first_frame": job.first_frame}
    yield _Stage("analyse", lambda: identity_of(fit, {}), (job.out / "analysis" / "analysis.json",), _analysis)
    yield _Stage("overlay", lambda: identity_of(fit | film, options), (job.out / OVERLAY,), _overlay)
    yield _Stage("page", lambda: identity_of(fit | film, options), (), partial(_page, result))


def _detection(job: Job, progress: Progress) -> list[Path]:
    assert job.model is not None
    (out,) = job.settings.keypoints
    import_module(DETECTOR).run_prediction(
        job.video, job.model, out, quality=job.quality, threads=job.threads, overwrite=True, progress=progress
    )
    return [out]


def _motion_identity(job: Job) -> dict[str, Any]:
    settings = job.settings
    assert settings.camera is not None
    files = {"video": job.video, "camera": settings.camera[0], "keypoints": settings.keypoints[0]}
    options = {
        "motion": job.camera_motion,
        "first_frame": job.first_frame,
        "camera_name": settings.camera_name and settings.camera_name[0],
        "tilt_deg": settings.tilt_deg,
        "individual": settings.individual,
    }
    return identity_of(files, options)


def _camera_motion(job: Job, progress: Progress) -> Iterable[Path]:
    from recon.workflows.camera_motion import of_clip, run_camera_motion

    more = {"first_frame": job.first_frame, "zoom": job.camera_motion == "zooms", "overwrite": True}
    _, files = run_camera_motion(of_clip(job.settings, job.video, job.track, **more), progress=progress)
    return files


class _Result:
    """What a video became: of the fit that this run makes, or of the one that it found done."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self._report: dict[str, Any] | None = None

    def fit(self, job: Job, progress: Progress) -> list[Path]:
        began = time.perf_counter()
        motion = fit_clip(job.fitted, progress)
        self._report = write_clip(motion, job.fitted, self.out, time.perf_counter() - began)
        return [self.out / name for name in (*read_manifest(self.out).files, MANIFEST)]

    @property
    def report(self) -> dict[str, Any]:
        if self._report is None:
            self._report = build_report(Motion.load(self.out))
        return self._report

    @property
    def frames_with_pose(self) -> int:
        return self.report["summary"]["frames_with_pose"]


def _analysis(job: Job, progress: Progress) -> list[Path]:
    from recon.workflows.analyse import AnalyseSettings, run_analyse

    *_, files = run_analyse(AnalyseSettings(folder=job.out, overwrite=True), progress=progress)
    return files


def _overlay(job: Job, progress: Progress) -> list[Path]:
    out = job.out / OVERLAY
    run_overlay(
        OverlaySettings(folder=job.out, video=job.video, out=out, first_frame=job.first_frame, overwrite=True),
        progress=progress,
    )
    return [out]


def _page(result: _Result, job: Job, progress: Progress) -> list[Path]:
    from recon.workflows.page import PageSettings, run_page

    video = job.video if result.frames_with_pose else None
    return [run_page(PageSettings(folder=job.out, video=video, first_frame=job.first_frame), progress=progress)]


# -- what was done ----------------------------------------------------------------------------------------------------


def _read_record(out: Path) -> dict[str, Any]:
    """By stage; nothing where there is none."""
    try:
        record = json.loads((out / RECORD).read_text(encoding="utf-8"))
        return record["stages"] if record["schema"] == SCHEMA else {}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}


def _write_record(out: Path, stages: Mapping[str, Any]) -> None:
    with staged_file(out / RECORD) as staged:
        staged.write_text(json.dumps({"schema": SCHEMA, "stages": stages}, indent=1) + "\n", encoding="utf-8")


def _changed(out: Path, before: Mapping[str, Any] | None) -> list[Path]:
    """What a stage wrote, and is not as it was written, or not there."""
    files = {out / name: digest for name, digest in ((before or {}).get("files") or {}).items()}
    return [path for path, digest in files.items() if not path.is_file() or sha256_of(path) != digest]


def _require_own(stage: _Stage, before: Mapping[str, Any] | None, changed: Iterable[Path]) -> None:
    """Raises InputError where files are in the way of a stage that no run has made, or that were changed since."""
    if not stage.places:
        return
    if before is None:
        foreign, found = [path for path in stage.places if path.exists()], "one that recon run has not made"
        expected = "another --out, or --overwrite"
    else:
        foreign, found = [path for path in changed if path.exists()], "other than recon run wrote it"
        expected = f"--from {stage.name} to write it again; --keypoints takes a file of your own"
    if foreign:
        first, *others = foreign
        more = f", and so {'are' if len(others) > 1 else 'is'} {len(others)} more" if others else ""
        raise InputError(Problem(first, "file", found + more, expected))
