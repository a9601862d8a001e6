"""Parquet tables of 3D positions, with the columns of a plain table (see `recon.io.columns`)."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from recon.errors import InputError, Problem
from recon.io.column_map import find_layout
from recon.io.columns import gather
from recon.io.common import formats_extra, rate, starts_with
from recon.io.pose import StoredPoints

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
