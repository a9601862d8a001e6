"""Import modules when a test first uses them, because each process of the tests collects every test file."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import pytest


class Later:
    """Stand-in for a module that is imported when one of its names is first used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("_"):  # pytest looks up private attributes of every object
            raise AttributeError(attribute)
        return getattr(import_module(self._name), attribute)


torch = Later("torch")
needs_torch = pytest.mark.skipif(find_spec("torch") is None, reason="without the package torch")
