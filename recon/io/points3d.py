"""sleap-anipose's 3D points (HDF5): `tracks` (frame, track, node, xyz), and perhaps `frames`, the first and the end.

Files of others have names beside them: `node_names`, `track_names`, and the rate as `recording_frame_rate`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.io.common import choose, name_problems, rate
from recon.io.hdf5 import child, numbers, opened, outline, texts
from recon.io.pose import StoredPoints, numbered_names

_SLEAP = {"point_scores", "track_occupancy", "edge_inds", "instance_scores"}
"""What its analysis files have beside `tracks`, and these not."""


def recognises(path: Path) -> bool:
    names = outline(path)
    if "tracks" not in names or _SLEAP & names:
        return False
    with opened(path) as file:
        shape = getattr(child(file, "tracks"), "shape", ())
        return len(shape) == 4 and shape[-1] == 3


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Of one track. Raises InputError."""
    with opened(path) as file:
        values = numbers(child(file, "tracks")).astype(float)
        stored = {name: child(file, name) for name in ("node_names", "track_names")}
        nodes, tracks = ([] if found is None else texts(found) for found in stored.values())
        span, fps = (child(file, name) for name in ("frames", "recording_frame_rate"))
        first = 0.0 if span is None else float(numbers(span).ravel()[0])
        fps = None if fps is None else rate(numbers(fps).ravel()[0])
    if not values.size:
        raise InputError(Problem(path, "tracks", f"{values.shape}", "(frames, tracks, nodes, 3), none of them 0"))
    T, N, K, _ = values.shape
    problems = name_problems(path, "node_names", nodes) if nodes else []
    problems += name_problems(path, "track_names", tracks) if tracks else []
    for name, found, wanted in (("node_names", nodes, K), ("track_names", tracks, N)):
        if found and len(found) != wanted:
            problems.append(Problem(path, name, f"{len(found)} names", f"{wanted}, as in tracks"))
    if not (abs(first) < 1e15 and first == int(first)):
        problems.append(Problem(path, "frames", f"{first:g}", "the first frame's number"))
    refuse(problems)
    animals = tracks or ([""] if N == 1 else [f"track_{i}" for i in range(N)])
    which = choose(path, animals, individual, [bool(np.isfinite(values[:, n]).any()) for n in range(N)])
    note = "The file names no points: they are called point1, point2, ... in its order."
    return StoredPoints(
        tuple(nodes) or numbered_names(K),
        values[:, which],
        int(first) + np.arange(T),
        fps=fps,
        individual=tracks[which] if tracks else None,
        notes=() if nodes else (note,),
    )
