"""Test fits of several cameras that estimate the lengths and keypoint offsets of an animal."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from recon import load_skeleton
from recon.animal.prior import prior_from_body
from recon.fit import constants, trajectory
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.prediction import predicted_keypoints
from recon.fit.result import TrajectorySolution
from recon.fit.terms import extrinsic_correction
from recon.fit.trajectory import solve_trajectory
from recon.fit.triangulation import smoothed, triangulate_views
from recon.gait.evaluation import aligned
from recon.testing.coverage import coordinate_coverage
from recon.testing.rigs import FPS, random_clip

BODY = load_skeleton("human-25")
VIEWS, TRUE_M = random_clip(BODY, 0.1, 4, 0)


@cache
def solved(count: int, known: bool) -> TrajectorySolution:
    options = TrajectoryOptions(fast=True, lengths_known=known)
    return solve_trajectory(VIEWS[:count], BODY, prior_from_body(BODY), FPS, options)


def left_out_px(xy_px: np.ndarray) -> float:
    """Return the median distance of predicted keypoints from the detections of the last camera, px."""
    return float(np.nanmedian(np.linalg.norm(xy_px - VIEWS[3].xy_px, axis=-1)))


def pose_error_m(solution: TrajectorySolution) -> float:
    return float(np.linalg.norm(aligned(solution.joints_m, TRUE_M) - TRUE_M, axis=-1).mean())


@pytest.mark.slow
def test_a_camera_that_was_left_out_is_predicted_better_than_by_triangulation():
    points_m = smoothed(triangulate_views(VIEWS[:3]), FPS).points_m
    triangulated_px, _ = VIEWS[3].project(np.nan_to_num(points_m))
    triangulated_px[np.isnan(points_m[..., 0])] = np.nan
    free_px, known_px = (left_out_px(predicted_keypoints(solved(3, known), VIEWS[3])[0]) for known in (False, True))
    assert free_px < left_out_px(triangulated_px)
    assert free_px < 0.5 * known_px


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_poses_are_better_and_within_their_intervals(count):
    free = solved(count, False)
    assert pose_error_m(free) < 0.7 * pose_error_m(solved(count, True))
    assert coordinate_coverage(free.joints_m - TRUE_M, free.covariance_m2, 0.9) > 0.85
    centred_m = aligned(free.joints_m, TRUE_M) - TRUE_M
    assert coordinate_coverage(centred_m, free.relative_covariance_m2, 0.9) > 0.85


def test_body_has_the_estimated_lengths():
    free = solved(3, False)
    states = free.states
    np.testing.assert_allclose(free.body.tree.pose(states, free.size).points_m, free.joints_m, atol=1e-9)
    length = {segment.name: np.linalg.norm(segment.offset_m) for segment in free.body.tree.segments}
    nominal = {segment.name: np.linalg.norm(segment.offset_m) for segment in BODY.tree.segments}
    assert length["l_shank"] == pytest.approx(length["r_shank"])
    assert length["l_shank"] != pytest.approx(nominal["l_shank"], rel=1e-3)
    assert BODY.keypoint_offset_m == {}
    assert set(free.body.keypoint_offset_m) == set(BODY.markers)


def test_a_long_clip_has_the_shape_of_a_part(monkeypatch):
    monkeypatch.setattr(trajectory, "SHAPE_S", 0.5 * len(TRUE_M) / FPS)
    options = TrajectoryOptions(fast=True)
    of_part = solve_trajectory(VIEWS[:3], BODY, prior_from_body(BODY), FPS, options)
    assert of_part.shape is not None
    assert of_part.body != solved(3, False).body
    assert pose_error_m(of_part) < 0.8 * pose_error_m(solved(3, True))
    assert coordinate_coverage(of_part.joints_m - TRUE_M, of_part.covariance_m2, 0.9) > 0.85


def test_lengths_are_within_their_intervals():
    shape = solved(3, False).shape
    assert shape is not None
    factors = np.random.default_rng(0).normal(size=len(shape.names)) * np.log1p(0.1)  # as `random_clip` draws them
    true_m = shape.expected_lengths_m * np.exp(factors)
    off = np.abs(shape.lengths_m - true_m) / shape.lengths_sigma_m
    assert np.mean(off < 1.645) > 0.8
    assert np.median(shape.lengths_sigma_m / true_m) < 0.1
    assert shape.offsets_m.shape == shape.offsets_sigma_m.shape == (len(BODY.markers), 3)
    assert np.all(shape.offsets_sigma_m > 0)
    assert solved(3, True).shape is None


def test_rays_still_meet_after_the_size_is_combined_with_its_prior():
    """The lengths and the second camera stay as estimated, so the animal's distance must not change."""
    body = load_skeleton("mouse-top")
    views, _ = random_clip(body, 0.1, 2, 0)
    solution = solve_trajectory(views, body, prior_from_body(body), FPS, TrajectoryOptions(fast=True))
    for view in solution.views:
        off_px = view.project(view.shift_to_exposure(solution.markers_m))[0] - view.xy_px
        np.testing.assert_allclose(np.nanmean(off_px, axis=(0, 1)), 0.0, atol=0.1)


def test_one_camera_keeps_the_lengths_with_more_uncertain_poses():
    free, known = (
        solve_trajectory(
            VIEWS[:1], BODY, prior_from_body(BODY), FPS, TrajectoryOptions(fast=True, lengths_known=is_known)
        )
        for is_known in (False, True)
    )
    np.testing.assert_allclose(free.joints_m, known.joints_m, atol=2e-3)  # the size differs a little
    variances = [np.trace(fit.relative_covariance_m2, axis1=2, axis2=3).mean() for fit in (free, known)]
    assert variances[0] > 1.02 * variances[1]
    assert free.body == BODY


def test_second_camera_has_the_uncertainty_of_a_calibration():
    """The uncertainty of a calibration is not added if the camera's pose is exact, or an unknown of the fit."""
    known, refined = TrajectoryOptions(cameras_known=True), TrajectoryOptions(refine_cameras=True)
    for options, is_uncertain in ((TrajectoryOptions(), True), (known, False), (refined, False)):
        clip = ClipProblem.from_views(VIEWS[:2], BODY, prior_from_body(BODY), FPS, options)
        _, nuisance = clip.shared_unknowns(np.array([0.05, 0.02]))
        sigmas = {unknown.name: unknown.sigma * np.sqrt(clip.correlation_frames) for unknown in nuisance}
        assert (extrinsic_correction(1) in sigmas) == is_uncertain
        if is_uncertain:
            between = np.array([constants.CALIBRATED_RAD] * 3 + [0.02] * 3)
            for camera in range(2):
                np.testing.assert_allclose(sigmas[extrinsic_correction(camera)], constants.SHARE_OF_PAIR * between)
