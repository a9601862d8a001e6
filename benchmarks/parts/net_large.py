"""Render the animal in pictures that it nearly fills, with exactly known keypoints.

The camera has a longer lens, and a window of its picture follows the animal, so that nothing in the window stands
still.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from recon.clip import Keypoints
from recon.io.formats import read_keypoints
from recon.io.video import video_writer
from recon.keypoint_net.labels import body_length_px, evaluate_2d, read_label_file
from recon.keypoint_net.network import run_prediction
from recon.keypoint_net.settings import LabelSource, TrainSettings
from recon.keypoint_net.train import run_training
from recon.testing.files import write_keypoints, write_labels
from recon.testing.film import FPS, film_clip, labelled_frames, render_frames

SIZE_PX = (640, 480)
LENS = 4.4
"""Focal length relative to the rendered video's camera, which makes the animal 403 to 474 px long."""
ABOVE_PX = 40
"""Distance of the camera's optical axis above the middle of the picture, pixels."""


def write_large_film(folder: Path) -> Keypoints:
    """Write large.mp4 and labels of some of its frames, and return the true keypoints in all frames."""
    folder.mkdir(parents=True, exist_ok=True)
    clip, ground_m = film_clip()
    width, height = SIZE_PX
    wide = 2 * round(0.5 * LENS * clip.camera.image_size_px[0])
    matrix = clip.camera.matrix * np.array([[LENS], [LENS], [1]])
    matrix[:2, 2] = (wide - 1) / 2, (height - 1) / 2 - ABOVE_PX
    camera = replace(clip.camera, matrix=matrix, image_size_px=(wide, height))
    xy_px, _ = camera.project(camera.world_to_camera(clip.truth_m))
    frames = np.arange(len(xy_px))
    middle = 0.5 * (xy_px.min(axis=1) + xy_px.max(axis=1))[:, 0]
    left = np.polyval(np.polyfit(frames, middle, 1), frames) - 0.5 * width
    left = np.clip(left.round().astype(int), 0, wide - width)
    xy_px[..., 0] -= left[:, None]
    inside = np.all((xy_px >= 0) & (xy_px <= np.array(SIZE_PX) - 1), axis=2)
    truth = replace(
        clip.keypoints, xy_px=np.where(inside[..., None], xy_px, np.nan), confidence=inside.astype(float),
        image_size_px=SIZE_PX,
    )  # fmt: skip
    with video_writer(folder / "large.mp4", SIZE_PX, FPS) as write:
        pictures = render_frames(clip.truth_m, clip.names, lambda t: camera, ground_m)
        for picture, x in zip(pictures, left, strict=True):
            write(np.ascontiguousarray(picture[:, x : x + width]))
    write_labels(truth, labelled_frames(), folder / "large_labels.csv")
    write_keypoints(truth, folder / "large_points.csv", decimals=2)
    return truth


def run_large(
    film: Path, out: Path, settings: TrainSettings, device: str, threads: int | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Train on the large animal, and return the training report and the scores in the frames without labels.

    `film` is a folder written by `write_large_film`.
    """
    video, labels = film / "large.mp4", film / "large_labels.csv"
    report = run_training(
        LabelSource(data=video, labels=labels), settings, out, device=device, threads=threads, overwrite=True
    )  # fmt: skip
    truth, labelled = read_keypoints(film / "large_points.csv"), read_label_file(labels)[0]
    others, length_px = ~np.isin(truth.frames, labelled.frames), body_length_px(truth.xy_px)
    found = run_prediction(video, out, out / "points.csv", device=device, threads=threads, overwrite=True)
    return report, evaluate_2d(
        truth.names, found.xy_px[others], found.confidence[others], truth.xy_px[others], length_px,
        tolerance_px=report["tolerance_px"],
    )  # fmt: skip
