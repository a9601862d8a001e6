"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recon.camera import Camera
from recon.initialise import mean_pose
from recon.keypoints import Keypoints, clean
from recon.motion import Motion
from recon.skeleton_file import load_skeleton
from recon.solve import FrameOptions, solve_frames


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real recordings, which are not part of the project: RECON_SHARED_DATA, or ../shared/data by default."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    path = Path(os.environ.get("RECON_SHARED_DATA", default))
    if not path.is_dir():
        pytest.skip(f"no real recordings at {path} (set RECON_SHARED_DATA)")
    return path


@pytest.fixture(scope="session")
def small_motion() -> Motion:
    """Six frames (10 to 15) of a mean pose that glides to the right at 9 m/s and 30 fps, 9 m from a pinhole camera.

    Pixels are exact, but for the `neck_base` of frame 14, 300 px off. Frame 13 has no data, frame 15 only six points.
    `nose` is in the file but not in the skeleton; `spine` is rejected as unlikely in frame 11.
    """
    skeleton = load_skeleton("cheetah-8u")
    camera = Camera.from_hfov(64.0, (1920, 1080))
    states = np.tile(mean_pose(skeleton), (6, 1))
    states[:, skeleton.place_slice] = [-1.5, 0.0, 9.0] + 0.3 * np.arange(6)[:, None] * [1.0, 0.0, 0.0]
    xy_px, _ = camera.project(skeleton.pose(states).joints_m)
    names = skeleton.keypoint_names("right")
    xy_px[4, names.index("neck_base"), 1] -= 300.0
    xy_px[3] = np.nan
    xy_px[5, [1, 4, 6]] = np.nan
    confidence = np.where(np.isnan(xy_px[..., 0]), 0.0, 1.0)
    confidence[1, names.index("spine")] = 0.1
    nose = np.full((6, 1, 2), 100.0)
    file = Keypoints(
        (*names, "nose"),
        np.concatenate([xy_px, nose], axis=1),
        np.concatenate([confidence, np.ones((6, 1))], axis=1),
        np.arange(10, 16),
        fps=30.0,
        source="glide.csv",
    )
    cleaned, cleaning = clean(file, 0.5)
    fitted = replace(
        cleaned, names=names, xy_px=cleaned.xy_px[:, : len(names)], confidence=cleaned.confidence[:, : len(names)]
    )
    solution = solve_frames(camera, skeleton, fitted.xy_px, fitted.confidence, 30.0, FrameOptions())
    return Motion(skeleton, camera, "right", "as given", fitted, cleaning, file.names, solution)
