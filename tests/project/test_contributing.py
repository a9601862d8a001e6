"""Test that the functions in CONTRIBUTING.md's map exist, and have about as many lines as stated."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SECTION = "## From a keypoint file to pose3d.csv"


def lines_of(file: str, name: str) -> int:
    """Return the number of lines of a function, or of a method as Class.method, in a file."""
    nodes: list[ast.stmt] = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
    node: ast.stmt | None = None
    for part in name.split("."):
        kinds = (ast.FunctionDef, ast.ClassDef)
        node = next((item for item in nodes if isinstance(item, kinds) and item.name == part), None)
        assert node is not None, f"{file} has no {name}"
        nodes = node.body
    assert node is not None
    assert node.end_lineno is not None
    return node.end_lineno - node.lineno + 1


def test_map_of_the_code_is_up_to_date() -> None:
    section = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split(SECTION)[1].split("\n## ")[0]
    text, way, others = section.split("| --- | --- |")
    sizes = []
    for table in (way, others):
        rows = [line for line in table.splitlines() if line.startswith("| `")]
        functions = [
            (file, name)
            for row in rows
            for names, file in re.findall(r"((?:`[\w.]+`, )*`[\w.]+`) in `(recon/[\w/]+\.py)`", row.split(" | ")[0])
            for name in re.findall(r"`([\w.]+)`", names)
        ]
        assert len(functions) >= len(rows)
        sizes.append(sum(lines_of(*function) for function in functions))
    stated = re.search(r"have (\d+) lines", text)
    assert stated is not None
    assert abs(sizes[0] - int(stated[1])) < 80
