"""Define array types, show objects in one line, and compute statistics of arrays with missing values.

The name of an array type states the content of an array. Docstrings state its shape.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from recon.base.file_names import encodable

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int64]
Index = NDArray[np.intp]
"""Indices of elements of another array."""
MAX_CHARACTERS = 250
"""Maximum number of characters in the text of an object."""
MAX_PART_CHARACTERS = 75
"""Maximum number of characters in the text of an object's field."""
MAX_SHOWN_ELEMENTS = 12
"""Maximum number of elements of an array whose values are shown instead of its shape."""


class Brief:
    """Base class of dataclasses with large fields, which `repr` shortens to fit on one line."""

    def __repr__(self) -> str:
        names = [field.name for field in fields(self)]  # pyright: ignore[reportArgumentType]
        text = ", ".join(f"{name}={_brief(getattr(self, name))}" for name in names)
        return f"{type(self).__name__}({text if len(text) <= MAX_CHARACTERS else text[:MAX_CHARACTERS] + '...'})"


def _brief(part: object) -> str:
    """Return the text of an object's field, or its shape, number of items or class if the text is too long."""
    if isinstance(part, np.ndarray):
        return f"array {part.shape}" if part.size > MAX_SHOWN_ELEMENTS else f"array {part.tolist()}"
    text = f"{part:.6g}" if isinstance(part, float) else " ".join(repr(part).split())
    if len(text) <= MAX_PART_CHARACTERS:
        return text
    if isinstance(part, tuple | list | dict):
        return f"{type(part).__name__} of {len(part)}"
    return type(part).__name__ if is_dataclass(part) else f"{text[: MAX_PART_CHARACTERS - 3]}..."


@overload
def to_plain(value: Mapping[str, object], digits: int = 9) -> dict[str, Any]: ...


@overload
def to_plain(value: object, digits: int = 9) -> object: ...


def to_plain(value: object, digits: int = 9) -> object:
    """Convert a value to JSON types, with NaN and infinities as None.

    Numbers are rounded to `digits` significant digits.
    """
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {encodable(str(key)): to_plain(item, digits) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return to_plain(value.tolist(), digits)
    if isinstance(value, list | tuple):
        return [to_plain(item, digits) for item in value]
    return value if value is None or isinstance(value, bool | int) else encodable(str(value))


def finite(values: Array | Sequence[float]) -> Array:
    """Return the values of an array that are neither NaN nor infinite, in one dimension."""
    values = np.asarray(values, dtype=float)
    return values[np.isfinite(values)]


def mean(values: Array | Sequence[float]) -> float:
    """Return the mean of the finite values, or NaN if there are none."""
    known = finite(values)
    return float(known.mean()) if len(known) else np.nan


def median(values: Array | Sequence[float]) -> float:
    """Return the median of the finite values, or NaN if there are none."""
    known = finite(values)
    return float(np.median(known)) if len(known) else np.nan


def running_median(values: Array, count: int) -> Array:
    """Return the running median of values (N, ...) without NaN over `count` rows, an odd number.

    The first and the last row are repeated beyond the ends. scipy.ndimage.median_filter gives the same values, but its
    import takes longer than the medians.
    """
    rows = np.arange(len(values))[:, None] + np.arange(count) - count // 2
    windows = np.sort(values[np.clip(rows, 0, len(values) - 1)], axis=1)  # several times as fast as np.median
    return windows[:, count // 2]


def mean_along(values: Array, axis: int | tuple[int, ...]) -> Array:
    """Return the mean along one or more axes of the values that are not NaN; NaN if all are NaN."""
    known = ~np.isnan(values)
    count = known.sum(axis=axis)
    total = np.sum(values, axis=axis, where=known)
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
