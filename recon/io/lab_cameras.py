"""Read calibration files of other layouts: tables in JSON, EasyMocap, JARVIS and OpenCV's stereo files.

- JSON with a table for each camera, in a list or by name, such as CMU Panoptic's: keys as `recon.io.camera_files`
  knows them, a lens that is stated or radial-tangential, world to camera.
- EasyMocap: `intri.yml` with `K_01`, `dist_01` of each name in `names`, and `extri.yml` in the same folder with
  `Rot_01` or `R_01` and `T_01`.
- JARVIS: `intrinsicMatrix`, `distortionCoefficients`, `R`, `T` of one camera. Matrices are MATLAB's, whose rows are
  points, and are transposed here.
- OpenCV's stereo files: `K1` (`M1`, `cameraMatrix1`), `D1`, `K2`, `D2`, and `R`, `T` from the first camera to the
  second. The world is the first camera's frame.

No format states the unit of lengths or that z points up.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.documents import parse_json
from recon.base.errors import InputError, Problem
from recon.io.calibration import CameraRecord, read_calibration
from recon.io.camera_files import ALIASES, document_of, record_of, require_lens

EXTRINSICS = "extri.yml"
_STEREO = re.compile(r"(?:K|M|cameraMatrix|camera_matrix|mtx)_?([12])")
_STEREO_LENS = ("D", "distCoeffs", "dist_coeffs", "dist", "distortion_coefficients")


# -- JSON with a table for each camera -----------------------------------------------------------------------------


def recognises_tables(path: Path) -> bool:
    """Return whether a file is JSON with a table for each camera."""
    if path.suffix.lower() != ".json":
        return False
    try:
        return bool(_tables_of(parse_json(read_calibration(path), path)))
    except InputError:
        return False


def read_tables(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the cameras of a JSON file with a table for each; raise InputError."""
    tables = _tables_of(parse_json(read_calibration(path), path))
    records = [
        record_of(name, location, table, world_z_up=table.get("world_z_up", False)) for name, location, table in tables
    ]
    for record, (_, _, table) in zip(records, tables, strict=True):
        require_lens(path, table, record)
    return records


def _tables_of(document: object) -> list[tuple[Any, str, Mapping[str, Any]]]:
    """Return name, location and table of each camera, if at least one table has a camera matrix."""
    cameras = document.get("cameras", document) if isinstance(document, Mapping) else document
    start = "cameras" if cameras is not document else ""
    if isinstance(cameras, Mapping):
        named = [(name, f"{start}.{name}.".lstrip("."), table) for name, table in cameras.items()]
    elif isinstance(cameras, list):
        named = [(None, f"{start}[{i}].", table) for i, table in enumerate(cameras)]
    else:
        return []
    tables = [(n, location, table) for n, location, table in named if isinstance(table, Mapping)]
    if not any({*ALIASES["matrix"]} & table.keys() for _, _, table in tables):
        return []
    known = {key for keys in ALIASES.values() for key in keys}
    return [
        (table.get("name", table.get("camera_name", name)), location, table)
        for name, location, table in tables
        if known & table.keys()
    ]


# -- EasyMocap -----------------------------------------------------------------------------------------------------


def recognises_easymocap(path: Path) -> bool:
    """Return whether a file is an EasyMocap file of lenses or poses."""
    if path.suffix.lower() not in (".yml", ".yaml"):
        return False
    text = read_calibration(path)
    return re.search(r"(?m)^names\s*:", text) is not None and re.search(r"(?m)^(K|R|Rot)_\S+\s*:", text) is not None


def read_easymocap(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the cameras of EasyMocap's lenses, with the poses of the file in the same folder; raise InputError."""
    document = document_of(path)
    if not any(key.startswith("K_") for key in document):
        expected = "the file of lenses, intri.yml, in the same folder"
        raise InputError(Problem(path, "camera", "EasyMocap's file of poses", expected))
    poses_file = path.with_name(path.name.replace("intri", "extri"))
    poses = document_of(poses_file) if poses_file != path and poses_file.is_file() else {}
    records = []
    for name in document.get("names", ()):
        size = [document.get(f"{side}_{name}") for side in "WH"]
        table = {
            "K": document.get(f"K_{name}"),
            "D": document.get(f"dist_{name}"),
            "size": None if None in size else size,
            "R": poses.get(f"Rot_{name}", poses.get(f"R_{name}")),
            "T": poses.get(f"T_{name}"),
        }
        called = {"matrix": f"K_{name}", "distortion": f"dist_{name}", "rotation": f"Rot_{name}"}
        called |= {"translation_m": f"T_{name}", "image_size_px": f"W_{name}, H_{name}"}
        record = record_of(str(name), "", {key: value for key, value in table.items() if value is not None})
        records.append(CameraRecord(record.name, "", record.values, called, keys=tuple(document)))
    return records


# -- OpenCV's stereo files -----------------------------------------------------------------------------------------


def recognises_stereo(path: Path) -> bool:
    """Return whether a file is an OpenCV file of two cameras."""
    if path.suffix.lower() not in (".yml", ".yaml", ".xml", ".json"):
        return False
    text = read_calibration(path)
    return all(re.search(rf"[<\"\s](?:K|M|cameraMatrix|camera_matrix|mtx)_?{i}[>\"\s:]", text) for i in (1, 2))


def read_stereo(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the two cameras of OpenCV's stereo file; raise InputError."""
    document = document_of(path)
    matrices = {match[1]: key for key in document if (match := _STEREO.fullmatch(key))}
    size = [document.get(f"image_{side}", document.get(side)) for side in ("width", "height")]
    poses = {"1": {"R": np.eye(3).tolist(), "T": [0.0, 0.0, 0.0]}, "2": {key: document.get(key) for key in "RT"}}
    posed = None not in poses["2"].values()
    records = []
    for number, key in sorted(matrices.items()):
        lens = next((k for name in _STEREO_LENS for k in (f"{name}{number}", f"{name}_{number}") if k in document), "D")
        table = {"K": document[key], "D": document.get(lens), **(poses[number] if posed else {})}
        sized = document.get("image_size", document.get("imageSize")) if None in size else size
        record = record_of(f"cam{number}", "", table, image_size_px=sized)
        called = {**record.called, "matrix": key, "distortion": lens if lens in document else f"D{number}"}
        records.append(CameraRecord(record.name, "", record.values, called, keys=tuple(document)))
    return records
