"""Tables of text: rows in, and out with numbers that read back exactly."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem
from recon.io.common import numbers

SEPARATORS = (",", ";", "\t")


def text_rows(path: Path, separator: str | None = None) -> Iterator[tuple[int, list[str]]]:
    """The rows of a text table that are not blank, each with the number of its line.

    separator: by default whichever of `SEPARATORS` the first line has most. Raises InputError for bytes that are not
    UTF-8, with a byte order mark or without, and for text that is no table.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        line = 0
        try:
            first = file.readline()
            file.seek(0)
            rows = csv.reader(file, delimiter=separator or max(SEPARATORS, key=first.count))
            for row in rows:
                line = rows.line_num
                if any(cell.strip() for cell in row):
                    yield line, row
        except UnicodeDecodeError:
            raise InputError(Problem(path, "text", "bytes that are not UTF-8", "a text file in UTF-8")) from None
        except csv.Error as error:
            raise InputError(Problem(path, f"line {line + 1}", str(error), "a table of text")) from None


def number_rows(
    path: Path, rows: Iterable[tuple[int, list[str]]], columns: Sequence[str], index: int = 0
) -> tuple[list[list[str]], np.ndarray, list[Problem]]:
    """Rows with the numbers of their lines: of each the first `index` cells, which are texts, and the others as numbers
    (T, C), one for each of `columns`, NaN for an empty cell; and what is wrong with them."""
    texts: list[list[str]] = []
    values = array("d")  # one buffer that grows: a long recording has millions of numbers
    problems: list[Problem] = []
    width = index + len(columns)
    for line, row in rows:
        if len(row) != width:
            problems.append(Problem(path, f"line {line}", f"{len(row)} cells", f"{width}, as in the header"))
            continue
        found, wrong = numbers(row[index:])
        problems += [
            Problem(path, f"line {line}, {columns[j]}", f"'{row[index + j].strip()}'", "a number or an empty cell")
            for j in wrong
        ]
        texts.append(row[:index])
        values.frombytes(found.tobytes())
    return texts, np.frombuffer(values).reshape(len(texts), len(columns)), problems


def write_table(path: Path, header: Iterable[Sequence[str]], frames: np.ndarray, values: np.ndarray) -> None:
    """Header rows as they are, then one row per frame: its number, and values (T, C); NaN is an empty cell."""
    write_rows(path, header, ([frame, *row.tolist()] for frame, row in zip(frames.tolist(), values, strict=True)))


def write_rows(path: Path, header: Iterable[Sequence[str]], rows: Iterable[Sequence[Any]]) -> None:
    """The same for rows of text, whole numbers and floats."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows(header)
        writer.writerows([_cell(value) for value in row] for row in rows)


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """A long table by its columns (N,), of floats, whole numbers or text without commas; NaN is an empty cell. Much
    faster than row by row."""
    import pyarrow as pa  # rerun has it
    from pyarrow import csv as arrow_csv

    table = pa.table(
        {name: pa.array(np.ascontiguousarray(values), from_pandas=True) for name, values in columns.items()}
    )
    arrow_csv.write_csv(table, path, arrow_csv.WriteOptions(quoting_style="none"))


def _cell(value: Any) -> Any:
    """What the writer turns into the shortest text that reads back exactly."""
    plain = value.item() if isinstance(value, np.generic) else value
    return "" if plain != plain else plain
