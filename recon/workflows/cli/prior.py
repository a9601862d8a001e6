"""`recon prior`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer
from rich.text import Text

from recon.animal.prior import FRAMES_PER_COMPONENT
from recon.workflows.cli.common import table_of, terminal
from recon.workflows.prior import PriorFitSettings, run_prior_fit


def prior_fit(settings: PriorFitSettings, as_json: bool) -> Any:
    """Fit a motion prior to results or 3D poses, and list what it was fitted to.

    Example: recon prior fit results/run1 results/run2 --out my-cat.npz
    """
    done = run_prior_fit(settings)
    if as_json:
        return {"out": settings.out, **done}
    table = table_of("segment", numbers=("frames", "fps", "speed m/s", "misfit mm", "used"))
    for row in done["segments"]:
        rms_mm = "-" if row["misfit_mm"] is None else f"{row['misfit_mm']:.1f}"
        numbers = f"{row['frames']}", f"{row['fps']:g}", f"{row['speed_m_s']:.1f}", rms_mm
        table.add_row(Text(row["name"]), *numbers, "yes" if row["used"] else "no")
    terminal().print(table)
    for line in _notes(done):
        typer.echo(line)
    typer.echo(f"The prior is in {settings.out}.")


def _notes(done: dict[str, Any]) -> Iterator[str]:
    """What there is to say beside the table of segments."""
    used, components, held_out = [row["used"] for row in done["segments"]], done["components"], done["held_out"]
    yield f"Used: {sum(used)} of {len(used)} segments, {done['frames']} frames and their mirror images."
    if components < done["components_asked"]:
        place = f"{components} components in place of {done['components_asked']}"
        yield f"{place}: each takes {FRAMES_PER_COMPONENT} frames."
    if done["left_out"]:
        yield f"{done['left_out']} frames of results have a flag or no pose: left out."
    if done["lacking"]:
        yield f"Markers that no file has: {', '.join(done['lacking'])}"
    for path, size in done["sizes"].items():
        if size != 1.0:
            yield f"{path}: {size:.3f} times the skeleton's lengths"
    if held_out is not None:
        yield (
            "Held-out log-likelihood per frame: {mixture:.2f} with {components} components, {one_gaussian:.2f} with "
            "one Gaussian"
        ).format(**held_out)
