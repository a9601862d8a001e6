"""Define a section of the report."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from recon.fit.motion import Motion

Line = tuple[str, str]
"""Label and value of a line in the summary."""


@dataclass(frozen=True)
class Section:
    """One field of report.json, and the lines of the summary that state it."""

    name: str
    """Name of the field."""
    data: Callable[[Motion], Any]
    """Function that returns the content of the field: numbers, texts, arrays, and lists and mappings of these."""
    lines: Callable[[Motion, Any], Iterable[Line]] = lambda motion, data: ()
    """Function that yields the lines from the motion and the field's content in JSON types; an unknown number is
    null.
    """


def camera_name(motion: Motion, number: int = 0) -> str:
    """Return the name of a camera for a sentence in the summary."""
    return motion.pictures[number].name if len(motion.pictures) > 1 else "the camera"
