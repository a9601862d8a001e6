"""Print and format Markdown tables for the benchmarks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def print_table(header: Sequence[object], rows: Iterable[Iterable[object]]) -> None:
    print_header(header)
    for cells in rows:
        print_row(cells)
    print(flush=True)


def print_header(header: Sequence[object]) -> None:
    """Begin a table whose rows are printed later, one at a time, by `print_row`."""
    print_row(header)
    print_row(["---"] * len(header))


def print_row(cells: Iterable[object]) -> None:
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)
