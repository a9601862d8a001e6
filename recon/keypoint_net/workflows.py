"""The keypoint network: labels in, a trained network out; a video in, a keypoint file out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recon.base.errors import InputError, Problem, all_of
from recon.base.files import require_free_file, sole_writer, staged_file, staged_folder
from recon.base.progress import Progress, silent
from recon.clip.keypoints import Keypoints
from recon.io.deeplabcut import write_csv, write_h5
from recon.io.video import require_codec
from recon.keypoint_net.labels import read_labels
from recon.keypoint_net.predict import predict_video
from recon.keypoint_net.report import write_training_report
from recon.keypoint_net.run import CHECKPOINT_FILE, TrainSettings, prepare
from recon.keypoint_net.split import parse_choice, split_labels
from recon.keypoint_net.torch_extra import choose_device, require_torch
from recon.keypoint_net.train import train
from recon.keypoint_net.trained import MODEL_FILE, VIEWS, load_model, model_file

WRITERS = {".csv": write_csv, ".h5": write_h5}


@dataclass(frozen=True)
class LabelSource:
    """Labelled pictures, and which of them to learn from."""

    data: Path
    """A DeepLabCut project folder, or a video with its label file."""
    labels: Path | None = None
    first_frame: int = 0
    """The number that the label file gives to the video's first frame."""
    individual: str | None = None
    validation: str = "0.2"
    """A share of the labelled pictures, or a range "A:B"."""
    test: str = "0"
    """A share of the labelled pictures, or a range "A:B"."""
    rename: str | None = None
    """A map of the labels' names (see `recon.animal.naming`), which the network has."""


def run_training(
    source: LabelSource,
    settings: TrainSettings,
    out: Path,
    *,
    device: str = "auto",
    threads: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:
    """`recon train`: `out` gets the network, a checkpoint and the training report, which is returned.

    Raises InputError, with every problem, before anything is written.
    """
    require_torch()
    chosen, labels, validation, test, _ = all_of(
        lambda: choose_device(device),
        lambda: read_labels(source.data, source.labels, source.first_frame, source.individual, source.rename),
        lambda: parse_choice(source.validation, "--validation"),
        lambda: parse_choice(source.test, "--test"),
        lambda: _check_folder(out, resume, overwrite),
    )
    run = prepare(labels, split_labels(labels, validation, test, settings.seed), settings, chosen)
    with sole_writer(out):
        _check_folder(out, resume, overwrite)
        state = train(run, out, resume, threads, progress)
        progress("report", 1.0)
        with staged_folder(out) as staging:
            return write_training_report(run, state, staging)


def run_prediction(
    video: Path,
    model: Path,
    out: Path,
    *,
    overlay: Path | None = None,
    quality: str = "fast",
    likelihood_min: float = 0.5,
    half: bool = True,
    still_background: bool = True,
    device: str = "auto",
    threads: int | None = None,
    partial: bool = False,
    overwrite: bool = False,
    progress: Progress = silent,
) -> Keypoints:
    """`recon predict`: a keypoint file in DeepLabCut's layout. Raises InputError; then nothing is written."""
    _, chosen, *_ = all_of(
        lambda: model_file(model),
        lambda: choose_device(device),
        lambda: require_free_file(out, overwrite, suffixes=WRITERS),
        lambda: _check_overlay(overlay, overwrite, video),
        lambda: _check_quality(quality),
    )
    trained = load_model(model, chosen)
    keypoints = predict_video(
        trained,
        video,
        quality=quality,
        still_background=still_background,
        half=half,
        overlay=overlay,
        likelihood_min=likelihood_min,
        partial=partial,
        threads=threads,
        progress=progress,
    )
    with staged_file(out) as staged:
        WRITERS[out.suffix.lower()](keypoints, staged)
    return keypoints


def _check_folder(out: Path, resume: bool, overwrite: bool) -> None:
    if resume and not (out / CHECKPOINT_FILE).is_file():
        expected = "one to go on from; without --resume, a new run"
        raise InputError(Problem(out / CHECKPOINT_FILE, "checkpoint", "no such file", expected))
    there = [name for name in (MODEL_FILE, CHECKPOINT_FILE) if (out / name).exists()]
    if there and not resume and not overwrite:
        expected = "a new folder, --resume to go on, or --overwrite to begin again"
        raise InputError(Problem("--out", "folder", f"{out}, which has a {there[0]}", expected))
    if out.exists() and not out.is_dir():
        raise InputError(Problem("--out", "folder", f"{out}, which is a file", "a folder"))


def _check_overlay(overlay: Path | None, overwrite: bool, video: Path) -> None:
    if overlay is None:
        return
    require_codec(overlay)
    require_free_file(overlay, overwrite, "--overlay", video)


def _check_quality(quality: str) -> None:
    if quality not in VIEWS:
        raise InputError(Problem("--quality", "quality", f"'{quality}'", "one of: " + ", ".join(VIEWS)))
