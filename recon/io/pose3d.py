"""3D positions by joint and frame: the table of their formats, and motions for priors.

A new format is one module with `recognises(path)` and `read_pose(path, individual)`, and one line in `POSE_READERS`.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.errors import InputError, Problem
from recon.io import READERS, bvh, c3d, columns, describe, file_head, movement, npz, nwb, parquet, trc
from recon.io import deeplabcut_pose as dlc
from recon.io.common import PROBLEMS_SHOWN, frame_number, number
from recon.io.deeplabcut import Column, Table, gather
from recon.io.pose import PER_METRE, Pose3D, StoredPose, z_up_from_y_up


@dataclass(frozen=True)
class PoseReader:
    """One format of 3D positions."""

    name: str
    recognises: Callable[[Path], bool]
    """Whether a readable file, not empty, is of this format and 3D; it looks at the content, not at the name."""
    read: Callable[[Path, str | None], StoredPose]
    """The positions of one animal as the file has them; raises InputError."""
    unit: str | None = None
    """Where the file does not say it; None for one that the user has to give."""
    up: str = "z"
    """Where the file does not say it."""


POSE_READERS: tuple[PoseReader, ...] = (
    PoseReader("pose3d.csv, DeepLabCut 3D CSV or H5", dlc.recognises_pose, dlc.read_pose, unit="m"),
    PoseReader("TRC", trc.recognises, trc.read_pose, up="y"),
    PoseReader("C3D", c3d.recognises, c3d.read_pose),
    PoseReader("BVH", bvh.recognises, bvh.read_pose, up="y"),
    PoseReader("NPZ", npz.recognises, npz.read_pose),
    PoseReader("Parquet", parquet.recognises, parquet.read_pose),
    PoseReader("movement netCDF", movement.recognises_pose, movement.read_pose),
    PoseReader("ndx-pose NWB", nwb.recognises_pose, nwb.read_pose),
    PoseReader("plain CSV", columns.recognises_pose, columns.read_pose),
)


def read_pose3d(
    path: str | Path, individual: str | None = None, unit: str | None = None, up: str | None = None
) -> Pose3D:
    """Positions in any known format, in metres, z up.

    unit (m, cm, mm) and up (y, z): what the file does not say of itself. Where neither says it, DeepLabCut's layouts
    are metres, TRC and BVH y up, and all others z up. individual: the animal's name, needed where there are several.
    Raises InputError for a file that is missing, of no known format, or faulty, and for a unit that nobody states.
    """
    path = Path(path)
    head = file_head(path)
    for reader in POSE_READERS:
        if reader.recognises(path):
            return in_metres(path, reader, reader.read(path, individual), unit, up)
    known = next((r.name for r in READERS if r.recognises(path)), None)
    if known is None:
        expected = "one of: " + ", ".join(r.name for r in POSE_READERS)
        raise InputError(Problem(path, "format", describe(head), expected))
    raise InputError(Problem(path, "coords", f"no z ({known})", "x, y, z: 3D positions"))


def in_metres(path: Path, reader: PoseReader, stored: StoredPose, unit: str | None, up: str | None) -> Pose3D:
    """The positions of a file in our unit and axes; unit and up as for `read_pose3d`. Raises InputError."""
    notes = list(stored.notes)
    problems = [
        Problem(path, name, f"{given} as given, but {stated} in the file", "one of the two")
        for name, given, stated in (("unit", unit, stored.unit), ("up", up, stored.up))
        if given is not None and stated is not None and given != stated
    ]
    unit = unit or stored.unit or reader.unit
    if unit not in PER_METRE:
        found = "none in the file" if unit is None else unit
        problems.append(Problem(path, "unit", found, f"one of: {', '.join(PER_METRE)} (--unit)"))
    if up is None and stored.up is None and reader.up != "z":
        notes.append(f"The file does not say which way is up: read as {reader.up} up, as is the custom (or --up z).")
    up = up or stored.up or reader.up
    if up not in ("y", "z"):
        problems.append(Problem(path, "up", up, "y or z (--up)"))
    if problems or unit is None:
        raise InputError(problems)
    with np.errstate(invalid="ignore"):  # a NaN that signals, as damaged floats can be
        xyz_m = stored.xyz / PER_METRE[unit]
    return Pose3D(
        stored.names,
        z_up_from_y_up(xyz_m) if up == "y" else xyz_m,
        stored.frames,
        source=str(path),
        fps=stored.fps,
        edges=stored.edges,
        notes=tuple(notes),
    )


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
    numbers = np.array([[number(cell.strip()) for cell in row[2:]] for row in rows])
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
        frame = frame_number(row[1])
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
        return not np.isinf(number(cell.strip()))
    except ValueError:
        return False
