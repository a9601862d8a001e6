"""SLEAP's analysis files and sleap-anipose's 3D points (HDF5).

- Analysis: `tracks`, `point_scores`, `track_occupancy`, `node_names`, `track_names`. The order of the axes is in the
  attribute `dims` of each dataset; files without it have SLEAP's first order. The frame axis counts from frame 0 of the
  video. Frames in which a track is not occupied are left out. Our own have the frame rate in `provenance`: there is no
  other place.
- points3d.h5: `tracks` (frame, track, node, xyz), and perhaps `frames`, the first and the end. Files of others have
  names beside them, and the rate as `recording_frame_rate`.
"""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from recon.base.errors import InputError, Problem
from recon.base.files import write_bytes
from recon.clip.keypoints import Keypoints
from recon.io.common import points_of_arrays, rate, require_span
from recon.io.hdf5 import attribute, child, numbers, opened, outline, texts
from recon.io.pose import StoredPoints

TITLE = "SLEAP analysis H5"
ORDERS = {
    "tracks": ("track", "xy", "node", "frame"),
    "point_scores": ("track", "node", "frame"),
    "track_occupancy": ("frame", "track"),
}
"""Without `dims`."""
WANTED = ("frame", "track", "node", "xy")


def recognises(path: Path) -> bool:
    return {"tracks", "node_names"} <= outline(path)


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The keypoints of one track: a file without scores has unknown ones, without occupancy every track in every frame.
    Raises InputError for a file that is damaged or whose arrays do not fit."""
    with opened(path) as file:
        arrays = {name: _array(path, dataset, name) for name in ORDERS if (dataset := child(file, name)) is not None}
        names, tracks = (_texts(file, name) for name in ("node_names", "track_names"))
        fps = _fps(file)
    xy = arrays["tracks"]
    score = arrays.get("point_scores", np.full(xy.shape[:3], np.nan))
    occupied = arrays.get("track_occupancy")
    return points_of_arrays(path, individual, xy, np.arange(len(xy)), names, tracks, score, occupied, fps=fps)


def _texts(file: Any, name: str) -> list[str]:
    """A list of names; empty where there is none, as SLEAP writes it without tracks."""
    dataset = child(file, name)
    return texts(dataset) if dataset is not None and getattr(dataset, "size", 0) else []


def _array(path: Path, dataset: Any, name: str) -> np.ndarray:
    """One array with its axes in the order of `WANTED`."""
    dims = attribute(dataset, "dims")
    order = ORDERS[name] if dims is None else tuple(str(axis) for axis in json.loads(dims))
    wanted = [axis for axis in WANTED if axis in ORDERS[name]]
    values = numbers(dataset)
    if sorted(order) != sorted(wanted) or values.ndim != len(wanted):
        found = f"{values.dtype} {values.shape} with the axes {', '.join(order)[:80]}"
        expected = f"numbers with the axes {', '.join(ORDERS[name])}, or as dims says"
        raise InputError(Problem(path, name, found, expected))
    return values.transpose([order.index(axis) for axis in wanted])


def _fps(file: Any) -> float | None:
    """As our own files have it; SLEAP's have none."""
    try:
        provenance = json.loads("".join(texts(child(file, "provenance"))))
    except (ValueError, RecursionError):
        return None
    return rate(provenance.get("fps")) if isinstance(provenance, dict) else None


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


# -- writing ----------------------------------------------------------------------------------------------------------


def write(keypoints: Keypoints, path: Path) -> None:
    if keypoints.frames[0] < 0:
        raise InputError(Problem(TITLE, "frames", f"{keypoints.frames[0]}", "numbers from 0 on"))
    T, K = int(keypoints.frames[-1]) + 1, len(keypoints.names)
    require_span(T, K, TITLE)
    tracks, scores = np.full((1, 2, K, T), np.nan), np.full((1, K, T), np.nan)
    tracks[0, :, :, keypoints.frames] = keypoints.xy_px.transpose(0, 2, 1)
    scores[0, :, keypoints.frames] = keypoints.confidence
    occupied = np.zeros((T, 1), np.uint8)
    occupied[keypoints.frames] = 1
    instances = np.where(occupied.T == 1, 1.0, np.nan)
    arrays = {
        "tracks": (tracks, ORDERS["tracks"]),
        "point_scores": (scores, ORDERS["point_scores"]),
        "track_occupancy": (occupied, ORDERS["track_occupancy"]),
        "instance_scores": (instances, ("track", "frame")),
        "tracking_scores": (instances, ("track", "frame")),
    }
    provenance = {"written_by": "recon"} | ({} if keypoints.fps is None else {"fps": keypoints.fps})
    made = BytesIO()
    with h5py.File(made, "w") as file:
        for name, (array, dims) in arrays.items():
            file.create_dataset(name, data=array, compression="gzip").attrs["dims"] = json.dumps(dims)
        file["node_names"] = np.array([name.encode() for name in keypoints.names])
        file["track_names"] = np.array([] if keypoints.individual is None else [keypoints.individual.encode()])
        file["edge_names"], file["edge_inds"] = np.zeros((0, 2)), np.zeros((0, 2), np.int32)
        file["labels_path"], file["video_path"], file["video_ind"] = "", "", np.int32(0)
        file["provenance"] = json.dumps(provenance)
        file.attrs["preset"], file.attrs["format"] = "matlab", "analysis"
    write_bytes(path, made.getvalue())
