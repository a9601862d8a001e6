"""Anipose's folders: sessions at any depth of a project, with 2D poses, and a calibration there or above."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from recon.base.documents import read_toml

POSES = {"pose_2d_filter": "pose-2d-filtered", "pose_2d": "pose-2d"}
"""Folders of a session by what config.toml calls them, the better one first."""

SQUARE = "board_square_side_length"


class Session(NamedTuple):
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


def sessions_in(folder: Path) -> list[Session]:
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


def _session(folder: Path, poses: Path) -> Session:
    config, file = _config(folder)
    name = str(_table(config, "pipeline").get("calibration_results", "calibration"))
    above = [folder, *folder.parents]
    if file is not None:
        above = above[: above.index(file.parent) + 1]
    calibrations = (parent / name / "calibration.toml" for parent in above)
    calibration = next((path for path in calibrations if path.is_file()), None)
    regex, length = _table(config, "triangulation").get("cam_regex"), _table(config, "calibration").get(SQUARE)
    cam_regex = (file, regex) if file is not None and isinstance(regex, str) else None
    return Session(folder, poses, calibration, cam_regex, float(length) if isinstance(length, int | float) else None)


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
