"""Print and format Markdown tables for the benchmarks."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def print_table(header: Sequence[object], rows: Iterable[Iterable[object]]) -> None:
    print_header(header)
    for cells in rows:
        print_row(cells)
    print(flush=True)


def print_header(header: Sequence[object]) -> None:
    """Print the header of a table whose rows are printed later, one by one, by `print_row`."""
    print_row(header)
    print_row(["---"] * len(header))


def print_row(cells: Iterable[object]) -> None:
    """Print one row of a table, with a space between each number and a following per cent sign."""
    texts = [re.sub(r"(?<=\d)%", " %", str(cell)) for cell in cells]
    print("| " + " | ".join(texts) + " |", flush=True)


def percent(share: float, digits: int = 0) -> str:
    """Format a fraction as a percentage, such as "12 %"."""
    return f"{100 * share:.{digits}f} %"
