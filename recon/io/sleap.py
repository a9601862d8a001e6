"""SLEAP's analysis files (HDF5): `tracks`, `point_scores`, `track_occupancy`, `node_names`, `track_names`.

The order of the axes stands in the attribute `dims` of each dataset; files without it have SLEAP's first order. The
frame axis counts from frame 0 of the video. Frames in which a track is not occupied are left out. Our own have the
frame rate in `provenance`: there is no other place.
"""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import write_bytes
from recon.clip.keypoints import Keypoints
from recon.io.common import choose, formats_extra, name_problems, rate, require_span
from recon.io.hdf5 import attribute, child, numbers, opened, outline, texts
from recon.io.pose import StoredPoints

TITLE = "SLEAP analysis H5"
ORDERS = {
    "tracks": ("track", "xy", "node", "frame"),
    "point_scores": ("track", "node", "frame"),
    "track_occupancy": ("frame", "track"),
}
"""Without `dims`."""
WANTED = {
    "tracks": ("frame", "track", "node", "xy"),
    "point_scores": ("frame", "track", "node"),
    "track_occupancy": ("frame", "track"),
}


def recognises(path: Path) -> bool:
    return {"tracks", "node_names"} <= outline(path)


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The keypoints of one track. Raises InputError for a file that is damaged or whose arrays do not fit."""
    with opened(path) as file:
        names = _texts(file, "node_names")
        tracks = _texts(file, "track_names")
        stored = {name: child(file, name) for name in ORDERS}
        if stored["tracks"] is None:
            raise InputError(Problem(path, "tracks", "a link to nowhere", "a dataset"))
        arrays = {name: _array(path, dataset, name) for name, dataset in stored.items() if dataset is not None}
        fps = _fps(file)
    xy, score, occupied = _checked_arrays(path, names, tracks, arrays)
    animals = tracks or [f"track_{i}" for i in range(xy.shape[1])]
    which = choose(path, animals, individual, (np.isfinite(xy[frames, n]).any() for n, frames in enumerate(occupied.T)))
    frames = np.flatnonzero(occupied[:, which])
    if not len(frames):
        raise InputError(Problem(path, f"track {animals[which]}", "no frame with it", "at least one"))
    return StoredPoints(
        tuple(names),
        xy[frames, which],
        frames,
        score[frames, which],
        fps=fps,
        individual=animals[which] if tracks else None,
    )


def _texts(file: Any, name: str) -> list[str]:
    """A list of names; empty where there is none, as SLEAP writes it without tracks."""
    dataset = child(file, name)
    return texts(dataset) if dataset is not None and getattr(dataset, "size", 0) else []


def _array(path: Path, dataset: Any, name: str) -> np.ndarray:
    """One array with its axes in the order that is wanted."""
    order, wanted = ORDERS[name], WANTED[name]
    dims = attribute(dataset, "dims")
    if dims is not None:
        order = tuple(str(axis) for axis in json.loads(dims))
    elif name == "tracks" and attribute(dataset.file, "transpose") in (False, 0):
        order = ("frame", "node", "xy", "track")
    values = numbers(dataset)
    if sorted(order) != sorted(wanted) or values.ndim != len(wanted):
        found = f"{values.dtype} {values.shape} with the axes {', '.join(order)[:80]}"
        raise InputError(
            Problem(path, name, found, f"numbers with the axes {', '.join(ORDERS[name])}, or as dims says")
        )
    return np.transpose(values.astype(float), [order.index(axis) for axis in wanted])


def _fps(file: Any) -> float | None:
    """As our own files have it; SLEAP's have none."""
    dataset = child(file, "provenance")
    try:
        provenance = json.loads("".join(texts(dataset)))
    except (ValueError, RecursionError):
        return None
    return rate(provenance.get("fps")) if isinstance(provenance, dict) else None


def _checked_arrays(
    path: Path, names: list[str], tracks: list[str], arrays: dict[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """xy (T, N, K, 2), scores (T, N, K) and occupancy (T, N) bool of N tracks. Raises InputError where they do not fit
    together; a file without scores has unknown ones, without occupancy every track in every frame."""
    xy = arrays["tracks"]
    T, N, K, two = xy.shape
    problems = name_problems(path, "node_names", names)
    if two != 2:
        problems.append(Problem(path, "tracks", f"{two} coordinates", "2: x, y"))
    if len(names) != K:
        problems.append(Problem(path, "node_names", f"{len(names)} names", f"{K}, as in tracks"))
    if tracks and len(tracks) != N:
        problems.append(Problem(path, "track_names", f"{len(tracks)} names", f"{N}, as in tracks"))
    problems += name_problems(path, "track_names", tracks) if tracks else []
    score = arrays.get("point_scores", np.full((T, N, K), np.nan))
    occupied = arrays.get("track_occupancy", np.ones((T, N)))
    for name, array, shape in (("point_scores", score, (T, N, K)), ("track_occupancy", occupied, (T, N))):
        if array.shape != shape:
            axes = ", ".join(WANTED[name])
            problems.append(Problem(path, name, f"{array.shape} ({axes})", f"{shape}, as in tracks"))
    refuse(problems)
    return xy, score, occupied > 0


# -- writing ---------------------------------------------------------------------------------------------------------


def write(keypoints: Keypoints, path: Path) -> None:
    with formats_extra(TITLE):
        import h5py
    if keypoints.frames[0] < 0:
        raise InputError(Problem(TITLE, "frames", f"{keypoints.frames[0]}", "numbers from 0 on"))
    T, K = int(keypoints.frames[-1]) + 1, len(keypoints.names)
    require_span(T, K, TITLE)
    tracks, scores = np.full((1, 2, K, T), np.nan), np.full((1, K, T), np.nan)
    tracks[0, :, :, keypoints.frames] = keypoints.xy_px.transpose(0, 2, 1)
    scores[0, :, keypoints.frames] = keypoints.confidence
    occupied = np.zeros((T, 1), np.uint8)
    occupied[keypoints.frames] = 1
    instance_scores = np.where(occupied.T == 1, 1.0, np.nan)
    named = [] if keypoints.individual is None else [keypoints.individual.encode()]
    provenance = {"written_by": "recon"} | ({} if keypoints.fps is None else {"fps": keypoints.fps})
    made = BytesIO()
    with h5py.File(made, "w") as file:
        for name, array in (("tracks", tracks), ("point_scores", scores), ("track_occupancy", occupied)):
            file.create_dataset(name, data=array, compression="gzip").attrs["dims"] = json.dumps(ORDERS[name])
        for name in ("instance_scores", "tracking_scores"):
            dataset = file.create_dataset(name, data=instance_scores, compression="gzip")
            dataset.attrs["dims"] = json.dumps(("track", "frame"))
        file["node_names"] = np.array([name.encode() for name in keypoints.names])
        file["track_names"] = np.array(named)
        file["edge_names"], file["edge_inds"] = np.zeros((0, 2)), np.zeros((0, 2), np.int32)
        file["labels_path"], file["video_path"], file["video_ind"] = "", "", np.int32(0)
        file["provenance"] = json.dumps(provenance)
        file.attrs["preset"], file.attrs["format"] = "matlab", "analysis"
    write_bytes(path, made.getvalue())
