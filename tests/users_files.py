"""Make a user's files under the names that a command writes, and check that they stay unchanged."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from command_line import run

from recon.base.outputs import RECORD

FOREIGN = 40
"""Minimum number of a user's files that `put_foreign` writes."""
REFUSED = "did not write, or that was changed since"


def contents(folder: Path) -> dict[str, str]:
    """Return the text of every file below a folder, and the target of every link, except recon's record."""
    return {
        path.relative_to(folder).as_posix(): os.readlink(path) if path.is_symlink() else path.read_text("latin-1")
        for path in folder.rglob("*")
        if (path.is_file() or path.is_symlink()) and path.name != RECORD
    }


def put_foreign(folder: Path, names: Iterable[str]) -> None:
    """Write files of a user under the given names, and under similar names up to `FOREIGN` files."""
    names = [*names]
    names += [f"{number}_{names[0]}" for number in range(FOREIGN - len(names))]
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"mine, {name}", encoding="utf-8")


def require_untouched(arguments: Sequence[object], folder: Path, names: Sequence[str]) -> None:
    """Check that a command that writes files of given names is refused, and that all files stay.

    A single existing file is enough. Without `--overwrite`, only the first of the names is tested alone.
    """
    put_foreign(folder, names)
    _require_refused(arguments, folder)
    for name in names:
        for other in names:
            (folder / other).unlink(missing_ok=True)
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("mine", encoding="utf-8")
        _require_refused(arguments, folder, options=((), ("--overwrite",)) if name == names[0] else (("--overwrite",),))


def _require_refused(
    arguments: Sequence[object], folder: Path, options: Sequence[tuple[str, ...]] = ((), ("--overwrite",))
) -> None:
    before, everything = contents(folder), sorted(folder.rglob("*"))
    for option in options:
        ended = run(*arguments, *option)
        assert ended.code == 2, ended
        assert REFUSED in ended.err, ended
        assert sorted(folder.rglob("*")) == everything
        assert contents(folder) == before
