"""Report the progress of long work."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Function that is called with the name of the present step, and with the fraction of the whole work that is done."""


def silent(stage: str, share: float) -> None:
    """Report no progress at all."""
