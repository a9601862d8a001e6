"""Parse the command-line arguments that several parts have in common."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from recordings import recordings

COMMON: dict[str, dict[str, Any]] = {
    "--csv": {"type": Path, "help": "write all rows here"},
    "--jobs": {"type": int, "default": 1, "help": "processes"},
    "--quick": {"action": "store_true", "help": "use only the named camera of each run"},
    "--set": {"action": "append", "default": [], "metavar": "NAME=VALUE", "help": "a setting of every fit"},
}


def parser_of(text: str | None, *options: str, kind: str = "", only: Sequence[str] = ()) -> argparse.ArgumentParser:
    """Return a command-line parser with the common options that a script needs.

    Parameters
    ----------
    text
        Docstring of the script, shown by --help.
    options
        Names of the common options (`COMMON`) that the script has.
    kind
        Kind of recordings whose folder can be given; the default is the folder of $RECON_SHARED_DATA.
    only
        Parts that --only can choose; by default all are measured.
    """
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    if kind:
        parser.add_argument("folder", type=Path, nargs="?", default=recordings(kind), help=f"default: {kind}")
    if only:
        parser.add_argument("--only", nargs="+", choices=[*only], default=[*only], metavar="PART", help=", ".join(only))
    for option in options:
        parser.add_argument(option, **COMMON[option])
    return parser


def settings_of(arguments: argparse.Namespace) -> dict[str, str]:
    """Return the settings that the option --set gives, as a dictionary from name to value."""
    return dict(item.split("=", 1) for item in arguments.set)


def runs_of(folder: Path) -> list[Path]:
    """Return the folders of the runs in a folder of recordings, in the order of their names."""
    return sorted(path.parent for path in folder.glob("*/meta.json"))


def runs_or_exit(parser: argparse.ArgumentParser, folder: Path) -> list[Path]:
    """Return the folders of the runs in a folder of recordings, or end the script if there are none."""
    runs = runs_of(folder)
    if not runs:
        parser.exit(message=f"no runs in {folder}: nothing measured\n")
    return runs
