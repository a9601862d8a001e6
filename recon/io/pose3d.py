"""3D positions by joint and frame, as CSV files with the header rows `bodyparts, coords`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.errors import InputError, Problem
from recon.io import describe, file_head
from recon.io.deeplabcut import gather, read_csv, recognises


@dataclass(frozen=True, eq=False)
class Pose3D:
    """names: J joints; xyz_m: (T, J, 3) float, metres, NaN = missing; frames: (T,) int, strictly increasing.

    Raises ValueError where they do not fit together.
    """

    names: tuple[str, ...]
    xyz_m: np.ndarray
    frames: np.ndarray
    source: str | None = None

    def __post_init__(self) -> None:
        if self.xyz_m.shape != (len(self.frames), len(self.names), 3):
            raise ValueError(f"{len(self.frames)} frames of {len(self.names)} joints, but positions {self.xyz_m.shape}")
        if len(set(self.names)) != len(self.names) or np.any(np.diff(self.frames) <= 0):
            raise ValueError("names must be unique and frames strictly increasing")
        if np.isinf(self.xyz_m).any():
            raise ValueError("a position is infinite")


def read_pose3d(path: str | Path) -> Pose3D:
    """Reads x, y, z per joint from a CSV file; DeepLabCut's third header row, `scorer`, is optional.

    The file does not say its unit: it must be metres. Raises InputError.
    """
    path = Path(path)
    head = file_head(path)
    if not recognises(path) or head.startswith(b"\x89HDF"):
        raise InputError(
            Problem(path, "format", describe(head), "CSV with the header rows bodyparts, coords (x, y, z)")
        )
    table = read_csv(path)
    if any(column.individual for column in table.columns):
        raise InputError(Problem(path, "header", "several animals", "the joints of one animal"))
    names, xyz_m = gather(table, path, required=("x", "y", "z"))
    return Pose3D(names, xyz_m, table.frames, source=str(path))
