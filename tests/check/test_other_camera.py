"""Test that gravity, the ground and the gait show which camera in the camera file filmed a clip."""

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
from recon.check.other_camera import MIN_GAIN, gains_of, other_camera_finding
from recon.clip import camera_poses
from recon.io.camera_files import write_cameras


def rolled(camera: Camera, degrees: float, name: str) -> Camera:
    """Return the camera after a rotation about its optical axis, in degrees, with another name."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert camera.rotation is not None
    assert camera.translation_m is not None
    return replace(camera, rotation=turn @ camera.rotation, translation_m=turn @ camera.translation_m, name=name)


def true_camera(baseline: Baseline) -> Camera:
    return replace(baseline.view.camera, name="west")


def seen_by(baseline: Baseline, camera: Camera) -> Baseline:
    """Return a baseline with another camera at the same position, and the animal moved so that pictures are equal."""
    pose, states = camera_poses([camera])[0], baseline.states.copy()
    states[:, :3] = states[:, :3] @ (pose[:3, :3].T @ baseline.view.rotation).T
    return Baseline(baseline.with_view(replace(baseline.view, camera=camera, T_camera_world=pose)), states)


def test_a_camera_with_another_roll_explains_the_clip_less_well(sample_baseline):
    baseline, noise_px = sample_baseline
    others = [rolled(true_camera(baseline), degrees, f"rolled {degrees}") for degrees in (8, -8)]
    with threadpool_limits(1, user_api="blas"):
        gains = gains_of(baseline, noise_px, others)
        assert [*other_camera_finding(baseline, noise_px, others)] == []
    assert [*gains] == ["rolled 8", "rolled -8"]
    assert max(gains.values()) < 0


def test_the_camera_that_filmed_a_clip_is_recognised(sample_baseline):
    baseline, noise_px = sample_baseline
    true = true_camera(baseline)
    given = seen_by(baseline, rolled(true, 8, "east"))
    with threadpool_limits(1, user_api="blas"):
        (item,) = other_camera_finding(given, noise_px, [rolled(true, -8, "north"), true])
    assert (item.code, item.severity) == ("another_camera_fits", "warning")
    assert (item.numbers["given"], item.numbers["others"]) == ("east", ("west",))
    assert item.numbers["log_likelihood_ratio"] > MIN_GAIN


def test_a_camera_with_another_heading_explains_the_clip_equally_well(sample_baseline):
    """A camera with another heading explains the same pictures equally well.

    The fit starts from the solution, moved in front of the camera, and gravity, the ground and the gait agree.
    """
    baseline, noise_px = sample_baseline
    true = true_camera(baseline)
    assert true.rotation is not None
    around = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    south = replace(true, rotation=true.rotation @ around, name="south")
    with threadpool_limits(1, user_api="blas"):
        assert gains_of(baseline, noise_px, [south])["south"] == pytest.approx(0.0, abs=0.1)


def test_clips_that_are_short_or_without_a_pose_are_not_tested(sample_baseline):
    baseline, noise_px = sample_baseline
    unsolved = Baseline(baseline.clip, np.full_like(baseline.states, np.nan))
    assert gains_of(unsolved, noise_px, [true_camera(baseline)]) == {}
    short = Baseline(baseline.clip.part(slice(0, 2)), baseline.states[:2])
    assert gains_of(short, noise_px[:2], [true_camera(baseline)]) == {}


@pytest.fixture
def files(tmp_path) -> Callable[..., FitSettings]:
    """Return a function that returns the settings for the name of a keypoint file and one of two cameras in a file."""
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
def test_a_wrong_camera_is_reported_unless_the_file_name_confirms_it(files, name, camera, codes):
    motion = fit_clip(files(name, camera, frames="0:30", fast=True))
    assert [item.code for item in motion.findings if item.code == "another_camera_fits"] == codes


def test_possible_cameras_have_a_similar_picture_and_the_same_world(files, tmp_path):
    settings = files("clip.csv", "cam1", camera_unit="mm")
    true, other = (read_camera(tmp_path / "cameras.toml", name) for name in ("cam1", "cam2"))
    (possible,) = possible_cameras(true, settings)
    assert possible.name == "cam2"
    assert np.asarray(possible.translation_m) * 1000 == pytest.approx(np.asarray(other.translation_m))
    assert possible_cameras(true, replace(settings, up="-z")) == ()
    assert possible_cameras(replace(true, image_size_px=(1280, 720)), settings) == ()
    assert possible_cameras(replace(true, rotation=None, translation_m=None), settings) == ()
