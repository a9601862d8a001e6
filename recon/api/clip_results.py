"""Write the results of a clip, and check later whether the results still belong to the same inputs.

Either all outputs of a motion appear in the folder, or none. A record lists what the results were made from: the
digests of the input files, the settings and the version.
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
from recon.api.clip import PAIR_REFINED, fit_clip
from recon.api.clip_cameras import read_clip_cameras
from recon.api.settings import SETTINGS, FitSettings, with_paths
from recon.base.documents import parse_json, read_toml, validated
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.file_names import existing_path
from recon.base.files import MANIFEST, digest, read_manifest, sha256_of, write_text
from recon.base.locks import sole_writer
from recon.base.outputs import Output
from recon.base.package import version
from recon.base.progress import Progress, silent
from recon.base.settings import on_command_line
from recon.clip import views_of
from recon.fit.clip_problem import ClipProblem
from recon.fit.motion import Motion
from recon.fit.motion_forms import CONFIG, MOTION, REPORT
from recon.fit.result import TrajectorySolution
from recon.io.corrections import CORRECTIONS
from recon.show.page.own_page import PLAYBACK
from recon.show.plain import write_report
from recon.show.report import build_report
from recon.show.tables import CLIP_OUTPUTS, REPROJECTION, SHAPE, camera_files, reprojection_files, write_tables

WRITING_BEGINS = 0.9
"""Fraction of the time of `recon fit` after which the files are written."""
T = TypeVar("T")
FIT = "fit"
"""Command under which the manifest lists the files of a fit."""
SCHEMA = {"name": "recon.record", "version": 1}
AS_THEY_WERE = "the prior and settings with which the clip was fitted: fit the clip again"
REFINED_CAMERAS = "cameras.toml"
"""Camera file with the poses that a fit refined."""
MAX_PLAYED_FRAMES = 2000
"""Maximum number of frames for which a fit writes the playback by default, a minute at the viewer's usual speed."""
OUTPUT_FILES = (*CLIP_OUTPUTS, REPROJECTION, MOTION, REPORT, PLAYBACK, CONFIG, MANIFEST)
"""Names of all output files for a clip of one camera. A clip of several cameras has one `REPROJECTION` per camera."""


def output_files(settings: FitSettings, out: Path) -> list[str]:
    """Return the names of the files that a fit with these settings may write.

    Tables by camera are included if the folder already has such tables.
    """
    tables: list[str] = []
    if reprojection_files(out) or (out / REPROJECTION).exists():
        with suppress(InputError):  # the fit raises this error too
            tables = camera_files([camera.name for camera, _ in read_clip_cameras(settings)])
    refined = [REFINED_CAMERAS] if settings.seeks_cameras else []
    shape = [SHAPE] if len(settings.keypoints) > 1 and not settings.lengths_known else []
    absent = {REPROJECTION} if settings.playback else {REPROJECTION, PLAYBACK}
    return [*(name for name in OUTPUT_FILES if name not in absent), *tables, *refined, *shape]


def output_of(settings: FitSettings, out: Path, overwrite: bool) -> Output:
    """Return the output through which a fit may write into its folder.

    The config.toml that the settings come from does not count as an input, because the fit may replace it with one that
    has the same settings.
    """
    inputs = tuple(input_files(settings).values())
    return Output(out, FIT, overwrite, inputs, has_manifest=True, mark=MOTION)


_Digests = Mapping[str, str | None]


def write_clip(
    motion: Motion, settings: FitSettings, out: Path, solve_s: float | None = None, sha256: _Digests | None = None
) -> dict[str, Any]:
    """Write all outputs of a clip into a folder, or none of them, and return the report.

    Results of an earlier fit are replaced unless they were changed after the fit.

    Parameters
    ----------
    motion
        The result of `fit_clip`.
    settings
        Settings of the fit.
    out
        The folder, which is created if necessary.
    solve_s
        Duration of the fit in seconds, if known.
    sha256
        Digests of the input files, as `input_digests` returns them. By default the files are read again.

    Raises
    ------
    InputError
        If a file to be written exists and no fit wrote it, or it was changed after the fit.
    """
    if sha256 is None:
        sha256 = input_digests(settings)
    known = {role: sha256_hex for role, sha256_hex in sha256.items() if sha256_hex is not None}
    timing_s = {} if solve_s is None else {"solve_s": solve_s}
    motion = replace(motion, settings=settings.plain(out), timing_s=timing_s)
    report = build_report(motion)
    with output_of(settings, out, overwrite=True).staged() as folder:
        motion.save(folder)
        write_tables(motion, folder)
        write_report(report, folder / REPORT)
        (folder / CONFIG).write_text(settings.to_toml(out, known), encoding="utf-8")
        is_short = len(motion.frames) <= MAX_PLAYED_FRAMES
        if settings.playback is True or (settings.playback == "auto" and is_short):
            from recon.show import view  # rerun is slow to import

            view.write(motion, folder / PLAYBACK)
        if settings.seeks_cameras or any(item.code in PAIR_REFINED for item in motion.findings):
            from recon.io.camera_files import write_cameras

            write_cameras([source.camera for source in motion.sources], folder / REFINED_CAMERAS)
    return report


def run_clip(settings: FitSettings, out: Path, overwrite: bool = False, progress: Progress = silent) -> dict[str, Any]:
    """Reconstruct a clip, write its folder as `recon fit` does, and return the report.

    Raises
    ------
    InputError
        If inputs cannot be used, if `out` holds results and `overwrite` is false, or if another process is writing to
        it. The error is raised before any work is done.
    """
    with sole_writer(out):
        output_of(settings, out, overwrite).require(output_files(settings, out))
        return fit_into(out, settings, progress)


def fit_into(out: Path, settings: FitSettings, progress: Progress = silent) -> dict[str, Any]:
    """Reconstruct a clip, replace an earlier fit's files in its folder, and return the report.

    Raises
    ------
    InputError
        If inputs cannot be used, or if an input file changes during the fit, because it would be unclear which content
        was fitted.
    """
    start, sha256 = time.perf_counter(), input_digests(settings)
    motion = fit_clip(settings, lambda stage, share: progress(stage, WRITING_BEGINS * share))
    require_same_inputs(settings, sha256)
    solve_s = time.perf_counter() - start
    progress("writing", WRITING_BEGINS)
    return write_clip(motion, settings, out, solve_s, sha256)


def input_files(settings: FitSettings) -> dict[str, Path]:
    """Return the input files, keyed by the setting that names them.

    Built-in skeletons and priors are not files.
    """
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
    """Return the digest of each input file, or None if the file cannot be read, keyed as in `input_files`."""
    return {role: file_sha256(path) for role, path in input_files(settings).items()}


def require_same_inputs(settings: FitSettings, sha256: _Digests) -> None:
    """Raise InputError for input files whose content no longer has the given digests."""
    changed = [path for role, path in input_files(settings).items() if file_sha256(path) != sha256[role]]
    expected = "a file that does not change during the fit: fit the clip again"
    raise_problems(Problem(path, "content", "a file that changed during the fit", expected) for path in changed)


def file_sha256(path: Path) -> str | None:
    """Return the digest of a file's content, or None if it cannot be read.

    The digest is cached until the file's size or times change, because a batch needs it many times.
    """
    try:
        state = path.stat()
        return _sha256_of(path, (state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns))
    except OSError:
        return None


@cache
def _sha256_of(path: Path, state: tuple[int, ...]) -> str:
    return sha256_of(path)


def identity(settings: FitSettings) -> dict[str, Any]:
    """Return the identity of a fit's results: digests of the input files, settings and version.

    The identity has neither the paths of files nor settings that the method does not read. The digest of an unreadable
    file is None.
    """
    files = input_files(settings)
    plain = {name: value for name, value in settings.plain().items() if value is not None and name not in files}
    return identity_of(files, plain)


def identity_of(files: Mapping[str, Path], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the identity of results: digests of the given files, keyed by role, the settings, and the version."""
    inputs = {role: file_sha256(path) for role, path in files.items()}
    return {"inputs": inputs, "settings": dict(settings), "version": version()}


@dataclass(frozen=True)
class _Identity:
    inputs: dict[str, str | None]
    settings: dict[str, Any]
    version: str


@dataclass(frozen=True)
class _Line:
    """One line of a `Record`, which describes one part of the work.

    `files` are the digests of the files that the part wrote, known once the part has ended. `notes` and `row` are free
    for the caller.
    """

    part: str
    identity: _Identity
    files: dict[str, str] = field(default_factory=dict)
    keypoints: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    row: dict[str, Any] = field(default_factory=dict)


_BEGIN = '{"'
"""First characters of every line of a record."""


class Record:
    """Record of what each part of the work was made from, and of how it ended.

    The file has one JSON object per line. The last line of a part counts, and only one process writes the file. A part
    gets a line before it begins and another line, with the files that it wrote, after it has ended, so that a killed
    run does not look finished. Lines of other versions are ignored, and so is a last line that was cut off, for example
    by a full disk.

    Raises
    ------
    InputError
        If the file has any other invalid line or is a link, because it may then belong to the user.
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
        """Keep only the last line of each part, before new lines are added."""
        write_text(self.path, "".join(json.dumps(row) + "\n" for row in self.rows.values()))

    def note(self, part: str, made_from: Mapping[str, Any], **details: Any) -> None:
        """Note that a part begins, or has ended with `files`, which are digests as returned by `digests`."""
        self.rows[part] = {"schema": SCHEMA, "part": part, "identity": made_from, **details}
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(self.rows[part]) + "\n")

    def why_redo(self, part: str, made_from: Mapping[str, Any], folder: Path) -> tuple[str, list[Path]]:
        """Return why a part has to be redone ("" if it is up to date), and its files that are missing or changed.

        If a manifest is among the files, the files that it lists are not checked here.
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
    """Return the digests of files, keyed by their path relative to the folder."""
    return {path.absolute().relative_to(folder.absolute()).as_posix(): sha256_of(path) for path in paths}


def _changed_names(theirs: Mapping[str, Any], mine: Mapping[str, Any]) -> list[str]:
    """Return the names of input files and settings that differ, and "version of recon" if it differs."""
    names = []
    for part in ("inputs", "settings"):
        old, new = theirs[part], mine[part]
        names += [name.split()[0] for name in sorted({*old, *new}) if old.get(name) != new.get(name)]
    return list(dict.fromkeys(names)) + (["version of recon"] if theirs["version"] != mine["version"] else [])


_REPLACED_BY = {
    "camera": ("hfov_deg", "lens", "image_size_px", "camera_name", "camera_unit", "tilt_deg"),
    "hfov_deg": ("camera", "camera_name", "camera_unit"),
    "camera_track": ("tilt_deg",),
}
"""Settings of config.toml that are ignored if another camera or track is given, keyed by the setting that gives it."""


def read_settings(config: Path | None, options: Mapping[str, Any] | None = None) -> FitSettings:
    """Return settings from the table [recon.fit] of a TOML file such as config.toml, overridden by options.

    Parameters
    ----------
    config
        TOML file, in which paths are relative to the folder of the file.
    options
        Values keyed by the settings' names; None means not given. If another camera or method is given, the file's
        settings that belong to its own camera or method do not apply.

    Raises
    ------
    InputError
        If settings are wrong. The message names each of them and where it was given.
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
    """Return the value of a setting read from a file in a folder.

    Paths in the value are relative to that folder.
    """
    return with_paths(name, value, lambda path: existing_path(os.path.normpath(folder.absolute() / path)))


LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
"""Names in a JSON schema of pydantic's limits, which pydantic does not translate if a string is parsed first."""


def config_schema() -> dict[str, Any]:
    """Return the JSON schema of config.toml, with a description of each setting.

    Sizes and ranges may be strings such as "1920x1080".
    """
    fit_schema = TypeAdapter(FitSettings).json_schema()
    for name, info in SETTINGS.items():
        property_schema = fit_schema["properties"][name]
        choices = [
            _with_json_limits(choice)
            for choice in property_schema.pop("anyOf", [property_schema])
            if choice.get("type") != "null"
        ]
        # A single value may replace a list with one item, and a string may replace the value that is parsed from it.
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
    items = ((key, value) for key, value in schema.items() if key not in ("title", "default"))
    return {
        LIMITS.get(key, key): _with_json_limits(value) if isinstance(value, dict) else value for key, value in items
    }


def read_config(config: Path, options: Mapping[str, Any]) -> FitSettings:
    """Read settings from the config.toml of a result, as `read_settings` does.

    Raises
    ------
    InputError
        If settings are wrong, or if files that they name are missing.
    """
    settings = read_settings(config, options)
    missing = {role: path for role, path in _named(options, settings).items() if not path.exists()}
    if missing:
        expected = "the file that config.toml names, relative to its folder: move both, or correct the path"
        raise InputError(Problem(config, role, f"{path}, no such file", expected) for role, path in missing.items())
    return settings


def problem_of(motion: Motion, folder: Path) -> ClipProblem:
    """Rebuild the least-squares problem of a loaded motion from the settings in its folder.

    Raises
    ------
    InputError
        If settings or a prior are missing or changed, or if the motion is from the frame method.
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
    """Return the input files whose content has changed since config.toml was written, except those given as options."""
    table = read_toml(config, "a config.toml of an earlier run").get("recon", {}).get("sha256", {})
    known = table if isinstance(table, dict) else {}
    files = _named(options, settings).items()
    return [path for role, path in files if role in known and digest(path) != known[role]]


def _named(options: Mapping[str, Any], settings: FitSettings) -> dict[str, Path]:
    """Return the input files that config.toml names, except files that the options replace."""
    return {role: path for role, path in input_files(settings).items() if options.get(role.split()[0]) is None}


def with_corrections_in(folder: Path, settings: FitSettings) -> FitSettings:
    """Return the settings of a fit, with the corrections file in its folder unless they name a corrections file."""
    path = folder / CORRECTIONS
    has_corrections = settings.corrections is None and path.is_file() and not path.is_symlink()
    return replace(settings, corrections=path.absolute()) if has_corrections else settings
