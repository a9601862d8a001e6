"""The command `recon demo`: reconstruct the bundled sample and compare it with its true poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from recon.api.samples import samples_folder
from recon.api.settings import FitSettings
from recon.base.numbers import quantity
from recon.base.outputs import Output
from recon.base.progress import Progress
from recon.base.settings import Settings
from recon.cli.answers import Answer, answer_of_fit
from recon.cli.look_options import PageSettings
from recon.cli.show import report
from recon.fit.motion import Motion
from recon.show.page.own_page import PAGE


class _DemoSettings(Settings):
    """Settings of `recon demo`."""

    out: Path = Path("demo-output")
    """Folder for the results."""
    overwrite: bool = False
    """Replace results in the folder."""


def demo(settings: _DemoSettings, progress: Progress) -> Answer:
    """Reconstruct the bundled sample, a synthetic gallop with noise, and compare it with the true poses.

    Example: recon demo --out demo-output
    """
    from recon.api.clip_results import run_clip
    from recon.gait.clip import ClipAnalysis
    from recon.gait.evaluation import evaluate_files
    from recon.show.sentences import analysis_sentences

    samples, out = samples_folder(), settings.out
    settings_of_sample = FitSettings(keypoints=(samples / "whole.csv",), camera=(samples / "camera.toml",), fps=60)
    Output(out, "report", True).require((PAGE,))
    fit_report = run_clip(settings_of_sample, out, settings.overwrite, progress)
    page = report(PageSettings(folder=out), progress).data["page"]
    errors = evaluate_files(out / "pose3d.csv", samples / "whole_truth.csv")
    mpjpe_mm, position_mm = 1000 * errors.mpjpe_m.mean, 1000 * errors.position_m
    answer, analysis = answer_of_fit(fit_report, out, page, mpjpe_mm=mpjpe_mm), ClipAnalysis(Motion.load(out))
    error = (
        f"Compared with the sample's true motion, the pose error is {quantity(mpjpe_mm, 0, 'mm')} (MPJPE) and the "
        f"position error {quantity(position_mm, 0, 'mm')}. The sample's camera file is exact; the expected errors "
        "above allow for the errors of real camera files and clips."
    )
    sentences = analysis_sentences(analysis)
    return replace(answer, lines=[*answer.lines, error, *sentences])
