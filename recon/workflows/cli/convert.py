"""`recon convert`."""

from __future__ import annotations

from typing import Any

import typer
from rich.text import Text

import recon.workflows.convert as workflow
from recon.clip.keypoints import Keypoints
from recon.io import CONVERTED
from recon.workflows.cli.common import table_of, terminal
from recon.workflows.convert import ConvertSettings


def convert(settings: ConvertSettings, as_json: bool) -> Any:
    """Convert 2D keypoints, 3D positions or results from one file format to another, by the extension of OUT.

    Example: recon convert results/clip model.osim

    3D positions are metres, z up, in all formats but those that have another custom; see recon convert --list.
    """
    if settings.show_list:
        return _formats(as_json)
    data, written, notes = workflow.convert(settings)
    what = f"{len(data.names)} keypoints, 2D" if isinstance(data, Keypoints) else f"{len(data.names)} joints, 3D"
    frames = f"frames {data.frames[0]} to {data.frames[-1]} ({len(data.frames)})"
    fps = "frame rate not known" if data.fps is None else f"{data.fps:g} frames per second"
    typer.echo("\n".join([*notes, f"{settings.out}: {written.title}, {what}, {frames}, {fps}"]))


def _formats(as_json: bool) -> Any:
    rows = [(f.name, " ".join(f.suffixes), ", ".join(f.writes), f.fps, f.frames, f.axes) for f in CONVERTED]
    names = ("--to", "extension", "holds", "frame rate", "frame numbers", "3D axes")
    if as_json:
        return [dict(zip(names, row, strict=True)) for row in rows]
    table = table_of(*names)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    terminal().print(table)
    typer.echo("Where an extension has several formats, the first is meant unless --to names another.")
