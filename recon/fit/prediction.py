"""Predict the detections of a camera that was not used in a fit.

**Deviations.** Skin, labels and a skeleton's rigid segments let keypoints deviate from the body's markers for a while.
The deviation d (3,) of each keypoint is modelled as a once differentiable Gaussian process (Matern 3/2), and is
estimated from the detections of all views by a Kalman filter and smoother. The size and the duration of deviations, and
the detections' noise about them, are those with the largest evidence. The noise that a fit estimates includes the
deviations.

**Covariance.** Each view is left out in turn, and predicted from the others. The errors of these predictions give a
factor on all covariances, with which 90 % regions hold 90 % of the detections. The factor accounts for the tails of the
detector's errors and the bias of each camera. The clock of the predicted camera is assumed to be as inaccurate as the
clocks of the views.

References
----------
J. Hartikainen and S. Sarkka, "Kalman filtering and smoothing solutions to temporal Gaussian process regression models",
IEEE International Workshop on Machine Learning for Signal Processing, 2010.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from recon.base.arrays import Array
from recon.clip import View
from recon.fit import constants
from recon.fit.regions import radius
from recon.fit.result import Solution, TrajectorySolution

LEVEL = 0.9
"""Probability of the regions that are calibrated on the detections of the solution's own views."""
DEVIATIONS = 0.25, 0.5, 1.0, 2.0, 4.0, 8.0
"""Candidates for the standard deviation of a keypoint's deviations, as multiples of the detections' noise."""
LASTING_S = 0.03, 0.08, 0.25, 1.0, 4.0
"""Candidates for the duration of a keypoint's deviations, s."""
NOISE_FRACTIONS = 0.35, 0.5, 0.7, 1.0
"""Candidates for the variance of the detections' noise about the deviations, as fractions of the fit's variance."""
SHARED_EVIDENCE_WEIGHT = 1.0
"""Weight of the mean evidence of all keypoints in the choice for one keypoint, relative to its own evidence."""


def predicted_keypoints(solution: Solution, view: View, fps: float | None = None) -> tuple[Array, Array]:
    """Return the keypoints that a view would detect, with their covariances.

    Parameters
    ----------
    solution
        The motion of T frames with J keypoints.
    view
        A camera on the same frames, whose detections are not read.
    fps
        Frames per second; None to leave out deviations of keypoints from the body's markers.

    Returns
    -------
    xy_px : (T, J, 2) array
        Predicted keypoints, pixels; NaN without a pose.
    covariance_px2 : (T, J, 2, 2) array
        Covariances of detections about `xy_px`, px^2. The covariances include the uncertainty of the keypoints in 3D,
        and the noise of detections in the solution's views, scaled to the distance from this view.
    """
    markers_m, covariance_m2 = solution.markers_m, solution.covariance_m2
    if fps is None or len(solution.views) == 1 or not solution.posed.any():
        scale = max(1.0, np.sqrt(_tail_factor(solution)))
        return _predicted(solution, view, markers_m, covariance_m2, scale)
    residuals = [_Residuals.of_view(solution, number) for number in range(len(solution.views))]
    deviation, deviation_m2, factor = _deviations(solution, residuals, fps)
    xy_px, covariance_px2 = _predicted(solution, view, markers_m + deviation, covariance_m2 + deviation_m2, 1.0)
    late_px = _time_offset_frames(solution) * _change_per_frame(xy_px)
    return xy_px, factor * covariance_px2 + late_px[..., :, None] * late_px[..., None, :]


def _time_offset_frames(solution: Solution) -> float:
    """Return the root mean square time offset of the views, uncertainty included, in frames; 0 if not estimated."""
    if not isinstance(solution, TrajectorySolution):
        return 0.0
    return float(np.sqrt(np.mean(solution.time_offset_frames**2 + solution.time_offset_sigma_frames**2)))


def _change_per_frame(xy_px: Array) -> Array:
    """Return the change of positions (T, J, 2) per frame, pixels; 0 if unknown."""
    return np.nan_to_num(np.gradient(xy_px, axis=0)) if len(xy_px) > 1 else np.zeros_like(xy_px)


def _predicted(solution: Solution, view: View, points_m: Array, points_m2: Array, scale: float) -> tuple[Array, Array]:
    is_posed = np.isfinite(points_m[..., 0])
    projected, by_point, valid = view.project_with_jacobian(view.shift_to_exposure(np.nan_to_num(points_m)))
    noise_px = scale * _noise_m(solution)[..., None, None] * _px_per_m(view, points_m)[..., None, None]
    covariance = by_point @ points_m2 @ by_point.swapaxes(-1, -2) + noise_px**2 * np.eye(2)
    return np.where((is_posed & valid)[..., None], projected, np.nan), covariance


def _tail_factor(solution: Solution) -> float:
    """Return the factor on the noise's variance with which 90 % regions contain 90 % of the views' detections.

    The fit's own noise ignores the tails of the detector's errors, because of the robust loss.
    """
    squares = []
    for view in solution.views:
        projected, covariance = _predicted(solution, view, solution.markers_m, solution.covariance_m2, 1.0)
        squares.append(_whitened_squares(projected - view.xy_px, covariance))
    return _level_factor(np.concatenate(squares))


def _whitened_squares(error: Array, covariance: Array) -> Array:
    """Return the squares e' S^-1 e (n,) of the n known errors e (..., 2) with covariances S (..., 2, 2)."""
    is_known = np.isfinite(error[..., 0]) & np.isfinite(covariance).all(axis=(-2, -1))
    whitened = np.linalg.solve(covariance[is_known], error[is_known][..., None])[..., 0]
    return np.asarray(np.sum(error[is_known] * whitened, axis=-1))


def _level_factor(squares: Array) -> float:
    return float(np.quantile(squares, LEVEL)) / radius(LEVEL, 2) ** 2 if len(squares) else 1.0


def _px_per_m(view: View, markers_m: Array) -> Array:
    distance_m = np.linalg.norm(markers_m - view.centre_m[:, None], axis=-1)
    return np.asarray(np.reshape(view.focal_px, (-1, 1)) / distance_m)


def _noise_m(solution: Solution) -> Array:
    """Return the detections' noise at the keypoints' distance, the median over all views, shape (T, J), m."""
    noise_m = [
        noise_px / _px_per_m(view, solution.markers_m)
        for view, noise_px in zip(solution.views, solution.noise_px, strict=True)
    ]
    with warnings.catch_warnings(action="ignore"):  # numpy warns of frames that have no pose
        return np.asarray(np.nanmedian(noise_m, axis=0))


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Reprojection errors of one view of T frames with J keypoints, before deviations are estimated."""

    error_px: Array
    """Detections minus projected markers, 0 if missing, shape (T, J, 2)."""
    by_point: Array
    """Derivatives of the projections with respect to the markers, px/m, shape (T, J, 2, 3)."""
    noise_px: Array
    """Standard deviation of the detections, shape (T, J)."""
    weight: Array
    """Weights under the robust loss, 0 if missing, shape (T, J)."""

    @classmethod
    def of_view(cls, solution: Solution, number: int) -> _Residuals:
        """Return the reprojection errors in the view of a solution with the index `number`."""
        view, noise_px = solution.views[number], solution.noise_px[number]
        markers_m = solution.markers_m
        projected, by_point, valid = view.project_with_jacobian(view.shift_to_exposure(np.nan_to_num(markers_m)))
        known = valid & view.present & np.isfinite(markers_m[..., 0]) & np.isfinite(noise_px)
        error_px, noise_px = np.where(known[..., None], view.xy_px - projected, 0.0), np.where(known, noise_px, 1.0)
        square = np.sum(error_px**2, axis=-1) / (constants.ROBUST_C * noise_px) ** 2
        return cls(error_px, by_point, noise_px, np.where(known, 1.0 / (1.0 + square), 0.0))

    @property
    def information(self) -> Array:
        """Return the precision (T, J, 3, 3) that the detections give the keypoints' deviations, 1/m^2."""
        weighted = self.by_point * (self.weight / self.noise_px**2)[..., None, None]
        return np.asarray(weighted.swapaxes(-1, -2) @ self.by_point)

    @property
    def pull(self) -> Array:
        """Return the precision times the deviations that the detections show, (T, J, 3), 1/m."""
        weighted = self.by_point * (self.weight / self.noise_px**2)[..., None, None]
        return np.asarray((weighted.swapaxes(-1, -2) @ self.error_px[..., None])[..., 0])

    @property
    def square(self) -> Array:
        """Return the weighted squared errors if keypoints did not deviate from the markers, (T, J)."""
        return np.asarray(self.weight * np.sum(self.error_px**2, axis=-1) / self.noise_px**2)

    def off_px(self, deviation: Array) -> Array:
        """Return the errors (..., T, J, 2), px, that remain after deviations (..., T, J, 3), m; NaN if missing."""
        remaining_px = self.error_px - (self.by_point @ deviation[..., None])[..., 0]
        return np.where(self.weight[..., None] > 0, remaining_px, np.nan)


def _deviations(solution: Solution, residuals: list[_Residuals], fps: float) -> tuple[Array, Array, float]:
    """Return deviations (T, J, 3) in m, their covariances (T, J, 3, 3), and the factor on predicted covariances."""
    information = np.array([residual.information for residual in residuals])
    pull = np.array([residual.pull for residual in residuals])
    total, total_pull = information.sum(axis=0), pull.sum(axis=0)
    sigma_m, lasting_frames, noise_share = _likeliest_process(solution, residuals, total, total_pull, fps)
    information, total = information / noise_share[:, None, None], total / noise_share[:, None, None]
    pull, total_pull = pull / noise_share[:, None], total_pull / noise_share[:, None]
    squares = []
    for number, (residual, view) in enumerate(zip(residuals, solution.views, strict=True)):
        by_rest = total - information[number], total_pull - pull[number]
        deviation, deviation_m2 = smoothed_deviations(*by_rest, sigma_m, lasting_frames)
        _, covariance = _predicted(
            solution, view, solution.markers_m + deviation, solution.covariance_m2 + deviation_m2, 1.0
        )
        squares.append(_whitened_squares(residual.off_px(deviation), covariance))
    return (
        *smoothed_deviations(total, total_pull, sigma_m, lasting_frames),
        _level_factor(np.concatenate(squares)),
    )


def _likeliest_process(
    solution: Solution, residuals: list[_Residuals], information: Array, pull: Array, fps: float
) -> tuple[Array, Array, Array]:
    """Return the deviations' standard deviation (J,) in m, duration (J,) in frames, and the noise's factor (J,)."""
    with warnings.catch_warnings(action="ignore"):  # numpy warns of keypoints that have no pose
        noise_m = np.nan_to_num(np.nanmedian(_noise_m(solution), axis=0), nan=1e-3)
    shares, lasting_s = np.array([(0.0, LASTING_S[0]), *product(DEVIATIONS, LASTING_S)]).T
    sigma_m, lasting_frames = shares[:, None] * noise_m, np.repeat(fps * lasting_s[:, None], len(noise_m), axis=1)
    square = np.sum([residual.square for residual in residuals], axis=0)
    seen = np.sum([residual.weight for residual in residuals], axis=(0, 1))
    evidence = np.array(
        [
            log_evidence(information / fraction, pull / fraction, square / fraction, sigma_m, lasting_frames)
            - seen * np.log(fraction)
            for fraction in NOISE_FRACTIONS
        ]
    ).reshape(-1, len(noise_m))
    best = np.argmax(evidence + SHARED_EVIDENCE_WEIGHT * evidence.mean(axis=1, keepdims=True), axis=0)
    noise_number, number = np.divmod(best, len(shares))
    return shares[number] * noise_m, fps * lasting_s[number], np.array(NOISE_FRACTIONS)[noise_number]


def log_evidence(information: Array, pull: Array, square: Array, sigma_m: Array, lasting_frames: Array) -> Array:
    """Return the log-likelihood (..., J) of the detections, given the size and duration of the deviations.

    Terms that depend on neither the size nor the duration are left out.

    Parameters
    ----------
    information, pull, square
        Precision of the deviations (T, J, 3, 3), 1/m^2, the precision times the deviations (T, J, 3), 1/m, and the
        squared errors without deviations (T, J).
    sigma_m, lasting_frames
        Standard deviation (m) and duration (frames) of the deviations, (..., J) each.
    """
    total = np.zeros(np.shape(sigma_m))
    for t, (mean, covariance, _, _) in enumerate(_filtered(information, pull, sigma_m, lasting_frames)):
        deviation, spread = mean[..., :3, None], covariance[..., :3, :3]
        error = pull[t][..., None] - information[t] @ deviation
        growth = np.eye(3) + information[t] @ spread
        explained = error.swapaxes(-1, -2) @ spread @ np.linalg.solve(growth, error)
        remaining = square[t][..., None, None] - deviation.swapaxes(-1, -2) @ (pull[t][..., None] + error)
        total -= 0.5 * ((remaining - explained)[..., 0, 0] + np.linalg.slogdet(growth)[1])
    return total


def smoothed_deviations(
    information: Array, pull: Array, sigma_m: Array, lasting_frames: Array | float
) -> tuple[Array, Array]:
    """Return the smoothed deviations (T, J, 3) of keypoints, with their covariances (T, J, 3, 3).

    Parameters
    ----------
    information, pull
        Precision of the deviations due to the detections of each frame, (T, J, 3, 3), 1/m^2, and this precision times
        the deviations, (T, J, 3), 1/m.
    sigma_m
        Expected standard deviation of the deviations along each axis, (J,), m.
    lasting_frames
        Duration of the deviations in frames, (J,), or one number for all keypoints. The correlation of two frames that
        are t durations apart is (1 + t) exp(-t).
    """
    transition = _transition(np.broadcast_to(lasting_frames, pull.shape[1:2]))
    steps = [*_filtered(information, pull, sigma_m, lasting_frames)]
    mean, covariance = steps[-1][2:]
    means, covariances = [mean], [covariance]
    for (_, _, filtered, filtered_m2), (predicted, predicted_m2, _, _) in zip(steps[-2::-1], steps[:0:-1], strict=True):
        gain = np.linalg.solve(predicted_m2, transition @ filtered_m2).swapaxes(-1, -2)
        mean = filtered + (gain @ (mean - predicted)[..., None])[..., 0]
        covariance = filtered_m2 + gain @ (covariance - predicted_m2) @ gain.swapaxes(-1, -2)
        means.append(mean)
        covariances.append(covariance)
    return np.array(means[::-1])[..., :3], np.array(covariances[::-1])[..., :3, :3]


def _filtered(
    information: Array, pull: Array, sigma_m: Array, lasting_frames: Array | float
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield the mean (..., J, 6) and covariance of every frame, before and after the frame's detections.

    The six unknowns are the deviation, m, and its velocity times the duration.
    """
    transition = _transition(np.broadcast_to(lasting_frames, np.shape(sigma_m)))
    stationary = np.maximum(sigma_m, 1e-9)[..., None, None] ** 2 * np.eye(6)
    innovation = stationary - transition @ stationary @ transition.swapaxes(-1, -2)
    mean, covariance = np.zeros(stationary.shape[:-1]), stationary
    for t in range(len(pull)):
        if t:
            mean = (transition @ mean[..., None])[..., 0]
            covariance = transition @ covariance @ transition.swapaxes(-1, -2) + innovation
        prediction = mean, covariance
        gain = covariance[..., :3] @ np.linalg.inv(np.eye(3) + information[t] @ covariance[..., :3, :3])
        error = pull[t][..., None] - information[t] @ mean[..., :3, None]
        mean = mean + (gain @ error)[..., 0]
        covariance = covariance - gain @ information[t] @ covariance[..., :3, :]
        covariance = 0.5 * (covariance + covariance.swapaxes(-1, -2))
        yield (*prediction, mean, covariance)


def _transition(lasting_frames: Array) -> Array:
    """Return the matrices (..., 6, 6) that take the state of `_filtered` to the next frame."""
    rate = 1.0 / np.asarray(lasting_frames, dtype=float)
    plane = np.moveaxis(np.exp(-rate) * np.array([[1.0 + rate, rate], [-rate, 1.0 - rate]]), (0, 1), (-2, -1))
    return np.einsum("...ab,cd->...acbd", plane, np.eye(3)).reshape(*rate.shape, 6, 6)
