"""Find camera positions from which the pixels determine an angle or a joint well.

The motion is a mean stride through the middle of the picture, which is the prior's mean pose, varied along its two
directions of largest variance. No fit is needed, because the expected uncertainty follows from the curvature of the
cost at this motion (`recon.fit.posterior`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from recon.animal.body import Body
from recon.animal.prior import MotionPrior
from recon.base.arrays import Array
from recon.base.threads import one_thread
from recon.clip import View, still_view
from recon.fit import constants
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.least_squares import Estimate
from recon.fit.posterior import posterior
from recon.gait.flexion import MODEL_RAD
from recon.geometry.camera import Camera
from recon.geometry.kinematics import ROOT

AZIMUTHS_RAD = np.radians(np.arange(0, 360, 30))
"""Azimuths of cameras around the animal, rad, counterclockwise seen from above.

A camera at 0 is ahead of the animal, and a camera at a quarter turn is on its left.
"""
ELEVATIONS_RAD = np.radians([5, 30, 55, 80])
"""Elevations of cameras above the level of the animal's middle, rad."""
FPS = 60.0
"""Frame rate of the simulated clip, Hz."""
FRAMES = 21
"""Number of frames of the simulated clip, which last one stride."""
STRIDES_HZ = 3.0
"""Strides per second of the simulated animal."""
LENGTHS_S = 5.0
"""Speed of the simulated animal in body lengths per second."""
AWAY_LENGTHS = 4.0
"""Default distance of the camera in body lengths."""
PICTURE_PX = (1920, 1080)
EQUAL_DIFFERENCE = 1e-6
"""Relative difference below which two positions' standard deviations count as equal."""


@dataclass(frozen=True, eq=False)
class Advice:
    """Precision with which a camera measures a target from each of E elevations and A azimuths."""

    target: str
    """Angle or joint to measure, such as front_trunk_yaw or the flexion of the left elbow."""
    unit: str
    """"rad" for an angle, "m" for joints."""
    distance_m: float
    sigma: Array
    """Median standard deviation over the frames, shape (E, A), in `unit`; infinite if the camera sees no marker."""
    share: Array
    """Fraction of the precision that comes from the pixels of all cameras, shape (E, A)."""
    first_position: tuple[float, float] | None = None
    """Azimuth and elevation (rad) of the first camera in advice on a second camera."""

    @property
    def best(self) -> tuple[int, int]:
        """Return the indices of the elevation and the azimuth with the smallest standard deviation.

        If several positions are equally good, such as both sides of an animal, the result is the first of them.
        """
        row, column = np.argwhere(self.sigma <= (1 + EQUAL_DIFFERENCE) * self.sigma.min())[0]
        return int(row), int(column)

    @property
    def position(self) -> tuple[float, float]:
        """Return the azimuth and elevation of the best position, rad."""
        row, column = self.best
        return float(AZIMUTHS_RAD[column]), float(ELEVATIONS_RAD[row])


def advise(
    body: Body,
    prior: MotionPrior,
    target: str | tuple[str, ...] | None = None,
    hfov_deg: float = 60.0,
    distance_m: float | None = None,
    cameras: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Advice]:
    """Return advice on where to put one or two cameras.

    The advice on a second camera assumes that the first camera is in its best position.

    Parameters
    ----------
    body, prior : Body, MotionPrior
        The animal, and the prior of its motion.
    target : str or tuple of str, optional
        An angle of the body's states (not its position or heading), a marker, or a tuple of the names of anatomical
        joints whose flexion is measured, such as ("left_elbow", "right_elbow"); by default all markers.
    hfov_deg : float
        Horizontal field of view, degrees.
    distance_m : float, optional
        Distance of a camera from the animal's middle, m; by default `AWAY_LENGTHS` body lengths.
    cameras : int
        Number of cameras, 1 or 2.
    progress : callable
        Called with the fraction of the work that is done.

    Raises
    ------
    ValueError
        If the body lacks the target, or if the field of view is outside (0, 180) degrees.
    """
    states, lens = mean_stride(body, prior), Camera.from_hfov(hfov_deg, PICTURE_PX)
    middle = body.tree.pose(states).points_m.mean(axis=(0, 1))
    distance = AWAY_LENGTHS * length_m(body) if distance_m is None else distance_m
    advices, shape = list[Advice](), (len(ELEVATIONS_RAD), len(AZIMUTHS_RAD))
    for number in range(cameras):
        first_position = advices[0].position if advices else None
        fixed_cameras = (
            [camera_at(replace(lens, name="first"), middle, *first_position, distance)] if first_position else []
        )
        grid = np.empty((*shape, 2))
        for done, (row, column) in enumerate(np.ndindex(shape)):
            position = float(AZIMUTHS_RAD[column]), float(ELEVATIONS_RAD[row])
            candidate = camera_at(replace(lens, name="candidate"), middle, *position, distance)
            with one_thread():
                grid[row, column] = precision_of(body, prior, states, [*fixed_cameras, candidate], target)
            progress((number + (done + 1) / math.prod(shape)) / cameras)
        unit = "rad" if isinstance(target, tuple) or target in body.state_names[4:] else "m"
        advices.append(Advice(target_text(target), unit, distance, grid[..., 0], grid[..., 1], first_position))
    return advices


def target_text(target: str | tuple[str, ...] | None) -> str:
    """Return the words for a target of `advise`, such as "the flexion of the left elbow and the right elbow"."""
    if isinstance(target, tuple):
        return "the flexion of " + " and ".join(f"the {joint.replace('_', ' ')}" for joint in target)
    return target or "all joints"


def precision_of(
    body: Body,
    prior: MotionPrior,
    states: Array,
    cameras: Sequence[Camera],
    target: str | tuple[str, ...] | None = None,
) -> tuple[float, float]:
    """Return a target's standard deviation and the fraction of its precision due to pixels, medians over frames.

    The standard deviation is in rad for an angle, and in m for a joint relative to the rest of the pose. The cameras
    see the motion of states (T, D). The result is (inf, 0) if no camera sees the animal. `target` is as in `advise`.

    The standard deviation of a flexion includes `MODEL_RAD`, as in the tables of the analysis. For several joints it is
    the root mean square of theirs.
    """
    views = [_view_of(body, states, camera) for camera in cameras]
    if not any(view.present.any() for view in views):
        return np.inf, 0.0
    clip = ClipProblem.from_views(views, body, prior, FPS, TrajectoryOptions(cameras_known=True))
    at_origin = states.copy()
    at_origin[:, ROOT] -= clip.origin_m
    around_m = clip.markers(at_origin)
    noise_px = clip.noise_px(around_m, np.ones((len(views), len(body.markers))))
    problem = clip.problem(noise_px, temperature=1.0, around_m=around_m)
    estimate = Estimate(at_origin, 0.0, 0, True, problem.expected())
    result = posterior(problem, body, estimate, max(constants.ERROR_TIME_S * FPS, 1.0))
    if isinstance(target, tuple):
        rows = [[*body.anatomy].index(joint) for joint in target]
        variance, prior_variance = result.flexion_variance[..., rows].mean(axis=2)
        fraction = np.clip(1.0 - variance / prior_variance, 0.0, 1.0)
        return float(np.median(np.sqrt(variance + MODEL_RAD**2))), float(np.median(fraction))
    if target in body.state_names[4:]:
        column = body.state_names[3:].index(target)
        sigma, fraction = np.sqrt(result.angle_variance[0][:, column]), result.angle_data_share[:, column]
        return float(np.median(sigma)), float(np.median(fraction))
    markers = slice(None) if target is None else [body.markers.index(target)]
    variance = np.trace(result.relative_covariance_m2[:, markers], axis1=2, axis2=3).mean(axis=1)
    return float(np.median(np.sqrt(variance))), float(np.nanmean(result.data_share[markers]))


def mean_stride(body: Body, prior: MotionPrior) -> Array:
    """Return the states (FRAMES, D) of a mean stride along the x axis through the origin of the world."""
    values, vectors = np.linalg.eigh(prior.covariance)
    time_s = (np.arange(FRAMES) - FRAMES // 2) / FPS
    phase = 2 * np.pi * STRIDES_HZ * time_s
    states = np.zeros((FRAMES, body.n_state))
    states[:, 0] = LENGTHS_S * length_m(body) * time_s
    states[:, 4:] = prior.mean
    for swing, k in ((np.cos(phase), -1), (np.sin(phase), -2)):
        states[:, 4:] += np.outer(swing, vectors[:, k] * np.sqrt(values[k]))
    return states


def length_m(body: Body) -> float:
    """Return the animal's length from end to end in the expected pose, m."""
    return float(np.ptp(body.expected_points_m()[:, 0]))


def camera_at(camera: Camera, target_m: Array, azimuth_rad: float, elevation_rad: float, distance_m: float) -> Camera:
    """Return a camera that looks at target_m (3,) from a position around an animal that faces along x."""
    level = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    towards = -np.cos(elevation_rad) * level - np.sin(elevation_rad) * np.array([0.0, 0.0, 1.0])
    right = np.array([-level[1], level[0], 0.0])
    rotation = np.stack([right, np.cross(towards, right), towards])
    return replace(camera, rotation=rotation, translation_m=-rotation @ (target_m - distance_m * towards))


def _view_of(body: Body, states: Array, camera: Camera) -> View:
    """Return the view of a camera that detects every marker inside its picture."""
    pixels, valid = camera.project(camera.world_to_camera(body.detected.pose(states).points_m))
    is_seen = valid & camera.in_image(pixels)
    return still_view(camera, np.where(is_seen[..., None], pixels, np.nan), is_seen.astype(float))
