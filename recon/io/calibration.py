"""Cameras from calibration files of any known format (`recon.io.camera_files`), with every value checked."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.base.documents import parse_json, read_text
from recon.base.errors import InputError, Problem, all_of, refuse
from recon.geometry.camera import Camera, is_rotation
from recon.geometry.lens import LENS_MODELS
from recon.io.camera_files import MAX_BYTES, CameraRecord
from recon.io.formats import FORMATS, recognised, titles

CameraFiles = str | Path | Sequence[Path]
"""One file, or several."""
AS_GIVEN = ", as was given"
LARGEST = 1e9
"""Of any number: more can only be damage."""
MAX_SIZE_PX = 1_000_000
ROTATION_TOLERANCE = 1e-3


def read_cameras(path: CameraFiles, image_size_px: tuple[int, int] | None = None) -> tuple[Camera, ...]:
    """All cameras of a calibration file, in its order. Cameras without a name are called cam1, cam2, ... Of several
    files, one after the other; a file's only camera is called as the file where two have one name.

    image_size_px: (width, height) for files that do not hold it. Raises InputError with every problem of the file,
    also where image_size_px contradicts it (a calibration holds for one resolution only).
    """
    if not isinstance(path, str | Path):
        return _of_several_files([*path], image_size_px)
    path = Path(path)
    problems: list[Problem] = []
    records = _records(path)
    cameras = [_build(record, number, path, image_size_px, problems) for number, record in enumerate(records, 1)]
    names = [camera.name for camera in cameras if camera]
    problems += [
        Problem(path, "camera names", f"{name!r} {names.count(name)} times", "a name of its own for each camera")
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
    refuse(_contradicted_once(problems))
    return tuple(camera for camera in cameras if camera)


def _of_several_files(paths: Sequence[Path], image_size_px: tuple[int, int] | None) -> tuple[Camera, ...]:
    """Raises InputError with every problem of every file."""
    of_file = all_of(*(partial(read_cameras, path, image_size_px) for path in paths))
    names = [camera.name for cameras in of_file for camera in cameras]
    found: list[Camera] = []
    for path, cameras in zip(paths, of_file, strict=True):
        alone = len(cameras) == 1 and names.count(cameras[0].name) > 1
        found += [replace(camera, name=path.stem) for camera in cameras] if alone else cameras
    names = [camera.name for camera in found]
    twice = {name for name in names if names.count(name) > 1}
    refuse(Problem(paths[-1], "camera", f"{name}, as in another file", "a name of its own") for name in sorted(twice))
    return tuple(found)


def _contradicted_once(problems: list[Problem]) -> list[Problem]:
    """The size that was given contradicts all cameras of a file alike."""
    kept: list[Problem] = []
    for problem in problems:
        said = (problem.found, problem.expected) in [(other.found, other.expected) for other in kept]
        if not (said and problem.expected.endswith(AS_GIVEN)):
            kept.append(problem)
    return kept


def read_camera(
    path: CameraFiles, name: str | int | None = None, image_size_px: tuple[int, int] | None = None
) -> Camera:
    """One camera of a calibration file.

    name: the camera's name; or a whole number N for the camera called camN, cam_N or cam_0N, which in a file without
    names is the Nth, counted from 1. It may be left out where the file holds one camera. Raises InputError where the
    file has a problem (see `read_cameras`), no such camera, or several and no name is given.
    """
    cameras = read_cameras(path, image_size_px)
    path = path if isinstance(path, str | Path) else ", ".join(map(str, path))
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


def _records(path: Path) -> list[CameraRecord]:
    suffixes = sorted({suffix for f in FORMATS if "cameras" in f.reads for suffix in f.suffixes})
    if path.suffix.lower() not in suffixes:
        expected = f"a calibration file: {', '.join(suffixes)}"
        raise InputError(Problem(path, "format", f"suffix {path.suffix!r}", expected))
    found = recognised(path, "cameras")
    if found is not None and found.read is not None:
        return found.read(path, None)
    parse_json(read_text(path, "a calibration", MAX_BYTES), path)
    raise InputError(Problem(path, "format", "JSON of another kind", f"one of: {titles('cameras')}"))


# ---- from records to cameras ----


def _build(
    record: CameraRecord, number: int, path: Path, image_size_px: tuple[int, int] | None, problems: list[Problem]
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
        return Rotation.from_rotvec(array.ravel()).as_matrix()
    matrix = array.reshape(3, 3)
    if not is_rotation(matrix, ROTATION_TOLERANCE):
        return None
    if is_rotation(matrix, 1e-9):
        return matrix
    left, _, right = np.linalg.svd(matrix)
    return left @ right
