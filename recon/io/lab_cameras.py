"""Read calibration files of other layouts: tables in JSON or YAML, EasyMocap, JARVIS and OpenCV's stereo files.

- JSON or YAML with a table for each camera, in a list or by name, such as CMU Panoptic's. Keys are spelled as
  `recon.io.camera_files` allows, the lens is stated or radial-tangential, and poses are from world to camera.
- EasyMocap: `intri.yml` with `K_01`, `dist_01` of each name in `names`, and `extri.yml` in the same folder with
  `Rot_01` or `R_01` and `T_01`.
- JARVIS: `intrinsicMatrix`, `distortionCoefficients`, `R`, `T` of one camera. Matrices are MATLAB's, whose rows are
  points, and are transposed here.
- OpenCV's stereo files: `K1` (`M1`, `cameraMatrix1`, `K_left`), `D1`, `K2`, `D2`, and `R`, `T` from the first camera
  to the second. The world is the first camera's frame.

No format states the unit of lengths or that z points up.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem
from recon.io.calibration import CameraRecord, read_calibration
from recon.io.camera_files import (
    ALIASES,
    cropped_to_region,
    document_of,
    has_camera_key,
    has_matrix,
    key_in,
    record_of,
    require_lens,
    require_separate_pose,
    size_in,
    without_inner,
)

_STEREO_ENDS = (("1", "2"), ("0", "1"), ("left", "right"), ("Left", "Right"), ("L", "R"), ("l", "r"))
"""Suffixes of the keys of the first and of the second camera in OpenCV's stereo files."""
_STEREO_MATRIX = r"(?:K|M|cameraMatrix|camera_matrix|intrinsic_matrix|mtx)_?"
_STEREO_LENS = ("D", "distCoeffs", "dist_coeffs", "dist", "distortion_coefficients", "distortion")


def recognises_tables(path: Path) -> bool:
    """Return whether a file is JSON or YAML with a table for each camera."""
    if path.suffix.lower() not in (".json", ".yml", ".yaml"):
        return False
    try:
        document = document_of(path)
        return not has_matrix(without_inner(document)) and bool(_tables_of(document))
    except InputError:
        return False


def read_tables(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the cameras of a JSON or YAML file that has a table for each camera."""
    document = document_of(path)
    tables = _tables_of(document)
    records = []
    for name, location, table in tables:
        z_up = table.get("world_z_up", False)  # OpenCV's YAML has no booleans
        records.append(record_of(name, location, table, world_z_up=z_up == 1.0 if isinstance(z_up, float) else z_up))
    for record, (_, _, table) in zip(records, tables, strict=True):
        require_lens(path, table, record)
        require_separate_pose(path, table, record)
    outside = next((key for key, value in document.items() if key != "cameras" and _has_poses(value)), None)
    if outside is not None and all(record.values["rotation"] is None for record in records):
        expected = "R and t of each camera, from world to camera, in its table"
        raise InputError(Problem(path, outside, "poses outside the cameras' tables", expected))
    return [cropped_to_region(path, table, record) for record, (_, _, table) in zip(records, tables, strict=True)]


def _has_poses(value: object) -> bool:
    """Return whether a value is a table of tables that have a rotation and no camera matrix, as multical writes."""
    tables = [table for table in value.values() if isinstance(table, Mapping)] if isinstance(value, Mapping) else []
    return any(key_in(table, ALIASES["rotation"]) is not None and not has_matrix(table) for table in tables)


def _tables_of(document: object) -> list[tuple[Any, str, Mapping[str, Any]]]:
    """Return the name, location and table of each camera, if at least one table has a camera matrix."""
    cameras = document.get("cameras", document) if isinstance(document, Mapping) else document
    start = "cameras" if cameras is not document else ""
    if isinstance(cameras, Mapping):
        named = [(name, f"{start}.{name}.".lstrip("."), table) for name, table in cameras.items()]
    elif isinstance(cameras, list):
        named = [(None, f"{start}[{i}].", table) for i, table in enumerate(cameras)]
    else:
        return []
    tables = [(n, location, without_inner(table)) for n, location, table in named if isinstance(table, Mapping)]
    if not any(has_matrix(table) for _, _, table in tables):
        return []
    return [
        (table.get("name", table.get("camera_name", name)), location, table)
        for name, location, table in tables
        if has_camera_key(table)
    ]


def recognises_easymocap(path: Path) -> bool:
    """Return whether a file is an EasyMocap file of lenses or poses."""
    if path.suffix.lower() not in (".yml", ".yaml"):
        return False
    text = read_calibration(path)
    return re.search(r"(?m)^names\s*:", text) is not None and re.search(r"(?m)^(K|R|Rot)_\S+\s*:", text) is not None


def read_easymocap(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the cameras of EasyMocap's intri.yml, with the poses of extri.yml in the same folder."""
    document = document_of(path)
    if not any(key.startswith("K_") for key in document):
        expected = "the file of lenses, intri.yml, in the same folder"
        raise InputError(Problem(path, "camera", "EasyMocap's file of poses", expected))
    poses_file = path.with_name(path.name.replace("intri", "extri"))
    poses = document_of(poses_file) if poses_file != path and poses_file.is_file() else {}
    records = []
    for name in document.get("names", ()):
        size = [document.get(f"{side}_{name}") for side in "WH"]
        lens = f"D_{name}" if f"D_{name}" in document else f"dist_{name}"
        table = {
            "K": document.get(f"K_{name}"),
            "D": document.get(lens),
            "size": None if None in size else size,
            "R": poses.get(f"Rot_{name}", poses.get(f"R_{name}")),
            "T": poses.get(f"T_{name}"),
        }
        called = {"matrix": f"K_{name}", "distortion": lens, "rotation": f"Rot_{name}"}
        called |= {"translation_m": f"T_{name}", "image_size_px": f"W_{name}, H_{name}"}
        record = record_of(str(name), "", {key: value for key, value in table.items() if value is not None})
        records.append(CameraRecord(record.name, "", record.values, called, keys=tuple(document)))
    return records


def recognises_stereo(path: Path) -> bool:
    """Return whether a file is an OpenCV file of two cameras."""
    if path.suffix.lower() not in (".yml", ".yaml", ".xml", ".json"):
        return False
    return _stereo_ends(read_calibration(path)) is not None


def _stereo_ends(text: str) -> tuple[str, str] | None:
    """Return the suffixes of the two cameras' keys in a stereo calibration file, or None for a file of another kind."""
    for ends in _STEREO_ENDS:
        if all(re.search(rf"[<\"\s]{_STEREO_MATRIX}{end}[>\"\s:]", f"\n{text}") for end in ends):
            return ends
    return None


def read_stereo(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the two cameras of a stereo calibration file written with OpenCV; `individual` is not used."""
    document, ends = document_of(path), _stereo_ends(read_calibration(path))
    matrices = [next((key for key in document if re.fullmatch(_STEREO_MATRIX + end, key)), "K") for end in ends or ()]
    size = size_in(document) or document.get(key_in(document, ALIASES["image_size_px"]) or "")
    fields = (("R", "rotation"), ("T", "translation_m"))
    moved = {short: document.get(key_in(document, ALIASES[field]) or "") for short, field in fields}
    poses = ({"R": np.eye(3).tolist(), "T": [0.0, 0.0, 0.0]}, moved) if None not in moved.values() else ({}, {})
    records = []
    for number, (key, end, pose) in enumerate(zip(matrices, ends or (), poses, strict=True), start=1):
        lens = next((k for name in _STEREO_LENS for k in (f"{name}{end}", f"{name}_{end}") if k in document), "D")
        table = {"K": document.get(key), "D": document.get(lens), **pose}
        name = f"cam{end if end.isdigit() else number}"
        record = record_of(name, "", table, image_size_px=size)
        called = {**record.called, "matrix": key, "distortion": lens if lens in document else f"D{end}"}
        records.append(CameraRecord(record.name, "", record.values, called, keys=tuple(document)))
    return records
