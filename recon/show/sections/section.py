"""What a section of a report is."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from recon.fit.motion import Motion

Line = tuple[str, str]
"""(label, value), of a summary."""


def no_lines(motion: Motion, data: Any) -> Iterable[Line]:
    """No lines, for a section that a summary leaves out."""
    return ()


@dataclass(frozen=True)
class Section:
    """One part of what is said of a motion, wherever it is said."""

    name: str
    """The name of its field of report.json."""
    data: Callable[[Motion], Any]
    """What stands there: numbers, texts, arrays, and lists and mappings of them."""
    lines: Callable[[Motion, Any], Iterable[Line]] = no_lines
    """The lines of the summary, from the motion and from the data as JSON has them: null where a number is not
    known."""
