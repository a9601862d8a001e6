"""The tables of a fit (docs/report.md): a function of a motion and a path for each, and their lists.

They write in place; `recon.base.files.staged_folder` makes a folder of them appear whole or not at all.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from recon.fit.motion import Motion
from recon.io.writing import write_rows, write_table

QUALITY_COLUMNS = ("frame", "flags", "alternative_m", "detections", "mean_weight", "place_sigma_m", "relative_rms_m")


def pose3d(motion: Motion, path: Path) -> None:
    """x, y, z in metres of each joint, under its keypoint's name, in the motion's frame of reference."""
    _write_points(path, motion, ("x", "y", "z"), motion.joints_m)


def pose3d_sigma(motion: Motion, path: Path) -> None:
    """Standard deviations in metres along the axes of the frame of reference, for each joint: of its position, and of
    its position relative to the mean of all joints."""
    coords = ("x_sigma", "y_sigma", "z_sigma", "x_rel", "y_rel", "z_rel")
    _write_points(path, motion, coords, np.concatenate((motion.joint_sigma_m, motion.relative_sigma_m), axis=2))


def angles(motion: Motion, path: Path) -> None:
    """The whole state, in its order: angles in rad, the place in metres."""
    columns = [name if name.endswith("_m") else f"{name}_rad" for name in motion.state_names]
    write_table(path, [["frame", *columns]], motion.frames, motion.states)


def angles_sigma(motion: Motion, path: Path) -> None:
    """The standard deviation of every angle of angles.csv, then every angle's information fraction."""
    columns = [f"{name}_{what}" for what in ("sigma_rad", "data_share") for name in motion.angle_names]
    values = np.hstack((motion.solution.angle_sigma_rad, motion.solution.angle_data_share))
    write_table(path, [["frame", *columns]], motion.frames, values)


def quality(motion: Motion, path: Path) -> None:
    """What is doubtful about each frame: flags, separated by semicolons, and the numbers behind them."""
    flags = [";".join(flags) for flags in motion.flags]
    columns = (motion.frames, flags, *(getattr(motion, name) for name in QUALITY_COLUMNS[2:]))
    write_rows(path, [QUALITY_COLUMNS], zip(*columns, strict=True))


def reprojection(motion: Motion, path: Path, camera: int = 0) -> None:
    """The joints in the picture of one of the motion's cameras, as a file of DeepLabCut's: x, y in pixels and a
    likelihood of 1; without a pose, or where the camera cannot see it, empty and 0."""
    xy_px = motion.pictures[camera].reprojected_px
    likelihood = np.isfinite(xy_px).all(axis=-1, keepdims=True)
    values = np.concatenate([np.where(likelihood, xy_px, np.nan), likelihood], axis=-1)
    _write_points(path, motion, ("x", "y", "likelihood"), values, scorer="recon")


CLIP_OUTPUTS: dict[str, Callable[[Motion, Path], None]] = {
    "pose3d.csv": pose3d,
    "angles.csv": angles,
    "quality.csv": quality,
    "pose3d_sigma.csv": pose3d_sigma,
    "angles_sigma.csv": angles_sigma,
}
"""The tables that every clip gets, by file name."""

REPROJECTION = "reprojection.csv"
"""The table that every clip gets for each camera, which is named in it where there are several (`camera_files`)."""


def write_tables(motion: Motion, folder: Path) -> None:
    """Every table of a motion, into a folder that exists."""
    for name, write in CLIP_OUTPUTS.items():
        write(motion, folder / name)
    for camera, file in enumerate(camera_files([picture.name for picture in motion.pictures])):
        reprojection(motion, folder / file, camera)


def camera_files(cameras: Sequence[str]) -> list[str]:
    """`REPROJECTION` of each of these cameras: reprojection.csv, or reprojection_cam1.csv ..."""
    if len(cameras) == 1:
        return [REPROJECTION]
    files: list[str] = []
    for number, camera in enumerate(cameras, start=1):
        name = re.sub(r"[^\w.-]+", "-", camera) or str(number)
        # Names that differ in letters that a file's name cannot have, or that some systems take for the same.
        twice = any(f"reprojection_{name}.csv".lower() == file.lower() for file in files)
        files.append(f"reprojection_{name}-{number}.csv" if twice else f"reprojection_{name}.csv")
    return files


def of_any_camera(folder: Path) -> list[str]:
    """The files in a folder that are called like `REPROJECTION` of some camera."""
    return sorted(path.name for path in folder.glob("reprojection_*.csv"))


def _write_points(path: Path, motion: Motion, coords: Sequence[str], values: np.ndarray, scorer: str = "") -> None:
    """DeepLabCut's layout: header rows `bodyparts, coords`, before them `scorer` if there is one. values (T, J, C)."""
    header = [
        ["bodyparts", *(name for name in motion.names for _ in coords)],
        ["coords", *(coord for _ in motion.names for coord in coords)],
    ]
    if scorer:
        header.insert(0, ["scorer"] + [scorer] * (len(header[0]) - 1))
    write_table(path, header, motion.frames, values.reshape(len(motion.frames), -1))
