"""Write a clip's folder, and tell later whether its results are still those of the same inputs.

All outputs of a motion appear in the folder, or none. A record has what results were made from: input files by their
content, settings and the version.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter

from recon.animal.prior import load_prior
from recon.api.clip import fit_clip
from recon.api.clip_cameras import read_clip_cameras
from recon.api.settings import SETTINGS, FitSettings, with_paths
from recon.base.documents import parse_json, read_toml, validated
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.file_names import existing_path
from recon.base.files import MANIFEST, read_manifest, sha256_of, write_text
from recon.base.locks import sole_writer
from recon.base.outputs import Output
from recon.base.package import version
from recon.base.progress import Progress, silent
from recon.base.settings import on_command_line
from recon.clip import views_of
from recon.fit.clip_problem import ClipProblem
from recon.fit.motion import Motion
from recon.fit.motion_forms import MOTION
from recon.fit.result import TrajectorySolution
from recon.show.plain import write_report
from recon.show.report import build_report
from recon.show.tables import CLIP_OUTPUTS, REPROJECTION, camera_files, of_any_camera, write_tables

T = TypeVar("T")
FIT = "fit"
"""Kind of a fit's files."""
CONFIG = "config.toml"
SCHEMA = {"name": "recon.record", "version": 1}
AS_THEY_WERE = "the prior and the settings of the fit, as they were: fit the clip again"
REFINED_CAMERAS = "cameras.toml"
"""Camera file with the poses that a fit refined."""
OUTPUT_FILES = (*CLIP_OUTPUTS, REPROJECTION, MOTION, "report.json", "motion.rrd", CONFIG, MANIFEST)
"""Every file that a clip of one camera gets. With several cameras there is a `REPROJECTION` for each."""


def output_files(settings: FitSettings, out: Path) -> list[str]:
    """Return the names of the files that a fit with these settings writes, of tables by camera those that are there."""
    tables: list[str] = []
    if of_any_camera(out) or (out / REPROJECTION).exists():
        with suppress(InputError):  # the fit raises it, too
            tables = camera_files([camera.name for camera, _ in read_clip_cameras(settings)])
    refined = [REFINED_CAMERAS] if settings.seeks_cameras else []
    return [*(name for name in OUTPUT_FILES if name != REPROJECTION), *tables, *refined]


def output_of(settings: FitSettings, out: Path, overwrite: bool) -> Output:
    """Return what a fit may write into its folder.

    A config.toml that the settings come from is no input: it may be replaced by one with the same settings.
    """
    inputs = tuple(input_files(settings).values())
    return Output(out, FIT, overwrite, inputs, has_manifest=True, mark=MOTION)


_Digests = Mapping[str, str | None]


def write_clip(
    motion: Motion, settings: FitSettings, out: Path, solve_s: float | None = None, sha256: _Digests | None = None
) -> dict[str, Any]:
    """Write every output of a clip into a folder, all or none, and return the report.

    Results that an earlier fit wrote there are replaced, unless somebody changed them since.

    Parameters
    ----------
    motion
        As `fit_clip` returned it.
    settings
        Those of the fit.
    out
        The folder, which is made if need be.
    solve_s
        How long the fit took, if it is known.
    sha256
        Of the input files by their role; by default they are read again.

    Raises
    ------
    InputError
        The folder has a file of a name to be written that no fit wrote, or that was changed since.
    """
    from recon.show import view  # rerun is slow to import

    if sha256 is None:
        sha256 = input_digests(settings)
    known = {role: sha256_hex for role, sha256_hex in sha256.items() if sha256_hex is not None}
    timing_s = {} if solve_s is None else {"solve_s": solve_s}
    motion = replace(motion, settings=settings.plain(out), timing_s=timing_s)
    report = build_report(motion)
    with output_of(settings, out, overwrite=True).staged() as folder:
        motion.save(folder)
        write_tables(motion, folder)
        write_report(report, folder / "report.json")
        (folder / CONFIG).write_text(settings.to_toml(out, known), encoding="utf-8")
        view.write(motion, folder / "motion.rrd")
        if settings.seeks_cameras:
            from recon.io.camera_files import write_cameras

            write_cameras([source.camera for source in motion.sources], folder / REFINED_CAMERAS)
    return report


def run_clip(settings: FitSettings, out: Path, overwrite: bool = False, progress: Progress = silent) -> dict[str, Any]:
    """Reconstruct a clip, write its folder as `recon fit` does, and return the report.

    Raises
    ------
    InputError
        Before any work, also if `out` holds results and may not be overwritten, or another process is writing to it.
    """
    with sole_writer(out):
        output_of(settings, out, overwrite).require(output_files(settings, out))
        return fit_into(out, settings, progress)


def fit_into(out: Path, settings: FitSettings, progress: Progress = silent) -> dict[str, Any]:
    """Reconstruct a clip, write its folder in place of an earlier fit's files, and return the report.

    Raises InputError also where an input file changes meanwhile: nobody could say which of its contents was fitted.
    """
    start, sha256 = time.perf_counter(), input_digests(settings)
    motion = fit_clip(settings, progress)
    require_same_inputs(settings, sha256)
    solve_s = time.perf_counter() - start
    progress("writing", 1.0)
    return write_clip(motion, settings, out, solve_s, sha256)


# -- what results were made from --------------------------------------------------------------------------------------


def input_files(settings: FitSettings) -> dict[str, Path]:
    """Return the input files by the setting that names them; built-in skeletons, priors and others are no files."""
    first, *more_paths = settings.keypoints
    files = {"keypoints": first} | {f"keypoints {i}": path for i, path in enumerate(more_paths, start=2)}
    files |= {f"camera {i}" if i > 1 else "camera": path for i, path in enumerate(settings.camera or (), start=1)}
    if settings.camera_track:
        from recon.io.camera_track import track_files

        tracks = [path for track in settings.camera_track for path in track_files(track)]
        files |= {f"camera_track {i}" if i else "camera_track": path for i, path in enumerate(tracks)}
    for role in ("skeleton", "subject", "detector", "prior", "rename", "corrections"):
        name = getattr(settings, role)
        if name is not None and Path(name).is_absolute():
            files[role] = Path(name)
    return files


def input_digests(settings: FitSettings) -> dict[str, str | None]:
    """Return the digest of each input file by its role; None where it cannot be read."""
    return {role: file_sha256(path) for role, path in input_files(settings).items()}


def require_same_inputs(settings: FitSettings, sha256: _Digests) -> None:
    """Raise InputError for input files that have another content than that of these digests."""
    changed = [path for role, path in input_files(settings).items() if file_sha256(path) != sha256[role]]
    expected = "a file that nobody changes while it is fitted: fit the clip again"
    raise_problems(Problem(path, "content", "another than when the fit began", expected) for path in changed)


def file_sha256(path: Path) -> str | None:
    """Return the digest of a file's content, None where it cannot be read.

    The digest is remembered as long as the file's size and times stay, as a batch asks again and again.
    """
    try:
        state = path.stat()
        return _sha256_of(path, (state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns))
    except OSError:
        return None


@cache
def _sha256_of(path: Path, state: tuple[int, ...]) -> str:
    return sha256_of(path)


def digest(path: Path) -> str | None:
    """Return the digest of a file's content, read now; None where it cannot be read."""
    try:
        return sha256_of(path)
    except OSError:
        return None


def identity(settings: FitSettings) -> dict[str, Any]:
    """Return what the results of a fit follow from: digests of the input files, settings and version.

    The place of a file is not part of it, nor are settings that the method does not read. The digest of a file that
    cannot be read is None.
    """
    files = input_files(settings)
    plain = {name: value for name, value in settings.plain().items() if value is not None and name not in files}
    return identity_of(files, plain)


def identity_of(files: Mapping[str, Path], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the identity of results that were made from files, by their role, with settings."""
    inputs = {role: file_sha256(path) for role, path in files.items()}
    return {"inputs": inputs, "settings": dict(settings), "version": version()}


@dataclass(frozen=True)
class _Identity:
    inputs: dict[str, str | None]
    settings: dict[str, Any]
    version: str


@dataclass(frozen=True)
class _Line:
    """A line of a record.

    The fields below `identity` are there once the part has ended; the last two as they are noted.
    """

    part: str
    identity: _Identity
    files: dict[str, str] = field(default_factory=dict)
    keypoints: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    row: dict[str, Any] = field(default_factory=dict)


_BEGIN = '{"'
"""Beginning of every line of a record."""


class Record:
    """What each part of a work was made from, and what became of it.

    The file has lines of JSON, of which the last of a part counts, and only one process writes it. A part has a row
    before it begins and another one, with the files that it wrote, once it has ended, so that a run that is killed at
    any moment does not look finished. Rows of other versions count as none, and so does the last one if it is cut off,
    as by a full disk.

    Raises
    ------
    InputError
        For any other row that a record cannot have, and for a link: the file may be a user's.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, dict[str, Any]] = {}
        if path.is_symlink():
            raise InputError(Problem(path, "file", "a link, which is not followed", "no such file, or a record"))
        try:
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return
        for number, line in enumerate(lines, 1):
            origin = f"{path}, line {number}"
            try:
                row = parse_json(line, origin)
            except InputError:
                if number < len(lines) or not (line.startswith(_BEGIN) or _BEGIN.startswith(line)):
                    raise
                break
            if not isinstance(row, dict) or row.get("schema", SCHEMA) == SCHEMA:
                validated(_Line, row, origin)
                self.rows[row["part"]] = row

    def tidy(self) -> None:
        """Leave only the last row of each part, before others are added."""
        write_text(self.path, "".join(json.dumps(row) + "\n" for row in self.rows.values()))

    def note(self, part: str, made_from: Mapping[str, Any], **details: Any) -> None:
        """Note that a part begins, or has ended with `files`, the digests as `digests` gives them."""
        self.rows[part] = {"schema": SCHEMA, "part": part, "identity": made_from, **details}
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(self.rows[part]) + "\n")

    def look(self, part: str, made_from: Mapping[str, Any], folder: Path) -> tuple[str, list[Path]]:
        """Return why a part has to be made, empty if it is up to date, and its files that are missing or changed.

        A manifest among the files answers for those that it lists.
        """
        row = self.rows.get(part)
        if row is None:
            return "new", []
        if "files" not in row:
            return "not finished before", []
        changed = [folder / name for name, sha256 in row["files"].items() if digest(folder / name) != sha256]
        if row["identity"] != made_from:
            return f"changed: {', '.join(_changed_names(row['identity'], made_from))}", changed
        if MANIFEST in row["files"] and not changed:
            changed = [Path(problem.file) for problem in read_manifest(folder).changed()]
        return "not complete" if changed else "", changed


def digests(paths: Iterable[Path], folder: Path) -> dict[str, str]:
    """Return the digests of files in a folder, by their path from there."""
    return {path.absolute().relative_to(folder.absolute()).as_posix(): sha256_of(path) for path in paths}


def _changed_names(theirs: Mapping[str, Any], mine: Mapping[str, Any]) -> list[str]:
    """Return the names of input files and settings that differ, and of the version."""
    names = []
    for part in ("inputs", "settings"):
        old, new = theirs[part], mine[part]
        names += [name.split()[0] for name in sorted({*old, *new}) if old.get(name) != new.get(name)]
    return list(dict.fromkeys(names)) + (["version of recon"] if theirs["version"] != mine["version"] else [])


# -- config.toml ------------------------------------------------------------------------------------------------------

_REPLACED_BY = {
    "camera": ("hfov_deg", "image_size_px", "camera_name", "camera_unit", "tilt_deg"),
    "hfov_deg": ("camera", "camera_name", "camera_unit"),
    "camera_track": ("tilt_deg",),
}
"""Settings of the config.toml that a given setting replaces, as those of another camera."""


def read_settings(config: Path | None, options: Mapping[str, Any] | None = None) -> FitSettings:
    """Return settings from the table [recon.fit] of a TOML file, such as config.toml, overruled by options.

    Parameters
    ----------
    config
        The file; paths in it are relative to its folder.
    options
        Settings by name; None is not given. Another camera or method replaces the one of the file together with all
        that belongs to it.

    Raises
    ------
    InputError
        Naming every setting that is wrong, and where it was given.
    """
    options = {name: value for name, value in (options or {}).items() if value is not None}
    file_settings = {} if config is None else _read_config(config)
    left_out = {*options, *(replaced for name in options for replaced in _REPLACED_BY.get(name, ()))}
    file_method = file_settings.get("method", SETTINGS["method"].default)
    if options.get("method", file_method) != file_method:
        left_out |= {name for name, setting in SETTINGS.items() if setting.option.method == file_method}
    plain = {name: value for name, value in file_settings.items() if name not in left_out} | options

    try:
        return FitSettings(**plain)
    except InputError as error:
        raise InputError(
            replace(problem, file=config)
            if config is not None and problem.field not in options
            else on_command_line(problem, SETTINGS)
            for problem in error.problems
        ) from None


def _read_config(config: Path) -> dict[str, Any]:
    document = read_toml(config, "a config.toml of an earlier run")
    table = document.get("recon", {})
    table = table.get("fit") if isinstance(table, dict) else None
    if not isinstance(table, dict):
        raise InputError(Problem(config, "table", ", ".join(document)[:120] or "nothing", "[recon.fit]"))
    return {name: setting_in_folder(config.parent, name, value) for name, value in table.items()}


def setting_in_folder(folder: Path, name: str, value: T) -> T:
    """Return the value of a setting that stands in a file of a folder, to which its paths are relative."""
    return with_paths(name, value, lambda path: existing_path(os.path.normpath(folder.absolute() / path)))


LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
"""JSON schema's names of limits by pydantic's, which stay where a text is read first."""


def config_schema() -> dict[str, Any]:
    """Return the JSON schema of config.toml, with the meaning of each setting.

    Sizes and ranges may be texts such as "1920x1080".
    """
    fit_schema = TypeAdapter(FitSettings).json_schema()
    for name, info in SETTINGS.items():
        property_schema = fit_schema["properties"][name]
        choices = [
            _with_json_limits(choice)
            for choice in property_schema.pop("anyOf", [property_schema])
            if choice.get("type") != "null"
        ]
        # One value stands for a list of one, and a text for what is read from it.
        choices += [choice["items"] for choice in choices if "items" in choice]
        if not any(choice.get("type") in ("string", "boolean") for choice in choices):
            choices.append({"type": "string"})
        default = {} if info.default in (MISSING, None) else {"default": info.plain(info.default)}
        fit_schema["properties"][name] = {"description": info.option.help, "anyOf": choices} | default
    fit_schema |= {"title": "recon.fit", "description": "The settings of a fit", "required": []}
    digest_schema = {"type": "object", "description": "Files' digests", "additionalProperties": {"type": "string"}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "config.toml of recon",
        "type": "object",
        "properties": {"recon": {"type": "object", "properties": {"fit": fit_schema, "sha256": digest_schema}}},
    }


def _with_json_limits(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema with limits as JSON schema calls them."""
    items = ((key, value) for key, value in schema.items() if key not in ("title", "default"))
    return {
        LIMITS.get(key, key): _with_json_limits(value) if isinstance(value, dict) else value for key, value in items
    }


def read_config(config: Path, options: Mapping[str, Any]) -> FitSettings:
    """Read settings as `read_settings` does, from the config.toml of a result.

    Raises InputError also for files that it names and that are missing.
    """
    settings = read_settings(config, options)
    missing = {role: path for role, path in _named(options, settings).items() if not path.exists()}
    if missing:
        expected = "the file that config.toml names, seen from its own folder: move both together, or name it anew"
        raise InputError(Problem(config, role, f"{path}, no such file", expected) for role, path in missing.items())
    return settings


def problem_of(motion: Motion, folder: Path) -> ClipProblem:
    """Return the problem that a loaded motion solves, set up again from the settings in its folder.

    Raises
    ------
    InputError
        For settings or a prior that are missing or changed, and for a motion of the frame method.
    """
    config = folder / CONFIG
    if not isinstance(motion.solution, TrajectorySolution):
        raise InputError(Problem(folder, "method", "frame by frame", "a fit of all frames at once"))
    read_manifest(folder).require(CONFIG)
    settings = read_config(config, {})
    prior = load_prior(settings.prior, motion.body)
    if prior.name != motion.solution.prior:
        raise InputError(Problem(config, "prior", prior.name, f"{motion.solution.prior}: {AS_THEY_WERE}"))
    views = views_of(motion.sources)
    return ClipProblem.from_views(views, motion.body, prior, motion.fps, settings.trajectory_options())


def replaced_files(config: Path, options: Mapping[str, Any], settings: FitSettings) -> list[Path]:
    """Return the files that a config.toml names whose content has changed since it was written."""
    table = read_toml(config, "a config.toml of an earlier run").get("recon", {}).get("sha256", {})
    known = table if isinstance(table, dict) else {}
    files = _named(options, settings).items()
    return [path for role, path in files if role in known and digest(path) != known[role]]


def _named(options: Mapping[str, Any], settings: FitSettings) -> dict[str, Path]:
    """Return the input files that are named in the config.toml, not by options."""
    return {role: path for role, path in input_files(settings).items() if options.get(role.split()[0]) is None}
