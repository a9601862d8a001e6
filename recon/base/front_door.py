"""Names of a room that others may use, each imported when it is first used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any


def lazily(package: str, names_of: Mapping[str, Iterable[str]]) -> Callable[[str], Any]:
    """The `__getattr__` of a package: it takes the names from the package's modules, `names_of` by module.

    A room then costs nothing until one of its names is used: `recon --help` imports the commands of all rooms.
    """
    module_of = {name: module for module, names in names_of.items() for name in names}

    def attribute(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{module_of[name]}"), name)

    return attribute
