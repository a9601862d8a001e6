"""Test that the notebooks run from top to bottom and give their saved outputs."""

from __future__ import annotations

import ast
import io
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pandas as pd
import pytest
from later import Later
from matplotlib.axes import Axes
from matplotlib.figure import Figure

nbformat = Later("nbformat")

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
RECORDED = FOLDER / "8_a_real_clip.ipynb"
QUICK = FOLDER / "7_the_8u_chain_in_motion.ipynb"
"""Notebook that takes only a few seconds."""
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)")


@pytest.fixture(scope="module")
def script() -> Iterator[ModuleType]:
    """Return notebooks/run.py as a module that the processes it starts can also find."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        yield import_module("run")


@pytest.fixture(scope="module")
def forked(script: ModuleType) -> ModuleType:
    """Return the script with the process from which kernels are forked."""
    first = script.FORKS.Process(target=int)
    first.start()
    first.join()
    return script


def test_the_readme_names_them_all_in_their_order() -> None:
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"\((\d_\w+\.ipynb)\)", text) == [path.name for path in NOTEBOOKS]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_saved_as_run_from_top_to_bottom_with_figures(path: Path) -> None:
    node = nbformat.read(path, as_version=4)
    nbformat.validate(node)
    code = [cell for cell in node.cells if cell.cell_type == "code"]
    outputs = [output for cell in code for output in cell.outputs]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert not [o for o in outputs if o.output_type == "error" or o.get("name") == "stderr"]
    if path == RECORDED:  # no output from recordings is saved
        assert any("no recordings: the rendered video of recon.testing" in text_of(cell) for cell in code)
    assert figures(outputs) >= 4
    assert "/tmp" not in "".join(text_of(cell) for cell in code)
    assert path.stat().st_size < 600_000


@pytest.mark.usefixtures("undrawn", "no_playback")
def test_cells_give_their_saved_outputs(monkeypatch: pytest.MonkeyPatch):
    """The cells of a notebook run in this process without drawing, which is faster than in a kernel."""
    monkeypatch.setenv("RECON_SHARED_DATA", "")
    monkeypatch.chdir(FOLDER)
    names: dict[str, Any] = {"__name__": "notebook"}
    compared = 0
    with pd.option_context("display.max_columns", 20):
        for number, cell in enumerate(nbformat.read(QUICK, as_version=4).cells):
            if cell.cell_type == "code":
                now = printed_by(cell.source, names)
                if "varies" not in cell.metadata.get("tags", ()):
                    assert not difference(text_of(cell), now), f"cell {number}"
                    compared += bool(now)
    assert compared >= 6
    names["plt"].close("all")


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_gives_its_saved_outputs(path: Path, forked: ModuleType, tmp_path: Path, monkeypatch):
    monkeypatch.setenv("RECON_SHARED_DATA", "")
    assert forked.main(["--out", str(tmp_path), path.stem]) == 0
    written = tmp_path / path.name
    before, after = (nbformat.read(p, as_version=4).cells for p in (path, written))
    assert [cell.source for cell in before] == [cell.source for cell in after]
    for number, (was, now) in enumerate(zip(before, after, strict=True)):
        if was.cell_type == "code" and "varies" not in was.metadata.get("tags", ()):
            assert kinds(was) == kinds(now), f"cell {number}: run `make notebooks`"
            different = difference(text_of(was), text_of(now))
            assert not different, f"cell {number}: {different}; if that is meant, run `make notebooks`"


@pytest.mark.slow
def test_notebook_runs_with_a_recording(shared_data: Path, forked: ModuleType, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("RECON_SHARED_DATA", str(shared_data))
    assert forked.main(["--out", str(tmp_path), "8"]) == 0
    cells = nbformat.read(tmp_path / RECORDED.name, as_version=4).cells
    assert figures([output for cell in cells for output in cell.get("outputs", ())]) >= 8


def test_a_recording_is_never_saved_in_the_project(script: ModuleType, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("RECON_SHARED_DATA", str(tmp_path))
    given = []

    def stop(path: Path, recordings: str) -> None:
        given.append(recordings)
        raise ValueError("not run")

    monkeypatch.setattr(script, "run", stop)
    for where in ([], ["--out", str(FOLDER)]):
        assert script.main([*where, "8"]) == 1
    assert given == ["", ""]


@pytest.mark.parametrize(
    ("was", "now", "same"),
    [
        ("peak 16.05 m/s at -0.87", "peak  16.1 m/s at -0.88", True),
        ("reached 46", "reached 47", True),
        ("reached 46", "reached 60", False),
        ("error 1.3e-05", "error 1.3e-04", False),
        ("l_front_paw 3", "r_front_paw 3", False),
    ],
)
def test_texts_are_compared_by_words_and_rounded_numbers(was: str, now: str, same: bool) -> None:
    assert (difference(was, now) == "") == same


def printed_by(source: str, names: dict[str, Any]) -> str:
    """Return the text that a cell prints, and its last value unless this is a figure."""
    tree = ast.parse(re.sub(r"^%.*$", "", source, flags=re.MULTILINE))
    last = tree.body[-1] if tree.body else None
    shown = last.value if isinstance(last, ast.Expr) else None
    if shown:
        tree.body.pop()
    out = io.StringIO()
    with redirect_stdout(out):
        exec(compile(tree, "cell", "exec"), names)
        value = eval(compile(ast.Expression(shown), "cell", "eval"), names) if shown else None
    return out.getvalue() + ("" if value is None or isinstance(value, Figure | Axes) else repr(value))


def figures(outputs: list[Any]) -> int:
    return sum("image/png" in output.get("data", {}) for output in outputs)


def kinds(cell: Any) -> list[tuple[str, ...]]:
    """Return the kind of each output: text, a table, a figure."""
    return [tuple(sorted(output.get("data", {"text": ""}))) for output in cell.outputs]


def text_of(cell: Any) -> str:
    texts = [o["text"] if "text" in o else o["data"].get("text/plain", "") for o in cell.outputs]
    return "\n".join(text for text in texts if not text.startswith("<Figure"))


def difference(was: str, now: str) -> str:
    """Return the first difference between two texts, except in blanks and rounded numbers; "" if they agree."""
    words = [NUMBER.sub("#", text).split() for text in (was, now)]
    if words[0] != words[1]:
        return f"{' '.join(words[0])!r} is now {' '.join(words[1])!r}"
    for a, b in zip(NUMBER.findall(was), NUMBER.findall(now), strict=True):
        last_digit = (
            10.0 ** -max(len(x.partition("e")[0].partition(".")[2]) for x in (a, b)) if "e" not in a + b else 0.0
        )
        if abs(float(a) - float(b)) > max(2.01 * last_digit, 0.05 * abs(float(a))):
            return f"{a} is now {b}"
    return ""
