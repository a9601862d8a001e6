"""Tables that people open in a spreadsheet, which runs a text that begins as a formula does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from recon.base.file_names import encodable

if TYPE_CHECKING:
    import pandas as pd  # slow to import

FORMULAS = ("=", "+", "-", "@", "\t", "\r")
"""A text that begins so would be run by a spreadsheet."""


def guarded(cell: Any) -> Any:
    """Return a cell of a table: a text that a spreadsheet would run stands after an apostrophe, in UTF-8."""
    if not isinstance(cell, str):
        return cell
    return encodable(f"'{cell}" if _is_formula(cell) and not _is_number(cell) else cell)


def unguarded(text: str) -> str:
    """Return the text that `guarded` was given."""
    return text[1:] if text[:1] == "'" and _is_formula(text) else text


def _is_formula(text: str) -> bool:
    return text.lstrip("'").startswith(FORMULAS)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def write_frame(table: pd.DataFrame, path: Path, index: bool = False) -> None:
    """Write a table as CSV, with every text guarded; `index` writes the names of the rows, too."""
    texts = table.select_dtypes(exclude=["number", "bool"]).columns
    table = table.assign(**{name: table[name].map(guarded) for name in texts}).rename(columns=guarded)
    table.to_csv(path, index=index, lineterminator="\n")
