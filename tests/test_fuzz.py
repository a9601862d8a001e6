"""A sample of the spoilt files of `tests/fuzz`: none is anything but read or refused in words."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.fuzz.corpus import Seed
    from tests.fuzz.pool import Tally

ROOT = Path(__file__).resolve().parents[1]
CASES = {"formats": 150, "settings": 250}
"""As their shares in all cases say."""

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the cases run in forked processes")


@cache
def good_files(kinds: str, folder: Path) -> list[Seed]:
    from tests.fuzz import corpus

    corpus._models = lambda folder: ()  # torch takes seconds to import; test_io_hostile.py has networks
    folder.mkdir()
    return list(corpus.of_formats(folder) if kinds == "formats" else corpus.of_settings(folder))


def cases(kinds: str, folder: Path, count: int) -> Tally:
    from tests.fuzz.pool import run_all

    return run_all(0, count, 1, good_files(kinds, folder), folder, 1)


@pytest.fixture(scope="module")
def cases_from(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str, int], Tally]]:
    """`cases_from(kinds, count)` is what becomes of the first so many cases: in a process that has no threads, so that
    it can be forked, and in which the good files are made once."""
    folder = tmp_path_factory.mktemp("fuzz")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            yield lambda kinds, count: pool.submit(cases, kinds, folder / kinds, count).result()


@pytest.mark.parametrize("kinds", CASES)
def test_spoilt_files_are_read_or_refused(kinds: str, cases_from) -> None:
    """More than a tenth is read, as not all are spoilt beyond recognition."""
    tally, count = cases_from(kinds, CASES[kinds]), CASES[kinds]
    assert tally.causes == {}
    assert tally.done == tally.read + tally.refused == count
    assert tally.read > count / 10


FEW_KINDS = """
import sys
from tests.fuzz import __main__ as fuzz, corpus
fuzz.seeds = lambda folder, real: [*corpus._cameras(folder.parent), *corpus._tracks()]
sys.exit(fuzz.main())
"""


def test_the_command_says_what_happened() -> None:
    command = [sys.executable, "-c", FEW_KINDS, "--cases", "40", "--seed", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    counts = {words: int(number) for number, words in re.findall(r"(?m)^ *(\d+)  (\w.*)$", done.stdout)}
    assert counts["cases"] == counts["read"] + counts["refused in words"] == 40
    assert counts["neither"] == 0
