"""`manifest.json`: which files the results in a folder are, so that a mixture of two runs is not taken for one.

It goes before the first file of a run is replaced, and comes after the last (`recon.base.files.staged_results`): a run
that is killed in between leaves none.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from recon.base.errors import InputError, Problem, refuse

MANIFEST = "manifest.json"
SCHEMA = {"name": "recon.manifest", "version": 1}
AGAIN = "the results of one run as they were written: run the command again, with --overwrite"


@dataclass(frozen=True)
class _Manifest:
    """What one run wrote into a folder."""

    folder: Path
    files: Mapping[str, tuple[int, str]]
    """By name: size in bytes, and the SHA-256 of the content in hexadecimal digits."""

    def __contains__(self, name: str) -> bool:
        return name in self.files

    def changed(self, names: Iterable[str] | None = None) -> list[Problem]:
        """What is missing or is not as it was written, of the named files, or of all."""
        return [
            Problem(self.folder / name, *fault, AGAIN)
            for name in (self.files if names is None else names)
            if (fault := self._fault(name)) is not None
        ]

    def require(self, *names: str) -> None:
        """Raises InputError unless these files are there and as the run wrote them."""
        refuse(self.changed(names))

    def _fault(self, name: str) -> tuple[str, str] | None:
        entry, path = self.files.get(name), self.folder / name
        if entry is None:
            return "file", f"no word of it in {MANIFEST}"
        try:
            if path.stat().st_size == entry[0] and sha256_of(path) == entry[1]:
                return None
        except OSError as error:
            there = not isinstance(error, FileNotFoundError)
            return "file", f"{error.strerror}" if there else f"no such file, which {MANIFEST} names"
        return "content", f"other than {MANIFEST} says: it was changed, or is of another run"


def read_manifest(folder: Path) -> _Manifest:
    """Raises InputError where there is none, as after a run that was interrupted while it wrote."""
    path = folder / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise ValueError
        files = {str(name): (int(entry["size"]), str(entry["sha256"])) for name, entry in content["files"].items()}
    except FileNotFoundError:
        found = f"no {MANIFEST}: of an interrupted run, or of an earlier version"
        raise InputError(Problem(folder, "folder", found, AGAIN)) from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        raise InputError(Problem(path, "content", "something else", AGAIN)) from None
    return _Manifest(folder, files)


def write_manifest(folder: Path) -> None:
    """Write the manifest of the files that are in the folder now."""
    files = {
        path.name: {"size": path.stat().st_size, "sha256": sha256_of(path)}
        for path in sorted(folder.iterdir())
        if path.name != MANIFEST and path.is_file()
    }
    text = json.dumps({"schema": SCHEMA, "files": files}, indent=1) + "\n"
    (folder / MANIFEST).write_text(text, encoding="utf-8", newline="\n")


def sha256_of(path: str | os.PathLike[str]) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
