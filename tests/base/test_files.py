"""Test that folders of outputs appear whole or not at all."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from command_line import refusal

from recon import InputError
from recon.base.files import read_manifest, staged_file, staged_folder
from recon.base.locks import sole_writer
from recon.base.outputs import RECORD, Output


def contents(folder: Path) -> dict[str, str]:
    """Return the text of every file in a folder except recon's record, by the file's path."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != RECORD)
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


def write_half(out: Path, exception: BaseException) -> None:
    with staged_folder(out) as folder:
        (folder / "one.csv").write_text("half")
        raise exception


def test_files_appear_together_when_the_block_ends(tmp_path):
    out = tmp_path / "a" / "b"
    with staged_folder(out) as folder:
        (folder / "one.csv").write_text("1")
        assert not (out / "one.csv").exists()
        (folder / "two.csv").write_text("2")
    assert contents(tmp_path) == {"a/b/one.csv": "1", "a/b/two.csv": "2"}
    assert sorted(path.name for path in out.iterdir()) == ["one.csv", "two.csv"]


def test_files_of_the_same_name_are_replaced_and_others_stay(tmp_path):
    (tmp_path / "one.csv").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "videos").mkdir()
    (tmp_path / "videos" / "clip.txt").write_text("film")
    with staged_folder(str(tmp_path)) as folder:
        (folder / "one.csv").write_text("new")
    assert contents(tmp_path) == {"one.csv": "new", "notes.txt": "mine", "videos/clip.txt": "film"}


@pytest.mark.parametrize("exception", [RuntimeError, KeyboardInterrupt, OSError])
def test_exception_leaves_nothing_behind(tmp_path, exception):
    with pytest.raises(exception):
        write_half(tmp_path / "a" / "b" / "c", exception())
    assert list(tmp_path.iterdir()) == []


def test_exception_leaves_earlier_files(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "one.csv").write_text("old")
    with pytest.raises(RuntimeError):
        write_half(out, RuntimeError())
    assert [path.name for path in out.iterdir()] == ["one.csv"]
    assert (out / "one.csv").read_text() == "old"


def test_earlier_empty_folder_stays_after_an_exception(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(RuntimeError):
        write_half(out, RuntimeError())
    assert list(out.iterdir()) == []


def test_folder_that_cannot_be_made_leaves_no_parents(tmp_path):
    with pytest.raises(OSError), staged_folder(tmp_path / "a" / ("x" * 300)):  # noqa: PT011 (its kind differs by system)
        pass
    assert list(tmp_path.iterdir()) == []


def test_folder_below_a_file(tmp_path):
    (tmp_path / "file").write_text("text")
    with pytest.raises(OSError), staged_folder(tmp_path / "file" / "out"):  # noqa: PT011 (its kind differs by system)
        pass
    assert contents(tmp_path) == {"file": "text"}


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is of POSIX")
def test_kill_leaves_only_a_hidden_folder_which_the_next_run_removes(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "one.csv").write_text("old")
    script = (
        "import os, signal, sys\n"
        "from recon.base.files import staged_folder\n"
        "with staged_folder(sys.argv[1]) as folder:\n"
        "    (folder / 'one.csv').write_text('half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    process = subprocess.run([sys.executable, "-c", script, str(out)], check=False)
    assert process.returncode == -signal.SIGKILL
    (hidden,) = (path for path in out.iterdir() if path.name != "one.csv")
    assert hidden.name.startswith(".recon-partial-")
    assert (out / "one.csv").read_text() == "old"
    with staged_folder(out) as folder:
        (folder / "two.csv").write_text("2")
    assert contents(out) == {"one.csv": "old", "two.csv": "2"}
    assert not hidden.exists()


def test_two_writers_do_not_disturb_each_other(tmp_path):
    with staged_folder(tmp_path) as first:
        (first / "one.csv").write_text("1")
        with staged_folder(tmp_path) as second:
            (second / "two.csv").write_text("2")
        assert contents(tmp_path)["two.csv"] == "2"
        with pytest.raises(RuntimeError):
            write_half(tmp_path, RuntimeError())
    assert contents(tmp_path) == {"one.csv": "1", "two.csv": "2"}


WRITE_AT_A_SIGN = """
import sys
from recon.base.files import staged_file
with staged_file(sys.argv[1]) as path:
    path.write_text("begun")
    print("begun", flush=True)
    sys.stdin.readline()
    path.write_text("done")
"""


def test_processes_do_not_remove_each_others_work(tmp_path):
    """Processes that overlap in time do not remove each other's files."""
    paths = [tmp_path / f"{k}.csv" for k in range(3)]
    processes = []
    for path in paths:
        command = [sys.executable, "-c", WRITE_AT_A_SIGN, str(path)]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        processes.append(process)
    for process in processes:
        process.communicate("\n")
        assert process.returncode == 0
    assert contents(tmp_path) == {f"{k}.csv": "done" for k in range(3)}


def test_only_one_process_writes_results(tmp_path):
    out = tmp_path / "out"
    with sole_writer(out):
        with refusal((out, "folder", f"another process ({os.getpid()})")), sole_writer(out):
            pass
        with sole_writer(tmp_path / "another"):
            pass
    with sole_writer(out):
        (out / "one.csv").write_text("1")
    assert contents(tmp_path) == {"out/one.csv": "1"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]  # nothing was written to the second folder


def test_the_folder_of_a_writer_that_died_is_free(tmp_path):
    (tmp_path / ".recon-writing").write_text("123\n")
    with sole_writer(tmp_path):
        assert (tmp_path / ".recon-writing").read_text() == f"{os.getpid()}\n"
    assert list(tmp_path.iterdir()) == []


def test_a_writer_waits_for_one_that_is_about_to_end(tmp_path):
    entered, done = threading.Event(), []

    def first():
        with sole_writer(tmp_path):
            entered.set()
            time.sleep(0.1)
            done.append("first")

    thread = threading.Thread(target=first)
    thread.start()
    entered.wait(300)
    with sole_writer(tmp_path, wait_s=300):
        done.append("second")
    thread.join()
    assert done == ["first", "second"]


def test_a_folder_that_cannot_be_written_to(tmp_path):
    (tmp_path / "file").write_text("text")
    with (
        refusal(("--out", "folder", f"the file {tmp_path / 'file'}", "folder")),
        sole_writer(tmp_path / "file" / "out"),
    ):
        pass


def write_results(out: Path, **files: str) -> None:
    with Output(out, "fit", overwrite=True, has_manifest=True).staged() as staging:
        for name, text in files.items():
            (staging / f"{name}.csv").write_text(text)


def test_results_come_with_a_manifest_and_replace_earlier_ones(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "c.csv").write_text("mine, too")
    write_results(tmp_path, a="1", b="2")
    assert {*contents(tmp_path)} == {"a.csv", "b.csv", "c.csv", "manifest.json", "notes.txt"}
    first = read_manifest(tmp_path)
    assert first.files["b.csv"] == (1, "d4735e3a265e16eee03f59718b9b5d03019c07d8b6c51f90da3a666eec13ab35")
    assert first.changed() == []
    write_results(tmp_path, a="3", other="4")
    assert {*contents(tmp_path)} == {"a.csv", "c.csv", "other.csv", "manifest.json", "notes.txt"}
    write_results(tmp_path, a="3")
    assert {*contents(tmp_path)} == {"a.csv", "c.csv", "manifest.json", "notes.txt"}


def test_folder_with_the_name_of_a_file_is_refused_before_any_change(tmp_path):
    write_results(tmp_path, a="1", c="1")
    before = contents(tmp_path)
    (tmp_path / "b.csv").mkdir()
    with refusal((tmp_path / "b.csv", "file", "a folder", "move")):
        write_results(tmp_path, a="2", b="2", c="2")
    with refusal((tmp_path / "b.csv", "file", "a folder", "move")):
        write_two(tmp_path)
    with refusal((tmp_path / "b.csv", "file", "a folder", "move")):
        Output(tmp_path, "fit", overwrite=True).require(("a.csv", "b.csv"))
    assert contents(tmp_path) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == [RECORD, "a.csv", "b.csv", "c.csv", "manifest.json"]


def write_two(out: Path) -> None:
    with staged_folder(out) as folder:
        (folder / "a.csv").write_text("2")
        (folder / "b.csv").write_text("2")


def steps_of_replacing(out: Path, monkeypatch: pytest.MonkeyPatch, at_step) -> None:
    """Replace results in `out`, and call `at_step(number)` before every move of a file."""
    write_results(out, a="1", b="1")
    count = itertools.count()

    def stepping(function):
        def step(*args):
            at_step(next(count))
            return function(*args)

        return step

    with monkeypatch.context() as patch:
        for name in ("replace", "link"):
            patch.setattr(os, name, stepping(getattr(os, name)))
        write_results(out, a="2", b="2", c="2")


@pytest.mark.parametrize("exception", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_failure_while_replacing_leaves_earlier_results(tmp_path, monkeypatch, exception):
    failing = 0

    def fail(number):
        if number == failing:
            raise exception

    raised = []
    for failing in range(10):
        out = tmp_path / str(failing)
        try:
            steps_of_replacing(out, monkeypatch, fail)
        except (OSError, KeyboardInterrupt):
            raised.append(failing)
        texts = {name: text for name, text in contents(out).items() if name != "manifest.json"}
        is_new = failing not in raised or failing == 8
        assert texts == ({"a.csv": "2", "b.csv": "2", "c.csv": "2"} if is_new else {"a.csv": "1", "b.csv": "1"})
        assert read_manifest(out).changed() == []
    # The moves are the record, three old files, four new files, the record. It is no error if the disk has no links, or
    # if it is full after all files have arrived.
    assert raised == ([0, 1, 2, 3] if isinstance(exception, OSError) else [*range(9)])


def test_kill_while_replacing_leaves_no_apparent_results(tmp_path, monkeypatch):
    """A process that is killed before any of the moves leaves nothing that looks like complete results."""
    out, taken = tmp_path / "out", []

    def look(number):
        try:
            manifest = read_manifest(out)
        except InputError:
            return
        if not manifest.changed():
            taken.append((number, contents(out)["a.csv"]))

    steps_of_replacing(out, monkeypatch, look)
    assert taken == [(0, "1"), (1, "1"), (8, "2")]  # the record is written first and last
    assert read_manifest(out).changed() == []


@pytest.mark.parametrize("stage", [staged_file, lambda path: staged_folder(path.parent)], ids=["file", "folder"])
def test_error_names_the_file_to_be_written(tmp_path, stage):
    """An error names the file to be written, and not the hidden staging folder, which no longer exists."""
    for error in (OSError(28, "No space left on device"), FileNotFoundError(2, "no such file", "elsewhere")):
        with pytest.raises(OSError, match=error.strerror) as caught, stage(tmp_path / "a.csv"):
            raise error
        own = "elsewhere" if error.errno == 2 else str(tmp_path / "a.csv" if stage is staged_file else tmp_path)
        assert caught.value.filename == own
    with pytest.raises(IsADirectoryError) as caught, stage(tmp_path / "a.csv") as staged:
        write_onto_a_folder(staged if stage is staged_file else staged / "a.csv")
    assert caught.value.filename == str(tmp_path / "a.csv")


def write_onto_a_folder(path: Path) -> None:
    path.mkdir()
    path.write_text("1")
