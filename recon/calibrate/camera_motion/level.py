"""Find the upward direction for a turning camera from marks on the horizon or on upright objects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.base.documents import require_file
from recon.base.errors import InputError, Problem, raise_problems
from recon.calibrate.camera_motion.rotation import Orientation, rays_of
from recon.geometry.camera import Camera
from recon.geometry.frames import level_from_camera
from recon.io.common import first_problems, frame_number, number, text_rows

COLUMNS = ("kind", "frame", "x1", "y1", "x2", "y2")
EXPECTED = f"a table (.csv) with the columns {', '.join(COLUMNS)}: horizon or vertical, and two of its points, px"
MARKED_PX = 2.0
"""Standard deviation of a marked point along each axis, px."""
MAX_SIGMA_RAD = math.radians(3.0)
"""Largest accepted standard deviation of the upward direction, rad.

A single vertical, or parallel verticals, leave the direction undetermined.
"""


LevelMark = tuple[str, int, tuple[tuple[float, float], tuple[float, float]]]
"""Kind ("horizon" or "vertical"), frame number, and two points (px) on the horizon or an upright object."""


def as_level(orientations: Sequence[Orientation], up: Array | None) -> tuple[Orientation, ...]:
    """Return orientations relative to a world with z up and y away from the camera.

    `up` is the upward direction (3,) in the camera frame of the first picture. If `up` is None, the camera is assumed
    to be level on average.
    """
    reference = orientations[0].rotation
    if up is None:
        reference = Rotation.from_matrix([turn.rotation for turn in orientations]).mean().as_matrix()
        up = up_at_tilt(0.0)
    level = level_from_camera(up) @ reference  # from the previous world to the level world
    return tuple(replace(orientation, rotation=orientation.rotation @ level.T) for orientation in orientations)


def up_at_tilt(tilt_rad: float) -> Array:
    """Return the upward direction (3,) in a camera that is tilted down by an angle and has no roll."""
    return np.array([0.0, -math.cos(tilt_rad), -math.sin(tilt_rad)])


def up_by_marks(
    source: Path, marks: Sequence[LevelMark], camera: Camera, orientations: Mapping[int, Orientation]
) -> tuple[Array, float]:
    """Return the upward direction (3,) in the camera frame of the first picture, and its standard deviation, rad.

    Rays to the horizon are horizontal, and an upright object lies in the plane of the rays to its ends. The upward
    direction is therefore perpendicular to the former rays and to the normals of these planes. `orientations` is keyed
    by frame number.

    Raises
    ------
    InputError
        If a frame has no orientation, if a point is outside the lens's range, or if the marks do not determine the
        upward direction.
    """
    first = orientations[min(orientations)].rotation
    rows, problems = [], []
    for kind, frame, ends_px in marks:
        orientation = orientations.get(frame)
        rays, valid = rays_of(camera, np.array(ends_px), orientation.zoom if orientation else 1.0)
        if orientation is None:
            problems.append(
                Problem(source, "frame", str(frame), "a frame of the video whose camera orientation is known")
            )
        elif not valid.all():
            problems.append(Problem(source, f"frame {frame}", str(ends_px), "points inside the picture"))
        else:
            level = rays if kind == "horizon" else np.cross(*rays)[None]
            rows.append(level @ orientation.rotation @ first.T)
    raise_problems(dict.fromkeys(problems))
    # A ray has the error of a mark, divided by the focal length. The normal of a plane has the error of two marks,
    # divided by the distance between them, which is the length of the cross product.
    A = np.concatenate(rows) * camera.matrix[0, 0] / MARKED_PX
    _, size, directions = np.linalg.svd(A, full_matrices=True)
    sigma = math.sqrt(np.sum(size[:2] ** -2.0)) if len(size) > 1 and size[1] > 0 else math.inf
    if sigma > MAX_SIGMA_RAD:
        found_text = "marks that do not determine the upward direction"
        raise InputError(Problem(source, "marks", found_text, "two points on the horizon, or verticals far apart"))
    up = directions[2]
    return (up if up[1] < 0 else -up), sigma


def read_marks(path: Path) -> tuple[LevelMark, ...]:
    """Read marks on the horizon and on upright objects from a CSV table with the columns `COLUMNS`.

    Raises
    ------
    InputError
        If the table has no lines, other columns, or lines that are not valid. The error lists the lines.
    """
    require_file(path, EXPECTED)
    (_, header), *rows = [*text_rows(path, ",")] or [(1, [])]
    if tuple(cell.strip() for cell in header) != COLUMNS:
        raise InputError(Problem(path, "header", repr(",".join(header))[:80], EXPECTED))
    marks, problems = list[LevelMark](), list[Problem]()
    for line, cells in rows:
        try:
            marks.append(_mark(*(cell.strip() for cell in cells)))
        except (TypeError, ValueError):  # too few cells, or cells that are not numbers
            problems.append(Problem(path, f"line {line}", repr(",".join(cells))[:80], EXPECTED))
    raise_problems(first_problems(problems, path) if rows else [Problem(path, "lines", "none", EXPECTED)])
    return tuple(marks)


def _mark(kind: str, frame: str, *ends: str) -> LevelMark:
    frame_index, (x1, y1, x2, y2) = frame_number(frame), map(number, ends)
    is_valid = kind in ("horizon", "vertical") and np.isfinite([x1, y1, x2, y2]).all()
    if frame_index is None or not is_valid or (x1, y1) == (x2, y2):
        raise ValueError
    return kind, frame_index, ((x1, y1), (x2, y2))
