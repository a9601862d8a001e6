"""What writers of several formats share: what a format asks for, names it can hold, time without gaps."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from recon.errors import InputError, Problem

POINTS_MAX = 20_000_000


def required_fps(fps: float | None, title: str) -> float:
    """Raises InputError without a frame rate."""
    if fps is None:
        found = "nothing, and no frame rate in the input"
        raise InputError(Problem("--fps", "fps", found, f"frames per second, as in 90: {title} cannot do without"))
    return fps


def require_names(names: Sequence[str], forbidden: str, title: str, bytes_max: int | None = None) -> None:
    """Raises InputError for names with a character that matches the pattern `forbidden`, or that are too long."""
    problems = [
        Problem(title, "name", f"'{name}', with {found.group()!r} in it", "a name that the format can hold")
        for name in names
        if (found := re.search(forbidden, name))
    ]
    problems += [
        Problem(title, "name", f"'{name}', {len(name.encode())} bytes in UTF-8", f"at most {bytes_max}")
        for name in names
        if bytes_max is not None and len(name.encode()) > bytes_max
    ]
    if problems:
        raise InputError(problems[:10])


def without_gaps(frames: np.ndarray, values: np.ndarray, title: str) -> np.ndarray:
    """Values (T, ...) with rows of NaN for the frame numbers that are absent between the first and the last.

    Raises InputError if the gaps would make the file absurdly long.
    """
    span = int(frames[-1] - frames[0]) + 1
    require_span(span, values.shape[1], title)
    regular = np.full((span, *values.shape[1:]), np.nan)
    regular[frames - frames[0]] = values
    return regular


def require_span(frames: int, points: int, title: str) -> None:
    """Raises InputError where frames times points would fill the memory."""
    if frames * points > POINTS_MAX:
        found = f"numbers that span {frames} frames"
        expected = f"at most {POINTS_MAX // points} of {points} points: the format has a row for each"
        raise InputError(Problem(title, "frames", found, expected))
