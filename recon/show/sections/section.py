"""Define a section of the report."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from recon.fit.motion import Motion

Line = tuple[str, str]
"""Label and value of a line of the summary."""


@dataclass(frozen=True)
class Section:
    """One field of report.json, and the lines of the summary that state it."""

    name: str
    """Name of the field."""
    data: Callable[[Motion], Any]
    """Returns the content of the field: numbers, texts, arrays, and lists and mappings of them."""
    lines: Callable[[Motion, Any], Iterable[Line]] = lambda motion, data: ()
    """Yields the lines from the motion and its data in JSON types: null for an unknown number."""


def camera_name(motion: Motion, number: int = 0) -> str:
    """Return the name of a camera in a sentence of the summary."""
    return motion.pictures[number].name if len(motion.pictures) > 1 else "the camera"
