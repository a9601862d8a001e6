"""Where to start: direction of travel, side, and a rough placement of the skeleton, from geometry alone.

A mean pose is put at the detections' bearings: for a given heading, the place that brings the joints nearest to their
viewing rays is a small linear problem, and its distance follows from the skeleton's size. Over many headings and all
frames of a stretch, the heading is chosen whose skeleton fits and which agrees with the path that it implies. The path
decides what a single frame cannot: whether the animal comes nearer or goes away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.camera import Camera
from recon.frames import level_axes
from recon.rotations import euler_angles
from recon.skeleton import MIN_JOINTS, Side, Skeleton

Array = NDArray[np.float64]

_HEADINGS = 36
_STRETCH_S = 1.0
_MISFIT_M = 0.15
"""Distance from a ray at which a joint of the mean pose counts half: a leg's swing."""
_MIN_SPEED_M_S = 1.0
_MIN_STRETCH_S = 0.15
"""Slower, or over a shorter time (half a stride), the path says nothing about the heading."""


@dataclass(frozen=True)
class Travel:
    """heading (T, 3): level unit vector in the camera frame, the way the animal faces; speed_m_s (T,): along its path,
    0 where it is too slow or too rarely seen to have one."""

    heading: Array
    speed_m_s: Array


def facing_side(skeleton: Skeleton, positions_px: dict[str, Array]) -> tuple[Side, str]:
    """The side of the animal that faces an upright camera, and why.

    positions_px: for each joint of `skeleton.forward` (T, 2), NaN where missing. An animal that faces the right of the
    picture shows its right side.
    """
    rear, front = (positions_px[joint] for joint in skeleton.forward)
    ahead = (front - rear)[:, 0]
    ahead = ahead[np.isfinite(ahead)]
    if len(ahead) == 0:
        return "right", "no frame shows both ends of the trunk: right by default"
    side: Side = "right" if np.median(ahead) > 0 else "left"
    agree = np.mean((ahead > 0) == (side == "right"))
    return side, f"the animal faces the {side} of the picture in {agree:.0%} of {len(ahead)} frames"


def upright_rotation(heading: Array, up: Array) -> Array:
    """R_camera_local (..., 3, 3) of a level animal: U along heading (..., 3), V down, W to the side."""
    down = np.broadcast_to(-up, heading.shape)
    return np.stack([heading, down, np.cross(heading, down)], axis=-1)


def mean_pose(skeleton: Skeleton) -> Array:
    """State (D,) with expected angles and nominal size, at the origin."""
    state = np.zeros(skeleton.n_state)
    state[skeleton.theta_slice] = skeleton.theta.mean_rad
    state[skeleton.phi_slice] = skeleton.phi.mean_rad
    state[skeleton.base_index] = skeleton.nominal_base_length_m
    return state


def place_on_rays(joints_m: Array, rays: Array) -> tuple[Array, Array]:
    """Translations (N, 3) that bring a rigid shape nearest to viewing rays, and the joints' distances (N, J) from them.

    joints_m (J, 3) or (N, J, 3): the shape, turned into the camera frame; rays (N, J, 3): unit vectors, NaN where
    missing, at least two a row. The first guess is the median over joints, at the median distance over pairs of joints;
    Gauss-Newton steps on the angles, with Geman-McClure weights, follow (distances from the rays themselves would draw
    the shape towards the camera, where they vanish).
    """
    seen = np.isfinite(rays[..., 0])
    middle = np.nanmedian(rays, axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    i, j = np.triu_indices(rays.shape[1], 1)
    between = joints_m[..., i, :] - joints_m[..., j, :]
    along = (between @ middle[..., None])[..., 0]
    apart_m = np.sqrt(np.maximum(np.sum(between**2, axis=-1) - along**2, 0.0))
    apart_rad = np.linalg.norm(rays[:, i] - rays[:, j], axis=2)
    depth = np.nanmedian(apart_m / np.maximum(apart_rad, 1e-6), axis=1)
    t = np.nanmedian(rays * depth[:, None, None] - joints_m, axis=1)

    across = _across(rays)
    for _ in range(6):
        off, slope, _ = _off_rays(joints_m + t[:, None], across)
        miss = np.linalg.norm(off, axis=2) * depth[:, None]
        weight = seen / (1.0 + (miss / _MISFIT_M) ** 2) ** 2
        normal, pull = _normal(off, slope, weight)
        step = -_solved(normal + 1e-9 * np.eye(3), pull)[..., 0]
        length = np.linalg.norm(step, axis=1)
        t = t + step * np.minimum(1.0, 0.3 * depth / np.maximum(length, 1e-9))[:, None]
    q = joints_m + t[:, None]
    miss = np.linalg.norm((across @ q[..., None])[..., 0], axis=2)
    return t, np.where(seen, miss, np.nan)


def _across(rays: Array) -> Array:
    """(N, J, 3, 3): what of a vector lies across each ray (N, J, 3); all of it where the ray is missing (NaN)."""
    d = np.nan_to_num(rays)
    return np.eye(3) - d[..., :, None] * d[..., None, :]


def _off_rays(points_m: Array, across: Array) -> tuple[Array, Array, Array]:
    """How far points (N, J, 3) lie off their rays as seen from the camera, (N, J, 3) without unit, the derivative
    (N, J, 3, 3) by the points, and the directions (N, J, 3) of the points;
    leading axes broadcast."""
    distance = np.linalg.norm(points_m, axis=-1, keepdims=True)
    q = points_m / distance
    slope = across @ (np.eye(3) - q[..., :, None] * q[..., None, :]) / distance[..., None]
    return (across @ q[..., None])[..., 0], slope, q


def _normal(off: Array, slope: Array, weight: Array) -> tuple[Array, Array]:
    """Normal equations (..., 3, 3) and (..., 3, 1) of a translation, summed over the J joints of off (..., J, 3)."""
    rows = slope.reshape(*slope.shape[:-3], -1, 3)
    weighted = (slope * weight[..., None, None]).reshape(rows.shape).swapaxes(-1, -2)
    return weighted @ rows, weighted @ off.reshape(*rows.shape[:-1], 1)


def estimate_travel(camera: Camera, skeleton: Skeleton, xy_px: Array, fps: float) -> Travel:
    """Heading and speed over the clip from detections (T, J, 2), about one second of straight path at a time.

    Stretches without five joints in at least five frames take the heading of the nearest stretch that has them.
    """
    T = len(xy_px)
    rays, _ = camera.rays(xy_px)
    usable = np.isfinite(rays[..., 0]).sum(axis=1) >= MIN_JOINTS
    right, away = level_axes(camera.up)
    angle = 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    headings = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * away
    shapes = skeleton.local_joints(mean_pose(skeleton)[None])[0] @ upright_rotation(headings, camera.up).transpose(
        0, 2, 1
    )

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
    misfit, runs = straight_runs(headings, shapes, up, rays, time_s)
    speeds = np.abs(runs[:, 3])
    best = int(np.argmin(misfit))
    # The minimum between grid points, from the parabola through the best three.
    left, here, right = misfit[[best - 1, best, (best + 1) % len(headings)]]
    bend = left - 2 * here + right
    turn = 0.5 * (left - right) / bend * 2 * np.pi / len(headings) if bend > 0 else 0.0
    heading = np.cos(turn) * headings[best] + np.sin(turn) * np.cross(up, headings[best])
    told = speeds[best] >= _MIN_SPEED_M_S and np.ptp(time_s) >= _MIN_STRETCH_S
    return np.append(heading, speeds[best] if told else np.nan)


def run_path(heading: Array, up: Array, time_s: Array) -> Array:
    """(F, 3, 6): places at times (F,) by the unknowns of `straight_runs`."""
    motion = np.zeros((len(time_s), 3, 6))
    motion[:, :, :3] = np.eye(3)
    motion[:, :, 3] = heading * time_s[:, None]
    motion[:, :, 4] = heading * (time_s**2)[:, None] / 2
    motion[:, :, 5] = up * time_s[:, None]
    return motion


def straight_runs(
    headings: Array, shapes: Array, up: Array, rays: Array, time_s: Array, centres_m: Array | None = None
) -> tuple[Array, Array]:
    """Shapes (H, J, 3), each running along its heading (H, 3), fitted to rays (F, J, 3) at times (F,) of mean zero.

    centres_m (F, 3): where the rays of each row come from, by default the origin. Returns the runs'
     misfits (H,), 0 to 1 (or up to 2 where one would run backwards), and their unknowns (H, 6): place at
    time zero, m, speed and acceleration along the heading, m/s and m/s^2, and climb, m/s. Gauss-Newton with
    Geman-McClure weights, all headings at once.
    """
    (H, J), F = shapes.shape[:2], len(rays)
    centres = np.zeros((F, 3)) if centres_m is None else centres_m
    each = np.broadcast_to(rays, (H, F, J, 3)).reshape(H * F, J, 3)
    places = place_on_rays(np.repeat(shapes, F, axis=0), each)[0].reshape(H, F, 3)
    depth = np.median(np.linalg.norm(places, axis=2), axis=1)[:, None, None, None]
    seen = np.isfinite(rays[..., 0])
    across = _across(rays)
    motion = np.stack([run_path(heading, up, time_s) for heading in headings])  # (H, F, 3, 6)
    # A wide, soft preference keeps what short clips do not show in bounds: m, m/s, m/s^2, m/s.
    prior = np.diag(1.0 / np.array([1e3, 1e3, 1e3, 15.0, 10.0, 1.0]) ** 2)
    x = np.zeros((H, 6))
    x[:, :3] = np.median(places + centres, axis=1)
    x[:, 3] = np.maximum(np.sum(_robust_slopes(time_s, places + centres) * headings, axis=1), 0.0)
    miss = np.zeros((H, F, J))
    for _ in range(8):
        path = (motion @ x[:, None, :, None])[..., 0] - centres  # (H, F, 3)
        off, slope, direction = _off_rays(shapes[:, None] + path[:, :, None], across)
        off, slope = off * (depth / _MISFIT_M), slope * (depth / _MISFIT_M)[..., None]
        ahead = np.sum(direction * np.nan_to_num(rays), axis=-1) > 0
        miss = np.where(ahead, np.linalg.norm(off, axis=-1), np.inf)
        weight = seen / (1.0 + miss**2) ** 2
        curvature, pull = _normal(off, slope, weight)
        turned = motion.swapaxes(-1, -2)
        normal = np.sum(turned @ curvature @ motion, axis=1) + prior + 1e-9 * np.eye(6)
        gradient = np.sum(turned @ pull, axis=1)[..., 0] + x @ prior
        x = x - _solved(normal, gradient[..., None])[..., 0]
    share = np.where(seen, 1.0 - 1.0 / (1.0 + miss**2), 0.0)
    return share.sum(axis=(1, 2)) / max(int(seen.sum()), 1) + (x[:, 3] < 0), x


def _solved(matrix: Array, right: Array) -> Array:
    """matrix^-1 right (N, n, m) of normal equations (N, n, n). Where rounding leaves one singular, as where all rays
    are one, all are held a little."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        held = 1e-9 * np.trace(matrix, axis1=-2, axis2=-1)[..., None, None] * np.eye(matrix.shape[-1])
        return np.linalg.solve(matrix + held, right)


def _robust_slopes(time_s: Array, places_m: Array) -> Array:
    """Velocities (H, 3) of straight paths through places (H, N, 3), by least absolute distances."""
    design = np.stack([np.ones_like(time_s), time_s - time_s.mean()], axis=1)
    weight, line = np.ones(places_m.shape[:2]), np.zeros((len(places_m), 2, 3))
    for _ in range(10):
        weighted = (design * weight[..., None]).swapaxes(1, 2)  # (H, 2, N)
        line = np.asarray(np.linalg.solve(weighted @ design + 1e-12 * np.eye(2), weighted @ places_m), dtype=float)
        weight = 1.0 / np.maximum(np.linalg.norm(places_m - design @ line, axis=2), 0.05)
    return line[:, 1]


def geometric_start(camera: Camera, skeleton: Skeleton, rays: Array, heading: Array) -> Array:
    """State (D,): the mean pose facing `heading` (3,), placed on one frame's rays (J, 3)."""
    state = mean_pose(skeleton)
    rotation = upright_rotation(heading, camera.up)
    place, _ = place_on_rays(skeleton.local_joints(state[None])[0] @ rotation.T, rays[None])
    # Contradictory rays can meet behind the camera; the solver needs a start that is in view.
    in_front = place[0] if place[0, 2] > 0 else -place[0]
    state[skeleton.place_slice] = rotation.T @ in_front
    state[skeleton.euler_slice] = euler_angles(rotation)
    return state


def state_from_joints(skeleton: Skeleton, joints_m: Array, up: Array) -> Array:
    """State (D,) read off nine 3D joints (J, 3) in the camera frame whose links have about the right proportions.

    U lies along the first link without angles, the roll about it is taken as zero (W level), which 3D joints leave
    open, and of the two pairs of angles of a link's direction, (T, P) and (pi - T, P + pi), the one is taken that is
    nearer to what is expected. Exact up to these choices for joints that the chain can reach.
    """
    state = mean_pose(skeleton)
    position = dict(zip(skeleton.joints, joints_m, strict=True))
    vectors = np.array([position[link.end] - position[link.start] for link in skeleton.links])
    lengths = np.linalg.norm(vectors, axis=1)
    state[skeleton.base_index] = lengths.sum() / skeleton.length_ratios.sum()

    fixed = next(i for i, link in enumerate(skeleton.links) if not link.free)
    U = vectors[fixed] / lengths[fixed]
    W = np.cross(U, -up)
    W /= np.linalg.norm(W)
    rotation = np.stack([U, np.cross(W, U), W], axis=1)
    directions = vectors / lengths[:, None] @ rotation

    T_at, P_at = {skeleton.joints[0]: 0.0}, {skeleton.joints[0]: 0.0}
    theta, phi = [], []
    for link, (du, dv, dw) in zip(skeleton.links, directions, strict=True):
        if not link.free:
            T_at[link.end], P_at[link.end] = T_at[link.start], P_at[link.start]
            continue
        a = len(theta)
        T, P = np.arcsin(np.clip(dv, -1, 1)), np.arctan2(dw, du)
        pairs = [
            (T - T_at[link.start], P - P_at[link.start]),
            (np.pi - T - T_at[link.start], P + np.pi - P_at[link.start]),
        ]
        means = skeleton.theta.mean_rad[a], skeleton.phi.mean_rad[a]
        near = [tuple(m + np.angle(np.exp(1j * (x - m))) for x, m in zip(pair, means, strict=True)) for pair in pairs]
        best = min(near, key=lambda pair: abs(pair[0] - means[0]) + abs(pair[1] - means[1]))
        theta.append(best[0])
        phi.append(best[1])
        T_at[link.end], P_at[link.end] = T_at[link.start] + best[0], P_at[link.start] + best[1]
    state[skeleton.theta_slice], state[skeleton.phi_slice] = theta, phi
    state[skeleton.place_slice] = rotation.T @ joints_m[0]
    state[skeleton.euler_slice] = euler_angles(rotation)
    return state
