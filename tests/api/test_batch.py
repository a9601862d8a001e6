"""Test batches of clips: which clips they have, what is fitted again, and that a failed clip does not stop others."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from batches import CAMERA, QUICK, found, manifest, staging_folders, table
from command_line import refusal, refused, run, run_tasks_here, says

from recon import FitSettings, InputError, find_clips, fit_clip, plan_batch, run_batch
from recon.api.analysis_settings import AnalyseSettings
from recon.api.batch import RECORD, Summary, fit_planned, input_problems
from recon.api.batch_inputs import Clip
from recon.api.clip_results import Record, run_clip
from recon.base import parallel
from recon.base.locks import sole_writer
from recon.base.outputs import Output
from recon.base.parallel import Event, outcome_of
from recon.base.progress import silent
from recon.cli.analyse import analyse_command

pytestmark = pytest.mark.usefixtures("no_playback", "undrawn", "frames_solved_once")
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at processes in /proc")


# Clips that are fitted, skipped or fitted again


def fit(clips: list[Clip], out: Path, overwrite: bool = False) -> list[tuple[str, str]]:
    """Run the batch in this process, and return the planned action and its reason for each clip."""
    plan = plan_batch(clips, out, overwrite)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("recon.api.batch.run_tasks", run_tasks_here)
        summary = run_batch(plan, out)
    assert {*summary.counts()} <= {"done", "done earlier"}
    return [(planned.action, planned.reason) for planned in plan]


def test_finished_clips_are_recognised_by_content(clips, tmp_path):
    out, one = tmp_path / "out", clips / "a.csv"
    camera = shutil.copy(CAMERA, tmp_path / "camera.toml")
    assert fit(found(one, camera=camera), out) == [("new", "")]
    first = {path.name: path.read_bytes() for path in (out / "a").iterdir()}
    assert json.loads(first["report.json"])["summary"]["frames"] == 4

    os.utime(one, (1, 1))
    assert fit(found(one, camera=camera), out) == [("done", "")]
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    shutil.move(one, moved / "a.csv")
    shutil.move(camera, moved / "other.toml")
    camera = moved / "other.toml"
    assert fit(found(moved / "a.csv", camera=camera), out) == [("done", "")]
    shutil.move(moved / "a.csv", one)
    # the trajectory method's settings have no effect on the frame method
    config = tmp_path / "config.toml"
    config.write_text("[recon.fit]\nfast = true\n")
    assert plan_batch(find_clips([one], QUICK | {"camera": camera}, config)[0], out)[0].action == "done"
    assert {path.name: path.read_bytes() for path in (out / "a").iterdir()} == first

    def planned(overwrite: bool = False, **common: Any) -> tuple[str, str]:
        (clip,) = plan_batch(found(one, camera=camera, **common), out, overwrite)
        return clip.action, clip.reason

    for file, what in ((one, "keypoints"), (camera, "camera")):
        content = file.read_text()
        file.write_text(content + "# changed\n" * (file == camera) + "\n")
        assert planned() == ("refit", f"changed: {what}")
        file.write_text(content)
    assert planned(overwrite=True) == ("refit", "--overwrite")
    assert planned() == ("done", "")
    assert planned(fps=60, likelihood_min=0.6) == ("refit", "changed: fps, likelihood_min")
    one.write_text(one.read_text() + "\n")
    (out / "a" / "angles.csv").unlink()
    assert fit(found(one, camera=camera, fps=60), out) == [("refit", "changed: keypoints, fps")]
    (out / "a" / "angles.csv").unlink()
    assert fit(found(one, camera=camera, fps=60), out) == [("refit", "not complete")]
    assert planned(fps=60) == ("done", "")


def test_corrections_in_a_clip_s_folder_are_used(clips, tmp_path):
    out, clip = tmp_path / "out", found(clips / "a.csv")
    (out / "a").mkdir(parents=True)
    (out / "a" / "corrections.csv").write_text("frame,keypoint,now_x_px,now_y_px\n3,nose,,\n")
    (planned,) = plan_batch(clip, out)
    assert planned.clip.settings.corrections == out / "a" / "corrections.csv"
    assert "corrections" in planned.identity["inputs"]


def test_results_of_another_version_are_fitted_again(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    record = out / RECORD
    record.write_text(record.read_text().replace('"version": "', '"version": "0.0.'))
    assert plan_batch(found(clips / "a.csv"), out)[0].reason == "changed: version of recon"


def test_a_killed_fit_is_not_finished(clips, tmp_path):
    """A fit that was killed between the arrival of its results and the end of the record is not finished."""
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    started, finished = (out / RECORD).read_text().splitlines()
    for left in (started, f"{started}\n{finished[:-20]}"):  # the second record was cut off by a full disk
        (out / RECORD).write_text(left)
        assert plan_batch(found(clips / "a.csv"), out)[0].reason == "not finished before"
    assert fit(found(clips / "a.csv"), out) == [("refit", "not finished before")]
    assert fit(found(clips / "a.csv"), out) == [("done", "")]


def test_results_from_outside_the_batch_are_refused(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    run_clip(FitSettings(keypoints=clips / "b.csv", **QUICK), out / "b")  # a fit outside the batch
    run_clip(FitSettings(keypoints=clips / "a.csv", **QUICK), out / "a", overwrite=True)  # replaces a fit of the batch
    other = tmp_path / "other"
    other.mkdir()
    (other / "c.csv").write_text((clips / "c.csv").read_text())
    fit(found(other / "c.csv"), out)
    (clips / "c.csv").write_text((clips / "c.csv").read_text() + "\n")
    unknown = ("folder", "no batch has written", "--overwrite")
    with refusal((out / "a", *unknown), (out / "b", *unknown), (out / "c", "folder", f"results of {other / 'c.csv'}")):
        plan_batch(found(clips), out)
    assert [p.reason for p in plan_batch(found(clips), out, overwrite=True)] == ["--overwrite"] * 3


def test_files_added_after_the_fit_cause_no_new_fit(clips, tmp_path):
    """A clip is not fitted again after files are added to its results, but it is if results are missing.

    Results that somebody changed are not touched.
    """
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    analyse_command(AnalyseSettings(folder=out / "a", figures=False))
    (out / "a" / "notes.txt").write_text("of the user")
    (planned,) = plan_batch(found(clips / "a.csv"), out)
    assert planned.action == "done"
    table = (out / "a" / "pose3d.csv").read_bytes()
    (out / "a" / "pose3d.csv").write_bytes(table.replace(b"1", b"2", 1))  # the size of the file stays the same
    for overwrite in (False, True):
        with refusal((out / "a" / "pose3d.csv", "file", "did not write, or that was changed since", "moved away")):
            plan_batch(found(clips / "a.csv"), out, overwrite)
    (out / "a" / "pose3d.csv").unlink()
    assert fit(found(clips / "a.csv"), out) == [("refit", "not complete")]
    assert (out / "a" / "pose3d.csv").read_bytes() == table


def test_a_folder_in_use_by_another_process_is_refused(clips, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.api.batch.DYING_S", 0.0)
    out = tmp_path / "out"
    (planned,) = plan_batch(found(clips / "a.csv"), out)
    with sole_writer(out):
        with refusal((out, "folder", ["another process", os.getpid()], "wait")):
            run_batch([planned], out, jobs=1)
        with sole_writer(out / "a"):
            outcome = outcome_of(fit_planned, planned, silent)
    assert outcome["status"] == "failed"
    assert says(outcome["error"], f"{out / 'a'}: folder", "another process", os.getpid())
    assert not out.exists()


def test_a_failed_clip_keeps_its_earlier_results(clips, tmp_path, in_process):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    for name in "ab":
        (clips / f"{name}.csv").write_text("scorer,x\n")
    plan = plan_batch(found(clips / "a.csv", clips / "b.csv"), out)
    summary = run_batch(plan, out)
    for planned in plan:
        row = summary.rows[planned.clip.name]
        assert (row["status"], row["attempts"]) == ("failed", 1)
        assert row["error"].startswith(f"{planned.clip.settings.keypoints_text}: header: ")
    assert sorted(path.name for path in out.iterdir() if path.is_dir()) == ["a"]
    assert (out / "a" / "pose3d.csv").is_file()
    assert plan_batch(found(clips / "a.csv"), out)[0].reason == "not finished before"


def test_another_version_on_the_worker_fails_the_clip(clips, tmp_path):
    (planned,) = plan_batch(found(clips / "a.csv"), tmp_path / "out")
    planned = replace(planned, identity={**planned.identity, "version": "99"})
    outcome = outcome_of(fit_planned, planned, silent)
    assert outcome["status"] == "failed"
    assert says(outcome["error"], 99)
    assert not (tmp_path / "out" / "a").exists()


def test_a_new_batch_reduces_the_record_to_one_row_per_clip(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv", clips / "b.csv"), out)
    assert len((out / RECORD).read_text().splitlines()) == 4
    before = Record(out / RECORD).rows
    with (out / RECORD).open("a") as file:
        # A row of another version, and a row that is cut off.
        file.write('{"schema": 1, "part": 3}\n{"part": "a", "sch')
    assert fit(found(clips), out) == [("done", ""), ("done", ""), ("new", "")]
    rows = [json.loads(line) for line in (out / RECORD).read_text().splitlines()]
    assert [(row["part"], "files" in row) for row in rows] == [("a", True), ("b", True), ("c", False), ("c", True)]
    assert Record(out / RECORD).rows.items() > before.items()


def test_a_damaged_record_is_reported_with_line_and_field(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    row = Record(out / RECORD).rows["a"]
    spoilt: list[tuple[object, str, Any]] = [
        (row | {"identity": {"inputs": [], "version": 2}}, "identity.inputs", "a table"),
        (row | {"files": ["manifest.json"]}, "files", "a table"),
        (row | {"keypoints": 3}, "keypoints", "a list"),
        ([], "content", "a table"),
    ]
    for line, field, expected in spoilt:
        (out / RECORD).write_text(f"{json.dumps(row)}\n{json.dumps(line)}\n")
        with pytest.raises(InputError) as caught:
            plan_batch(found(clips / "a.csv"), out)
        first = caught.value.problems[0]
        assert (first.file, first.field, first.expected) == (f"{out / RECORD}, line 2", field, expected)
    (out / RECORD).write_text(f"nonsense\n{json.dumps(row)}\n")
    with refusal((f"{out / RECORD}, line 1", "content")):
        plan_batch(found(clips / "a.csv"), out)
    (out / RECORD).write_text(json.dumps(row | {"row": {"status": "done", "pose_mm": "wide", "verdict": ["use"]}}))
    where = f"{out / RECORD}, row of a"
    refused(args(clips / "a.csv", out), (where, "pose_mm", "wide", "number"), (where, "verdict", "use", "text"))
    del row["row"]
    (out / RECORD).write_text(json.dumps(row))
    assert plan_batch(found(clips / "a.csv"), out)[0].action == "refit"


def test_a_damaged_summary_is_reported_with_line_and_column(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    summary = out / "summary.csv"
    kept = summary.read_text()
    summary.write_text(kept.replace(",4,4,", ",6,many,").replace("frames,", "rows,", 1))
    refused(["report", out], (f"{summary}, line 2", "frames_with_pose", "many", "number"))
    summary.write_text(kept.replace("clip,", "name,"))
    refused(["report", out], (f"{summary}, line 2", "clip", "nothing", "text"))


def test_input_problems_are_listed_by_clip(clips, tmp_path):
    (clips / "a.csv").write_text("scorer,x\n")
    (clips / "b.csv").unlink()
    path = manifest(clips, "keypoints,camera\na.csv,none.toml\nb.csv,\nc.csv,\n")
    first, second, third = input_problems(found(path))
    assert [Path(p.file).name for p in first] == ["a.csv", "none.toml"]
    assert [p.found for p in second] == ["no such file"]
    assert third == ()


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"tilt_deg": 5}, "tilt_deg"),
        ({"side": "left", "method": "trajectory"}, "side"),
        ({"skeleton": "dog-27"}, "name or file"),
        ({"frames": "900:950"}, "frames"),
        ({"camera": None, "hfov_deg": 60, "image_size_px": "300x200"}, "image size"),
    ],
)
def test_a_batch_reports_the_same_input_problems_as_a_fit(clips, wrong, field):
    (clip,) = found(clips / "a.csv", **wrong)
    with pytest.raises(InputError) as caught:
        fit_clip(clip.settings)
    (seen,) = input_problems([clip])
    assert seen == caught.value.problems
    assert [problem.field for problem in seen] == [field]


def test_a_problem_of_many_clips_is_reported_once(clips, tmp_path):
    """A problem that many clips share is stated once, even if each clip has its own camera file."""
    plain = "matrix = [[1600, 0, 960], [0, 1600, 540], [0, 0, 1]]\nsize = [1920, 1080]\ndistortions = [0, 0, 0, 0, 0]\n"
    pose = "rotation = [0, 0, 0]\ntranslation = [0, 0, 0]\n"
    for name in "abc":
        two = "".join(f'[{camera}]\nname = "{camera}"\n{plain}{pose}' for camera in ("cam_a", "cam_b"))
        (clips / f"{name}.toml").write_text(two)
    path = manifest(clips, "keypoints,camera\na.csv,a.toml\nb.csv,b.toml\nc.csv,c.toml\n")
    command = ["batch", path, "--set", "method=frame", "--fps", 30, "--out", tmp_path / "out"]
    three = f"{clips / 'a.toml'} and 2 more files"
    (problem,) = refused(command, (three, "camera", "2 cameras", ["cam_a, cam_b", "--camera-name"]))
    assert not (tmp_path / "out").exists()
    ended = run(*command, "--dry-run")
    assert f"a, b, c: {problem}" in ended.out
    assert ended.out.count("none of them chosen") == 1
    assert says(ended.out, "3 clips", "0 new", "0 to fit", "0 done", "3 that cannot")


# Processes


def killer(*, once: str = "", always: str = "") -> Any:
    """Return an event handler that kills the worker of a clip: once, at its first progress, or always."""
    killed: set[int] = set()

    def on_event(event: Event, summary: Summary) -> None:
        wanted = event.name == always or (event.name == once and not killed)
        if event.kind == "progress" and wanted and event.pid not in killed:
            assert event.pid is not None
            if event.name == once:
                killed.add(event.pid)
            os.kill(event.pid, signal.SIGKILL)

    return on_event


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is of POSIX")
def test_a_crash_fails_only_its_clip(clips, tmp_path):
    (clips / "broken.csv").write_text("scorer,x\n")
    (clips / "empty.csv").touch()
    shutil.copy(clips / "a.csv", clips / "d.csv")
    out = tmp_path / "out"
    plan = plan_batch(found(clips / "*.csv"), out)
    on_event = killer(once="a")
    also = killer(always="b")

    def both(event: Event, summary: Summary) -> None:
        on_event(event, summary)
        if event.name != "a":
            also(event, summary)

    run_batch(plan, out, jobs=2, retries=1, on_event=both)
    rows = table(out)
    assert {name: (row["status"], row["attempts"]) for name, row in rows.items()} == {
        "a": ("done", "2"),
        "b": ("failed", "2"),
        "broken": ("failed", "1"),
        "c": ("done", "1"),
        "d": ("done", "1"),
        "empty": ("failed", "1"),
    }
    assert says(rows["b"]["error"], "SIGKILL", "memory")
    assert says(rows["empty"]["error"], f"{clips / 'empty.csv'}: file", "empty")
    assert (out / "b" / "crash.log").read_text().startswith(rows["b"]["error"])
    assert staging_folders(out) == []

    report = json.loads((out / "c" / "report.json").read_text())
    row, speeds = rows["c"], report["root_path"]["smoothed"] or report["root_path"]["exact"]
    assert row["keypoints"] == "../clips/c.csv"  # from the summary's folder
    assert row["out"] == "c"
    assert row["frames"] == row["frames_with_pose"] == "4"
    assert float(row["mean_reprojection_px"]) == report["summary"]["reprojection_px"]["mean"]
    assert int(row["outliers"]) == report["summary"]["outliers"]
    assert row["corrected"] == "0"
    assert float(row["peak_speed_m_s"]) == speeds["peak_speed_m_s"]
    assert float(row["mean_speed_m_s"]) == speeds["mean_speed_m_s"]
    assert row["size"] == ""
    assert rows["d"]["inputs_hash"] == rows["c"]["inputs_hash"] != rows["broken"]["inputs_hash"]
    assert len({row["settings_hash"] for row in rows.values()}) == 1

    again = plan_batch(found(clips / "*.csv"), out)
    assert [planned.action for planned in again] == ["done", "new", "new", "done", "done", "new"]


def test_failed_clips_are_fitted_again(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    speed = str(Record(out / RECORD).rows["a"]["row"]["peak_speed_m_s"])
    Output(out / "b", "batch").write("crash.log", "the worker was killed")
    Output(out / "a", "batch").write("crash.log", "of a user")
    (out / "a" / "crash.log").write_text("mine")
    assert fit(found(clips / "[ab].csv"), out) == [("done", ""), ("new", "")]
    rows = table(out)
    assert (rows["a"]["status"], rows["a"]["attempts"], rows["b"]["status"]) == ("done earlier", "0", "done")
    assert rows["a"]["peak_speed_m_s"] == speed
    assert not (out / "b" / "crash.log").exists()
    assert (out / "a" / "crash.log").read_text() == "mine"


# Command line


def args(clips: Path, out: Path, *more: object) -> list[object]:
    given = [f"--{name}={value}" for name, value in QUICK.items() if name != "method"]
    return ["batch", clips, *given, "--set", f"method={QUICK['method']}", "--out", out, *more]


def test_dry_run_writes_nothing(clips, tmp_path):
    out = tmp_path / "out"
    (clips / "c.csv").write_text("scorer,x\n")
    fit(found(clips / "a.csv", clips / "b.csv"), out)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    ended = run(*args(clips, out, "--dry-run", "--json"))
    rows = json.loads(ended.out)["clips"]
    assert [(row["clip"], row["action"]) for row in rows] == [("a", "done"), ("b", "done"), ("c", "cannot be fitted")]
    assert rows[2]["out"] == str(out / "c")
    assert len(rows[2]["problems"]) == 1
    assert "header" in rows[2]["problems"][0]
    assert (ended.code, run(*args(clips, out, "--dry-run", "--strict")).code) == (0, 1)
    ended = run(*args(clips, out, "--dry-run", "--fps", 60))
    assert says(ended.out, "3 clips", "0 new", "2 to fit", "0 done", "1 that cannot")
    assert "refit (changed: fps)" in ended.out
    assert says(ended.out, "--camera and --fps")
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_command(clips, tmp_path, in_process):
    """The command prints a line for each clip, obeys --strict and prints the summary as JSON."""
    out = tmp_path / "out"
    (clips / "c.csv").write_text("scorer,x\n")
    fit(found(clips / "a.csv", clips / "b.csv"), out)
    ended = run(*args(clips, out))
    assert ended.code == 0
    assert ended.out.startswith("2 of 3 clips are done already.\n")
    rows_of_table = [line.split()[:2] for line in ended.out.split("\n")[1:] if line.startswith("  ") and line.strip()]
    assert rows_of_table[-3:] == [["c", "failed"], ["a", "check"], ["b", "check"]]
    assert '\n3 clips: 2 "check", 1 failed, in ' in ended.out
    assert says(ended.out, f"Open {out / 'summary.html'}", f"recon report {out}/CLIP", f"recon compare {out} --out")
    assert ended.err.startswith(f"[1/1] failed  c: {clips / 'c.csv'}: header: ")
    ended = run(*args(clips, out, "--strict", "--quiet", "--json"))
    assert ended.code == 1
    summary = json.loads(ended.out)
    assert summary["counts"] == {"done earlier": 2, "failed": 1}
    assert [row["clip"] for row in summary["clips"]] == ["a", "b", "c"]
    assert {name: row["status"] for name, row in table(out).items()} == {
        "a": "done earlier",
        "b": "done earlier",
        "c": "failed",
    }


def test_unusable_input_ends_a_batch_before_any_work(clips, tmp_path):
    out = tmp_path / "out"
    command = ["batch", clips, "--fps", 30, "--out", out]
    refused(command, ("--camera", "camera", "nothing"))
    wrong = ["--camera", clips / "none.toml", "--skeleton", "unicorn"]
    refused([*command, *wrong], ("none.toml", "file", "no such file"), ("--skeleton", "name or file", "'unicorn'"))
    (tmp_path / "file").touch()
    refused(args(clips, tmp_path / "file"), ("--out", "folder", tmp_path / "file"))
    assert not out.exists()


def workers(pid: int) -> list[int]:
    """Return the child processes that fit clips, without Python's own helper process."""
    lists = Path(f"/proc/{pid}/task").glob("*/children")
    children = [int(child) for path in lists for child in path.read_text().split()]
    return [child for child in children if b"resource_tracker" not in Path(f"/proc/{child}/cmdline").read_bytes()]


def wait_for(condition: Any, seconds: float = 300) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


def statuses(out: Path) -> list[str]:
    return [row["status"] for row in table(out).values()] if (out / "summary.csv").exists() else []


HELD = """
import signal, time
from recon.api.batch import Summary
from recon.api.clip_results import Record
from recon.cli.app import main

# Where the tests run in the background, Ctrl-C is ignored, and children inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
Summary.write_if_due = Summary.write
note, begun = Record.note, []

def note_and_wait(self, part, made_from, **details):
    note(self, part, made_from, **details)
    if "files" not in details:
        begun.append(part)
    if len(begun) == 2:
        begun.append("")
        time.sleep(300)

Record.note = note_and_wait
main()
"""
"""Program that runs `recon batch` and waits after starting two clips, until a test stops it."""


@pytest.fixture
def in_the_middle(clips, tmp_path) -> Iterator[tuple[subprocess.Popen[str], Path, list[object]]]:
    """Start `recon batch` on four clips, and yield the process, its folder and its arguments after the first clip."""
    shutil.copy(clips / "a.csv", clips / "d.csv")
    command = args(clips, tmp_path / "out", "--jobs", 1)
    code = [sys.executable, "-c", HELD, *map(str, command)]
    with subprocess.Popen(code, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            wait_for(lambda: "done" in statuses(tmp_path / "out"))
            yield process, tmp_path / "out", command
        finally:
            process.kill()


def finished(out: Path) -> dict[str, int]:
    """Return the time, ns, at which the report of each finished clip was written, by clip."""
    done = [name for name, row in Record(out / RECORD).rows.items() if "files" in row]
    return {name: (out / name / "report.json").stat().st_mtime_ns for name in done}


def some_left(clips: Path, done: dict[str, int]) -> int:
    """Delete all unfinished clips but one, and return how many are left: 1 or 0."""
    left = sorted(path for path in clips.glob("*.csv") if path.stem not in done)
    for path in left[1:]:
        path.unlink()
    return len(left[:1])


@pytest.mark.slow
@linux
def test_ctrl_c_keeps_finished_clips(clips, in_the_middle, in_process):
    process, out, command = in_the_middle
    (worker,) = workers(process.pid)
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate(timeout=300)
    assert process.returncode == 130
    assert not Path(f"/proc/{worker}").exists()
    done = finished(out)
    assert 1 <= len(done) <= 2
    assert sorted(statuses(out)) == ["done"] * len(done) + ["pending"] * (4 - len(done))
    (line,) = errors.splitlines()
    assert says(line, "Stopped", f"{len(done)} done, {4 - len(done)} pending", "same command again")
    assert "Traceback" not in said
    assert staging_folders(out) == []
    assert sorted(path.name for path in out.iterdir() if path.is_dir()) == sorted(done)
    left = some_left(clips, done)
    assert run(*command).code == 0
    assert statuses(out) == ["done earlier"] * len(done) + ["done"] * left
    assert finished(out).items() >= done.items()


@pytest.mark.slow
@linux
def test_after_a_kill_finished_clips_are_not_fitted_again(clips, in_the_middle, in_process):
    process, out, command = in_the_middle
    (worker,) = workers(process.pid)
    process.kill()
    wait_for(lambda: not Path(f"/proc/{worker}").exists() or "Z" in Path(f"/proc/{worker}/stat").read_text().split())
    done = finished(out)
    assert 1 <= len(done) <= 2
    left = some_left(clips, done)
    assert run(*command).code == 0
    assert statuses(out).count("done earlier") == len(done)
    assert statuses(out).count("done") == left
    assert finished(out).items() >= done.items()
    assert staging_folders(out) == []


# A cluster


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Start two Dask workers, each a process with one thread."""
    distributed = pytest.importorskip("distributed")
    with (
        warnings.catch_warnings(action="default"),  # Dask raises warnings of its own
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
    ):
        yield cluster


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # Dask raises warnings of its own
def test_a_batch_runs_on_a_dask_cluster(clips, tmp_path, cluster):
    (clips / "broken.csv").write_text("scorer,x\n")
    out = tmp_path / "out"
    plan = plan_batch(found(clips / "*.csv"), out)
    pids = {one.worker_address: one.pid for one in cluster.workers.values()}
    killed: list[int] = []

    def kill_one(event: Event, summary: Summary) -> None:
        if summary.rows[event.name]["status"] == "done" and not killed:
            nanny = next(iter(cluster.workers.values()))
            pid = pids[nanny.worker_address]
            nanny.close_gracefully()  # so that no new worker is started
            killed.append(pid)
            os.kill(pid, signal.SIGKILL)

    run_batch(plan, out, scheduler=cluster.scheduler_address, on_event=kill_one)
    assert killed
    rows = table(out)
    assert {name: row["status"] for name, row in rows.items()} == {
        **dict.fromkeys("abc", "done"),
        "broken": "failed",
    }
    assert set(finished(out)) == set("abc")
    assert [planned.action for planned in plan_batch(found(clips / "*.csv"), out)].count("done") == 3


@pytest.fixture
def certificates(tmp_path) -> dict[str, str]:
    """Write Dask's settings of an encrypted cluster, with one key and a self-signed certificate for all."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("no openssl")
    key, certificate = str(tmp_path / "key.pem"), str(tmp_path / "certificate.pem")
    made = ("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost")
    subprocess.run([openssl, *made, "-keyout", key, "-out", certificate], check=True, capture_output=True)
    own = {
        f"distributed.comm.tls.{who}": {"key": key, "cert": certificate} for who in ("scheduler", "worker", "client")
    }
    return {"distributed.comm.tls.ca-file": certificate, "distributed.comm.require-encryption": True} | own


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # Dask raises warnings of its own
def test_a_cluster_with_certificates(clips, tmp_path, certificates):
    """A batch connects to an encrypted cluster with the certificates of Dask's configuration, and not without."""
    dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
    one, out = clips / "a.csv", tmp_path / "out"
    with dask.config.set(certificates):
        how = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None, "protocol": "tls://"}
        cluster = distributed.LocalCluster(**how, processes=False, security=distributed.Security())
    with cluster:
        assert cluster.scheduler_address.startswith("tls://")
        at = cluster.scheduler_address
        refused(args(one, out, "--scheduler", at), ("--scheduler", at, "TLS", ["tls://", "distributed.comm.tls"]))
        with dask.config.set(certificates):
            ended = run(*args(one, out, "--scheduler", cluster.scheduler_address))
        assert (ended.code, statuses(out)) == (0, ["done"])


def test_an_unreachable_cluster_is_reported(clips, tmp_path):
    pytest.importorskip("distributed")
    nonsense = "nonsense://here"
    refused(args(clips, tmp_path / "out", "--scheduler", nonsense), ("--scheduler", nonsense, "nonsense", "tcp://"))


@pytest.mark.parametrize("scheme", ["tcp", "tls"])
def test_a_silent_scheduler_ends_with_a_message(scheme, monkeypatch):
    pytest.importorskip("distributed")

    monkeypatch.setattr(parallel, "CONNECT_S", 0.3)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        began = time.monotonic()
        at = f"{scheme}://127.0.0.1:{silent.getsockname()[1]}"
        found, expected = ("0.3 s", "tcp://") if scheme == "tcp" else ("TLS", "distributed.comm.tls")
        with refusal(("--scheduler", at, found, expected)):
            parallel._client(at)
        assert time.monotonic() - began < 60  # without the limit it would never end
