"""pose3d.csv: the joints' positions, with the header rows `bodyparts, coords` (see docs/report.md)."""

from __future__ import annotations

from pathlib import Path

from recon.export.table import write_table
from recon.motion import Motion


def write(motion: Motion, path: Path) -> None:
    """x, y, z in metres of each joint, under its keypoint's name, in the motion's frame of reference."""
    header = (
        ["bodyparts", *(name for name in motion.names for _ in "xyz")],
        ["coords", *("xyz" * len(motion.names))],
    )
    write_table(path, header, motion.frames, motion.joints_m.reshape(len(motion.frames), -1))
