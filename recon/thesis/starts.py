"""Where the frame method starts: direction of travel, and a rough placement of the chain, from geometry alone.

The mean pose is put at the detections' bearings (`recon.fit.starts`), over many headings and all frames of a
stretch: the heading is chosen whose chain fits and which agrees with the path that it implies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.animal.body import MIN_JOINTS
from recon.animal.chain import Chain, upright_rotation
from recon.base.arrays import Array
from recon.fit.starts import constant_velocity, position_on_rays
from recon.geometry.camera import Camera
from recon.geometry.frames import euler_angles, level_axes

_HEADINGS = 36
_STRETCH_S = 1.0
_MIN_SPEED_M_S = 1.0
_MIN_STRETCH_S = 0.15
"""Slower, or over a shorter time (half a stride), the path says nothing about the heading."""


@dataclass(frozen=True)
class Travel:
    """heading (T, 3): level unit vector in the camera frame, the way the animal faces; speed_m_s (T,): along its path,
    0 where it is too slow or too rarely seen to have one."""

    heading: Array
    speed_m_s: Array


def mean_pose(chain: Chain) -> Array:
    """State (D,) with expected angles and nominal size, at the origin."""
    state = np.zeros(chain.n_state)
    state[chain.theta_slice] = chain.theta.mean_rad
    state[chain.phi_slice] = chain.phi.mean_rad
    state[chain.base_index] = chain.nominal_base_length_m
    return state


def estimate_travel(camera: Camera, chain: Chain, xy_px: Array, fps: float) -> Travel:
    """Heading and speed over the clip from detections (T, J, 2), about one second of straight path at a time.

    Stretches without five joints in at least five frames take the heading of the nearest stretch that has them.
    """
    T = len(xy_px)
    rays, _ = camera.rays(xy_px)
    usable = np.isfinite(rays[..., 0]).sum(axis=1) >= MIN_JOINTS
    right, away = level_axes(camera.up)
    angle = 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    headings = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * away
    shapes = chain.local_joints(mean_pose(chain)[None])[0] @ upright_rotation(headings, camera.up).transpose(0, 2, 1)

    stretches = np.array_split(np.arange(T), max(1, round(T / fps / _STRETCH_S)))
    found = np.full((len(stretches), 4), np.nan)
    for s, rows in enumerate(stretches):
        rows = rows[usable[rows]]
        if len(rows) >= MIN_JOINTS:
            found[s] = _stretch_travel(headings, shapes, camera.up, rays[rows], rows / fps)
    known = np.flatnonzero(np.isfinite(found[:, 0]))
    if len(known) == 0:
        return Travel(np.tile(right, (T, 1)), np.zeros(T))
    nearest = known[np.argmin(np.abs(np.arange(len(stretches))[:, None] - known), axis=1)]
    speed = np.where(np.isfinite(found[:, 3]), found[:, 3], 0.0)
    lengths = [len(rows) for rows in stretches]
    return Travel(np.repeat(found[nearest, :3], lengths, axis=0), np.repeat(speed, lengths))


def _stretch_travel(headings: Array, shapes: Array, up: Array, rays: Array, time_s: Array) -> Array:
    """(4,): heading and speed of one stretch; the speed is NaN where it says nothing.

    For every heading the mean pose runs straight ahead, with a constant acceleration and a slope of the ground; the
    heading whose run fits all the rays best decides. It is seen in the shape's foreshortening and in the path alike.
    """
    time_s = time_s - time_s.mean()
    misfit, runs = constant_velocity(headings, shapes, up, rays, time_s)
    speeds = np.abs(runs[:, 3])
    best = int(np.argmin(misfit))
    # The minimum between grid points, from the parabola through the best three.
    left, here, right = misfit[[best - 1, best, (best + 1) % len(headings)]]
    bend = left - 2 * here + right
    turn = 0.5 * (left - right) / bend * 2 * np.pi / len(headings) if bend > 0 else 0.0
    heading = np.cos(turn) * headings[best] + np.sin(turn) * np.cross(up, headings[best])
    moves = speeds[best] >= _MIN_SPEED_M_S and np.ptp(time_s) >= _MIN_STRETCH_S
    return np.append(heading, speeds[best] if moves else np.nan)


def geometric_start(camera: Camera, chain: Chain, rays: Array, heading: Array) -> Array:
    """State (D,): the mean pose facing `heading` (3,), placed on one frame's rays (J, 3)."""
    state = mean_pose(chain)
    rotation = upright_rotation(heading, camera.up)
    place, _ = position_on_rays(chain.local_joints(state[None])[0] @ rotation.T, rays[None])
    # Contradictory rays can meet behind the camera; the solver needs a start that is in view.
    in_front = place[0] if place[0, 2] > 0 else -place[0]
    state[chain.place_slice] = rotation.T @ in_front
    state[chain.euler_slice] = euler_angles(rotation)
    return state


def state_from_joints(chain: Chain, joints_m: Array, up: Array) -> Array:
    """State (D,) read off nine 3D joints (J, 3) in the camera frame whose links have about the right proportions.

    U lies along the first link without angles, the roll about it is taken as zero (W level), which 3D joints leave
    open, and of the two pairs of angles of a link's direction, (T, P) and (pi - T, P + pi), the one is taken that is
    nearer to what is expected. Exact up to these choices for joints that the chain can reach.
    """
    state = mean_pose(chain)
    position = dict(zip(chain.joints, joints_m, strict=True))
    vectors = np.array([position[link.end] - position[link.start] for link in chain.links])
    lengths = np.linalg.norm(vectors, axis=1)
    state[chain.base_index] = lengths.sum() / chain.length_ratios.sum()

    fixed = next(i for i, link in enumerate(chain.links) if not link.free)
    U = vectors[fixed] / lengths[fixed]
    W = np.cross(U, -up)
    W /= np.linalg.norm(W)
    rotation = np.stack([U, np.cross(W, U), W], axis=1)
    directions = vectors / lengths[:, None] @ rotation

    T_at, P_at = {chain.joints[0]: 0.0}, {chain.joints[0]: 0.0}
    theta, phi = [], []
    for link, (du, dv, dw) in zip(chain.links, directions, strict=True):
        if not link.free:
            T_at[link.end], P_at[link.end] = T_at[link.start], P_at[link.start]
            continue
        a = len(theta)
        T, P = np.arcsin(np.clip(dv, -1, 1)), np.arctan2(dw, du)
        pairs = [
            (T - T_at[link.start], P - P_at[link.start]),
            (np.pi - T - T_at[link.start], P + np.pi - P_at[link.start]),
        ]
        means = chain.theta.mean_rad[a], chain.phi.mean_rad[a]
        near = [tuple(m + np.angle(np.exp(1j * (x - m))) for x, m in zip(pair, means, strict=True)) for pair in pairs]
        best = min(near, key=lambda pair: abs(pair[0] - means[0]) + abs(pair[1] - means[1]))
        theta.append(best[0])
        phi.append(best[1])
        T_at[link.end], P_at[link.end] = T_at[link.start] + best[0], P_at[link.start] + best[1]
    state[chain.theta_slice], state[chain.phi_slice] = theta, phi
    state[chain.place_slice] = rotation.T @ joints_m[0]
    state[chain.euler_slice] = euler_angles(rotation)
    return state
