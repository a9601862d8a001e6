"""Simulate a cheetah that accelerates in a gallop, and exact detections of it by one camera.

Formulas define the motion. Speed and stride frequency rise towards a limit. The links' inclinations to the ground are
short Fourier series in the stride's phase, whose amplitudes grow slowly with speed. The coefficients were optimised so
that the feet are nearly still and on the ground in stance, and clear of the ground in swing; that angles and rates are
within the ranges of the skeleton `cheetah-8u`; and that means and spreads of the angles are close to those of galloping
cheetahs in AcinoSet (Joska et al. 2021). The transverse angles, the trunk's yaw and roll and its sideways sway are slow
waves drawn from a seed.

The world frame is right-handed, with z up, in metres. The origin is on the ground, in the middle of the first second's
path. The camera is on the side of negative y. "Near" means the side of the animal that faces the camera.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from recon.animal.body import Side
from recon.animal.skeleton_file import load_skeleton, with_detector_offsets
from recon.base.arrays import Array, Bools
from recon.clip import Keypoints
from recon.fit.points import solve_points
from recon.geometry.camera import Camera
from recon.geometry.frames import euler_rotation
from recon.thesis.chain import UnknownsChain, euler_angles, load_chain

Direction = Literal["right", "left"]
CameraModel = Literal["pinhole", "fisheye"]

KEYPOINT_NAMES = (
    *("neck_base", "spine", "tail_base"),
    *(f"{side}_{leg}_{part}" for side in "rl" for leg in ("front", "back") for part in ("knee", "ankle", "paw")),
)
IMAGE_SIZE_PX = (1920, 1080)
MARGIN_PX = 20.0
"""Smallest distance in pixels of the joints from the picture's edges in the first second."""

START_SPEED_M_S = 9.5
"""Speed of the animal in the first frame."""
TOP_SPEED_M_S = 20.0
"""Speed that the animal approaches in time."""
START_STRIDES_HZ = 3.2
"""Strides per second in the first frame."""
TOP_STRIDES_HZ = 3.5
"""Strides per second at the top speed."""
RISE_S = 0.85
"""Time constant in seconds with which speed and stride frequency approach their limits."""
START_PHASE = 0.40
"""Phase of the stride in the first frame, shortly before the stance of the near fore foot.

The stance of the near hind foot begins at 0, the stance of the near fore foot at 0.42.
"""
SLOPE = 0.03
"""Slope of the ground, which rises in the direction of travel."""
WIDTH_M = 0.18
"""Lateral distance between the near and the far legs."""

_HIND_LAG = 0.08
"""Delay of the far hind leg behind the near one, as a fraction of the stride."""
_FORE_LAG = 0.11
"""Delay of the far fore leg behind the near one, as a fraction of the stride."""
_SWING_SPEED_M_S = 14.0
"""Speed for which the amplitudes of `_SERIES` hold."""
_SWING_POWER = 0.26
"""Exponent with which the amplitude of `_SERIES` grows with speed."""
# Fourier series over the stride's phase of each link's inclination to the ground (rad, 0 forwards, pi/2 down) and of
# the root's height (m). A series has the mean, then cosine and sine of each harmonic. T5 is the link from tail_base to
# spine, and T1 the link from spine to neck_base.
_SERIES: dict[str, tuple[float, ...]] = {
    "height": (0.664, -0.025, -0.026, 0.001, 0.012),
    "T5": (-0.026, -0.143, 0.022),
    "T1": (0.014, 0.007, -0.199),
    "T6": (0.977, -0.508, 0.556, -0.008, 0.017, -0.005, -0.233),
    "T7": (2.579, -0.961, 0.281, 0.092, 0.278, -0.061, -0.016),
    "T8": (1.202, -0.412, 0.721, 0.126, 0.529, 0.022, -0.133),
    "T2": (1.927, 0.178, -0.754, 0.252, 0.026, -0.101, -0.103),
    "T3": (1.063, -0.425, -1.044, -0.012, -0.069, 0.056, -0.045),
    "T4": (1.645, 0.586, -1.012, -0.079, -0.165, 0.164, 0.000),
}


@dataclass(frozen=True, eq=False)
class SyntheticClip:
    """Simulated clip of T frames and K keypoints (15 for `cheetah-8u`, 24 for `cheetah-24`), with its truth."""

    keypoints: Keypoints
    """Exact detections; points outside the picture are missing."""
    camera: Camera
    truth_m: Array
    """True positions of the keypoints in world coordinates, shape (T, K, 3), m."""
    names: tuple[str, ...]
    """Names of the keypoints, shape (K,)."""
    state: Array
    """States of `cheetah-8u` for the near side's legs, in the camera frame, shape (T, D)."""
    side: Side
    """Side of the animal that faces the camera."""


def gallop(
    fps: float = 30.0,
    n_frames: int = 30,
    heading_rad: float = 0.0,
    direction: Direction = "right",
    camera_model: CameraModel = "pinhole",
    seed: int = 0,
) -> SyntheticClip:
    """Simulate a cheetah that covers about 13 m and three strides in the first second, and then reaches 20 m/s.

    The camera is static, and the animal is in the picture for the first second. Points that leave the picture later are
    missing.

    Parameters
    ----------
    fps
        Frame rate in Hz.
    n_frames
        Number of frames T.
    heading_rad
        Angle between the direction of travel and the image plane, positive away from the camera.
    direction
        Direction of travel in the picture.
    camera_model
        Lens of the camera.
    seed
        Seed of the slow waves of the transverse angles.

    Returns
    -------
    SyntheticClip
        Exact detections, camera and truth.

    Raises
    ------
    ValueError
        If the heading is more than 1.2 rad from the image plane.
    """
    if abs(heading_rad) > 1.2:
        raise ValueError(f"the heading must be within 1.2 rad of the picture's plane, got {heading_rad}")
    chain = load_chain("cheetah-8u")
    side: Side = "right" if direction == "right" else "left"
    rng = np.random.default_rng(seed)
    waves = [_Waves.draw(rng, 2 * chain.n_angles + 3) for _ in range(2)]

    def run_at(t: Array) -> _Run:
        return _run(chain, t, heading_rad, direction, waves)

    shown = run_at(np.arange(0.0, 1.0, 1 / 60))
    camera = _place_camera(camera_model, np.concatenate([shown.near_m, shown.far_m], axis=1).reshape(-1, 3))
    assert camera.rotation is not None
    assert camera.translation_m is not None

    state, rotation, near_side_m, far_side_m = run_at(np.arange(n_frames) / fps)
    r, t = camera.rotation, camera.translation_m
    in_camera = r @ rotation
    root = near_side_m[:, 0] @ r.T + t
    state[:, chain.position_slice] = np.einsum("tji,tj->ti", in_camera, root)
    state[:, chain.euler_slice] = np.unwrap(euler_angles(in_camera), axis=0)

    far_side: Side = "left" if side == "right" else "right"
    by_name = dict(zip(chain.body.keypoint_names(far_side), np.moveaxis(far_side_m, 1, 0), strict=True))
    by_name |= dict(zip(chain.body.keypoint_names(side), np.moveaxis(near_side_m, 1, 0), strict=True))
    truth_m = np.stack([by_name[name] for name in KEYPOINT_NAMES], axis=1)
    xy_px, valid = camera.project(truth_m @ r.T + t)
    visible = valid & camera.in_image(xy_px)
    keypoints = Keypoints(
        names=KEYPOINT_NAMES,
        xy_px=np.where(visible[..., None], xy_px, np.nan),
        confidence=visible.astype(float),
        frames=np.arange(n_frames),
        fps=float(fps),
        image_size_px=camera.image_size_px,
    )
    return SyntheticClip(keypoints, camera, truth_m, KEYPOINT_NAMES, state, side)


@dataclass(frozen=True, eq=False)
class _Waves:
    """W slow sine waves about small means; each field has the shape (W,)."""

    mean: Array
    amplitude: Array
    frequency_hz: Array
    phase_rad: Array

    @classmethod
    def draw(cls, rng: np.random.Generator, count: int) -> _Waves:
        """Draw random waves with standard deviations from 0.05 to 0.13 and means of at most ±0.04."""
        return cls(
            mean=rng.uniform(-0.04, 0.04, count),
            amplitude=math.sqrt(2) * rng.uniform(0.05, 0.13, count),
            frequency_hz=rng.uniform(0.8, 1.6, count),
            phase_rad=rng.uniform(0, 2 * np.pi, count),
        )

    def __call__(self, t: Array) -> Array:
        """Return the waves (T, W) at times (T,) in seconds."""
        return self.mean + self.amplitude * np.sin(2 * np.pi * t[:, None] * self.frequency_hz + self.phase_rad)


def _rising(t: Array, start: float, top: float) -> tuple[Array, Array]:
    """Return a quantity (T,) that rises from `start` towards `top`, and its integral (T,) over time."""
    gap = (top - start) * np.exp(-t / RISE_S)
    return top - gap, top * t - RISE_S * (top - start - gap)


def _series(name: str, phase: Array, swing: Array) -> Array:
    """Return the values of one of `_SERIES` at phases (T,), with deviations from the mean scaled by `swing` (T,)."""
    mean, *terms = _SERIES[name]
    angle = 2 * np.pi * phase
    return mean + swing * sum(
        a * np.cos(k * angle) + b * np.sin(k * angle)
        for k, (a, b) in enumerate(zip(terms[::2], terms[1::2], strict=True), start=1)
    )


def _thetas(chain: UnknownsChain, phase: Array, swing: Array, hind_lag: float, fore_lag: float) -> Array:
    """Return the sagittal angles (T, A) of the links relative to their parents, in rad."""
    trunk = {name: _series(name, phase, swing) for name in ("T5", "T1")}
    hind = {name: _series(name, phase - hind_lag, swing) for name in ("T6", "T7", "T8")}
    fore = {name: _series(name, phase - fore_lag, swing) for name in ("T2", "T3", "T4")}
    inclination = trunk | hind | fore
    parent = {"J6": "T5", "J7": "T6", "J8": "T7", "J1": "T5", "J2": "T1", "J3": "T2", "J4": "T3"}
    ends = [link.end for link in chain.links if link.free]
    return np.stack([inclination[end.replace("J", "T")] - inclination[parent[end]] for end in ends], axis=1)


class _Run(NamedTuple):
    """States and joints of a galloping animal at T times."""

    state: Array
    """States without position and orientation, shape (T, D)."""
    R_world_local: Array
    """Orientation of the root, shape (T, 3, 3)."""
    near_m: Array
    """Joints in the world, with the near legs, shape (T, J, 3)."""
    far_m: Array
    """Joints in the world, with the far legs, shape (T, J, 3)."""


def _run(chain: UnknownsChain, t: Array, heading_rad: float, direction: Direction, waves: list[_Waves]) -> _Run:
    """Return the states and joints of the animal at times t (T,) in seconds."""
    speed, distance = _rising(t, START_SPEED_M_S, TOP_SPEED_M_S)
    _, strides = _rising(t, START_STRIDES_HZ, TOP_STRIDES_HZ)
    phase, swing = START_PHASE + strides, (speed / _SWING_SPEED_M_S) ** _SWING_POWER
    middle = 0.5 * _rising(np.array([1.0]), START_SPEED_M_S, TOP_SPEED_M_S)[1]

    sign = 1.0 if direction == "right" else -1.0
    level = np.array([sign * math.cos(heading_rad), math.sin(heading_rad), 0.0])
    tilt = math.atan(SLOPE)
    ahead = math.cos(tilt) * level + [0, 0, math.sin(tilt)]
    up = -math.sin(tilt) * level + [0, 0, math.cos(tilt)]
    left = np.cross(ahead, -up)
    ground = np.stack([ahead, -up, left], axis=1)

    n = chain.n_angles
    near_waves, far_waves = (w(t) for w in waves)
    roll, yaw, sway_m = 0.25 * near_waves[:, 2 * n :].T
    rotation = ground @ euler_rotation(np.stack([roll, yaw, _series("T5", phase, swing)], axis=1))
    height_m = _series("height", phase, swing)
    root = (distance - middle)[:, None] * ahead + height_m[:, None] * up + sway_m[:, None] * left

    def state(hind_lag: float, fore_lag: float, phi: Array) -> Array:
        out = np.zeros((len(t), chain.n_state))
        out[:, chain.theta_slice] = _thetas(chain, phase, swing, hind_lag, fore_lag)
        out[:, chain.phi_slice] = phi
        out[:, chain.base_index] = chain.nominal_base_length_m
        return out

    phi, far_phi = near_waves[:, :n], far_waves[:, :n].copy()
    spine = [i for i, link in enumerate(link for link in chain.links if link.free) if link.limb == "spine"]
    far_phi[:, spine] = phi[:, spine]
    near_state = state(0.0, 0.0, phi)
    local_near = chain.local_joints(near_state)
    local_far = chain.local_joints(state(_HIND_LAG, _FORE_LAG, far_phi)) + np.array([0.0, 0.0, sign * WIDTH_M])
    near_m, far_m = (root[:, None] + local @ rotation.transpose(0, 2, 1) for local in (local_near, local_far))
    return _Run(near_state, rotation, near_m, far_m)


def _place_camera(model: CameraModel, points_m: Array) -> Camera:
    """Place a camera as near as possible with all world points (N, 3) at least `MARGIN_PX` inside its picture."""
    width, height = IMAGE_SIZE_PX
    if model == "pinhole":
        bare, distance_m = Camera.from_hfov(60.0, IMAGE_SIZE_PX, name="synthetic pinhole"), 14.0
    else:
        matrix = np.array([[860.0, 0, 953.0], [0, 862.0, 546.0], [0, 0, 1]])
        coefficients = np.array([0.12, -0.05, 0.015, -0.001])
        bare, distance_m = Camera("synthetic fisheye", matrix, coefficients, "fisheye", IMAGE_SIZE_PX), 8.0
    for _ in range(200):
        camera = _look(bare, np.array([0.3, -distance_m, 1.5]), target_m=np.array([0.0, 0.0, 0.7]), roll_rad=0.01)
        assert camera.rotation is not None
        assert camera.translation_m is not None
        xy_px, valid = camera.project(points_m @ camera.rotation.T + camera.translation_m)
        inside = (xy_px >= MARGIN_PX) & (xy_px <= np.array([width, height]) - 1 - MARGIN_PX)
        if valid.all() and inside.all():
            return camera
        distance_m += 0.25
    raise ValueError("no camera position has the whole animal in the picture")


def _look(camera: Camera, centre_m: Array, target_m: Array, roll_rad: float) -> Camera:
    """Return the camera at a point (3,) in the world, looking at a target (3,), with a roll about its axis."""
    forward = (target_m - centre_m) / np.linalg.norm(target_m - centre_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    upright = np.stack([right, np.cross(forward, right), forward])
    rotation = euler_rotation(np.array([0.0, 0.0, roll_rad])) @ upright
    return dataclasses.replace(camera, rotation=rotation, translation_m=-rotation @ centre_m)


def add_noise(
    keypoints: Keypoints, sigma_px: float = 2.0, dropout: float = 0.05, outlier: float = 0.02, seed: int = 0
) -> tuple[Keypoints, Bools]:
    """Add the noise, gaps and gross outliers of a keypoint network to detections.

    Parameters
    ----------
    keypoints
        Exact detections.
    sigma_px
        Standard deviation of the Gaussian noise of each coordinate in pixels.
    dropout
        Fraction of points that become missing, rounded to a whole number of points.
    outlier
        Fraction of points that are moved by 40 to 300 px in a random direction, rounded in the same way. They stay
        within the picture if its size is known.
    seed
        Random seed.

    Returns
    -------
    tuple
        The detections, and a mask (T, K) of the gross outliers. Likelihoods are 0.9 to 1 for good points, 0.6 to 0.98
        for outliers, and 0 for missing points.
    """
    rng = np.random.default_rng(seed)
    shape = keypoints.confidence.shape
    noise = rng.normal(size=(*shape, 2)) * sigma_px
    order = rng.permutation(shape[0] * shape[1]).reshape(shape)
    length, angle = rng.uniform(40, 300, shape), rng.uniform(0, 2 * np.pi, shape)
    good, poor = 1 - 0.1 * rng.uniform(size=shape) ** 3, rng.uniform(0.6, 0.98, shape)

    n_lost, n_outliers = round(dropout * order.size), round(outlier * order.size)
    lost = ~keypoints.present | (order < n_lost)
    outliers = ~lost & (order >= n_lost) & (order < n_lost + n_outliers)
    xy_px = keypoints.xy_px + noise
    jump = length[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    if keypoints.image_size_px is not None:
        beyond = (xy_px + jump < 0) | (xy_px + jump > np.array(keypoints.image_size_px) - 1)
        jump = np.where(beyond, -jump, jump)
    xy_px = np.where(outliers[..., None], xy_px + jump, xy_px)
    noisy = dataclasses.replace(
        keypoints,
        xy_px=np.where(lost[..., None], np.nan, xy_px),
        confidence=np.where(lost, 0.0, np.where(outliers, poor, good)),
    )
    return noisy, outliers


def project_clip(camera: Camera, clip: SyntheticClip) -> Keypoints:
    """Project the true positions of a clip into a camera; points outside the picture are missing."""
    xy_px, valid = camera.project(camera.world_to_camera(clip.truth_m))
    visible = valid & camera.in_image(xy_px)
    return Keypoints(
        names=clip.names,
        xy_px=np.where(visible[..., None], xy_px, np.nan),
        confidence=visible.astype(float),
        frames=clip.keypoints.frames,
        fps=clip.keypoints.fps,
        image_size_px=camera.image_size_px,
    )


def whole_gallop(
    fps: float = 60, n_frames: int = 60, detector: Path | None = None
) -> tuple[SyntheticClip, SyntheticClip]:
    """Simulate a whole cheetah (skeleton `cheetah-24`) in the gallop that the function `gallop` simulates.

    The poses match the gallop's trunk and legs as closely as possible, the head stays level, and the tail swings.

    Parameters
    ----------
    fps, n_frames
        Frame rate in Hz, and number of frames T.
    detector
        TOML file of a detector's keypoint offsets. If it is None, keypoints are the markers.

    Returns
    -------
    tuple
        The clip with the markers as its truth, and the same clip with the points that the detector detects as its
        truth.
    """
    clip = gallop(fps=fps, n_frames=n_frames)
    body = load_skeleton("cheetah-24")
    points_m = np.full((len(clip.truth_m), len(body.markers), 3), np.nan)
    points_m[:, [body.markers.index(name) for name in clip.names]] = clip.truth_m
    states, *_ = solve_points(body, points_m)
    column = {name: states[:, i] for i, name in enumerate(body.state_names)}
    t = np.arange(len(states)) / fps
    column["head_pitch"][:] = -0.7 * (column["rear_trunk_pitch"] + column["front_trunk_pitch"])
    column["tail_1_yaw"][:] = 0.3 * np.sin(2 * np.pi * 1.3 * t)
    column["tail_2_yaw"][:] = 0.3 * np.sin(2 * np.pi * 1.3 * t - 0.8)
    column["tail_1_pitch"][:] = -0.45 + 0.2 * np.cos(2 * np.pi * 3.3 * t)
    clip = dataclasses.replace(clip, truth_m=body.tree.pose(states).points_m, names=body.markers)
    if detector is None:
        return clip, clip
    detected = with_detector_offsets(body, detector).detected
    return clip, dataclasses.replace(clip, truth_m=detected.pose(states).points_m)
