"""Writes the rendered film of this folder with its truth: python data/samples/make_rendered.py [FOLDER]."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from draw_film import render_frames
from make_samples import SyntheticClip, seen_by, whole_animal, write_keypoints, write_truth

from recon.clip import Keypoints
from recon.geometry.camera import Camera
from recon.io import write_camera
from recon.io.video import Image, video_writer

FPS, FRAMES, LABELLED = 120, 90, 40
SIZE_PX = (640, 360)
FOCAL_PX, DISTANCE_M, HEIGHT_M = 640.0, 11.5, 1.7
LABELLER = "recon_synthetic"


def film() -> tuple[SyntheticClip, float]:
    """The gallop of `whole.csv` at 120 fps, seen by a camera for this film, and the height of the ground (m)."""
    clip, _ = whole_animal(FPS, FRAMES)
    clip = replace(clip, keypoints=seen_by(clip.camera, clip))  # on the markers, which are what is drawn
    paws = [i for i, name in enumerate(clip.names) if name.endswith("paw")]
    ground_m = float(np.quantile(clip.truth_m[:, paws, 2], 0.02)) - 0.03
    middle = 0.5 * (clip.truth_m[0].mean(axis=0) + clip.truth_m[-1].mean(axis=0))
    centre = np.array([middle[0], middle[1] - DISTANCE_M, ground_m + HEIGHT_M])
    look = np.array([middle[0], middle[1], ground_m + 0.75]) - centre
    look = look / np.linalg.norm(look)
    right = np.array([1.0, 0.0, 0.0])
    rotation = np.stack([right, np.cross(look, right), look])
    matrix = np.array([[FOCAL_PX, 0, (SIZE_PX[0] - 1) / 2], [0, FOCAL_PX, (SIZE_PX[1] - 1) / 2], [0, 0, 1]])
    camera = Camera("film", matrix, np.zeros(0), "pinhole", SIZE_PX, rotation, -rotation @ centre)
    return replace(clip, keypoints=seen_by(camera, clip), camera=camera), ground_m


def labelled_frames() -> np.ndarray:
    """Spread evenly, as one would choose them."""
    return np.linspace(0, FRAMES - 1, LABELLED).round().astype(int)


def write_labels(keypoints: Keypoints, frames: np.ndarray, path: Path) -> None:
    """DeepLabCut's label file: rows named by image, x and y only, empty where a point is not in the picture."""
    rows = [
        ["scorer"] + [LABELLER] * 2 * len(keypoints.names),
        ["bodyparts"] + [name for name in keypoints.names for _ in range(2)],
        ["coords"] + ["x", "y"] * len(keypoints.names),
    ]
    for frame in frames:
        cells = ["" if np.isnan(v) else f"{v:.2f}" for v in keypoints.xy_px[frame].ravel()]
        rows.append([f"labeled-data/rendered/img{frame:03d}.png", *cells])
    path.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8", newline="\n")


def make(folder: Path) -> None:
    """The film, its camera, the labels of some of its frames, and the truth in the picture and in space."""
    clip, ground_m = film()
    write_film(folder, clip, render_frames(clip.truth_m, clip.names, lambda t: clip.camera, ground_m))


def write_film(folder: Path, clip: SyntheticClip, pictures: Iterable[Image]) -> None:
    with video_writer(folder / "rendered.mp4", SIZE_PX, FPS) as write:
        for picture in pictures:
            write(picture)
    write_camera(clip.camera, folder / "rendered_camera.toml")
    write_labels(clip.keypoints, labelled_frames(), folder / "rendered_labels.csv")
    write_keypoints(clip.keypoints, folder / "rendered_points.csv", decimals=2)
    write_truth(clip, folder / "rendered_truth.csv", decimals=4)


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
