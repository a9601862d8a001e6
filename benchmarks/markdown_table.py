"""Markdown tables for the benchmarks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def print_table(header: Sequence[object], rows: Iterable[Iterable[object]]) -> None:
    for cells in (header, ["---"] * len(header), *rows):
        print("| " + " | ".join(map(str, cells)) + " |")
    print(flush=True)
