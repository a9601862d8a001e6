"""A sample of the spoilt files of `tests/fuzz`: none is anything but read or refused in words."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.fuzz.corpus import Seed
    from tests.fuzz.pool import Tally

ROOT = Path(__file__).resolve().parents[1]
CASES = {"formats": 750, "settings": 1250}
"""As their shares in all cases say."""

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the cases run in forked processes")


@cache
def good_files(kinds: str, folder: Path) -> list[Seed]:
    from tests.fuzz import corpus

    folder.mkdir()
    return list(corpus.of_formats(folder) if kinds == "formats" else corpus.of_settings(folder))


def make(kinds: str, folder: Path) -> None:
    good_files(kinds, folder)


def cases(kinds: str, folder: Path, count: int) -> Tally:
    from tests.fuzz.pool import run_all

    return run_all(0, count, 1, good_files(kinds, folder), folder, 1)


@contextmanager
def prepared(kinds: str, folder: Path) -> Iterator[Callable[[int], Tally]]:
    """`cases_from(count)` is what becomes of the first so many cases: in a process that has no threads, so that it
    can be forked, and in which the good files are made once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            pool.submit(make, kinds, folder).result()
            yield lambda count: pool.submit(cases, kinds, folder, count).result()


@pytest.fixture(scope="session")
def format_cases(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[int], Tally]]:
    with prepared("formats", tmp_path_factory.mktemp("fuzz") / "good") as cases_from:
        yield cases_from


@pytest.fixture(scope="session")
def setting_cases(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[int], Tally]]:
    with prepared("settings", tmp_path_factory.mktemp("fuzz") / "good") as cases_from:
        yield cases_from


def test_spoilt_clips_and_poses_are_read_or_refused(format_cases) -> None:
    check(format_cases(CASES["formats"]), CASES["formats"])


def test_other_spoilt_files_are_read_or_refused(setting_cases) -> None:
    check(setting_cases(CASES["settings"]), CASES["settings"])


def check(tally: Tally, cases: int) -> None:
    """More than a tenth is read, as not all are spoilt beyond recognition."""
    assert tally.causes == {}
    assert tally.done == tally.read + tally.refused == cases
    assert tally.read > cases / 10


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
