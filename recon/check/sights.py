"""Compare the rays of cameras that see the same keypoints, without a body and without a fit.

If cameras see the same keypoint in the same frame, their rays should meet. The points at which the rays of several
cameras meet are computed robustly and with their covariance (`meeting_points`), and compared with the directions in
which another camera saw them (`squared_errors`). The errors are in standard deviations, which include the noise of the
points and of the directions. The median error of a camera, divided by the median of pure noise, is its error ratio,
which is about 1 if the cameras agree (`error_ratio`). Two cameras have no third camera to be compared with, so they are
compared with each other by the epipolar planes of their rays (`error_ratio_of_pair`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Index
from recon.clip import View

MIN_POINTS = 30
"""Minimum number of points, over all frames, required to compute an error ratio."""
WIDE_OFFSET_S = 0.5
"""Largest time offset that is tried for a camera that does not agree, seconds."""
NARROW_OFFSET = 3
"""Largest time offset in frames that is tried for a camera that agrees, unless the best offset is at this limit."""
_ROBUST = 3.0
"""Residual, in standard deviations, that has a robust weight of 0.5."""
_POINT_ROUNDS = 3
"""Number of iterations of robust reweighting in the triangulation of points, and in the estimate of a drift."""
_MEDIAN_OF_LINE = 0.4549
"""Median of the squared length of a normal error in one dimension, in units of its variance."""
_MEDIAN_OF_POINT = 1.3863
"""Median of the squared length of a normal error in two dimensions, in units of its variance along an axis."""
_PARALLEL = 1e-4
"""Ratio of a point's precision along its rays to the precision across them, below which the rays are parallel."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Directions in which a camera saw J keypoints in T frames."""

    rays: Array
    """Unit vectors along the directions in the world frame, shape (T, J, 3); NaN where missing."""
    centre_m: Array
    """Centre of the camera in the world frame, shape (T, 3)."""
    rotation: Array
    """Rotation from the world to the camera frame, shape (T, 3, 3)."""
    focal_px: float
    noise_rad: Array
    """Standard deviation of a detection as an angle, shape (T, 1)."""

    def later(self, frames: float) -> Sight:
        """Return the directions as if the camera had taken every picture a number of frames later."""
        rays, centre_m = _shifted(self.rays, frames), _shifted(self.centre_m, frames)
        # The rotation is shifted by whole frames, because the mean of two rotation matrices is no rotation.
        return replace(self, rays=rays, centre_m=centre_m, rotation=_shifted(self.rotation, round(frames)))

    def part(self, rows: Index) -> Sight:
        """Return the directions in some of the T frames."""
        parts = (self.rays[rows], self.centre_m[rows], self.rotation[rows], self.focal_px, self.noise_rad[rows])
        return Sight(*parts)


Points = tuple[Array, Array]
"""Positions of triangulated points (T, J, 3), metres, and covariances (T, J, 3, 3); NaN with fewer than two rays."""
PointsOf = Callable[[tuple[Sight, ...]], Points]
"""Version of `meeting_points` with a cache, because several comparisons need the points of the same cameras."""


def _shifted(values: Array, frames: float) -> Array:
    """Return values (T, ...) shifted by a number of frames, with linear interpolation, and NaN beyond the ends."""
    whole, T = int(np.floor(frames)), len(values)
    rows = np.arange(T) - np.array([[whole], [whole + 1]])
    inside = ((rows >= 0) & (rows < T)).reshape(2, T, *[1] * (values.ndim - 1))
    first, second = np.where(inside, values[rows.clip(0, T - 1)], np.nan)
    fraction = frames - whole
    return (1 - fraction) * first + fraction * second if fraction else first


def sights_of(views: Sequence[View], sigma_px: float, keypoint_sigma_m: float) -> list[Sight]:
    """Return the directions in which each view saw its keypoints, at the times of the first camera's frames.

    `sigma_px` is the standard deviation of a detection, pixels, and `keypoint_sigma_m` that of a keypoint's position on
    the body, m.
    """
    T = len(views[0].xy_px)
    sights = []
    for view in views:
        focal_px = float(np.mean(view.focal_px))
        rotation = np.broadcast_to(view.T_camera_world[..., :3, :3], (T, 3, 3))
        sight = Sight(view.rays(), view.centre_m, rotation, focal_px, np.full((T, 1), sigma_px / focal_px))
        sights.append(sight.later(view.offset_frames))
    position_m, _ = meeting_points(sights)
    return [_with_keypoint_noise(sight, position_m, keypoint_sigma_m) for sight in sights]


def triangulated_m(views: Sequence[View], sigma_px: float, keypoint_sigma_m: float) -> Array:
    """Return the points at which the rays of several views meet, m, shape (T, J, 3); NaN with fewer than two rays."""
    return meeting_points(sights_of(views, sigma_px, keypoint_sigma_m))[0]


def _with_keypoint_noise(sight: Sight, position_m: Array, keypoint_sigma_m: float) -> Sight:
    """Return the directions with the keypoints' noise on the body added, as an angle at their median distance."""
    distance = np.linalg.norm(position_m - sight.centre_m[:, None], axis=-1)
    if np.isnan(distance).all():
        return sight
    with warnings.catch_warnings(action="ignore"):  # some frames have no points
        typical = np.nanmedian(distance, axis=1)
    typical = np.where(np.isnan(typical), np.nanmedian(distance), typical)
    return replace(sight, noise_rad=np.hypot(sight.noise_rad, keypoint_sigma_m / typical[:, None]))


def meeting_points(sights: Sequence[Sight]) -> Points:
    """Return the points nearest to the rays of two or more cameras, with less weight for outlying rays."""
    rays = np.array([sight.rays for sight in sights])
    centres = np.array([sight.centre_m for sight in sights])[:, :, None]
    noise = np.array([sight.noise_rad for sight in sights])
    seen = np.isfinite(rays[..., 0])
    rays, centres = np.where(seen[..., None], rays, 0.0), np.where(np.isfinite(centres), centres, 0.0)
    across_rays = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    weight, distance, enough_rays = seen.astype(float), np.ones(seen.shape), seen.sum(axis=0) > 1
    position, information = np.zeros((*enough_rays.shape, 3)), np.zeros((*enough_rays.shape, 3, 3))
    for _ in range(_POINT_ROUNDS):
        ray_information = (weight / (noise * distance) ** 2)[..., None, None] * across_rays
        information = ray_information.sum(axis=0)
        spread = np.linalg.eigvalsh(information)
        enough_rays &= spread[..., 0] > _PARALLEL * spread[..., 2]
        information[~enough_rays] = np.eye(3)
        position = np.linalg.solve(information, (ray_information @ centres[..., None]).sum(axis=0))[..., 0]
        distance = np.maximum(np.linalg.norm(position - centres, axis=-1), 1e-3)
        error = np.linalg.norm((position - centres) / distance[..., None] - rays, axis=-1)
        weight = seen / (1.0 + (error / noise / _ROBUST) ** 2)
    position[~enough_rays] = np.nan
    covariance = np.asarray(np.linalg.inv(information), dtype=float)
    covariance[~enough_rays] = np.nan
    return position, covariance


def squared_errors(sight: Sight, points: Points) -> tuple[Array, Array]:
    """Return unit vectors from a camera to points (T, J, 3), and squared errors of its rays (T, J), in variances.

    The squared error of a point behind the camera is infinite.
    """
    position_m, covariance_m2 = points
    offset_m = position_m - sight.centre_m[:, None]
    distance = np.linalg.norm(offset_m, axis=-1, keepdims=True)
    towards = offset_m / distance
    x, y = _across(sight.rays)
    error = np.stack([np.sum((towards - sight.rays) * axis, axis=-1) for axis in (x, y)], axis=-1)
    basis = np.stack([x, y], axis=-2) / distance[..., None]
    covariance = basis @ covariance_m2 @ basis.swapaxes(-1, -2)
    a, b, c = (covariance[..., i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
    a, c = a + sight.noise_rad**2, c + sight.noise_rad**2
    squared = (c * error[..., 0] ** 2 - 2 * b * error[..., 0] * error[..., 1] + a * error[..., 1] ** 2) / (a * c - b**2)
    is_ahead, squared_behind = np.sum(offset_m * sight.rays, axis=-1) > 0, np.where(np.isnan(squared), np.nan, np.inf)
    return towards, np.where(is_ahead, squared, squared_behind)


def _across(rays: Array) -> tuple[Array, Array]:
    """Return two unit vectors for each ray that are orthogonal to the ray and to each other."""
    helper = np.where(np.abs(rays[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    x = np.cross(helper, rays)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return x, np.asarray(np.cross(rays, x), dtype=float)


def error_ratio(sight: Sight, points: Points) -> float:
    """Return the error ratio of a camera, given points from other cameras; NaN for fewer than `MIN_POINTS` points."""
    _, squared = squared_errors(sight, points)
    known_squares = squared[~np.isnan(squared)]
    return float(np.sqrt(np.median(known_squares) / _MEDIAN_OF_POINT)) if len(known_squares) >= MIN_POINTS else np.nan


def error_ratio_of_pair(a: Sight, b: Sight) -> tuple[float, float, int]:
    """Return two cameras' error ratio, the median angle of rays to epipolar planes, rad, and the number of points.

    A ray of a is compared with the plane through both cameras' centres and the corresponding ray of b. The error ratio
    is the same if a and b are exchanged.
    """
    line = b.centre_m - a.centre_m
    plane_of_b, plane_of_a = np.cross(b.rays, line[:, None]), np.cross(line[:, None], a.rays)
    # An error of one radian in a's or b's ray changes the triple product of both rays and the line by these lengths.
    by_a, by_b = np.linalg.norm(plane_of_b, axis=-1), np.linalg.norm(plane_of_a, axis=-1)
    off_plane = np.abs(np.sum(a.rays * plane_of_b, axis=-1))
    is_known = np.isfinite(off_plane) & (by_a > 0) & (by_b > 0)
    if is_known.sum() < MIN_POINTS:
        return np.nan, np.nan, int(is_known.sum())
    sigma = np.hypot(by_a * a.noise_rad, by_b * b.noise_rad)[is_known]
    ratio = np.sqrt(np.median((off_plane[is_known] / sigma) ** 2) / _MEDIAN_OF_LINE)
    return float(ratio), float(np.median(off_plane[is_known] / by_a[is_known])), int(is_known.sum())


def error_ratios(sights: Sequence[Sight], agreeing: Sequence[int], points_of: PointsOf) -> Array:
    """Return the error ratio of each camera in the group `agreeing`, compared with the others in the group, shape (V,).

    The error ratio is NaN for cameras that are not in the group.
    """
    ratios = np.full(len(sights), np.nan)
    for v in agreeing:
        partners = tuple(sights[o] for o in agreeing if o != v)
        ratios[v] = (
            error_ratio_of_pair(sights[v], *partners)[0]
            if len(agreeing) == 2
            else error_ratio(sights[v], points_of(partners))
        )
    return ratios


def best_turned(sight: Sight, points: Points) -> tuple[Sight, float]:
    """Return the directions after the camera's rotation that fits the points best, and the rotation's angle, rad."""
    towards, _ = squared_errors(sight, points)
    goal, rays = (np.einsum("tij,tkj->tki", sight.rotation, v) for v in (towards, sight.rays))
    is_known = np.isfinite(goal[..., 0]) & np.isfinite(rays[..., 0])
    if is_known.sum() < MIN_POINTS:
        return sight, np.nan
    noise = np.broadcast_to(sight.noise_rad, is_known.shape)[is_known]
    rotation = Rotation.identity()
    for _ in range(10):
        error = np.linalg.norm(goal[is_known] - rotation.apply(rays[is_known]), axis=-1)
        scale = max(float(np.median(error / noise)), 1.0)
        weight = noise**-2 / (1.0 + (error / noise / scale / _ROBUST) ** 2)
        rotation, _ = Rotation.align_vectors(goal[is_known], rays[is_known], weight)
    in_world = sight.rotation.swapaxes(-1, -2) @ rotation.as_matrix() @ sight.rotation
    return replace(sight, rays=np.einsum("tij,tkj->tki", in_world, sight.rays)), float(rotation.magnitude())


def best_shifted(sight: Sight, points: Points, fps: float, wide: bool) -> tuple[Sight, float]:
    """Return the directions with the time offset that fits the points best, and the offset in frames.

    Offsets up to `WIDE_OFFSET_S` are tried if `wide` is true, otherwise offsets up to `NARROW_OFFSET`, and the wider
    range only if the best offset is at the end of the narrow one. Offsets of whole frames are tried first, then
    quarters of a frame about the best.
    """
    reach = min(max(round(WIDE_OFFSET_S * fps), NARROW_OFFSET) if wide else NARROW_OFFSET, len(sight.rays) // 2)
    ratios = {float(frames): error_ratio(sight.later(frames), points) for frames in range(-reach, reach + 1)}
    if not np.isfinite([*ratios.values()]).any():
        return sight, np.nan
    best = min(ratios, key=lambda frames: (np.nan_to_num(ratios[frames], nan=np.inf), abs(frames)))
    if not wide and abs(best) == reach:
        return best_shifted(sight, points, fps, wide=True)
    for frames in (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75):
        ratios[best + frames] = error_ratio(sight.later(best + frames), points)
    best = min(ratios, key=lambda frames: (np.nan_to_num(ratios[frames], nan=np.inf), abs(frames)))
    return sight.later(best), best


def drift_by_rays(views: Sequence[View], markers_m: Array, v: int) -> tuple[float, float]:
    """Return the drift of a camera's clock over the clip, estimated from rays alone, and its sigma, both in frames.

    The drift that best moves the camera's rays into the epipolar planes of the other cameras' rays is estimated
    together with a time offset and a constant angle. The animal's lengths, which are wrong in a rough skeleton, are not
    used. Both values are NaN for fewer than `MIN_POINTS` points.

    Parameters
    ----------
    views
        Views of the same T frames.
    markers_m
        Markers of a fit in the world frame, metres, shape (T, J, 3). Only the velocities of their projections are used.
    v
        Index of the camera.
    """
    sights = sights_of(views, sigma_px=1.0, keypoint_sigma_m=0.0)  # the noise is estimated from the errors instead
    sight, T = sights[v], len(markers_m)
    towards = markers_m - sight.centre_m[:, None]
    speed = np.gradient(towards / np.linalg.norm(towards, axis=-1, keepdims=True), axis=0)
    time = ((np.arange(T) - 0.5 * (T - 1)) / T)[:, None]
    columns, errors = [], []
    for partner in sights[:v] + sights[v + 1 :]:
        normal = np.cross((sight.centre_m - partner.centre_m)[:, None], partner.rays)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        error, by_frame = (np.sum(vectors * normal, axis=-1) for vectors in (sight.rays, speed))
        is_known = np.isfinite(error) & np.isfinite(by_frame)
        derivatives = (by_frame * time, by_frame, np.ones_like(by_frame))
        columns.append(np.stack(derivatives, axis=-1)[is_known])
        errors.append(error[is_known])
    A, error = np.concatenate(columns), np.concatenate(errors)
    if len(error) < MIN_POINTS:
        return np.nan, np.nan
    weight, scale = np.ones(len(error)), 1.0
    estimate = covariance = np.full((3, 3), np.nan)
    for _ in range(_POINT_ROUNDS):
        covariance = np.linalg.pinv((A * weight[:, None]).T @ A)
        estimate = covariance @ (A * weight[:, None]).T @ error
        rest = error - A @ estimate
        scale = max(float(np.median(np.abs(rest))) / np.sqrt(_MEDIAN_OF_LINE), 1e-12)
        weight = 1.0 / (1.0 + (rest / scale / _ROBUST) ** 2)
    return float(estimate[0]), float(scale * np.sqrt(covariance[0, 0]))
