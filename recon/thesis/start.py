"""Estimate the direction of travel and a rough first pose from geometry, without measured angles.

The mean pose is placed on the rays of the detections (`recon.fit.starts`), for many headings and all frames of about
one second. The heading is chosen whose poses fit the detections and their own path best.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from recon.animal.body import MIN_JOINTS
from recon.animal.chain import upright_rotation
from recon.base.arrays import Array
from recon.base.errors import Problem, raise_problems
from recon.fit.starts import constant_velocity, position_on_rays
from recon.geometry.camera import Camera
from recon.geometry.frames import euler_rotation, level_axes
from recon.thesis.chain import UnknownsChain, euler_angles, mean_pose

_HEADINGS = 36
"""Number of headings that are tried, evenly spaced over a full turn."""
_STRETCH_S = 1.0
"""Length in seconds of the parts of a clip in which the path counts as straight."""
_MIN_SPEED_M_S = 1.0
"""Speed in m/s below which a path does not determine the heading."""
_MIN_STRETCH_S = 0.15
"""Duration in seconds below which a path does not determine the heading, about half a stride."""


@dataclass(frozen=True)
class Travel:
    """Direction of travel and speed of every frame."""

    heading: Array
    """Horizontal unit vectors along which the animal faces, in the camera frame, shape (T, 3)."""
    speed_m_s: Array
    """Speed along the path in m/s, shape (T,); 0 if the animal is too slow or too rarely seen."""


def estimate_travel(camera: Camera, chain: UnknownsChain, xy_px: Array, fps: float) -> Travel:
    """Return the heading and the speed in every frame, assuming a straight path within about one second.

    Stretches without five joints in at least five frames get the heading of the nearest stretch that has them.

    Parameters
    ----------
    camera, chain
        Camera of the clip, and the chain whose mean pose is placed on the rays.
    xy_px
        Detections (T, J, 2) in pixels; NaN if missing.
    fps
        Frames per second.
    """
    T = len(xy_px)
    rays, _ = camera.rays(xy_px)
    usable = np.isfinite(rays[..., 0]).sum(axis=1) >= MIN_JOINTS
    right, forward = level_axes(camera.up)
    angle = 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS
    headings = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * forward
    shapes = chain.local_joints(mean_pose(chain)[None])[0] @ upright_rotation(headings, camera.up).transpose(0, 2, 1)

    stretches = np.array_split(np.arange(T), max(1, round(T / fps / _STRETCH_S)))
    runs = np.full((len(stretches), 4), np.nan)
    for s, rows in enumerate(stretches):
        rows = rows[usable[rows]]
        if len(rows) >= MIN_JOINTS:
            runs[s] = _stretch_travel(headings, shapes, camera.up, rays[rows], rows / fps)
    known = np.flatnonzero(np.isfinite(runs[:, 0]))
    if len(known) == 0:
        return Travel(np.tile(right, (T, 1)), np.zeros(T))
    nearest = known[np.argmin(np.abs(np.arange(len(stretches))[:, None] - known), axis=1)]
    speed = np.where(np.isfinite(runs[:, 3]), runs[:, 3], 0.0)
    lengths = [len(rows) for rows in stretches]
    return Travel(np.repeat(runs[nearest, :3], lengths, axis=0), np.repeat(speed, lengths))


def _stretch_travel(headings: Array, shapes: Array, up: Array, rays: Array, time_s: Array) -> Array:
    """Return the heading (3) and the speed (1) in a stretch of a clip; the speed is NaN for a short or slow path.

    For every heading, the mean pose runs straight ahead, with constant acceleration and on sloping ground. The heading
    whose run fits all rays best is chosen, so both the foreshortening of the body and the path count.
    """
    time_s = time_s - time_s.mean()
    misfit, runs = constant_velocity(headings, shapes, up, rays, time_s)
    speeds = np.abs(runs[:, 3])
    best = int(np.argmin(misfit))
    # Refine the minimum between grid points with a parabola through the best heading and its neighbours.
    left, middle, right = misfit[[best - 1, best, (best + 1) % len(headings)]]
    bend = left - 2 * middle + right
    turn = 0.5 * (left - right) / bend * 2 * np.pi / len(headings) if bend > 0 else 0.0
    heading = np.cos(turn) * headings[best] + np.sin(turn) * np.cross(up, headings[best])
    moves = speeds[best] >= _MIN_SPEED_M_S and np.ptp(time_s) >= _MIN_STRETCH_S
    return np.append(heading, speeds[best] if moves else np.nan)


def parse_start_angles(text: str, chain: UnknownsChain) -> dict[int, float]:
    """Return angles in rad, keyed by their index in the state, from a string such as "th6=55,th7=97,xi=-3" in degrees.

    Names are spelled as in `variables.csv` (th6, ph6, xi, psi, zeta) or `angles.csv` (theta_6).

    Raises
    ------
    InputError
        If the chain has no angle of this name, or if a value is not a number.
    """
    angle_columns = [*range(2 * chain.n_angles), *range(chain.n_state)[chain.euler_slice]]
    index = {name: k for names in (chain.unknown_names, chain.state_names) for k, name in enumerate(names)}
    allowed = [chain.unknown_names[k] for k in angle_columns]
    angles, problems = {}, []
    for part in text.split(","):
        name, _, value = (word.strip() for word in part.partition("="))
        try:
            degrees = float(value)
        except ValueError:
            degrees = math.nan
        if index.get(name) not in angle_columns or not math.isfinite(degrees):
            expected = f"name=degrees, such as th6=55, with one of the names {', '.join(allowed)}"
            problems.append(Problem("--start-angles", "angle", repr(part.strip()), expected))
        else:
            angles[index[name]] = math.radians(degrees)
    raise_problems(problems)
    return angles


def geometric_start(
    camera: Camera, chain: UnknownsChain, rays: Array, heading: Array, angles: Mapping[int, float] | None = None
) -> Array:
    """Return the state (D,) of the mean pose facing `heading` (3,), placed on one frame's rays (J, 3).

    `angles` holds angles in rad by their index in the state, which replace angles of the mean pose and of the heading.
    """
    state = mean_pose(chain)
    rotation = upright_rotation(heading, camera.up)
    state[chain.euler_slice] = euler_angles(rotation)
    if angles:
        state[[*angles]] = [*angles.values()]
        rotation = euler_rotation(state[chain.euler_slice])
    position = position_on_rays(chain.local_joints(state[None])[0] @ rotation.T, rays[None])
    # Contradictory rays can meet behind the camera, but the solver needs a start in view.
    in_front = position[0] if position[0, 2] > 0 else -position[0]
    state[chain.position_slice] = rotation.T @ in_front
    return state
