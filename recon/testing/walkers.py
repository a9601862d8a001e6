"""Simulate a walking person and a running mouse as states of `human-25` and `mouse-top`."""

from __future__ import annotations

import numpy as np

from recon.animal.skeleton_file import load_skeleton
from recon.base.arrays import Array

STANCE_FRACTION = 0.62
"""Fraction of the stride for which a foot of the walking person stands."""
ROOT_HEIGHT_M, ANKLE_HEIGHT_M = 0.8, 0.055


def walking_person(frames: int, fps: float, speed_m_s: float = 1.0, strides_hz: float = 0.9) -> Array:
    """Return states (T, D) of a `human-25` that walks along x on the ground z = 0.

    The knees are slightly bent. A foot stands flat for `STANCE_FRACTION` of the stride, and the two links of the leg
    follow it.
    """
    body = load_skeleton("human-25")
    column, time_s = {name: i for i, name in enumerate(body.state_names)}, np.arange(frames) / fps
    length = {s.name: -s.offset_m[2] for s in body.tree.segments}
    thigh_m, shank_m = length["l_shank"], length["l_foot"]
    states = np.zeros((frames, body.n_state))
    states[:, 4:] = body.mean_rad
    states[:, column["pelvis_pitch"]] = 0.0
    states[:, 0], states[:, 2] = speed_m_s * (time_s - time_s.mean()), ROOT_HEIGHT_M
    for side, lag in (("l", 0.0), ("r", 0.5)):
        phase = strides_hz * time_s + lag
        swing = np.clip(phase % 1.0 - STANCE_FRACTION, 0.0, None) / (1 - STANCE_FRACTION)
        eased = (1 - np.cos(np.pi * swing)) / 2
        steps = np.floor(phase) + eased + STANCE_FRACTION / 2 - lag
        ankle_m = np.stack(
            [
                speed_m_s / strides_hz * (steps - strides_hz * time_s),
                ANKLE_HEIGHT_M + 0.1 * np.sin(np.pi * swing) ** 2,
            ]
        )
        ahead_m, above_m = ankle_m - [[0.0], [ROOT_HEIGHT_M]]
        bend = np.arccos((ahead_m**2 + above_m**2 - thigh_m**2 - shank_m**2) / (2 * thigh_m * shank_m))
        hip = np.arctan2(-ahead_m, -above_m) - np.arctan2(shank_m * np.sin(bend), thigh_m + shank_m * np.cos(bend))
        states[:, column[f"{side}_thigh_pitch"]], states[:, column[f"{side}_shank_pitch"]] = hip, bend
        states[:, column[f"{side}_foot_pitch"]] = 0.3 * np.sin(np.pi * swing) - hip - bend
        states[:, column[f"{side}_upper_arm_pitch"]] = 0.1 + 0.35 * np.cos(2 * np.pi * phase)
    states[:, column["trunk_yaw"]] = 0.08 * np.sin(2 * np.pi * strides_hz * time_s)
    return states


def running_mouse(frames: int, fps: float) -> Array:
    """Return states (T, D) of a `mouse-top` on a curved path, with its back 25 mm above the ground."""
    body = load_skeleton("mouse-top")
    time_s, rng = np.arange(frames) / fps, np.random.default_rng(3)
    states = np.zeros((frames, body.n_state))
    frequency_hz = rng.uniform(0.4, 1.5, body.n_state - 4)
    phase_rad = rng.uniform(0, 6, body.n_state - 4)
    waves = np.sin(2 * np.pi * frequency_hz * time_s[:, None] + phase_rad)
    states[:, 4:] = body.mean_rad + 0.6 * body.sigma_rad * waves
    states[:, 3] = 1.2 * np.sin(2 * np.pi * 0.4 * time_s)
    velocity = 0.2 * np.stack([np.cos(states[:, 3]), np.sin(states[:, 3])], axis=1)
    states[:, :2] = np.cumsum(velocity, axis=0) / fps
    states[:, :2] -= states[:, :2].mean(axis=0)
    states[:, 2] = 0.025 + 0.004 * np.sin(2 * np.pi * 1.1 * time_s)
    return states
