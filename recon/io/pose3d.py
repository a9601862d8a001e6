"""3D positions by joint and frame, as CSV files with the header rows `bodyparts, coords`."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.errors import InputError, Problem
from recon.io import describe, file_head
from recon.io.deeplabcut import PROBLEMS_SHOWN, Column, Table, gather, read_csv, recognises


@dataclass(frozen=True, eq=False)
class Pose3D:
    """names: J joints; xyz_m: (T, J, 3) float, metres, NaN = missing; frames: (T,) int, strictly increasing.

    Raises ValueError where they do not fit together.
    """

    names: tuple[str, ...]
    xyz_m: np.ndarray
    frames: np.ndarray
    source: str | None = None

    def __post_init__(self) -> None:
        if self.xyz_m.shape != (len(self.frames), len(self.names), 3):
            raise ValueError(f"{len(self.frames)} frames of {len(self.names)} joints, but positions {self.xyz_m.shape}")
        if len(set(self.names)) != len(self.names) or np.any(np.diff(self.frames) <= 0):
            raise ValueError("names must be unique and frames strictly increasing")
        if np.isinf(self.xyz_m).any():
            raise ValueError("a position is infinite")


def read_pose3d(path: str | Path) -> Pose3D:
    """Reads x, y, z per joint from a CSV file; DeepLabCut's third header row, `scorer`, is optional.

    The file does not say its unit: it must be metres. Raises InputError.
    """
    path = Path(path)
    head = file_head(path)
    if not recognises(path) or head.startswith(b"\x89HDF"):
        raise InputError(
            Problem(path, "format", describe(head), "CSV with the header rows bodyparts, coords (x, y, z)")
        )
    table = read_csv(path)
    if any(column.individual for column in table.columns):
        raise InputError(Problem(path, "header", "several animals", "the joints of one animal"))
    names, xyz_m = gather(table, path, required=("x", "y", "z"))
    return Pose3D(names, xyz_m, table.frames, source=str(path))


def read_pose_segments(path: str | Path) -> dict[str, Pose3D]:
    """Several pieces of motion in one CSV file, by name: a first header row `segment, frame, <joints>`, a second with
    x, y, z, and metres. A file as `read_pose3d` takes it is one piece, named after the file. Raises InputError."""
    path = Path(path)
    head = file_head(path)
    if not head.removeprefix(b"\xef\xbb\xbf").startswith(b"segment,frame,"):
        return {path.stem: read_pose3d(path)}
    with path.open(encoding="utf-8-sig", newline="") as file:
        try:
            names, coords, *rows = csv.reader(file)
        except (UnicodeDecodeError, csv.Error, ValueError) as error:
            expected = "two header rows and a row per frame, comma-separated text in UTF-8"
            raise InputError(Problem(path, "text", str(error), expected)) from None
    problems = list(_segment_problems(path, names, coords, rows))
    if problems:
        raise InputError(problems[:PROBLEMS_SHOWN])
    columns = tuple(Column("", name.strip(), c.strip()) for name, c in zip(names[2:], coords[2:], strict=True))
    numbers = np.array([[float(cell or "nan") for cell in row[2:]] for row in rows])
    pieces = np.array([row[0] for row in rows])
    frames = np.array([int(row[1]) for row in rows])
    segments = {}
    for piece in dict.fromkeys(pieces.tolist()):
        of = pieces == piece
        joints, xyz_m = gather(Table(columns, numbers[of], frames[of], ()), path, required=("x", "y", "z"))
        segments[piece] = Pose3D(joints, xyz_m, frames[of], source=str(path))
    return segments


def _segment_problems(path: Path, names: list[str], coords: list[str], rows: list[list[str]]) -> Iterator[Problem]:
    if len(coords) != len(names) or not {c.strip() for c in coords[2:]} <= {"x", "y", "z"}:
        yield Problem(path, "line 2", ", ".join(dict.fromkeys(coords)), f"two blanks and {len(names) - 2} of x, y, z")
    if not rows:
        yield Problem(path, "rows", "no frames", "at least one row below the header")
    last: dict[str, int] = {}
    for line, row in enumerate(rows, start=3):
        if len(row) != len(names):
            yield Problem(path, f"line {line}", f"{len(row)} cells", f"{len(names)}, as in the header")
            continue
        frame = int(row[1]) if row[1].isdecimal() else None
        if frame is None or frame <= last.get(row[0], -1):
            expected = f"a frame number after {last[row[0]]}" if row[0] in last else "a frame number (0, 1, 2, ...)"
            yield Problem(path, f"line {line}, frame", f"'{row[1]}'", expected)
        else:
            last[row[0]] = frame
        for name, coord, cell in zip(names[2:], coords[2:], row[2:], strict=False):
            if not _is_number(cell):
                yield Problem(path, f"line {line}, column {name}/{coord}", f"'{cell}'", "a number or an empty cell")


def _is_number(cell: str) -> bool:
    """Whether a cell is empty or holds a number that is not infinite."""
    try:
        return not np.isinf(float(cell or "nan"))
    except ValueError:
        return False
