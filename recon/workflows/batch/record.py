"""`batch.jsonl` in the folder of a batch: what each clip's results were made from, so that a later run knows them.

It is a table of which lines of JSON are the rows, and the last one of a clip counts. Only the process that runs the
batch writes it. A clip has a row with the state "started" before its fit begins, which makes its folder the batch's
own, and one with the state "finished" when all results are in place: a run that is killed at any moment leaves no clip
that looks finished.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import require_free_folder, staged_file
from recon.base.manifest import MANIFEST, read_manifest
from recon.base.package import version
from recon.workflows.batch.inputs import Clip
from recon.workflows.clip_results import output_files
from recon.workflows.made_from import digest, input_files
from recon.workflows.settings import FitSettings, beside

RECORD = "batch.jsonl"
SCHEMA = {"name": "recon.batch", "version": 3}
Action = Literal["new", "refit", "done"]


@dataclass(frozen=True)
class Planned:
    """A clip with what is to be done with it, and why."""

    clip: Clip
    out: Path
    action: Action
    reason: str
    identity: Mapping[str, Any]
    """See `identity`."""
    row: Mapping[str, Any] | None = None
    """Of the summary, if it is done."""


def plan_batch(clips: Sequence[Clip], out: Path, overwrite: bool = False) -> list[Planned]:
    """What is to be done with each clip, whose results belong into `out / clip.name`.

    Results of the same input files, settings and version are done. Those that a batch made of the same keypoints, or of
    some of the clip's cameras, with other settings are made again. Raises InputError for folders with any other
    results, unless they may be overwritten.
    """
    require_free_folder(out, (), overwrite=True)
    file_sha256.cache_clear()  # files may have changed since the last plan of this process
    record = read_record(out)
    planned, problems = [], []
    for clip in clips:
        try:
            planned.append(_planned(clip, out / clip.name, record.get(clip.name), overwrite))
        except InputError as error:
            problems += error.problems
    refuse(problems)
    return planned


def _planned(clip: Clip, out: Path, record: Mapping[str, Any] | None, overwrite: bool) -> Planned:
    mine = identity(clip.settings)
    there = [name for name in output_files(out) if (out / name).exists()]
    if not there:
        return Planned(clip, out, "new", "", mine)
    if overwrite:
        return Planned(clip, out, "refit", "--overwrite", mine)
    if record is None or (record["state"] == "finished" and not _is_own(out, record)):
        raise InputError(_occupied_problem(out, "results that no batch has made"))
    theirs = record["identity"]
    there_before = beside(out.parent, "keypoints", record["keypoints"])
    same_files = {*there_before} & {str(path) for path in clip.settings.keypoints}
    if not same_files and not _keypoints(theirs) & _keypoints(mine):
        raise InputError(_occupied_problem(out, f"results of {', '.join(there_before)}"))
    if record["state"] != "finished":
        return Planned(clip, out, "refit", "not finished before", mine)
    if theirs != mine:
        return Planned(clip, out, "refit", f"changed: {', '.join(_changed_names(theirs, mine))}", mine)
    if not _is_whole(out):
        return Planned(clip, out, "refit", "not complete", mine)
    return Planned(clip, out, "done", "", mine, record["row"])


def _occupied_problem(out: Path, found: str) -> Problem:
    return Problem(
        out, "folder", found, "a folder without results, or of an earlier batch of this clip; or --overwrite"
    )


def _changed_names(theirs: Mapping[str, Any], mine: Mapping[str, Any]) -> list[str]:
    """Names of the input files and settings that differ, and the version."""
    names = []
    for part in ("inputs", "settings"):
        old, new = theirs[part], mine[part]
        names += [name.split()[0] for name in sorted({*old, *new}) if old.get(name) != new.get(name)]
    return list(dict.fromkeys(names)) + (["version of recon"] if theirs["version"] != mine["version"] else [])


def _keypoints(known: Mapping[str, Any]) -> set[str]:
    """Hashes of the keypoint files that could be read."""
    return {digest for role, digest in known["inputs"].items() if role.split()[0] == "keypoints" and digest}


# -- identity -----------------------------------------------------------------------------------------------------


def identity(settings: FitSettings) -> dict[str, Any]:
    """What the results follow from: the content of the input files by their role, the settings, the version.

    Where a file lies is not part of it, nor are settings that only the other method reads. A file that cannot be read
    has no content, None.
    """
    files = input_files(settings)
    plain = {name: value for name, value in settings.plain().items() if value is not None and name not in files}
    return identity_of(files, plain)


def identity_of(files: Mapping[str, Path], settings: Mapping[str, Any]) -> dict[str, Any]:
    """The same of any files, by their role, and settings."""
    return {
        "inputs": {role: file_sha256(path) for role, path in files.items()},
        "settings": dict(settings),
        "version": version(),
    }


file_sha256 = cache(digest)
"""As a batch asks again and again."""


def short_hash(part: Any) -> str:
    """Sixteen digits for a table."""
    return hashlib.sha256(json.dumps(part, sort_keys=True).encode()).hexdigest()[:16]


def _is_own(out: Path, row: Mapping[str, Any]) -> bool:
    """Whether the results are those that the batch has written: each report has its own times, and so each manifest its
    own hashes. Without a manifest they are what is left of some run."""
    return not (out / MANIFEST).exists() or digest(out / MANIFEST) == row["manifest_sha256"]


def _is_whole(out: Path) -> bool:
    """Whether all files are there and as they were written."""
    try:
        return not read_manifest(out).changed()
    except InputError:
        return False


# -- the table ----------------------------------------------------------------------------------------------------


def read_record(out: Path) -> dict[str, dict[str, Any]]:
    """The last row of each clip, by its name. Rows that are damaged, as a kill or a full disk leaves the last one, and
    those of other versions count as none."""
    try:
        lines = (out / RECORD).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return {}
    rows = {}
    for line in lines:
        try:
            row = json.loads(line)
            if row["schema"] == SCHEMA:
                rows[row["clip"]] = row
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
    return rows


def tidy_record(out: Path) -> None:
    """Leave the last row of each clip, before others come behind it."""
    with staged_file(out / RECORD) as staged:
        staged.write_text("".join(map(_line, read_record(out).values())), encoding="utf-8")


def note_start(out: Path, planned: Planned) -> None:
    """From now on what is in a clip's folder is of the batch in `out`."""
    _append(out, planned, state="started")


def note_end(out: Path, planned: Planned, row: Mapping[str, Any]) -> None:
    """All results of a clip are in place. row: of the summary."""
    _append(out, planned, state="finished", manifest_sha256=digest(planned.out / MANIFEST), row=row)


def _append(out: Path, planned: Planned, **more: Any) -> None:
    row = {"schema": SCHEMA, "clip": planned.clip.name, "keypoints": planned.clip.settings.keypoints_from(out)}
    with (out / RECORD).open("a", encoding="utf-8") as file:
        file.write(_line({**row, "identity": planned.identity, **more}))


def _line(row: Mapping[str, Any]) -> str:
    return json.dumps(row) + "\n"
