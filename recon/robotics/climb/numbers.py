"""Numbers of a recipe's file: what more or less than these would be can only be damage."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

LARGEST = 1e9
Number = Annotated[float, Field(strict=True, gt=-LARGEST, lt=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, lt=LARGEST, allow_inf_nan=False)]
FORBID = ConfigDict(extra="forbid", frozen=True)
"""Of tables: a name that is not known is a mistake."""
