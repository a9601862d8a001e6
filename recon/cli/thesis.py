"""Define the commands of the published system: `recon frame` fits a clip, `recon solver` describes the optimisation."""

from __future__ import annotations

from typing import Annotated, Any

from rich.console import Console

from recon.api.settings import SETTINGS, FitSettings
from recon.base.progress import Progress
from recon.cli.answers import Answer
from recon.cli.commands import OptionsOf
from recon.cli.fit import FitRunSettings, fit
from recon.thesis.clip import SolverSettings, run_solver

_OPTIONS = tuple(name for name, info in SETTINGS.items() if name != "method" and info.option.method in (None, "frame"))


def frame(
    settings: FitRunSettings,
    options: Annotated[dict[str, Any], OptionsOf(FitSettings, _OPTIONS, promoted=("start_angles",))],
    console: Console,
    progress: Progress,
) -> Answer:
    """Fit one side of the animal as a chain, frame by frame, with the method of the thesis, for comparison.

    Example: recon frame clip.csv --camera scene.json --camera-name cam2 --fps 90 --out results/clip

    Exit code 0: finished. 1: no frame could be solved. 2: the input cannot be used.
    """
    return fit(settings, {**options, "method": "frame"}, console, progress)


def solver(settings: SolverSettings, progress: Progress) -> Answer:
    """Show how the optimiser of `recon frame` worked: cost, gradient, Jacobian, limits.

    Writes tables (CSV), the Jacobian (NPZ) and figures (PNG, SVG).

    Example: recon solver results/clip
    """
    summary, files = run_solver(settings, progress)
    return Answer(summary, [f"{len(files)} files are in {settings.out_folder}."])
