"""Test tasks that run in other processes, and their outcome if a process dies.

This file imports little, because each process that it starts imports it.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import subprocess
import sys
import time
from typing import Any

import pytest

import recon.base.parallel as parallel
from recon.base.memory import NEW_OBJECTS
from recon.base.parallel import Event, run_tasks
from recon.base.progress import Progress


def work(task: str, progress: Progress) -> dict[str, Any]:
    """Do a task of these tests in another process: sleep, crash, raise, or describe the process."""
    if task == "environment":
        threads, new_objects = os.environ["OMP_NUM_THREADS"], gc.get_threshold()[0]
        return {"pid": os.getpid(), "threads": threads, "numpy": "numpy" in sys.modules, "new_objects": new_objects}
    if task == "crash":
        print("last words", flush=True)
        os.abort()
    if task == "exit":
        sys.stderr.write("told why\n")
        os._exit(7)
    if task == "wait":
        try:
            progress("waiting", 0.5)
            time.sleep(60)
        finally:
            print("cleaned up", flush=True)
    raise KeyError(task)


def ended(*tasks: str, **more: Any) -> dict[str, Any]:
    """Return the outcomes of tasks by name, which is the task's text up to a colon."""
    outcomes: dict[str, Any] = {}

    def tell(event: Event) -> None:
        if event.kind == "ended":
            outcomes[event.name] = event.outcome

    run_tasks(work, [(task, task.split(":")[0]) for task in tasks], tell, **more)
    return outcomes


def test_processes_have_one_thread_and_are_replaced(monkeypatch):
    monkeypatch.setattr(parallel, "TASKS_PER_PROCESS", 2)
    held, stop = [], parallel._Process.stop
    monkeypatch.setattr(parallel._Process, "stop", lambda self: (held.append(self.pid), stop(self)))
    for library in ("OMP", "OPENBLAS"):  # conftest.py also sets these variables
        monkeypatch.delenv(f"{library}_NUM_THREADS", raising=False)
    first, second, third = ended("environment:1", "environment:2", "environment:3", jobs=1).values()
    assert first["pid"] == second["pid"] != third["pid"] != os.getpid()
    assert (first["threads"], first["new_objects"]) == ("1", NEW_OBJECTS)
    assert held == [third["pid"]]  # only the last process still has files open


@pytest.mark.skipif(os.name != "posix", reason="signals are of POSIX")
def test_processes_that_die_are_failures():
    outcomes = ended("crash", "environment", "exit", "fault", jobs=1)
    assert outcomes["environment"]["attempts"] == 1
    errors = {name: (outcomes[name]["status"], outcomes[name]["error"]) for name in ("crash", "exit", "fault")}
    assert errors == {
        "crash": ("failed", "the worker was killed (SIGABRT)"),
        "exit": ("failed", "the worker crashed: told why"),
        "fault": ("failed", "the worker crashed: KeyError: 'fault'"),
    }
    assert outcomes["crash"]["log"].startswith("last words\n")
    assert "in work" in outcomes["crash"]["log"]  # the log names the Python function
    assert "Traceback" in outcomes["fault"]["log"]
    assert {outcome["attempts"] for outcome in ended("exit", "fault", jobs=2, retries=1).values()} == {2}


def test_an_interrupt_stops_the_processes():
    seen = []

    def interrupt(event: Event) -> None:
        seen.append(event.stage)
        if event.stage == "waiting":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_tasks(work, [("wait", "wait")] * 3, interrupt, jobs=2)
    assert seen[-1] == "waiting"
    assert not multiprocessing.active_children()


def test_a_script_needs_no_main(tmp_path):
    """A script without an `if __name__` guard does not run again in the processes."""
    script = tmp_path / "script.py"
    script.write_text(
        "from recon.base.parallel import run_tasks\nfrom recon.base.progress import silent\n"
        "print('once')\nrun_tasks(silent, [('one', 1)], lambda event: print(event.kind), jobs=1)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, timeout=60)
    assert (done.stdout.split(), done.stderr) == (["once", "progress", "ended"], "")
