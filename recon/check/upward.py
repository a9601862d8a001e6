"""Estimate the upward direction from the ground under an animal's feet, if the camera files do not define it.

The keypoints are triangulated from all cameras, and a plane is fitted to the feet in stance. No body is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from recon.animal.body import Body
from recon.base.arrays import Array, Index
from recon.check.sights import triangulated_m
from recon.clip import View
from recon.fit import constants
from recon.fit.terms import StanceVelocity

MAX_SIGMA_RAD = np.radians(10.0)
"""Largest accepted standard deviation of the upward direction, as for a camera that is assumed to be level, rad."""
POSTURE_RAD = np.radians(15.0)
"""Standard deviation over clips of the angle between up and the mean direction from the feet to the body, rad."""
FOOT_SIGMA_FRACTION = 1 / 15
"""Standard deviation of the height above the ground of feet in stance, as a fraction of the body's height above them.

For a cheetah, it equals `GROUND_FOOT_M`.
"""
MIN_STANDING = 3
"""Minimum number of positions of feet in stance, over all frames, as in `recon.fit.clip_problem`."""


class _Upward(NamedTuple):
    """Upward unit vector (3,), a point on the ground (3,) in m, and the standard deviation of the direction in rad.

    The vector and the point are in the world frame of the camera poses. The standard deviation applies to the less
    certain axis.
    """

    up: Array
    ground_m: Array
    sigma_rad: float


def up_from_feet(views: Sequence[View], body: Body, fps: float, sigma_px: float) -> _Upward | None:
    """Return the upward direction, estimated from the feet in stance of an animal that several cameras see.

    The direction is the normal of the plane through the feet in stance, which are slow feet that lie in a plane with
    other slow feet. The direction from the feet to the body is also used, because feet on a single line do not
    determine a plane. Return None if the plane is too uncertain.

    Parameters
    ----------
    views
        Views of the clip, in a world whose upward direction is not known.
    body
        The animal.
    fps
        Frames per second.
    sigma_px
        Standard deviation of the detector's noise, pixels.
    """
    positions_m = triangulated_m(views, sigma_px, body.keypoint_sigma_m)
    feet = np.array([body.markers.index(foot) for foot in body.feet])
    if not len(feet) or len(positions_m) < 2:
        return None
    step = 0.5 * (positions_m[1:, feet] + positions_m[:-1, feet])
    is_seen = np.isfinite(step[..., 0])
    posture_m = _feet_to_body(positions_m, feet)
    if is_seen.sum() < MIN_STANDING or posture_m is None:
        return None
    axes = np.linalg.svd(posture_m[None])[2]
    axes[0] *= np.sign(axes[0] @ posture_m)  # upwards according to the posture

    slow = StanceVelocity(feet, fps, constants.SLIP_M_S, constants.SLIP_C).contact(positions_m, 1.0)[2][is_seen]
    middle = np.median(step[is_seen], axis=0)
    along_axes = (axes @ (step[is_seen] - middle).T).T
    correlation_frames = max(constants.ERROR_TIME_S * fps, 1.0)
    plane, normal, standing = _fit_tilted_plane(along_axes, slow, float(np.linalg.norm(posture_m)), correlation_frames)
    up = axes.T @ [1.0, *-plane[1:]]
    sigma = float(np.sqrt(np.linalg.eigvalsh(np.linalg.inv(normal)[1:, 1:])[-1]))
    if not standing >= MIN_STANDING or not sigma < MAX_SIGMA_RAD:
        return None
    return _Upward(up / np.linalg.norm(up), middle + plane[0] * axes[0], sigma)


def _feet_to_body(positions_m: Array, feet: Index) -> Array | None:
    """Return the median vector from the feet to the rest of the body, shape (3,), m; None if never seen together."""
    rest_m = positions_m[:, np.setdiff1d(np.arange(positions_m.shape[1]), feet)]
    is_whole = np.isfinite(positions_m[:, feet, 0]).any(axis=1) & np.isfinite(rest_m[..., 0]).any(axis=1)
    if not is_whole.any():
        return None
    vectors_m = np.nanmedian(rest_m[is_whole], axis=1) - np.nanmean(positions_m[is_whole][:, feet], axis=1)
    return np.median(vectors_m, axis=0)


def _fit_tilted_plane(
    feet_m: Array, slow: Array, tall_m: float, correlation_frames: float
) -> tuple[Array, Array, float]:
    """Return a plane fitted to the positions of slow feet, the curvature of its cost, and the number of feet in stance.

    Parameters
    ----------
    feet_m
        Positions of feet as height and two horizontal coordinates, m, shape (N, 3).
    slow
        Weight of each position, which is larger for slower feet, shape (N,).
    tall_m
        Height of the body above the feet, m. Positions far from the plane lose their weight. The distance at which they
        lose it decreases from about this height to `FOOT_SIGMA_FRACTION` of it.
    correlation_frames
        Number of frames within which errors count only once.

    Returns
    -------
    plane : ndarray
        Height and two slopes of the plane, shape (3,).
    curvature : ndarray
        Curvature of the cost, shape (3, 3).
    standing : float
        Number of positions on the plane.
    """
    height, *across = feet_m.T
    rows = np.stack([np.ones_like(height), *across], axis=-1)
    posture_precision = np.diag([0.0, *np.full(2, np.tan(POSTURE_RAD) ** -2.0)])
    plane, normal, weight = np.array([np.quantile(height, 0.25), 0.0, 0.0]), np.eye(3), slow
    for width_m in tall_m * np.geomspace(1.0, FOOT_SIGMA_FRACTION, 12):
        weight = slow / (1.0 + ((height - rows @ plane) / (3 * width_m)) ** 2) ** 2
        weighted_rows = rows.T * weight / (correlation_frames * width_m**2)
        normal = weighted_rows @ rows + posture_precision
        plane = np.linalg.solve(normal, weighted_rows @ height)
    return plane, normal, float(weight.sum())
