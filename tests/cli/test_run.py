"""Test `recon run`: from a video to a page, without repeating stages."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from command_line import refusal, refused, run, run_tasks_here, says

import recon.cli.run as module
from recon import FitSettings, Keypoints, read_keypoints, write_clip
from recon.api.clip_results import output_of
from recon.base.outputs import Output
from recon.cli.answers import Answer
from recon.cli.run import _Job, job_of, jobs_of, keypoints_of, run_folder, run_video
from recon.cli.video_options import RunSettings
from recon.io.video import video_writer
from recon.keypoint_net.settings import PredictSettings

SAMPLES = Path(__file__).parents[2] / "data" / "samples"
ALL = ["fit", "analyse", "overlay", "playback", "page"]


def write_film(path: Path, frames: int = 2, size_px: tuple[int, int] = (64, 48)) -> Path:
    with video_writer(path, size_px, 60.0) as write:
        for number in range(frames):
            write(np.full((size_px[1], size_px[0], 3), 10 * number, np.uint8))
    return path


@pytest.fixture(scope="module")
def report(small_trajectory, tmp_path_factory) -> str:
    """Return the report of eight frames with a pose."""
    folder = tmp_path_factory.mktemp("fit")
    settings = FitSettings(keypoints=Path("run.csv"), camera=Path("camera.toml"), fps=30)
    write_clip(small_trajectory, settings, folder, solve_s=0.1)
    return (folder / "report.json").read_text(encoding="utf-8")


@pytest.fixture
def called(monkeypatch, report, small_trajectory) -> list[str]:
    """Replace each stage by a function that only writes its files, and return the list of stages carried out."""
    names: list[str] = []
    numbers = count()

    def write(path: Path, name: str) -> Path:
        kind = {"page": "report", "track": "camera-motion", "playback": "view"}.get(name, name)
        Output(path.parent, kind, overwrite=True).write(path.name, f"{name} {len(names)}")
        return path

    def does(name: str, file: str, notes: Sequence[str] = ()):
        def work(settings, *args, **options):
            names.append(name)
            return Answer({}, files=[write(settings.folder / file, name)], notes=notes)

        return work

    def predict(video: Path, model: Path, out: Path, *, progress, output, **options) -> Keypoints:
        PredictSettings(video=video, model=model, out=out, **options)
        names.append("detect")
        with output.staged(adds=True) as folder:
            shutil.copy(SAMPLES / "whole.csv", folder / out.name)
        return read_keypoints(out)

    def track(settings, output, progress):
        names.append("camera-motion")
        return Answer({}, files=(write(settings.out, "track"),))

    def write_results(out: Path, settings, progress) -> dict:
        names.append("fit")
        with output_of(settings, out, overwrite=True).staged() as folder:
            replace(small_trajectory, timing_s={"solve_s": 0.1}).save(folder)
            (folder / "report.json").write_text(report, encoding="utf-8")
            (folder / "pose3d.csv").write_text(f"poses {next(numbers)}")
        return json.loads(report)

    monkeypatch.setattr("recon.keypoint_net.network.run_prediction", predict)
    monkeypatch.setattr("recon.cli.run.camera_motion_answer", track)
    monkeypatch.setattr("recon.cli.run._check_inputs", lambda job: None)
    monkeypatch.setattr("recon.cli.run.fit_into", write_results)
    monkeypatch.setattr("recon.cli.run.analyse_command", does("analyse", "analysis/analysis.json"))
    monkeypatch.setattr("recon.cli.run.draw_overlay", does("overlay", "overlay.mp4", ["uneven in time"]))
    monkeypatch.setattr("recon.cli.run.write_recording", does("playback", "playback.rrd"))
    monkeypatch.setattr("recon.cli.run.make_page", does("page", "report.html"))
    return names


@pytest.fixture
def film(tmp_path) -> Path:
    shutil.copy(SAMPLES / "whole.csv", tmp_path / "points.csv")
    (tmp_path / "net").mkdir()
    (tmp_path / "net" / "model.pt").write_text("weights")
    return write_film(tmp_path / "run.avi")


def job(film: Path, **more) -> _Job:
    given = {"camera": SAMPLES / "camera.toml", **more.pop("given", {})}
    if "model" not in more:
        more["keypoints"] = film.parent / "points.csv"
    return job_of(RunSettings(video=film, out=film.parent / "out", **more), given)


def done(job: _Job, called: list[str]) -> list[str]:
    """Run the stages of a job, and return the names of those that were carried out."""
    called.clear()
    stages, _ = run_video(job)
    assert [stage.stage for stage in stages if stage.status == "done"] == called
    return called.copy()


def test_camera_is_chosen_before_keypoints_are_detected(film):
    with refusal(("whole_scene.json", "camera", "2 cameras, none of them chosen", "--camera-name")):
        module._check_inputs(job(film, model=film.parent / "net", given={"camera": SAMPLES / "whole_scene.json"}))


def test_finished_stages_are_skipped(film, called):
    assert done(job(film), called) == ALL
    # The note of the earlier run is repeated.
    assert [stage.notes for stage in run_video(job(film))[0]] == [(), (), ("uneven in time",), (), ()]
    assert job(film).fit.fps == 60
    assert done(job(film), called) == []
    assert done(job(film, given={"likelihood_min": 0.4}), called) == ALL
    assert done(job(film, given={"likelihood_min": 0.4}, first_frame=3), called) == ["overlay", "playback", "page"]
    assert done(job(film, first_frame=3), called) == ALL
    assert done(job(film, first_frame=3, start="analyse"), called) == ["analyse", "overlay", "playback", "page"]
    (film.parent / "points.csv").write_text((SAMPLES / "whole_cam1.csv").read_text())
    assert done(job(film, first_frame=3), called) == ALL
    Output(film.parent / "out", "report", overwrite=True).write("report.html", "of recon report")
    assert done(job(film, first_frame=3), called) == ["page"]
    (film.parent / "out" / "overlay.mp4").unlink()
    assert done(job(film, first_frame=3), called) == ["overlay"]
    write_film(film, frames=3)
    assert done(job(film, first_frame=3), called) == ["overlay", "playback", "page"]


def test_corrections_in_the_folder_are_used(film, called):
    done(job(film), called)
    out = film.parent / "out"
    (out / "corrections.csv").write_text("frame,keypoint,now_x_px,now_y_px\n3,nose,,\n")
    assert job(film).fit.corrections == out / "corrections.csv"
    assert done(job(film), called)[0] == "fit"
    assert done(job(film), called) == []
    assert (out / "corrections.csv").read_text().endswith("3,nose,,\n")
    chosen = film.parent / "mine.csv"
    shutil.copy(out / "corrections.csv", chosen)
    assert job(film, corrections=chosen).fit.corrections == chosen
    with refusal(("--corrections", "corrections", "a folder of videos", "corrections.csv in the folder")):
        RunSettings(video=film.parent, out=out, keypoints=film.parent, corrections=chosen)


def test_the_network_runs_again_only_if_it_changed(film, called):
    of_network = {"model": film.parent / "net"}
    assert done(job(film, **of_network), called) == ["detect", *ALL]
    assert done(job(film, **of_network), called) == []
    (film.parent / "net" / "model.pt").write_text("other weights")
    assert done(job(film, **of_network), called)[0] == "detect"
    assert (film.parent / "out" / "run_keypoints.csv").read_bytes() == (SAMPLES / "whole.csv").read_bytes()


def test_finished_stages_do_not_depend_on_the_working_directory(film, called, monkeypatch):
    monkeypatch.chdir(film.parent)
    camera = {"camera": SAMPLES / "camera.toml"}
    turns = RunSettings(video=Path("run.avi"), out=Path("out"), model=Path("net"), camera_motion="turns")
    here = job_of(turns, camera)
    assert done(here, called) == ["detect", "camera-motion", *ALL]
    assert done(here, called) == []
    monkeypatch.chdir("/")
    assert done(job(film, model=film.parent / "net", camera_motion="turns"), called) == []


def test_a_turning_camera_has_a_camera_motion_stage(film, called, monkeypatch):
    fitted, write = [], module.fit_into

    def noted(out: Path, settings, progress) -> dict:
        fitted.append(settings)
        return write(out, settings, progress)

    monkeypatch.setattr(module, "fit_into", noted)
    turning = {"camera_motion": "turns", "given": {"tilt_deg": 3.0}}
    assert done(job(film, **turning), called) == ["camera-motion", *ALL]
    assert fitted[0].camera_track == (film.parent.absolute() / "out" / "run_camera.csv",)
    assert fitted[0].tilt_deg is None
    assert done(job(film, **turning), called) == []
    assert done(job(film, camera_motion="zooms", given={"tilt_deg": 3.0}), called)[0] == "camera-motion"


def test_an_interrupted_stage_is_repeated(film, called, monkeypatch):
    def interrupted(*args, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("recon.cli.run.draw_overlay", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_video(job(film))
    assert called == ["fit", "analyse"]
    assert not (film.parent / "out" / ".recon-writing").exists()
    assert done(job(film), called) == ["overlay", "playback", "page"]


def test_files_of_a_user_are_not_replaced(film, called):
    out = film.parent / "out"
    out.mkdir()
    names = ("pose3d.csv", "report.html", "overlay.mp4", "analysis")
    for name in names[:3]:
        (out / name).write_text("mine")
        for more in ({}, {"overwrite": True}, {"start": "fit"}):
            with refusal((out / name, "file", "did not write, or that was changed", "moved away")):
                run_video(job(film, **more))
        assert (called, (out / name).read_text()) == ([], "mine")
        (out / name).unlink()
    assert done(job(film), called) == ALL
    for name in ("pose3d.csv", "report.html", "analysis/analysis.json"):
        before = (out / name).read_text()
        (out / name).write_text("corrected by hand")
        for more in ({}, {"overwrite": True}, {"start": "fit"}):
            called.clear()
            with refusal((out / name, "file", "did not write, or that was changed", "moved away")):
                run_video(job(film, **more))
            assert (called, (out / name).read_text()) == ([], "corrected by hand")
        (out / name).write_text(before)
    assert done(job(film), called) == []


def test_results_of_another_command_are_replaced_only_with_overwrite(film, called, small_trajectory):
    out = film.parent / "out"
    write_clip(small_trajectory, job(film).fit, out)
    with refusal((out / "pose3d.csv", "file", ["another command", "one of"], "--overwrite")):
        run_video(job(film))
    assert done(job(film, overwrite=True), called) == ALL
    assert not (out / "angles.csv").exists()


def test_a_fit_without_a_pose_gets_only_a_page(film, called, report, monkeypatch):
    nothing = json.loads(report)
    nothing["summary"] |= {"frames_with_pose": 0}
    nothing["unsolved"] = True

    def write(out: Path, settings, progress) -> dict:
        with output_of(settings, out, overwrite=True).staged() as folder:
            (folder / "report.json").write_text(json.dumps(nothing))
        return nothing

    monkeypatch.setattr("recon.cli.run.fit_into", write)
    monkeypatch.setattr("recon.cli.run.Motion.load", lambda folder: None)
    monkeypatch.setattr("recon.cli.run.build_report", lambda motion: nothing)
    ended = run(
        "run", film, "--camera", SAMPLES / "camera.toml", "--keypoints", film.parent / "points.csv",
        "--out", film.parent / "out",
    )  # fmt: skip
    assert ended.code == 1
    assert called == ["page"]
    assert says(ended.out, "analyse       left out", "too few frames")
    assert says(ended.err, "no frame")


def test_the_command_prints_the_outcome_of_each_stage(film, called):
    args = (
        "run", film, "--camera", SAMPLES / "camera.toml", "--keypoints", film.parent / "points.csv",
        "--out", film.parent / "out",
    )  # fmt: skip
    first, again = run(*args), run(*args)
    assert (first.code, first.err) == (0, "")
    assert "fit           4 files, " in first.out
    assert "overlay       overlay.mp4, " in first.out
    assert "overlay       overlay.mp4, as before" in again.out
    assert "8 of 8 with a pose" in again.out
    assert "report.html in a browser" in " ".join(again.out.split())
    shown = json.loads(run(*args, "--from", "page", "--json").out)
    assert [(stage["stage"], stage["status"]) for stage in shown["stages"]] == [
        ("fit", "unchanged"), ("analyse", "unchanged"), ("overlay", "unchanged"), ("playback", "unchanged"),
        ("page", "done"),
    ]  # fmt: skip
    assert shown["summary"]["frames"] == 8


def test_all_problems_are_reported_before_any_work(film, called):
    options = ("--camera-motion", "spins", "--from", "detekt")
    refused(
        ["run", film, "--out", film.parent / "out", *options],
        ("--camera-motion", "camera_motion", "'spins'", "turns or zooms"),
        ("--from", "start", "'detekt'", "detect, camera-motion, fit, analyse, overlay, playback or page"),
    )
    options = ("--camera-motion", "turns", "--fps", -1, "--keypoints", film.parent / "points.csv")
    no_lens = [("--camera", "camera", "nothing"), ("--camera-motion", "camera", "no camera file")]
    refused(["run", film, "--out", film.parent / "out", *options], ("--fps", "fps", "'-1'"), *no_lens)
    args = ["run", film, "--camera", "camera.toml", "--out", film.parent / "out"]
    refused(args, ("--keypoints", "keypoints", "nothing", "--model"))
    both = ["--keypoints", "a.csv", "--model", "net"]
    refused([*args, *both], ("--keypoints", "keypoints", "a.csv together with --model", "--model"))
    refused([*args, "--keypoints", "a.csv", "--from", "detect"], ("--from", "stage", "'detect'"))
    refused([*args, "--model", "none"], ("--model", "file", "no file none", "recon train"))
    assert called == []
    assert not (film.parent / "out").exists()


def test_a_video_of_another_size_is_refused_before_detection(film, monkeypatch):
    with refusal((film, "size", "64x48", "1920x1080")):
        run_video(job(film, model=film.parent / "net"))
    assert not (film.parent / "out" / "run_keypoints.csv").exists()


def test_a_video_of_another_size_is_refused_before_the_fit(film):
    with refusal((film, "size", "64x48", "1920x1080")):
        run_video(job(film))
    assert not (film.parent / "out" / "report.json").exists()


@pytest.mark.usefixtures("undrawn")
def test_all_stages_run_on_a_rendered_film(tmp_path, monkeypatch):
    """All stages run on the beginning of the rendered video, write the listed files, and are done afterwards."""
    page = '<meta name="generator" content="recon">'
    monkeypatch.setattr(
        "recon.cli.look.clip_page", lambda _, stills, behind, files, camera, *more: f"{page} {behind} {files}"
    )
    given = {"camera": SAMPLES / "rendered_camera.toml", "fast": True, "frames": "0:6"}
    job = job_of(
        RunSettings(video=SAMPLES / "rendered.mp4", out=tmp_path / "out", keypoints=SAMPLES / "rendered_points.csv"),
        given,
    )
    stages, shares = [], []
    done, _ = run_video(job, lambda what, share: shares.append((what.split(":")[0], share)), stages.append)
    assert done == stages
    assert [(stage.stage, stage.status) for stage in stages] == [(name, "done") for name in ALL]
    assert [*dict(shares)] == ALL
    assert shares == sorted(shares, key=lambda pair: pair[1])
    written = {path.relative_to(job.run.out).as_posix() for path in job.run.out.rglob("*") if path.is_file()}
    assert written == {name for stage in stages for name in stage.files} | {
        "run.jsonl",
        ".recon.json",
        "analysis/.recon.json",
    }
    assert "rendered.mp4 ['overlay.mp4', 'analysis/analysis.json'," in (job.run.out / "report.html").read_text()
    assert all(stage.status != "done" for stage in run_video(job)[0])


# Folders


def test_keypoint_files_are_matched_to_videos_by_name(tmp_path):
    for name in ("run.csv", "runDLC_resnet50.h5", "run2DLC_a.csv", "run2DLC_b.csv", "run3-labels.csv"):
        shutil.copy(SAMPLES / "whole.csv", tmp_path / name.replace(".h5", ".csv"))
    write_film(tmp_path / "run5.avi")
    shutil.copy(SAMPLES / "whole.csv", tmp_path / "run5DLC.csv")
    assert keypoints_of(tmp_path / "run5.avi", tmp_path) == tmp_path / "run5DLC.csv"
    for stem, found in (
        ("run", "run.csv, runDLC_resnet50.csv"),
        ("run2", "run2DLC_a.csv, run2DLC_b.csv"),
        ("run3", "none"),
    ):
        with refusal((tmp_path, f"keypoints of {stem}.mp4", found, stem)):
            keypoints_of(tmp_path / f"{stem}.mp4", tmp_path)


def test_a_folder_of_videos_is_run_as_a_batch(tmp_path, called, monkeypatch):
    def run_tasks(work, tasks, tell, **more) -> None:
        assert [job.threads for _, job in tasks] == [1] * len(tasks)
        run_tasks_here(work, pickle.loads(pickle.dumps(tasks)), tell, **more)

    monkeypatch.setattr("recon.cli.run.run_tasks", run_tasks)
    videos = tmp_path / "videos"
    videos.mkdir()
    for name in ("a", "b"):
        write_film(videos / f"{name}.avi")
        shutil.copy(SAMPLES / "whole.csv", videos / f"{name}.csv")
    args = ("run", videos, "--keypoints", videos, "--camera", SAMPLES / "camera.toml", "--out", tmp_path / "all")
    ended = run(*args)
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.count("] done  ") == 2
    assert called == ALL * 2
    (tmp_path / "all" / "b" / "overlay.mp4").write_text("mine")
    shown = json.loads(run(*args, "--json").out)
    assert called == ALL * 2
    assert [(clip["clip"], clip["status"], clip["frames_with_pose"]) for clip in shown["clips"]] == [
        ("a", "done earlier", 8), ("b", "failed", None),
    ]  # fmt: skip
    assert "b.csv" in shown["clips"][1]["keypoints"]
    table = (tmp_path / "all" / "summary.html").read_text()
    assert 'href="a/report.html"' in table
    (videos / "b.csv").unlink()
    with refusal((videos, "keypoints of b.avi", "none")):
        jobs_of(RunSettings(video=videos, out=tmp_path / "all", keypoints=videos), {"camera": SAMPLES / "camera.toml"})
    with refusal((tmp_path / "all", "files", "no videos", ".avi")):
        jobs_of(RunSettings(video=tmp_path / "all", out=tmp_path / "all", keypoints=videos), {})
    assert run_folder([], tmp_path / "none").counts() == {}
