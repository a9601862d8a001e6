"""Test columns, units of times, spreadsheets' changes, crops and lost markers in tables of points."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import refusal, says
from format_files import NAN, refuses, save

from recon.io.columns import parse_map
from recon.io.formats import read_keypoints
from recon.io.positions import read_pose3d
from recon.io.times import frames_of_times, nearest_frames
from recon.io.writing import frames_of_text, frames_text

TABS = """\
frame|nose x (px)|nose y (px)|nose conf|tail x (px)|tail y (px)|tail conf
6|||0|5|6|
5|1|2|0.5|3|4|.25
"""


@pytest.mark.parametrize(
    "text",
    [
        "frame,bodypart,x,y,likelihood\n5,nose,1,2,0.5\n5,tail,3,4,0.25\n6,tail,5,6,\n6,nose,,,0\n",
        "Keypoint;Frame_Idx;X_px;Y_px;Score\ntail;5;3;4;0.25\nnose;5;1;2;.5\nnose;6;nan;NaN;0\ntail;6;5;6;NA\n",
        ",frame,nose_x,nose_y,nose_likelihood,tail_x,tail_y,tail_likelihood\n0,5,1,2,0.5,3,4,0.25\n1,6,,,0,5,6,\n",
        TABS.replace("|", "\t"),
        "fnum,tail.x,tail.y,nose.x,nose.y,nose.p,tail.p\r\n5,3,4,1,2,0.5,0.25\r\n6.0,5,6,,,0,\r\n",
        "\ufefftime_s,nose:x,nose:y,nose:score,tail:x,tail:y,tail:score\n0.5,1,2,0.5,3,4,0.25\n0.6,,,0,5,6,\n",
    ],
    ids=["long", "long-semicolons", "wide-index", "wide-tabs", "wide-dots", "wide-times"],
)
def test_plain_csv(tmp_path, text):
    found = read_keypoints(save(tmp_path / "a.csv", text))
    order = [found.names.index(name) for name in ("nose", "tail")]
    assert len(found.names) == 2
    assert found.frames.tolist() == [5, 6]
    assert found.fps == (10.0 if "time_s" in text else None)
    np.testing.assert_array_equal(found.xy_px[:, order], [[[1, 2], [3, 4]], [[NAN, NAN], [5, 6]]])
    np.testing.assert_array_equal(found.confidence[:, order], [[0.5, 0.25], [0, NAN]])


def test_plain_csv_of_several_animals(tmp_path):
    path = save(tmp_path / "a.csv", "frame,animal,node,x,y\n0,m1,nose,1,2\n0,m2,nose,3,4\n1,m2,nose,5,6\n")
    refuses(path, ("individual", "2 animals", "m1, m2"))
    found = read_keypoints(path, "m2")
    assert (found.individual, found.frames.tolist(), found.xy_px[:, 0].tolist()) == ("m2", [0, 1], [[3, 4], [5, 6]])


def test_numbers_of_frames_as_they_are_called_in_spreadsheets(tmp_path):
    for name in ("Frame #", "frame number", "Frame No"):
        assert read_keypoints(save(tmp_path / "a.csv", f"{name},nose_x,nose_y\n3,1,2\n")).frames.tolist() == [3]


@pytest.mark.parametrize("unit", ["mm", "cm", "m"])
def test_positions_in_space_without_z_are_no_pixels(tmp_path, unit):
    refuses(
        save(tmp_path / "a.csv", f"frame,nose_x_{unit},nose_y_{unit}\n0,1,2\n"), ("columns", f"in {unit}", "pixels")
    )
    refuses(save(tmp_path / "b.csv", f"frame,node,x_{unit},y_{unit}\n0,a,1,2\n"), ("columns", f"in {unit}", "pixels"))


def test_unknown_columns_are_reported(tmp_path):
    found = read_keypoints(save(tmp_path / "a.csv", "frame,nose_x,nose_y,speed\n0,1,2,3\n"))
    assert [says(note, "left out: speed") for note in found.notes] == [True]


def test_anipose_3d_csv(tmp_path):
    """Anipose's 3D CSV needs a unit, because the file does not state it."""
    header = "nose_x,nose_y,nose_z,nose_error,nose_ncams,nose_score,M_00,M_01,center_0,fnum"
    path = save(tmp_path / "a.csv", f"{header}\n10,20,30,1,2,0.9,1,0,0,7\n,,,,,,1,0,0,8\n")
    pose = read_pose3d(path, unit="mm")
    assert (pose.names, pose.frames.tolist()) == (("nose",), [7, 8])
    np.testing.assert_allclose(pose.xyz_m[:, 0], [[0.01, 0.02, 0.03], [NAN] * 3])
    refuses(path, ("unit", "no unit", "m, cm, mm (--unit)"), read=read_pose3d)
    refuses(path, ("coords", "3D positions", "2D keypoints"))
    metres = save(tmp_path / "b.csv", "frame,nose_x_m,nose_y_m,nose_z_m\n0,1,2,3\n")
    assert read_pose3d(metres).xyz_m.tolist() == [[[1, 2, 3]]]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("frame,node,x,y\n0,a,1,2\n0.5,a,1,2\n", [("frames", "0.5 after 0", "increasing")]),
        ("frame,node,x,y\n0,a,1,one\n1,a,inf,2\n", [("line 3, x", "'inf'"), ("line 2, y", "'one'")]),
        ("frame,node,x,y\n0,a,1,2\n0,a,3,4\n", [("line 3", "second row")]),
        ("frame,node,x,y\n0,,1,2\n", [("names of points", "''")]),
        ("frame,node,x,y\n0,a,1\n1,a,2,3,4\n", [("line 2", "3 cells", 4), ("line 3", "5 cells", 4)]),
        ("frame,node,x,y\n", [("points", "no frames")]),
        ("frame,a_x,a_y\n0,1,2\n0,3,4\n", [("line 3", "second row")]),
    ],
)
def test_plain_csv_problems(tmp_path, text, expected):
    refuses(save(tmp_path / "a.csv", text), *expected)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("frame=F,x=X,y=Y", ["no bodypart"]),
        ("bodypart=B,x=X,y=Y", ["no frame"]),
        ("frame=F,where=B,x=X,y=Y", ["'where=B'", "no bodypart"]),
        ("frame=F,frame=G,bodypart=B,x=X,y=Y", ["'frame=G'"]),
        ("frame=F,x={bodypart}_x,y=Y", ["{bodypart} in x"]),
        ("frame", ["'frame'", "no bodypart, x, y"]),
    ],
)
def test_column_maps_that_are_wrong(text, found):
    with refusal(*(("--columns", "map", one) for one in found)):
        parse_map(text)


def test_frames_of_times():
    def frames(times, fps=None):
        found, rate = frames_of_times(Path("a"), np.array(times, dtype=float), fps)
        return found.tolist(), rate

    assert frames([0, 0.1, 0.2, 0.5]) == ([0, 1, 2, 5], 10)
    assert frames(np.arange(100, 10_000) / 29.97) == (list(range(100, 10_000)), 29.97)
    assert frames([1 / 3], 30) == ([10], 30)
    assert frames([7.0]) == ([0], None)
    # a clock error of 100 ppm and noise of a tenth of a frame shift no frame
    noisy = np.arange(5000) * 1.0001 / 120 + np.random.default_rng(0).uniform(-0.1, 0.1, 5000) / 120
    assert frames(noisy + 1.0, 120)[0] == list(range(120, 5120))


@pytest.mark.parametrize("fps", [24, 29.97, 60, 90])
def test_times_rounded_to_hundredths(fps):
    """The frame rate follows from the whole duration, although the median step is 0.01 or 0.02 s."""
    times = np.round(np.arange(100) / fps, 2)
    found, rate = frames_of_times(Path("a"), times, None)
    assert found.tolist() == list(range(100))
    assert rate == pytest.approx(fps, rel=2e-3)


@pytest.mark.parametrize("gaps", [(), (20, 21, 60)])
def test_times_of_a_jittering_clock(gaps):
    """The frame rate is estimated in spite of missing frames; if it is given, each time gets its nearest frame."""
    frames = np.setdiff1d(np.arange(200), gaps)
    times = 12.3 + (frames + np.random.default_rng(1).normal(0, 0.12, len(frames))) / 60
    found, rate = frames_of_times(Path("a"), times, None)
    assert (found - found[0]).tolist() == frames.tolist()
    assert rate == pytest.approx(60, rel=1e-3)
    nearest = nearest_frames(Path("a"), times, 60.0)
    assert (nearest - nearest[0]).tolist() == frames.tolist()


def test_times_of_a_variable_rate():
    """A variable rate, from 30 to 24 Hz as in a telephone's video, is refused unless a rate is given."""
    times = np.cumsum(1 / np.linspace(30, 24, 120))
    with refusal(("a", "time", ["variable frame rate: 33.4 to 41.7 ms"])):
        frames_of_times(Path("a"), times, None)
    found = nearest_frames(Path("a"), times, 30.0)
    assert np.abs(found / 30 - times).max() <= 1 / 60 + 1e-9
    with refusal(("a", "time", ["share a frame at 20"])):
        nearest_frames(Path("a"), times, 20.0)


@pytest.mark.parametrize(
    "stamp",
    [
        *("2026-05-04T12:59:{:010.7f}+02:00", "2026-05-04 12:59:{:06.3f}", "{:.2f}"),
        *("04.05.2026 12:59:{:06.3f}", "5/4/2026 12:59:{:06.3f} AM", "59:{:06.3f}"),
    ],
)
def test_a_table_of_times(stamp, tmp_path):
    """Time stamps in ISO 8601 are read with any precision, and `--fps` replaces the rate of rounded times."""
    fps = 150 if "59" not in stamp else 30
    rows = [stamp.format(2 + k / fps) + f",{k},{2 * k},0.9" for k in range(40)]
    (tmp_path / "clip.csv").write_text("\n".join(["timestamp,nose_x,nose_y,nose_likelihood", *rows]))
    found = read_keypoints(tmp_path / "clip.csv")
    assert found.fps == pytest.approx(fps, rel=1e-2)
    assert np.diff(found.frames).tolist() == [1] * 39
    np.testing.assert_array_equal(found.xy_px[:, 0, 1], 2 * np.arange(40))
    given = read_keypoints(tmp_path / "clip.csv", fps=float(fps))
    assert given.fps == pytest.approx(fps, rel=1e-6)
    assert np.diff(given.frames).tolist() == [1] * 39


@pytest.mark.parametrize(
    ("column", "times", "found", "expected"),
    [
        ("time", ["0", "17", "33", "50"], "times 17 s apart", "time_ms"),
        ("time", ["00:00:00:00", "00:00:00:01"], "'00:00:00:00'", "time stamps"),
        ("time", ["04.05.2026 23:59:59.9", "05.05.2026 00:00:00.0"], "'04.05.2026 23:59:59.9'", "time stamps"),
    ],
)
def test_times_that_cannot_be_read(column, times, found, expected, tmp_path):
    """Milliseconds without a unit, time codes, and dates of unknown format are refused."""
    path = tmp_path / "a.csv"
    path.write_text("\n".join([f"{column},nose_x,nose_y", *(f"{time},1,2" for time in times)]))
    with refusal((path, column, [found], expected)):
        read_keypoints(path)


@pytest.mark.parametrize("index", ["", "Unnamed: 0"])
def test_an_index_of_pandas(index, tmp_path):
    """An unnamed first column is ignored in DeepLabCut's tables, and has the frames in wide tables."""
    path = tmp_path / "a.csv"
    path.write_text("\n".join([f"{index},{TABLE[0]}", *(f"{i},{row}" for i, row in enumerate(TABLE[1:]))]))
    assert read_keypoints(path).xy_px[:, 0].tolist() == [[1.5, 2.25], [5, 6]]
    path.write_text(f"{index},nose_x,nose_y\n3,1,2\n5,3,4\n")
    wide = read_keypoints(path)
    assert (wide.frames.tolist(), wide.xy_px.tolist()) == ([3, 5], [[[1, 2]], [[3, 4]]])
    path.write_text("nose_x,nose_y,tail_x,tail_y\n1,2,3,4\n")
    with refusal((path, "columns", ["no frame and no time", "nose_x"], "a column frame")):
        read_keypoints(path)


def test_further_values_of_a_point_are_left_out(tmp_path):
    """The medians and variances that an ensemble Kalman smoother adds are not read, and named."""
    coords = ("x", "y", "likelihood", "x_ens_median", "y_posterior_var")
    rows = [["scorer"] + ["ensemble-kalman_tracker"] * 10, ["bodyparts"] + ["nose"] * 5 + ["tail"] * 5]
    rows += [["coords", *coords, *coords], ["0", *map(str, range(10, 20))]]
    rows[3][3] = rows[3][8] = "0.5"
    path = save(tmp_path / "a.csv", "\n".join(",".join(row) for row in rows) + "\n")
    found = read_keypoints(path)
    assert (found.names, found.xy_px.tolist()) == (("nose", "tail"), [[[10, 11], [15, 16]]])
    assert found.confidence.tolist() == [[0.5, 0.5]]
    assert found.notes == ("Columns left out: x_ens_median, y_posterior_var.",)
    in_space = "bodyparts,nose,nose,nose,nose\ncoords,x,y,z,confidence\n0,1,2,3,0.5\n"
    pose = read_pose3d(save(tmp_path / "b.csv", in_space), unit="m", up="z")
    assert (pose.xyz_m.tolist(), pose.notes) == ([[[1, 2, 3]]], ("Columns left out: confidence.",))
    # without a likelihood, an unknown coordinate may be a likelihood under another name
    path.write_text(path.read_text().replace("likelihood", "likely"))
    refuses(path, ("column nose/likely", "coordinate 'likely'"), *[("column nose/" + c, c) for c in coords[3:]])


TABLE = ["scorer,net,net,net,net", "bodyparts,nose,nose,tail,tail", "coords,x,y,x,y", "0,1.5,2.25,3,4", "1,5,6,,8.5"]


@pytest.mark.parametrize(
    "saved",
    [
        lambda text: "\ufeff" + text.replace(",", ";").replace(".", ","),
        lambda text: "sep=;\r\n" + text.replace(",", ";"),
        lambda text: text.replace(",", "\t").replace(".", ","),
        lambda text: text.replace("\n", ",,\n"),
        lambda text: '"sep=;"\n' + text.replace(",", ";"),
        lambda text: text.replace(",", "|"),
    ],
)
@pytest.mark.parametrize("wide", [False, True])
def test_a_table_that_excel_saved(saved, wide, tmp_path):
    """Excel writes decimal commas, a line with the separator, empty columns, and a byte order mark."""
    rows = ["frame,nose_x,nose_y,tail_x,tail_y", *TABLE[3:]] if wide else TABLE
    (tmp_path / "a.csv").write_text(saved("\n".join(rows) + "\n"), encoding="utf-8")
    found = read_keypoints(tmp_path / "a.csv")
    assert (found.names, found.frames.tolist()) == (("nose", "tail"), [0, 1])
    np.testing.assert_array_equal(found.xy_px, [[[1.5, 2.25], [3, 4]], [[5, 6], [np.nan, 8.5]]])


def test_headers_that_spreadsheets_leave(tmp_path):
    """The message names merged cells in the header, or the two networks whose tables are side by side."""
    path = tmp_path / "a.csv"
    path.write_text("\n".join([TABLE[0], "bodyparts,nose,,tail,", *TABLE[2:]]))
    with refusal((path, "header row bodyparts", ["empty cells after 'nose'", "merged"], "unmerge")):
        read_keypoints(path)
    path.write_text("\n".join(["scorer,a,a,b,b", "bodyparts,nose,nose,nose,nose", *TABLE[2:]]))
    with refusal((path, "scorer", "2 scorers: a, b", "one scorer")):
        read_keypoints(path)


def test_a_column_that_is_repeated(tmp_path):
    """A repeated column gives a note if its cells are equal, and is refused if they differ."""
    path = tmp_path / "a.csv"
    path.write_text("frame,nose_x,nose_y,frame\n0,1,2,0\n1,3,4,1\n")
    found = read_keypoints(path)
    assert found.xy_px.tolist() == [[[1, 2]], [[3, 4]]]
    assert "'frame' is in the table more than once" in " ".join(found.notes)
    path.write_text("frame,nose_x,nose_y,nose_x\n0,1,2,0\n1,3,4,1\n")
    with refusal((path, "header", "column 'nose_x' more than once", "columns of this name differ")):
        read_keypoints(path)


def test_blank_and_repeated_columns_of_deeplabcuts_tables(tmp_path):
    """Blank and repeated columns are left out, even if decimal commas are in quoted numbers."""
    path = tmp_path / "a.csv"
    rows = [
        ",scorer,net,,net,net",
        ",bodyparts,nose,,nose,nose",
        ",coords,x,,y,x",
        ',0,"0,5",,"2,25","0,5"',
        ",1,5,,6,5",
    ]
    path.write_text("\n".join(rows))
    found = read_keypoints(path)
    assert found.xy_px.tolist() == [[[0.5, 2.25]], [[5, 6]]]
    assert "Columns of nose are in the table more than once" in " ".join(found.notes)
    path.write_text("\n".join([*rows[:4], ",1,5,,6,7"]))
    with refusal((path, "bodypart nose", "different numbers", "one column for each coordinate")):
        read_keypoints(path)
    path.write_text("\n".join([*rows[:4], ",1,5,8,6,5"]))
    with refusal((path, "line 5", "5 cells", "4 cells, as in the header")):
        read_keypoints(path)


@pytest.mark.parametrize(
    ("column", "write", "first_s"),
    [
        ("time_ms", lambda s: f"{1e3 * s:.3f}", 2.0),
        ("time [ms]", lambda s: f"{1e3 * s:.3f}", 2.0),
        ("timestamp_ns", lambda s: f"{1_790_000_000 + s:.6f}".replace(".", "") + "000", 0.0),
        ("timestamp", lambda s: f"{1_790_000_000 + s:.6f}", 0.0),
        ("timestamp", lambda s: f"{1_790_000_000 + s:.3f}".replace(".", ""), 0.0),
        ("time", lambda s: f"00:00:{s:09.6f}", 2.0),
    ],
)
def test_units_of_times(column, write, first_s, tmp_path):
    """Time stamps since 1970 in any unit count from the first one."""
    rows = [f"{write(2 + k / 50)},{k},{2 * k}" for k in range(20)]
    (tmp_path / "a.csv").write_text("\n".join([f"{column},nose_x,nose_y", *rows]))
    found = read_keypoints(tmp_path / "a.csv")
    assert found.fps == pytest.approx(50, rel=1e-4)
    assert found.frames.tolist() == list(range(round(50 * first_s), round(50 * first_s) + 20))


@pytest.mark.parametrize("names", ["x_nose,y_nose,score_nose", "nose (x),nose (y),nose (score)"])
def test_names_of_columns_of_points(names, tmp_path):
    (tmp_path / "a.csv").write_text(f"frame,{names}\n0,1,2,0.9\n1,3,4,0.8\n")
    found = read_keypoints(tmp_path / "a.csv")
    assert (found.names, found.xy_px.tolist()) == (("nose",), [[[1, 2]], [[3, 4]]])
    assert found.confidence.tolist() == [[0.9], [0.8]]


CROPPED = "clipDLC_resnet50_runAug1shuffle1_1000"


@pytest.mark.parametrize("end", [".csv", "_filtered.csv"])
@pytest.mark.parametrize(
    ("about", "shift"),
    [
        ({"cropping": True, "cropping_parameters": [600, 1920, 50, 1080]}, (600, 50)),
        ({"cropping": True, "cropping_parameters": np.array([600, 1920, 50, 1080])[[0, 1, 2, 3]].tolist()}, (600, 50)),
        ({"cropping": np.bool_(True), "cropping_parameters": list(np.array([600.0, 1920, 50, 1080]))}, (600, 50)),
        (
            {"cropping": True, "cropping_parameters": (600, 1920, 50, 1080), "file": Path("a"), "x": np.eye(3)},
            (600, 50),
        ),
        ({"cropping": False, "cropping_parameters": [600, 1920, 50, 1080]}, (0, 0)),
        ({}, (0, 0)),
    ],
)
def test_the_crop_that_deeplabcut_states_is_applied(end, about, shift, tmp_path):
    """The crop's corner, in a file next to the table, is added to keypoints, and missing points stay missing."""
    rows = ["scorer" + ",net" * 3, "bodyparts" + ",nose" * 3, "coords,x,y,likelihood", "0,1.5,2.5,0.9", "1,0,0,0"]
    path = tmp_path / f"{CROPPED}{end}"
    path.write_text("\n".join(rows))
    (tmp_path / f"{CROPPED}_meta.pickle").write_bytes(pickle.dumps({"data": about | {"start": 1.0}}))
    found = read_keypoints(path)
    assert found.xy_px.tolist() == [[[1.5 + shift[0], 2.5 + shift[1]]], [[0, 0]]]
    assert ("crop of the picture (x 600 to 1920, y 50 to 1080" in " ".join(found.notes)) == any(shift)


def test_nothing_in_a_pickle_is_run(tmp_path):
    """A pickle of metadata that would run code is ignored."""
    rows = ["scorer" + ",net" * 3, "bodyparts" + ",nose" * 3, "coords,x,y,likelihood", "0,1.5,2.5,0.9"]
    (tmp_path / f"{CROPPED}.csv").write_text("\n".join(rows))
    harm = tmp_path / "harm"
    program = b"cos\nsystem\n(S'touch " + str(harm).encode() + b"'\ntR."
    (tmp_path / f"{CROPPED}_meta.pickle").write_bytes(program)
    found = read_keypoints(tmp_path / f"{CROPPED}.csv")
    assert found.xy_px.tolist() == [[[1.5, 2.5]]]
    assert f"{CROPPED}_meta.pickle cannot be read" in found.notes[-1]
    assert not harm.exists()


@pytest.mark.parametrize("edges", [None, [600], [-1, 5, 0, 5], np.array([600, 1920, 50, 1080])])
def test_a_crop_that_is_not_known_is_refused(edges, tmp_path):
    rows = ["scorer" + ",net" * 3, "bodyparts" + ",nose" * 3, "coords,x,y,likelihood", "0,1.5,2.5,0.9"]
    (tmp_path / f"{CROPPED}.csv").write_text("\n".join(rows))
    meta = tmp_path / f"{CROPPED}_meta.pickle"
    meta.write_bytes(pickle.dumps({"data": {"cropping": True, "cropping_parameters": edges}}))
    with refusal((meta, "cropping_parameters", [], "x1, x2, y1, y2")):
        read_keypoints(tmp_path / f"{CROPPED}.csv")


def test_alphapose(tmp_path):
    rows = [
        {"image_id": f"{k}.jpg", "keypoints": [k, 2, 0.9] * 16 + [0, 0, 0], "score": 2.0, "idx": track}
        for k in range(3)
        for track in (1, 2)
    ]
    (tmp_path / "a.json").write_text(json.dumps(rows))
    with refusal((tmp_path / "a.json", "individual", "2 animals", "1, 2")):
        read_keypoints(tmp_path / "a.json")
    found = read_keypoints(tmp_path / "a.json", "2")
    assert (found.names[0], len(found.names), found.frames.tolist()) == ("Nose", 17, [0, 1, 2])
    np.testing.assert_array_equal(found.xy_px[:, 0], [[0, 2], [1, 2], [2, 2]])
    assert not found.present[:, 16].any()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"Format Version,1.23,Take Name,a\n", ("an export of Motive (OptiTrack)", "TRC or C3D")),
        (b"\xef\xbb\xbfFormat Version;1.23;Take Name;a\n", ("an export of Motive (OptiTrack)", "TRC or C3D")),
        (b"Trajectories\n200\n,,dog:nose,,\n", ("Vicon Nexus", "C3D, or TRC")),
        (b"NO_OF_FRAMES\t3\n", ("Qualisys", "C3D")),
        (b"\x80\x04\x95\x00\x00", ("a pickle", ".h5 or .csv")),
        (b'{"0.jpg": {"version": "AlphaPose v0.3", "bodies": []}}', ("AlphaPose's results", "AlphaPose's own")),
        (b"%PDF-1.7 and more", ("a PDF", "DeepLabCut CSV")),
        (b'[{"bodyparts": [[[1, 2, 0.5]]]}]', ("DeepLabCut's JSON", ".h5 or .csv")),
        (b'[{"frame_id": 0, "instances": []}]', ("MMPose's predictions without names", "meta_info")),
        (b'[{"id": 4, "annotations": []}]', ("Label Studio", "in pixels")),
        (b'<?xml version="1.0" encoding="utf-8"?>\n<annotations>', ("CVAT", "COCO Keypoints")),
        (
            b"nose,nose,nose,nose,tail,tail,tail,tail\nx,y,z,confidence,x,y,z,confidence\n",
            ("JARVIS", "bodyparts, coords"),
        ),
        (b"\x93NUMPY\x01\x00v\x00{'descr'", ("NumPy", "names, xyz_m")),
        (b"Bild;Punkt;x;y\n1;nose;2;3\n", ("begins with 'Bild", "DeepLabCut CSV")),
    ],
)
def test_files_of_other_programs_are_named(content, expected, tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with refusal((path, "format", *expected)):
        read_keypoints(path)


def test_a_sleap_project_is_named(tmp_path):
    with h5py.File(tmp_path / "a.slp", "w") as file:
        file.create_group("metadata")
        file["frames"] = [0]
    with refusal((tmp_path / "a.slp", "format", "a SLEAP project", "Export Analysis HDF5")):
        read_keypoints(tmp_path / "a.slp")


LOST = [
    "PathFileType\t4\t(X/Y/Z)\ta.trc",
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
    "60\t60\t3\t2\tm",
    "Frame#\tTime\tpaw\t\t\torigin\t\t",
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
]


def test_lost_markers_that_are_written_as_zeros(tmp_path):
    """Zeros are read as missing, except for a point that is zero in all frames, which is an origin."""
    rows = ["0\t0.0\t1\t2\t3\t0\t0\t0", "1\t0.0167\t0\t0\t0\t0\t0\t0", "2\t0.0333\t0\t2\t3\t0\t0\t0"]
    (tmp_path / "a.trc").write_text("\n".join([*LOST, *rows]))
    found = read_pose3d(tmp_path / "a.trc", up="z")
    np.testing.assert_array_equal(found.xyz_m[:, 0], [[1, 2, 3], [np.nan] * 3, [0, 2, 3]])
    np.testing.assert_array_equal(found.xyz_m[:, 1], np.zeros((3, 3)))
    assert "Points at exactly (0, 0, 0) are taken as missing: paw in 1 frame." in found.notes


def test_another_number_for_lost_markers(tmp_path):
    """A number that occurs repeatedly in all three coordinates marks a lost marker, in tables as in TRC files."""
    rows = ["0,-9999,-9999,-9999,1,2,3", "1,1,2,4,-9999,-9999,-9999", "2,5,5,5,0,0,0"]
    (tmp_path / "a.csv").write_text("\n".join(["frame,paw_x,paw_y,paw_z,nose_x,nose_y,nose_z", *rows]))
    found = read_pose3d(tmp_path / "a.csv", unit="m", up="z")
    np.testing.assert_array_equal(found.xyz_m[:, 0], [[np.nan] * 3, [1, 2, 4], [5, 5, 5]])
    np.testing.assert_array_equal(found.xyz_m[:, 1], [[1, 2, 3], [np.nan] * 3, [np.nan] * 3])
    assert "exactly (-9999, -9999, -9999) and (0, 0, 0) are taken as missing" in " ".join(found.notes)
    rows = ["0,-0,0,-0.0,1,2,3", "1,1,2,4,9999999,9999999,9999999", "2,5,5,5,9999999,9999999,9999999"]
    (tmp_path / "b.csv").write_text("\n".join(["frame,paw_x,paw_y,paw_z,nose_x,nose_y,nose_z", *rows]))
    (note,) = read_pose3d(tmp_path / "b.csv", unit="m", up="z").notes
    assert "exactly (0, 0, 0) and (9999999, 9999999, 9999999)" in note


@pytest.mark.parametrize(
    ("up", "expected"),
    [
        *((None, [1, 2, 3]), ("z", [1, 2, 3]), ("y", [1, -3, 2]), ("-y", [1, 3, -2])),
        *(("x", [2, 3, 1]), ("-x", [2, -3, -1]), ("-z", [1, -2, -3])),
    ],
)
def test_the_upward_axis_of_positions(up, expected, tmp_path):
    """Every upward axis that can be stated gives a rotation, such as -y for DeepLabCut's first camera."""
    path = tmp_path / "a.csv"
    path.write_text("scorer,DLC_3D,DLC_3D,DLC_3D\nbodyparts,a,a,a\ncoords,x,y,z\n0,1,2,3\n")
    found = read_pose3d(path, unit="m", up=up)
    assert found.xyz_m.tolist() == [[expected]]
    assert "--up -y" in found.notes[0]
    axes = path.with_name("axes.csv")
    axes.write_text("scorer,s,s,s\nbodyparts,a,a,a\ncoords,x,y,z\n0,1,0,0\n1,0,1,0\n2,0,0,1\n")
    assert np.linalg.det(read_pose3d(axes, unit="m", up=up).xyz_m[:, 0]) == pytest.approx(1)
    with refusal((path, "up", "down", "-y if y points down")):
        read_pose3d(path, unit="m", up="down")


@pytest.mark.parametrize(("scorer", "asked"), [("DLC_3D", True), ("recon", False), (None, False)])
def test_the_unit_of_triangulated_positions(scorer, asked, tmp_path):
    """DeepLabCut's triangulated positions are in the unit of the board, and recon's are in metres."""
    rows = [] if scorer is None else [f"scorer,{scorer},{scorer},{scorer}"]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([*rows, "bodyparts,nose,nose,nose", "coords,x,y,z", "0,100,200,3000"]))
    if asked:
        with refusal((path, "unit", "no unit", "--unit")):
            read_pose3d(path)
    found = read_pose3d(path, unit="mm" if asked else None)
    np.testing.assert_allclose(found.xyz_m[0, 0], np.array([100, 200, 3000]) / (1000 if asked else 1))
    assert any("triangulated by DeepLabCut" in note for note in found.notes) == asked


BROKEN = "track,frame_idx,nose.x,nose.y,nose.score,tail.x,tail.y,tail.score"


def test_tracks_of_one_animal_are_joined(tmp_path):
    """The message suggests joining two tracks that never overlap in time, but not a third animal's track."""
    rows = [f"track_0,{k},{k},1,0.9,{k},2,0.8" for k in range(5)]
    rows += [f",{k},{k},1,0.9,{k},2,0.8" for k in range(5, 8)] + [f"other,{k},9,9,0.9,9,9,0.8" for k in range(8)]
    (tmp_path / "a.csv").write_text("\n".join([BROKEN, *rows]))
    together = "--individual track_0,untracked"
    with refusal((tmp_path / "a.csv", "individual", "3 animals", ["track_0, untracked, other", together])):
        read_keypoints(tmp_path / "a.csv")
    found = read_keypoints(tmp_path / "a.csv", "track_0,untracked")
    assert (found.individual, found.frames.tolist()) == ("track_0,untracked", list(range(8)))
    np.testing.assert_array_equal(found.xy_px[:, 0, 0], np.arange(8))
    np.testing.assert_array_equal(found.confidence, [[0.9, 0.8]] * 8)
    assert read_keypoints(tmp_path / "a.csv", "untracked").frames.tolist() == [5, 6, 7]
    with refusal((tmp_path / "a.csv", "individual track_0,other", "frame 0 and 4 more", "never overlap")):
        read_keypoints(tmp_path / "a.csv", "track_0,other")


@pytest.mark.parametrize(("frames", "text"), [([0], ["0"]), ([3, 4, 5, 9, 11, 12], ["3-5", "9", "11-12"])])
def test_frames_as_text(frames, text):
    assert frames_text(np.array(frames)) == text
    assert frames_of_text(text).tolist() == frames


@pytest.mark.parametrize("text", [[], ["a"], ["3-1"], ["1", "1"], ["5", "2"], ["1-2-3"]])
def test_other_text_is_not_read_as_frames(text):
    assert frames_of_text(text) is None
