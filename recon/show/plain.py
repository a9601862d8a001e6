"""Convert values to plain JSON types, and summarise values for a report."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.arrays import Array, finite, mean, to_plain
from recon.base.file_names import encodable, to_encodable


def write_report(report: Mapping[str, Any], path: Path) -> None:
    """Write a report as indented JSON, with each list of numbers on one line."""
    text = json.dumps(to_encodable(report), indent=1, allow_nan=False, ensure_ascii=False)
    # JSON strings contain no line breaks, so only white space between values changes.
    text = re.sub(r"\[[^\[\]{}]*\]", lambda match: re.sub(r"\s*\n\s*", " ", match[0]), text)
    path.write_text(text + "\n", encoding="utf-8")


def to_json(value: object) -> str:
    """Return a value as a JSON string, for a file or for `--json`."""
    return json.dumps(to_plain(value), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def file_name(path: str | None) -> str | None:
    """Return the file name of a path without its folders, or None."""
    return None if path is None else encodable(Path(path).name)


def picked(source: object, *names: str) -> dict[str, Any]:
    """Return a dictionary of the attributes `names` of an object."""
    return {name: getattr(source, name) for name in names}


def by_name(names: Sequence[str], values: Sequence[object]) -> dict[str, Any]:
    """Return a dictionary with each of `names` as a key and the value at the same index."""
    return dict(zip(names, values, strict=True))


def spread(values: Array) -> dict[str, float]:
    """Return the mean, minimum and maximum of the known values as `mean`, `min` and `max`."""
    known_values = finite(values)
    low, high = (float(known_values.min()), float(known_values.max())) if len(known_values) else (np.nan, np.nan)
    return {"mean": mean(values), "min": low, "max": high}


def number(value: float | None, spec: str) -> str:
    """Return a number as a string for a summary, or "?" if it is unknown."""
    return "?" if value is None or math.isnan(value) else format(value, spec)
