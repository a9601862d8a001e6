"""Set up simulated cameras that look at a point, surround an animal, or follow it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.clip import View
from recon.geometry.camera import Camera
from recon.geometry.frames import rigid

if TYPE_CHECKING:
    from recon.testing.gallop import SyntheticClip

SHAKE_DEG = 0.3
"""Standard deviation of a handheld camera's shake about each axis, in degrees."""
SHAKE_S = 0.033
"""Correlation time of a handheld camera's shake, in seconds."""
FOLLOW_S = 0.05
"""Time in seconds over which a camera that follows an animal smooths its rotation."""


def level_rotation(centre_m: Array, target_m: Array) -> Array:
    """Return R_camera_world (3, 3) of a camera at a point (3,) that looks at a target (3,) without roll, z up."""
    ahead = (target_m - centre_m) / np.linalg.norm(target_m - centre_m)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])


def aim_camera(lens: Camera, centre_m: Array, target_m: Array) -> Camera:
    """Return a camera at a point that looks at another point.

    Parameters
    ----------
    lens
        Camera whose pose, if any, is replaced.
    centre_m
        Centre (3,) of the camera in metres, in a world with z up.
    target_m
        Point (3,) that the camera looks at without roll, in metres.

    Returns
    -------
    Camera
        Camera with this lens and pose, in a world that is marked as z-up.
    """
    rotation = level_rotation(np.asarray(centre_m, dtype=float), np.asarray(target_m, dtype=float))
    return replace(lens, rotation=rotation, translation_m=-rotation @ centre_m, world_z_up=True)


def camera_ring(count: int, length_m: float, random: np.random.Generator) -> list[Camera]:
    """Return `count` cameras around an animal at five times its length, in a world with z up."""
    cameras = []
    for i in range(count):
        bearing = 2 * np.pi * (i + random.uniform(-0.2, 0.2)) / count
        centre_m = 5 * length_m * np.array([np.cos(bearing), np.sin(bearing), random.uniform(0.15, 0.5)])
        lens = Camera.from_hfov(40.0, (1920, 1080), name=f"cam{i + 1}")
        cameras.append(aim_camera(lens, centre_m, np.array([0.0, 0.0, 0.3 * length_m])))
    return cameras


def level_pose(centre_m: Sequence[float], heading_rad: float) -> Array:
    """Return T_camera_world (4, 4) of a level camera at a point (3,), with its heading in rad from the x axis."""
    right = np.array([np.sin(heading_rad), -np.cos(heading_rad), 0.0])
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    rotation = np.stack([right, [0.0, 0.0, -1.0], ahead])
    return rigid(rotation, -rotation @ np.array(centre_m))


def make_view(camera: Camera, points_m: Array, T_camera_world: Array, sigma_px: float = 2.0, seed: int = 0) -> View:
    """Simulate a camera's detections of points.

    Parameters
    ----------
    camera
        Camera with the lens of the view, whose pose is ignored.
    points_m
        Points (T, K, 3) in world coordinates, m.
    T_camera_world
        Pose (4, 4) of the camera, or poses (T, 4, 4) of a moving camera.
    sigma_px
        Standard deviation of the detections' noise along each axis in pixels.
    seed
        Seed of the noise.

    Returns
    -------
    View
        Detections of all points, each with a confidence of 1.
    """
    blank = View(camera, T_camera_world, np.zeros((*points_m.shape[:2], 2)), np.ones(points_m.shape[:2]))
    noise = sigma_px * np.random.default_rng(seed).normal(size=blank.xy_px.shape)
    return replace(blank, xy_px=blank.project(points_m)[0] + noise)


def turn_view(view: View, angle_deg: float, random: np.random.Generator) -> View:
    """Turn the camera of a view about a random axis through its centre, without changing the detections."""
    axis = random.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(angle_deg) * axis / np.linalg.norm(axis)).as_matrix()
    return replace(view, T_camera_world=rigid(turn, np.zeros(3)) @ view.T_camera_world)


def panning_camera(clip: SyntheticClip, seed: int = 0) -> Callable[[float], Camera]:
    """Return a handheld camera that turns to follow the middle of the animal.

    Parameters
    ----------
    clip
        Clip of a static camera.
    seed
        Seed of the shake, which is 0 in the first frame.

    Returns
    -------
    Callable
        Function from a time in frames to the camera.
    """
    level, centre = clip.camera.rotation, clip.camera.centre_world
    assert level is not None
    fps = clip.keypoints.fps
    assert fps
    animal_m = clip.truth_m.mean(axis=1) - centre
    bearing = gaussian_filter1d(np.arctan2(animal_m[:, 0], animal_m[:, 1]), FOLLOW_S * fps, mode="nearest")
    shake = gaussian_filter1d(np.random.default_rng(seed).normal(size=(len(animal_m), 3)), SHAKE_S * fps, axis=0)
    shake = np.radians(SHAKE_DEG) * (shake - shake[0]) / shake.std(axis=0)
    frames = np.arange(len(animal_m))

    @cache
    def camera_at(t: float) -> Camera:
        right, *rotvec = (np.interp(t, frames, angles) for angles in (bearing, *shake.T))
        rotation = Rotation.from_rotvec(rotvec).as_matrix() @ level @ Rotation.from_euler("z", right).as_matrix()
        return replace(clip.camera, rotation=rotation, translation_m=-rotation @ centre)

    return camera_at
