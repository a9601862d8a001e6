"""Test that Ctrl-C gives one line on stderr and exit code 130 at any moment of a process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Ended, run
from fuzz.ctrl_c import fault, interrupted

from recon.base.interrupts import MESSAGE

posix = pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
FIT = ("fit", "clip.csv", "--camera", "camera.toml", "--fps", "60", "--out", "results")

# This script stands in for a command, and waits at a known line. tests/fuzz/ctrl_c.py interrupts real fits.
START = """
import atexit, hashlib, os, signal, sys, time, types
from recon.base import interrupts
from recon.__main__ import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background

def ctrl_c():
    os.kill(os.getpid(), signal.SIGINT)

def fit():
    try:
        work()
    finally:
        print("cleaned up", flush=True)

results = sys.modules["recon.cli.fit"] = types.ModuleType("recon.cli.fit")
results.fit = fit
sys.modules["pandas"] = types.ModuleType("pandas")
"""
IN_A_LIBRARY = "hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)"
WORK = {
    "at work": "ctrl_c(); time.sleep(60)",
    "just before it waits": """
    import threading
    threading.Timer(0.1, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGINT)).start()
    time.sleep(60)
""",
    "another exception": """
    try:
        ctrl_c(); time.sleep(60)
    except BaseException:
        raise ValueError("no such thing") from None
""",
    "no exception": """
    try:
        ctrl_c(); time.sleep(60)
    except BaseException:
        pass
""",
    "within an import": """
    class Finder:
        @staticmethod
        def find_spec(name, path=None, target=None):
            if name == "wave":
                ctrl_c(); time.sleep(0.2)
    sys.meta_path.insert(0, Finder)
    import wave
    time.sleep(60)
""",
    "in a destructor": """
    class Thing:
        def __del__(self):
            ctrl_c(); time.sleep(60)
    Thing()
    time.sleep(60)
""",
}


def recon_in(code: str) -> Ended:
    command = [sys.executable, "-c", f"{START}{code}\nmain()", "fit"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    return Ended(done.returncode, done.stdout, done.stderr)


def test_a_command_called_from_python_ends_with_one_line(monkeypatch):
    def interrupted(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("recon.api.clip_results.run_clip", interrupted)
    assert run(*FIT) == Ended(130, "", f"{MESSAGE}\n")


@posix
@pytest.mark.parametrize(
    "moment",
    [
        pytest.param(
            moment, marks=[pytest.mark.slow] * (moment in ("just before it waits", "no exception", "in a destructor"))
        )
        for moment in WORK
    ],
)
def test_the_command_cleans_up(moment):
    """The command cleans up even if a library turns the interrupt into another exception, or drops it."""
    assert recon_in(f"def work():\n    {WORK[moment]}") == Ended(130, "cleaned up\n", f"{MESSAGE}\n")


@posix
@pytest.mark.parametrize(
    "module", ["typer", *(pytest.param(name, marks=pytest.mark.slow) for name in ("rich.markup", "recon.cli.app"))]
)
def test_interrupt_during_an_import(module):
    """An interrupt during an import prints no exception of a library."""
    code = f"""
class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == {module!r}:
            ctrl_c(); time.sleep(60)
sys.meta_path.insert(0, Finder)
"""
    assert recon_in(code) == Ended(130, "", f"{MESSAGE}\n")


@posix
def test_library_that_does_not_return():
    code = f"""
interrupts.STUCK_S = 0.1
import threading
def work():
    threading.Timer(0.1, ctrl_c).start()
    {IN_A_LIBRARY}
"""
    assert recon_in(code) == Ended(130, "", f"{MESSAGE}\n")


@posix
@pytest.mark.parametrize(
    "again",
    [
        pytest.param("ctrl_c(); time.sleep(60)", marks=pytest.mark.slow),
        f"interrupts.CLEAN_UP_S = 0.1; {IN_A_LIBRARY}",
    ],
)
def test_second_interrupt_ends_the_clean_up(again):
    code = f"""
def work():
    try:
        ctrl_c(); time.sleep(60)
    finally:
        {again}
"""
    assert recon_in(code) == Ended(130, "", f"{MESSAGE}\n")


@posix
def test_interrupt_after_the_command():
    """An interrupt after the command prints the line once, and does not wait for functions registered with `atexit`."""
    code = """
def work():
    atexit.register(lambda: (ctrl_c(), time.sleep(60)))
    raise KeyboardInterrupt
"""
    assert recon_in(code) == Ended(130, "cleaned up\n", f"{MESSAGE}\n")
    assert recon_in(code.replace("raise KeyboardInterrupt", "sys.exit(0)")) == Ended(
        130, "cleaned up\n", f"{MESSAGE}\n"
    )


@posix
def test_interrupt_while_python_ends():
    """While Python ends, nothing is left to stop, so the exit code is the command's own."""
    code = """
class Last:
    def __del__(self, kill=os.kill, pid=os.getpid(), number=signal.SIGINT):
        kill(pid, number)
last = Last()
def work():
    sys.exit(3)
"""
    assert recon_in(code) == Ended(3, "cleaned up\n", "")


@posix
def test_sigterm_ends_like_ctrl_c():
    code = "def work():\n    os.kill(os.getpid(), signal.SIGTERM); time.sleep(60)"
    assert recon_in(code) == Ended(130, "cleaned up\n", f"{MESSAGE}\n")
    assert recon_in(f"{code}\nsignal.signal(signal.SIGINT, signal.SIG_IGN)").out == "cleaned up\n"


@posix
def test_ignored_interrupt_stays_ignored():
    code = "def work():\n    ctrl_c(); print('done'); sys.exit(3)\nsignal.signal(signal.SIGINT, signal.SIG_IGN)"
    assert recon_in(code) == Ended(3, "done\ncleaned up\n", "")


@posix
@pytest.mark.parametrize(
    ("end", "code", "said"),
    [
        pytest.param("sys.exit(5)", 5, "", marks=pytest.mark.slow),
        ("raise ArithmeticError", 1, "ArithmeticError\n"),
    ],
)
def test_the_process_ends_with_its_own_code(end, code, said):
    """Functions registered with `atexit` run, and can print, before the process ends."""
    ended = recon_in(f"def work():\n    atexit.register(print, 'at the exit'); {end}")
    assert (ended.code, ended.out) == (code, "cleaned up\nat the exit\n")
    assert ended.err.endswith(said)
    assert bool(ended.err) == bool(said)


@posix
@pytest.mark.parametrize(
    ("where", "code", "said"),
    [("/dev/full", 2, "No space left on device"), pytest.param("|", 1, "", marks=pytest.mark.slow)],
)
def test_output_to_a_full_disk_or_a_closed_pipe(where, code, said):
    """A full disk is reported; a reader that closed the pipe is not an error."""
    if where == "|":
        reader, writer = os.pipe()
        os.close(reader)
    else:
        writer = os.open(where, os.O_WRONLY)
    command = [sys.executable, "-m", "recon", "--version"]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False, timeout=300)
    os.close(writer)
    assert (done.returncode, done.stderr.count("\n")) == (code, len(said) > 0)
    assert said in done.stderr


@posix
@pytest.mark.parametrize(
    "after_s", [0.5, *(pytest.param(after_s, marks=pytest.mark.slow) for after_s in (0.0, 0.2, 0.8))]
)
def test_interrupt_from_outside(after_s, tmp_path):
    """The interrupt arrives while modules are imported, or while the clip is fitted and written."""
    samples = Path(__file__).resolve().parents[2] / "data" / "samples"
    fit = ["fit", samples / "whole.csv", "--camera", samples / "camera.toml", "--fps", 60, "--out", tmp_path / "out"]
    ended = interrupted([*map(str, fit)], after_s, tmp_path)
    if ended.in_time:  # otherwise the command ended before the signal
        assert not fault(ended), ended


@pytest.mark.skipif(sys.platform != "linux", reason="others do not limit what a process may have")
def test_too_little_memory_is_reported_before_libraries_are_loaded():
    ended = subprocess.run(
        ["bash", "-c", f"ulimit -v 400000; exec '{sys.executable}' -m recon doctor"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr == "error: not enough memory: the limit is 390 MB (ulimit -v), but 640 MB are needed\n"
