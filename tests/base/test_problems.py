"""Test the line that describes a problem with an input, and how tests compare problems."""

import pickle

import pytest
from command_line import refusal

from recon import InputError
from recon.base.errors import Problem


@pytest.mark.parametrize(
    ("file", "field", "line"),
    [
        ("a.csv", "line 9", "a.csv: line 9: found 3 cells, expected 8"),
        ("--fps", "fps", "--fps: found 3 cells, expected 8"),
        ("--image-size", "image_size_px", "--image-size: found 3 cells, expected 8"),
        ("--set base-length-m", "base_length_m", "--set base-length-m: found 3 cells, expected 8"),
        ("--out", "folder", "--out: folder: found 3 cells, expected 8"),
        ("a\x1b[31m\n.csv", "line 9", r"a\x1b[31m\n.csv: line 9: found 3 cells, expected 8"),
    ],
)
def test_a_problem_is_one_line(file, field, line):
    assert str(Problem(file, field, "3 cells", "8")) == line


def test_an_error_passes_between_processes():
    error = InputError([Problem("a.csv", "names", "x", "y"), Problem("b", "c", "d", "e")])
    assert pickle.loads(pickle.dumps(error)).problems == error.problems


def test_details_follow_a_problem():
    error = InputError([Problem("a.csv", "names", "x", "y", ("file,skeleton", "x,\x07")), Problem("b", "c", "d", "e")])
    lines = "a.csv: names: found x, expected y\nfile,skeleton\nx,\\x07\nb: c: found d, expected e"
    assert str(error) == lines


def test_problem_of_several_files_is_reported_once():
    of_cameras = [Problem(f"cam{n}.csv", "names", "x", "y", ("file,skeleton", "x,")) for n in (1, 2)]
    error = InputError([*of_cameras, Problem("cam1.csv", "names", "x", "z"), of_cameras[0]])
    assert str(error).splitlines() == [
        *("cam1.csv, cam2.csv: names: found x, expected y", "file,skeleton", "x,"),
        "cam1.csv: names: found x, expected z",
    ]
    assert len(error.problems) == 4


@pytest.mark.parametrize(
    "other",
    [
        [("b.csv", "line 9", "3 cells", 8)],
        [("a.csv", "line 8", "3 cells", 8)],
        [("a.csv", "line 9", "8", 8)],
        [("a.csv", "line 9", ["3 cells", "4"], 8)],
        [("a.csv", "line 9", "3 cell")],
        [("a.csv", "line 9", "3 cells", 1.8)],
        [("a.csv", "line 9"), ("a.csv", "line 9")],
        [],
    ],
)
def test_other_problems_do_not_match_the_expected_ones(other):
    problem = Problem("x/a.csv", "line 9", "3 cells, 0.4 wide", "8")
    for file in ("a.csv", "x/a.csv"):
        with refusal((file, "line 9", ["3 cells", 0.4], 8)):
            raise InputError(problem)
    with pytest.raises(AssertionError, match="refused for"), refusal(*other):
        raise InputError(problem)
