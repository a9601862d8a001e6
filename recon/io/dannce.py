"""DANNCE's files: Label3D's `*_dannce.mat` with cameras (`params`) and labels (`labelData`), a camera's own file, and
predictions (`save_data_AVG.mat`: `pred`, `sampleID`).

Poses and matrices are MATLAB's: rows are points, X_camera = X_world r + t and pixels X_camera K, and the first pixel is
(1, 1). Lengths are in the unit of the calibration, by custom millimetres. Points have no names unless the file has a
`skeleton`. Frames are those of the first camera's video, `data_frame`, and of predictions `sampleID`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem
from recon.io import matlab
from recon.io.camera_files import CameraRecord
from recon.io.common import choose
from recon.io.pose import StoredPoints, numbered_names


def recognises(path: Path) -> bool:
    return matlab.recognises(path)


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """3D labels or predictions. Raises InputError."""
    choose(path, [""], individual)
    found = matlab.variables(path)
    labels = found.get("labelData")
    label = labels[0] if isinstance(labels, list) and labels else labels
    if isinstance(label, dict):
        values, frames = _numbers(label.get("data_3d")), _numbers(label.get("data_frame"))
        if values is not None and values.ndim == 2 and values.shape[1] % 3 == 0:
            values = values.reshape(len(values), -1, 3)
    else:
        values, frames = _numbers(found.get("pred")), _numbers(found.get("sampleID"))
        values = values.transpose(0, 2, 1) if values is not None and values.ndim == 3 else values
    if values is None or values.ndim != 3 or values.shape[2] != 3 or not values.size:
        shape = "nothing" if values is None else f"{values.shape}"
        expected = "labelData with data_3d (frames, 3 for each point), or pred (frames, 3, points)"
        raise InputError(Problem(path, "data_3d", shape, expected))
    frames = np.zeros(0) if frames is None else frames.ravel()
    counted = len(frames) == len(values) and np.isfinite(frames).all() and not (np.abs(frames) > 1e15).any()
    if not counted or (np.diff(frames) <= 0).any():
        raise InputError(Problem(path, "data_frame", "others", f"{len(values)} increasing frame numbers"))
    skeleton = found.get("skeleton")
    names = skeleton.get("joint_names") if isinstance(skeleton, dict) else None
    names = tuple(names) if isinstance(names, list) and all(isinstance(n, str) and n for n in names) else ()
    named = len({*names}) == len(names) == values.shape[1]
    return StoredPoints(
        names if named else numbered_names(values.shape[1]),
        values.astype(float),
        frames.astype(np.int64),
        notes=() if named else ("The file names no points: they are called point1, point2, ... in its order.",),
    )


def _numbers(value: Any) -> np.ndarray | None:
    return value.astype(float) if isinstance(value, np.ndarray) else None


def read_cameras(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Of `params`, called as `camnames` says, or the one that the file is of. Raises InputError."""
    found = matlab.variables(path)
    params, names = found.get("params", [found]), found.get("camnames")
    tables: list[dict[str, Any]] = [
        table for table in (params if isinstance(params, list) else [params]) if isinstance(table, dict)
    ]
    if not tables or not any("K" in table for table in tables):
        raise InputError(Problem(path, "params", "no cameras", "K, r, t, RDistort and TDistort of each"))
    called: list[Any] = names if isinstance(names, list) and all(isinstance(name, str) for name in names) else []
    if len(called) != len(tables):
        called = [None] * len(tables)
    places = [f"params[{i}]." * ("params" in found) for i in range(len(tables))]
    return [_record(*of) for of in zip(called, tables, places, strict=True)]


def _record(name: str | None, table: dict[str, Any], place: str) -> CameraRecord:
    K, r, t, radial, sideways = (_numbers(table.get(key)) for key in ("K", "r", "t", "RDistort", "TDistort"))
    r = _numbers(table.get("R")) if r is None else r
    changed: dict[str, Any] = {"r": None if r is None else r.T, "t": t}
    if K is not None and K.shape == (3, 3):
        changed["K"] = K.T - np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    if radial is not None and sideways is not None and radial.size in (2, 3) and sideways.size == 2:
        k = [*radial.ravel(), 0.0]
        changed["RDistort"] = [k[0], k[1], *sideways.ravel(), k[2]]
    keys = {"matrix": "K", "distortion": "RDistort", "rotation": "r", "translation_m": "t", "image_size_px": "size"}
    return CameraRecord(name, place, "radtan", False, changed, keys)
