"""C3D files of marker positions: the unit and the screen's axes in the header; a missing point has residual -1.

C3D counts frames from 1: its frame 1 is frame 0 here. Our own files list their frame numbers.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from recon.errors import InputError, Problem
from recon.io.common import formats_extra, frames_of_text, name_problems, rate
from recon.io.pose import UNIT_NAMES, StoredPose

OWN_GROUP = "RECON"
SIGN_BYTE = {84: 15, 85: 13, 86: 12}
"""By kind of processor (Intel, DEC, MIPS): the byte of the header with the sign of the scale, negative for floats."""


def recognises(path: Path) -> bool:
    """By the key of the header and the kind of processor of the parameters."""
    with path.open("rb") as file:
        head = file.read(2)
        if len(head) < 2 or head[1] != 0x50 or not head[0]:
            return False
        file.seek(512 * (head[0] - 1) + 3)
        return file.read(1) in {bytes([p]) for p in SIGN_BYTE}


def read_pose(path: Path, individual: str | None = None) -> StoredPose:
    """Raises InputError for a damaged file, and for a choice of animals: C3D has one."""
    if individual is not None:
        raise InputError(Problem(path, "individual", "a file without named animals", f"an animal '{individual}'"))
    _require_whole(path)
    with formats_extra(path):
        import ezc3d
    try:
        file = ezc3d.c3d(str(path))
        xyz = np.array(file["data"]["points"][:3], dtype=float).transpose(2, 1, 0)
        residual = np.array(file["data"]["meta_points"]["residuals"][0], dtype=float).T
        parameters = {
            group: {name: entry["value"] for name, entry in entries.items() if "value" in entry}
            for group, entries in file["parameters"].items()
        }
        first = int(file["header"]["points"]["first_frame"])
    except (OSError, ValueError, RuntimeError, IndexError, KeyError, TypeError, MemoryError) as error:
        raise InputError(Problem(path, "content", f"data that cannot be read ({error})", "a whole C3D file")) from None
    point = parameters.get("POINT", {})
    T, J = xyz.shape[:2]
    names = tuple(str(name).strip() for name in _labels(point))[:J]
    problems = name_problems(path, "POINT:LABELS", names)
    fps = rate(str(np.float32(point["RATE"][0]))) if len(point.get("RATE", ())) else None
    unit = UNIT_NAMES.get(str(point["UNITS"][0]).strip()) if len(point.get("UNITS", ())) else None
    if len(names) != J:
        problems.append(Problem(path, "POINT:LABELS", f"{len(names)} names", f"{J}, one for each point"))
    if not T:
        problems.append(Problem(path, "points", "no frames", "at least one"))
    if fps is None:
        problems.append(Problem(path, "POINT:RATE", "nothing", "frames per second"))
    xyz[residual < 0] = np.nan
    if np.isinf(xyz).any():
        problems.append(Problem(path, "points", "infinite coordinates", "numbers"))
    if problems:
        raise InputError(problems)
    frames, listed = _frames(parameters, first, T), frames_of_text(parameters.get(OWN_GROUP, {}).get("FRAMES", ()))
    if listed is not None and len(listed) <= T and listed[-1] - listed[0] == T - 1:
        frames, xyz = listed, xyz[listed - listed[0]]
    return StoredPose(names, xyz, frames, fps=fps, unit=unit, up=_up(point))


def _require_whole(path: Path) -> None:
    """Raises InputError for a file that is shorter than its header says: the library would crash."""
    content = path.read_bytes()
    parameters = 512 * (content[0] - 1)
    processor = content[parameters + 3]
    order = ">" if processor == 86 else "<"
    header = content[:18].ljust(18, b"\0")
    points, analogs, first, last, _, _, _, block = struct.unpack_from(f"{order}8H", header, 2)
    floats = bool(header[SIGN_BYTE[processor]] & 0x80)
    size = 512 * (block - 1) + (last - first + 1) * (4 * points + analogs) * (4 if floats else 2)
    shortest = max(size, parameters + 512 * content[parameters + 2])
    if block < 2 or len(content) < shortest:
        found = f"{len(content)} bytes of {shortest} that the header announces"
        raise InputError(Problem(path, "content", found, "a whole C3D file"))


def _labels(point: dict[str, Any]) -> list[str]:
    """LABELS holds 255 names; more follow in LABELS2, LABELS3, ..."""
    more = sorted((name for name in point if name.startswith("LABELS")), key=lambda n: int(n[6:] or 1))
    return [label for name in more for label in point[name]]


def _frames(parameters: dict[str, Any], first: int, T: int) -> np.ndarray:
    """Frame numbers from 0; the two words of TRIAL:ACTUAL_START_FIELD hold what the header is too small for."""
    words = parameters.get("TRIAL", {}).get("ACTUAL_START_FIELD", ())
    if len(words) == 2:
        first = (int(words[0]) & 0xFFFF) + ((int(words[1]) & 0xFFFF) << 16) - 1
    return np.arange(T) + max(first, 0)


def _up(point: dict[str, Any]) -> str | None:
    """The axis that points up on the screen."""
    screen = [str(text).strip().upper() for text in point.get("Y_SCREEN", ())]
    return {"+Z": "z", "Z": "z", "+Y": "y", "Y": "y"}.get(screen[0]) if screen else None
