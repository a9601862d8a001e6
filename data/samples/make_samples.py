"""Writes the sample clips of this folder: python data/samples/make_samples.py [FOLDER]."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from recon.calibration import write_camera
from recon.keypoints import Keypoints
from recon.synthetic import SyntheticClip, add_noise, gallop

SCORER = "recon_synthetic"


def write_keypoints(keypoints: Keypoints, path: Path, decimals: int) -> None:
    """DeepLabCut's CSV layout; a missing point has empty coordinates and likelihood 0."""
    rows = [
        ["scorer"] + [SCORER] * 3 * len(keypoints.names),
        ["bodyparts"] + [name for name in keypoints.names for _ in range(3)],
        ["coords"] + ["x", "y", "likelihood"] * len(keypoints.names),
    ]
    for frame, points, likelihoods in zip(keypoints.frames, keypoints.xy_px, keypoints.confidence, strict=True):
        row = [str(frame)]
        for point, likelihood in zip(points, likelihoods, strict=True):
            row += ["" if np.isnan(v) else f"{v:.{decimals}f}" for v in point] + [f"{likelihood:.{decimals}f}"]
        rows.append(row)
    _write(path, rows)


def write_truth(clip: SyntheticClip, path: Path) -> None:
    """Joint positions in the world, metres."""
    rows = [
        ["bodyparts"] + [name for name in clip.names for _ in range(3)],
        ["coords"] + ["x", "y", "z"] * len(clip.names),
    ]
    for frame, joints in zip(clip.keypoints.frames, clip.truth_m, strict=True):
        rows.append([str(frame)] + [f"{v:.6f}" for v in joints.ravel()])
    _write(path, rows)


def write_outliers(keypoints: Keypoints, outliers: np.ndarray, path: Path) -> None:
    """The gross outliers, by frame and keypoint."""
    found = [[str(keypoints.frames[t]), keypoints.names[k]] for t, k in np.argwhere(outliers)]
    _write(path, [["frame", "keypoint"], *found])


def _write(path: Path, rows: list[list[str]]) -> None:
    path.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8", newline="\n")


def make(folder: Path) -> None:
    """All sample files but README.md, into an existing folder."""
    straight = gallop()
    for clip, name, camera in (
        (straight, "clean", "camera"),
        (gallop(heading_rad=0.35), "clean_heading_20deg", "camera_heading_20deg"),
        (gallop(heading_rad=0.6), "clean_heading_34deg", "camera_heading_34deg"),
    ):
        write_keypoints(clip.keypoints, folder / f"{name}.csv", decimals=6)
        write_truth(clip, folder / f"{name}_truth.csv")
        write_camera(clip.camera, folder / f"{camera}.toml")

    fisheye = gallop(direction="left", camera_model="fisheye")
    write_camera(fisheye.camera, folder / "camera_fisheye.toml")
    for clip, name, outliers_name, seed in (
        (straight, "noisy", "outliers", 0),
        (fisheye, "fisheye_left", "fisheye_left_outliers", 1),
    ):
        noisy, outliers = add_noise(clip.keypoints, sigma_px=2.0, dropout=0.05, outlier=0.02, seed=seed)
        write_keypoints(noisy, folder / f"{name}.csv", decimals=4)
        write_truth(clip, folder / f"{name}_truth.csv")
        write_outliers(noisy, outliers, folder / f"{outliers_name}.csv")


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
