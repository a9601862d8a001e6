"""NumPy archive of 3D positions in metres, z up (see `recon.io.npz`)."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np

from recon.files import write_bytes
from recon.io.pose import Pose3D, index_edges


def write(pose: Pose3D, path: Path) -> None:
    made = BytesIO()
    np.savez_compressed(
        made,
        names=np.array(pose.names),
        xyz_m=pose.xyz_m,
        frames=pose.frames,
        fps=np.array(np.nan if pose.fps is None else pose.fps),
        edges=index_edges(pose.names, pose.edges),
    )
    write_bytes(path, made.getvalue())
