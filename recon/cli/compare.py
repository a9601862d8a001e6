"""The command `recon compare`: compare strides and speeds of several clips by group."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from textwrap import fill

import pandas as pd
from rich.table import Table

from recon.api.compare import FIGURE, QUANTITIES, CompareSettings, known_quantities, run_compare
from recon.base.numbers import counted
from recon.base.progress import Progress
from recon.cli.answers import Answer, table_of
from recon.show.page.own_page import COMPARE_PAGE


def compare(settings: CompareSettings, progress: Progress) -> Answer:
    """Compare strides and speeds of several clips by group, with uncertainties, group means and spreads.

    Example: recon compare results/a results/b results/c --table animals.csv --by sex --out comparison
    """
    comparison = run_compare(settings, progress)
    groups, notes = comparison.groups, comparison.notes
    data = {"groups": groups.to_dict("records"), "left_out": comparison.left_out, "notes": notes}
    return Answer(data, _lines(comparison.clips, groups, settings.out), notes=notes)


def _lines(clips: pd.DataFrame, groups: pd.DataFrame, out: Path) -> Iterator[str | Table]:
    levels = clips["verdict"].value_counts()
    yield f"{counted(len(clips), 'clip')}: " + ", ".join(f"{count} {level}" for level, count in levels.items())
    known = clips.groupby("group")[[*QUANTITIES]].count()
    rows = (
        (
            *map(
                str,
                (fill(row["group"], 20), QUANTITIES[quantity][0], known.loc[row["group"], quantity], row["strides"]),
            ),
            *_cells(row[quantity], row[f"{quantity}_sigma"], row[f"{quantity}_spread"]),
        )
        for row in groups.to_dict("records")
        for quantity in QUANTITIES
    )
    yield table_of("group", "quantity", numbers=("clips", "strides", "mean", "±", "spread"), rows=rows)
    yield "±: one standard deviation of the mean, with the size's; spread: one standard deviation between the clips."
    if missing := [QUANTITIES[quantity][0] for quantity in QUANTITIES if quantity not in known_quantities(clips)]:
        reason = "No clip has a complete stride: no" if not groups["strides"].sum() else "No clip has a known"
        yield f"{reason} {', '.join(missing)}."
    yield f"Rows by stride, clip and group (CSV and Parquet), and {FIGURE}, are in {out}."
    yield f"Open {out / COMPARE_PAGE} in a browser."


def _cells(mean: float, sigma: float, spread: float) -> tuple[str, ...]:
    shown = f"{mean:.3g}", f"{sigma:.2g}", f"{spread:.2g}"
    return tuple("-" if text == "nan" else text for text in shown)
