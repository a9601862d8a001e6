"""Options that several commands behind a fit share."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator

from recon.base.settings import Number, Option


def _start_and_end(given: Any) -> Any:
    return tuple(given.split(":")) if isinstance(given, str) else given


StrideTimes = Annotated[tuple[Number, Number], BeforeValidator(_start_and_end)]
"""(start, end) in seconds since frame 0, or the text "0.31:0.62"."""
FIRST_FRAME = Option("Number that the video's first frame has in the keypoint file, if it was cut.")
ANYWAY = Option('Also of a clip whose verdict is "do not use".')
STRIDE = Option(
    "A stride, in seconds since frame 0, as in 0.31:0.62. (default: one that is found)",
    "START:END in seconds, as in 0.31:0.62",
    metavar="START:END",
)
