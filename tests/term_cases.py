"""Make a term of every kind, states at which to evaluate it, and the dense form of a banded matrix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.animal.prior import load_prior
from recon.animal.skeleton_file import load_skeleton
from recon.clip import View, still_view
from recon.fit.least_squares import LeastSquares
from recon.fit.terms import (
    Heading,
    KnownAngles,
    Linear,
    OnGround,
    PoseMixture,
    Reprojection,
    StanceVelocity,
    climb_term,
    dynamics_term,
    pose_term,
    root_term,
)
from recon.geometry.camera import Camera

FPS = 90.0
T = 5
CAMERA = Camera.from_hfov(60.0, (1920, 1080))
BODY = load_skeleton("cheetah-24", "phantom")
PRIOR = load_prior("running-cheetah", BODY)
FEET = np.array([BODY.markers.index(foot) for foot in BODY.feet])


def some_states(seed: int = 0) -> np.ndarray:
    """Return states (T, D) of a body that runs past the camera, with every angle away from its mean."""
    rng = np.random.default_rng(seed)
    states = np.zeros((T, BODY.n_state))
    states[:, 4:] = PRIOR.mean + 0.2 * rng.normal(size=(T, BODY.n_state - 4))
    states[:, :3] = [0.3, 7.0, -0.2] + np.arange(T)[:, None] * [0.1, 0.02, 0.01] + 0.02 * rng.normal(size=(T, 3))
    states[:, 3] = 0.3 + 0.05 * rng.normal(size=T)
    return states


def view(xy_px: np.ndarray, confidence: np.ndarray | None = None, camera: Camera = CAMERA) -> View:
    """Return the view of a level camera at the origin."""
    return still_view(camera, xy_px, np.ones(xy_px.shape[:2]) if confidence is None else confidence)


def pixels(states: np.ndarray) -> np.ndarray:
    points_m = BODY.tree.pose(states).points_m
    return view(np.zeros((*points_m.shape[:2], 2))).project(points_m)[0]


def detections(states: np.ndarray) -> np.ndarray:
    """Return detections (T, J, 2) with errors of about 10 px, one gross error, and one missing detection."""
    xy_px = pixels(states)
    xy_px = xy_px + 10 * np.random.default_rng(1).normal(size=xy_px.shape)
    xy_px[1, 3] += 200.0
    xy_px[2, 5] = np.nan
    return xy_px


def moving_view(xy_px: np.ndarray, confidence: np.ndarray) -> View:
    """Return the view of a fisheye camera that pans, travels and zooms."""
    lens = replace(CAMERA, model="fisheye", distortion=np.array([0.05, -0.01, 0.0, 0.0]))
    still, turn = view(xy_px, confidence, lens), 0.03 * np.arange(T)
    pan = np.tile(np.eye(4), (T, 1, 1))
    pan[:, 0, 0], pan[:, 0, 2], pan[:, 2, 0], pan[:, 2, 2] = np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)
    pan[:, :3, 3] = np.outer(np.arange(T), [0.1, 0.02, -0.05])
    zoom = np.array([1500.0, 1510.0, 950.0, 545.0]) + np.outer(np.arange(T), [30.0, 30.0, 1.0, -1.0])
    return replace(still, T_camera_world=pan @ still.T_camera_world, intrinsics_px=zoom)


def terms():
    xy_px = detections(some_states(1))
    confidence, sigma = np.linspace(0.5, 1, xy_px[..., 0].size).reshape(xy_px.shape[:2]), np.full(xy_px.shape[:2], 8.0)
    contact = np.random.default_rng(3).uniform(size=(T - 1, len(FEET)))
    D = BODY.n_state
    rear, front = (BODY.markers.index(marker) for marker in BODY.forward)
    return [
        pose_term(PRIOR, D, FPS, 2.0),
        dynamics_term(PRIOR, D, FPS, 1.5),
        root_term(D, FPS, np.array([12.0, 12.0, 9.0]), 40.0),
        climb_term(D, FPS, 0.5),
        PoseMixture(PRIOR, FPS, 0.7),
        PoseMixture(PRIOR, FPS, 1.0, temperature=5.0),
        Reprojection(view(xy_px, confidence), sigma, 3.0, np.zeros(3)),
        Reprojection(replace(view(xy_px, confidence), offset_frames=0.3), sigma, 3.0, np.zeros(3)),
        Reprojection(moving_view(xy_px, confidence), sigma, 3.0, np.zeros(3)),
        Heading(rear, front, FPS, 0.5),
        KnownAngles(some_states(1), 0.05),
        StanceVelocity(FEET, FPS, 2.5, 2.0),
        OnGround(FEET, contact, np.array([-0.8, 0.01, -0.02]), np.array([0.3, 7.0]), FPS, 0.04),
    ]


def gradient(term, states: np.ndarray) -> np.ndarray:
    problem = LeastSquares(BODY.tree, [term], []) if isinstance(term, Linear) else LeastSquares(BODY.tree, [], [term])
    return problem.normal(states).gradient


def to_dense(blocks: np.ndarray) -> np.ndarray:
    """Return the dense matrix (TD, TD) of banded blocks, with both triangles filled."""
    T, n_blocks, D, _ = blocks.shape
    dense = np.zeros((T, D, T, D))
    for t in range(T):
        for k in range(min(n_blocks, T - t)):
            dense[t + k, :, t] = blocks[t, k]
            dense[t, :, t + k] = blocks[t, k].T
    return dense.reshape(T * D, T * D)
