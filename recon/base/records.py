"""Save dataclasses bit for bit in one file of arrays: a NumPy archive (.npz) without pickles.

The archive has an array `record`, a JSON text with everything but the larger arrays, and each larger array, named by
the fields that lead to it, such as `solution.states`. Arrays with the same content are stored once. Floats are
stored as planes of bytes, which compress better, and in single precision where that changes no bit (`_Layout`).

Fields are plain values, paths, slices, tuples, mappings with strings as keys, arrays of numbers, tables of files
(pydantic's models), and dataclasses, also of a subclass within this package. Loaded values have the types that the
fields declare. A subclass is named by its tag, `record_tag`, never by its module, and the caller of `load_record` lists
the classes. Values that a dataclass computes from its fields are not in the file.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import operator
import zipfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import GenericAlias
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from recon.base.documents import KINDS, MAX_UNPACKED, arrays_of, damage_as_input_error, read_content
from recon.base.errors import InputError, Problem
from recon.base.field_problems import problems_of

RECORD = "record"
MAX_JSON_ELEMENTS = 64
"""Maximum number of elements of an array that is stored in the JSON text, because many tiny files are slow to read."""
CLASS = "class"
"""Key of a subclass's tag in the JSON text."""
Classes = Mapping[str, Callable[[], type]]
"""Functions that import and return a class, by the class's tag, because some modules are slow to import."""

_Class = TypeVar("_Class")


def save_record(value: object, path: Path, schema: Mapping[str, Any]) -> None:
    """Write a dataclass to a file atomically.

    `schema` is the name and version of the format, which `load_record` expects.

    Raises
    ------
    TypeError
        If a value has a type that a record cannot hold.
    """
    arrays: dict[str, tuple[np.ndarray, _Layout | None]] = {}
    text = json.dumps({"schema": schema, "value": _plain(value, "", arrays, {})})
    arrays = {RECORD: (np.frombuffer(text.encode(), np.uint8), None), **arrays}
    from recon.base.files import staged_file

    with staged_file(path) as staged:
        try:
            with zipfile.ZipFile(staged, "w", zipfile.ZIP_DEFLATED) as archive:
                # Arrays are packed one after the other, because the arrays of a long clip need much memory.
                for name, (array, layout) in arrays.items():
                    entry = zipfile.ZipInfo(f"{name}.npy")
                    entry.compress_type = zipfile.ZIP_DEFLATED
                    with archive.open(entry, "w", force_zip64=True) as file:
                        stored = array if layout is None else layout.packed(array)
                        np.lib.format.write_array(file, np.asanyarray(stored), allow_pickle=False)
        except OSError as error:
            error.filename = str(staged)
            raise


def load_record(
    record_class: type[_Class],
    path: Path,
    schema: Mapping[str, Any],
    expected: str,
    classes: Classes | None = None,
    older_versions: tuple[int, ...] = (),
) -> _Class:
    """Return the object of class `record_class` that `save_record` wrote.

    `expected` describes the file in messages, `classes` are the subclasses that the file may contain, and
    `older_versions` are further versions of the schema that can be read.

    Raises
    ------
    InputError
        If the file is damaged or of another kind, or would take too much memory. All sizes are checked before anything
        is unpacked.
    """
    content = read_content(path, expected, MAX_UNPACKED)
    with damage_as_input_error(path, expected):
        arrays = arrays_of(content, KINDS)
        record = json.loads(arrays.pop(RECORD).astype(np.uint8, casting="no").tobytes())
        schema_found = record["schema"]
        if schema_found not in (schema, *({**schema, "version": version} for version in older_versions)):
            wanted = f"{schema['name']}, version {schema['version']}: {expected}"
            raise InputError(
                Problem(path, "schema", f"{schema_found['name']}, version {schema_found['version']}"[:100], wanted)
            )
        try:
            return _validated(record_class, _restored(record["value"], arrays, classes or {}))
        except ValidationError as error:
            problems = problems_of(error, path, skipped=1)
            raise InputError(dataclasses.replace(p, expected=f"{p.expected}: {expected}") for p in problems) from None


@dataclasses.dataclass(frozen=True)
class _Layout:
    """Layout of a stored array of floats, as planes (itemsize, N) of the bytes of its N values.

    The planes of slowly changing values compress well. The longest axis varies fastest.
    """

    dtype: str
    """Type of the array."""
    shape: tuple[int, ...]
    stored: str
    """Type of the stored values, single precision if this changes no bit."""
    symmetric: bool
    """Whether the last two axes form symmetric matrices, of which only the upper triangles are stored."""

    @classmethod
    def of_array(cls, array: np.ndarray) -> _Layout:
        """Return the smallest layout that restores an array bit for bit."""
        bits = np.ascontiguousarray(array).view(f"u{array.dtype.itemsize}")
        is_square = array.ndim > 2 and array.shape[-1] == array.shape[-2] > 1
        symmetric = is_square and np.array_equal(bits, bits.swapaxes(-1, -2))
        stored = array.dtype
        if stored.itemsize == 8:
            with np.errstate(over="ignore", under="ignore"):
                single = array.astype(stored.newbyteorder("=").str.replace("8", "4"))
            if np.array_equal(single.astype(stored).view(bits.dtype), bits):
                stored = single.dtype
        return cls(array.dtype.str, array.shape, stored.str, symmetric)

    def packed(self, array: np.ndarray) -> np.ndarray:
        """Return an array as planes of bytes, (itemsize, N)."""
        if self.symmetric:
            array = array[(..., *np.triu_indices(array.shape[-1]))]
        values = np.moveaxis(array.astype(self.stored), _longest(array.shape), -1)
        return np.ascontiguousarray(np.ascontiguousarray(values).reshape(-1, 1).view(np.uint8).T)

    def unpacked(self, planes: np.ndarray) -> np.ndarray:
        """Return the array that is stored as planes, or raise ValueError or TypeError if they do not fit the layout."""
        dtypes = np.dtype(self.dtype), np.dtype(self.stored)
        if any(dtype.kind != "f" for dtype in dtypes) or planes.dtype != np.uint8 or planes.ndim != 2:
            raise ValueError(f"an array of {self.dtype}, stored as {planes.dtype}")
        shape = self.shape
        if self.symmetric:
            *outer, n, columns_count = shape
            if n != columns_count:
                raise ValueError(f"symmetric matrices of {n} rows and {columns_count} columns")
            shape = (*outer, n * (n + 1) // 2)
        if math.prod(shape) != planes.shape[1]:  # a damaged file can state any shape
            raise ValueError(f"an array of {math.prod(shape)} values, of which {planes.shape[1]} are stored")
        longest = _longest(shape)
        moved = (*shape[:longest], *shape[longest + 1 :], shape[longest])
        values = np.ascontiguousarray(planes.T).view(dtypes[1]).reshape(moved)
        values = np.moveaxis(values, -1, longest).astype(dtypes[0], order="C")
        if not self.symmetric:
            return values
        array = np.empty(self.shape, dtypes[0])
        rows, columns = np.triu_indices(self.shape[-1])
        array[..., rows, columns] = array[..., columns, rows] = values
        return array


def _longest(shape: tuple[int, ...]) -> int:
    return int(np.argmax(shape))


LAYOUT = {field.name for field in dataclasses.fields(_Layout)}


def _plain(
    value: object, field: str, arrays: dict[str, tuple[np.ndarray, _Layout | None]], name_of: dict[object, str]
) -> object:
    """Return a value as JSON types, with larger arrays replaced by their names.

    `field` is the path of fields to the value. `name_of` has the name of each array by its content, so that equal
    arrays are written once.
    """

    def inside(name: str | int, item: object) -> object:
        return _plain(item, f"{field}.{name}".removeprefix("."), arrays, name_of)

    if value is None or isinstance(value, bool | int | float | str):
        return value.item() if isinstance(value, np.generic) else value
    if isinstance(value, np.ndarray):
        return _plain_array(value, field, arrays, name_of)
    if isinstance(value, slice):
        return {"slice": [value.start, value.stop, value.step]}
    if isinstance(value, tuple | list):
        return [inside(i, item) for i, item in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: inside(key, item) for key, item in value.items()}
    if dataclasses.is_dataclass(value):
        value_class = type(value)
        named = {CLASS: _tag(value_class, field)} if dataclasses.is_dataclass(value_class.__base__) else {}
        return named | {f.name: inside(f.name, getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", by_alias=True)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{field}: a {type(value).__name__} cannot be saved")


def _plain_array(
    value: np.ndarray, field: str, arrays: dict[str, tuple[np.ndarray, _Layout | None]], name_of: dict[object, str]
) -> Mapping[str, object]:
    """Return a small array as JSON types, or the name under which a larger one is added to `arrays`."""
    if value.dtype.kind not in KINDS:
        raise TypeError(f"{field}: an array of {value.dtype} cannot be saved")
    if value.size <= MAX_JSON_ELEMENTS:
        return {"dtype": value.dtype.str, "shape": value.shape, "values": value.ravel().tolist()}
    content = value.dtype.str, value.shape, hashlib.sha256(np.ascontiguousarray(value).data).digest()
    name = name_of.setdefault(content, field)
    if name not in arrays:
        arrays[name] = value, _Layout.of_array(value) if value.dtype.kind == "f" else None
    layout = arrays[name][1]
    return {"array": name} | ({} if layout is None else dataclasses.asdict(layout))


def _tag(subclass: type, field: str) -> str:
    """Return the tag of a subclass, or raise TypeError if it has none."""
    tag: str | None = getattr(subclass, "record_tag", None)
    if tag is None:
        raise TypeError(f"{field}: a {subclass.__name__} cannot be saved, as it has no record_tag")
    return tag


def _restored(value: object, arrays: Mapping[str, np.ndarray], classes: Classes) -> object:
    """Return a value that `_plain` wrote, with its arrays, slices and tagged dataclasses restored.

    Other dataclasses remain mappings.
    """
    if isinstance(value, list):
        return [_restored(item, arrays, classes) for item in value]
    if not isinstance(value, dict):
        return value
    if value.keys() == {"array"}:
        return arrays[value["array"]]
    if value.keys() == {"array", *LAYOUT}:
        shape = tuple(map(operator.index, value["shape"]))
        layout = _Layout(value["dtype"], shape, value["stored"], value["symmetric"])
        return layout.unpacked(arrays[value["array"]])
    if value.keys() == {"slice"}:
        return slice(*value["slice"])
    if value.keys() == {"dtype", "shape", "values"}:
        if (dtype := np.dtype(value["dtype"])).kind not in KINDS or len(value["values"]) > MAX_JSON_ELEMENTS:
            raise ValueError(f"an array of {dtype}")
        return np.array(value["values"], dtype).reshape(value["shape"])
    restored: dict[str, Any] = {name: _restored(item, arrays, classes) for name, item in value.items()}
    if CLASS not in restored:
        return restored
    tag = restored.pop(CLASS)
    if tag not in classes:
        raise ValueError(f"{str(tag)[:60]!r}, which is not a class that such a file can hold")
    return _validated(classes[tag](), restored)


def _validated(record_class: type[_Class], fields: object) -> _Class:
    return _adapter(record_class).validate_python([fields])[0]


@cache
def _adapter(record_class: type) -> TypeAdapter[Any]:
    """Return a validator for a list of objects, because pydantic takes no configuration for a single object."""
    many: Any = GenericAlias(list, (record_class,))
    return TypeAdapter(many, config=ConfigDict(extra="forbid", arbitrary_types_allowed=True))
