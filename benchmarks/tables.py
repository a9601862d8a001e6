"""Write the measured tables of the docs from benchmarks/results/*.json.

    python benchmarks/tables.py [--check]

A page has a line `<!-- results: QUESTION/NAME -->` before each such table. The table's header and rows, the command,
the recordings and the date of the measurement are in results/QUESTION.json under "tables". If the entry of a table has
a "run", the rows come from the last output of that part. With --check, nothing is written, and the exit code is 1 if a
page differs from the results.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
MARKER = re.compile(r"<!-- results: (?P<question>\w+)/(?P<name>[\w-]+) -->\n\n(?P<table>(?:\|.*\n)+)")


@cache
def results_of(question: str) -> dict[str, Any]:
    """Return the content of results/QUESTION.json for one question."""
    return json.loads((RESULTS / f"{question}.json").read_text(encoding="utf-8"))


def table_text(question: str, name: str) -> str:
    """Return one measured table as Markdown."""
    results = results_of(question)
    entry = results["tables"][name]
    source = results["runs"][entry["run"]]["tables"][entry.get("number", 0)] if "run" in entry else entry
    header, rows = source["header"], source["rows"]
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(cells)} |\n".replace("|  |", "| |") for cells in lines)


def pages() -> Iterator[Path]:
    """Yield the pages that may have measured tables."""
    yield ROOT / "README.md"
    yield from sorted((ROOT / "docs").rglob("*.md"))


def with_tables(text: str) -> str:
    """Return the content `text` of a page, with its measured tables updated."""

    def replace(match: re.Match[str]) -> str:
        begin = match.group(0)[: match.start("table") - match.start()]
        return begin + table_text(match["question"], match["name"])

    return MARKER.sub(replace, text)


def differences() -> list[str]:
    """Return the pages whose tables differ from the results, and the tables that no page has."""
    problems, named = [], set()
    for page in pages():
        text = page.read_text(encoding="utf-8")
        named |= {(match["question"], match["name"]) for match in MARKER.finditer(text)}
        if text.count("<!-- results:") != len(MARKER.findall(text)):
            problems.append(f"{page.relative_to(ROOT)}: a line `<!-- results: ... -->` is not followed by a table")
        elif with_tables(text) != text:
            problems.append(f"{page.relative_to(ROOT)}: its tables differ from benchmarks/results")
    kept = {(path.stem, name) for path in RESULTS.glob("*.json") for name in results_of(path.stem).get("tables", {})}
    return problems + [f"benchmarks/results/{question}.json: no page has {name}" for question, name in kept - named]


def main() -> None:
    """Write the measured tables into the pages of the docs, or only check them with --check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a page does not agree")
    options = parser.parse_args()
    if options.check:
        problems = differences()
        print("\n".join(problems) or "The tables of the docs agree with benchmarks/results.")
        sys.exit(bool(problems))
    for page in pages():
        text = page.read_text(encoding="utf-8")
        made = with_tables(text)
        if made != text:
            page.write_text(made, encoding="utf-8")
            print(f"{page.relative_to(ROOT)}: tables updated")


if __name__ == "__main__":
    main()
