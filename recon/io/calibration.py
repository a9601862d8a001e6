"""Cameras from calibration files of any known format, with every value checked; and our own camera files.

A reader gives a `CameraRecord` for each camera, a table of unchecked values. Ours are TOML with one table `[camera]`
with `format = "recon-camera"`, or several in `[[cameras]]`; those of other programs are in `recon.io.camera_files`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.arrays import Array
from recon.base.documents import parse_json, parse_toml, read_text
from recon.base.errors import InputError, Problem, all_of, refuse
from recon.geometry.camera import Camera, is_rotation
from recon.geometry.lens import LENS_MODELS
from recon.io.formats import FORMATS, recognised, titles

CameraFiles = str | Path | Sequence[Path]
"""One file, or several."""
FORMAT, VERSION = "recon-camera", 1
MAX_BYTES = 1 << 23
LARGEST = 1e9
"""The largest number in a calibration: more can only be damage."""
MAX_SIZE_PX = 1_000_000
ROTATION_TOLERANCE = 1e-3
ALIASES = {
    "matrix": ("matrix", "camera_matrix", "cameraMatrix", "K", "k"),
    "distortion": ("distortions", "distortion_coefficients", "dist_coeffs", "distCoeffs", "D", "d"),
    "rotation": ("rotation", "R", "rvec", "r"),
    "translation_m": ("translation", "T", "tvec", "t"),
    "image_size_px": ("size", "camera_resolution", "image_size_px"),
    "model": ("distortion_model",),
}
"""What programs call a field."""


@dataclass(frozen=True)
class CameraRecord:
    """One camera as its file has it."""

    name: Any
    place: str
    values: Mapping[str, Any]
    """Unchecked, by field of `Camera`."""
    called: Mapping[str, str]
    """What the file calls a field, where it calls it otherwise."""

    @classmethod
    def of_table(cls, name: Any, place: str, table: Mapping[str, Any], **more: Any) -> CameraRecord:
        """From a table with keys of its own (`ALIASES`), and more values by field."""
        called = {field: next((key for key in keys if key in table), keys[0]) for field, keys in ALIASES.items()}
        values = {field: table.get(key) for field, key in called.items()}
        return cls(name, place, values | {"model": "radtan", "world_z_up": False} | more, called)


def read_cameras(path: CameraFiles, image_size_px: tuple[int, int] | None = None) -> tuple[Camera, ...]:
    """All cameras of a calibration file, in its order. Cameras without a name are called cam1, cam2, ... Of several
    files, one after the other; a file's only camera is called as the file where two have one name.

    image_size_px: (width, height) for files that do not hold it. Raises InputError with every problem of every file,
    also where image_size_px contradicts it (a calibration holds for one resolution only).
    """
    if not isinstance(path, str | Path):
        of_file = all_of(*(partial(read_cameras, one, image_size_px) for one in path))
        names = [camera.name for cameras in of_file for camera in cameras]
        found: list[Camera] = []
        for one, cameras in zip(path, of_file, strict=True):
            alone = len(cameras) == 1 and names.count(cameras[0].name) > 1
            found += [replace(cameras[0], name=one.stem)] if alone else cameras
        refuse(
            Problem(path[-1], "camera", f"{name}, as in another file", "a name of its own") for name in _twice(found)
        )
        return tuple(found)
    path = Path(path)
    return cameras_of(_records(path), path, image_size_px)


def cameras_of(
    records: Sequence[CameraRecord], path: Path, image_size_px: tuple[int, int] | None = None
) -> tuple[Camera, ...]:
    """The cameras of a file's records. Raises InputError with every problem."""
    problems: list[Problem] = []
    built = [_build(record, i, path, image_size_px, problems) for i, record in enumerate(records, 1)]
    cameras = tuple(camera for camera in built if camera)
    problems += [
        Problem(path, "camera names", f"{name!r} {count} times", "a name of its own for each camera")
        for name, count in _twice(cameras).items()
    ]
    refuse(problems)
    return cameras


def _twice(cameras: Sequence[Camera]) -> dict[str, int]:
    names = [camera.name for camera in cameras]
    return {name: names.count(name) for name in names if names.count(name) > 1}


def read_camera(
    path: CameraFiles, name: str | int | None = None, image_size_px: tuple[int, int] | None = None
) -> Camera:
    """One camera of a calibration file.

    name: the camera's name; or a whole number N for the camera called camN, cam_N or cam_0N, which in a file without
    names is the Nth, counted from 1. It may be left out where the file holds one camera. Raises InputError where the
    file has a problem (see `read_cameras`), no such camera, or several and no name is given.
    """
    cameras = read_cameras(path, image_size_px)
    wanted = "" if name is None else str(name)
    matches = [camera for camera in cameras if name is None or camera.name == wanted]
    if not matches and wanted.isascii() and wanted.isdigit():
        pattern = re.compile(rf"cam_?0*{int(wanted)}", re.IGNORECASE)
        matches = [camera for camera in cameras if pattern.fullmatch(camera.name)]
    if len(matches) == 1:
        return matches[0]
    many = f"{len(matches) or 'no'} camera{'s' * (len(matches) > 1)}"
    found = f"{many} and no choice" if name is None else f"{many} called {wanted!r}"
    expected = f"one of {', '.join(camera.name for camera in cameras)}{' by --camera-name' if name is None else ''}"
    path = path if isinstance(path, str | Path) else ", ".join(map(str, path))
    raise InputError(Problem(path, "camera", found, expected))


def _records(path: Path) -> list[CameraRecord]:
    suffixes = sorted({suffix for f in FORMATS if "cameras" in f.reads for suffix in f.suffixes})
    if path.suffix.lower() not in suffixes:
        expected = f"a calibration file: {', '.join(suffixes)}"
        raise InputError(Problem(path, "format", f"suffix {path.suffix!r}", expected))
    found = recognised(path, "cameras")
    if found is not None:
        return found.read(path, None)
    parse_json(read_calibration(path), path)
    raise InputError(Problem(path, "format", "JSON of another kind", f"one of: {titles('cameras')}"))


def read_calibration(path: Path) -> str:
    """Its text. Raises InputError for anything but a text that is not empty."""
    text = read_text(path, "a calibration", MAX_BYTES)
    if not text.strip():
        raise InputError(Problem(path, "file", "an empty file", "a calibration"))
    return text


# -- our own ----------------------------------------------------------------------------------------------------------


def recognises_own(path: Path) -> bool:
    return path.suffix.lower() == ".toml" and re.search(r"(?m)^\s*format\s*=", read_calibration(path)) is not None


def read_own(path: Path, individual: str | None = None) -> list[CameraRecord]:
    """Raises InputError for another version, too."""
    document = parse_toml(read_calibration(path), path)
    one, several = document.get("camera"), document.get("cameras")
    tables = {"camera.": one} if one is not None else {}
    if not tables and isinstance(several, list):
        tables = {f"cameras[{i}].": table for i, table in enumerate(several)}
    if not tables or not all(isinstance(table, dict) for table in tables.values()):
        raise InputError(Problem(path, "format", "no table of a camera", f'[camera] with format = "{FORMAT}"'))
    refuse(
        Problem(path, f"{place}format", f"format {table.get('format')!r}, version {table.get('version')!r}", expected)
        for place, table in tables.items()
        for expected in [f"format {FORMAT!r}, version {VERSION}"]
        if (table.get("format"), table.get("version")) != (FORMAT, VERSION)
    )
    up = {"world_z_up": True}
    return [CameraRecord(table.get("name"), place, up | table, {}) for place, table in tables.items()]


def write_cameras(cameras: Sequence[Camera], path: str | Path) -> None:
    """Write cameras as TOML that `read_cameras` reads back exactly; whole or not at all."""
    _write({"cameras": [_table(camera) for camera in cameras]}, path)


def write_camera(camera: Camera, path: str | Path) -> None:
    """The same of one, that `read_camera` reads back without its name."""
    _write({"camera": _table(camera)}, path)


def _table(camera: Camera) -> dict[str, Any]:
    return {"format": FORMAT, "version": VERSION, **camera.to_dict()}


def _write(document: dict[str, Any], path: str | Path) -> None:
    import tomli_w

    from recon.base.files import staged_file

    with staged_file(path) as staged:
        staged.write_text(tomli_w.dumps(document), encoding="utf-8")


# -- from records to cameras ------------------------------------------------------------------------------------------


def _build(
    record: CameraRecord, number: int, path: Path, image_size_px: tuple[int, int] | None, problems: list[Problem]
) -> Camera | None:
    """The camera of a record; or None, with every reason appended to problems."""
    before, values = len(problems), record.values

    def fault(field: str, found: str, expected: str) -> None:
        problems.append(Problem(path, record.place + record.called.get(field, field), found, expected))

    def block(field: str, sizes: tuple[int, ...], expected: str) -> Array | None:
        """The numbers of a field, where they have one of the sizes (any, for no sizes) and are finite."""
        array = _numbers(values.get(field))
        if values.get(field) is None:
            found = "nothing"
        elif array is None:
            found = "something other than a block of numbers"
        elif sizes and array.size not in sizes:
            found = f"shape {array.shape}"
        elif not (np.abs(array) <= LARGEST).all():
            found = f"values up to {np.abs(array).max():g}"
        else:
            return array
        return fault(field, found, expected)

    expected = "[[fx, s, ox], [0, fy, oy], [0, 0, 1]], fx and fy > 0"
    matrix = block("matrix", (9,), expected)
    if matrix is not None:
        matrix = matrix.reshape(3, 3)
        if min(matrix[0, 0], matrix[1, 1]) <= 0 or matrix[1, 0] != 0 or (matrix[2] != (0, 0, 1)).any():
            fault("matrix", str(matrix.tolist()), expected)

    model: Any = values.get("model")
    known = model in tuple(LENS_MODELS)
    if not known:
        fault("model", repr(model), "a known lens model")
    distortion = block("distortion", (), "the lens coefficients")
    if distortion is not None and known:
        distortion = distortion.ravel()
        model = model if distortion.size else "pinhole"
        counts = LENS_MODELS[model].counts
        while distortion.size not in counts and distortion.size > min(counts) and distortion[-1] == 0:
            distortion = distortion[:-1]  # such as OpenCV's thin prism and tilt, not estimated
        if distortion.size not in counts:
            expected = f"{' or '.join(map(str, counts))} coefficients of a {model} lens"
            fault("distortion", f"{distortion.size} coefficients", expected)

    size = _image_size(values.get("image_size_px"), image_size_px, fault)

    rotation = translation = None
    if values.get("rotation") is not None or values.get("translation_m") is not None:
        rotation = block("rotation", (3, 9), "a rotation, world to camera: 3x3 or a Rodrigues vector")
        translation = block("translation_m", (3,), "a translation of 3 numbers")
        if rotation is not None:
            rotation = _rotation(rotation)
            if rotation is None:
                expected = f"an orthonormal, right-handed matrix (to {ROTATION_TOLERANCE:g})"
                fault("rotation", "a matrix that is not a rotation", expected)

    up, tilt = values["world_z_up"], values.get("tilt_rad", 0.0)
    if not isinstance(up, bool):
        fault("world_z_up", repr(up), "true or false")
    if not isinstance(tilt, int | float) or not abs(tilt) < math.pi / 2 or (tilt and up and rotation is not None):
        fault("tilt_rad", repr(tilt), "radians between -pi/2 and pi/2, and 0 beside a pose that says which way is up")
    if len(problems) > before or matrix is None or distortion is None or size is None:
        return None
    name = f"cam{number}" if record.name is None else str(record.name)
    translation = None if translation is None else translation.ravel()
    return Camera(name, matrix, distortion, model, size, rotation, translation, up, float(tilt))


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
        return fault("image_size_px", str(value), expected)
    size = (int(array[0]), int(array[1]))
    if given is not None and size != tuple(given):
        fault("image_size_px", f"{size[0]}x{size[1]}", f"{given[0]}x{given[1]}, as was given")
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
        from scipy.spatial.transform import Rotation  # hardly any file has one

        return Rotation.from_rotvec(array.ravel()).as_matrix()
    matrix = array.reshape(3, 3)
    if not is_rotation(matrix, ROTATION_TOLERANCE):
        return None
    if is_rotation(matrix, 1e-9):
        return matrix
    left, _, right = np.linalg.svd(matrix)
    return left @ right
