"""Settings of the commands for keypoints from video, which the command line reads without the libraries of the work."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from recon.api.options import RENAME
from recon.api.settings import FrameRange
from recon.base.settings import Count, Integer, Number, Option, Positive, Settings

DEVICE = Option("Device on which the network runs: auto, cpu, cuda or mps.")
THREADS = Option("Threads on the CPU. (default: one for each core)", "1 or more")
_SPLIT = "Split of the pictures"
_TRAINING = "Training"


class LabelSource(Settings):
    """Labelled pictures, and how they are split for training, validation and test."""

    data: Annotated[Path, Option(argument="DATA")]
    """DeepLabCut project (its folder or config.yaml), or a video (with --labels)."""
    labels: Path | None = None
    """Label file of the video, such as CollectedData_me.csv."""
    first_frame: Integer = 0
    """Frame number that the labels use for the video's first frame, such as 50 if 0050.png is the first frame."""
    individual: str | None = None
    """Name of the animal, if the labels have several animals."""
    rename: Annotated[str | None, RENAME] = None
    validation: Annotated[str, Option(panel=_SPLIT)] = "0.2"
    """Pictures for validation and calibration, as a fraction or as frame numbers A:B (B excluded)."""
    test: Annotated[str, Option(panel=_SPLIT)] = "0"
    """Pictures for the final test only, in the form of --validation."""


class TrainSettings(Settings):
    """Settings for training a network."""

    minutes: Annotated[
        Number, Field(ge=0.05), Option("Time to train, minutes.", "0.05 minutes or more", panel=_TRAINING)
    ] = 15.0
    steps: Annotated[Count | None, Option(expected="1 or more", panel=_TRAINING)] = None
    """Number of steps, instead of a time; runs with the same number of steps give the same result."""
    batch: Annotated[Count, Option(expected="1 or more", panel=_TRAINING)] = 8
    """Number of pictures per step."""
    seed: Annotated[
        Integer, Field(ge=0), Option("Seed of weights, split and augmentation.", "0 or more", panel=_TRAINING)
    ] = 0
    mirror: Annotated[bool, Option(panel=_TRAINING)] = False
    """Also train on mirrored pictures with left and right names exchanged, for animals that run both ways but are
    labelled running one way. Training takes longer.
    """

    def of_training(self) -> dict[str, Any]:
        """Return the training settings alone, without the fields of subclasses."""
        return {name: getattr(self, name) for name in TrainSettings.infos()}


class TrainRunSettings(LabelSource, TrainSettings):
    """Settings of `recon train`."""

    out: Annotated[Path, Option(metavar="DIR")]
    """Folder for the network and its report, such as models/horse."""
    device: Annotated[str, DEVICE] = "auto"
    threads: Annotated[Count | None, THREADS] = None
    resume: bool = False
    """Continue from the checkpoint in DIR."""
    overwrite: bool = False
    """Start again if DIR already has a network."""


class PredictSettings(Settings):
    """Settings of `recon predict`."""

    video: Annotated[Path, Option(argument="VIDEO")]
    """Video file, such as run.mp4."""
    model: Annotated[Path, Option(metavar="DIR")]
    """Folder of a trained network, such as models/run."""
    out: Path
    """Keypoint file to write, .csv or .h5, in DeepLabCut's layout."""
    overlay: Path | None = None
    """Also write a video with the points drawn on it, as .mp4 (MPEG-4), .webm (VP8) or .avi (Motion JPEG)."""
    device: Annotated[str, DEVICE] = "auto"
    threads: Annotated[Count | None, THREADS] = None
    partial: bool = False
    """Accept a video with fewer decodable frames than its header states."""
    overwrite: bool = False
    """Replace existing files."""


class Evaluate2DSettings(Settings):
    """Settings of `recon evaluate-2d`."""

    predicted: Annotated[Path, Option(argument="PREDICTED")]
    """Predicted keypoints in any known format, such as run.csv."""
    labels: Annotated[Path, Option(argument="LABELS")]
    """Labels in DeepLabCut's layout, such as CollectedData_me.csv."""
    first_frame: Integer = 0
    """Frame number that the labels use for frame 0 of the predictions."""
    frames: FrameRange | None = None
    """Frame numbers of the labels to compare, A:B (B excluded)."""
    individual: str | None = None
    """Name of the animal, if the files have several animals."""
    rename: Annotated[str | None, RENAME] = None
    likelihood_min: Annotated[Number, Option(expected="a number from 0 to 1")] = 0.5
    """Smallest likelihood of a point that counts as likely."""
    tolerance_px: Annotated[Positive, Option(expected="pixels above 0")] = 5.0
    """Largest distance of a correct point from its label, for the reliability of the likelihoods."""
