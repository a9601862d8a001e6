"""`recon train` and `recon predict`: labels in, a trained network out; a video in, a keypoint file out.

The frames of a video go through the network in batches, the next ones decoded meanwhile. Pictures are held for a few
batches only; what grows with the video are the points, 12 bytes each.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import ExitStack, closing
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from recon.base import Progress, silent
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import require_free_file, sole_writer, staged_file, staged_folder
from recon.base.settings import Count, Integer, Option, Settings
from recon.clip import Keypoints
from recon.io import FORMATS
from recon.io.video import Image, VideoInfo, missing_note, probe, require_codec, timed_frames, video_writer
from recon.show.overlay import draw_circle
from recon.show.plain import picked
from recon.wings.keypoint_net import network as net
from recon.wings.keypoint_net.labels import read_labels, resize, split_labels
from recon.wings.keypoint_net.pictures import ahead, background_of_video
from recon.wings.keypoint_net.train import (
    CHECKPOINT_FILE,
    SPLIT,
    TrainSettings,
    point_colours,
    prepare,
    train,
    write_training_report,
)
from recon.workflows.cli import Answer, stop
from recon.workflows.settings import RENAME

WRITERS = {f.suffixes[0]: f.write for f in FORMATS if f.name == "deeplabcut"}


class LabelSource(Settings):
    """Labelled pictures, and which of them to learn from."""

    data: Annotated[Path, Option(argument="DATA")]
    """DeepLabCut project (its folder or config.yaml), or a video (with --labels)."""
    labels: Path | None = None
    """Label file of the video, as in CollectedData_me.csv."""
    first_frame: Integer = 0
    """Number that the labels give to the video's first frame: 50 where 0050.png is frame 0."""
    individual: str | None = None
    """The animal, where the labels name several."""
    rename: Annotated[str | None, RENAME] = None
    validation: Annotated[str, Option(panel=SPLIT)] = "0.2"
    """Pictures to judge and calibrate by: a share, or frame numbers A:B (B excluded)."""
    test: Annotated[str, Option(panel=SPLIT)] = "0"
    """Pictures that are only judged at the end, in the same way."""


class _TrainRunSettings(LabelSource, TrainSettings):
    """What `recon train` does: labels, how to learn from them, and where and with what."""

    out: Annotated[Path, Option(metavar="DIR")]
    """Folder for the network and its report, as in models/horse."""
    device: Annotated[str, net.DEVICE] = "auto"
    threads: Annotated[Count | None, net.THREADS] = None
    resume: bool = False
    """Go on from the checkpoint in DIR."""
    overwrite: bool = False
    """Begin again in a DIR that has a network."""


def train_command(settings: _TrainRunSettings, progress: Progress) -> Answer:
    """Train a small keypoint network on a few labels in DeepLabCut's layout.

    Example: recon train run.mp4 --labels CollectedData_me.csv --out models/run
    """
    out, how = settings.out, picked(settings, "device", "threads", "resume", "overwrite")
    try:
        report = run_training(settings, settings, out, **how, progress=progress)
    except KeyboardInterrupt:
        message = "the same command with --resume goes on from the last checkpoint"
        if not (out / CHECKPOINT_FILE).is_file():
            message = "there is no checkpoint yet"
        stop(f"Stopped: {message}.")
    return Answer(report, _summary(report, out))


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
    net.require_torch()
    chosen, labels, _ = all_of(
        lambda: net.choose_device(device),
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


def _summary(report: dict[str, Any], out: Path) -> Iterator[str]:
    yield f"{report['steps']} steps in {report['seconds']:.0f} s on {report['device']}."
    best = report["best_validation"]
    if best:
        yield f"Validation pictures, before any was learned from: median error {best['median_px']:.2f} px at best."
        if best["median_px"] > 2 * report["tolerance_px"]:
            yield (
                f"That is too far off to be of use: a point counts as right within {report['tolerance_px']:.1f} px. "
                "Train longer (--minutes), or label more."
            )
    if "test" in report["errors"]:
        score = report["errors"]["test"]["all"]
        yield f"Test pictures: median error {score['median_px']:.2f} px, {score['pck_px']['5.0']:.0%} within 5 px."
    suspects = report["suspicious_labels"]
    if suspects:
        first = suspects[0]
        yield (
            f"{len(suspects)} labels look wrong, {first['keypoint']} in {first['image']} the most: "
            f"see {out / 'suspicious.csv'}."
        )
    yield f"The network and its report are in {out}. Use it with: recon predict VIDEO --model {out} --out FILE.csv"


def _check_folder(out: Path, resume: bool, overwrite: bool) -> None:
    if resume and not (out / CHECKPOINT_FILE).is_file():
        expected = "one to go on from; without --resume, a new run"
        raise InputError(Problem(out / CHECKPOINT_FILE, "checkpoint", "no such file", expected))
    there = [name for name in (net.MODEL_FILE, CHECKPOINT_FILE) if (out / name).exists()]
    if there and not resume and not overwrite:
        expected = "a new folder, --resume to go on, or --overwrite to begin again"
        raise InputError(Problem("--out", "folder", f"{out}, which has a {there[0]}", expected))
    if out.exists() and not out.is_dir():
        raise InputError(Problem("--out", "folder", f"{out}, which is a file", "a folder"))


# -- prediction --------------------------------------------------------------------------------------------------------

LIKELY = 0.5
"""Points less likely than this are rings in the overlay."""
PIXELS = 2**20
"""The most pixels of a batch, at the network's scale."""
WAITING = 2
"""Batches that are decoded ahead."""
LOST_SHARE, LOST_FRAMES = 0.01, 3
"""So many frames fewer than the video states are its count's fault; more are the video's."""

_Chunk = tuple[list[int], list[float], list[Image], list[Image]]
"""Numbers of consecutive frames, their time stamps in seconds, their pictures at the network's scale, and as they
are, if they are drawn on."""


class PredictSettings(Settings):
    """What `recon predict` finds, and where."""

    video: Annotated[Path, Option(argument="VIDEO")]
    """The video, as in run.mp4."""
    model: Annotated[Path, Option(metavar="DIR")]
    """Folder of a trained network, as in models/run."""
    out: Path
    """The keypoint file, .csv or .h5, in DeepLabCut's layout."""
    overlay: Path | None = None
    """A new video with the points drawn, .mp4 (MPEG-4) or .avi (Motion JPEG)."""
    device: Annotated[str, net.DEVICE] = "auto"
    threads: Annotated[Count | None, net.THREADS] = None
    partial: bool = False
    """Accept a video of which fewer frames can be decoded than it states."""
    overwrite: bool = False
    """Replace files that are there."""


def predict_command(settings: PredictSettings, progress: Progress) -> Answer:
    """Find the keypoints in every frame of a video, with a network that `recon train` made.

    Example: recon predict run.mp4 --model models/run --out run.csv --overlay run_points.mp4
    """
    start = time.monotonic()
    keypoints = run_prediction(**picked(settings, *settings.infos()), progress=progress)
    frames, seconds = len(keypoints.frames), time.monotonic() - start
    sure = float((keypoints.confidence >= LIKELY).mean())
    drawn = f", drawn on the video in {settings.overlay}" if settings.overlay else ""
    said = (
        f"{frames} frames in {seconds:.1f} s ({frames / seconds:.0f} a second); {sure:.0%} of the points have a "
        f"likelihood of {LIKELY:g} or more. They are in {settings.out}{drawn}."
    )
    data = {**picked(settings, "out", "overlay"), "frames": frames, "seconds": seconds, "likely_share": sure}
    return Answer(data | {"notes": keypoints.notes}, [said, *(f"note: {note}" for note in keypoints.notes)])


def run_prediction(video: Path, model: Path, out: Path, *, progress: Progress = silent, **options: Any) -> Keypoints:
    """`recon predict`: a keypoint file in DeepLabCut's layout. options: the other fields of `PredictSettings`. Raises
    InputError; then nothing is written."""
    s = PredictSettings(video=video, model=model, out=out, **options)
    _, device, *_ = all_of(
        lambda: net.model_file(model),
        lambda: net.choose_device(s.device),
        lambda: require_free_file(out, s.overwrite, suffixes=WRITERS),
        lambda: _check_overlay(s),
    )
    keypoints = predict_video(net.load_model(model, device), s, progress)
    with staged_file(out) as staged:
        WRITERS[out.suffix.lower()](keypoints, staged)
    return keypoints


def _check_overlay(settings: PredictSettings) -> None:
    if settings.overlay is not None:
        require_codec(settings.overlay)
        require_free_file(settings.overlay, settings.overwrite, "--overlay", settings.video)


def predict_video(trained: net.TrainedNetwork, settings: PredictSettings, progress: Progress = silent) -> Keypoints:
    """Every frame's points as the network sees them, without smoothing, with calibrated likelihoods. Raises
    InputError."""
    video, spec = settings.video, trained.spec
    info = probe(video)
    progress("background", 0.0)
    background = background_of_video(video, spec.scale)
    net.use_threads(settings.threads)
    numbers: list[int] = []
    times_s: list[float] = []
    xy_px: list[NDArray[np.float32]] = []
    likelihood: list[NDArray[np.float32]] = []
    total = max(info.stated_frames or 0, 1)
    with ExitStack() as stack:
        write = None
        if settings.overlay is not None:
            even = (info.size_px[0] // 2 * 2, info.size_px[1] // 2 * 2)
            write = stack.enter_context(video_writer(settings.overlay, even, info.fps or 30.0))
        made = _chunks(video, info, spec.scale, keep=write is not None)
        for of_chunk, stamps_s, pictures, originals in stack.enter_context(closing(ahead(made, 1 + WAITING))):
            xy, raw = trained.points(pictures, background)
            sure = net.calibrated(raw, spec.calibration)
            numbers += of_chunk
            times_s += stamps_s
            xy_px.append(xy.astype(np.float32))
            likelihood.append(sure.astype(np.float32))
            if write is not None:
                for picture, points, how in zip(originals, xy, sure, strict=True):
                    drawn = draw_points(picture, points, how)
                    write(drawn[: drawn.shape[0] // 2 * 2, : drawn.shape[1] // 2 * 2])
            progress(f"frame {numbers[-1]}", min(1.0, len(numbers) / total))
        lost = (stated := info.stated_frames or 0) - len(numbers)
        if not settings.partial and lost > max(LOST_FRAMES, LOST_SHARE * stated):
            expected = f"the {stated} that the file states; --partial takes what can be decoded"
            raise InputError(Problem(video, "frames", f"{len(numbers)} that can be decoded", expected))
    note = missing_note(video, np.array(times_s))
    return Keypoints(
        spec.names,
        np.concatenate(xy_px).astype(float),
        np.concatenate(likelihood).astype(float),
        np.array(numbers, dtype=np.int64),
        fps=info.fps,
        image_size_px=info.size_px,
        source=str(video),
        notes=() if note is None else (note,),
    )


def _chunks(video: Path, info: VideoInfo, scale: float, keep: bool) -> Generator[_Chunk]:
    """The frames of a video in batches. keep: the original pictures, too."""
    width, height = info.size_px
    size = int(np.clip(PIXELS / (width * height * scale**2), 1, 32))
    frames = timed_frames(video)
    while some := list(islice(frames, size)):
        numbers, times_s, pictures = (list(column) for column in zip(*some, strict=True))
        yield numbers, times_s, [resize(picture, scale) for picture in pictures], pictures if keep else []


def draw_points(picture: Image, xy_px: Array, likelihood: Array) -> Image:
    """A copy with dots at points (K, 2); those less likely than `LIKELY` are rings."""
    drawn = picture.copy()
    radius = max(2.0, max(picture.shape[:2]) / 160)
    for at, how, colour in zip(xy_px, likelihood, point_colours(len(xy_px)), strict=True):
        if np.isfinite(at).all():
            likely = how >= LIKELY
            if likely:
                draw_circle(drawn, at, radius + 1, (0, 0, 0), -1)
            draw_circle(drawn, at, radius if likely else 0.7 * radius, colour, -1 if likely else 1)
    return drawn
