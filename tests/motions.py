"""Change motions for a test."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from recon.fit.motion import Motion


def with_first(motion: Motion, **changes: Any) -> Motion:
    """Return a motion with fields of its first source replaced."""
    first, *others = motion.sources
    return replace(motion, sources=(replace(first, **changes), *others))
