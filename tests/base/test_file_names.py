"""Test file names that are not UTF-8, closed or ASCII streams, and folders without write permission."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from command_line import run

from recon import find_clips
from recon.base.errors import printable
from recon.base.file_names import encodable, existing_path, to_encodable

pytestmark = pytest.mark.usefixtures("no_playback")

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "data" / "samples"
FIT = ("--camera", SAMPLES / "camera.toml", "--fps", 60, "--frames", "0:4", "--set", "fast=true")
LATIN_1 = os.fsdecode(b"caf\xe9")


@pytest.fixture
def latin_1(tmp_path):
    """Return a keypoint file whose name is not UTF-8."""
    path = tmp_path / f"{LATIN_1}.csv"
    try:
        shutil.copy(SAMPLES / "whole.csv", path)
    except (OSError, UnicodeError):
        pytest.skip("names are Unicode here")
    return path


IN_TURN = """
import sys
from recon.__main__ import main
for command in " ".join(sys.argv[1:]).split(" then "):
    sys.argv = ["recon", *command.split()]
    try:
        main()
    except SystemExit as ended:
        print("ended with", ended.code or 0, file=sys.stderr)
"""
"""Python code that runs several commands in one process, because a process takes long to start."""


def process(*args: object, shell: str = "") -> subprocess.CompletedProcess:
    """Run `recon ARGS` in its own process; `shell` is appended to the command, such as a redirection."""
    command = ["bash", "-c", f'"$@" {shell}', "bash", sys.executable, "-m", "recon", *map(str, args)]
    env = {**os.environ, "COLUMNS": "80", "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, capture_output=True, env=env, check=False, timeout=300)


def test_a_name_is_written_and_read_again(tmp_path):
    assert encodable("café") == "café"
    assert encodable(LATIN_1) == r"caf\xe9" == printable(LATIN_1)
    assert encodable("a\ud800b") == r"a\ud800b"
    assert to_encodable({LATIN_1: [LATIN_1, 1, None]}) == {r"caf\xe9": [r"caf\xe9", 1, None]}
    assert existing_path(str(tmp_path / r"caf\xe9")) == str(tmp_path / r"caf\xe9")


def test_name_with_bytes_and_text_like_codes_is_found_again(tmp_path):
    path = tmp_path / (LATIN_1 + r"\xe9\xff")
    try:
        path.touch()
    except (OSError, UnicodeError):
        pytest.skip("names are Unicode here")
    assert existing_path(encodable(str(path))) == str(path)
    many = str(tmp_path / (r"\xe9" * 60))  # the search for a name ends
    assert existing_path(many) == many


def test_a_name_that_is_not_utf_8_is_escaped_in_every_file(latin_1, tmp_path, undrawn):
    out = tmp_path / "out"
    assert run("fit", latin_1, *FIT, "--out", out, "--quiet").code == 0
    config = tomllib.loads((out / "config.toml").read_text(encoding="utf-8"))
    report = (out / "report.json").read_text(encoding="utf-8")
    assert config["recon"]["fit"]["keypoints"] == r"../caf\xe9.csv"
    assert r'"keypoints": "caf\\xe9.csv"' in report
    assert run("report", out, "--quiet").code == 0
    assert r"caf\xe9.csv" in (out / "report.html").read_text(encoding="utf-8")
    again = run("fit", "--config", out / "config.toml", "--out", tmp_path / "again", "--quiet")
    assert again.code == 0, again
    assert (tmp_path / "again" / "pose3d.csv").read_bytes() == (out / "pose3d.csv").read_bytes()


@pytest.mark.slow
def test_a_batch_goes_on_with_a_name_that_is_not_utf_8(latin_1, tmp_path):
    shutil.copy(SAMPLES / "whole.csv", tmp_path / "right.csv")
    args = ("batch", tmp_path / "*.csv", *FIT, "--out", tmp_path / "results", "--jobs", 1)
    assert run(*args, "--quiet").code == 0
    with (tmp_path / "results" / "summary.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["clip"]: row for row in csv.DictReader(file)}
    assert {name: row["status"] for name, row in rows.items()} == {"caf_xe9": "done", "right": "done"}
    assert rows["caf_xe9"]["keypoints"] == r"../caf\xe9.csv"
    again = run(*args, "--dry-run", "--json")
    assert {clip["action"] for clip in json.loads(again.out)["clips"]} == {"done"}


def test_folder_of_a_clip_has_a_valid_name(tmp_path):
    """File systems accept the name of a clip's folder, even if keypoint files have long names or escaped bytes."""
    names = [os.fsdecode(b"\xe9" * 240 + b"-%d.csv" % number) for number in range(2)] + ["ä" * 120 + ".csv"]
    try:
        for name in names:
            shutil.copy(SAMPLES / "whole.csv", tmp_path / name)
    except (OSError, UnicodeError):
        pytest.skip("names are Unicode here")
    clips, _ = find_clips([tmp_path], {"camera": SAMPLES / "camera.toml", "fps": 60})
    assert len({clip.name for clip in clips}) == 3
    for clip in clips:
        (tmp_path / clip.name).mkdir()


def test_video_whose_name_is_not_utf_8_is_refused(tmp_path):
    """A video whose name is not UTF-8 is refused, because OpenCV would crash."""
    from recon.io.video import probe

    path = tmp_path / f"{LATIN_1}.mp4"
    shutil.copy(SAMPLES / "rendered.mp4", path)
    with pytest.raises(ValueError, match=r"caf\\xe9.mp4: name: found bytes that are not UTF-8, expected a name"):
        probe(path)


def test_robot_whose_name_is_not_utf_8_is_refused(tmp_path):
    pytest.importorskip("mujoco")
    from recon.robotics.models import read_model

    path = tmp_path / f"{LATIN_1}.urdf"
    path.write_text("<robot/>")
    with pytest.raises(ValueError, match=r"caf\\xe9.urdf: name: found bytes that are not UTF-8, expected a name"):
        read_model(path)


def test_a_manifest_with_a_null_byte_is_refused(tmp_path):
    (tmp_path / "batch.csv").write_text("keypoints,fps\na\0b.csv,60\n")
    with pytest.raises(ValueError, match=r"batch\.csv: line 2, keypoints: found no files"):
        find_clips([tmp_path / "batch.csv"], {})


@pytest.mark.skipif(sys.platform == "win32", reason="a shell of POSIX")
@pytest.mark.slow
def test_standard_output_may_be_closed(tmp_path):
    """A closed standard output is no error; `test_interrupts.py` tests an output that cannot be written to."""
    clip = tmp_path / "Läufer.csv"
    shutil.copy(SAMPLES / "whole.csv", clip)
    closed = process("convert", clip, tmp_path / "closed.csv", "--to", "long", "--quiet", shell=">&-")
    assert (closed.returncode, closed.stderr) == (0, b"")
    header, *rows = (tmp_path / "closed.csv").read_text().splitlines()
    assert (header, len(rows)) == ("frame,bodypart,x,y,likelihood", 60 * 24)


def test_standard_output_may_be_ascii(tmp_path):
    no = ("convert", tmp_path / "Löwe.csv", tmp_path / "no.csv")
    commands = [*map(str, ("skeleton", "list", "--json", "then", *no, "then", "fit", "--help"))]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii", "LANG": "C", "PYTHONUTF8": "0"}
    done = subprocess.run([sys.executable, "-c", IN_TURN, *commands], capture_output=True, env=env, timeout=300)
    assert re.findall(rb"ended with (\d)", done.stderr) == [b"0", b"2", b"0"], done.stderr
    listed, usage = done.stdout.decode("ascii").split("Usage:")
    assert json.loads(listed)
    assert "--camera" in usage
    assert rb"L\xf6we.csv: no such file" in done.stderr
