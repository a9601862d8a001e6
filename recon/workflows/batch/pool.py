"""Where the clips of a batch are fitted: in processes of this machine, or on a Dask cluster."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol

from recon.base.errors import InputError, Problem
from recon.base.package import install_command
from recon.workflows.batch.worker import Worker, WorkerDied

if TYPE_CHECKING:
    from distributed import Future
    from distributed import Worker as DaskWorker

CONNECT_S = 10.0
TICK_S = 0.5
Task = Mapping[str, Any]
"""Of `recon.workflows.batch.worker.task_of`."""


@dataclass(frozen=True)
class Event:
    """What happened to a clip. On a cluster nothing is heard of its progress."""

    kind: Literal["progress", "ended"]
    clip: str
    pid: int | None = None
    """The process that it runs in."""
    stage: str = ""
    share: float = 0.0
    """Of it all that is done."""
    outcome: Mapping[str, Any] = field(default_factory=dict)
    """Columns of the summary, of one that ended."""


class Pool(Protocol):
    def start(self, tasks: Sequence[tuple[str, Task]], tell: Callable[[Event], None]) -> None:
        """Begin to fit tasks, each with its clip's name; tell is called from other threads."""
        ...

    def fault(self) -> str | None:
        """Why some clips will have no event "ended", if so."""
        ...

    def stop(self) -> None:
        """Stop what is under way and free everything."""
        ...


def carry_out(
    pool: Pool,
    tasks: Sequence[tuple[str, Task]],
    tell: Callable[[Event], None],
    now_and_then: Callable[[], None] = lambda: None,
) -> None:
    """All tasks, each told when it ends, whatever comes in between. Raises InputError where workers go away."""
    events: queue.SimpleQueue[Event] = queue.SimpleQueue()
    left = len(tasks)
    try:
        pool.start(tasks, events.put)
        while left:
            try:
                event = events.get(timeout=TICK_S)
            except queue.Empty:
                fault = pool.fault()
                if fault is not None:
                    expected = "workers until the end: the same command again goes on from here"
                    raise InputError(Problem("recon batch", "workers", fault, expected)) from None
            else:
                left -= event.kind == "ended"
                tell(event)
            now_and_then()
    finally:
        try:
            pool.stop()
        finally:
            while not events.empty():
                event = events.get()
                if event.kind == "ended":
                    tell(event)


class LocalPool:
    """One thread for each worker process; the threads only wait."""

    def __init__(self, jobs: int, retries: int) -> None:
        self._retries = retries
        self._workers = [Worker() for _ in range(jobs)]
        self._threads: list[threading.Thread] = []
        self._fault: str | None = None

    def start(self, tasks: Sequence[tuple[str, Task]], tell: Callable[[Event], None]) -> None:
        waiting: queue.SimpleQueue[tuple[str, Task]] = queue.SimpleQueue()
        for task in tasks:
            waiting.put(task)
        for worker in self._workers[: len(tasks)]:
            thread = threading.Thread(target=self._serve, args=(worker, waiting, tell), daemon=True)
            self._threads.append(thread)
            thread.start()

    def fault(self) -> str | None:
        return self._fault

    def stop(self) -> None:
        stopping = [threading.Thread(target=worker.stop) for worker in self._workers]
        for thread in stopping:
            thread.start()
        for thread in (*stopping, *self._threads):
            thread.join()

    def _serve(
        self, worker: Worker, waiting: queue.SimpleQueue[tuple[str, Task]], tell: Callable[[Event], None]
    ) -> None:
        try:
            while True:
                clip, task = waiting.get_nowait()

                def progress(stage: str, share: float, clip: str = clip) -> None:
                    tell(Event("progress", clip, worker.pid, stage, share))

                tell(Event("ended", clip, outcome=worker.fit(task, self._retries, progress)))
        except (queue.Empty, WorkerDied):
            pass
        except OSError as error:
            self._fault = f"no process that could be started: {error}"
        finally:
            worker.end()


class DaskPool:
    """One task a clip on a running cluster, whose workers must see the same files under the same paths.

    Each thread of a Dask worker has a worker process of its own, as on one machine: threads would share one
    interpreter, and a crash would take the Dask worker with it. When a Dask worker dies, its processes end, and the
    scheduler gives its clips to others.
    """

    def __init__(self, address: str, retries: int, run: str) -> None:
        """run: which run of the batch it is. Raises InputError where there is no scheduler, or no Dask here."""
        try:
            from distributed import Client
        except ImportError:
            expected = f"Dask: {install_command('cluster')}"
            raise InputError(Problem("--scheduler", "package", "no package distributed", expected)) from None
        try:
            self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            expected = "a running Dask scheduler, as in tcp://host:8786"
            raise InputError(Problem("--scheduler", address, str(error), expected)) from None
        self._retries, self._run = retries, run
        self._futures: dict[str, Future] = {}
        self._cancelled = False

    def start(self, tasks: Sequence[tuple[str, Task]], tell: Callable[[Event], None]) -> None:
        def end(future: Future, clip: str) -> None:
            if future.status == "finished":
                tell(Event("ended", clip, outcome=future.result()))
                future.release()  # else it is computed again when the Dask worker that holds it dies
            elif future.status == "error":
                error = future.exception()
                message = f"{type(error).__name__}: {error}"
                tell(Event("ended", clip, outcome={"status": "failed", "error": message}))
            else:
                self._cancelled = True

        for clip, task in tasks:
            key = f"recon-{self._run}-{clip}"
            future = self._client.submit(fit_on_cluster, dict(task), self._retries, key=key, pure=False)
            self._futures[clip] = future
            future.add_done_callback(lambda future, clip=clip: end(future, clip))

    def fault(self) -> str | None:
        if self._client.status in ("closed", "closing"):
            return "no connection to the scheduler any more"
        return "clips that the scheduler has cancelled" if self._cancelled else None

    def stop(self) -> None:
        if self._client.status == "running":
            self._client.cancel([*self._futures.values()], force=True)
            self._client.run(stop_on_cluster, self._run, on_error="ignore")
        self._client.close()


class _Fleet:
    """The worker processes of one batch on one Dask worker: all, and those without a clip."""

    def __init__(self) -> None:
        self.all: list[Worker] = []
        self.idle: queue.SimpleQueue[Worker] = queue.SimpleQueue()

    def take(self) -> Worker:
        try:
            return self.idle.get_nowait()
        except queue.Empty:
            self.all.append(Worker())
            return self.all[-1]

    def end_idle(self) -> None:
        while not self.idle.empty():
            self.idle.get().end()


def fit_on_cluster(task: dict[str, Any], retries: int) -> dict[str, Any]:
    """A task of a Dask worker, in one of its threads."""
    from distributed import get_worker

    fleets = _fleets(get_worker())
    if task["run"] not in fleets:
        for other in list(fleets.values()):  # of a batch that was killed, or that starts its processes again
            other.end_idle()
    fleet = fleets.setdefault(task["run"], _Fleet())
    worker = fleet.take()
    try:
        outcome = worker.fit(task, retries, lambda stage, share: None)
    except WorkerDied:
        worker.end()
        raise
    fleet.idle.put(worker)
    return outcome


def stop_on_cluster(run: str, dask_worker: DaskWorker) -> None:
    """On a Dask worker, which `Client.run` passes by this name, when a batch is over."""
    fleet = _fleets(dask_worker).pop(run, None)
    if fleet is not None:
        for worker in fleet.all:
            worker.stop()
        fleet.end_idle()


def _fleets(dask_worker: DaskWorker) -> dict[str, _Fleet]:
    """By batch; they live as long as the Dask worker."""
    return vars(dask_worker).setdefault("recon_fleets", {})
