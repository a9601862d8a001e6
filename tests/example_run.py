"""Simulate a run of `cheetah-24` in front of cameras, which many tests fit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from recon import FitSettings
from recon.animal.prior import load_prior
from recon.animal.skeleton_file import load_skeleton
from recon.clip import Keypoints, View, still_view
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.geometry.camera import Camera
from recon.geometry.frames import level_from_camera
from recon.testing.cameras import level_pose, make_view

FPS = 90.0
CAMERA = Camera.from_hfov(60.0, (1920, 1080))
BODY = load_skeleton("cheetah-24", "phantom")
PRIOR = load_prior("running-cheetah", BODY)
CAMERA_FROM_LEVEL = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
LEVEL = level_from_camera(CAMERA.up)
AHEAD, ASIDE = level_pose([0.0, 0.0, 0.0], np.pi / 2), level_pose([-9.0, 9.0, 0.5], 0.0)
FISHEYE = replace(CAMERA, model="fisheye", distortion=np.zeros(4))
KEYPOINT_M = 0.005
POSES = (AHEAD, ASIDE, level_pose([4.0, 1.0, 1.0], 0.75 * np.pi), level_pose([9.0, 10.0, 0.8], np.pi))


def run(T: int = 40, heading_rad: float = 0.4, speed_m_s: float = 9.0) -> np.ndarray:
    """Return the joints (T, J, 3), m, of a run with three strides a second, in the camera's frame.

    The angles vary along the two widest directions of the prior's covariance.
    """
    values, vectors = np.linalg.eigh(PRIOR.covariance)
    t = np.arange(T) / FPS
    swing = 2 * np.pi * 3.0 * t
    states = np.zeros((T, BODY.n_state))
    states[:, 4:] = (
        PRIOR.mean
        + np.outer(np.cos(swing), vectors[:, -1] * np.sqrt(values[-1]))
        + np.outer(np.sin(swing), vectors[:, -2] * np.sqrt(values[-2]))
    )
    along = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    states[:, :3] = np.array([0.0, 9.0, -0.3]) + np.outer((t - t.mean()) * speed_m_s, along)
    states[:, 3] = heading_rad
    return BODY.tree.pose(states).points_m @ CAMERA_FROM_LEVEL.T


def seen(joints_m: np.ndarray, sigma_px: float = 2.0, seed: int = 0) -> np.ndarray:
    xy_px, _ = CAMERA.project(joints_m)
    return xy_px + sigma_px * np.random.default_rng(seed).normal(size=xy_px.shape)


def solve(xy_px: np.ndarray, body=BODY, prior=PRIOR, camera=CAMERA, **options) -> TrajectorySolution:
    confidence = np.isfinite(xy_px[..., 0]).astype(float)
    return solve_trajectory([still_view(camera, xy_px, confidence)], body, prior, FPS, TrajectoryOptions(**options))


@cache
def plain() -> TrajectorySolution:
    return solve(seen(run()))


def errors_m(solution: TrajectorySolution, truth: np.ndarray) -> np.ndarray:
    """Return the mean distance of the joints in each frame (T,), m, both poses centred."""
    found = solution.joints_camera_m
    centred = found - found.mean(axis=1, keepdims=True) - truth + truth.mean(axis=1, keepdims=True)
    return np.linalg.norm(centred, axis=-1).mean(axis=1)


def truth_m() -> np.ndarray:
    """Return the joints (T, J, 3), m, of the run, in the level frame of a camera at the origin."""
    return run() @ LEVEL.T


def view_of(points_m: np.ndarray, T_camera_world: np.ndarray, sigma_px: float = 2.0, seed: int = 0) -> View:
    """Return the view of points (T, J, 3), m, by the run's camera at a pose, with `sigma_px` of noise."""
    return make_view(CAMERA, points_m, T_camera_world, sigma_px, seed)


@cache
def two() -> TrajectorySolution:
    views = [view_of(truth_m(), AHEAD), view_of(truth_m(), ASIDE, seed=1)]
    return solve_trajectory(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True, size_sigma=0.3))


def keypoints_of(xy_px: np.ndarray, first: int = 0) -> Keypoints:
    return Keypoints(BODY.markers, xy_px, np.ones(xy_px.shape[:2]), np.arange(first, first + len(xy_px)), fps=FPS)


def settings(folder: Path, *numbers: int, **more: object) -> FitSettings:
    files = [folder / f"run_cam{number}.csv" for number in numbers]
    given = {"fps": FPS, "subject": "phantom", "fast": True, "camera": folder / "scene.json"} | more
    return FitSettings(keypoints=files, **given)  # pyright: ignore[reportArgumentType]


def run_views(n: int = 4) -> list[View]:
    """Return n views of the run, at most as noisy as a fit expects."""
    views = [view_of(truth_m(), T, sigma_px=2.0, seed=i) for i, T in enumerate(POSES[:n])]
    return [replace(view, camera=replace(view.camera, name=f"cam{i + 1}")) for i, view in enumerate(views)]


def late(view: View, frames: int) -> View:
    """Return a view whose pictures were taken `frames` later than their numbers state."""
    xy_px = np.full_like(view.xy_px, np.nan)
    if frames > 0:
        xy_px[:-frames] = view.xy_px[frames:]
    else:
        xy_px[-frames:] = view.xy_px[:frames]
    return replace(view, xy_px=xy_px)
