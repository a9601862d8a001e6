"""Read and write subject files, which have the measured lengths of an animal, and write detector and prior files."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

import numpy as np
import tomli_w
from pydantic import Field

from recon.animal.body import Body, other_side, side_of
from recon.animal.prior import SHAPES, MotionPrior
from recon.base.documents import FileTable, Number, Sigma, named_table, unknown, validated
from recon.base.errors import Problem
from recon.base.files import staged_file, write_bytes

_Offset = tuple[Number, Number, Number]


class _SubjectFile(FileTable):
    skeleton: str
    title: str
    size_sigma: Sigma
    at_m: dict[str, _Offset]
    keypoint_offset_m: dict[str, _Offset] = Field(default_factory=dict)


def read_subject(table: dict[str, Any], source: str) -> _SubjectFile:
    """Return the validated content of a subject file, given the file's table.

    Raises
    ------
    InputError
        If the table cannot be used. The error lists every problem.
    """
    return validated(_SubjectFile, table, source)


class _Row(Protocol):
    """Segment or marker in a skeleton file."""

    @property
    def name(self) -> str: ...
    def model_copy(self, *, update: Mapping[str, Any] | None = None) -> Self: ...


class _SkeletonTable(Protocol):
    """Part of a skeleton file's content (`recon.animal.skeleton_file`) that a subject file replaces."""

    @property
    def name(self) -> str: ...
    @property
    def segments(self) -> Sequence[_Row]: ...
    @property
    def markers(self) -> Sequence[_Row]: ...
    def model_copy(self, *, update: Mapping[str, Any] | None = None) -> Self: ...


_Table = TypeVar("_Table", bound=_SkeletonTable)


def subject_problems(animal: _SubjectFile, file: _SkeletonTable, source: str) -> Iterator[Problem]:
    """Yield a problem for each entry of a subject file that does not fit the skeleton file."""
    if animal.skeleton != file.name:
        yield Problem(source, "skeleton", repr(animal.skeleton), f"{file.name!r}, the skeleton in use")
        return
    markers = [marker.name for marker in file.markers]
    names = [*(segment.name for segment in file.segments[1:]), *markers]
    placed = [(f"at_m.{name}", name) for name in animal.at_m]
    yield from unknown(source, placed, names, f"a segment (except the root) or a marker of {file.name}: ")
    offset = [(f"keypoint_offset_m.{name}", name) for name in animal.keypoint_offset_m]
    yield from unknown(source, offset, markers, f"a marker of {file.name}: ")


def with_subject(animal: _SubjectFile, file: _Table) -> _Table:
    """Return the content of a skeleton file with the lengths and keypoint offsets of a measured animal.

    The offset of the root is not changed.
    """

    def changed(item: _Row) -> _Row:
        measured = {"at_m": animal.at_m, "keypoint_offset_m": animal.keypoint_offset_m}
        return item.model_copy(
            update={field: values[item.name] for field, values in measured.items() if item.name in values}
        )

    root, *segments = file.segments
    tables = {"segments": (root, *map(changed, segments)), "markers": tuple(map(changed, file.markers))}
    return file.model_copy(update={"title": animal.title, "size_sigma": animal.size_sigma, **tables})


def subject_toml(skeleton: str | Path, body: Body, title: str, notes: Sequence[str] = ()) -> str:
    """Return the text of a subject file with a body's lengths and keypoint offsets.

    Each of the `notes` becomes a comment at the beginning of the file.
    """
    raw, _ = named_table(skeleton, "animal/skeletons", "--skeleton", "skeleton")
    placed = {item.name: item.offset_m for item in (*body.tree.segments, *body.tree.markers)}
    names = [item["name"] for item in (*raw["segments"][1:], *raw["markers"])]
    offsets = {marker["name"]: body.keypoint_offset_m.get(marker["name"]) for marker in raw["markers"]}
    plain = {
        "skeleton": raw["name"],
        "title": title,
        "size_sigma": round(body.size_sigma, 4),
        "at_m": {name: [round(x, 4) for x in placed[name]] for name in names if any(placed[name])},
        "keypoint_offset_m": {
            name: [round(x, 4) for x in offset] for name, offset in offsets.items() if offset is not None
        },
    }
    return "".join(f"# {note}\n" for note in notes) + tomli_w.dumps(plain)


def detector_toml(body: Body, title: str, notes: Sequence[str] = ()) -> str:
    """Return the text of a detector file with the keypoint offsets of a body's left side and midline.

    Each of the `notes` becomes a comment at the beginning of the file.
    """
    keypoints = {
        marker: {
            "offset_m": [round(x, 4) for x in body.keypoint_offset_m[marker]],
            "spread_m": round(spread, 4),
            "sigma_m": round(body.keypoint_noise_m.get(marker, body.keypoint_sigma_m), 4),
        }
        for marker, spread in body.keypoint_spread_m.items()
        if marker in body.keypoint_offset_m and (side_of(marker) != "right" or other_side(marker) not in body.markers)
    }
    plain = {"skeleton": body.name, "title": title, "keypoint_sigma_m": round(body.keypoint_sigma_m, 4)}
    return "".join(f"# {note}\n" for note in notes) + tomli_w.dumps(plain | {"keypoints": keypoints})


def save_prior(prior: MotionPrior, path: str | Path) -> None:
    """Write a motion prior to an .npz file without pickles.

    Arrays are stored in single precision, and names and segments as JSON.
    """
    description: dict[str, Any] = {"format": 1, "name": prior.name, "source": prior.source}
    description |= {"angles": list(prior.angles), "segments": [asdict(row) for row in prior.segments]}
    arrays = {name: getattr(prior, name).astype(np.float32) for name in SHAPES}
    made = io.BytesIO()
    np.savez_compressed(made, about=np.array(json.dumps(description)), **arrays)
    with staged_file(Path(path)) as staged:
        write_bytes(staged, made.getvalue())
