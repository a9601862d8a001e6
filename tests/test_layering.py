"""Test that rooms import in one direction only, and import only packages of the base install.

`LAYERS` is the order of the rooms, which are packages directly under `recon`. A room imports only from itself and from
rooms before it; this also holds for imports in functions and for types. Each of the `WINGS` can be removed, because a
wing imports only rooms and itself, and no room imports a wing, except in the few functions of `UPWARD`
(benchmarks/house.py). `TOPS` import all rooms, and no room imports `TOPS`. `recon/__init__.pyi`, the public API, may
name all rooms, and no room imports the API. Every import names the module that defines a name, never the `__init__` of
a room or of the package.
"""

from __future__ import annotations

import ast
import re
import runpy
import sys
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "recon"

LAYERS = (
    "base",
    "geometry",
    "clip",
    "animal",
    "io",
    "fit",
    "check",
    "gait",
    "calibrate",
    "show",
    "api",
    "ik",
)
WINGS = ("robotics", "keypoint_net", "thesis")
TOPS = ("cli", "testing")
"""Rooms that may import all rooms and wings, and that no room imports: the command line, and simulations for tests."""

IMPORT_NAMES = {"opencv-python-headless": "cv2", "rerun-sdk": "rerun"}
"""Names of modules by distribution, for distributions whose modules have another name."""


@cache
def loaded_house() -> SimpleNamespace:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "benchmarks"))
        return SimpleNamespace(**runpy.run_path(str(ROOT / "benchmarks" / "house.py")))


@pytest.fixture(scope="module")
def house() -> SimpleNamespace:
    """Return the contents of `benchmarks/house.py`, which finds the imports between modules."""
    return loaded_house()


def parsed(source: str) -> ast.Module:
    """Return the syntax tree of a source text, which is cached."""
    return loaded_house().parsed(source)


def nodes_that_import(source: str) -> list[ast.stmt | ast.Call]:
    return loaded_house().nodes_that_import(source)


@cache
def base_imports() -> set[str]:
    """Return the top-level modules that every install has: the standard library and pyproject's dependencies."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.split(r"[^\w.-]", requirement)[0] for requirement in project["dependencies"]]
    return {"recon", *sys.stdlib_module_names} | {IMPORT_NAMES.get(n, n.replace("-", "_")) for n in names}


def module_name(path: Path) -> str:
    """Return the dotted name of a file: recon/io/formats.py -> recon.io.formats, with `__init__` kept."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def violations(
    module: str, source: str, base: set[str], is_upward: Callable[[str, str], bool] = lambda module, target: False
) -> list[str]:
    """Return a text for each import of a module that breaks a rule; `module` is a name of `module_name`."""
    tree = parsed(source)
    found = []
    layer = room(tuple(module.split(".")))
    if layer in ("__init__", "__main__"):
        wrong_way = []
    elif layer not in (*LAYERS, *WINGS, *TOPS):
        found.append(f"{module} is not named in LAYERS")
        wrong_way = []
    else:
        before = LAYERS[: LAYERS.index(layer)] if layer in LAYERS else LAYERS
        allowed = {*before, *(WINGS if layer in TOPS else ()), layer}
        wrong_way = [
            (line, t)
            for line, t in all_imports(module, source)
            if t[0] == "recon" and room(t) not in allowed and not is_upward(module, ".".join(t))
        ]
        found += [
            f"{module}:{line} imports {name} from {origin}, which does not define it"
            for line, origin, name in imported_names(module, source)
            if not defines(origin, name)
        ]
    found += [
        f"{module}:{line} imports {'.'.join(target)}, which does not come before it" for line, target in wrong_way
    ]
    found += [
        f"{module}:{line} imports {name} when it is imported itself, and the base install has no {name}"
        for line, name in imports_on_import(tree)
        if name not in base
    ]
    return found


def imported_names(module: str, source: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, module and name of every name that is imported from a module of the package."""
    for node in nodes_that_import(source):
        if isinstance(node, ast.ImportFrom):
            package = module.split(".")[: -node.level] if node.level else []
            origin = ".".join((*package, *(node.module.split(".") if node.module else ())))
            if origin.split(".")[0] == "recon" and (is_file(origin) or is_folder(origin)):
                yield from ((node.lineno, origin, alias.name) for alias in node.names)


def is_file(module: str) -> bool:
    return (ROOT / Path(*module.split("."))).with_suffix(".py").is_file()


def is_folder(module: str) -> bool:
    return (ROOT / Path(*module.split(".")) / "__init__.py").is_file()


def defines(origin: str, name: str) -> bool:
    """Return whether a module defines a name, or is a package with a module of that name."""
    return name in definitions(origin) or is_file(f"{origin}.{name}") or is_folder(f"{origin}.{name}")


@cache
def definitions(module: str) -> set[str]:
    """Return the functions, classes and variables at the top of a module, also below `if`, `try` or `with`."""
    path = ROOT / Path(*module.split("."))
    path = path / "__init__.py" if is_folder(module) else path.with_suffix(".py")
    names, nodes = set(), list[ast.AST](parsed(path.read_text(encoding="utf-8")).body)
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
            continue
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        nodes += ast.iter_child_nodes(node)
    return names


def room(parts: tuple[str, ...]) -> str:
    """Return the room of a dotted name, which is given as its parts."""
    return parts[1] if len(parts) > 1 else ""


def all_imports(module: str, source: str) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield line and dotted name, as parts, of every import, also inside functions and by `import_module`.

    `from recon import x` counts as recon.x if this is a module, and otherwise as the public API, recon. `__version__`
    and similar names do not belong to the API.
    """
    for node in nodes_that_import(source):
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
    return name in (*LAYERS, *WINGS, *TOPS) or (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file()


def called_name(call: ast.Call) -> str | None:
    function = call.func
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", None)


def imports_on_import(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and first part of the name of every absolute import that runs when the module is imported."""
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


def test_imports(house):
    files = {module_name(path): path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")}
    assert [
        wrong for name in sorted(files) for wrong in violations(name, files[name], base_imports(), house.is_upward)
    ] == []


def test_layers_contain_modules():
    assert (PACKAGE / "geometry" / "camera.py").is_file()
    assert {"numpy", "cv2", "rerun", "tomli_w", "json", "recon"} <= base_imports()


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("recon.geometry.camera", "from recon.fit.points import solve_points"),
        ("recon.geometry.camera", "import recon.fit"),
        ("recon.geometry.camera", "import numpy, recon.fit"),
        ("recon.geometry.camera", "from recon import fit"),
        ("recon.geometry.camera", "import recon.fit.points"),
        ("recon.geometry.camera", "import recon"),
        ("recon.geometry.camera", "from .. import fit"),
        ("recon.geometry.camera", "from ..fit.points import solve_points"),
        ("recon.io.formats", "from ..fit.motion import Motion"),
        ("recon.io.__init__", "from ..fit.motion import Motion"),
        ("recon.io.formats", "from .. import fit"),
        ("recon.fit.result", "def f():\n    from recon.show.page.pages import clip_page"),
        ("recon.fit.result", "import importlib\ndef f():\n    importlib.import_module('recon.show.view')"),
        ("recon.base.errors", "from recon.io.npz import write"),
        ("recon.show.report", "from recon.ik.clip import run_ik"),
        ("recon.robotics.dh", "from recon.thesis.solver import FrameSolver"),
        ("recon.robotics.dh", "from recon.cli.answers import Answer"),
        ("recon.api.clip", "def f():\n    from recon.cli.answers import say"),
    ],
)
def test_catches_an_import_against_the_order(module, source):
    (found,) = violations(module, source, base_imports())
    assert "does not come before it" in found


@pytest.mark.parametrize(
    "source",
    [
        "from recon.geometry import Camera",
        "from recon.geometry import camera, Camera",
        "def f():\n    from recon.clip import Pose3D",
        "if TYPE_CHECKING:\n    from recon.geometry import Camera",
        "from recon.animal.body import InputError",
    ],
)
def test_catches_an_import_from_where_a_name_is_not_defined(source):
    (found,) = violations("recon.fit.points", source, base_imports())
    assert "does not define it" in found


@pytest.mark.parametrize("module", ["recon.helpers", "recon.misc.__init__", "recon.misc.deep"])
def test_catches_a_module_outside_all_rooms(module):
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
@pytest.mark.parametrize("module", ["recon.__init__", "recon.show.view", "recon.ik.damped"])
def test_catches_an_optional_import_at_the_top(module, source):
    (found,) = violations(module, source, base_imports())
    assert "the base install has no" in found


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("recon.__init__", "from recon.cli.app import main\nfrom .fit.points import solve_points"),
        (
            "recon.fit.starts",
            "from recon.geometry.camera import Camera\nfrom recon import geometry\nfrom .points import solve_points",
        ),
        (
            "recon.io.__init__",
            "from recon.io import deeplabcut\nfrom . import deeplabcut\nfrom .deeplabcut import read_csv",
        ),
        (
            "recon.io.formats",
            "from recon.io.common import Pose3D\nfrom .deeplabcut import read_csv\nfrom ..base.errors import Problem",
        ),
        ("recon.cli.app", "from recon.base.version import __version__"),
        ("recon.show.view", "def f():\n    import torch"),
        ("recon.show.view", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import torch"),
        ("recon.show.view", "import json\nimport numpy as np\nimport rerun.blueprint as rrb\nimport cv2"),
    ],
)
def test_allowed_imports_pass(module, source):
    assert violations(module, source, base_imports()) == []


def test_layers_are_named_once():
    assert len({*LAYERS, *WINGS, *TOPS}) == len((*LAYERS, *WINGS, *TOPS))


def test_no_files_import_each_other(house):
    assert house.circles(house.imports()) == []


def test_finds_circular_imports(house):
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set(), "e": {"f"}, "f": {"e"}, "g": {"g2"}, "g2": {"a"}}
    assert house.circles(graph) == [["a", "b", "c"], ["e", "f"]]
    assert house.circles({"a": {"b"}, "b": set()}) == []


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import recon.io.npz", {"recon.io.npz"}),
        ("from recon.io import npz, read_keypoints", {"recon.io.npz", "recon.io"}),
        ("from . import npz", {"recon.io.npz"}),
        ("from .npz import write", {"recon.io.npz"}),
        ("from .. import fit", {"recon.fit"}),
        ("def f():\n    from recon.fit import solve_trajectory", {"recon.fit"}),
        ("if TYPE_CHECKING:\n    from recon.fit import View", {"recon.fit"}),
        ("import_module('recon.fit')\nimportlib.import_module(name)", {"recon.fit"}),
        ("from recon import __version__\nimport numpy.random\nfrom numpy import random", set()),
        ("from recon import fit_clip", {"recon"}),
    ],
)
def test_finds_what_a_module_imports(source, found, house):
    modules = dict.fromkeys(("recon", "recon.io", "recon.io.npz", "recon.io.trc", "recon.fit"))
    assert house.imported_by("recon.io.trc", source, False, modules) == found


def test_finds_a_function_that_replaces_another(house, tmp_path):
    def replaced(source: str) -> list[tuple[int, str]]:
        (tmp_path / "module.py").write_text(source)
        return house.shadowing_names(house.Syntax.read(tmp_path / "module.py"))

    assert replaced("def draw():\n    pass\n\n\ndef draw():\n    pass\n") == [(5, "draw")]
    overloads = "@overload\ndef draw(x: int): ...\n@overload\ndef draw(x: str): ...\ndef draw(x):\n    pass\n"
    assert replaced(overloads) == []
    assert replaced("def draw():\n    pass\n\n\ndef paint():\n    pass\n") == []
