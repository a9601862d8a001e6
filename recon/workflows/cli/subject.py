"""`recon subject`."""

from __future__ import annotations

from typing import Any

import typer
from rich.text import Text

from recon.workflows.cli.common import counted, table_of, terminal
from recon.workflows.subject import SubjectFitSettings, run_subject_fit


def subject_fit(settings: SubjectFitSettings, as_json: bool) -> Any:
    """Measure one animal in clips that several cameras filmed, for `recon fit --subject`; without its lengths the
    detector only, for `recon fit --set detector`, also from several measured animals.

    Example: recon subject fit results/run1 results/run2 --offsets --out my-cat.toml
    """
    found = run_subject_fit(settings)
    if as_json:
        return {"out": settings.out, **found}
    lengths, offsets = ([row for row in found["values"] if row["unit"] == unit] for unit in ("m", "mm"))
    if lengths:
        table = table_of("length of", numbers=("m", "±"))
        for row in lengths:
            table.add_row(Text(row["name"]), f"{row['value']:.3f}", f"{row['sigma']:.3f}")
        terminal().print(table)
    if offsets:
        table = table_of("keypoint off its marker, mm", numbers=("forwards", "left", "up", "±"))
        for three in zip(offsets[::3], offsets[1::3], offsets[2::3], strict=True):
            sigma = max(row["sigma"] for row in three)
            name = three[0]["name"].removesuffix("_x")
            table.add_row(Text(name), *(f"{row['value']:.0f}" for row in three), f"{sigma:.0f}")
        terminal().print(table)
    if lengths:
        typer.echo(f"Size: {found['size']:.3f} ± {found['size_sigma']:.3f} of the skeleton's lengths.")
    if not found["converged"]:
        typer.echo("The last step was not small yet: more frames would say more.")
    kind, use = ("subject", "--subject ") if lengths else ("detector", "--set detector=")
    typer.echo(f"From {counted(found['clips'], 'clip')}, {found['frames']} frames. The {kind} is in {settings.out}.")
    typer.echo(f"Use it with: recon fit {use}{settings.out}")
