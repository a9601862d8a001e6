"""How long work reports what it is doing."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with what is being done, and how much of all is done, 0 to 1."""


def silent(stage: str, share: float) -> None:
    """Report nothing: for work that nobody watches."""
