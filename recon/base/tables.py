"""Write tables that are safe to open in a spreadsheet, which evaluates a cell that begins like a formula."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, overload

from recon.base.file_names import encodable

if TYPE_CHECKING:
    import pandas as pd  # slow to import

_Cell = TypeVar("_Cell")
FORMULAS = ("=", "+", "-", "@", "\t", "\r")
"""Beginnings of cells that a spreadsheet would evaluate."""


@overload
def guarded(cell: str) -> str: ...


@overload
def guarded(cell: _Cell) -> _Cell: ...


def guarded(cell: object) -> object:
    """Return a table cell that UTF-8 can encode, with an apostrophe in front of a string that looks like a formula."""
    if not isinstance(cell, str):
        return cell
    return encodable(f"'{cell}" if _is_formula(cell) and not _is_number(cell) else cell)


def unguarded(text: str) -> str:
    """Return the original text of a cell that `guarded` returned."""
    return text[1:] if text[:1] == "'" and _is_formula(text) else text


def _is_formula(text: str) -> bool:
    return text.lstrip("'").startswith(FORMULAS)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def write_frame(table: pd.DataFrame, path: Path, index: bool = False, digits: int | None = None) -> None:
    """Write a table as CSV with every text guarded.

    `index` states whether the row names are written. `digits` is the number of significant digits of numbers; None
    writes all of them.
    """
    texts = table.select_dtypes(exclude=["number", "bool"]).columns
    table = table.assign(**{name: table[name].map(guarded) for name in texts}).rename(columns=guarded)
    form = None if digits is None else f"%.{digits}g"
    table.to_csv(path, index=index, lineterminator="\n", float_format=form)
