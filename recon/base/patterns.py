"""Check regular expressions of unknown origin, so that only fast ones are used."""

from __future__ import annotations

from re import _constants as codes  # type: ignore[attr-defined]
from re import _parser as parser  # type: ignore[attr-defined]
from typing import Any, TypeAlias

_Part: TypeAlias = Any
"""Part of a parsed pattern, for which Python publishes no types."""
MAX_REPEATS = 3
"""Maximum number of repeats in a pattern.

The time of a search grows as the text's length to the power of this number.
"""
MAX_OPTIONS = 6
"""Maximum number of optional parts of a pattern, each of which doubles the time."""
MAX_LENGTH = 200
_REPEATS = (codes.MAX_REPEAT, codes.MIN_REPEAT, codes.POSSESSIVE_REPEAT)


def slow_part(pattern: str) -> str | None:
    """Describe the part of a pattern that could make a search practically endless; None if there is no such part.

    Raises
    ------
    re.error
        If the text is not a pattern.
    """
    if len(pattern) > MAX_LENGTH:
        return f"{len(pattern)} characters"
    repeats = _variable_repeats(parser.parse(pattern), inside=False)
    if repeats is None:
        return "a repeat or a choice within a repeat"
    options = repeats.count(1)
    if len(repeats) - options > MAX_REPEATS:
        return f"{len(repeats) - options} repeats"
    return f"{options} optional parts" if options > MAX_OPTIONS else None


def _variable_repeats(part: _Part, inside: bool) -> list[int] | None:
    """Return the maximum count of each repeat of variable length in part of a pattern.

    The result is None if a repeat contains a repeat of variable length or a choice. `inside` states whether the part
    itself is repeated.
    """
    operation = part[0] if isinstance(part, tuple) and len(part) == 2 else None
    if any(operation is repeat for repeat in _REPEATS):
        smallest, largest, repeated = part[1]
        is_variable = smallest != largest
        if inside and is_variable:
            return None
        counts = _variable_repeats(repeated, inside or largest > 1)
        return None if counts is None else [*counts, *([int(largest)] if is_variable else ())]
    if operation is codes.BRANCH and inside:
        return None
    if isinstance(part, tuple | list | parser.SubPattern):
        all_counts: list[int] = []
        for inner in part:
            counts = _variable_repeats(inner, inside)
            if counts is None:
                return None
            all_counts += counts
        return all_counts
    return []
