"""Convert points and rotations between frames of reference.

The rigid transform `T_a_b` (4, 4) converts points from frame b to frame a, p_a = T_a_b p_b, in metres. The frames are:

- camera: x to the picture's right, y down, z forward, as in OpenCV.
- level: origin at a camera's centre, x to the picture's right, y away from the camera, z up.
- world: the frame in which the motion is solved, right-handed, at rest, with z up. It is the world of the camera files
  if its z axis is known to point up, otherwise the level frame of the first camera.
- reference: the frame of the results. It is the world of the camera files if there is one, otherwise the first camera's
  frame.

Rotations are given by Euler angles, with derivatives, which scipy's `Rotation` does not provide. Every rotation is R =
Rx(xi) Ry(psi) Rz(zeta), a product of right-handed rotations about x, y and z (scipy's intrinsic "XYZ"), in radians.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from recon.base.arrays import Array

_IDENTITY = np.eye(3)
_CROSS = np.cross(_IDENTITY[:, None], _IDENTITY).swapaxes(1, 2)
_CROSS_TWICE = _CROSS @ _CROSS


def level_axes(up: Array) -> tuple[Array, Array]:
    """Return the horizontal unit vectors to the right and away from the camera, shape (3,) in the camera frame.

    If the right of the picture points straight up, the first vector points to the bottom of the picture. `up` (3,) is
    the upward unit vector in the camera frame.
    """
    sideways = np.eye(3)[int(abs(up[0]) > 0.999)]
    right = sideways - up * (sideways @ up)
    right /= float(np.linalg.norm(right))
    return right, np.asarray(np.cross(up, right), dtype=float)


def level_from_camera(up: Array) -> Array:
    """Return the rotation (3, 3) from the camera frame to the level frame.

    `up` (3,) is the upward unit vector in the camera frame.
    """
    right, ahead = level_axes(up)
    return np.stack([right, ahead, up])


def rigid(rotation: Array, translation_m: Array) -> Array:
    """Return the rigid transforms (..., 4, 4) composed of rotations (..., 3, 3) and translations (..., 3), metres."""
    T = np.zeros((*rotation.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = rotation, translation_m, 1.0
    return T


def inverse(T: Array) -> Array:
    """Return the inverses of rigid transforms (..., 4, 4)."""
    rotation = T[..., :3, :3].swapaxes(-1, -2)
    return rigid(rotation, -(rotation @ T[..., :3, 3, None])[..., 0])


def moved(T: Array, points_m: Array) -> Array:
    """Transform points (..., 3), metres, from frame b to frame a by the rigid transform T_a_b (4, 4)."""
    return points_m @ T[:3, :3].T + T[:3, 3]


def euler_rotation(angles_rad: npt.ArrayLike) -> Array:
    """Return the rotation matrices (..., 3, 3) of Euler angles (xi, psi, zeta), shape (..., 3), rad."""
    x, y, z = _turns(angles_rad)
    return x @ y @ z


def euler_rotation_with_jacobian(angles_rad: npt.ArrayLike) -> tuple[Array, Array]:
    """Return the rotation matrices (..., 3, 3) of Euler angles (..., 3) in rad, and their derivatives (..., 3, 3, 3).

    The derivative dR with respect to angle k is dR[..., k, :, :].
    """
    x, y, z = _turns(angles_rad)
    rotation = x @ y @ z
    return rotation, np.stack([_CROSS[0] @ rotation, x @ _CROSS[1] @ y @ z, rotation @ _CROSS[2]], axis=-3)


def quaternions(rotations: Array) -> Array:
    """Return the unit quaternions (N, 4), in the order x, y, z, w, of rotations (N, 3, 3).

    The largest component of each quaternion is positive. scipy's `Rotation` gives the same values, but takes longer to
    import.
    """
    R, trace, i, j, k = rotations, np.trace(rotations, axis1=1, axis2=2), [0, 1, 2], [1, 2, 0], [2, 0, 1]
    products = np.empty((len(R), 4, 4))  # four times the product of each two components
    products[:, :3, :3] = R + R.swapaxes(1, 2)
    products[:, i, i] += 1.0 - trace[:, None]
    products[:, 3, :3] = products[:, :3, 3] = R[:, k, j] - R[:, j, k]
    products[:, 3, 3] = 1.0 + trace
    largest = np.argmax(np.column_stack([R[:, i, i], trace]), axis=1)
    multiples = products[np.arange(len(R)), largest]
    return multiples / np.linalg.norm(multiples, axis=1, keepdims=True)


def _turns(angles_rad: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Return the rotation matrices (..., 3, 3) about the x, the y and the z axis by angles (..., 3), rad.

    The matrices follow from Rodrigues' formula, R = I + sin(angle) G + (1 - cos(angle)) G G, where G is the
    cross-product matrix of the axis. The derivative is dR = G R.
    """
    angles = np.asarray(angles_rad, dtype=float)[..., None, None]
    turns = _IDENTITY + np.sin(angles) * _CROSS + (1.0 - np.cos(angles)) * _CROSS_TWICE
    return turns[..., 0, :, :], turns[..., 1, :, :], turns[..., 2, :, :]
