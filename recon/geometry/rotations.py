"""Angles and quaternions of rotation matrices, by scipy's `Rotation`, in the conventions of `recon.geometry.frames`."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array


def euler_angles(rotation: npt.ArrayLike) -> Array:
    """Angles (xi, psi, zeta), shape (..., 3), of rotation matrices (..., 3, 3): the inverse of `euler_rotation`.

    psi lies in [-pi/2, pi/2]. At psi = +-pi/2 only xi + zeta or xi - zeta is determined; zeta is then set to 0.
    Raises ValueError for a matrix that is not a rotation (determinant not positive).
    """
    matrices = np.asarray(rotation, dtype=float)
    if (np.linalg.det(matrices) <= 0).any():  # older scipy takes them for rotations
        raise ValueError("a matrix with a determinant that is not positive is no rotation")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_euler("XYZ")
    return np.asarray(angles).reshape(*matrices.shape[:-2], 3)


def quaternions(rotations: Array) -> Array:
    """Unit quaternions (N, 4), x, y, z, w, of rotation matrices (N, 3, 3)."""
    return Rotation.from_matrix(rotations).as_quat()


def quaternion_rotations(quaternions: Array) -> Array:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4), x, y, z, w: the inverse of `quaternions`."""
    return Rotation.from_quat(quaternions).as_matrix()


def part_of_turn(rotations: Array, share: Array) -> Array:
    """Rotations (N, 3, 3) about the same axes, by a share (N,) of the angle, the shorter way round."""
    return Rotation.from_rotvec(share[:, None] * Rotation.from_matrix(rotations).as_rotvec()).as_matrix()
