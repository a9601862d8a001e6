"""Which way is up, as said, marked in the pictures, or supposed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.base.documents import require_file
from recon.base.errors import InputError, Problem, refuse
from recon.calibrate.camera_motion.rotation import Orientation, rays_of
from recon.geometry.camera import Camera
from recon.geometry.frames import level_from_camera
from recon.io.common import first_problems, frame_number, number, text_rows

COLUMNS = ("kind", "frame", "x1", "y1", "x2", "y2")
EXPECTED = f"a table (.csv) with the columns {', '.join(COLUMNS)}: horizon or vertical, and two points of it, px"
MARKED_PX = 2.0
"""How exactly a point is marked."""
MAX_SIGMA_RAD = math.radians(3.0)
"""Marks that say less of the upward direction do not say it: a single vertical, or parallel ones."""


LevelMark = tuple[str, int, tuple[tuple[float, float], tuple[float, float]]]
"""horizon or vertical, a frame, and two points (px) of the horizon, or of something upright, in its picture."""


def as_level(orientations: Sequence[Orientation], up: Array | None) -> tuple[Orientation, ...]:
    """The turns from a world with z up, y away from the camera.

    up: (3,) in the first frame's camera. None: the mean frame looks level.
    """
    reference = orientations[0].rotation
    if up is None:
        reference, up = (
            Rotation.from_matrix([one.rotation for one in orientations]).mean().as_matrix(),
            tilted(0.0),
        )
    level = level_from_camera(up) @ reference  # of the old world
    return tuple(replace(orientation, rotation=orientation.rotation @ level.T) for orientation in orientations)


def tilted(tilt_rad: float) -> Array:
    """Up (3,) in a camera that looks down so far, its picture level to the sides."""
    return np.array([0.0, -math.cos(tilt_rad), -math.sin(tilt_rad)])


def up_by_marks(
    source: Path, marks: Sequence[LevelMark], camera: Camera, orientations: Mapping[int, Orientation]
) -> tuple[Array, float]:
    """Up (3,) in the first frame's camera, and its standard deviation in rad. turns: by frame.

    The horizon's rays lie level, and something upright lies in the plane through its ends' rays: up is at right angles
    to all of the first and to the normals of the second. Raises InputError for a frame without a turn, a point
    outside the lens's range, and for marks that do not tell.
    """
    first = orientations[min(orientations)].rotation
    rows, problems = [], []
    for kind, frame, ends_px in marks:
        orientation = orientations.get(frame)
        rays, valid = rays_of(camera, np.array(ends_px), orientation.zoom if orientation else 1.0)
        if orientation is None:
            problems.append(Problem(source, "frame", str(frame), "one of the video in which the turn was found"))
        elif not valid.all():
            problems.append(Problem(source, f"frame {frame}", str(ends_px), "points of the picture"))
        else:
            level = rays if kind == "horizon" else np.cross(*rays)[None]
            rows.append(level @ orientation.rotation @ first.T)
    refuse(dict.fromkeys(problems))
    # A ray is as exact as a mark over the focal length; a plane's normal as two marks over the length between them,
    # which is that of the cross product.
    A = np.concatenate(rows) * camera.matrix[0, 0] / MARKED_PX
    _, size, directions = np.linalg.svd(A, full_matrices=True)
    sigma = math.sqrt(np.sum(size[:2] ** -2.0)) if len(size) > 1 and size[1] > 0 else math.inf
    if sigma > MAX_SIGMA_RAD:
        found = "marks that leave the upward direction open"
        raise InputError(Problem(source, "marks", found, "two points of the horizon, or verticals far from each other"))
    up = directions[2]
    return (up if up[1] < 0 else -up), sigma


def read_marks(path: Path) -> tuple[LevelMark, ...]:
    """From a CSV table of `COLUMNS`. Raises InputError with every problem."""
    require_file(path, EXPECTED)
    (_, header), *rows = [*text_rows(path, ",")] or [(1, [])]
    if tuple(cell.strip() for cell in header) != COLUMNS:
        raise InputError(Problem(path, "header", repr(",".join(header))[:80], EXPECTED))
    marks = [(line, cells, _mark(cells)) for line, cells in rows]
    problems = [
        Problem(path, f"line {line}", repr(",".join(cells))[:80], EXPECTED) for line, cells, mark in marks if not mark
    ]
    refuse(first_problems(problems, path) if marks else [Problem(path, "lines", "none", EXPECTED)])
    return tuple(mark for _, _, mark in marks if mark)


def _mark(cells: Sequence[str]) -> LevelMark | None:
    if len(cells) != len(COLUMNS) or cells[0].strip() not in ("horizon", "vertical"):
        return None
    try:
        frame, (x1, y1, x2, y2) = frame_number(cells[1].strip()), (number(cell.strip()) for cell in cells[2:])
    except ValueError:
        return None
    if frame is None or not np.isfinite([x1, y1, x2, y2]).all() or (x1, y1) == (x2, y2):
        return None
    return cells[0].strip(), frame, ((x1, y1), (x2, y2))
