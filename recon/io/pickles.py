"""Read plain values from pickles of unknown origin.

A pickle is a program, which could do anything. `plain_pickle` runs only instructions that build plain values, and
`plain_parts_of_pickle` replaces every object of another kind by an `Unread`.
"""

from __future__ import annotations

import io
import pickle
import pickletools
from typing import Any, TypeAlias

Plain: TypeAlias = Any
"""String, number, list, tuple or dictionary."""
MAX_PICKLE_BYTES = 1 << 24
PLAIN_PICKLES = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "STRING", "SHORT_BINSTRING", "BINSTRING"),
    *("NONE", "NEWTRUE", "NEWFALSE", "EMPTY_LIST", "EMPTY_DICT", "EMPTY_TUPLE", "MARK", "LIST", "TUPLE", "DICT"),
    *("TUPLE1", "TUPLE2", "TUPLE3", "APPEND", "APPENDS", "SETITEM", "SETITEMS", "PROTO", "FRAME", "STOP"),
    *("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE", "GET", "BINGET", "LONG_BINGET"),
}
"""Instructions of pickles that build strings, numbers, lists, tuples and dictionaries, and import or call nothing."""
_SCALARS = {
    *((module, "scalar") for module in ("numpy.core.multiarray", "numpy._core.multiarray")),
    ("numpy", "dtype"),
}
"""NumPy's functions that make single numbers, allowed among plain values on request."""


def plain_pickle(content: bytes) -> Plain:
    """Return the value of a pickle of plain values.

    The pickle is run only if all its instructions are in `PLAIN_PICKLES`.

    Raises
    ------
    ValueError
        If the pickle has any other instruction, which the message names.
    """
    _require_small(content)
    try:
        for opcode, argument, _ in pickletools.genops(content):
            if opcode.name not in PLAIN_PICKLES:
                raise ValueError(f"a pickled Python object ({opcode.name} {argument or ''}".rstrip() + ")")
            _require_small_index(opcode.name, argument, content)
        return pickle.loads(content)
    except (ArithmeticError, AttributeError, LookupError, TypeError, EOFError, pickle.UnpicklingError):
        raise ValueError("a damaged pickle") from None


def plain_parts_of_pickle(content: bytes) -> Plain:
    """Return the plain values and NumPy numbers of a pickle, with an `Unread` for every object of another class.

    Nothing else in the pickle is imported or called.

    Raises
    ------
    ValueError
        If the pickle is damaged.
    """
    _require_small(content)
    try:
        for opcode, argument, _ in pickletools.genops(content):
            _require_small_index(opcode.name, argument, content)
        return _ScalarUnpickler(io.BytesIO(content)).load()
    except (ArithmeticError, AttributeError, LookupError, TypeError, EOFError, pickle.UnpicklingError):
        raise ValueError("a damaged pickle") from None


class Unread:
    """Placeholder for an object of a pickle that is not created, which ignores what the pickle does with it."""

    def __init__(self, *arguments: object, **named: object) -> None: ...

    def __call__(self, *arguments: object, **named: object) -> Unread:
        """Return this placeholder as the result of a call."""
        return self

    def __repr__(self) -> str:
        return "an object of Python"

    def __setstate__(self, state: object) -> None: ...

    def __setitem__(self, key: object, value: object) -> None: ...

    def append(self, value: object) -> None:
        """Do nothing with a value that would be appended."""

    def extend(self, values: object) -> None:
        """Do nothing with values that would be appended."""


class _ScalarUnpickler(pickle.Unpickler):
    """Unpickler that imports nothing but the functions that make NumPy's numbers."""

    def find_class(self, module: str, name: str) -> object:
        return super().find_class(module, name) if (module, name) in _SCALARS else Unread


def _require_small(content: bytes) -> None:
    if len(content) > MAX_PICKLE_BYTES:
        raise ValueError(f"a pickle of {len(content)} bytes")


def _require_small_index(name: str, argument: int | str | None, content: bytes) -> None:
    """Raise ValueError for a memo index so large that memory would be allocated for all smaller ones."""
    if name in ("PUT", "LONG_BINPUT") and int(argument or 0) > len(content):
        raise ValueError("a damaged pickle")
