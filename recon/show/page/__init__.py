"""Pages to look at and to pass on: of one result, and of a batch. Each is one HTML file that fetches nothing.

The words, tables and numbers are the report's, the figures those of `recon.show.plots`, the frame around them that of
`templates/`, filled in by Jinja2, which escapes whatever comes from a file or its name.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from recon.base.errors import InputError, Problem

PAGE, SUMMARY_PAGE = "report.html", "summary.html"
"""In the folder of a result, and in that of a batch."""
GENERATED = '<meta name="generator" content="recon">'
"""By which a page is known again."""


def require_own_page(path: Path) -> None:
    """Raises InputError where a file is in the page's place that recon has not made."""
    with suppress(FileNotFoundError, NotADirectoryError), path.open(encoding="utf-8", errors="replace") as file:
        if GENERATED not in file.read(2000):
            raise InputError(Problem(path, "file", "one that recon has not made", f"a place for {path.name}"))
