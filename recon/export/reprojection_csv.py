"""reprojection.csv: the joints in a camera's picture, in DeepLabCut's layout (see docs/report.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.export.table import write_table
from recon.motion import Motion

SCORER = "recon"


def write(motion: Motion, path: Path, camera: int = 0) -> None:
    """camera: which of the motion's.

    x, y in pixels and a likelihood of 1; without a pose, or where the camera cannot see it, empty and 0.
    """
    xy_px = motion.pictures[camera].reprojected_px
    likelihood = np.isfinite(xy_px).all(axis=-1, keepdims=True)
    values = np.concatenate([np.where(likelihood, xy_px, np.nan), likelihood], axis=-1)
    coords = ("x", "y", "likelihood")
    header = (
        ["scorer", *(SCORER for _ in motion.names for _ in coords)],
        ["bodyparts", *(name for name in motion.names for _ in coords)],
        ["coords", *(coords * len(motion.names))],
    )
    write_table(path, header, motion.frames, values.reshape(len(motion.frames), -1))
