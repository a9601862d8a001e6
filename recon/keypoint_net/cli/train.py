"""The command `recon train`: its options, and what it prints."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from recon.base.settings import Count, Option
from recon.keypoint_net.network import DEVICE, THREADS
from recon.keypoint_net.train import CHECKPOINT_FILE, TrainSettings
from recon.keypoint_net.workflows import LabelSource, run_training
from recon.workflows.cli.common import progress_bar, say, stop, terminal


class _TrainRunSettings(LabelSource, TrainSettings):
    """What `recon train` does: labels, how to learn from them, and where and with what."""

    out: Annotated[Path, Option("Folder for the network and its report, as in models/horse.", metavar="DIR")]
    device: Annotated[str, DEVICE] = "auto"
    threads: Annotated[Count | None, THREADS] = None
    resume: Annotated[bool, Option("Go on from the checkpoint in DIR.")] = False
    overwrite: Annotated[bool, Option("Begin again in a DIR that has a network.")] = False


def train(settings: _TrainRunSettings, quiet: bool) -> None:
    """Train a small keypoint network on a few labels in DeepLabCut's layout.

    Example: recon train run.mp4 --labels CollectedData_me.csv --out models/run
    """
    out = settings.out
    console = terminal(quiet=quiet)
    try:
        with progress_bar(console) as progress:
            report = run_training(
                settings,
                settings,
                out,
                device=settings.device,
                threads=settings.threads,
                resume=settings.resume,
                overwrite=settings.overwrite,
                progress=progress,
            )
    except KeyboardInterrupt:
        message = "the same command with --resume goes on from the last checkpoint"
        if not (out / CHECKPOINT_FILE).is_file():
            message = "there is no checkpoint yet"
        stop(f"Stopped: {message}.")
    for line in _summary(report, out):
        say(console, line)


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
