"""Adjust the orientations of all frames together, and estimate the focal length from pictures far apart.

The joint adjustment removes drift when the camera returns to an earlier direction. The focal length can be estimated
because the angles between points stay constant across a rotation only for the correct focal length.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import bsr_array, csc_array, diags_array
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Integers
from recon.calibrate.camera_motion import rotation as turning
from recon.calibrate.camera_motion.rotation import Orientation
from recon.geometry.camera import Camera

ADJUST_STEPS = 4
"""Number of Gauss-Newton steps in which all frames are adjusted together."""
MAX_PAIRS = 60
"""Maximum number of pairs of pictures that determine the focal length. Those with the largest rotations are used."""
MIN_PAIRS = 4
"""Minimum number of pairs of pictures required to estimate the focal length."""
MAX_LOG_FACTOR = 0.7
"""Largest absolute logarithm of a trial factor on the focal length; the refined factor may reach twice this."""
LOG_STEP = 1e-3
"""Step in the logarithm of the focal length with which derivatives are computed numerically."""
STEPS = 6
"""Number of iterations to find the focal length."""
ROUNDS = 4
"""Number of iterations to find the rotation between two pictures for a given focal length."""
COARSE_ROUNDS = 2
"""Number of iterations to find the rotation between two pictures while trial focal lengths are compared."""
PAIR_FLOOR_PX = 0.15
"""Standard deviation of the error that all points of a pair of pictures have in common, px."""


FrameLink = tuple[int, int, Array, Array, Array, Array]
"""Link from a keyframe to a frame: index of the frame, index of the keyframe, rotation (3, 3), log zooms (2,), H (5, 5)
and g (5,).

The cost is e'He - 2 g'e, where e (5,) is the deviation of the rotation (rad) and of the two log zooms from their values
in the link.
"""


def adjust(
    orientations: Sequence[Orientation], links: Sequence[FrameLink], solve_zoom: bool, floor_rad: float
) -> tuple[tuple[Orientation, ...], Array, Array]:
    """Return the adjusted orientations of N frames, and the standard deviations of rotations and zooms.

    The first frame is fixed, and every other frame has at least one of the `links`. Standard deviations of rotations
    (N,) are in rad per axis, relative to the first frame. Standard deviations of zooms (N,) are relative to the zoom.
    `floor_rad` is `PICTURE_FLOOR_PX` as an angle.
    """
    n, p = len(orientations), 4 if solve_zoom else 3
    rotation = np.stack([orientation.rotation for orientation in orientations])
    log_zoom = np.log([orientation.zoom for orientation in orientations])
    frame, key, measured, zooms, normal, gradient = map(np.stack, zip(*links, strict=True))
    rows, ends = np.arange(len(links) + 1), np.stack([frame, key], axis=1)
    weights, information, factor = bsr_array((normal, rows[:-1], rows)), None, None
    for _ in range(ADJUST_STEPS):
        turns = rotation[frame] @ rotation[key].swapaxes(1, 2)
        e = np.zeros((len(links), 5))
        e[:, :3] = Rotation.from_matrix(turns @ measured.swapaxes(1, 2)).as_rotvec()
        e[:, 3:] = log_zoom[ends] - zooms
        J = np.zeros((len(links), 2, 5, p))
        J[:, 0, :3, :3], J[:, 1, :3, :3] = np.eye(3), -turns
        if solve_zoom:
            J[:, 0, 3, 3] = J[:, 1, 4, 3] = 1.0
        slopes = bsr_array((J.reshape(-1, 5, p), ends.ravel(), 2 * rows), shape=(e.size, n * p))
        information = (slopes.T @ weights @ slopes).tocsc()
        fixed = np.where(np.arange(n * p) < p, 1e6 * information.max(), 0.0)
        factor = splu((information + diags_array(fixed)).tocsc())
        step = factor.solve(slopes.T @ (gradient.ravel() - weights @ e.ravel())).reshape(n, p)
        rotation = Rotation.from_rotvec(step[:, :3]).as_matrix() @ rotation
        if solve_zoom:
            log_zoom = log_zoom + step[:, 3]
    assert information is not None
    assert factor is not None
    sigma = np.sqrt(np.maximum(_variances(information, factor, frame, key, n), 0))
    adjusted = tuple(Orientation(r, float(z)) for r, z in zip(rotation, np.exp(log_zoom), strict=True))
    sigma_zoom = sigma[:, 3] if solve_zoom else np.zeros(n)
    return adjusted, np.hypot(np.sqrt((sigma[:, :3] ** 2).mean(axis=1)), floor_rad), sigma_zoom


def _variances(information: csc_array, factor: SuperLU, frame: Integers, key: Integers, n: int) -> Array:
    """Return the variances (n, P) of the unknowns of n frames.

    A keyframe's variance comes from the inverse of the information (n P, n P), whose factorisation is given. The
    variance of another frame is its own variance plus the mean of its keyframes'. `frame` and `key` are the two ends of
    each link.
    """
    p = information.shape[0] // n
    variance = np.full((n, p), np.nan)
    for k in np.unique(key).tolist():
        variance[k] = np.diag(factor.solve(np.eye(n * p, p, -k * p))[k * p : (k + 1) * p])
    for t in np.flatnonzero(np.isnan(variance[:, 0])).tolist():
        own_rows = slice(t * p, (t + 1) * p)
        own_variance = np.diag(np.linalg.inv(information[own_rows, own_rows].toarray()))
        variance[t] = variance[key[frame == t]].mean(axis=0) + own_variance
    return variance


class TurnedPair(NamedTuple):
    """Points followed from one picture to another, and the rotation between the pictures."""

    key: int
    """Number of the earlier picture's keyframe."""
    a_px: Array
    """The points in the earlier picture, shape (N, 2)."""
    b_px: Array
    """The points in the later picture, shape (N, 2)."""
    turn: Array
    """Rotation from the earlier to the later camera frame, shape (3, 3)."""


def furthest_turned(pairs: Sequence[TurnedPair]) -> list[TurnedPair]:
    """Return the `MAX_PAIRS` pairs of pictures with the largest rotations of the camera between them."""
    return sorted(pairs, key=lambda pair: -float(Rotation.from_matrix(pair.turn).magnitude()))[:MAX_PAIRS]


def focal_factor(camera: Camera, pairs: Sequence[TurnedPair], limit_px: float) -> tuple[float, float] | None:
    """Return the log ratio of the focal length to the camera file's, and its standard deviation.

    The standard deviation combines the errors of the points and the scatter between the keyframes of the pairs' earlier
    pictures. The result is None for fewer than `MIN_PAIRS` pairs. Points with larger errors than `limit_px` count as
    outliers while a first value is searched for.
    """
    if len(pairs) < MIN_PAIRS:
        return None
    every_few = pairs[:: max(1, len(pairs) // 12)]

    def cost(log_factor: float) -> float:
        sizes = [np.linalg.norm(_residuals_px(camera, pair, log_factor, COARSE_ROUNDS), axis=1) for pair in every_few]
        return sum(float(np.minimum(size / limit_px, 1.0).mean()) for size in sizes)

    log_factor = min(np.linspace(-MAX_LOG_FACTOR, MAX_LOG_FACTOR, 29).tolist(), key=cost)
    information, pull = np.ones((2, len(pairs)))
    for _ in range(STEPS):
        information, pull = np.transpose([_information(camera, pair, log_factor) for pair in pairs])
        step = pull.sum() / information.sum()
        log_factor = float(np.clip(log_factor + step, -2 * MAX_LOG_FACTOR, 2 * MAX_LOG_FACTOR))
        if abs(step) < 0.01 / np.sqrt(information.sum()):
            break
    keys, total = np.array([pair.key for pair in pairs]), float(information.sum())
    scatter = sum(pull[keys == key].sum() ** 2 for key in np.unique(keys)) / total**2
    return log_factor, float(np.sqrt(1 / total + scatter))


def _information(camera: Camera, pair: TurnedPair, log_factor: float) -> tuple[float, float]:
    """Return a pair's precision for the log focal-length ratio, and the negative slope of its cost along this ratio."""
    residual_px, *ends = (_residuals_px(camera, pair, log_factor + change) for change in (0.0, LOG_STEP, -LOG_STEP))
    slope, weights, size = (
        (ends[0] - ends[1]) / (2 * LOG_STEP),
        _weights(residual_px),
        np.linalg.norm(residual_px, axis=1),
    )
    used = max(float(weights.sum()), 1.0)
    sigma2 = max(float(weights @ size**2) / (2 * used), 1e-4) + PAIR_FLOOR_PX**2 * used
    return float(weights @ (slope**2).sum(axis=1)) / sigma2, -float(
        weights @ (slope * residual_px).sum(axis=1)
    ) / sigma2


def _residuals_px(camera: Camera, pair: TurnedPair, log_factor: float, rounds: int = ROUNDS) -> Array:
    """Return the residuals (N, 2) of a pair's points in the later picture after the best rotation."""
    zoom = float(np.exp(log_factor))
    (a, is_known), (b, is_seen) = (turning.rays_of(camera, points_px, zoom) for points_px in (pair.a_px, pair.b_px))
    is_known &= is_seen
    # The rotation is scaled to shift the picture by the same distance at this focal length.
    turn = Rotation.from_rotvec(Rotation.from_matrix(pair.turn).as_rotvec() / zoom)
    residual_px = np.full(pair.a_px.shape, 1e9)
    for number in range(rounds):
        if number:
            turn, _ = Rotation.align_vectors(b[is_known], a[is_known], weights=_weights(residual_px)[is_known])
        pixels, valid = turning.pixels_of(camera, turn.apply(np.where(is_known[:, None], a, b)), zoom)
        residual_px = np.where((is_known & valid)[:, None], pixels - pair.b_px, 1e9)
    return residual_px


def _weights(residual_px: Array) -> Array:
    """Return Tukey weights (N,) for residuals (N, 2), px."""
    size = np.linalg.norm(residual_px, axis=1)
    return turning.tukey(size, max(4 * float(np.median(size)), 1.0))
