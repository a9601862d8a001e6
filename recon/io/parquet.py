"""Parquet tables of 3D positions, with the columns of a plain table (see `recon.io.columns`)."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from recon.errors import InputError, Problem
from recon.io.column_map import find_layout
from recon.io.columns import stored_pose
from recon.io.common import formats_extra, rate, starts_with
from recon.io.pose import StoredPose

METADATA = b"recon"
"""Key of our own metadata: JSON with fps and up."""


def recognises(path: Path) -> bool:
    return starts_with(path, b"PAR1")


def read_pose(path: Path, individual: str | None = None) -> StoredPose:
    """Raises InputError."""
    with formats_extra(path):
        import pyarrow as pa
        import pyarrow.parquet as pq
    try:
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
    layout = find_layout(path, table.column_names)
    if not layout.has_z:
        raise InputError(Problem(path, "columns", ", ".join(table.column_names)[:120], "x, y, z: 3D positions"))
    pose = stored_pose(path, columns, layout, individual)
    if not isinstance(own, dict):
        return pose
    return replace(pose, fps=pose.fps or rate(own.get("fps")), up="z" if own.get("up") == "z" else None)
