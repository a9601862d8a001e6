"""The bundled sample, reconstructed and compared with its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from recon.base.errors import InputError, Problem
from recon.base.progress import Progress
from recon.fit.motion import Motion
from recon.gait.evaluation import Evaluation, evaluate_files
from recon.show.page.clip import in_sentences
from recon.workflows.clip_results import run_clip
from recon.workflows.page import PageSettings, run_page
from recon.workflows.settings import FitSettings


def samples_folder() -> Path:
    """Where the samples are: inside an installed package, or in data/samples of a checkout."""
    package = Path(__file__).parents[1]
    for folder in (package / "samples", package.parent / "data" / "samples"):
        if (folder / "whole.csv").is_file():
            return folder
    raise InputError(Problem("recon", "samples", "no samples beside the package", "a complete installation"))


def run_demo(out: Path, overwrite: bool, progress: Progress) -> tuple[dict[str, Any], Evaluation, list[str], Path]:
    """Fit the whole animal of the samples into the folder `out`: the report, its errors against the truth, what was
    found in sentences, and the page."""
    samples = samples_folder()
    camera = samples / "camera.toml"
    settings = FitSettings(keypoints=(samples / "whole.csv",), camera=(camera,), fps=60)
    report = run_clip(settings, out, overwrite, progress)
    found = in_sentences(Motion.load(out))
    page = run_page(PageSettings(folder=out), progress)
    return report, evaluate_files(out / "pose3d.csv", samples / "whole_truth.csv"), found, page
