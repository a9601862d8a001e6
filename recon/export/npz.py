"""NumPy archive of 3D positions in metres, z up (see `recon.io.npz`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.io.pose import Pose3D, index_edges


def write(pose: Pose3D, path: Path) -> None:
    with path.open("wb") as file:  # by name, an extension might be added
        np.savez_compressed(
            file,
            names=np.array(pose.names),
            xyz_m=pose.xyz_m,
            frames=pose.frames,
            fps=np.array(np.nan if pose.fps is None else pose.fps),
            edges=index_edges(pose.names, pose.edges),
        )
