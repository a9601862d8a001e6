"""`recon convert`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from recon.base.errors import InputError, Problem
from recon.workflows.cli.common import FPS, RENAME, number_option, table_of, terminal

if TYPE_CHECKING:
    from recon.workflows.convert import Conversion


def convert(
    source: Annotated[
        Path | None,
        typer.Argument(metavar="IN", help="File, or folder of results, as in results/clip.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Argument(metavar="OUT", help="File to write, as in clip.trc.", show_default=False)
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(help="Format, where the extension has several, as in long or sleap. (default: see --list)"),
    ] = None,
    fps: Annotated[
        float | None, number_option("Frame rate in Hz, as in 120, if the file does not say it or is wrong.", FPS)
    ] = None,
    individual: Annotated[str | None, typer.Option(help="Which animal of a multi-animal file, as in animal1.")] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            help="Columns of a plain CSV, as in 'frame=Frame,bodypart=Node,x=X,y=Y,likelihood=Score', or for one row "
            "per frame 'frame=Frame,x={bodypart} X,y={bodypart} Y'. (default: by their names)"
        ),
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="Unit of 3D positions, if the file does not say it: m, cm or mm.")
    ] = None,
    up: Annotated[
        str | None,
        typer.Option(help="Axis of 3D positions that points up, if the file does not say it: y or z."),
    ] = None,
    rename: Annotated[str | None, RENAME] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file.")] = False,
    show_list: Annotated[bool, typer.Option("--list", help="Print the formats.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="With --list, as JSON.")] = False,
) -> None:
    """Convert 2D keypoints, 3D positions or results from one file format to another, by the extension of OUT.

    Example: recon convert results/clip model.osim

    3D positions are metres, z up, in all formats but those that have another custom; see recon convert --list.
    """
    if show_list:
        _print_formats(as_json)
        return
    if source is None or out is None:
        found = "nothing" if source is None else "one file"
        raise InputError(Problem("recon convert", "files", found, "IN and OUT, as in recon convert clip.csv clip.nc"))
    from recon.workflows.convert import Options, convert

    options = Options(fps, individual, columns, unit, up, rename)
    typer.echo(_summary(out, convert(source, out, to, options, overwrite)))


def _summary(out: Path, done: Conversion) -> str:
    from recon.clip.keypoints import Keypoints

    data = done.data
    what = f"{len(data.names)} keypoints, 2D" if isinstance(data, Keypoints) else f"{len(data.names)} joints, 3D"
    frames = f"frames {data.frames[0]} to {data.frames[-1]} ({len(data.frames)})"
    fps = "frame rate not known" if data.fps is None else f"{data.fps:g} frames per second"
    return "\n".join([f"{out}: {done.format.title}, {what}, {frames}, {fps}", *done.notes])


def _print_formats(as_json: bool) -> None:
    from recon.io import CONVERTED

    rows = [(f.name, " ".join(f.suffixes), ", ".join(f.writes), f.fps, f.frames, f.axes) for f in CONVERTED]
    names = ("--to", "extension", "holds", "frame rate", "frame numbers", "3D axes")
    if as_json:
        typer.echo(json.dumps([dict(zip(names, row, strict=True)) for row in rows], indent=1))
        return
    table = table_of(*names)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    terminal().print(table)
    typer.echo("Where an extension has several formats, the first is meant unless --to names another.")
