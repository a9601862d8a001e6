"""Calibration files: cameras in, cameras out.

Formats, told apart by suffix and content:

- OpenCV YAML, JSON and XML (`camera_matrix`, `distortion_coefficients`, `image_width`, `image_height`, and the other
  spellings in use), including ROS camera_info YAML with `distortion_model`. The lens is a fisheye where the file says
  `fisheye: 1` or `distortion_model: equidistant`, else radial-tangential. A pose is optional (`R`, `T`; `rotation`,
  `translation`; `rvec`, `tvec`; world to camera). Whether z points up is only known where the file has `world_z_up: 1`.
- AcinoSet JSON: a scene (`cameras` with `k`, `d`, `r`, `t` and perhaps `name`) or one camera (`k`, `d`). Fisheye
  lenses, world to camera, metres, world z up.
- Anipose and Pose2Sim TOML: one table per camera. World to camera in the length unit of the calibration board, which
  the file does not name: it is taken to be metres here, and `camera_unit` of a fit's settings says otherwise. The board
  defines the world, so z need not point up.
- This package's own TOML: one table `[camera]` with `format = "recon-camera"`, see `write_camera`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.arrays import Array
from recon.base.documents import parse_json, parse_toml, read_text
from recon.base.errors import InputError, Problem
from recon.base.files import staged_file
from recon.geometry.camera import Camera, is_rotation
from recon.geometry.lens import LENS_MODELS, lens_named

FORMAT = "recon-camera"
AS_GIVEN = ", as was given"
VERSION = 1
MAX_BYTES = 1 << 23
LARGEST = 1e9
"""Of any number: more can only be damage."""
MAX_SIZE_PX = 1_000_000
MAX_NESTING = 5_000
"""OpenCV dies at 20,000."""
ROTATION_TOLERANCE = 1e-3

OPENCV_KEYS = {
    "matrix": ("camera_matrix", "cameraMatrix", "K"),
    "distortion": ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D"),
    "rotation": ("rotation", "R", "rvec"),
    "translation_m": ("translation", "T", "tvec"),
}


@dataclass(frozen=True)
class _Record:
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


def read_cameras(path: str | Path, image_size_px: tuple[int, int] | None = None) -> tuple[Camera, ...]:
    """All cameras of a calibration file, in its order. Cameras without a name are called cam1, cam2, ...

    image_size_px: (width, height) for files that do not hold it. Raises InputError with every problem of the file,
    also where image_size_px contradicts it (a calibration holds for one resolution only).
    """
    path = Path(path)
    problems: list[Problem] = []
    records = _read_records(path)
    cameras = [_build(record, number, path, image_size_px, problems) for number, record in enumerate(records, 1)]
    names = [camera.name for camera in cameras if camera]
    problems += [
        Problem(path, "camera names", f"{name!r} {names.count(name)} times", "a name of its own for each camera")
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
    if problems:
        raise InputError(_contradicted_once(problems))
    return tuple(camera for camera in cameras if camera)


def _contradicted_once(problems: list[Problem]) -> list[Problem]:
    """The size that was given contradicts all cameras of a file alike."""
    kept: list[Problem] = []
    for problem in problems:
        said = (problem.found, problem.expected) in [(other.found, other.expected) for other in kept]
        if not (said and problem.expected.endswith(AS_GIVEN)):
            kept.append(problem)
    return kept


def read_camera(
    path: str | Path, name: str | int | None = None, image_size_px: tuple[int, int] | None = None
) -> Camera:
    """One camera of a calibration file.

    name: the camera's name; or a whole number N for the camera called camN, cam_N or cam_0N, which in a file without
    names is the Nth, counted from 1. It may be left out where the file holds one camera. Raises InputError where the
    file has a problem (see `read_cameras`), no such camera, or several and no name is given.
    """
    cameras = read_cameras(path, image_size_px)
    choices = f"one of {', '.join(camera.name for camera in cameras)}"
    if name is None:
        if len(cameras) == 1:
            return cameras[0]
        raise InputError(
            Problem(path, "camera", f"{len(cameras)} cameras and no choice", f"{choices} by --camera-name")
        )
    wanted = str(name)
    matches = [camera for camera in cameras if camera.name == wanted]
    if not matches and wanted.isascii() and wanted.isdigit():
        pattern = re.compile(rf"cam_?0*{int(wanted)}", re.IGNORECASE)
        matches = [camera for camera in cameras if pattern.fullmatch(camera.name)]
    if len(matches) != 1:
        raise InputError(
            Problem(
                path, "camera", f"{len(matches) or 'no'} camera{'s' * (len(matches) > 1)} called {wanted!r}", choices
            )
        )
    return matches[0]


def write_camera(camera: Camera, path: str | Path) -> None:
    """Write one camera as TOML that `read_camera` reads back exactly; whole or not at all."""
    _write({"camera": _table(camera)}, path)


def write_cameras(cameras: Sequence[Camera], path: str | Path) -> None:
    """The same of several, that `read_cameras` reads."""
    _write({"cameras": [_table(camera) for camera in cameras]}, path)


def _write(document: dict[str, Any], path: str | Path) -> None:
    import tomli_w

    with staged_file(path) as staged:
        staged.write_text(tomli_w.dumps(document), encoding="utf-8")


def _table(camera: Camera) -> dict[str, Any]:
    return {"format": FORMAT, "version": VERSION, **camera.to_dict()}


# ---- from text to records ----


def _read_records(path: Path) -> list[_Record]:
    parsers: dict[str, Callable[[Path, str], list[_Record]]] = {
        ".json": _parse_json,
        ".toml": _parse_toml,
        ".yaml": _parse_yaml,
        ".yml": _parse_yaml,
        ".xml": _parse_xml,
    }
    parse = parsers.get(path.suffix.lower())
    if parse is None:
        raise InputError(
            Problem(path, "format", f"suffix {path.suffix!r}", f"a calibration file: {', '.join(sorted(parsers))}")
        )
    text = read_text(path, "a calibration", MAX_BYTES)
    if not text.strip():
        raise InputError(Problem(path, "file", "an empty file", "a calibration"))
    return parse(path, text)


def _parse_json(path: Path, text: str) -> list[_Record]:
    if '"opencv-matrix"' in text:
        # OpenCV 4 writes whole numbers as "1.", which is not JSON.
        return [_opencv_record(_load_file_storage(path, text))]
    document = parse_json(text, path)
    if isinstance(document, dict) and ("cameras" in document or "k" in document):
        return _acinoset_records(path, document)
    if isinstance(document, dict) and any(key in document for key in OPENCV_KEYS["matrix"]):
        return [_opencv_record(document)]
    raise InputError(
        Problem(path, "format", "JSON of another kind", "an AcinoSet scene (cameras), k and d, or a camera_matrix")
    )


def _parse_yaml(path: Path, text: str) -> list[_Record]:
    # OpenCV 4 and 5 write different headers, ROS none. All versions read this one.
    body = re.sub(r"\A(\s*#[^\n]*\n|\s*\n)*(%YAML[^\n]*\n)?(---[^\n]*\n)?", "", text)
    return [_opencv_record(_load_file_storage(path, "%YAML:1.0\n---\n" + body))]


def _parse_xml(path: Path, text: str) -> list[_Record]:
    return [_opencv_record(_load_file_storage(path, text))]


def _parse_toml(path: Path, text: str) -> list[_Record]:
    document = parse_toml(text, path)
    own = document.get("camera")
    if isinstance(own, dict) and "format" in own:
        return [_own_record(path, own)]
    several = document.get("cameras")
    if isinstance(several, list) and all(isinstance(one, dict) and "format" in one for one in several):
        return [_own_record(path, one, f"cameras[{i}].") for i, one in enumerate(several)]
    tables = {key: table for key, table in document.items() if isinstance(table, dict) and key != "metadata"}
    if not tables:
        expected = f'[camera] with format = "{FORMAT}", or one table per camera as Anipose and Pose2Sim write'
        raise InputError(Problem(path, "format", "no table of a camera", expected))
    return [_anipose_record(key, table) for key, table in tables.items()]


def _own_record(path: Path, table: dict[str, Any], place: str = "camera.") -> _Record:
    if (table["format"], table.get("version")) != (FORMAT, VERSION):
        found = f"format {table['format']!r}, version {table.get('version')!r}"
        raise InputError(Problem(path, f"{place}format", found, f"format {FORMAT!r}, version {VERSION}"))
    keys = {field: field for field in ("matrix", "distortion", "image_size_px", "rotation", "translation_m")}
    up, tilt_rad = table.get("world_z_up", True), table.get("tilt_rad", 0.0)
    return _Record(table.get("name"), place, table.get("model"), up, table, keys, tilt_rad)


def _anipose_record(section: str, table: dict[str, Any]) -> _Record:
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
    return _Record(table.get("name", section), f"{section}.", model, False, table, keys)


def _acinoset_records(path: Path, document: dict[str, Any]) -> list[_Record]:
    entries = document.get("cameras", [document])
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
        _Record(entry.get("name"), place, "fisheye", True, entry | size, keys)
        for place, entry in zip(places, entries, strict=True)
    ]


def _opencv_record(document: dict[str, Any]) -> _Record:
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
    return _Record(document.get("camera_name"), "", lens_named(str(model)) or model, up, document | changed, keys)


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


# ---- from records to cameras ----


def _build(
    record: _Record, number: int, path: Path, image_size_px: tuple[int, int] | None, problems: list[Problem]
) -> Camera | None:
    """The camera of a record; or None, with every reason appended to problems."""
    before = len(problems)

    def fault(field: str, found: str, expected: str) -> None:
        problems.append(Problem(path, record.place + record.keys.get(field, field), found, expected))

    def block(field: str, sizes: tuple[int, ...], expected: str) -> Array | None:
        """The numbers of a field, where they have one of the sizes (any, for no sizes) and are finite."""
        array = _numbers(record.value(field))
        if record.value(field) is None:
            fault(field, "nothing", expected)
        elif array is None:
            fault(field, "something other than a block of numbers", expected)
        elif sizes and array.size not in sizes:
            fault(field, f"shape {array.shape}", expected)
        elif not np.isfinite(array).all():
            fault(field, "values that are not finite", expected)
        elif (np.abs(array) > LARGEST).any():
            fault(field, f"values up to {np.abs(array).max():g}", expected)
        else:
            return array
        return None

    expected = "[[fx, s, ox], [0, fy, oy], [0, 0, 1]], fx and fy > 0"
    matrix = block("matrix", (9,), expected)
    if matrix is not None:
        matrix = matrix.reshape(3, 3)
        if min(matrix[0, 0], matrix[1, 1]) <= 0 or matrix[1, 0] != 0 or (matrix[2] != (0, 0, 1)).any():
            fault("matrix", str(matrix.tolist()), expected)

    model = record.model
    known = model in tuple(LENS_MODELS)
    if not known:
        fault("model", repr(model), "a known lens model")
    distortion = block("distortion", (), "the lens coefficients")
    if distortion is not None and known:
        distortion = distortion.ravel()
        if not distortion.size:
            model = "pinhole"
        counts = LENS_MODELS[model].counts
        while distortion.size not in counts and distortion.size > min(counts) and distortion[-1] == 0:
            distortion = distortion[:-1]  # such as OpenCV's thin prism and tilt, not estimated
        if distortion.size not in counts:
            expected = f"{' or '.join(map(str, counts))} coefficients of a {model} lens"
            fault("distortion", f"{distortion.size} coefficients", expected)

    size = _image_size(record.value("image_size_px"), image_size_px, fault)

    rotation = translation = None
    if record.value("rotation") is not None or record.value("translation_m") is not None:
        rotation = block("rotation", (3, 9), "a rotation, world to camera: 3x3 or a Rodrigues vector")
        translation = block("translation_m", (3,), "a translation of 3 numbers")
        if rotation is not None:
            rotation = _rotation(rotation)
            if rotation is None:
                expected = f"an orthonormal, right-handed matrix (to {ROTATION_TOLERANCE:g})"
                fault("rotation", "a matrix that is not a rotation", expected)

    if not isinstance(record.world_z_up, bool):
        fault("world_z_up", repr(record.world_z_up), "true or false")
    knows_up = rotation is not None and record.world_z_up
    tilt = record.tilt_rad
    if not isinstance(tilt, int | float) or not abs(tilt) < math.pi / 2 or (tilt and knows_up):
        fault("tilt_rad", repr(tilt), "radians between -pi/2 and pi/2, and 0 beside a pose that says which way is up")
    if len(problems) > before or matrix is None or distortion is None or size is None:
        return None
    return Camera(
        name=f"cam{number}" if record.name is None else str(record.name),
        matrix=matrix,
        distortion=distortion,
        model=model,
        image_size_px=size,
        rotation=rotation,
        translation_m=None if translation is None else translation.ravel(),
        world_z_up=record.world_z_up,
        tilt_rad=float(tilt),
    )


def _image_size(
    value: Any, given: tuple[int, int] | None, fault: Callable[[str, str, str], None]
) -> tuple[int, int] | None:
    """The image size from the file and from the caller, which must agree where both are known."""
    expected = "the image size: width and height in pixels"
    if value is None:
        if given is None:
            fault("image_size_px", "nothing", f"{expected}, in the file or by --image-size")
        return given
    array = _numbers(value)
    if array is None or array.shape != (2,) or not ((array > 0) & (array < MAX_SIZE_PX)).all() or (array % 1).any():
        fault("image_size_px", str(value), expected)
        return None
    size = (int(array[0]), int(array[1]))
    if given is not None and size != tuple(given):
        fault("image_size_px", f"{size[0]}x{size[1]}", f"{given[0]}x{given[1]}{AS_GIVEN}")
    return size


def _numbers(value: Any) -> Array | None:
    """Array of a number, a nested list, or {rows, cols, data}; None for anything else."""
    try:
        if isinstance(value, Mapping):
            array = np.asarray(value["data"]).reshape(int(value["rows"]), int(value["cols"]))
        else:
            array = np.asarray(value)
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    return array.astype(float) if array.dtype.kind in "iuf" else None


def _rotation(array: Array) -> Array | None:
    """Rotation matrix of a 3x3 matrix or a Rodrigues vector; None for a matrix that is no rotation."""
    if array.size == 3:
        from scipy.spatial.transform import Rotation  # slow to import

        return Rotation.from_rotvec(array.ravel()).as_matrix()
    matrix = array.reshape(3, 3)
    if not is_rotation(matrix, ROTATION_TOLERANCE):
        return None
    if is_rotation(matrix, 1e-9):
        return matrix
    left, _, right = np.linalg.svd(matrix)
    return left @ right
