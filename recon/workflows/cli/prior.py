"""`recon prior`."""

from __future__ import annotations

import json

import typer
from rich.text import Text

from recon.workflows.cli.common import table_of, terminal
from recon.workflows.prior import PriorFitSettings, run_prior_fit


def prior_fit(settings: PriorFitSettings, as_json: bool) -> None:
    """Fit a motion prior to results or 3D poses, and list what it was fitted to.

    Example: recon prior fit results/run1 results/run2 --out my-cat.npz
    """
    done = run_prior_fit(settings)
    if as_json:
        typer.echo(json.dumps({"out": str(settings.out), **done.to_dict()}, indent=1))
        return
    table = table_of("segment", numbers=("frames", "fps", "speed m/s", "misfit mm", "used"))
    for row, rms_mm in zip(done.prior.segments, done.rms_mm, strict=True):
        numbers = f"{row.frames}", f"{row.fps:g}", f"{row.speed_m_s:.1f}", f"{rms_mm:.1f}".replace("nan", "-")
        table.add_row(Text(row.name), *numbers, "yes" if row.used else "no")
    terminal().print(table)
    for line in done.notes():
        typer.echo(line)
    typer.echo(f"The prior is in {settings.out}.")
