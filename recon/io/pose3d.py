"""3D positions by joint and frame, in metres, z up; and motions for priors."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.io.common import MAX_FRAME, PROBLEMS_SHOWN, frame_number, numbers
from recon.io.deeplabcut import Column, PointTable, gather
from recon.io.formats import Format, file_head, read_points
from recon.io.pose import PER_METRE, Pose3D, StoredPoints, z_up_from_y_up
from recon.io.table import text_rows


def read_pose3d(
    path: str | Path, individual: str | None = None, unit: str | None = None, up: str | None = None
) -> Pose3D:
    """Positions in any known format, in metres, z up.

    unit (m, cm, mm) and up (y, z): what the file does not say of itself. Where neither says it, DeepLabCut's layouts
    are metres, TRC and BVH y up, and all others z up. individual: the animal's name, needed where there are several.
    Raises InputError for a file that is missing, of no known format, or faulty, and for a unit that nobody states.
    """
    reader, stored = read_points(path, individual, "3D")
    return in_metres(Path(path), reader, stored, unit, up)


def in_metres(path: Path, reader: Format, stored: StoredPoints, unit: str | None, up: str | None) -> Pose3D:
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
        xyz_m = stored.values / PER_METRE[unit]
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
    rows = [row for _, row in text_rows(path, ",")]
    if len(rows) < 2:
        raise InputError(Problem(path, "text", f"{len(rows)} rows", "two header rows and a row per frame"))
    names, coords, *rows = rows
    problems = list(_segment_problems(path, names, coords, rows))
    refuse(problems[:PROBLEMS_SHOWN])
    columns = tuple(Column("", name.strip(), c.strip()) for name, c in zip(names[2:], coords[2:], strict=True))
    values = np.array([numbers(row[2:])[0] for row in rows])
    pieces = np.array([row[0] for row in rows])
    frames = np.array([int(row[1]) for row in rows])
    segments = {}
    for piece in dict.fromkeys(pieces.tolist()):
        of = pieces == piece
        joints, xyz_m = gather(PointTable(columns, values[of], frames[of], ()), path, required=("x", "y", "z"))
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
        frame = frame_number(row[1], -MAX_FRAME)
        if frame is None or frame <= last.get(row[0], -MAX_FRAME - 1):
            expected = f"a frame number after {last[row[0]]}" if row[0] in last else "a frame number (0, 1, 2, ...)"
            yield Problem(path, f"line {line}, frame", f"'{row[1]}'", expected)
        else:
            last[row[0]] = frame
        cells = list(zip(names[2:], coords[2:], row[2:], strict=False))
        for i in numbers(cell for _, _, cell in cells)[1]:
            name, coord, cell = cells[i]
            yield Problem(path, f"line {line}, column {name}/{coord}", f"'{cell}'", "a number or an empty cell")
