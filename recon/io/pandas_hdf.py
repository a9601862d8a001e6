"""Tables that pandas keeps in HDF5 files, in its fixed and in its table layout, read without pandas and PyTables.

Those would unpickle whatever a file holds. Here cells are numbers or texts, and the column labels, which pandas pickles
in the table layout, are lists and tuples of texts (see `plain_pickle`); anything else is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem
from recon.io import plain_pickle
from recon.io.hdf5 import attribute, child, groups, names, numbers, opened, raw_attribute, read

MAX_LEVELS = 8
MAX_BLOCKS = 1000
NUMBER_KINDS = ("integer", "float")

Label = tuple[str, ...]


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


def keys(path: Path) -> list[str]:
    """Where in an HDF5 file pandas stored something. Raises InputError for a file that cannot be opened."""
    import h5py

    with opened(path, outline=True) as file:
        return [str(group.name) for group in groups(file) if h5py.h5a.exists(group.id, b"pandas_type")]


def read_frame(path: Path, key: str) -> _StoredTable:
    """The table under a key. Raises InputError for anything else than a table, and for cells or labels that are pickled
    Python objects."""
    with opened(path) as file:
        group = child(file, key)
        kind = attribute(group, "pandas_type") if group is not None else None
        layouts = {"frame": _fixed_frame, "frame_table": _table_frame}
        if group is None or kind not in layouts:
            kinds = {"series": "a Series", "series_table": "a Series"}
            raise InputError(Problem(path, f"key {key}", kinds.get(str(kind), f"'{kind}'"), "a table"))
        try:
            return layouts[kind](group)
        except _NotPlain as error:
            expected = "a table of numbers, without Python objects, which could run anything"
            raise InputError(Problem(path, f"key {key}", str(error), expected)) from None


class _NotPlain(Exception):
    """Something that only unpickling could read."""


# -- fixed layout: the axes and the blocks of columns of one type, each an array ---------------------------------


def _fixed_frame(group: Any) -> _StoredTable:
    levels, columns = _axis(group, "axis0")
    _, index = _axis(group, "axis1")
    free: dict[Label, list[int]] = {}
    for at, label in enumerate(columns):
        free.setdefault(label, []).append(at)
    count = _count(attribute(group, "nblocks"), MAX_BLOCKS)
    parts: list[tuple[list[int], np.ndarray]] = []
    for block in range(count):
        _, items = _axis(group, f"block{block}_items")
        values = _values(group, f"block{block}_values")
        if values.shape != (len(index), len(items)):
            raise ValueError(f"{values.shape} cells for {len(index)} rows and {len(items)} columns")
        parts.append(([free[label].pop(0) for label in items], values))
    return _StoredTable(levels, columns, index, _table_of_blocks(len(index), len(columns), parts))


def _axis(group: Any, name: str) -> tuple[tuple[str | None, ...], tuple[Label, ...]]:
    """Names of the levels, and labels."""
    if attribute(group, f"{name}_variety") != "multi":
        dataset = _required_child(group, name)
        return (_name(dataset),), tuple((label,) for label in _labels(group, dataset))
    levels = [
        _required_child(group, f"{name}_level{i}")
        for i in range(_count(attribute(group, f"{name}_nlevels"), MAX_LEVELS))
    ]
    parts = []
    for i, level in enumerate(levels):
        texts = [*_labels(group, level), "nan"]  # code -1
        codes = _whole_numbers(group, f"{name}_label{i}")
        if ((codes < -1) | (codes >= len(texts) - 1)).any():
            raise ValueError(f"{name}_label{i} has codes without a label")
        parts.append([texts[code] for code in codes.tolist()])
    return tuple(_name(level) for level in levels), tuple(zip(*parts, strict=True))


def _labels(group: Any, dataset: Any) -> list[str]:
    """One level of labels as texts."""
    _require_plain_cells(dataset)
    if _is_empty(dataset):
        return []
    return _texts_of(group, read(dataset).ravel(), attribute(dataset, "kind"))


def _texts_of(group: Any, values: np.ndarray, kind: Any) -> list[str]:
    if kind in NUMBER_KINDS and values.dtype.kind in "fiu":
        return [str(value) for value in values.tolist()]
    if kind not in NUMBER_KINDS and values.dtype.kind == "S":
        encoding = str(attribute(group, "encoding") or "UTF-8")
        return [_decoded(value, encoding) for value in values.tolist()]
    raise ValueError(f"labels of kind {kind}")


def _values(group: Any, name: str) -> np.ndarray:
    """Cells (T, C) of one block."""
    dataset = _required_child(group, name)
    _require_plain_cells(dataset)
    if _is_empty(dataset):
        columns, rows = _attribute_value(dataset, "shape")
        return np.zeros((_count(rows, 10**9), _count(columns, 10**6)), float)
    values = read(dataset)
    if values.ndim != 2 or values.dtype.kind not in "fiubS":
        raise ValueError(f"{name} has no rows and columns of numbers")
    # Stored as (C, T), and turned over where it says so.
    return values if attribute(dataset, "transposed") else values.T


def _is_empty(dataset: Any) -> bool:
    """pandas stores an array without elements as one with one, and its shape beside it."""
    shape = _attribute_value(dataset, "shape")
    return isinstance(shape, tuple) and 0 in shape


def _require_plain_cells(dataset: Any) -> None:
    if attribute(dataset, "PSEUDOATOM") is not None:
        raise _NotPlain("cells that are pickled Python objects")


# -- table layout: one array of records, and the labels of its columns pickled -----------------------------------


def _table_frame(group: Any) -> _StoredTable:
    if (kind := attribute(group, "table_type")) != "appendable_frame":
        raise ValueError(f"a table of type {kind}")
    axes = _attribute_value(group, "non_index_axes")
    try:
        ((axis, given),) = axes
    except (TypeError, ValueError):
        axis, given = None, None
    if axis != 1 or not isinstance(given, list | tuple):
        raise ValueError("a table without labels of its columns")
    columns = tuple(_label(label) for label in given)
    depth = {len(label) for label in columns}
    if len(depth) != 1:
        raise ValueError("labels of different levels")
    dataset = _required_child(group, "table")
    rows = read(dataset)
    if rows.ndim != 1 or rows.dtype.names is None:
        raise ValueError("a table without records")
    index = _texts_of(group, _field(rows, "index"), attribute(dataset, "index_kind"))
    places = {label: at for at, label in enumerate(columns)}
    parts: list[tuple[list[int], np.ndarray]] = []
    for name in _attribute_value(group, "values_cols"):
        labels = [_label(label) for label in _attribute_value(dataset, f"{name}_kind")]
        values = _field(rows, str(name)).reshape(len(rows), -1)
        if values.shape[1] != len(labels) or values.dtype.kind not in "fiubS":
            raise ValueError(f"{values.shape[1]} columns of {values.dtype} with {len(labels)} labels in {name}")
        parts.append(([places[label] for label in labels], values))
    cells = _table_of_blocks(len(rows), len(columns), parts)
    return _StoredTable(_level_names(group, depth.pop()), columns, tuple((label,) for label in index), cells)


def _field(rows: np.ndarray, name: str) -> np.ndarray:
    if rows.dtype.names is None or name not in rows.dtype.names:
        raise ValueError(f"a table without {name}")
    return rows[name]


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
        if values.dtype.kind == "S":
            cells[:, at] = [[_decoded(cell, "UTF-8") for cell in row] for row in values.tolist()]
        else:
            cells[:, at] = values
    return cells


def _required_child(group: Any, name: str) -> Any:
    found = child(group, name)
    if found is None:
        raise ValueError(f"no {name} in {', '.join(names(group))[:200] or 'an empty group'}")
    return found


def _whole_numbers(group: Any, name: str) -> np.ndarray:
    values = numbers(_required_child(group, name)).ravel()
    if values.dtype.kind not in "iu":
        raise ValueError(f"{name} has no whole numbers")
    return values


def _count(value: Any, most: int) -> int:
    if not isinstance(value, int | np.integer) or not 0 <= value <= most:
        raise ValueError("a number that should say how many there are")
    return int(value)


def _name(dataset: Any) -> str | None:
    """Of a level."""
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
        return plain_pickle.loads(value)
    except ValueError as error:
        raise _NotPlain(f"{name} is {error}") from None


def _decoded(text: bytes, encoding: str) -> str:
    return text.decode("utf-8" if encoding.upper() in ("UTF-8", "UTF8", "ASCII") else "latin-1")
