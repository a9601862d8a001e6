"""DeepLabCut's H5 files: the table of `recon.io.deeplabcut`, as pandas keeps it in HDF5.

pandas and PyTables would unpickle whatever a file holds. Here tables are read without them, in pandas' fixed and in its
table layout: cells are numbers or texts, and the column labels, which are pickled in the table layout, are lists and
tuples of texts; anything else is refused.
"""

from __future__ import annotations

import pickle
import pickletools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

from recon.base.errors import InputError, Problem
from recon.base.files import write_bytes
from recon.clip.keypoints import Keypoints
from recon.io.common import formats_extra, is_hdf5
from recon.io.deeplabcut import HEADERS, PointTable, header_problem, layout, points_in, row_numbers, table_of
from recon.io.hdf5 import attribute, child, groups, names, numbers, opened, raw_attribute, read_values
from recon.io.pose import Pose3D, StoredPoints

KEY = "df_with_missing"
ANY_PANDAS = "0.15.2"
"""As the version of pandas that wrote a file: with it, pandas 2 and 3 read it alike."""
MAX_LEVELS, MAX_BLOCKS, MAX_PICKLE_BYTES = 8, 1000, 1 << 24
NUMBER_KINDS = ("integer", "float")
PLAIN_PICKLES = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "STRING", "SHORT_BINSTRING", "BINSTRING"),
    *("NONE", "NEWTRUE", "NEWFALSE", "EMPTY_LIST", "EMPTY_DICT", "EMPTY_TUPLE", "MARK", "LIST", "TUPLE", "DICT"),
    *("TUPLE1", "TUPLE2", "TUPLE3", "APPEND", "APPENDS", "SETITEM", "SETITEMS", "PROTO", "FRAME", "STOP"),
    *("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE", "GET", "BINGET", "LONG_BINGET"),
}
"""Instructions of pickles that build texts, numbers, lists, tuples and dictionaries, and import or call nothing."""

Label = tuple[str, ...]


class _NotPlain(Exception):
    """Something that only unpickling could read."""


@dataclass(frozen=True, eq=False)
class _StoredTable:
    """A table of T rows and C columns."""

    levels: tuple[str | None, ...]
    """The names of the columns' levels."""
    columns: tuple[Label, ...]
    """C labels, one text for each level."""
    index: tuple[Label, ...]
    """T labels of the rows."""
    cells: np.ndarray
    """(T, C): float, or object with floats and texts."""


def recognises(path: Path) -> bool:
    """Whether an HDF5 file has a pandas table. Raises InputError for one that cannot be opened."""
    return is_hdf5(path) and bool(_keys(path))


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one animal (see `recon.io.deeplabcut.points_in`). Raises InputError."""
    return points_in(read_table(path), path, individual)


def read_table(path: Path) -> PointTable:
    """All of a file that is recognised. Raises InputError."""
    stored = _stored_table(path)
    levels, cells = stored.levels, stored.cells
    if not any(levels):
        levels = {2: HEADERS[2], 3: HEADERS[0], 4: HEADERS[1]}.get(len(levels), levels)
    if levels not in HEADERS:
        raise InputError(header_problem(path, f"column levels {', '.join(map(str, levels))}"))
    bad: list[tuple[int, int, str]] = []
    if cells.dtype == object:
        texts = ["" if cell != cell else str(cell) for cell in cells.ravel().tolist()]
        cells = row_numbers(texts, cells.shape[1], bad).reshape(cells.shape)
    return table_of(path, levels, stored.columns, stored.index, cells, bad, [])


def image_names(path: Path) -> list[str]:
    """The labels of the rows of an HDF5 file's table, parts of paths joined. Raises InputError."""
    return ["/".join(label) for label in _stored_table(path).index]


def _keys(path: Path) -> list[str]:
    """Where in an HDF5 file pandas stored something. Raises InputError for a file that cannot be opened."""
    with opened(path, outline=True) as file:
        return [str(group.name) for group in groups(file) if h5py.h5a.exists(group.id, b"pandas_type")]


def _stored_table(path: Path) -> _StoredTable:
    """The only table of a file. Raises InputError for anything else than a table, and for cells or labels that are
    pickled Python objects."""
    keys = _keys(path)
    if len(keys) != 1:
        raise InputError(Problem(path, "keys", ", ".join(keys) or "none", "one table"))
    with opened(path) as file:
        group = child(file, keys[0])
        kind = attribute(group, "pandas_type")
        layouts = {"frame": _fixed_frame, "frame_table": _table_frame}
        if kind not in layouts:
            kinds = {"series": "a Series", "series_table": "a Series"}
            raise InputError(Problem(path, f"key {keys[0]}", kinds.get(str(kind), f"'{kind}'"), "a table"))
        try:
            return layouts[kind](group)
        except _NotPlain as error:
            expected = "a table of numbers, without Python objects, which could run anything"
            raise InputError(Problem(path, f"key {keys[0]}", str(error), expected)) from None


# -- fixed layout: the axes and the blocks of columns of one type, each an array ---------------------------------


def _fixed_frame(group: Any) -> _StoredTable:
    levels, columns = _axis(group, "axis0")
    _, index = _axis(group, "axis1")
    free: dict[Label, list[int]] = {}
    for at, label in enumerate(columns):
        free.setdefault(label, []).append(at)
    parts: list[tuple[list[int], np.ndarray]] = []
    for block in range(_count(attribute(group, "nblocks"), MAX_BLOCKS)):
        _, items = _axis(group, f"block{block}_items")
        dataset = _required_child(group, f"block{block}_values")
        if not _is_empty(dataset):  # stored as (C, T), and turned over where it says so
            values = read_values(dataset)
            parts.append(
                ([free[label].pop(0) for label in items], values if attribute(dataset, "transposed") else values.T)
            )
    return _StoredTable(levels, columns, index, _table_of_blocks(len(index), len(columns), parts))


def _axis(group: Any, name: str) -> tuple[tuple[str | None, ...], tuple[Label, ...]]:
    """Names of the levels, and labels."""
    if attribute(group, f"{name}_variety") != "multi":
        dataset = _required_child(group, name)
        return (_level_name(dataset),), tuple((label,) for label in _labels(group, dataset))
    count = _count(attribute(group, f"{name}_nlevels"), MAX_LEVELS)
    levels = [_required_child(group, f"{name}_level{i}") for i in range(count)]
    parts = []
    for i, level in enumerate(levels):
        texts = np.array([*_labels(group, level), "nan"], object)  # code -1
        codes = numbers(_required_child(group, f"{name}_label{i}")).ravel()
        if ((codes < -1) | (codes >= len(texts) - 1)).any():
            raise ValueError(f"{name}_label{i} has codes without a label")
        parts.append(texts[codes].tolist())
    return tuple(_level_name(level) for level in levels), tuple(zip(*parts, strict=True))


def _labels(group: Any, dataset: Any) -> list[str]:
    """One level of labels as texts."""
    return [] if _is_empty(dataset) else _texts_of(group, read_values(dataset).ravel(), attribute(dataset, "kind"))


def _texts_of(group: Any, values: np.ndarray, kind: Any) -> list[str]:
    if kind in NUMBER_KINDS and values.dtype.kind in "fiu":
        return [str(value) for value in values.tolist()]
    if kind not in NUMBER_KINDS and values.dtype.kind == "S":
        encoding = "utf-8" if str(attribute(group, "encoding") or "UTF-8").upper() in ("UTF-8", "ASCII") else "latin-1"
        return [value.decode(encoding) for value in values.tolist()]
    raise ValueError(f"labels of kind {kind}")


def _is_empty(dataset: Any) -> bool:
    """pandas stores an array without elements as one with one, and its shape beside it. Raises _NotPlain for cells that
    are pickled."""
    if attribute(dataset, "PSEUDOATOM") is not None:
        raise _NotPlain("cells that are pickled Python objects")
    shape = _attribute_value(dataset, "shape")
    return isinstance(shape, tuple) and 0 in shape


# -- table layout: one array of records, and the labels of its columns pickled -----------------------------------


def _table_frame(group: Any) -> _StoredTable:
    ((axis, given),) = _attribute_value(group, "non_index_axes")
    if axis != 1 or attribute(group, "table_type") != "appendable_frame":
        raise ValueError("a table without labels of its columns")
    columns = tuple(_label(label) for label in given)
    (depth,) = {len(label) for label in columns}
    dataset = _required_child(group, "table")
    rows = read_values(dataset)
    index = _texts_of(group, rows["index"], attribute(dataset, "index_kind"))
    places = {label: at for at, label in enumerate(columns)}
    parts: list[tuple[list[int], np.ndarray]] = []
    for name in _attribute_value(group, "values_cols"):
        labels = [_label(label) for label in _attribute_value(dataset, f"{name}_kind")]
        parts.append(([places[label] for label in labels], rows[str(name)].reshape(len(rows), -1)))
    cells = _table_of_blocks(len(rows), len(columns), parts)
    return _StoredTable(_level_names(group, depth), columns, tuple((label,) for label in index), cells)


def _level_names(group: Any, depth: int) -> tuple[str | None, ...]:
    info = _attribute_value(group, "info")
    about = info.get(1, {}) if isinstance(info, dict) else {}
    found = about.get("names") if isinstance(about, dict) else None
    if not isinstance(found, list | tuple) or len(found) != depth:
        return (None,) * depth
    return tuple(None if name is None else str(name)[:100] for name in found)


def _label(label: Any) -> Label:
    """Raises ValueError for a label of something else than texts and numbers."""
    parts = label if isinstance(label, tuple) else (label,)
    if not parts or len(parts) > MAX_LEVELS or not all(isinstance(p, str | int | float) for p in parts):
        raise ValueError("a column label of something else than texts")
    return tuple(str(part) for part in parts)


# -- both ---------------------------------------------------------------------------------------------------------


def _table_of_blocks(rows: int, columns: int, parts: list[tuple[list[int], np.ndarray]]) -> np.ndarray:
    """(rows, columns): what several blocks have; NaN where none has anything."""
    texts = any(values.dtype.kind == "S" for _, values in parts)
    cells = np.full((rows, columns), np.nan, object if texts else float)
    for at, values in parts:
        if values.shape != (rows, len(at)) or values.dtype.kind not in "fiubS":
            raise ValueError(f"{values.shape} cells of {values.dtype} for {rows} rows and {len(at)} columns")
        cells[:, at] = np.char.decode(values, "utf-8") if values.dtype.kind == "S" else values
    return cells


def _required_child(group: Any, name: str) -> Any:
    found = child(group, name)
    if found is None:
        raise ValueError(f"no {name} in {', '.join(names(group))[:200] or 'an empty group'}")
    return found


def _count(value: Any, most: int) -> int:
    if not isinstance(value, int | np.integer) or not 0 <= value <= most:
        raise ValueError("a number that should say how many there are")
    return int(value)


def _level_name(dataset: Any) -> str | None:
    value = _attribute_value(dataset, "name")
    return None if value is None else str(value)[:100]


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
        raise _NotPlain(f"{name} is {error}") from None


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
    header, frames, values = layout(data)
    columns = pd.MultiIndex.from_arrays([*header.values()], names=[*header])
    table = pd.DataFrame(values, pd.Index(frames), columns)
    in_memory: dict[str, Any] = {"driver": "H5FD_CORE", "driver_core_backing_store": 0}
    with cast(Any, pd.HDFStore(str(path), mode="w", **in_memory)) as store:
        store.put(KEY, table, format="table", index=False, track_times=False)
        store.get_storer(KEY).attrs.pandas_version = ANY_PANDAS
        content = store._handle.get_file_image()
    write_bytes(path, content)
