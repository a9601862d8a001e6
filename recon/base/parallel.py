"""Many tasks beside each other, each in a process: one whose process dies takes no other with it.

Each process has an executor of `concurrent.futures` of its own, because all that an executor has under way is lost
when one of its processes dies.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any, Literal

from recon.base import Progress
from recon.base.errors import InputError, Problem

Outcome = Mapping[str, Any]
"""What became of a task, by name, at least its status; a task that failed has an error."""
Work = Callable[[Any, Progress], Outcome]
"""What is done with each task: a function at the top of a module, so that another process finds it."""
STARTING = "starting"
TASKS_PER_PROCESS = 50
"""Then a new process takes over: rerun keeps two to four threads and 1.5 to 3 MB of each recording for good."""
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMEXPR", "RAYON")} | {
    "OPENCV_FOR_THREADS_NUM": "1"
}
KILLED = 128 + signal.SIGTERM
STOP_S = 3.0
"""A process that is told to stop has this long to clean up."""
TICK_S = 0.1
TELL_S = 0.2
"""Progress is told no more often."""
LOG_BYTES = 20_000


@dataclass(frozen=True)
class Event:
    """What happened to a task. On a cluster nothing is heard of its progress but that it begins."""

    kind: Literal["progress", "ended"]
    name: str
    """The name of the task."""
    pid: int | None = None
    """The process that it runs in."""
    stage: str = ""
    share: float = 0.0
    """How much of all is done, 0 to 1."""
    outcome: Outcome = field(default_factory=dict)
    """The outcome of a task that has ended."""


def available_cores() -> int:
    """How many processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def outcome_of(work: Work, task: Any, progress: Progress) -> dict[str, Any]:
    """Do a task. Input that cannot be used is an outcome, with the status "failed"; a fault is not."""
    began = time.perf_counter()
    try:
        outcome = work(task, progress)
    except (InputError, OSError) as error:
        text = str(error)
        if isinstance(error, OSError) and error.filename:
            text = f"{error.filename}: {error.strerror}"
        outcome = {"status": "failed", "error": text}
    return {"seconds": round(time.perf_counter() - began, 3), "attempts": 1, **outcome}


def carry_out(
    work: Work,
    tasks: Sequence[tuple[str, Any]],
    tell: Callable[[Event], None],
    *,
    jobs: int | None = None,
    retries: int = 0,
    now_and_then: Callable[[], None] = lambda: None,
) -> None:
    """All tasks, each with its name, in processes of this machine with one thread each; what happens is told.

    jobs: tasks at a time, by default one for each core; retries: how often a task is tried again whose process died or
    that raised what is no InputError. Its outcome is then a failure with the last words of the process as "log". After
    an exception, as at Ctrl-C, the processes are stopped, which takes seconds, and what ended before is told. Raises
    InputError where processes cannot be started.
    """
    others = multiprocessing.active_children()
    waiting = deque((name, task, 1) for name, task in tasks)
    underway: dict[Future[dict[str, Any]], tuple[_Process, str, Any, int]] = {}
    complete = False

    def begin(process: _Process, name: str, task: Any, attempt: int) -> None:
        underway[process.submit(work, task)] = process, name, task, attempt
        tell(Event("progress", name, process.pid, STARTING))

    with TemporaryDirectory(ignore_cleanup_errors=True) as logs:
        processes = [_Process(Path(logs) / str(i)) for i in range(min(jobs or available_cores(), len(tasks)))]
        try:
            for process in processes:
                begin(process, *waiting.popleft())
            while underway:
                done, _ = wait(underway, TICK_S, FIRST_COMPLETED)
                for process, name, *_ in underway.values():
                    for stage, share in process.messages():
                        tell(Event("progress", name, process.pid, stage, share))
                for future in done:
                    process, name, task, attempt = underway.pop(future)
                    error = future.exception()
                    if error is not None and attempt <= retries:
                        process.fault(error)
                        begin(process, name, task, attempt + 1)
                        continue
                    outcome = future.result() if error is None else process.fault(error)
                    tell(Event("ended", name, outcome={**outcome, "attempts": attempt}))
                    if waiting:
                        begin(process, *waiting.popleft())
                now_and_then()
            complete = True
        finally:
            ours = [one for one in multiprocessing.active_children() if one not in others]
            _end(processes, ours, now=not complete)
            for future, (_, name, _, attempt) in underway.items():
                if future.done() and not future.cancelled() and future.exception() is None:
                    tell(Event("ended", name, outcome={**future.result(), "attempts": attempt}))


def _end(processes: Sequence[_Process], ours: Sequence[Any], now: bool) -> None:
    """Let the processes end; now: what they do is stopped, and cleans up."""
    kill = threading.Timer(STOP_S, lambda: [one.kill() for one in ours])
    kill.daemon = True
    if now:
        for one in ours:
            one.terminate()
        kill.start()
    for process in processes:
        process.end()
    kill.cancel()


class _Process:
    """An executor of one process, which is started when it is needed, again when it died, and anew now and then."""

    def __init__(self, log: Path) -> None:
        self._log = log
        self._executor: ProcessPoolExecutor | None = None
        self._process: Any = None
        self._tasks = 0

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    def submit(self, work: Work, task: Any) -> Future[dict[str, Any]]:
        if self._executor is not None and self._tasks < TASKS_PER_PROCESS:
            self._tasks += 1
            return self._executor.submit(_in_process, work, task)
        self.end(wait=False)
        context = multiprocessing.get_context("spawn")  # others cannot be started beside threads
        self._messages, theirs = context.Pipe(duplex=False)
        self._tasks = 1
        self._executor = ProcessPoolExecutor(1, context, _begin, (theirs, str(self._log)))
        before = multiprocessing.active_children()
        try:
            with _alone():
                future = self._executor.submit(_in_process, work, task)
        except OSError as error:
            raise InputError(Problem("processes", "start", str(error), "a system that can start another one")) from None
        self._process = next(one for one in multiprocessing.active_children() if one not in before)
        theirs.close()
        return future

    def messages(self) -> Iterator[tuple[str, float]]:
        """Progress of the task, as far as it has not been asked for."""
        try:
            while self._messages.poll():
                yield self._messages.recv()
        except (EOFError, OSError):  # it is dead
            pass

    def fault(self, error: BaseException) -> dict[str, Any]:
        """The outcome of a task that raised this, or whose process died."""
        if not isinstance(error, BrokenProcessPool):
            return _failure(f"crashed: {type(error).__name__}: {error}", str(error.__cause__ or ""))
        self.end()
        code, log = self._process.exitcode or 0, self._last_words()
        if code < 0:
            memory = ", as the system does when memory runs out" if -code == getattr(signal, "SIGKILL", 9) else ""
            return _failure(f"was killed ({signal.Signals(-code).name}{memory})", log)
        return _failure(f"crashed: {(log.strip().splitlines() or ['no word'])[-1]}", log)

    def end(self, wait: bool = True) -> None:
        """Let the process go once it has done its task; `submit` starts another one."""
        if self._executor is not None:
            self._executor.shutdown(wait, cancel_futures=True)
            self._executor = None

    def _last_words(self) -> str:
        text = self._log.read_bytes()[-LOG_BYTES:] if self._log.exists() else b""
        return text.decode("utf-8", errors="replace")


def _failure(what: str, log: str) -> dict[str, Any]:
    return {"status": "failed", "error": f"the worker {what}", "log": log}


@contextmanager
def _alone() -> Iterator[None]:
    """A process that starts here does not import the caller's script, which would begin the same work again, and never
    hears the terminal's Ctrl-C: its parent tells it when to stop."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if hasattr(signal, "pthread_sigmask") else None
    try:
        yield
    finally:
        sys.modules["__main__"] = script
        if before is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


# -- in the process ---------------------------------------------------------------------------------------------------

_parent: Connection | None = None
"""Where progress goes."""


def _begin(messages: Connection, log: str) -> None:
    """Before anything else is imported: one thread for each library, and what is printed goes into the log."""
    global _parent
    os.environ.update(ONE_THREAD)
    if hasattr(os, "setsid"):
        os.setsid()  # a session of its own, which systems give a fair share of the processor
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(KILLED))  # tasks clean up behind them
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o600)
    os.dup2(file, 1)
    os.dup2(file, 2)
    faulthandler.enable()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _parent = messages


def _end_with_parent() -> None:
    """Nobody waits for the task at hand once the parent is no more, however that ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(0)


def _in_process(work: Work, task: Any) -> dict[str, Any]:
    last_s = 0.0

    def progress(stage: str, share: float) -> None:
        nonlocal last_s
        if _parent is not None and time.monotonic() - last_s > TELL_S:
            last_s = time.monotonic()
            _parent.send((stage, share))

    return outcome_of(work, task, progress)
