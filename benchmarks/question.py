"""Run the parts of a benchmark that answer one question, and keep the measurements as JSON."""

from __future__ import annotations

import argparse
import datetime
import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PARTS = ROOT / "benchmarks" / "parts"
RESULTS = ROOT / "benchmarks" / "results"
TIMES = re.compile(r"(^|[ ,])(s|ms|µs|seconds|wall|time)($|[ ,])")
"""Pattern that matches the headings of columns with measured times."""
TIMED = ("speed", "peers")
"""Questions whose results keep the columns with measured times."""


@dataclass(frozen=True)
class Part:
    """A measurement: a script of `parts/`, and the arguments with which it is run."""

    script: str
    arguments: Sequence[str] = ()
    quick: Sequence[str] | None = None
    """Arguments with which the script takes about a minute; None if it is left out of --quick."""
    data: str = "simulated"
    """Recordings that the script needs: a folder of $RECON_SHARED_DATA, or "simulated"."""


def main(description: str, question: str, parts: Mapping[str, Part]) -> None:
    """Run the parts that the command line selects, print their tables, and write results/QUESTION.json."""
    names = "\n".join(
        f"  {name}: {part.data}; {part.script} {' '.join(part.arguments)}" for name, part in parts.items()
    )
    parser = argparse.ArgumentParser(
        description=f"{description}\nParts:\n{names}", formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", nargs="+", choices=[*parts], default=[*parts], metavar="NAME", help="only these parts"
    )
    parser.add_argument(
        "--quick", action="store_true", help="run parts and sizes that take about a minute, and keep nothing"
    )
    options = parser.parse_args()
    failures = []
    for name in options.only:
        part = parts[name]
        if options.quick and part.quick is None:
            continue
        if part.data != "simulated" and not recordings(part.data).is_dir():
            print(f"{name}: no recordings in {recordings(part.data)}", flush=True)
            continue
        arguments = [*(part.quick if options.quick and part.quick is not None else part.arguments)]
        print(f"\n## {name}\n", flush=True)
        output = run_part(part.script, arguments)
        if output is None:
            failures.append(name)
        elif not options.quick:
            keep(question, name, part, arguments, output)
    if failures:
        sys.exit(f"failed: {', '.join(failures)}")


def recordings(kind: str) -> Path:
    """Return the folder of one kind of recordings."""
    return Path(os.environ.get("RECON_SHARED_DATA", ROOT.parent / "shared" / "data")) / kind


def run_part(script: str, arguments: Sequence[str]) -> str | None:
    """Run a script, print its output as it appears, and return the output, or None if the script failed."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, str(PARTS / script), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, encoding="utf-8") as process:
        assert process.stdout is not None
        lines = []
        for line in process.stdout:
            print(line, end="", flush=True)
            lines.append(line)
    return None if process.returncode else "".join(lines)


def keep(question: str, name: str, part: Part, arguments: Sequence[str], output: str) -> None:
    """Store in the results of a question the tables and sentences that a part printed."""
    path = RESULTS / f"{question}.json"
    results = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    tables, sentences = read_markdown(output)
    if question not in TIMED:  # other questions keep only what does not depend on the machine
        tables = [without_times(table) for table in tables]
    results.setdefault("runs", {})[name] = {
        "measured": datetime.date.today().isoformat(),
        "command": " ".join(["python", f"benchmarks/{question}.py", "--only", name]),
        "script": " ".join([f"benchmarks/parts/{part.script}", *arguments]),
        "data": part.data,
        "tables": tables,
        "sentences": sentences,
    }
    path.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def without_times(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table without the columns whose headings match `TIMES`."""
    columns = [number for number, name in enumerate(table["header"]) if not TIMES.search(name)]
    return {
        "header": [table["header"][number] for number in columns],
        "rows": [[row[number] for number in columns if number < len(row)] for row in table["rows"]],
    }


def read_markdown(text: str) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the tables in a Markdown string, each with a header and rows, and the lines outside tables."""
    tables: list[dict[str, Any]] = []
    sentences: list[str] = []
    is_in_table = False
    for line in text.splitlines():
        if not line.startswith("|"):
            is_in_table = False
            if line.strip():
                sentences.append(line.strip())
            continue
        cells = cells_of(line)
        if not is_in_table:
            tables.append({"header": cells, "rows": []})
            is_in_table = True
        elif not all(set(cell) <= set("-: ") for cell in cells):
            tables[-1]["rows"].append(cells)
    return tables, sentences


def cells_of(line: str) -> list[str]:
    """Return the cells of a line of a Markdown table."""
    return [cell.strip() for cell in line.strip().strip("|").split(" | ")]
