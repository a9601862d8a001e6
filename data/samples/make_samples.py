"""Writes the sample clips of this folder: python data/samples/make_samples.py [FOLDER]."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import recon.animal
from recon.animal.skeleton_file import load_skeleton
from recon.clip import Keypoints
from recon.fit import solve_points
from recon.geometry.camera import Camera
from recon.io import write_camera

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
from gallop import SyntheticClip, add_noise, gallop

SCORER = "recon_synthetic"
AS_ACINOSET = "recon_synthetic_acinoset"
"""The scorer of keypoints that lie where those of a measured detector do."""
SAMPLES = Path(__file__).parent


def write_keypoints(keypoints: Keypoints, path: Path, decimals: int, scorer: str = SCORER) -> None:
    """DeepLabCut's CSV layout; a missing point has empty coordinates and likelihood 0."""
    rows = [
        ["scorer"] + [scorer] * 3 * len(keypoints.names),
        ["bodyparts"] + [name for name in keypoints.names for _ in range(3)],
        ["coords"] + ["x", "y", "likelihood"] * len(keypoints.names),
    ]
    for frame, points, likelihoods in zip(keypoints.frames, keypoints.xy_px, keypoints.confidence, strict=True):
        row = [str(frame)]
        for point, likelihood in zip(points, likelihoods, strict=True):
            row += ["" if np.isnan(v) else f"{v:.{decimals}f}" for v in point] + [f"{likelihood:.{decimals}f}"]
        rows.append(row)
    _write(path, rows)


def write_truth(clip: SyntheticClip, path: Path, decimals: int = 6) -> None:
    """Joint positions in the world, metres."""
    rows = [
        ["bodyparts"] + [name for name in clip.names for _ in range(3)],
        ["coords"] + ["x", "y", "z"] * len(clip.names),
    ]
    for frame, joints in zip(clip.keypoints.frames, clip.truth_m, strict=True):
        rows.append([str(frame)] + [f"{v:.{decimals}f}" for v in joints.ravel()])
    _write(path, rows)


def write_outliers(keypoints: Keypoints, outliers: np.ndarray, path: Path) -> None:
    """The gross outliers, by frame and keypoint."""
    found = [[str(keypoints.frames[t]), keypoints.names[k]] for t, k in np.argwhere(outliers)]
    _write(path, [["frame", "keypoint"], *found])


def _write(path: Path, rows: list[list[str]]) -> None:
    path.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8", newline="\n")


def whole_animal(fps: float = 60, n_frames: int = 60) -> tuple[SyntheticClip, SyntheticClip]:
    """The skeleton `cheetah-24` in that gallop, and the same with its keypoints in place of its
    markers: where the detector of `detector.toml` sees them, which is not quite the one that fits take it for.

    It takes the poses that are nearest to the gallop's trunk and legs; the head stays level and the tail swings.
    """
    clip = gallop(fps=fps, n_frames=n_frames)
    body = load_skeleton("cheetah-24")
    points_m = np.full((len(clip.truth_m), len(body.markers), 3), np.nan)
    at = [body.markers.index(name) for name in clip.names]
    points_m[:, at] = clip.truth_m
    states, *_ = solve_points(body, points_m)
    column = {name: states[:, i] for i, name in enumerate(body.state_names)}
    t = np.arange(len(states)) / fps
    column["head_pitch"][:] = -0.7 * (column["rear_trunk_pitch"] + column["front_trunk_pitch"])
    column["tail_1_yaw"][:] = 0.3 * np.sin(2 * np.pi * 1.3 * t)
    column["tail_2_yaw"][:] = 0.3 * np.sin(2 * np.pi * 1.3 * t - 0.8)
    column["tail_1_pitch"][:] = -0.45 + 0.2 * np.cos(2 * np.pi * 3.3 * t)
    clip = replace(clip, truth_m=body.tree.pose(states).points_m, names=body.markers)
    detected = recon.animal.with_detector_offsets(body, SAMPLES / "detector.toml").detected
    return clip, replace(clip, truth_m=detected.pose(states).points_m)


def scene(first: Camera) -> tuple[Camera, ...]:
    """cam1 where a camera stands, cam2 ahead of the animal and to its right, both with fisheye lenses."""
    place, target = np.array([10.0, -8.0, 1.6]), np.array([0.0, 0.0, 0.6])
    away = (target - place) / np.linalg.norm(target - place)
    right = np.array([away[1], -away[0], 0.0]) / np.hypot(*away[:2])
    rotation = np.stack([right, np.cross(away, right), away])
    matrix = np.array([[1100.0, 0, 959.5], [0, 1100, 539.5], [0, 0, 1]])
    lens = replace(first, name="cam1", model="fisheye", matrix=matrix, distortion=np.zeros(4))
    return lens, replace(lens, name="cam2", rotation=rotation, translation_m=-rotation @ place)


def write_scene(cameras: tuple[Camera, ...], path: Path) -> None:
    """In AcinoSet's layout."""
    entries = [
        {
            "name": camera.name,
            "k": camera.matrix.tolist(),
            "d": camera.distortion[:, None].tolist(),
            "r": np.array(camera.rotation).tolist(),
            "t": np.array(camera.translation_m)[:, None].tolist(),
        }
        for camera in cameras
    ]
    document = {"camera_resolution": [*cameras[0].image_size_px], "cameras": entries}
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")


def seen_by(camera: Camera, clip: SyntheticClip) -> Keypoints:
    """What a camera sees of the clip's truth."""
    xy_px, valid = camera.project(camera.world_to_camera(clip.truth_m))
    visible = valid & camera.in_image(xy_px)
    return Keypoints(
        names=clip.names,
        xy_px=np.where(visible[..., None], xy_px, np.nan),
        confidence=visible.astype(float),
        frames=clip.keypoints.frames,
        fps=clip.keypoints.fps,
        image_size_px=camera.image_size_px,
    )


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

    # Fewer digits: these poses are the result of an optimisation, whose last digits differ between machines.
    whole, detected = whole_animal()
    noisy, outliers = add_noise(seen_by(whole.camera, detected), sigma_px=2.0, dropout=0.05, outlier=0.02, seed=2)
    write_keypoints(noisy, folder / "whole.csv", decimals=2, scorer=AS_ACINOSET)
    write_truth(whole, folder / "whole_truth.csv", decimals=4)
    write_outliers(noisy, outliers, folder / "whole_outliers.csv")

    cameras = scene(whole.camera)
    write_scene(cameras, folder / "whole_scene.json")
    for number, camera in enumerate(cameras, start=1):
        noisy, _ = add_noise(seen_by(camera, detected), sigma_px=2.0, dropout=0.05, outlier=0.02, seed=2 + number)
        write_keypoints(noisy, folder / f"whole_{camera.name}.csv", decimals=2, scorer=AS_ACINOSET)


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
