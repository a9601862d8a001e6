"""The command `recon settings`: its options, and what it prints."""

from __future__ import annotations

import json
from dataclasses import MISSING
from typing import Annotated, Any

from pydantic import TypeAdapter
from rich.text import Text

from recon.base.errors import InputError, Problem
from recon.base.settings import Option, SettingInfo, Settings
from recon.workflows.cli.common import Answer, table_of
from recon.workflows.settings import SETTINGS, FitSettings

LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
"""What pydantic leaves under its own names where a text is read first."""


class _ListedSettings(Settings):
    """The settings of `recon settings`."""

    command: Annotated[str, Option(argument="COMMAND")] = "fit"
    """The command, as in fit."""
    schema: bool = False
    """Print the JSON schema of config.toml in place of the list: editors complete and check by it."""


def settings(settings: _ListedSettings) -> Answer:
    """List all settings of a command: those that are options, and those that only --set and config.toml have.

    Example: recon settings fit
    """
    if settings.schema:
        schema = config_schema()
        return Answer(schema, [Text(json.dumps(schema, indent=1, ensure_ascii=False))])
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


def config_schema() -> dict[str, Any]:
    """The JSON schema of config.toml, with what each setting means; texts such as "1920x1080" stand for sizes and
    ranges."""
    of_fit = TypeAdapter(FitSettings).json_schema()
    for name, info in SETTINGS.items():
        given = of_fit["properties"][name]
        choices = [_of_schema(one) for one in given.pop("anyOf", [given]) if one.get("type") != "null"]
        # One value stands for a list of one, and a text for what is read from it.
        choices += [one["items"] for one in choices if "items" in one]
        if not any(one.get("type") in ("string", "boolean") for one in choices):
            choices.append({"type": "string"})
        default = {} if info.default in (MISSING, None) else {"default": info.plain(info.default)}
        of_fit["properties"][name] = {"description": info.option.help, "anyOf": choices} | default
    of_fit |= {"title": "recon.fit", "description": "The settings of a fit", "required": []}
    digests = {"type": "object", "description": "Files' digests", "additionalProperties": {"type": "string"}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "config.toml of recon",
        "type": "object",
        "properties": {"recon": {"type": "object", "properties": {"fit": of_fit, "sha256": digests}}},
    }


def _of_schema(made: dict[str, Any]) -> dict[str, Any]:
    """Limits as JSON schema calls them."""
    named = {
        LIMITS.get(key, key): _of_schema(value) if isinstance(value, dict) else value for key, value in made.items()
    }
    return {key: value for key, value in named.items() if key not in ("title", "default")}


def row_of(info: SettingInfo) -> dict[str, Any]:
    """A setting as JSON has it."""
    default = None if info.default is MISSING else info.plain(info.default)
    return {"name": info.field, "written": info.on_command_line, "default": default, "meaning": info.option.help}
