"""Rigid motions and twists, by scipy: what it lacks are only the names and the plane.

A twist is (v, w): the velocity of the point that lies at the origin, m/s, and the angular velocity, rad/s. Its
exponential over a time is where the motion at this constant twist leads, from the identity.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from recon.base.arrays import Array


def exp_se3(v_m_s: ArrayLike, w_rad_s: ArrayLike, time_s: ArrayLike = 1.0) -> RigidTransform:
    """The motion of twists (..., 3), (..., 3) over times (...)."""
    v, w, t = np.asarray(v_m_s, float), np.asarray(w_rad_s, float), np.asarray(time_s, float)[..., None]
    v, w = np.broadcast_arrays(t * v, t * w)
    # scipy has the angular velocity first.
    return RigidTransform.from_exp_coords(np.concatenate([w, v], axis=-1))


def log_se3(motion: RigidTransform, time_s: ArrayLike = 1.0) -> tuple[Array, Array]:
    """v and w (..., 3) whose exponential over the time is the motion, turning by no more than half a turn."""
    t = np.asarray(time_s, float)[..., None]
    coords = motion.as_exp_coords()
    return coords[..., 3:] / t, coords[..., :3] / t


def exp_se2(v_m_s: ArrayLike, w_rad_s: ArrayLike, time_s: ArrayLike = 1.0) -> Array:
    """Homogeneous matrices (..., 3, 3) of the motion in the plane of v (..., 2) and w (...) over times (...)."""
    w = np.asarray(w_rad_s, float)
    v = np.asarray(v_m_s, float)
    zero = np.zeros(np.broadcast_shapes(v.shape[:-1], w.shape))
    in_space = exp_se3(
        np.stack([v[..., 0] + zero, v[..., 1] + zero, zero], -1), np.stack([zero, zero, w + zero], -1), time_s
    )
    return in_space.as_matrix()[..., _PLANE[:, None], _PLANE]


def log_se2(motion: ArrayLike, time_s: ArrayLike = 1.0) -> tuple[Array, Array]:
    """v (..., 2) and w (...) of motions (..., 3, 3) in the plane."""
    motion = np.asarray(motion, float)
    in_space = np.broadcast_to(np.eye(4), (*motion.shape[:-2], 4, 4)).copy()
    in_space[..., _PLANE[:, None], _PLANE] = motion
    v, w = log_se3(RigidTransform.from_matrix(in_space), time_s)
    return v[..., :2], w[..., 2]


_PLANE = np.array([0, 1, 3])
"""x, y and the homogeneous coordinate."""
