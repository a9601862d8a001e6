"""Find the files of DeepLabCut's project folder: `config.yaml`, `labeled-data` and `videos`.

Only names are needed from the configuration, so no YAML reader is used. DeepLabCut, and people who edit its files,
write one list item or one key per line.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from recon.base.documents import read_text
from recon.base.errors import InputError, Problem, raise_problems

CONFIG = "config.yaml"
SEVERAL = "MULTI!"
"""Value of `bodyparts` in projects with several animals, whose bodyparts are in `multianimalbodyparts`."""
_ENTRY = re.compile(r"([A-Za-z_]\w*)\s*:(?:\s+(.*))?")
_LABELS = ("labeled-data/*/CollectedData_*", "*/CollectedData_*", "CollectedData_*")
_PREDICTED = re.compile(
    r"(?P<video>.+?)_?(?P<network>(?:DLC|superanimal)_?.+?)(?P<tracker>_(?:el|bx|sk|ctd))?(?P<filtered>_filtered)?"
)
_TRACKERS = ("_el", "_ctd", "_sk", "_bx", None)
"""Suffixes of tables for each tracking method, the preferred method first; None for tables without a method."""
_OTHERS = ("_skeleton", "_3d")
"""Suffixes of tables without 2D keypoints, which hold lengths and angles, or 3D positions."""


@dataclass(frozen=True)
class Project:
    """Content of a DeepLabCut project's `config.yaml`, with empty fields for absent keys."""

    config: Path
    scorer: str
    """Name of the person who labelled."""
    bodyparts: tuple[str, ...]
    """Bodyparts of one animal."""
    video_sets: tuple[str, ...]
    """Paths of the videos, perhaps on another computer."""

    @property
    def folder(self) -> Path:
        """Return the project's folder, which holds `config.yaml`."""
        return self.config.parent


def find_project(path: Path) -> Project | None:
    """Return the DeepLabCut project of a folder or of its `config.yaml`, or None for any other path.

    Raises
    ------
    InputError
        If the configuration cannot be read.
    """
    config = path / CONFIG if path.is_dir() else path
    if config.suffix.lower() not in (".yaml", ".yml") or not config.is_file():
        return None
    entries = _entries(read_text(config, "DeepLabCut's config.yaml"))
    if not {"Task", "scorer"} <= {*entries}:
        return None
    names = entries.get("bodyparts", [])
    if names == [SEVERAL]:
        names = entries.get("multianimalbodyparts", [])
    return Project(config, "".join(entries["scorer"][:1]), tuple(names), tuple(entries.get("video_sets", ())))


def refuse_several(path: Path) -> None:
    """Raise InputError if a path where one keypoint file is needed is a folder or a DeepLabCut project."""
    if find_project(path):
        expected = (
            "one of its tables, such as videos/run1DLC_*.h5; the project as a whole is for recon batch, recon train "
            "and recon skeleton from-keypoints"
        )
        raise InputError(Problem(path, "file", "a DeepLabCut project", expected))
    if path.is_dir():
        openpose = [f" (for example {file.name})" for file in sorted(path.glob("*[0-9]*.json"))[:1]]
        expected = f"one of its files{''.join(openpose) or '; recon batch reads all files of a folder'}"
        raise InputError(Problem(path, "file", "a folder", expected))


def _entries(text: str) -> dict[str, list[str]]:
    """Return the value, the list items or the mapping's keys for each top-level key of a YAML document."""
    entries: dict[str, list[str]] = {}
    key, depth = "", 0
    for line in text.splitlines():
        plain = re.sub(r"(^|\s)#.*$", "", line).rstrip()
        bare = plain.lstrip()
        indent = len(plain) - len(bare)
        if not bare:
            continue
        if not indent and (entry := _ENTRY.fullmatch(bare)):
            key, depth = entry[1], 0
            value = entry[2] or ""
            inside = value[1:-1].split(",") if value[:1] + value[-1:] == "[]" else [value]
            entries[key] = [text for item in inside if (text := _text(item))]
        elif key and bare.startswith("- ") and not bare.startswith("- -"):
            entries[key].append(_text(bare[2:]))
        elif key and indent and (depth := depth or indent) == indent and not bare.startswith(": "):
            # A key that is too long for its line begins with "? ", and its value begins the next line with ": ".
            entries[key].append(_text(bare.removeprefix("? ").removesuffix(":")))
    return entries


def _text(item: str) -> str:
    item = item.strip()
    return item[1:-1] if len(item) > 1 and item[0] == item[-1] and item[0] in "'\"" else item


def bodyparts(project: Project) -> tuple[str, ...]:
    """Return the names of a project's keypoints.

    Raises
    ------
    InputError
        If the project names no keypoints.
    """
    if not project.bodyparts:
        expected = "the names of the keypoints, under bodyparts, or under multianimalbodyparts for several animals"
        raise InputError(Problem(project.config, "bodyparts", "no names", expected))
    return project.bodyparts


def label_files(folder: Path, scorer: str = "") -> list[Path]:
    """Return one label file from each folder with labels.

    If several people labelled, the file of the scorer is returned, otherwise the first in alphabetical order. CSV is
    preferred to H5.
    """
    for pattern in _LABELS:
        by_folder: dict[Path, list[Path]] = {}
        for file in sorted(folder.glob(pattern)):
            if file.suffix.lower() in (".csv", ".h5"):
                by_folder.setdefault(file.parent, []).append(file)
        if by_folder:
            return [min(files, key=lambda f: f.stem != f"CollectedData_{scorer}") for files in by_folder.values()]
    return []


def predictions(project: Project) -> tuple[dict[str, Path], tuple[str, ...]]:
    """Return the file of predictions for each video of a project, keyed by the video's name, and the files left out.

    Tables are in the folders of the videos: `videos`, or as configured. Within one network's tables of a video,
    unfiltered tables are preferred to filtered ones, tracked animals to untracked ones, and H5 to CSV.

    Raises
    ------
    InputError
        If there is no table, or if a video has tables of several networks.
    """
    video_folders = dict.fromkeys(
        (project.folder / "videos", *(Path(v).parent for v in project.video_sets if Path(v).is_file()))
    )
    folders = [folder for folder in video_folders if folder.is_dir()]
    by_video: dict[str, dict[str, list[tuple[bool, int, bool, Path]]]] = {}
    for file in (file for folder in folders for file in sorted(folder.iterdir())):
        named = None if file.stem.endswith(_OTHERS) else _PREDICTED.fullmatch(file.stem)
        if named and file.suffix.lower() in (".h5", ".csv"):
            rank = named["filtered"] is not None, _TRACKERS.index(named["tracker"]), file.suffix.lower() != ".h5"
            by_video.setdefault(named["video"], {}).setdefault(named["network"], []).append((*rank, file))
    if not by_video:
        expected = (
            "tables such as videos/run1DLC_*.h5, which DeepLabCut writes when it analyses the videos; or the "
            "folder of these tables instead of the project"
        )
        raise InputError(Problem(project.config, "predictions", f"no tables in {project.folder / 'videos'}", expected))
    problems, pattern = (
        [],
        f"tables of one network, chosen by a pattern instead of the project: '{project.folder / 'videos'}/*",
    )
    for video, tables in by_video.items():
        if len(tables) > 1:
            detail = f"tables of {len(tables)} networks: {', '.join(tables)}"
            problems.append(
                Problem(project.config, f"predictions of {video}", detail, f"{pattern}{next(iter(tables))}.*'")
            )
    raise_problems(problems)
    chosen = {video: min(next(iter(tables.values())))[-1] for video, tables in by_video.items()}
    left_out = (
        file.name for tables in by_video.values() for files in tables.values() for *_, file in sorted(files)[1:]
    )
    return chosen, tuple(left_out)
