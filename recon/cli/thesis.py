"""Define the commands of the published system: `recon frame` fits a clip, `recon solver` describes the optimisation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from rich.console import Console

from recon.api.settings import SETTINGS, FitSettings
from recon.base.numbers import counted, percent, quantity
from recon.base.progress import Progress
from recon.cli.answers import Answer
from recon.cli.commands import OptionsOf
from recon.cli.fit import FitRunSettings, fit
from recon.thesis.settings import SolverSettings

_OPTIONS = tuple(name for name, info in SETTINGS.items() if name != "method" and info.option.method in (None, "frame"))


def frame(
    settings: FitRunSettings,
    options: Annotated[dict[str, Any], OptionsOf(FitSettings, _OPTIONS, promoted=("start_angles", "camera_rotation"))],
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

    The results are tables (CSV), the Jacobian (NPZ) and figures (PNG, SVG).

    Example: recon solver results/clip
    """
    from recon.thesis.clip import run_solver

    summary, files = run_solver(settings, progress)
    return Answer(summary, [*_solver_lines(summary), f"{len(files)} files are in {settings.out_folder}."])


def _solver_lines(summary: dict[str, Any]) -> Iterator[str]:
    """Yield sentences on how the search ended, its effort, the errors in the picture, and the terms of the cost."""
    from recon.thesis.inspect import PUBLISHED

    yield f"{summary['frames_converged']} of {counted(summary['frames'], 'frame')} converged."
    effort = (
        f"{row['median']:.0f} {name} ({row['min']:.0f} to {row['max']:.0f})"
        for name, row in (
            ("iterations", summary["iterations_by_frame"]),
            ("evaluations", summary["evaluations_by_frame"]),
        )
    )
    yield f"A frame took {' and '.join(effort)}, median and range."
    worst = summary["worst_joint"]
    yield (
        f"Error in the picture: {quantity(summary['image_error_px']['mean'], 1, 'px')} on average, largest at "
        f"{worst['name']} ({quantity(worst['mean_px'], 1, 'px')})."
    )
    costs = summary["cost_by_term"]
    total = sum(costs.values()) or 1.0
    parts = {name: costs.get(term, 0.0) / total for name, term in PUBLISHED.items()}
    parts["priors and other terms"] = max(1.0 - sum(parts.values()), 0.0)
    yield f"Fractions of the cost: {', '.join(f'{name} {percent(fraction)}' for name, fraction in parts.items())}."
