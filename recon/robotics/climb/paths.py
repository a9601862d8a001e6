"""The ways of the feet: up at one angle, across, down at another, like a trapezoid; and the step they climb."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from recon.base.arrays import Array
from recon.robotics.climb.numbers import FORBID, Number

PHASES = ("rise", "traverse", "lower")


@dataclass(frozen=True)
class Step:
    """A step up across the way: the ground is level at 0 as far as edge_m forward (y), and at height_m beyond."""

    __pydantic_config__ = FORBID
    edge_m: Number
    height_m: Number

    def distance_m(self, points_m: Array) -> Array:
        """(...): from points (..., 3) to the ground or the step, whichever is nearer, negative inside."""
        y, z = points_m[..., 1] - self.edge_m, points_m[..., 2]
        return np.minimum(z, _outside(y, z - self.height_m))

    def corner_m(self, points_m: Array) -> Array:
        """(...): from points (..., 3) to the step's edge, negative inside the step."""
        y, z = points_m[..., 1] - self.edge_m, points_m[..., 2] - self.height_m
        return np.where((y > 0) & (z < 0), -1.0, 1.0) * np.hypot(y, z)


def _outside(y: Array, z: Array) -> Array:
    """Signed distance from (y, z) to the quadrant y > 0, z < 0."""
    away = np.hypot(np.maximum(-y, 0), np.maximum(z, 0))
    return np.where((y > 0) & (z < 0), -np.minimum(y, -z), away)


def corners(start_m: Array, end_m: Array, clearance_m: ArrayLike, rise_rad: ArrayLike, lower_rad: ArrayLike) -> Array:
    """(..., 4, 3): the corners of the path of a foot from start_m (..., 3) to end_m (..., 3).

    The foot rises at rise_rad above the forward direction (more than a right angle: leaning back) and sinks at
    lower_rad above the backward direction, in the plane of forward (y) and up; between them it crosses, sideways too,
    clearance_m above the higher end. Where both slopes take up more than the way there is, they are steeper, and meet.
    """
    start, end = np.broadcast_arrays(np.asarray(start_m, float), np.asarray(end_m, float))
    top = np.maximum(start[..., 2], end[..., 2]) + clearance_m
    ahead, back = (top - start[..., 2]) / np.tan(rise_rad), (top - end[..., 2]) / np.tan(lower_rad)
    way = end[..., 1] - start[..., 1]
    over = np.where(ahead + back > np.maximum(way, 0.0), np.maximum(way, 0.0) / np.maximum(ahead + back, 1e-12), 1.0)
    first, second = start.copy(), end.copy()
    first[..., 1] += over * ahead
    second[..., 1] -= over * back
    first[..., 2] = second[..., 2] = top
    return np.stack([start, first, second, end], axis=-2)


def along(corners_m: Array, phase: int, share: Array) -> Array:
    """(..., n, 3): the points at the shares (n,), 0 to 1, of one leg of the paths (..., 4, 3)."""
    a, b = corners_m[..., phase, :], corners_m[..., phase + 1, :]
    return a[..., None, :] + np.asarray(share)[:, None] * (b - a)[..., None, :]
