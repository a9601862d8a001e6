"""Test clips that several cameras filmed: files and their cameras, common frames, and wrong inputs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from example_run import (
    AHEAD,
    ASIDE,
    BODY,
    CAMERA,
    FISHEYE,
    FPS,
    keypoints_of,
    settings,
    truth_m,
)
from scipy.spatial.transform import Rotation

from recon import Camera, FitSettings, Motion, clean, fit_clip, samples_folder
from recon.animal.skeleton_file import load_skeleton
from recon.api.clip_cameras import cameras_in
from recon.api.clip_inputs import length_of_animal_m, prepare
from recon.api.extrinsics import clips_of, run_extrinsics
from recon.base.numbers import plus_minus
from recon.cli.cameras import lines_of
from recon.clip import Source, View, align_cameras
from recon.fit.extrinsics import solve_extrinsics
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.io.calibration import read_cameras
from recon.io.camera_files import write_cameras
from recon.io.deeplabcut import write_csv
from recon.io.formats import read_keypoints
from tests.command_line import refusal, says
from tests.command_line import run as command

pytestmark = pytest.mark.usefixtures("no_playback")

SAMPLES = samples_folder()


def test_cameras_are_matched_by_the_file_name(runs):
    given = prepare(settings(runs, 2, 1))
    assert [source.camera.name for source in given.sources] == ["cam2", "cam1"]
    assert [source.camera.name for source in prepare(settings(runs, 1)).sources] == ["cam1"]


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("run_top1DLC_resnet50", ["top1"]),
        ("run_top10", []),
        ("A-walk", ["A"]),
        ("Alex-walk", []),
        ("a1-walk-camB", ["B"]),
        ("run1_1-cam-2", ["2"]),
        ("run_1-B", ["B", "1"]),
        ("run_cam_02_DLC", ["cam02"]),
        ("run_cam-2_DLC", ["2"]),
        ("cam4_json", ["int_cam4_img"]),
        ("run_cam04", ["int_cam4_img"]),
        ("run_Camera03", ["hires_cam3_params"]),
    ],
)
def test_names_of_cameras_in_names_of_files(name, found):
    assert [*cameras_in(name, ["top1", "A", "B", "1", "2", "cam02", "hires_cam3_params", "int_cam4_img"])] == found


def test_an_exact_camera_name_takes_precedence():
    for name in ("cam1", "cam01", "Cam1"):
        assert [*cameras_in(f"run_{name}", ["cam1", "cam01", "Cam1"])] == [name]
    assert [*cameras_in("run_cam001", ["cam1", "cam01"])] == ["cam1", "cam01"]


def test_cameras_in_millimetres(runs):
    def places_m(given: FitSettings) -> np.ndarray:
        return np.array([source.camera.translation_m for source in prepare(given).sources], dtype=float)

    scene = json.loads((runs / "scene.json").read_text())
    for camera in scene["cameras"]:
        camera["t"] = (1000 * np.array(camera["t"])).tolist()
    (runs / "in_mm.json").write_text(json.dumps(scene))
    in_mm = settings(runs, 1, 2, camera=runs / "in_mm.json", camera_unit="mm")
    np.testing.assert_allclose(places_m(in_mm), places_m(settings(runs, 1, 2)), rtol=1e-12)
    for scene_file, given, right in (("in_mm.json", "m", "mm"), ("scene.json", "mm", "m"), ("scene.json", "cm", "m")):
        with refusal(("--camera-unit", "camera_unit", [given, "times as large"], f"probably {right}")):
            prepare(settings(runs, 1, 2, camera=runs / scene_file, camera_unit=given))
    with refusal(("settings", "camera_unit", "'mm'", "--camera")):
        FitSettings(keypoints=(Path("a.csv"),), hfov_deg=60, image_size_px=(9, 9), camera_unit="mm")


def test_a_wrong_unit_is_found_from_few_frames(runs, monkeypatch):
    """The second camera's file begins at frame 10, so the first frames do not show the unit."""
    monkeypatch.setattr("recon.api.clip_inputs.FRAMES_FOR_UNIT", 8)
    with refusal(("--camera-unit", "camera_unit", ["mm", "times as large"], "probably m")):
        prepare(settings(runs, 1, 2, camera_unit="mm"))


def test_outliers_do_not_make_the_animal_longer():
    """In most frames some point is an outlier, so the largest extent of a typical frame is too long."""
    rng = np.random.default_rng(0)
    body = load_skeleton("dog-27")
    points_m = np.repeat(body.expected_points_m()[None], 60, axis=0)
    true_m = length_of_animal_m(points_m)
    assert true_m == pytest.approx(np.linalg.norm(points_m[0, :, None] - points_m[0], axis=2).max())
    with_outliers_m = points_m.copy()
    is_outlier = rng.random(points_m.shape[:2]) < 0.1
    with_outliers_m[is_outlier] += rng.normal(0.0, true_m, (is_outlier.sum(), 3))
    assert is_outlier.any(axis=1).mean() > 0.8
    assert np.median(np.ptp(with_outliers_m, axis=1).max(axis=1)) > 1.5 * true_m
    assert length_of_animal_m(with_outliers_m) == pytest.approx(true_m, rel=0.02)
    assert length_of_animal_m(np.full((3, 5, 3), np.nan)) == 0.0


def test_cameras_can_be_named_by_option(runs):
    given = prepare(settings(runs, 1, 2, camera_name=["cam2", "cam1"]))
    assert [source.camera.name for source in given.sources] == ["cam2", "cam1"]


def test_views_have_the_same_frames(runs):
    """The second camera's file begins at frame 10. Its view has all frames, and is empty before frame 10."""
    first, second = prepare(settings(runs, 1, 2)).sources
    np.testing.assert_array_equal(first.keypoints.frames, np.arange(40))
    np.testing.assert_array_equal(second.keypoints.frames, np.arange(40))
    assert not second.keypoints.present[:10].any()
    assert second.keypoints.present[10:].all()


def test_a_range_of_frames_is_the_first_cameras(runs):
    first, second = prepare(settings(runs, 1, 2, frames="5:20")).sources
    assert (first.keypoints.frames[0], first.keypoints.frames[-1]) == (5, 19)
    assert not second.keypoints.present[:5].any()
    assert second.keypoints.present[5:].all()


def test_offsets_of_cameras_shift_their_frames():
    """A camera that began 2.25 frames later has its frame 0 between frames 2 and 3 of the clip."""
    xy_px = np.arange(5.0)[:, None, None] + np.zeros((5, len(BODY.markers), 2))
    sources = [Source(CAMERA, *clean(keypoints_of(values), 0.5), BODY.markers) for values in (xy_px + 100, xy_px + 200)]
    first, late = align_cameras(sources, [0.0, 2.25])
    np.testing.assert_array_equal(first.keypoints.frames, np.arange(7))
    assert (first.offset_frames, late.offset_frames) == (0.0, 0.25)
    assert np.isnan(first.keypoints.xy_px[5:]).all()
    np.testing.assert_array_equal(late.keypoints.xy_px[:, 0, 0], [np.nan, np.nan, 200, 201, 202, 203, 204])
    _, early = align_cameras(sources, [0.0, -0.25])
    assert early.offset_frames == 0.75
    assert early.keypoints.frames[0] == -1


def test_a_clip_of_two_cameras(runs):
    motion = fit_clip(settings(runs, 1, 2))
    assert isinstance(motion, Motion)
    assert np.linalg.norm(motion.joints_m - truth_m(), axis=-1).mean() < 0.025
    assert [source.camera.name for source in motion.sources] == ["cam1", "cam2"]
    assert motion.solution.weight.shape == (2, 40, len(BODY.markers))


@pytest.mark.parametrize(("up", "turned"), [("z", False), ("-y", True), ("0,-2,0", True), ("first-camera", None)])
def test_up_turns_the_cameras(runs, tmp_path, up, turned):
    """`up` states the up direction of cameras whose world has -y up, as OpenCV's boards have, or z up."""
    R = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if turned else np.eye(3)  # from z up to the file's axes
    given = read_cameras(runs / "scene.json")
    cameras = [replace(one, rotation=np.asarray(one.rotation) @ R.T, world_z_up=False) for one in given]
    write_cameras(cameras, tmp_path / "rig.toml")
    found = prepare(settings(runs, 1, 2, camera=tmp_path / "rig.toml", up=up)).sources
    assert [source.camera.knows_up for source in found] == [turned is not None] * 2
    for source, pose in zip(found if turned is not None else (), (AHEAD, ASIDE), strict=False):
        assert source.camera.rotation is not None
        np.testing.assert_allclose(source.camera.rotation[:, 2], pose[:3, 2], atol=1e-9)
        assert np.linalg.det(source.camera.rotation) == pytest.approx(1)


def test_up_is_refused_if_known_or_not_a_direction(runs):
    with refusal(("--set up", "direction", "'upwards'", "first-camera")):
        prepare(settings(runs, 1, 2, up="upwards"))
    with refusal(("--set up", "up", ["z", "no pose for cam1"], "cameras with poses")):
        prepare(settings(runs, 1, camera=None, hfov_deg=60.0, image_size_px=(1920, 1080), up="z"))
    with refusal(("--set up", "up", ["-z", "states z up for cam1, cam2"], "no --set up")):
        prepare(settings(runs, 1, 2, up="-z"))


def test_a_copied_camera_entry_is_reported(runs, tmp_path):
    one, other, *_ = read_cameras(runs / "scene.json")
    write_cameras([one, replace(one, name=other.name)], tmp_path / "copied.toml")
    with refusal((tmp_path / "copied.toml", "cameras cam1 and cam2", "same pose")):
        prepare(settings(runs, 1, 2, camera=tmp_path / "copied.toml"))


@pytest.mark.slow
def test_a_tenth_of_animal_and_rig_gives_a_tenth_of_the_motion(runs, tmp_path):
    """An animal and a rig of a tenth of the size give the same pictures, and a tenth of the motion."""
    cameras = [
        replace(one, translation_m=0.1 * np.asarray(one.translation_m)) for one in read_cameras(runs / "scene.json")
    ]
    write_cameras(cameras, tmp_path / "small.toml")
    more = {"frames": "10:30", "prior": "none", "ground": "none"}
    large = fit_clip(settings(runs, 1, 2, **more))
    small = fit_clip(settings(runs, 1, 2, camera=tmp_path / "small.toml", size=0.1, **more))
    assert small.size == pytest.approx(large.size, abs=0.02)
    assert small.body.keypoint_sigma_m == pytest.approx(0.1 * large.body.keypoint_sigma_m)
    off_m = np.linalg.norm(10 * small.joints_m - large.joints_m, axis=-1)
    assert np.nanmedian(off_m) < 0.02


def test_wrong_inputs_of_several_cameras_are_refused(runs, tmp_path):
    with refusal(("settings", "camera_name", "1: cam1", 2), ("settings", "offset_s", "3: 0.0, 0.1, 0.2", 2)):
        settings(runs, 1, 2, camera_name=["cam1"], offset_s=[0.0, 0.1, 0.2])
    with refusal(("settings", "keypoints", f"{runs / 'run_cam1.csv'}, {runs / 'run_cam1.csv'}", "different file")):
        settings(runs, 1, 1)
    with refusal(("settings", "keypoints", ["2 files", "frame method"], "--set method=trajectory")):
        settings(runs, 1, 2, method="frame", subject=None, fast=None)
    with refusal(("scene.json", "camera", ["cam1", "two keypoint files"], "--camera-name")):
        prepare(settings(runs, 1, 2, camera_name=["cam1", "cam1"]))
    (tmp_path / "clip.csv").write_bytes((runs / "run_cam1.csv").read_bytes())
    given = replace(settings(runs, 1, 2), keypoints=(tmp_path / "clip.csv", runs / "run_cam2.csv"))
    with refusal(("scene.json", "camera", ["2 cameras", "clip.csv"], ["cam1, cam2", "--camera-name"])):
        prepare(given)
    gone = tmp_path / "gone.csv"
    with refusal((gone, "file", "no such file")):  # that its name contains no camera is not reported
        prepare(replace(given, keypoints=(gone, runs / "run_cam2.csv")))
    with refusal((gone, "file", "no such file")):
        prepare(replace(given, keypoints=(gone,)))
    with refusal(
        (gone, "file", "no such file"), ("scene.json", "camera", "none of them chosen for clip.csv", "--camera-name")
    ):
        prepare(replace(given, keypoints=(gone, tmp_path / "clip.csv")))
    write_cameras([CAMERA], tmp_path / "one.toml")
    with refusal(("one.toml", "camera", "1 of the 2 cameras", "--camera once for each")):
        prepare(replace(given, camera=tmp_path / "one.toml"))


def test_command(runs, tmp_path):
    files = [runs / "run_cam1.csv", runs / "run_cam2.csv"]
    out = tmp_path / "out"
    options = ("--fps", 90, "--frames", "4:16", "--set", "fast=true")
    ended = command("fit", *files, "--camera", runs / "scene.json", *options, "--out", out)
    assert ended.code == 0, ended.err
    assert "run_cam1.csv, run_cam2.csv, frames 4 to 15 at 90 fps" in ended.out
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert [camera["frames_seen"] for camera in report["cameras"]] == [12, 6]
    assert report["cameras"][1]["points"]["missing"] == 6 * len(BODY.markers)
    assert {path.name for path in out.glob("reprojection*")} == {"reprojection_cam1.csv", "reprojection_cam2.csv"}
    again = command("fit", "--config", out / "config.toml", "--out", tmp_path / "again")
    assert again.code == 0, again.err
    assert (out / "pose3d.csv").read_bytes() == (tmp_path / "again" / "pose3d.csv").read_bytes()


def test_refined_poses_are_used_if_they_fit_better(runs, tmp_path):
    """Refined poses are used for a camera that was turned by 2 degrees, and not for one with the correct pose."""
    as_it_is = fit_clip(settings(runs, 1, 2, refine_cameras=True, frames="10:30"))
    assert [one.code for one in as_it_is.findings if one.code.startswith("cameras_")] == ["cameras_as_calibrated"]
    scene = json.loads((runs / "scene.json").read_text())
    beside = View(FISHEYE, ASIDE, np.zeros((1, 1, 2)), np.ones((1, 1)))
    turned = beside.corrected(np.radians([2, 0, 0, 0, 0, 0])).T_camera_world
    scene["cameras"][1] |= {"r": turned[:3, :3].tolist(), "t": turned[:3, 3, None].tolist()}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    known = {"camera": tmp_path / "scene.json"}
    motion = fit_clip(settings(runs, 1, 2, refine_cameras=True, frames="10:36", **known))
    given, cameras = prepare(settings(runs, 1, 2, **known)).sources, [source.camera for source in motion.sources]
    for camera, view in zip(cameras, motion.solution.views, strict=True):
        in_camera = camera.world_to_camera(motion.solution.joints_m)
        np.testing.assert_allclose(in_camera, view.to_camera(motion.solution.joints_m), atol=1e-9)
    assert cameras[0].to_dict() == given[0].camera.to_dict()
    off_rad = [
        Rotation.from_matrix(np.asarray(camera.rotation) @ ASIDE[:3, :3].T).magnitude()
        for camera in (given[1].camera, cameras[1])
    ]
    assert off_rad[1] < 0.5 * off_rad[0]
    write_cameras(cameras, tmp_path / "cameras.toml")
    assert [c.to_dict() for c in read_cameras(tmp_path / "cameras.toml")] == [c.to_dict() for c in cameras]
    (tmp_path / "cameras.toml").write_text('[[cameras]]\nformat = "recon-camera"\nversion = 99\n')
    with refusal(("cameras.toml", "cameras[0].format", "version 99", "version 1")):
        read_cameras(tmp_path / "cameras.toml")


@pytest.mark.slow
def test_a_turned_camera_of_a_pair_is_refined_automatically(runs, tmp_path):
    """The pose of a camera turned by 2 degrees in a pair is refined automatically, unless poses are stated as exact."""
    scene = json.loads((runs / "scene.json").read_text())
    beside = View(FISHEYE, ASIDE, np.zeros((1, 1, 2)), np.ones((1, 1)))
    turned = beside.corrected(np.radians([2, 0, 0, 0, 0, 0])).T_camera_world
    scene["cameras"][1] |= {"r": turned[:3, :3].tolist(), "t": turned[:3, 3, None].tolist()}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    known = {"camera": tmp_path / "scene.json"}
    motion = fit_clip(settings(runs, 1, 2, **known))
    as_said = fit_clip(settings(runs, 1, 2, cameras_known=True, frames="10:30", fast=True, **known))
    assert ["pair_refined" in {one.code for one in fit.findings} for fit in (motion, as_said)] == [True, False]
    still_off = Rotation.from_matrix(np.asarray(motion.sources[1].camera.rotation) @ ASIDE[:3, :3].T).magnitude()
    # The fit attributes a part of the rotation to the first camera.
    assert still_off < np.radians(0.35)
    given = prepare(settings(runs, 1, 2, **known)).sources[1].camera
    assert as_said.sources[1].camera.to_dict() == given.to_dict()


@pytest.mark.slow
def test_refinement_that_makes_a_camera_an_outlier_is_dropped(runs, monkeypatch):
    """A refinement that makes one camera an outlier, as the robust cost allows in a small rig, is not used."""

    def solve(views, body, prior, fps, options, progress):
        found = solve_trajectory(views, body, prior, fps, replace(options, refine_cameras=False), progress)
        if not options.refine_cameras:
            return found
        thrown = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
        turned = replace(found.views[1], T_camera_world=found.views[1].corrected(thrown).T_camera_world)
        return replace(found, views=(found.views[0], turned), extrinsic_correction=np.stack([0 * thrown, thrown]))

    monkeypatch.setattr("recon.api.clip.solve_trajectory", solve)
    motion = fit_clip(settings(runs, 1, 2, frames="10:36", refine_cameras=True))
    (one,) = [one for one in motion.findings if one.code == "cameras_not_refined"]
    assert one.camera == "cam2"
    assert float(one.numbers["after_px"]) > 10 * float(one.numbers["before_px"])  # pyright: ignore[reportArgumentType]
    assert isinstance(motion.solution, TrajectorySolution)
    assert not motion.solution.extrinsic_correction.any()
    given = prepare(settings(runs, 1, 2, frames="10:36")).sources
    assert [s.camera.to_dict() for s in motion.sources] == [s.camera.to_dict() for s in given]


def test_only_several_static_cameras_are_refined(runs):
    with refusal(("settings", "refine_cameras", "one keypoint file", "several cameras")):
        settings(runs, 1, refine_cameras=True)
    with refusal(("settings", "cameras_known", "refine_cameras as well", "only one of the two")):
        settings(runs, 1, 2, refine_cameras=True, cameras_known=True)
    with refusal(("settings", "refine_cameras", "camera track", "static cameras")):
        settings(runs, 1, 2, refine_cameras=True, camera_track=["cam1.csv"])


def test_camera_poses_are_found_from_the_animal_alone(runs, tmp_path):
    """Camera poses are estimated roughly from half a second of one run in two views, without the file's poses."""
    cameras, report = run_extrinsics([settings(runs, 1, 2, frames="10:36")], tmp_path / "found.toml")
    true, found = (read_cameras(path) for path in (runs / "scene.json", tmp_path / "found.toml"))
    assert [camera.to_dict() for camera in cameras] == [camera.to_dict() for camera in found]

    def beside(a: Camera, b: Camera) -> np.ndarray:
        return np.stack([b.world_to_camera(a.camera_to_world(corner)) for corner in np.eye(4, 3, k=-1)])

    (first, *axes), (own, *own_axes) = beside(*found), beside(*true)
    assert np.linalg.norm(first - own) < 0.15 * np.linalg.norm(own)
    cosines = np.sum((np.array(axes) - first) * (np.array(own_axes) - own), axis=1)
    assert np.degrees(np.arccos(cosines.min())) < 6
    height_m = found[0].camera_to_world(np.zeros(3))[2]
    assert found[0].knows_up
    assert 0.2 < height_m < 3
    assert [line.split(":")[0] for line in lines_of(cameras, report)] == ["cam1", "cam2"]
    assert 0 < np.linalg.norm(report["cameras"][1]["turn_sigma_rad"]) < 0.1


@pytest.mark.slow
def test_camera_heights_have_standard_deviations(tmp_path):
    """Camera heights, 1.5 and 1.6 m in the sample, have standard deviations."""
    files, given = [SAMPLES / f"whole_cam{n}.csv" for n in (1, 2)], {"camera": SAMPLES / "whole_scene.json", "fps": 60}
    more = {"fast": True, "frames": "10:40"}
    cameras, report = run_extrinsics(clips_of(files, given | more)[0], tmp_path / "found.toml")
    heights_m = np.array([camera.centre_world[2] for camera in cameras])
    sigma_m = np.array([camera["height_sigma_m"] for camera in report["cameras"]])
    assert (np.abs(heights_m - [1.5, 1.6]) < 2 * sigma_m).all()
    assert ((sigma_m > 0.1) & (sigma_m < 1.0)).all()
    assert [line.split(" high")[0] for line in lines_of(cameras, report)] == [
        f"{camera.name}: {plus_minus(height, sigma, 'm')}"
        for camera, height, sigma in zip(cameras, heights_m, sigma_m, strict=True)
    ]


def test_clips_of_one_rig_are_grouped_by_camera_name(runs, tmp_path):
    """Files are grouped to clips by camera name, and refined poses keep the file's world and first camera."""
    for number in (1, 2):
        for clip in ("a", "b"):
            (tmp_path / f"{clip}_cam{number}.csv").write_bytes((runs / f"run_cam{number}.csv").read_bytes())
    given = {"camera": runs / "scene.json", "fps": FPS, "subject": "phantom", "frames": "10:36"}
    clips, notes = clips_of([str(tmp_path / "*.csv")], given)
    assert [[path.name for path in clip.keypoints] for clip in clips] == [
        ["a_cam1.csv", "a_cam2.csv"],
        ["b_cam1.csv", "b_cam2.csv"],
    ]
    assert says(notes[0], "4 files", "2 clips")
    out = tmp_path / "refined.toml"
    _, report = run_extrinsics([replace(clip, refine_cameras=True) for clip in clips], out)
    (first, second), (own, other) = read_cameras(out), read_cameras(runs / "scene.json")
    assert first.knows_up
    np.testing.assert_allclose(first.centre_world, own.centre_world, atol=1e-5)
    np.testing.assert_allclose(second.centre_world, other.centre_world, atol=0.15)
    assert len(report["clips"]) == 2
    assert report["cameras"][0]["height_sigma_m"] is None  # the file says where the ground is
    (only,), _ = clips_of(clips[0].keypoints, given | {"camera_name": ["cam1", "cam2"]})
    assert only.keypoints == clips[0].keypoints


def test_cameras_that_the_clips_do_not_determine_are_refused(runs, tmp_path, monkeypatch):
    def solve(*given):
        rig = solve_extrinsics(*given)
        return replace(rig, sigma=np.where(np.arange(2)[:, None] == 1, np.radians(15.0), rig.sigma))

    monkeypatch.setattr("recon.api.extrinsics.solve_extrinsics", solve)
    clip = settings(runs, 1, 2, frames="10:36", refine_cameras=True)
    with refusal(("KEYPOINTS", "camera cam2", ["rotation", "26 degrees"])):
        run_extrinsics([clip], tmp_path / "out.toml")
    assert not (tmp_path / "out.toml").exists()


@pytest.mark.slow
def test_unsynchronised_cameras_are_calibrated(runs, tmp_path):
    """Cameras that began at different times are calibrated, with a time offset found within half a frame."""
    table = (runs / "run_cam2.csv").read_text().splitlines()
    late = [line.split(",", 1) for line in table[3:]]
    rows = [f"{int(frame) - 4},{rest}" for frame, rest in late]
    (tmp_path / "run_cam2.csv").write_text("\n".join([*table[:3], *rows]) + "\n")
    given = replace(
        settings(runs, 1, 2, find_offsets=True, frames="8:36"),
        keypoints=(runs / "run_cam1.csv", tmp_path / "run_cam2.csv"),
    )
    cameras, report = run_extrinsics([given], tmp_path / "out.toml")
    assert report["clips"][0]["offset_s"] == pytest.approx([0.0, 4 / FPS], abs=0.5 / FPS)
    assert [line for line in lines_of(cameras, report) if "run_cam2.csv +0.0" in line]
    alone = replace(given, keypoints=(runs / "run_cam1.csv", tmp_path / "blind_cam2.csv"))
    (tmp_path / "blind_cam2.csv").write_text("\n".join([*table[:3], *rows[:3]]) + "\n")
    with refusal(("--set find-offsets", "camera cam2", ["no time offset", "cam1"], "--set offset-s")):
        run_extrinsics([alone], tmp_path / "other.toml")


def test_refined_extrinsics_need_poses(runs, tmp_path):
    lenses = [replace(camera, rotation=None, translation_m=None) for camera in read_cameras(runs / "scene.json")]
    write_cameras(lenses, tmp_path / "lenses.toml")
    with refusal(("--set refine-cameras", "poses", "no poses of cam1, cam2", "camera file")):
        run_extrinsics(
            [settings(runs, 1, 2, camera=tmp_path / "lenses.toml", refine_cameras=True)], tmp_path / "out.toml"
        )


def test_up_in_option_and_file_is_refused(runs, tmp_path):
    """The up direction cannot be stated twice, in the option and in a file whose poses are read."""
    clip, out = settings(runs, 1, 2, tilt_deg=3.0), tmp_path / "out.toml"
    beside = ("up", "--set refine-cameras=true", "only one of the two")
    with refusal(("--tilt-deg", *beside), ("--level-deg", *beside)):
        run_extrinsics([replace(clip, refine_cameras=True)], out, level_rad=np.radians(1.0))


@pytest.mark.slow
def test_a_tilt_is_used_if_poses_are_not_read(runs, tmp_path):
    cameras, _ = run_extrinsics(
        [settings(runs, 1, 2, frames="10:36", tilt_deg=10.0)], tmp_path / "out.toml", level_rad=np.radians(0.5)
    )
    for camera in cameras:
        ahead = camera.camera_to_world(np.array([0.0, 0.0, 1.0])) - camera.centre_world
        assert np.degrees(np.arcsin(-ahead[2])) == pytest.approx(10, abs=3)


def test_a_camera_has_one_lens(runs, tmp_path):
    scene = json.loads((runs / "scene.json").read_text())
    scene["cameras"][1]["k"][0][0] *= 1.1
    (tmp_path / "other.json").write_text(json.dumps(scene))
    with refusal(("KEYPOINTS", "camera cam2", "different lenses or poses")):
        run_extrinsics(
            [settings(runs, 1, 2), settings(runs, 1, 2, camera=tmp_path / "other.json")], tmp_path / "out.toml"
        )


def test_poses_of_a_single_camera_cannot_be_estimated(runs, tmp_path):
    with refusal(
        ("run_cam1.csv", "cameras", "cam1", "two or more"),
        ("--out", "file", f"'{tmp_path / 'found.csv'}'", "ends in .toml"),
    ):
        run_extrinsics([settings(runs, 1)], tmp_path / "found.csv")


def test_a_standing_animal_does_not_determine_camera_poses(runs, tmp_path):
    for number in (1, 2):
        moving = read_keypoints(runs / f"run_cam{number}.csv")
        stays = moving.xy_px - np.nanmean(moving.xy_px, axis=1, keepdims=True) + (960.0, 540.0)
        write_csv(replace(moving, xy_px=stays), tmp_path / f"run_cam{number}.csv")
    clip = settings(tmp_path, 1, 2, camera=runs / "scene.json")
    with refusal(("KEYPOINTS", "motion", 0.2, "its own length")):
        run_extrinsics([clip], tmp_path / "found.toml")
    assert not (tmp_path / "found.toml").exists()
