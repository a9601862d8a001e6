"""Test that every format keeps all values, and that other programs' readers read recon's files."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refusal, refused, says
from exact_tables import read_csv
from typer.testing import CliRunner

from recon.base.outputs import RECORD
from recon.cli.app import app
from recon.cli.convert import ConvertSettings, choose_format, convert
from recon.clip import Keypoints
from recon.io.common import Pose3D
from recon.io.formats import CONVERTED, FORMATS, Format, read_keypoints
from recon.io.positions import read_pose3d
from recon.robotics.retarget_clip import FORMATS as ROBOT_FORMATS

NAN = float("nan")
FRAMES = np.array([7, 8, 9, 10, 14])
FPS = 119.88
OF_2D = [f for f in FORMATS if "2D" in f.writes]
OF_3D = [f for f in FORMATS if "3D" in f.writes]
OF_POINTS = [f for f in FORMATS if f in OF_2D or f in OF_3D]
TOLERANCE_M = {"c3d": 3e-7}  # numbers of 32 bits, in millimetres


def label(f: Format) -> str:
    return f.name + f.suffixes[0]


def a_clip(frames: np.ndarray = FRAMES) -> Keypoints:
    """Return a clip of three keypoints with a missing frame, missing points and one unknown likelihood."""
    rng = np.random.default_rng(0)
    xy, confidence = rng.uniform(0, 1000, (len(frames), 3, 2)), rng.uniform(0.1, 1, (len(frames), 3))
    xy[-1, 2], confidence[-1, 2] = NAN, 0.0
    xy[1:2, :], confidence[1:2, :] = NAN, 0.0
    xy[0, 1], confidence[0, 0] = 0.0, NAN
    names = ("nose", "ñandú 鼻", "tail base")
    return Keypoints(names, xy, confidence, frames, fps=FPS, individual="Phantom é")


def a_pose(frames: np.ndarray = FRAMES) -> Pose3D:
    xyz_m = np.random.default_rng(1).normal(size=(len(frames), 4, 3))
    xyz_m[-1, 2] = xyz_m[1:2] = xyz_m[:1, 3] = NAN
    edges = (("tail", "鼻"), ("鼻", "ear"))
    return Pose3D(("鼻", "tail", "ear", "paw"), xyz_m, frames, fps=FPS, edges=edges)


def assert_same_keypoints(found: Keypoints, expected: Keypoints) -> None:
    assert found.names == expected.names
    assert found.fps == expected.fps
    assert found.individual == expected.individual
    np.testing.assert_array_equal(found.frames, expected.frames)
    np.testing.assert_array_equal(found.xy_px, expected.xy_px)
    known = expected.present
    np.testing.assert_array_equal(found.confidence[known], expected.confidence[known])
    assert not (found.confidence[~known] > 0).any()


def assert_same_pose(found: Pose3D, expected: Pose3D, tolerance_m: float = 0.0) -> None:
    assert sorted(found.names) == sorted(expected.names)
    assert found.fps == expected.fps
    np.testing.assert_array_equal(found.frames, expected.frames)
    at = [found.names.index(name) for name in expected.names]
    np.testing.assert_allclose(found.xyz_m[:, at], expected.xyz_m, rtol=0, atol=tolerance_m)


@pytest.fixture(scope="module")
def files_2d(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("2d")
    paths = {label(f): folder / f"clip_{f.name}{f.suffixes[0]}" for f in OF_2D}
    for f in OF_2D:
        f.write(a_clip(), paths[label(f)])
    return paths


@pytest.fixture(scope="module")
def files_3d(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("3d")
    paths = {label(f): folder / f"clip_{f.name}{f.suffixes[0]}" for f in OF_3D}
    for f in OF_3D:
        f.write(a_pose(), paths[label(f)])
    return paths


def pairs(formats: Sequence[Format]) -> list[tuple[Format, Format]]:
    """Return pairs of formats: each format to the next and to itself, and the last to the first."""
    return [pair for i, one in enumerate(formats) for pair in ((one, one), (one, formats[(i + 1) % len(formats)]))]


@pytest.mark.parametrize(("start", "end"), pairs(OF_2D), ids=label)
def test_pairs_of_2d_formats(files_2d, start, end, tmp_path):
    out = tmp_path / f"out{end.suffixes[0]}"
    done = convert(ConvertSettings(source=files_2d[label(start)], out=out, to=end.name))
    assert done.data == {"out": out, "format": end.name, "notes": ()}
    assert_same_keypoints(read_keypoints(out), a_clip())


@pytest.mark.parametrize(("start", "end"), pairs(OF_3D), ids=label)
def test_pairs_of_3d_formats(files_3d, start, end, tmp_path):
    out = tmp_path / f"out{end.suffixes[0]}"
    done = convert(ConvertSettings(source=files_3d[label(start)], out=out))
    assert done.data == {"out": out, "format": end.name, "notes": ()}
    tolerance_m = max(TOLERANCE_M.get(start.name, 0), TOLERANCE_M.get(end.name, 0))
    assert_same_pose(read_pose3d(out), a_pose(), tolerance_m)


@pytest.mark.parametrize(
    "frames",
    [
        pytest.param(np.array([0]), id="0", marks=pytest.mark.slow),
        pytest.param(np.array([120]), id="120"),
        pytest.param(np.arange(3), id="0-2", marks=pytest.mark.slow),
        pytest.param(np.arange(70_000, 70_004), id="7e4"),
    ],
)
@pytest.mark.parametrize("target", OF_POINTS, ids=label)
def test_single_frames_and_other_first_frames_are_kept(target, frames, tmp_path):
    path = tmp_path / f"clip{target.suffixes[0]}"
    if target in OF_2D:
        target.write(a_clip(frames), path)
        assert_same_keypoints(read_keypoints(path), a_clip(frames))
    if target in OF_3D:
        target.write(a_pose(frames), path)
        assert_same_pose(read_pose3d(path), a_pose(frames), TOLERANCE_M.get(target.name, 0.0))


@pytest.mark.parametrize("target", OF_POINTS, ids=label)
def test_without_a_frame_rate(target, tmp_path):
    path = tmp_path / f"clip{target.suffixes[0]}"
    for write, data, read in (
        ("2D" in target.writes and target.write, replace(a_clip(), fps=None, individual=None), read_keypoints),
        ("3D" in target.writes and target.write, replace(a_pose(), fps=None), read_pose3d),
    ):
        if write and target.fps == "needed":
            with refusal(("--fps", "fps", "no frame rate", "such as 90")):
                write(data, path)
            assert not path.exists()
        elif write:
            write(data, path)
            found = read(path)
            assert found.fps is None
            assert found.frames.tolist() == FRAMES.tolist()
            assert getattr(found, "individual", None) is None


def test_edges_are_kept(files_3d):
    found = {frozenset(edge) for edge in read_pose3d(files_3d["nwb.nwb"]).edges}
    assert found == {frozenset(edge) for edge in a_pose().edges}


@pytest.mark.parametrize(
    ("target", "name", "found"),
    [
        ("nwb", "a/b", "'a/b', with '/'"),
        ("trc", "a\tb", r"with '\t'"),
        ("c3d", " nose", "' nose', with ' '"),
        ("c3d", "鼻" * 100, "300 bytes"),
    ],
)
def test_names_that_a_format_cannot_hold(target, name, found, tmp_path):
    of = next(f for f in FORMATS if f.name == target)
    with refusal((of.title, "name", found)):
        of.write(Pose3D((name,), np.zeros((2, 1, 3)), np.arange(2), fps=10.0), tmp_path / "a")
    assert list(tmp_path.iterdir()) == []


def test_frame_numbers_far_apart(tmp_path):
    c3d = next(f for f in FORMATS if f.name == "c3d")
    with refusal(("C3D", "frames", 10**9 + 1)):
        c3d.write(a_pose(np.array([0, 10**9])), tmp_path / "a")


@pytest.mark.parametrize("name", ["deeplabcut.csv", "deeplabcut.h5"])
def test_deeplabcut_by_pandas(files_2d, files_3d, name):
    for path, coords, values in (
        (files_2d[name], "x y likelihood", np.dstack([a_clip().xy_px, a_clip().confidence])),
        (files_3d[name], "x y z", a_pose().xyz_m),
    ):
        levels = ["scorer", "individuals", "bodyparts", "coords"]
        if path is files_3d[name]:
            levels.remove("individuals")
        if name.endswith("csv"):
            table = read_csv(path, header=list(range(len(levels))), index_col=0)
        else:
            table = pd.read_hdf(path, key="df_with_missing")
        assert list(table.columns.names) == levels
        assert set(table.columns.get_level_values("scorer")) == {"recon_119.88fps"}
        assert table.columns.get_level_values("coords").tolist() == coords.split() * values.shape[1]
        assert table.index.tolist() == FRAMES.tolist()
        np.testing.assert_array_equal(table.to_numpy(), values.reshape(5, -1))


def test_deeplabcut_h5_for_every_pandas(files_2d):
    """The header is plain text and states an old version of pandas, so that every pandas reads the file."""
    import tables  # slow to import

    with tables.open_file(str(files_2d["deeplabcut.h5"])) as file:
        attributes = file.root.df_with_missing._v_attrs
        assert attributes.pandas_version == "0.15.2"
        assert attributes.pandas_type == "frame_table"
        ((axis, columns),) = attributes.non_index_axes
        assert axis == 1
        assert columns[0] == ("recon_119.88fps", "Phantom é", "nose", "x")
        assert {type(text) for column in columns for text in column} == {str}


@pytest.mark.parametrize("kind", ["2D", "3D"])
def test_movement_by_xarray(files_2d, files_3d, kind):
    import xarray

    path = (files_2d if kind == "2D" else files_3d)["movement.nc"]
    values = a_clip().xy_px if kind == "2D" else a_pose().xyz_m
    with xarray.open_dataset(path) as data:
        assert data["position"].dims == ("time", "space", "keypoint", "individual")
        assert data["confidence"].dims == ("time", "keypoint", "individual")
        assert data["space"].to_numpy().tolist() == list("xyz"[: int(kind[0])])
        assert data.attrs["ds_type"] == "poses"
        assert data.attrs["fps"] == FPS
        assert data.attrs["time_unit"] == "seconds"
        assert data.attrs.get("length_unit") == (None if kind == "2D" else "m")
        np.testing.assert_allclose(data["time"].to_numpy(), FRAMES / FPS, rtol=1e-15)
        if kind == "2D":
            assert data["individual"].to_numpy().tolist() == ["Phantom é"]
            one = data["position"].sel(keypoint="tail base", individual="Phantom é", space="y")
            np.testing.assert_array_equal(one.to_numpy(), values[:, 2, 1])
        np.testing.assert_array_equal(data["position"].to_numpy()[..., 0], values.transpose(0, 2, 1))


@pytest.mark.parametrize("kind", ["2D", pytest.param("3D", marks=pytest.mark.slow)])
def test_nwb_by_pynwb(files_2d, files_3d, kind):
    from ndx_pose import PoseEstimation
    from pynwb import NWBHDF5IO, validate

    path = (files_2d if kind == "2D" else files_3d)["nwb.nwb"]
    with NWBHDF5IO(str(path), "r") as io:
        file = io.read()
        assert validate(io=io) == []
        behavior = file.processing["behavior"]
        (poses,) = (p for p in behavior.data_interfaces.values() if isinstance(p, PoseEstimation))
        data = a_clip() if kind == "2D" else a_pose()
        assert tuple(poses.skeleton.nodes) == data.names
        assert poses.name == ("Phantom é" if kind == "2D" else "PoseEstimation")
        for k, name in enumerate(data.names):
            series = poses.pose_estimation_series[name]
            np.testing.assert_allclose(series.timestamps[:], FRAMES / FPS, rtol=1e-15)
            if isinstance(data, Keypoints):
                np.testing.assert_array_equal(series.data[:], data.xy_px[:, k])
                np.testing.assert_array_equal(series.confidence[:], data.confidence[:, k])
                assert series.unit == "pixels"
            else:
                np.testing.assert_array_equal(series.data[:], data.xyz_m[:, k])
                assert series.unit == "metres"
                assert series.reference_frame.endswith("z up")
        if kind == "3D":
            assert np.array(poses.skeleton.edges[:]).tolist() == [[1, 0], [0, 2]]


def test_regular_nwb_has_a_rate(tmp_path):
    from pynwb import NWBHDF5IO

    nwb = next(f for f in FORMATS if f.name == "nwb")
    nwb.write(replace(a_clip(np.arange(30, 34)), fps=30.0), tmp_path / "a.nwb")
    with NWBHDF5IO(str(tmp_path / "a.nwb"), "r") as io:
        poses = io.read().processing["behavior"]["Phantom é"]
        assert poses.pose_estimation_series["nose"].rate == 30.0
        assert poses.pose_estimation_series["nose"].starting_time == 1.0


def test_plain_csv_by_csv(files_2d):
    with files_2d["long.csv"].open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["frame", "individual", "bodypart", "x", "y", "likelihood", "fps"]
    assert len(rows) == 15
    assert rows[2] == {
        "frame": "7",
        "individual": "Phantom é",
        "bodypart": "tail base",
        "x": repr(float(a_clip().xy_px[0, 2, 0])),
        "y": repr(float(a_clip().xy_px[0, 2, 1])),
        "likelihood": repr(float(a_clip().confidence[0, 2])),
        "fps": "119.88",
    }
    assert rows[3]["x"] == rows[3]["y"] == ""


def test_parquet_by_pandas(files_3d):
    table = pd.read_parquet(files_3d["parquet.parquet"])
    assert list(table.columns) == ["frame", "joint", "x_m", "y_m", "z_m"]
    for axis, i in (("x_m", 0), ("z_m", 2)):
        wide = table.pivot_table(index="frame", columns="joint", values=axis, dropna=False)
        np.testing.assert_array_equal(wide[list(a_pose().names)].to_numpy(), a_pose().xyz_m[..., i])


def test_c3d_by_ezc3d(files_3d):
    """Points are missing in C3D if their residual is -1, as in all frames of a gap."""
    import ezc3d

    file = ezc3d.c3d(str(files_3d["c3d.c3d"]))
    point = file["parameters"]["POINT"]
    assert point["LABELS"]["value"] == list(a_pose().names)
    assert point["UNITS"]["value"] == ["mm"]
    assert point["RATE"]["value"] == pytest.approx([FPS], rel=1e-7)
    assert point["X_SCREEN"]["value"] == ["+X"]
    assert point["Y_SCREEN"]["value"] == ["+Z"]
    assert file["parameters"]["RECON"]["FRAMES"]["value"] == ["7-10", "14"]
    assert file["header"]["points"]["first_frame"] == 7
    expected_mm = np.full((8, 4, 3), NAN)
    expected_mm[FRAMES - 7] = a_pose().xyz_m * 1000
    missing = np.isnan(expected_mm[..., 0])
    residual = file["data"]["meta_points"]["residuals"][0].T
    np.testing.assert_array_equal(residual, np.where(missing, -1, 0))
    points_mm = file["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(points_mm[~missing], expected_mm[~missing], rtol=1e-6)


def test_more_points_than_one_list_of_labels_holds(tmp_path):
    names = tuple(f"p{i}" for i in range(300))
    pose = Pose3D(names, np.random.default_rng(0).normal(size=(2, 300, 3)), np.arange(2), fps=100.0)
    next(f for f in FORMATS if f.name == "c3d").write(pose, tmp_path / "a.c3d")
    assert_same_pose(read_pose3d(tmp_path / "a.c3d"), pose, 3e-7)


def test_trc_by_its_layout(files_3d):
    """A TRC file has x, z and -y of a position in metres, and three empty cells for a missing point."""
    lines = files_3d["trc.trc"].read_text(encoding="utf-8").splitlines()
    assert lines[0].split("\t")[:3] == ["PathFileType", "4", "(X/Y/Z)"]
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    assert header["Units"] == "m"
    assert float(header["DataRate"]) == FPS
    assert (header["NumFrames"], header["NumMarkers"], header["OrigDataStartFrame"]) == ("5", "4", "7")
    assert lines[3].split("\t") == ["Frame#", "Time", "鼻", "", "", "tail", "", "", "ear", "", "", "paw", "", ""]
    assert lines[4].split("\t")[:5] == ["", "", "X1", "Y1", "Z1"]
    table = read_csv(files_3d["trc.trc"], sep="\t", skiprows=5, header=None)
    assert table[0].tolist() == FRAMES.tolist()
    np.testing.assert_allclose(table[1], FRAMES / FPS)
    x, y, z = a_pose().xyz_m[..., 0], a_pose().xyz_m[..., 1], a_pose().xyz_m[..., 2]
    np.testing.assert_array_equal(table.to_numpy()[:, 2:].reshape(5, 4, 3), np.stack([x, z, -y], axis=2))
    assert lines[6].split("\t")[2:] == [""] * 12


def test_npz_by_numpy(files_3d):
    with np.load(files_3d["npz.npz"]) as file:
        np.testing.assert_array_equal(file["xyz_m"], a_pose().xyz_m)
        assert file["names"].tolist() == list(a_pose().names)
        assert file["frames"].tolist() == FRAMES.tolist()
        assert float(file["fps"]) == FPS


def test_choice_of_format():
    def chosen(name: str, to: str | None = None) -> str:
        return choose_format(Path(name), to).title

    assert chosen("a.csv") == "DeepLabCut CSV"
    assert chosen("a.CSV", "long") == "plain CSV"
    assert chosen("a.h5") == "DeepLabCut H5"
    with refusal(("a.xyz", "extension", "'.xyz'", ".csv, .h5")):
        choose_format(Path("a.xyz"), None)
    with refusal(("a.csv", "extension", "'.csv'", "one of: .trc")):
        choose_format(Path("a.csv"), "trc")
    with refusal(("--to", "format", "'fbx'", "deeplabcut, movement")):
        choose_format(Path("a.csv"), "fbx")


def test_2d_and_3d_are_not_converted_into_each_other(files_2d, files_3d, tmp_path):
    with refusal((files_2d["movement.nc"], "content", "2D keypoints", "3D positions for TRC")):
        convert(ConvertSettings(source=files_2d["movement.nc"], out=tmp_path / "a.trc"))
    with refusal(
        (files_3d["movement.nc"], "content", "3D positions", ["2D keypoints for plain CSV", "--to deeplabcut"])
    ):
        convert(ConvertSettings(source=files_3d["movement.nc"], out=tmp_path / "a.csv", to="long"))
    with refusal(("--up", "IN", ["2D keypoints", files_2d["movement.nc"]], "no --up")):
        convert(ConvertSettings(source=files_2d["movement.nc"], out=tmp_path / "a.csv", up="z"))
    assert list(tmp_path.iterdir()) == []


def test_every_problem_at_once(tmp_path):
    (tmp_path / "a.csv").write_text("nothing of use\n")
    path = tmp_path / "a.csv"
    with refusal(
        (path, "format", "nothing of use"),
        ("--to", "format", "'fbx'"),
        (path, "file", "an input of this run", "another OUT"),
    ):
        convert(ConvertSettings(source=path, out=path, to="fbx"))
    assert path.read_text() == "nothing of use\n"


def test_a_failed_conversion_leaves_no_folder(files_2d, tmp_path):
    out = tmp_path / "new" / "a.nwb"
    no_rate = replace(a_clip(), fps=None)
    FORMATS[0].write(no_rate, tmp_path / "a.csv")
    with refusal(("--fps", "fps", "no frame rate")):
        convert(ConvertSettings(source=tmp_path / "a.csv", out=out))
    assert not out.parent.exists()
    convert(ConvertSettings(source=tmp_path / "a.csv", out=out, fps=50))
    found = read_keypoints(out)
    assert found.fps == 50
    assert found.frames.tolist() == FRAMES.tolist()
    assert {p.name for p in out.parent.iterdir()} == {"a.nwb", RECORD}
    with refusal(("OUT", "file", out, "--overwrite")):
        convert(ConvertSettings(source=files_2d["movement.nc"], out=out))
    convert(ConvertSettings(source=files_2d["movement.nc"], out=out, overwrite=True))
    assert read_keypoints(out).fps == FPS


def test_frame_rate_as_given_overrules_the_file(files_2d, tmp_path):
    notes = convert(ConvertSettings(source=files_2d["movement.nc"], out=tmp_path / "a.nc", fps=240)).data["notes"]
    assert [says(note, "119.88 frames", "240 as given") for note in notes] == [True]
    found = read_keypoints(tmp_path / "a.nc")
    assert found.fps == 240
    assert found.frames.tolist() == FRAMES.tolist()
    with refusal(("settings", "fps", -3, "greater than 0")):
        convert(ConvertSettings(source=files_2d["movement.nc"], out=tmp_path / "b.nc", fps=-3))


def test_zero_zero_is_missing_everywhere(tmp_path):
    text = "scorer,n,n,n\nbodyparts,nose,nose,nose\ncoords,x,y,likelihood\n0,0,0,0\n1,0,0,0.9\n2,3,4,\n"
    (tmp_path / "a.csv").write_text(text)
    notes = convert(ConvertSettings(source=tmp_path / "a.csv", out=tmp_path / "a.nc")).data["notes"]
    assert [says(note, "1 points", "(0, 0)", "missing") for note in notes] == [True]
    found = read_keypoints(tmp_path / "a.nc")
    np.testing.assert_array_equal(found.xy_px[:, 0], [[NAN, NAN], [0, 0], [3, 4]])
    np.testing.assert_array_equal(found.confidence[:, 0], [0, 0.9, NAN])


def test_columns_by_a_map(tmp_path):
    (tmp_path / "a.csv").write_text("Nr;Node;U;V;Q\n3;nose;1.5;2;0.5\n4;nose;;;\n", encoding="utf-8")
    named = "frame=Nr, bodypart=Node, x=U, y=V, likelihood=Q"
    convert(ConvertSettings(source=tmp_path / "a.csv", out=tmp_path / "b.csv", columns=named, fps=25))
    found = read_keypoints(tmp_path / "b.csv")
    assert (found.names, found.frames.tolist(), found.fps) == (("nose",), [3, 4], 25)
    np.testing.assert_array_equal(found.xy_px[:, 0], [[1.5, 2], [NAN, NAN]])
    (tmp_path / "c.csv").write_text("t,X of a,Y of a,Z of a\n0,1,2,3\n0.5,4,5,6\n", encoding="utf-8")
    wide = "time=t,x=X of {bodypart},y=Y of {bodypart},z=Z of {bodypart}"
    with refusal((tmp_path / "c.csv", "unit", "no unit", "m, cm, mm")):
        convert(ConvertSettings(source=tmp_path / "c.csv", out=tmp_path / "c.trc", columns=wide))
    convert(ConvertSettings(source=tmp_path / "c.csv", out=tmp_path / "c.trc", columns=wide, unit="cm", up="y"))
    pose = read_pose3d(tmp_path / "c.trc")
    np.testing.assert_allclose(pose.xyz_m[:, 0], [[0.01, -0.03, 0.02], [0.04, -0.06, 0.05]])
    assert (pose.fps, pose.frames.tolist()) == (2, [0, 1])


@pytest.fixture(scope="module")
def results(small_trajectory, tmp_path_factory) -> Path:
    from recon import FitSettings, write_clip

    folder = tmp_path_factory.mktemp("results")
    settings = FitSettings(keypoints=Path("run.csv"), fps=30, hfov_deg=64.0, image_size_px=(1920, 1080))
    write_clip(small_trajectory, settings, folder)
    return folder


def test_folder_of_results(results, tmp_path):
    """A folder of results is converted with z up, the report's frame rate and the skeleton's limbs."""
    from recon.fit.motion import Motion

    notes = convert(ConvertSettings(source=results, out=tmp_path / "a.nwb")).data["notes"]
    assert "level frame" in notes[0]
    expected = Motion.load(results).upright
    found = read_pose3d(tmp_path / "a.nwb")
    assert_same_pose(found, replace(expected, fps=30.0))
    assert ("neck_base", "nose") in found.edges or ("nose", "neck_base") in found.edges
    given = {"unit": "mm", "individual": "a"}
    with refusal(*((f"--{name}", "IN", ["results", results], f"no --{name}") for name in given)):
        convert(ConvertSettings(source=results, out=tmp_path / "b.nwb", **given))
    with refusal((tmp_path, "folder", "no motion.npz", "recon fit")):
        convert(ConvertSettings(source=tmp_path, out=tmp_path / "b.nwb"))


def run(*arguments: str | Path):
    return CliRunner().invoke(app, ["convert", *map(str, arguments)])


def test_results_as_json_have_the_verdict_of_the_report(whole_results, tmp_path):
    said = json.loads(run(whole_results, tmp_path / "a.csv", "--json").output)
    assert said["verdict"] == json.loads((whole_results / "report.json").read_text(encoding="utf-8"))["verdict"]


def test_command(files_3d, tmp_path):
    done = run(files_3d["trc.trc"], tmp_path / "a.c3d")
    assert done.exit_code == 0
    expected = f"{tmp_path}/a.c3d: C3D, 4 joints, 3D, frames 7 to 14 (5), 119.88 frames per second\n"
    assert done.output == expected


def test_command_lists_formats():
    listed = json.loads(run("--list", "--json").output)
    assert [row["--to"] for row in listed] == [*(f.name for f in CONVERTED), *ROBOT_FORMATS]
    shown = run("--list").output
    assert all(f.name in shown for f in CONVERTED)


def test_command_names_problems(tmp_path):
    missing, unknown = (tmp_path / "none.csv", "file", "no such file"), (tmp_path / "a.xyz", "extension", "'.xyz'")
    refused(["convert", tmp_path / "none.csv", tmp_path / "a.xyz"], missing, unknown)
    refused(["convert", "a.csv"], ("recon convert", "files", "one file", "IN and OUT"))


def test_missing_library_says_what_to_install(monkeypatch, files_3d, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with refusal((files_3d["parquet.parquet"], "format", "pyarrow", "[formats]")):
        convert(ConvertSettings(source=files_3d["parquet.parquet"], out=tmp_path / "a.csv"))
