"""Test the reading and interpolation of camera tracks, and fits of clips by moving cameras."""

from __future__ import annotations

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from example_run import AHEAD, ASIDE, BODY, FISHEYE, FPS, settings
from scipy.spatial.transform import Rotation

from recon import FitSettings, Motion, find_clips, fit_clip, read_keypoints
from recon.api.clip_cameras import read_clip_cameras
from recon.api.clip_inputs import prepare
from recon.api.clip_results import identity
from recon.clip import Keypoints, View, fill_from_nearest, views_of
from recon.geometry.camera import Camera
from recon.geometry.frames import inverse, rigid
from recon.io.camera_files import write_camera
from recon.io.camera_track import read_camera_track
from recon.io.deeplabcut import write_csv
from recon.io.positions import read_pose3d
from recon.testing.cameras import level_pose
from recon.testing.files import TRACK_HEADER, track_rows, write_track
from tests.command_line import refusal, says
from tests.command_line import run as command

pytestmark = pytest.mark.usefixtures("no_playback")

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
DRONE = Camera.from_hfov(64.0, (1920, 1080))
LEVEL = level_pose([1.0, 2.0, 3.0], 0.3)


def write_model(out: Path, lenses: list[str], frames: np.ndarray, poses: np.ndarray, of: list[int]) -> Path:
    """Write a COLMAP model as text, in which every other image has points."""
    out.mkdir(exist_ok=True)
    (out / "cameras.txt").write_text("# Camera list\n" + "\n".join(lenses) + "\n")
    lines = ["# Image list with two lines of data per image:"]
    for i, (row, camera) in enumerate(zip(track_rows(frames, poses), of, strict=True)):
        name = f"run 2/cam1_{int(row[0]):06d}.png"
        lines += [" ".join(map(repr, [i + 1, *row[1:], camera])) + f" {name}", "10.5 20.5 -1 30 40 7" if i % 2 else ""]
    (out / "images.txt").write_text("\n".join(lines) + "\n")
    return out


def turning(T: int, by_rad: float = 0.01, centre_m: tuple[float, float, float] = (1.0, 2.0, 3.0)) -> np.ndarray:
    return np.stack([level_pose([*centre_m], 0.3 + by_rad * t) for t in range(T)])


def refuses(text: str, path: Path, *expected: tuple[object, ...]) -> None:
    """Check that a track raises these problems, given as for `refusal` but without the file."""
    path.write_text(text)
    with refusal(*((path, *one) for one in expected)):
        read_camera_track(path)


def test_a_table(tmp_path):
    poses, frames = turning(6), np.array([3, 4, 5, 6, 8, 9])
    track = read_camera_track(write_track(tmp_path / "track.csv", frames, poses))
    np.testing.assert_array_equal(track.frames, frames)
    np.testing.assert_allclose(track.T_camera_world, poses, atol=1e-12)
    assert (track.camera, track.intrinsics_px) == (None, None)
    zoom = np.column_stack([np.linspace(1000, 1500, 6)] * 2 + [np.full(6, 960.0), np.full(6, 540.0)])
    track = read_camera_track(write_track(tmp_path / "zoom.csv", frames, poses, zoom))
    assert track.intrinsics_px is not None
    np.testing.assert_allclose(track.intrinsics_px, zoom)


def test_a_table_of_poses_from_the_camera_to_the_world(tmp_path):
    """A table can have poses from the camera to the world, with the camera's position in x, y, z."""
    poses, frames = turning(4), np.arange(4)
    path = write_track(tmp_path / "track.csv", frames, inverse(poses))
    path.write_text(path.read_text().replace("tx,ty,tz", "x,y,z"))
    np.testing.assert_allclose(read_camera_track(path).T_camera_world, poses, atol=1e-12)
    refuses(path.read_text().replace("x,y,z", "x,y"), path, *(("columns", f"no {name}") for name in ("tx", "ty", "tz")))


@pytest.mark.parametrize("name", ["reconstruction.json", "shots.geojson"])
def test_poses_of_opendronemap(name, tmp_path):
    """OpenSfM stores rotation vectors from the world to the camera, and shots.geojson has the cameras' positions."""
    poses, frames = turning(3), [7, 8, 11]
    shots = {}
    for frame, T in zip(frames, poses, strict=True):
        at = T[:3, 3] if name.startswith("rec") else inverse(T)[:3, 3]
        turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
        shots[f"DJI_0004_{frame:05d}.jpg"] = {"rotation": turn.tolist(), "translation": at.tolist(), "camera": "v2 dji"}
    document = [{"cameras": {}, "shots": shots, "points": {}}]
    if name == "shots.geojson":
        features = [{"type": "Feature", "properties": {"filename": key} | shot} for key, shot in shots.items()]
        document = {"type": "FeatureCollection", "features": features}
    path = tmp_path / name
    path.write_text(json.dumps(document))
    track = read_camera_track(path)
    assert track.frames.tolist() == frames
    np.testing.assert_allclose(track.T_camera_world, poses, atol=1e-9)
    refuses("[]", path, ("shots", "0 reconstructions"))
    longer = json.dumps(document).replace('"rotation": [', '"rotation": [1, ', 1)
    refuses(longer, path, ("shots.DJI_0004_00007.jpg", "no complete pose", "3 numbers"))


def test_a_table_in_another_order_with_other_columns_and_semicolons(tmp_path):
    text = "time;TX;ty;tz;qw;qx;qy;qz;frame\n" + "".join(
        ";".join(map(repr, [0.1, *row[5:], *row[1:5], row[0]])) + "\n"
        for row in reversed(track_rows(np.arange(3), turning(3)))
    )
    (tmp_path / "track.csv").write_text(text)
    track = read_camera_track(tmp_path / "track.csv")
    np.testing.assert_array_equal(track.frames, [0, 1, 2])
    np.testing.assert_allclose(track.T_camera_world, turning(3), atol=1e-12)


def test_short_gaps_are_filled_and_long_ones_are_not(tmp_path):
    """Gaps of 3 frames at 30 Hz are interpolated at constant velocity, and gaps of 4 frames are not."""
    poses, kept = turning(12, 0.05), np.array([0, 3, 7, 8])
    poses[:, :3, 3] = -(poses[:, :3, :3] @ np.array([[t, 0.1 * t, 1.0] for t in range(12)])[..., None])[..., 0]
    zoom = np.column_stack([1000.0 + 10 * np.arange(12), 1000.0 + 10 * np.arange(12), np.zeros((12, 2))])
    track = read_camera_track(write_track(tmp_path / "track.csv", kept + 5, poses[kept], zoom[kept]))
    found, filled = track.at(np.arange(3, 16), 30.0)
    np.testing.assert_array_equal(np.flatnonzero(found.known) - 2, [0, 1, 2, 3, 7, 8])
    np.testing.assert_array_equal(np.flatnonzero(filled) - 2, [1, 2])
    np.testing.assert_allclose(found.T_camera_world[found.known], poses[[0, 1, 2, 3, 7, 8]], atol=1e-12)
    assert found.intrinsics_px is not None
    np.testing.assert_allclose(found.intrinsics_px[found.known], zoom[[0, 1, 2, 3, 7, 8]])
    assert np.isnan(found.T_camera_world[~found.known]).all()
    assert np.isnan(found.intrinsics_px[~found.known]).all()
    np.testing.assert_array_equal(
        fill_from_nearest(np.array([np.nan, 1.0, np.nan, np.nan, 4.0, np.nan])), [1, 1, 1, 4, 4, 4]
    )


@pytest.mark.parametrize(
    ("line", "model", "distortion"),
    [
        ("1 SIMPLE_PINHOLE 1920 1080 1000 960 540", "pinhole", []),
        ("1 PINHOLE 1920 1080 1000 1000 960 540", "pinhole", []),
        ("1 SIMPLE_RADIAL 1920 1080 1000 960 540 0.1", "radtan", [0.1, 0, 0, 0]),
        ("1 RADIAL 1920 1080 1000 960 540 0.1 0.02", "radtan", [0.1, 0.02, 0, 0]),
        ("1 FULL_OPENCV 1920 1080 1000 1000 960 540 1 2 3 4 5 6 7 8", "radtan", [1, 2, 3, 4, 5, 6, 7, 8]),
        ("1 OPENCV 1920 1080 1000 1000 960 540 0.1 0.02 0.003 0.004", "radtan", [0.1, 0.02, 0.003, 0.004]),
        ("1 OPENCV_FISHEYE 1920 1080 1000 1000 960 540 0.1 0.02 0.003 0.004", "fisheye", [0.1, 0.02, 0.003, 0.004]),
    ],
)
def test_lenses_of_a_colmap_model(tmp_path, line, model, distortion):
    """Lenses of a COLMAP model, which counts pixels from the corner of the first pixel, are converted."""
    out = write_model(tmp_path / "phone", [line, "2 FOV 640 480 1 1 1 1 1"], np.arange(4), turning(4), [1] * 4)
    for path in (out, out / "images.txt"):
        track = read_camera_track(path)
        np.testing.assert_array_equal(track.frames, np.arange(4))
        np.testing.assert_allclose(track.T_camera_world, turning(4), atol=1e-12)
        assert track.intrinsics_px is None
        lens = track.camera
        assert lens is not None
        assert (lens.name, lens.model, lens.image_size_px) == ("phone", model, (1920, 1080))
        np.testing.assert_array_equal(lens.matrix, [[1000, 0, 959.5], [0, 1000, 539.5], [0, 0, 1]])
        np.testing.assert_array_equal(lens.distortion, distortion)


def test_a_focal_length_in_another_unit_than_pixels(tmp_path):
    frames, poses = np.arange(3), np.stack([LEVEL] * 3)
    write_camera(DRONE, tmp_path / "camera.toml")
    given = {"keypoints": tmp_path / "a.csv", "camera": tmp_path / "camera.toml", "fps": 60}
    for focal, known in ((1e5, False), (24.0, False), (3000.0, True)):
        track = write_track(tmp_path / "track.csv", frames, poses, np.tile([focal, focal, 959.5, 539.5], (3, 1)))
        settings = FitSettings(**given, camera_track=track)
        with nullcontext() if known else refusal((track, "fx", f"{focal:.4g} px", "of the camera file")):
            read_clip_cameras(settings)


def test_a_colmap_model_that_zooms(tmp_path):
    lenses = ["1 RADIAL 1920 1080 1000 960 540 0.1 0", "2 RADIAL 1920 1080 1200 970 540 0.1 0"]
    track = read_camera_track(write_model(tmp_path / "zoom", lenses, np.arange(3), turning(3), [1, 2, 2]))
    assert track.intrinsics_px is not None
    np.testing.assert_array_equal(
        track.intrinsics_px, [[1000, 1000, 959.5, 539.5], [1200, 1200, 969.5, 539.5], [1200, 1200, 969.5, 539.5]]
    )


def test_standard_deviations_of_rotations_are_read(tmp_path):
    """The standard deviation of rotations is kept over short gaps, and refused if it is not a number."""
    path = write_track(tmp_path / "track.csv", np.array([3, 5, 6]), turning(3))
    head, *rows = path.read_text().splitlines()
    said = [f"{row},{sigma}" for row, sigma in zip(rows, (0.02, 0.05, 0.01), strict=True)]
    path.write_text("\n".join([f"{head},sigma_deg", *said]))
    found = read_camera_track(path).at(np.arange(3, 7), 60.0)[0].rotation_sigma_rad
    np.testing.assert_allclose(np.degrees(found), [0.02, 0.05, 0.05, 0.01])
    for wrong in ("-0.1", "nan", "60"):
        text = "\n".join([f"{head},sigma_deg", *said[:2], f"{rows[2]},{wrong}"])
        refuses(text, path, ("sigma_deg", "line 4", "0 to 10 degrees"))


def test_uncertain_rotations_make_points_uncertain():
    """The covariance of points agrees with that of points turned about the camera at random."""
    points, sigma = np.random.default_rng(0).normal([0.0, 9.0, 0.0], 1.0, (2, 3, 3)), np.radians([0.3, 0.1])
    pans = View(FISHEYE, turning(2), np.zeros((2, 3, 2)), np.ones((2, 3)), rotation_sigma_rad=sigma)
    turns = sigma[:, None] * np.random.default_rng(1).normal(size=(40000, 2, 3))
    moved = np.cross(turns[:, :, None], points - pans.centre_m[:, None])
    expected = np.einsum("ntja,ntjb->tjab", moved, moved) / len(moved)
    np.testing.assert_allclose(pans.rotation_covariance_m2(points), expected, atol=0.02 * expected.max())
    assert pans.part(slice(1, 2)).turn_px == pytest.approx(np.radians(0.1) * pans.focal_px)


def test_all_faults_of_a_table_are_reported(tmp_path):
    path, positions = tmp_path / "track.csv", TRACK_HEADER.replace("tx,ty,tz", "x,y,z")
    refuses(
        f"{TRACK_HEADER}\n0,2,0,0,0,0,0,0\n1,1,0,0,0,0,,0\n1,1,0,0,0,0,0,1e9\n",
        path,
        ("frame", "line 3, line 4", "each frame"),
        ("numbers", "line 3", "finite"),
        ("qw, qx, qy, qz", "line 2", "unit quaternions"),
        ("tx, ty, tz", "line 4", "metres"),
    )
    missing = (("columns", f"no {name}") for name in ("qz", "fy", "cx", "cy"))
    refuses("frame,qw,qx,qy,tx,ty,tz,fx\n", path, *missing)
    cells = ("line 2", "4 cells", 8), ("line 3, qx", "'x'", "number")
    refuses(f"{TRACK_HEADER}\n0,1,0,0\n0.5,1,x,0,0,0,0,0\n", path, *cells)
    refuses(f"{TRACK_HEADER}\n", path, ("rows", "no rows"))
    refuses(f"{positions}\n0,1,0,0,0,0,0,0\n1,0,0,0,0,0,0,0\n", path, ("qw, qx, qy, qz", "line 3", "unit quaternions"))
    refuses(f"{TRACK_HEADER},fx,fy,cx,cy\n0,1,0,0,0,0,0,0,0,1,2,3\n", path, ("fx, fy, cx, cy", "line 2", "px"))


def test_faults_of_a_colmap_model_are_named(tmp_path):
    image = "1 1 0 0 0 0 0 0 1 "
    lines = ("line 1", "'1 1 0 0 0 0 0 0 1 a.png'", "IMAGE_ID"), ("line 4", "'1 2'", "POINT3D_ID")
    refuses(f"{image}a.png\n\n{image}b2.png\n1 2\n", tmp_path / "images.txt", *lines)
    refuses(f"{image}a1.png\n\n{image}b1.png\n\n", tmp_path / "images.txt", ("frame", "line 1, line 3"))
    lens = "1 SIMPLE_RADIAL 9 9 1000 4 4 "
    for lines, expected in (
        (["1 FOV 9 9 1 1 1 1 1"], [("line 2, camera 1: model", "'FOV'", "SIMPLE_RADIAL")]),
        ([lens], [("line 2, camera 1: parameters", "nothing", "fx"), ("line 2, camera 1: distortion", "nothing")]),
        (["1 SIMPLE_PINHOLE 9 9 -5 4 4"], [("line 2, camera 1: parameters", "[[-5.0, 0.0, 3.5]", "fx and fy > 0")]),
        ([lens + "0.1"], [("cameras", "no camera 2", "images.txt")]),
        ([lens + "0.1", "2" + lens[1:] + "0.2"], [("cameras", "2 cameras with different lenses")]),
    ):
        write_model(tmp_path, lines, np.arange(2), turning(2), [1, 1 if "FOV" in lines[0] else 2])
        with refusal(*((tmp_path / "cameras.txt", *one) for one in expected)):
            read_camera_track(tmp_path)


def test_a_world_whose_z_does_not_point_up_is_refused(tmp_path):
    """COLMAP's world, whose y points down, is refused. Cameras that lean by less than 60 degrees are accepted."""
    down = np.tile(np.eye(4), (3, 1, 1))
    with refusal(("track.csv", "poses", ["not upright in 3 of 3 frames", "z points up"], "z up")):
        read_camera_track(write_track(tmp_path / "track.csv", np.arange(3), down))
    down[:2] = LEVEL
    assert len(read_camera_track(write_track(tmp_path / "track.csv", np.arange(3), down)).frames) == 3


@pytest.mark.slow
def test_a_drone_that_looks_down_on_the_animal_and_follows_it(tmp_path):
    """The depth below a drone that follows the animal is known as precisely as the animal's size."""
    truth = read_pose3d(SAMPLES / "whole_truth.csv")
    truth = replace(truth, xyz_m=truth.xyz_m[:16], frames=truth.frames[:16])
    turn = Rotation.from_euler("xz", [-180, 130], degrees=True).as_matrix()
    ahead = turn[2] / abs(turn[2, 2])
    above = truth.xyz_m.mean(axis=1) * [1, 1, 0] - 12.0 * ahead
    poses = np.stack([rigid(turn, -turn @ position) for position in above])
    blank = View(DRONE, poses, np.zeros((*truth.xyz_m.shape[:2], 2)), np.ones(truth.xyz_m.shape[:2]))
    xy_px = blank.project(truth.xyz_m)[0] + 2.0 * np.random.default_rng(0).normal(size=blank.xy_px.shape)
    seen = Keypoints(truth.names, xy_px, np.full(blank.confidence.shape, 0.9), truth.frames, fps=60.0)
    write_csv(seen, tmp_path / "drone.csv")
    track = write_track(tmp_path / "track.csv", truth.frames, poses)
    lens = {"hfov_deg": 64.0, "image_size_px": (1920, 1080)}
    motion = fit_clip(FitSettings(keypoints=tmp_path / "drone.csv", camera_track=track, fps=60, fast=True, **lens))
    found = motion.upright.xyz_m[:, [motion.names.index(name) for name in truth.names]]
    off_m = found - truth.xyz_m
    assert np.linalg.norm(off_m - off_m.mean(axis=1, keepdims=True), axis=2).mean() < 0.1
    assert (np.abs(turn @ off_m.mean(axis=(0, 1))) < [0.1, 0.1, 2.5]).all()
    assert motion.verdict.level != "do not use"


def test_files_of_other_kinds(tmp_path):
    refuses("{}", tmp_path / "track.yml", ("format", "'.yml'", "(.csv)"))
    with refusal(("images.txt", "file", "no such file")):
        read_camera_track(tmp_path)


def test_settings_that_do_not_fit(runs, tmp_path):
    track = write_track(tmp_path / "track.csv", np.arange(40), turning(40))
    given: dict[str, Any] = {"keypoints": runs / "run_cam1.csv", "fps": FPS}
    for more, *expected in (
        ({"camera_track": track}, "camera", ["no lens", "track.csv"], "camera file"),
        ({"camera_track": [track, track], "camera": "a.json"}, "camera_track", "2 tracks for 1 keypoint file"),
        ({"camera_track": track, "camera": "a.json", "tilt_deg": 5}, "tilt_deg", "5 together with a camera track"),
        ({"camera_track": track, "camera": "a.json", "method": "frame"}, "camera_track", "frame method"),
    ):
        with refusal(("settings", *expected)):
            prepare(FitSettings(**given, **more))


def test_a_track_belongs_to_the_camera_in_its_name(runs, tmp_path):
    """A track belongs to the camera whose name is part of the track's name, here the second of two cameras."""
    aside = np.tile(ASIDE, (40, 1, 1))
    track = write_track(tmp_path / "cam2_track.csv", np.arange(40), aside)
    first, second = prepare(settings(runs, 1, 2, camera_track=track)).sources
    assert not first.moves
    assert second.moves
    assert not second.camera.has_extrinsics
    still = views_of(prepare(settings(runs, 1, 2)).sources)[1]
    moving = views_of((first, second))[1]
    np.testing.assert_allclose(moving.T_camera_world[10:], np.tile(still.T_camera_world, (30, 1, 1)), atol=1e-9)
    nobody = write_track(tmp_path / "other.csv", np.arange(40), aside)
    with refusal((nobody, "name", "other", "cam1, cam2")):
        prepare(settings(runs, 1, 2, camera_track=nobody))


def test_a_colmap_model_has_the_lens_of_its_camera(runs, tmp_path):
    lens = "3 OPENCV_FISHEYE 1920 1080 {0} {0} 960 540 0 0 0 0".format(FISHEYE.matrix[0, 0])
    models = [
        write_model(tmp_path / name, [lens], np.arange(40), np.tile(at, (40, 1, 1)), [3] * 40)
        for name, at in (("cam1", AHEAD), ("cam2", ASIDE))
    ]
    plain: dict[str, Any] = {"fps": FPS, "camera_track": models, "camera_name": ["cam1", "cam2"]}
    files = (runs / "run_cam1.csv", runs / "run_cam2.csv")
    sources = prepare(FitSettings(keypoints=files, **plain)).sources
    assert [source.camera.name for source in sources] == ["cam1", "cam2"]
    np.testing.assert_allclose(sources[0].camera.matrix, FISHEYE.matrix, atol=1e-9)
    with refusal(("--camera-track", "camera", ["camera file", models[0] / "images.txt"], "only one of the two")):
        prepare(replace(settings(runs, 1), camera_track=tuple(models[:1])))


def test_a_batch_finds_tracks_next_to_its_manifest_and_notices_changes(runs, tmp_path):
    track = write_track(tmp_path / "track.csv", np.arange(40), turning(40))
    manifest = tmp_path / "clips.csv"
    manifest.write_text(f"keypoints,camera,fps,camera_track\n{runs}/run_cam1.csv,{runs}/scene.json,90,track.csv\n")
    (clip,), _ = find_clips([manifest], {})
    assert clip.settings.camera_track == (track,)
    before = identity(clip.settings)
    assert set(before["inputs"]) == {"keypoints", "camera", "camera_track"}
    assert "camera_track" not in before["settings"]


def test_frames_without_a_pose_have_no_detections(runs, tmp_path):
    """Detections are left out in frames without a camera pose, but kept in gaps of up to 9 frames at 90 Hz."""
    frames = np.array([t for t in range(35) if not 10 < t < 23 and t not in (3, 4)])
    track = write_track(tmp_path / "track.csv", frames, np.tile(AHEAD, (len(frames), 1, 1)))
    (source,) = prepare(settings(runs, 1, camera_track=track)).sources
    absent = [*range(11, 23), *range(35, 40)]
    np.testing.assert_array_equal(np.flatnonzero(~source.keypoints.present.any(axis=1)), absent)
    assert source.poses is not None
    np.testing.assert_array_equal(np.flatnonzero(~source.poses.known), absent)
    lost = len(absent) * len(BODY.markers)
    between, left_out = source.cleaning.notes
    assert says(between, "2 frames", "0.1 s apart")
    assert says(left_out, f"{lost} points", "left out", f"{BODY.markers[0]} in frame 11, ...")
    far = write_track(tmp_path / "far.csv", np.arange(100, 110), turning(10))
    with refusal((far, "frame", ["100 to 109", runs / "run_cam1.csv"], "0 to 39")):
        prepare(settings(runs, 1, camera_track=far))


def panned(runs: Path) -> dict[str, Any]:
    """Write keypoints and track of the sample as seen by a camera that turns to and fro, and return their settings."""
    (view,) = views_of(
        prepare(FitSettings(keypoints=SAMPLES / "whole.csv", camera=SAMPLES / "camera.toml", fps=60)).sources
    )
    keypoints = read_keypoints(SAMPLES / "whole.csv")
    T = len(keypoints.frames)
    angle = 0.05 * np.sin(np.arange(T) / 10)
    turn = np.tile(np.eye(3), (T, 1, 1))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 0, 1], turn[:, 1, 0] = -np.sin(angle), np.sin(angle)
    rotation, centre = view.T_camera_world[:3, :3] @ turn, view.centre_m[0]
    poses = rigid(rotation, -(rotation @ centre))
    pans = View(view.camera, poses, view.xy_px, view.confidence)
    seen = Keypoints(BODY.markers, pans.project(centre + view.rays())[0], view.confidence, keypoints.frames, fps=60.0)
    seen = replace(seen, scorer=keypoints.scorer)
    write_csv(seen, runs / "pan.csv")
    return {
        "keypoints": runs / "pan.csv",
        "camera": SAMPLES / "camera.toml",
        "camera_track": write_track(runs / "track.csv", keypoints.frames, poses),
        "fps": 60,
        "fast": True,
    }


def test_a_camera_that_pans_gives_the_motion_of_a_still_camera(tmp_path):
    """A panning camera and a static camera give the same motion if the height of the camera is not used."""
    options: dict[str, Any] = {"ground": "none"}
    pan = fit_clip(FitSettings(**panned(tmp_path), **options))
    still = fit_clip(
        FitSettings(keypoints=SAMPLES / "whole.csv", camera=SAMPLES / "camera.toml", fps=60, fast=True, **options)
    )
    assert isinstance(pan, Motion)
    assert isinstance(still, Motion)
    assert np.linalg.norm(pan.joints_m - still.joints_m, axis=-1).mean() < 0.001
    assert pan.frame_of_reference == "world"
    assert pan.states_frame == "world"
    assert pan.relative_rms_m.mean() == pytest.approx(still.relative_rms_m.mean(), rel=0.03)


@pytest.mark.slow
def test_command(tmp_path):
    """A fit with a camera track can be read, evaluated, analysed, converted and repeated by commands."""
    given, out = panned(tmp_path), tmp_path / "out"
    track = Path(str(given["camera_track"]))
    lines = track.read_text().splitlines()
    track.write_text("\n".join([lines[0], *lines[6:]]) + "\n")
    files = ["--camera", given["camera"], "--camera-track", track]
    ended = command("fit", given["keypoints"], *files, "--fps", 60, "--set", "fast=true", "--out", out)
    assert ended.code == 0, ended.err
    report = json.loads((out / "report.json").read_text())
    assert report["frame_of_reference"] == "world"
    assert report["assumptions"]["camera_moves"] is True
    assert report["assumptions"]["camera_level"] is False
    assert any(says(said, "metres with z up") for said in report["assumptions"]["sentences"])
    assert not any("static" in said for said in report["assumptions"]["sentences"])
    assert report["cameras"][0]["track"]["frames_without_pose"] == 5
    results = Motion.load(out)
    truth = SAMPLES / "whole_truth.csv"
    assert results.knows_up
    scored = command("evaluate", out, truth, "--json")
    assert scored.code == 0, scored.err
    assert json.loads(scored.out)["mpjpe_mm"] < 60
    assert command("analyse", out, "--no-figures").code == 0
    assert command("convert", out, tmp_path / "pose.trc").code == 0
    again = command("fit", "--config", out / "config.toml", "--out", tmp_path / "again")
    assert again.code == 0, again.err
    assert (out / "pose3d.csv").read_bytes() == (tmp_path / "again" / "pose3d.csv").read_bytes()
