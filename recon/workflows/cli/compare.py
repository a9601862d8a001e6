"""`recon compare`."""

from __future__ import annotations

import typer

from recon.workflows.cli.common import counted, progress_bar, say, table_of, terminal
from recon.workflows.compare import FIGURE, QUANTITIES, CompareSettings, run_compare


def compare(settings: CompareSettings, as_json: bool, quiet: bool) -> None:
    """Strides and speeds of several clips, by group: each with its uncertainty, and the groups' means and spreads.

    Example: recon compare results/a results/b results/c --table animals.csv --by sex --out comparison
    """
    console = terminal(quiet=quiet, stderr=as_json)
    with progress_bar(console) as progress:
        made = run_compare(settings, progress)
    if as_json:
        typer.echo(made.groups.to_json(orient="records", indent=1))
        return
    levels = made.clips["verdict"].value_counts()
    say(console, f"{counted(len(made.clips), 'clip')}: " + ", ".join(f"{n} {level}" for level, n in levels.items()))
    table = table_of("group", numbers=("clips", "strides", *QUANTITIES), title="mean ± its sigma (spread of clips)")
    for row in made.groups.to_dict("records"):
        cells = [f"{row[q]:.3g} ± {row[f'{q}_sigma']:.2g} ({row[f'{q}_spread']:.2g})" for q in QUANTITIES]
        table.add_row(str(row["group"]), str(row["clips"]), str(row["strides"]), *cells)
    console.print(table)
    say(console, f"Rows by stride, clip and group, and {FIGURE}, are in {made.out}.")
