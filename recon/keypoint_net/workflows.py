"""The keypoint network: labels in, a trained network out; a video in, a keypoint file out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from recon.base import Progress, silent
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import require_free_file, sole_writer, staged_file, staged_folder
from recon.base.settings import Integer, Option, Settings
from recon.clip.keypoints import Keypoints
from recon.io import FORMATS
from recon.io.video import require_codec
from recon.keypoint_net.labels import read_labels, split_labels
from recon.keypoint_net.network import MODEL_FILE, choose_device, load_model, model_file, require_torch
from recon.keypoint_net.predict import PredictSettings, predict_video
from recon.keypoint_net.report import write_training_report
from recon.keypoint_net.train import CHECKPOINT_FILE, SPLIT, TrainSettings, prepare, train
from recon.workflows.settings import RENAME

WRITERS = {f.suffixes[0]: f.write for f in FORMATS if f.name == "deeplabcut"}


class LabelSource(Settings):
    """Labelled pictures, and which of them to learn from."""

    data: Annotated[
        Path, Option("DeepLabCut project (its folder or config.yaml), or a video (with --labels).", argument="DATA")
    ]
    labels: Annotated[Path | None, Option("Label file of the video, as in CollectedData_me.csv.")] = None
    first_frame: Annotated[
        Integer, Option("Number that the labels give to the video's first frame: 50 where 0050.png is frame 0.")
    ] = 0
    individual: Annotated[str | None, Option("The animal, where the labels name several.")] = None
    rename: Annotated[str | None, RENAME] = None
    validation: Annotated[
        str, Option("Pictures to judge and calibrate by: a share, or frame numbers A:B (B excluded).", panel=SPLIT)
    ] = "0.2"
    test: Annotated[str, Option("Pictures that are only judged at the end, in the same way.", panel=SPLIT)] = "0"


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
    chosen, labels, _ = all_of(
        lambda: choose_device(device),
        lambda: read_labels(source.data, source.labels, source.first_frame, source.individual, source.rename),
        lambda: _check_folder(out, resume, overwrite),
    )
    run = prepare(labels, split_labels(labels, source.validation, source.test, settings.seed), settings, chosen)
    with sole_writer(out):
        _check_folder(out, resume, overwrite)
        state = train(run, out, resume, threads, progress)
        progress("report", 1.0)
        with staged_folder(out) as staging:
            return write_training_report(run, state, staging)


def run_prediction(video: Path, model: Path, out: Path, *, progress: Progress = silent, **options: Any) -> Keypoints:
    """`recon predict`: a keypoint file in DeepLabCut's layout. options: the other fields of `PredictSettings`. Raises
    InputError; then nothing is written."""
    s = PredictSettings(video=video, model=model, out=out, **options)
    _, device, *_ = all_of(
        lambda: model_file(model),
        lambda: choose_device(s.device),
        lambda: require_free_file(out, s.overwrite, suffixes=WRITERS),
        lambda: _check_overlay(s),
    )
    keypoints = predict_video(load_model(model, device), s, progress)
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


def _check_overlay(settings: PredictSettings) -> None:
    if settings.overlay is not None:
        require_codec(settings.overlay)
        require_free_file(settings.overlay, settings.overwrite, "--overlay", settings.video)
