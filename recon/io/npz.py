"""Our own NumPy archives of 3D positions: `names`, `xyz_m`, `frames`, `fps` (NaN if not known), `edges`; z up."""

from __future__ import annotations

import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.documents import KINDS, MAX_UNPACKED, arrays_of, read_content
from recon.base.files import write_bytes
from recon.io.common import DAMAGE, Pose3D, StoredPoints, index_edges, points_of_arrays, rate, starts_with


def recognises(path: Path) -> bool:
    """Whether it is a NumPy archive with positions. Of a damaged archive `read` says so."""
    if not starts_with(path, b"PK\x03\x04"):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return "xyz_m.npy" in archive.namelist()
    except (zipfile.BadZipFile, EOFError, *DAMAGE):
        return True


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Raises InputError for a damaged file or arrays that do not fit."""
    arrays = arrays_of(read_content(path, "a whole file", MAX_UNPACKED), f"{KINDS}U")
    names = [str(name) for name in arrays["names"].tolist()]
    edges = tuple((names[a], names[b]) for a, b in arrays["edges"])
    more: dict[str, Any] = {"fps": rate(arrays["fps"]), "unit": "m", "up": "z", "edges": edges}
    return points_of_arrays(path, individual, arrays["xyz_m"], arrays["frames"], names, **more)


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
