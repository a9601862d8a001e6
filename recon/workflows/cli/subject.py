"""`recon subject`."""

from __future__ import annotations

import json
from collections.abc import Iterator

import typer
from rich.table import Table
from rich.text import Text

from recon.workflows.cli.common import counted, table_of, terminal
from recon.workflows.subject import SubjectFit, SubjectFitSettings, run_subject_fit


def subject_fit(settings: SubjectFitSettings, as_json: bool) -> None:
    """Measure one animal in clips that several cameras filmed, for `recon fit --subject`; without its lengths the
    detector only, for `recon fit --set detector`, also from several measured animals.

    Example: recon subject fit results/run1 results/run2 --offsets --out my-cat.toml
    """
    found = run_subject_fit(settings)
    if as_json:
        typer.echo(json.dumps({"out": str(settings.out), **found.to_dict()}, indent=1))
        return
    for table in _tables(found):
        terminal().print(table)
    if found.fit.shape.lengths:
        typer.echo(f"Size: {found.size:.3f} ± {found.size_sigma:.3f} of the skeleton's lengths.")
    if not found.fit.converged:
        typer.echo("The last step was not small yet: more frames would say more.")
    kind = "subject" if found.fit.shape.lengths else "detector"
    use = f"--subject {settings.out}" if found.fit.shape.lengths else f"--set detector={settings.out}"
    typer.echo(f"From {counted(found.clips, 'clip')}, {found.frames} frames. The {kind} is in {settings.out}.")
    typer.echo(f"Use it with: recon fit {use}")


def _tables(found: SubjectFit) -> Iterator[Table]:
    rows, shape = list(found.rows()), found.fit.shape
    first = len(shape.lengths)
    if shape.lengths:
        table = table_of("length of", numbers=("m", "±"))
        for name, value, sigma, _ in rows[:first]:
            table.add_row(Text(name), f"{value:.3f}", f"{sigma:.3f}")
        yield table
    if shape.offsets:
        table = table_of("keypoint off its marker, mm", numbers=("forwards", "left", "up", "±"))
        for i, name in enumerate(shape.offsets):
            three = rows[first + 3 * i : first + 3 * i + 3]
            sigma = max(s for _, _, s, _ in three)
            table.add_row(Text(name), *(f"{value:.0f}" for _, value, _, _ in three), f"{sigma:.0f}")
        yield table
