"""C3D files of marker positions: the unit and the screen's axes in the header; a missing point has residual -1.

C3D counts frames from 1: its frame 1 is frame 0 here. Our own files list their frame numbers, which may have gaps, in
which all points are missing. The format (c3d.org,
user guide): blocks of 512 bytes; a header, a section of parameters in groups, and for each frame four numbers of every
point, x, y, z and a word with the residual, followed by the analog samples. Numbers are those of one of three kinds of
processor.
"""

from __future__ import annotations

import errno
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import write_bytes
from recon.io.common import (
    choose,
    formats_extra,
    frames_of_text,
    frames_text,
    name_problems,
    rate,
    require_names,
    required_fps,
    without_gaps,
)
from recon.io.pose import PER_METRE, UNIT_NAMES, Pose3D, StoredPoints

TITLE = "C3D"
UNIT = "mm"
"""Of our own files."""
OWN_GROUP = "RECON"
WORD_MAX, TEXT_MAX = 65_535, 255
BLOCK = 512
KEY = 0x50
INTEL, DEC, MIPS = 84, 85, 86
"""Kinds of processor: the order of bytes, and DEC's own floats."""

Parameters = dict[str, dict[str, Any]]
"""By group and name: lists of texts, or arrays."""


@dataclass(frozen=True, eq=False)
class _Content:
    """What a file holds, of T frames and J points."""

    parameters: Parameters
    xyz: np.ndarray
    """(T, J, 3), NaN where a point is missing."""
    first: int
    """The number of the first frame, from 1."""


def recognises(path: Path) -> bool:
    """By the key of the header and the kind of processor of the parameters."""
    with path.open("rb") as file:
        head = file.read(2)
        if len(head) < 2 or head[1] != KEY or not head[0]:
            return False
        file.seek(BLOCK * (head[0] - 1) + 3)
        return file.read(1) in {bytes([p]) for p in (INTEL, DEC, MIPS)}


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Raises InputError for a damaged file, and for a choice of animals: C3D has one."""
    choose(path, [""], individual)
    try:
        content = _content(path.read_bytes())
    except (ValueError, IndexError, struct.error) as error:
        raise InputError(Problem(path, "content", f"data that cannot be read ({error})", "a whole C3D file")) from None
    xyz, point = content.xyz, content.parameters.get("POINT", {})
    T, J = xyz.shape[:2]
    names = tuple(_labels(point))[:J]
    problems = name_problems(path, "POINT:LABELS", names)
    fps = rate(str(np.float32(number))) if (number := _first_number(point.get("RATE"))) is not None else None
    if len(names) != J:
        problems.append(Problem(path, "POINT:LABELS", f"{len(names)} names", f"{J}, one for each point"))
    if not T:
        problems.append(Problem(path, "points", "no frames", "at least one"))
    if fps is None:
        problems.append(Problem(path, "POINT:RATE", "nothing", "frames per second"))
    refuse(problems)
    listed = frames_of_text(_texts(content.parameters.get(OWN_GROUP, {}).get("FRAMES")))
    frames = np.arange(T) + content.first - 1
    if listed is not None and len(listed) <= T and listed[-1] - listed[0] == T - 1:
        frames, xyz = listed, xyz[listed - listed[0]]
    unit = UNIT_NAMES.get("".join(_texts(point.get("UNITS"))[:1]))
    return StoredPoints(names, xyz, frames, fps=fps, unit=unit, up=_up(point))


def _labels(point: dict[str, Any]) -> list[str]:
    """LABELS holds 255 names; more follow in LABELS2, LABELS3, ..."""
    found = _texts(point.get("LABELS"))
    more = 2
    while f"LABELS{more}" in point:
        found += _texts(point[f"LABELS{more}"])
        more += 1
    return found


def _up(point: dict[str, Any]) -> str | None:
    """The axis that points up on the screen."""
    screen = [text.upper() for text in _texts(point.get("Y_SCREEN"))]
    return {"+Z": "z", "Z": "z", "+Y": "y", "Y": "y"}.get(screen[0]) if screen else None


# -- the file -----------------------------------------------------------------------------------------------------


def _content(content: bytes) -> _Content:
    """Raises ValueError, IndexError or struct.error for a file that is damaged or cut off."""
    start = BLOCK * (content[0] - 1)
    processor = content[start + 3]
    order = ">" if processor == MIPS else "<"
    points, analogs, first, last, _ = struct.unpack_from(f"{order}5H", content, 2)
    block = struct.unpack_from(f"{order}H", content, 16)[0]
    scale = float(_floats(content[12:16], processor)[0])
    parameters = _parameters(content[start : start + BLOCK * content[start + 2]], processor)
    point = parameters.get("POINT", {})
    if (stated := _first_number(point.get("SCALE"))) is not None:
        scale = float(stated)
    first, last = _range(parameters, first, last)
    T, width = max(last - first + 1, 0) if points or analogs else 0, 4 * points + analogs
    begin, item = BLOCK * (block - 1), 4 if scale < 0 else 2
    if block < 2 or not np.isfinite(scale) or begin + T * width * item > len(content):
        raise ValueError(f"{len(content)} bytes of {begin + T * width * item} that the header announces")
    values = content[begin : begin + T * width * item]
    if item == 4:
        rows = _floats(values, processor).reshape(T, width)[:, : 4 * points].reshape(T, points, 4)
        with np.errstate(invalid="ignore"):  # a NaN that signals, as damaged floats can be
            xyz, word = rows[..., :3].astype(float), rows[..., 3]
    else:
        rows = np.frombuffer(values, f"{order}i2").reshape(T, width)[:, : 4 * points].reshape(T, points, 4)
        xyz, word = rows[..., :3] * scale, rows[..., 3]
    xyz[~(word >= 0)] = np.nan
    return _Content(parameters, xyz, max(first, 1))


def _range(parameters: Parameters, first: int, last: int) -> tuple[int, int]:
    """First and last frame, from 1: of TRIAL, whose two words hold what the header is too small for, or the header."""
    trial = parameters.get("TRIAL", {})
    return _of_words(trial.get("ACTUAL_START_FIELD"), first), _of_words(trial.get("ACTUAL_END_FIELD"), last)


def _of_words(value: Any, otherwise: int) -> int:
    """The number that two words make, the lower first; another one for anything else than two words."""
    if not isinstance(value, np.ndarray) or value.size != 2 or value.dtype.kind != "i":
        return otherwise
    low, high = (int(word) & 0xFFFF for word in value.ravel())
    return low | high << 16


def _parameters(section: bytes, processor: int) -> Parameters:
    """Records: length of the name (negative: locked), number of the group (negative: a group itself), name, distance
    to the next record from here, and for a parameter its type, dimensions and data."""
    groups: dict[int, str] = {}
    found: dict[int, dict[str, Any]] = {}
    order = ">h" if processor == MIPS else "<h"
    at = 4
    while at + 2 <= len(section):
        length, group = struct.unpack_from("bb", section, at)
        if not length or not group:
            break
        name = section[at + 2 : at + 2 + abs(length)].decode("latin-1").upper()
        at += 2 + abs(length)
        distance = struct.unpack_from(order, section, at)[0]
        if group < 0:
            groups[-group] = name
        else:
            found.setdefault(group, {})[name] = _value(section, at + 2, processor)
        if not distance:
            break
        if distance < 2:
            raise ValueError("parameters that do not follow one another")
        at += distance
    return {groups.get(group, f"{group}"): values for group, values in found.items()}


def _value(section: bytes, at: int, processor: int) -> Any:
    """A parameter's data: texts of type -1, bytes of 1, whole numbers of 2, floats of 4."""
    kind, dimensions = struct.unpack_from("bB", section, at)
    shape = tuple(section[at + 2 : at + 2 + dimensions])
    at += 2 + dimensions
    if len(shape) != dimensions or dimensions > 7 or kind not in (-1, 1, 2, 4):
        raise ValueError("a parameter of an unknown type")
    size = int(np.prod(shape, dtype=np.int64)) * abs(kind)
    data = section[at : at + size]
    if len(data) < size:
        raise ValueError("a parameter that is cut off")
    if kind == -1:
        width = shape[0] if shape else 1
        return [_decoded_text(data[i : i + width]) for i in range(0, size, width or 1)]
    order = ">" if processor == MIPS else "<"
    values = _floats(data, processor) if kind == 4 else np.frombuffer(data, "i1" if kind == 1 else f"{order}i2")
    return values.reshape(shape[::-1])


def _floats(data: bytes, processor: int) -> np.ndarray:
    """(N,): DEC's have their halves swapped, and another exponent."""
    if processor == DEC:
        halves = np.frombuffer(data, "<u2").reshape(-1, 2)
        return np.ascontiguousarray(halves[:, ::-1]).view("<f4").ravel() / 4
    return np.frombuffer(data, ">f4" if processor == MIPS else "<f4")


def _decoded_text(data: bytes) -> str:
    try:
        return data.decode("utf-8").strip(" \0")
    except UnicodeDecodeError:
        return data.decode("latin-1").strip(" \0")


def _texts(value: Any) -> list[str]:
    return list(value) if isinstance(value, list) else []


def _first_number(value: Any) -> float | None:
    """The first number of a parameter."""
    return float(value.ravel()[0]) if isinstance(value, np.ndarray) and value.size else None


# -- writing ---------------------------------------------------------------------------------------------------------


def write(pose: Pose3D, path: Path) -> None:
    """Millimetres, z up. Raises InputError without a frame rate, and for names, numbers of frames or gaps that C3D
    cannot hold."""
    fps = required_fps(pose.fps, TITLE)
    require_names(pose.names, r"^\s|\s$|\x00", TITLE, bytes_max=TEXT_MAX)
    with formats_extra(TITLE):
        import ezc3d
    xyz = without_gaps(pose.frames, pose.xyz_m * PER_METRE[UNIT], TITLE)
    ranges = frames_text(pose.frames)
    for what, count, most in (("frames", len(xyz), WORD_MAX), ("gaps", len(ranges) - 1, TEXT_MAX - 1)):
        if count > most:
            raise InputError(Problem(TITLE, what, str(count), f"at most {most}"))
    points = np.ones((4, len(pose.names), len(xyz)))
    points[:3] = np.nan_to_num(xyz, nan=0.0).transpose(2, 1, 0)
    missing = np.any(np.isnan(xyz), axis=2)
    file = ezc3d.c3d()
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = np.where(missing.T[None], -1.0, 0.0)
    first = int(pose.frames[0])
    file["header"]["points"]["first_frame"] = min(max(first, 0), WORD_MAX - len(xyz))
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [fps], [UNIT]
    point["LABELS"]["value"] = list(pose.names)
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    file.add_parameter(OWN_GROUP, "FRAMES", ranges)
    write_bytes(path, _encoded(file, points))


def _encoded(file: Any, points: np.ndarray) -> bytes:
    """The content of the file, with its points (4, J, T).

    The library writes to a path only, and does not say when a disk is full: it writes to memory, where the system has a
    folder for that, and the points are compared.
    """
    memory = "/dev/shm"
    with TemporaryDirectory(dir=memory if os.access(memory, os.W_OK | os.X_OK) else None) as folder:
        path = Path(folder) / "positions.c3d"
        file.write(str(path))
        content = path.read_bytes()
        start = 512 * (int.from_bytes(content[16:18], "little") - 1)
        stored = content[max(start, 0) :][: 4 * points.size]
        if len(stored) != 4 * points.size or not _same(stored, points):
            raise OSError(errno.ENOSPC, "a temporary file could not be written: is the disk full?", str(folder))
        return content


def _same(stored: bytes, points: np.ndarray) -> bool:
    found = np.frombuffer(stored, "<f4").reshape(points.shape[::-1]).T
    return np.array_equal(found[:3], points[:3].astype(np.float32))
