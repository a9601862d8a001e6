"""Recordings for rerun, made in memory: on a full disk, rerun's own writer waits for ever."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from recon.base.files import write_bytes

APPLICATION = "recon"


@contextmanager
def recording(path: Path, layout: rrb.Blueprint, part_of: str | None = None) -> Iterator[rr.RecordingStream]:
    """A recording to log to, which is written to `path` when the block ends without an exception.

    part_of: the id of a recording that this one adds to. Raises OSError that names the path.
    """
    stream = rr.RecordingStream(APPLICATION, recording_id=part_of, send_properties=part_of is None)
    try:
        memory = stream.memory_recording()
        stream.send_blueprint(layout, make_active=False, make_default=True)
        yield stream
        write_bytes(path, memory.drain_as_bytes())
    finally:
        stream.disconnect()
