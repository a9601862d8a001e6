"""`batch.json` in the folder of each clip: what its results were made from, so that a later run knows them again.

It is written first, with the state "started", which makes the folder the batch's own, and again when all results are
in place, with the state "finished". A run that is killed at any moment therefore leaves no folder that looks finished.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from recon.base.errors import InputError, Problem
from recon.base.files import require_free_folder, staged_file
from recon.base.manifest import MANIFEST, read_manifest
from recon.base.package import version
from recon.workflows.batch.inputs import Clip
from recon.workflows.clip import output_files
from recon.workflows.made_from import digest, input_files
from recon.workflows.settings import FitSettings, beside

RECORD = "batch.json"
CRASH_LOG = "crash.log"
SCHEMA = {"name": "recon.batch.clip", "version": 2}
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
    planned, problems = [], []
    for clip in clips:
        try:
            planned.append(_planned(clip, out / clip.name, overwrite))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    return planned


def _planned(clip: Clip, out: Path, overwrite: bool) -> Planned:
    mine = identity(clip.settings)
    record = read_record(out)
    there = [name for name in output_files(out) if (out / name).exists()]
    if not there:
        return Planned(clip, out, "new", "", mine)
    if overwrite:
        return Planned(clip, out, "refit", "--overwrite", mine)
    if record is None or (record["state"] == "finished" and not _is_own(out, record)):
        raise InputError(_occupied_problem(out, "results that no batch has made"))
    theirs = record["identity"]
    there_before = beside(out, "keypoints", record["keypoints"].split(", "))
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


# -- the file -----------------------------------------------------------------------------------------------------


def read_record(out: Path) -> dict[str, Any] | None:
    try:
        record = json.loads((out / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) and record.get("schema") == SCHEMA else None


def start_record(out: Path, run: str, settings: FitSettings, known: Mapping[str, Any]) -> int:
    """Make a clip's folder the batch's own; which attempt of this run it is, 1 or more."""
    before = read_record(out)
    attempt = before["attempt"] + 1 if before is not None and before["run"] == run else 1
    _write(out, "started", run, attempt, settings, known)
    return attempt


def finish_record(
    out: Path, run: str, attempt: int, settings: FitSettings, known: Mapping[str, Any], row: Mapping[str, Any]
) -> None:
    """When all results are in place."""
    (out / CRASH_LOG).unlink(missing_ok=True)
    results = {"manifest_sha256": digest(out / MANIFEST), "row": row}
    _write(out, "finished", run, attempt, settings, known, results)


def drop_record(out: Path) -> None:
    """After a fit that failed: the record goes, unless there are older results."""
    if not any((out / name).exists() for name in output_files(out)):
        (out / RECORD).unlink(missing_ok=True)


def _is_own(out: Path, record: Mapping[str, Any]) -> bool:
    """Whether the results are those that the batch has written: each report has its own times, and so each manifest its
    own hashes. Without a manifest they are what is left of some run."""
    return not (out / MANIFEST).exists() or digest(out / MANIFEST) == record["manifest_sha256"]


def _is_whole(out: Path) -> bool:
    """Whether all files are there and as they were written."""
    try:
        return not read_manifest(out).changed()
    except InputError:
        return False


def _write(
    out: Path,
    state: str,
    run: str,
    attempt: int,
    settings: FitSettings,
    known: Mapping[str, Any],
    results: Mapping[str, Any] | None = None,
) -> None:
    head = {"schema": SCHEMA, "state": state, "run": run, "attempt": attempt}
    head["keypoints"] = ", ".join(settings.keypoints_from(out))
    text = json.dumps({**head, "identity": known, **(results or {})}, indent=1)
    with staged_file(out / RECORD) as staged:
        staged.write_text(text + "\n", encoding="utf-8")
