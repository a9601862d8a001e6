"""Run many tasks in parallel, each in its own process, so that a dying process does not affect the others.

The processes run on this machine or on a Dask cluster, whose workers see the same files at the same paths. A pool of
`concurrent.futures` would lose all tasks under way when one of its processes dies, and would report no progress.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import queue
import signal
import sys
import threading
import time
import traceback
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count
from multiprocessing.connection import Connection, wait
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from recon.base.errors import InputError, Problem
from recon.base.memory import collect_rarely, keep_freed_memory
from recon.base.package import install_command
from recon.base.progress import Progress

if TYPE_CHECKING:
    from distributed import Client, Future

Outcome = Mapping[str, Any]
"""Results of a task, keyed by their names: at least "status", and "error" if the task failed."""
_Task = TypeVar("_Task")
Work = Callable[[_Task, Progress], Outcome]
"""Function that does a task, defined at the top level of a module, so that another process can import it."""
Tasks = Sequence[tuple[str, _Task]]
"""Pairs of a task's name and the task."""
STARTING = "starting"
TASKS_PER_PROCESS = 50
"""Number of tasks after which a process is replaced, because rerun frees neither threads nor memory of a recording."""
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMEXPR", "RAYON")} | {
    "OPENCV_FOR_THREADS_NUM": "1"
}
KILLED = 128 + signal.SIGTERM
STOP_S = 3.0
"""Time in seconds that a process has to clean up before it is killed."""
TICK_S = 0.1
LOG_BYTES = 20_000


@dataclass(frozen=True)
class Event:
    """Progress or end of a task (on a cluster, only the beginning or the end)."""

    kind: Literal["progress", "ended"]
    name: str
    """Name of the task."""
    pid: int | None = None
    """Process ID of the process in which the task runs; None on a cluster."""
    stage: str = ""
    share: float = 0.0
    """Fraction of the work that is done, 0 to 1."""
    outcome: Outcome = field(default_factory=dict)
    """Outcome of a task that has ended; empty before."""


EventCallback = Callable[[Event], None]
"""Function that is called with each event."""


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def outcome_of(work: Work[_Task], task: _Task, progress: Progress) -> dict[str, Any]:
    """Run a task and return its outcome, with the status "failed" after an InputError or OSError.

    Other exceptions are not caught.
    """
    began = time.perf_counter()
    try:
        outcome = work(task, progress)
    except (InputError, OSError) as error:
        text = str(error)
        if isinstance(error, OSError) and error.filename:
            text = f"{error.filename}: {error.strerror}"
        outcome = {"status": "failed", "error": text}
    return {"seconds": round(time.perf_counter() - began, 3), "attempts": 1, **outcome}


def run_tasks(
    work: Work[_Task], tasks: Tasks[_Task], on_event: EventCallback, jobs: int | None = None, retries: int = 0
) -> None:
    """Run tasks in processes on this machine with one thread each, and report their events to `on_event`.

    After an exception, such as Ctrl-C, the processes are stopped, which takes seconds, and tasks that have already
    ended are reported.

    Parameters
    ----------
    work
        Function that does a task.
    tasks
        The tasks with their names.
    on_event
        Function that is called with each event.
    jobs
        Number of tasks at the same time, by default one for each core.
    retries
        Number of further attempts at a task whose process died, or that raised an exception other than InputError and
        OSError. After the last attempt the outcome is a failure, with the end of the process's output as "log".

    Raises
    ------
    InputError
        If processes cannot be started.
    """
    waiting = deque((name, task, 1) for name, task in tasks)
    underway: dict[Any, tuple[_Process, str, _Task, int]] = {}
    processes: list[_Process] = []
    numbers = count()

    def begin(process: _Process | None, name: str, task: _Task, attempt: int) -> None:
        if process is None or process.tasks_left == 0:
            if process is not None:
                process.channel.close()  # this ends the process
                processes.remove(process)  # close its files, since any number of processes may follow
            process = _Process(Path(logs) / str(next(numbers)))
            processes.append(process)
        process.give(work, task)
        underway[process.channel] = process, name, task, attempt
        on_event(Event("progress", name, process.pid, STARTING))

    with TemporaryDirectory(ignore_cleanup_errors=True) as logs:
        try:
            for _ in range(min(jobs or available_cores(), len(tasks))):
                begin(None, *waiting.popleft())
            while underway:
                for channel in wait(list(underway), TICK_S):
                    process, name, task, attempt = underway[channel]
                    message = process.receive()
                    if isinstance(message, tuple):
                        on_event(Event("progress", name, process.pid, *message))
                        continue
                    del underway[channel]
                    if "log" in message and attempt <= retries:
                        begin(process, name, task, attempt + 1)
                        continue
                    on_event(Event("ended", name, outcome={**message, "attempts": attempt}))
                    if waiting:
                        begin(process, *waiting.popleft())
        finally:
            for process in processes:
                process.stop()
            until_s = time.monotonic() + STOP_S
            for process in processes:
                process.join(until_s)
            for process, name, _, attempt in underway.values():
                outcome = process.outcome()
                if "log" not in outcome:
                    on_event(Event("ended", name, outcome={**outcome, "attempts": attempt}))


class _Process:
    """Process that does one task after the other, at most `TASKS_PER_PROCESS`, until its channel is closed."""

    def __init__(self, log: Path) -> None:
        context = multiprocessing.get_context("spawn")  # other start methods do not work with threads
        self.channel, child_channel = context.Pipe()
        self._process, self._log = context.Process(target=_take_tasks, args=(child_channel, log)), log
        try:
            with _isolated_start():
                self._process.start()
        except OSError as error:
            raise InputError(
                Problem("processes", "start", str(error), "a system that can start another process")
            ) from None
        child_channel.close()
        self.pid, self.tasks_left = self._process.pid, TASKS_PER_PROCESS

    def give(self, work: Work[_Task], task: _Task) -> None:
        """Begin a task, whose events come through the channel."""
        self.tasks_left -= 1
        with suppress(OSError):  # the process is dead, which `receive` will report
            self.channel.send((work, task))

    def receive(self) -> tuple[str, float] | dict[str, Any]:
        """Return the task's next progress report or its outcome, even if the process died."""
        with suppress(EOFError, OSError):
            return self.channel.recv()
        self._process.join()
        self.tasks_left = 0
        text = self._log.read_bytes()[-LOG_BYTES:] if self._log.exists() else b""
        code, log = self._process.exitcode or 0, text.decode("utf-8", errors="replace")
        if code < 0:
            memory = ", as the system does when memory runs out" if -code == getattr(signal, "SIGKILL", 9) else ""
            return _failure(f"was killed ({signal.Signals(-code).name}{memory})", log)
        return _failure(f"crashed: {(log.strip().splitlines() or ['no output'])[-1]}", log)

    def outcome(self) -> dict[str, Any]:
        """Return the task's outcome, and skip progress reports in the channel."""
        while isinstance(message := self.receive(), tuple):
            pass
        return message

    def stop(self) -> None:
        """Stop the task, which first cleans up, or end the process if it waits for a task."""
        self._process.terminate()

    def join(self, until_s: float) -> None:
        self._process.join(max(0.0, until_s - time.monotonic()))
        self._process.kill()
        self._process.join()


def _failure(reason: str, log: str) -> dict[str, Any]:
    return {"status": "failed", "error": f"the worker {reason}", "log": log}


@contextmanager
def _isolated_start() -> Iterator[None]:
    """Start processes that neither import the caller's script nor receive the terminal's Ctrl-C.

    The script would begin the same work again, and the parent stops the processes itself.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    signal_mask = (
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if hasattr(signal, "pthread_sigmask") else None
    )
    try:
        yield
    finally:
        sys.modules["__main__"] = script
        if signal_mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, signal_mask)


def _take_tasks(channel: Connection, log: Path) -> None:
    """Run one task after the other, until the parent closes the channel.

    Each library gets one thread before any is imported. Printed text goes into the log.
    """
    os.environ.update(ONE_THREAD)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(KILLED))  # so that tasks clean up
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o600)
    os.dup2(file, 1)
    os.dup2(file, 2)
    faulthandler.enable()
    keep_freed_memory()
    collect_rarely()
    threading.Thread(target=_end_with_parent, daemon=True).start()

    with suppress(EOFError):
        while True:
            work, task = channel.recv()
            try:
                channel.send(outcome_of(work, task, lambda *progress: channel.send(progress)))
            except Exception as error:
                channel.send(_failure(f"crashed: {type(error).__name__}: {error}", traceback.format_exc()))


def _end_with_parent() -> None:
    """End this process when its parent has ended, since the result would not be used."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(0)


CONNECT_S = 10.0
_STOPPED: set[str] = set()
"""Names of batches that have ended, in the process of a Dask worker."""


class _StoppedError(Exception):
    """Error that stops a task because its batch has ended."""


def run_tasks_on_cluster(
    address: str, work: Work[_Task], tasks: Tasks[_Task], on_event: EventCallback, retries: int = 0
) -> None:
    """Run all tasks as futures of the Dask scheduler at an address, and report the end of each.

    No task is lost if a Dask worker dies, since other workers take over its tasks. After an exception the tasks under
    way are stopped.

    Raises
    ------
    InputError
        If there is no scheduler, if it stops, or if Dask is not installed.
    """
    client = _client(address)
    batch = uuid.uuid4().hex
    underway: dict[str, tuple[str, Future]] = {}  # name and future of each task, by the future's key
    ended: queue.SimpleQueue[Future] = queue.SimpleQueue()
    try:
        for name, task in tasks:
            key = f"recon-{batch}-{name}"
            future = client.submit(_on_worker, batch, work, task, key=key, retries=retries, pure=False)
            underway[key] = name, future
            on_event(Event("progress", name, stage=STARTING))
            future.add_done_callback(ended.put)
        while underway:
            try:
                future = ended.get(timeout=TICK_S)
            except queue.Empty:
                if client.status in ("closed", "closing"):
                    raise _lost("a lost connection to the scheduler") from None
            else:
                name, _ = underway.pop(str(future.key))
                on_event(Event("ended", name, outcome=_outcome(future)))
                future.release()  # otherwise it would be computed again if the Dask worker that holds it dies
    finally:
        if client.status == "running":
            client.cancel([future for _, future in underway.values()], force=True)
            client.run(_stop, batch, on_error="ignore")
        client.close()


def _client(address: str) -> Client:
    import asyncio  # slow to import

    try:
        from distributed import Client, Security
        from distributed.comm.core import connect
    except ImportError:
        expected = f"Dask: {install_command('cluster')}"
        raise InputError(Problem("--scheduler", "package", "no package distributed", expected)) from None

    async def connect_once() -> None:
        (await connect(address, CONNECT_S, **Security().get_connection_args("client"))).abort()

    try:
        # a client would wait forever at a port that only accepts connections
        asyncio.run(asyncio.wait_for(connect_once(), CONNECT_S))
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except Exception as error:  # wrong addresses, network failures, missing certificates
        silent = f"no answer within {CONNECT_S:g} s" if isinstance(error, TimeoutError) else type(error).__name__
        message = " ".join(str(error).split())[:200] or silent
        expected = "a running Dask scheduler, such as tcp://host:8786"
        if address.startswith("tls://"):
            expected += ", or tls:// with the certificates of Dask's configuration (distributed.comm.tls)"
        raise InputError(Problem("--scheduler", address, message, expected)) from None


def _outcome(future: Future) -> dict[str, Any]:
    if future.status == "finished":
        return future.result()
    if future.status == "error":
        error = future.exception()
        return {"status": "failed", "error": f"{type(error).__name__}: {error}", "attempts": 1}
    raise _lost("tasks that the scheduler has cancelled")


def _lost(reason: str) -> InputError:
    expected = "workers that run until the end: run the same command again to continue from here"
    return InputError(Problem("recon batch", "workers", reason, expected))


def _stop(batch: str) -> None:
    """Mark a batch as ended in this process of a Dask worker."""
    _STOPPED.add(batch)


def _on_worker(batch: str, work: Work[_Task], task: _Task) -> dict[str, Any]:
    def progress(stage: str, share: float) -> None:
        if batch in _STOPPED:
            raise _StoppedError

    keep_freed_memory()
    return outcome_of(work, task, progress)
