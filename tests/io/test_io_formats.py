"""Formats beside DeepLabCut's: layouts that occur in the field, and files that are broken."""

from __future__ import annotations

import json
import pickle
import struct
import warnings
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from command_line import refusal, says
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from recon import FitSettings, InputError
from recon.cli.convert import ConvertSettings, convert
from recon.clip import Keypoints
from recon.io.calibration import read_cameras
from recon.io.columns import parse_map
from recon.io.common import NoChoiceError, Pose3D
from recon.io.formats import FORMATS, read_keypoints
from recon.io.positions import read_pose3d
from recon.io.times import frames_of_times, nearest_frames
from recon.io.writing import frames_of_text, frames_text

NAN = float("nan")


def refuses(path: Path, *expected: tuple[object, ...], individual: str | None = None, read=read_keypoints) -> None:
    """expected: each problem as for `refusal`, without the file."""
    with refusal(*((path, *one) for one in expected)):
        read(path, individual)


def save(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8", newline="")
    return path


# SLEAP

NODES, TRACKS = ["nose", "tail", "ear"], ["a", "b"]
XY = np.random.default_rng(0).uniform(0, 100, (5, 2, 3, 2))  # frame, track, node, xy
SCORE = np.random.default_rng(1).uniform(0, 1, (5, 2, 3))
SLEAP_AXES = {"f": "frame", "t": "track", "n": "node", "c": "xy"}


def sleap_file(path: Path, tracks="tcnf", scores="tnf", occupancy="ft", dims: bool = True, **more) -> Path:
    """An analysis file with its axes in this order; `more` replaces datasets, None leaves one out."""
    import h5py

    occupied = np.ones((5, 2), np.uint8)
    occupied[0, 1] = 0
    arrays = {
        "tracks": (np.einsum(f"ftnc->{tracks}", XY), tracks),
        "point_scores": (np.einsum(f"ftn->{scores}", SCORE), scores),
        "track_occupancy": (np.einsum(f"ft->{occupancy}", occupied), occupancy),
    }
    datasets = {name: array for name, (array, _) in arrays.items()}
    datasets |= {"node_names": np.array([n.encode() for n in NODES]), "track_names": np.array([b"a", b"b"])}
    with h5py.File(path, "w") as file:
        for name, data in (datasets | more).items():
            if data is not None:
                file[name] = data
                if dims and name in arrays:
                    file[name].attrs["dims"] = json.dumps([SLEAP_AXES[axis] for axis in arrays[name][1]])
    return path


@pytest.mark.parametrize(
    ("orders", "dims"),
    [
        (("tcnf", "tnf", "ft"), False),
        (("tcnf", "tnf", "ft"), True),
        (("ftnc", "ftn", "ft"), True),
        (("nfct", "nft", "tf"), True),
    ],
    ids=["no-dims", "matlab", "standard", "custom"],
)
def test_sleap(tmp_path, orders, dims):
    path = sleap_file(tmp_path / "a.h5", *orders, dims=dims)
    a, b = read_keypoints(path, "a"), read_keypoints(path, "b")
    assert (a.names, a.individual, a.fps) == (tuple(NODES), "a", None)
    assert a.frames.tolist() == [0, 1, 2, 3, 4]
    assert b.frames.tolist() == [1, 2, 3, 4]  # not occupied in the first
    np.testing.assert_array_equal(a.xy_px, XY[:, 0])
    np.testing.assert_array_equal(b.xy_px, XY[1:, 1])
    np.testing.assert_array_equal(b.confidence, SCORE[1:, 1])
    refuses(path, ("individual", ["2 animals", "--individual"], "a, b"))
    refuses(path, ("individual", "'c'", "a, b"), individual="c")


def test_sleap_not_transposed(tmp_path):
    import h5py

    path = sleap_file(tmp_path / "a.h5", "fnct", dims=False)
    with h5py.File(path, "a") as file:
        file.attrs["transpose"] = False
    np.testing.assert_array_equal(read_keypoints(path, "a").xy_px, XY[:, 0])


def test_sleap_tracks_without_points_are_no_choice(tmp_path):
    occupied = np.zeros((5, 2))
    occupied[1:3, 1] = 1
    path = sleap_file(tmp_path / "a.h5", track_occupancy=occupied)
    found = read_keypoints(path)
    assert (found.individual, found.frames.tolist()) == ("b", [1, 2])


def test_sleap_without_scores_and_names(tmp_path):
    path = sleap_file(tmp_path / "a.h5", point_scores=None, track_occupancy=None, track_names=np.zeros(0))
    found = read_keypoints(path, "track_1")
    assert np.isnan(found.confidence).all()
    assert found.individual is None
    np.testing.assert_array_equal(found.xy_px, XY[:, 1])


def test_sleap_problems(tmp_path):
    refuses(
        sleap_file(tmp_path / "a.h5", node_names=np.array([b"x", b"x"]), point_scores=np.ones((2, 3, 4))),
        ("names of points", "'x'", "unique"),
        ("names of points", 2, 3),
        ("likelihoods", "(4, 2, 3)", "(5, 2, 3)"),
    )
    path = sleap_file(tmp_path / "c.h5", dims=False, point_scores=np.ones((5, 2)))
    refuses(path, ("point_scores", ["float64 (5, 2)", "track, node, frame"], "track, node, frame"))
    path = sleap_file(tmp_path / "d.h5", dims=False, track_occupancy=np.zeros((5, 2)))
    refuses(path, ("frames", "none with the animal"), individual="a")


def test_real_sleap(shared_data):
    path = next((shared_data / "importer-files" / "sleap").glob("*.h5"))
    found = read_keypoints(path)
    assert found.names == ("top", "front", "rear")
    import h5py

    with h5py.File(path) as file:
        np.testing.assert_array_equal(found.xy_px[:, 1, 0], file["tracks"][0, 0, 1, :])
        np.testing.assert_array_equal(found.confidence[:, 2], file["point_scores"][0, 2, :])


# movement


def movement_data(plural: bool, space: str = "xy", **attributes):
    import xarray

    s = "s" if plural else ""
    values = np.random.default_rng(0).uniform(0, 9, (4, len(space), 3, 2))
    return xarray.Dataset(
        {
            "position": (("time", "space", f"keypoint{s}", f"individual{s}"), values),
            "confidence": (("time", f"keypoint{s}", f"individual{s}"), values[:, 0] / 10),
        },
        coords={
            "time": np.arange(4) / 25.0,
            "space": list(space),
            f"keypoint{s}": NODES,
            f"individual{s}": TRACKS,
        },
        attrs={"ds_type": "poses", "fps": 25.0, "time_unit": "seconds", "source_software": "SLEAP"} | attributes,
    )


def test_movement_animals_without_points_are_no_choice(tmp_path):
    data = movement_data(False)
    data["position"][..., 1] = np.nan
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    assert read_keypoints(tmp_path / "a.nc").individual == "a"


@pytest.mark.parametrize("plural", [False, True])
def test_movement(tmp_path, plural):
    data = movement_data(plural)
    data.to_netcdf(tmp_path / "a.nc", engine="scipy")
    refuses(tmp_path / "a.nc", ("format", "netCDF 3", "netCDF 4"))
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    found = read_keypoints(tmp_path / "a.nc", "b")
    assert (found.names, found.individual, found.fps) == (tuple(NODES), "b", 25.0)
    assert found.frames.tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(found.xy_px, data["position"].to_numpy()[..., 1].transpose(0, 2, 1))
    np.testing.assert_array_equal(found.confidence, data["confidence"].to_numpy()[..., 1])
    refuses(tmp_path / "a.nc", ("individual", "2 animals", "a, b"))


def test_movement_attributes_of_other_kinds(tmp_path):
    """They say nothing."""
    data = movement_data(False, fps=[1.0, 2.0], time_unit=[1, 2], ds_type=[1, 2])
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    found = read_keypoints(tmp_path / "a.nc", "a")
    assert (found.fps, found.frames.tolist()) == (25.0, [0, 1, 2, 3])


def test_movement_without_numbers_of_its_dimensions(tmp_path):
    """Other programs than h5netcdf say only in each dimension which variables it belongs to."""
    import h5py

    data = movement_data(True)
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with h5py.File(tmp_path / "a.nc", "a") as file:
        for name in ("position", "confidence"):
            del file[name].attrs["_Netcdf4Coordinates"]
    found = read_keypoints(tmp_path / "a.nc", "b")
    np.testing.assert_array_equal(found.xy_px, data["position"].to_numpy()[..., 1].transpose(0, 2, 1))


def test_movement_in_frames(tmp_path):
    data = movement_data(True, time_unit="frames").assign_coords(time=[3, 4, 8, 9])
    del data.attrs["fps"]
    data.isel(individuals=[0]).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    found = read_keypoints(tmp_path / "a.nc")
    assert found.frames.tolist() == [3, 4, 8, 9]
    assert found.fps is None


def test_movement_3d(tmp_path):
    """The unit is not part of movement's format: it has to be given, unless the file is ours."""
    data = movement_data(False, "xyz")
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    refuses(tmp_path / "a.nc", ("coords", "x, y, z: 3D positions", "2D keypoints"), individual="a")
    refuses(tmp_path / "a.nc", ("unit", "none", "m, cm, mm (--unit)"), individual="a", read=read_pose3d)
    pose = read_pose3d(tmp_path / "a.nc", "a", unit="mm")
    values = data["position"].to_numpy()[..., 0].transpose(0, 2, 1)
    np.testing.assert_allclose(pose.xyz_m, values / 1000)
    turned = read_pose3d(tmp_path / "a.nc", "a", unit="m", up="y").xyz_m
    np.testing.assert_array_equal(turned, np.stack([values[..., 0], -values[..., 2], values[..., 1]], axis=2))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d.rename({"keypoint": "node"}), ("position", "time, space, node", "keypoint, space")),
        (lambda d: d.assign_coords(space=["y", "x"]), ("space", "y, x", "x, y or x, y, z")),
        (lambda d: d.assign_coords(keypoint=["a", "a", "b"]), ("names of points", "'a'", "unique")),
        (lambda d: d.assign_coords(time=[0, 1, 1, 2]), ("time", "do not increase")),
        (lambda d: d.assign_coords(time=[0, 0.04, 0.1, 0.2]), ("time", ["variable frame rate: 40 to 100 ms"])),
        (lambda d: d.assign_attrs(ds_type="bboxes"), ("ds_type", "bboxes", "poses")),
        (lambda d: d.isel(time=[]), ("points", "no frames")),
    ],
)
def test_movement_problems(tmp_path, change, expected):
    change(movement_data(False)).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    refuses(tmp_path / "a.nc", expected, individual="a")


# NWB


def test_real_nwb(shared_data):
    folder = shared_data / "importer-files" / "ndx-pose"
    for name in ("0.3.0_poseestimation_one_camera.nwb", "0.3.0_poseestimation_two_cameras.nwb"):
        found = read_keypoints(folder / name)
        assert found.names == ("front_left_paw", "front_right_paw")
        assert found.frames.tolist() == list(range(10))
        assert found.fps == pytest.approx(0.9)
        import h5py

        with h5py.File(folder / name) as file:
            series = file["processing/behavior/PoseEstimation/front_right_paw"]
            np.testing.assert_array_equal(found.xy_px[:, 1], series["data"])
            np.testing.assert_array_equal(found.confidence[:, 1], series["confidence"])
    paw = ("PoseEstimation/front_right_paw", "(100, 2)", ["(100, 3)", "front_left_paw"])
    refuses(folder / "0.1.1_poseestimation_nodes_edges.nwb", paw)
    refuses(folder / "0.1.1_poseestimation_no_cameras.nwb", ("PoseEstimationSeries", "none", "ndx-pose"))


def nwb_file(path: Path, edit=None) -> Path:
    """Two animals, a and b, of our own writer, which `edit` may change."""
    import h5py

    write = next(f.write for f in FORMATS if f.name == "nwb")
    clip = Keypoints(("nose", "tail"), XY[:, 0, :2], SCORE[:, 0, :2], np.arange(5), fps=20.0, individual="a")
    write(clip, path)
    with h5py.File(path, "a") as file:
        behavior = file["processing/behavior"]
        behavior.copy("a", "b")
        for name in ("nose", "tail"):
            behavior[f"b/{name}/data"][:] += 1
        if edit:
            edit(behavior)
    return path


def test_nwb_of_several_animals(tmp_path):
    path = nwb_file(tmp_path / "a.nwb")
    refuses(path, ("individual", "2 animals", "a, b"))
    found = read_keypoints(path, "b")
    assert found.individual == "b"
    np.testing.assert_array_equal(found.xy_px, XY[:, 0, :2] + 1)


def test_nwb_problems(tmp_path):
    def shift(behavior):
        behavior["a/tail/starting_time"][()] = 7.0

    refuses(
        nwb_file(tmp_path / "a.nwb", shift),
        ("a/tail", ["times", "nose"], "the same times for all points"),
        individual="a",
    )

    def explode(behavior):
        behavior["a/nose/data"][2] = np.inf

    refuses(nwb_file(tmp_path / "c.nwb", explode), ("points", "infinite"), individual="a")

    def shorten(behavior):
        del behavior["a/tail/confidence"]
        behavior["a/tail/confidence"] = np.ones(3)

    counts = ("tail", "5 positions, 3 confidences and 5 times")
    refuses(nwb_file(tmp_path / "b.nwb", shorten), counts, individual="a")


# COCO

COCO = {
    "images": [
        {"id": 5, "file_name": "v/img012.png", "width": 64, "height": 48},
        {"id": 6, "file_name": "v/img010.png"},
    ],
    "annotations": [
        {"id": 1, "image_id": 5, "category_id": 1, "keypoints": [1, 2, 2, 0, 0, 0], "track_id": 3},
        {"id": 2, "image_id": 6, "category_id": 1, "keypoints": [3, 4, 1, 5, 6, 2], "track_id": 3},
    ],
    "categories": [{"id": 1, "name": "cheetah", "keypoints": ["nose", "tail"]}],
}


def test_coco(tmp_path):
    found = read_keypoints(save(tmp_path / "a.json", json.dumps(COCO)))
    assert found.names == ("nose", "tail")
    assert found.frames.tolist() == [10, 12]
    np.testing.assert_array_equal(found.xy_px, [[[3, 4], [5, 6]], [[1, 2], [NAN, NAN]]])
    np.testing.assert_array_equal(found.confidence, [[NAN, NAN], [NAN, 0]])
    assert found.individual is found.fps is found.image_size_px is None
    assert [says(note, "numbered", "file names") for note in found.notes] == [True]


def test_coco_of_several_animals(tmp_path):
    second = [dict(a, track_id=4, id=9, keypoints=[9] * 6) for a in COCO["annotations"]]
    path = save(tmp_path / "a.json", json.dumps(COCO | {"annotations": COCO["annotations"] + second}))
    refuses(path, ("individual", "2 animals", "3, 4"))
    assert read_keypoints(path, "4").xy_px.tolist() == [[[9, 9], [9, 9]]] * 2
    assert read_keypoints(path, "4").individual == "4"


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"annotations": [*COCO["annotations"], COCO["annotations"][0]]}, ("annotation 1", ["second", "frame 12"])),
        ({"annotations": [dict(COCO["annotations"][0], keypoints=[1, 2])]}, ("content", "array of size 2")),
        ({"annotations": [dict(COCO["annotations"][0], image_id=8)]}, ("content", "without 8")),
        ({"annotations": [dict(COCO["annotations"][0], keypoints=["x"] * 6)]}, ("content", "'x'")),
        ({"categories": [{"id": 1, "name": "cheetah"}]}, ("categories", "0 lists", "one")),
        ({"categories": [{"id": 1, "keypoints": ["a", "a"]}]}, ("names of points", "'a'", "unique")),
        ({"images": [{"file_name": "x.png"}]}, ("content", "without 'id'")),
        ({"images": {}}, ("content", "without 5")),
        ({"images": [{"id": 5}, {"id": 5}]}, ("images", "not unique")),
        (
            {"images": [{"id": -(10**14)}, {"id": 6}], "annotations": []},
            ("frames", "-100000000000000", "increasing"),
        ),
        ({"images": [{"id": 0}, {"id": 2**70}], "annotations": []}, ("content", "too large")),
    ],
)
def test_coco_problems(tmp_path, change, expected):
    refuses(save(tmp_path / "a.json", json.dumps(COCO | change)), expected)


# Plain CSV

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


def test_columns_that_mean_nothing_are_named(tmp_path):
    found = read_keypoints(save(tmp_path / "a.csv", "frame,nose_x,nose_y,speed\n0,1,2,3\n"))
    assert [says(note, "left out: speed") for note in found.notes] == [True]


def test_anipose_3d_csv(tmp_path):
    """Its unit is the calibration board's, which the file does not say."""
    header = "nose_x,nose_y,nose_z,nose_error,nose_ncams,nose_score,M_00,M_01,center_0,fnum"
    path = save(tmp_path / "a.csv", f"{header}\n10,20,30,1,2,0.9,1,0,0,7\n,,,,,,1,0,0,8\n")
    pose = read_pose3d(path, unit="mm")
    assert (pose.names, pose.frames.tolist()) == (("nose",), [7, 8])
    np.testing.assert_allclose(pose.xyz_m[:, 0], [[0.01, 0.02, 0.03], [NAN] * 3])
    refuses(path, ("unit", "none", "m, cm, mm (--unit)"), read=read_pose3d)
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


# Frame numbers


def test_frames_of_times():
    def frames(times, fps=None):
        found, rate = frames_of_times(Path("a"), np.array(times, dtype=float), fps)
        return found.tolist(), rate

    assert frames([0, 0.1, 0.2, 0.5]) == ([0, 1, 2, 5], 10)
    assert frames(np.arange(100, 10_000) / 29.97) == (list(range(100, 10_000)), 29.97)
    assert frames([1 / 3], 30) == ([10], 30)
    assert frames([7.0]) == ([0], None)
    # A clock that is 100 ppm off, and noise of a tenth of a frame, shift no frame.
    noisy = np.arange(5000) * 1.0001 / 120 + np.random.default_rng(0).uniform(-0.1, 0.1, 5000) / 120
    assert frames(noisy + 1.0, 120)[0] == list(range(120, 5120))


@pytest.mark.parametrize("fps", [24, 29.97, 60, 90])
def test_times_rounded_to_hundredths(fps):
    """The rate comes from the whole duration: the median step is 0.01 or 0.02 s, whatever the rate is."""
    times = np.round(np.arange(100) / fps, 2)
    found, rate = frames_of_times(Path("a"), times, None)
    assert found.tolist() == list(range(100))
    assert rate == pytest.approx(fps, rel=2e-3)


@pytest.mark.parametrize("gaps", [(), (20, 21, 60)])
def test_times_of_a_jittering_clock(gaps):
    """With frames missing, too, and with the rate given every time gets its nearest frame."""
    frames = np.setdiff1d(np.arange(200), gaps)
    times = 12.3 + (frames + np.random.default_rng(1).normal(0, 0.12, len(frames))) / 60
    found, rate = frames_of_times(Path("a"), times, None)
    assert (found - found[0]).tolist() == frames.tolist()
    assert rate == pytest.approx(60, rel=1e-3)
    nearest = nearest_frames(Path("a"), times, 60.0)
    assert (nearest - nearest[0]).tolist() == frames.tolist()


def test_times_of_a_variable_rate():
    """A telephone that goes from 30 to 24 frames a second: refused without a rate, and with one each time has the
    nearest frame of it."""
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
    """ISO 8601 as Bonsai writes them, with milliseconds only, and seconds of which several are the same; --fps counts
    in place of the rate that rounded times say."""
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
    """Milliseconds without a unit, frames in a time code, and midnight in a date of which the format is not known."""
    path = tmp_path / "a.csv"
    path.write_text("\n".join([f"{column},nose_x,nose_y", *(f"{time},1,2" for time in times)]))
    with refusal((path, column, [found], expected)):
        read_keypoints(path)


@pytest.mark.parametrize("index", ["", "Unnamed: 0"])
def test_an_index_of_pandas(index, tmp_path):
    """DeepLabCut's table, read by pandas and written again, has a column of row numbers; a wide one has the frames
    there."""
    path = tmp_path / "a.csv"
    path.write_text("\n".join([f"{index},{TABLE[0]}", *(f"{i},{row}" for i, row in enumerate(TABLE[1:]))]))
    assert read_keypoints(path).xy_px[:, 0].tolist() == [[1.5, 2.25], [5, 6]]
    path.write_text(f"{index},nose_x,nose_y\n3,1,2\n5,3,4\n")
    wide = read_keypoints(path)
    assert (wide.frames.tolist(), wide.xy_px.tolist()) == ([3, 5], [[[1, 2]], [[3, 4]]])
    path.write_text("nose_x,nose_y,tail_x,tail_y\n1,2,3,4\n")
    with refusal((path, "columns", ["no frame and no time", "nose_x"], "a column frame")):
        read_keypoints(path)


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
    """Decimal commas, a line that states the separator, empty columns behind the last, a byte order mark."""
    rows = ["frame,nose_x,nose_y,tail_x,tail_y", *TABLE[3:]] if wide else TABLE
    (tmp_path / "a.csv").write_text(saved("\n".join(rows) + "\n"), encoding="utf-8")
    found = read_keypoints(tmp_path / "a.csv")
    assert (found.names, found.frames.tolist()) == (("nose", "tail"), [0, 1])
    np.testing.assert_array_equal(found.xy_px, [[[1.5, 2.25], [3, 4]], [[5, 6], [np.nan, 8.5]]])


def test_headers_that_spreadsheets_leave(tmp_path):
    """Merged cells, and the tables of two networks side by side, are named."""
    path = tmp_path / "a.csv"
    path.write_text("\n".join([TABLE[0], "bodyparts,nose,,tail,", *TABLE[2:]]))
    with refusal((path, "header row bodyparts", ["empty cells after 'nose'", "merged"], "unmerge")):
        read_keypoints(path)
    path.write_text("\n".join(["scorer,a,a,b,b", "bodyparts,nose,nose,nose,nose", *TABLE[2:]]))
    with refusal((path, "scorer", "2 scorers: a, b", "one scorer")):
        read_keypoints(path)


def test_a_column_that_is_repeated(tmp_path):
    """As pandas leaves an index: it is named where its cells are the same, and refused where they differ."""
    path = tmp_path / "a.csv"
    path.write_text("frame,nose_x,nose_y,frame\n0,1,2,0\n1,3,4,1\n")
    found = read_keypoints(path)
    assert found.xy_px.tolist() == [[[1, 2]], [[3, 4]]]
    assert "'frame' is in the table more than once" in " ".join(found.notes)
    path.write_text("frame,nose_x,nose_y,nose_x\n0,1,2,0\n1,3,4,1\n")
    with refusal((path, "header", "column 'nose_x' more than once", "columns of this name differ")):
        read_keypoints(path)


def test_blank_and_repeated_columns_of_deeplabcuts_tables(tmp_path):
    """Blank columns anywhere are left out, equal columns read once, and a number below 1 in quotes has a decimal
    comma."""
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
    with refusal((path, "bodypart nose", "different numbers", "one of each kind")):
        read_keypoints(path)
    path.write_text("\n".join([*rows[:4], ",1,5,8,6,5"]))
    with refusal((path, "line 5", "5 cells", "4, as in the header")):
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
    """Stamps since 1970 count from the first, whatever their unit."""
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
def test_the_crop_that_deeplabcut_states_beside_its_table(end, about, shift, tmp_path):
    """Missing points stay (0, 0)."""
    rows = ["scorer" + ",net" * 3, "bodyparts" + ",nose" * 3, "coords,x,y,likelihood", "0,1.5,2.5,0.9", "1,0,0,0"]
    path = tmp_path / f"{CROPPED}{end}"
    path.write_text("\n".join(rows))
    (tmp_path / f"{CROPPED}_meta.pickle").write_bytes(pickle.dumps({"data": about | {"start": 1.0}}))
    found = read_keypoints(path)
    assert found.xy_px.tolist() == [[[1.5 + shift[0], 2.5 + shift[1]]], [[0, 0]]]
    assert ("crop of the picture (x 600 to 1920, y 50 to 1080" in " ".join(found.notes)) == any(shift)


def test_nothing_in_a_pickle_is_run(tmp_path):
    """A file of metadata that would do something is not used."""
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
    """A point that is zero throughout is an origin, and stays."""
    rows = ["0\t0.0\t1\t2\t3\t0\t0\t0", "1\t0.0167\t0\t0\t0\t0\t0\t0", "2\t0.0333\t0\t2\t3\t0\t0\t0"]
    (tmp_path / "a.trc").write_text("\n".join([*LOST, *rows]))
    found = read_pose3d(tmp_path / "a.trc", up="z")
    np.testing.assert_array_equal(found.xyz_m[:, 0], [[1, 2, 3], [np.nan] * 3, [0, 2, 3]])
    np.testing.assert_array_equal(found.xyz_m[:, 1], np.zeros((3, 3)))
    assert "Points at exactly (0, 0, 0) are taken as missing: paw in 1 frame." in found.notes


def test_another_number_for_lost_markers(tmp_path):
    """A number three times counts if it occurs again; a table of positions is read as TRC is."""
    rows = ["0,-9999,-9999,-9999,1,2,3", "1,1,2,4,-9999,-9999,-9999", "2,5,5,5,0,0,0"]
    (tmp_path / "a.csv").write_text("\n".join(["frame,paw_x,paw_y,paw_z,nose_x,nose_y,nose_z", *rows]))
    found = read_pose3d(tmp_path / "a.csv", unit="m", up="z")
    np.testing.assert_array_equal(found.xyz_m[:, 0], [[np.nan] * 3, [1, 2, 4], [5, 5, 5]])
    np.testing.assert_array_equal(found.xyz_m[:, 1], [[1, 2, 3], [np.nan] * 3, [np.nan] * 3])
    assert "exactly (-9999, -9999, -9999) and (0, 0, 0) are taken as missing" in " ".join(found.notes)


@pytest.mark.parametrize(
    ("up", "expected"),
    [
        *((None, [1, 2, 3]), ("z", [1, 2, 3]), ("y", [1, -3, 2]), ("-y", [1, 3, -2])),
        *(("x", [2, 3, 1]), ("-x", [2, -3, -1]), ("-z", [1, -2, -3])),
    ],
)
def test_the_upward_axis_of_positions(up, expected, tmp_path):
    """DeepLabCut's are those of its first camera, y down. Every choice is a rotation."""
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
    """DeepLabCut's are in units of the board; ours, and tables without a scorer, are metres."""
    rows = [] if scorer is None else [f"scorer,{scorer},{scorer},{scorer}"]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([*rows, "bodyparts,nose,nose,nose", "coords,x,y,z", "0,100,200,3000"]))
    if asked:
        with refusal((path, "unit", "none", "--unit")):
            read_pose3d(path)
    found = read_pose3d(path, unit="mm" if asked else None)
    np.testing.assert_allclose(found.xyz_m[0, 0], np.array([100, 200, 3000]) / (1000 if asked else 1))
    assert any("DeepLabCut triangulated" in note for note in found.notes) == asked


BROKEN = "track,frame_idx,nose.x,nose.y,nose.score,tail.x,tail.y,tail.score"


def test_tracks_of_one_animal_are_joined(tmp_path):
    """A track that broke, and frames that were corrected and have none: their names are offered together, because they
    never overlap in time; a third animal is there all the time."""
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
def test_other_text_is_no_frames(text):
    assert frames_of_text(text) is None


# 3D files of others


def test_real_trc(shared_data):
    """Commas for tabs, millimetres, a header that announces more frames than there are."""
    path = shared_data / "importer-files" / "c3d-trc" / "markers.trc"
    pose = read_pose3d(path, up="z")
    table = pd.read_csv(path, skiprows=6, header=None)
    assert pose.names[:2] == ("ASISl", "ASISr")
    assert (len(pose.names), pose.fps, pose.frames[0], len(pose.frames)) == (51, 100, 1, 93)
    np.testing.assert_allclose(pose.xyz_m.reshape(93, -1), table.to_numpy()[:, 2:155] / 1000)
    assert [says(note, "652 frames", 93) for note in pose.notes] == [True]
    assert says(read_pose3d(path).notes[1], "way is up")
    # Under y up, which is wrong for this file, what it calls y is our z.
    np.testing.assert_array_equal(read_pose3d(path).xyz_m[..., 2], pose.xyz_m[..., 1])


def c3d_bytes(processor: int, integers: bool) -> bytes:
    """Two frames, 5 and 6, of two points and one analog channel, on the computer of choice (84 Intel, 86 MIPS); the
    second point is missing in the first frame."""
    order = ">" if processor == 86 else "<"

    def floats(*values: float) -> bytes:
        return struct.pack(f"{order}{len(values)}f", *values)

    def words(*values: int) -> bytes:
        return struct.pack(f"{order}{len(values)}h", *values)

    def record(name: str, group: int, rest: bytes) -> bytes:
        return struct.pack("bb", len(name), group) + name.encode() + words(2 + len(rest)) + rest

    scale = 0.5 if integers else -1.0
    records = record("POINT", -1, b"\0") + record("RATE", 1, b"\4\0" + floats(50.0) + b"\0")
    records += record("LABELS", 1, b"\xff\2\4\2" + b"noseear " + b"\0") + record("UNITS", 1, b"\xff\1\2mm\0")
    records += record("SCALE", 1, b"\4\0" + floats(scale) + b"\0") + record("Y_SCREEN", 1, b"\xff\1\2+Y\0")
    section = (bytes([1, 0x50, 1, processor]) + records).ljust(512, b"\0")
    header = bytes([2, 0x50]) + words(2, 1, 5, 6, 0) + floats(scale) + words(3, 1) + floats(50.0)
    rows = [(2, 4, 6, 0, 0, 0, 0, -1, 9), (8, 10, 12, 0, 14, 16, 18, 0, 9)]
    data = b"".join(words(*row) if integers else floats(*row) for row in rows)
    return header.ljust(512, b"\0") + section + data


@pytest.mark.parametrize("integers", [False, True])
@pytest.mark.parametrize("processor", [84, 86])
def test_c3d_of_other_computers(tmp_path, processor, integers):
    path = tmp_path / "a.c3d"
    path.write_bytes(c3d_bytes(processor, integers))
    pose = read_pose3d(path)
    assert (pose.names, pose.fps, pose.frames.tolist()) == (("nose", "ear"), 50.0, [4, 5])
    scale = 0.5 if integers else 1.0
    # y up: x forwards, y up, z right becomes x, -z, y
    expected = np.array([[[2, -6, 4], [NAN, NAN, NAN]], [[8, -12, 10], [14, -18, 16]]]) * scale / 1000
    np.testing.assert_allclose(pose.xyz_m, expected, rtol=1e-6)
    whole = c3d_bytes(processor, integers)
    path.write_bytes(whole[:-1])
    with refusal((path, "content", f"{len(whole) - 1} bytes of {len(whole)}")):
        read_pose3d(path)


def test_real_c3d(shared_data):
    import ezc3d

    path = shared_data / "importer-files" / "c3d-trc" / "markers_analogs.c3d"
    pose = read_pose3d(path)
    raw = ezc3d.c3d(str(path))
    assert pose.names == tuple(raw["parameters"]["POINT"]["LABELS"]["value"])
    assert (pose.fps, pose.frames[0], len(pose.frames)) == (100, 0, 580)
    np.testing.assert_allclose(pose.xyz_m, raw["data"]["points"][:3].transpose(2, 1, 0) / 1000)
    missing = raw["data"]["meta_points"]["residuals"][0].T < 0
    assert missing.sum() == 305
    np.testing.assert_array_equal(np.isnan(pose.xyz_m[..., 0]), missing)


BVH = """\
HIERARCHY
ROOT hips
{
  OFFSET 0.0 1.0 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT knee
  {
    OFFSET 0.0 -2.0 0.0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 1.0 0.0 0.0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 0 0 0 0 0 0 0 0
1 2 3 90 0 0 0 90 0
"""


def test_bvh_by_hand(tmp_path):
    """At rest the knee is 2 below, its end 1 along x. In the second frame the hips, at (1, 2, 3), turn by 90 degrees
    about z, so that -y becomes x: the knee is at (3, 2, 3). A turn of the knee about its own x leaves its end, which
    lies on that axis, 1 along what x has become, y."""
    pose = read_pose3d(save(tmp_path / "a.bvh", BVH), unit="m", up="z")
    assert pose.names == ("hips", "knee", "knee_end")
    expected = [[[0, 0, 0], [0, -2, 0], [1, -2, 0]], [[1, 2, 3], [3, 2, 3], [3, 3, 3]]]
    np.testing.assert_allclose(pose.xyz_m, expected, atol=1e-12)
    assert pose.fps == pytest.approx(30, rel=1e-5)
    assert pose.edges == (("hips", "knee"), ("knee", "knee_end"))
    refuses(tmp_path / "a.bvh", ("unit", "none", "m, cm, mm (--unit)"), read=read_pose3d)
    centimetres = read_pose3d(tmp_path / "a.bvh", unit="cm")
    np.testing.assert_allclose(centimetres.xyz_m[1, 1], [0.03, -0.03, 0.02])
    assert says(centimetres.notes[0], "with y up")


def test_bvh_against_another_reader(tmp_path):
    rows = np.random.default_rng(0).uniform(-180, 180, (20, 9))
    head = BVH[: BVH.index("Frames:")].replace(
        "Zrotation Xrotation Yrotation\n    End", "Yrotation Zrotation Xrotation\n    End"
    )
    numbers = "\n".join(" ".join(map(str, row)) for row in rows)
    path = save(tmp_path / "a.bvh", f"{head}Frames: 20\nFrame Time: 0.01\n{numbers}\n")
    pose = read_pose3d(path, unit="m", up="z")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its dependencies
        bvhio = pytest.importorskip("bvhio")
        root = bvhio.readAsHierarchy(str(path))
    for t in range(20):
        root.loadPose(t)
        for j, (joint, _, _) in enumerate(root.layout()):
            assert joint.Name == pose.names[j]
            np.testing.assert_allclose(pose.xyz_m[t, j], tuple(joint.PositionWorld), atol=1e-4)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("Frames: 2", "Frames: 3"), ("MOTION", "2 rows, and Frames: 3")),
        (("1 2 3 90 0 0 0 90 0", "1 2 3 90"), ("line 20", "4 cells", 9)),
        (("Frame Time: 0.0333333", "Frame Time: 0"), ("Frame Time", 0, "above 0")),
        (("1 2 3 90 0 0 0 90 0", "1 2 3 90 0 0 0 90 x"), ("line 20, knee Yrotation", "'x'", "number")),
        (("CHANNELS 3 Zrotation", "CHANNELS 3 Zscale"), ("content", ["Zscale", "hierarchy"])),
        (("OFFSET 1.0 0.0 0.0", "OFFSET 1.0"), ("content", ["'OFFSET 1.0'", "hierarchy"])),
        (("MOTION", ""), ("content", ["'Frames: 2'", "hierarchy"])),
        (("JOINT knee", "JOINT hips"), ("names of points", "'hips'", "unique")),
        (("Frames: 2", "Frames: 0_2"), ("MOTION", "2 rows, and Frames: 0")),
    ],
)
def test_bvh_problems(tmp_path, change, expected):
    assert change[0] in BVH
    refuses(save(tmp_path / "a.bvh", BVH.replace(*change)), expected, read=read_pose3d)


TRC = """\
PathFileType\t4\t(X/Y/Z)\ta.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
50\t50\t2\t2\tmm\t50\t1\t2
Frame#\tTime\ta\t\t\tb\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2
1\t0\t1\t2\t3\t\t\t
2\t0.02\t4\t5\t6\t7\t8\t9
"""


def test_trc(tmp_path):
    pose = read_pose3d(save(tmp_path / "a.trc", TRC))
    assert (pose.names, pose.frames.tolist(), pose.fps) == (("a", "b"), [1, 2], 50)
    expected = np.array([[[1, -3, 2], [NAN] * 3], [[4, -6, 5], [7, -9, 8]]]) / 1000
    np.testing.assert_allclose(pose.xyz_m, expected)
    with refusal((tmp_path / "a.trc", "unit", ["m as given", "mm in"])):
        read_pose3d(tmp_path / "a.trc", unit="m")


def test_trc_problems_come_together(tmp_path):
    text = TRC.replace("\tmm\t", "\tin\t").replace("50\t50\t2\t2", "x\t50\t2\t3").replace("\n1\t0\t1", "\nI\t0\tone")
    cells = ("line 6, Frame#", "'I'"), ("line 6, a X", "'one'")
    refuses(save(tmp_path / "a.trc", text), *cells, read=read_pose3d)
    text = TRC.replace("\tmm\t", "\tin\t").replace("50\t50\t2\t2", "x\t50\t2\t3")
    refuses(save(tmp_path / "a.trc", text), ("unit", "in", "m, cm, mm (--unit)"), read=read_pose3d)
    refuses(save(tmp_path / "a.trc", TRC[:-4]), ("line 7", "7 cells", 8), read=read_pose3d)


def test_npz_problems(tmp_path):
    np.savez(tmp_path / "a.npz", xyz_m=np.zeros((2, 1, 3)), names=np.array([1]), frames=np.arange(2), fps=1.0)
    refuses(tmp_path / "a.npz", ("content", "without 'edges'", "NPZ"), read=read_pose3d)
    np.savez(
        tmp_path / "b.npz",
        xyz_m=np.zeros((2, 1, 3)),
        names=np.array(["a"]),
        frames=np.array([3, 3]),
        fps=1.0,
        edges=np.zeros((1, 2), int),
    )
    refuses(tmp_path / "b.npz", ("frames", "3 after 3", "increasing"), read=read_pose3d)


def test_parquet_of_others(tmp_path):
    table = pd.DataFrame({"frame": [1, 2], "nose_x_mm": [1.0, NAN], "nose_y_mm": [2.0, NAN], "nose_z_mm": [3.0, NAN]})
    table.to_parquet(tmp_path / "a.parquet")
    np.testing.assert_allclose(read_pose3d(tmp_path / "a.parquet").xyz_m[:, 0], [[0.001, 0.002, 0.003], [NAN] * 3])
    table.drop(columns="nose_z_mm").to_parquet(tmp_path / "b.parquet")
    long = pd.DataFrame({"frame": [0, 0, 1, 1], "joint": ["nose", "tail"] * 2, "x_m": range(4), "y_m": 1.0, "z_m": 2.0})
    for kind in ("category", "large_string[pyarrow]", "string_view[pyarrow]"):
        try:
            long.astype({"joint": kind}).to_parquet(tmp_path / "long.parquet")
        except pa.ArrowNotImplementedError:  # old versions cannot write string_view
            continue
        found = read_pose3d(tmp_path / "long.parquet")
        assert found.names == ("nose", "tail")
        np.testing.assert_array_equal(found.xyz_m[:, :, 0], [[0, 1], [2, 3]])
    refuses(tmp_path / "b.parquet", ("coords", "no z (Parquet)", "x, y, z"), read=read_pose3d)


# MMPose, whose whole files are tested with the names of detectors


def mmpose_file(path: Path, frames: object, names: object = ("nose", "tail")) -> Path:
    meta = {"keypoint_id2name": dict(enumerate(names)) if isinstance(names, tuple) else names}
    return save(path, json.dumps({"meta_info": meta, "instance_info": frames}))


def mmpose_animal(x: float, **more: object) -> dict[str, object]:
    return {"keypoints": [[x, 1.0], [x, 2.0]], "keypoint_scores": [0.9, 0.5], **more}


@pytest.mark.parametrize("first", [0, 1])
def test_mmpose_counts_frames_from_1(tmp_path, first):
    frames = [{"frame_id": first + t, "instances": [mmpose_animal(t)] if t != 1 else []} for t in range(3)]
    found = read_keypoints(mmpose_file(tmp_path / "a.json", frames))
    assert (found.names, found.frames.tolist(), found.individual) == (("nose", "tail"), [0, 1, 2], None)
    np.testing.assert_array_equal(found.xy_px[:, 0], [[0, 1], [NAN, NAN], [2, 1]])
    np.testing.assert_array_equal(found.confidence, [[0.9, 0.5], [0, 0], [0.9, 0.5]])


def test_mmpose_with_tracks(tmp_path):
    animals = [mmpose_animal(3, track_id=4), mmpose_animal(7, track_id=5)]
    path = mmpose_file(tmp_path / "a.json", [{"frame_id": 1, "instances": animals}])
    refuses(path, ("individual", "2 animals", "4, 5"))
    found = read_keypoints(path, "5")
    assert (found.individual, found.xy_px[0, 0, 0]) == ("5", 7)


@pytest.mark.parametrize(
    ("frames", "names", "expected"),
    [
        (
            [{"frame_id": 1, "instances": [mmpose_animal(1), mmpose_animal(2)]}],
            ("nose", "tail"),
            ("frame 1", "second animal", "track_id"),
        ),
        (
            [{"frame_id": 1, "instances": [mmpose_animal(1)]}],
            ("nose",),
            ("frame 1", "2 points and 2 scores", "1 keypoints"),
        ),
        (
            [{"frame_id": 1, "instances": [{"keypoints": [[1, 2]]}]}],
            ("nose",),
            ("content", "without 'keypoint_scores'"),
        ),
        ([{"frame_id": 1, "instances": [mmpose_animal(1)]}], {"7": "nose"}, ("content", "without '0'")),
        ([[mmpose_animal(1)]], ("nose", "tail"), ("content", "cannot be read", "MMPose JSON")),
        ([], ("nose", "tail"), ("points", "no frames")),
    ],
)
def test_mmpose_problems(tmp_path, frames, names, expected):
    refuses(mmpose_file(tmp_path / "a.json", frames, names), expected)


# Broken files of every format


def written(folder: Path) -> list[tuple[Path, object]]:
    clip = Keypoints(("nose", "tail"), XY[:, 0, :2], SCORE[:, 0, :2], np.arange(5), fps=20.0)
    pose = Pose3D(("nose", "tail"), np.random.default_rng(0).normal(size=(5, 2, 3)), np.arange(5), fps=20.0)
    files = []
    for f in FORMATS:
        for kind, data, read in (("2D", clip, read_keypoints), ("3D", pose, read_pose3d)):
            if kind in f.writes:
                path = folder / f"{kind}_{f.name}{f.suffixes[0]}"
                f.write(data, path)
                files.append((path, read))
    return files


def test_cut_off_files_are_refused(tmp_path):
    """But for a text table that happens to end with a full row, which cannot be told from a shorter one."""
    for path, read in written(tmp_path):
        content = path.read_bytes()
        for share in (0.02, 0.3, 0.6):
            cut = tmp_path / f"cut_{path.name}"
            cut.write_bytes(content[: max(4, int(share * len(content)))])
            lines = cut.read_bytes().splitlines()
            full_row = path.suffix == ".csv" and lines[-1].count(b",") == lines[0].count(b",") and len(lines) > 4
            if not full_row:
                with pytest.raises(InputError):
                    read(cut)


def test_the_content_counts_not_the_extension(tmp_path):
    for path, read in written(tmp_path):
        renamed = path.rename(tmp_path / f"{path.stem}.dat")
        assert len(read(renamed).frames) == 5


def test_a_choice_that_is_none(tmp_path):
    for path, read in written(tmp_path):
        with pytest.raises(InputError) as caught:
            read(path, "rex")
        (problem,) = caught.value.problems
        assert (problem.file, problem.field) == (path, "individual")
        assert "'rex'" in f"{problem.found} {problem.expected}"


def test_pose_fps_and_edges():
    pose = Pose3D(("a", "b"), np.zeros((1, 2, 3)), np.arange(1))
    assert pose.fps is None
    with pytest.raises(ValueError, match="fps"):
        replace(pose, fps=0.0)
    with pytest.raises(ValueError, match="edge"):
        replace(pose, edges=(("a", "c"),))


def test_a_bvh_file_of_infinite_size(tmp_path):
    path = tmp_path / "a.bvh"
    path.write_text(
        "HIERARCHY\nROOT hip\n{\nOFFSET inf 0 0\nCHANNELS 1 Xrotation\nEnd Site\n{\nOFFSET 0 0 0\n}\n}\n"
        "MOTION\nFrames: 1\nFrame Time: 0.1\n0\n"
    )
    with refusal((path, "points", "infinite")):
        read_pose3d(path, unit="m")


def test_the_help_of_a_fit_names_what_it_reads():
    """Both of keypoints and of cameras."""
    infos = FitSettings.infos()
    for f in FORMATS:
        for kind, name in (("2D", "keypoints"), ("cameras", "camera")):
            if kind in f.reads:
                assert f.title.split()[0] in infos[name].option.help.replace("recon toml", "camera"), f.title


def test_every_format_is_on_its_page():
    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
    for f in FORMATS:
        assert f.title in page or f.title.split()[0] in page
        assert f"`{f.suffixes[0]}`" in page


# OpenPose, a file for each frame


def openpose_files(folder: Path, frames: dict[int, list[np.ndarray]], name: str = "run_{:012d}_keypoints.json") -> Path:
    folder.mkdir(exist_ok=True)
    for number, people in frames.items():
        content = {"version": 1.3, "people": [{"pose_keypoints_2d": points.ravel().tolist()} for points in people]}
        (folder / name.format(number)).write_text(json.dumps(content), encoding="utf-8")
    return folder / name.format(min(frames))


@pytest.mark.parametrize("name", ["run_{:012d}_keypoints.json", "run_{:06d}.json"])
def test_openpose_one_file_stands_for_all(tmp_path, name):
    points = np.arange(75.0).reshape(25, 3) + 1
    points[:, 2] = 0.9
    points[4] = 0
    path = openpose_files(tmp_path / "a", {7: [points], 8: [], 10: [points]}, name)
    openpose_files(tmp_path / "a", {9: [points]}, "other_{:06d}.json")
    found = read_keypoints(path)
    assert found.frames.tolist() == [7, 8, 10]
    assert found.names[:2] == ("Nose", "Neck")
    assert found.names[19:22] == ("LBigToe", "LSmallToe", "LHeel")
    np.testing.assert_array_equal(found.xy_px[0, 5], points[5, :2])
    assert np.isnan(found.xy_px[0, 4]).all()
    assert np.isnan(found.xy_px[1]).all()
    for read in (read_keypoints, lambda folder: convert(ConvertSettings(source=folder, out=tmp_path / "a.csv"))):
        with refusal((path.parent, "file", "a folder", "other_000009.json")):
            read(path.parent)


def test_openpose_with_two_persons_and_other_lists(tmp_path):
    one = np.ones((17, 3))
    path = openpose_files(tmp_path / "a", {0: [one, one * [2, 2, 1]], 1: [one, one * [2, 2, 1]]})
    with pytest.raises(NoChoiceError):
        read_keypoints(path)
    assert read_keypoints(path, "2").xy_px[1, 0].tolist() == [2, 2]
    path = openpose_files(tmp_path / "b", {0: [one], 1: [np.ones((25, 3))]})
    refuses(path, ("pose_keypoints_2d", "17 and 25", "17, 18, 25, 26"))
    nameless = path.rename(path.with_name("run.json"))
    refuses(nameless, ("file", "without a number", "run_000012_keypoints.json"))


# DANNCE, sleap-anipose


def dannce_file(path: Path, packed: bool = True, **changes) -> Path:
    """As Label3D writes it, two cameras, two frames of two points."""
    points = np.array([[[1.0, 2, 3], [4, 5, 6]], [[7, 8, 9], [NAN, NAN, NAN]]])
    label = {"data_3d": points.reshape(2, 6), "data_frame": np.array([[10], [20]], np.int32)}
    lens = {
        "K": np.array([[1000.0, 0, 0], [0, 1100, 0], [641, 513, 1]]),
        "RDistort": [[-0.1, 0.02]],
        "TDistort": [[1e-3, 2e-3]],
    }
    poses = [{"r": TURN.T, "t": np.array([[10.0, 20, 900]])}, {"r": np.eye(3), "t": np.array([[0.0, 0, 800]])}]
    content = {
        "labelData": cell(label, label),
        "params": cell(*(lens | pose for pose in poses)),
        "camnames": cell("Camera1", "Camera2").T,
    } | changes
    savemat(path, {name: value for name, value in content.items() if value is not None}, do_compression=packed)
    return path


def cell(*items: object) -> np.ndarray:
    found = np.empty((len(items), 1), dtype=object)
    found[:, 0] = items
    return found


TURN = Rotation.from_euler("xyz", [0.3, -0.2, 0.1]).as_matrix()


@pytest.mark.parametrize("packed", [True, False])
def test_dannce(tmp_path, packed):
    """A point is projected as DANNCE does it: rows, K and r on the right, the first pixel (1, 1)."""
    path = dannce_file(tmp_path / "run_dannce.mat", packed)
    pose = read_pose3d(path, unit="mm")
    assert (pose.names, pose.frames.tolist()) == (("point1", "point2"), [10, 20])
    np.testing.assert_allclose(pose.xyz_m[:, 0], [[0.001, 0.002, 0.003], [0.007, 0.008, 0.009]])
    assert np.isnan(pose.xyz_m[1, 1]).all()
    one, two = read_cameras(path, (1280, 1024))
    assert (one.name, two.name, one.knows_up) == ("Camera1", "Camera2", False)
    assert one.distortion.tolist() == [-0.1, 0.02, 0.001, 0.002, 0.0]
    at = np.array([[30.0, -40, 100]])
    x, y, z = (at @ TURN.T + [10.0, 20, 900]).ravel()
    plain = replace(one, distortion=np.zeros(4))
    px, _ = plain.project(plain.world_to_camera(at))
    np.testing.assert_allclose(px + 1, [[1000 * x / z + 641, 1100 * y / z + 513]])
    with refusal(*((path, f"params[{i}].size", "nothing", "--image-size") for i in (0, 1))):
        read_cameras(path)


def test_dannce_predictions_and_names(tmp_path):
    for shape, animal in ((2, 3, 2), None), ((2, 1, 3, 2), None), ((1, 2, 3, 2), "track_0"):
        file = {"pred": np.arange(12.0).reshape(shape), "sampleID": range(shape[0])}
        savemat(tmp_path / "save_data_AVG.mat", file)
        pose = read_pose3d(tmp_path / "save_data_AVG.mat", animal, unit="m")
        np.testing.assert_array_equal(pose.xyz_m[0], [[0, 2, 4], [1, 3, 5]])
    path = dannce_file(tmp_path / "a.mat", skeleton={"joint_names": cell("nose", "tail")})
    assert read_pose3d(path, unit="mm").names == ("nose", "tail")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, ("data_3d", "nothing", "labelData")),
        ({"data_3d": np.ones((2, 5)), "data_frame": [1, 2]}, ("content", "array of size 10")),
        ({"data_3d": np.ones((2, 6)), "data_frame": [2, 2]}, ("frames", "2 after 2", "increasing")),
    ],
)
def test_dannce_problems(tmp_path, content, expected):
    path = dannce_file(tmp_path / "a.mat", labelData=content and cell(content))
    with refusal((path, *expected)):
        read_pose3d(path, unit="mm")


def test_other_files_of_matlab(tmp_path):
    save(tmp_path / "b.mat", "MATLAB 7.3 MAT-file, Platform: x")
    with refusal((tmp_path / "b.mat", "file", "7.3", "save(name, '-v7')")):
        read_pose3d(tmp_path / "b.mat", unit="mm")
    with refusal((tmp_path / "a.mat", "params", "no cameras", "K, r, t")):
        read_cameras(dannce_file(tmp_path / "a.mat", params=cell("none")))


def test_sleap_anipose(tmp_path):
    import h5py

    values = np.random.default_rng(0).normal(size=(5, 2, 3, 3))
    with h5py.File(tmp_path / "points3d.h5", "w") as file:
        file.create_dataset("tracks", data=values, compression="gzip", chunks=True)
        file["frames"] = [100, 105]
    with refusal((tmp_path / "points3d.h5", "individual", "2 animals", "track_0, track_1")):
        read_pose3d(tmp_path / "points3d.h5", unit="m")
    pose = read_pose3d(tmp_path / "points3d.h5", "track_1", unit="m")
    np.testing.assert_array_equal(pose.xyz_m, values[:, 1])
    assert (pose.names, pose.frames.tolist()) == (("point1", "point2", "point3"), [100, 101, 102, 103, 104])
    with h5py.File(tmp_path / "points3d.h5", "a") as file:
        file["node_names"], file["recording_frame_rate"] = [b"nose", b"neck", b"tail"], 120.0
    pose = read_pose3d(tmp_path / "points3d.h5", "track_0", unit="m")
    assert (pose.names, pose.fps) == (("nose", "neck", "tail"), 120.0)
