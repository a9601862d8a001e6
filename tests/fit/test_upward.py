"""Test the upward direction that a walking animal gives to cameras whose file does not state it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recon import FitSettings, load_skeleton, write_cameras
from recon.api.clip_inputs import prepare
from recon.clip import Keypoints
from recon.geometry.camera import Camera
from recon.io.deeplabcut import write_csv

BODY, FPS, T = load_skeleton("quadruped"), 60.0, 180
WORLD = Rotation.from_rotvec([1.3, -0.7, 0.4]).as_matrix()
"""Rotation matrix from z up to the world of the calibration, which turns by 88 degrees."""


def walking(scale: float) -> np.ndarray:
    """Return joints (T, J, 3), m, of a walk in a circle; each foot stands on z = 0 for two thirds of the time."""
    still = BODY.tree.pose(np.concatenate([np.zeros(4), BODY.mean_rad])[None]).points_m[0]
    still -= [0.0, 0.0, np.mean([still[BODY.markers.index(foot), 2] for foot in BODY.feet])]
    gone_m = 0.8 * np.arange(T) / FPS
    points = np.empty((T, len(still), 3))
    for j, marker in enumerate(BODY.markers):
        at, lift = gone_m, np.zeros(T)
        if marker in BODY.feet:
            phase = gone_m / 0.5 + 0.25 * BODY.feet.index(marker)
            swing = np.clip(phase % 1.0 - 2 / 3, 0.0, None) * 3
            at, lift = 0.5 * (np.floor(phase) + swing - 0.25 * BODY.feet.index(marker)), 0.08 * np.sin(np.pi * swing)
        turn = Rotation.from_euler("z", at[:, None] / 1.5).as_matrix()
        height = max(still[j, 2], 0.02) if marker not in BODY.feet else 0.0
        points[:, j] = turn @ [still[j, 0], still[j, 1] - 1.5, height] + lift[:, None] * [0.0, 0.0, 1.0]
    return scale * points


def looking(centre_m: np.ndarray, name: str, rolled_deg: float) -> Camera:
    """Return a camera that looks at the middle of the floor, in a world with z up."""
    ahead = -centre_m / np.linalg.norm(centre_m)
    right = np.cross(ahead, [0.0, 1.0, 0.0] if abs(ahead[2]) > 0.99 else [0.0, 0.0, 1.0])
    level = np.stack([right, np.cross(ahead, right), ahead]) / np.array([[np.linalg.norm(right)] * 2 + [1.0]]).T
    rotation = Rotation.from_euler("z", rolled_deg, degrees=True).as_matrix() @ level
    lens = Camera.from_hfov(60.0, (1280, 1024))
    return replace(lens, name=name, rotation=rotation, translation_m=-rotation @ centre_m, world_z_up=False)


@pytest.mark.parametrize(
    ("scale", "first"),
    [(1.0, [4.0, 0, 1.9]), pytest.param(0.1, [4.0, 0, 1.9], marks=pytest.mark.slow), (0.1, [0.0, 0.0, 5.0])],
)
def test_up_is_found_from_the_ground_that_feet_stand_on(tmp_path, scale, first):
    """The upward direction is found although keypoints are off by 2 % of the animal's length.

    The first camera may look straight down, and the animal may be as small as a mouse.
    """
    true, rng = walking(scale), np.random.default_rng(0)
    centres = scale * np.array([first, [0.0, 4.5, 1.5], [-4.0, -1.0, 2.5], [1.0, -4.5, 1.0]])
    cameras, points = [], true @ WORLD.T  # in the axes of the calibration
    for number, centre in enumerate(centres, start=1):
        level = looking(centre, f"cam{number}", 13.0)
        camera = replace(level, rotation=np.asarray(level.rotation) @ WORLD.T)
        beside = points + 0.02 * scale * rng.normal(size=points.shape[1:])
        xy_px = camera.project(camera.world_to_camera(beside))[0] + rng.normal(size=(*points.shape[:2], 2))
        seen = Keypoints(BODY.markers, xy_px, np.full(xy_px.shape[:2], 0.9), np.arange(T), fps=FPS)
        write_csv(seen, tmp_path / f"cam{number}.csv")
        cameras.append(camera)
    write_cameras(cameras, tmp_path / "rig.toml")
    files = tuple(tmp_path / f"cam{number}.csv" for number in range(1, 5))
    given = prepare(FitSettings(keypoints=files, camera=(tmp_path / "rig.toml",), skeleton="quadruped", size=scale))
    (said,) = given.findings
    assert said.code == "up_from_feet"
    sigma_rad, up = (
        float(said.numbers["sigma_rad"]),
        WORLD.T @ np.array(str(said.numbers["up"]).split(","), dtype=float),
    )
    assert sigma_rad < np.radians(3)
    assert np.arccos(min(up[2], 1.0)) < max(3 * sigma_rad, np.radians(1))
    for source, centre in zip(given.sources, centres, strict=True):
        assert source.camera.knows_up
        height_m = source.camera.camera_to_world(np.zeros(3))[2]
        assert height_m == pytest.approx(centre[2], abs=0.15 * scale)
    assert not prepare(
        FitSettings(keypoints=files, camera=(tmp_path / "rig.toml",), skeleton="quadruped", up="first-camera")
    ).findings
