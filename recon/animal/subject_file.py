"""One animal's lengths and keypoint offsets, in a file of its own beside the skeleton's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import Field

from recon.base.documents import FileTable, Number, Sigma, unknown, validated
from recon.base.errors import Problem

_Offset = tuple[Number, Number, Number]


class _SubjectFile(FileTable):
    skeleton: str
    title: str
    size_sigma: Sigma
    at_m: dict[str, _Offset]
    keypoint_offset_m: dict[str, _Offset] = Field(default_factory=dict)


def read(table: dict[str, Any], source: str) -> _SubjectFile:
    """Raises InputError with everything that is wrong with the table."""
    return validated(_SubjectFile, table, source)


def problems(animal: _SubjectFile, file: Any, source: str) -> Iterator[Problem]:
    """What keeps a subject from being one of a skeleton, which is a table of `recon.animal.skeleton_file`."""
    if animal.skeleton != file.name:
        yield Problem(source, "skeleton", repr(animal.skeleton), f"{file.name!r}, the skeleton that it is used with")
        return
    markers = [marker.name for marker in file.markers]
    names = [*(segment.name for segment in file.segments[1:]), *markers]
    placed = [(f"at_m.{name}", name) for name in animal.at_m]
    yield from unknown(source, placed, names, f"a segment but the root, or a marker, of {file.name}: ")
    offset = [(f"keypoint_offset_m.{name}", name) for name in animal.keypoint_offset_m]
    yield from unknown(source, offset, markers, f"a marker of {file.name}: ")


def applied(animal: _SubjectFile, file: Any) -> Any:
    """The skeleton with an animal's lengths and keypoint offsets; the root stays."""
    at, offset = animal.at_m, animal.keypoint_offset_m
    segments = tuple(s.model_copy(update={"at_m": at.get(s.name, s.at_m)}) for s in file.segments)
    markers = tuple(
        m.model_copy(
            update={"at_m": at.get(m.name, m.at_m), "keypoint_offset_m": offset.get(m.name, m.keypoint_offset_m)}
        )
        for m in file.markers
    )
    changed = {"segments": (file.segments[0], *segments[1:]), "markers": markers}
    return file.model_copy(update={"title": animal.title, "size_sigma": animal.size_sigma, **changed})
