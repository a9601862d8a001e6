"""CSV tables whose numbers read back exactly."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np


def write_table(path: Path, header: Iterable[Sequence[str]], frames: np.ndarray, values: np.ndarray) -> None:
    """Header rows as they are, then one row per frame: its number, and values (T, C); NaN is an empty cell."""
    write_rows(path, header, ([frame, *row] for frame, row in zip(frames, values, strict=True)))


def write_rows(path: Path, header: Iterable[Sequence[str]], rows: Iterable[Sequence[Any]]) -> None:
    """The same for rows of text, whole numbers and floats."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows(header)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: Any) -> str:
    plain = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, float):
        return "" if plain != plain else repr(plain)
    return str(plain)
