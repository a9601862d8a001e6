"""Make small valid files of every kind, each with the function that reads it."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
from scipy.io import savemat
from scipy.spatial.transform import RigidTransform

from recon import FitSettings, InputError, find_clips, read_settings
from recon.animal.naming import load_names
from recon.animal.prior import load_prior
from recon.animal.skeleton_file import builtin_subjects, load_skeleton, with_detector_offsets
from recon.api.clip_results import Record, run_clip
from recon.base.errors import Problem, printable
from recon.base.files import MANIFEST, write_manifest
from recon.base.tables import FORMULAS, guarded
from recon.clip import Keypoints, clean
from recon.fit.motion import Motion
from recon.fit.motion_forms import MOTION
from recon.geometry.camera import Camera
from recon.io.bones import write_bvh
from recon.io.calibration import read_cameras
from recon.io.camera_files import write_camera
from recon.io.camera_track import read_camera_track
from recon.io.columns import parse_map, read_long
from recon.io.common import Pose3D
from recon.io.formats import FORMATS, read_keypoints
from recon.io.json_poses import ANIMAL3D
from recon.io.positions import read_pose3d, read_pose_segments
from recon.keypoint_net.labels import read_label_file
from recon.robotics.climb.plan import load_recipe
from recon.robotics.dh import load_dh
from recon.robotics.physics import described
from recon.robotics.quadruped import LEGS, load_robot
from recon.robotics.retarget import Reference, place, posed
from recon.robotics.retarget_clip import KEPT, RobotSamples, keep, kept_motions
from recon.show.plain import to_json
from recon.show.rig import make_rig
from tests.fuzz.folders import records, write_after, write_among_others

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
LABELS = """scorer,me,me,me,me
bodyparts,nose,nose,tail,tail
coords,x,y,x,y
labeled-data/run/img0007.png,1,2,3,4
labeled-data/run/img0009.png,,,5,6
"""
SEGMENTS = (
    "segment,frame,nose,nose,nose,tail,tail,tail\n,,x,y,z,x,y,z\na,0,1,2,3,4,5,6\na,1,1,2,3,,,\nb,0,1,2,3,4,5,6\n"
)
DH = b'convention = "modified"\njoints = [{}, { a_m = 0.4, alpha_rad = 1.57, slides = true, limits = [-1, 1] }]\n'
EXTENDED = b"""extends = "cheetah-8u"
length_m = { r1 = 0.4, r4 = 0.2 }
base_length = { nominal_m = 0.25, sigma_m = 0.02 }
"""
OPENCV = """%YAML:1.0
---
image_width: 1920
image_height: 1080
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1000., 0., 960., 0., 1000., 540., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0.1, -0.01, 0., 0., 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T: [ 0., 1., 2. ]
"""
XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>1920</image_width>
<image_height>1080</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>1000. 0. 960. 0. 1000. 540. 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>1</rows><cols>4</cols><dt>d</dt><data>0. 0. 0. 0.</data>
</distortion_coefficients>
</opencv_storage>
"""
MATRIX = [[1000.0, 0.0, 960.0], [0.0, 1000.0, 540.0], [0.0, 0.0, 1.0]]
STEREO = (
    OPENCV.replace("camera_matrix", "K1").replace("distortion_coefficients", "D1")
    + "K2: ["
    + ("[ 1000., 0., 960. ], [ 0., 1000., 540. ], [ 0., 0., 1. ] ]\nD2: [ 0.1, 0., 0., 0., 0. ]\n")
)
EASYMOCAP = OPENCV.replace("camera_matrix", "K_01").replace("distortion_coefficients", "dist_01") + (
    'names: [ "01" ]\nW_01: 1920\nH_01: 1080\n'
)
TABLES = {
    name: {
        "K": MATRIX,
        "distCoef": [0.1, 0, 0, 0, 0],
        "R": np.eye(3).tolist(),
        "t": [0, 1, 2],
        "resolution": [1920, 1080],
    }
    for name in ("a", "b")
}
ACINOSET = {
    "camera_resolution": [1920, 1080],
    "cameras": [{"k": MATRIX, "d": [[0.1], [0], [0], [0]], "r": np.eye(3).tolist(), "t": [[0], [1], [2]]}] * 2,
}
ANIPOSE = f"""[cam_0]
name = "A"
size = [1920, 1080]
matrix = {MATRIX}
distortions = [0.1, 0.0, 0.0, 0.0, 0.0]
rotation = [0.1, 0.2, 0.3]
translation = [1.0, 2.0, 3.0]
[metadata]
adjusted = false
"""
OPENDRONEMAP = {
    "v2 dji": {"projection_type": "brown", "width": 1920, "height": 1080, "focal_x": 0.7, "focal_y": 0.7, "k1": 0.1}
}
SHOTS = [
    {
        "cameras": OPENDRONEMAP,
        "shots": {
            f"a{i:04d}.jpg": {"rotation": [1.5, 0.1, 0], "translation": [1, 2, 3], "camera": "v2 dji"} for i in (7, 9)
        },
    }
]
FEATURES = {"features": [{"properties": {"filename": name} | shot} for name, shot in SHOTS[0]["shots"].items()]}
MMPOSE = {
    "meta_info": {"keypoint_id2name": {"0": "nose", "1": "tail"}},
    "instance_info": [
        {"frame_id": t, "instances": [{"keypoints": [[t, 2.5], [3, 4]], "keypoint_scores": [0.5, 1]}]} for t in (1, 2)
    ],
}
COCO = {
    "images": [{"id": t, "file_name": f"img{t:03d}.png", "width": 64, "height": 48} for t in (3, 4)],
    "annotations": [
        {
            "id": t,
            "image_id": t,
            "category_id": 1,
            "track_id": a,
            "keypoints": [t, 2, 2, 0, 0, 0],
            "keypoint_scores": [1, None],
        }
        for t, a in ((3, 1), (4, 1), (4, 2))
    ],
    "categories": [{"id": 1, "name": "cheetah", "keypoints": ["nose", "tail"]}],
}
ALPHAPOSE = [{"image_id": f"{t}.jpg", "keypoints": [t, 2.5, 0.9] * 17, "score": 2.0, "idx": 1} for t in (3, 4)]
PEOPLE = {"version": 1.3, "people": [{"pose_keypoints_2d": [10.0, 20.0, 0.5] * 17}, {"pose_keypoints_2d": []}]}
WIDE = "frame,nose_x,nose_y,nose_score,tail_x,tail_y,speed\n3,1,2,0.5,3,4,1\n5,1,2,,,,1\n"
FRAMES = np.array([3, 4, 5, 6, 9])
NAMES = (
    *(b"caf\xe9.csv", "L\u00e4ufer (1).csv".encode(), b"\\xe9=1.csv", b"=HYPERLINK(1).csv"),
    *(b"@a +b.csv", b"--out.csv", b" a .csv", b"a\nb\r.csv", b"\x1b[31m\x07.csv", "\u0430\u202e\u2028.csv".encode()),
    *(b"NUL.csv", b"x" * 250 + b".csv"),
)
"""File names, some of them with unusual characters."""


@dataclass(frozen=True)
class Seed:
    """A valid file, from which damaged files are made."""

    name: str
    content: bytes
    read: Callable[[Path], object]
    """Function that reads files of this kind."""
    share: float = 1.0
    """Relative frequency of this file among the cases."""
    is_input: bool = True
    """Whether the package opens the path itself, which may then be a link."""
    link: str | None = None
    """Kind of path (one of `pool.LINKS`), or None for a plain file."""

    @property
    def suffix(self) -> str:
        return Path(self.name).suffix


def seeds(folder: Path, real: Path | None = None) -> list[Seed]:
    """Make all valid files in `folder`, and read some more from the folder of recordings `real`, if it is given."""
    folder.mkdir(parents=True, exist_ok=True)
    found = [*of_formats(folder), *of_settings(folder)]
    for path in sorted(real.glob("importer-files/*/*")) if real is not None else ():
        if path.suffix in (".h5", ".nwb", ".csv", ".json", ".trc") and path.stat().st_size < 1 << 18:
            read = _cameras_of if path.suffix == ".json" else _positions if path.suffix == ".trc" else _points
            found.append(Seed(f"real-{path.name}", path.read_bytes(), read, 0.3))
    return found


def of_settings(folder: Path) -> Iterator[Seed]:
    """Make the files that are not clips: cameras, tracks, settings, animals, robots, results and networks."""
    yield from _texts()
    yield from _cameras(folder)
    yield from _tracks()
    yield from _built_in()
    yield from _results(folder)
    yield from _models(folder)
    yield from _folders()


def _points(path: Path) -> object:
    return clean(read_keypoints(path), 0.5)


def _animal(path: Path) -> object:
    return clean(read_keypoints(path, "bella"), 0.5)


def _positions(path: Path) -> object:
    return read_pose3d(path, unit="m")


def _cameras_of(path: Path) -> object:
    cameras = read_cameras(path)
    return [camera.project(np.array([[0.1, 0.2, 5.0]])) for camera in cameras]


def _sized_cameras_of(path: Path) -> object:
    return read_cameras(path, (1920, 1080))


def _cell(*items: object) -> np.ndarray:
    """Return items as a cell array, as MATLAB stores it."""
    found = np.empty((len(items), 1), dtype=object)
    found[:, 0] = items
    return found


def _body_of(path: Path) -> object:
    skeleton = load_skeleton(path)
    return skeleton.tree.pose(np.zeros((1, skeleton.n_state)))


def of_formats(folder: Path) -> Iterator[Seed]:
    """Write a small clip in every format that the package writes."""
    random = np.random.default_rng(0)
    names = ("nose", "l_eye", "spine")
    xy_px, confidence = random.uniform(0, 1000, (5, 3, 2)).round(2), random.uniform(0.5, 1, (5, 3)).round(3)
    xy_px[1, 2], confidence[1, 2] = np.nan, 0
    clip = Keypoints(names, xy_px, confidence, FRAMES, fps=50.0, image_size_px=(1920, 1080))
    pose = Pose3D(names, random.normal(size=(5, 3, 3)).round(3), FRAMES, fps=50.0, edges=(("nose", "spine"),))
    for kind in FORMATS:
        path = folder / f"{kind.name}{kind.suffixes[0]}"
        if "2D" in kind.writes:
            kind.write(clip, path)
            yield Seed(f"2d-{path.name}", path.read_bytes(), _points)
            kind.write(replace(clip, individual="bella"), path)
            yield Seed(f"2d-animal-{path.name}", path.read_bytes(), _animal, 0.4)
        if "3D" in kind.writes:
            kind.write(pose, path)
            states_unit = kind.axes.startswith("mm")
            yield Seed(f"3d-{path.name}", path.read_bytes(), read_pose3d if states_unit else _positions)
    chain = load_skeleton("cheetah-8u")
    rig = make_rig(chain, 1.0, chain.markers, FRAMES, random.normal(size=(5, chain.n_state)).round(2), 50.0)
    write_bvh(rig, folder / "3d.bvh")
    yield Seed("3d.bvh", (folder / "3d.bvh").read_bytes(), _positions)
    label = {"data_3d": np.arange(12.0).reshape(2, 6), "data_frame": np.array([[3], [5]])}
    params = {
        "K": np.array(MATRIX).T,
        "r": np.eye(3),
        "t": np.ones((1, 3)),
        "RDistort": [[0.1, 0]],
        "TDistort": [[0, 0]],
    }
    for packed in (True, False):
        cells = {"labelData": _cell(label, label), "params": _cell(params), "camnames": _cell("Camera1")}
        savemat(folder / "dannce.mat", cells, do_compression=packed)
        for read in (_positions, _sized_cameras_of):
            yield Seed(f"dannce-{packed}.mat", (folder / "dannce.mat").read_bytes(), read, 0.7)
    with h5py.File(folder / "points3d.h5", "w") as file:
        file.create_dataset("tracks", data=random.normal(size=(4, 1, 3, 3)), compression="gzip")
        file["node_names"], file["frames"] = [b"nose", b"ear", b"tail"], [2, 6]
    yield Seed("points3d.h5", (folder / "points3d.h5").read_bytes(), _positions)
    lifted = {"model": "fmpose3d_animals", "bodyparts": ["nose", "neck"], "poses_3d": [[[1, 2, 3], [4, 5, 6]], []]}
    yield Seed("3d-fmpose3d.json", json.dumps(lifted).encode(), _positions)
    yield Seed("2d-mmpose.json", json.dumps(MMPOSE).encode(), _points)
    yield Seed("2d-coco.json", json.dumps(COCO).encode(), lambda path: clean(read_keypoints(path, "1"), 0.5))
    yield Seed("2d-alphapose.json", json.dumps(ALPHAPOSE).encode(), _points)
    np.savez(folder / "demo.npz", pose3d=random.normal(size=(1, len(ANIMAL3D.split()), 3)))
    yield Seed("3d-fmpose3d.npz", (folder / "demo.npz").read_bytes(), _positions)
    yield Seed("2d-openpose-000012_keypoints.json", json.dumps(PEOPLE).encode(), _points)
    yield Seed("2d-wide.csv", WIDE.encode(), _points)
    write_sleap(clip, folder / "2d.analysis.h5")
    yield Seed("2d-sleap.analysis.h5", (folder / "2d.analysis.h5").read_bytes(), _points)
    yield Seed("2d-fixed.h5", _fixed_h5(folder / "fixed.h5", clip), _points)


def write_sleap(points: Keypoints, path: Path) -> None:
    """Write points as an analysis file of SLEAP."""
    with h5py.File(path, "w") as file:
        file["tracks"] = points.xy_px.transpose(2, 1, 0)[None]
        file["point_scores"] = points.confidence.T[None]
        file["track_occupancy"] = np.ones((len(points.frames), 1), np.uint8)
        file["node_names"], file["track_names"] = [name.encode() for name in points.names], [b"track_0"]


def _fixed_h5(path: Path, clip: Keypoints) -> bytes:
    """Write labels of DeepLabCut in the fixed HDF5 layout of pandas, and return the bytes."""
    import pandas as pd

    columns = pd.MultiIndex.from_product([["me"], clip.names, ["x", "y"]], names=["scorer", "bodyparts", "coords"])
    rows = pd.MultiIndex.from_tuples([("labeled-data", "run", f"img{n:04d}.png") for n in clip.frames])
    pd.DataFrame(clip.xy_px.reshape(5, -1), index=rows, columns=columns).to_hdf(path, key="df_with_missing")
    return path.read_bytes()


def _texts() -> Iterator[Seed]:
    yield Seed("labels.csv", LABELS.encode(), read_label_file)
    yield Seed("segments.csv", SEGMENTS.encode(), read_pose_segments)
    yield Seed("map.txt", b"frame=Frame, bodypart=Node, x=X, y=Y, likelihood=Score", _by_map, is_input=False)
    yield Seed("map-wide.txt", b"frame=Frame, x={bodypart} X, y={bodypart} Y", _by_map, is_input=False)
    settings = FitSettings(keypoints=SAMPLES / "whole.csv", camera=SAMPLES / "camera.toml", fps=60, frames="0:30")
    yield Seed("config.toml", settings.to_toml().encode(), lambda path: read_settings(path, {}), 2.0)
    batch = f"keypoints,camera,fps,frames,method\n{SAMPLES}/whole.csv,{SAMPLES}/camera.toml,60,0:20,\n"
    batch += f"{SAMPLES}/noisy.csv,{SAMPLES}/camera.toml,30,,frame\n"
    yield Seed("batch.csv", batch.encode(), lambda path: find_clips([path], {}), 2.0)
    yield Seed("rates.json", b'{"fps": [120, 90]}', _rates, 0.5)
    for name in NAMES:
        yield Seed("name.txt", name, _file_name, 0.4, is_input=False)
    record = {"schema": {"name": "recon.batch", "version": 3}, "clip": "a", "state": "started", "keypoints": ["a.csv"]}
    yield Seed("record.jsonl", json.dumps(record).encode(), _record, 0.5)


def _file_name(path: Path) -> object:
    """Write a file name into a config.toml, a table, a message and JSON, and find the file as a clip of a batch."""
    name = os.fsdecode(path.read_bytes().replace(b"\0", b"").replace(b"/", b"")[:255])
    folder = path.with_name("names")
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "out").mkdir(parents=True)
    try:
        (folder / name).write_text(WIDE, encoding="utf-8")
    except OSError as error:
        raise InputError(Problem(path, "name", str(error), "a name of a file")) from None
    settings = FitSettings(keypoints=folder / name, camera=SAMPLES / "camera.toml", fps=60)
    (folder / "out" / "config.toml").write_text(settings.to_toml(folder / "out"), encoding="utf-8")
    assert read_settings(folder / "out" / "config.toml", {}).keypoints == settings.keypoints, ascii(name)
    json.loads(to_json({name: name}))
    cell = guarded(name)
    cell.encode()
    assert not cell.startswith(FORMULAS) or _is_number(cell), ascii(cell)
    row = io.StringIO(newline="")
    csv.writer(row).writerow([cell, "next"])
    assert next(csv.reader(io.StringIO(row.getvalue(), newline=""))) == [cell, "next"], ascii(cell)
    assert printable(cell).isprintable()
    assert str(Problem(folder / name, "file", name, name)).isprintable(), ascii(name)
    clips, _ = find_clips([folder / name], {"camera": SAMPLES / "camera.toml", "fps": 60})
    for clip in clips:
        (folder / "out" / clip.name).mkdir()
        clip.name.encode()
    return clips


def _is_number(text: str) -> bool:
    try:
        return bool(float(text)) or True
    except ValueError:
        return False


def _by_map(path: Path) -> object:
    table = path.with_name("table.csv")
    table.write_text("Frame,Node,X,Y,Score,nose X,nose Y\n0,nose,1,2,0.9,1,2\n1,tail,3,4,0.8,3,4\n")
    return read_long(table, None, parse_map(path.read_text(encoding="utf-8", errors="replace")))


def _rates(path: Path) -> object:
    from recon.api.prior_fit import _rates as read

    return read(str(path), [path])


def _record(path: Path) -> object:
    return Record(path).rows


def _cameras(folder: Path) -> Iterator[Seed]:
    write_camera(Camera.from_hfov(60.0, (1920, 1080), name="cam"), folder / "camera.toml")
    for name, content in (
        ("camera.toml", (folder / "camera.toml").read_text()),
        ("opencv.yml", OPENCV),
        ("opencv.xml", XML),
        ("scene.json", json.dumps(ACINOSET)),
        ("anipose.toml", ANIPOSE),
        ("opendronemap.json", json.dumps(OPENDRONEMAP)),
        ("stereo.yml", STEREO),
        ("intri.yml", EASYMOCAP),
        ("tables.json", json.dumps(TABLES)),
    ):
        yield Seed(name, content.encode(), _cameras_of, 1.5)


def _tracks() -> Iterator[Seed]:
    rows = [
        f"{frame},0.7071,0.7071,0,0,0.1,0.2,5,{focal},{focal},959.5,539.5" for frame, focal in ((7, 1000), (9, 1100))
    ]
    table = "\n".join(["frame,qw,qx,qy,qz,tx,ty,tz,fx,fy,cx,cy", *rows])
    images = "# Image list\n" + "".join(
        f"{i} 0.7071 0.7071 0 0 0.1 0.2 5 1 a/img{i:04d}.png\n1.5 2 -1\n" for i in (1, 2)
    )
    # with a camera's position, the rotation is from camera to world, the inverse
    positions = table.replace("tx,ty,tz", "x,y,z").replace("0.7071,0.7071", "0.7071,-0.7071")
    for name, content in (
        ("track.csv", table),
        ("places.csv", positions),
        ("images.txt", images),
        ("reconstruction.json", json.dumps(SHOTS)),
        ("shots.geojson", json.dumps(FEATURES)),
    ):
        yield Seed(name, content.encode(), _track)


def _track(path: Path) -> object:
    return read_camera_track(path).at(np.arange(12), 30.0)


def _built_in() -> Iterator[Seed]:
    package = resources.files("recon") / "animal"
    for name in ("cheetah-8u", "cheetah-24", "horse-22"):
        yield Seed(f"{name}.toml", (package / "skeletons" / f"{name}.toml").read_bytes(), _body_of, 1.5)
    yield Seed("extended.toml", EXTENDED, _body_of)
    subject = builtin_subjects()[0]
    content = (package / "subjects" / f"{subject}.toml").read_bytes()
    yield Seed(f"subject-{subject}.toml", content, lambda path: load_skeleton("cheetah-24", path), 1.5)
    yield Seed("names.csv", (package / "names" / "animal3d.csv").read_bytes(), load_names)
    body = load_skeleton("cheetah-24")
    detector = (package / "detectors" / "acinoset.toml").read_bytes()
    yield Seed("detector.toml", detector, lambda path: with_detector_offsets(body, path), 1.5)
    prior = (package / "priors" / "running-cheetah.npz").read_bytes()
    yield Seed("prior.npz", prior, lambda path: load_prior(path, body), 1.5)
    for name in ("aibo", "a1"):
        content = (resources.files("recon.robotics") / "robots" / f"{name}.toml").read_bytes()
        yield Seed(f"robot-{name}.toml", content, _walking, 1.5)
    yield Seed("dh.toml", DH, load_dh)
    yield Seed("robot.npz", _kept_robot(), lambda path: RobotSamples(kept_motions(path)[0], 50.0), 1.5)
    if find_spec("mujoco") is not None:
        yield Seed("robot.urdf", _urdf().encode(), _walking, 0.3)
        spec = described(load_robot("a1"))
        spec.compile()
        yield Seed("robot.xml", spec.to_xml().encode(), _walking, 0.3)
    recipe = sorted((resources.files("recon.robotics.climb") / "recipes").iterdir(), key=str)[0]
    yield Seed("recipe.toml", recipe.read_bytes(), load_recipe)


def _walking(path: Path) -> object:
    """Return the motion of a robot that follows an animal for a few samples."""
    t = np.linspace(0.0, 0.1, 4)
    zero, feet = np.zeros((4, 3)), np.zeros((4, len(LEGS), 3))
    feet[1:3, :, 2] = 0.05
    return place(Reference(t, zero, zero.copy(), feet, feet[..., 2] == 0, 0.5), load_robot(path), 0.3)


def _kept_robot() -> bytes:
    """Return a robot.npz file in which a robot stands for a few samples."""
    robot, t = load_robot("a1"), np.linspace(0.0, 0.1, 4)
    feet = np.array([leg.neutral_m for leg in robot.legs.values()])
    pose = RigidTransform.from_translation(np.zeros((4, 3)))
    stands = np.ones((4, len(LEGS)), dtype=bool)
    motion = posed(robot, t, pose, np.tile(feet, (4, 1, 1)), stands)
    with TemporaryDirectory() as folder:
        keep(motion, replace(motion, advance_m=np.zeros(2)), "a1", {}, path := Path(folder) / KEPT)
        return path.read_bytes()


def _urdf() -> str:
    import runpy

    return runpy.run_path(str(Path(__file__).resolve().parents[1] / "robot_urdf.py"))["a1_urdf"]()


def _results(folder: Path) -> Iterator[Seed]:
    """Yield the motion and the manifest of a fit, which are damaged separately and read as a results folder.

    If the motion is damaged, the manifest has the digest of the damaged file.
    """
    results = folder / "results"
    run_clip(
        FitSettings(
            keypoints=SAMPLES / "noisy.csv", camera=SAMPLES / "camera.toml", fps=30, frames="0:3", method="frame"
        ),
        results,
    )
    files = {name: (results / name).read_bytes() for name in (MOTION, MANIFEST)}

    def read(path: Path) -> object:
        name = path.name.partition("-")[2]
        made = path.with_name("results")
        made.mkdir(exist_ok=True)
        for other, content in files.items():
            (made / other).write_bytes(path.read_bytes() if other == name else content)
        if name != MANIFEST:
            write_manifest(made)
        found = Motion.load(made)
        return (
            found.body,
            found.foot_names,
            found.limbs,
            found.posture_rad,
            found.size,
            found.title,
            found.time_s,
            found.forward_names,
        )

    for name, content in files.items():
        yield Seed(f"results-{name}", content, read, 3.0 if name == MOTION else 0.7, is_input=False)


def _models(folder: Path) -> Iterator[Seed]:
    """Yield the files of a network except the weights."""
    if find_spec("torch") is None:
        return
    import torch

    from recon.keypoint_net.network import FORMAT, load_model

    spec = {"names": ["nose", "tail"], "scale": 0.5, "body_length_px": 300.0, "tolerance_px": 9.0}
    spec |= {"calibration": [1.0, 0.0]}
    torch.save({"format": FORMAT, "spec": spec, "weights": {}}, folder / "model.pt")
    content = (folder / "model.pt").read_bytes()

    def read(path: Path) -> object:
        return load_model(path, torch.device("cpu"))

    yield Seed("model.pt", content, read, 0.3)


def _folders() -> Iterator[Seed]:
    """Yield the cases of folders to write to; the bytes of the file determine the content of the first folder."""
    yield Seed("folder.txt", b"what lies in the folder", write_among_others, 4.0, is_input=False)
    for name, content in records():
        yield Seed(name, content, write_after, 2.0, is_input=False)


def outcome(seed: Seed, path: Path) -> str | None:
    """Read a file, and return None if it is read, or "refused" for an InputError that describes each problem."""
    try:
        seed.read(path)
    except InputError as error:
        if not error.problems or not all(str(problem).strip() for problem in error.problems):
            raise RuntimeError("an InputError without a problem") from None
        return "refused"
    return None
