"""Whether a clip's motion may be used, and how far off it is expected to be, as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["do not use", "check", "use"]
LEVELS: tuple[Level, ...] = ("do not use", "check", "use")
"""In the order in which they are to be looked at."""


@dataclass(frozen=True)
class Expected:
    """An error before it is known: the middle of its distribution, and the ends of the interval that holds 90 %."""

    expected: float
    low: float
    high: float

    def times(self, factor: float) -> Expected:
        """The same in another unit."""
        return Expected(factor * self.expected, factor * self.low, factor * self.high)


@dataclass(frozen=True)
class Verdict:
    """On one clip. `recon.check.verdict` makes it; docs/verdict.md says what to do with it."""

    level: Level
    reason: str
    """One sentence."""
    pose_m: Expected | None = None
    """Mean distance of the joints from their true places once the mean of all joints is taken off (MPJPE); None
    without a pose."""
    pose_of_trunk: Expected | None = None
    """The same, relative to the length of the trunk."""
    position_m: Expected | None = None
    """Distance of the mean of all joints from its true place, mean over the frames."""
