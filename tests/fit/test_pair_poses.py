"""Test the hypotheses about the poses of two cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.animal.prior import load_prior
from recon.fit import constants
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.least_squares import LeastSquares, SharedUnknown
from recon.fit.pair_poses import PairPoses, pair_poses, with_uncertain_poses
from recon.fit.posterior import pair_poses_of, with_reestimated_noise
from recon.fit.terms import SIZE, Reprojection, extrinsic_correction
from recon.fit.trajectory import solve_segments

USUAL_RAD = constants.SHARE_OF_PAIR * constants.CALIBRATED_RAD
USUAL = np.tile([*[USUAL_RAD] * 3, *[0.03] * 3], 2)
"""Usual standard deviations (12,) of the errors of two poses, rad and m."""
CALIBRATED = constants.WELL_CALIBRATED * USUAL
MISPLACED = np.tile([*[constants.MISPLACED_RAD] * 3, *[0.3] * 3], 2)
"""Standard deviations (12,) of the errors of two cameras that were turned and moved, rad and m."""
PAN, SECOND_PAN = 1, 7
"""Turns of the first and of the second camera about their vertical axis, among the twelve errors."""
SHIFT, SECOND_SHIFT = 3, 9
"""Shifts of the two cameras along their horizontal axis, among the twelve errors."""


def likelihood(measured: dict[int, float], sigma_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the precision (12, 12) and the gradient (12,) of independent measurements of some errors, by index."""
    precision, pull = np.zeros((12, 12)), np.zeros(12)
    for index, value in measured.items():
        precision[index, index], pull[index] = sigma_rad**-2, -value * sigma_rad**-2
    return precision, pull


def test_hypotheses_without_evidence_keep_their_prior():
    poses = PairPoses.weigh(np.zeros((12, 12)), np.zeros(12), CALIBRATED, MISPLACED)
    assert np.tensordot(poses.weight, poses.is_turned, axes=1) == pytest.approx(np.full((2, 3), constants.TURNED_SHARE))
    assert poses.weight @ poses.is_moved == pytest.approx(np.full(2, constants.MOVED_SHARE))
    assert not poses.is_moved.all(axis=1).any()
    fraction = np.tile([*[constants.TURNED_SHARE] * 3, *[constants.MOVED_SHARE] * 3], 2)
    variance = fraction * MISPLACED**2 + (1 - fraction) * CALIBRATED**2
    assert np.diagonal(poses.covariance_about(np.zeros(12))) == pytest.approx(variance)
    np.testing.assert_array_equal(poses.expected, np.zeros(12))


def test_turn_is_attributed_to_the_right_camera():
    measured = dict.fromkeys(range(12), 0.0)
    for index in (PAN, SECOND_PAN):
        seen = likelihood(measured | {index: np.radians(3.0)}, np.radians(0.1))
        poses = PairPoses.weigh(*seen, CALIBRATED, MISPLACED)
        assert np.degrees(poses.expected[index]) == pytest.approx(3.0, abs=0.01)
        assert np.degrees(poses.expected[PAN + SECOND_PAN - index]) == pytest.approx(0.0, abs=0.01)


def test_shift_is_attributed_to_the_right_camera():
    measured = dict.fromkeys(range(12), 0.0)
    for index in (SHIFT, SECOND_SHIFT):
        poses = PairPoses.weigh(*likelihood(measured | {index: 0.3}, 0.001), CALIBRATED, MISPLACED)
        assert poses.expected[index] == pytest.approx(0.3, abs=0.001)
        assert poses.expected[SHIFT + SECOND_SHIFT - index] == pytest.approx(0.0, abs=0.001)
        assert poses.weight @ poses.is_moved == pytest.approx([float(index == SHIFT), float(index == SECOND_SHIFT)])


def test_turn_is_preferred_to_a_shift_with_the_same_effect():
    """Only the sum of a pan and of a shift at 10 m is measured, and turns are more common than shifts."""
    both = np.zeros(12)
    both[[PAN, SHIFT]] = 1.0, 0.1
    precision = np.outer(both, both) * np.radians(0.1) ** -2
    poses = PairPoses.weigh(precision, -np.radians(3.0) * both * np.radians(0.1) ** -2, CALIBRATED, MISPLACED)
    assert both @ poses.expected == pytest.approx(np.radians(3.0), abs=np.radians(0.1))
    assert poses.weight @ poses.is_turned[:, 0, 1] > poses.weight @ poses.is_moved[:, 0] > constants.MOVED_SHARE


def test_each_camera_is_turned_by_half_if_either_may_be_turned():
    """Only the difference of two pans is measured, so that both cameras remain uncertain."""
    difference = np.zeros(12)
    difference[[PAN, SECOND_PAN]] = -1.0, 1.0
    precision, angle_rad = np.outer(difference, difference) * np.radians(0.1) ** -2, np.radians(3.0)
    poses = PairPoses.weigh(precision, -angle_rad * difference * np.radians(0.1) ** -2, CALIBRATED, MISPLACED)
    assert np.degrees(poses.expected[[PAN, SECOND_PAN]]) == pytest.approx([-1.5, 1.5], abs=0.02)
    sigma_deg = np.degrees(np.sqrt(np.diagonal(poses.covariance_about(poses.expected))))
    assert sigma_deg[PAN] == pytest.approx(sigma_deg[SECOND_PAN])
    assert 1.4 < sigma_deg[PAN] < 1.8  # 3 degrees and 0 are equally likely


def random_problem(correlation: float) -> tuple[LeastSquares, np.ndarray]:
    """Return a problem of a size and two poses, and the precision of its shared unknowns."""
    unknowns = [SharedUnknown(SIZE, np.ones(1), np.array([0.1]))]
    names = extrinsic_correction(0), extrinsic_correction(1)
    unknowns += [SharedUnknown(name, np.zeros(6), USUAL[:6] / np.sqrt(correlation)) for name in names]
    problem = LeastSquares(None, [], [], unknowns)  # pyright: ignore[reportArgumentType]
    rows = np.random.default_rng(0).normal(size=(20, 13))
    return problem, 1e4 * rows.T @ rows + np.diag(np.concatenate([unknown.sigma for unknown in unknowns]) ** -2.0)


def test_uncertainty_of_poses_includes_all_hypotheses():
    correlation = 4.0
    problem, S = random_problem(correlation)
    shared, gradient = problem.expected(), np.zeros(13)
    changed = with_uncertain_poses(problem, shared, (S, gradient), correlation)
    before, after = np.linalg.inv(S), np.linalg.inv(changed)
    prior = np.diag(np.tile(problem.shared[1].sigma, 2)) ** 2
    # The prior of the size counts only once, too.
    lasting = S + np.diag([(correlation - 1.0) * 0.1**-2.0, *np.zeros(12)])
    likelihood_precision = np.linalg.inv(np.linalg.inv(lasting)[1:, 1:]) - np.linalg.inv(prior)
    misplaced = np.where(np.arange(12) % 6 < 3, constants.MISPLACED_RAD, constants.MOVED_FACTOR * USUAL)
    poses = PairPoses.weigh(likelihood_precision / correlation, np.zeros(12), CALIBRATED, misplaced)
    np.testing.assert_allclose(correlation * after[1:, 1:], poses.covariance_about(np.zeros(12)), rtol=1e-6, atol=1e-15)
    by_poses = np.linalg.solve(before[1:, 1:], before[1:, 0])  # the size depends on the poses as before
    np.testing.assert_allclose(np.linalg.solve(after[1:, 1:], after[1:, 0]), by_poses, rtol=1e-5, atol=1e-9)


def test_prior_mean_moves_the_minimum_to_the_expected_poses():
    problem, S = random_problem(4.0)
    gradient = 0.02 * S[:, 2]  # a rotation, so that the expected poses are not the minimum
    weighed = pair_poses(problem, problem.expected(), (S, gradient), 4.0)
    assert weighed is not None
    prior_pull = np.append(0.0, -weighed.prior_mean / np.tile(problem.shared[1].sigma, 2) ** 2)
    minimum = np.asarray(-np.linalg.solve(S, gradient + prior_pull), dtype=float)
    assert np.abs(weighed.poses.expected).max() > 1e-3
    np.testing.assert_allclose(minimum[1:], weighed.poses.expected, rtol=1e-8, atol=1e-12)
    # A fit that starts at this minimum, with the weighted prior mean, gives the same result.
    means = {unknown.name: unknown.mean for unknown in problem.shared}
    means |= {extrinsic_correction(i): weighed.prior_mean[6 * i : 6 * i + 6] for i in range(2)}
    shared = [replace(unknown, mean=means[unknown.name]) for unknown in problem.shared]
    values = {SIZE: 1.0 + minimum[:1]} | {extrinsic_correction(i): minimum[6 * i + 1 : 6 * i + 7] for i in range(2)}
    again = pair_poses(replace(problem, shared=shared), values, (S, np.zeros(13)), 4.0)
    assert again is not None
    np.testing.assert_allclose(again.prior_mean, weighed.prior_mean, rtol=1e-8, atol=1e-12)


def test_a_first_camera_that_defines_the_world_stays_certain():
    unknown = SharedUnknown(extrinsic_correction(1), np.zeros(6), USUAL[:6])
    problem = LeastSquares(None, [], [], [unknown])  # pyright: ignore[reportArgumentType]
    S = np.diag(unknown.sigma**-2.0)
    assert with_uncertain_poses(problem, problem.expected(), (S, np.zeros(6)), 1.0) is S


def test_noise_does_not_depend_on_the_prior_of_the_poses(two_cameras, monkeypatch):
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
