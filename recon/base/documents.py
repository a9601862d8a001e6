"""Read JSON, TOML and NumPy archives of unknown origin, and the package's own files.

Sizes are checked before anything is unpacked. Readers return a table or arrays, or raise InputError.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
import tomllib
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from recon.base.errors import ANY_FILE, NO_FILE, InputError, Problem
from recon.base.file_names import encodable

Json: TypeAlias = Any
"""Content of a JSON text: dictionaries, lists, strings, numbers, booleans and None."""
MAX_BYTES = 1 << 28
MAX_TOML_BYTES = 1 << 23
"""Maximum size of a TOML file, in bytes, because the parser is slow."""


@contextmanager
def damage_as_input_error(source: str | Path, expected: str, field: str = "content") -> Iterator[None]:
    """Turn every exception that a damaged file can cause in the block into an InputError.

    `expected` describes an undamaged file, for the message.
    """
    try:
        yield
    except (InputError, AssertionError, NameError, ImportError):  # errors of the program, not of the file
        raise
    except UnicodeDecodeError as error:
        raise InputError(Problem(source, field, f"bytes that are not {error.encoding.upper()}", expected)) from None
    except RecursionError:
        raise InputError(Problem(source, field, "tables or lists that are nested too deeply", expected)) from None
    except Exception as error:
        message = " ".join(str(getattr(error, "strerror", None) or error).split())[:200] or type(error).__name__
        damage = (
            f"an entry without {message}" if isinstance(error, KeyError) else f"data that cannot be read ({message})"
        )
        raise InputError(Problem(source, field, damage, expected)) from None


def read_text(path: Path, expected: str, most_bytes: int = MAX_BYTES) -> str:
    """Return the text of a UTF-8 file.

    `expected` describes the file, for messages.

    Raises
    ------
    InputError
        If the path is not a readable file, or the file is empty, too large, or not in UTF-8.
    """
    return text_of(read_content(path, expected, most_bytes), path, expected)


def text_of(content: bytes, source: str | Path, expected: str) -> str:
    """Decode UTF-8 bytes, or raise InputError if they are not UTF-8."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        fault = f"byte {error.start + 1} of the file is not UTF-8"
        raise InputError(Problem(source, "text", fault, f"{expected}, as text in UTF-8")) from None


def read_content(path: Path, expected: str, most_bytes: int = MAX_BYTES) -> bytes:
    """Return the content of a file as bytes, with the checks and errors of `read_text` except for the encoding."""
    content = read_head(path, expected, most_bytes + 1)
    if len(content) > most_bytes:
        raise InputError(Problem(path, "file", f"a file of more than {most_bytes >> 20} MB", expected))
    return content


def read_head(path: Path, expected: str = ANY_FILE, length: int = 64) -> bytes:
    """Return the first bytes of a file.

    Raises
    ------
    InputError
        If the file is empty, or the path is not a readable file.
    """
    require_file(path, expected)
    with damage_as_input_error(path, expected, "file"), path.open("rb") as file:
        head = file.read(min(os.fstat(file.fileno()).st_size, length))
    if not head:
        raise InputError(Problem(path, "file", "an empty file", expected))
    return head


def utf8_path(path: Path) -> str:
    """Return an absolute path for a library that accepts only UTF-8, or raise InputError if its name is not UTF-8."""
    name = str(path.absolute())
    if encodable(name) != name:
        raise InputError(Problem(path, "name", "bytes that are not UTF-8", "a name in UTF-8: rename the file"))
    return name


def require_file(path: Path, expected: str = ANY_FILE) -> None:
    """Raise InputError unless a path is a regular file.

    Reading a pipe, for example, could block forever.
    """
    with damage_as_input_error(path, expected, "file"):
        if not path.is_file():
            raise InputError(Problem(path, "file", _kind_of(path), expected))


def _kind_of(path: Path) -> str:
    """Return a description of a path that is not a file, for a message."""
    if path.exists():
        return "a folder" if path.is_dir() else "a pipe or a device"
    return "a link that points to nothing" if path.is_symlink() else NO_FILE


def read_json(path: Path, expected: str) -> Json:
    """Return the content of a JSON file, or raise InputError if it cannot be read."""
    return parse_json(read_text(path, expected), path, expected)


def read_toml(path: Path, expected: str = "a TOML file") -> dict[str, Any]:
    """Return the table of a TOML file, or raise InputError if it cannot be read."""
    return parse_toml(read_text(path, expected, MAX_TOML_BYTES), path, expected)


def parse_json(text: str, source: str | Path, expected: str = "JSON") -> Json:
    """Return the content of a JSON string, or raise InputError if the string is not JSON."""
    with damage_as_input_error(source, expected):
        return json.loads(text)


_LONG_KEY = re.compile(r"""(?<![\w"'-])(?:(?:"[^"\n]*+"|'[^'\n]*+'|[\w-]++)[ \t]*+\.[ \t]*+){100}""")


def parse_toml(text: str, source: str | Path, expected: str = "TOML") -> dict[str, Any]:
    """Return the table of a TOML string, or raise InputError if the string is not TOML."""
    with damage_as_input_error(source, expected):
        if _LONG_KEY.search(text):
            raise RecursionError  # the time and memory of tomllib grow with the square of a key's length
        return tomllib.loads(text)


_Model = TypeVar("_Model")


_adapter = cache(TypeAdapter)  # cached because making an adapter takes longer than checking a table


def validated(model: type[_Model], table: Mapping[str, Any], source: str | Path) -> _Model:
    """Return a table converted to a pydantic model or a dataclass, after a check of its types and values.

    Raises
    ------
    InputError
        If the table does not fit the model. The message lists everything that is wrong.
    """
    adapter = _adapter(model)
    try:
        return adapter.validate_python(table)
    except ValidationError as error:
        from recon.base.field_problems import problems_of

        raise InputError(problems_of(error, source, adapter.json_schema(), table=table)) from None


MAX_UNPACKED = 1 << 30
"""Maximum size of an unpacked archive, in bytes, because a larger archive could fill the memory."""
MAX_ARRAYS = 1 << 16
"""Maximum number of arrays in an archive."""
KINDS = "biuf"
"""NumPy's letters for the types of numbers: booleans, signed and unsigned integers, and floats."""


def arrays_of(content: bytes, kinds: str) -> dict[str, np.ndarray]:
    """Return the arrays of a NumPy archive, keyed by their names.

    `kinds` are NumPy's letters for the allowed types, never "O", which is a pickle. Sizes are checked before anything
    is unpacked.

    Raises
    ------
    ValueError
        If an array has another type or is too large. Errors of NumPy and zipfile are passed on.
    """
    arrays = {}
    with zipfile.ZipFile(BytesIO(content)) as archive:
        check_unpacked_size(archive)
        for entry in archive.infolist():
            with archive.open(entry) as file:  # a damaged entry may be larger than it states
                arrays[entry.filename.removesuffix(".npy")] = _array(file.read(entry.file_size), kinds)
    return arrays


def check_unpacked_size(archive: zipfile.ZipFile) -> None:
    """Raise ValueError for a zip archive that unpacks to more than `MAX_UNPACKED` bytes or `MAX_ARRAYS` files."""
    infos = archive.infolist()
    size = sum(info.file_size for info in infos)
    if len(infos) > MAX_ARRAYS or size > MAX_UNPACKED:
        limits = f"at most {MAX_ARRAYS} arrays of {MAX_UNPACKED >> 20} MB are read"
        raise ValueError(f"{len(infos)} arrays of {size >> 20} MB; {limits}")
    if any(info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for info in infos):
        raise ValueError("compressed in a way that NumPy does not use")  # zipfile would unpack these without a limit


def _array(content: bytes, kinds: str) -> np.ndarray:
    """Return the array of an .npy file, or raise ValueError if its header and its data disagree."""
    file = BytesIO(content)
    version = np.lib.format.read_magic(file)
    read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # arrays written by Python 2 cause a warning
        shape, fortran, dtype = read_header(file)
    start = file.tell()
    if dtype.kind not in kinds or not dtype.itemsize or dtype.itemsize * math.prod(shape) != len(content) - start:
        raise ValueError(f"an array of {dtype} with shape {shape} in {len(content)} bytes")
    if (
        dtype.kind == "U"
        and np.frombuffer(content, f"{dtype.byteorder}u4", offset=start).max(initial=0) > sys.maxunicode
    ):
        raise ValueError("text with characters that do not exist")
    flat = np.frombuffer(content, dtype, offset=start)
    return flat.reshape(shape, order="F" if fortran else "C").copy(order="K")


Number = Annotated[float, Field(gt=-1e6, lt=1e6, allow_inf_nan=False)]
Sigma = Annotated[float, Field(gt=1e-9, lt=1e6, allow_inf_nan=False)]
"""Type of a standard deviation in a file, with limits that only a damaged value exceeds."""


class FileTable(BaseModel):
    """Base class for tables in files, which refuses fields that the class does not declare."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def unknown(source: str, names: Iterable[tuple[str, str]], known: Iterable[str], prefix: str = "") -> Iterator[Problem]:
    """Yield a problem for each pair of field and name whose name is not known."""
    known = [*known]
    for field, name in names:
        if name not in known:
            yield Problem(source, field, repr(name), f"{prefix or 'one of '}{', '.join(known)}")


def named_file(
    name: str | Path, folder: str, suffix: str, option: str, kind: str, names: Iterable[str] | None = None
) -> tuple[bytes, str]:
    """Return the content of a built-in file or of a user's file, and its name for messages.

    `name` is the name of a file in the package's `folder`, or the path of any other file. `kind` describes the file,
    and `names` are the allowed names if only some files of the folder are allowed.

    Raises
    ------
    InputError
        If there is no such file, or it cannot be read.
    """
    known = builtin_names(folder, suffix)
    if str(name) in known:
        return builtin_file(folder, f"{name}{suffix}").read_bytes(), f"{kind} {name}"
    path, expected = Path(name), f"a {kind} file ({suffix})"
    if not os.path.isfile(path):  # False, not an OSError, for a name that is too long
        choice = ", ".join(known if names is None else names)
        content = f"{str(name)!r}{', no such file' if path.suffix else ''}"
        raise InputError(Problem(option, "name or file", content, f"one of {choice}, or {expected}"))
    return read_content(path, expected, MAX_UNPACKED), str(path)


def named_table(
    name: str | Path, folder: str, option: str, kind: str, names: Iterable[str] | None = None
) -> tuple[dict[str, Any], str]:
    """Return the content of a built-in TOML file or of the user's own, and the file's name for messages.

    The parameters are those of `named_file`.
    """
    content, source = named_file(name, folder, ".toml", option, kind, names)
    return parse_toml(text_of(content, source, f"a {kind} file"), source), source


def builtin_file(folder: str, name: str) -> Traversable:
    """Return a file in a folder of the package."""
    return resources.files("recon") / folder / name


@cache
def builtin_names(folder: str, suffix: str) -> tuple[str, ...]:
    """Return the names, without `suffix`, of the files in a folder of the package that have this suffix."""
    files = (resources.files("recon") / folder).iterdir()
    return tuple(sorted(f.name.removesuffix(suffix) for f in files if f.name.endswith(suffix)))
