"""Tests of the explanations of two cameras' poses."""

from __future__ import annotations

import numpy as np
import pytest

from recon.animal.prior import load_prior
from recon.fit import constants
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.least_squares import LeastSquares, SharedUnknown
from recon.fit.pair_poses import PairPoses, with_uncertain_poses
from recon.fit.posterior import pair_poses_of, with_reestimated_noise
from recon.fit.terms import SIZE, Reprojection, extrinsic_correction
from recon.fit.trajectory import solve_segments

USUAL_RAD = constants.SHARE_OF_PAIR * constants.CALIBRATED_RAD
USUAL = np.tile([*[USUAL_RAD] * 3, *[0.03] * 3], 2)
"""Usual standard deviations of the errors of two poses."""
PAN, SECOND_PAN = 1, 7
"""Turns of the first and of the second camera about their vertical axis, among the twelve errors."""


def likelihood(measured: dict[int, float], sigma_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the precision and the gradient of errors that were measured, each on its own."""
    precision, pull = np.zeros((12, 12)), np.zeros(12)
    for index, value in measured.items():
        precision[index, index], pull[index] = sigma_rad**-2, -value * sigma_rad**-2
    return precision, pull


def test_poses_that_nothing_shows_are_as_likely_turned_as_expected():
    poses = PairPoses.weigh(np.zeros((12, 12)), np.zeros(12), USUAL)
    shares = np.tensordot(poses.weight, poses.is_turned, axes=1)
    assert shares == pytest.approx(np.full((2, 3), constants.TURNED_SHARE))
    variance = constants.TURNED_SHARE * constants.MISPLACED_RAD**2 + (1 - constants.TURNED_SHARE) * USUAL_RAD**2
    assert np.diagonal(poses.covariance_about(np.zeros(12)))[[0, 1, 8]] == pytest.approx(np.full(3, variance))
    assert not poses.first_is_turned
    turned, usual = poses.rotations_rad()[1], poses.rotations_rad()[0]
    assert usual == pytest.approx(np.full(3, USUAL_RAD))
    assert turned == pytest.approx(np.full(3, np.sqrt(2 * variance - USUAL_RAD**2)))


def test_a_turn_that_the_detections_show_is_that_of_its_camera():
    measured = dict.fromkeys(range(12), 0.0)
    for index, is_first in ((PAN, True), (SECOND_PAN, False)):
        poses = PairPoses.weigh(*likelihood(measured | {index: np.radians(3.0)}, np.radians(0.1)), USUAL)
        expected = poses.weight @ poses.mean
        assert np.degrees(expected[index]) == pytest.approx(3.0, abs=0.01)
        assert np.degrees(expected[PAN + SECOND_PAN - index]) == pytest.approx(0.0, abs=0.01)
        assert poses.first_is_turned is is_first
        assert poses.rotations_rad()[0 if is_first else 1, 1] > 0.99 * constants.MISPLACED_RAD


def test_if_it_is_open_which_camera_is_turned_the_first_defines_the_world_and_both_are_uncertain():
    """Only the difference of the two pans is measured."""
    difference = np.zeros(12)
    difference[[PAN, SECOND_PAN]] = -1.0, 1.0
    precision, angle_rad = np.outer(difference, difference) * np.radians(0.1) ** -2, np.radians(3.0)
    poses = PairPoses.weigh(precision, -angle_rad * difference * np.radians(0.1) ** -2, USUAL)
    first_rad, second_rad = poses.rotations_rad()
    assert not poses.first_is_turned
    assert first_rad[1] == pytest.approx(USUAL_RAD)
    assert second_rad[1] == pytest.approx(constants.MISPLACED_RAD, rel=0.01)
    value = angle_rad * np.eye(12)[SECOND_PAN]
    sigma_deg = np.degrees(np.sqrt(np.diagonal(poses.covariance_about(value))))
    assert sigma_deg[PAN] == pytest.approx(sigma_deg[SECOND_PAN], rel=0.05)
    assert 1.8 < sigma_deg[PAN] < 2.3  # 3 degrees or 0, as likely


def test_the_poses_of_a_problem_become_as_uncertain_as_all_explanations_leave_them():
    names, correlation = [extrinsic_correction(0), extrinsic_correction(1)], 4.0
    unknowns = [SharedUnknown(SIZE, np.ones(1), np.array([0.1]))]
    unknowns += [SharedUnknown(name, np.zeros(6), USUAL[:6] / np.sqrt(correlation)) for name in names]
    problem = LeastSquares(None, [], [], unknowns)  # pyright: ignore[reportArgumentType]
    random = np.random.default_rng(0)
    rows = random.normal(size=(20, 13))
    S = 1e4 * rows.T @ rows + np.diag(np.concatenate([unknown.sigma for unknown in unknowns]) ** -2.0)
    shared, gradient = problem.expected(), np.zeros(13)
    changed = with_uncertain_poses(problem, shared, (S, gradient), correlation)
    before, after = np.linalg.inv(S), np.linalg.inv(changed)
    prior = np.diag(unknowns[1].sigma.tolist() * 2) ** 2
    likelihood_precision = np.linalg.inv(before[1:, 1:]) - np.linalg.inv(prior)
    poses = PairPoses.weigh(likelihood_precision / correlation, np.zeros(12), USUAL)
    np.testing.assert_allclose(correlation * after[1:, 1:], poses.covariance_about(np.zeros(12)), rtol=1e-6, atol=1e-15)
    by_poses = np.linalg.solve(before[1:, 1:], before[1:, 0])  # the size follows the poses as before
    np.testing.assert_allclose(np.linalg.solve(after[1:, 1:], after[1:, 0]), by_poses, rtol=1e-5, atol=1e-9)


def test_a_first_camera_that_defines_the_world_stays_certain():
    unknown = SharedUnknown(extrinsic_correction(1), np.zeros(6), USUAL[:6])
    problem = LeastSquares(None, [], [], [unknown])  # pyright: ignore[reportArgumentType]
    S = np.diag(unknown.sigma**-2.0)
    assert with_uncertain_poses(problem, problem.expected(), (S, np.zeros(6)), 1.0) is S


def test_the_noise_of_detections_does_not_depend_on_how_far_a_camera_may_be_turned(two_cameras, monkeypatch):
    solution, body = two_cameras.solution, two_cameras.body
    prior = load_prior(solution.prior, body)
    clip = ClipProblem.from_views(solution.views, body, prior, two_cameras.fps, TrajectoryOptions(fast=True))
    (segment,) = solve_segments(clip)
    assert pair_poses_of(segment.problem, segment.estimate, clip.correlation_frames) is not None

    def confidence() -> np.ndarray:
        problem = with_reestimated_noise(segment.problem, segment.estimate, clip.correlation_frames)
        return next(term.view.confidence for term in problem.terms if isinstance(term, Reprojection))

    usual = confidence()
    monkeypatch.setattr(constants, "MISPLACED_RAD", 0.3)
    np.testing.assert_array_equal(confidence(), usual)
