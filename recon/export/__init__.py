"""Writing a `Motion` to files: one module per format, each with `write(motion, path)`.

Writers write in place; `recon.files.staged_folder` makes a folder of them appear whole or not at all.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from recon.export import angles_csv, pose3d_csv, pose3d_sigma_csv, quality_csv, reprojection_csv
from recon.motion import Motion, TrajectoryMotion

CLIP_OUTPUTS: dict[str, Callable[[Motion, Path], None]] = {
    "pose3d.csv": pose3d_csv.write,
    "angles.csv": angles_csv.write,
    "reprojection.csv": reprojection_csv.write,
    "quality.csv": quality_csv.write,
}
"""The tables that every clip gets, by file name."""

TRAJECTORY_OUTPUTS: dict[str, Callable[[TrajectoryMotion, Path], None]] = {
    "pose3d_sigma.csv": pose3d_sigma_csv.write,
}
"""Those that come with the trajectory method."""


def write_tables(motion: Motion, folder: Path) -> None:
    """Every table of a motion, into a folder that exists."""
    for name, write in CLIP_OUTPUTS.items():
        write(motion, folder / name)
    if isinstance(motion, TrajectoryMotion):
        for name, write in TRAJECTORY_OUTPUTS.items():
            write(motion, folder / name)
