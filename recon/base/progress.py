"""Report the progress of long work."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Function called with the name of the present step, and the fraction of all the work that is done, 0 to 1."""


def silent(stage: str, share: float) -> None:
    """Report no progress at all."""
