"""Test formats other than DeepLabCut's, with layouts that occur in practice and with damaged files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import refusal, says
from format_files import NAN, refuses, save
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from recon import FitSettings, InputError
from recon.cli.convert import ConvertSettings, convert
from recon.clip import Keypoints
from recon.io.calibration import read_cameras
from recon.io.common import NoChoiceError, Pose3D
from recon.io.formats import FORMATS, read_keypoints
from recon.io.positions import read_pose3d

NODES, TRACKS = ["nose", "tail", "ear"], ["a", "b"]
XY = np.random.default_rng(0).uniform(0, 100, (5, 2, 3, 2))  # frame, track, node, xy
SCORE = np.random.default_rng(1).uniform(0, 1, (5, 2, 3))
SLEAP_AXES = {"f": "frame", "t": "track", "n": "node", "c": "xy"}


def sleap_file(path: Path, tracks="tcnf", scores="tnf", occupancy="ft", dims: bool = True, **more) -> Path:
    """Write SLEAP's analysis file with axes in this order; `more` replaces datasets, and None leaves one out."""
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
    assert b.frames.tolist() == [1, 2, 3, 4]  # the track is empty in the first frame
    np.testing.assert_array_equal(a.xy_px, XY[:, 0])
    np.testing.assert_array_equal(b.xy_px, XY[1:, 1])
    np.testing.assert_array_equal(b.confidence, SCORE[1:, 1])
    refuses(path, ("individual", ["2 animals", "--individual"], "a, b"))
    refuses(path, ("individual", "'c'", "a, b"), individual="c")


def test_sleap_not_transposed(tmp_path):
    path = sleap_file(tmp_path / "a.h5", "fnct", dims=False)
    with h5py.File(path, "a") as file:
        file.attrs["transpose"] = False
    np.testing.assert_array_equal(read_keypoints(path, "a").xy_px, XY[:, 0])


def test_sleap_tracks_without_points_need_no_choice(tmp_path):
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
    refuses(path, ("frames", "no frame with the animal"), individual="a")


def test_real_sleap(shared_data):
    path = next((shared_data / "importer-files" / "sleap").glob("*.h5"))
    found = read_keypoints(path)
    assert found.names == ("top", "front", "rear")

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


def test_movement_animals_without_points_need_no_choice(tmp_path):
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
    """Attributes of unexpected kinds in a movement file are ignored."""
    data = movement_data(False, fps=[1.0, 2.0], time_unit=[1, 2], ds_type=[1, 2])
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    found = read_keypoints(tmp_path / "a.nc", "a")
    assert (found.fps, found.frames.tolist()) == (25.0, [0, 1, 2, 3])


def test_movement_without_numbers_of_its_dimensions(tmp_path):
    """A movement file is read without numbers of its dimensions.

    Programs other than h5netcdf store only the variables of each dimension.
    """
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
    """The unit of 3D positions in a movement file has to be given, unless recon wrote the file."""
    data = movement_data(False, "xyz")
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    refuses(tmp_path / "a.nc", ("coords", "3D positions (x, y, z)", "2D keypoints"), individual="a")
    refuses(tmp_path / "a.nc", ("unit", "no unit", "m, cm, mm (--unit)"), individual="a", read=read_pose3d)
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


def test_real_nwb(shared_data):
    folder = shared_data / "importer-files" / "ndx-pose"
    for name in ("0.3.0_poseestimation_one_camera.nwb", "0.3.0_poseestimation_two_cameras.nwb"):
        found = read_keypoints(folder / name)
        assert found.names == ("front_left_paw", "front_right_paw")
        assert found.frames.tolist() == list(range(10))
        assert found.fps == pytest.approx(0.9)

        with h5py.File(folder / name) as file:
            series = file["processing/behavior/PoseEstimation/front_right_paw"]
            np.testing.assert_array_equal(found.xy_px[:, 1], series["data"])
            np.testing.assert_array_equal(found.confidence[:, 1], series["confidence"])
    paw = ("PoseEstimation/front_right_paw", "(100, 2)", ["(100, 3)", "front_left_paw"])
    refuses(folder / "0.1.1_poseestimation_nodes_edges.nwb", paw)
    refuses(folder / "0.1.1_poseestimation_no_cameras.nwb", ("PoseEstimationSeries", "no series", "ndx-pose"))


def nwb_file(path: Path, edit=None) -> Path:
    """Write an NWB file of two animals, a and b, which `edit` may change."""
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
    """Files that are cut off are refused, except text tables that end with a complete row."""
    for path, read in written(tmp_path):
        content = path.read_bytes()
        for fraction in (0.02, 0.3, 0.6):
            cut = tmp_path / f"cut_{path.name}"
            cut.write_bytes(content[: max(4, int(fraction * len(content)))])
            lines = cut.read_bytes().splitlines()
            full_row = path.suffix == ".csv" and lines[-1].count(b",") == lines[0].count(b",") and len(lines) > 4
            if not full_row:
                with pytest.raises(InputError):
                    read(cut)


def test_formats_are_recognised_by_content_not_by_suffix(tmp_path):
    for path, read in written(tmp_path):
        renamed = path.rename(tmp_path / f"{path.stem}.dat")
        assert len(read(renamed).frames) == 5


def test_an_unknown_individual_is_refused(tmp_path):
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
    """The help of a fit names every format of keypoints and cameras that it reads."""
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


def dannce_file(path: Path, packed: bool = True, **changes) -> Path:
    """Write Label3D's file with two cameras and two frames of two points."""
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
    """A camera projects a point as DANNCE does, where matrices are transposed and the first pixel is (1, 1)."""
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
