"""`recon subject`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from recon.workflows.cli.common import counted, table_of, terminal

if TYPE_CHECKING:
    from recon.workflows.subject import SubjectFit


def subject_fit(
    clips: Annotated[
        list[Path],
        typer.Argument(metavar="CLIPS", help="Results of recon fit with several cameras, or their config.toml."),
    ],
    out: Annotated[Path, typer.Option(help="File for the subject, as in my-cat.toml.")],
    lengths: Annotated[
        bool, typer.Option("--lengths/--no-lengths", help="Measure the lengths of the segments, left equal to right.")
    ] = True,
    offsets: Annotated[
        bool,
        typer.Option("--offsets/--no-offsets", help="Measure where the detector's keypoints lie beside the markers."),
    ] = False,
    poses: Annotated[
        list[Path] | None,
        typer.Option(
            help="3D poses of a clip that another method knows, in the cameras' world, once for each clip: offsets are "
            "measured beside these."
        ),
    ] = None,
    title: Annotated[str | None, typer.Option(help="Of the animal, in words. (default: made up)")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the table as JSON.")] = False,
) -> None:
    """Measure one animal in clips that several cameras filmed, for `recon fit --subject`; without its lengths the
    detector only, for `recon fit --set detector`, also from several measured animals.

    Example: recon subject fit results/run1 results/run2 --offsets --out my-cat.toml
    """
    from recon.workflows.subject import run_subject_fit

    found = run_subject_fit(clips, out, lengths, offsets, title, overwrite, poses or ())
    if as_json:
        typer.echo(json.dumps({"out": str(out), **found.to_dict()}, indent=1))
        return
    for table in _tables(found):
        terminal().print(table)
    if found.fit.shape.lengths:
        typer.echo(f"Size: {found.size:.3f} ± {found.size_sigma:.3f} of the skeleton's lengths.")
    if not found.fit.converged:
        typer.echo("The last step was not small yet: more frames would say more.")
    kind = "subject" if found.fit.shape.lengths else "detector"
    typer.echo(
        f"From {counted(found.clips, 'clip')}, {found.frames} frames. The {kind} is in {out}: recon fit --{kind} {out}"
    )


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
