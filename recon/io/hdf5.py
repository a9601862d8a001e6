"""HDF5 files of unknown origin, read with h5py: numbers and texts, and nothing else.

h5py runs nothing that a file holds. What the HDF5 library itself hangs in, or asks too much memory for, is checked
before: heaps of texts that lead nowhere, sizes that the file cannot fill, data in other files, types of other kinds.
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

from recon.base import InputError, Problem
from recon.base.documents import MAX_UNPACKED, damage_named
from recon.io.common import starts_with

FREE_BYTES = 1 << 26
"""What a dataset or a piece of it may take in any case; beyond that what it takes in the file, or, up to
`MAX_UNPACKED`, `MAX_RATIO` times that."""
MAX_RATIO = 1100
USUAL_RATIO = 100
"""Up to this, a table may be four times larger: tracks of many animals are mostly empty."""
"""The most that gzip can compress is 1032 times."""
FILTERS = (1, 2, 3, 32000)
"""gzip, shuffle, Fletcher's checksum, LZF: those that every h5py has, and whose decoders hold."""
MAX_ATTRIBUTE_BYTES = 1 << 24
MAX_TEXTS = 100_000
MAX_DEPTH = 12
MAX_GROUPS = 20_000
MAX_HOPS = 8


def is_hdf5(path: Path) -> bool:
    return starts_with(path, b"\x89HDF\r\n\x1a\n")


@contextmanager
def opened(path: Path, outline: bool = False) -> Iterator[h5py.File]:
    """A file to read. Raises InputError where it is damaged, also for what h5py says of that inside the block.

    outline: only names and types are looked at, which is safe without `_require_sound_heaps`.
    """
    with damage_named(path, "an HDF5 file that is whole and undamaged"):
        if not outline:
            _require_sound_heaps(path)
        try:
            file = h5py.File(path, "r")
        except OSError:
            found = "an HDF5 file that is cut off or damaged"
            raise InputError(Problem(path, "file", found, "a whole file")) from None
        with file:
            yield file


def _require_sound_heaps(path: Path) -> None:
    """Raises ValueError where a global heap, which holds texts of any length, has an object without an end: the
    library would look for the next one for ever.

    Header: signature, version, 3 bytes, size (8); objects: number (2), references (2), 4 bytes, size (8), data in steps
    of 8 bytes; number 0 is the free rest, which counts its header in its size."""
    with path.open("rb") as file:
        head = file.read(24)
        if (head[13:15] if head[8:9] < b"\2" else head[9:11]) != b"\x08\x08":
            raise ValueError("addresses of another size than 8 bytes")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            heap = content.find(b"GCOL\1")
            while heap >= 0:
                end = heap + int.from_bytes(content[heap + 8 : heap + 16], "little")
                at = heap + 16
                while at + 16 <= min(end, len(content)):
                    number = int.from_bytes(content[at : at + 2], "little")
                    length = int.from_bytes(content[at + 8 : at + 16], "little")
                    step = 16 + (length + 7) // 8 * 8 if number else length
                    if step < 16 or at + step > end:
                        raise ValueError("a damaged heap of texts")
                    at += step
                heap = content.find(b"GCOL\1", heap + 5)


def outline(path: Path) -> frozenset[str]:
    """The names at the root of a file, of its groups, datasets and attributes; empty for a file of another kind.

    Raises InputError where it cannot be opened.
    """
    if not is_hdf5(path):
        return frozenset()
    with opened(path, outline=True) as file:
        return frozenset((*names(file), *(name for name in file.attrs if isinstance(name, str))))


# -- finding things -----------------------------------------------------------------------------------------------


def names(group: h5py.Group) -> tuple[str, ...]:
    """The names of what a group holds."""
    return tuple(name for name in group if isinstance(name, str))


def child(group: h5py.Group, path: str, hops: int = MAX_HOPS) -> Any:
    """The group or dataset that a group holds under a name, or a path; None where there is nothing, or a link into
    another file."""
    found: Any = group.file["/"] if path.startswith("/") else group
    for name in path.split("/"):
        if name in ("", ".") or found is None:
            continue
        if not isinstance(found, h5py.Group) or not found.id.links.exists(name.encode()):
            return None
        link = found.get(name, getlink=True)
        if isinstance(link, h5py.HardLink):
            found = found[name]
        elif isinstance(link, h5py.SoftLink) and hops > 0:
            found = child(found, link.path, hops - 1)
        else:
            return None
    return found if isinstance(found, h5py.Group | h5py.Dataset) else None


def member(group: h5py.Group, name: str) -> Any:
    """What a group has to hold. Raises ValueError where it does not."""
    found = child(group, name)
    if found is None:
        raise ValueError(f"no {name} in {', '.join(names(group))[:200] or 'an empty group'}")
    return found


def groups(file: h5py.File) -> Iterator[h5py.Group]:
    """All groups, the root first, each once. Raises ValueError for more than a file of poses can have."""
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
                found = group[name]
                if isinstance(found, h5py.Group):
                    pending.append((found, depth + 1))


def is_scale(item: Any) -> bool:
    """Whether it is a dataset that names a dimension of others."""
    return isinstance(item, h5py.Dataset) and attribute(item, "CLASS") == "DIMENSION_SCALE"


def scale_of(scale: Any, dataset: Any) -> list[int]:
    """The axes of a dataset that a scale says it belongs to."""
    if not h5py.h5a.exists(scale.id, b"REFERENCE_LIST"):
        return []
    stored = h5py.h5a.open(scale.id, b"REFERENCE_LIST")
    kind = stored.get_type()
    if kind.get_class() != h5t.COMPOUND or np.prod(stored.shape or (1,)) > MAX_TEXTS:
        return []
    members = [kind.get_member_class(i) for i in range(kind.get_nmembers())]
    if members != [h5t.REFERENCE, h5t.INTEGER]:
        return []
    listed = scale.attrs["REFERENCE_LIST"].ravel().tolist()
    return [int(axis) for reference, axis in listed if reference and scale.file[reference] == dataset]


# -- reading ------------------------------------------------------------------------------------------------------


def attribute(holder: h5py.Group | h5py.Dataset, name: str) -> Any:
    """A number, a text, an array of numbers or a list of texts; None where there is none. Bytes are read as UTF-8.

    Raises ValueError for anything else."""
    value = raw_attribute(holder, name)
    if isinstance(value, bytes):
        return value.decode("utf-8")
    if isinstance(value, np.ndarray) and value.dtype.kind in "SUO":
        return [_text_of(item) for item in value.ravel().tolist()]
    if isinstance(value, np.ndarray) and value.ndim and value.size == 1:
        return value.ravel()[0]
    return value


def raw_attribute(holder: h5py.Group | h5py.Dataset, name: str) -> Any:
    """The same, with bytes as they are."""
    if not h5py.h5a.exists(holder.id, name.encode()):
        return None
    stored = h5py.h5a.open(holder.id, name.encode())
    kind = stored.get_type()
    if not _is_readable(kind) or kind.get_class() == h5t.COMPOUND:
        raise ValueError(f"attribute {name} is neither number nor text")
    many = int(np.prod(stored.shape or (1,), dtype=float))
    if many * kind.get_size() > MAX_ATTRIBUTE_BYTES or (many > MAX_TEXTS and _of_any_length(kind)):
        raise ValueError(f"attribute {name} is too large")
    value = holder.attrs[name]
    if isinstance(value, h5py.Empty):
        return b"" if value.dtype.kind == "S" else None
    return bytes(value) if isinstance(value, np.bytes_) else value


def numbers(dataset: Any) -> np.ndarray:
    """A dataset of numbers. Raises ValueError for one of another kind, or that asks for more than the file has."""
    values = read_values(dataset)
    if values.dtype.kind not in "fiub":
        raise ValueError(f"{dataset.name} has no numbers")
    return values


def is_text(dataset: h5py.Dataset) -> bool:
    return dataset.id.get_type().get_class() == h5t.STRING


def texts(dataset: Any) -> list[str]:
    """A dataset of texts, of any shape, one after the other. Raises ValueError as `numbers` does."""
    _require_readable(dataset)
    if not dataset.size:
        return []
    if not _of_any_length(dataset.id.get_type()):
        return [_text_of(item) for item in read_values(dataset).ravel().tolist()]
    if dataset.size > MAX_TEXTS:
        raise ValueError(f"{dataset.name} has {dataset.size} texts")
    _require_short_texts(dataset)
    left, found = FREE_BYTES, []
    for index in np.ndindex(dataset.shape):
        item = dataset[index]
        left -= len(item)
        if left < 0 or not isinstance(item, bytes | str) or isinstance(item, h5py.Empty):
            raise ValueError(f"{dataset.name} has no texts, or too many")
        found.append(_text_of(item))
    return found


def texts_in(group: h5py.Group, name: str) -> list[str]:
    """The texts of a dataset in a group; none where it is not there, or is empty."""
    dataset = child(group, name)
    return texts(dataset) if getattr(dataset, "size", 0) else []


def read_values(dataset: Any) -> np.ndarray:
    """A dataset of numbers, of texts of one length, or of records of those. Raises ValueError as `numbers` does."""
    _require_readable(dataset)
    if _of_any_length(dataset.id.get_type()):
        raise ValueError(f"{dataset.name} has texts of any length")
    return np.asarray(dataset[()])


def _text_of(item: Any) -> str:
    return item.decode("utf-8") if isinstance(item, bytes) else str(item)


def _require_readable(dataset: Any) -> None:
    """Raises ValueError for a dataset that is none, whose type is none of ours, whose data lie in other files, or that
    asks for more than the file has."""
    if not isinstance(dataset, h5py.Dataset):
        raise ValueError(f"{getattr(dataset, 'name', 'something')} is no dataset")
    kind, layout = dataset.id.get_type(), dataset.id.get_create_plist()
    if not _is_readable(kind):
        raise ValueError(f"{dataset.name} has neither numbers nor texts")
    if dataset.is_virtual or dataset.external:
        raise ValueError(f"the data of {dataset.name} lie in another file")
    for i in range(layout.get_nfilters()):
        if (code := layout.get_filter(i)[0]) not in FILTERS:
            raise ValueError(f"{dataset.name} is compressed in another way than by gzip (HDF5 filter {code})")
    if dataset.shape is None:
        raise ValueError(f"{dataset.name} is empty")
    stored, item = dataset.id.get_storage_size(), kind.get_size()
    wanted = item * max(math.prod(dataset.shape), math.prod(dataset.chunks or ()))
    packed = min(MAX_RATIO * stored, MAX_UNPACKED), min(USUAL_RATIO * stored, 4 * MAX_UNPACKED)
    if wanted > max(FREE_BYTES, stored, *packed):
        raise ValueError(f"{dataset.name} asks for {wanted:.3g} bytes, of which the file has {stored}")


def _is_readable(kind: Any, inside: bool = False) -> bool:
    """Whether a type is of numbers or texts, or of records or short rows of those."""
    which = kind.get_class()
    if which == h5t.COMPOUND:
        members = [kind.get_member_type(i) for i in range(kind.get_nmembers())]
        return (
            not inside and not any(_of_any_length(m) for m in members) and all(_is_readable(m, True) for m in members)
        )
    if which == h5t.ARRAY:
        return inside and kind.get_super().get_class() in (h5t.INTEGER, h5t.FLOAT, h5t.STRING, h5t.BITFIELD)
    return which in (h5t.INTEGER, h5t.FLOAT, h5t.STRING, h5t.ENUM, h5t.BITFIELD)


def _of_any_length(kind: Any) -> bool:
    return kind.get_class() == h5t.STRING and bool(kind.is_variable_str())


def _require_short_texts(dataset: Any) -> None:
    """Raises ValueError where a text claims to be longer than the file, for which the library would take memory. Each
    stands in the data as its length (4), the address of its heap (8), and its number there (4)."""
    where = dataset.id.get_offset()
    if where is None:
        return
    with Path(dataset.file.filename).open("rb") as file:
        file.seek(where)
        stored = file.read(16 * int(dataset.size))
        size = file.seek(0, 2)
    lengths = np.frombuffer(stored[: len(stored) // 16 * 16], "<u4")[::4]
    if len(lengths) != dataset.size or (lengths > size).any():
        raise ValueError(f"{dataset.name} has texts that are longer than the file")
