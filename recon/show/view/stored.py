"""Playbacks that are written already, and what was written later to go with them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk, RrdReader
from rerun.error_utils import RerunWarning

from recon.base.errors import InputError, Problem
from recon.show.recording import APPLICATION


@dataclass(frozen=True)
class Part:
    """A recording, or what was written later to go with it, with one layout. id: of the recording."""

    id: str
    data: Sequence[Chunk]
    layout: rrb.Blueprint

    @classmethod
    def read(cls, path: Path) -> Part:
        """Raises InputError where there is no such file of ours, or only the beginning of one."""
        if not path.is_file():
            raise InputError(_problem(path, "no such file"))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RerunWarning)  # rerun reads a file without its end and only warns
                reader = RrdReader(path)
                recordings, layouts = reader.recordings(), reader.blueprints()
                data, views = ([c for s in kind for c in reader.stream(store=s)] for kind in (recordings, layouts))
        except RerunWarning as warning:
            raise InputError(_problem(path, "a file that has lost its end")) from warning
        except (RuntimeError, ValueError) as error:
            raise InputError(_problem(path, f"a file that rerun cannot read ({error})")) from error
        if [one.application_id for one in (*recordings, *layouts)] != [APPLICATION] * 2:
            raise InputError(_problem(path, "a rerun recording of another kind"))
        return cls(recordings[0].recording_id, data, _AsStored(views))


class _AsStored(rrb.Blueprint):
    """A layout that was written before."""

    def __init__(self, chunks: Sequence[Chunk]) -> None:
        super().__init__(auto_layout=False, auto_views=False)
        self.chunks = chunks

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        stream.send_chunks(self.chunks)


def _problem(path: Path, found: str) -> Problem:
    return Problem(path, "file", found, "a playback that `recon fit` has written")
