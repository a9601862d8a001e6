"""Which clips a batch has: files, globs, folders and manifests in, one `Clip` with its settings and name each out."""

from __future__ import annotations

import csv
import glob
import os
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from recon.base.documents import read_toml
from recon.base.errors import InputError, Problem, refuse
from recon.check import names_text
from recon.io import file_head, individuals, recognised, titles
from recon.io.calibration import read_cameras
from recon.io.deeplabcut_project import Project, find_project, predictions
from recon.io.table import SEPARATORS, text_rows
from recon.show.page import SUMMARY_PAGE
from recon.workflows.batch.groups import AUTO, NONE, ClipDraft, join_cameras, missing_cameras
from recon.workflows.settings import SETTINGS, FitSettings, beside, read_settings

SUMMARY = "summary.csv"
_UNFIT = re.compile(r'[<>:"/\\|?*\x00-\x1f]')
"""Characters that some file system does not take in a name."""
BETWEEN = "|"
"""In a manifest's cell, between the files, names or numbers of several cameras."""
LEAST_NO_METRES = 1.0
"""No board has squares of a metre: a calibration with such a number is in another unit."""

POSES = {"pose_2d_filter": "pose-2d-filtered", "pose_2d": "pose-2d"}
"""Folders of a session by what config.toml calls them, the better one first."""

SQUARE = "board_square_side_length"


@dataclass(frozen=True)
class Clip:
    """One fit of a batch. name: of its folder, unique among the batch's clips whatever their case."""

    name: str
    settings: FitSettings


def find_clips(
    inputs: Sequence[str | Path],
    common: Mapping[str, Any],
    config: Path | None = None,
    cameras_by: str = AUTO,
    posed: bool = True,
) -> tuple[list[Clip], list[str]]:
    """The clips of all inputs in their order, and notes: what was left out, and which files are one clip.

    inputs: keypoint files, quoted globs, DeepLabCut's projects (a folder with config.yaml, or that file: the tables
    beside its videos), other folders (every file that a reader recognises; of files that differ in their
    suffix only the last one, .h5 rather than .csv, as DeepLabCut writes its tables twice; Anipose's sessions) and CSV
    manifests (a header with `keypoints`). common: settings of every clip by name, None where not given; a manifest's
    cells overrule them, and they overrule those of config. Each animal of a file of several is a clip, unless one is
    chosen. cameras_by: which files are one clip, see `join_cameras`; posed: only if the camera file says where its
    cameras stand.
    Raises InputError with the problems of all inputs and rows.
    """
    drafts, notes, problems = [], [], []
    for given in inputs:
        try:
            found, said = _drafts_of(str(given), common)
        except InputError as error:
            problems += error.problems
        else:
            drafts += found
            notes += said
    try:
        cameras_of = _cameras_of(common, config, posed)
        drafts, said = join_cameras(_without_repeats(drafts), cameras_by, common.get("camera_name"), cameras_of)
        notes += said
    except InputError as error:
        problems += error.problems
    every: list[tuple[ClipDraft, FitSettings]] = []
    for draft in drafts:
        try:
            every += _each_animal(draft, _settings(draft, common, config))
        except InputError as error:
            problems += error.problems
    problems += _name_problems(drafts)
    drafts = [draft for draft, _ in every]
    refuse(dict.fromkeys(problems))  # what all clips have in common is said once
    if not drafts:
        raise InputError(Problem("INPUT", "clips", "none", "keypoint files, a folder of them, or a manifest"))
    names = _names(drafts)
    notes += [] if cameras_by == NONE else missing_cameras(drafts, names)
    return [Clip(name, settings) for name, (_, settings) in zip(names, every, strict=True)], notes


# -- inputs -------------------------------------------------------------------------------------------------------


def _drafts_of(given: str, common: Mapping[str, Any]) -> tuple[list[ClipDraft], list[str]]:
    path = Path(given)
    if os.path.exists(path) and (project := find_project(path)):  # a Path raises OSError where a name is too long
        return _drafts_of_project(project)
    if os.path.isdir(path):
        files, notes = _files_in(path)
        of_anipose = _sessions_in(path) if not files or path.absolute().name.startswith("pose-2d") else []
        if of_anipose:
            return _drafts_of_sessions(of_anipose, common)
        if not files:
            raise InputError(Problem(path, "files", "no keypoint files", f"files of a known format: {titles('2D')}"))
        return [ClipDraft((file,)) for file in files], notes
    if not os.path.exists(path) and glob.has_magic(given):
        matches = [Path(match) for match in sorted(glob.glob(given, recursive=True))]
        files = [match for match in matches if not match.is_dir()]
        if not files:
            raise InputError(Problem(given, "files", "none that match", "a pattern such as 'clips/*.csv'"))
        return [draft for file in files for draft in _drafts_of_file(file)], []
    file_head(path)  # a typing error ends the batch before it begins
    return _drafts_of_file(path), []


def _drafts_of_file(path: Path) -> list[ClipDraft]:
    return _drafts_of_manifest(path) if is_manifest(path) else [ClipDraft((path.absolute(),))]


def _drafts_of_project(project: Project) -> tuple[list[ClipDraft], list[str]]:
    """A draft for each video of DeepLabCut's project that a network has analysed, called as the video."""
    found, left_out = predictions(project)
    drafts = [
        ClipDraft((file.absolute(),), called=file.absolute().with_name(f"{video}{file.suffix}"))
        for video, file in found.items()
    ]
    notes = [f"{project.folder} is a project of DeepLabCut: {len(drafts)} of its videos are analysed."]
    if left_out:
        notes.append(f"Left out, other tables of the same videos: {names_text(left_out)}")
    return drafts, notes


def _drafts_of_sessions(sessions: Sequence[_Session], common: Mapping[str, Any]) -> tuple[list[ClipDraft], list[str]]:
    """A draft for each file of 2D poses, with the calibration of its session unless another camera is given."""
    own_cameras = common.get("camera") is None and common.get("hfov_deg") is None
    drafts, notes, problems = [], [], []
    for session in sessions:
        files, said = _files_in(session.poses)
        notes += said
        row = {}
        if own_cameras and session.calibration is None:
            expected = "calibration/calibration.toml in it or above it, or --camera"
            problems.append(Problem(session.folder, "calibration", "none", expected))
        elif own_cameras:
            row = {"camera": str(session.calibration)}
            if common.get("camera_unit") is None and (session.square_length or 0.0) >= LEAST_NO_METRES:
                found = f"{session.square_length:g}, so that the calibration is not in metres"
                expected = "its unit besides, as in --camera-unit mm"
                problems.append(
                    Problem(session.cam_regex[0] if session.cam_regex else session.folder, SQUARE, found, expected)
                )
        drafts += [
            ClipDraft((file,), row, called=session.folder / file.name, cam_regex=session.cam_regex) for file in files
        ]
    refuse(dict.fromkeys(problems))
    if not drafts:
        places = names_text([str(session.poses) for session in sessions])
        raise InputError(Problem(places, "files", "no keypoint files", f"files of a known format: {titles('2D')}"))
    folders = dict.fromkeys(session.poses.name for session in sessions)
    said = (
        f"{len(sessions)} session{'s' * (len(sessions) > 1)} of Anipose: {len(drafts)} files of {' and '.join(folders)}"
    )
    return drafts, [said, *notes]


def _files_in(folder: Path) -> tuple[list[Path], list[str]]:
    chosen: dict[str, Path] = {}
    twins, others, unreadable = [], [], []
    for path in sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")):
        if not os.access(path, os.R_OK):
            unreadable.append(path)
        elif not _is_recognised(path):
            others.append(path)
        else:
            if path.stem in chosen:
                twins.append(chosen[path.stem])
            chosen[path.stem] = path
    notes = []
    if inside := [path.name for path in sorted(folder.iterdir()) if path.is_dir() and not path.name.startswith(".")]:
        notes.append(f"Folders in {folder} are not read ({names_text(inside)}); '{folder}/**/*.csv' reads them, too.")
    reasons = {"beside a file of the same name": twins, "of no known format": others, "not readable": unreadable}
    for why, left_out in reasons.items():
        if left_out:
            notes.append(f"Left out of {folder}, {why}: {names_text([path.name for path in left_out])}")
    return [path.absolute() for path in chosen.values()], notes


def _is_recognised(path: Path) -> bool:
    """Whether a reader takes the file; one that is too damaged to tell is a clip, which will say so."""
    try:
        file_head(path)
    except InputError:
        return False
    try:
        return recognised(path, "2D") is not None
    except InputError:
        return True


def _without_repeats(drafts: Sequence[ClipDraft]) -> list[ClipDraft]:
    """A file that two patterns name is one clip; the rows of a manifest are all meant."""
    seen: set[Path] = set()
    kept = []
    for draft in drafts:
        if draft.where is not None or not seen.issuperset(draft.paths):
            kept.append(draft)
        if draft.where is None:
            seen.update(draft.paths)
    return kept


# -- sessions of Anipose: at any depth, with 2D poses, and a calibration there or above -------------------------------


class _Session(NamedTuple):
    """A session of Anipose."""

    folder: Path
    poses: Path
    """The folder with its keypoint files."""
    calibration: Path | None
    """Its own, or the next one above it."""
    cam_regex: tuple[Path, str] | None
    """The pattern of cameras in names, with the file that has it."""
    square_length: float | None
    """Of the calibration's board, in the unit of the calibration."""


def _sessions_in(folder: Path) -> list[_Session]:
    """The sessions of a project, one session, or that of a folder of 2D poses. Of filtered 2D poses and others of one
    session the filtered ones. Raises InputError for a config.toml that cannot be read."""
    folder = folder.absolute()
    pipeline = _table(_config(folder)[0], "pipeline")
    names = [str(pipeline.get(key, name)) for key, name in POSES.items()]
    if folder.name in names:
        return [_session(folder.parent, folder)]
    found: dict[Path, Path] = {}
    for name in names:
        for poses in folder.rglob(name):
            if poses.is_dir() and any(path.is_file() for path in poses.iterdir()):
                found.setdefault(poses.parent, poses)
    return [_session(session, found[session]) for session in sorted(found)]


def _session(folder: Path, poses: Path) -> _Session:
    config, file = _config(folder)
    name = str(_table(config, "pipeline").get("calibration_results", "calibration"))
    above = [folder, *folder.parents]
    if file is not None:
        above = above[: above.index(file.parent) + 1]
    calibrations = (parent / name / "calibration.toml" for parent in above)
    calibration = next((path for path in calibrations if path.is_file()), None)
    regex, length = _table(config, "triangulation").get("cam_regex"), _table(config, "calibration").get(SQUARE)
    cam_regex = (file, regex) if file is not None and isinstance(regex, str) else None
    return _Session(folder, poses, calibration, cam_regex, float(length) if isinstance(length, int | float) else None)


def _config(folder: Path) -> tuple[Mapping[str, Any], Path | None]:
    """Of the project that a folder belongs to, with its file, if there is one."""
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
    """Whether a file is a CSV table whose header has a column `keypoints`."""
    return path.suffix.lower() == ".csv" and os.path.isfile(path) and "keypoints" in _header(path)


def _header(path: Path) -> list[str]:
    with path.open("rb") as file:
        line = file.readline(65536).decode("utf-8-sig", errors="replace")
    line = next(iter(line.strip().splitlines()), "")  # lines may end as on old Macs
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=max(SEPARATORS, key=line.count)), [])]
    except csv.Error:
        return []


def _drafts_of_manifest(path: Path) -> list[ClipDraft]:
    """One draft a row. Raises InputError with everything that is wrong with the table itself."""
    header = _header(path)
    known = ("out", *SETTINGS)
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
        values = {name: beside(path.parent, name, _cell_value(name, cell)) for name, cell in row.items()}
        files = [file for one in values.pop("keypoints") for file in _matching_files(Path(one))]
        if not files:
            problems.append(Problem(path, f"{line}, keypoints", f"no files that match {row['keypoints']}", "some"))
            continue
        drafts.append(ClipDraft(tuple(files), values, out, (path, line)))
    if not drafts and not problems:
        problems.append(Problem(path, "rows", "none", "one row a clip below the header"))
    refuse(problems)
    return drafts


def _cell_value(name: str, cell: str) -> str | list[str]:
    """A cell of what each camera has, as a list."""
    return [one.strip() for one in cell.split(BETWEEN)] if name in SETTINGS and SETTINGS[name].is_many else cell


def _matching_files(path: Path) -> list[Path]:
    """A file, or those of a pattern."""
    if os.path.exists(path) or not glob.has_magic(str(path)):
        return [path]
    return [file for match in sorted(glob.glob(str(path), recursive=True)) if (file := Path(match)).is_file()]


# -- settings -----------------------------------------------------------------------------------------------------


def _settings(draft: ClipDraft, common: Mapping[str, Any], config: Path | None) -> FitSettings:
    """A row over the common options over config. Problems of a row are said of the manifest's line."""
    row = draft.row
    under = {name: value for name, value in common.items() if value is not None and name not in row}
    if "camera" in row and under.pop("hfov_deg", None) is not None:
        under.pop("image_size_px", None)
    if "hfov_deg" in row:
        under = {name: value for name, value in under.items() if name not in ("camera", "camera_name")}
    if "method" in row:  # the common options are for the clips of the other method
        under = {name: value for name, value in under.items() if SETTINGS[name].option.method in (None, row["method"])}
    try:
        return read_settings(config, {"keypoints": draft.paths, **under, **row})
    except InputError as error:
        raise InputError(_problem_of_row(problem, draft, under) for problem in error.problems) from None


def _each_animal(draft: ClipDraft, settings: FitSettings) -> list[tuple[ClipDraft, FitSettings]]:
    animals = () if settings.individual is not None else individuals(settings.keypoints[0])
    if not animals:
        return [(draft, settings)]
    names = [None if draft.name is None else f"{draft.name}-{animal}" for animal in animals]
    return [
        (replace(draft, row={**draft.row, "individual": animal}, name=name), replace(settings, individual=animal))
        for animal, name in zip(animals, names, strict=True)
    ]


_OF_SEVERAL = ("offset_s", "camera_track", "camera_fps", "find_offsets", "refine_cameras", "focal_sigma")
"""What may be there once for each camera of a clip."""


def _cameras_of(common: Mapping[str, Any], config: Path | None, posed: bool) -> Callable[[ClipDraft], tuple[str, ...]]:
    """A function of a draft, which may still be a part of a clip: the names of the cameras in its file that can film a
    clip together, none where they cannot, or where it is given which camera is meant. posed: without poses they
    cannot."""
    read = cache(read_cameras)

    def names_of(draft: ClipDraft) -> tuple[str, ...]:
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


def _problem_of_row(problem: Problem, draft: ClipDraft, common: Mapping[str, Any]) -> Problem:
    in_row = problem.field in draft.row or (problem.found == "nothing" and problem.field not in common)
    if draft.where is None or not in_row:
        return problem
    manifest, line = draft.where
    return replace(problem, file=manifest, field=f"{line}, {problem.field}")


# -- names --------------------------------------------------------------------------------------------------------


def _name_problems(drafts: Sequence[ClipDraft]) -> list[Problem]:
    """Of names given in manifests: they must be plain, and different."""
    problems = []
    count = Counter(draft.name.casefold() for draft in drafts if draft.name is not None)
    for draft in drafts:
        if draft.name is None or draft.where is None:
            continue
        manifest, line = draft.where
        if _UNFIT.search(draft.name) or draft.name.startswith(".") or draft.name.casefold() in (SUMMARY, SUMMARY_PAGE):
            expected = f"a plain name of a folder below --out, other than {SUMMARY} and {SUMMARY_PAGE}"
            problems.append(Problem(manifest, f"{line}, out", repr(draft.name), expected))
        elif count[draft.name.casefold()] > 1:
            problems.append(Problem(manifest, f"{line}, out", f"{draft.name!r} more than once", "a name of its own"))
    return problems


def _names(drafts: Sequence[ClipDraft]) -> list[str]:
    """As given; else the file's name, with its suffix or its folders where files share it, the animal and the frames
    where the row says them, and a number where that is still not enough."""
    base = file_names(dict.fromkeys(draft.title for draft in drafts))
    taken = {SUMMARY, SUMMARY_PAGE, *(draft.name.casefold() for draft in drafts if draft.name is not None)}
    names = []
    for draft in drafts:
        name = draft.name
        if name is None:
            plain = _UNFIT.sub("_", base[draft.title] + draft.tag).strip(". ") or "clip"
            name, count = plain, 1
            while name.casefold() in taken:
                count += 1
                name = f"{plain}-{count}"
            taken.add(name.casefold())
        names.append(name)
    return names


def file_names(paths: Sequence[Path] | Mapping[Path, None]) -> dict[Path, str]:
    """A name for each file: those that share it get their suffix or as many folders in front as it takes."""
    siblings = Counter((path.parent, path.stem.casefold()) for path in paths)
    stems = {
        path: f"{path.stem}-{path.suffix[1:]}" if siblings[path.parent, path.stem.casefold()] > 1 else path.stem
        for path in paths
    }
    depth = dict.fromkeys(paths, 0)

    def name(path: Path) -> str:
        folders = [part for part in path.parent.parts if part != path.anchor]
        return "-".join([*folders[len(folders) - depth[path] :], stems[path]])

    while True:
        count = Counter(name(path).casefold() for path in paths)
        shared = [p for p in paths if count[name(p).casefold()] > 1 and depth[p] < len(p.parent.parts) - 1]
        if not shared:
            return {path: name(path) for path in paths}
        for path in shared:
            depth[path] += 1
