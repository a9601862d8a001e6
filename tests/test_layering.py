"""Modules import in one direction only, and nothing that the base install lacks.

`LAYERS` is the order: a module or package directly under `recon` imports from those named before it and from its own
package, wherever the import stands. `recon/__init__.py` is the public API: it may import all of them, and none imports
it.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "recon"

LAYERS = (
    "arrays",
    "interrupts",
    "package",
    "errors",
    "progress",
    "documents",
    "manifest",
    "files",
    "recording",
    "video",
    "rotations",
    "frames",
    "regions",
    "banded",
    "keypoints",
    "io",
    "camera",
    "clip",
    "calibration",
    "camera_track",
    "camera_motion",
    "intrinsics",
    "kinematics",
    "body",
    "capsules",
    "naming",
    "chain",
    "skeleton_file",
    "detector",
    "prior",
    "synthetic",
    "straight_runs",
    "solve",
    "mistakes",
    "published",
    "motion",
    "report_fields",
    "results",
    "overlay",
    "analysis",
    "ik",
    "robot",
    "plots",
    "report",
    "export",
    "page",
    "view",
    "settings",
    "net",
    "app",
    "cli",
    "__main__",
)

IMPORT_NAMES = {"opencv-python-headless": "cv2", "rerun-sdk": "rerun"}
"""Distributions whose modules have another name."""


def base_imports() -> set[str]:
    """Top-level modules that every install has: the standard library's and those of pyproject's dependencies."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.split(r"[^\w.-]", requirement)[0] for requirement in project["dependencies"]]
    return {"recon", *sys.stdlib_module_names} | {IMPORT_NAMES.get(n, n.replace("-", "_")) for n in names}


def module_name(path: Path) -> str:
    """recon/io/pose3d.py -> recon.io.pose3d; recon/io/__init__.py -> recon.io.__init__."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def violations(module: str, source: str, base: set[str]) -> list[str]:
    """What is wrong with the imports of one module, in words; `module` is a name as `module_name` gives it."""
    tree = ast.parse(source)
    found = []
    layer = module.split(".")[1]
    if layer == "__init__":
        wrong_way = []
    elif layer not in LAYERS:
        found.append(f"{module} is not named in LAYERS")
        wrong_way = []
    else:
        allowed = {*LAYERS[: LAYERS.index(layer)], layer}
        wrong_way = [(line, t) for line, t in all_imports(module, tree) if t[0] == "recon" and not allowed & {*t[1:2]}]
    found += [
        f"{module}:{line} imports {'.'.join(target)}, which does not come before it" for line, target in wrong_way
    ]
    found += [
        f"{module}:{line} imports {name} when it is imported itself, and the base install has no {name}"
        for line, name in imports_on_import(tree)
        if name not in base
    ]
    return found


def all_imports(module: str, tree: ast.Module) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Line and dotted name (as parts) of every import, those inside functions and by `import_module` included.

    `from recon import x` is recon.x where that is a module, and otherwise the public API, recon; `__version__` and its
    like are no API.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, tuple(alias.name.split("."))) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = module.split(".")[: -node.level] if node.level else []
            origin = (*package, *(node.module.split(".") if node.module else ()))
            if origin == ("recon",):
                names = [alias.name for alias in node.names if not alias.name.startswith("__")]
                yield from ((node.lineno, ("recon", name) if is_module(name) else origin) for name in names)
            else:
                yield node.lineno, origin
        elif isinstance(node, ast.Call) and called_name(node) in ("import_module", "__import__"):
            for argument in node.args[:1]:
                if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                    yield node.lineno, tuple(argument.value.split("."))


def is_module(name: str) -> bool:
    return name in LAYERS or (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file()


def called_name(call: ast.Call) -> str | None:
    function = call.func
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", None)


def imports_on_import(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and first part of the name of every absolute import that runs when the module is imported."""
    if isinstance(node, ast.Import):
        yield from ((node.lineno, alias.name.split(".")[0]) for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
        yield node.lineno, node.module.split(".")[0]
    elif isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
        for child in node.orelse:
            yield from imports_on_import(child)
    elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
        for child in ast.iter_child_nodes(node):
            yield from imports_on_import(child)


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=module_name)
def test_imports(path):
    assert violations(module_name(path), path.read_text(encoding="utf-8"), base_imports()) == []


def test_there_is_something_to_check():
    assert (PACKAGE / "camera.py").is_file()
    assert {"numpy", "cv2", "rerun", "tomli_w", "json", "recon"} <= base_imports()


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("recon.camera", "from recon.solve import solve"),
        ("recon.camera", "import recon.solve"),
        ("recon.camera", "import numpy, recon.solve"),
        ("recon.camera", "from recon import solve"),
        ("recon.camera", "from recon import fit"),
        ("recon.camera", "import recon"),
        ("recon.camera", "from . import solve"),
        ("recon.camera", "from .solve import solve"),
        ("recon.io.pose3d", "from ..camera import Camera"),
        ("recon.io.__init__", "from ..camera import Camera"),
        ("recon.io.pose3d", "from .. import camera"),
        ("recon.solve", "def f():\n    from recon.motion import Motion"),
        ("recon.solve", "import importlib\ndef f():\n    importlib.import_module('recon.view')"),
        ("recon.errors", "from recon.files import write"),
    ],
)
def test_catches_an_import_against_the_order(module, source):
    (found,) = violations(module, source, base_imports())
    assert "does not come before it" in found


@pytest.mark.parametrize("module", ["recon.helpers", "recon.misc.__init__", "recon.misc.deep"])
def test_catches_a_module_without_a_place(module):
    assert violations(module, "", base_imports()) == [f"{module} is not named in LAYERS"]


@pytest.mark.parametrize(
    "source",
    [
        "import torch",
        "import xarray as xr",
        "from dask import delayed",
        "try:\n    import torch\nexcept ImportError:\n    torch = None",
        "if True:\n    import torch",
        "if not TYPE_CHECKING:\n    import torch",
        "if TYPE_CHECKING:\n    pass\nelse:\n    import torch",
        "class A:\n    import torch",
        "with b:\n    import torch",
    ],
)
@pytest.mark.parametrize("module", ["recon.__init__", "recon.view", "recon.ik.damped"])
def test_catches_an_optional_import_at_the_top(module, source):
    (found,) = violations(module, source, base_imports())
    assert "the base install has no" in found


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("recon.__init__", "from recon.cli import main\nfrom .solve import solve"),
        (
            "recon.solve",
            "from recon.straight_runs import place_on_rays\nfrom recon import camera\nfrom .errors import InputError",
        ),
        (
            "recon.io.__init__",
            "from recon.io import deeplabcut\nfrom . import deeplabcut\nfrom .deeplabcut import read",
        ),
        (
            "recon.io.pose3d",
            "from recon.io import describe\nfrom .deeplabcut import read\nfrom ..errors import Problem",
        ),
        ("recon.cli", "from recon import __version__"),
        ("recon.view", "def f():\n    import torch"),
        ("recon.view", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import torch"),
        ("recon.view", "import json\nimport numpy as np\nimport rerun.blueprint as rrb\nimport cv2"),
    ],
)
def test_lets_good_imports_pass(module, source):
    assert violations(module, source, base_imports()) == []


def test_layers_are_named_once():
    assert len(set(LAYERS)) == len(LAYERS)
