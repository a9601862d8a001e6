"""Define options that several commands share, without the settings of a fit, whose import takes longer."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator

from recon.base.settings import Number, Option

INDIVIDUAL = "Name of the animal in a file of several animals, such as animal1."
RENAME = Option(
    "New names of keypoints: a CSV file of old and new names, or a built-in map, such as superanimal-quadruped."
)
StrideTimes = Annotated[
    tuple[Number, Number], BeforeValidator(lambda value: value.split(":") if isinstance(value, str) else value)
]
"""(start, end) in seconds since frame 0, or text such as "0.31:0.62"."""
FIRST_FRAME = Option("Number that the video's first frame has in the keypoint file, if the video was cut.")
ANYWAY = Option('Also use clips whose verdict is "do not use".')
STRIDE = Option(
    "A stride, in seconds since frame 0, such as 0.31:0.62; its start moves to the nearest frame. "
    "(default: a stride of the clip)",
    "START:END in seconds, such as 0.31:0.62",
    metavar="START:END",
)
