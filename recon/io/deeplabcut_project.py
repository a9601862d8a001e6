"""DeepLabCut's project folder: `config.yaml`, `labeled-data` and `videos`.

Of the configuration only names are needed: no reader of YAML is. DeepLabCut writes its lists with one item a line, and
its mappings with one key a line, and so do people who edit them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from recon.base import InputError, Problem, raise_problems
from recon.base.documents import read_text

CONFIG = "config.yaml"
SEVERAL = "MULTI!"
"""In place of the bodyparts, where a project has several animals: they are in `multianimalbodyparts`."""
_ENTRY = re.compile(r"([A-Za-z_]\w*)\s*:(?:\s+(.*))?")
_LABELS = ("labeled-data/*/CollectedData_*", "*/CollectedData_*", "CollectedData_*")
_PREDICTED = re.compile(
    r"(?P<video>.+?)_?(?P<network>(?:DLC|superanimal)_?.+?)(?P<tracker>_(?:el|bx|sk|ctd))?(?P<filtered>_filtered)?"
)
_TRACKERS = ("_el", "_ctd", "_sk", "_bx", None)
"""Ends of tables of tracked animals, by the method, the better first."""
_OTHERS = ("_skeleton", "_3d")
"""Ends of tables that are no keypoints: lengths and angles, and 3D positions."""


@dataclass(frozen=True)
class Project:
    """What the configuration says. The names are empty where it does not have them."""

    config: Path
    scorer: str
    """The name of who labelled."""
    bodyparts: tuple[str, ...]
    """The bodyparts of one animal."""
    video_sets: tuple[str, ...]
    """Paths of the videos, perhaps of another computer."""

    @property
    def folder(self) -> Path:
        return self.config.parent


def find_project(path: Path) -> Project | None:
    """The project of a folder or of its `config.yaml`; None where it is neither. Raises InputError for a file that
    cannot be read."""
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
    """Raises InputError for a folder, and for a project, which have several files to choose from."""
    if find_project(path):
        expected = (
            "one of its tables, as videos/run1DLC_*.h5; the project as a whole is for recon batch, recon train and "
            "recon skeleton from-keypoints"
        )
        raise InputError(Problem(path, "file", "a project of DeepLabCut", expected))
    if path.is_dir():
        openpose = [f" ({file.name} stands for all)" for file in sorted(path.glob("*[0-9]*.json"))[:1]]
        expected = f"one of its files{''.join(openpose) or '; recon batch takes all of a folder'}"
        raise InputError(Problem(path, "file", "a folder", expected))


def _entries(text: str) -> dict[str, list[str]]:
    """By each key of the document its value, the items of its list, or the keys of its mapping."""
    found: dict[str, list[str]] = {}
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
            found[key] = [text for item in inside if (text := _text(item))]
        elif key and bare.startswith("- ") and not bare.startswith("- -"):
            found[key].append(_text(bare[2:]))
        elif key and indent and (depth := depth or indent) == indent and not bare.startswith(": "):
            # A key that is too long for its line begins with "? ", and its value, in the next, with ": ".
            found[key].append(_text(bare.removeprefix("? ").removesuffix(":")))
    return found


def _text(item: str) -> str:
    item = item.strip()
    return item[1:-1] if len(item) > 1 and item[0] == item[-1] and item[0] in "'\"" else item


def bodyparts(project: Project) -> tuple[str, ...]:
    """Names of its keypoints. Raises InputError where it has none."""
    if not project.bodyparts:
        expected = "the names of the keypoints, under bodyparts, or multianimalbodyparts of several animals"
        raise InputError(Problem(project.config, "bodyparts", "none", expected))
    return project.bodyparts


def label_files(folder: Path, scorer: str = "") -> list[Path]:
    """One file of each folder with labels: where several people labelled it the scorer's, else that of the first in the
    alphabet; of CSV and H5 the first."""
    for pattern in _LABELS:
        by_folder: dict[Path, list[Path]] = {}
        for file in sorted(folder.glob(pattern)):
            if file.suffix.lower() in (".csv", ".h5"):
                by_folder.setdefault(file.parent, []).append(file)
        if by_folder:
            return [min(files, key=lambda f: f.stem != f"CollectedData_{scorer}") for files in by_folder.values()]
    return []


def predictions(project: Project) -> tuple[dict[str, Path], tuple[str, ...]]:
    """What a network found in the project's videos: a table for each video, by its name, and what is left out.

    They lie beside the videos: in `videos`, or where the configuration has them. Of one network's tables of a video
    what it found counts before what DeepLabCut filtered, tracked animals before others, and H5 before CSV. Raises
    InputError where there is none, and for a video with those of several networks.
    """
    places = dict.fromkeys(
        (project.folder / "videos", *(Path(v).parent for v in project.video_sets if Path(v).is_file()))
    )
    folders = [place for place in places if place.is_dir()]
    by_video: dict[str, dict[str, list[tuple[bool, int, bool, Path]]]] = {}
    for file in (file for folder in folders for file in sorted(folder.iterdir())):
        named = None if file.stem.endswith(_OTHERS) else _PREDICTED.fullmatch(file.stem)
        if named and file.suffix.lower() in (".h5", ".csv"):
            rank = named["filtered"] is not None, _TRACKERS.index(named["tracker"]), file.suffix.lower() != ".h5"
            by_video.setdefault(named["video"], {}).setdefault(named["network"], []).append((*rank, file))
    if not by_video:
        expected = (
            "tables as videos/run1DLC_*.h5, which DeepLabCut writes when it analyses the videos; or, in place of the "
            "project, the folder where they are"
        )
        raise InputError(Problem(project.config, "predictions", f"none in {project.folder / 'videos'}", expected))
    problems, pattern = [], f"of one, chosen by a pattern in place of the project: '{project.folder / 'videos'}/*"
    for video, of in by_video.items():
        if len(of) > 1:
            found = f"of {len(of)} networks: {', '.join(of)}"
            problems.append(Problem(project.config, f"predictions of {video}", found, f"{pattern}{next(iter(of))}.*'"))
    raise_problems(problems)
    chosen = {video: min(next(iter(of.values())))[-1] for video, of in by_video.items()}
    left_out = (file.name for of in by_video.values() for files in of.values() for *_, file in sorted(files)[1:])
    return chosen, tuple(left_out)
