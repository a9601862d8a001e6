"""Predict the detections of a camera that a solution was not fitted to."""

from __future__ import annotations

import warnings

import numpy as np

from recon.base.arrays import Array
from recon.clip import View
from recon.fit.posterior import radius
from recon.fit.result import Solution

LEVEL = 0.9
"""Probability of the regions that are calibrated on the detections of the solution's own views."""


def predicted_keypoints(solution: Solution, view: View) -> tuple[Array, Array]:
    """Return the keypoints that a view would detect, with their covariances.

    Parameters
    ----------
    solution
        The motion of T frames with J keypoints.
    view
        A camera on the same frames. Its detections are not read.

    Returns
    -------
    xy_px : (T, J, 2) array
        Pixels, NaN without a pose.
    covariance_px2 : (T, J, 2, 2) array
        Covariances of detections about them: of the keypoints in 3D, and the detections' noise in the solution's
        views, scaled to the distance from this one.
    """
    scale = max(1.0, np.sqrt(_tail_factor(solution)))
    return _predicted(solution, view, scale)


def _predicted(solution: Solution, view: View, scale: float) -> tuple[Array, Array]:
    markers_m = solution.markers_m
    is_posed = np.isfinite(markers_m[..., 0])
    projected, by_point, valid = view.project_with_jacobian(view.shift_to_exposure(np.nan_to_num(markers_m)))
    noise_px = scale * _noise_m(solution)[..., None, None] * _px_per_m(view, markers_m)[..., None, None]
    covariance = by_point @ solution.covariance_m2 @ by_point.swapaxes(-1, -2) + noise_px**2 * np.eye(2)
    return np.where((is_posed & valid)[..., None], projected, np.nan), covariance


def _tail_factor(solution: Solution) -> float:
    """Return the factor on the noise's variance with which 90 % regions hold 90 % of the detections of the views.

    The noise of the fit is that of its robust loss, which leaves out the tails that detectors have.
    """
    squares = []
    for view in solution.views:
        projected, covariance = _predicted(solution, view, 1.0)
        error = projected - view.xy_px
        is_known = np.isfinite(error[..., 0]) & np.isfinite(covariance).all(axis=(-2, -1))
        whitened = np.linalg.solve(covariance[is_known], error[is_known][..., None])[..., 0]
        squares.append(np.sum(error[is_known] * whitened, axis=-1))
    everything = np.concatenate(squares)
    if not len(everything):
        return 1.0
    return float(np.quantile(everything, LEVEL)) / radius(LEVEL, 2) ** 2


def _px_per_m(view: View, markers_m: Array) -> Array:
    distance_m = np.linalg.norm(markers_m - view.centre_m[:, None], axis=-1)
    return np.asarray(np.reshape(view.focal_px, (-1, 1)) / distance_m)


def _noise_m(solution: Solution) -> Array:
    """Return the noise of detections at the keypoints' distance, (T, J): the median over the views, metres."""
    noise_m = [
        noise_px / _px_per_m(view, solution.markers_m)
        for view, noise_px in zip(solution.views, solution.noise_px, strict=True)
    ]
    with warnings.catch_warnings(action="ignore"):  # of frames without a pose
        return np.asarray(np.nanmedian(noise_m, axis=0))
