"""DeepLabCut's H5 files: the table of `recon.io.deeplabcut`, as pandas keeps it in HDF5."""

from __future__ import annotations

import pickle
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem
from recon.base.files import write_bytes
from recon.clip.keypoints import Keypoints
from recon.io import pandas_hdf
from recon.io.deeplabcut import HEADERS, PointTable, header_problem, layout, points_in, row_numbers, table_of
from recon.io.hdf5 import is_hdf5
from recon.io.pose import Pose3D, StoredPoints

KEY = "df_with_missing"
ANY_PANDAS = "0.15.2"
"""As the version of pandas that wrote a file: with it, pandas 2 and 3 read it alike."""
BLOCK = "values_block_0"
MAX_SMALL_ATTRIBUTE = 60_000
"""Bytes; larger ones need HDF5's format of version 1.8."""


def recognises(path: Path) -> bool:
    """Whether an HDF5 file has a pandas table. Raises InputError for one that cannot be opened."""
    return is_hdf5(path) and bool(pandas_hdf.keys(path))


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one animal (see `recon.io.deeplabcut.points_in`). Raises InputError."""
    return points_in(read_table(path), path, individual)


def read_table(path: Path) -> PointTable:
    """All of a file that is recognised. Raises InputError."""
    keys = pandas_hdf.keys(path)
    if len(keys) != 1:
        raise InputError(Problem(path, "keys", ", ".join(keys) or "none", "one table"))
    frame = pandas_hdf.read_frame(path, keys[0])
    levels = frame.levels
    if not any(levels):
        levels = {2: HEADERS[2], 3: HEADERS[0], 4: HEADERS[1]}.get(len(levels), levels)
    if levels not in HEADERS:
        raise InputError(header_problem(path, f"column levels {', '.join(map(str, levels))}"))
    bad: list[tuple[int, int, str]] = []
    cells = frame.cells
    if cells.dtype == object:
        texts = ["" if cell != cell else str(cell) for cell in cells.ravel().tolist()]
        cells = row_numbers(texts, cells.shape[1], 0, bad).reshape(cells.shape)
    return table_of(path, levels, frame.columns, frame.index, cells, bad, [])


def image_names(path: Path) -> list[str]:
    """The labels of the rows of an HDF5 file's table, parts of paths joined. Raises InputError."""
    (key,) = pandas_hdf.keys(path)
    return ["/".join(label) for label in pandas_hdf.read_frame(path, key).index]


def write(data: Keypoints | Pose3D, path: Path) -> None:
    """x, y and likelihood, or x, y, z in metres with z up, as `pandas.DataFrame.to_hdf(key=KEY, format="table")` would,
    but without PyTables' index of the frames."""
    import h5py

    header, frames, values = layout(data)
    columns = list(zip(*header.values(), strict=True))
    rows = np.empty(len(frames), [("index", "<i8"), (BLOCK, "<f8", (len(columns),))])
    rows["index"], rows[BLOCK] = frames, values
    group_attributes = {
        "pandas_type": "frame_table",
        "pandas_version": ANY_PANDAS,
        "encoding": "UTF-8",
        "errors": "strict",
        "table_type": "appendable_frame",
        "index_cols": [(0, "index")],
        "values_cols": [BLOCK],
        "data_columns": [],
        "non_index_axes": [(1, columns)],
        "nan_rep": "nan",
        "levels": 1,
        "info": {1: {"names": list(header), "type": "MultiIndex"}, "index": {}},
    }
    table_attributes = {
        "CLASS": "TABLE",
        "VERSION": "2.7",
        "FIELD_0_NAME": "index",
        "FIELD_1_NAME": BLOCK,
        "FIELD_0_FILL": 0,
        "FIELD_1_FILL": 0.0,
        "NROWS": len(frames),
        "index_kind": "integer",
        f"{BLOCK}_dtype": "float64",
        f"{BLOCK}_kind": columns,
        f"{BLOCK}_meta": None,
    }
    large = len(pickle.dumps(columns, 0)) > MAX_SMALL_ATTRIBUTE
    content = BytesIO()
    with h5py.File(content, "w", libver=("v108", "latest") if large else ("earliest", "latest")) as file:
        _describe(file, {"CLASS": "GROUP", "VERSION": "1.0", "PYTABLES_FORMAT_VERSION": "2.1"})
        group = file.create_group(KEY)
        _describe(group, {"CLASS": "GROUP", "VERSION": "1.0", **group_attributes})
        _describe(group.create_dataset("table", data=rows, chunks=True, maxshape=(None,)), table_attributes)
    write_bytes(path, content.getvalue())


def _describe(holder: Any, attributes: dict[str, Any]) -> None:
    """Attributes as PyTables has them: texts and numbers as they are, everything else pickled."""
    import h5py

    holder.attrs["TITLE"] = h5py.Empty("S1")
    for name, value in attributes.items():
        if isinstance(value, str):
            text = value.encode()
            holder.attrs.create(name, np.array(text), dtype=h5py.string_dtype("utf-8", len(text)))
        elif isinstance(value, int | float):
            holder.attrs[name] = value
        else:
            holder.attrs[name] = np.bytes_(pickle.dumps(value, 0))
