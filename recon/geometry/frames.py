"""Frames of reference. `T_a_b` (4, 4) takes points from frame b to frame a: p_a = T_a_b p_b, metres.

camera: x to the picture's right, y down, z forward (OpenCV's). level: a camera's centre, x to the picture's right, y
away from the camera, z up. world: where motion is solved, right-handed with z up and at rest: the camera files' world
where its z axis is known to point up, otherwise the level frame of the first camera. reference: what results are given
in, the camera files' world where there is one, otherwise the first camera's frame.

Rotations: Euler angles with their derivatives, which scipy's `Rotation` does not give. The way back, and quaternions,
are in `recon.geometry.rotations`.

One convention throughout: R = Rx(xi) Ry(psi) Rz(zeta), elementary right-handed rotations about X, Y and Z multiplied in
that order (scipy's intrinsic "XYZ"), angles in radians in the order (xi, psi, zeta).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

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
    """The inverse of rigid transforms (..., 4, 4)."""
    rotation = T[..., :3, :3].swapaxes(-1, -2)
    return rigid(rotation, -(rotation @ T[..., :3, 3, None])[..., 0])


def moved(T: Array, points_m: Array) -> Array:
    """Points (..., 3) of frame b in frame a; T (4, 4) is T_a_b, of all points."""
    return points_m @ T[:3, :3].T + T[:3, 3]


def euler_rotation(angles_rad: npt.ArrayLike) -> Array:
    """Rotation matrices R = Rx(xi) Ry(psi) Rz(zeta), shape (..., 3, 3), of angles (xi, psi, zeta), shape (..., 3)."""
    angles = np.asarray(angles_rad, dtype=float)
    entries, _ = _matrix_entries(angles)
    return np.array(entries).T.reshape(*angles.shape[:-1], 3, 3)


def euler_rotation_with_jacobian(angles_rad: npt.ArrayLike) -> tuple[Array, Array]:
    """Rotation matrices and their exact derivatives with respect to the angles.

    angles_rad: (..., 3), (xi, psi, zeta). Returns R (..., 3, 3) and dR (..., 3, 3, 3), where dR[..., k, :, :] is the
    derivative of R with respect to angle k.
    """
    angles = np.asarray(angles_rad, dtype=float)
    r, (cx, cy, sx, sy, cz, sz) = _matrix_entries(angles)
    zero = 0.0 * cx
    # Rx is on the left: its derivative mixes rows. Rz is on the right: its derivative mixes columns.
    d_xi = (zero, zero, zero, -r[6], -r[7], -r[8], r[3], r[4], r[5])
    d_psi = (-sy * cz, sy * sz, cy, sx * r[0], sx * r[1], sx * sy, -cx * r[0], -cx * r[1], -cx * sy)
    d_zeta = (r[1], -r[0], zero, r[4], -r[3], zero, r[7], -r[6], zero)
    stack = np.array((*r, *d_xi, *d_psi, *d_zeta)).T.reshape(*angles.shape[:-1], 4, 3, 3)
    return stack[..., 0, :, :], stack[..., 1:, :, :]


def _matrix_entries(angles: Array):
    """The nine entries of R row by row, and cosines and sines. Each is a (N,) array, or a float for one rotation.

    Python floats are several times faster than numpy scalars, and one rotation per call is the solver's inner loop.
    """
    if angles.ndim == 1:
        cx, cy, cz = np.cos(angles).tolist()
        sx, sy, sz = np.sin(angles).tolist()
    else:
        flat = angles.reshape(-1, 3).T
        cx, cy, cz = np.cos(flat)
        sx, sy, sz = np.sin(flat)
    sxsy, cxsy = sx * sy, cx * sy
    entries = (
        *(cy * cz, -cy * sz, sy),
        *(cx * sz + sxsy * cz, cx * cz - sxsy * sz, -sx * cy),
        *(sx * sz - cxsy * cz, sx * cz + cxsy * sz, cx * cy),
    )
    return entries, (cx, cy, sx, sy, cz, sz)
