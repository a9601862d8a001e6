"""Rigid motions: twists and their exponentials, by scipy, and the pose of a body on planted feet.

A twist is (v, w): the velocity of the point that lies at the origin, m/s, and the angular velocity, rad/s. Its
exponential over a time is where the motion at this constant twist leads, from the identity.

World: z up. Body axes: x forwards, y left, z up, the origin in the centre of mass (or wherever the hips are measured
from). Yaw, pitch and roll turn about z, y and x in this order, so that a positive pitch puts the nose down.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

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


def body_pose(position_m: ArrayLike, roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> RigidTransform:
    """T_world_body of positions (..., 3) and angles (...)."""
    angles = np.stack(np.broadcast_arrays(yaw_rad, pitch_rad, roll_rad), axis=-1)
    return RigidTransform.from_components(np.asarray(position_m, float), Rotation.from_euler("ZYX", angles))


def leg_targets(pose: RigidTransform, hips_m: ArrayLike, feet_m: ArrayLike) -> Array:
    """Feet from their hips in body axes (..., L, 3), for T_world_body (...), hips (L, 3) in body axes and feet in the
    world, (L, 3) or (..., L, 3)."""
    hips, feet = np.asarray(hips_m, float), np.asarray(feet_m, float)
    position, R = np.asarray(pose.translation), np.asarray(pose.rotation.as_matrix())
    return np.einsum("...lj,...jk->...lk", feet - position[..., None, :], R) - hips


def feet_in_world(pose: RigidTransform, hips_m: ArrayLike, targets_m: ArrayLike) -> Array:
    """The inverse: feet (..., L, 3) in the world of targets (..., L, 3) from the hips."""
    position, R = np.asarray(pose.translation), np.asarray(pose.rotation.as_matrix())
    return np.einsum("...lk,...jk->...lj", np.asarray(targets_m) + np.asarray(hips_m), R) + position[..., None, :]
