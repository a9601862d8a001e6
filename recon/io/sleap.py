"""SLEAP's analysis files and sleap-anipose's 3D points (HDF5).

- Analysis: `tracks`, `point_scores`, `track_occupancy`, `node_names`, `track_names`. The order of the axes is in the
  attribute `dims` of each dataset; files without it have SLEAP's first order. The frame axis counts from frame 0 of the
  video. Frames in which a track is not occupied are left out.
- points3d.h5: `tracks` (frame, track, node, xyz), and perhaps `frames`, the first and the end. Files of others have
  names beside them, and the rate as `recording_frame_rate`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem
from recon.io.common import StoredPoints, points_of_arrays, rate
from recon.io.hdf5 import attribute, child, numbers, opened, outline, texts

ORDERS = {
    "tracks": ("track", "xy", "node", "frame"),
    "point_scores": ("track", "node", "frame"),
    "track_occupancy": ("frame", "track"),
}
"""The orders of axes in files without `dims`."""
WANTED = ("frame", "track", "node", "xy")


def recognises(path: Path) -> bool:
    return {"tracks", "node_names"} <= outline(path)


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The keypoints of one track: a file without scores has unknown ones, without occupancy every track in every frame.
    Raises InputError for a file that is damaged or whose arrays do not fit."""
    with opened(path) as file:
        arrays = {name: _array(path, dataset, name) for name in ORDERS if (dataset := child(file, name)) is not None}
        names, tracks = (_texts(file, name) for name in ("node_names", "track_names"))
    xy = arrays["tracks"]
    score = arrays.get("point_scores", np.full(xy.shape[:3], np.nan))
    occupied = arrays.get("track_occupancy")
    return points_of_arrays(path, individual, xy, np.arange(len(xy)), names, tracks, score, occupied)


def _texts(file: Any, name: str) -> list[str]:
    """A list of names; empty where there is none, as SLEAP writes it without tracks."""
    dataset = child(file, name)
    return texts(dataset) if dataset is not None and getattr(dataset, "size", 0) else []


def _array(path: Path, dataset: Any, name: str) -> np.ndarray:
    """One array with its axes in the order of `WANTED`."""
    dims = attribute(dataset, "dims")
    order = ORDERS[name] if dims is None else tuple(str(axis) for axis in json.loads(dims))
    if dims is None and name == "tracks" and attribute(dataset.file, "transpose") in (False, 0):
        order = ("frame", "node", "xy", "track")
    wanted = [axis for axis in WANTED if axis in ORDERS[name]]
    values = numbers(dataset)
    if sorted(order) != sorted(wanted) or values.ndim != len(wanted):
        found = f"{values.dtype} {values.shape} with the axes {', '.join(order)[:80]}"
        expected = f"numbers with the axes {', '.join(ORDERS[name])}, or as dims says"
        raise InputError(Problem(path, name, found, expected))
    return values.transpose([order.index(axis) for axis in wanted])


# -- sleap-anipose's points3d.h5 --------------------------------------------------------------------------------------


def recognises_points3d(path: Path) -> bool:
    names = outline(path)
    if "tracks" not in names or {"point_scores", "track_occupancy", "edge_inds", "instance_scores"} & names:
        return False
    with opened(path) as file:
        shape = getattr(child(file, "tracks"), "shape", ())
        return len(shape) == 4 and shape[-1] == 3


def read_points3d(path: Path, individual: str | None = None) -> StoredPoints:
    """The 3D points of one track. Raises InputError."""
    with opened(path) as file:
        values = numbers(child(file, "tracks"))
        names, tracks = (_texts(file, name) for name in ("node_names", "track_names"))
        first, fps = (
            None if (dataset := child(file, name)) is None else float(numbers(dataset).ravel()[0])
            for name in ("frames", "recording_frame_rate")
        )
    frames = (first or 0.0) + np.arange(len(values))
    return points_of_arrays(path, individual, values, frames, names, tracks, fps=rate(fps))
