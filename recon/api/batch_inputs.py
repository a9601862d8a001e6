"""Which clips a batch has: files, patterns, folders and manifests in, a `Clip` with its settings and name each out."""

from __future__ import annotations

import glob
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import count, islice
from pathlib import Path
from typing import Any

from recon.api.clip_cameras import cameras_in
from recon.api.clip_results import beside, read_settings
from recon.api.settings import SETTINGS, FitSettings
from recon.base.arrays import Brief
from recon.base.documents import read_head, read_toml
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.file_names import encodable
from recon.base.patterns import slow_part
from recon.check.codes import names_text
from recon.fit.motion_forms import MOTION
from recon.io.calibration import read_cameras
from recon.io.common import text_rows
from recon.io.deeplabcut_project import find_project, predictions
from recon.io.formats import individuals, recognised, titles
from recon.io.json_poses import clip_of_frame
from recon.show.page.own_page import SUMMARY_PAGE

SUMMARY = "summary.csv"
AUTO, NONE = "auto", "none"
OPTION = "--cameras-by"
SEPARATORS = "-_. "
"""In a file's name, beside the camera's."""
_MANIFEST = "a CSV table with columns keypoints, camera and fps"
_UNFIT = re.compile(r'[<>:"/\\|?*\x00-\x1f]')
"""Characters that some file system does not take in a name."""
BETWEEN = "|"
"""In a manifest's cell, between the files, names or numbers of several cameras."""
LEAST_NO_METRES = 1.0
"""No board has squares of a metre: a calibration with such a number is in another unit."""
POSES = {"pose_2d_filter": "pose-2d-filtered", "pose_2d": "pose-2d"}
"""Folders of Anipose's session by what config.toml calls them, the better one first."""
SQUARE = "board_square_side_length"
_OF_SEVERAL = ("offset_s", "camera_track", "camera_fps", "find_offsets", "refine_cameras", "focal_sigma")
"""What may be there once for each camera of a clip."""


@dataclass(frozen=True, repr=False)
class Clip(Brief):
    """One fit of a batch. name: of its folder, unique among the batch's clips whatever their case."""

    name: str
    settings: FitSettings


@dataclass(frozen=True)
class _Draft:
    """A clip, or a part of one, with the settings that it has of its own."""

    paths: tuple[Path, ...]
    row: Mapping[str, Any] = field(default_factory=dict)
    name: str | None = None
    where: tuple[Path, str] | None = None
    """The manifest and the line that say so."""
    called: Path | None = None
    """What it is named after, where that is not its only file."""
    cam_regex: tuple[Path, str] | None = None
    """Anipose's pattern of cameras in names, with the file that has it."""
    by: str | None = None
    """Whose rule found the camera in its files' names."""

    @property
    def title(self) -> Path:
        return self.called or self.paths[0]


Drafts = tuple[list[_Draft], list[str]]
"""With notes: what was left out, and which files are one clip."""


def find_clips(
    inputs: Sequence[str | Path],
    common: Mapping[str, Any],
    config: Path | None = None,
    cameras_by: str = AUTO,
    posed: bool = True,
    recursive: bool = False,
) -> tuple[list[Clip], list[str]]:
    """The clips of all inputs in their order, and notes: what was left out, and which files are one clip.

    inputs: keypoint files, quoted patterns, DeepLabCut's projects (a folder with config.yaml, or that file: the tables
    beside its videos), other folders (every file that a reader recognises; of files that differ in their
    suffix only the last one, .h5 rather than .csv, as DeepLabCut writes its tables twice; Anipose's sessions) and CSV
    manifests (a header with `keypoints`). common: settings of every clip by name, None where not given; a manifest's
    cells overrule them, and they overrule those of config. Each animal of a file of several is a clip, unless one is
    chosen. cameras_by: which files are one clip, see `_joined`; posed: only if the camera file says where its cameras
    stand. recursive: folders within folders, too. Raises InputError with the problems of all inputs and rows.
    """
    problems: list[Problem] = []

    def tried(make: Callable[..., Any], *given: Any, otherwise: Any = ((), ())) -> Any:
        try:
            return make(*given)
        except InputError as error:
            problems.extend(error.problems)
            return otherwise

    found = [tried(_drafts_of, str(given), common, recursive) for given in inputs]
    notes = [note for _, said in found for note in said]
    drafts = _without_repeats([draft for some, _ in found for draft in some])
    cameras_of = _cameras_of(common, config, posed)
    drafts, said = tried(_joined, drafts, cameras_by, common.get("camera_name"), cameras_of, otherwise=(drafts, []))
    every = [one for draft in drafts for one in tried(_with_settings, draft, common, config, otherwise=[])]
    raise_problems(dict.fromkeys((*problems, *_name_problems(drafts))))  # what all clips have in common is said once
    if not every:
        raise InputError(Problem("INPUT", "clips", "none", "keypoint files, a folder of them, or a manifest"))
    names = _names([draft for draft, _ in every])
    lacking = [] if cameras_by == NONE else _missing_cameras([draft for draft, _ in every], names)
    clips = [Clip(name, settings) for name, (_, settings) in zip(names, every, strict=True)]
    return clips, [*notes, *said, *lacking]


# -- inputs -------------------------------------------------------------------------------------------------------


def _drafts_of(given: str, common: Mapping[str, Any], recursive: bool) -> Drafts:
    path = Path(given)
    if os.path.exists(path) and (project := find_project(path)):  # a Path raises OSError where a name is too long
        found, left_out = predictions(project)
        files = [(file.absolute(), f"{video}{file.suffix}") for video, file in found.items()]
        notes = [f"{project.folder} is a project of DeepLabCut, with tables of {len(files)} of its videos."]
        notes += [f"Left out, other tables of the same videos: {names_text(left_out)}"] if left_out else []
        return [_Draft((file,), called=file.with_name(name)) for file, name in files], notes
    if os.path.isdir(path):
        files, notes = _files_in(path, recursive)
        here = any(file.parent == path.absolute() for file in files)
        if (not here or path.absolute().name.startswith("pose-2d")) and (sessions := _sessions_in(path)):
            return _drafts_of_sessions(sessions, common)
        if not files:
            deeper = "" if recursive else "; --recursive looks further down"
            raise InputError(Problem(path, "files", "no keypoint files", f"a known format: {titles('2D')}{deeper}"))
        return [_draft_of(file) for file in files], notes
    files = _matching_files(path)
    if not files:
        raise InputError(Problem(given, "files", "none that match", "a pattern such as 'clips/*.csv'"))
    if files == [path]:
        read_head(path)  # a typing error ends the batch before it begins
    each = (_drafts_of_manifest(file) if is_manifest(file) else [_draft_of(file.absolute())] for file in files)
    return [draft for drafts in each for draft in drafts], []


def _draft_of(file: Path) -> _Draft:
    return _Draft((file,), called=clip_of_frame(file))


def _matching_files(path: Path) -> list[Path]:
    """A file, or those of a pattern."""
    if "\0" in str(path):  # no file has such a name, and resolving it fails
        return []
    if os.path.exists(path) or not glob.has_magic(str(path)):
        return [path]
    return [file for match in sorted(glob.glob(str(path), recursive=True)) if (file := Path(match)).is_file()]


def _files_in(folder: Path, recursive: bool = False) -> tuple[list[Path], list[str]]:
    if (folder / MOTION).is_file():
        return [], [f"Left out, results of a fit: {folder}"]
    chosen: dict[str, Path] = {}
    left_out: dict[str, list[str]] = {}
    inside = []
    for path in sorted(p for p in folder.iterdir() if not p.name.startswith(".")):
        if path.is_dir():
            inside.append(path)
        elif why := _why_left_out(path):
            left_out.setdefault(why, []).append(path.name)
        elif clip := clip_of_frame(path):
            chosen.setdefault(str(clip), path.absolute())
        else:
            if path.stem in chosen:
                left_out.setdefault("beside a file of the same name", []).append(chosen[path.stem].name)
            chosen[path.stem] = path.absolute()
    notes = [f"Left out of {folder}, {why}: {names_text(names)}" for why, names in sorted(left_out.items())]
    files = [*chosen.values()]
    for sub in inside if recursive else ():
        more, said = _files_in(sub, recursive)
        files, notes = files + more, notes + said
    if files and inside and not recursive:
        notes.insert(0, f"Folders in {folder} are not read ({names_text([p.name for p in inside])}): see --recursive.")
    return files, notes


def _why_left_out(path: Path) -> str:
    """Why a file of a folder is no clip; nothing of one that is, or too damaged to tell, as the clip will say so."""
    if not os.access(path, os.R_OK):
        return "not readable"
    try:
        if not path.stat().st_size or recognised(path, "2D") is None:
            with suppress(InputError):
                return "cameras (for a manifest's column camera)" if read_cameras(path) else ""
            return "of no known format"
        if any({"x", "y", "z"} <= {*cells} for _, cells in islice(text_rows(path), 4)):  # the rows of a header
            return "3D positions"
    except OSError:  # of a disk that fails
        return "not readable"
    except InputError:
        pass
    return ""


def _without_repeats(drafts: Sequence[_Draft]) -> list[_Draft]:
    """A file that two patterns name is one clip, and files of its frames are, by whatever way to their folder; the rows
    of a manifest are all meant."""
    seen: set[Path] = set()
    kept = []
    for draft in drafts:
        title, *paths = (path.parent.resolve() / path.name for path in (draft.title, *draft.paths))
        if draft.where is not None or not (title in seen or seen.issuperset(paths)):
            kept.append(draft)
        if draft.where is None:
            seen.update((title, *paths))
    return kept


# -- sessions of Anipose: at any depth, with 2D poses, and a calibration there or above -------------------------------


def _sessions_in(folder: Path) -> list[tuple[Path, Path]]:
    """The sessions of a project, one session, or that of a folder of 2D poses, each with its folder of keypoint files:
    of filtered 2D poses and others the filtered ones. Raises InputError for a config.toml that cannot be read."""
    folder = folder.absolute()
    pipeline = _table(_anipose_config(folder)[0], "pipeline")
    names = [str(pipeline.get(key, name)) for key, name in POSES.items()]
    if folder.name in names:
        return [(folder.parent, folder)]
    found: dict[Path, Path] = {}
    for name in names:
        for poses in folder.rglob(name):
            if poses.is_dir() and any(path.is_file() for path in poses.iterdir()):
                found.setdefault(poses.parent, poses)
    return sorted(found.items())


def _drafts_of_sessions(sessions: Sequence[tuple[Path, Path]], common: Mapping[str, Any]) -> Drafts:
    """A draft for each file of 2D poses, with the calibration of its session, its own or the next one above it, unless
    another camera is given."""
    drafts, notes, problems = [], [], []
    for folder, poses in sessions:
        config, file = _anipose_config(folder)
        above = [folder, *folder.parents]
        above = above if file is None else above[: above.index(file.parent) + 1]
        name = str(_table(config, "pipeline").get("calibration_results", "calibration"))
        calibration = next((p for parent in above if (p := parent / name / "calibration.toml").is_file()), None)
        square, regex = _table(config, "calibration").get(SQUARE), _table(config, "triangulation").get("cam_regex")
        own = common.get("camera") is None and common.get("hfov_deg") is None
        if own and calibration is None:
            expected = "calibration/calibration.toml in it or above it, or --camera"
            problems.append(Problem(folder, "calibration", "none", expected))
        unsaid = own and calibration is not None and common.get("camera_unit") is None
        if unsaid and isinstance(square, int | float) and square >= LEAST_NO_METRES:
            found = f"{square:g}, so that the calibration is not in metres"
            problems.append(Problem(file or folder, SQUARE, found, "its unit besides, as in --camera-unit mm"))
        row = {"camera": str(calibration)} if own else {}
        cam_regex = (file, regex) if file is not None and isinstance(regex, str) else None
        files, said = _files_in(poses)
        drafts += [_Draft((path,), row, called=folder / path.name, cam_regex=cam_regex) for path in files]
        notes += said
    raise_problems(dict.fromkeys(problems))
    if not drafts:
        places = names_text([str(poses) for _, poses in sessions])
        raise InputError(Problem(places, "files", "no keypoint files", f"files of a known format: {titles('2D')}"))
    folders = " and ".join(dict.fromkeys(poses.name for _, poses in sessions))
    count = f"{len(sessions)} session{'s' * (len(sessions) > 1)}"
    return drafts, [f"{count} of Anipose: {len(drafts)} files of {folders}", *notes]


def _anipose_config(folder: Path) -> tuple[Mapping[str, Any], Path | None]:
    """The configuration of the project that a folder belongs to, with its file, if there is one."""
    for parent in (folder, *folder.parents):
        path = parent / "config.toml"
        if path.is_file():
            config = read_toml(path, "Anipose's settings")
            if config.keys() & {"triangulation", "pipeline", "nesting", "model_folder"}:
                return config, path
    return {}, None


def _table(config: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = config.get(name)
    return table if isinstance(table, dict) else {}


# -- manifests ----------------------------------------------------------------------------------------------------


def is_manifest(path: Path) -> bool:
    """Whether a file is a CSV table with a column `keypoints`, or `camera`, where the other is misspelt; keypoints may
    have a column of that name, too."""
    try:
        header = _header(path) if path.suffix.lower() == ".csv" and os.path.isfile(path) else ()
        return "keypoints" in header or ("camera" in header and recognised(path) is None)
    except (InputError, OSError):  # no table of text, or a disk that fails: the clip will say so
        return False


def _header(path: Path) -> list[str]:
    return [cell.strip() for cell in next(text_rows(path), (0, []))[1]]


def _drafts_of_manifest(path: Path) -> list[_Draft]:
    """One draft a row. Raises InputError with everything that is wrong with the table itself."""
    header, known, many = _header(path), ("out", *SETTINGS), {name for name, info in SETTINGS.items() if info.is_many}
    problems = [
        Problem(path, f"column {name!r}" if name else "header", "an unknown column", f"one of {', '.join(known)}")
        for name in header
        if name not in known
    ]
    drafts = []
    for line_number, cells in islice(text_rows(path), 1, None):
        line = f"line {line_number}"
        if len(cells) > len(header):
            problems.append(Problem(path, line, f"{len(cells)} cells", f"{len(header)}, as in the header"))
        row = {name: cell.strip() for name, cell in zip(header, cells, strict=False) if cell.strip()}
        if "keypoints" not in row:
            problems.append(Problem(path, f"{line}, keypoints", "nothing", "a keypoint file"))
            continue
        out = row.pop("out", None)
        lists = {name: [one.strip() for one in cell.split(BETWEEN)] for name, cell in row.items() if name in many}
        values = {name: beside(path.parent, name, value) for name, value in (row | lists).items()}
        files = [file for one in values.pop("keypoints") for file in _matching_files(Path(one))]
        if not files:
            problems.append(Problem(path, f"{line}, keypoints", f"no files that match {row['keypoints']}", "some"))
            continue
        drafts.append(_Draft(tuple(files), values, out, (path, line)))
    if not drafts and not problems:
        problems.append(Problem(path, "rows", "none", "one row a clip below the header"))
    raise_problems(problems)
    return drafts


# -- which files are one clip that several cameras filmed ---------------------------------------------------------


def _joined(
    drafts: Sequence[_Draft],
    cameras_by: str,
    camera_name: str | Sequence[str] | None,
    cameras_of: Callable[[_Draft], Sequence[str]],
) -> Drafts:
    """The files of one clip in one draft, in the order of the drafts. camera_name: as given for every clip.

    cameras_by: a pattern; `AUTO`: Anipose's pattern, or the names of a draft's cameras, as `cameras_of` gives them, if
    any two files are one clip by them; `NONE`: nothing is joined. Files of one folder are one clip if their names are
    the same without what the pattern fits, or without the camera's name. A manifest's rows say themselves which files
    they have. Raises InputError for a faulty pattern, and one that fits no file.
    """
    pattern = None if cameras_by in (AUTO, NONE) else _compiled(cameras_by, OPTION)
    if pattern is not None and camera_name is not None:
        found = f"{camera_name if isinstance(camera_name, str) else ', '.join(camera_name)} beside {OPTION}"
        raise InputError(Problem("--camera-name", "camera_name", found, "one of the two"))
    groups: dict[Any, list[tuple[_Draft, _Draft]]] = {}  # as it was, and with its camera
    lost = []
    for draft in drafts:
        one = _with_camera(draft, pattern, cameras_by, cameras_of)
        if one.by is None and one.where is None and (pattern or one.cam_regex):
            lost.append(one.paths[0].name)
        elif one.by is None or cameras_by == NONE:
            groups[len(groups)] = [(draft, one)]
        else:
            row = {name: value for name, value in one.row.items() if name != "camera_name"}
            clip = one.title.parent, one.title.name.casefold(), repr(row)
            groups.setdefault(clip, []).append((draft, one))
    if lost and not any(one.by for group in groups.values() for _, one in group):
        found = f"no camera in {names_text(lost)}"
        raise InputError(Problem(OPTION, "pattern", found, "one that fits the files' names"))
    several = [[one for _, one in group] for group in groups.values() if len(group) > 1]
    joined = []
    for group in groups.values():
        draft, first = group[0]
        if first.by is None or (first.by == AUTO and not several):
            joined.append(draft)
        else:
            paths = tuple(path for _, one in group for path in one.paths)
            cameras = tuple(name for _, one in group for name in one.row["camera_name"])
            joined.append(replace(first, paths=paths, row={**first.row, "camera_name": cameras}))
    notes = [f"Left out, without a camera in the name: {names_text(lost)}"] if lost else []
    if several:
        rules = dict.fromkeys(one.by for group in several for one in group)
        by = " and ".join("the cameras' names in theirs" if rule == AUTO else str(rule) for rule in rules)
        clips = f"{len(several)} clips" if len(several) > 1 else "1 clip"
        otherwise = f" ({OPTION} {NONE} takes each by itself)" if OPTION not in rules else ""
        notes.append(f"{sum(map(len, several))} files are {clips} of several cameras, by {by}{otherwise}.")
    return joined, notes


def _with_camera(
    draft: _Draft, pattern: re.Pattern[str] | None, cameras_by: str, cameras_of: Callable[[_Draft], Sequence[str]]
) -> _Draft:
    """With the camera that its file's name says, and called after what is left of the name, or, if that is nothing,
    after its folder; as it is where the name says none, or a manifest has it."""
    if draft.where is not None:
        return draft
    title, by = draft.title, OPTION
    if pattern is None and draft.cam_regex is not None:
        text, config = draft.cam_regex[1], draft.cam_regex[0]
        pattern, by = _compiled_from_file(text, config), f"cam_regex in {config}"
    if pattern is not None:  # its first group is the camera's name, or all of it, as in Anipose
        match = pattern.search(title.stem)
        found = {} if match is None else {((match[1] if pattern.groups else match[0]) or "").strip(): match}
    else:
        by, found = AUTO, {} if cameras_by == NONE else cameras_in(title.stem, cameras_of(draft))
    if len(found) > 1:
        expected = f"the name of one camera; {OPTION} with a pattern that finds it, or {OPTION} {NONE}"
        raise InputError(Problem(title, "name", f"the cameras {' and '.join(found)}", expected))
    for camera, match in found.items():
        if camera:
            if cameras_by != NONE:
                rest = title.stem[: match.start()].rstrip(SEPARATORS) + title.stem[match.end() :]
                rest, folder = rest.strip(SEPARATORS), title.parent
                title = (folder if rest else folder.parent) / f"{rest or folder.name}{title.suffix}"
            return replace(draft, row={**draft.row, "camera_name": (camera,)}, called=title, by=by)
    return draft


@cache
def _compiled_from_file(text: str, file: Path) -> re.Pattern[str]:
    """Return a pattern that stands in a file; raise InputError for one that can take for ever."""
    pattern = _compiled(text, file)
    if slow := slow_part(text):
        expected = f"a simpler pattern, as in '-cam([A-Z])'; or {OPTION} with a pattern of your own"
        raise InputError(Problem(file, "cam_regex", f"{text[:100]!r}, with {slow}: it can take for ever", expected))
    return pattern


def _compiled(text: str, where: Path | str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        expected = "a regular expression that finds the camera's name in a file's name, as in '-cam([A-Z])'"
        raise InputError(Problem(where, "pattern", f"{text!r} ({error})", expected)) from None


def _cameras_of(common: Mapping[str, Any], config: Path | None, posed: bool) -> Callable[[_Draft], tuple[str, ...]]:
    """A function of a draft, which may still be a part of a clip: the names of the cameras in its file that can film a
    clip together, none where they cannot, or where it is given which camera is meant. posed: without poses they
    cannot."""
    read = cache(read_cameras)

    def names_of(draft: _Draft) -> tuple[str, ...]:
        own, of_all = ({n: v for n, v in of.items() if n not in _OF_SEVERAL} for of in (draft.row, common))
        try:
            settings = _settings(replace(draft, paths=draft.paths[:1], row=own), of_all, config)
            if settings.camera is None or settings.camera_name is not None or settings.method == "frame":
                return ()
            cameras = read(settings.camera, settings.image_size_px)
        except InputError:  # said later
            return ()
        usable = not posed or all(camera.has_extrinsics for camera in cameras)
        return tuple(camera.name for camera in cameras) if usable else ()

    return names_of


def _missing_cameras(drafts: Sequence[_Draft], names: Sequence[str]) -> list[str]:
    """A note of the joined clips, by name, that do not have all the cameras that others have."""
    every: dict[Any, dict[str, None]] = {}  # by project, whose cameras have names of their own
    by_name = [(name, draft) for name, draft in zip(names, drafts, strict=True) if draft.by]
    for _, draft in by_name:
        every.setdefault(draft.cam_regex, {}).update(dict.fromkeys(draft.row["camera_name"]))
    lacks = [
        f"{name} ({', '.join(missing)})"
        for name, draft in by_name
        if (missing := [one for one in every[draft.cam_regex] if one not in draft.row["camera_name"]])
    ]
    return [f"Fitted without cameras that others have: {names_text(lacks)}"] if lacks else []


# -- settings -----------------------------------------------------------------------------------------------------


def _with_settings(draft: _Draft, common: Mapping[str, Any], config: Path | None) -> list[tuple[_Draft, FitSettings]]:
    """A draft, or one for each animal in its file, with all settings."""
    settings = _settings(draft, common, config)
    animals = () if settings.individual is not None else individuals(settings.keypoints[0])
    if not animals:
        return [(draft, settings)]
    found = []
    for one in animals:
        name = draft.name and f"{draft.name}-{one}"
        own = replace(draft, row={**draft.row, "individual": one}, name=name)
        found.append((own, replace(settings, individual=one)))
    return found


def _settings(draft: _Draft, common: Mapping[str, Any], config: Path | None) -> FitSettings:
    """A row over the common options over config. Problems of a row are said of the manifest's line."""
    row = draft.row
    under = {name: value for name, value in common.items() if value is not None and name not in row}
    if "camera" in row and under.pop("hfov_deg", None) is not None:
        under.pop("image_size_px", None)
    if "hfov_deg" in row:
        under = {name: value for name, value in under.items() if name not in ("camera", "camera_name")}
    if "method" in row:  # the common options are for the clips of the other method
        under = {name: value for name, value in under.items() if SETTINGS[name].option.method in (None, row["method"])}

    def of_row(problem: Problem) -> Problem:
        in_row = problem.field in row or (problem.found == "nothing" and problem.field not in under)
        if draft.where is None and problem.field == "camera" and in_row:
            return replace(problem, expected=f"{problem.expected}; for clips with cameras of their own {_MANIFEST}")
        if draft.where is None or not in_row:
            return problem
        return replace(problem, file=draft.where[0], field=f"{draft.where[1]}, {problem.field}")

    try:
        return read_settings(config, {"keypoints": draft.paths, **under, **row})
    except InputError as error:
        raise InputError(map(of_row, error.problems)) from None


# -- names --------------------------------------------------------------------------------------------------------


def _name_problems(drafts: Sequence[_Draft]) -> Iterator[Problem]:
    """The problems of names given in manifests: they must be plain, and different."""
    named = [(draft.name, draft.where) for draft in drafts if draft.name is not None and draft.where is not None]
    count = Counter(name.casefold() for name, _ in named)
    for name, (manifest, line) in named:
        if _UNFIT.search(name) or name.startswith(".") or name.casefold() in (SUMMARY, SUMMARY_PAGE):
            expected = f"a plain name of a folder below --out, other than {SUMMARY} and {SUMMARY_PAGE}"
            yield Problem(manifest, f"{line}, out", repr(name), expected)
        elif count[name.casefold()] > 1:
            yield Problem(manifest, f"{line}, out", f"{name!r} more than once", "a name of its own")


def _names(drafts: Sequence[_Draft]) -> list[str]:
    """As given; else the file's name, with its suffix or its folders where files share it, the animal and the frames
    where the row says them, and a number where that is still not enough."""
    base = file_names(dict.fromkeys(draft.title for draft in drafts))
    taken = {SUMMARY, SUMMARY_PAGE, *(draft.name.casefold() for draft in drafts if draft.name is not None)}
    names = []
    for draft in drafts:
        tags = (str(draft.row[key]).replace(":", "-") for key in ("individual", "frames") if key in draft.row)
        plain = _UNFIT.sub("_", encodable("-".join((base[draft.title], *tags)))).strip(". ") or "clip"
        free = (name for i in count(1) if (name := f"{plain}-{i}" if i > 1 else plain).casefold() not in taken)
        names.append(draft.name or next(free))
        taken.add(names[-1].casefold())
    return names


def file_names(paths: Sequence[Path] | Mapping[Path, None]) -> dict[Path, str]:
    """A name for each file: those that share it get their suffix or as many folders in front as it takes."""
    siblings = Counter((path.parent, path.stem.casefold()) for path in paths)
    twins = (siblings[path.parent, path.stem.casefold()] > 1 for path in paths)
    stems = {p: f"{p.stem}-{p.suffix[1:]}" if twin else p.stem for p, twin in zip(paths, twins, strict=True)}
    names, depth, shared = stems, 0, [*paths]
    while shared:
        count, depth = Counter(name.casefold() for name in names.values()), depth + 1
        shared = [path for path in paths if count[names[path].casefold()] > 1 and depth < len(path.parent.parts)]
        names = names | {path: "-".join([*path.parent.parts[-depth:], stems[path]]) for path in shared}
    return names
