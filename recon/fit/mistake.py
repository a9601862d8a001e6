"""What may be wrong with a clip as it was given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

MistakeKind = Literal[
    "sides", "garbage", "normalised", "upside_down", "y_up", "smaller_video", "other_camera", "frame_rate"
]
CLEAR = float(np.log(1000.0))
"""A mistake is named where it makes what was seen so many times as likely, as a logarithm."""


@dataclass(frozen=True)
class Mistake:
    """view: its place among the clip's; None: of the clip. rows: first and stop, of the clip's frames; None: all of
    them. markers: their places, of "sides" those that are exchanged. ratio: how many times as likely the clip is with
    the mistake undone, as a logarithm; NaN where a file says so itself. found: what would be right: a camera's name, a
    frame rate in Hz, or how many times smaller the video was."""

    kind: MistakeKind
    ratio: float
    view: int | None = None
    rows: tuple[int, int] | None = None
    markers: tuple[int, ...] = ()
    found: str | float | None = None
    mended: bool = False
