"""Test that the functions in CONTRIBUTING.md's map exist, lead to each other, and have the stated number of lines."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SECTION = "## From a keypoint file to pose3d.csv"
BY_TABLE = {"read_csv": "FORMATS", "Reprojection._errors": "LeastSquares", "pose3d": "CLIP_OUTPUTS"}
"""Functions that no earlier function of the map names, and the name by which the text above the map explains this."""


def tables() -> tuple[str, list[list[tuple[str, str]]]]:
    """Return the text above the map, and the file and the name of each function of both tables."""
    section = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split(SECTION)[1].split("\n## ")[0]
    text, *rest = section.split("| --- | --- |")
    found = []
    for table in rest:
        rows = [line for line in table.splitlines() if line.startswith("| `")]
        functions = [
            (file, name)
            for row in rows
            for names, file in re.findall(r"((?:`[\w.]+`, )*`[\w.]+`) in `(recon/[\w/]+\.py)`", row.split(" | ")[0])
            for name in re.findall(r"`([\w.]+)`", names)
        ]
        assert len(functions) >= len(rows)
        found.append(functions)
    assert len(found) == 2
    return text, found


def node_of(file: str, name: str) -> ast.stmt:
    """Return the syntax tree of a function, or of a method as Class.method, in a file."""
    nodes: list[ast.stmt] = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
    node: ast.stmt | None = None
    for part in name.split("."):
        kinds = (ast.FunctionDef, ast.ClassDef)
        node = next((item for item in nodes if isinstance(item, kinds) and item.name == part), None)
        assert node is not None, f"{file} has no {name}"
        nodes = node.body
    assert node is not None
    return node


def lines_of(node: ast.stmt) -> int:
    assert node.end_lineno is not None
    return node.end_lineno - node.lineno + 1


def test_map_of_the_code_is_up_to_date() -> None:
    text, both = tables()
    sizes = [sum(lines_of(node_of(*function)) for function in functions) for functions in both]
    stated = re.search(r"have (\d+) lines", text)
    assert stated is not None
    assert abs(sizes[0] - int(stated[1])) < 80


def test_each_function_of_the_map_is_named_in_an_earlier_one() -> None:
    text, (way, _) = tables()
    named: set[str] = set()
    not_named = []
    for file, name in way:
        if name.split(".")[-1] not in named:
            not_named.append(name)
        nodes = [*ast.walk(node_of(file, name))]
        named |= {node.id for node in nodes if isinstance(node, ast.Name)}
        named |= {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    assert not_named == ["fit", *BY_TABLE]
    assert all(f"`{table}`" in text for table in BY_TABLE.values())
