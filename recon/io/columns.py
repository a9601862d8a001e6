"""Plain tables, long (one row for each frame and point) or wide (one row for each frame), as CSV.

Which column is what: see `recon.io.column_map`.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.clip.keypoints import Keypoints
from recon.io.column_map import ColumnLayout, find_layout, layout_by_name
from recon.io.common import MAX_FRAME, choose, first_problems, frames_of_times, name_problems, numbers, rate
from recon.io.hdf5 import is_hdf5
from recon.io.pose import StoredPoints
from recon.io.table import SEPARATORS, text_rows, write_rows

Columns = Mapping[str, Sequence[Any] | np.ndarray]
"""A table by column: text cells, or numbers."""


def recognises(path: Path) -> bool:
    """Whether it is a text table whose columns are obvious, 2D or 3D."""
    return _layout_of_head(path) is not None


def read(path: Path, individual: str | None = None, columns: Mapping[str, str] | None = None) -> StoredPoints:
    """The points of one animal; columns: a map as `parse_map` gives it. Raises InputError."""
    table = _read_csv(path)
    return gather(path, table, find_layout(path, list(table), columns), individual)


def gather(path: Path, table: Columns, layout: ColumnLayout, individual: str | None) -> StoredPoints:
    """The table by frame and point, of one animal. Raises InputError for cells that are no numbers, points that appear
    twice in a frame, coordinates that are missing."""
    coords = ("x", "y", "z") if layout.has_z else ("x", "y")
    rows = np.arange(len(next(iter(table.values()), ())))
    animal = None
    if "individual" in layout.of_role:
        whose = [str(cell).strip() for cell in table[layout.of_role["individual"]]]
        animals = list(dict.fromkeys(whose)) or [""]
        animal = animals[choose(path, animals, individual)]
        rows = np.flatnonzero([w == animal for w in whose])
    else:
        choose(path, [""], individual)
    problems: list[Problem] = []

    def cells_of(column: str) -> np.ndarray:
        return _numbers(path, column, table[column], rows, problems)

    if not len(rows):
        raise InputError(Problem(path, "rows", "no frames", "at least one row below the header"))
    fps = None
    if "fps" in layout.of_role:
        rates = set(cells_of(layout.of_role["fps"]).tolist())
        fps = rate(rates.pop()) if len(rates) == 1 else None
    clock = layout.of_role.get("frame") or layout.of_role["time"]
    ticks = cells_of(clock)
    problems += _clock_problems(path, clock, ticks, rows, "frame" in layout.of_role)
    refuse(first_problems(problems, path))
    distinct, row_of = np.unique(ticks, return_inverse=True)
    names, placed, faults = _placed(path, table, layout, coords, rows, row_of)
    problems += faults
    both = np.full((len(distinct), len(names), len(coords) + 1), np.nan)
    for column, k, c in placed:
        both[row_of, k, c] = cells_of(column)
    problems += name_problems(path, "bodypart", names)
    refuse(first_problems(problems, path))
    if "frame" in layout.of_role:
        frames = distinct.astype(np.int64)
    else:
        frames, fps = frames_of_times(path, distinct, fps)
    ignored = [column for column in layout.ignored if column.strip()]
    notes = (f"Columns left out: {', '.join(ignored)}.",) if ignored else ()
    return StoredPoints(
        names,
        both[..., :-1],
        frames,
        both[..., -1],
        fps=fps,
        individual=animal or None,
        unit=layout.unit if layout.unit != "px" else None,
        notes=notes,
    )


def _clock_problems(path: Path, column: str, ticks: np.ndarray, rows: np.ndarray, frames: bool) -> Iterator[Problem]:
    """Rows without a time, or without a frame number."""
    bad = ~((np.abs(ticks) <= MAX_FRAME) & (np.rint(ticks) == ticks)) if frames else np.isnan(ticks)
    expected = "a frame number: 0, 1, 2, ..." if frames else "a time in seconds"
    for i in np.flatnonzero(bad & ~np.isinf(ticks)):
        found = "nothing" if np.isnan(ticks[i]) else f"{ticks[i]:g}"
        yield Problem(path, f"line {rows[i] + 2}, {column}", found, expected)


def _placed(
    path: Path, table: Columns, layout: ColumnLayout, coords: Sequence[str], rows: np.ndarray, row_of: np.ndarray
) -> tuple[tuple[str, ...], Sequence[tuple[str, int | np.ndarray, int]], list[Problem]]:
    """The points; columns with the point of their cells, or of each (N,), and the place of what they hold among the
    coordinates and, last, the likelihood; and what is wrong with them. rows, row_of (N,): of the table, and frames."""
    places = {coord: c for c, coord in enumerate((*coords, "likelihood"))}
    if layout.of_part:
        names = tuple(dict.fromkeys(part for part, _ in layout.of_part))
        problems = [
            Problem(path, f"bodypart {name}", f"no {coord}", ", ".join(coords))
            for name in names
            for coord in coords
            if (name, coord) not in layout.of_part
        ]
        if row_of.max() + 1 < len(row_of):
            found = f"{len(row_of)} rows for {row_of.max() + 1} frames"
            problems.append(Problem(path, "frames", found, "one row for each"))
        of_part = layout.of_part.items()
        return names, [(column, names.index(part), places[coord]) for (part, coord), column in of_part], problems
    labels = table[layout.of_role["bodypart"]]
    points = [str(labels[row]).strip() for row in rows.tolist()]
    index = {name: k for k, name in enumerate(dict.fromkeys(points))}
    names, point_of = tuple(index), np.array([index[point] for point in points])
    cells, count = np.unique(row_of * len(names) + point_of, return_counts=True)
    problems = [
        Problem(path, f"bodypart {names[cell % len(names)]}", f"{n} rows in one frame", "one")
        for cell, n in zip(cells, count, strict=True)
        if n > 1
    ]
    placed = [(layout.of_role[coord], point_of, c) for coord, c in places.items() if coord in layout.of_role]
    return names, placed, problems


def _numbers(path: Path, column: str, cells: Any, rows: np.ndarray, problems: list[Problem]) -> np.ndarray:
    """The cells of some rows as floats; those that are no numbers, or infinite, become problems."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind in "fiu":
        values = cells[rows].astype(float)
        wrong = np.flatnonzero(np.isinf(values)).tolist()
    else:
        values, wrong = numbers(cells[row] for row in rows)
    problems += [
        Problem(path, f"line {rows[i] + 2}, {column}", f"'{str(cells[rows[i]]).strip()}'", "a number or an empty cell")
        for i in wrong
    ]
    return values


def _layout_of_head(path: Path) -> ColumnLayout | None:
    """The layout of a text table by its first line."""
    if is_hdf5(path):
        return None
    with path.open("rb") as file:
        first = file.readline(1 << 20).removeprefix(b"\xef\xbb\xbf")
    try:
        text = first.decode("utf-8").rstrip("\r\n")
        header = next(csv.reader([text], delimiter=max(SEPARATORS, key=text.count)), [])
    except (UnicodeDecodeError, csv.Error):
        return None
    return layout_by_name(header) if len(set(header)) == len(header) else None


def _read_csv(path: Path) -> dict[str, list[str]]:
    """Text cells by column. Raises InputError for text that is no table."""
    rows = text_rows(path)
    header = next(rows, (1, []))[1]
    problems = [Problem(path, "header", "a column more than once", "unique columns")]
    problems = problems if len(set(header)) != len(header) else []
    table = []
    for line, row in rows:
        table.append(row)
        if len(row) != len(header):
            problems.append(Problem(path, f"line {line}", f"{len(row)} cells", f"{len(header)}, as in line 1"))
    refuse(first_problems(problems, path))
    columns = list(zip(*table, strict=True)) or [()] * len(header)
    return {name: list(cells) for name, cells in zip(header, columns, strict=True)}


# -- writing ---------------------------------------------------------------------------------------------------------


def write_long(keypoints: Keypoints, path: Path) -> None:
    """One row for each frame and keypoint: frame, individual (if named), bodypart, x, y, likelihood, fps."""
    start, end = _more(keypoints)
    header = ["frame", *start, "bodypart", "x", "y", "likelihood", *end]
    rows = (
        [frame, *start.values(), name, *keypoints.xy_px[t, k], keypoints.confidence[t, k], *end.values()]
        for t, frame in enumerate(keypoints.frames)
        for k, name in enumerate(keypoints.names)
    )
    write_rows(path, [header], rows)


def write_wide(keypoints: Keypoints, path: Path) -> None:
    """One row for each frame: frame, individual (if named), NAME_x, NAME_y, NAME_likelihood, ..., fps."""
    start, end = _more(keypoints)
    of_points = [f"{name}_{coord}" for name in keypoints.names for coord in ("x", "y", "likelihood")]
    rows = []
    for t, frame in enumerate(keypoints.frames):
        cells = [v for xy, c in zip(keypoints.xy_px[t], keypoints.confidence[t], strict=True) for v in (*xy, c)]
        rows.append([frame, *start.values(), *cells, *end.values()])
    write_rows(path, [["frame", *start, *of_points, *end]], rows)


def _more(keypoints: Keypoints) -> tuple[dict[str, str], dict[str, float]]:
    """Columns that are the same in all rows, before and after the others."""
    start = {} if keypoints.individual is None else {"individual": keypoints.individual}
    return start, {} if keypoints.fps is None else {"fps": keypoints.fps}
