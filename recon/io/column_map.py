"""Which column of a plain table is what: by a map, or by names that people use.

A map looks like this; capitals do not matter where columns are recognised by their names:

    frame=Frame, bodypart=Node, x=X, y=Y, likelihood=Score          (long: one row for each frame and point)
    frame=Frame, x={bodypart} X, y={bodypart} Y                     (wide: one row for each frame)

An end of a coordinate's column such as _px, _m or _mm is its unit.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from recon.base.errors import InputError, Problem, refuse

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


@dataclass(frozen=True)
class ColumnLayout:
    """Which column holds what."""

    of_role: dict[str, str]
    """The column of each role but, in a wide table, those of `OF_POINTS`."""
    of_part: dict[tuple[str, str], str]
    """Those for each bodypart; empty for a long table."""
    unit: str | None
    """That of the coordinates, if all have the same."""
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


def find_layout(path: Path, columns: Sequence[str], given: Mapping[str, str] | None = None) -> ColumnLayout:
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
