"""Read and write recon's NumPy archives of 3D positions, and read archives of FMPose3D's animal demo.

Recon's archives have `names`, `xyz_m`, `frames`, `fps` (NaN if unknown) and `edges`, with z up. FMPose3D's archives are
`pose3D/0000_3D.npz` with the points of a picture as `pose3d`.
"""

from __future__ import annotations

import re
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.documents import KINDS, MAX_UNPACKED, arrays_of, damage_as_input_error, read_content
from recon.base.errors import InputError, Problem
from recon.base.files import write_bytes
from recon.io import common, writing
from recon.io.common import Pose3D, StoredPoints, one_animal, rate
from recon.io.json_poses import ANIMAL3D, LENGTHS


def recognises(path: Path) -> bool:
    """Return whether a file is a NumPy archive of positions, or a damaged archive, which `read` reports."""
    return _has(path, "xyz_m.npy", damaged=True)


def recognises_fmpose3d(path: Path) -> bool:
    """Return whether a file is an archive of FMPose3D's demo."""
    return _has(path, "pose3d.npy", damaged=False)


def _has(path: Path, name: str, damaged: bool) -> bool:
    """Return whether an archive contains a file of this name, or `damaged` for an unreadable archive."""
    if not common.starts_with(path, b"PK\x03\x04"):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return name in archive.namelist()
    except Exception:
        return damaged


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the positions in a .npz archive that recon wrote.

    Raises
    ------
    InputError
        If the file is damaged, or if its arrays disagree.
    """
    arrays = arrays_of(read_content(path, "a whole file", MAX_UNPACKED), f"{KINDS}U")
    names = [str(name) for name in arrays["names"].tolist()]
    edges = tuple((names[a], names[b]) for a, b in arrays["edges"])
    extra: dict[str, Any] = {"fps": rate(arrays["fps"]), "unit": "m", "up": "z", "edges": edges}
    return one_animal(path, individual, StoredPoints(tuple(names), arrays["xyz_m"], arrays["frames"], **extra))


def read_fmpose3d(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the poses in all numbered files of the folder that contains the given file.

    A file without a number in its name is read alone, as frame 0.
    """
    named = [(re.fullmatch(r"(\d+)_3D", file.stem), file) for file in path.parent.glob("*.npz")]
    files = sorted((int(number[1]), file) for number, file in named if number)
    files = files if path in [file for _, file in files] else [(0, path)]
    names, numbers = ANIMAL3D.split(), np.array([number for number, _ in files])
    common.require_span(len(files), len(names), path.parent)
    values = np.concatenate([_pose_of(file, len(names)) for _, file in files])
    return one_animal(path, individual, StoredPoints(tuple(names), values, numbers, notes=(LENGTHS,)))


def _pose_of(path: Path, points: int) -> np.ndarray:
    """Return the pose of one picture, shape (1, points, 3), in the network's own unit."""
    expected = f"the {points} points of one animal as pose3d"
    with damage_as_input_error(path, expected):
        pose = arrays_of(read_content(path, "a whole file", MAX_UNPACKED), KINDS)["pose3d"]
    if pose.shape not in ((points, 3), (1, points, 3)):
        raise InputError(Problem(path, "pose3d", f"an array of shape {pose.shape}", expected))
    return pose.reshape(1, points, 3)


def write(pose: Pose3D, path: Path) -> None:
    """Write 3D positions as a new NumPy archive."""
    made = BytesIO()
    arrays: dict[str, Any] = {"names": np.array(pose.names), "xyz_m": pose.xyz_m, "frames": pose.frames}
    arrays |= {"fps": np.array(pose.fps, dtype=float), "edges": writing.index_edges(pose.names, pose.edges)}
    arrays |= {"notes": np.array(pose.notes, dtype=str)}
    if pose.sigma_m is not None:
        arrays |= {"sigma_m": pose.sigma_m, "flags": np.array(pose.flags, dtype=str)}
    np.savez_compressed(made, **arrays)
    write_bytes(path, made.getvalue())
