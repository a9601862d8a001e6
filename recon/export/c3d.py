"""C3D file of joint positions: millimetres, z up, a missing point has residual -1.

C3D counts frames from 1: frame 0 is its frame 1. RECON:FRAMES lists the frame numbers, which may have gaps; frames in
a gap are there, with all points missing.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from recon.errors import InputError, Problem
from recon.export.checks import require_names, required_fps, without_gaps
from recon.files import write_bytes
from recon.io.c3d import OWN_GROUP
from recon.io.common import formats_extra, frames_text
from recon.io.pose import PER_METRE, Pose3D

TITLE = "C3D"
UNIT = "mm"
WORD_MAX = 65_535
TEXT_MAX = 255


def write(pose: Pose3D, path: Path) -> None:
    """Raises InputError without a frame rate, and for names, numbers of frames or gaps that C3D cannot hold."""
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
    file["header"]["points"]["first_frame"] = min(first, WORD_MAX - len(xyz))
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
