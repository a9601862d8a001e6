"""Test how much freed memory a process keeps, and how often it searches for unused objects."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

from recon.base.memory import KEPT_BYTES, MAX_BYTES, NEW_OBJECTS

CODE = """
import ctypes, sys
from pathlib import Path
from recon.base.memory import keep_freed_memory

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]

def used_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 >> 20

if sys.argv[1] == "keep":
    keep_freed_memory()
before = used_mb()
size, count = int(sys.argv[2]), int(sys.argv[3])
blocks = [libc.malloc(size) for _ in range(count)]
for block in blocks:
    ctypes.memset(block, 1, size)
for block in reversed(blocks):
    libc.free(block)
print(used_mb() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs glibc")
def test_freed_memory_is_kept_up_to_a_limit_except_for_large_arrays():
    def left_mb(how: str, size: int, count: int) -> int:
        command = [sys.executable, "-c", CODE, how, str(size), str(count)]
        return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    block, kept_mb = MAX_BYTES // 4, KEPT_BYTES >> 20
    assert left_mb("plain", block, 10) < 20
    assert left_mb("keep", block, 10) > 70
    assert left_mb("keep", block, 2 * KEPT_BYTES // block) <= kept_mb + 10
    assert left_mb("keep", 2 * MAX_BYTES, 3) < 10


def test_a_command_searches_rarely_for_unused_objects_and_never_as_it_ends():
    code = """
import atexit, gc, sys
from recon.__main__ import main

atexit.register(lambda: print(gc.get_freeze_count() > 0))  # runs last
sys.argv = ["recon", "--version"]
try:
    main()
finally:
    print(gc.isenabled(), gc.get_threshold()[0], gc.get_freeze_count())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-2:] == [f"True {NEW_OBJECTS} 0", "True"]
