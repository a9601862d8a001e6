"""DeepLabCut's H5 files: the table of `recon.io.deeplabcut`, as pandas keeps it in HDF5.

pandas and PyTables would unpickle whatever a file holds. Here tables are read without them, in pandas' fixed and in its
table layout: cells are numbers or texts, and the column labels, which are pickled in the table layout, are lists and
tuples of texts; anything else is refused.
"""

from __future__ import annotations

import pickle
import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

from recon.base import InputError, Problem
from recon.base.files import write_bytes
from recon.clip import Keypoints
from recon.io.common import Pose3D, StoredPoints
from recon.io.deeplabcut import HEADERS, Table, header_problem, points_of_table
from recon.io.hdf5 import attribute, child, groups, is_hdf5, member, numbers, opened, raw_attribute, read_values
from recon.io.writing import deeplabcut_layout, formats_extra

KEY = "df_with_missing"
ANY_PANDAS = "0.15.2"
"""As the version of pandas that wrote a file: with it, pandas 2 and 3 read it alike."""
MAX_PICKLE_BYTES = 1 << 24
PLAIN_PICKLES = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "STRING", "SHORT_BINSTRING", "BINSTRING"),
    *("NONE", "NEWTRUE", "NEWFALSE", "EMPTY_LIST", "EMPTY_DICT", "EMPTY_TUPLE", "MARK", "LIST", "TUPLE", "DICT"),
    *("TUPLE1", "TUPLE2", "TUPLE3", "APPEND", "APPENDS", "SETITEM", "SETITEMS", "PROTO", "FRAME", "STOP"),
    *("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE", "GET", "BINGET", "LONG_BINGET"),
}
"""Instructions of pickles that build texts, numbers, lists, tuples and dictionaries, and import or call nothing."""

Label = tuple[str, ...]


def recognises(path: Path) -> bool:
    """Whether an HDF5 file has a pandas table. Raises InputError for one that cannot be opened."""
    return is_hdf5(path) and bool(_keys(path))


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one animal (see `recon.io.deeplabcut.points_of_table`). Raises InputError, also for anything else
    than one table, and for cells or labels that are pickled Python objects."""
    keys = _keys(path)
    if len(keys) != 1:
        raise InputError(Problem(path, "keys", ", ".join(keys) or "none", "one table"))
    with opened(path) as file:
        group = child(file, keys[0])
        kind = attribute(group, "pandas_type")
        layouts: dict[Any, Callable[[Any], Table]] = {"frame": _fixed_frame, "frame_table": _table_frame}
        if kind not in layouts:
            raise InputError(Problem(path, f"key {keys[0]}", f"pandas' '{kind}'", "a table"))
        table = layouts[kind](group)
    if not any(table.levels):
        known = {2: HEADERS[2], 3: HEADERS[0], 4: HEADERS[1]}
        table = table._replace(levels=known.get(len(table.levels), table.levels))
    if tuple(table.levels) not in HEADERS:
        raise InputError(header_problem(path, f"column levels {', '.join(map(str, table.levels))}"))
    return points_of_table(path, individual, table)


def _keys(path: Path) -> list[str]:
    """Where in an HDF5 file pandas stored something. Raises InputError for a file that cannot be opened."""
    with opened(path, outline=True) as file:
        return [str(group.name) for group in groups(file) if h5py.h5a.exists(group.id, b"pandas_type")]


# -- fixed layout: the axes and the blocks of columns of one type, each an array ---------------------------------


def _fixed_frame(group: Any) -> Table:
    levels, columns = _axis(group, "axis0")
    _, index = _axis(group, "axis1")
    free: dict[Label, list[int]] = {}
    for at, label in enumerate(columns):
        free.setdefault(label, []).append(at)
    cells = np.full((len(index), len(columns)), np.nan)
    for block in range(int(attribute(group, "nblocks"))):
        _, items = _axis(group, f"block{block}_items")
        dataset = member(group, f"block{block}_values")
        if not _is_empty(dataset):  # stored as (C, T), and turned over where it says so
            values = numbers(dataset)
            places = [free[label].pop(0) for label in items]
            cells[:, places] = values if attribute(dataset, "transposed") else values.T
    return Table(levels, columns, index, cells)


def _axis(group: Any, name: str) -> tuple[list[str | None], list[Label]]:
    """Names of the levels, and labels."""
    if attribute(group, f"{name}_variety") != "multi":
        dataset = member(group, name)
        return [_attribute_value(dataset, "name")], [(label,) for label in _labels(group, dataset)]
    levels, parts = [], []
    for i in range(int(attribute(group, f"{name}_nlevels"))):
        level = member(group, f"{name}_level{i}")
        texts = np.array([*_labels(group, level), "nan"], object)  # code -1
        codes = numbers(member(group, f"{name}_label{i}")).ravel()
        if codes.min(initial=0) < -1:
            raise ValueError(f"{name}_label{i} has codes without a label")
        parts.append(texts[codes].tolist())
        levels.append(_attribute_value(level, "name"))
    return levels, list(zip(*parts, strict=True))


def _labels(group: Any, dataset: Any) -> list[str]:
    """One level of labels as texts."""
    return [] if _is_empty(dataset) else _texts_of(group, read_values(dataset).ravel())


def _texts_of(group: Any, values: np.ndarray) -> list[str]:
    if values.dtype.kind != "S":
        return [str(value) for value in values.tolist()]
    encoding = "utf-8" if str(attribute(group, "encoding") or "UTF-8").upper() in ("UTF-8", "ASCII") else "latin-1"
    return [value.decode(encoding) for value in values.tolist()]


def _is_empty(dataset: Any) -> bool:
    """pandas stores an array without elements as one with one, and its shape beside it. Raises ValueError for cells
    that are pickled."""
    if attribute(dataset, "PSEUDOATOM") is not None:
        raise ValueError("cells that are pickled Python objects, which could run anything")
    return 0 in (_attribute_value(dataset, "shape") or ())


# -- table layout: one array of records, and the labels of its columns pickled -----------------------------------


def _table_frame(group: Any) -> Table:
    ((_, given),) = _attribute_value(group, "non_index_axes")
    columns = [_label(label) for label in given]
    dataset = member(group, "table")
    rows = read_values(dataset)
    cells = np.full((len(rows), len(columns)), np.nan)
    for name in _attribute_value(group, "values_cols"):
        places = [columns.index(_label(label)) for label in _attribute_value(dataset, f"{name}_kind")]
        cells[:, places] = rows[str(name)].reshape(len(rows), -1)
    names = ((_attribute_value(group, "info") or {}).get(1) or {}).get("names")
    levels = names if names and len(names) == len(columns[0]) else [None] * len(columns[0])
    return Table(levels, columns, [(text,) for text in _texts_of(group, rows["index"])], cells)


def _label(label: Any) -> Label:
    return tuple(str(part) for part in (label if isinstance(label, tuple) else (label,)))


# -- both ---------------------------------------------------------------------------------------------------------


def _attribute_value(holder: Any, name: str) -> Any:
    """An attribute as PyTables writes it: a text or number as it is, anything else pickled, which ends in a dot."""
    value = raw_attribute(holder, name)
    if not isinstance(value, bytes):
        return value
    if len(value) < 2 or not value.endswith(b"."):
        return value.decode("utf-8")
    try:
        return plain_pickle(value)
    except ValueError as error:
        raise ValueError(f"{name} is {error}, which could run anything") from None


def plain_pickle(content: bytes) -> Any:
    """The value of a pickle of plain values. A pickle is a program: it is run only if all of its instructions are among
    `PLAIN_PICKLES`. Raises ValueError that says what else is in it."""
    if len(content) > MAX_PICKLE_BYTES:
        raise ValueError(f"a pickle of {len(content)} bytes")
    try:
        for opcode, argument, _ in pickletools.genops(content):
            if opcode.name not in PLAIN_PICKLES:
                raise ValueError(f"a pickled Python object ({opcode.name} {argument or ''}".rstrip() + ")")
            if opcode.name in ("PUT", "LONG_BINPUT") and int(argument or 0) > len(content):
                raise ValueError("a damaged pickle")  # a place that memory would be taken for
        return pickle.loads(content)
    except (ArithmeticError, AttributeError, LookupError, TypeError, EOFError, pickle.UnpicklingError):
        raise ValueError("a damaged pickle") from None


# -- writing ------------------------------------------------------------------------------------------------------


def write(data: Keypoints | Pose3D, path: Path) -> None:
    """x, y and likelihood, or x, y, z in metres with z up, by pandas, as DeepLabCut writes its own."""
    import pandas as pd

    with formats_extra("DeepLabCut H5"):
        import tables  # noqa: F401  what pandas writes with
    header, frames, values = deeplabcut_layout(data)
    columns = pd.MultiIndex.from_arrays([*header.values()], names=[*header])
    table = pd.DataFrame(values, pd.Index(frames), columns)
    in_memory: dict[str, Any] = {"driver": "H5FD_CORE", "driver_core_backing_store": 0}
    with cast(Any, pd.HDFStore(str(path), mode="w", **in_memory)) as store:
        store.put(KEY, table, format="table", index=False, track_times=False)
        store.get_storer(KEY).attrs.pandas_version = ANY_PANDAS
        content = store._handle.get_file_image()
    write_bytes(path, content)
