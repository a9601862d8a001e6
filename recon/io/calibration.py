"""Read cameras from calibration files of any known format, and from recon's own camera files.

The reader of a format returns a `CameraRecord` of unchecked values for each camera, and this module checks them.
Recon's own files are TOML with a table `[camera]` that has `format = "recon-camera"`, or several in `[[cameras]]`.
Files of other programs are in `recon.io.camera_files`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.arrays import Array
from recon.base.documents import parse_json, parse_toml, read_text, require_file
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.geometry.camera import BLOCKS, MAX_ABSOLUTE, TILT, Camera, is_rotation
from recon.geometry.lens import LENS_MODELS
from recon.io.formats import FORMATS, recognised, titles

CameraFiles = str | Path | Sequence[Path]
"""Path of one calibration file, or paths of several."""
FORMAT, VERSION = "recon-camera", 1
MAX_BYTES = 1 << 23
MAX_SIZE_PX = 1_000_000
ROTATION_TOLERANCE = 1e-3
MAX_NUMBERS_BYTES = 1 << 14
ROTATION_VECTOR = "a rotation vector in radians, along the axis and as long as the angle"
KEYS_SHOWN = 160
"""Largest number of characters of a file's keys that a message shows."""


@dataclass(frozen=True)
class CameraRecord:
    """Camera as described in a file, with unchecked values."""

    name: Any
    location: str
    values: Mapping[str, Any]
    """Unchecked value for each field of `Camera` that the file states."""
    called: Mapping[str, str]
    """Key in the file for each field of `Camera` that has another name there."""
    lenses: Iterable[str] = tuple(LENS_MODELS)
    """Names of lens models that the file format can have."""
    keys: tuple[str, ...] = ()
    """All keys of the camera's table, listed in messages on missing fields."""


def read_cameras(path: CameraFiles, image_size_px: tuple[int, int] | None = None) -> tuple[Camera, ...]:
    """Return all cameras of a calibration file, or of several files, in order.

    Cameras without a name are called cam1, cam2, ... With several files, if two cameras have the same name, a file's
    only camera is named after the file.

    Parameters
    ----------
    path : path, or sequence of paths
        The calibration file or files.
    image_size_px : (width, height), optional
        Picture size in pixels for files that state none. It must agree with a size that a file states.

    Raises
    ------
    InputError
        If the files cannot be used. The message lists every problem.
    """
    if not isinstance(path, str | Path):
        of_file = collect_problems(*(partial(read_cameras, file, image_size_px) for file in path))
        names = [camera.name for cameras in of_file for camera in cameras]
        renamed: list[Camera] = []
        for file, cameras in zip(path, of_file, strict=True):
            alone = len(cameras) == 1 and names.count(cameras[0].name) > 1
            renamed += [replace(cameras[0], name=file.stem)] if alone else cameras
        twice = [f"{name}, which another file has too" for name in _twice(renamed)]
        raise_problems(Problem(path[-1], "camera", name, "a different name for each camera") for name in twice)
        return tuple(renamed)
    path = Path(path)
    suffixes = sorted({suffix for f in FORMATS if "cameras" in f.reads for suffix in f.suffixes})
    if path.suffix.lower() not in suffixes:
        raise InputError(Problem(path, "format", *_of_other_suffix(path, f"a calibration file: {', '.join(suffixes)}")))
    unsupported = _unsupported_format(path)
    if unsupported is not None:
        raise InputError(Problem(path, "format", *unsupported))
    reader = recognised(path, "cameras")
    if reader is None:
        keys = _keys_text(parse_json(read_calibration(path), path))
        raise InputError(
            Problem(path, "format", f"JSON that is no known camera file{keys}", f"one of: {titles('cameras')}")
        )
    return cameras_of(reader.read(path), path, image_size_px)


def _keys_text(document: object) -> str:
    """Return the keys of a document, and of the tables in it, for a message."""
    entries = document.items() if isinstance(document, dict) else [("", document)]
    text = ", ".join(f"{key}{_inner_keys(value)}".strip() for key, value in entries)
    return f"; it has {text[:KEYS_SHOWN]}" if text else ""


def _inner_keys(value: object) -> str:
    """Return the keys of a table, or of the first table of a list, in brackets."""
    table = value[0] if isinstance(value, list) and value else value
    return f" ({', '.join(map(str, table))})" if isinstance(table, dict) else ""


_KEYS = "camera_matrix, distortion_coefficients, image_width, image_height, and R and T from world to camera"
_BY_HAND = f"its values in JSON, one table for each camera: {_KEYS}"
_OTHER_PROGRAMS = (
    (
        r'"(ppx|ppy)"',
        "intrinsics of a RealSense camera, whose lens model can be the inverse of OpenCV's",
        "a calibration with a board (recon calibrate)",
    ),
    (
        r'"(IntrinsicMatrix|RadialDistortion|RDistort)"',
        "MATLAB's camera parameters, in the order of MATLAB",
        f"{_BY_HAND}; transpose IntrinsicMatrix (not K), write the coefficients as RadialDistortion 1, 2, "
        "TangentialDistortion 1, 2, RadialDistortion 3, and note that ImageSize is height, width",
    ),
    (
        r'"(fl_x|camera_angle_x|transform_matrix)"',
        "nerfstudio's or Blender's transforms.json, whose poses are from camera to world",
        f"{_BY_HAND}, with y down and z ahead",
    ),
    (r"(?i)<(qualisys|qtm)|<calibration[^>]*(created|qtm)", "a Qualisys calibration", _BY_HAND),
    (r"<Camera [^>]*DEVICEID", "a Vicon calibration", _BY_HAND),
    (
        r"<chunk|<document[^>]*version|<calibration>\s*<projection>",
        "a Metashape project or calibration",
        "OpenCV's XML: in Metashape, Tools > Camera Calibration > Save, as OpenCV",
    ),
    (
        r"(?ms)\A(?!.*(matrix|\bK)\s*:).*^cam0:\s*$.*^\s+(camera_model|cam_overlaps|distortion_coeffs|rostopic)\s*:",
        "a Kalibr camchain",
        f"{_BY_HAND}; the world is that of cam0, and poses are products of T_cn_cnm1",
    ),
)
"""Patterns of calibration files that recon cannot read, each with a description, and what to give instead."""
_OTHER_SUFFIXES = {
    ".npz": ("an archive of NumPy", _BY_HAND),
    ".npy": ("an array of NumPy", _BY_HAND),
    ".pickle": ("a pickle, which can run code", _BY_HAND),
    ".pkl": ("a pickle, which can run code", _BY_HAND),
    ".xcp": ("a Vicon calibration", _BY_HAND),
    ".bin": ("a binary COLMAP model", "a model as text, for a camera that moves: --camera-track"),
}
"""Calibration files that recon cannot read, by suffix, each with a description, and what to give instead."""
DLT_COEFFICIENTS = 11
ARGUS_NUMBERS = 12
"""Number of values of a camera in Argus' profile: index, focal length, size, centre, aspect, five coefficients."""


def _unsupported_format(path: Path) -> tuple[str, str] | None:
    """Return the description of a known format that cannot be read, and what to give instead, or None."""
    if path.suffix.lower() == ".mat":
        require_file(path)
        return None
    text = read_calibration(path)
    return next(((name, instead) for pattern, name, instead in _OTHER_PROGRAMS if re.search(pattern, text)), None)


def _of_other_suffix(path: Path, expected: str) -> tuple[str, str]:
    """Return the description of a file whose suffix is that of no calibration, and what to give instead."""
    if path.is_dir():
        return "a folder", expected
    suffix = f"suffix {path.suffix!r}"
    if path.suffix.lower() in _OTHER_SUFFIXES:
        name, instead = _OTHER_SUFFIXES[path.suffix.lower()]
        return f"{suffix}: {name}", instead
    if not path.is_file() or path.stat().st_size > MAX_NUMBERS_BYTES:
        return suffix, expected
    lines = [line for line in path.read_text(errors="replace").splitlines() if line.strip()]
    if any(re.match(r"#\s*CAMERA_ID, MODEL", line) for line in lines):
        return f"{suffix}: cameras of COLMAP", f"--camera-track, if the camera moves; otherwise {_BY_HAND}"
    if not lines or not all(re.fullmatch(r"[-+0-9.eE,;\s]+", line) for line in lines):
        return suffix, expected
    if {len(line.split()) for line in lines} == {ARGUS_NUMBERS}:
        return f"{suffix}: a camera profile of Argus, which holds no pose", _BY_HAND
    if len(lines) == DLT_COEFFICIENTS:
        return f"{suffix}: DLT coefficients, which hold no lens", _BY_HAND
    return suffix, expected


def cameras_of(
    records: Sequence[CameraRecord], path: Path, image_size_px: tuple[int, int] | None = None
) -> tuple[Camera, ...]:
    """Return the cameras of a file's records.

    Raises
    ------
    InputError
        If records are invalid. The message lists every problem.
    """
    cameras = collect_problems(
        *(partial(_camera, record, i, path, image_size_px) for i, record in enumerate(records, 1))
    )
    expected = "a unique name for each camera"
    raise_problems(
        Problem(path, "camera names", f"{name!r} {n} times", expected) for name, n in _twice(cameras).items()
    )
    return tuple(cameras)


def _twice(cameras: Sequence[Camera]) -> dict[str, int]:
    names = [camera.name for camera in cameras]
    return {name: names.count(name) for name in names if names.count(name) > 1}


def read_camera(
    path: CameraFiles, name: str | int | None = None, image_size_px: tuple[int, int] | None = None
) -> Camera:
    """Return one camera of a calibration file.

    `name` is the camera's name. A whole number N selects camN, cam_N or cam0N, which is the Nth camera in a file
    without names.

    Raises
    ------
    InputError
        If the file cannot be used, or if not exactly one camera matches.
    """
    cameras = read_cameras(path, image_size_px)
    wanted = "" if name is None else str(name)
    matches = [camera for camera in cameras if name is None or camera.name == wanted]
    if not matches and wanted.isascii() and wanted.isdigit():
        pattern = re.compile(rf"cam_?0*{int(wanted)}", re.IGNORECASE)
        matches = [camera for camera in cameras if pattern.fullmatch(camera.name)]
    if len(matches) == 1:
        return matches[0]
    count_text = f"{len(matches) or 'no'} camera{'s' * (len(matches) > 1)}"
    detail = f"{count_text}, none of them chosen" if name is None else f"{count_text} called {wanted!r}"
    expected = f"one of {', '.join(camera.name for camera in cameras)}{' by --camera-name' if name is None else ''}"
    path = path if isinstance(path, str | Path) else ", ".join(map(str, path))
    raise InputError(Problem(path, "camera", detail, expected))


def read_calibration(path: Path) -> str:
    """Return the text of a calibration file.

    Raises
    ------
    InputError
        If the file cannot be read as text.
    """
    return read_text(path, "a calibration", MAX_BYTES)


def recognises_own(path: Path) -> bool:
    """Return whether a file is one of recon's own camera files."""
    return path.suffix.lower() == ".toml" and re.search(r"(?m)^\s*format\s*=", read_calibration(path)) is not None


def read_own(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Return the cameras of recon's own camera file.

    Raises
    ------
    InputError
        If the file is invalid or written by another version of the format.
    """
    document = parse_toml(read_calibration(path), path)
    single, several = document.get("camera"), document.get("cameras")
    tables = {"camera.": single} if single is not None else {}
    if not tables and isinstance(several, list):
        tables = {f"cameras[{i}].": table for i, table in enumerate(several)}
    if not tables or not all(isinstance(table, dict) for table in tables.values()):
        raise InputError(Problem(path, "format", "no table of a camera", f'[camera] with format = "{FORMAT}"'))
    words, expected = "format {!r}, version {!r}", (FORMAT, VERSION)
    stated = {f"{location}format": (table.get("format"), table.get("version")) for location, table in tables.items()}
    wrong = {field: values for field, values in stated.items() if values != expected}
    raise_problems(
        Problem(path, field, words.format(*values), words.format(*expected)) for field, values in wrong.items()
    )
    defaults = {"world_z_up": True}
    return [CameraRecord(table.get("name"), location, defaults | table, {}) for location, table in tables.items()]


def _camera(record: CameraRecord, number: int, path: Path, image_size_px: tuple[int, int] | None) -> Camera:
    """Return the camera of a record, or raise InputError with every problem.

    A camera without a name in the record is called cam followed by `number`.
    """
    values, camera = record.values, None
    faults: dict[str, tuple[str, str]] = {}
    """Found and expected value of each wrong field."""
    arguments: dict[str, Any] = {"name": f"cam{number}" if record.name is None else str(record.name)}
    arguments |= {
        "world_z_up": values["world_z_up"],
        "tilt_rad": values.get("tilt_rad", 0.0),
        "model": values.get("model"),
    }
    for field, kinds, expected in (("world_z_up", bool, "true or false"), ("tilt_rad", int | float, TILT)):
        if not isinstance(arguments[field], kinds):
            faults[field] = repr(arguments.pop(field)), expected
    for field, (_, expected) in BLOCKS.items():
        arguments[field] = _numbers(values.get(field))
        if arguments[field] is None and values.get(field) is not None:
            faults[field] = "data that is not an array of numbers", expected
    rotation = arguments.get("rotation")
    if rotation is not None and rotation.size == 3 and np.linalg.norm(rotation) > 2 * np.pi:
        faults["rotation"] = f"a vector of length {np.linalg.norm(rotation):.3g}, perhaps in degrees", ROTATION_VECTOR
    arguments["image_size_px"], fault = _image_size(values.get("image_size_px"), image_size_px)
    faults |= {"image_size_px": fault} if fault else {}
    # the matrix could not be computed for an unknown lens model, which is the only problem to report
    if values.get("matrix") is None and arguments["model"] not in (None, *LENS_MODELS):
        faults = {"model": (repr(arguments["model"]), f"one of: {', '.join(record.lenses)}")}
    else:
        try:
            camera = Camera(**_reshaped(arguments))
        except InputError as error:
            faults = {problem.field: (problem.found, problem.expected) for problem in error.problems} | faults
    for field in ("matrix", "distortion"):
        if field in faults and values.get(field) is None and record.keys:
            faults[field] = f"nothing; the file has {', '.join(record.keys)[:KEYS_SHOWN]}", faults[field][1]
    if "matrix" in faults and _is_transposed(arguments["matrix"]):
        matrix_text, expected = faults["matrix"]
        faults["matrix"] = (
            f"{matrix_text.strip()} with the principal point in its last row",
            f"its transpose: {expected}",
        )
    if faults or camera is None:
        keys = {field: record.location + record.called.get(field, field) for field in faults}
        raise InputError(Problem(path, keys[field], *fault) for field, fault in faults.items())
    return camera


def _is_transposed(matrix: Array | None) -> bool:
    """Return whether a camera matrix has its principal point in the last row."""
    if matrix is None or matrix.shape != (3, 3):
        return False
    return bool((matrix[:2, 2] == 0).all() and (matrix[2, :2] > 0).all() and matrix[2, 2] == 1)


def _reshaped(arguments: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of `Camera` with arrays in its shapes, without excess distortion coefficients that are 0."""
    matrix, distortion, rotation, translation = (arguments[field] for field in BLOCKS)
    if matrix is not None and matrix.size == 9:
        arguments["matrix"] = matrix.reshape(3, 3)
    if distortion is not None and arguments["model"] in tuple(LENS_MODELS):
        distortion = distortion.ravel()
        arguments["model"] = arguments["model"] if distortion.size else "pinhole"
        counts = LENS_MODELS[arguments["model"]].counts
        while distortion.size not in counts and distortion.size > min(counts) and distortion[-1] == 0:
            distortion = distortion[:-1]  # such as OpenCV's thin prism and tilt coefficients
        arguments["distortion"] = distortion
    if rotation is not None and rotation.size in (3, 9) and (np.abs(rotation) <= MAX_ABSOLUTE).all():
        arguments["rotation"] = _rotation(rotation)
    if translation is not None and translation.size == 3:
        arguments["translation_m"] = translation.ravel()
    return arguments


def _image_size(value: object, stated: tuple[int, int] | None) -> tuple[tuple[int, int], tuple[str, str] | None]:
    """Return the image size in pixels, and the found and the expected value if the size is missing or wrong.

    If the file and the user both state a size, they must agree.
    """
    expected = "the image size: width and height in pixels"
    if value is None:
        return stated or (1, 1), None if stated else ("nothing", f"{expected}, in the file or by --image-size")
    sides = [int(side) for side in re.findall(r"\d{1,9}", value)] if isinstance(value, str) else value  # 1920x1080
    array = _numbers(sides)
    if array is None or array.shape != (2,) or not ((array > 0) & (array < MAX_SIZE_PX)).all() or (array % 1).any():
        return (1, 1), (str(value), expected)
    width, height = map(int, array)
    if stated is not None and (width, height) != tuple(stated):
        return (width, height), (f"{width}x{height}", f"{stated[0]}x{stated[1]} as given")
    return (width, height), None


def _numbers(value: object) -> Array | None:
    """Convert a number, a nested list or {rows, cols, data} to an array, and anything else to None."""
    try:
        if isinstance(value, Mapping):
            array = np.asarray(value["data"]).reshape(int(value["rows"]), int(value["cols"]))
        else:
            array = np.asarray(value)
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    return array.astype(float) if array.dtype.kind in "iuf" else None


def _rotation(array: Array) -> Array:
    """Return a rotation matrix from a Rodrigues vector, or from a 3x3 matrix that is only nearly orthonormal."""
    if array.size == 3:
        from scipy.spatial.transform import Rotation  # imported here because few files need it

        return Rotation.from_rotvec(array.ravel()).as_matrix()
    matrix = array.reshape(3, 3)
    if is_rotation(matrix, 1e-9) or not is_rotation(matrix, ROTATION_TOLERANCE):
        return matrix
    left, _, right = np.linalg.svd(matrix)
    return left @ right
