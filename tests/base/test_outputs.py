"""Test that no command ever replaces or deletes a user's file, with or without --overwrite."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import copy_results, refusal, run, run_tasks_here
from users_files import REFUSED, contents, put_foreign, require_untouched

from recon import InputError
from recon.base.files import MANIFEST, read_manifest
from recon.base.locks import sole_writer
from recon.base.outputs import RECORD, Output, ReadResults, is_current, output_file, read_record
from recon.base.settings import Settings, input_paths
from recon.io.video import video_writer
from recon.show.page.own_page import PAGE

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
ROUNDS = 8
"""Number of times that each of two processes writes."""
CAMERA = ("--camera", SAMPLES / "camera.toml")
QUICK = ("--fps", 60, "--frames", "0:8", "--set", "fast=true")


def written(out: Path, kind: str = "fit", overwrite: bool = True, **files: str) -> None:
    """Write texts into the folder `out` as the command `kind` does."""
    with Output(out, kind, overwrite, has_manifest=True).staged() as folder:
        for name, text in files.items():
            (folder / f"{name}.csv").write_text(text)


def test_own_unchanged_files_are_replaced_and_obsolete_ones_go(tmp_path):
    (tmp_path / "notes.csv").write_text("mine")
    written(tmp_path, a="1", b="1")
    written(tmp_path, a="2", c="2")
    assert {*contents(tmp_path)} == {"a.csv", "c.csv", "notes.csv", MANIFEST}
    assert (tmp_path / "a.csv").read_text() == "2"
    assert {*read_record(tmp_path)} == {"a.csv", "c.csv", MANIFEST}
    assert read_manifest(tmp_path).kind == "fit"


def test_a_changed_file_is_refused_and_an_obsolete_one_that_was_changed_stays(tmp_path):
    written(tmp_path, a="1", b="1")
    (tmp_path / "a.csv").write_text("changed")
    before = contents(tmp_path)
    with refusal((tmp_path / "a.csv", "file", "`recon fit` did not write, or that was changed", "moved away")):
        written(tmp_path, a="2")
    assert contents(tmp_path) == before
    (tmp_path / "a.csv").write_text("1")
    (tmp_path / "b.csv").write_text("changed")
    written(tmp_path, a="2")
    assert (tmp_path / "b.csv").read_text() == "changed"


def test_another_command_s_files_are_not_replaced(tmp_path):
    written(tmp_path, "fit", a="1")
    with refusal((tmp_path / "a.csv", "file", f"; the same holds for {MANIFEST}", "another --out")):
        written(tmp_path, "retarget", a="2")
    assert (tmp_path / "a.csv").read_text() == "1"


def test_nothing_is_replaced_without_overwrite(tmp_path):
    written(tmp_path, a="1")
    with refusal(("--out", "folder", f"a.csv and 1 more in {tmp_path}", "a folder without results, or --overwrite")):
        written(tmp_path, overwrite=False, a="2")
    written(tmp_path / "new", overwrite=False, a="2")


@pytest.mark.skipif(os.name != "posix", reason="links need a privilege on Windows")
def test_links_are_not_followed_nor_replaced(tmp_path):
    (tmp_path / "precious.csv").write_text("mine")
    out = tmp_path / "out"
    written(out, b="1")
    for name, target in (("a.csv", "../precious.csv"), ("b.csv", "nowhere.csv")):
        (out / name).unlink(missing_ok=True)
        (out / name).symlink_to(target)
        before = contents(tmp_path)
        with refusal((out / name, "file", "a link", "moved away")):
            written(out, a="2", b="2")
        assert contents(tmp_path) == before
        (out / name).unlink()


def test_an_input_is_never_replaced_nor_removed(tmp_path):
    written(tmp_path, cameras="1", a="1")
    inputs = (tmp_path / "cameras.csv",)
    with (
        refusal((tmp_path / "cameras.csv", "file", "an input of this run", "another --out")),
        Output(tmp_path, "fit", True, inputs, has_manifest=True).staged() as folder,
    ):
        (folder / "cameras.csv").write_text("2")
    with Output(tmp_path, "fit", True, inputs, has_manifest=True).staged() as folder:
        (folder / "a.csv").write_text("2")
    assert (tmp_path / "cameras.csv").read_text() == "1"
    assert (tmp_path / "a.csv").read_text() == "2"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="children are forked")
@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.slow)])
def test_files_of_a_killed_run_are_recognised(tmp_path, step):
    """The run is killed at each step of moving files in turn, and the next run replaces its files."""
    for kill_at in range(1, 60, step):
        out = tmp_path / str(kill_at)
        written(out, a="1", b="1")
        child = os.fork()
        if child == 0:
            count = [0]
            for name in ("link", "replace", "unlink"):
                setattr(os, name, _killed(getattr(os, name), count, kill_at))
            written(out, a="2", b="2", c="2")
            os._exit(0)
        is_killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) < 0
        written(out, a="3", b="3")
        assert contents(out) == {"a.csv": "3", "b.csv": "3", MANIFEST: (out / MANIFEST).read_text()}, kill_at
        if not is_killed:
            break
    assert 10 < kill_at < 59


@pytest.mark.skipif(not hasattr(os, "fork"), reason="children are forked")
def test_the_second_of_two_simultaneous_writers_is_refused(tmp_path):
    children = []
    for text in ("1", "2"):
        child = os.fork()
        if child == 0:
            for _ in range(ROUNDS):
                with suppress(InputError):
                    written(tmp_path, **dict.fromkeys("abc", text))
            os._exit(0)
        children.append(child)
    assert [os.waitpid(child, 0)[1] for child in children] == [0, 0]
    assert read_manifest(tmp_path).changed() == []
    left = contents(tmp_path)
    assert {*left} == {"a.csv", "b.csv", "c.csv", MANIFEST}
    assert len({left[name] for name in ("a.csv", "b.csv", "c.csv")}) == 1


def _killed(function: Callable[..., object], count: list[int], last: int) -> Callable[..., object]:
    """Return a function that counts its calls, and kills its process just before call number `last`."""

    def step(*args: Any, **more: Any) -> object:
        count[0] += 1
        if count[0] == last:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*args, **more)

    return step


def test_results_of_version_0_2_are_known_by_their_manifest(tmp_path):
    """The manifest of version 0.2 does not state its command, and is the only record."""
    written(tmp_path, motion="1", old="1")
    (tmp_path / RECORD).unlink()
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    del manifest["kind"]
    (tmp_path / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
    other = Output(tmp_path, "retarget", True, has_manifest=True, mark="robot.csv")
    with refusal((tmp_path / "motion.csv", "file", "did not write", "moved")):
        other.require(("motion.csv",))
    fit = Output(tmp_path, "fit", True, has_manifest=True, mark="motion.csv")
    with fit.staged() as folder:
        (folder / "motion.csv").write_text("2")
    assert {*contents(tmp_path)} == {"motion.csv", MANIFEST}


@pytest.mark.parametrize("name", ["../thesis.tex", "/etc/thesis.tex", "..", "sub/thesis.tex", ""])
def test_manifest_that_names_files_elsewhere_is_refused(tmp_path, name):
    (tmp_path / "thesis.tex").write_text("mine")
    out = tmp_path / "out"
    written(out, a="1")
    manifest = json.loads((out / MANIFEST).read_text())
    manifest["files"][name] = {"size": 4, "sha256": "0"}
    (out / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
    with refusal((out / MANIFEST, "files", repr(name), "its own folder")):
        read_manifest(out)
    with refusal((out / MANIFEST, "file", "did not write, or that was changed", "moved")):
        written(out, a="2")
    record = json.loads((out / RECORD).read_text())
    record["files"][name] = record["files"]["a.csv"]
    (out / RECORD).write_text(json.dumps(record))
    with refusal((out / RECORD, "content", "another kind of file", "move this file away")):
        written(out, a="2")
    assert (tmp_path / "thesis.tex").read_text() == "mine"
    assert (out / "a.csv").read_text() == "1"


def test_file_that_is_not_a_record_is_left_alone(tmp_path):
    for text in (
        "mine",
        "[]",
        '{"schema": 1}',
        '{"schema": {"name": "recon.files", "version": 1}, "files": {"a": [1]}}',
    ):
        (tmp_path / RECORD).write_text(text)
        with refusal((tmp_path / RECORD, "content", "another kind of file", "move this file away")):
            written(tmp_path, a="1")
        assert (tmp_path / RECORD).read_text() == text


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of POSIX")
@pytest.mark.parametrize("name", [RECORD, MANIFEST, "a.csv"])
def test_pipe_in_place_of_a_file_does_not_block(tmp_path, name):
    written(tmp_path, a="1", b="1")
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    with refusal(
        (tmp_path / name, *{RECORD: ("content", "another kind of file")}.get(name, ("file", "did not write")))
    ):
        written(tmp_path, a="2")
    assert ReadResults.read(tmp_path).manifest is None or name != MANIFEST
    assert (tmp_path / "b.csv").read_text() == "1"


@pytest.mark.skipif(os.name != "posix", reason="links need a privilege on Windows")
@pytest.mark.parametrize("target", ["nowhere", "out"])
def test_a_folder_that_is_a_link_to_nothing_is_named(tmp_path, target):
    out = tmp_path / "out"
    out.symlink_to(target)
    for folder in (out, out / "deep"):
        with refusal(("--out", "folder", f"{out}, a link that points to nothing", "remove the link")):
            Output(folder, "fit").require()
    assert out.is_symlink()


def test_a_file_that_appears_or_changes_meanwhile_stays(tmp_path):
    written(tmp_path, a="1")
    with refusal((tmp_path / "b.csv", "file", "did not write", "moved")), Output(tmp_path, "fit", True).staged() as new:
        (new / "a.csv").write_text("2")
        (new / "b.csv").write_text("2")
        (tmp_path / "b.csv").write_text("mine")
    with refusal((tmp_path / "a.csv", "file", "did not write", "moved")), Output(tmp_path, "fit", True).staged() as new:
        (new / "a.csv").write_text("2")
        (tmp_path / "a.csv").write_text("mine")
    assert (tmp_path / "a.csv").read_text() == (tmp_path / "b.csv").read_text() == "mine"


def test_named_file_is_replaced_if_it_is_own(tmp_path):
    path = tmp_path / "camera.toml"
    for text in ("1", "2"):
        with output_file(path, "calibrate", overwrite=True).staged_file() as staged:
            staged.write_text(text)
    assert contents(tmp_path) == {"camera.toml": "2"}
    with refusal(("--out", "file", f"{path}, which exists already", "a new name, or --overwrite")):
        output_file(path, "calibrate", overwrite=False).require((path.name,))
    with refusal((path, "file", "an input of this run", "another --out")):
        output_file(path, "calibrate", overwrite=True, inputs=[tmp_path / "." / "camera.toml"]).require((path.name,))
    path.write_text("mine")
    for overwrite in (False, True):
        with refusal((path, "file", "`recon calibrate` did not write, or that was changed", "moved away")):
            output_file(path, "calibrate", overwrite).require((path.name,))


def test_record_drops_files_that_no_longer_exist(tmp_path):
    for name in ("a.trc", "b.trc"):
        with output_file(tmp_path / name, "convert", overwrite=False).staged_file() as staged:
            staged.write_text("1")
    (tmp_path / "a.trc").unlink()
    with output_file(tmp_path / "c.trc", "convert", overwrite=False).staged_file() as staged:
        staged.write_text("1")
    assert {*read_record(tmp_path)} == {"b.trc", "c.trc"}


def test_files_next_to_the_named_file_are_replaced_only_if_own(tmp_path):
    output = output_file(tmp_path / "camera.toml", "calibrate", overwrite=True)
    picture = tmp_path / "camera_coverage.png"
    for text in ("1", "2"):
        with output.staged(adds=True) as folder:
            (folder / "camera.toml").write_text(text)
            (folder / picture.name).write_text(text)
    assert contents(tmp_path) == {"camera.toml": "2", "camera_coverage.png": "2"}
    picture.write_text("mine")
    with refusal((picture, "file", "`recon calibrate` did not write", "moved away")):
        output.require(("camera.toml", picture.name))


def test_no_file_of_the_results_that_are_read_is_replaced(tmp_path):
    written(tmp_path, pose3d="1")
    (tmp_path / "mine.csv").write_text("mine")
    for name in ("pose3d.csv", "mine.csv"):
        output = output_file(tmp_path / name, "convert", True, [tmp_path], ReadResults.read(tmp_path))
        with refusal((tmp_path / name, "file", "`recon convert` did not write", "moved")):
            output.require((name,))
    for text in ("1", "2"):
        output = output_file(tmp_path / "new.csv", "convert", True, [tmp_path], ReadResults.read(tmp_path))
        with output.staged_file() as staged:
            staged.write_text(text)
    assert (tmp_path / "new.csv").read_text() == "2"


def test_inputs_are_the_existing_paths_of_the_settings(tmp_path):
    class Given(Settings):
        source: Path
        names: str = "whole"
        several: tuple[Path, ...] = ()
        out: Path | None = None

    for name in ("a", "b", "c"):
        (tmp_path / name).touch()
    found = input_paths(Given(source=tmp_path / "a", names=str(tmp_path / "b"), out=tmp_path / "c"))
    assert found == (tmp_path / "a", tmp_path / "b")
    assert input_paths(Given(source=tmp_path / ("x" * 200), names="x" * 5000, several=(tmp_path / "b",))) == (
        tmp_path / "b",
    )


def test_files_made_from_results_are_removed_with_them(tmp_path):
    out = tmp_path / "clip"

    def analysed(folder: Path, name: str, exact: bool = False) -> None:
        output = Output(folder, "analyse", True, made_from=ReadResults.read(out), exact=name if exact else None)
        with output.staged(adds=True) as staging:
            (staging / name).write_text("1")

    written(out, a="1")
    analysed(out / "analysis", "speeds.csv")
    analysed(out / "analysis", "forces.csv")
    analysed(out, "report.html")
    analysed(tmp_path / "elsewhere", "speeds.csv")
    assert is_current(out / "report.html", out)
    assert is_current(out / "analysis" / "speeds.csv", out)
    (out / "analysis" / "forces.csv").write_text("changed")
    written(out, a="2")
    assert {*contents(tmp_path)} == {f"clip/{name}" for name in ("a.csv", MANIFEST, "analysis/forces.csv")} | {
        "elsewhere/speeds.csv"
    }
    assert not is_current(out / "analysis" / "forces.csv", out)
    assert not is_current(tmp_path / "elsewhere" / "speeds.csv", out)


def test_nothing_is_written_from_results_replaced_meanwhile(tmp_path):
    out = tmp_path / "clip"
    written(out, a="1")
    for folder in (out, tmp_path / "analysis"):
        with (
            refusal((out, "results", "another run has replaced", "run the command again")),
            Output(folder, "analyse", True, made_from=ReadResults.read(out)).staged() as staging,
        ):
            (staging / "b.csv").write_text("of the earlier ones")
            written(out, a="2" if folder == out else "3")
        assert not (folder / "b.csv").exists()


@pytest.mark.skipif(os.name != "posix", reason="links need a privilege on Windows")
@pytest.mark.parametrize("kind", ["symlink", "hard link", "file", "folder", "fifo"])
def test_file_that_is_not_a_lock_is_left_alone(tmp_path, kind):
    precious, lock = tmp_path / "precious.csv", tmp_path / "out" / ".recon-writing"
    precious.write_text("1234\n" * 100)
    lock.parent.mkdir()
    make = {
        "symlink": lambda: lock.symlink_to(precious),
        "hard link": lambda: lock.hardlink_to(precious),
        "file": lambda: lock.write_text("my notes"),
        "folder": lambda: lock.mkdir(),
        "fifo": lambda: os.mkfifo(lock),
    }
    make[kind]()
    with refusal((lock, "lock", "not a lock file of recon", "remove it")), sole_writer(lock.parent):
        pass
    assert precious.read_text() == "1234\n" * 100
    assert os.path.lexists(lock)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="needs another user")
def test_another_user_s_lock_is_taken_if_it_is_stale_and_named_if_it_cannot_be_opened():
    reader, writer = os.pipe()
    with TemporaryDirectory() as name:
        Path(name).chmod(0o777)
        lock = Path(name) / ".recon-writing"
        for mode in (0o644, 0o600):
            lock.write_text("1\n")
            lock.chmod(mode)
            if (child := os.fork()) == 0:
                os.seteuid(65534)
                try:
                    with sole_writer(name):
                        os.write(writer, b"in")
                except InputError as error:
                    os.write(writer, str(error).encode())
                os._exit(0)
            os.waitpid(child, 0)
            said = os.read(reader, 1000).decode()
            assert said == "in" if mode == 0o644 else f"{lock}: lock: found a lock file of another user (root)" in said
            assert lock.exists() == (mode == 0o600)


Arguments = Sequence[object]


def commands(clip: Path, frame: Path) -> dict[str, tuple[Arguments, str]]:
    """Return the arguments of each command, and the name of a file that it writes.

    `clip` and `frame` are folders of results of fits.
    """
    return {
        "fit": (("fit", SAMPLES / "whole.csv", *CAMERA, *QUICK), "motion.npz"),
        "frame": (("frame", SAMPLES / "noisy.csv", *CAMERA, "--fps", 30, "--frames", "0:4"), "motion.npz"),
        "batch": (("batch", SAMPLES / "whole.csv", *CAMERA, *QUICK), "summary.csv"),
        "analyse": (("analyse", clip, "--no-figures"), "analysis.json"),
        "retarget": (("retarget", clip, "--robot", "a1"), "report.json"),
        "climb": (("climb", "--no-figures"), "report.json"),
        "ik": (("ik", clip, "--target", "stride-max", "--no-figures"), "ik.json"),
        "solver": (("solver", frame, "--no-figures"), "solver.json"),
        "camera-advice": (("camera-advice", "--skeleton", "cheetah-24", "--cameras", 1), "camera_advice.json"),
        "compare": (("compare", clip), "groups.csv"),
        "skeleton check": (("skeleton", "check", "cheetah-24"), "skeleton.png"),
    }


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in ("climb", "solver", "camera-advice", "retarget")))
        for name in commands(Path(), Path())
    ],
)
@pytest.mark.usefixtures("no_playback", "undrawn", "in_process", "remembered_analyses")
def test_no_command_touches_users_files_with_names_that_it_writes(whole_results, frame_results, tmp_path, name):
    """A first run, or the fixtures of fits, shows the names that a command writes.

    Before the second run, files of a user have these names.
    """
    arguments, sure = commands(whole_results, frame_results)[name]
    first = {"fit": whole_results, "frame": frame_results}.get(name, tmp_path / "first")
    if name not in ("fit", "frame"):
        ended = run(*arguments, "--out", first)
        assert ended.code in (0, 1), ended.err
    names = sorted(contents(first))
    assert sure in names
    mine = tmp_path / "mine"
    put_foreign(mine, [sure, *(file for file in names if file != sure)])
    before = contents(mine)
    for more in ((), ("--overwrite",)):
        ended = run(*arguments, "--out", mine, *more)
        assert ended.code == 2, ended
        assert REFUSED in ended.err
        assert contents(mine) == before
        assert RECORD not in {path.name for path in mine.rglob("*")}
    for file in names:  # one foreign file is enough
        (mine / file).unlink()
    (mine / sure).write_text("mine")
    assert run(*arguments, "--out", mine, "--overwrite").code == 2
    assert (mine / sure).read_text() == "mine"


def test_batch_leaves_a_users_files_in_the_folder_of_a_clip(tmp_path):
    put_foreign(tmp_path / "whole", ["motion.npz", "pose3d.csv", "report.json", "report.html", "manifest.json"])
    before = contents(tmp_path)
    arguments = ("batch", SAMPLES / "whole.csv", *CAMERA, *QUICK, "--out", tmp_path, "--jobs", 1)
    for more in ((), ("--overwrite",)):
        assert run(*arguments, *more).code in (1, 2)
        after = contents(tmp_path)
        assert {name: after.get(name) for name in before} == before


def files_and_commands(clip: Path, inputs: Path, mine: Path) -> dict[str, tuple[Arguments, Sequence[str]]]:
    """Return the arguments of each command that writes files of given names, and these names.

    `clip` has the results of a fit, `inputs` is a folder with other inputs, and `mine` is the folder to write to.
    """
    film, folder = inputs / "film.avi", ("--out", mine)
    two = (SAMPLES / "whole_cam1.csv", SAMPLES / "whole_cam2.csv", "--camera", SAMPLES / "whole_scene.json")
    fit = ("motion.npz", "pose3d.csv", "report.json", "config.toml", MANIFEST)
    video = (PAGE, "overlay.mp4", "analysis/analysis.json", "analysis/joints.csv")
    moving = ("film_camera.csv", "film_camera_report.json", "film_camera_panorama.png")
    turning = ("--model", inputs / "net", "--camera-motion", "turns")
    still = ("run", film, "--fps", 60, *CAMERA, *folder)
    return {
        "run": ((*still, "--keypoints", SAMPLES / "whole.csv"), (*fit, *video)),
        "run of a network": ((*still, *turning), ("film_keypoints.csv", *moving)),
        "demo": (("demo", *folder), (*fit, PAGE)),
        "calibrate": (
            ("calibrate", inputs, "--board", "chessboard:9x6:25mm", "--model", "radtan", "--out", mine / "lens.toml"),
            ("lens.toml", "lens_coverage.png"),
        ),
        "calibrate extrinsics": (
            ("calibrate", "extrinsics", *two, "--fps", 60, "--out", mine / "cameras.toml"),
            ("cameras.toml",),
        ),
        "camera-motion": (
            ("camera-motion", film, *CAMERA, "--out", mine / "track.csv"),
            ("track.csv", "track_report.json", "track_panorama.png"),
        ),
        **{
            f"convert {name}": (("convert", clip, mine / name), (name, *beside))
            for name, beside in {
                "a.csv": (),
                "a.trc": (),
                "a.c3d": (),
                "a.npz": (),
                "a.nc": (),
                "a.glb": (),
                "a.bvh": (),
                "a.osim": ("a.mot", "a.trc"),
            }.items()
        },
        "audit": (("audit", SAMPLES / "whole.csv", "--fps", 60, *folder), ("audit.csv", "audit.html")),
        "overlay": (("overlay", clip, "--video", film, "--out", mine / "o.mp4"), ("o.mp4",)),
        "view": (("view", clip, "--out", mine / "x.rrd"), ("x.rrd",)),
        "skeleton from-keypoints": (
            ("skeleton", "from-keypoints", SAMPLES / "whole.csv", "--out", mine / "new.toml"),
            ("new.toml",),
        ),
        "subject fit": (("subject", "fit", clip, "--out", mine / "cat.toml"), ("cat.toml",)),
        "prior fit": (("prior", "fit", clip, "--out", mine / "cat.npz"), ("cat.npz",)),
    }


@pytest.fixture(scope="module")
def other_inputs(tmp_path_factory):
    """Return a folder with a film of black pictures, which shows no board, and with the folder of a network."""
    folder = tmp_path_factory.mktemp("inputs")
    with video_writer(folder / "film.avi", (1920, 1080), 60.0) as write:
        write(np.zeros((1080, 1920, 3), np.uint8))
    cv2.imwrite(str(folder / "board.png"), np.zeros((48, 64, 3), np.uint8))
    (folder / "net").mkdir()
    (folder / "net" / "model.pt").write_text("weights")
    return folder


@pytest.mark.parametrize("name", files_and_commands(Path(), Path(), Path()))
def test_no_command_replaces_a_users_file_that_it_is_given(whole_results, other_inputs, tmp_path, name):
    """A command that would replace a user's file is refused before any work."""
    arguments, names = files_and_commands(whole_results, other_inputs, tmp_path / "mine")[name]
    require_untouched(arguments, tmp_path / "mine", names)


def test_no_page_replaces_a_users_file(whole_results, tmp_path, monkeypatch):
    """No page replaces a user's file, although `recon report` renews its own page without --overwrite."""
    monkeypatch.setattr("recon.cli.look.run_tasks", run_tasks_here)
    clip = copy_results(whole_results, tmp_path / "all" / "clip")
    put_foreign(clip, [PAGE, "summary.html"])
    before = contents(tmp_path)
    assert REFUSED in run("report", clip).err
    assert contents(tmp_path) == before
    (tmp_path / "all" / "summary.csv").write_text("clip,status,results\nclip,done,clip\n")
    put_foreign(tmp_path / "all", ["summary.html"])
    before = contents(tmp_path)
    assert run("report", tmp_path / "all").code in (1, 2)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "name",
    [
        "compare",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("skeleton check", "analyse", "retarget", "solver")),
    ],
)
@pytest.mark.usefixtures("no_playback", "undrawn")
def test_command_replaces_its_own_files(whole_results, frame_results, tmp_path, name):
    arguments, sure = commands(whole_results, frame_results)[name]
    for more in ((), ("--overwrite",)):
        assert run(*arguments, "--out", tmp_path / "out", *more).code in (0, 1)
        assert (tmp_path / "out" / sure).is_file()
    (tmp_path / "out" / sure).write_text("changed")
    assert run(*arguments, "--out", tmp_path / "out", "--overwrite").code == 2
    assert (tmp_path / "out" / sure).read_text() == "changed"
