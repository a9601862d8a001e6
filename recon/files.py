"""Writing files whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

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
