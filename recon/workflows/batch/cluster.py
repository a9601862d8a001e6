"""The same as `recon.base.parallel.carry_out` on a Dask cluster, whose workers see the same files at the same paths."""

from __future__ import annotations

import asyncio
import queue
import uuid
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from recon.base.errors import InputError, Problem
from recon.base.package import install_command
from recon.base.parallel import STARTING, Event, Work, outcome_of

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_S = 10.0
TICK_S = 0.5
_STOPPED: set[str] = set()
"""On a Dask worker: the batches that are over."""


class _StoppedError(Exception):
    """The batch that a task belongs to is over."""


def carry_out_on_cluster(
    address: str,
    work: Work,
    tasks: Sequence[tuple[str, Any]],
    tell: Callable[[Event], None],
    *,
    retries: int = 0,
) -> None:
    """All tasks as futures of the scheduler at an address, told of as they end; a Dask worker that dies costs no task,
    as others take them. After an exception the tasks under way are stopped. Raises InputError where there is no
    scheduler, or no Dask here, and where the scheduler goes away."""
    client = _client(address)
    batch = uuid.uuid4().hex
    underway: dict[str, tuple[str, Future]] = {}  # by key
    ended: queue.SimpleQueue[Future] = queue.SimpleQueue()
    try:
        for name, task in tasks:
            key = f"recon-{batch}-{name}"
            future = client.submit(_on_worker, batch, work, task, key=key, retries=retries, pure=False)
            underway[key] = name, future
            tell(Event("progress", name, stage=STARTING))
            future.add_done_callback(ended.put)
        while underway:
            try:
                future = ended.get(timeout=TICK_S)
            except queue.Empty:
                if client.status in ("closed", "closing"):
                    raise _lost("no connection to the scheduler any more") from None
            else:
                name, _ = underway.pop(str(future.key))
                tell(Event("ended", name, outcome=_outcome(future)))
                future.release()  # else it is computed again when the Dask worker that holds it dies
    finally:
        if client.status == "running":
            client.cancel([future for _, future in underway.values()], force=True)
            client.run(_stop, batch, on_error="ignore")
        client.close()


def _client(address: str) -> Client:
    try:
        from distributed import Client, Security
        from distributed.comm.core import connect
    except ImportError:
        expected = f"Dask: {install_command('cluster')}"
        raise InputError(Problem("--scheduler", "package", "no package distributed", expected)) from None

    async def answers() -> None:
        (await connect(address, CONNECT_S, **Security().get_connection_args("client"))).abort()

    try:
        asyncio.run(asyncio.wait_for(answers(), CONNECT_S))  # a client would wait on where a port only accepts
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except Exception as error:  # of addresses, of the network, of certificates that there are not
        silent = f"no answer within {CONNECT_S:g} s" if isinstance(error, TimeoutError) else type(error).__name__
        found = " ".join(str(error).split())[:200] or silent
        expected = "a running Dask scheduler, as in tcp://host:8786"
        if address.startswith("tls://"):
            expected += ", or tls:// with the certificates of Dask's configuration (distributed.comm.tls)"
        raise InputError(Problem("--scheduler", address, found, expected)) from None


def _outcome(future: Future) -> dict[str, Any]:
    if future.status == "finished":
        return future.result()
    if future.status == "error":
        error = future.exception()
        return {"status": "failed", "error": f"{type(error).__name__}: {error}", "attempts": 1}
    raise _lost("tasks that the scheduler has cancelled")


def _lost(found: str) -> InputError:
    expected = "workers until the end: the same command again goes on from here"
    return InputError(Problem("recon batch", "workers", found, expected))


def _stop(batch: str) -> None:
    """On a Dask worker, beside its tasks."""
    _STOPPED.add(batch)


def _on_worker(batch: str, work: Work, task: Any) -> dict[str, Any]:
    def progress(stage: str, share: float) -> None:
        if batch in _STOPPED:
            raise _StoppedError

    return outcome_of(work, task, progress)
