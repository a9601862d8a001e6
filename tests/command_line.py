"""Running `recon ARGS` in tests."""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from recon import read_settings
from recon.base import silent, write_manifest
from recon.base.parallel import STARTING, Event, Work, outcome_of
from recon.workflows import main


class Ended(NamedTuple):
    code: int
    out: str
    err: str


def run(*args: object) -> Ended:
    """`recon ARGS` in this process: `main()` with its handling of errors."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["recon", *map(str, args)])
        patch.setenv("COLUMNS", "80")
        with pytest.raises(SystemExit) as caught:
            main()
    code = caught.value.code or 0
    assert isinstance(code, int)
    return Ended(code, out.getvalue(), err.getvalue())


def run_process(*args: object, before: str = "") -> Ended:
    """`recon ARGS` in a process of its own, after some lines of Python."""
    command = [
        sys.executable,
        "-W",
        "error",
        "-c",
        f"{before}\nfrom recon.workflows.cli import main\nmain()",
        *map(str, args),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    return Ended(done.returncode, done.stdout, done.stderr)


def copy_results(results: Path, to: Path) -> Path:
    """A folder of results elsewhere, which finds what they were made from."""
    shutil.copytree(results, to)
    (to / "config.toml").write_text(read_settings(results / "config.toml", {}).to_toml(to), encoding="utf-8")
    write_manifest(to)
    return to


def carry_out_here(work: Work, tasks: Sequence[tuple[str, Any]], tell: Callable[[Event], None], **_: Any) -> None:
    """`carry_out` in this process: tests of what it does need no other."""
    for name, task in tasks:
        tell(Event("progress", name, stage=STARTING))
        tell(Event("ended", name, outcome=outcome_of(work, task, silent)))
