"""A person who walks and a mouse that runs about, before cameras that are known exactly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from recon import Camera, FitSettings, Keypoints, load_skeleton, write_cameras
from recon.base.arrays import Array
from recon.io import Pose3D, write_csv

SPREAD = 0.5
"""How far keypoints lie beside the markers all the time, of the spread that the skeleton states for single frames."""


def walking(frames: int, fps: float, speed_m_s: float = 1.0, strides_hz: float = 0.9) -> Array:
    """(T, D): states of human-25 that walks along x over z = 0, with knees a little bent: a foot stands flat for 0.62
    of the stride, and the leg's two links follow it."""
    body = load_skeleton("human-25")
    at, time_s = {name: i for i, name in enumerate(body.state_names)}, np.arange(frames) / fps
    length = {s.name: -s.offset_m[2] for s in body.tree.segments}
    thigh_m, shank_m = length["l_shank"], length["l_foot"]
    states = np.zeros((frames, body.n_state))
    states[:, 4:] = body.mean_rad
    states[:, at["pelvis_pitch"]] = 0.0
    states[:, 0], states[:, 2] = speed_m_s * (time_s - time_s.mean()), 0.8
    for side, late in (("l", 0.0), ("r", 0.5)):
        phase = strides_hz * time_s + late
        swing = np.clip(phase % 1.0 - 0.62, 0.0, None) / 0.38
        eased = (1 - np.cos(np.pi * swing)) / 2
        stood = np.floor(phase) + eased + 0.31 - late
        ankle_m = np.stack(
            [speed_m_s / strides_hz * (stood - strides_hz * time_s), 0.055 + 0.1 * np.sin(np.pi * swing) ** 2]
        )
        ahead_m, above_m = ankle_m - [[0.0], [0.8]]
        bend = np.arccos((ahead_m**2 + above_m**2 - thigh_m**2 - shank_m**2) / (2 * thigh_m * shank_m))
        hip = np.arctan2(-ahead_m, -above_m) - np.arctan2(shank_m * np.sin(bend), thigh_m + shank_m * np.cos(bend))
        states[:, at[f"{side}_thigh_pitch"]], states[:, at[f"{side}_shank_pitch"]] = hip, bend
        states[:, at[f"{side}_foot_pitch"]] = 0.3 * np.sin(np.pi * swing) - hip - bend
        states[:, at[f"{side}_upper_arm_pitch"]] = 0.1 + 0.35 * np.cos(2 * np.pi * phase)
    states[:, at["trunk_yaw"]] = 0.08 * np.sin(2 * np.pi * strides_hz * time_s)
    return states


def running_about(frames: int, fps: float) -> Array:
    """(T, D): states of mouse-top on a bent path through an open field, its back 25 mm above the ground."""
    body = load_skeleton("mouse-top")
    time_s, rng = np.arange(frames) / fps, np.random.default_rng(3)
    states = np.zeros((frames, body.n_state))
    waves = np.sin(
        2 * np.pi * rng.uniform(0.4, 1.5, body.n_state - 4) * time_s[:, None] + rng.uniform(0, 6, body.n_state - 4)
    )
    states[:, 4:] = body.mean_rad + 0.6 * body.sigma_rad * waves
    states[:, 3] = 1.2 * np.sin(2 * np.pi * 0.4 * time_s)
    velocity = 0.2 * np.stack([np.cos(states[:, 3]), np.sin(states[:, 3])], axis=1)
    states[:, :2] = np.cumsum(velocity, axis=0) / fps
    states[:, :2] -= states[:, :2].mean(axis=0)
    states[:, 2] = 0.025 + 0.004 * np.sin(2 * np.pi * 1.1 * time_s)
    return states


def looking_at(centre_m: Array, target_m: Array, name: str) -> Camera:
    """A level camera there, in a world with z up."""
    ahead = (target_m - centre_m) / np.linalg.norm(target_m - centre_m)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    lens = Camera.from_hfov(60.0, (1280, 1024), name=name)
    return replace(lens, rotation=rotation, translation_m=-rotation @ centre_m, world_z_up=True)


def filmed(
    folder: Path,
    skeleton: str,
    states: Array,
    fps: float,
    centres_m: Array,
    size: float,
    height_m: float,
    sigma_px: float,
) -> tuple[FitSettings, Pose3D]:
    """Files of a clip in a folder, and the truth. centres_m (V, 3): cameras that look at (0, 0, height_m); size: of the
    animal; keypoints lie beside its markers (`SPREAD`), and their detections have noise."""
    body, rng = load_skeleton(skeleton), np.random.default_rng(0)
    offsets = {marker: tuple(rng.normal(0, SPREAD * body.keypoint_sigma_m, 3)) for marker in body.markers}
    detected = replace(body, keypoint_offset_m=offsets).detected
    true_m, seen_m = (tree.pose(states, np.full(len(states), size)).points_m for tree in (body.tree, detected))
    cameras, files = [], []
    for number, centre_m in enumerate(np.asarray(centres_m), start=1):
        camera = looking_at(centre_m, np.array([0.0, 0.0, height_m]), f"cam{number}")
        xy_px, valid = camera.project(camera.world_to_camera(seen_m))
        assert valid.all()
        xy_px = xy_px + rng.normal(0, sigma_px, xy_px.shape)
        likelihood = np.where(rng.uniform(size=valid.shape) < 0.05, 0.05, 0.95)
        files.append(folder / f"cam{number}.csv")
        write_csv(Keypoints(body.markers, xy_px, likelihood, np.arange(len(states)), fps=fps), files[-1])
        cameras.append(camera)
    write_cameras(cameras, folder / "rig.toml")
    settings = FitSettings(keypoints=tuple(files), camera=(folder / "rig.toml",), skeleton=skeleton, fps=fps)
    return settings, Pose3D(body.markers, true_m, np.arange(len(states)), fps=fps)
