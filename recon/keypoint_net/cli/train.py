"""`recon train`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from recon.workflows.cli.common import RENAME, number_option, progress_bar, say, stop, terminal

if TYPE_CHECKING:
    from collections.abc import Iterator

TRAINING = "Training"
SPLIT = "Which pictures"


def train(
    data: Annotated[Path, typer.Argument(help="DeepLabCut project folder, or a video (with --labels).")],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for the network and its report, as in models/horse.")
    ],
    labels: Annotated[Path | None, typer.Option(help="Label file of the video, as in CollectedData_me.csv.")] = None,
    first_frame: Annotated[
        int, typer.Option(help="Number that the labels give to the video's first frame: 50 where 0050.png is frame 0.")
    ] = 0,
    individual: Annotated[str | None, typer.Option(help="The animal, where the labels name several.")] = None,
    rename: Annotated[str | None, RENAME] = None,
    validation: Annotated[
        str,
        typer.Option(
            help="Pictures to judge and calibrate by: a share, or frame numbers A:B (B excluded).",
            rich_help_panel=SPLIT,
        ),
    ] = "0.2",
    test: Annotated[
        str, typer.Option(help="Pictures that are only judged at the end, in the same way.", rich_help_panel=SPLIT)
    ] = "0",
    finish: Annotated[
        bool,
        typer.Option(
            "--finish/--no-finish", help="Learn from the validation pictures, too, at the end.", rich_help_panel=SPLIT
        ),
    ] = True,
    minutes: Annotated[
        float, number_option("Time to train.", "minutes above 0, as in 15", rich_help_panel=TRAINING)
    ] = 15.0,
    steps: Annotated[
        int | None,
        typer.Option(help="Steps to train, instead of a time: the same in every run.", rich_help_panel=TRAINING),
    ] = None,
    batch: Annotated[int, typer.Option(help="Pictures in a step.", rich_help_panel=TRAINING)] = 8,
    seed: Annotated[int, typer.Option(help="Of weights, split and augmentation.", rich_help_panel=TRAINING)] = 0,
    mirror: Annotated[
        bool,
        typer.Option(
            "--mirror/--no-mirror",
            help="Train on mirror pictures, too, in which left and right, or near and off, change their names: for "
            "animals that are labelled going one way and filmed going both. Takes longer to learn.",
            rich_help_panel=TRAINING,
        ),
    ] = False,
    patience: Annotated[
        int, typer.Option(help="Evaluations without improvement before stopping early.", rich_help_panel=TRAINING)
    ] = 12,
    half: Annotated[
        bool,
        typer.Option(
            "--half/--no-half",
            help="Compute in 16 bits where the device is faster with them.",
            rich_help_panel=TRAINING,
        ),
    ] = True,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda or mps.")] = "auto",
    threads: Annotated[int | None, typer.Option(help="Threads on the CPU. (default: the fastest)")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint in DIR.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Begin again in a DIR that has a network.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Train a small keypoint network on a few labels in DeepLabCut's layout.

    Example: recon train run.mp4 --labels CollectedData_me.csv --out models/run
    """
    from recon.keypoint_net.run import CHECKPOINT_FILE, TrainSettings
    from recon.keypoint_net.workflows import LabelSource, run_training

    settings = TrainSettings(
        steps=steps,
        minutes=minutes,
        batch=batch,
        seed=seed,
        mirror=mirror,
        patience=patience,
        finish=finish,
        half=half,
    )
    console = terminal(quiet=quiet)
    try:
        with progress_bar(console) as progress:
            report = run_training(
                LabelSource(data, labels, first_frame, individual, validation, test, rename),
                settings,
                out,
                device=device,
                threads=threads,
                resume=resume,
                overwrite=overwrite,
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
    early = ", stopped early" if report["stopped_early"] else ""
    yield f"{report['steps']} steps in {report['seconds']:.0f} s on {report['device']}{early}."
    if report["device"] == "cpu":
        timed = ", ".join(f"{1000 * s:.0f} ms with {n}" for n, s in report["step_s_by_threads"].items())
        yield f"Threads: {report['threads']}{timed and f' (a step took {timed})'}; --threads chooses others."
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
