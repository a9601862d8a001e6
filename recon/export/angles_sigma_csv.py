"""angles_sigma.csv: how far each angle can be trusted, and how much of that comes from the pixels (docs/report.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.export.table import write_table
from recon.motion import Motion


def write(motion: Motion, path: Path) -> None:
    """Of every angle of angles.csv the standard deviation, then of every angle the pixels' share."""
    columns = [f"{name}_{what}" for what in ("sigma_rad", "data_share") for name in motion.angle_names]
    values = np.hstack((motion.solution.angle_sigma_rad, motion.solution.angle_data_share))
    write_table(path, [["frame", *columns]], motion.frames, values)
