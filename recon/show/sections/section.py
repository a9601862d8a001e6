"""Define the class for sections of report.json and of the summary."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from recon.fit.motion import Motion

Line = tuple[str, str]
"""Label and value of a line in the summary that a fit prints."""


@dataclass(frozen=True)
class Section:
    """Field of report.json, with functions that compute its content and its lines in the summary that a fit prints."""

    name: str
    """Name of the field."""
    data: Callable[[Motion], Any]
    """Function that returns the content of the field, made of numbers, strings, arrays, lists and mappings.
    """
    lines: Callable[[Motion, Any], Iterable[Line]] = lambda motion, data: ()
    """Function that yields the summary's lines, given the motion and the content in JSON types (None for unknown)."""


def camera_name(motion: Motion, number: int = 0) -> str:
    """Return a camera's name, or "the camera" if there is only one, for a sentence in the summary."""
    return motion.pictures[number].name if len(motion.pictures) > 1 else "the camera"
