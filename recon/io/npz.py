"""NumPy archives of 3D positions: our own, with `names`, `xyz_m`, `frames`, `fps` (NaN if not known), `edges`, z up;
and those of FMPose3D's demo for animals, `pose3D/0000_3D.npz` with the points of a picture as `pose3d`."""

from __future__ import annotations

import re
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.documents import KINDS, MAX_UNPACKED, arrays_of, read_content
from recon.base.files import write_bytes
from recon.io.common import DAMAGE, Pose3D, StoredPoints, index_edges, points_of_arrays, rate, starts_with
from recon.io.json_poses import ANIMAL3D, LENGTHS


def recognises(path: Path) -> bool:
    """Whether it is a NumPy archive with positions. Of a damaged archive `read` says so."""
    return _has(path, "xyz_m.npy", damaged=True)


def recognises_fmpose3d(path: Path) -> bool:
    return _has(path, "pose3d.npy", damaged=False)


def _has(path: Path, name: str, damaged: bool) -> bool:
    """Whether it is an archive with that file in it; damaged: of one that cannot be read."""
    if not starts_with(path, b"PK\x03\x04"):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return name in archive.namelist()
    except (zipfile.BadZipFile, EOFError, *DAMAGE):
        return damaged


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Raises InputError for a damaged file or arrays that do not fit."""
    arrays = arrays_of(read_content(path, "a whole file", MAX_UNPACKED), f"{KINDS}U")
    names = [str(name) for name in arrays["names"].tolist()]
    edges = tuple((names[a], names[b]) for a, b in arrays["edges"])
    more: dict[str, Any] = {"fps": rate(arrays["fps"]), "unit": "m", "up": "z", "edges": edges}
    return points_of_arrays(path, individual, arrays["xyz_m"], arrays["frames"], names, **more)


def read_fmpose3d(path: Path, individual: str | None = None) -> StoredPoints:
    """The poses of all files in the folder that are numbered as this one; one without a number is frame 0. Raises
    InputError."""
    numbered = {file: re.fullmatch(r"(\d+)_3D", file.stem) for file in path.parent.glob("*.npz")}
    files = {int(found[1]): file for file, found in numbered.items() if found}
    files = dict(sorted(files.items())) if path in files.values() else {0: path}
    poses = [arrays_of(read_content(file, "a whole file", MAX_UNPACKED), KINDS)["pose3d"] for file in files.values()]
    values, names = np.stack(poses), ANIMAL3D.split()
    return points_of_arrays(path, individual, values, np.array([*files]), names, notes=(LENGTHS,))


def write(pose: Pose3D, path: Path) -> None:
    made = BytesIO()
    of_fit: dict[str, Any] = (
        {} if pose.sigma_m is None else {"sigma_m": pose.sigma_m, "flags": np.array(pose.flags, dtype=str)}
    )
    np.savez_compressed(
        made,
        names=np.array(pose.names),
        xyz_m=pose.xyz_m,
        frames=pose.frames,
        fps=np.array(np.nan if pose.fps is None else pose.fps),
        edges=index_edges(pose.names, pose.edges),
        notes=np.array(pose.notes, dtype=str),
        **of_fit,
    )
    write_bytes(path, made.getvalue())
