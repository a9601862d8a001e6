"""Whether a clip's motion may be used, and how far off it is expected to be, as data."""

from __future__ import annotations

from dataclasses import astuple, dataclass
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

    @property
    def in_words(self) -> str:
        """Of metres, in metres, or in millimetres where the largest is below half a metre."""
        unit, error = ("mm", self.times(1000.0)) if self.high < 0.5 else ("m", self)
        expected, low, high = (f"{value:.2g}" if value < 10 else f"{value:.0f}" for value in astuple(error))
        return f"{expected} {unit} ({low} to {high})"

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

    @property
    def lines(self) -> tuple[str, ...]:
        """In words: the level and why, and what errors are expected, where that is known."""
        said = f"{self.level}: {self.reason}"
        if self.pose_m is None or self.pose_of_trunk is None or self.position_m is None:
            return (said,)
        share = f"{self.pose_of_trunk.expected:.0%} of the trunk's length"
        return said, f"pose off by {self.pose_m.in_words}, {share}; position by {self.position_m.in_words}"
