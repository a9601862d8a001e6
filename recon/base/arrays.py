"""Arrays by what is in them, their shapes stand in docstrings; and what is known of those with unknown values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int64]
Index = NDArray[np.intp]
"""Indices of places in another array."""


def finite(values: Array | Sequence[float]) -> Array:
    """Which rows (N,) of an array (N, ...) have no NaN and no infinity."""
    values = np.asarray(values, dtype=float)
    return values[np.isfinite(values)]


def mean(values: Array | Sequence[float]) -> float:
    """The mean of the values that are known, NaN where none is."""
    known = finite(values)
    return float(known.mean()) if len(known) else np.nan


def median(values: Array | Sequence[float]) -> float:
    """The median of the values that are known, NaN where none is."""
    known = finite(values)
    return float(np.median(known)) if len(known) else np.nan


def mean_along(values: Array, axis: int | tuple[int, ...]) -> Array:
    """The mean along an axis, or several, of the values that are known, NaN where none is."""
    known = ~np.isnan(values)
    count = known.sum(axis=axis)
    total = np.sum(values, axis=axis, where=known)
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
