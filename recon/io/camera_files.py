"""Read calibration files of other programs as tables of unchecked values, and write recon's own.

Layouts of further programs are in `recon.io.lab_cameras`.

- OpenCV YAML, JSON and XML (`camera_matrix`, `distortion_coefficients`, `image_width`, `image_height`, and the other
  spellings in use), including ROS camera_info YAML with `distortion_model`. The lens is the stated one (`LENS_KEYS`,
  `fisheye: 1`), otherwise radial-tangential. A pose from world to camera is optional (`R`, `T`; `rotation`,
  `translation`; `rvec`, `tvec`). z is known to point up only if the file has `world_z_up: 1`.
- AcinoSet JSON: a scene (`cameras` with `k`, `d`, `r`, `t` and perhaps `name`) or one camera (`k`, `d`). Lenses are
  fisheye lenses, and poses are from world to camera, in metres with z up.
- Anipose and Pose2Sim TOML: one table per camera. Poses are from world to camera in the length unit of the calibration
  board, which the file does not name. Metres are assumed here, and `camera_unit` of a fit's settings states another
  unit. The board defines the world, so z need not point up.
- OpenDroneMap's `cameras.json` and OpenSfM's `camera_models.json`: a table per camera, by name, with focal lengths and
  centres as fractions of the picture's longer side. Poses are in tracks (`recon.io.camera_track`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from recon.base.arrays import Array
from recon.base.documents import Json, parse_json, parse_toml
from recon.base.errors import InputError, Problem
from recon.base.files import write_text
from recon.geometry.camera import Camera, is_rotation
from recon.geometry.lens import LENS_MODELS, lens_named
from recon.io.calibration import FORMAT, KEYS_SHOWN, ROTATION_TOLERANCE, VERSION, CameraRecord, read_calibration
from recon.io.common import number

if TYPE_CHECKING:
    import cv2  # slow to import

ALIASES = {
    "matrix": (
        *("matrix", "camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix", "intrinsicMatrix", "mtx"),
        *("K", "k", "intrinsics", "intrinsic", "cam_matrix"),
    ),
    "distortion": (
        *("distortions", "distortion_coefficients", "Distortion_Coefficients", "distortionCoefficients"),
        *("dist_coeffs", "distCoeffs", "distCoef", "dist_coef", "dist_coeff", "distortion_coeffs", "distortion"),
        *("dist", "D", "d"),
    ),
    "rotation": ("rotation", "rotation_matrix", "R", "rvec", "r", "rotation_vector"),
    "translation_m": ("translation", "translation_vector", "T", "tvec", "t"),
    "image_size_px": (
        *("size", "camera_resolution", "image_size_px", "image_size", "imageSize", "resolution"),
        *("img_size", "frame_size"),
    ),
    "model": ("distortion_model",),
}
"""Keys of each field in other programs, which may also be written with other capitals, blanks, or underscores."""
FOCAL_KEYS = ("fx", "fy", "cx", "cy")
"""Keys of a camera matrix given as separate numbers."""
COEFFICIENT_KEYS = ("k1", "k2", "p1", "p2", "k3")
"""Keys of radial-tangential coefficients given as separate numbers, in OpenCV's order."""
INNER_KEYS = (
    *("intrinsics", "intrinsic", "intrinsic_parameters", "extrinsics", "extrinsic", "extrinsic_parameters"),
    *("distortion", "pose", "lens"),
)
"""Keys of tables in a camera's table that hold some of its values."""
POSE_KEYS = (
    *("extrinsics", "extrinsic", "extrinsic_matrix", "world_to_camera", "world2cam", "w2c", "RT", "view_matrix"),
    *("camera_to_world", "cam2world", "c2w", "pose", "camera_pose", "transform", "transform_matrix"),
)
"""Keys of a pose given as one matrix, whose direction differs between programs."""
_OTHER_POSE = re.compile(r"q|quat\w*|euler\w*|orientation|c|eye|(cam(era)?)?(pos(ition)?|cent(er|re)|location)")
"""Pattern of plain keys of a camera's position, or of its direction in numbers other than a matrix or a vector."""
LENS_KEYS = (
    *("distortion_model", "projection_model", "distortion_type", "lens_model", "camera_model", "model", "lens"),
    *("camera_type", "projection", "lens_type", "model_type", "projection_type", "type"),
)
"""Keys under which files state a lens model."""
STRICT_LENS_KEYS = LENS_KEYS[:4]
"""Keys whose value can only be a lens model, while values of the other `LENS_KEYS` can also name a product."""
FISHEYE_KEYS = ("fisheye", "fisheye_model", "is_fisheye", "use_fisheye")
SIZE_KEYS = (
    ("image_width", "width", "img_width", "frame_width"),
    ("image_height", "height", "img_height", "frame_height"),
)
"""Keys of the picture's width, and of its height."""
_PERSPECTIVE = ("pinhole", "perspective")
"""Names of camera models that do not describe the lens distortion."""
_OTHER_LENS = re.compile(
    r"fish|omni|equi|kannala|brandt|\bmei\b|thin|division|unified|fov|eucm|\bds\b|double|sphere|scaramuzza|ocam|\batan\b",
    re.IGNORECASE,
)
"""Pattern of lens models in a text that can also name a product."""
_NO = {"no", "false", "off", "0", "none", ""}
"""Words that negate a key of `FISHEYE_KEYS`."""
MAX_NESTING = 5_000
"""Largest number of nested levels in a file that is read, because OpenCV crashes on deeply nested files."""


def _is(path: Path, suffixes: tuple[str, ...], pattern: str = "") -> bool:
    return path.suffix.lower() in suffixes and re.search(pattern, read_calibration(path)) is not None


def _tables(path: Path, value: object, expected: str) -> dict[str, dict[str, Any]]:
    """Return `value` if it is a dictionary of tables, or raise InputError if it is empty or anything else."""
    if not isinstance(value, dict) or not value or not all(isinstance(table, dict) for table in value.values()):
        raise InputError(Problem(path, "cameras", "no table of a camera", expected))
    return value


def record_of(name: object, location: str, table: Mapping[str, Any], **changes: Any) -> CameraRecord:
    """Return the camera record of a table in which fields have other programs' keys (`ALIASES`).

    The lens is the stated lens, otherwise radial-tangential. `changes` replace values of the table, by field.
    """
    called = {field: key_in(table, keys) or keys[0] for field, keys in ALIASES.items()}
    values = {field: table.get(key) for field, key in called.items()}
    if values["image_size_px"] is None:
        values["image_size_px"] = size_in(table)
    if values["matrix"] is None:
        values |= _values_from_scalars(table, values["distortion"])
    key, model = stated_lens(table)
    called["model"] = key
    values |= {"model": model or "radtan", "world_z_up": False} | changes
    if called["matrix"] == "intrinsicMatrix":  # JARVIS stores matrices transposed, as MATLAB does
        values |= {field: transposed(values[field]) for field in ("matrix", "rotation")}
    return CameraRecord(name, location, values, called, keys=tuple(map(str, table)))


def without_inner(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a camera's table into which the values of its inner tables, such as `intrinsics`, are merged."""
    names = {plain_key(name) for name in INNER_KEYS}
    inner = [
        key
        for key, value in table.items()
        if plain_key(key) in names and isinstance(value, Mapping) and not {"data", "rows"} & value.keys()
    ]
    values = {key: value for key, value in table.items() if key not in inner}
    for key in inner:
        values = {**table[key], **values}
    return values


def plain_key(key: object) -> str:
    """Return a key in lower case, without blanks, underscores and dashes."""
    return re.sub(r"[ _-]", "", str(key)).lower()


def key_in(table: Mapping[str, Any], keys: Sequence[str]) -> str | None:
    """Return the first of `keys` that a table has, as the table spells it, or None.

    Capitals, blanks, underscores and dashes are ignored if no key matches exactly.
    """
    exact = next((key for key in keys if key in table), None)
    if exact is not None:
        return exact
    written = {plain_key(key): key for key in table}
    return next((written[plain_key(key)] for key in keys if plain_key(key) in written), None)


def size_in(table: Mapping[str, object]) -> list[object] | None:
    """Return the picture's width and height if a table has them as two numbers."""
    keys = [key_in(table, names) for names in SIZE_KEYS]
    return None if None in keys else [table[key] for key in keys if key is not None]


def has_matrix(table: Mapping[str, Any]) -> bool:
    """Return whether a table has a camera matrix, as a block or as separate numbers."""
    return key_in(table, ALIASES["matrix"]) is not None or {*FOCAL_KEYS} <= table.keys()


def _values_from_scalars(table: Mapping[str, Any], distortion: object) -> dict[str, Any]:
    """Return the camera matrix from fx, fy, cx, cy, and the coefficients k1, k2, p1, p2, k3 if `distortion` is None."""
    if not {*FOCAL_KEYS} <= table.keys():
        return {}
    fx, fy, cx, cy = (table[key] for key in FOCAL_KEYS)
    values: dict[str, Any] = {"matrix": [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]}
    if distortion is None and {"k1", "k2"} <= table.keys() and not {"k4", "k5", "k6"} & table.keys():
        values["distortion"] = [table.get(key, 0.0) for key in COEFFICIENT_KEYS]
    return values


def require_separate_pose(path: Path, table: Mapping[str, Any], record: CameraRecord) -> None:
    """Raise InputError for a pose that is not stated by R and t, because it would be left out silently.

    It may be in one matrix, which is from world to camera or the other way round, or be the camera's position.
    """
    stated = [record.values[field] is not None for field in ("rotation", "translation_m")]
    if all(stated):
        return
    matrix = None if any(stated) else next((key for key, value in table.items() if _is_pose(key, value)), None)
    if matrix is not None:
        expected = "R and t from world to camera; if the matrix is from camera to world, invert it first"
        raise InputError(Problem(path, f"{record.location}{matrix}", "a pose in one matrix", expected))
    for key, value in table.items():
        if _OTHER_POSE.fullmatch(plain_key(key)) and _array(value).size in (3, 4):
            expected = "R and t from world to camera, where t is -R times the camera's position"
            raise InputError(Problem(path, f"{record.location}{key}", "a pose without R or without t", expected))


def _is_pose(key: str, value: object) -> bool:
    """Return whether a value is a pose in one matrix, by its key or its numbers."""
    array = _array(value)
    if array.size not in (12, 16):
        return False
    turn = array.reshape(-1, 4)[:3, :3]  # a projection matrix has the lens here
    return plain_key(key) in {plain_key(name) for name in POSE_KEYS} or is_rotation(turn, ROTATION_TOLERANCE)


def _array(value: object) -> Array:
    """Return a block of numbers as an array, which is empty for anything else."""
    try:
        array = np.asarray(_block(value) if isinstance(value, list | Mapping) else [])
    except ValueError:  # rows of different lengths
        return np.zeros(0)
    return array.astype(float) if array.dtype.kind in "iuf" else np.zeros(0)


def stated_lens(table: Mapping[str, Any]) -> tuple[str, str | None]:
    """Return the key under which a table states its lens, and the name of the lens.

    The name is recon's if the lens is known, otherwise the file's, and None if the table states no lens. Contradictory
    names are joined into one string, which is not the name of any lens.
    """
    stated: dict[str, str] = {}
    for name in LENS_KEYS:
        key = key_in(table, (name,))
        text = table[key] if key is not None else None
        if key is None or not isinstance(text, str) or text.lower() in _PERSPECTIVE:
            continue
        known = lens_named(text.lower())
        if known is not None or name in STRICT_LENS_KEYS or _OTHER_LENS.search(text):
            stated[key] = known or text
    for name in FISHEYE_KEYS:
        key = key_in(table, (name,))
        if key is not None and table[key] and str(table[key]).strip().lower() not in _NO:
            stated[key] = "fisheye"
    key = key_in(table, ("xi",))
    if key is not None and _array([table[key]]).any():
        stated[key] = "omnidirectional"  # the mirror parameter of OpenCV's omnidir and of Mei's model
    if len({*stated.values()}) > 1:
        return ", ".join(stated), " and ".join(stated.values())
    return next(iter(stated.items()), ("distortion_model", None))


def transposed(value: object) -> object:
    """Return the transpose of a 3x3 block, or anything else unchanged."""
    array = np.asarray(value["data"] if isinstance(value, Mapping) and "data" in value else value)
    return array.reshape(3, 3).T.tolist() if array.dtype.kind in "iuf" and array.size == 9 else value


def recognises_anipose(path: Path) -> bool:
    """Return whether a file is in TOML, the format of Anipose's calibrations.

    Recon's own camera files are in TOML, too. They are recognised first, because they precede Anipose's in `FORMATS`.
    """
    return _is(path, (".toml",))


def read_anipose(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the cameras of an Anipose or Pose2Sim TOML file."""
    document = parse_toml(read_calibration(path), path)
    expected = f'[camera] with format = "{FORMAT}", or one table per camera as Anipose and Pose2Sim write'
    records = []
    if isinstance(document.get("cameras"), dict):  # as Caliscope writes
        inside = document["cameras"]
        document = {f"cam_{key}" if str(key).isdigit() else key: table for key, table in inside.items()}
    # Caliscope's camera without a calibration has only its size
    document = {key: t for key, t in document.items() if not isinstance(t, dict) or "port" not in t or has_matrix(t)}
    # other tables are metadata, or the file is about something else
    tables = {key: table for key, table in document.items() if isinstance(table, dict) and has_camera_key(table)}
    if not tables:
        inside = (f"{key}: {', '.join(table)}" if isinstance(table, dict) else key for key, table in document.items())
        detail = f"no table of a camera; the file has {'; '.join(inside)[:KEYS_SHOWN]}"
        raise InputError(Problem(path, "cameras", detail, expected))
    for section, table in tables.items():
        coefficients = table.get("distortions")
        if isinstance(coefficients, list) and len(coefficients) == 1:
            table = table | {"distortions": coefficients + [0.0] * 3}  # only k1 was estimated, and the others are 0
        record = record_of(table.get("name", section), f"{section}.", table)
        require_separate_pose(path, table, record)
        records.append(record)
    return records


def has_camera_key(table: Mapping[str, Any]) -> bool:
    """Return whether a table has a key of a camera parameter."""
    return has_matrix(table) or any(key_in(table, keys) is not None for keys in ALIASES.values())


def recognises_acinoset(path: Path) -> bool:
    """Return whether a file is JSON of cameras with AcinoSet's keys, and no other keys for the same values."""
    if not _is(path, (".json",), r'"(cameras|k)"\s*:') or _is(path, (".json",), '"opencv-matrix"'):
        return False
    try:
        document = parse_json(read_calibration(path), path)
    except InputError:
        return True
    content = document.get("cameras", [document]) if isinstance(document, dict) else []
    entries = content.values() if isinstance(content, dict) else content if isinstance(content, list) else []
    tables = [entry for entry in entries if isinstance(entry, dict)]
    foreign = {*LENS_KEYS, *ALIASES["matrix"], *ALIASES["distortion"], "R", "T", "resolution"} - {"k", "d"}
    has_own_keys = not tables or any({"k", "d"} & table.keys() for table in tables)
    return has_own_keys and not any(foreign & table.keys() for table in tables)


def read_acinoset(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the cameras of an AcinoSet JSON file."""
    document = parse_json(read_calibration(path), path)
    entries = document.get("cameras", [document]) if isinstance(document, dict) else None
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(Problem(path, "cameras", "no list of cameras", "a list with k, d, r and t of each camera"))
    shared = {"camera_resolution": document.get("camera_resolution")}
    fixed = {"model": "fisheye", "world_z_up": True}
    locations = [f"cameras[{i}]." if "cameras" in document else "" for i in range(len(entries))]
    return [
        record_of(e.get("name"), location, shared | e, **fixed) for e, location in zip(entries, locations, strict=True)
    ]


OPENSFM_LENSES = {
    "perspective": ("radtan", ("k1", "k2")),
    "simple_radial": ("radtan", ("k1",)),
    "radial": ("radtan", ("k1", "k2")),
    "brown": ("radtan", ("k1", "k2", "p1", "p2", "k3")),
    "fisheye": ("fisheye", ("k1", "k2")),
    "fisheye_opencv": ("fisheye", ("k1", "k2", "k3", "k4")),
}
"""Recon's lens model for each of OpenSfM's names, and the coefficients that a file with this lens has."""
COLMAP_LENSES = {
    name: (lens.name, parameters.split()) for lens in LENS_MODELS.values() for name, parameters in lens.colmap.items()
}
"""Recon's lens model for each of COLMAP's names, and its parameters in order."""


def recognises_opensfm(path: Path) -> bool:
    """Return whether a file is OpenDroneMap's or OpenSfM's JSON."""
    return _is(path, (".json",), r'"projection_type"\s*:')


def read_opensfm(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the cameras of an OpenDroneMap or OpenSfM file, in pixels.

    Lengths in the file are fractions of the picture's longer side, and centres are measured from the picture's middle.
    """
    document = parse_json(read_calibration(path), path)
    if isinstance(document, list) and document and isinstance(document[0], dict):  # as in reconstruction.json
        document = document[0].get("cameras")
    expected = "a table for each camera, by its name, as in OpenDroneMap's cameras.json"
    called = {"image_size_px": "width, height", "model": "projection_type"}
    records = []
    for name, table in _tables(path, document, expected).items():
        values: dict[str, Any] = {"model": table.get("projection_type"), "world_z_up": False}
        with suppress(KeyError, TypeError, ValueError, OverflowError):  # a missing value is reported later
            values["model"], names = OPENSFM_LENSES[table["projection_type"]]
            n = {key: float(table.get(key, 0.0)) for key in names} | {"w": float(table["width"])}
            n["h"] = float(table["height"])
            longer = max(n["w"], n["h"])
            for axis, side in (("x", "w"), ("y", "h")):
                n[f"f{axis}"] = longer * float(table[f"focal_{axis}" if f"focal_{axis}" in table else "focal"])
                n[f"c{axis}"] = longer * float(table.get(f"c_{axis}", 0.0)) + (n[side] - 1) / 2
            values |= _record_values(values["model"], n)
        records.append(CameraRecord(name, f"{name}: ", values, called, OPENSFM_LENSES))
    return records


def read_colmap(path: Path) -> list[CameraRecord]:
    """Return the cameras of COLMAP's cameras.txt, without poses.

    Lines are CAMERA_ID MODEL WIDTH HEIGHT PARAMS. (0, 0) is the corner of the first pixel in COLMAP, and the centre of
    the first pixel in recon.
    """
    records = []
    for line, cells in enumerate(map(str.split, read_calibration(path).splitlines()), start=1):
        if not cells or cells[0].startswith("#"):
            continue
        values: dict[str, Any] = {"model": "".join(cells[1:2]), "world_z_up": False}
        with suppress(LookupError, ValueError):  # a missing value is reported later
            values["model"], names = COLMAP_LENSES[cells[1]]
            w, h = values["image_size_px"] = number(cells[2]), number(cells[3])
            n = dict(zip(names, map(number, cells[4:]), strict=True)) | {"w": w, "h": h}
            n |= {"fx": n["f"], "fy": n["f"]} if "f" in n else {}
            values |= _record_values(values["model"], n | {"cx": n["cx"] - 0.5, "cy": n["cy"] - 0.5})
        called = {"matrix": "parameters"}
        records.append(CameraRecord(cells[0], f"line {line}, camera {cells[0]}: ", values, called, COLMAP_LENSES))
    return records


def _record_values(model: str, n: dict[str, float]) -> dict[str, Any]:
    """Return a camera record's values from w, h, fx, fy, cx, cy and the lens's coefficients, 0 where absent."""
    lens = LENS_MODELS[model]
    count = min(count for count in lens.counts if count >= sum(name in n for name in lens.coefficients))
    matrix = [[n["fx"], 0.0, n["cx"]], [0.0, n["fy"], n["cy"]], [0.0, 0.0, 1.0]]
    distortion = [n.get(name, 0.0) for name in lens.coefficients[:count]]
    return {"model": model, "image_size_px": [n["w"], n["h"]], "matrix": matrix, "distortion": distortion}


def recognises_opencv(path: Path) -> bool:
    """Return whether a file is OpenCV's or ROS' YAML, XML or JSON."""
    if _is(path, (".yaml", ".yml", ".xml")) or _is(path, (".json",), '"opencv-matrix"'):
        return True
    if path.suffix.lower() != ".json":
        return False
    try:
        document = parse_json(read_calibration(path), path)
    except InputError:
        return False
    return isinstance(document, dict) and has_matrix(without_inner(document))


def read_opencv(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the camera of an OpenCV or ROS file."""
    document = without_inner(document_of(path))
    stated: dict[str, Any] = {"world_z_up": bool(document.get("world_z_up", False))}
    size = size_in(document)
    if size is not None:
        stated["image_size_px"] = size
    is_ros = key_in(document, ("distortion_model", "P", "projection_matrix")) is not None
    if is_ros and key_in(document, ("R",)) is not None and key_in(document, ALIASES["translation_m"]) is None:
        stated["rotation"] = None  # the R of ROS is a rectification, not a pose
    record = record_of(document.get("camera_name"), "", document, **stated)
    require_lens(path, document, record)
    require_separate_pose(path, document, record)
    return [cropped_to_region(path, document, record)]


def document_of(path: Path) -> dict[str, Any]:
    """Return the document of an OpenCV or ROS file as plain values.

    Raises
    ------
    InputError
        If the file is invalid.
    """
    text = read_calibration(path)
    if path.suffix.lower() == ".json" and '"opencv-matrix"' not in text:
        document = parse_json(text, path)
    else:  # OpenCV sometimes writes invalid JSON, with whole numbers as "1."
        document = _read_file_storage(path, text)
    if isinstance(document, list) and document and all(isinstance(table, dict) for table in document):
        return {"cameras": document}
    if not isinstance(document, dict):
        raise InputError(Problem(path, "content", "no keys", "keys such as camera_matrix and distortion_coefficients"))
    return document


def require_lens(path: Path, document: Mapping[str, Any], record: CameraRecord) -> None:
    """Raise InputError for four coefficients without a stated lens, because they may belong to either of two models."""
    value = record.values["distortion"]
    coefficients = np.asarray(value["data"] if isinstance(value, Mapping) and "data" in value else value)
    ambiguous = coefficients.size == 4 and coefficients.dtype.kind in "iuf" and coefficients.any()
    if ambiguous and stated_lens(document)[1] is None and key_in(document, FISHEYE_KEYS) is None:
        detail = "4 coefficients but no lens model: radtan and fisheye lenses both have 4"
        expected = "distortion_model: plumb_bob (radtan) or equidistant (fisheye) in the file"
        raise InputError(Problem(path, record.location + record.called["distortion"], detail, expected))


def cropped_to_region(path: Path, document: Mapping[str, Any], record: CameraRecord) -> CameraRecord:
    """Return the camera of a picture that ROS has cropped (region of interest) and downsampled (binning).

    The file's matrix belongs to the whole picture. As in ROS' image_geometry, the region's corner is subtracted from
    the principal point, and the result is divided by the binning.
    """
    region = document.get("roi")
    region = region if isinstance(region, Mapping) else {}
    binning = [number_or(document.get(f"binning_{axis}"), 1.0) or 1.0 for axis in "xy"]
    corner = [number_or(region.get(f"{axis}_offset"), 0.0) for axis in "xy"]
    size = [number_or(region.get(side), 0.0) for side in ("width", "height")]
    whole = record.values["image_size_px"]
    if binning == [1.0, 1.0] and corner == [0.0, 0.0] and (size in ([0.0, 0.0], whole)):
        return record
    matrix = np.array(_block(record.values["matrix"]), dtype=float)
    if matrix.size != 9 or not isinstance(whole, list):
        raise InputError(
            Problem(path, "roi", "a region of interest, or binning", "the matrix and the size of the whole picture")
        )
    matrix = matrix.reshape(3, 3)
    matrix[:2, 2] -= corner
    matrix[:2] /= np.array(binning)[:, None]
    region_px = [part or full for part, full in zip(size, whole, strict=True)]
    image_size_px = [int(side / by) for side, by in zip(region_px, binning, strict=True)]
    values = dict(record.values) | {"matrix": matrix.tolist(), "image_size_px": image_size_px}
    return CameraRecord(record.name, record.location, values, record.called, keys=record.keys)


def number_or(value: object, otherwise: float) -> float:
    """Return `value` as a float, or the default `otherwise` if it is not a number."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else otherwise


def _block(value: object) -> object:
    return value["data"] if isinstance(value, Mapping) and "data" in value else [] if value is None else value


def _read_file_storage(path: Path, text: str) -> Json:
    """Return OpenCV's FileStorage as plain dictionaries, lists, strings and numbers."""
    import cv2  # slow to import

    if path.suffix.lower() in (".yaml", ".yml"):
        # OpenCV 4 and 5 write different headers, and ROS writes none. All versions of OpenCV read the header below.
        text = re.sub(r"\A(\s*#[^\n]*\n|\s*\n)*(%YAML[^\n]*\n)?(---[^\n]*\n)?", "", text)
        text = re.sub(r"(?m)^---\s*\Z", "", text)  # ends a message that ROS 2 has printed
        text = "%YAML:1.0\n---\n" + _with_indented_lists(text)
    if _nesting(text) > MAX_NESTING:
        raise InputError(Problem(path, "content", "lists or tables that are nested too deeply", "a calibration"))
    try:
        # the nodes live only as long as the storage
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        return _plain_node(storage.root())
    except (cv2.error, SystemError) as error:  # the constructor's cv2.error arrives wrapped in a SystemError
        reason = str(error.__cause__ or error).strip().splitlines()[-1].rpartition("error)")[2].strip()
        detail = f"text that OpenCV cannot parse: {reason}"
        raise InputError(Problem(path, "file", detail, "YAML, XML or JSON")) from error


def _with_indented_lists(text: str) -> str:
    """Indent the lists of YAML below their keys, because OpenCV requires this indent and PyYAML does not write it."""
    lines: list[str] = []
    indents: list[int] = []  # indentation of each open list that was not indented
    key_indent = None
    for line in text.splitlines():
        indent, is_item = len(line) - len(line.lstrip(" ")), re.match(r" *-(\s|$)", line) is not None
        while line.strip() and indents and (indent < indents[-1] or (indent == indents[-1] and not is_item)):
            indents.pop()
        if is_item and indent == key_indent:
            indents.append(indent)
        lines.append("  " * len(indents) + line)
        if line.strip():
            key_indent = indent if line.rstrip().endswith(":") and not is_item else None
    return "\n".join(lines) + "\n"


def _nesting(text: str) -> int:
    """Return an upper bound on how deeply OpenCV's parsers descend into a string.

    OpenCV has no limit of its own. The bound counts brackets, elements, and for YAML the list markers in a line times
    the number of indents. Closing brackets do not count, because they may stand in comments.
    """
    inline = max((len(re.findall(r"[-:?](?=\s)", line)) for line in text.splitlines()), default=0)
    indents = {len(spaces) for spaces in re.findall(r"(?m)^ *(?=\S)", text)}
    return max(len(re.findall(r"[\[{]", text)), len(re.findall(r"<[^/?!]", text)), inline * len(indents))


def _plain_node(node: cv2.FileNode) -> Json:
    if node.isMap():
        return {key: _plain_node(node.getNode(key)) for key in node.keys()}  # noqa: SIM118 (not a dict)
    if node.isSeq():
        return [_plain_node(node.at(index)) for index in range(node.size())]
    if node.isString():
        return node.string()
    return node.real() if node.isInt() or node.isReal() else None


def write_cameras(cameras: Sequence[Camera], path: str | Path) -> None:
    """Write cameras as TOML that `read_cameras` reads back exactly, without leaving an incomplete file."""
    write_text(path, tomli_w.dumps({"cameras": [_table(camera) for camera in cameras]}))


def write_camera(camera: Camera, path: str | Path) -> None:
    """Write one camera to a TOML file, which `read_camera` reads without the camera's name."""
    write_text(path, tomli_w.dumps({"camera": _table(camera)}))


def _table(camera: Camera) -> dict[str, Any]:
    return {"format": FORMAT, "version": VERSION, **camera.to_dict()}
