"""Recordings for rerun. On a full disk rerun's own writer waits for ever, so that it writes into a pipe, and what comes
out of it is written here: a long recording is never in memory as a whole."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import rerun as rr
import rerun.blueprint as rrb

from recon.base.files import write_bytes

_AT_ONCE = 1 << 20


@contextmanager
def recording(path: Path, layout: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A recording to log to, which is written to `path`; there is none when the block raises.

    Raises OSError that names the path.
    """
    stream = rr.RecordingStream("recon")
    try:
        if not hasattr(os, "mkfifo"):  # Windows
            memory = stream.memory_recording()
            stream.send_blueprint(layout, make_active=False, make_default=True)
            yield stream
            write_bytes(path, memory.drain_as_bytes())
            return
        with TemporaryDirectory() as folder, ThreadPoolExecutor(1) as beside:
            pipe = Path(folder) / "pipe"
            os.mkfifo(pipe)
            source = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
            os.set_blocking(source, True)
            stream.save(pipe)
            written = beside.submit(_copy, source, path)
            try:
                stream.send_blueprint(layout, make_active=False, make_default=True)
                yield stream
            except BaseException:
                stream.disconnect()  # which ends what is read
                written.exception()
                path.unlink(missing_ok=True)
                raise
            stream.disconnect()
            written.result()
    finally:
        stream.disconnect()


def _copy(source: int, path: Path) -> None:
    """All of a pipe into a file. Where that cannot be written, the pipe is read to its end all the same: whoever fills
    it would wait for ever."""
    with open(source, "rb") as pipe:
        try:
            with path.open("wb") as file:
                while content := pipe.read(_AT_ONCE):
                    file.write(content)
        except OSError as error:
            while pipe.read(_AT_ONCE):
                pass
            error.filename = str(path)
            raise
