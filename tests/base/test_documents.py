"""Test that JSON and TOML on which Python's parsers crash, and paths that are not regular files, are refused."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

import pytest
from command_line import refused

from recon import InputError, read_settings
from recon.animal.skeleton_file import load_skeleton
from recon.base.documents import MAX_TOML_BYTES, read_content, read_json, read_toml
from recon.io.formats import read_keypoints
from recon.io.positions import read_pose3d
from recon.robotics.quadruped import load_robot

DIGITS = "1" * 5000
TEXTS = {
    "deep.json": ("[" * 100_000, "nested too deeply"),
    "deep.toml": ("a = " + "{x = " * 5000, "nested too deeply"),
    "lists.toml": ("a = " + "[" * 50_000, "nested too deeply"),
    "digits.json": (DIGITS, "5000 digits"),
    "digits.toml": (f"a = {DIGITS}", "5000 digits"),
    "date.toml": ("a = 2020-02-31", "Invalid"),
    "latin.toml": ("a = 'ä'".encode("latin-1"), "byte 6 of the file is not UTF-8"),
    "latin.json": ('"ä"'.encode("latin-1"), "byte 2 of the file is not UTF-8"),
    "huge.toml": ("#" * (MAX_TOML_BYTES + 1), "more than 8 MB"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_text_that_is_refused(tmp_path, name):
    text, said = TEXTS[name]
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    read = read_json if name.endswith("json") else read_toml
    with pytest.raises(InputError, match=said):
        read(tmp_path / name, "some settings")


def test_byte_order_mark(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfa = 1")
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"a": 1}')
    assert read_toml(tmp_path / "a.toml") == read_json(tmp_path / "a.json", "a table") == {"a": 1}


def test_missing_file_is_refused(tmp_path):
    for name, said in (("none", "no such file"), (".", "a folder"), ("a\0b", "no such file|cannot be opened")):
        with pytest.raises(InputError, match=said):
            read_content(tmp_path / name, "a table")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_pipe_is_refused_without_waiting(tmp_path):
    path = tmp_path / "pipe.toml"
    os.mkfifo(path)
    for read in (
        read_keypoints,
        read_pose3d,
        load_robot,
        load_skeleton,
        lambda path: load_skeleton("cheetah-24", path),
        lambda path: read_settings(path, {}),
    ):
        with pytest.raises(InputError):
            read(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((b"thigh_m", b"# \xe4\nthigh_m"), "not UTF-8"),
        ((b"thigh_m = ", b"thigh_m = inf # "), "leg.thigh_m: found inf"),
        ((b"thigh_m = ", b"thigh_m = 0 # "), "leg.thigh_m: found 0"),
        ((b"hip_m = [", b"hip_m = [nan, "), "hip_m"),
        ((b"stand_m = ", b"stand_m = 1e300 # "), "stand_m: found 1e+300"),
    ],
)
def test_robots(tmp_path, change, said):
    content = (resources.files("recon.robotics") / "robots" / "a1.toml").read_bytes()
    (tmp_path / "a.toml").write_bytes(content.replace(*change, 1))
    with pytest.raises(InputError) as error:
        load_robot(tmp_path / "a.toml")
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("option", "field", "expected"),
    [
        ("--camera", "cameras", "[camera]"),
        ("--skeleton", "content", "segments"),
        ("--subject", "content", "skeleton"),
        ("--set=detector", "content", "keypoints"),
    ],
)
def test_a_file_about_something_else_is_one_problem(tmp_path, option, field, expected):
    other = tmp_path / "other.toml"
    other.write_text('[project]\nname = "a"\n\n[tool.ruff]\nline-length = 120\n')
    samples = Path(__file__).parents[2] / "data/samples"
    given = {"--camera": samples / "camera.toml"} | {option: other}
    args = [f"{name}={value}" for name, value in given.items()]
    refused(["fit", samples / "whole.csv", *args, "--fps", 60, "--out", tmp_path / "out"], (other, field, "", expected))
