"""Anipose's folders: sessions at any depth of a project, with 2D poses, and a calibration there or above."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from recon.base.documents import read_toml

POSES = {"pose_2d_filter": "pose-2d-filtered", "pose_2d": "pose-2d"}
"""Folders of a session by what config.toml calls them, the better one first."""


@dataclass(frozen=True)
class Session:
    """A session of Anipose."""

    folder: Path
    """The session's."""
    poses: Path
    """The folder with its keypoint files."""
    calibration: Path | None = None
    """Its own, or the next one above it."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Anipose's settings."""
    config_file: Path | None = None
    """Their file."""

    @property
    def cam_regex(self) -> tuple[Path, str] | None:
        """The pattern of cameras in names, with the file that has it."""
        text = _table(self.config, "triangulation").get("cam_regex")
        return (self.config_file, text) if self.config_file is not None and isinstance(text, str) else None

    @property
    def square_length(self) -> float | None:
        """Of the calibration's board, in the unit of the calibration."""
        length = _table(self.config, "calibration").get("board_square_side_length")
        return float(length) if isinstance(length, int | float) else None


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
    return Session(folder, poses, next((path for path in calibrations if path.is_file()), None), config, file)


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
