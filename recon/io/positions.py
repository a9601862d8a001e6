"""Read 3D positions of any format, in metres with z up."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from recon.base.documents import read_head
from recon.base.errors import InputError, Problem, collect_problems
from recon.io.common import Pose3D, StoredPoints, text_rows
from recon.io.deeplabcut import points_of_rows
from recon.io.formats import Format, read_points

PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
UNIT_NAMES = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), "cm"),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
}


_AXES_OF_UP = {
    "z": ((0, 1), (1, 1), (2, 1)),
    "y": ((0, 1), (2, -1), (1, 1)),
    "x": ((1, 1), (2, 1), (0, 1)),
    "-z": ((0, 1), (1, -1), (2, -1)),
    "-y": ((0, 1), (2, 1), (1, -1)),
    "-x": ((1, 1), (2, -1), (0, -1)),
}
"""Axis and sign in the file of x, y and z in a world with z up, keyed by the file's upward axis."""


def read_pose3d(
    path: str | Path, individual: str | None = None, unit: str | None = None, up: str | None = None
) -> Pose3D:
    """Return the 3D positions in a file of any known format, in metres with z up.

    Parameters
    ----------
    path : path
        File in any known format of 3D positions.
    individual : str, optional
        Name of the animal, needed if there are several.
    unit, up : str, optional
        Unit (m, cm, mm) and upward axis (y, z, x, -y, -z, -x), if the file does not state them. If neither the file nor
        `up` states an axis, y is assumed to point up in TRC and BVH, and z in all other formats.

    Raises
    ------
    InputError
        If the file is missing, of no known format, or faulty, if the unit is missing or unknown, or if the unit or the
        axis contradicts the file.
    """
    reader, stored = read_points(path, individual, "3D")
    return in_metres(Path(path), reader, stored, unit, up)


def in_metres(path: Path, reader: Format, stored: StoredPoints, unit: str | None, up: str | None) -> Pose3D:
    """Return a file's positions in metres with z up.

    `unit` and `up` are what the user states, as described in `read_pose3d`.

    Raises
    ------
    InputError
        If the unit is missing or unknown, or if the unit or the axis contradicts the file.
    """
    notes, problems = list(stored.notes), []
    for name, option, stated in (("unit", unit, stored.unit), ("up", up, stored.up)):
        if option is not None and stated is not None and option != stated:
            problems.append(Problem(path, name, f"{option} as given, but {stated} in the file", "the same in both"))
    unit = unit or stored.unit or reader.unit
    if unit not in PER_METRE:
        detail = "no unit in the file" if unit is None else unit
        problems.append(Problem(path, "unit", detail, f"one of: {', '.join(PER_METRE)} (--unit)"))
    if up is None and stored.up is None and reader.up != "z":
        assumed = f"it was read with {reader.up} up, as is usual for the format"
        notes.append(f"The file does not say which way is up: {assumed}. If that is wrong, give --up z.")
    up = up or stored.up or reader.up
    if up not in _AXES_OF_UP:
        problems.append(Problem(path, "up", up, "y or z, or -y if y points down (--up)"))
    if problems or unit is None:
        raise InputError(problems)
    with np.errstate(invalid="ignore"):  # damaged floats can be signalling NaNs
        xyz_m = stored.values / PER_METRE[unit]
    return Pose3D(
        stored.names,
        xyz_m if up == "z" else np.stack([sign * xyz_m[..., axis] for axis, sign in _AXES_OF_UP[up]], axis=-1),
        stored.frames,
        source=str(path),
        fps=stored.fps,
        edges=stored.edges,
        notes=tuple(notes),
    )


def read_pose_segments(path: str | Path) -> dict[str, Pose3D]:
    """Return the segments of motion in one CSV file, as a dictionary whose keys are the segments' names.

    The file has a first header row `segment, frame, <joints>`, a second with x, y, z, and positions in metres. Any
    other file that `read_pose3d` reads is one segment with the file's name.

    Raises
    ------
    InputError
        If the file is invalid, or is not in a format of 3D positions.
    """
    path = Path(path)
    if not read_head(path).removeprefix(b"\xef\xbb\xbf").startswith(b"segment,frame,"):
        return {path.stem: read_pose3d(path)}
    rows = text_rows(path, ",")
    names, coords = next(rows)[1], next(rows, (2, []))[1]
    if len(coords) != len(names):
        raise InputError(Problem(path, "line 2", f"{len(coords)} cells", f"{len(names)} cells, as in line 1"))
    pieces: dict[str, list[tuple[int, list[str]]]] = {}
    for line, row in rows:
        pieces.setdefault(row[0], []).append((line, row[1:]))
    if not pieces:
        raise InputError(Problem(path, "rows", "no frames", "at least one row below the header"))
    header = {"bodyparts": names[2:], "coords": coords[2:]}
    try:
        segments = collect_problems(*(partial(_piece, path, header, rows) for rows in pieces.values()))
    except InputError as error:  # all segments have the same header
        raise InputError(list(dict.fromkeys(error.problems))) from None
    return dict(zip(pieces, segments, strict=True))


def _piece(path: Path, header: dict[str, list[str]], rows: list[tuple[int, list[str]]]) -> Pose3D:
    stored = points_of_rows(path, header, rows, 1)
    if not stored.in_space:
        raise InputError(Problem(path, "line 2", "no z", "the columns x, y, z of each joint"))
    return Pose3D(stored.names, stored.values, stored.frames, source=str(path), notes=stored.notes)
