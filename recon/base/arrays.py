"""Arrays by what is in them, their shapes stand in docstrings; what is known of those with unknown values; and numbers
as sentences have them."""

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


# -- in sentences ------------------------------------------------------------------------------------------------------

SHORT_M = 0.1
"""Lengths below it are in millimetres: those of a mouse are 0.00 m otherwise."""


def decimals(value: float) -> str:
    """The format of a speed or a path: one decimal, and two where it is below 1, as of a mouse: 12.3, 0.07."""
    return ".1f" if abs(value) >= 1 else ".2f"


def length_text(length_m: float, sigma_m: float | None = None) -> str:
    """As in 1.23 m, 1.23 ± 0.04 m, 1.230 ± 0.004 m, 56 mm."""
    fine = sigma_m is not None and sigma_m < 0.005
    scale, unit, form = (1e3, "mm", ".0f") if abs(length_m) < SHORT_M else (1.0, "m", ".3f" if fine else ".2f")
    values = [format(scale * value, form) for value in (length_m, sigma_m) if value is not None]
    return f"{' ± '.join(values)} {unit}"
