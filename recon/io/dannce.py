"""Read DANNCE's files: Label3D's `*_dannce.mat`, a camera's own file, and predictions.

Label3D's file has cameras (`params`) and labels (`labelData`). Predictions are in `save_data_AVG.mat` (`pred`,
`sampleID`). Poses and matrices are MATLAB's: rows are points, X_camera = X_world r + t and pixels X_camera K, and the
first pixel is (1, 1). Lengths are in the unit of the calibration, which is usually millimetres. Points have no names
unless the file has a `skeleton`. Frames are numbered as in the first camera's video, in `data_frame` for labels and in
`sampleID` for predictions.

This module reads MATLAB's files of versions 5 to 7 and checks everything, because damaged files crash scipy. A file is
a list of elements, each with a type, a size in bytes, and data. A compressed element contains another element. A matrix
holds its flags, sizes, name and data as elements. Every size is checked before memory is taken. Version 7.3 is HDF5.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.documents import read_content
from recon.base.errors import InputError, Problem
from recon.io.calibration import CameraRecord
from recon.io.camera_files import record_of
from recon.io.common import StoredPoints, one_animal, starts_with

MAX_BYTES = 1 << 28
"""Largest size in bytes of a MATLAB file that is read."""
MAX_UNPACKED = 1 << 28
"""Largest size in bytes of the unpacked elements of a MATLAB file."""
MAX_DEPTH = 12
"""Largest depth of cells and structures nested in each other."""
MAX_ITEMS = 100_000
"""Largest number of elements in a MATLAB file."""
_MATRIX, _COMPRESSED = 14, 15
"""Type numbers of an array and of a compressed element in MATLAB's format."""
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""NumPy type for each type number of an element that holds numbers."""
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16-le", 16: "utf-8", 17: "utf-16-le"}
_CELL, _STRUCT, _CHAR = 1, 2, 4
"""Class numbers of cell arrays, structs and strings in MATLAB's format."""


def recognises(path: Path) -> bool:
    """Return whether a file is a MATLAB file."""
    return starts_with(path, b"MATLAB ") and path.suffix.lower() == ".mat"


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the 3D labels or predictions of a MATLAB file."""
    variables = _variables(path)
    label = variables.get("labelData", [None])
    label = label[0] if isinstance(label, list) else label
    if isinstance(label, dict):
        values, frames = label["data_3d"], label["data_frame"]
        values = values.reshape(len(values), -1, 3)
    elif "pred" in variables:
        values, frames = variables["pred"].swapaxes(-2, -1), variables["sampleID"]  # with or without an axis of animals
    else:
        expected = "labelData with data_3d (frames, 3 for each point), or pred (frames, 3, points)"
        raise InputError(Problem(path, "data_3d", "nothing", expected))
    skeleton = variables.get("skeleton")
    names = _all_texts(skeleton.get("joint_names")) if isinstance(skeleton, dict) else ()
    return one_animal(path, individual, StoredPoints(names, values, frames.ravel()))


def _all_texts(value: object) -> tuple[str, ...]:
    """Return the strings of a cell array, or an empty tuple for anything else."""
    return tuple(value) if isinstance(value, list) and all(isinstance(text, str) for text in value) else ()


recognises_cameras = recognises


def read_cameras(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the cameras in `params` of a MATLAB file, named by `camnames`, or the file's only camera."""
    variables = _variables(path)
    params = variables.get("params", [variables])
    tables = [
        table
        for table in (params if isinstance(params, list) else [params])
        if isinstance(table, dict) and "K" in table
    ]
    if not tables:
        raise InputError(
            Problem(
                path,
                "params",
                "no cameras of DANNCE",
                "K, r, t, RDistort and TDistort of each, or other calibrations in JSON",
            )
        )
    names = _all_texts(variables.get("camnames"))
    records = []
    for i, table in enumerate(tables):
        k = [*table["RDistort"].ravel(), 0.0]
        values = {
            "K": table["K"].T - np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]),
            "D": [k[0], k[1], *table["TDistort"].ravel(), k[2]],
            "r": table["r" if "r" in table else "R"].T,
            "t": table["t"],
        }
        name, location = names[i] if len(names) == len(tables) else None, f"params[{i}]." * ("params" in variables)
        records.append(record_of(name, location, values))
    return records


def _variables(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file, keyed by their names.

    An array of numbers keeps MATLAB's shape. A struct becomes a dictionary, an array of structs a list of dictionaries,
    and a cell array a list. Strings are kept, and anything else becomes None.

    Raises
    ------
    InputError
        If the file is invalid.
    """
    content = read_content(path, "a MATLAB file", MAX_BYTES)
    if content.startswith(b"MATLAB 7.3") or content[126:128] != b"IM":
        is_hdf5 = content.startswith(b"MATLAB 7.3")
        actual = "a MATLAB file of version 7.3" if is_hdf5 else "no header of a little-endian MATLAB file"
        expected = "a MATLAB file of version 7 or older: in MATLAB, save(name, '-v7')"
        raise InputError(Problem(path, "file", actual, expected))
    return dict(_File().top(memoryview(content)[128:]))


class _File:
    """Reader of one MATLAB file, with limits on its memory and number of items.

    If the file is damaged, the methods raise errors of various types.
    """

    def __init__(self) -> None:
        self.left, self.items = MAX_UNPACKED, MAX_ITEMS

    def top(self, data: memoryview) -> Iterator[tuple[str, Any]]:
        """Yield the name and the value of each variable of the file."""
        for kind, body in self.elements(data, packed=True):
            if kind == _COMPRESSED:
                unpacker = zlib.decompressobj()
                whole = unpacker.decompress(bytes(body), self.left)
                if unpacker.unconsumed_tail:
                    raise ValueError("more data than a file of poses can hold")
                self.left -= len(whole)
                kind, body = next(self.elements(memoryview(whole)), (0, body))
            if kind == _MATRIX:
                yield self.matrix(body, 0)

    def elements(self, data: memoryview, packed: bool = False) -> Iterator[tuple[int, memoryview]]:
        """Yield the type and the data of each element in a block of bytes.

        `packed` is for the top of a file, where compressed elements are not padded.
        """
        position = 0
        while position + 8 <= len(data):
            kind, size = struct.unpack_from("<II", data, position)
            if kind >> 16:  # the size of an element of up to 4 bytes shares a word with the type
                size, kind, begin, step = kind >> 16, kind & 0xFFFF, position + 4, 8
                if size > 4:
                    raise ValueError("a short element with more than 4 bytes")
            else:
                begin = position + 8
                step = 8 + (size if packed and kind == _COMPRESSED else (size + 7) // 8 * 8)
            if begin + size > len(data):
                raise ValueError("an element beyond the end")
            yield kind, data[begin : begin + size]
            position += step

    def matrix(self, body: memoryview, depth: int) -> tuple[str, Any]:
        """Return the name and the value of a matrix element, which is inside `depth` others."""
        self.items -= 1
        if depth > MAX_DEPTH or self.items < 0:
            raise ValueError("more elements, or elements nested deeper, than a file of poses can hold")
        if not len(body):
            return "", None
        elements = [*self.elements(body)]
        flags, shape = int(self.numbers(*elements[0])[0]), self.numbers(*elements[1]).tolist()
        kind, name = flags & 0xFF, bytes(elements[2][1]).decode("ascii")
        if kind == _CELL:
            return name, [self.matrix(element, depth + 1)[1] for _, element in elements[3:]]
        if kind == _STRUCT:
            return name, self.structs(elements[3:], depth)
        if kind == _CHAR:
            text_type, text = elements[3]
            return name, bytes(text).decode(_TEXTS[text_type])
        if not 6 <= kind < 16 or flags & 0x0800:  # objects, sparse arrays and complex numbers
            return name, None
        values = self.numbers(*elements[3]) if len(elements) > 3 else np.zeros(0)
        if min(shape) < 0:
            raise ValueError("negative sizes")
        return name, values.reshape(shape, order="F")

    def structs(self, elements: list[tuple[int, memoryview]], depth: int) -> object:
        length = int(self.numbers(*elements[0])[0])
        text = bytes(elements[1][1])
        if not 0 < length <= 64:
            raise ValueError("field names that are missing, or longer than MATLAB allows")
        fields = [text[i : i + length].split(b"\0")[0].decode("ascii") for i in range(0, len(text), length)]
        values = [self.matrix(element, depth + 1)[1] for _, element in elements[2:]]
        rows = [dict(zip(fields, values[i:], strict=False)) for i in range(0, len(values), max(len(fields), 1))]
        return rows[0] if len(rows) == 1 else rows

    def numbers(self, kind: int, data: memoryview) -> np.ndarray:
        return np.frombuffer(data, np.dtype(f"<{_NUMBERS[kind]}"))
