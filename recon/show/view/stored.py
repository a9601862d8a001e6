"""Playbacks that are written already, and what was written later to go with them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.blueprint.components import ContainerKind
from rerun.chunk import Chunk, RrdReader
from rerun.error_utils import RerunWarning

from recon.base.errors import InputError, Problem
from recon.show.view.scene import Array

SAME_TIME_S = 1e-6
"""A time this close to a frame's is the frame's."""


@dataclass(frozen=True)
class Part:
    """A recording, or what was written later to go with it, with one layout. id: of the recording."""

    id: str
    data: Sequence[Chunk]
    layout: _Layout

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
        layout = _Layout.of(views)
        if len(recordings) != 1 or len(layouts) != 1 or layout is None:
            raise InputError(_problem(path, "a rerun recording of another kind"))
        return cls(recordings[0].recording_id, data, layout)


@dataclass(frozen=True)
class Playback(Part):
    """The recording itself. frames (T,), time_s (T,): the frames that it has data of, and when they are."""

    frames: NDArray[np.int64]
    time_s: Array

    @classmethod
    def read(cls, path: Path) -> Playback:
        """Raises InputError where there is no playback, or only part of one."""
        part = Part.read(path)
        timed = next((c for c in part.data if {*c.timeline_names} == {"frame", "time"}), None)
        if timed is None:
            raise InputError(_problem(path, "a rerun recording of another kind"))
        rows = timed.to_record_batch()
        frames, time_ns = (rows.column(name).to_numpy(zero_copy_only=False) for name in ("frame", "time"))
        return cls(part.id, part.data, part.layout, frames, time_ns / np.timedelta64(1, "s"))

    def on_frames(self, time_s: Array) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """Which of the times (N,) are those of frames, and of which frames."""
        nearest = np.searchsorted((self.time_s[1:] + self.time_s[:-1]) / 2, time_s)
        rows = np.flatnonzero(np.abs(self.time_s[nearest] - time_s) < SAME_TIME_S)
        return rows, self.frames[nearest[rows]]


@dataclass(frozen=True)
class _Layout:
    """A stored blueprint. root: path of its outermost container; values: by path and component."""

    chunks: Sequence[Chunk]
    root: str
    values: dict[str, dict[str, list[Any]]]

    @classmethod
    def of(cls, chunks: Sequence[Chunk]) -> _Layout | None:
        """None where nothing is laid out."""
        values: dict[str, dict[str, list[Any]]] = {}
        for chunk in chunks:
            for row in chunk.to_record_batch().to_pylist():
                known = {name: value for name, value in row.items() if isinstance(value, list)}
                values.setdefault(chunk.entity_path.removeprefix("/"), {}).update(known)
        ids = values.get("viewport", {}).get("ViewportBlueprint:root_container")
        root = f"container/{UUID(bytes=bytes(ids[0]))}" if ids else ""
        return cls(chunks, root, values) if values.get(root, {}).get("ContainerBlueprint:contents") else None

    def with_tabs(
        self, name: str, tabs: Sequence[rrb.Container], active: int, time: rrb.TimePanel | None
    ) -> rrb.Blueprint:
        """The last part of the outermost container becomes the first tab, with this name, and `tabs` follow.

        active: the tab in front. time: in place of the stored panel."""
        *others, last = self._contents(self.root)
        root = rrb.Container(
            *(_Kept(path) for path in others),
            rrb.Tabs(rrb.Vertical(_Kept(last), name=name), *tabs, active_tab=active),
            kind=ContainerKind(self._field(self.root, "container_kind")[0]),
            column_shares=self._field(self.root, "col_shares") or None,
            row_shares=self._field(self.root, "row_shares") or None,
            name=None,
        )
        panels = {path for path in self.values if path.endswith("_panel")} - ({"time_panel"} if time else set())
        kept = tuple(f"/{path}/" for path in (*panels, *self._below(*others, last)))
        parts = [root, time] if time else [root]
        return _Restored([c for c in self.chunks if f"{c.entity_path}/".startswith(kept)], *parts)

    def _below(self, *paths: str) -> Iterator[str]:
        """The paths and those of all that their containers hold."""
        for path in paths:
            yield path
            yield from self._below(*self._contents(path))

    def _contents(self, container: str) -> list[str]:
        """Paths of what a container holds, in their order; none of a view."""
        return self._field(container, "contents")

    def _field(self, container: str, name: str) -> list[Any]:
        return self.values.get(container, {}).get(f"ContainerBlueprint:{name}", [])

    def as_stored(self) -> rrb.Blueprint:
        return _Stored(self.chunks)


class _Restored(rrb.Blueprint):
    """A blueprint with parts that are stored."""

    def __init__(self, chunks: Sequence[Chunk], *parts: rrb.Container | rrb.TimePanel) -> None:
        super().__init__(*parts, auto_layout=False, auto_views=False)
        self.chunks = chunks

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        stream.send_chunks(self.chunks)
        super()._log_to_stream(stream)


class _Stored(_Restored):
    """A blueprint that is stored, and nothing more."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        stream.send_chunks(self.chunks)


class _Kept(rrb.Container):
    """A stored part, named where it is placed."""

    def __init__(self, path: str) -> None:
        super().__init__(kind=ContainerKind.Tabs, name=None)
        self.path = path

    def blueprint_path(self) -> str:
        return self.path

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        """Its chunks are sent with those of all stored parts."""


def _problem(path: Path, found: str) -> Problem:
    return Problem(path, "file", found, "a playback that `recon fit` has written")
