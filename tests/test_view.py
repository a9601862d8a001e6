"""The recording of a motion, read back with rerun's own reader."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from recon.errors import InputError
from recon.motion import Motion
from recon.view import open_viewer, write

# World axes x, y (ahead), z (up) seen from 2 m above the origin, looking along y.
LOOKING_ALONG_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

PER_FRAME = {
    "/world/skeleton": "LineStrips3D:strips",
    "/world/skeleton/joints": "Points3D:positions",
    "/world/followed": "Points3D:positions",
    "/world/trail": "LineStrips3D:strips",
    **{
        f"/{root}/{entity}": component
        for root in ("picture", "closeup")
        for entity, component in {
            "detections": "LineStrips2D:strips",
            "outliers": "LineStrips2D:strips",
            "reprojections": "LineStrips2D:strips",
            "reprojections/joints": "Points2D:positions",
            "links": "LineStrips2D:strips",
        }.items()
    },
    "/angles/theta": "Scalars:scalars",
    "/angles/phi": "Scalars:scalars",
    "/speed": "Scalars:scalars",
    "/residuals": "Scalars:scalars",
}


class Recording:
    """Rows of every entity: `static` by entity and component, `frames` by entity, frame number and component."""

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
                    self.frames.setdefault(chunk.entity_path, {})[row["frame"]] = row
                    self.time_s[row["frame"]] = row["time"].total_seconds()

    def values(self, entity: str, frame: int) -> list[Any]:
        return self.frames[entity][frame][PER_FRAME[entity]] or []


@pytest.fixture(scope="module")
def world_motion(small_motion: Motion) -> Motion:
    """The small motion seen by a camera 2 m above the ground."""
    height = np.array([0.0, 0.0, 2.0])
    camera = replace(small_motion.camera, rotation=LOOKING_ALONG_Y, translation_m=-LOOKING_ALONG_Y @ height)
    return replace(small_motion, camera=camera)


@pytest.fixture(scope="module")
def recording(world_motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("view") / "motion.rrd"
    write(world_motion, path)
    return Recording(path)


def test_holds_every_entity_at_every_frame(recording: Recording, world_motion: Motion) -> None:
    assert set(recording.frames) == set(PER_FRAME)
    for rows in recording.frames.values():
        assert sorted(rows) == list(world_motion.frames)
    assert {"/", "/world/path", "/world/ground", "/world/camera", "/picture/frame"} <= set(recording.static)
    assert recording.blueprints == 1


def test_times_are_seconds_since_frame_zero(recording: Recording) -> None:
    assert recording.time_s == pytest.approx({frame: frame / 30.0 for frame in range(10, 16)}, abs=1e-8)


def test_joints_are_those_of_the_motion(recording: Recording, world_motion: Motion) -> None:
    for frame, joints in zip(world_motion.frames, world_motion.joints_m, strict=True):
        if frame != 13:
            np.testing.assert_allclose(recording.values("/world/skeleton/joints", frame), joints, atol=1e-5)
    assert recording.static["/world/skeleton/joints"]["Points3D:labels"] == list(world_motion.names)


def test_limbs_join_their_joints(recording: Recording, world_motion: Motion) -> None:
    limbs = world_motion.skeleton.limbs
    for strip, joints in zip(recording.values("/world/skeleton", 12), limbs.values(), strict=True):
        rows = [world_motion.skeleton.joints.index(joint) for joint in joints]
        np.testing.assert_allclose(strip, world_motion.joints_m[2, rows], atol=1e-5)
    assert recording.static["/world/skeleton"]["LineStrips3D:class_ids"] == list(range(len(limbs)))


def test_a_frame_without_data_shows_nothing(recording: Recording, world_motion: Motion) -> None:
    assert not world_motion.solved[3]
    for entity in PER_FRAME:
        assert recording.values(entity, 13) == [], entity


def test_trail_follows_the_root_and_does_not_bridge_the_gap(recording: Recording, world_motion: Motion) -> None:
    (step,) = recording.values("/world/trail", 12)
    np.testing.assert_allclose(step, world_motion.root_m[1:3], atol=1e-5)
    assert [frame for frame in range(10, 16) if recording.values("/world/trail", frame)] == [11, 12, 15]


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


def test_camera_stands_where_its_extrinsics_say(recording: Recording, world_motion: Motion) -> None:
    camera = recording.static["/world/camera"]
    np.testing.assert_allclose(camera["Transform3D:translation"], [[0.0, 0.0, 2.0]], atol=1e-6)
    (columns,) = camera["Transform3D:mat3x3"]
    np.testing.assert_allclose(np.reshape(columns, (3, 3)).T, LOOKING_ALONG_Y.T, atol=1e-6)
    (columns,) = camera["Pinhole:image_from_camera"]
    np.testing.assert_allclose(np.reshape(columns, (3, 3)).T, world_motion.camera.matrix, rtol=1e-6)


def test_picture_has_the_pixels_of_the_motion(recording: Recording, world_motion: Motion) -> None:
    for row, frame in enumerate(world_motion.frames):
        seen = np.isfinite(world_motion.detected_px[row, :, 0])
        outlier = world_motion.outliers[row]
        for entity, chosen in (("detections", seen & ~outlier), ("outliers", seen & outlier)):
            strokes = np.reshape(recording.values(f"/picture/{entity}", frame), (-1, 2, 2, 2))
            np.testing.assert_allclose(strokes.mean(axis=(1, 2)), world_motion.detected_px[row, chosen], atol=1e-3)
        if world_motion.solved[row]:
            pixels = recording.values("/picture/reprojections/joints", frame)
            np.testing.assert_allclose(pixels, world_motion.reprojected_px[row], atol=1e-3)
            ends = np.stack((world_motion.detected_px[row, seen], world_motion.reprojected_px[row, seen]), axis=1)
            np.testing.assert_allclose(recording.values("/picture/links", frame), ends, atol=1e-3)


def test_the_outlier_is_shown_as_one(recording: Recording) -> None:
    assert [frame for frame in range(10, 16) if recording.values("/picture/outliers", frame)] == [14]


def test_the_close_up_is_the_picture_around_the_skeletons_middle(recording: Recording, world_motion: Motion) -> None:
    pixels = world_motion.reprojected_px[2]
    shown = np.array(recording.values("/closeup/reprojections/joints", 12))
    np.testing.assert_allclose(shown, pixels - pixels.mean(axis=0), atol=1e-3)


def test_series_have_the_units_of_plots(recording: Recording, world_motion: Motion) -> None:
    degrees = np.rad2deg(world_motion.angles_rad[2])
    np.testing.assert_allclose(recording.values("/angles/theta", 12), degrees[:7])
    np.testing.assert_allclose(recording.values("/angles/phi", 12), degrees[7:], atol=1e-12)
    assert recording.static["/angles/theta"]["SeriesLines:names"][:2] == ["θ6 hind leg", "θ7 hind leg"]
    distance = world_motion.distance_px[4]
    np.testing.assert_allclose(recording.values("/residuals", 14), [np.nanmean(distance), np.nanmax(distance)])
    exact, smooth, straight = recording.values("/speed", 12)
    assert exact == pytest.approx(9.0, abs=2.0)
    assert straight == pytest.approx(world_motion.solution.travel.speed_m_s[2])
    assert smooth == pytest.approx(9.0, abs=2.0)


def test_without_extrinsics_the_camera_is_the_origin(small_motion: Motion, tmp_path: Path) -> None:
    write(small_motion, tmp_path / "motion.rrd", start_frame=12)
    recording = Recording(tmp_path / "motion.rrd")
    assert "Transform3D:translation" not in recording.static["/world/camera"]
    np.testing.assert_allclose(
        recording.values("/world/skeleton/joints", 12), small_motion.joints_camera_m[2], atol=1e-5
    )
    # The ground is level under a level camera: one height, y down.
    assert np.ptp(np.array(recording.static["/world/ground"]["LineStrips3D:strips"])[..., 1]) == 0


def test_a_motion_without_any_pose_can_be_written(small_motion: Motion, tmp_path: Path) -> None:
    nothing = replace(
        small_motion,
        solution=replace(small_motion.solution, states=np.full_like(small_motion.states, np.nan), reports=(None,) * 6),
        keypoints=replace(small_motion.keypoints, xy_px=np.full_like(small_motion.detected_px, np.nan)),
    )
    write(nothing, tmp_path / "motion.rrd")
    recording = Recording(tmp_path / "motion.rrd")
    assert all(not recording.values(entity, 12) for entity in recording.frames)


def test_viewer_needs_a_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file") as caught:
        open_viewer(tmp_path / "motion.rrd")
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize("code", [0, 1])
def test_viewer_is_rerun_of_this_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    path = tmp_path / "motion.rrd"
    path.touch()
    commands = []

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        commands.append(command)
        return subprocess.CompletedProcess(command, code)

    monkeypatch.setattr(subprocess, "run", run)
    if code:
        with pytest.raises(InputError, match="exit code 1"):
            open_viewer(path)
    else:
        open_viewer(path)
    ((python, *rest),) = commands
    assert python == sys.executable
    assert rest[:2] == ["-m", "rerun"]
    assert rest[-1] == str(path)
