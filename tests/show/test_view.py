"""Test the recording of a motion with rerun's own reader."""

from __future__ import annotations

import http.client
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from command_line import refusal
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from recon import ClipAnalysis
from recon.clip import Source, views_of
from recon.fit.motion import Motion
from recon.fit.result import MotionSegment, Solution
from recon.show.view import DISPLAYS, OVERVIEW_ASPECT, VIEW_RAD, fitting_eye, open_viewer, time_view, write
from recon.show.view.scene import CLOSE_VIEW_SIZE, HIDDEN_LINK, TimePlot, limb_strips, middle_and_reach_px
from recon.show.view.web import served
from recon.thesis.objectives import FrameOptions
from recon.thesis.solution import FrameSolution
from recon.thesis.solver import solve_frames

# World axes x, y (ahead), z (up) seen from 2 m above the origin, looking along y.
LOOKING_ALONG_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

FEET = ("l_front_paw", "r_front_paw", "l_back_paw", "r_back_paw")
PER_FRAME = {
    "/world/skeleton": "LineStrips3D:strips",
    "/world/skeleton/joints": "Points3D:positions",
    "/world/followed": "Points3D:positions",
    "/world/trail": "LineStrips3D:strips",
    "/picture/detections": "Points2D:positions",
    "/picture/outliers": "Points2D:positions",
    "/picture/reprojections": "LineStrips2D:strips",
    "/picture/reprojections/joints": "Points2D:positions",
    "/picture/links": "LineStrips2D:strips",
    "/speed": "Scalars:scalars",
    "/residuals": "Scalars:scalars",
    "/uncertainty": "Scalars:scalars",
    "/world/uncertainty": "Ellipsoids3D:centers",
    "/world/stance": "Points3D:positions",
}
FLAGS = {
    f"/{flag}": "StateChange:state" for flag in ("no_data", "data_poor", "ambiguous_depth", "outliers", "few_points")
}
ANIMAL = "/picture/animal"
CHAIN = {
    **PER_FRAME,
    **{f"/angles/middle/{kind}": "Scalars:scalars" for kind in ("theta", "phi", "yaw_pitch_roll")},
    **{f"/{foot}": "StateChange:state" for foot in ("r_front_paw", "r_back_paw")},
}
WHOLE = {
    **PER_FRAME,
    **{f"/angles/{side}/{part}": "Scalars:scalars" for side in ("left", "right") for part in ("fore", "hind")},
    **{f"/angles/middle/{kind}": "Scalars:scalars" for kind in ("yaw", "pitch", "roll")},
    **{f"/{foot}": "StateChange:state" for foot in FEET},
}


CHANGES = {"/picture/outliers", "/world/stance", *(f"/{foot}" for foot in FEET)}
"""Entities that have rows only in frames in which they change."""


class Recording:
    """Rows of a recording: `static` by entity and component, `frames` by entity, frame number and component."""

    def __init__(self, path: Path) -> None:
        reader = RrdReader(path)
        self.blueprints = len(reader.blueprints())
        (store,) = reader.recordings()
        self.name = store.application_id
        self.static: dict[str, dict[str, Any]] = {}
        self.frames: dict[str, dict[int, dict[str, Any]]] = {}
        self.time_s: dict[int, float] = {}
        for chunk in reader.stream(store=store):
            if not chunk.is_static:
                assert set(chunk.timeline_names) == {"frame", "time"}
            for row in chunk.to_record_batch().to_pylist():
                if chunk.is_static:
                    self.static.setdefault(chunk.entity_path, {}).update(row)
                else:
                    self.frames.setdefault(chunk.entity_path, {}).setdefault(row["frame"], {}).update(row)
                    self.time_s[row["frame"]] = row["time"].total_seconds()

    def values(self, entity: str, frame: int, component: str = "") -> list[Any]:
        """Return the newest value of a component up to a frame, which the viewer shows."""
        component = component or {**CHAIN, **WHOLE, **FLAGS}[entity]
        rows = self.frames[entity]
        newest = max((n for n, row in rows.items() if n <= frame and component in row), default=None)
        return [] if newest is None else rows[newest][component] or []


@pytest.fixture(scope="module")
def world_motion(small_motion: Motion) -> Motion:
    """Return the small motion seen by a camera 2 m above the ground."""
    height = np.array([0.0, 0.0, 2.0])
    camera = replace(small_motion.camera, rotation=LOOKING_ALONG_Y, translation_m=-LOOKING_ALONG_Y @ height)
    source, solution = replace(small_motion.sources[0], camera=camera), small_motion.solution
    assert isinstance(solution, FrameSolution)
    return replace(
        small_motion,
        sources=(source,),
        solution=solve_frames(*views_of([source]), solution.chain, small_motion.fps, FrameOptions()),
    )


@pytest.fixture(scope="module")
def recording(world_motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("view") / "motion.rrd"
    write(world_motion, path)
    return Recording(path)


def test_a_recording_has_every_entity_at_every_frame(recording: Recording, world_motion: Motion) -> None:
    assert set(recording.frames) - set(FLAGS) == {*CHAIN, ANIMAL}
    for entity in {*CHAIN, ANIMAL} - CHANGES:
        assert sorted(recording.frames[entity]) == list(world_motion.frames), entity
    assert {"/", "/world/path", "/world/ground", "/world/camera", "/picture/frame"} <= set(recording.static)
    assert recording.blueprints == 1


def test_times_are_seconds_since_frame_zero(recording: Recording) -> None:
    assert recording.time_s == pytest.approx({frame: frame / 30.0 for frame in range(10, 16)}, abs=1e-6)


def test_joints_agree_with_the_motion(recording: Recording, world_motion: Motion) -> None:
    for frame, joints in zip(world_motion.frames, world_motion.joints_m, strict=True):
        if frame != 13:
            np.testing.assert_allclose(recording.values("/world/skeleton/joints", frame), joints, atol=1e-5)
    assert recording.static["/world/skeleton/joints"]["Points3D:labels"] == list(world_motion.names)


def test_limbs_join_their_joints(recording: Recording, world_motion: Motion) -> None:
    limbs = world_motion.body.limbs
    for strip, joints in zip(recording.values("/world/skeleton", 12), limbs.values(), strict=True):
        rows = [world_motion.joints.index(joint) for joint in joints]
        np.testing.assert_allclose(strip, world_motion.joints_m[2, rows], atol=1e-5)
    assert recording.static["/world/skeleton"]["LineStrips3D:class_ids"] == list(range(len(limbs)))


def test_a_frame_without_data_shows_nothing(recording: Recording, world_motion: Motion) -> None:
    assert not world_motion.solved[3]
    for entity in CHAIN:
        assert recording.values(entity, 13) == [], entity
    assert recording.values("/no_data", 13) == ["no data"]


def test_trail_follows_the_root_and_does_not_bridge_the_gap(recording: Recording, world_motion: Motion) -> None:
    (step,) = recording.values("/world/trail", 12)
    np.testing.assert_allclose(step, world_motion.root_m[1:3], atol=1e-5)
    assert [frame for frame in range(10, 16) if recording.values("/world/trail", frame)] == [11, 12, 15]


def test_the_overview_is_filled_by_all_points() -> None:
    """A path of 14 m and a camera 10 m to its side fill the overview to between three quarters and its edge."""
    points = np.array([[-7.0, 0, 0], [7, 0, 0], [-7, 0, 1], [7, 0, 1], [0, -10, 2]])
    eye, target = fitting_eye(points, np.eye(3))
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    seen = (points - eye) @ np.stack((right, np.cross(right, ahead), ahead), axis=1)
    fraction = np.abs(seen[:, :2] / seen[:, 2:]) / np.tan(VIEW_RAD / 2) / [OVERVIEW_ASPECT, 1.0]
    assert ahead[2] < -0.3
    assert 0.75 < fraction.max() < 1.0


def test_ground_lies_under_the_paws(recording: Recording, world_motion: Motion) -> None:
    lines = np.array(recording.static["/world/ground"]["LineStrips3D:strips"])
    paws = [world_motion.names.index(name) for name in ("r_front_paw", "r_back_paw")]
    heights = world_motion.joints_m[world_motion.solved][:, paws, 2]
    assert np.ptp(lines[..., 2]) == 0
    assert heights.min() - 1e-5 <= lines[0, 0, 2] <= np.median(heights)
    low, high = lines[..., :2].min(axis=(0, 1)), lines[..., :2].max(axis=(0, 1))
    path = world_motion.root_m[world_motion.solved][:, :2]
    assert (low < path).all()
    assert (path < high).all()
    np.testing.assert_allclose(np.diff(np.unique(lines[..., 0])), 1.0)


def test_the_camera_is_at_the_position_of_its_extrinsics(recording: Recording, world_motion: Motion) -> None:
    camera = recording.static["/world/camera"]
    np.testing.assert_allclose(camera["Transform3D:translation"], [[0.0, 0.0, 2.0]], atol=1e-6)
    (columns,) = camera["Transform3D:mat3x3"]
    np.testing.assert_allclose(np.reshape(columns, (3, 3)).T, LOOKING_ALONG_Y.T, atol=1e-6)
    (columns,) = camera["Pinhole:image_from_camera"]
    np.testing.assert_allclose(np.reshape(columns, (3, 3)).T, world_motion.camera.matrix, rtol=1e-6)


def test_picture_has_the_pixels_of_the_motion(recording: Recording, world_motion: Motion) -> None:
    (picture,) = world_motion.pictures
    reach_px = middle_and_reach_px(picture)[1].max()
    for row, frame in enumerate(world_motion.frames):
        seen = np.isfinite(picture.detected_px[row, :, 0])
        outlier = picture.outliers[row]
        for entity, chosen in (("detections", seen & ~outlier), ("outliers", seen & outlier)):
            points = np.reshape(recording.values(f"/picture/{entity}", frame), (-1, 2))
            np.testing.assert_allclose(points, picture.detected_px[row, chosen], atol=1e-3)
        if world_motion.solved[row]:
            pixels = recording.values("/picture/reprojections/joints", frame)
            np.testing.assert_allclose(pixels, picture.reprojected_px[row], atol=1e-3)
            ends = np.stack((picture.detected_px[row], picture.reprojected_px[row]), axis=1)
            linked = outlier | (picture.distance_px[row] >= HIDDEN_LINK * 2 * CLOSE_VIEW_SIZE * reach_px)
            links = np.reshape(recording.values("/picture/links", frame), (-1, 2, 2))
            np.testing.assert_allclose(links, ends[linked], atol=1e-3)


def test_the_outlier_is_shown_as_an_outlier(recording: Recording) -> None:
    assert [frame for frame in range(10, 16) if recording.values("/picture/outliers", frame)] == [14]


def test_the_close_up_is_the_picture_around_the_skeletons_middle(recording: Recording, world_motion: Motion) -> None:
    """The close-up is centred on the middle of the skeleton, and does not move in a frame without a pose."""
    rows = recording.frames[ANIMAL]
    middle = world_motion.pictures[0].reprojected_px[2].mean(axis=0)
    for frame in (12, 13):
        np.testing.assert_allclose(rows[frame]["Transform3D:translation"], [[*middle, 0.0]], atol=1e-3)


def test_series_have_the_units_of_plots(recording: Recording, world_motion: Motion) -> None:
    degrees = dict(zip(world_motion.angle_names, np.rad2deg(world_motion.angles_rad[2]), strict=True))
    for entity, names in (
        ("middle/theta", ["theta_6", "theta_7", "theta_8", "theta_1", "theta_2", "theta_3", "theta_4"]),
        ("middle/yaw_pitch_roll", ["J0_yaw", "J0_pitch", "J0_roll"]),
    ):
        expected = [degrees[name] for name in names]
        np.testing.assert_allclose(recording.values(f"/angles/{entity}", 12), expected, atol=1e-12)
    labels = recording.static["/angles/middle/yaw_pitch_roll"]["SeriesLines:names"]
    assert labels == ["J0 yaw", "J0 pitch", "J0 roll"]
    picture = world_motion.pictures[0]
    assert picture.outliers[4].any()
    shown = [np.nanmedian(picture.distance_px[4]), np.nanmax(picture.distance_px[4][~picture.outliers[4]])]
    np.testing.assert_allclose(recording.values("/residuals", 14), shown)
    smooth, straight, exact = recording.values("/speed", 12)
    assert exact == pytest.approx(9.0, abs=2.0)
    assert straight == pytest.approx(world_motion.solution.travel.speed_m_s[2])
    assert smooth == pytest.approx(9.0, abs=2.0)


def test_no_legend_covers_its_lines() -> None:
    """The axis leaves three tenths of its height above the lines for a legend with three names."""
    values = np.array([[0.0, 2.0, np.nan], [1.0, 7.0, 3.0]])
    axis: Any = time_view(TimePlot("a", "A", "bcd", [(0, 0, 0)] * 3, values)).properties["ScalarAxis"]
    low, high = axis.range.as_arrow_array().to_pylist()[0]
    assert (low, high) == (0.0, pytest.approx(10.0))


def test_without_extrinsics_the_camera_is_the_origin(small_motion: Motion, tmp_path: Path) -> None:
    write(small_motion, tmp_path / "motion.rrd")
    recording = Recording(tmp_path / "motion.rrd")
    np.testing.assert_array_equal(recording.static["/world/camera"]["Transform3D:translation"], np.zeros((1, 3)))
    np.testing.assert_allclose(
        recording.values("/world/skeleton/joints", 12), small_motion.joints_camera_m[2], atol=1e-5
    )
    # under a level camera, whose y points down, level ground has a single y
    assert np.ptp(np.array(recording.static["/world/ground"]["LineStrips3D:strips"])[..., 1]) == 0


def without_poses(solution: Solution, **changes: Any) -> Solution:
    fields = ("states", "joints_m", "covariance_m2", "relative_covariance_m2", "noise_px", "weight", "contact")
    nothing = {name: np.full_like(getattr(solution, name), np.nan) for name in fields}
    return replace(solution, **nothing, segments=(), **changes)


def without_points(source: Source) -> Source:
    keypoints = source.keypoints
    return replace(source, keypoints=replace(keypoints, xy_px=np.full_like(keypoints.xy_px, np.nan)))


def test_a_motion_without_any_pose_can_be_written(small_motion: Motion, tmp_path: Path) -> None:
    nothing = replace(
        small_motion,
        solution=without_poses(small_motion.solution, reports=(None,) * 6),
        sources=(without_points(small_motion.sources[0]),),
    )
    write(nothing, tmp_path / "motion.rrd")
    recording = Recording(tmp_path / "motion.rrd")
    assert all(not recording.values(entity, 12) for entity in recording.frames)


@pytest.fixture(scope="module")
def played(world_trajectory: Motion, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("view") / "motion.rrd"
    write(world_trajectory, path)
    return Recording(path)


def test_a_trajectory_has_every_entity_at_every_frame(played: Recording, world_trajectory: Motion) -> None:
    assert set(played.frames) - set(FLAGS) == {*WHOLE, ANIMAL}
    for entity in {*WHOLE, ANIMAL} - CHANGES:
        assert sorted(played.frames[entity]) == list(world_trajectory.frames), entity


def test_limbs_of_a_whole_animal_are_coloured_by_side(played: Recording, world_trajectory: Motion) -> None:
    context = played.static["/"]["AnnotationContext:context"][0]
    colours = {c["class_description"]["info"]["label"]: c["class_description"]["info"]["color"] for c in context}
    assert list(colours) == list(world_trajectory.limbs)
    left, right, middle = colours["left front leg"], colours["right front leg"], colours["trunk"]
    assert (left, right, middle) == (0x56B4E9FF, 0xE69F00FF, 0x009E73FF)
    assert colours["left hind leg"] == left
    assert colours["right hind leg"] == right
    assert colours["tail"] == colours["head"] == colours["eyes"] == middle
    limbs = list(colours)
    joints = played.static["/world/skeleton/joints"]["Points3D:class_ids"]
    at = dict(zip(world_trajectory.names, (limbs[i] for i in joints), strict=True))
    assert at["l_front_paw"] == at["l_shoulder"] == "left front leg"
    assert at["neck_base"] == at["tail_base"] == at["spine"] == "trunk"
    assert (at["nose"], at["tail2"]) == ("head", "tail")


def test_ellipsoids_are_one_sigma_of_the_pose(played: Recording, world_trajectory: Motion) -> None:
    row = played.frames["/world/uncertainty"][12]
    np.testing.assert_allclose(row["Ellipsoids3D:centers"], world_trajectory.joints_m[2], atol=1e-5)
    axes = Rotation.from_quat(row["Ellipsoids3D:quaternions"]).as_matrix()
    half = np.array(row["Ellipsoids3D:half_sizes"])
    covariance = np.einsum("jab,jb,jcb->jac", axes, half**2, axes)
    np.testing.assert_allclose(covariance, world_trajectory.relative_covariance_m2()[2], atol=1e-7)


def test_ellipsoids_of_a_fast_camera_change_25_times_a_second(world_trajectory: Motion, tmp_path: Path) -> None:
    """At 75 Hz, ellipsoids change in every third frame, and vanish if they are not known."""
    source = world_trajectory.sources[0]
    relative_m2 = world_trajectory.solution.relative_covariance_m2.copy()
    relative_m2[3] = np.nan
    fast = replace(
        world_trajectory,
        sources=(replace(source, keypoints=replace(source.keypoints, fps=75.0)),),
        solution=replace(world_trajectory.solution, relative_covariance_m2=relative_m2),
    )
    write(fast, tmp_path / "motion.rrd")
    recording = Recording(tmp_path / "motion.rrd")
    rows = recording.frames["/world/uncertainty"]
    assert [n for n, row in sorted(rows.items()) if "Ellipsoids3D:half_sizes" in row] == [10, 13, 14, 16]
    for component in ("centers", "half_sizes", "quaternions", "colors"):
        counts = [len(recording.values("/world/uncertainty", n, f"Ellipsoids3D:{component}")) for n in range(10, 18)]
        assert counts == [24, 24, 24, 0, 24, 24, 24, 24], component


def test_limbs_are_interrupted_by_joints_that_are_not_seen() -> None:
    """Limbs are interrupted by an unseen joint in a leg, and end before the unseen end of the tail."""
    points = np.arange(20.0).reshape(2, 5, 2)
    seen = np.array([[True] * 5, [True, False, True, True, False]])
    columns = limb_strips(points, {"leg": (0, 1, 2, 3), "tail": (0, 4)}, seen, with_classes=True)
    strips, classes = (column.as_arrow_array().to_pylist() for column in columns)
    frame = points.tolist()
    assert strips == [[frame[0][:4], [frame[0][0], frame[0][4]]], [frame[1][2:4]]]
    assert classes == [[0, 1], [0]]


def test_flagged_frames_are_marked(played: Recording, world_trajectory: Motion) -> None:
    shown = {flag: [f for f in range(10, 18) if played.values(flag, f)] for flag in FLAGS if flag in played.frames}
    assert shown == {"/no_data": [13], "/data_poor": [15], "/ambiguous_depth": [15]}
    red, plain = (played.frames["/world/uncertainty"][f]["Ellipsoids3D:colors"] for f in (15, 14))
    assert len(set(red)) == 1 < len(set(plain))


def test_standing_feet_are_marked(recording: Recording, world_motion: Motion, tmp_path: Path) -> None:
    """No feet are marked while all feet move with the body, and then the feet of given stances."""
    motion, analysis = world_motion, ClipAnalysis(world_motion)
    given = np.zeros_like(analysis.standing)
    given[1:3, 0] = given[[2, 4], 1] = True
    marked = ClipAnalysis(motion)
    vars(marked)["standing"] = given
    write(motion, tmp_path / "motion.rrd", marked)
    assert not analysis.standing.any()
    for shown, stands in ((recording, analysis.standing), (Recording(tmp_path / "motion.rrd"), given)):
        for row, frame in enumerate(motion.frames):
            for name, stood in zip((motion.names[foot] for foot in motion.feet), stands[row], strict=True):
                assert shown.values(f"/{name}", frame) == (["stance"] if stood else [])
            feet = motion.joints_m[row, motion.feet][stands[row]]
            np.testing.assert_allclose(np.reshape(shown.values("/world/stance", frame), (-1, 3)), feet, atol=1e-5)


def test_the_estimated_ground_is_drawn(played: Recording, world_trajectory: Motion) -> None:
    points = np.reshape(played.static["/world/ground"]["LineStrips3D:strips"], (-1, 3))
    ground = world_trajectory.solution.segments[0].ground
    assert ground is not None
    # the ground rises along x, the direction in which the camera at (1, 2, 3) looks
    np.testing.assert_allclose(points[:, 2], ground.height_m + 0.02 * points[:, 0], atol=1e-5)
    assert np.ptp(points[:, 2]) > 0.05


def test_the_ground_of_every_segment_is_drawn(world_trajectory: Motion, tmp_path: Path) -> None:
    """The ground of each segment is drawn from its first frame on, 0.4 m lower in the second segment."""
    solution = world_trajectory.solution
    ground = solution.segments[0].ground
    assert ground is not None
    lower = replace(ground, height_m=ground.height_m - 0.4)
    solution = replace(solution, segments=(MotionSegment(slice(0, 3), ground), MotionSegment(slice(5, 8), lower)))
    write(replace(world_trajectory, solution=solution), tmp_path / "motion.rrd")
    recording = Recording(tmp_path / "motion.rrd")
    assert "LineStrips3D:strips" not in recording.static["/world/ground"]
    rows = recording.frames["/world/ground"]
    assert list(rows) == [10, 15]
    for frame, height in ((10, ground.height_m), (15, lower.height_m)):
        points = np.reshape(rows[frame]["LineStrips3D:strips"], (-1, 3))
        np.testing.assert_allclose(points[:, 2], height + 0.02 * points[:, 0], atol=1e-5)


def test_series_of_a_whole_animal(played: Recording, world_trajectory: Motion) -> None:
    names = world_trajectory.angle_names
    degrees = dict(zip(names, np.rad2deg(world_trajectory.angles_rad[2]), strict=True))
    left = [value for name, value in degrees.items() if name.startswith("l_fore")]
    np.testing.assert_allclose(played.values("/angles/left/fore", 12), left)
    assert played.static["/angles/left/fore"]["SeriesLines:names"][0] == "fore upper pitch"
    rolls = [value for name, value in degrees.items() if name.endswith("_roll")]
    np.testing.assert_allclose(played.values("/angles/middle/roll", 12), rolls, atol=1e-12)
    shown = [len(played.values(entity, 12)) for entity in WHOLE if entity.startswith("/angles/")]
    assert sum(shown) == len(names)
    assert played.values("/speed", 12) == pytest.approx([9.0])
    expected = [world_trajectory.relative_rms_m[2], world_trajectory.place_sigma_m[2]]
    np.testing.assert_allclose(played.values("/uncertainty", 12), expected)


def test_a_trajectory_without_any_pose_can_be_written(small_trajectory: Motion, tmp_path: Path) -> None:
    solution = small_trajectory.solution
    flags = (("no data",),) * 8
    motion = replace(
        small_trajectory,
        solution=without_poses(solution, flags=flags),
        sources=(without_points(small_trajectory.sources[0]),),
    )
    write(motion, tmp_path / "motion.rrd")
    recording = Recording(tmp_path / "motion.rrd")
    assert recording.values("/no_data", 12) == ["no data"]
    assert all(not recording.values(entity, 12) for entity in WHOLE)


def moving(motion: Motion) -> Motion:
    """Return a motion whose second camera moves along x by one metre per frame."""
    first, second = motion.solution.views
    poses = np.tile(second.T_camera_world, (8, 1, 1))
    poses[:, :3, 3] -= np.arange(8)[:, None] * poses[:, :3, 0]
    return replace(motion, solution=replace(motion.solution, views=(first, replace(second, T_camera_world=poses))))


@pytest.fixture(scope="module")
def filmed_twice(two_cameras: Motion, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("several") / "motion.rrd"
    write(moving(two_cameras), path)
    return Recording(path)


def test_every_camera_has_its_pictures(filmed_twice: Recording, two_cameras: Motion) -> None:
    of_pictures = {entity for entity in filmed_twice.frames if entity.split("/")[1] == "picture"}
    assert of_pictures == {
        f"/picture/{camera}/{entity}"
        for camera in ("cam1", "cam2")
        for entity in ("animal", "detections", "outliers", "reprojections", "reprojections/joints", "links")
    }
    for number, camera in enumerate(("cam1", "cam2")):
        rows = filmed_twice.frames[f"/picture/{camera}/reprojections/joints"]
        found = np.array([rows[frame]["Points2D:positions"] for frame in two_cameras.frames])
        expected = moving(two_cameras).pictures[number].reprojected_px
        np.testing.assert_allclose(found, expected, rtol=1e-5)
    links = filmed_twice.frames["/picture/cam2/links"]
    assert [len(links[frame]["LineStrips2D:strips"] or []) for frame in (11, 12)] == [0, 24]


def test_cameras_are_drawn_at_their_positions_over_time(filmed_twice: Recording) -> None:
    (position,) = filmed_twice.static["/world/camera/cam1"]["Transform3D:translation"]
    np.testing.assert_allclose(position, [1, 2, 3], atol=1e-5)
    rows = filmed_twice.frames["/world/camera/cam2"]
    positions = [rows[frame]["Transform3D:translation"][0] for frame in range(10, 18)]
    np.testing.assert_allclose(positions, [[10 + t, -8, 2.5] for t in range(8)], atol=1e-5)
    names = filmed_twice.frames["/world/camera_names"]
    np.testing.assert_allclose(names[17]["Points3D:positions"], [[1, 2, 3], [17, -8, 2.5]], atol=1e-5)
    assert filmed_twice.static["/world/camera_names"]["Points3D:labels"] == ["cam1", "cam2"]
    for camera in ("cam1", "cam2"):
        assert filmed_twice.static[f"/world/camera/{camera}"]["Pinhole:resolution"] == [[1920, 1080]]


def test_errors_over_time_include_all_cameras(filmed_twice: Recording, two_cameras: Motion) -> None:
    found = [filmed_twice.frames["/residuals"][frame]["Scalars:scalars"] for frame in (10, 12, 15)]
    pictures = moving(two_cameras).pictures
    distance = np.concatenate([picture.distance_px for picture in pictures], axis=1)[[0, 2, 5]]
    outliers = np.concatenate([picture.outliers for picture in pictures], axis=1)[[0, 2, 5]]
    worst = np.nanmax(np.where(outliers, 0.0, distance), axis=1)
    np.testing.assert_allclose(found, np.stack((np.nanmedian(distance, axis=1), worst), axis=1), atol=1e-9)
    assert (outliers.sum(axis=1) == [0, 24, 24]).all()  # the second camera's pose in the file is wrong


@pytest.mark.skipif(sys.platform != "linux", reason="others always have a screen, or say it otherwise")
def test_viewer_needs_a_display(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "motion.rrd").touch()
    for name in DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    with refusal(("recon view", "viewer", "no display", "--web", "recon report DIR")):
        open_viewer(tmp_path / "motion.rrd")


@pytest.mark.parametrize("code", [0, 1])
def test_viewer_is_rerun_of_this_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    path = tmp_path / "motion.rrd"
    path.touch()
    commands = []

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        commands.append(command)
        return subprocess.CompletedProcess(command, code)

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setenv("DISPLAY", ":0")
    if code:
        with refusal(("recon view", "viewer", "exit code 1", "--out FILE.rrd")):
            open_viewer(path)
    else:
        open_viewer(path)
    ((python, *rest),) = commands
    assert python == sys.executable
    assert rest[:2] == ["-m", "rerun"]
    assert rest[-1] == str(path)


def test_the_web_viewer_is_served_on_this_machine_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started, ended = [], []

    class Rerun:
        def __init__(self, command: list[str], **_: Any) -> None:
            started.append(command)

        poll = wait = lambda self: None

        def terminate(self) -> None:
            ended.append(True)

    html = b'<link rel="preconnect" href="https://fonts.example" crossorigin /><script src="re_viewer.js"></script>'
    monkeypatch.setattr(subprocess, "Popen", Rerun)
    monkeypatch.setattr("recon.show.view.web._listens", lambda port: True)
    monkeypatch.setattr("recon.show.view.web._content", lambda address: html)
    (tmp_path / "motion.rrd").write_bytes(b"recording")
    with served(tmp_path / "motion.rrd") as address:
        assert ended == [True]  # ends rerun's own server before its address is published
        parts = urlsplit(address)
        recording = urlsplit(parse_qs(parts.query)["url"][0])
        assert (recording.netloc, recording.path) == (parts.netloc, f"{parts.path}recording.rrd")
        connection = http.client.HTTPConnection(parts.netloc, timeout=10)

        def got(path: str) -> tuple[int, bytes, str | None]:
            connection.request("GET", path)
            response = connection.getresponse()
            return response.status, response.read(), response.headers["Content-Type"]

        assert got(f"{parts.path}?{parts.query}")[1] == b'<script src="re_viewer.js"></script>'
        assert got(f"{parts.path}re_viewer_bg.wasm")[2] == "application/wasm"
        assert got(recording.path)[:2] == (200, b"recording")
        for path in ("/recording.rrd", f"/{'x' * 32}/recording.rrd"):
            status, content, _ = got(path)
            assert (status, b"recording" in content) == (404, False)
            connection.close()
        connection.request("GET", parts.path)
        policy = connection.getresponse().headers["Content-Security-Policy"] or ""
        connection.close()
    ((program, *rest),) = started
    assert Path(program).is_file()
    assert rest[:3] == ["--serve-web", "--bind", "127.0.0.1"]
    assert str(tmp_path / "motion.rrd") not in rest  # rerun's server would let every user of this machine read it
    assert "http" not in policy


def test_a_playback_without_enough_memory_is_an_error(small_motion, tmp_path, monkeypatch):
    """Rerun itself only warns and leaves parts out if there is not enough memory."""
    from rerun.encodings import Utf8Batch

    def short(*_: Any) -> None:
        raise MemoryError

    monkeypatch.setattr(Utf8Batch, "_native_to_pa_array", staticmethod(short))
    with pytest.raises(MemoryError):
        write(small_motion, tmp_path / "motion.rrd")
    assert list(tmp_path.iterdir()) == []
