"""The commands `recon train` and `recon predict` of the keypoint network."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from recon.base.numbers import percent, quantity
from recon.base.progress import Progress
from recon.cli.answers import Answer, say, stop
from recon.keypoint_net.settings import PredictSettings, TrainRunSettings
from recon.show.plain import picked


def train_command(settings: TrainRunSettings, console: Console, progress: Progress) -> Answer:
    """Train a small keypoint network on a few labels in DeepLabCut's layout.

    Example: recon train run.mp4 --labels CollectedData_me.csv --out models/run
    """
    from recon.keypoint_net.train import CHECKPOINT_FILE, run_training

    out, options = settings.out, picked(settings, "device", "threads", "resume", "overwrite")
    try:
        announce = partial(say, console)
        report = run_training(settings, settings, out, **options, progress=progress, announce=announce)
    except KeyboardInterrupt:
        message = "the same command with --resume continues from the last checkpoint"
        if not (out / CHECKPOINT_FILE).is_file():
            message = "there is no checkpoint yet"
        stop(f"Stopped: {message}.")
    return Answer(report, _training_lines(report, out))


def _training_lines(report: dict[str, Any], out: Path) -> Iterator[str]:
    from recon.keypoint_net.train import MAX_LEARNED_ERROR

    yield f"{report['steps']} steps in {quantity(report['seconds'], 0, 's')} on {report['device']}."
    best = report["best_validation"]
    if best:
        best_text = quantity(best["median_px"], 2, "px")
        yield f"Validation pictures, before training on them: median error {best_text} at best."
        if best["median_px"] > 2 * (right_px := report["tolerance_px"]):
            yield f"This error is too large to be of use: a point counts as right within {quantity(right_px, 1, 'px')}."
            yield "Train longer (--minutes), or label more."
    if "test" in report["errors"]:
        score = report["errors"]["test"]["all"]
        yield (
            f"Test pictures: median error {quantity(score['median_px'], 2, 'px')}, "
            f"{percent(score['pck_px']['5.0'])} within 5 px."
        )
    if not report["labels_judged"]:
        limit_px = MAX_LEARNED_ERROR * report["tolerance_px"]
        yield (
            "The labels were not checked: the network is off by "
            f"{quantity(report['learned_median_px'], 1, 'px')} (median) in its "
            f"training pictures, and the check needs {quantity(limit_px, 1, 'px')} or less."
        )
    suspects = report["suspicious_labels"]
    if suspects:
        first = suspects[0]
        worst = f"{first['keypoint']} in {first['image']} the most"
        yield f"{len(suspects)} labels look wrong, {worst}: see {out / 'suspicious.csv'}."
    model = shlex.quote(str(out))
    yield f"The network and its report are in {out}. Use it with: recon predict VIDEO --model {model} --out FILE.csv"


def predict_command(settings: PredictSettings, progress: Progress) -> Answer:
    """Find the keypoints in every frame of a video, with a network made by `recon train`.

    Example: recon predict run.mp4 --model models/run --out run.csv --overlay run_points.mp4
    """
    from recon.keypoint_net.network import RING_LIKELIHOOD, run_prediction

    start = time.monotonic()
    keypoints = run_prediction(**picked(settings, *settings.infos()), progress=progress)
    frames, seconds = len(keypoints.frames), time.monotonic() - start
    sure = float((keypoints.confidence >= RING_LIKELIHOOD).mean())
    drawn = f", drawn on the video in {settings.overlay}" if settings.overlay else ""
    speed = f"{frames} frames in {quantity(seconds, 1, 's')} ({frames / seconds:.0f} a second)"
    likely = f"{percent(sure)} of the points have a likelihood of {RING_LIKELIHOOD:g} or more"
    sentence = f"{speed}; {likely}. They are in {settings.out}{drawn}."
    data = {**picked(settings, "out", "overlay"), "frames": frames, "seconds": seconds, "likely_share": sure}
    return Answer(data | {"notes": keypoints.notes}, [sentence], notes=keypoints.notes)
