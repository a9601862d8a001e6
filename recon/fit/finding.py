"""A diagnosis of an input or of a fit, as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Severity = Literal["error", "warning", "note"]
"""error: the result is not to be used as it is; warning: it is to be used with care; note: nothing is wrong."""
Number = float | int | str | tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """What a check found. `recon.check.CODES` has the severity and the words of each code."""

    code: str
    severity: Severity
    frames: tuple[int, int] | None = None
    """First frame number, and the one after the last; None: the whole clip."""
    camera: str | None = None
    """The name of the camera that it is about; None: all of them, or the clip."""
    numbers: dict[str, Number] = field(default_factory=dict)
    """What says so, plain numbers and names. Radians, metres, seconds and pixels, as the names end."""

    def names(self, number: str) -> tuple[str, ...]:
        """The names that stand there; none where there is none."""
        found = self.numbers.get(number, ())
        return found if isinstance(found, tuple) else ()
