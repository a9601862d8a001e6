"""Arrays by what is in them, their shapes stand in docstrings; and what is known of those with unknown values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon.base.file_names import encodable

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int64]
Index = NDArray[np.intp]
"""Indices of places in another array."""
LONGEST, LONGEST_PART, SMALL = 250, 75, 12
"""The characters that an object shows of itself at most, and a part of it; numbers of an array that is shown itself."""


class Brief:
    """What a dataclass with large parts is a subclass of (`repr=False`), so that it shows itself in one line."""

    def __repr__(self: Any) -> str:
        text = ", ".join(f"{field.name}={_brief(getattr(self, field.name))}" for field in fields(self))
        return f"{type(self).__name__}({text if len(text) <= LONGEST else text[:LONGEST] + '...'})"


def _brief(part: Any) -> str:
    """Return a part of an object in a few words: a long one by its shape, its number of items, or its class."""
    if isinstance(part, np.ndarray):
        return f"array {part.shape}" if part.size > SMALL else f"array {part.tolist()}"
    text = f"{part:.6g}" if isinstance(part, float) else " ".join(repr(part).split())
    if len(text) <= LONGEST_PART:
        return text
    if isinstance(part, tuple | list | dict):
        return f"{type(part).__name__} of {len(part)}"
    return type(part).__name__ if is_dataclass(part) else f"{text[: LONGEST_PART - 3]}..."


def to_plain(value: Any, digits: int = 9) -> Any:
    """Arrays, tuples, mappings and numbers as JSON types; NaN and infinities are None. digits: the significant ones."""
    if isinstance(value, Mapping):
        return {encodable(str(key)): to_plain(item, digits) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return to_plain(value.tolist(), digits)
    if isinstance(value, list | tuple):
        return [to_plain(item, digits) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int) else encodable(str(value))


def finite(values: Array | Sequence[float]) -> Array:
    """Return the values of an array that are neither NaN nor infinite, in one row."""
    values = np.asarray(values, dtype=float)
    return values[np.isfinite(values)]


def mean(values: Array | Sequence[float]) -> float:
    """Return the mean of the values that are known, NaN if none is."""
    known = finite(values)
    return float(known.mean()) if len(known) else np.nan


def median(values: Array | Sequence[float]) -> float:
    """Return the median of the values that are known, NaN if none is."""
    known = finite(values)
    return float(np.median(known)) if len(known) else np.nan


def mean_along(values: Array, axis: int | tuple[int, ...]) -> Array:
    """Return the mean of the known values along an axis, or several, NaN where none is."""
    known = ~np.isnan(values)
    count = known.sum(axis=axis)
    total = np.sum(values, axis=axis, where=known)
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
