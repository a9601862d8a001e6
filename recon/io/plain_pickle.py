"""Pickles of plain values, read without running anything.

pandas keeps a table's column labels as pickles inside an HDF5 file. A pickle is a program: here its instructions are
listed by `pickletools`, and those that build lists, tuples, dictionaries, texts and numbers are followed. Any other
ends the reading, so that nothing is ever imported or called.
"""

from __future__ import annotations

import pickletools
from collections.abc import Callable, Sequence
from typing import Any

MAX_BYTES = 1 << 24

_VALUES = (
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "STRING", "SHORT_BINSTRING", "BINSTRING"),
)
"""Instructions that push their argument."""
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_EMPTY: dict[str, Callable[[], Any]] = {"EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_TUPLE": tuple}
_FIXED_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_MARK = object()


def loads(content: bytes) -> Any:
    """The value of a pickle. Raises ValueError that says what is in it beside plain values."""
    if len(content) > MAX_BYTES:
        raise ValueError(f"a pickle of {len(content)} bytes")
    stack: list[Any] = []
    memo: dict[int, Any] = {}
    try:
        for opcode, argument, _ in pickletools.genops(content):
            if opcode.name == "STOP" and len(stack) == 1:
                return stack[0]
            _step(opcode.name, argument, stack, memo)
    except (IndexError, KeyError, TypeError):
        pass
    raise ValueError("a damaged pickle")


def _step(name: str, argument: Any, stack: list[Any], memo: dict[int, Any]) -> None:
    if name in _VALUES:
        stack.append(argument)
    elif name in _CONSTANTS:
        stack.append(_CONSTANTS[name])
    elif name in _EMPTY:
        stack.append(_EMPTY[name]())
    elif name == "MARK":
        stack.append(_MARK)
    elif name in ("LIST", "TUPLE", "DICT"):
        items = _to_mark(stack)
        stack.append(items if name == "LIST" else tuple(items) if name == "TUPLE" else _pairs(items))
    elif name in _FIXED_TUPLES:
        n = _FIXED_TUPLES[name]
        stack[-n:] = [tuple(stack[-n:])]
    elif name in ("APPEND", "APPENDS"):
        items = [stack.pop()] if name == "APPEND" else _to_mark(stack)
        list.extend(stack[-1], items)
    elif name in ("SETITEM", "SETITEMS"):
        items = [stack.pop(-2), stack.pop()] if name == "SETITEM" else _to_mark(stack)
        dict.update(stack[-1], _pairs(items))
    elif name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
        memo[len(memo) if argument is None else argument] = stack[-1]
    elif name in ("GET", "BINGET", "LONG_BINGET"):
        stack.append(memo[argument])
    elif name not in ("PROTO", "FRAME"):
        raise ValueError(f"a pickled Python object ({name} {argument or ''}".rstrip() + ")")


def _to_mark(stack: list[Any]) -> list[Any]:
    """What lies above the last mark, which goes as well."""
    items: list[Any] = []
    while (top := stack.pop()) is not _MARK:
        items.append(top)
    return items[::-1]


def _pairs(items: Sequence[Any]) -> dict[Any, Any]:
    return dict(zip(items[::2], items[1::2], strict=True))
