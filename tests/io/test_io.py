"""Test the reading of keypoints and 3D positions from files."""

from __future__ import annotations

import csv
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from command_line import refusal, says

from recon import InputError
from recon.clip import Keypoints, clean
from recon.io import hdf5_poses
from recon.io.common import Pose3D, numbers
from recon.io.formats import individuals, read_keypoints
from recon.io.positions import read_pose3d

NAN = float("nan")
SINGLE = """\
scorer,net,net,net,net,net,net
bodyparts,nose,nose,nose,tail,tail,tail
coords,x,y,likelihood,x,y,likelihood
0,1.5,2.5,0.9,3,4,0.8
1,5,6,0.7,,,
2,0,0,0,7,8,1
"""
MULTI = """\
scorer,net,net.1,net.2,net.3,net.4,net.5,net.6,net.7,net.8
individuals,m1,m1,m1,m2,m2,m2,single,single,single
bodyparts,nose,nose,nose,nose,nose,nose,corner,corner,corner
coords,x,y,likelihood,x,y,likelihood,x,y,likelihood
0,1,2,0.9,3,4,0.8,5,6,0.7
"""
LABELS = """\
scorer,me,me,me,me
bodyparts,nose,nose,tail,tail
coords,x,y,x,y
labeled-data/run/img0007.png,1,2,3,4
labeled-data/run/img0009.png,,,5,6
"""


def save(folder: Path, text: str, name: str = "clip.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8", newline="")
    return path


def refuses(path: Path, *expected: tuple[object, ...], individual: str | None = None) -> None:
    """Check that a file is refused for the expected problems, given as for `refusal` but without the file."""
    with refusal(*((path, *one) for one in expected)):
        read_keypoints(path, individual)


def naive_csv(path: Path, individual: str | None = None) -> dict[str, np.ndarray]:
    """Return the columns of DeepLabCut's CSV by "bodypart/coord", and the frame numbers as "frame"."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    start = next(i for i, row in enumerate(rows) if row[0] == "coords") + 1
    header = {row[0]: row for row in rows[:start]}
    columns = {"frame": np.array([row[0] for row in rows[start:]])}
    for j in range(1, len(rows[0])):
        if individual is None or header["individuals"][j] == individual:
            name = f"{header['bodyparts'][j]}/{header['coords'][j]}"
            assert name not in columns
            columns[name] = np.array([float(row[j] or "nan") for row in rows[start:]])
    return columns


def assert_same(keypoints: Keypoints, columns: dict[str, np.ndarray]) -> None:
    columns = dict(columns)
    np.testing.assert_array_equal(keypoints.frames, columns.pop("frame").astype(int))
    assert list(dict.fromkeys(name.rsplit("/", 1)[0] for name in columns)) == list(keypoints.names)
    for k, name in enumerate(keypoints.names):
        np.testing.assert_array_equal(keypoints.xy_px[:, k, 0], columns.pop(f"{name}/x"))
        np.testing.assert_array_equal(keypoints.xy_px[:, k, 1], columns.pop(f"{name}/y"))
        np.testing.assert_array_equal(keypoints.confidence[:, k], columns.pop(f"{name}/likelihood"))
    assert not columns


def test_real_csv_of_one_animal(shared_data):
    path = shared_data / "importer-files" / "deeplabcut" / "deepof_single.csv"
    keypoints = read_keypoints(path)
    assert_same(keypoints, naive_csv(path))
    assert keypoints.individual is None
    assert keypoints.notes == ()


def test_real_file_of_animals_recognised_by_prefixes(shared_data):
    path = shared_data / "importer-files" / "deeplabcut" / "deepof_two_animals_prefixed.csv"
    refuses(path, ("individual", "2 animals", "B, W"))
    keypoints, columns = read_keypoints(path, "W"), naive_csv(path)
    own = {name.removeprefix("W_"): column for name, column in columns.items() if name[:2] == "W_" or name == "frame"}
    assert_same(keypoints, own)
    assert (keypoints.individual, keypoints.names[0]) == ("W", "Nose")


@pytest.mark.parametrize("suffix", ["csv", "h5"])
@pytest.mark.parametrize("animal", ["mouse_black_tail", "mouse_white_tail"])
def test_real_file_of_several_animals(shared_data, suffix, animal):
    path = shared_data / "importer-files" / "deeplabcut" / f"deepof_madlc.{suffix}"
    keypoints = read_keypoints(path, animal)
    if suffix == "csv":
        columns = naive_csv(path, animal)
    else:
        frame = pd.read_hdf(path).droplevel("scorer", axis=1)[animal]
        columns = {"frame": frame.index.to_numpy()} | {"/".join(c): frame[c].to_numpy() for c in frame.columns}
    assert_same(keypoints, columns)
    assert keypoints.individual == animal
    assert len(keypoints.names) == 14

    cleaned, report = clean(keypoints, 0.6)
    zero = sum(
        int(((columns[f"{n}/x"] == 0) & (columns[f"{n}/y"] == 0) & (columns[f"{n}/likelihood"] == 0)).sum())
        for n in keypoints.names
    )
    assert zero > 0
    assert report.total("missing_zero_zero") == report.total("missing") == zero
    assert not (cleaned.xy_px == 0).any()
    refuses(path, ("individual", "2 animals", "mouse_black_tail, mouse_white_tail"))
    refuses(path, ("individual", "'mouse'", "mouse_black_tail, mouse_white_tail"), individual="mouse")


@pytest.mark.parametrize("name", ["deepof_single.h5", "openfield_table.h5"])
def test_real_h5_of_one_animal(shared_data, name):
    path = shared_data / "importer-files" / "deeplabcut" / name
    frame = pd.read_hdf(path).droplevel("scorer", axis=1)
    columns = {"frame": frame.index.to_numpy()} | {"/".join(c): frame[c].to_numpy() for c in frame.columns}
    assert_same(read_keypoints(path), columns)


def test_every_real_run(shared_data):
    paths = sorted((shared_data / "cheetah-runs").glob("*/cam*.csv"))
    assert len(paths) == 28
    for path in paths:
        keypoints = read_keypoints(path)
        assert_same(keypoints, naive_csv(path))
        assert len(keypoints.names) == 24
        report = clean(keypoints, 0.5)[1]
        assert all(c["used"] + c["missing"] + c["rejected"] == c["frames"] for c in report.keypoints.values())
        assert report.total("missing_nan_with_likelihood") == 0


def test_every_real_truth(shared_data):
    for path in (shared_data / "cheetah-runs").glob("*/truth.csv"):
        pose, columns = read_pose3d(path), naive_csv(path)
        np.testing.assert_array_equal(pose.frames, columns["frame"].astype(int))
        for j, name in enumerate(pose.names):
            np.testing.assert_array_equal(pose.xyz_m[:, j].T, [columns[f"{name}/{c}"] for c in "xyz"])
        refuses(path, ("coords", "3D positions", "2D keypoints"))


def test_real_labels(shared_data):
    path = shared_data / "horse-side" / "CollectedData_Byron.csv"
    keypoints, columns = read_keypoints(path), naive_csv(path)
    assert keypoints.frames.tolist() == list(range(50, 250))
    for k, name in enumerate(keypoints.names):
        np.testing.assert_array_equal(keypoints.xy_px[:, k].T, [columns[f"{name}/{c}"] for c in "xy"])
    assert np.isnan(keypoints.confidence).all()
    cleaned, report = clean(keypoints, 0.6)
    labelled = sum(int((~np.isnan(columns[f"{name}/x"])).sum()) for name in keypoints.names)
    assert report.total("used") == report.total("likelihood_unknown") == labelled > 0
    assert report.total("missing_empty") == 200 * 22 - labelled
    assert np.array_equal(cleaned.confidence == 1, cleaned.present)


@pytest.mark.parametrize(
    "name", ["sleap/small_robot.000_small_robot_3_frame.analysis.h5", "ndx-pose/0.3.0_poseestimation_one_camera.nwb"]
)
def test_real_hdf5_of_other_kinds_is_no_deeplabcut_file(shared_data, name):
    assert not hdf5_poses.recognises_deeplabcut(shared_data / "importer-files" / name)


def test_hdf5_of_another_kind(tmp_path):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["tracks"] = np.zeros(3)
    refuses(path, ("format", "HDF5", "DeepLabCut H5"))


@pytest.mark.parametrize("name", ["deepof_single.h5", "openfield_table.h5"])
def test_an_h5_file_that_is_cut_off_is_refused(shared_data, tmp_path, name):
    whole = (shared_data / "importer-files" / "deeplabcut" / name).read_bytes()
    for length in (8, 100, 2000, len(whole) // 2, len(whole) - 1):
        path = tmp_path / "cut.h5"
        path.write_bytes(whole[:length])
        refuses(path, ("file", "cut off", "complete"))


def test_single_animal(tmp_path):
    keypoints = read_keypoints(save(tmp_path, SINGLE))
    assert keypoints.names == ("nose", "tail")
    assert keypoints.frames.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(keypoints.xy_px[:, 0], [[1.5, 2.5], [5, 6], [0, 0]])
    np.testing.assert_array_equal(keypoints.xy_px[:, 1], [[3, 4], [NAN, NAN], [7, 8]])
    np.testing.assert_array_equal(keypoints.confidence, [[0.9, 0.8], [0.7, NAN], [0, 1]])
    assert (keypoints.individual, keypoints.fps, keypoints.notes) == (None, None, ())
    assert keypoints.source == str(tmp_path / "clip.csv")


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + SINGLE,
        SINGLE.replace("\n", "\r\n"),
        SINGLE.rstrip("\n"),
        SINGLE.replace(",", ";"),
        SINGLE.replace(",", "\t"),
        SINGLE + "\n\n",
        SINGLE.replace("net,", "net.1,", 1),
        SINGLE.replace("\n0,", "\n0.0,").replace("\n1,", "\n1.,"),
        SINGLE.replace("6,0.7,,,", "6,0.7,NaN, ,nan"),
        SINGLE.replace("5,6,0.7", '" 5","6 ",7e-1'),
    ],
    ids=["bom", "crlf", "no-final-newline", "semicolons", "tabs", "blank-lines", "scorer-suffix", "float-index",
         "nan-cells", "quotes-and-blanks"],
)  # fmt: skip
def test_equivalent_tables_are_read_equally(tmp_path, text):
    plain, variant = read_keypoints(save(tmp_path, SINGLE)), read_keypoints(save(tmp_path, text, "variant.csv"))
    assert plain.names == variant.names
    for field in ("xy_px", "confidence", "frames"):
        np.testing.assert_array_equal(getattr(plain, field), getattr(variant, field))
    assert variant.notes == ()


def test_the_name_of_the_file_does_not_matter(tmp_path):
    assert read_keypoints(str(save(tmp_path, SINGLE, "clip.txt"))).names == ("nose", "tail")


def test_columns_in_any_order(tmp_path):
    text = "scorer,n,n,n,n,n,n\nbodyparts,b,a,b,a,b,a\ncoords,likelihood,y,x,x,y,likelihood\n4,0.1,2,3,4,5,0.6\n"
    keypoints = read_keypoints(save(tmp_path, text))
    assert keypoints.names == ("b", "a")
    assert keypoints.xy_px.tolist() == [[[3, 5], [4, 2]]]
    assert keypoints.confidence.tolist() == [[0.1, 0.6]]


def test_several_animals(tmp_path):
    path = save(tmp_path, MULTI)
    keypoints = read_keypoints(path, "m2")
    assert (keypoints.names, keypoints.individual) == (("nose",), "m2")
    assert keypoints.xy_px.tolist() == [[[3, 4]]]
    assert [says(note, "Left out", "corner") for note in keypoints.notes] == [True]
    refuses(path, ("individual", ["2 animals", "--individual"], "m1, m2"))
    refuses(path, ("individual", "'single'", "m1, m2"), individual="single")


@pytest.mark.parametrize(
    ("names", "animals"),
    [
        ("B_nose B_ear B_tail W_nose W_ear W_tail", ("B", "W")),
        ("l_paw l_ear l_hip r_paw r_ear r_hip", ()),  # sides
        ("B_nose B_ear B_tail W_nose W_ear W_tail corner", ()),
        ("B_nose B_ear B_tail W_nose W_ear W_hip", ()),
        ("nose ear tail", ()),
    ],
)
def test_animals_are_recognised_by_prefixes_of_bodyparts(tmp_path, names, animals):
    header = [["scorer"], ["bodyparts"], ["coords"]]
    for name in names.split():
        for row, cells in zip(header, (["n"] * 3, [name] * 3, ["x", "y", "likelihood"]), strict=True):
            row += cells
    path = save(tmp_path, "\n".join(",".join(row) for row in (*header, ["0", *"121" * len(names.split())])) + "\n")
    assert individuals(path) == animals
    if animals:
        assert read_keypoints(path, "W").names == ("nose", "ear", "tail")
    else:
        assert read_keypoints(path).names == tuple(names.split())


@pytest.mark.parametrize("nothing", ["", "0.0"])
def test_animals_without_points_need_no_choice(tmp_path, nothing):
    """DeepLabCut writes empty or zero columns for animals that it never saw."""
    text = "scorer,n,n,n,n,n,n,n,n,n\nindividuals,m1,m1,m1,m2,m2,m2,m3,m3,m3\nbodyparts" + ",nose" * 9
    text += "\ncoords" + ",x,y,likelihood" * 3
    none = ",".join([nothing, nothing, "0.0"])
    path = save(tmp_path, f"{text}\n0,{none},3,4,0.9,{none}\n")
    found = read_keypoints(path)
    assert (found.individual, found.xy_px.tolist()) == ("m2", [[[3, 4]]])
    assert read_keypoints(path, "m1").individual == "m1"
    refuses(path, ("individual", "'m4'", "one of: m2"), individual="m4")
    two = save(tmp_path, f"{text}\n0,{none},3,4,0.9,{none}\n1,5,6,0.9,{none},{none}\n")
    refuses(two, ("individual", "2 animals", "one of: m1, m2"))
    empty = save(tmp_path, f"{text}\n0,{none},{none},{none}\n")
    refuses(empty, ("individual", "3 animals", "m1, m2, m3"))


def test_the_only_animal_needs_no_choice(tmp_path):
    text = (
        "scorer,n,n,n,n,n,n\nindividuals,m1,m1,single,single,single,single\nbodyparts,nose,nose,post,post,door,door\n"
        "coords,x,y,x,y,x,y\n0,1,2,3,4,5,6\n"
    )
    keypoints = read_keypoints(save(tmp_path, text))
    assert (keypoints.names, keypoints.individual) == (("nose",), "m1")
    assert [says(note, "Left out", "post, door") for note in keypoints.notes] == [True]
    # A file that has only unique bodyparts is read as one animal.
    assert read_keypoints(save(tmp_path, text.replace("m1", "single"))).names == ("nose", "post", "door")


def test_individual_in_a_file_of_one_animal(tmp_path):
    refuses(save(tmp_path, SINGLE), ("individual", "without named", "'m1'"), individual="m1")


def test_labels(tmp_path):
    keypoints = read_keypoints(save(tmp_path, LABELS))
    assert keypoints.frames.tolist() == [7, 9]
    np.testing.assert_array_equal(keypoints.xy_px, [[[1, 2], [3, 4]], [[NAN, NAN], [5, 6]]])
    assert np.isnan(keypoints.confidence).all()


@pytest.mark.parametrize(
    "text",
    [
        LABELS.replace("/", "\\"),
        LABELS.replace("/", ",").replace("rer,", "rer,,,").replace("parts,", "parts,,,").replace("ords,", "ords,,,"),
        LABELS.replace("labeled-data/run/", ""),
        LABELS.replace("img0007", "12_7").replace("img", ""),
    ],
    ids=["windows", "three-columns", "bare-names", "digits"],
)
def test_label_index_variants(tmp_path, text):
    keypoints = read_keypoints(save(tmp_path, text))
    assert keypoints.frames.tolist() == [7, 9]
    np.testing.assert_array_equal(keypoints.xy_px[0], [[1, 2], [3, 4]])


def test_labels_of_several_animals(tmp_path):
    text = (
        "scorer,,,me,me,me,me\nindividuals,,,m1,m1,m2,m2\nbodyparts,,,nose,nose,nose,nose\n"
        "coords,,,x,y,x,y\nlabeled-data,run,img3.png,1,2,3,4\n"
    )
    keypoints = read_keypoints(save(tmp_path, text), "m2")
    assert keypoints.frames.tolist() == [3]
    assert keypoints.xy_px.tolist() == [[[3, 4]]]


def test_unsorted_rows_are_sorted_with_a_note(tmp_path):
    lines = SINGLE.splitlines()
    keypoints = read_keypoints(save(tmp_path, "\n".join([*lines[:3], lines[5], lines[3], lines[4]])))
    np.testing.assert_array_equal(keypoints.xy_px[:, 0], [[1.5, 2.5], [5, 6], [0, 0]])
    assert "sorted" in keypoints.notes[0]


def test_stray_blanks_in_names_are_noted(tmp_path):
    text = SINGLE.replace("nose", " nose").replace("tail", "tail ")
    keypoints = read_keypoints(save(tmp_path, text))
    assert keypoints.names == ("nose", "tail")
    pairs = (("' nose'", "'nose'"), ("'tail '", "'tail'"))
    assert [says(note, *pair) for note, pair in zip(keypoints.notes, pairs, strict=True)] == [True, True]
    assert clean(keypoints, 0.5)[1].notes == keypoints.notes


def test_likelihoods_that_mean_something_else_are_refused(tmp_path):
    """Likelihoods in per cent would all be above the threshold."""
    for text, *expected in (
        (SINGLE.replace("0.9", "37"), "likelihood", ["0 to 37", "above 1 in 20 % of the points"], "0 to 1"),
        (SINGLE.replace("0.9", "-1"), "likelihood", "-1 to 1", "0 to 1"),
        (SINGLE.replace("0.9", "inf"), "line 4, nose/likelihood", "'inf'"),
        ("frame,bodypart,x,y,likelihood\n0,nose,1,2,90\n", "likelihood", ["90 to 90", "percent"], "0 to 1"),
    ):
        refuses(save(tmp_path, text), tuple(expected))


@pytest.mark.parametrize(
    "text",
    [
        '{"camera_resolution": [1920, 1080], "cameras": []}',
        '[camera]\nformat = "recon-camera"\n',
        "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n",
        '[cam_0]\nname = "A"\n',
    ],
)
def test_a_calibration_in_place_of_keypoints_is_named(text, tmp_path):
    refuses(save(tmp_path, text), ("format", "a calibration, which belongs to --camera"))


def test_odd_likelihoods_are_noted(tmp_path):
    """Scores slightly outside 0 to 1, which are not probabilities, give a note."""
    (note,) = read_keypoints(save(tmp_path, SINGLE.replace("0.9", "1.2"))).notes
    assert says(note, "Likelihoods", "0 to 1.2", "0 and 1")


def test_names_that_would_control_a_terminal_are_refused(tmp_path):
    """The message about a name with control characters is a single line without them."""
    for path, *said in (
        (save(tmp_path, SINGLE.replace("nose", "\x1b[31mnose")), "column \\x1b[31mnose/x: found"),
        (save(tmp_path, "frame,bodypart,x,y\n0,no\x1b]0;se,1,2\n", "b.csv"), "names of points: found 'no\\x1b]0;se'"),
        (tmp_path / "a\nb\u202e.csv", f"{tmp_path}/a\\nb\\u202e.csv: ", "no such file"),
    ):
        with pytest.raises(InputError) as caught:
            read_keypoints(path)
        lines = str(caught.value).splitlines()
        assert len(lines) == len(caught.value.problems)
        assert says(lines[0], *said)
        assert all(line.isprintable() for line in lines)


def test_missing_header_row_is_noted(tmp_path):
    """A missing header row gives a note, since the other rows name the columns."""
    whole, headless = (read_keypoints(save(tmp_path, text)) for text in (SINGLE, SINGLE.split("\n", 1)[1]))
    assert whole.notes == ()
    (note,) = headless.notes
    assert says(note, "first row, scorer", "missing")
    assert clean(headless, 0.5)[1].notes == (note,)
    np.testing.assert_array_equal(headless.xy_px, whole.xy_px)
    np.testing.assert_array_equal(headless.confidence, whole.confidence)


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        *[("-0.1", -0.1), ("123456789.12345679", 123456789.12345679), ("1.0e-05", 1e-5), ("7", 7.0), (" 2 ", 2.0)],
        *[("", np.nan), (" ", np.nan), ("nan", np.nan), ("NaN", np.nan), ("null", np.nan), (None, np.nan)],
        *[("+1", 1.0), (".5", 0.5), ("1.", 1.0), ("01", 1.0)],
        *[(text, None) for text in ("1,2", "true", '"1"', "[1]", "1e400", "inf", "Infinity", "1_0", "1 2", "x")],
    ],
)
def test_cells_become_numbers_or_are_listed(cell, value):
    values, wrong = numbers(["1.5", cell, "", "2"])
    assert wrong == ([1] if value is None else [])
    expected = [1.5, values[1] if value is None else value, np.nan, 2.0]
    assert np.array_equal(values, expected, equal_nan=True)


@pytest.mark.parametrize("cell", ["1_000.5", "１", "٣", "1e5_0", "0x10"])
def test_numbers_that_only_python_accepts_are_refused(tmp_path, cell):
    wrong = (f"'{cell}'", "a number")
    refuses(save(tmp_path, SINGLE.replace("1.5", cell)), ("line 4, nose/x", *wrong))
    refuses(save(tmp_path, f"frame,bodypart,x,y\n0,nose,{cell},2\n"), ("line 2, x", *wrong))
    trc = save(tmp_path, f"bodyparts,nose,nose,nose\ncoords,x,y,z\n0,{cell},2,3\n")
    with refusal((trc, "line 3, nose/x", *wrong)):
        read_pose3d(trc)


@pytest.mark.parametrize(
    ("clock", "cells", "expected"),
    [
        ("frame", ("0", "-1e14"), ("frames", "-100000000000000", "whole numbers")),
        ("frame", ("0", ""), ("line 3, frame", "nothing", "frame number")),
        ("frame", ("0", "1e17"), ("frames", "1e+17 after 0", "increasing")),
        ("frame", ("0.5", "1"), ("frames", "0.5", "whole numbers")),
        ("time_s", ("0.04", ""), ("line 3, time_s", "nothing", "seconds")),
        ("time_s", ("-1e14", "0"), ("time", "-1e+14 to 0 s")),
        ("time_s", ("0", "1e300"), ("time", "0 to 1e+300 s")),
    ],
)
def test_invalid_frame_numbers_and_times_are_refused(tmp_path, clock, cells, expected):
    text = f"{clock},bodypart,x,y,fps\n" + "".join(f"{cell},nose,1,2,25\n" for cell in cells)
    refuses(save(tmp_path, text), expected)


def test_no_file(tmp_path):
    refuses(tmp_path / "none.csv", ("file", "no such file"))
    refuses(tmp_path, ("file", "a folder"))
    refuses(save(tmp_path, ""), ("file", "empty"))


def test_unknown_format(tmp_path):
    refuses(save(tmp_path, "frame,x,y\n0,1,2\n"), ("format", "'frame,x,y'", "DeepLabCut CSV"))
    refuses(save(tmp_path, " \n\n"), ("format", "empty lines"))
    binary = tmp_path / "binary.csv"
    for content in (b"\x00\x01\x02\x03", bytes(range(128, 192)), b"\x89PNG\r\n\x1a\n\x00\x00"):
        binary.write_bytes(content)
        refuses(binary, ("format", "binary"))
    for content in (b"\0\0\0\x20ftypisom", b"RIFF\0\0\0\0AVI LIST", b"\x1aE\xdf\xa3"):
        binary.write_bytes(content)
        refuses(binary, ("format", ["a video", "recon run and recon predict"]))
    refuses(save(tmp_path, "äöü" * 50), ("format", f"'{('äöü' * 50)[:32]}"))


def test_binary_after_the_header(tmp_path):
    path = tmp_path / "clip.csv"
    for junk in (bytes(range(128, 256)), b"\xff\xfe"):
        path.write_bytes(SINGLE.encode() + junk)
        refuses(path, ("text", "bytes that are not UTF-8", "UTF-8"))
    path.write_text(SINGLE, encoding="utf-16")
    refuses(path, ("format", "UTF-16"))
    path.write_bytes(SINGLE.encode() + b"3,\x00,1,1,1,1,1\n")
    refuses(path, ("line 7, nose/x", "'\x00'"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("scorer", ("header", "end of the file after scorer")),
        (SINGLE.replace("coords,x,y,likelihood,x,y,likelihood\n", ""), ("header", "'scorer, bodyparts, 0'")),
        (SINGLE.replace("bodyparts", "parts"), ("header", "'scorer, parts'")),
        ("\n".join(SINGLE.splitlines()[:2]), ("header", "end of the file after scorer, bodyparts")),
        ("\n".join(SINGLE.splitlines()[:3]), ("points", "no frames")),
        ("scorer\nbodyparts\ncoords\n0\n", ("header rows", "no columns")),
        (SINGLE.replace(",x,y,likelihood\n", "\n"), ("header rows", "7 in scorer, 7 in bodyparts, 4 in coords")),
        (SINGLE.replace("x,y,l", "x,why,l", 1), ("column nose/why", "'why'", "x, y, z, likelihood")),
        (SINGLE.replace("x,y,l", "x,why,l"), ("column nose/why", ["'why'", "1 more column"], "x, y, z")),
        (SINGLE.replace("tail", "nose"), ("bodypart nose", "several columns")),
        (SINGLE.replace("tail", "nose "), ("bodypart nose", "several columns")),
        (SINGLE.replace("likelihood", "z"), ("coords", "3D positions", "2D keypoints")),
        (SINGLE.replace("\n1,", "\n0,"), ("frames", "0 after 0")),
        (SINGLE.replace("\n1,", "\n1.5,"), ("row 2 below the header", "'1.5'")),
        (SINGLE.replace("\n1,", "\n100000000000000,"), ("row 2 below the header", "'100000000000000'")),
        (SINGLE.replace("\n1,", "\none,"), ("row 2 below the header", "'one'")),
        (SINGLE.replace("\n1,", "\n,"), ("row 2 below the header", "''")),
        (
            SINGLE.replace("\n1,", "\n" + "9" * 5000 + ","),
            ("row 2 below the header", f"'{'9' * 200}'", "a frame number"),
        ),
        (SINGLE.replace("0.7,,,", "0.7"), ("line 5", "4 cells", 7)),
        (SINGLE[:-6], ("line 6", "5 cells", 7)),
        (SINGLE.replace("5,6", "5,six"), ("line 5, nose/y", "'six'", "a number")),
        (SINGLE.replace("5,6", "5,inf"), ("line 5, nose/y", "'inf'", "a number")),
        (SINGLE.replace("5,6", "True,6"), ("line 5, nose/x", "'True'", "a number")),
        (LABELS.replace("img0007", "nose"), ("row 1 below the header", "'labeled-data/run/nose.png'")),
        (LABELS.replace("run/img0009", "walk/img0009"), ("images", "2 folders: labeled-data/run, labeled-data/walk")),
        (LABELS.replace("0009", "7"), ("frames", "7 after 7")),
    ],
)
def test_the_problem_of_a_table_is_reported(tmp_path, text, expected):
    refuses(save(tmp_path, text), expected)


def test_all_wrong_columns_are_reported(tmp_path):
    nameless = ((f"column {kind}", "without a printable name") for kind in ("x", "y", "likelihood"))
    refuses(save(tmp_path, SINGLE.replace("nose", "")), *nameless)
    twice = (("bodypart nose", "several columns"), ("bodypart nose", "no column y"))
    refuses(save(tmp_path, SINGLE.replace("coords,x,y,", "coords,x,likelihood,")), *twice)


def test_all_bad_cells_are_named_up_to_ten(tmp_path):
    rows = [f"{i},bad{i},2,0.5,inf,4,0.5" for i in range(100, 104)]
    path = save(tmp_path, "\n".join([*SINGLE.splitlines()[:3], *rows]))
    noses = [(f"line {line}, nose/x", f"'bad{line + 96}'") for line in range(4, 8)]
    refuses(path, *noses, *((f"line {line}, tail/x", "'inf'") for line in range(4, 8)))
    rows = [f"{i},x,x,x,x,x,x" for i in range(4)]
    with pytest.raises(InputError) as caught:
        read_keypoints(save(tmp_path, "\n".join([*SINGLE.splitlines()[:3], *rows])))
    *cells, more = caught.value.problems
    assert [cell.found for cell in cells] == ["'x'"] * 10
    assert says(more.found, "14 more problems")


def test_problems_of_different_kinds_come_together(tmp_path):
    path = save(tmp_path, SINGLE.replace("5,6", "5,six").replace("\n2,0", "\ntwo,0") + "3,1\n")
    refuses(path, ("line 5, nose/y", "'six'"), ("row 3 below the header", "'two'"), ("line 7", "2 cells", 7))


def frame_of(names: list[str] | None, *columns: tuple[str, ...], index=(0, 1, 2), dtype=float) -> pd.DataFrame:
    cells = np.arange(1, 1 + len(index) * len(columns)).reshape(len(index), len(columns)).astype(dtype)
    return pd.DataFrame(cells, index=index, columns=pd.MultiIndex.from_tuples(columns, names=names))


XYL = [("nose", "x"), ("nose", "y"), ("nose", "likelihood")]


@pytest.mark.parametrize("kind", ["fixed", "table"])
@pytest.mark.parametrize(
    ("names", "prefix"),
    [
        (["bodyparts", "coords"], ()),
        (None, ()),
        (["scorer", "bodyparts", "coords"], ("net",)),
        (None, ("net",)),
        (["individuals", "bodyparts", "coords"], ("m1",)),
        (["scorer", "individuals", "bodyparts", "coords"], ("net", "m1")),
        (None, ("net", "m1")),
    ],
)
def test_h5_levels(tmp_path, kind, names, prefix):
    path = tmp_path / "clip.h5"
    frame = frame_of(names, *[(*prefix, *c) for c in XYL], index=[5, 6, 8])
    frame[(*prefix, *XYL[2])] /= 10
    frame.to_hdf(path, key="any_key", format=kind)
    keypoints = read_keypoints(path)
    assert keypoints.names == ("nose",)
    assert keypoints.frames.tolist() == [5, 6, 8]
    assert keypoints.xy_px[:, 0].tolist() == [[1, 2], [4, 5], [7, 8]]
    assert keypoints.confidence[:, 0].tolist() == [0.3, 0.6, 0.9]
    assert keypoints.individual == ("m1" if "m1" in prefix else None)


def test_h5_without_likelihood(tmp_path):
    path = tmp_path / "clip.h5"
    frame = frame_of(["bodyparts", "coords"], *XYL)
    frame[("nose", "likelihood")] = NAN
    frame.to_hdf(path, key="fte_df")
    cleaned, report = clean(read_keypoints(path), 0.9)
    assert cleaned.confidence[:, 0].tolist() == [1, 1, 1]
    assert report.total("likelihood_unknown") == report.total("used") == 3


@pytest.mark.parametrize(
    "index",
    [
        ["labeled-data/run/img3.png", "labeled-data/run/img4.png"],
        pd.MultiIndex.from_tuples([("labeled-data", "run", "img3.png"), ("labeled-data", "run", "img4.png")]),
        [3.0, 4.0],
    ],
    ids=["paths", "three-levels", "floats"],
)
def test_h5_index(tmp_path, index):
    path = tmp_path / "clip.h5"
    frame_of(["bodyparts", "coords"], *XYL[:2], index=index).to_hdf(path, key="df_with_missing")
    keypoints = read_keypoints(path)
    assert keypoints.frames.tolist() == [3, 4]
    assert keypoints.xy_px[:, 0].tolist() == [[1, 2], [3, 4]]


def test_h5_problems(tmp_path):
    good = frame_of(["bodyparts", "coords"], *XYL)
    path = tmp_path / "two.h5"
    good.to_hdf(path, key="b")
    good.to_hdf(path, key="a")
    refuses(path, ("keys", "/a, /b", "one table"))

    path = tmp_path / "series.h5"
    good[("nose", "x")].rename("x").to_hdf(path, key="a")
    refuses(path, ("key /a", "'series'", "a table"))

    path = tmp_path / "levels.h5"
    pd.DataFrame({"nose_x": [1.0], "nose_y": [2.0]}).to_hdf(path, key="a")
    refuses(path, ("header", "None", "scorer, bodyparts, coords"))

    path = tmp_path / "inf.h5"
    good.replace(2.0, np.inf).to_hdf(path, key="a")
    refuses(path, ("points", "infinite"))

    path = tmp_path / "duplicate.h5"
    frame_of(["bodyparts", "coords"], *XYL, index=[0, 4, 4]).to_hdf(path, key="a")
    refuses(path, ("frames", "4 after 4", "increasing"))

    path = tmp_path / "text.h5"
    words = good.astype(object)
    words.iloc[1, 0] = "four"
    with pytest.warns(pd.errors.PerformanceWarning):
        words.to_hdf(path, key="a")
    refuses(path, ("content", "pickled Python objects"))

    path = tmp_path / "words.h5"
    words = good.astype({("nose", "x"): str})
    words.iloc[1, 0] = "four"
    words.to_hdf(path, key="a", format="table")
    refuses(path, ("content", "b'four'"))


@pytest.mark.slow
def test_a_long_file_is_read_to_its_last_value(tmp_path):
    columns = [(f"p{i}", c) for i in range(25) for c in ("x", "y", "likelihood")]
    values = np.arange(750_000).reshape(10_000, 75) % 997 / 1000
    frame = pd.DataFrame(values, columns=pd.MultiIndex.from_tuples(columns))
    frame.columns.names = ["bodyparts", "coords"]
    path = tmp_path / "clip.csv"
    frame.to_csv(path)
    keypoints = read_keypoints(path)
    np.testing.assert_array_equal(keypoints.xy_px[:, 24, 1], frame[("p24", "y")])


def test_pose3d(tmp_path):
    text = "bodyparts,a,a,a,b,b,b\ncoords,x,y,z,x,y,z\n7,1,2,3,4,5,6\n9,1,2,3,,,\n"
    of_another = save(tmp_path, "scorer,s,s,s,s,s,s\n" + text, "scorer.csv")
    for path, unit in ((save(tmp_path, text), None), (of_another, "m")):
        pose = read_pose3d(path, unit=unit)
        assert pose.names == ("a", "b")
        assert pose.frames.tolist() == [7, 9]
        np.testing.assert_array_equal(pose.xyz_m, [[[1, 2, 3], [4, 5, 6]], [[1, 2, 3], [NAN, NAN, NAN]]])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (SINGLE, ("coords", "no z", "3D positions")),
        (MULTI, ("coords", "no z", "3D positions")),
        ("frame,x,y,z\n", ("format", "'frame,x,y,z'", "DeepLabCut CSV")),
        (SINGLE.replace("coords,x,y,likelihood", "coords,x,y,z"), ("bodypart tail", "no column z", "x, y, z")),
        ("", ("file", "empty")),
    ],
)
def test_pose3d_problems(tmp_path, text, expected):
    path = save(tmp_path, text)
    with refusal((path, *expected)):
        read_pose3d(path)


def test_pose3d_fields_must_fit_together():
    with pytest.raises(ValueError, match="positions"):
        Pose3D(("a",), np.zeros((2, 2, 3)), np.arange(2))
    with pytest.raises(ValueError, match="unique"):
        Pose3D(("a", "a"), np.zeros((2, 2, 3)), np.arange(2))
    with pytest.raises(ValueError, match="infinite"):
        Pose3D(("a",), np.full((2, 1, 3), np.inf), np.arange(2))
