"""The command `recon settings`: its options, and what it prints."""

from __future__ import annotations

import json
from dataclasses import MISSING
from typing import Annotated, Any

from recon.base.errors import InputError, Problem
from recon.base.settings import Option, SettingInfo, Settings
from recon.workflows.cli.common import Answer, table_of


class _ListedSettings(Settings):
    """The settings of `recon settings`."""

    command: Annotated[str, Option(argument="COMMAND")] = "fit"
    """The command, as in fit."""


def settings(settings: _ListedSettings) -> Answer:
    """List all settings of a command: those that are options, and those that only --set and config.toml have.

    Example: recon settings fit
    """
    from recon.workflows.cli import commands

    command = commands().get(settings.command)
    if command is None:
        expected = f"one of {', '.join(commands())}"
        raise InputError(Problem("COMMAND", "command", repr(settings.command), expected))
    rows = [row_of(info) for info in command.infos.values()]
    cells = (
        (r["written"], json.dumps(r["default"] if r["default"] is not None else "").strip('"'), r["meaning"])
        for r in rows
    )
    return Answer(rows, [table_of("setting", "default", "meaning", rows=cells)])


def row_of(info: SettingInfo) -> dict[str, Any]:
    """A setting as JSON has it."""
    default = None if info.default is MISSING else info.plain(info.default)
    return {"name": info.field, "written": info.on_command_line, "default": default, "meaning": info.option.help}
