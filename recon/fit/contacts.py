"""Which feet stand, and on what ground."""

from __future__ import annotations

import numpy as np

from recon.base.arrays import Array
from recon.fit import constants
from recon.fit.clip_problem import ClipProblem
from recon.fit.result import Ground
from recon.fit.terms import REFERENCE_HZ, OnGround, Standing, Term

LOW_FEET = 0.1
"""Of the frames, the part in which the lowest foot is taken to be on the ground."""
ELSEWHERE = 2.5
"""A ground further off z = 0, in standard deviations of what is expected, is not taken to lie there."""


def above_ground(clip: ClipProblem, points_m: Array, size: float = 1.0) -> float:
    """By how many standard deviations the lowest feet are above where a ground at z = 0 would be, for markers (T, J, 3)
    at nominal size about the origin."""
    low_m = float(np.quantile(points_m[:, clip.feet, 2].min(axis=1), LOW_FEET))
    return (float(clip.origin_m[2]) / size + low_m) / float(
        np.hypot(constants.GROUND_HEIGHT_M, clip.size_sigma * low_m)
    )


def contacts(clip: ClipProblem, points_m: Array, size: float) -> tuple[Array, Ground | None, tuple[Term, ...]]:
    """Contact (T, F) of every foot, the ground under them, and the terms that hold both, for markers (T, J, 3) at
    nominal size about the origin."""
    feet = clip.feet
    stance = Standing(feet, clip.fps, constants.SLIP_M_S, constants.SLIP_C)
    _, _, still = stance.contact(points_m, size)
    middle = 0.5 * (points_m[1:, feet] + points_m[:-1, feet])
    height, sigma = float(np.percentile(middle[..., 2], 10)), 10.0
    near_zero = abs(above_ground(clip, points_m, size)) < ELSEWHERE if clip.ground_known else None
    if near_zero:
        height = -float(clip.origin_m[2]) / size
        sigma = float(np.hypot(constants.GROUND_HEIGHT_M, clip.size_sigma * height))
    spread = np.array([sigma, constants.GROUND_SLOPE, constants.GROUND_SLOPE])
    centre = np.median(middle[..., :2].reshape(-1, 2), axis=0)
    rows = np.concatenate([np.ones((*middle.shape[:2], 1)), middle[..., :2] - centre], axis=-1)
    plane, covariance, contact = np.array([height, 0.0, 0.0]), np.diag(spread**2), still
    count = REFERENCE_HZ / clip.fps / constants.GROUND_FOOT_M**2
    for _ in range(5):
        above = middle[..., 2] - rows @ plane
        contact = still / (1.0 + (above / (3 * constants.GROUND_FOOT_M)) ** 2) ** 2
        normal = np.einsum("tf,tfa,tfb->ab", contact, rows, rows) * count + np.diag(spread**-2.0)
        covariance = np.linalg.inv(normal)
        pull = np.einsum("tf,tfa,tf->a", contact, rows, middle[..., 2]) * count + spread**-2.0 * (height, 0.0, 0.0)
        plane = covariance @ pull
    both = np.concatenate([contact[:1], np.maximum(contact[1:], contact[:-1]), contact[-1:]])
    if contact.sum() < 3:  # no foot stands: nothing is known of the ground
        return both, None, (stance,)
    on_ground = OnGround(feet, contact, plane, centre, clip.fps, constants.GROUND_FOOT_M)
    slope = plane[1:]
    sigma = float(np.sqrt(covariance[0, 0] * clip.correlation_frames))
    ground = Ground(float(plane[0] - slope @ centre), slope, sigma, near_zero)
    return both, ground, (stance, on_ground)
