"""Test that the names in the benchmarks' scripts exist, and that the docs' tables agree with their results."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
QUESTIONS = (
    *("accuracy", "cameras", "peers", "uncertainty", "wrong_inputs"),
    *("gait", "robots", "thesis", "net", "speed"),
)


def script(name: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the names that a script of the benchmarks defines."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    try:
        return runpy.run_path(str(BENCHMARKS / f"{name}.py"))
    finally:
        sys.modules.pop("question", None)


def test_the_tables_of_the_docs_agree_with_the_results(monkeypatch):
    assert script("tables", monkeypatch)["differences"]() == []


def test_table_edited_by_hand_is_written_again(monkeypatch):
    tables = script("tables", monkeypatch)
    text = f"Before.\n\n<!-- results: accuracy/focal -->\n\n{tables['table_text']('accuracy', 'focal')}\nAfter.\n"
    assert tables["with_tables"](text) == text
    assert "99.5" in text
    assert tables["with_tables"](text.replace("99.5", "9.5")) == text


@pytest.mark.parametrize("question", QUESTIONS)
def test_every_part_has_its_script(question, monkeypatch):
    defined = script(question, monkeypatch)
    assert defined["PARTS"]
    for part in defined["PARTS"].values():
        assert (BENCHMARKS / "parts" / part.script).is_file()
    results = (
        json.loads((BENCHMARKS / "results" / f"{question}.json").read_text(encoding="utf-8"))
        if (BENCHMARKS / "results" / f"{question}.json").is_file()
        else {}
    )
    for table in results.get("tables", {}).values():
        source = results["runs"][table["run"]] if "run" in table else table
        assert {"measured", "command", "data"} <= source.keys()


def test_printed_tables_are_read(monkeypatch):
    question = script("question", monkeypatch)
    tables, sentences = question["read_markdown"](
        "### Title\n\n| a | b |\n| --- | ---: |\n| 1 | 2 |\n|  | 3 |\n\nSo.\n"
    )
    assert tables == [{"header": ["a", "b"], "rows": [["1", "2"], ["", "3"]]}]
    assert sentences == ["### Title", "So."]
    timed = {"header": ["frames", "wall, s", "off, mm"], "rows": [["1", "2", "3"]]}
    assert question["without_times"](timed) == {"header": ["frames", "off, mm"], "rows": [["1", "3"]]}


def test_results_that_differ_in_a_bit_are_found(tmp_path, monkeypatch):
    same = script("same_results", monkeypatch)
    for name, x in (("old", 1.0), ("new", np.nextafter(1.0, 2.0))):
        (tmp_path / name).mkdir()
        np.savez(tmp_path / name / "motion.npz", states=np.array([[x]]), record=np.zeros(3, np.uint8))
        (tmp_path / name / "quality.csv").write_text(f"frame,x,solve_s\n0,1,{x}\n")
        (tmp_path / name / "report.json").write_text(json.dumps({"timing_s": x, "verdict": {"level": "use", "n": x}}))
    both = (tmp_path / "old", tmp_path / "new")
    assert same["compare_files"](*both, "quality.csv").difference == ""
    assert "states" in same["compare_files"](*both, "motion.npz").difference
    assert "verdict.n: 1.0 -> 1.0000000000000002; 1 in all" in same["compare_files"](*both, "report.json").difference
    assert same["compare_files"](*both, "pose3d.csv").difference
