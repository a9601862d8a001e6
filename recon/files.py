"""Writing files whole or not at all, and not over others."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from recon.errors import InputError, Problem

_PREFIX = ".recon-partial-"


@contextmanager
def staged_folder(folder: str | Path) -> Iterator[Path]:
    """A place to write a folder's files: they move into `folder` when the block ends without an exception.

    Each file replaces its namesake in one step; other files in `folder` stay. After an exception nothing is left, not
    even a folder that was made for the purpose; after a kill, only a hidden staging folder, which the next run removes.
    """
    folder = Path(folder)
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    staging = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for stale in folder.glob(f"{_PREFIX}*"):
            shutil.rmtree(stale, ignore_errors=True)
        staging = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=folder))
        yield staging
        for file in sorted(staging.iterdir()):
            os.replace(file, folder / file.name)
    except BaseException:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
        for folder_made in made:
            with suppress(OSError):  # it was not made after all, or others have put something into it
                folder_made.rmdir()
        raise
    staging.rmdir()


def require_free_folder(out: Path, names: Iterable[str], overwrite: bool, expected: str = "results") -> None:
    """Raises InputError where `out` cannot become a folder to write to, or has files of these names (what is expected
    not to be there) that may not be replaced."""
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not there.is_dir():
        raise InputError(Problem("--out", "folder", f"the file {there}", "a folder, which is made if need be"))
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(Problem("--out", "folder", f"{there}, which may not be written to", "a folder of your own"))
    present = [name for name in names if (out / name).exists()]
    if present and not overwrite:
        found = f"{', '.join(present)} in {out}"
        raise InputError(Problem("--out", "folder", found, f"a folder without {expected}, or --overwrite"))


def require_free_file(out: Path, overwrite: bool, option: str = "--out", source: Path | None = None) -> None:
    """Raises InputError where a file is there already that may not be replaced, as the source never may."""
    if source is not None and out.resolve() == source.resolve():
        raise InputError(Problem(option, "file", f"{out}, which is the input", "a new name"))
    if out.exists() and not overwrite:
        raise InputError(Problem(option, "file", f"{out}, which is there already", "a new name, or --overwrite"))
