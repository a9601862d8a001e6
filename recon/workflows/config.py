"""Settings of a fit from config.toml and the command line, and the JSON schema of that file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import MISSING, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from recon.base import InputError, Problem
from recon.base.documents import read_toml
from recon.base.settings import on_command_line
from recon.workflows.settings import SETTINGS, FitSettings, with_paths

_REPLACED_BY = {
    "camera": ("hfov_deg", "image_size_px", "camera_name", "camera_unit", "tilt_deg"),
    "hfov_deg": ("camera", "camera_name", "camera_unit"),
    "camera_track": ("tilt_deg",),
}
"""Settings of another camera, which do not go with one that is given."""


def read_settings(config: Path | None, given: Mapping[str, Any] | None = None) -> FitSettings:
    """Settings from the table [recon.fit] of a TOML file, such as config.toml, overruled by those given.

    None is not given. Paths in the file are relative to its folder. Another camera or method among those given replaces
    the one of the file together with all that belongs to it. Raises InputError, naming every setting that is wrong, and
    where it was given.
    """
    given = {name: value for name, value in (given or {}).items() if value is not None}
    under = {} if config is None else _read_config(config)
    left_out = {*given, *(name for one in given for name in _REPLACED_BY.get(one, ()))}
    before = under.get("method", SETTINGS["method"].default)
    if given.get("method", before) != before:
        left_out |= {name for name, setting in SETTINGS.items() if setting.option.method == before}
    plain = {name: value for name, value in under.items() if name not in left_out} | given

    try:
        return FitSettings(**plain)
    except InputError as error:
        raise InputError(
            replace(problem, file=config)
            if config is not None and problem.field not in given
            else on_command_line(problem, SETTINGS)
            for problem in error.problems
        ) from None


def _read_config(config: Path) -> dict[str, Any]:
    document = read_toml(config, "a config.toml of an earlier run")
    table = document.get("recon", {})
    table = table.get("fit") if isinstance(table, dict) else None
    if not isinstance(table, dict):
        raise InputError(Problem(config, "table", ", ".join(document)[:120] or "nothing", "[recon.fit]"))
    return {name: beside(config.parent, name, value) for name, value in table.items()}


def beside(folder: Path, name: str, given: Any) -> Any:
    """The value of a setting that stands in a file of that folder: its paths are relative to the folder."""
    return with_paths(name, given, lambda path: os.path.normpath(folder.absolute() / path))


LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
"""What pydantic leaves under its own names where a text is read first."""


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
