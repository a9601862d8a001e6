"""Simulate an animal of any skeleton inside a ring of cameras, as views for a solver or as files of a clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from recon.animal.body import Body
from recon.animal.prior import ANGLES
from recon.animal.skeleton_file import load_skeleton
from recon.base.arrays import Array
from recon.clip import Keypoints, View, still_view
from recon.fit.body_shape import Shape
from recon.geometry.camera import Camera
from recon.io.camera_files import write_cameras
from recon.io.common import Pose3D
from recon.io.deeplabcut import write_csv
from recon.testing.cameras import aim_camera, camera_ring

FPS = 60.0
"""Default frame rate of a simulated clip in Hz."""
FRAMES = 72
"""Default number of frames of a simulated clip."""
BIAS = 0.5
"""Standard deviation of the keypoints' bias along each axis, relative to the skeleton's keypoint_sigma_m."""
SIGMA_PX = 2.0
"""Standard deviation of the detections' noise along each axis in pixels."""
MISSING = 0.05
"""Fraction of detections that are missing."""


def body_length_m(body: Body) -> float:
    """Return the largest extent in metres of an animal in its expected pose."""
    return float(np.ptp(_expected_points(body), axis=1).max())


def _expected_points(body: Body) -> Array:
    return body.tree.pose(np.concatenate([np.zeros((1, 4)), body.mean_rad[None]], axis=1)).points_m


def random_motion(body: Body, random: np.random.Generator, frames: int = FRAMES, fps: float = FPS) -> Array:
    """Simulate a motion in which every angle swings about its expected value and the animal follows a curved path.

    Parameters
    ----------
    body
        The animal.
    random
        Random generator of the frequencies, phases and heading.
    frames, fps
        Number of frames T, and frame rate in Hz.

    Returns
    -------
    Array
        States (T, D). The lowest point is close to the ground z = 0, and the speed is two thirds of a body length per
        second.
    """
    time_s, n, length_m = np.arange(frames) / fps, body.n_state - 4, body_length_m(body)
    swing = np.sin(2 * np.pi * random.uniform(0.5, 2.0, n) * time_s[:, None] + random.uniform(0, 2 * np.pi, n))
    states = np.zeros((frames, body.n_state))
    states[:, ANGLES] = body.mean_rad + 0.8 * body.sigma_rad * swing
    states[:, 3] = random.uniform(-np.pi, np.pi) + 0.6 * np.sin(2 * np.pi * 0.4 * time_s)
    ahead = np.stack([np.cos(states[:, 3]), np.sin(states[:, 3])], axis=1)
    states[:, :2] = np.cumsum(ahead, axis=0) * length_m / fps / 1.5
    states[:, :2] -= states[:, :2].mean(axis=0)
    states[:, 2] = -_expected_points(body)[..., 2].min()
    return states


def random_clip(body: Body, length_sigma: float, cameras: int, seed: int) -> tuple[list[View], Array]:
    """Simulate an animal with its own lengths inside a ring of cameras.

    Parameters
    ----------
    body
        The skeleton that a fit will assume.
    length_sigma
        Relative standard deviation of the animal's lengths from the skeleton's. Left and right lengths are equal.
    cameras
        Number of cameras, which are five body lengths away.
    seed
        Seed of the lengths, the keypoints' bias, the motion, the cameras and the noise.

    Returns
    -------
    tuple
        A view of each camera, and the true positions (T, J, 3) of the markers in world coordinates, m.
    """
    random = np.random.default_rng(seed)
    shape = Shape.of_body(body)
    factors = random.normal(size=len(shape)) * np.log1p(length_sigma)
    offsets = {marker: tuple(random.normal(0, BIAS * body.keypoint_sigma_m, 3)) for marker in body.markers}
    individual = replace(shape.applied(body, factors), keypoint_offset_m=offsets)
    states = random_motion(individual, random)
    detected_m, views = individual.detected.pose(states).points_m, []
    for camera in camera_ring(cameras, body_length_m(individual), random):
        xy_px, valid = camera.project(camera.world_to_camera(detected_m))
        xy_px = xy_px + random.normal(0, SIGMA_PX, xy_px.shape)
        present = valid & (random.uniform(size=valid.shape) > MISSING)
        views.append(still_view(camera, np.where(present[..., None], xy_px, np.nan), present.astype(float)))
    return views, individual.tree.pose(states).points_m


def write_rig_clip(
    folder: Path,
    skeleton: str,
    states: Array,
    fps: float,
    centres_m: Sequence[Sequence[float]] | Array,
    size: float,
    target_height_m: float,
    sigma_px: float,
) -> tuple[dict[str, Path], Pose3D]:
    """Write keypoint files and cameras of a simulated clip.

    Parameters
    ----------
    folder
        Existing folder, to which cam1.csv, cam2.csv, ... and rig.toml are written.
    skeleton
        Name of the skeleton.
    states
        States of the skeleton, shape (T, D).
    fps
        Frame rate in Hz.
    centres_m
        Centres of the V cameras in metres, shape (V, 3). All look at (0, 0, target_height_m).
    size
        Size of the animal, relative to the skeleton.
    target_height_m
        Height in metres of the point that the cameras look at.
    sigma_px
        Standard deviation of the detections' noise in pixels. One detection in twenty has a low likelihood, and
        keypoints have a bias (`BIAS`).

    Returns
    -------
    tuple
        The files, keyed by name (cam1, ..., rig), and the true markers.
    """
    body, rng = load_skeleton(skeleton), np.random.default_rng(0)
    offsets = {marker: tuple(rng.normal(0, BIAS * body.keypoint_sigma_m, 3)) for marker in body.markers}
    detected = replace(body, keypoint_offset_m=offsets).detected
    true_m, detected_m = (tree.pose(states, np.full(len(states), size)).points_m for tree in (body.tree, detected))
    cameras, files = [], {}
    for number, centre_m in enumerate(np.asarray(centres_m), start=1):
        lens = Camera.from_hfov(60.0, (1280, 1024), name=f"cam{number}")
        camera = aim_camera(lens, centre_m, np.array([0.0, 0.0, target_height_m]))
        xy_px, valid = camera.project(camera.world_to_camera(detected_m))
        assert valid.all()
        xy_px = xy_px + rng.normal(0, sigma_px, xy_px.shape)
        likelihood = np.where(rng.uniform(size=valid.shape) < 0.05, 0.05, 0.95)
        files[camera.name] = folder / f"{camera.name}.csv"
        keypoints = Keypoints(body.markers, xy_px, likelihood, np.arange(len(states)), fps=fps)
        write_csv(keypoints, files[camera.name])
        cameras.append(camera)
    files["rig"] = folder / "rig.toml"
    write_cameras(cameras, files["rig"])
    return files, Pose3D(body.markers, true_m, np.arange(len(states)), fps=fps)
