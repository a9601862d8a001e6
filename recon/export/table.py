"""CSV tables whose numbers read back exactly."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np


def write_table(path: Path, header: Iterable[Sequence[str]], frames: np.ndarray, values: np.ndarray) -> None:
    """Header rows as they are, then one row per frame: its number, and values (T, C); NaN is an empty cell."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows(header)
        for frame, row in zip(frames.tolist(), values.tolist(), strict=True):
            writer.writerow([frame, *("" if value != value else repr(value) for value in row)])
