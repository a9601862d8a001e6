"""A sample of the spoilt files of `tests/fuzz`: none is anything but read or refused in words."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the cases run in forked processes")
def test_spoilt_files_are_read_or_refused():
    command = [sys.executable, "-m", "tests.fuzz", "--cases", "2000", "--seed", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    counts = {words: int(number) for number, words in re.findall(r"(?m)^ *(\d+)  (\w.*)$", done.stdout)}
    assert counts["cases"] == counts["read"] + counts["refused in words"] == 2000
    assert counts["neither"] == 0
    assert counts["read"] > 200  # not all are spoilt beyond recognition
