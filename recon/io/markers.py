"""Read and write positions of markers in motion capture's formats, TRC and C3D.

TRC is text, separated by tabs or commas, with the unit in the header and y up by convention.

C3D (c3d.org, user guide) has blocks of 512 bytes: a header, a section of parameters in groups, and for each frame four
numbers of every point, x, y, z and a word with the residual, -1 for a missing point, followed by the analog samples.
The unit and the screen's axes are in the header. Numbers are stored as on Intel's or MIPS' processors. Files with DEC's
floats are not read. C3D counts frames from 1, which is frame 0 in recon. Recon's own files list their frame numbers,
and have no points in the gaps between these. Files are read without ezc3d, which crashes on damaged ones.
"""

from __future__ import annotations

import errno
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.documents import read_text
from recon.base.errors import InputError, Problem, raise_problems
from recon.io import common, writing
from recon.io.common import Pose3D, StoredPoints
from recon.io.positions import PER_METRE, UNIT_NAMES

UP_TEXT = "y up: x forwards, y up, z right"
"""End of the first line of the TRC files that recon writes."""
HEADER_LINES = 5


def recognises_trc(path: Path) -> bool:
    """Return whether a file is a TRC file."""
    return common.starts_with_text(path, b"PathFileType")


def read_trc(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the markers of a TRC file.

    Raises
    ------
    InputError
        If the header or cells cannot be used.
    """
    lines = read_text(path, "a TRC file").splitlines()
    separator = "\t" if "\t" in lines[0] else ","
    cells = [[cell.strip() for cell in line.split(separator)] for line in lines]
    header = dict(zip(cells[1], cells[2], strict=False))
    names = [name for name in cells[3][2:] if name]
    columns = ["Frame#", "Time", *(f"{name} {axis}" for name in names for axis in "XYZ")]
    rows = (
        (line, row if any(row[len(columns) :]) else row[: len(columns)])
        for line, row in enumerate(cells[HEADER_LINES:], start=HEADER_LINES + 1)
        if any(row)
    )
    _, values, problems = common.number_rows(path, rows, columns)
    raise_problems(common.first_problems(problems, path))
    notes = ()
    if header.get("NumFrames") != str(len(values)):
        stated = header.get("NumFrames", "no number of")
        notes = (f"The header states {stated} frames, but the file has {len(values)}.",)
    unit = header.get("Units") or None
    extra: dict[str, Any] = {"unit": UNIT_NAMES.get(str(unit), unit), "up": "y" if UP_TEXT in cells[0] else None}
    xyz = values[:, 2:].reshape(len(values), len(names), 3)
    fps = common.rate(header.get("DataRate"))
    stored = StoredPoints(tuple(names), xyz, values[:, 0], fps=fps, notes=notes, **extra)
    return common.without_lost_markers(common.one_animal(path, individual, stored))


def write_trc(pose: Pose3D, path: Path) -> None:
    """Write a TRC file in metres with x forwards, y up and z right, as OpenSim reads it, and empty cells in gaps.

    Raises
    ------
    InputError
        If the frame rate is not known, or if a name has tabs or line breaks.
    """
    fps = writing.required_fps(pose.fps, "TRC")
    writing.require_names(pose.names, r"[\t\r\n]|^\s|\s$", "TRC")
    T, rate = len(pose.frames), repr(fps)
    header = {"DataRate": rate, "CameraRate": rate, "NumFrames": T, "NumMarkers": len(pose.names), "Units": "m"}
    header |= {"OrigDataRate": rate, "OrigDataStartFrame": pose.frames[0], "OrigNumFrames": T}
    lines = [
        ["PathFileType", "4", "(X/Y/Z)", path.name, UP_TEXT],
        list(header),
        list(header.values()),
        ["Frame#", "Time", *(cell for name in pose.names for cell in (name, "", ""))],
        ["", "", *(f"{axis}{j + 1}" for j in range(len(pose.names)) for axis in "XYZ")],
    ]
    values = writing.y_up_from_z_up(pose.xyz_m).reshape(len(pose.frames), -1)
    for frame, row in zip(pose.frames.tolist(), values.tolist(), strict=True):
        lines.append([frame, repr(frame / fps), *("" if v != v else repr(v) for v in row)])
    text = "".join("\t".join(map(str, line)) + "\n" for line in lines)
    path.write_text(text, encoding="utf-8", newline="")


UNIT = "mm"
"""Unit of lengths in the C3D files that recon writes."""
OWN_GROUP = "RECON"
WORD_MAX, TEXT_MAX = 65_535, 255
BLOCK = 512
KEY = 0x50
INTEL = 84
"""Processor type in the header of C3D files with little-endian numbers."""
MIPS = 86
"""Processor type in the header of C3D files with big-endian numbers."""

Parameters = dict[str, dict[str, Any]]
"""Parameters of a C3D file, as lists of strings or arrays of numbers, keyed by group and then by name."""


def recognises_c3d(path: Path) -> bool:
    """Return whether a file is a C3D file, by the key of the header and the kind of processor."""
    with path.open("rb") as file:
        head = file.read(2)
        if len(head) < 2 or head[1] != KEY or not head[0]:
            return False
        file.seek(BLOCK * (head[0] - 1) + 3)
        return file.read(1) in {bytes([p]) for p in (INTEL, MIPS)}


def read_c3d(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the markers of a C3D file."""
    parameters, xyz, first = _content(path.read_bytes())
    point = parameters.get("POINT", {})
    # each parameter holds up to 255 names
    labels = sorted((name for name in point if name.startswith("LABELS")), key=len)
    names = [text for name in labels for text in point[name]][: xyz.shape[1]]
    fps = common.rate(str(np.float32(point["RATE"].ravel()[0])))
    frames = np.arange(len(xyz)) + first - 1
    listed = writing.frames_of_text(parameters.get(OWN_GROUP, {}).get("FRAMES", ()))
    # a program that cuts the file may leave the list of frames as it was before, which is then ignored
    if listed is not None and listed[-1] - listed[0] == len(xyz) - 1:
        frames, xyz = listed, xyz[listed - listed[0]]
    unit, screen = ("".join(point.get(name, ())[:1]) for name in ("UNITS", "Y_SCREEN"))
    up_axis = {"+Z": "z", "Z": "z", "+Y": "y", "Y": "y"}.get(screen.upper())
    stored = StoredPoints(tuple(names), xyz, frames, fps=fps, unit=UNIT_NAMES.get(unit), up=up_axis)
    return common.without_lost_markers(common.one_animal(path, individual, stored))


def _content(content: bytes) -> tuple[Parameters, np.ndarray, int]:
    """Return parameters, positions (T, J, 3), NaN where missing, and the number of the first frame, from 1.

    If the file is damaged or cut off, errors of the types that `damage_as_input_error` converts are raised.
    """
    start = BLOCK * (content[0] - 1)
    order = ">" if content[start + 3] == MIPS else "<"
    points, analogs, first, last, _, scale, block = struct.unpack_from(f"{order}5HfH", content, 2)
    parameters = _parameters(content[start : start + BLOCK * content[start + 2]], order)
    if "SCALE" in parameters.get("POINT", {}):
        scale = float(parameters["POINT"]["SCALE"].ravel()[0])
    # Numbers too large for the header are in two words each of TRIAL, the lower first.
    trial = parameters.get("TRIAL", {})
    first = _number_of_words(trial.get("ACTUAL_START_FIELD"), first)
    last = _number_of_words(trial.get("ACTUAL_END_FIELD"), last)
    T, width = max(last - first + 1, 0) if points or analogs else 0, 4 * points + analogs
    kind = f"{order}f4" if scale < 0 else f"{order}i2"
    begin, size = BLOCK * (block - 1), T * width * np.dtype(kind).itemsize
    if block < 2 or not np.isfinite(scale) or begin + size > len(content):
        raise ValueError(f"{len(content)} of the {begin + size} bytes that the header states")
    rows = np.frombuffer(content[begin : begin + size], kind).reshape(T, width)[:, : 4 * points].reshape(T, points, 4)
    with np.errstate(invalid="ignore"):  # damaged floats can be signalling NaNs
        xyz = rows[..., :3].astype(float) * (1.0 if scale < 0 else scale)
        xyz[~(rows[..., 3] >= 0)] = np.nan
    return parameters, xyz, max(first, 1)


def _number_of_words(value: object, otherwise: int) -> int:
    """Return the number that is stored as two 16-bit words, the lower first, or `otherwise` for other values."""
    if not isinstance(value, np.ndarray) or value.size != 2 or value.dtype.kind != "i":
        return otherwise
    low, high = (int(word) & 0xFFFF for word in value.ravel())
    return low | high << 16


def _parameters(section: bytes, order: str) -> Parameters:
    """Return the parameters in the parameter section of a C3D file.

    A record has the length of the name (negative if locked), the number of the group (negative for the group itself),
    the name, the distance from the end of the name to the next record, and for a parameter its type, dimensions and
    data.

    `order` is the byte order of numbers, "<" or ">".
    """
    groups: dict[int, str] = {}
    by_group: dict[int, dict[str, Any]] = {}
    position, distance = 4, 2
    while position + 2 <= len(section) and distance:
        length, group = struct.unpack_from("bb", section, position)
        if not length or not group:
            break
        name = section[position + 2 : position + 2 + abs(length)].decode("latin-1").upper()
        position += 2 + abs(length)
        distance = struct.unpack_from(f"{order}h", section, position)[0]
        if group < 0:
            groups[-group] = name
        else:
            by_group.setdefault(group, {})[name] = _value(section, position + 2, order)
        if distance and distance < 2:
            raise ValueError("parameters that are not contiguous")
        position += distance
    return {groups.get(group, f"{group}"): values for group, values in by_group.items()}


def _value(section: bytes, position: int, order: str) -> list[str] | np.ndarray:
    """Return a parameter's data, which are strings (type -1), bytes (1), whole numbers (2) or floats (4).

    `order` is the byte order of numbers, "<" or ">".
    """
    kind, dimensions = struct.unpack_from("bB", section, position)
    shape = tuple(section[position + 2 : position + 2 + dimensions])
    position += 2 + dimensions
    size = int(np.prod(shape, dtype=np.int64)) * abs(kind)
    data = section[position : position + size]
    if len(shape) != dimensions or dimensions > 7 or len(data) < size:
        raise ValueError("a parameter that is cut off")
    if kind == -1:
        width = shape[0] if shape else 1
        return [_text(data[i : i + width]) for i in range(0, size, width or 1)]
    return np.frombuffer(data, {1: "i1", 2: f"{order}i2", 4: f"{order}f4"}[kind]).reshape(shape[::-1])


def _text(data: bytes) -> str:
    try:
        return data.decode("utf-8").strip(" \0")
    except UnicodeDecodeError:
        return data.decode("latin-1").strip(" \0")


def write_c3d(pose: Pose3D, path: Path) -> None:
    """Write a C3D file in millimetres, with z up.

    Raises
    ------
    InputError
        If the frame rate is not known, or if C3D cannot hold the names, the number of frames or the gaps.
    """
    fps = writing.required_fps(pose.fps, "C3D")
    writing.require_names(pose.names, r"^\s|\s$|\x00", "C3D", bytes_max=TEXT_MAX)
    with writing.formats_extra("C3D"):
        import ezc3d
    xyz = writing.without_gaps(pose.frames, pose.xyz_m * PER_METRE[UNIT], "C3D")
    ranges = writing.frames_text(pose.frames)
    for quantity, count, limit in (("frames", len(xyz), WORD_MAX), ("gaps", len(ranges) - 1, TEXT_MAX - 1)):
        if count > limit:
            raise InputError(Problem("C3D", quantity, f"{count} {quantity}", f"at most {limit} {quantity}"))
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
    file.write(str(path))
    with suppress(Exception):  # the library does not report a full disk
        if np.array_equal(read_c3d(path).values, xyz[pose.frames - first].astype(np.float32), equal_nan=True):
            return
    raise OSError(errno.ENOSPC, "the file could not be written: is the disk full?", str(path))
