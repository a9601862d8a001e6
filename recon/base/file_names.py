"""Write any file name into a UTF-8 text file, and find the file again by the written name.

A file name on Linux is a sequence of bytes that need not be UTF-8. Python reads a byte that is not UTF-8 as a lone
surrogate, which no UTF-8 file can hold.
"""

from __future__ import annotations

import os
import re
from typing import Any, overload

_SURROGATE = re.compile("[\ud800-\udfff]")
_ESCAPED_BYTE = re.compile(r"\\x([89a-f][0-9a-f])")


def encodable(text: str) -> str:
    r"""Return a string that UTF-8 can encode, with escape sequences for invalid bytes, as in caf\xe9.csv."""
    return _SURROGATE.sub(_code, text) if not text.isascii() else text


@overload
def to_encodable(value: dict[str, Any]) -> dict[str, Any]: ...


@overload
def to_encodable(value: object) -> object: ...


def to_encodable(value: object) -> object:
    """Return a value with `encodable` applied to every string in its lists and dictionaries."""
    if isinstance(value, dict):
        return {encodable(key): to_encodable(item) for key, item in value.items()}
    if isinstance(value, list):
        return [to_encodable(item) for item in value]
    return encodable(value) if isinstance(value, str) else value


def _code(match: re.Match[str]) -> str:
    number = ord(match[0])
    return rf"\x{number - 0xDC00:02x}" if 0xDC80 <= number <= 0xDCFF else rf"\u{number:04x}"


def existing_path(path: str) -> str:
    r"""Return the path of the existing file whose name `encodable` wrote, or the path unchanged if there is none.

    A name may contain both escape sequences and literal text that looks like one, such as \xe9. The names of the files
    in each folder decide which is meant.
    """
    if os.name == "nt" or not _ESCAPED_BYTE.search(path) or os.path.lexists(path):
        return path
    folder, name = os.path.split(path)
    if not name:  # the root has no name
        return path
    folder = existing_path(folder)
    if os.path.lexists(os.path.join(folder, name)):
        return os.path.join(folder, name)
    try:
        names = os.listdir(folder or ".")
    except OSError:
        return path
    match = next((candidate for candidate in sorted(names) if encodable(candidate) == name), name)
    return os.path.join(folder, match) if match != name else path
