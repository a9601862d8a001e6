"""The bundled sample, reconstructed and compared with its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from recon.analysis.evaluation import Evaluation, evaluate_files
from recon.errors import InputError, Problem
from recon.pipelines.clip import Progress, run_clip
from recon.settings import FitSettings


def samples_folder() -> Path:
    """Where the samples are: inside an installed package, or in data/samples of a checkout."""
    package = Path(__file__).parents[1]
    for folder in (package / "samples", package.parent / "data" / "samples"):
        if (folder / "noisy.csv").is_file():
            return folder
    raise InputError(Problem("recon", "samples", "no samples beside the package", "a complete installation"))


def run_demo(out: Path, overwrite: bool, progress: Progress) -> tuple[dict[str, Any], Evaluation]:
    """Fit the noisy sample into the folder `out`: the report, and the errors against the sample's truth."""
    samples = samples_folder()
    # The sample has neither head nor tail, and is the chain's gallop.
    settings = FitSettings(
        keypoints=samples / "noisy.csv", camera=samples / "camera.toml", fps=30, skeleton="cheetah-8u"
    )
    report = run_clip(settings, out, overwrite, progress)
    return report, evaluate_files(out / "pose3d.csv", samples / "noisy_truth.csv")
