"""Parquet tables of 3D positions, with the columns of a plain table (see `recon.io.columns`)."""

from __future__ import annotations

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np

from recon.base.errors import InputError, Problem
from recon.base.files import write_bytes
from recon.io.column_map import find_layout
from recon.io.columns import gather
from recon.io.common import POINTS_MAX, formats_extra, rate, starts_with
from recon.io.pose import Pose3D, StoredPoints

VALUES_MAX = 4 * POINTS_MAX
METADATA = b"recon"
"""Key of our own metadata: JSON with fps and up."""


def recognises(path: Path) -> bool:
    return starts_with(path, b"PAR1")


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Raises InputError."""
    with formats_extra(path):
        import pyarrow as pa
        import pyarrow.parquet as pq
    try:
        size = pq.read_metadata(path)  # a column of equal values takes no room in the file
        if size.num_rows * size.num_columns > VALUES_MAX:
            raise ValueError(f"{size.num_rows} rows of {size.num_columns} columns are too much")
        table = pq.read_table(path)
        own = json.loads((table.schema.metadata or {}).get(METADATA, b"{}"))
        columns = {}
        for name in table.column_names:
            column = table.column(name)
            numeric = pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
            columns[name] = np.asarray(column.to_numpy(), dtype=float) if numeric else column.to_pylist()
    except (OSError, ValueError, RecursionError, MemoryError, LookupError, pa.ArrowException) as error:
        found = f"data that cannot be read ({' '.join(str(error).split())[:200]})"
        raise InputError(Problem(path, "content", found, "a whole file")) from None
    if not table.num_rows:
        raise InputError(Problem(path, "rows", "none", "at least one"))
    pose = gather(path, columns, find_layout(path, table.column_names), individual)
    if not isinstance(own, dict):
        return pose
    return replace(pose, fps=pose.fps or rate(own.get("fps")), up="z" if own.get("up") == "z" else None)


# -- writing ---------------------------------------------------------------------------------------------------------


def write(pose: Pose3D, path: Path) -> None:
    """One row for each frame and joint: frame, joint, x_m, y_m, z_m (metres, z up)."""
    with formats_extra("Parquet"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    T, J = pose.xyz_m.shape[:2]
    table = pa.table(
        {
            "frame": pa.array(np.repeat(pose.frames, J), pa.int64()),
            "joint": pa.array(list(pose.names) * T, pa.string()),
            **{f"{axis}_m": pa.array(pose.xyz_m[..., i].ravel(), pa.float64()) for i, axis in enumerate("xyz")},
        }
    )
    about = {"fps": pose.fps, "unit": "m", "up": "z", "notes": pose.notes}
    made = BytesIO()
    pq.write_table(table.replace_schema_metadata({METADATA: json.dumps(about)}), made)
    write_bytes(path, made.getvalue())
