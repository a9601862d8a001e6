"""Names of the pages' files, and how a page of recon is known from another program's."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from recon.base.errors import InputError, Problem

PAGE, SUMMARY_PAGE = "report.html", "summary.html"
"""Names of the page in the folder of a result, and in that of a batch."""
GENERATED = '<meta name="generator" content="recon">'
"""Mark by which recon recognises its own pages."""


def require_own_page(path: Path) -> None:
    """Raise InputError if a file of this name exists that recon has not made."""
    with suppress(FileNotFoundError, NotADirectoryError), path.open(encoding="utf-8", errors="replace") as file:
        if GENERATED not in file.read(2000):
            raise InputError(Problem(path, "file", "one that recon has not made", f"a place for {path.name}"))
