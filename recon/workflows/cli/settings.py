"""`recon settings`."""

from __future__ import annotations

import json
from dataclasses import MISSING
from typing import Annotated, Any

import typer
from rich.text import Text

from recon.base.errors import InputError, Problem
from recon.base.settings import Option, SettingInfo, Settings
from recon.workflows.cli.common import table_of, terminal


class _ListedSettings(Settings):
    """What `recon settings` is told."""

    command: Annotated[str, Option("The command, as in fit.", argument="COMMAND")] = "fit"


def settings(settings: _ListedSettings, as_json: bool) -> None:
    """List all settings of a command: those that are options, and those that only --set and config.toml have.

    Example: recon settings fit
    """
    from recon.workflows.cli import commands

    command = commands().get(settings.command)
    if command is None:
        expected = f"one of {', '.join(commands())}"
        raise InputError(Problem("COMMAND", "command", repr(settings.command), expected))
    rows = [row_of(info) for info in command.takes.infos.values()]
    if as_json:
        typer.echo(json.dumps(rows, indent=1))
        return
    table = table_of("setting", "default", "meaning")
    for row in rows:
        default = "" if row["default"] is None else json.dumps(row["default"]).strip('"')
        table.add_row(*(Text(cell) for cell in (row["written"], default, row["meaning"])))
    terminal().print(table)


def row_of(info: SettingInfo) -> dict[str, Any]:
    """A setting as JSON has it."""
    default = None if info.default is MISSING else info.plain(info.default)
    return {"name": info.field, "written": info.on_command_line, "default": default, "meaning": info.option.help}
