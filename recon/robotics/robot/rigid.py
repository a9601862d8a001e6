"""Rigid motions and twists, by scipy: what it lacks are only the names.

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
