"""Run `recon ARGS` in tests, and check the problems for which commands and functions are refused."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import recon.cli.app as cli
from recon import InputError, read_settings
from recon.base.errors import Problem
from recon.base.files import write_manifest
from recon.base.parallel import STARTING, Event, Work, outcome_of
from recon.base.progress import silent
from recon.cli.app import main


class Ended(NamedTuple):
    code: int
    out: str
    err: str


def run(*args: object) -> Ended:
    """Run `recon ARGS` in this process, by `main()` with its handling of errors."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["recon", *map(str, args)])
        patch.setenv("COLUMNS", "80")
        with pytest.raises(SystemExit) as caught:
            main()
    code = caught.value.code or 0
    assert isinstance(code, int)
    return Ended(code, out.getvalue(), err.getvalue())


Refusal = tuple[object, ...]
"""Expected parts of a `Problem`: the file (or only its name) or option, the field, and words of `found` and `expected`.

The words of `found` and `expected` are a text, a number or a list of them, and may be left out.
"""


def refused(args: Sequence[object], *expected: Refusal) -> tuple[Problem, ...]:
    """Check that `recon ARGS` fails with exactly the expected problems, one line of error for each."""
    problems: list[Problem] = []
    app = cli.app

    def noted() -> None:
        try:
            app()
        except InputError as error:
            problems.extend(error.problems)
            raise

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli, "app", noted)
        ended = run(*args)
    printed = "".join(f"error: {line}\n" for line in ("\n".join(problem.lines) for problem in problems))
    assert ended == Ended(2, "", printed), ended
    compare(problems, expected)
    return tuple(problems)


@contextmanager
def refusal(*expected: Refusal) -> Iterator[None]:
    """Check that the block raises `InputError` with exactly the expected problems."""
    with pytest.raises(InputError) as caught:
        yield
    compare(caught.value.problems, expected)


def compare(problems: Sequence[Problem], expected: Sequence[Refusal]) -> None:
    """Compare problems with the expected ones, in any order."""
    said = [[_is_about(problem, one) for one in expected] for problem in problems]
    if len(problems) != len(expected) or not all(map(any, said)) or not all(map(any, zip(*said, strict=True))):
        told = "\n".join(map(repr, problems))
        raise AssertionError(f"refused for\n{told}\nand not for\n" + "\n".join(map(repr, expected)))


def _is_about(problem: Problem, expected: Refusal) -> bool:
    file, field, *values = expected
    each = [one if isinstance(one, list) else [one] for one in values]
    texts = (problem.found, problem.expected)
    is_here = str(file) in (str(problem.file), Path(problem.file).name) and field == problem.field
    return is_here and all(says(text, *one) for text, one in zip(texts, each, strict=False))


def says(text: str, *values: object) -> bool:
    """Return whether a text contains all values as whole words; 13 and 3.5 do not contain 3."""
    begins, ends = r"(?:(?<![\w.])|(?!\w))", r"(?:(?!\w|\.\d)|(?<!\w))"
    return all(re.search(f"{begins}{re.escape(str(value))}{ends}", text) for value in values)


def run_process(*args: object, before: str = "") -> Ended:
    """Run `recon ARGS` in another process, after the lines of Python in `before`."""
    command = [
        sys.executable,
        "-W",
        "error",
        "-c",
        f"{before}\nfrom recon.cli.app import main\nmain()",
        *map(str, args),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    return Ended(done.returncode, done.stdout, done.stderr)


def copy_results(results: Path, to: Path) -> Path:
    """Copy a folder of results so that the copy finds the inputs of the original."""
    shutil.copytree(results, to)
    (to / "config.toml").write_text(read_settings(results / "config.toml", {}).to_toml(to), encoding="utf-8")
    write_manifest(to)
    return to


def run_tasks_here(work: Work, tasks: Sequence[tuple[str, Any]], tell: Callable[[Event], None], **_: Any) -> None:
    """Run tasks in this process, instead of `run_tasks`, in tests that need no other process."""
    for name, task in tasks:
        tell(Event("progress", name, stage=STARTING))
        tell(Event("ended", name, outcome=outcome_of(work, task, silent)))
