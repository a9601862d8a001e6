"""Change the solver's constants (`recon.fit.constants`) temporarily, to measure their effect."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from recon.fit import constants
from recon.fit.clip_problem import TrajectoryOptions


@contextmanager
def holding(**values: Any) -> Iterator[None]:
    """Change constants of the solver, such as ROBUST_C, within a `with` block."""
    before = {name: getattr(constants, name) for name in values}
    try:
        for name, value in values.items():
            setattr(constants, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(constants, name, value)


@contextmanager
def options_with(given: Mapping[str, Any]) -> Iterator[TrajectoryOptions]:
    """Yield fit options with the given values; names in capitals are constants, changed within the `with` block."""
    with holding(**{name: value for name, value in given.items() if name.isupper()}):
        yield TrajectoryOptions(**{name: value for name, value in given.items() if not name.isupper()})
