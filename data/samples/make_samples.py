"""Write the sample clips of this folder: python data/samples/make_samples.py [FOLDER]."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from recon.geometry.camera import Camera
from recon.io.camera_files import write_camera
from recon.testing.files import write_keypoints, write_outliers, write_scene, write_truth
from recon.testing.gallop import add_noise, gallop, project_clip, whole_gallop

AS_ACINOSET = "recon_synthetic_acinoset"
"""Scorer of keypoints with the offsets of a measured detector."""
SAMPLES = Path(__file__).parent


def scene(first: Camera) -> tuple[Camera, ...]:
    """Set up cam1 where a camera stands, and cam2 ahead of the animal and to its right, both with fisheye lenses."""
    centre, target = np.array([10.0, -8.0, 1.6]), np.array([0.0, 0.0, 0.6])
    ahead = (target - centre) / np.linalg.norm(target - centre)
    right = np.array([ahead[1], -ahead[0], 0.0]) / np.hypot(*ahead[:2])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    matrix = np.array([[1100.0, 0, 959.5], [0, 1100, 539.5], [0, 0, 1]])
    lens = replace(first, name="cam1", model="fisheye", matrix=matrix, distortion=np.zeros(4))
    return lens, replace(lens, name="cam2", rotation=rotation, translation_m=-rotation @ centre)


def make(folder: Path) -> None:
    """Write all sample files but README.md into an existing folder."""
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

    # Fewer digits: these poses are the result of an optimisation, whose last digits differ between machines.
    whole, detected = whole_gallop(detector=SAMPLES / "detector.toml")
    noisy, outliers = add_noise(project_clip(whole.camera, detected), sigma_px=2.0, dropout=0.05, outlier=0.02, seed=2)
    write_keypoints(noisy, folder / "whole.csv", decimals=2, scorer=AS_ACINOSET)
    write_truth(whole, folder / "whole_truth.csv", decimals=4)
    write_outliers(noisy, outliers, folder / "whole_outliers.csv")

    cameras = scene(whole.camera)
    write_scene(cameras, folder / "whole_scene.json")
    for number, camera in enumerate(cameras, start=1):
        noisy, _ = add_noise(project_clip(camera, detected), sigma_px=2.0, dropout=0.05, outlier=0.02, seed=2 + number)
        write_keypoints(noisy, folder / f"whole_{camera.name}.csv", decimals=2, scorer=AS_ACINOSET)


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
