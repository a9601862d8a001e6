"""3D positions in DeepLabCut's layout, CSV or H5: header rows `bodyparts, coords`, and `scorer` if need be."""

from __future__ import annotations

import csv
from itertools import islice
from pathlib import Path

from recon.errors import InputError
from recon.io.deeplabcut import gather, of_one_animal, read_table, recognises
from recon.io.hdf5 import is_hdf5
from recon.io.pose import StoredPose

HEADER_ROWS = 4


def recognises_pose(path: Path) -> bool:
    """Whether it is DeepLabCut's, with a coordinate z."""
    if not recognises(path):
        return False
    if is_hdf5(path):
        try:
            return any(column.coord == "z" for column in read_table(path).columns)
        except InputError:
            return True  # which `read_pose` says in its own words
    with path.open(encoding="utf-8-sig", newline="", errors="replace") as file:
        rows = list(islice(csv.reader(file), HEADER_ROWS))
    return any(row[:1] == ["coords"] and "z" in (cell.strip() for cell in row) for row in rows)


def read_pose(path: Path, individual: str | None = None) -> StoredPose:
    """x, y, z of each joint; the file does not say its unit. Raises InputError."""
    table, _ = of_one_animal(read_table(path), path, individual)
    names, xyz = gather(table, path, required=("x", "y", "z"))
    return StoredPose(names, xyz, table.frames, fps=table.fps, notes=table.notes)
