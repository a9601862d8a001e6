"""Calibration files as they are: for each camera a table of unchecked values, and what it calls each field.

- OpenCV YAML, JSON and XML (`camera_matrix`, `distortion_coefficients`, `image_width`, `image_height`, and the other
  spellings in use), including ROS camera_info YAML with `distortion_model`. The lens is a fisheye where the file says
  `fisheye: 1` or `distortion_model: equidistant`, else radial-tangential. A pose is optional (`R`, `T`; `rotation`,
  `translation`; `rvec`, `tvec`; world to camera). Whether z points up is only known where the file has `world_z_up: 1`.
- AcinoSet JSON: a scene (`cameras` with `k`, `d`, `r`, `t` and perhaps `name`) or one camera (`k`, `d`). Fisheye
  lenses, world to camera, metres, world z up.
- Anipose and Pose2Sim TOML: one table per camera. World to camera in the length unit of the calibration board, which
  the file does not name: it is taken to be metres here, and `camera_unit` of a fit's settings says otherwise. The board
  defines the world, so z need not point up.
- OpenDroneMap's `cameras.json` and OpenSfM's `camera_models.json`: by name, focal lengths and centres as shares of the
  picture's longer side. No poses: those are tracks (`recon.io.camera_track`).
- This package's own TOML: one table `[camera]` with `format = "recon-camera"`, or several in `[[cameras]]`.

`recon.io.calibration` checks the values and makes cameras of them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recon.base.documents import parse_json, parse_toml, read_text
from recon.base.errors import InputError, Problem
from recon.base.files import staged_file
from recon.geometry.camera import Camera
from recon.geometry.lens import lens_named

FORMAT = "recon-camera"
VERSION = 1
MAX_BYTES = 1 << 23
MAX_NESTING = 5_000
"""OpenCV dies at 20,000."""
OPENCV_KEYS = {
    "matrix": ("camera_matrix", "cameraMatrix", "K"),
    "distortion": ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D"),
    "rotation": ("rotation", "R", "rvec"),
    "translation_m": ("translation", "T", "tvec"),
}


@dataclass(frozen=True)
class CameraRecord:
    """One camera as its file has it: a table of unchecked values, and what it calls each field of `Camera`."""

    name: Any
    place: str
    model: Any
    world_z_up: Any
    table: dict[str, Any]
    keys: dict[str, str]
    tilt_rad: Any = 0.0

    def value(self, field: str) -> Any:
        return self.table.get(self.keys[field])


def _text(path: Path) -> str:
    """Raises InputError for anything but a text that is not empty."""
    text = read_text(path, "a calibration", MAX_BYTES)
    if not text.strip():
        raise InputError(Problem(path, "file", "an empty file", "a calibration"))
    return text


def _is(path: Path, suffixes: Sequence[str], pattern: str = "") -> bool:
    return path.suffix.lower() in suffixes and re.search(pattern, _text(path)) is not None


# -- this package's own ----------------------------------------------------------------------------------------------


def recognises_own(path: Path) -> bool:
    return _is(path, (".toml",), r"(?m)^\s*format\s*=")


def read_own(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Raises InputError for another version, too."""
    document = parse_toml(_text(path), path)
    one, several = document.get("camera"), document.get("cameras")
    if isinstance(one, dict):
        return [_own_record(path, one)]
    if isinstance(several, list) and several and all(isinstance(table, dict) for table in several):
        return [_own_record(path, table, f"cameras[{i}].") for i, table in enumerate(several)]
    raise InputError(Problem(path, "format", "no table of a camera", f'[camera] with format = "{FORMAT}"'))


def _own_record(path: Path, table: dict[str, Any], place: str = "camera.") -> CameraRecord:
    if (table.get("format"), table.get("version")) != (FORMAT, VERSION):
        found = f"format {table.get('format')!r}, version {table.get('version')!r}"
        raise InputError(Problem(path, f"{place}format", found, f"format {FORMAT!r}, version {VERSION}"))
    keys = {field: field for field in ("matrix", "distortion", "image_size_px", "rotation", "translation_m")}
    up, tilt_rad = table.get("world_z_up", True), table.get("tilt_rad", 0.0)
    return CameraRecord(table.get("name"), place, table.get("model"), up, table, keys, tilt_rad)


def write_cameras(cameras: Sequence[Camera], path: str | Path) -> None:
    """Write cameras as TOML that `read_cameras` reads back exactly; whole or not at all."""
    _write({"cameras": [_own_table(camera) for camera in cameras]}, path)


def write_camera(camera: Camera, path: str | Path) -> None:
    """The same of one, that `read_camera` reads back without its name."""
    _write({"camera": _own_table(camera)}, path)


def _write(document: dict[str, Any], path: str | Path) -> None:
    import tomli_w

    with staged_file(path) as staged:
        staged.write_text(tomli_w.dumps(document), encoding="utf-8")


def _own_table(camera: Camera) -> dict[str, Any]:
    return {"format": FORMAT, "version": VERSION, **camera.to_dict()}


# -- Anipose, Pose2Sim -----------------------------------------------------------------------------------------------


def recognises_anipose(path: Path) -> bool:
    return _is(path, (".toml",)) and not recognises_own(path)


def read_anipose(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Raises InputError."""
    document = parse_toml(_text(path), path)
    tables = {key: table for key, table in document.items() if isinstance(table, dict) and key != "metadata"}
    if not tables:
        expected = f'[camera] with format = "{FORMAT}", or one table per camera as Anipose and Pose2Sim write'
        raise InputError(Problem(path, "format", "no table of a camera", expected))
    return [_anipose_record(key, table) for key, table in tables.items()]


def _anipose_record(section: str, table: dict[str, Any]) -> CameraRecord:
    keys = {
        "matrix": "matrix",
        "distortion": "distortions",
        "image_size_px": "size",
        "rotation": "rotation",
        "translation_m": "translation",
    }
    bent = table.get("distortions")
    if isinstance(bent, list) and len(bent) == 1:
        table = table | {"distortions": bent + [0.0] * 3}  # k1 alone, the others were not estimated
    model = "fisheye" if table.get("fisheye") else "radtan"
    return CameraRecord(table.get("name", section), f"{section}.", model, False, table, keys)


# -- AcinoSet --------------------------------------------------------------------------------------------------------


def recognises_acinoset(path: Path) -> bool:
    return _is(path, (".json",), r'"(cameras|k)"\s*:') and not _is(path, (".json",), '"opencv-matrix"')


def read_acinoset(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Raises InputError."""
    document = parse_json(_text(path), path)
    entries = document.get("cameras", [document]) if isinstance(document, dict) else None
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(Problem(path, "cameras", "no list of cameras", "a list with k, d, r and t of each camera"))
    keys = {
        "matrix": "k",
        "distortion": "d",
        "rotation": "r",
        "translation_m": "t",
        "image_size_px": "camera_resolution",
    }
    size = {"camera_resolution": document.get("camera_resolution")}
    places = [f"cameras[{index}]." if "cameras" in document else "" for index in range(len(entries))]
    return [
        CameraRecord(entry.get("name"), place, "fisheye", True, entry | size, keys)
        for place, entry in zip(places, entries, strict=True)
    ]


# -- OpenDroneMap, OpenSfM -------------------------------------------------------------------------------------------

OPENSFM_LENSES = {
    "perspective": ("radtan", ("k1", "k2")),
    "simple_radial": ("radtan", ("k1",)),
    "radial": ("radtan", ("k1", "k2")),
    "brown": ("radtan", ("k1", "k2", "p1", "p2", "k3")),
    "fisheye": ("fisheye", ("k1", "k2")),
    "fisheye_opencv": ("fisheye", ("k1", "k2", "k3", "k4")),
}
"""By OpenSfM's name: our lens, and the first of its coefficients, of which the others are 0."""


def recognises_opensfm(path: Path) -> bool:
    return _is(path, (".json",), r'"projection_type"\s*:')


def read_opensfm(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Raises InputError."""
    document = parse_json(_text(path), path)
    if isinstance(document, list) and document and isinstance(document[0], dict):  # reconstruction.json
        document = document[0].get("cameras")
    if not isinstance(document, dict) or not document or not all(isinstance(of, dict) for of in document.values()):
        expected = "a table for each camera, by its name, as in OpenDroneMap's cameras.json"
        raise InputError(Problem(path, "cameras", "no tables by name", expected))
    return [opensfm_record(name, table) for name, table in document.items()]


def opensfm_record(name: str, table: dict[str, Any]) -> CameraRecord:
    """Its shares of the longer side in pixels, from the picture's middle."""
    lens = table.get("projection_type")
    model, given = OPENSFM_LENSES.get(lens, (lens, ())) if isinstance(lens, str) else (lens, ())
    changed: dict[str, Any] = {"width, height": None}
    try:
        w, h = (float(table[side]) for side in ("width", "height"))
        fx, fy = (float(table[f"focal_{axis}"] if f"focal_{axis}" in table else table["focal"]) for axis in "xy")
        cx, cy = (float(table.get(f"c_{axis}", 0.0)) for axis in "xy")
        longer = max(w, h)
        changed["width, height"] = [w, h]
        changed["matrix"] = [
            [longer * fx, 0.0, longer * cx + (w - 1) / 2],
            [0.0, longer * fy, longer * cy + (h - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
        bent = {key: float(table.get(key, 0.0)) for key in given}
        order = ("k1", "k2", "k3", "k4") if model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
        changed["distortion"] = [bent.get(key, 0.0) for key in order]
    except (KeyError, TypeError, ValueError, OverflowError):
        pass  # what is missing then is said
    keys = {
        "matrix": "matrix",
        "distortion": "distortion",
        "image_size_px": "width, height",
        "rotation": "rotation",
        "translation_m": "translation",
        "model": "projection_type",
    }
    return CameraRecord(name, f"{name}: ", model, False, changed, keys)


# -- OpenCV, ROS -----------------------------------------------------------------------------------------------------


def recognises_opencv(path: Path) -> bool:
    keys = "|".join(("opencv-matrix", *OPENCV_KEYS["matrix"]))
    return _is(path, (".yaml", ".yml", ".xml")) or _is(path, (".json",), f'"({keys})"')


def read_opencv(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Raises InputError."""
    text = _text(path)
    if path.suffix.lower() == ".json" and '"opencv-matrix"' not in text:
        document = parse_json(text, path)
        if not isinstance(document, dict):
            raise InputError(Problem(path, "content", "something else than a table", "a camera_matrix"))
        return [_opencv_record(document)]
    # What OpenCV writes as JSON is not always JSON: whole numbers are "1.". Of YAML, OpenCV 4 and 5 write different
    # headers, and ROS none; all versions read this one.
    if path.suffix.lower() in (".yaml", ".yml"):
        text = "%YAML:1.0\n---\n" + re.sub(r"\A(\s*#[^\n]*\n|\s*\n)*(%YAML[^\n]*\n)?(---[^\n]*\n)?", "", text)
    return [_opencv_record(_load_file_storage(path, text))]


def _opencv_record(document: dict[str, Any]) -> CameraRecord:
    keys = {
        field: next((alias for alias in aliases if alias in document), aliases[0])
        for field, aliases in OPENCV_KEYS.items()
    }
    size = [document.get(f"image_{side}", document.get(side)) for side in ("width", "height")]
    changed: dict[str, Any] = {"image_width, image_height": None if None in size else size}
    if keys["rotation"] == "R" and document.get(keys["translation_m"]) is None:
        changed["R"] = None  # ROS: the rectification, not a pose
    keys |= {"image_size_px": "image_width, image_height", "model": "distortion_model"}
    model = document.get("distortion_model")
    if model is None:
        model = "fisheye" if document.get("fisheye") or document.get("fisheye_model") else "radtan"
    up = bool(document.get("world_z_up", False))
    return CameraRecord(document.get("camera_name"), "", lens_named(str(model)) or model, up, document | changed, keys)


def _load_file_storage(path: Path, text: str) -> dict[str, Any]:
    """A document of OpenCV's FileStorage as plain dictionaries, lists, strings and numbers."""
    import cv2  # slow to import

    if _nesting(text) > MAX_NESTING:
        raise InputError(Problem(path, "content", "lists or tables that are nested too deeply", "a calibration"))
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        document = _plain_node(storage.root())
    except (cv2.error, SystemError) as error:  # the constructor's cv2.error arrives wrapped in a SystemError
        reason = str(error.__cause__ or error).strip().splitlines()[-1]
        reason = reason.rpartition("error)")[2].strip()
        raise InputError(
            Problem(path, "file", f"text that OpenCV cannot parse: {reason}", "YAML, XML or JSON")
        ) from error
    if not isinstance(document, dict):
        raise InputError(Problem(path, "file", "no keys", "camera_matrix, distortion_coefficients, ..."))
    return document


def _nesting(text: str) -> int:
    """A bound on how deeply OpenCV's parsers, which know no limit, go into a text: brackets, elements, or what stands
    in one line of YAML, times the lines that are indented ever more. Whether they are closed does not matter: what
    looks like it may be a comment."""
    inline = max((len(re.findall(r"[-:?](?=\s)", line)) for line in text.splitlines()), default=0)
    indents = {len(spaces) for spaces in re.findall(r"(?m)^ *(?=\S)", text)}
    return max(len(re.findall(r"[\[{]", text)), len(re.findall(r"<[^/?!]", text)), inline * len(indents))


def _plain_node(node: Any) -> Any:
    if node.isMap():
        return {key: _plain_node(node.getNode(key)) for key in node.keys()}  # noqa: SIM118 (not a dict)
    if node.isSeq():
        return [_plain_node(node.at(index)) for index in range(node.size())]
    if node.isString():
        return node.string()
    return node.real() if node.isInt() or node.isReal() else None
