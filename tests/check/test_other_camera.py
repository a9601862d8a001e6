"""Test that a clip from another camera of the camera file is recognised by gravity, the ground and the gait."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from recon import Camera, FitSettings, fit_clip, read_camera, samples_folder
from recon.api.clip_cameras import possible_cameras
from recon.check.likelihood import Baseline
from recon.check.other_camera import GAIN, gains_of, other_camera_finding
from recon.clip import camera_poses
from recon.io.camera_files import write_cameras


def rolled(camera: Camera, degrees: float, name: str) -> Camera:
    """Return the camera at the same point, turned about its optical axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert camera.rotation is not None
    assert camera.translation_m is not None
    return replace(camera, rotation=turn @ camera.rotation, translation_m=turn @ camera.translation_m, name=name)


def true_camera(baseline: Baseline) -> Camera:
    return replace(baseline.view.camera, name="west")


def seen_by(baseline: Baseline, camera: Camera) -> Baseline:
    """Return a view by another camera at the same point, with the animal moved in front of it: equal pictures."""
    pose, states = camera_poses([camera])[0], baseline.states.copy()
    states[:, :3] = states[:, :3] @ (pose[:3, :3].T @ baseline.view.rotation).T
    return Baseline(baseline.with_view(replace(baseline.view, camera=camera, T_camera_world=pose)), states)


def test_a_camera_that_is_turned_otherwise_explains_the_clip_less_well(sample_baseline):
    baseline, noise_px = sample_baseline
    others = [rolled(true_camera(baseline), degrees, f"rolled {degrees}") for degrees in (8, -8)]
    with threadpool_limits(1, user_api="blas"):
        gains = gains_of(baseline, noise_px, others)
        assert [*other_camera_finding(baseline, noise_px, others)] == []
    assert [*gains] == ["rolled 8", "rolled -8"]
    assert max(gains.values()) < 0


def test_a_clip_of_another_camera_is_recognised_and_that_camera_named(sample_baseline):
    baseline, noise_px = sample_baseline
    true = true_camera(baseline)
    given = seen_by(baseline, rolled(true, 8, "east"))
    with threadpool_limits(1, user_api="blas"):
        (item,) = other_camera_finding(given, noise_px, [rolled(true, -8, "north"), true])
    assert (item.code, item.severity) == ("another_camera_fits", "warning")
    assert (item.numbers["given"], item.numbers["others"]) == ("east", ("west",))
    assert item.numbers["log_likelihood_ratio"] > GAIN


def test_a_camera_in_another_direction_explains_the_same_pictures_equally_well(sample_baseline):
    """A camera in another direction explains the same pictures equally well.

    Its start is the solution moved in front of it, so that only gravity, the ground and the gait count.
    """
    baseline, noise_px = sample_baseline
    true = true_camera(baseline)
    assert true.rotation is not None
    around = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    south = replace(true, rotation=true.rotation @ around, name="south")
    with threadpool_limits(1, user_api="blas"):
        assert gains_of(baseline, noise_px, [south])["south"] == pytest.approx(0.0, abs=0.1)


def test_a_short_clip_and_one_without_a_pose_are_not_tested(sample_baseline):
    baseline, noise_px = sample_baseline
    unsolved = Baseline(baseline.clip, np.full_like(baseline.states, np.nan))
    assert gains_of(unsolved, noise_px, [true_camera(baseline)]) == {}
    short = Baseline(baseline.clip.part(slice(0, 2)), baseline.states[:2])
    assert gains_of(short, noise_px[:2], [true_camera(baseline)]) == {}


@pytest.fixture
def files(tmp_path) -> Callable[..., FitSettings]:
    """Return settings by keypoint file name and camera, `files(name, camera)`, for a file of two cameras."""
    true = replace(read_camera(samples_folder() / "camera.toml"), name="cam1")
    write_cameras([true, rolled(true, 8, "cam2")], tmp_path / "cameras.toml")

    def settings(name: str, camera: str, **more: Any) -> FitSettings:
        shutil.copy(samples_folder() / "whole.csv", tmp_path / name)
        file = tmp_path / "cameras.toml"
        return FitSettings(keypoints=(tmp_path / name,), camera=file, camera_name=(camera,), fps=60, **more)

    return settings


@pytest.mark.parametrize(
    ("name", "camera", "codes"),
    [("clip.csv", "cam2", ["another_camera_fits"]), ("clip.csv", "cam1", []), ("clip_cam2.csv", "cam2", [])],
)
def test_a_wrong_camera_name_is_noticed_unless_the_keypoint_files_name_confirms_it(files, name, camera, codes):
    motion = fit_clip(files(name, camera, frames="0:30", fast=True))
    assert [item.code for item in motion.findings if item.code == "another_camera_fits"] == codes


def test_only_cameras_with_a_like_picture_and_a_pose_in_the_same_world_are_possible(files, tmp_path):
    settings = files("clip.csv", "cam1", camera_unit="mm")
    true, other = (read_camera(tmp_path / "cameras.toml", name) for name in ("cam1", "cam2"))
    (possible,) = possible_cameras(true, settings)
    assert possible.name == "cam2"
    assert np.asarray(possible.translation_m) * 1000 == pytest.approx(np.asarray(other.translation_m))
    assert possible_cameras(true, replace(settings, up="-z")) == ()
    assert possible_cameras(replace(true, image_size_px=(1280, 720)), settings) == ()
    assert possible_cameras(replace(true, rotation=None, translation_m=None), settings) == ()
