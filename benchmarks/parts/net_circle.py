"""Train a network on labels of the rendered video, predict its keypoints, fit them, and compare with the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from recon.api.camera_motion import settings_for_clip
from recon.api.clip_results import run_clip
from recon.api.samples import samples_folder
from recon.api.settings import FitSettings
from recon.cli.cameras import camera_motion
from recon.clip import Keypoints
from recon.gait.evaluation import Evaluation, evaluate_files
from recon.io.deeplabcut import write_csv
from recon.io.formats import read_keypoints
from recon.keypoint_net.labels import body_length_px, evaluate_2d, read_label_file
from recon.keypoint_net.network import run_prediction
from recon.keypoint_net.settings import LabelSource, TrainSettings
from recon.keypoint_net.train import run_training

NOISE_PX = 2.0
"""Standard deviation of the noise on the true points, pixels, in the fit used for comparison."""


@dataclass(frozen=True)
class Circle:
    """Results of all stages, from the training on labels to the comparison of the motion with the truth."""

    training: dict[str, Any]
    """Report of the training, the content of training.json."""
    points: dict[str, Any]
    """Scores of the predictions in the frames without labels."""
    predicted: Evaluation
    """3D scores over all frames, from the fit of the predictions."""
    noisy: Evaluation
    """3D scores over all frames, from the fit of the true points with noise."""

    @property
    def predicted_m(self) -> float:
        """Return the MPJPE of the fit of predictions, metres."""
        return self.predicted.mpjpe_m.mean

    @property
    def noisy_m(self) -> float:
        """Return the MPJPE of the fit of true points with noise, metres."""
        return self.noisy.mpjpe_m.mean

    @property
    def ratio(self) -> float:
        return self.predicted_m / self.noisy_m


def run_circle(
    out: Path,
    settings: TrainSettings,
    *,
    samples: Path | None = None,
    device: str = "auto",
    threads: int | None = None,
    seed: int = 0,
    turns: bool = False,
    **fit: Any,
) -> Circle:
    """Train a network, predict, fit twice, and write everything into the folder `out`.

    `samples` is the folder with the video and its files, by default the project's own. If `turns` is true, the camera
    pans, and its rotation is estimated from the video. `fit` has the settings of both fits.
    """
    samples = samples or samples_folder()
    film, labels = samples / "rendered.mp4", samples / "rendered_labels.csv"
    training = run_training(
        LabelSource(data=film, labels=labels), settings, out / "network",
        device=device, threads=threads, overwrite=True,
    )  # fmt: skip
    points = out / "points.csv"
    run_prediction(film, out / "network", points, device=device, threads=threads, overwrite=True)
    truth, found = read_keypoints(samples / "rendered_points.csv"), read_keypoints(points)
    labelled, _ = read_label_file(labels)
    others = ~np.isin(truth.frames, labelled.frames)
    score = evaluate_2d(
        truth.names, found.xy_px[others], found.confidence[others], truth.xy_px[others], body_length_px(truth.xy_px)
    )
    noisy = out / "noisy.csv"
    write_csv(with_noise(truth, NOISE_PX, seed), noisy)
    errors = []
    for name, file in (("predicted", points), ("noisy", noisy)):
        options = FitSettings(
            keypoints=(file,),
            camera=(samples / "rendered_camera.toml",),
            fps=found.fps,
            detector="none",  # the video's keypoints have no bias
            **fit,
        )
        if turns:
            track = (out / f"{name}_track.csv").absolute()
            camera_motion(settings_for_clip(options, film, track, overwrite=True))
            options = replace(options, camera_track=(track,), tilt_deg=None)
        run_clip(options, out / name, overwrite=True)
        errors.append(evaluate_files(out / name / "pose3d.csv", samples / "rendered_truth.csv"))
    return Circle(training, score, errors[0], errors[1])


def with_noise(truth: Keypoints, sigma_px: float, seed: int) -> Keypoints:
    noise = np.random.default_rng(seed).normal(0, sigma_px, truth.xy_px.shape)
    return replace(truth, xy_px=truth.xy_px + noise)
