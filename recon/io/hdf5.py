"""Read numbers and strings, and nothing else, from HDF5 files of unknown origin, with h5py.

h5py does not execute any content of a file. Content that could make the HDF5 library hang or take too much memory is
rejected first: heaps of strings without an end, sizes that the file cannot fill, data in other files, and types other
than numbers and strings.
"""

from __future__ import annotations

import math
import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5t

from recon.base.documents import MAX_UNPACKED, damage_as_input_error
from recon.base.errors import InputError, Problem
from recon.io.common import starts_with

FREE_BYTES = 1 << 26
"""Number of bytes of memory that a dataset or a chunk of it may always take.

A larger dataset may take the size that it has in the file, or `MAX_RATIO` times that size up to `MAX_UNPACKED`.
"""
MAX_RATIO = 1100
"""Largest ratio of a dataset's size in memory to its size in the file, slightly above the limit of gzip."""
USUAL_RATIO = 100
"""Largest ratio of a dataset's size in memory to its size in the file, for sizes up to four times `MAX_UNPACKED`.

Tracks of many animals are mostly empty, and therefore large when unpacked.
"""
FILTERS = (1, 2, 3, 32000)
"""Numbers of the HDF5 filters that every h5py has with robust decoders: gzip, shuffle, Fletcher's checksum, LZF."""
MAX_ATTRIBUTE_BYTES = 1 << 24
MAX_TEXTS = 100_000
MAX_DEPTH = 12
MAX_GROUPS = 20_000
MAX_HOPS = 8


def is_hdf5(path: Path) -> bool:
    """Return whether a file is an HDF5 file."""
    return starts_with(path, b"\x89HDF\r\n\x1a\n")


@contextmanager
def opened(path: Path, names_only: bool = False) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading.

    If `names_only` is true, only names and types are read, which is safe without `_require_sound_heaps`.

    Raises
    ------
    InputError
        If the file is damaged, or if h5py raises an error inside the block.
    """
    with damage_as_input_error(path, "a complete, undamaged HDF5 file"):
        if not names_only:
            _require_sound_heaps(path)
        try:
            file = h5py.File(path, "r")
        except OSError:
            detail = "an HDF5 file that is cut off or damaged"
            raise InputError(Problem(path, "file", detail, "a complete, undamaged file")) from None
        with file:
            yield file


def _require_sound_heaps(path: Path) -> None:
    """Raise ValueError if an object in a global heap has an impossible size.

    A global heap holds strings of any length. After an object of size 0, the library would look for the next object for
    ever. The header has the signature, the version, 3 unused bytes and the size (8 bytes). An object has its number (2
    bytes), its number of references (2 bytes), 4 unused bytes, its size (8 bytes), and data in steps of 8 bytes. Object
    0 is the remaining free space, whose size includes its header.
    """
    with path.open("rb") as file:
        head = file.read(24)
        if (head[13:15] if head[8:9] < b"\2" else head[9:11]) != b"\x08\x08":
            raise ValueError("addresses that are not 8 bytes long")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            heap = content.find(b"GCOL\1")
            while heap >= 0:
                end = heap + int.from_bytes(content[heap + 8 : heap + 16], "little")
                position = heap + 16
                while position + 16 <= min(end, len(content)):
                    number = int.from_bytes(content[position : position + 2], "little")
                    length = int.from_bytes(content[position + 8 : position + 16], "little")
                    step = 16 + (length + 7) // 8 * 8 if number else length
                    if step < 16 or position + step > end:
                        raise ValueError("a damaged heap of texts")
                    position += step
                heap = content.find(b"GCOL\1", heap + 5)


def outline(path: Path) -> frozenset[str]:
    """Return the names of groups, datasets and attributes at the root of a file; empty if it is not HDF5.

    Raises
    ------
    InputError
        If an HDF5 file cannot be opened.
    """
    if not is_hdf5(path):
        return frozenset()
    with opened(path, names_only=True) as file:
        return frozenset((*names(file), *(name for name in file.attrs if isinstance(name, str))))


def names(group: h5py.Group) -> tuple[str, ...]:
    """Return the names of a group's members."""
    return tuple(name for name in group if isinstance(name, str))


def child(group: h5py.Group, path: str, hops: int = MAX_HOPS) -> Any:
    """Return a group's member by name or path, or None if it is absent or links to another file."""
    item: Any = group.file["/"] if path.startswith("/") else group
    for name in path.split("/"):
        if name in ("", ".") or item is None:
            continue
        if not isinstance(item, h5py.Group) or not item.id.links.exists(name.encode()):
            return None
        link = item.get(name, getlink=True)
        if isinstance(link, h5py.HardLink):
            item = item[name]
        elif isinstance(link, h5py.SoftLink) and hops > 0:
            item = child(item, link.path, hops - 1)
        else:
            return None
    return item if isinstance(item, h5py.Group | h5py.Dataset) else None


def member(group: h5py.Group, name: str) -> h5py.Dataset:
    """Return a required member of a group.

    Raises
    ------
    ValueError
        If the group has no member of this name.
    """
    item = child(group, name)
    if item is None:
        raise ValueError(f"no {name} in {', '.join(names(group))[:200] or 'an empty group'}")
    return item


def groups(file: h5py.File) -> Iterator[h5py.Group]:
    """Yield every group of a file once, beginning with the root.

    Raises
    ------
    ValueError
        If there are more groups than a file of poses can have.
    """
    seen: set[Any] = set()
    pending: list[tuple[h5py.Group, int]] = [(file["/"], 0)]  # pyright: ignore[reportAssignmentType]
    while pending:
        group, depth = pending.pop()
        if group in seen or depth > MAX_DEPTH:
            continue
        seen.add(group)
        if len(seen) > MAX_GROUPS:
            raise ValueError(f"more than {MAX_GROUPS} groups")
        yield group
        for name in reversed(names(group)):
            if isinstance(group.get(name, getlink=True), h5py.HardLink):
                item = group[name]
                if isinstance(item, h5py.Group):
                    pending.append((item, depth + 1))


def is_scale(item: object) -> bool:
    """Return whether an item is a dimension scale, which is a dataset that names a dimension of other datasets."""
    return isinstance(item, h5py.Dataset) and attribute(item, "CLASS") == "DIMENSION_SCALE"


def scale_of(scale: h5py.Dataset, dataset: h5py.Dataset) -> list[int]:
    """Return the indices of a dataset's axes to which a dimension scale belongs."""
    if not h5py.h5a.exists(scale.id, b"REFERENCE_LIST"):
        return []
    stored = h5py.h5a.open(scale.id, b"REFERENCE_LIST")
    kind = stored.get_type()
    if kind.get_class() != h5t.COMPOUND or np.prod(stored.shape or (1,)) > MAX_TEXTS:
        return []
    members = [kind.get_member_class(i) for i in range(kind.get_nmembers())]
    if members != [h5t.REFERENCE, h5t.INTEGER]:
        return []
    listed = np.asarray(scale.attrs["REFERENCE_LIST"]).ravel().tolist()
    return [int(axis) for reference, axis in listed if reference and scale.file[reference] == dataset]


def attribute(holder: h5py.Group | h5py.Dataset, name: str) -> Any:
    """Return an attribute as a number, a string, an array of numbers or a list of strings, or None if it is absent.

    Bytes are read as UTF-8.

    Raises
    ------
    ValueError
        If the attribute is of another type.
    """
    value = raw_attribute(holder, name)
    if isinstance(value, bytes):
        return value.decode("utf-8")
    if isinstance(value, np.ndarray) and value.dtype.kind in "SUO":
        return [_text_of(item) for item in value.ravel().tolist()]
    if isinstance(value, np.ndarray) and value.ndim and value.size == 1:
        return value.ravel()[0]
    return value


def raw_attribute(holder: h5py.Group | h5py.Dataset, name: str) -> object:
    """Return an attribute with bytes unchanged, or None if it is absent.

    Raises
    ------
    ValueError
        If the attribute is neither a number nor a string, or is too large.
    """
    if not h5py.h5a.exists(holder.id, name.encode()):
        return None
    stored = h5py.h5a.open(holder.id, name.encode())
    kind = stored.get_type()
    if not _is_readable(kind) or kind.get_class() == h5t.COMPOUND:
        raise ValueError(f"attribute {name} is neither number nor text")
    count = int(np.prod(stored.shape or (1,), dtype=float))
    if count * kind.get_size() > MAX_ATTRIBUTE_BYTES or (count > MAX_TEXTS and _is_variable_length(kind)):
        raise ValueError(f"attribute {name} is too large")
    value = holder.attrs[name]
    if isinstance(value, h5py.Empty):
        return b"" if value.dtype.kind == "S" else None
    return bytes(value) if isinstance(value, np.bytes_) else value


def numbers(dataset: h5py.Dataset) -> np.ndarray:
    """Return the numbers of a dataset.

    Raises
    ------
    ValueError
        If the dataset has no numbers, or claims more data than the file has.
    """
    values = read_values(dataset)
    if values.dtype.kind not in "fiub":
        raise ValueError(f"{dataset.name} has no numbers")
    return values


def is_text(dataset: h5py.Dataset) -> bool:
    """Return whether the elements of a dataset are strings."""
    return dataset.id.get_type().get_class() == h5t.STRING


def texts(dataset: h5py.Dataset) -> list[str]:
    """Return the strings of a dataset of any shape in one list.

    Raises
    ------
    ValueError
        If the dataset has no strings, or claims more data than the file has.
    """
    _require_readable(dataset)
    if not dataset.size:
        return []
    if not _is_variable_length(dataset.id.get_type()):
        return [_text_of(item) for item in read_values(dataset).ravel().tolist()]
    if dataset.size > MAX_TEXTS:
        raise ValueError(f"{dataset.name} has {dataset.size} texts")
    _require_short_texts(dataset)
    remaining_bytes, items = FREE_BYTES, []
    for index in np.ndindex(dataset.shape):
        item = dataset[index]
        remaining_bytes -= len(item)
        if remaining_bytes < 0 or not isinstance(item, bytes | str) or isinstance(item, h5py.Empty):
            raise ValueError(f"{dataset.name} has no texts, or too many")
        items.append(_text_of(item))
    return items


def texts_in(group: h5py.Group, name: str) -> list[str]:
    """Return the strings of a dataset in a group, or an empty list if the dataset is absent or empty."""
    dataset = child(group, name)
    return texts(dataset) if getattr(dataset, "size", 0) else []


def read_values(dataset: h5py.Dataset) -> np.ndarray:
    """Return the content of a dataset of numbers, strings of fixed length, or records of both.

    Raises
    ------
    ValueError
        If the dataset has other types, or claims more data than the file has.
    """
    _require_readable(dataset)
    if _is_variable_length(dataset.id.get_type()):
        raise ValueError(f"{dataset.name} has texts of variable length")
    return np.asarray(dataset[()])


def _text_of(item: object) -> str:
    return item.decode("utf-8") if isinstance(item, bytes) else str(item)


def _require_readable(dataset: h5py.Dataset) -> None:
    """Raise ValueError for a dataset that must not be read.

    Items that are not datasets, other types, data in other files, and more data than the file has are rejected.
    """
    if not isinstance(dataset, h5py.Dataset):
        raise ValueError(f"{getattr(dataset, 'name', 'something')} is not a dataset")
    kind, layout = dataset.id.get_type(), dataset.id.get_create_plist()
    if not _is_readable(kind):
        raise ValueError(f"{dataset.name} has neither numbers nor texts")
    if dataset.is_virtual or dataset.external:
        raise ValueError(f"the data of {dataset.name} lie in another file")
    for i in range(layout.get_nfilters()):
        if (code := layout.get_filter(i)[0]) not in FILTERS:
            raise ValueError(f"{dataset.name} is compressed by something other than gzip (HDF5 filter {code})")
    if dataset.shape is None:
        raise ValueError(f"{dataset.name} is empty")
    stored, item = dataset.id.get_storage_size(), kind.get_size()
    wanted = item * max(math.prod(dataset.shape), math.prod(dataset.chunks or ()))
    packed = min(MAX_RATIO * stored, MAX_UNPACKED), min(USUAL_RATIO * stored, 4 * MAX_UNPACKED)
    if wanted > max(FREE_BYTES, stored, *packed):
        raise ValueError(
            f"{dataset.name} needs {wanted:.3g} bytes of memory, but the file stores only {stored} bytes of it"
        )


def _is_readable(kind: h5t.TypeID, inside: bool = False) -> bool:
    """Return whether an HDF5 type is a number, a string, or a record of numbers, strings or arrays of these.

    `inside` states whether the type is part of a record, in which arrays are allowed and records are not.
    """
    type_class = kind.get_class()
    if type_class == h5t.COMPOUND:
        members = [kind.get_member_type(i) for i in range(kind.get_nmembers())]
        return (
            not inside
            and not any(_is_variable_length(m) for m in members)
            and all(_is_readable(m, True) for m in members)
        )
    if type_class == h5t.ARRAY:
        return inside and kind.get_super().get_class() in (h5t.INTEGER, h5t.FLOAT, h5t.STRING, h5t.BITFIELD)
    return type_class in (h5t.INTEGER, h5t.FLOAT, h5t.STRING, h5t.ENUM, h5t.BITFIELD)


def _is_variable_length(kind: h5t.TypeID) -> bool:
    return kind.get_class() == h5t.STRING and bool(kind.is_variable_str())


def _require_short_texts(dataset: h5py.Dataset) -> None:
    """Raise ValueError if a string claims to be longer than the file, for which the library would allocate memory.

    Each string is stored as its length (4 bytes), the address of its heap (8 bytes), and its number there (4 bytes).
    """
    start = dataset.id.get_offset()
    if start is None:
        return
    with Path(dataset.file.filename).open("rb") as file:
        file.seek(start)
        stored = file.read(16 * int(dataset.size or 0))
        size = file.seek(0, 2)
    lengths = np.frombuffer(stored[: len(stored) // 16 * 16], "<u4")[::4]
    if len(lengths) != dataset.size or (lengths > size).any():
        raise ValueError(f"{dataset.name} has texts that are longer than the file")
