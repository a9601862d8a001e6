"""Frames of reference. `T_a_b` (4, 4) takes points from frame b to frame a: p_a = T_a_b p_b, metres.

camera: x to the picture's right, y down, z forward (OpenCV's). level: a camera's centre, x to the picture's right, y
away from the camera, z up. world: where motion is solved, right-handed with z up and at rest: the camera files' world
where its z axis is known to point up, otherwise the level frame of the first camera. reference: what results are given
in, the camera files' world where there is one, otherwise the first camera's frame.
"""

from __future__ import annotations

import numpy as np

from recon.base.arrays import Array


def level_axes(up: Array) -> tuple[Array, Array]:
    """Two level unit vectors (3,) in the camera frame: to the picture's right, and away from the camera.

    up (3,): the upward unit vector there.
    """
    right = np.array([1.0, 0.0, 0.0]) - up * up[0]
    right /= float(np.linalg.norm(right))
    return right, np.asarray(np.cross(up, right), dtype=float)


def level_from_camera(up: Array) -> Array:
    """The rotation R_level_camera (3, 3)."""
    right, away = level_axes(up)
    return np.stack([right, away, up])


def rigid(rotation: Array, translation_m: Array) -> Array:
    """T (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3)."""
    T = np.zeros((*rotation.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = rotation, translation_m, 1.0
    return T


def inverse(T: Array) -> Array:
    """Of rigid transforms (..., 4, 4)."""
    rotation = T[..., :3, :3].swapaxes(-1, -2)
    return rigid(rotation, -(rotation @ T[..., :3, 3, None])[..., 0])


def moved(T: Array, points_m: Array) -> Array:
    """Points (..., 3) of frame b in frame a; T (4, 4) is T_a_b, of all points."""
    return points_m @ T[:3, :3].T + T[:3, 3]
