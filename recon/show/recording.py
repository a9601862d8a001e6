"""Recordings for rerun, whose own writer waits for ever on a full disk: they are written by `write_bytes` instead."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from recon.base.files import write_bytes


@contextmanager
def recording(path: Path, layout: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A recording to log to, which is written to `path`; there is none when the block raises.

    Raises OSError that names the path.
    """
    stream = rr.RecordingStream("recon")
    try:
        memory = stream.memory_recording()
        stream.send_blueprint(layout, make_active=False, make_default=True)
        yield stream
        write_bytes(path, memory.drain_as_bytes())
    finally:
        stream.disconnect()
