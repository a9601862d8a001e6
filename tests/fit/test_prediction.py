"""Test the predicted detections of a camera that was left out of the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.clip import still_view
from recon.fit.prediction import log_evidence, predicted_keypoints, smoothed_deviations


def test_deviations_follow_a_gaussian_process():
    random, T, sigma_m, lasting = np.random.default_rng(0), 6, np.array([0.02, 0.05]), np.array([1.5, 9.0])
    rows = random.normal(0, 30, (T, 2, 2, 3))
    rows[2] = 0.0  # nothing was seen in this frame
    information, pull = rows.swapaxes(-1, -2) @ rows, random.normal(size=(T, 2, 3))
    pull[2] = 0.0
    means, covariances = smoothed_deviations(information, pull, sigma_m, lasting)
    evidence = log_evidence(information, pull, np.zeros((T, 2)), sigma_m, lasting)
    steps = np.abs(np.subtract.outer(np.arange(T), np.arange(T)))
    for j in range(2):
        apart = steps / lasting[j]
        prior = np.kron(sigma_m[j] ** 2 * (1 + apart) * np.exp(-apart), np.eye(3))
        precision = np.linalg.inv(prior)
        for t in range(T):
            precision[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] += information[t, j]
        covariance = np.linalg.inv(precision)
        explained, volume = (
            pull[:, j].ravel() @ covariance @ pull[:, j].ravel(),
            np.linalg.slogdet(precision @ prior)[1],
        )
        np.testing.assert_allclose(evidence[j], 0.5 * (explained - volume))
        np.testing.assert_allclose(means[:, j].ravel(), covariance @ pull[:, j].ravel(), atol=1e-10)
        blocks = [covariance[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] for t in range(T)]
        np.testing.assert_allclose(covariances[:, j], blocks, atol=1e-12)


def test_keypoints_that_leave_their_markers_are_followed(two_cameras):
    """Keypoints that are 6 cm above their markers in both cameras are predicted above their markers."""
    solution, seen_m = two_cameras.solution, two_cameras.solution.markers_m + np.array([0.0, 0.0, 0.06])
    views = [replace(v, xy_px=v.project(seen_m)[0], confidence=np.ones(seen_m.shape[:2])) for v in solution.views]
    solution = replace(solution, views=tuple(views), noise_px=np.full_like(solution.noise_px, 10.0))
    camera = replace(two_cameras.camera, translation_m=two_cameras.camera.translation_m + np.array([1.0, 0.0, 2.0]))
    third = still_view(camera, np.full((*seen_m.shape[:2], 2), np.nan), np.zeros(seen_m.shape[:2]))
    true_px, _ = third.project(seen_m)
    errors_px = [
        np.nanmedian(np.linalg.norm(predicted_keypoints(solution, third, fps)[0] - true_px, axis=-1))
        for fps in (None, 30.0)
    ]
    assert errors_px[1] < 0.5 * errors_px[0]
