"""Plain tables, long (one row for each frame and point) or wide (one row for each frame), as CSV or Parquet.

Which column is what says a map, or names that people use. A map looks like this; capitals do not matter where columns
are recognised by their names:

    frame=Frame, bodypart=Node, x=X, y=Y, likelihood=Score          (long: one row for each frame and point)
    frame=Frame, x={bodypart} X, y={bodypart} Y                     (wide: one row for each frame)

An end of a coordinate's column such as _px, _m or _mm is its unit.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import write_bytes
from recon.clip.keypoints import Keypoints
from recon.io.common import (
    MAX_FRAME,
    POINTS_MAX,
    choose,
    damage_named,
    first_problems,
    formats_extra,
    frames_of_times,
    name_problems,
    numbers,
    rate,
    starts_with,
)
from recon.io.pose import Pose3D, StoredPoints
from recon.io.table import SEPARATORS, text_rows, write_rows

Columns = Mapping[str, Any]
"""A table by column: sequences of text cells, or arrays of numbers."""
ROLES: dict[str, tuple[str, ...]] = {
    "frame": ("frame", "frames", "frame_idx", "frame_index", "frame_id", "frame_number", "framenumber", "fnum"),
    "time": ("time_s", "time", "seconds", "timestamp"),
    "bodypart": ("bodypart", "body_part", "keypoint", "node", "joint", "marker", "landmark", "part", "point", "name"),
    "individual": ("individual", "animal", "track", "track_id", "instance", "subject"),
    "x": ("x",),
    "y": ("y",),
    "z": ("z",),
    "likelihood": ("likelihood", "confidence", "score", "conf", "prob", "p"),
    "fps": ("fps",),
}
"""What a column is for, and what it may be called without a map; capitals do not matter."""
OF_POINTS = ("x", "y", "z", "likelihood")
UNIT = r"(?:[ _]?[\[(]?(px|m|cm|mm)[\])]?)?"
PART = "{bodypart}"
VALUES_MAX = 4 * POINTS_MAX
METADATA = b"recon"
"""Key of our own metadata in Parquet: JSON with fps and up."""


@dataclass(frozen=True)
class ColumnLayout:
    """Which column of a plain table holds what."""

    of_role: dict[str, str]
    """The column of each role but, in a wide table, those of `OF_POINTS`."""
    of_part: dict[tuple[str, str], str]
    """The columns of each bodypart; empty for a long table."""
    unit: str | None
    """The unit of the coordinates, if all have the same."""
    ignored: tuple[str, ...]
    """Other columns."""

    @property
    def has_z(self) -> bool:
        return "z" in self.of_role or any(coord == "z" for _, coord in self.of_part)


def parse_map(text: str) -> dict[str, str]:
    """The column map "frame=Frame, x=X, ..." by role. Raises InputError with everything that is wrong with it."""
    given: dict[str, str] = {}
    problems = []
    for part in text.split(","):
        role, _, column = (piece.strip() for piece in part.partition("="))
        if not column or role not in ROLES or role in given:
            expected = f"ROLE=COLUMN, each role once, one of: {', '.join(ROLES)}"
            problems.append(Problem("--columns", "map", f"'{part.strip()}'", expected))
        given[role] = column
    wide = {role for role, column in given.items() if PART in column}
    lacking = ({"x", "y"} if wide else {"x", "y", "bodypart"}) - given.keys()
    if lacking:
        expected = f"a column for each, or x and y with {PART} in them"
        problems.append(Problem("--columns", "map", f"no {', '.join(sorted(lacking))}", expected))
    if not {"frame", "time"} & given.keys():
        problems.append(Problem("--columns", "map", "no frame", "a column with frame numbers, or time in seconds"))
    if wide and wide != set(OF_POINTS) & given.keys() | {"bodypart"} & given.keys():
        found = f"{PART} in {', '.join(sorted(wide))}"
        expected = f"a wide table with {PART} in x, y and likelihood, or a long one with bodypart=COLUMN"
        problems.append(Problem("--columns", "map", found, expected))
    refuse(problems)
    return given


def _layout(path: Path, columns: Sequence[str], given: Mapping[str, str] | None = None) -> ColumnLayout:
    """The roles of a table's columns, by a map or by their names. Raises InputError where there are none."""
    layout = layout_by_name(columns) if given is None else _by_map(path, columns, given)
    if layout is None:
        expected = "frame, bodypart, x, y or frame, NAME_x, NAME_y, ...; or a map of columns (--columns)"
        raise InputError(Problem(path, "columns", ", ".join(columns)[:120], expected))
    return layout


def layout_by_name(columns: Sequence[str]) -> ColumnLayout | None:
    """None where the columns are not obvious."""
    of_role: dict[str, str] = {}
    units: set[str | None] = set()
    for column in columns:
        for role, known in ROLES.items():
            match = re.fullmatch(f"({'|'.join(known)}){UNIT if role in 'xyz' else ''}", column.strip().lower())
            if match and role not in of_role:
                of_role[role] = column
                units |= {match[2]} if role in "xyz" else set()
    if not {"frame", "time"} & of_role.keys():
        return None
    if {"bodypart", "x", "y"} <= of_role.keys():
        ignored = tuple(c for c in columns if c not in of_role.values())
        return ColumnLayout(of_role, {}, units.pop() if len(units) == 1 else None, ignored)
    pattern = re.compile(rf"(.+?)[ _.:/-](?:([xyz]){UNIT}|({'|'.join(ROLES['likelihood'])}))", re.IGNORECASE)

    def part_of(column: str) -> tuple[str, str, str | None] | None:
        match = pattern.fullmatch(column.strip())
        return (match[1], (match[2] or "likelihood").lower(), match[3]) if match else None

    return _wide(columns, {r: c for r, c in of_role.items() if r in ("frame", "time", "individual", "fps")}, part_of)


def _by_map(path: Path, columns: Sequence[str], given: Mapping[str, str]) -> ColumnLayout | None:
    fixed = {role: column for role, column in given.items() if PART not in column}
    if absent := [column for column in fixed.values() if column not in columns]:
        there = ", ".join(columns)[:120]
        raise InputError([Problem(path, "columns", f"no '{column}'", f"one of: {there}") for column in absent])
    if len(fixed) == len(given):
        return ColumnLayout(dict(given), {}, None, ())
    patterns = {}
    for role in given.keys() - fixed.keys():
        before, _, after = given[role].partition(PART)
        patterns[role] = re.compile(f"{re.escape(before)}(.+){re.escape(after)}")

    def part_of(column: str) -> tuple[str, str, None] | None:
        found = [(m[1], role, None) for role, pattern in patterns.items() if (m := pattern.fullmatch(column))]
        return found[0] if found else None

    return _wide([c for c in columns if c not in fixed.values()], fixed, part_of)


def _wide(
    columns: Sequence[str], of_role: dict[str, str], part_of: Callable[[str], tuple[str, str, str | None] | None]
) -> ColumnLayout | None:
    """part_of: bodypart, coordinate and unit of a column, or None. Parts without x or y are none."""
    found = {c: part for c in columns if c not in of_role.values() and (part := part_of(c))}
    has = {(part, coord) for part, coord, _ in found.values()}
    whole = {c: p for c, p in found.items() if (p[0], "x") in has and (p[0], "y") in has}
    if not whole:
        return None
    of_part = {(part, coord): c for c, (part, coord, _) in whole.items()}
    units = {unit for _, coord, unit in whole.values() if coord != "likelihood"}
    ignored = tuple(c for c in columns if c not in of_role.values() and c not in of_part.values())
    return ColumnLayout(of_role, of_part, units.pop() if len(units) == 1 else None, ignored)


# -- reading ----------------------------------------------------------------------------------------------------------


def recognises_long(path: Path) -> bool:
    """Whether it is a text table whose columns are obvious, long or wide, 2D or 3D."""
    with path.open("rb") as file:
        first = file.readline(1 << 20)
    try:
        text = first.decode("utf-8-sig").rstrip("\r\n")
        header = next(csv.reader([text], delimiter=max(SEPARATORS, key=text.count)), [])
    except (UnicodeDecodeError, csv.Error):
        return False
    return len(set(header)) == len(header) and layout_by_name(header) is not None


def read_long(path: Path, individual: str | None = None, columns: Mapping[str, str] | None = None) -> StoredPoints:
    """The points of one animal; columns: a map as `parse_map` gives it. Raises InputError."""
    rows = text_rows(path)
    header = next(rows, (1, []))[1]
    table, problems = [], []
    if len(set(header)) != len(header):
        problems = [Problem(path, "header", "a column more than once", "unique columns")]
    for line, row in rows:
        table.append(row)
        if len(row) != len(header):
            problems.append(Problem(path, f"line {line}", f"{len(row)} cells", f"{len(header)}, as in line 1"))
    refuse(first_problems(problems, path))
    cells = list(zip(*table, strict=True)) or [()] * len(header)
    return _gathered(path, dict(zip(header, cells, strict=True)), _layout(path, header, columns), individual)


recognises_wide, read_wide = recognises_long, read_long


def recognises_parquet(path: Path) -> bool:
    return starts_with(path, b"PAR1")


def read_parquet(path: Path, individual: str | None = None) -> StoredPoints:
    """The 3D positions of a Parquet file. Raises InputError."""
    with formats_extra(path):
        import pyarrow as pa
        import pyarrow.parquet as pq
    with damage_named(path, "a whole file"):
        size = pq.read_metadata(path)  # a column of equal values takes no room in the file
        if size.num_rows * size.num_columns > VALUES_MAX:
            raise ValueError(f"{size.num_rows} rows of {size.num_columns} columns are too much")
        table = pq.read_table(path)
        own = json.loads((table.schema.metadata or {}).get(METADATA, b"{}"))
        columns = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            numeric = pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
            columns[name] = np.asarray(column.to_numpy(), dtype=float) if numeric else column.to_pylist()
    pose = _gathered(path, columns, _layout(path, table.column_names), individual)
    if not isinstance(own, dict):
        return pose
    return replace(pose, fps=pose.fps or rate(own.get("fps")), up="z" if own.get("up") == "z" else None)


def _gathered(path: Path, table: Columns, layout: ColumnLayout, individual: str | None) -> StoredPoints:
    """The table by frame and point, of one animal. Raises InputError for cells that are no numbers, points that appear
    twice in a frame, coordinates that are missing."""
    role, problems = layout.of_role, list[Problem]()
    rows = np.arange(len(next(iter(table.values()), ())))
    animal = None
    if "individual" in role:
        whose = [str(cell).strip() for cell in table[role["individual"]]]
        animals = list(dict.fromkeys(whose)) or [""]
        animal = animals[choose(path, animals, individual)]
        rows = np.flatnonzero([w == animal for w in whose])
    else:
        choose(path, [""], individual)
    if not len(rows):
        raise InputError(Problem(path, "rows", "no frames", "at least one row below the header"))

    def cells_of(column: str) -> np.ndarray:
        """As floats; those that are no numbers, or infinite, become problems."""
        cells = table[column]
        values, wrong = numbers(cells[row] for row in rows)
        problems.extend(
            Problem(path, f"line {rows[i] + 2}, {column}", f"'{str(cells[rows[i]]).strip()}'", expected)
            for i in wrong
            for expected in ["a number or an empty cell"]
        )
        return values

    rates = set(cells_of(role["fps"]).tolist()) if "fps" in role else ()
    fps = rate(rates.pop()) if len(rates) == 1 else None
    by_frame = "frame" in role
    clock = role["frame" if by_frame else "time"]
    ticks = cells_of(clock)
    usable = (np.abs(ticks) <= MAX_FRAME) & (np.rint(ticks) == ticks) if by_frame else ~np.isnan(ticks)
    expected = "a frame number: 0, 1, 2, ..." if by_frame else "a time in seconds"
    for i in np.flatnonzero(~usable & ~np.isinf(ticks)):
        found = "nothing" if np.isnan(ticks[i]) else f"{ticks[i]:g}"
        problems.append(Problem(path, f"line {rows[i] + 2}, {clock}", found, expected))
    refuse(first_problems(problems, path))
    distinct, row_of = np.unique(ticks, return_inverse=True)
    coords = ("x", "y", "z") if layout.has_z else ("x", "y")
    names, placed, faults = _placed(path, table, layout, coords, rows, row_of)
    problems += faults
    both = np.full((len(distinct), len(names), len(coords) + 1), np.nan)
    for column, k, c in placed:
        both[row_of, k, c] = cells_of(column)
    problems += name_problems(path, "bodypart", names)
    refuse(first_problems(problems, path))
    frames, fps = (distinct.astype(np.int64), fps) if by_frame else frames_of_times(path, distinct, fps)
    ignored = [column for column in layout.ignored if column.strip()]
    return StoredPoints(
        names,
        both[..., :-1],
        frames,
        both[..., -1],
        fps=fps,
        individual=animal or None,
        unit=layout.unit if layout.unit != "px" else None,
        notes=(f"Columns left out: {', '.join(ignored)}.",) if ignored else (),
    )


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


# -- writing ---------------------------------------------------------------------------------------------------------


def write_long(keypoints: Keypoints, path: Path) -> None:
    """One row for each frame and keypoint: frame, individual (if named), bodypart, x, y, likelihood, fps."""
    start, end, values = _parts(keypoints)
    rows = (
        [frame, *start.values(), name, *point, *end.values()]
        for frame, points in zip(keypoints.frames, values, strict=True)
        for name, point in zip(keypoints.names, points, strict=True)
    )
    write_rows(path, [["frame", *start, "bodypart", "x", "y", "likelihood", *end]], rows)


def write_wide(keypoints: Keypoints, path: Path) -> None:
    """One row for each frame: frame, individual (if named), NAME_x, NAME_y, NAME_likelihood, ..., fps."""
    start, end, values = _parts(keypoints)
    of_points = [f"{name}_{coord}" for name in keypoints.names for coord in ("x", "y", "likelihood")]
    rows = (
        [frame, *start.values(), *points.ravel(), *end.values()]
        for frame, points in zip(keypoints.frames, values, strict=True)
    )
    write_rows(path, [["frame", *start, *of_points, *end]], rows)


def _parts(keypoints: Keypoints) -> tuple[dict[str, str], dict[str, float], np.ndarray]:
    """Columns that are the same in all rows, before and after the others; and x, y, likelihood (T, K, 3)."""
    start = {} if keypoints.individual is None else {"individual": keypoints.individual}
    end = {} if keypoints.fps is None else {"fps": keypoints.fps}
    return start, end, np.concatenate([keypoints.xy_px, keypoints.confidence[..., None]], axis=2)


def write_parquet(pose: Pose3D, path: Path) -> None:
    """One row for each frame and joint: frame, joint, x_m, y_m, z_m (metres, z up)."""
    with formats_extra("Parquet"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    T, J = pose.xyz_m.shape[:2]
    of_fit = {}
    if pose.sigma_m is not None and pose.flags is not None:
        of_fit = {f"{axis}_sigma_m": pa.array(pose.sigma_m[..., i].ravel()) for i, axis in enumerate("xyz")}
        of_fit["flags"] = pa.array(np.repeat(pose.flags, J))
    table = pa.table(
        {
            "frame": pa.array(np.repeat(pose.frames, J), pa.int64()),
            "joint": pa.array(list(pose.names) * T, pa.string()),
            **{f"{axis}_m": pa.array(pose.xyz_m[..., i].ravel(), pa.float64()) for i, axis in enumerate("xyz")},
            **of_fit,
        }
    )
    about = {"fps": pose.fps, "unit": "m", "up": "z", "notes": pose.notes}
    made = BytesIO()
    pq.write_table(table.replace_schema_metadata({METADATA: json.dumps(about)}), made)
    write_bytes(path, made.getvalue())
