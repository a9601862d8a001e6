"""What is to be done with the clips of a batch, and what is wrong with their inputs, as far as it can be told without
fitting. `batch.jsonl` in the batch's folder keeps what each clip's results were made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import require_free_folder
from recon.base.manifest import MANIFEST, read_manifest
from recon.workflows.batch.inputs import Clip
from recon.workflows.clip import Unknown, prepare, read_model_and_cameras
from recon.workflows.clip_results import output_files
from recon.workflows.made_from import Record, digest, file_sha256, identity
from recon.workflows.settings import FitSettings, beside

RECORD = "batch.jsonl"
Problems = tuple[Problem, ...]


@dataclass(frozen=True)
class ClipPlan:
    """A clip with what is to be done with it, and why."""

    clip: Clip
    out: Path
    action: Literal["new", "refit", "done"]
    reason: str
    identity: Mapping[str, Any]
    """What its results follow from."""
    row: Mapping[str, Any] | None = None
    """The row of the summary, if the clip is done."""


def plan_batch(clips: Sequence[Clip], out: Path, overwrite: bool = False) -> list[ClipPlan]:
    """What is to be done with each clip, whose results belong into `out / clip.name`.

    Results of the same input files, settings and version are done. Those that a batch made of the same keypoints, or of
    some of the clip's cameras, with other settings are made again. Raises InputError for folders with any other
    results, unless they may be overwritten.
    """
    require_free_folder(out, (), overwrite=True)
    file_sha256.cache_clear()  # files may have changed since the last plan of this process
    record = Record(out / RECORD).rows
    planned, problems = [], []
    for clip in clips:
        try:
            planned.append(_planned(clip, out / clip.name, record.get(clip.name), overwrite))
        except InputError as error:
            problems += error.problems
    refuse(problems)
    return planned


def _planned(clip: Clip, out: Path, row: Mapping[str, Any] | None, overwrite: bool) -> ClipPlan:
    mine = identity(clip.settings)
    if not any((out / name).exists() for name in output_files(out)):
        return ClipPlan(clip, out, "new", "", mine)
    if overwrite:
        return ClipPlan(clip, out, "refit", "--overwrite", mine)
    expected = "a folder without results, or of an earlier batch of this clip; or --overwrite"
    is_own = row is not None and ("made" not in row or row["made"] == digest(out / MANIFEST))
    if row is None or not (is_own or not (out / MANIFEST).exists()):
        raise InputError(Problem(out, "folder", "results that no batch has made", expected))
    theirs = row["identity"]
    before = beside(out.parent, "keypoints", row["keypoints"])
    if not {*before} & {*map(str, clip.settings.keypoints)} and not _keypoints(theirs) & _keypoints(mine):
        raise InputError(Problem(out, "folder", f"results of {', '.join(before)}", expected))
    if "made" not in row:
        return ClipPlan(clip, out, "refit", "not finished before", mine)
    if theirs != mine:
        return ClipPlan(clip, out, "refit", f"changed: {', '.join(_changed_names(theirs, mine))}", mine)
    try:
        whole = not read_manifest(out).changed()
    except InputError:
        whole = False
    plan = ClipPlan(clip, out, "refit", "not complete", mine)
    return replace(plan, action="done", reason="", row=row["row"]) if whole else plan


def _changed_names(theirs: Mapping[str, Any], mine: Mapping[str, Any]) -> list[str]:
    """Names of the input files and settings that differ, and the version."""
    names = []
    for part in ("inputs", "settings"):
        old, new = theirs[part], mine[part]
        names += [name.split()[0] for name in sorted({*old, *new}) if old.get(name) != new.get(name)]
    return list(dict.fromkeys(names)) + (["version of recon"] if theirs["version"] != mine["version"] else [])


def _keypoints(known: Mapping[str, Any]) -> set[str]:
    """Hashes of the keypoint files that could be read."""
    return {sha256 for role, sha256 in known["inputs"].items() if role.split()[0] == "keypoints" and sha256}


# -- what inputs lack ---------------------------------------------------------------------------------------------


def input_problems(clips: Sequence[Clip]) -> list[Problems]:
    """The problems of each clip: everything that its fit would raise before solving."""
    read = _reader()
    return [_problems_of(lambda s=clip.settings: prepare(s, read)) for clip in clips]


def check_shared(clips: Sequence[Clip]) -> None:
    """Raises InputError for problems with cameras, skeletons, subjects and priors that every clip has, be it each with
    a file of its own."""
    read = _reader()
    each = [_problems_of(lambda s=clip.settings: read(s)) for clip in clips]
    refuse(problem for problem, places in repeated(each) if len(places) == len(clips))


def repeated(each: Sequence[Problems]) -> list[tuple[Problem, tuple[int, ...]]]:
    """What several clips have in common is said once, whatever the files are called: each problem, and the places among
    all clips of those that have the same."""
    found: dict[tuple[str, str, str], dict[int, Problem]] = {}
    for place, problems in enumerate(each):
        for problem in problems:
            found.setdefault((problem.field, problem.found, problem.expected), {}).setdefault(place, problem)
    said = []
    for by_place in found.values():
        file, *others = dict.fromkeys(str(problem.file) for problem in by_place.values())
        named = f"{file} and {len(others)} more files" if others else file
        said.append((replace(next(iter(by_place.values())), file=named), tuple(by_place)))
    return said


def _reader() -> Callable[[FitSettings], Unknown]:
    """`read_model_and_cameras` for many clips: what they share is read once."""
    read = cache(read_model_and_cameras)

    def of(settings: FitSettings) -> Unknown:
        # Names of keypoint files choose cameras.
        names = [path.name if settings.camera_name is None else str(i) for i, path in enumerate(settings.keypoints)]
        return read(replace(settings, keypoints=names, individual=None, frames=None))

    return of


def _problems_of(read: Callable[[], Any]) -> Problems:
    try:
        read()
    except InputError as error:
        return error.problems
    return ()
