"""Find the clips of a batch: turn files, patterns, folders and manifests into named `Clip` objects with settings."""

from __future__ import annotations

import glob
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cache, partial
from itertools import count as counting
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from recon.api.clip_cameras import cameras_in
from recon.api.clip_results import read_settings, setting_in_folder
from recon.api.settings import SETTINGS, FitSettings
from recon.base.arrays import Brief
from recon.base.documents import read_head, read_toml
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.file_names import encodable
from recon.base.numbers import counted
from recon.base.patterns import slow_part
from recon.check.codes import names_text
from recon.fit.motion_forms import MOTION
from recon.io.calibration import read_cameras
from recon.io.common import text_rows
from recon.io.deeplabcut_project import find_project, predictions
from recon.io.formats import individuals, recognised, titles
from recon.io.json_poses import clip_of_frame
from recon.show.page.own_page import SUMMARY, SUMMARY_PAGE

T = TypeVar("T")
AUTO, NONE = "auto", "none"
OPTION = "--cameras-by"
SEPARATORS = "-_. "
"""Characters that may separate the camera's name from the rest of a file name."""
_MANIFEST = "a CSV table with columns keypoints, camera and fps"
MAX_BYTES = 240
"""Maximum length of a clip's name in bytes. File systems allow 255, and a number may be appended."""
_UNFIT = re.compile(r'[<>:"/\\|?*\x00-\x1f]')
"""Characters that some file systems do not allow in names."""
CELL_SEPARATOR = "|"
"""Separator between the values of several cameras in one cell of a manifest."""
MAX_SQUARE_M = 1.0
"""Side of a calibration board's square (m) from which an Anipose session must be in a unit other than metres."""
POSES = {"pose_2d_filter": "pose-2d-filtered", "pose_2d": "pose-2d"}
"""Default names of the folders of 2D poses in an Anipose session, by key in config.toml, the preferred one first."""
EXPERIMENT = "run", "animal", "group"
"""Columns of a manifest that `recon compare --design` reads."""
SQUARE = "board_square_side_length"
_BY_CAMERA = ("offset_s", "camera_track", "camera_fps", "find_offsets", "refine_cameras", "focal_sigma")
"""Settings that may have one value per camera of a clip."""


@dataclass(frozen=True, repr=False)
class Clip(Brief):
    """Clip of a batch: the name of its folder and the settings of its fit."""

    name: str
    """Name of the clip's folder, unique within the batch even when upper and lower case are not distinguished."""
    settings: FitSettings


@dataclass(frozen=True)
class _Draft:
    """Files of a clip or of one of its cameras, with the settings of their row in a manifest."""

    paths: tuple[Path, ...]
    row: Mapping[str, Any] = field(default_factory=dict)
    name: str | None = None
    manifest_line: tuple[Path, str] | None = None
    """The manifest and the line that the draft comes from."""
    named_after: Path | None = None
    """The path that the clip is named after, if it is not the clip's only file."""
    cam_regex: tuple[Path, str] | None = None
    """Anipose's pattern for cameras in file names, and the file that contains it."""
    rule: str | None = None
    """Source of the rule that identified the camera from the file names."""

    @property
    def title(self) -> Path:
        """Return the path that the clip is named after."""
        return self.named_after or self.paths[0]


Drafts = tuple[list[_Draft], list[str]]
"""Drafts, and notes on files that were left out or joined into one clip."""


def find_clips(
    inputs: Sequence[str | Path],
    common: Mapping[str, Any],
    config: Path | None = None,
    cameras_by: str = AUTO,
    posed: bool = True,
    recursive: bool = False,
) -> tuple[list[Clip], list[str]]:
    """Return the clips of all inputs in order, and notes.

    Each animal of a file with several animals is a clip of its own, unless one is chosen.

    Parameters
    ----------
    inputs
        Any of these: keypoint files; quoted patterns; DeepLabCut projects (a folder with config.yaml, or that file),
        whose tables next to the videos are read; Anipose sessions; CSV manifests with `keypoints` in their header;
        other folders, in which every file that a reader recognises is read. If files of a folder differ only in their
        suffix, the last one is read (.h5 rather than .csv, since DeepLabCut writes each table twice).
    common
        Settings for every clip, keyed by their names; None if not given. These settings override `config`, and the
        cells of a manifest override these settings.
    config
        The config.toml of an earlier fit.
    cameras_by
        Rule that decides which files belong to one clip: a regular expression that matches the camera's name in a file
        name; "auto" for Anipose's pattern or the names in the camera file; or "none", if each file is a clip.
    posed
        Whether files are joined only if the camera file has poses for its cameras.
    recursive
        Whether subfolders are read too.

    Returns
    -------
    tuple
        The clips, and notes on files that were left out or joined into one clip.

    Raises
    ------
    InputError
        If inputs or rows cannot be used. The message lists all problems.
    """
    problems: list[Problem] = []

    def collected(make: Callable[[], T], default: T) -> T:
        """Call a function and return its result.

        If it raises InputError, keep the problems and return the default.
        """
        try:
            return make()
        except InputError as error:
            problems.extend(error.problems)
            return default

    drafts: list[_Draft] = []
    notes: list[str] = []
    for path in inputs:
        input_drafts, input_notes = collected(partial(_drafts_of, str(path), common, recursive), ([], []))
        drafts += input_drafts
        notes += input_notes
    drafts = _without_repeats(drafts)
    camera_names = _camera_names_by_draft(common, config, posed)
    join = partial(_joined, drafts, cameras_by, common.get("camera_name"), camera_names)
    drafts, join_notes = collected(join, (drafts, []))
    fits = [fit for draft in drafts for fit in collected(partial(_with_settings, draft, common, config), [])]
    raise_problems(dict.fromkeys((*problems, *_name_problems(drafts))))  # report a shared problem only once
    if not fits:
        raise InputError(Problem("INPUT", "clips", "no clips", "keypoint files, a folder of them, or a manifest"))
    drafts = [draft for draft, _ in fits]
    names = _names(drafts)
    missing = [] if cameras_by == NONE else _missing_cameras(drafts, names)
    clips = [Clip(name, settings) for name, (_, settings) in zip(names, fits, strict=True)]
    return clips, [*notes, *join_notes, *missing]


def _drafts_of(text: str, common: Mapping[str, Any], recursive: bool) -> Drafts:
    path = Path(text)
    if os.path.exists(path) and (project := find_project(path)):  # a name that is too long makes Path raise OSError
        tables, left_out = predictions(project)
        files = [(file.absolute(), f"{video}{file.suffix}") for video, file in tables.items()]
        notes = [f"{project.folder} is a DeepLabCut project with tables of {len(files)} of its videos."]
        notes += [f"Other tables of the same videos were left out: {names_text(left_out)}"] if left_out else []
        return [_Draft((file,), named_after=file.with_name(name)) for file, name in files], notes
    if os.path.isdir(path):
        files, notes = _files_in(path, recursive)
        has_own_files = any(file.parent == path.absolute() for file in files)
        if (not has_own_files or path.absolute().name.startswith("pose-2d")) and (sessions := _sessions_in(path)):
            return _drafts_of_sessions(sessions, common)
        if not files:
            deeper = "" if recursive else "; --recursive also looks in its subfolders"
            raise InputError(Problem(path, "files", "no keypoint files", f"a known format: {titles('2D')}{deeper}"))
        return [_draft_of(file) for file in files], notes
    files = _matching_files(path)
    if not files:
        raise InputError(
            Problem(text, "files", "no files that match", "at least one file: check the folder and the suffix")
        )
    if files == [path]:
        read_head(path)  # so that a misspelt name ends the batch before it begins
    drafts_by_file = (
        _drafts_of_manifest(file) if is_manifest(file) else [_draft_of(file.absolute())] for file in files
    )
    return [draft for drafts in drafts_by_file for draft in drafts], []


def _draft_of(file: Path) -> _Draft:
    return _Draft((file,), named_after=clip_of_frame(file))


def _matching_files(path: Path) -> list[Path]:
    if "\0" in str(path):  # no file has a NUL in its name, and resolving such a path fails
        return []
    if os.path.exists(path) or not glob.has_magic(str(path)):
        return [path]
    return [file for match in sorted(glob.glob(str(path), recursive=True)) if (file := Path(match)).is_file()]


def _files_in(folder: Path, recursive: bool = False) -> tuple[list[Path], list[str]]:
    if (folder / MOTION).is_file():
        return [], [f"Left out, because the folder has results of a fit: {folder}"]
    chosen: dict[str, Path] = {}
    left_out: dict[str, list[str]] = {}
    inside = []
    for path in sorted(p for p in folder.iterdir() if not p.name.startswith(".")):
        if path.is_dir():
            inside.append(path)
        elif reason := _why_left_out(path):
            left_out.setdefault(reason, []).append(path.name)
        elif clip := clip_of_frame(path):
            chosen.setdefault(str(clip), path.absolute())
        else:
            if path.stem in chosen:
                left_out.setdefault("next to a file of the same name", []).append(chosen[path.stem].name)
            chosen[path.stem] = path.absolute()
    notes = [f"Left out of {folder}, {reason}: {names_text(names)}" for reason, names in sorted(left_out.items())]
    files = [*chosen.values()]
    for sub in inside if recursive else ():
        sub_files, sub_notes = _files_in(sub, recursive)
        files, notes = files + sub_files, notes + sub_notes
    if files and inside and not recursive:
        subfolders = names_text([p.name for p in inside])
        notes.insert(0, f"Folders in {folder} are not read ({subfolders}): add --recursive to read them.")
    return files, notes


def _why_left_out(path: Path) -> str:
    """Return why a file of a folder is not a clip, or "" if the file is a clip or too damaged to tell."""
    if not os.access(path, os.R_OK):
        return "not readable"
    try:
        if not path.stat().st_size or recognised(path, "2D") is None:
            with suppress(InputError):
                return "camera files (for --camera, or a manifest's column camera)" if read_cameras(path) else ""
            return "of no known format"
        if any({"x", "y", "z"} <= {*cells} for _, cells in islice(text_rows(path), 4)):  # a header has at most 4 rows
            return "3D positions"
    except OSError:  # a failing disk
        return "not readable"
    except InputError:
        pass
    return ""


def _without_repeats(drafts: Sequence[_Draft]) -> list[_Draft]:
    """Return the drafts, except those whose files an earlier draft already has, even by another path.

    All rows of a manifest are kept.
    """
    seen: set[Path] = set()
    kept = []
    for draft in drafts:
        title, *paths = (path.parent.resolve() / path.name for path in (draft.title, *draft.paths))
        if draft.manifest_line is not None or not (title in seen or seen.issuperset(paths)):
            kept.append(draft)
        if draft.manifest_line is None:
            seen.update((title, *paths))
    return kept


def _sessions_in(folder: Path) -> list[tuple[Path, Path]]:
    """Return the sessions of an Anipose project, each with its folder of keypoint files.

    The folder may be a project, one session, or a folder of 2D poses. Filtered 2D poses are preferred to unfiltered
    ones.

    Raises
    ------
    InputError
        If a config.toml cannot be read.
    """
    folder = folder.absolute()
    pipeline = _table(_anipose_config(folder)[0], "pipeline")
    names = [str(pipeline.get(key, name)) for key, name in POSES.items()]
    if folder.name in names:
        return [(folder.parent, folder)]
    sessions: dict[Path, Path] = {}
    for name in names:
        for poses in folder.rglob(name):
            if poses.is_dir() and any(path.is_file() for path in poses.iterdir()):
                sessions.setdefault(poses.parent, poses)
    return sorted(sessions.items())


def _drafts_of_sessions(sessions: Sequence[tuple[Path, Path]], common: Mapping[str, Any]) -> Drafts:
    """Return one draft per file of 2D poses in Anipose sessions, and notes.

    A draft has the calibration of its session, or the nearest one in a folder above. If the common settings give a
    camera, the draft has no calibration of its own.
    """
    drafts, notes, problems = [], [], []
    for folder, poses in sessions:
        config, file = _anipose_config(folder)
        parents = [folder, *folder.parents]
        parents = parents if file is None else parents[: parents.index(file.parent) + 1]
        name = str(_table(config, "pipeline").get("calibration_results", "calibration"))
        calibration = next((p for parent in parents if (p := parent / name / "calibration.toml").is_file()), None)
        square, regex = _table(config, "calibration").get(SQUARE), _table(config, "triangulation").get("cam_regex")
        uses_calibration = common.get("camera") is None and common.get("hfov_deg") is None
        if uses_calibration and calibration is None:
            expected = "calibration/calibration.toml in this folder or in one above, or --camera"
            problems.append(Problem(folder, "calibration", "none", expected))
        unit_missing = uses_calibration and calibration is not None and common.get("camera_unit") is None
        if unit_missing and isinstance(square, int | float) and square >= MAX_SQUARE_M:
            actual = f"{square:g}, so the calibration is not in metres"
            problems.append(Problem(file or folder, SQUARE, actual, "its unit as well, such as --camera-unit mm"))
        problems += _crops(config, file or folder) if uses_calibration else []
        row = {"camera": str(calibration)} if uses_calibration else {}
        cam_regex = (file, regex) if file is not None and isinstance(regex, str) else None
        files, file_notes = _files_in(poses)
        drafts += [_Draft((path,), row, named_after=folder / path.name, cam_regex=cam_regex) for path in files]
        notes += file_notes
        unfiltered = folder / str(_table(config, "pipeline").get("pose_2d", POSES["pose_2d"]))
        if unfiltered != poses and unfiltered.is_dir():  # filtering may have ended before its last file
            unread = sorted({path.stem for path in _files_in(unfiltered)[0]} - {path.stem for path in files})
            notes += [f"Not read, because only {unfiltered} has them: {names_text(unread)}"] if unread else []
    raise_problems(dict.fromkeys(problems))
    if not drafts:
        searched = names_text([str(poses) for _, poses in sessions])
        raise InputError(Problem(searched, "files", "no keypoint files", f"files of a known format: {titles('2D')}"))
    folders = " and ".join(dict.fromkeys(poses.name for _, poses in sessions))
    return drafts, [
        f"{counted(len(sessions), 'Anipose session')}: {counted(len(drafts), 'file')} of {folders}.",
        *notes,
    ]


def _anipose_config(folder: Path) -> tuple[Mapping[str, Any], Path | None]:
    """Return the config.toml of the Anipose project that a folder belongs to, as a table and a path.

    Without a project, the table is empty and the path is None.
    """
    for parent in (folder, *folder.parents):
        path = parent / "config.toml"
        if path.is_file():
            config = read_toml(path, "Anipose's settings")
            if config.keys() & {"triangulation", "pipeline", "nesting", "model_folder"}:
                return config, path
    return {}, None


def _crops(config: Mapping[str, Any], file: Path) -> list[Problem]:
    """Return a problem for each camera whose video Anipose's settings state to be cropped, as `offset`."""
    offsets = {name: _table(_table(config, "cameras"), name).get("offset") for name in _table(config, "cameras")}
    expected = "keypoints in the whole picture, or --camera with a calibration of the cropped videos"
    return [
        Problem(file, f"cameras.{name}.offset", f"{offset}, the corner of a crop, which is not added", expected)
        for name, offset in offsets.items()
        if isinstance(offset, list) and any(offset)
    ]


def _table(config: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = config.get(name)
    return table if isinstance(table, dict) else {}


def is_manifest(path: Path) -> bool:
    """Return whether a file is a manifest: a CSV table with a column `keypoints`.

    A table with a column `camera` is also a manifest, so that a misspelt `keypoints` is reported, unless it is a
    keypoint file.
    """
    try:
        header = _header(path) if path.suffix.lower() == ".csv" and os.path.isfile(path) else ()
        return "keypoints" in header or ("camera" in header and recognised(path) is None)
    except (InputError, OSError):  # the fit of the clip reports a file that is not a table, or a failing disk
        return _begins_with_keypoints(path)


def _begins_with_keypoints(path: Path) -> bool:
    """Return whether the first line has a column `keypoints`, in any encoding, so that the encoding is reported."""
    try:
        line = read_head(path, length=1 << 10).replace(b"\0", b"").splitlines()[0]
    except (InputError, OSError, IndexError):
        return False
    return b"keypoints" in [cell.strip(b' "\xff\xfe') for cell in re.split(rb"[,;\t]", line.lower())]


def _header(path: Path) -> list[str]:
    return [cell.strip().lower() for cell in next(text_rows(path), (0, []))[1]]


def _expected_column(name: str, known: Sequence[str]) -> str:
    """Return the column of a manifest that a wrong name resembles, or all columns."""
    meant = get_close_matches(name.replace("-", "_"), known, 1, 0.8)
    return f"a known column, perhaps {meant[0]}" if meant else f"one of {', '.join(known)}"


def _drafts_of_manifest(path: Path) -> list[_Draft]:
    """Return one draft per row of a manifest.

    Raises
    ------
    InputError
        If the table is faulty. The message lists every fault of the table itself.
    """
    header, known = _header(path), ("out", *EXPERIMENT, *SETTINGS)
    many = {name for name, info in SETTINGS.items() if info.is_many}
    problems = [
        Problem(path, f"column {name!r}" if name else "header", "an unknown column", _expected_column(name, known))
        for name in header
        if name not in known
    ]
    drafts = []
    for line_number, cells in islice(text_rows(path), 1, None):
        line = f"line {line_number}"
        if len(cells) > len(header):
            problems.append(Problem(path, line, f"{len(cells)} cells", f"{len(header)} cells, as in the header"))
        row = {name: cell.strip() for name, cell in zip(header, cells, strict=False) if cell.strip()}
        row = {name: cell for name, cell in row.items() if name not in EXPERIMENT}
        if "keypoints" not in row:
            problems.append(Problem(path, f"{line}, keypoints", "nothing", "a keypoint file"))
            continue
        out = row.pop("out", None)
        lists = {
            name: [text.strip() for text in cell.split(CELL_SEPARATOR)] for name, cell in row.items() if name in many
        }
        values = {name: setting_in_folder(path.parent, name, value) for name, value in (row | lists).items()}
        files = [file for pattern in values.pop("keypoints") for file in _matching_files(Path(pattern))]
        if not files:
            problems.append(
                Problem(path, f"{line}, keypoints", f"no files that match {row['keypoints']}", "one file or more")
            )
            continue
        drafts.append(_Draft(tuple(files), values, out, (path, line)))
    if not drafts and not problems:
        problems.append(Problem(path, "rows", "no rows", "one row for each clip below the header"))
    raise_problems(problems)
    return drafts


def _joined(
    drafts: Sequence[_Draft],
    cameras_by: str,
    camera_name: str | Sequence[str] | None,
    camera_names: Callable[[_Draft], Sequence[str]],
) -> Drafts:
    """Join the drafts of each clip that several cameras filmed into one, keeping the order of the drafts.

    Files in one folder belong to one clip if their names are equal after the part that matches the pattern, or the
    camera's name, is removed. The rows of a manifest list their own files and are never joined.

    Parameters
    ----------
    drafts
        Drafts of single files and of manifest rows.
    cameras_by
        A regular expression; `AUTO` for Anipose's pattern or, if they join any two files, the names in the camera file;
        or `NONE` to join nothing.
    camera_name
        The camera name given for every clip, if any.
    camera_names
        Function that returns the names of a draft's cameras.

    Raises
    ------
    InputError
        If the pattern is faulty or matches no file.
    """
    pattern = None if cameras_by in (AUTO, NONE) else _compiled(cameras_by, OPTION)
    if pattern is not None and camera_name is not None:
        actual = f"{camera_name if isinstance(camera_name, str) else ', '.join(camera_name)} together with {OPTION}"
        raise InputError(Problem("--camera-name", "camera_name", actual, "only one of the two"))
    clips: dict[Any, list[_FileOfClip]] = {}
    without_camera = []
    for draft in drafts:
        with_camera = _with_camera(draft, pattern, cameras_by, camera_names)
        if with_camera.rule is None and with_camera.manifest_line is None and (pattern or with_camera.cam_regex):
            without_camera.append(with_camera.paths[0].name)
        else:
            is_by_itself = with_camera.rule is None or cameras_by == NONE
            key = len(clips) if is_by_itself else _clip_key(with_camera)
            clips.setdefault(key, []).append(_FileOfClip(draft, with_camera))
    if without_camera and not any(file.with_camera.rule for files in clips.values() for file in files):
        actual = f"no camera in {names_text(without_camera)}"
        raise InputError(Problem(OPTION, "pattern", actual, "a pattern that matches the files' names"))
    several = [files for files in clips.values() if len(files) > 1]
    notes = [f"Left out, without a camera in the name: {names_text(without_camera)}"] if without_camera else []
    if several:
        notes.append(_joining_note(several))
    return [_draft_of_clip(files, any_joined=bool(several)) for files in clips.values()], notes


class _FileOfClip(NamedTuple):
    """Draft of a clip as the user gave it, and the same draft with the camera and clip names found in its file name."""

    stated: _Draft
    with_camera: _Draft


def _clip_key(draft: _Draft) -> tuple[Path, str, str]:
    """Return the folder, the name without the camera's, and the settings, which all files of one clip share."""
    row = {name: value for name, value in draft.row.items() if name != "camera_name"}
    return draft.title.parent, draft.title.name.casefold(), repr(row)


def _draft_of_clip(files: Sequence[_FileOfClip], any_joined: bool) -> _Draft:
    """Return one draft for all files of a clip.

    Names of cameras that the file names happen to contain count only if they join any two files (`any_joined`).
    """
    stated, first = files[0]
    if first.rule is None or (first.rule == AUTO and not any_joined):
        return stated
    paths = tuple(path for file in files for path in file.with_camera.paths)
    cameras = tuple(name for file in files for name in file.with_camera.row["camera_name"])
    return replace(first, paths=paths, row={**first.row, "camera_name": cameras})


def _joining_note(clips: Sequence[Sequence[_FileOfClip]]) -> str:
    rules = dict.fromkeys(file.with_camera.rule for files in clips for file in files)
    rule_text = " and ".join("camera names in the file names" if rule == AUTO else str(rule) for rule in rules)
    alternative = f" ({OPTION} {NONE} fits each file separately)" if OPTION not in rules else ""
    clip_count = counted(len(clips), "clip")
    return f"{sum(map(len, clips))} files were joined to {clip_count} of several cameras, by {rule_text}{alternative}."


def _with_camera(
    draft: _Draft, pattern: re.Pattern[str] | None, cameras_by: str, camera_names: Callable[[_Draft], Sequence[str]]
) -> _Draft:
    """Return a draft with the camera that its file name contains, named after the rest of the file name.

    If nothing is left of the file name, the clip is named after its folder. The draft is returned unchanged if its
    file name contains no camera, or if it comes from a manifest.
    """
    if draft.manifest_line is not None:
        return draft
    title, rule = draft.title, OPTION
    if pattern is None and draft.cam_regex is not None:
        text, config = draft.cam_regex[1], draft.cam_regex[0]
        pattern, rule = _compiled_from_file(text, config), f"cam_regex in {config}"
    if pattern is not None:  # as in Anipose, the camera's name is the first group, or the whole match if there is none
        match = pattern.search(title.stem)
        cameras = {} if match is None else {((match[1] if pattern.groups else match[0]) or "").strip(): match}
    else:
        rule, cameras = AUTO, {} if cameras_by == NONE else cameras_in(title.stem, camera_names(draft))
    if len(cameras) > 1:
        expected = f"the name of one camera; {OPTION} with a pattern that matches it, or {OPTION} {NONE}"
        raise InputError(Problem(title, "name", f"the cameras {' and '.join(cameras)}", expected))
    for camera, match in cameras.items():
        if camera:
            if cameras_by != NONE:
                rest = title.stem[: match.start()].rstrip(SEPARATORS) + title.stem[match.end() :]
                rest, folder = rest.strip(SEPARATORS), title.parent
                title = (folder if rest else folder.parent) / f"{rest or folder.name}{title.suffix}"
            return replace(draft, row={**draft.row, "camera_name": (camera,)}, named_after=title, rule=rule)
    return draft


@cache
def _compiled_from_file(text: str, file: Path) -> re.Pattern[str]:
    """Return the compiled pattern that a file contains.

    Raises
    ------
    InputError
        If a search with the pattern could take forever.
    """
    pattern = _compiled(text, file)
    if slow := slow_part(text):
        expected = f"a simpler pattern, such as '-cam([A-Z])'; or {OPTION} with a pattern of your own"
        raise InputError(Problem(file, "cam_regex", f"{text[:100]!r}, with {slow}: it may never end", expected))
    return pattern


def _compiled(text: str, origin: Path | str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        expected = "a regular expression that matches the camera's name in a file's name, such as '-cam([A-Z])'"
        raise InputError(Problem(origin, "pattern", f"{text!r} ({error})", expected)) from None


def _camera_names_by_draft(
    common: Mapping[str, Any], config: Path | None, posed: bool
) -> Callable[[_Draft], tuple[str, ...]]:
    """Return a function that gives the names of a draft's cameras that can film a clip together.

    The function returns no names if the cameras cannot be combined, or if the user chose one. If `posed` is true,
    cameras without poses cannot be combined.
    """
    read = cache(read_cameras)

    def names_of(draft: _Draft) -> tuple[str, ...]:
        row, options = (
            {name: value for name, value in values.items() if name not in _BY_CAMERA} for values in (draft.row, common)
        )
        try:
            settings = _settings(replace(draft, paths=draft.paths[:1], row=row), options, config)
            if settings.camera is None or settings.camera_name is not None or settings.method == "frame":
                return ()
            cameras = read(settings.camera, settings.image_size_px)
        except InputError:  # raised later together with the clip's other problems
            return ()
        usable = not posed or all(camera.has_extrinsics for camera in cameras)
        return tuple(camera.name for camera in cameras) if usable else ()

    return names_of


def _missing_cameras(drafts: Sequence[_Draft], names: Sequence[str]) -> list[str]:
    """Return a note on joined clips that lack cameras which other clips have."""
    all_cameras: dict[Any, dict[str, None]] = {}  # keyed by project, because projects name cameras differently
    by_name = [(name, draft) for name, draft in zip(names, drafts, strict=True) if draft.rule]
    for _, draft in by_name:
        all_cameras.setdefault(draft.cam_regex, {}).update(dict.fromkeys(draft.row["camera_name"]))
    incomplete = [
        f"{name} ({', '.join(missing)})"
        for name, draft in by_name
        if (missing := [camera for camera in all_cameras[draft.cam_regex] if camera not in draft.row["camera_name"]])
    ]
    return [f"Fitted with fewer cameras than other clips: {names_text(incomplete)}"] if incomplete else []


def _with_settings(draft: _Draft, common: Mapping[str, Any], config: Path | None) -> list[tuple[_Draft, FitSettings]]:
    """Return a draft with all its settings, or one draft per animal in its file."""
    settings = _settings(draft, common, config)
    animals = () if settings.individual is not None else individuals(settings.keypoints[0])
    if not animals:
        return [(draft, settings)]
    fits = []
    for animal in animals:
        name = draft.name and f"{draft.name}-{animal}"
        animal_draft = replace(draft, row={**draft.row, "individual": animal}, name=name)
        fits.append((animal_draft, replace(settings, individual=animal)))
    return fits


def _settings(draft: _Draft, common: Mapping[str, Any], config: Path | None) -> FitSettings:
    """Return the settings of a draft, whose row overrides the common options, which override config.toml."""
    row = draft.row
    options = {name: value for name, value in common.items() if value is not None and name not in row}
    if "camera" in row and options.pop("hfov_deg", None) is not None:
        options.pop("image_size_px", None)
        options.pop("lens", None)
    if "hfov_deg" in row:
        options = {name: value for name, value in options.items() if name not in ("camera", "camera_name")}
    if "method" in row:  # the common options are meant for clips of the other method
        options = {
            name: value for name, value in options.items() if SETTINGS[name].option.method in (None, row["method"])
        }

    def located(problem: Problem) -> Problem:
        """Add to a problem the manifest line that contains the setting, or the advice to write a manifest."""
        in_row = problem.field in row or (problem.found == "nothing" and problem.field not in options)
        if draft.manifest_line is None and problem.field == "camera" and in_row:
            return replace(
                problem, expected=f"{problem.expected}; or, if the clips have different cameras, {_MANIFEST}"
            )
        if draft.manifest_line is None or not in_row:
            return problem
        return replace(problem, file=draft.manifest_line[0], field=f"{draft.manifest_line[1]}, {problem.field}")

    try:
        return read_settings(config, {"keypoints": draft.paths, **options, **row})
    except InputError as error:
        raise InputError(map(located, error.problems)) from None


def _name_problems(drafts: Sequence[_Draft]) -> Iterator[Problem]:
    """Yield problems with the names given in manifests, which have to be plain and unique."""
    named = [
        (draft.name, draft.manifest_line)
        for draft in drafts
        if draft.name is not None and draft.manifest_line is not None
    ]
    uses = Counter(name.casefold() for name, _ in named)
    for name, (manifest, line) in named:
        if _UNFIT.search(name) or name.startswith(".") or name.casefold() in (SUMMARY, SUMMARY_PAGE):
            expected = f"a plain name of a folder below --out, other than {SUMMARY} and {SUMMARY_PAGE}"
            yield Problem(manifest, f"{line}, out", repr(name), expected)
        elif uses[name.casefold()] > 1:
            yield Problem(manifest, f"{line}, out", f"{name!r} more than once", "a unique name")


def _names(drafts: Sequence[_Draft]) -> list[str]:
    """Return the names of the clips.

    A clip has the name that the user gave, or else its file name. If several files share a name, the suffix or the
    folders are added. The animal and the frames follow if they were given for the clip, and a number if the name is
    still not unique.
    """
    file_name = file_names(dict.fromkeys(draft.title for draft in drafts))
    taken = {SUMMARY, SUMMARY_PAGE, *(draft.name.casefold() for draft in drafts if draft.name is not None)}
    names = []
    for draft in drafts:
        tags = (str(draft.row[key]).replace(":", "-") for key in ("individual", "frames") if key in draft.row)
        plain = _UNFIT.sub("_", encodable("-".join((file_name[draft.title], *tags))))
        plain = plain.encode()[:MAX_BYTES].decode(errors="ignore").strip(". ") or "clip"
        free = (name for i in counting(1) if (name := f"{plain}-{i}" if i > 1 else plain).casefold() not in taken)
        names.append(draft.name or next(free))
        taken.add(names[-1].casefold())
    return names


def file_names(paths: Sequence[Path] | Mapping[Path, None]) -> dict[Path, str]:
    """Return a unique name for each file, which is its stem where no other file has the same one.

    Files of one folder with the same stem get their suffix, and files of several folders as many parent folders as
    necessary.
    """
    siblings = Counter((path.parent, path.stem.casefold()) for path in paths)
    has_twin = (siblings[path.parent, path.stem.casefold()] > 1 for path in paths)
    stems = {p: f"{p.stem}-{p.suffix[1:]}" if twin else p.stem for p, twin in zip(paths, has_twin, strict=True)}
    names, depth, ambiguous = stems, 0, [*paths]
    # Names that are not yet unique get one more parent folder in each round.
    while ambiguous:
        uses, depth = Counter(name.casefold() for name in names.values()), depth + 1
        ambiguous = [path for path in paths if uses[names[path].casefold()] > 1 and depth < len(path.parent.parts)]
        names = names | {path: "-".join([*path.parent.parts[-depth:], stems[path]]) for path in ambiguous}
    return names
