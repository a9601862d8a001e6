"""Our own NumPy archives of 3D positions: `names`, `xyz_m`, `frames`, `fps` (NaN if not known), `edges`; z up."""

from __future__ import annotations

import struct
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.documents import read_content
from recon.base.errors import Problem, refuse
from recon.base.files import write_bytes
from recon.base.records import KINDS, MAX_BYTES, arrays_of
from recon.io.common import choose, damage_named, name_problems, rate, starts_with
from recon.io.pose import Pose3D, StoredPoints, index_edges

WANTED = {"names": "U", "xyz_m": "f", "frames": "i", "fps": "f", "edges": "i"}
"""Arrays and the kinds of their types."""


def recognises(path: Path) -> bool:
    """Whether it is a NumPy archive with positions. Of a damaged archive `read` says so."""
    if not starts_with(path, b"PK\x03\x04"):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return "xyz_m.npy" in archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, EOFError, NotImplementedError, RuntimeError, struct.error):
        return True


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Raises InputError for a damaged file or arrays that do not fit, and for a choice of animals: it has one."""
    choose(path, [""], individual)
    content = read_content(path, "a whole file", MAX_BYTES)
    with damage_named(path, "a whole file"):
        arrays = arrays_of(content, f"{KINDS}U")
        names = [str(name) for name in np.atleast_1d(arrays.get("names", [])).tolist()]
    refuse(
        Problem(path, name, "nothing" if name not in arrays else f"values of type {arrays[name].dtype}", expected)
        for name, kind in WANTED.items()
        for expected in [{"U": "texts", "f": "floats", "i": "whole numbers"}[kind]]
        if name not in arrays or arrays[name].dtype.kind != kind
    )
    xyz, frames, edges = arrays["xyz_m"].astype(float), np.atleast_1d(arrays["frames"]), arrays["edges"]
    problems = name_problems(path, "names", names)
    if xyz.shape != (len(frames), len(names), 3) or not len(frames):
        found = f"{xyz.shape}, with {len(frames)} frames and {len(names)} names"
        problems.append(Problem(path, "xyz_m", found, "(frames, names, 3)"))
    if (np.diff(frames) <= 0).any():
        problems.append(Problem(path, "frames", "numbers that do not increase", "increasing frame numbers"))
    if edges.ndim != 2 or edges.shape[1] != 2 or ((edges < 0) | (edges >= len(names))).any():
        problems.append(Problem(path, "edges", f"{edges.shape}", "(E, 2), places in names"))
    refuse(problems)
    return StoredPoints(
        tuple(names),
        xyz,
        frames.astype(np.int64),
        fps=rate(arrays["fps"]),
        unit="m",
        up="z",
        edges=tuple((names[a], names[b]) for a, b in edges),
    )


# -- writing ---------------------------------------------------------------------------------------------------------


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
