"""pose3d_sigma.csv: how far the joints' positions can be trusted, in the layout of pose3d.csv (see docs/report.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.export.table import write_table
from recon.motion import Motion

COORDS = ("x_sigma", "y_sigma", "z_sigma", "x_rel", "y_rel", "z_rel")


def write(motion: Motion, path: Path) -> None:
    """Standard deviations in metres along the axes of the frame of reference, for each joint: of its position, and of
    its position relative to the mean of all joints."""
    header = (
        ["bodyparts", *(name for name in motion.names for _ in COORDS)],
        ["coords", *(COORDS * len(motion.names))],
    )
    values = np.concatenate((motion.joint_sigma_m, motion.relative_sigma_m), axis=2)
    write_table(path, header, motion.frames, values.reshape(len(motion.frames), -1))
