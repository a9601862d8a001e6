"""Which way is up where the cameras' poses do not say it: from the ground that the feet of an animal stand on.

No body is fitted: the keypoints are triangulated, in whatever world the poses have.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from recon.animal.body import Body
from recon.base.arrays import Array
from recon.check.agreement import points_m
from recon.clip import View
from recon.fit import constants
from recon.fit.terms import StanceVelocity

MAX_SIGMA_RAD = np.radians(10.0)
"""Less is known of a camera that is taken to be level."""
POSTURE_RAD = np.radians(15.0)
"""How far from up the body may lie from its feet, in the mean over a clip."""
FOOT_SHARE = 1 / 15
"""How far from the ground feet stand, as a part of the body's height above them: `GROUND_FOOT_M` of a cheetah."""
MIN_STANDING = 3
"""Fewer feet that stand, over all frames, say nothing: as in `recon.fit.clip_problem`."""


class _Upward(NamedTuple):
    """The unit vector (3,) that points up, a point (3,) of the ground below the animal, metres, in the poses' world,
    and the standard deviation of the direction about its less known axis."""

    up: Array
    ground_m: Array
    sigma_rad: float


def up_from_feet(views: Sequence[View], body: Body, fps: float, sigma_px: float) -> _Upward | None:
    """Up as the feet of an animal say it that several cameras saw, None where they say too little.

    The plane through the feet that stand: slow ones, and, of those, the ones that others stand with. The body, which is
    above them, holds the plane where they stand on one line."""
    positions_m = points_m(views, sigma_px, body.keypoint_sigma_m)
    feet = np.array([body.markers.index(foot) for foot in body.feet])
    if not len(feet) or len(positions_m) < 2:
        return None
    above = positions_m[:, np.setdiff1d(np.arange(len(body.markers)), feet)]
    whole = np.isfinite(positions_m[:, feet, 0]).any(axis=1) & np.isfinite(above[..., 0]).any(axis=1)
    step = 0.5 * (positions_m[1:, feet] + positions_m[:-1, feet])
    seen = np.isfinite(step[..., 0])
    if seen.sum() < MIN_STANDING or not whole.any():
        return None
    body_m = np.nanmedian(above[whole], axis=1) - np.nanmean(positions_m[whole][:, feet], axis=1)
    posture = np.median(body_m, axis=0)
    tall_m = float(np.linalg.norm(posture))
    axes = np.linalg.svd(posture[None])[2]
    axes[0] *= np.sign(axes[0] @ posture)  # up by the posture, and across it

    still = StanceVelocity(feet, fps, constants.SLIP_M_S, constants.SLIP_C).contact(positions_m, 1.0)[2][seen]
    middle = np.median(step[seen], axis=0)
    height, *across = axes @ (step[seen] - middle).T
    rows = np.stack([np.ones_like(height), *across], axis=-1)
    held = np.diag([0.0, *np.full(2, np.tan(POSTURE_RAD) ** -2.0)])
    alike = max(constants.ERROR_TIME_S * fps, 1.0)
    plane, normal, weight = np.array([np.quantile(height, 0.25), 0.0, 0.0]), np.eye(3), still
    for width_m in tall_m * np.geomspace(1.0, FOOT_SHARE, 12):
        weight = still / (1.0 + ((height - rows @ plane) / (3 * width_m)) ** 2) ** 2
        of_rows = rows.T * weight / (alike * width_m**2)
        normal = of_rows @ rows + held
        plane = np.linalg.solve(normal, of_rows @ height)
    up = axes.T @ [1.0, *-plane[1:]]
    sigma = float(np.sqrt(np.linalg.eigvalsh(np.linalg.inv(normal)[1:, 1:])[-1]))
    if not weight.sum() >= MIN_STANDING or not sigma < MAX_SIGMA_RAD:
        return None
    return _Upward(up / np.linalg.norm(up), middle + plane[0] * axes[0], sigma)
