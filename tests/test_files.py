"""Folders of outputs appear whole or not at all."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from recon.files import staged_folder


def contents(folder: Path) -> dict[str, str]:
    return {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()}


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


def test_namesakes_are_replaced_and_others_stay(tmp_path):
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


def test_exception_leaves_what_was_there(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "one.csv").write_text("old")
    with pytest.raises(RuntimeError):
        write_half(out, RuntimeError())
    assert [path.name for path in out.iterdir()] == ["one.csv"]
    assert (out / "one.csv").read_text() == "old"


def test_empty_folder_that_was_there_before_stays_after_an_exception(tmp_path):
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
        "from recon.files import staged_folder\n"
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
