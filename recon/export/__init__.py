"""Writing a `Motion` to files: one module per format, each with `write(motion, path)`.

Writers write in place; `recon.files.staged_folder` makes a folder of them appear whole or not at all.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from recon.export import angles_csv, angles_sigma_csv, pose3d_csv, pose3d_sigma_csv, quality_csv, reprojection_csv
from recon.motion import Motion

CLIP_OUTPUTS: dict[str, Callable[[Motion, Path], None]] = {
    "pose3d.csv": pose3d_csv.write,
    "angles.csv": angles_csv.write,
    "quality.csv": quality_csv.write,
    "pose3d_sigma.csv": pose3d_sigma_csv.write,
    "angles_sigma.csv": angles_sigma_csv.write,
}
"""The tables that every clip gets, by file name."""

CAMERA_OUTPUTS: dict[str, Callable[[Motion, Path, int], None]] = {
    "reprojection.csv": reprojection_csv.write,
}
"""Those that every clip gets for each camera, which is named in them where there are several (`camera_files`)."""


def camera_files(table: str, cameras: Sequence[str]) -> list[str]:
    """The files of one of `CAMERA_OUTPUTS` for each of these cameras: reprojection.csv, or reprojection_cam1.csv ..."""
    if len(cameras) == 1:
        return [table]
    stem, suffix = table.rsplit(".", 1)
    files: list[str] = []
    for number, camera in enumerate(cameras, start=1):
        name = re.sub(r"[^\w.-]+", "-", camera) or str(number)
        # Names that differ in letters that a file's name cannot have, or that some systems take for the same.
        twice = any(f"{stem}_{name}.{suffix}".lower() == file.lower() for file in files)
        files.append(f"{stem}_{name}-{number}.{suffix}" if twice else f"{stem}_{name}.{suffix}")
    return files


def of_any_camera(folder: Path) -> list[str]:
    """The files in a folder that are called like those of `CAMERA_OUTPUTS` of some camera."""
    patterns = [table.replace(".", "_*.") for table in CAMERA_OUTPUTS]
    return sorted(path.name for pattern in patterns for path in folder.glob(pattern))


def write_tables(motion: Motion, folder: Path) -> None:
    """Every table of a motion, into a folder that exists."""
    for name, write in CLIP_OUTPUTS.items():
        write(motion, folder / name)
    for name, write in CAMERA_OUTPUTS.items():
        for camera, file in enumerate(camera_files(name, [picture.name for picture in motion.pictures])):
            write(motion, folder / file, camera)
