"""What every room uses: errors, whole-or-nothing files, documents, interrupts; here front doors and progress."""

from __future__ import annotations

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.base.arrays import Array, Bools, Brief, Index, Integers, finite, mean, mean_along, median
    from recon.base.errors import (
        InputError,
        Problem,
        collect_problems,
        printable,
        problems_of,
        raise_problems,
    )
    from recon.base.files import read_manifest, sole_writer, staged_file, staged_folder, staged_results, write_manifest
    from recon.base.interrupts import MESSAGE
    from recon.base.numbers import decimals, length_text
    from recon.base.package import DISTRIBUTION, install_command, pip_command, version
    from recon.base.records import load_record, save_record

Progress = Callable[[str, float], None]
"""Called with what is being done, and how much of all is done, 0 to 1."""


def silent(stage: str, share: float) -> None:
    """For work that nobody watches."""


def lazily(package: str, file: str) -> Callable[[str], Any]:
    """The `__getattr__` of a package, of that `__file__`, that names what others may use in imports under `if
    TYPE_CHECKING:` only: a room costs nothing until one of its names is used. `__all__` are those with `as`."""
    tree = ast.parse(Path(file).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    module_of = {alias.name: str(node.module) for node in imports for alias in node.names}

    public = sorted(alias.asname for node in imports for alias in node.names if alias.asname)

    def attribute(name: str) -> Any:
        if name == "__all__":
            return public
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(module_of[name]), name)

    return attribute


__getattr__ = lazily(__name__, __file__)
