"""Measure the size of the package: lines of code, classes, modules loaded by a fit, options, import cycles and times.

python benchmarks/house.py [--rooms] [--quick] [--check] [--where]

Code lines exclude blank lines, comments and docstrings. A public class is at the top level of a module and has a name
without a leading underscore. An import cycle is a group of files that import each other, at the top or in functions.
--rooms adds a table of lines and classes for each room (a package directly under `recon`). --quick leaves out the
times.

--check prints how many names, imports and types of each room break a rule (`RULES`), and fails if there are more than
allowed. --where also prints each violation. `make lint` runs the check.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parent / "parts"))

import startup
from markdown_table import print_table

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "recon"
SAMPLES = ROOT / "data" / "samples"
RUNS = 5
"""Number of pairs of processes whose times are compared for each ratio."""
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
LOADED = """
import json, sys, recon
from pathlib import Path
samples = Path(sys.argv[1])
settings = recon.FitSettings(keypoints=samples / "whole.csv", camera=samples / "camera.toml", fps=60)
recon.fit_clip(settings)
print(json.dumps([m.__file__ for name, m in sys.modules.items() if name.split(".")[0] == "recon" and m.__file__]))
"""


def sources() -> dict[str, ast.Module]:
    """Return the syntax tree of every file of the package by module name (recon.io for recon/io/__init__.py)."""
    return {module_of(path): ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def code_lines(path: Path) -> int:
    """Count the lines of a file that are not blank, a comment or part of a docstring."""
    text = path.read_text(encoding="utf-8")
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef):
            strings = node.body  # a string below a field or a constant is its docstring
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            strings = node.body[:1]
        else:
            continue
        for one in strings:
            if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant) and isinstance(one.value.value, str):
                docstrings.update(range(one.lineno, (one.end_lineno or one.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docstrings)


def public_classes(tree: ast.Module) -> list[str]:
    return [node.name for node in tree.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]


_WORDS = """
again alike also another apart aside away before behind beside both each even far found given held here how its more
most much now of off once one only other others own said so some still such than that their then there these they
this those thus told too us very what when where which while who whose why with within yet
"""
FUNCTION_WORDS = frozenset(_WORDS.split())
"""Words that do not describe a value, and are therefore not allowed as names."""
PUBLISHED = {
    "recon/animal/prior_fit.py": {"apart"},  # --apart of `recon prior fit`
    "recon/api/model_settings.py": {"apart"},  # the setting of the option --apart
    "recon/base/errors.py": {"found"},  # the field of a problem, in "found ..., expected ..."
    "recon/gait/clip.py": {"given"},  # the stride of a `ClipAnalysis`
    "recon/robotics/climb/plan.py": {"most"},  # a key in recipe files
    "recon/robotics/retarget_clip.py": {"said"},  # a field of robot.npz
}
"""Function words that a file may use as names, because users write them as options or fields."""
UPWARD = {
    "recon.clip": {"recon.io.columns"},  # Keypoints.from_dataframe and from_xarray read columns
    "recon.io.formats": {"recon.io"},  # the table of formats lists all readers
    # Motion.load reads solutions of the frame method, and Motion.plot draws
    "recon.fit.motion_forms": {"recon.thesis.solution", "recon.show.plots.side_view"},
    "recon.thesis.solution": {"recon.thesis.report"},  # the frame method has its own sections of the report
    "recon.api.clip": {"recon.thesis.clip"},  # fit_clip also fits by the frame method
    "recon.api.clip_inputs": {"recon.thesis.clip"},  # the frame method reads its own chain
}
"""Modules of a higher layer that each importing module may import inside a function."""


class Syntax(NamedTuple):
    """Nodes of a file's syntax tree, with the nodes inside functions and the top-level statements listed separately."""

    nodes: list[ast.AST]
    local: list[ast.AST]
    """Nodes inside functions, without the functions and classes themselves."""
    top: list[ast.stmt]
    """Statements at the top level of the module."""

    @classmethod
    def read(cls, path: Path) -> Syntax:
        """Parse a file, and walk its tree once."""
        tree = ast.parse(path.read_text(encoding="utf-8"))
        nodes, local, waiting = list[ast.AST](), list[ast.AST](), [(node, False) for node in tree.body]
        while waiting:
            node, is_local = waiting.pop()
            nodes.append(node)
            if is_local and not isinstance(node, FUNCTIONS | ast.ClassDef):
                local.append(node)
            is_local = is_local or isinstance(node, FUNCTIONS | ast.Lambda)
            waiting += [(child, is_local) for child in ast.iter_child_nodes(node)]
        return cls(nodes, local, tree.body)


FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef


def function_word_names(syntax: Syntax) -> list[tuple[int, str]]:
    """Return the line and the name of each variable, function or class that is named by a function word."""
    return [(line, name) for node in syntax.nodes for line, name in bound(node) if name in FUNCTION_WORDS]


def shadowing_names(syntax: Syntax) -> list[tuple[int, str]]:
    """Return the lines and names of local variables that hide an import, a function or a class of the module.

    A module that is imported for types only may be imported again in a function, or be returned by the function that
    requires its package (`torch = require_torch()`). A function or class that replaces an earlier one of the same name
    also counts, unless a decorator joins the two.
    """
    imports = [node for node in syntax.nodes if isinstance(node, ast.Import | ast.ImportFrom)]
    aliases = [alias for node in imports for alias in node.names]
    modules = {alias.asname or alias.name for node in imports if isinstance(node, ast.Import) for alias in node.names}
    top = {(alias.asname or alias.name).split(".")[0] for alias in aliases}
    top |= {node.name for node in syntax.top if isinstance(node, FUNCTIONS | ast.ClassDef)}
    names = {pair for node in syntax.local if not isinstance(node, ast.alias) for pair in bound(node) if pair[1] in top}
    for node in syntax.local:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            bindings = [pair for target in node.targets for part in ast.walk(target) for pair in bound(part)]
            names -= {pair for pair in bindings if pair[1] in modules and _requires(node.value, pair[1])}
    return [*names, *_defined_again(syntax)]


def _defined_again(syntax: Syntax) -> Iterator[tuple[int, str]]:
    definitions = [node for node in syntax.top if isinstance(node, FUNCTIONS | ast.ClassDef)]
    for number, node in enumerate(definitions):
        earlier = [other for other in definitions[:number] if other.name == node.name]
        if not node.decorator_list and any(not other.decorator_list for other in earlier):
            yield node.lineno, node.name


def _requires(call: ast.Call, module: str) -> bool:
    return _called(call.func) == f"require_{module}"


def bound(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield the line and name that a node of a syntax tree binds: a variable, parameter, function, class or alias."""
    if isinstance(node, ast.Name):
        if isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
    elif isinstance(node, ast.arg):
        yield node.lineno, node.arg
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield node.lineno, node.name
    elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar):
        if node.name is not None:
            yield node.lineno, node.name
    elif isinstance(node, ast.alias) and node.asname:
        yield node.lineno, node.asname


def string_imports(syntax: Syntax) -> list[tuple[int, str]]:
    """Return the lines and names of calls that import a module, or take an attribute, by a name built in the code."""
    calls = []
    for node in syntax.nodes:
        if not isinstance(node, ast.Call):
            continue
        called = _called(node.func)
        built = called == "getattr" and isinstance(node.args[1], ast.JoinedStr | ast.BinOp)
        if called in ("import_module", "__import__") or built:
            calls.append((node.lineno, called))
    return calls


def any_in_signatures(syntax: Syntax) -> list[tuple[int, str]]:
    """Return the lines and functions with parameters or results that are typed as `Any`.

    `Any` counts alone, in a union, or as the element of a sequence. Tables of plain types, `dict[str, Any]`, and
    passed-on keywords, `**keywords: Any`, do not count.
    """
    signatures = []
    for node in syntax.nodes:
        if isinstance(node, FUNCTIONS):
            parameters = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs, node.args.vararg]
            annotations = [*(item.annotation for item in parameters if item is not None), node.returns]
            signatures += [(note.lineno, node.name) for note in annotations if note is not None and _has_any(note)]
    return signatures


def _has_any(annotation: ast.expr) -> bool:
    if isinstance(annotation, ast.BinOp):
        return _has_any(annotation.left) or _has_any(annotation.right)
    if isinstance(annotation, ast.Subscript) and _called(annotation.value) in SEQUENCES:
        return _has_any(annotation.slice)
    return isinstance(annotation, ast.Name) and annotation.id == "Any"


SEQUENCES = ("Iterable", "Iterator", "Sequence", "list", "set")

RULES = (
    ("function words as names", function_word_names, 0),
    ("names that shadow", shadowing_names, 0),
    ("imports by strings", string_imports, 0),
    ("`Any` in signatures", any_in_signatures, 10),
)
"""Title of each rule, the function that finds its violations, and the number allowed in the whole package."""


def check(where: bool) -> bool:
    """Print how often every room breaks each of `RULES`, and return whether the numbers are allowed."""
    counts: Counter[tuple[str, str]] = Counter()
    for path in sorted(PACKAGE.rglob("*.py")):
        parts, syntax = path.relative_to(PACKAGE).parts, Syntax.read(path)
        for title, occurrences, _ in RULES:
            published = PUBLISHED.get(path.relative_to(ROOT).as_posix(), ())
            lines = sorted(pair for pair in occurrences(syntax) if pair[1] not in published)
            counts[parts[0].removesuffix(".py"), title] += len(lines)
            for line, name in lines if where else ():
                print(f"{path.relative_to(ROOT)}:{line}: {title}: {name}")
    rooms = sorted({room for (room, _), count in counts.items() if count})
    titles = [title for title, _, _ in RULES]
    totals = [sum(counts[room, title] for room in rooms) for title in titles]
    table = [[room, *(counts[room, title] for title in titles)] for room in rooms]
    print_table(["room", *titles], [*table, ["all", *totals], ["at most", *(most for *_, most in RULES)]])
    broken = [title for total, (title, _, most) in zip(totals, RULES, strict=True) if total > most]
    for text in broken:
        print(f"not allowed: {text} (--where lists them)")
    return not broken


@cache
def parsed(source: str) -> ast.Module:
    """Return the syntax tree of Python source code, from a cache if the same code was parsed before."""
    return ast.parse(source)


@cache
def nodes_that_import(source: str) -> list[ast.stmt | ast.Call]:
    """Return the import statements in source code, and all calls if the code may import a module by its name.

    Imports in functions are included. Expressions make up most of a syntax tree, and are walked only for calls.
    """
    tree = parsed(source)
    if "import_module" in source or "__import__" in source:
        return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom | ast.Call)]
    imports, nodes = list[ast.stmt | ast.Call](), list[ast.AST](tree.body)
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            imports.append(node)
        for branch in ("body", "orelse", "handlers", "finalbody", "cases"):
            children = getattr(node, branch, ())
            nodes += children if isinstance(children, list) else ()
    return imports


def imported_by(module: str, source: str, is_package: bool, modules: Mapping[str, object]) -> set[str]:
    """Return the package's modules that a module imports at its top, inside functions, or by `import_module`."""
    found = set()
    for node in nodes_that_import(source):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts = module.split(".") if is_package else module.split(".")[:-1]
            origin = ".".join([*parts[: len(parts) - node.level + 1]] if node.level else [])
            origin = ".".join(part for part in (origin, node.module) if part)
            # An imported name is a submodule, or else an attribute of the module. `__version__` is no part of the API.
            called = [alias.name for alias in node.names if not alias.name.startswith("__")]
            names = [f"{origin}.{name}" if f"{origin}.{name}" in modules else origin for name in called]
        elif isinstance(node, ast.Call) and node.args and _called(node.func) == "import_module":
            names = [node.args[0].value] if isinstance(node.args[0], ast.Constant) else []
        else:
            continue
        found.update(name for name in names if name in modules)
    return found - {module}


def _called(function: ast.expr) -> str:
    """Return the name of a called function, without the object on which it is called."""
    return (
        function.id if isinstance(function, ast.Name) else function.attr if isinstance(function, ast.Attribute) else ""
    )


def imports() -> dict[str, set[str]]:
    """Return the modules that each module of the package imports from the package, except those of `UPWARD`."""
    texts = {module_of(path): path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
    graph = {name: imported_by(name, text, is_package(name), texts) for name, text in texts.items()}
    return {name: {target for target in targets if not is_upward(name, target)} for name, targets in graph.items()}


def is_upward(module: str, target: str) -> bool:
    """Return whether `UPWARD` allows a module to import the module `target` inside a function."""
    return any(f"{target}.".startswith(f"{name}.") for name in UPWARD.get(module, ()))


def is_package(module: str) -> bool:
    return (ROOT / Path(*module.split(".")) / "__init__.py").is_file()


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Return groups of modules that import each other, found as strongly connected components (Tarjan)."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    path: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        number[name] = lowest[name] = len(number)
        path.append(name)
        for other in sorted(graph.get(name, ())):
            if other not in number:
                visit(other)
            if other in path:
                lowest[name] = min(lowest[name], lowest[other])
        if lowest[name] == number[name]:
            group = path[path.index(name) :]
            del path[path.index(name) :]
            if len(group) > 1:
                found.append(sorted(group))

    for name in sorted(graph):
        if name not in number:
            visit(name)
    return found


def output_of(*arguments: str) -> str:
    environment = {**os.environ, "COLUMNS": "100", "TERM": "dumb"}
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=True, cwd=ROOT, env=environment
    ).stdout


def loaded_by_a_fit() -> list[Path]:
    """List the package's files that a Python script loads to fit the sample."""
    return [Path(file) for file in json.loads(output_of("-c", LOADED, str(SAMPLES)).splitlines()[-1])]


def fit_help() -> tuple[int, int]:
    """Return the number of options in `recon fit --help`, and its number of lines at 100 columns."""
    text = output_of("-m", "recon", "fit", "--help")
    options = re.findall(r"^\W*(?:\*\s+)?(--[a-z][\w-]*)", text, re.MULTILINE)
    return len({*options} - {"--help"}), len(text.strip().splitlines())


def lines_of(files: Sequence[Path]) -> int:
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)


def rows(quick: bool) -> Iterator[list[object]]:
    files, trees = sorted(PACKAGE.rglob("*.py")), sources()
    yield ["code lines", sum(map(code_lines, files)), "25,500"]
    yield ["all lines", lines_of(files), ""]
    yield ["entries at the top of `recon/`", sum(p.name != "__pycache__" for p in PACKAGE.iterdir()), "16"]
    names = Counter(name for tree in trees.values() for name in public_classes(tree))
    yield ["public classes", names.total(), "190"]
    shared = sorted(name for name, count in names.items() if count > 1)
    yield ["class names that occur more than once", f"{len(shared)}{': ' if shared else ''}{', '.join(shared)}", "0"]
    loaded = loaded_by_a_fit()
    yield ["modules that a fit of the sample from Python loads", len(loaded), "45"]
    yield ["lines in these modules", lines_of(loaded), "9,500"]
    options, lines = fit_help()
    yield ["options in `recon fit --help`", options, "24"]
    yield ["lines of `recon fit --help`", lines, ""]
    groups = circles(imports())
    yield ["import cycles of files", f"{len(groups)}{': ' if groups else ''}{'; '.join(map(', '.join, groups))}", "0"]
    if not quick:
        with tempfile.TemporaryDirectory() as folder:
            for name, arguments, beside, limit in startup.COMMANDS:
                *_, ratio, _ = startup.compared(arguments, beside, RUNS, folder)
                yield [f"time of `{name}` relative to `{beside}`", f"{ratio:.1f}", limit]


def print_rooms() -> None:
    lines: Counter[str] = Counter()
    classes: Counter[str] = Counter()
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).parts
        room = "/".join(parts[: min(2, len(parts) - 1)]) or parts[0]
        lines[room] += code_lines(path)
        classes[room] += len(public_classes(ast.parse(path.read_text(encoding="utf-8"))))
    print_table(
        ["folder", "code lines", "public classes"], [[room, n, classes[room]] for room, n in lines.most_common()]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", action="store_true")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--where", action="store_true")
    options = parser.parse_args()
    if options.check or options.where:
        raise SystemExit(not check(options.where))
    print_table(["what", "now", "at most"], list(rows(options.quick)))
    if options.rooms:
        print_rooms()


if __name__ == "__main__":
    main()
