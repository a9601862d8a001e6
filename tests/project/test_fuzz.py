"""Test that a sample of the damaged files of `tests/fuzz` is read, or refused with a message."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stdout
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.fuzz.corpus import Seed
    from tests.fuzz.pool import Tally

ROOT = Path(__file__).resolve().parents[2]
CASES = {"formats": 150, "settings": 250}
"""Number of damaged files that are tested, by kind."""

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the cases run in forked processes")


def good_files(kinds: str, folder: Path) -> list[Seed]:
    from tests.fuzz import corpus

    corpus._models = lambda folder: ()  # torch takes seconds to import; test_io_hostile.py has networks
    folder.mkdir()
    return list(corpus.of_formats(folder) if kinds == "formats" else corpus.of_settings(folder))


def cases(kinds: str, folder: Path, count: int) -> Tally:
    from tests.fuzz.pool import run_all

    return run_all(0, count, 1, good_files(kinds, folder), folder, 1)


def of_the_command(folder: Path) -> tuple[int, str]:
    """Return the exit code and the output of `python -m tests.fuzz` for cameras and their tracks."""
    from tests.fuzz import __main__ as fuzz
    from tests.fuzz import corpus

    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out):
        patch.setattr(fuzz, "seeds", lambda *_: [*corpus._cameras(folder), *corpus._tracks()])
        patch.setattr(sys, "argv", ["fuzz", "--cases", "40", "--seed", "1"])
        return fuzz.main(), out.getvalue()


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPoolExecutor]:
    """Return a process without threads, which can be forked, and in which the valid files are made once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            yield pool


@pytest.mark.slow
@pytest.mark.parametrize("kinds", CASES)
def test_damaged_files_are_read_or_refused(kinds: str, pool: ProcessPoolExecutor, tmp_path: Path) -> None:
    """More than a tenth of the damaged files can still be read, because the damage is often small."""
    count = CASES[kinds]
    tally = pool.submit(cases, kinds, tmp_path / kinds, count).result()
    assert tally.causes == {}
    assert tally.done == tally.read + tally.refused == count
    assert tally.read > count / 10


def formats_of_good_files(folder: Path) -> set[str]:
    """Read every valid file, and return the titles of the formats of these files."""
    from recon.io.formats import FORMATS

    titles = set()
    for seed in (*good_files("formats", folder / "formats"), *good_files("settings", folder / "settings")):
        if seed.is_input and seed.link is None:
            path = folder / f"good-{seed.name}"
            path.write_bytes(seed.content)
            seed.read(path)
            titles.update([f.title for f in FORMATS if f.recognises(path)][:1])
    return titles


@pytest.mark.slow
def test_good_files_are_read_and_have_every_format(pool: ProcessPoolExecutor, tmp_path: Path) -> None:
    from recon.io.formats import FORMATS

    titles = pool.submit(formats_of_good_files, tmp_path).result()
    assert titles == {f.title for f in FORMATS if f.reads}


@pytest.mark.slow
def test_command_prints_the_number_of_cases(pool: ProcessPoolExecutor, tmp_path: Path) -> None:
    code, printed = pool.submit(of_the_command, tmp_path).result()
    assert code == 0, printed
    counts = {words: int(number) for number, words in re.findall(r"(?m)^ *(\d+)  (\w.*)$", printed)}
    assert counts["cases"] == counts["read"] + counts["refused in words"] == 40
    assert counts["neither"] == 0
