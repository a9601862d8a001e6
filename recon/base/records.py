"""Dataclasses in one file of arrays, bit for bit: a NumPy archive (.npz) without pickles.

The archive has an array `record`, a text of JSON with all that is no array, and an array for each larger one, called by
where it stands, as in `solution.states`. Fields and their types are those that the dataclasses declare: plain values,
paths, slices, tuples, mappings with texts as keys, arrays of numbers, and dataclasses, also of a subclass within this
package. What a dataclass works out from its fields is not in the file.
"""

from __future__ import annotations

import dataclasses
import json
import lzma
import math
import struct
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from io import BytesIO
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from recon.base.documents import parse_json, read_content
from recon.base.errors import InputError, Problem

RECORD = "record"
SMALL = 64
"""Arrays with no more numbers than this stand in the text: an archive of thousands of tiny files is slow to read."""
MAX_BYTES, MAX_ARRAYS = 1 << 30, 1 << 16
"""The largest archive that is unpacked, and the largest size and number of arrays that it is unpacked to."""
PACKAGE, CLASS = __name__.partition(".")[0], "class"
"""Whose dataclasses may be in an archive, and where their names stand in it."""
KINDS = "biuf"
"""The types of arrays that are read, as NumPy names them: truth values, whole numbers and floats."""
_DAMAGE = (OSError, ValueError, KeyError, TypeError, EOFError, MemoryError, RuntimeError, ImportError)
_DAMAGE_OF_ZIP = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, SyntaxError, tokenize.TokenError)
"""The last two are of an array's header."""

_Class = TypeVar("_Class")


def save_record(value: Any, path: Path, schema: Mapping[str, Any]) -> None:
    """Write a dataclass, whole or not at all. schema: the format's name and version, which `load_record` expects.

    Raises TypeError for values of types that such a file does not hold."""
    packer = _Packer()
    text = json.dumps({"schema": schema, "value": packer.packed(value, type(value), "")})
    made = BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as archive:
        for name, array in {RECORD: np.frombuffer(text.encode(), np.uint8), **packer.arrays}.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
    from recon.base.files import staged_file, write_bytes

    with staged_file(path) as staged:
        write_bytes(staged, made.getvalue())


def load_record(of: type[_Class], path: Path, schema: Mapping[str, Any], expected: str) -> _Class:
    """Read what `save_record` wrote of that class. expected: what the file should be, in a message.

    Raises InputError for a file that is damaged, is something else, or would take too much memory: the sizes of all
    that is in it are checked before anything is unpacked."""
    content = read_content(path, expected, MAX_BYTES)
    try:
        arrays = arrays_of(content, KINDS)
        text = _text(arrays.pop(RECORD))
    except _DAMAGE as error:
        found = f"data that cannot be read ({' '.join(str(error).split())[:100] or type(error).__name__})"
        raise InputError(Problem(path, "content", found, expected)) from None
    record = parse_json(text, path, expected)
    found = record.get("schema") if isinstance(record, dict) else None
    if found != schema:
        told = f"{found.get('name')}, version {found.get('version')}" if isinstance(found, dict) else "none"
        wanted = f"{schema['name']}, version {schema['version']}: {expected}"
        raise InputError(Problem(path, "schema", told[:100], wanted))
    try:
        return _Unpacker(arrays).unpacked(record["value"], of, "")
    except (*_DAMAGE, AttributeError, IndexError, OverflowError, RecursionError) as error:
        raise InputError(Problem(path, "content", " ".join(str(error).split())[:200], expected)) from None


def arrays_of(content: bytes, kinds: str) -> dict[str, np.ndarray]:
    """The arrays of a NumPy archive by name. kinds: of their types, as NumPy names them; "O", pickles, is none.

    Raises ValueError for a damaged archive, other types, and one that would take too much memory: sizes are checked
    before anything is unpacked."""
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            check_unpacked_size(archive)
            return {one.filename.removesuffix(".npy"): _array(archive.read(one), kinds) for one in archive.infolist()}
    except (*_DAMAGE, *_DAMAGE_OF_ZIP) as error:
        raise ValueError(" ".join(str(error).split())[:200] or type(error).__name__) from None


def check_unpacked_size(archive: zipfile.ZipFile) -> None:
    """Raises ValueError for a zip archive that is unpacked to more than `MAX_BYTES`, or to too many files."""
    infos = archive.infolist()
    size = sum(info.file_size for info in infos)
    if len(infos) > MAX_ARRAYS or size > MAX_BYTES:
        raise ValueError(f"{len(infos)} arrays of {size >> 20} MB are too much")


def _text(array: np.ndarray) -> str:
    """What bytes (n,) say. Raises ValueError for an array of another type."""
    if array.dtype != np.uint8:
        raise ValueError(f"a text of {array.dtype}")
    return array.tobytes().decode()


def _array(content: bytes, kinds: str) -> np.ndarray:
    """The array of an .npy file whose header says what follows. Raises ValueError for any other."""
    file = BytesIO(content)
    version = np.lib.format.read_magic(file)
    read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
    shape, fortran, dtype = read_header(file)
    start = file.tell()
    if dtype.kind not in kinds or not dtype.itemsize or dtype.itemsize * math.prod(shape) != len(content) - start:
        raise ValueError(f"an array of {dtype} with shape {shape} in {len(content)} bytes")
    if (
        dtype.kind == "U"
        and np.frombuffer(content, f"{dtype.byteorder}u4", offset=start).max(initial=0) > sys.maxunicode
    ):
        raise ValueError("texts of characters that there are not")
    flat = np.frombuffer(content, dtype, offset=start)
    return flat.reshape(shape, order="F" if fortran else "C").copy(order="K")


def _arms(hint: Any) -> tuple[Any, ...]:
    """The types that a value with that type hint may have."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _elements(hint: Any, count: int) -> list[Any] | None:
    """The types of the elements of a tuple or a list of that length; None where the hint is of another type."""
    origin, args = get_origin(hint), get_args(hint)
    if origin not in (tuple, list):
        return None
    if origin is list or args[1:] == (...,):
        return [args[0]] * count
    return list(args) if len(args) == count else None


def _is_mapping(hint: Any) -> bool:
    return isinstance(get_origin(hint), type) and issubclass(get_origin(hint), Mapping)


@cache
def _field_types(of: type) -> dict[str, Any]:
    """By name, of the fields that a dataclass is made from."""
    hints = get_type_hints(of)
    return {field.name: hints[field.name] for field in dataclasses.fields(of) if field.init}


def _subclass(name: str, of: Any) -> type:
    """A dataclass of this package by its module and name. Raises ValueError unless it is one of that class."""
    module, _, own = name.partition(":")
    found = getattr(import_module(module), own, None) if module.startswith(f"{PACKAGE}.") else None
    if not (isinstance(found, type) and issubclass(found, of) and dataclasses.is_dataclass(found)):
        raise ValueError(f"{name[:60]!r} where a {of.__name__} belongs")
    return found


class _Packer:
    """Makes plain values of a dataclass, its larger arrays set aside in `arrays`."""

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self.name_of: dict[int, str] = {}
        """By identity: an array that stands in several places is written once."""

    def packed(self, value: Any, hint: Any, where: str) -> Any:
        """hint: the type that is declared for the value; where: the names of the fields that lead to it."""
        if isinstance(value, np.ndarray):
            return self._packed_array(value, where)
        if isinstance(value, slice):
            return [value.start, value.stop, value.step]
        if isinstance(value, tuple | list):
            of = next((of for arm in _arms(hint) if (of := _elements(arm, len(value)))), [Any] * len(value))
            return [self.packed(one, of[i], f"{where}.{i}") for i, one in enumerate(value)]
        if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
            of = next((get_args(arm)[1] for arm in _arms(hint) if _is_mapping(arm)), Any)
            return {key: self.packed(one, of, f"{where}.{key}") for key, one in value.items()}
        if dataclasses.is_dataclass(value):
            types, own = _field_types(type(value)), type(value)
            fields = {name: self.packed(getattr(value, name), of, f"{where}.{name}") for name, of in types.items()}
            return fields if own in _arms(hint) else {CLASS: f"{own.__module__}:{own.__qualname__}", **fields}
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, Path):
            return str(value)
        if value is None or isinstance(value, bool | int | float | str):
            return value
        raise TypeError(f"{where.removeprefix('.')}: a {type(value).__name__} cannot be saved")

    def _packed_array(self, array: np.ndarray, where: str) -> dict[str, Any]:
        if array.dtype.kind not in KINDS:
            raise TypeError(f"{where.removeprefix('.')}: an array of {array.dtype} cannot be saved")
        if array.size <= SMALL:
            return {"dtype": array.dtype.str, "shape": array.shape, "values": array.ravel().tolist()}
        name = self.name_of.setdefault(id(array), where.removeprefix("."))
        self.arrays[name] = array
        return {"array": name}


class _Unpacker:
    """Makes dataclasses of plain values and arrays again. Raises ValueError, TypeError or KeyError where they do not
    have the declared types."""

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        self.arrays = arrays

    def unpacked(self, value: Any, hint: Any, where: str) -> Any:
        """The value that `_Packer.packed` made this of, by its type."""
        for arm in _arms(hint):
            if self._is(value, arm):
                return self._of_type(value, arm, where)
        raise ValueError(f"{where.removeprefix('.') or RECORD}: {str(value)[:40]!r} where {hint} belongs")

    def _is(self, value: Any, arm: Any) -> bool:
        """Whether a plain value can be of that type."""
        if arm is Any:
            return True
        if get_origin(arm) is Literal:
            return value in get_args(arm) and type(value) in {type(one) for one in get_args(arm)}
        if _is_mapping(arm) or dataclasses.is_dataclass(arm) or np.ndarray in (arm, get_origin(arm)):
            return isinstance(value, dict)
        if arm is slice:
            return isinstance(value, list) and len(value) == 3
        if get_origin(arm) in (tuple, list):
            return isinstance(value, list) and _elements(arm, len(value)) is not None
        plain = {float: (float, int), Path: (str,), NoneType: (NoneType,)}.get(arm, (arm,))
        return type(value) in plain

    def _of_type(self, value: Any, arm: Any, where: str) -> Any:
        if dataclasses.is_dataclass(arm):
            return self._dataclass(dict(value), arm, where)
        if np.ndarray in (arm, get_origin(arm)):
            return self._array(value)
        if _is_mapping(arm):
            return {key: self.unpacked(one, get_args(arm)[1], f"{where}.{key}") for key, one in value.items()}
        if (of := _elements(arm, len(value) if isinstance(value, list) else 0)) is not None:
            return get_origin(arm)(self.unpacked(one, of[i], f"{where}.{i}") for i, one in enumerate(value))
        return slice(*value) if arm is slice else Path(str(value)) if arm is Path else value

    def _dataclass(self, fields: dict[str, Any], of: Any, where: str) -> Any:
        of = _subclass(fields.pop(CLASS), of) if CLASS in fields else of
        types = _field_types(of)
        if differing := {*types} ^ {*fields}:
            raise ValueError(
                f"{where.removeprefix('.') or RECORD}: {', '.join(sorted(differing))[:80]} of a {of.__name__}"
            )
        return of(**{name: self.unpacked(fields[name], types[name], f"{where}.{name}") for name in types})

    def _array(self, value: dict[str, Any]) -> np.ndarray:
        if "array" in value:
            return self.arrays[value["array"]]
        dtype = np.dtype(value["dtype"])
        if dtype.kind not in KINDS or len(value["values"]) > SMALL:
            raise ValueError(f"an array of {dtype}")
        return np.array(value["values"], dtype).reshape(value["shape"])
