"""Triangulate keypoints seen by several cameras, without a skeleton.

The method is robust to outliers, gives covariances, and leaves gaps where a point is not determined.

**Start.** Every pair of cameras that saw a keypoint in a frame gives a point, the middle of the shortest line between
the two rays. Each such point is scored by its reprojection into all cameras, with squared errors cut off at
`OUTLIER_SIGMAS` standard deviations (MSAC; Torr and Zisserman 2000), and the best one is the start. All V (V - 1) / 2
pairs of V cameras are tried, so the result does not depend on random numbers.

**Minimum.** Gauss-Newton steps minimise the reprojection errors in the distorted pictures, with Cauchy's weights at
first. Detections with errors above `OUTLIER_SIGMAS` standard deviations are then left out, and the others get their
full weight. If fewer than two detections remain, or the rays are nearly parallel, the point is a gap (NaN).

**Noise.** The detector's noise is estimated for each keypoint from the remaining errors, divided by their degrees of
freedom, and all steps are repeated with it.

**Covariance.** The covariance of a point is the inverse of J' J / sigma^2 of the remaining detections. The covariance
is multiplied by the mean squared error of the detections, in standard deviations, if this is above 1.

**Smoothing.** Optionally, cubic smoothing splines are fitted over time, one for each coordinate, weighted by the
points' standard deviations. The smoothness is chosen by generalised cross-validation (Craven and Wahba 1979). Points
far off the spline lose their weight, and short gaps are filled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from recon.base.arrays import Array, Bools, Brief, Index
from recon.clip import View

OUTLIER_SIGMAS = 3.5
"""Maximum distance of an inlier detection from the reprojected point, in standard deviations."""
SIGMAS_PX = (0.3, 12.0)
"""Minimum and maximum of the estimated noise of a keypoint, as a standard deviation in pixels."""
MIN_CROSSING_RAD = np.radians(1.0)
"""Minimum angle (rad) between two rays that determine a point."""
BRIDGED_S = 0.2
"""Maximum length of a gap that a spline fills, s."""
_CAUCHY_ROUNDS = 4
"""Number of Gauss-Newton steps with Cauchy's weights, with which outliers hardly count."""
_FINAL_ROUNDS = 3
"""Number of Gauss-Newton steps with full weights, without outliers."""
_NOISE_ROUNDS = 2
"""Number of rounds that estimate the detector's noise."""
_SPLINE_ROUNDS = 3
"""Number of rounds that adapt the weights of a spline's points."""
_MEDIAN_OF_CHI_SQUARE = 1.3863
"""Median of a detection's squared error over its variance if several rays meet (chi square, two degrees of freedom)."""
_MEDIAN_OF_TWO_RAYS = 0.9099
"""Median of a detection's squared error over its variance if two rays meet, which leave one degree of freedom."""
_LEAST_OF_KEYPOINT = 20
"""Minimum number of detections required to estimate a keypoint's own noise."""
_LEAST_INFORMATION = 1e-2
"""Information on each coordinate of a point (m^-2) without detections, a standard deviation of 10 m."""
_MIN_KNOTS = 6
"""Minimum number of points required to fit a spline."""


@dataclass(frozen=True, eq=False, repr=False)
class Triangulation(Brief):
    """Points of T frames and J keypoints, triangulated from V cameras."""

    points_m: Array
    """Points in the world, metres, shape (T, J, 3); NaN if unknown."""
    covariance_m2: Array
    """Covariances of the points along the world's axes, m^2, shape (T, J, 3, 3)."""
    is_used: Bools
    """Mask of the detections that contributed to the points, shape (V, T, J)."""
    error_px: Array
    """Distance of each detection from the point's reprojection, px, shape (V, T, J); NaN if either is missing."""
    sigma_px: Array
    """Standard deviation of the noise of each keypoint's detections, px, shape (J,)."""

    @property
    def sigma_m(self) -> Array:
        """Return the standard deviations of the points along the world's axes, m, (T, J, 3)."""
        return np.sqrt(np.diagonal(self.covariance_m2, axis1=2, axis2=3))


def triangulate_views(views: Sequence[View], sigma_px: float = 3.0) -> Triangulation:
    """Return the points at which the rays of several views meet.

    Parameters
    ----------
    views
        V >= 2 views of the same T frames and J keypoints, in one world.
    sigma_px
        Expected noise of the detections in pixels, from which the noise of each keypoint is estimated.

    Raises
    ------
    ValueError
        If there is only one view.

    References
    ----------
    P. H. S. Torr and A. Zisserman, "MLESAC", Computer Vision and Image Understanding 78, 2000.
    """
    if len(views) < 2:
        raise ValueError("there is one view, but triangulation needs two or more")
    views = [_at_frame_times(view.mask_outside_image()) for view in views]
    sigma = np.full(views[0].xy_px.shape[1], float(sigma_px))
    result = _triangulated(views, sigma)
    for _ in range(_NOISE_ROUNDS):
        sigma = _estimate_noise(result, sigma, sigma_px)
        result = _triangulated(views, sigma)
    return result


def _at_frame_times(view: View) -> View:
    """Return a view whose keypoints are interpolated to the clip's frame times."""
    fraction = view.offset_frames
    if not fraction:
        return view
    earlier = np.concatenate([np.full_like(view.xy_px[:1], np.nan), view.xy_px[:-1]])
    xy_px = fraction * earlier + (1.0 - fraction) * view.xy_px
    confidence = np.where(np.isfinite(xy_px[..., 0]), view.confidence, 0.0)
    return replace(view, xy_px=xy_px, confidence=confidence, offset_frames=0.0)


def _triangulated(views: Sequence[View], sigma: Array) -> Triangulation:
    """Triangulate the keypoints of several views, leaving out outliers, for a noise `sigma` (J,) in pixels."""
    present = np.array([view.present for view in views])
    points = _best_of_pairs(views, present, sigma)
    for _ in range(_CAUCHY_ROUNDS):
        error, by_point, valid = _errors(views, points, sigma)
        square = np.sum(error**2, axis=-1)
        weight = np.where(present & valid, 1.0 / (1.0 + square / OUTLIER_SIGMAS**2), 0.0)
        points = points + _gauss_newton_step(error, by_point, weight)
    error, by_point, valid = _errors(views, points, sigma)
    square = np.sum(error**2, axis=-1)
    is_used = present & valid & (square < OUTLIER_SIGMAS**2)
    for _ in range(_FINAL_ROUNDS):
        points = points + _gauss_newton_step(error, by_point, is_used.astype(float))
        error, by_point, valid = _errors(views, points, sigma)
    square = np.sum(error**2, axis=-1)
    is_used &= valid & (square < (1.5 * OUTLIER_SIGMAS) ** 2)
    is_known = (is_used.sum(axis=0) >= 2) & _rays_cross(views, points, is_used) & np.isfinite(points).all(axis=-1)
    is_used &= is_known
    covariance = _covariance(by_point, square, is_used)
    points = np.where(is_known[..., None], points, np.nan)
    covariance = np.where(is_known[..., None, None], covariance, np.nan)
    error_px = np.where(present & valid & is_known, np.sqrt(square) * sigma, np.nan)
    return Triangulation(points, covariance, is_used, error_px, sigma)


def _best_of_pairs(views: Sequence[View], present: Bools, sigma: Array) -> Array:
    """Return the points (T, J, 3), each from the pair of cameras whose point fits all cameras best."""
    rays = [view.rays() for view in views]
    centres = [view.centre_m[:, None] for view in views]
    best_points, best_cost = np.full((*present.shape[1:], 3), np.nan), np.full(present.shape[1:], np.inf)
    for a, b in combinations(range(len(views)), 2):
        points = _between_rays(rays[a], centres[a], rays[b], centres[b])
        if not np.isfinite(points[..., 0]).any():
            continue
        error, _, valid = _errors(views, points, sigma, derivatives=False)
        square = np.where(valid, np.sum(error**2, axis=-1), np.inf)
        cost = np.sum(np.where(present, np.minimum(square, OUTLIER_SIGMAS**2), 0.0), axis=0)
        cost = np.where(np.isfinite(points[..., 0]), cost, np.inf)
        better = cost < best_cost
        best_points[better], best_cost[better] = points[better], cost[better]
    return best_points


def _between_rays(ray_a: Array, centre_a: Array, ray_b: Array, centre_b: Array) -> Array:
    """Return the middles (T, J, 3) of the shortest lines between rays, NaN for parallel or diverging rays."""
    line = centre_b - centre_a
    cosine = np.sum(ray_a * ray_b, axis=-1)
    along_a, along_b = np.sum(ray_a * line, axis=-1), np.sum(ray_b * line, axis=-1)
    square_sine = 1.0 - cosine**2
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_a = (along_a - cosine * along_b) / square_sine
        depth_b = (cosine * along_a - along_b) / square_sine
        crosses = (square_sine > np.sin(MIN_CROSSING_RAD) ** 2) & (depth_a > 0) & (depth_b > 0)
    middle = 0.5 * (centre_a + depth_a[..., None] * ray_a + centre_b + depth_b[..., None] * ray_b)
    return np.where(crosses[..., None], middle, np.nan)


def _errors(views: Sequence[View], points: Array, sigma: Array, derivatives: bool = True) -> tuple[Array, Array, Bools]:
    """Return reprojection errors in standard deviations, their derivatives, and a mask of the points in view.

    The shapes are (V, T, J, 2), (V, T, J, 2, 3) and (V, T, J). Derivatives are with respect to the points. Missing
    detections have an error of 0.
    """
    errors, by_points, valids = [], [], []
    known = np.asarray(np.isfinite(points).all(axis=-1))
    safe = np.where(known[..., None], points, 0.0)
    for view in views:
        if derivatives:
            projected, by_point, valid = view.project_with_jacobian(safe)
            by_points.append(np.nan_to_num(by_point) / sigma[:, None, None])
        else:
            projected, valid = view.project(safe)
        is_seen = view.present & valid & known
        errors.append(np.where(is_seen[..., None], (projected - view.xy_px) / sigma[:, None], 0.0))
        valids.append(valid & known)
    return np.array(errors), np.array(by_points), np.array(valids)


def _gauss_newton_step(error: Array, by_point: Array, weight: Array) -> Array:
    """Return the Gauss-Newton step of points (T, J, 3) in metres, 0 if fewer than two detections have a weight."""
    weighted = by_point * weight[..., None, None]
    normal = np.sum(weighted.swapaxes(-1, -2) @ by_point, axis=0)
    pull = np.sum(weighted.swapaxes(-1, -2) @ error[..., None], axis=0)
    scale = np.trace(normal, axis1=-2, axis2=-1)[..., None, None]
    regular = normal + (1e-9 * scale + 1e-12) * np.eye(3)
    step = -np.linalg.solve(regular, pull)[..., 0]
    is_determined = (weight > 0).sum(axis=0) >= 2
    return np.where(is_determined[..., None] & np.isfinite(step), step, 0.0)


def _rays_cross(views: Sequence[View], points: Array, is_used: Bools) -> Bools:
    """Return a mask (T, J) of the points for which two used rays cross at `MIN_CROSSING_RAD` or more."""
    to_points = [points - view.centre_m[:, None] for view in views]
    with np.errstate(invalid="ignore", divide="ignore"):
        rays = [arm / np.linalg.norm(arm, axis=-1, keepdims=True) for arm in to_points]
    crosses = np.zeros(points.shape[:2], dtype=bool)
    for a, b in combinations(range(len(views)), 2):
        sine = np.linalg.norm(np.cross(rays[a], rays[b]), axis=-1)
        crosses |= is_used[a] & is_used[b] & (sine > np.sin(MIN_CROSSING_RAD))
    return crosses


def _covariance(by_point: Array, square: Array, is_used: Bools) -> Array:
    """Return the points' covariances (T, J, 3, 3) in m^2, increased if errors are larger than the noise explains."""
    weighted = by_point * is_used[..., None, None]
    normal = np.sum(weighted.swapaxes(-1, -2) @ by_point, axis=0)
    scale = np.maximum(np.trace(normal, axis1=-2, axis2=-1), 1e-12)[..., None, None]
    covariance = np.linalg.inv(normal + 1e-9 * scale * np.eye(3))
    freedom = np.maximum(2 * is_used.sum(axis=0) - 3, 1)
    factor = np.maximum(np.sum(square * is_used, axis=0) / freedom, 1.0)
    return np.asarray(covariance * factor[..., None, None], dtype=float)


def _estimate_noise(result: Triangulation, sigma: Array, expected_px: float) -> Array:
    """Return the noise of each keypoint's detections, from the median of the used detections' errors, (J,), px."""
    count = result.is_used.sum(axis=0)
    freedom = np.where(count >= 2, (2 * count - 3) / np.maximum(2 * count, 1), np.nan)
    median = np.where(count > 2, _MEDIAN_OF_CHI_SQUARE, _MEDIAN_OF_TWO_RAYS)
    with np.errstate(invalid="ignore"):
        square = result.error_px**2 / freedom / median
    is_counted = np.isfinite(square) & (count > 2)  # two rays show errors along one direction only
    if not is_counted.any():
        is_counted = np.isfinite(square)
    everything = square[is_counted]
    if not len(everything):
        return sigma
    overall = float(np.median(everything))
    estimates = np.empty(len(sigma))
    for j in range(len(sigma)):
        joint_squares = square[:, :, j][is_counted[:, :, j]]
        estimates[j] = np.median(joint_squares) if len(joint_squares) >= _LEAST_OF_KEYPOINT else overall
    return np.clip(np.sqrt(estimates), SIGMAS_PX[0], max(SIGMAS_PX[1], 2 * expected_px))


def predicted_by_others(
    views: Sequence[View], points_m: Array, sigma_px: Sequence[Array]
) -> Iterator[tuple[Array, Array]]:
    """Yield, for each view, where the other views predict its keypoints to be, and the standard deviations.

    Points are triangulated from the other views by one Gauss-Newton step with Cauchy's weights from given points. The
    step removes the influence that the view itself had on these points.

    Parameters
    ----------
    views
        V views of the same T frames and J keypoints, in one world.
    points_m
        The given points, such as the markers of a fit of all views, metres, shape (T, J, 3).
    sigma_px
        Noise of the detections of each of the V views, pixels, shape (T, J).

    Yields
    ------
    predicted_px : array, shape (T, J, 2)
        Predicted keypoints at the times of the view's pictures, NaN unless two other views agree with the given
        point within `OUTLIER_SIGMAS`.
    predicted_sigma_px : array, shape (T, J)
        Standard deviation of the prediction, the root mean square of both axes.
    """
    shape = points_m.shape
    normals, pulls, counts = np.zeros((*shape, 3)), np.zeros(shape), np.zeros(shape[:2], dtype=int)
    for view, noise_px in zip(views, sigma_px, strict=True):
        normal, pull, is_inlier = _normal_equations(view, points_m, noise_px)
        normals += normal
        pulls += pull
        counts += is_inlier
    for view, noise_px in zip(views, sigma_px, strict=True):
        normal, pull, is_inlier = _normal_equations(view, points_m, noise_px)
        is_known = counts - is_inlier >= 2
        information = np.where(is_known[..., None, None], normals - normal, 0.0)
        covariance_m2 = np.linalg.inv(information + _LEAST_INFORMATION * np.eye(3))
        step_m = -(covariance_m2 @ (pulls - pull)[..., None])[..., 0]
        predicted_px, by_point, valid = view.project_with_jacobian(view.shift_to_exposure(points_m + step_m))
        variance_px2 = 0.5 * np.sum((by_point @ covariance_m2) * by_point, axis=(-1, -2))
        is_known &= valid
        yield np.where(is_known[..., None], predicted_px, np.nan), np.where(is_known, np.sqrt(variance_px2), np.nan)


def _normal_equations(view: View, points_m: Array, sigma_px: Array) -> tuple[Array, Array, Bools]:
    """Return J'WJ (T, J, 3, 3) and J'W times the errors (T, J, 3) of a view at given points, and a mask of inliers.

    W are Cauchy's weights. Points that the view does not see have zeros.
    """
    projected, by_point, valid = view.project_with_jacobian(view.shift_to_exposure(points_m))
    error = (projected - view.xy_px) / sigma_px[..., None]
    is_seen = valid & np.isfinite(error[..., 0])
    error = np.where(is_seen[..., None], error, 0.0)
    square = np.sum(error**2, axis=-1)
    weight = 1.0 / (1.0 + square / OUTLIER_SIGMAS**2)
    by_point = np.where(is_seen[..., None, None], by_point / sigma_px[..., None, None], 0.0)
    weighted = (by_point * weight[..., None, None]).swapaxes(-1, -2)
    return weighted @ by_point, (weighted @ error[..., None])[..., 0], is_seen & (square < OUTLIER_SIGMAS**2)


def smoothed(result: Triangulation, fps: float) -> Triangulation:
    """Return the points smoothed by splines over time, with gaps of up to `BRIDGED_S` filled.

    Parameters
    ----------
    result
        The triangulated points.
    fps
        Frames per second.

    Returns
    -------
    Triangulation
        The smoothed points. Their covariances still apply to single frames, and overestimate the splines' errors.
        Filled gaps have the covariances of the nearest known frame.

    References
    ----------
    P. Craven and G. Wahba, "Smoothing noisy data with spline functions", Numerische Mathematik 31, 1979.
    """
    points, covariance = result.points_m.copy(), result.covariance_m2.copy()
    bridged = max(round(BRIDGED_S * fps), 1)
    for j in range(points.shape[1]):
        known = np.flatnonzero(np.isfinite(points[:, j, 0]))
        for frames in np.split(known, np.flatnonzero(np.diff(known) > bridged) + 1):
            if len(frames) < _MIN_KNOTS:
                continue
            sigma = np.sqrt(np.diagonal(covariance[frames, j], axis1=1, axis2=2))
            every = np.arange(frames[0], frames[-1] + 1)
            nearest = frames[np.abs(every[:, None] - frames).argmin(axis=1)]
            points[every, j] = _spline(frames, points[frames, j], sigma, every)
            covariance[every, j] = result.covariance_m2[nearest, j]
    return replace(result, points_m=points, covariance_m2=covariance)


def _spline(frames: Index, values: Array, sigma: Array, every: Index) -> Array:
    """Fit a robust smoothing spline to values (n, 3) at frames (n,), and return its values (m, 3) at other frames."""
    from scipy.interpolate import make_smoothing_spline  # slow to import

    result = np.empty((len(every), 3))
    x, root = frames.astype(float), np.ones(len(frames))
    typical = np.median(sigma, axis=0)
    for _ in range(_SPLINE_ROUNDS):
        squares = np.zeros(len(frames))
        for axis in range(3):
            weight = root * (typical[axis] / np.maximum(sigma[:, axis], 0.3 * typical[axis])) ** 2
            spline = make_smoothing_spline(x, values[:, axis], weight)
            result[:, axis] = spline(every)
            squares += ((values[:, axis] - spline(x)) / sigma[:, axis]) ** 2
        # the median of a chi square variable with three degrees of freedom
        spread = max(float(np.median(squares)) / 2.366, 1e-12)
        root = 1.0 / (1.0 + squares / spread / OUTLIER_SIGMAS**2)
    return result
