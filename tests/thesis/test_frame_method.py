"""Test the poses, the uncertainty and the reports of the frame method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.clip import still_view
from recon.geometry.frames import inverse
from recon.testing.gallop import add_noise, gallop
from recon.thesis import solver as frame
from recon.thesis.chain import load_chain, mean_pose
from recon.thesis.objectives import FrameOptions, JointReprojection, base_length
from recon.thesis.solver import (
    CONVERGED,
    FrameProblem,
    FrameSolver,
    posterior_covariance,
    precision_shares,
    solve_frames,
)
from recon.thesis.start import Travel

SK = load_chain("cheetah-8u")
EXACT = FrameOptions(sigma_px=1.0, keypoint_sigma_m=0.0, base_sigma_m=0.001)
NOISY = FrameOptions(sigma_px=2.0, keypoint_sigma_m=0.0)


def level_states(n: int) -> np.ndarray:
    """Return random poses of a level animal, with each link near its expected side."""
    rng = np.random.default_rng(5)
    states = np.tile(mean_pose(SK), (n, 1))
    states[:, SK.theta_slice] += rng.uniform(-0.5, 0.5, (n, 7))
    states[:, SK.phi_slice] = rng.uniform(-0.25, 0.25, (n, 7))
    states[:, SK.position_slice] = rng.normal([0, 0, 9], 0.5, (n, 3))
    states[:, SK.euler_slice.start + 1] = rng.uniform(-0.6, 0.6, n)
    states[:, SK.euler_slice.start + 2] = rng.uniform(-0.2, 0.2, n)
    states[:, SK.base_index] = rng.uniform(0.15, 0.23, n)
    return states


def near(clip, values: np.ndarray) -> np.ndarray:
    return values[:, [clip.keypoints.names.index(n) for n in SK.body.keypoint_names(clip.side)]]


def fit(clip, keypoints, options: FrameOptions):
    view = still_view(clip.camera, near(clip, keypoints.xy_px), near(clip, keypoints.confidence))
    return solve_frames(view, SK, clip.keypoints.fps, options)


def mpjpe_mm(clip, states: np.ndarray) -> float:
    truth = clip.camera.world_to_camera(near(clip, clip.truth_m))
    joints = SK.pose(states).joints_m
    off = (joints - joints.mean(1, keepdims=True)) - (truth - truth.mean(1, keepdims=True))
    return float(1000 * np.linalg.norm(off, axis=2).mean())


def reprojection_px(clip, keypoints, states: np.ndarray) -> np.ndarray:
    pixels, _ = clip.camera.project(SK.pose(states).joints_m)
    return np.linalg.norm(pixels - near(clip, keypoints.xy_px), axis=2)


@pytest.mark.parametrize("seed", range(5))
def test_the_jacobian_has_rank_18_for_pixels_and_20_for_joints(seed: int):
    """Pixels do not determine scale, roll and a mode of depth, and joints do not determine the roll."""
    camera = gallop().camera
    state = level_states(5)[seed]
    joints = SK.pose(state[None]).joints_m
    pixels = JointReprojection(camera, camera.project(joints)[0], np.ones((1, 9)), 1.0, 1e9)
    in_space = SK.pose_with_jacobian(state[None]).joints_jacobian.reshape(-1, SK.n_state)
    for J, rank in ((FrameProblem(SK, (pixels,), 0, None, 0.0).at(state)[1], 18), (in_space, 20)):
        singular = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
        assert len(J) >= rank
        assert np.sum(singular > 1e-9 * singular[0]) == rank


@pytest.mark.parametrize(
    ("direction", "heading_rad"),
    [("right", 0.35), *(pytest.param("left", heading, marks=pytest.mark.slow) for heading in (0.0, 0.6))],
)
def test_clean_gallop(direction, heading_rad: float):
    clip = gallop(n_frames=12, heading_rad=heading_rad, direction=direction)
    solution = fit(clip, clip.keypoints, EXACT)
    assert all(r is not None and r.status == "converged" for r in solution.reports)
    assert reprojection_px(clip, clip.keypoints, solution.chain_states).mean(axis=1).max() <= 0.5
    assert mpjpe_mm(clip, solution.chain_states) <= 50


@pytest.mark.parametrize("camera_model", [pytest.param("pinhole", marks=pytest.mark.slow), "fisheye"])
def test_noisy_gallop(camera_model):
    clip = gallop(n_frames=12, camera_model=camera_model)
    keypoints, _ = add_noise(clip.keypoints, seed=3)
    solution = fit(clip, keypoints, NOISY)
    assert all(r is not None and r.status == "converged" for r in solution.reports)
    assert mpjpe_mm(clip, solution.chain_states) <= 80


@pytest.mark.parametrize(
    "options",
    [
        replace(NOISY, form="printed"),
        replace(NOISY, angle_prior="none"),
        replace(NOISY, angle_prior="none", form="printed"),
        replace(NOISY, camera_rotation="fixed"),
        replace(NOISY, reprojection="printed"),
        replace(NOISY, max_evaluations=3),
    ],
)
def test_every_option_ends_with_a_report(options: FrameOptions):
    clip = gallop(n_frames=3)
    keypoints, _ = add_noise(clip.keypoints, seed=1)
    solution = fit(clip, keypoints, options)
    for report in solution.reports:
        assert report is not None
        assert (report.optimizer_status in CONVERGED and report.in_view) == (report.status == "converged")
        assert sum(report.cost_shares.values()) == pytest.approx(1)
        assert set(report.cost_shares) <= set(solution.objectives)
    if options.max_evaluations == 3:
        assert any(r is not None and r.status == "not_converged" for r in solution.reports)
    if options.camera_rotation == "fixed":
        np.testing.assert_allclose(
            solution.chain_states[:, SK.euler_slice], solution.chain_states[[0] * 3, SK.euler_slice]
        )


def test_frames_without_data_are_skipped_and_the_clip_goes_on():
    clip = gallop()
    xy = clip.keypoints.xy_px.copy()
    xy[10:15] = np.nan
    xy[20, :12] = np.nan
    solution = fit(clip, replace(clip.keypoints, xy_px=xy), EXACT)
    empty = [i for i, report in enumerate(solution.reports) if report is None]
    assert empty == [10, 11, 12, 13, 14, 20]
    assert np.isnan(solution.chain_states[empty]).all()
    solved = [i for i in range(30) if i not in empty]
    assert np.isfinite(solution.chain_states[solved]).all()
    assert reprojection_px(clip, clip.keypoints, solution.chain_states)[solved].mean(axis=1).max() < 0.5


def test_a_clip_without_any_data():
    clip = gallop(n_frames=3)
    solution = fit(clip, replace(clip.keypoints, xy_px=np.full_like(clip.keypoints.xy_px, np.nan)), EXACT)
    assert solution.reports == (None, None, None)


def test_report_against_the_problem_by_hand():
    """The report of a frame agrees with the residuals at the solution, computed without the solver."""
    clip = gallop(n_frames=1)
    solution = fit(clip, clip.keypoints, EXACT)
    report = solution.reports[0]
    assert report is not None
    distance = reprojection_px(clip, clip.keypoints, solution.chain_states)[0]
    u2 = (distance / report.sigma_px) ** 2
    reprojection = np.sum(u2 / (1 + u2 / EXACT.robust_c**2))
    assert report.cost_shares["reprojection"] * report.squared_norm == pytest.approx(reprojection, rel=1e-6)
    theta = solution.chain_states[0, SK.theta_slice] - SK.theta.mean_rad
    prior = np.sum((theta / SK.file.prior.theta_sigma_rad) ** 2)
    assert report.cost_shares["theta prior"] * report.squared_norm == pytest.approx(prior, rel=1e-9)
    assert report.sigma_px == 1.0
    assert report.function_evaluations >= report.iterations > 0


def test_the_base_length_stays_at_its_prior():
    """The base length stays at its prior, although this is wrong, because the data do not determine it."""
    clip = gallop(n_frames=10)
    wrong = replace(EXACT, base_length_m=0.25, base_sigma_m=0.01)
    solution = fit(clip, clip.keypoints, wrong)
    assert np.abs(solution.chain_states[:, SK.base_index] - 0.25).max() < 0.002
    shares = np.array([r.data_share for r in solution.reports if r is not None])
    assert shares[:, SK.base_index].max() < 0.05
    assert shares.min() >= 0
    assert shares.max() <= 1


def test_the_base_length_has_the_stated_prior():
    """If only a length is given, its relative standard deviation is the skeleton's."""
    options = replace(EXACT, base_length_m=0.6, base_sigma_m=None)
    clip = gallop(n_frames=1)
    view = still_view(clip.camera, near(clip, clip.keypoints.xy_px), near(clip, clip.keypoints.confidence))
    objectives = FrameSolver(view, SK, 30.0, options).objectives
    (prior,) = (term for term in objectives if term.name == "base length prior")
    assert (prior.mean, prior.sigma) == pytest.approx(base_length(SK, options))
    assert prior.sigma == pytest.approx(0.6 * 0.02 / 0.203)


def test_precision_shares_of_a_problem_computed_by_hand():
    """Fractions of the precision agree with those computed by hand.

    Data observe each of two unknowns with standard deviation s, and priors with p. The variance is 1 / (1/s^2 + 1/p^2),
    and the fraction from the data is p^2 / (s^2 + p^2).
    """
    D = SK.n_state
    s, p = 0.5, 2.0
    C = posterior_covariance(np.concatenate([np.eye(D) / s, np.eye(D) / p]))
    np.testing.assert_allclose(C, np.eye(D) / (1 / s**2 + 1 / p**2), atol=1e-15)
    fraction = precision_shares(C, np.eye(D) / s)
    np.testing.assert_allclose(fraction, p**2 / (s**2 + p**2))
    undetermined = posterior_covariance(np.eye(D)[:5])
    assert np.isnan(undetermined).all()
    assert np.isnan(precision_shares(undetermined, np.eye(D)[:5])).all()


def test_the_same_input_gives_the_same_states():
    clip = gallop(n_frames=8)
    np.testing.assert_array_equal(fit(clip, clip.keypoints, NOISY).states, fit(clip, clip.keypoints, NOISY).states)


def test_a_pose_that_diverges_is_left_out_of_the_solution():
    """A frame whose detections coincide fits an animal far away, and is left out of the solution."""
    clip = gallop(n_frames=4)
    xy = clip.keypoints.xy_px.copy()
    xy[2] = xy[2, :1]
    solution = fit(clip, replace(clip.keypoints, xy_px=xy), NOISY)
    assert np.isnan(solution.chain_states[2]).all()
    assert np.isfinite(solution.chain_states[[0, 1, 3]]).all()
    away, after = solution.reports[2], solution.reports[3]
    assert away is not None
    assert after is not None
    assert (away.status, away.in_view, after.status, after.in_view) == ("not_converged", False, "converged", True)
    unknown = (solution.covariance_m2[2], solution.relative_covariance_m2[2])
    shares = (away.data_share, away.mean_weight, *unknown)
    assert all(np.isnan(values).all() for values in shares)


def test_detections_outside_the_lens_model_are_left_out():
    """A frame whose points are 2,500 px outside the picture changes nothing in the solution of other frames."""
    clip = gallop(n_frames=3, camera_model="fisheye")
    xy = clip.keypoints.xy_px.copy()
    off, missing = xy.copy(), xy.copy()
    off[1] += (2500.0, 300.0)
    missing[1] = np.nan
    solutions = [fit(clip, replace(clip.keypoints, xy_px=points), NOISY) for points in (off, missing)]
    np.testing.assert_array_equal(solutions[0].states, solutions[1].states)
    assert solutions[0].reports[1] is None


def test_covariance_of_the_joints_computed_by_hand():
    """The joints' covariance along the world's axes agrees with one computed by hand.

    An error of the position moves all joints equally, and an error of the size in proportion to their distance from the
    root.
    """
    camera = gallop(n_frames=2).camera
    state = np.tile(mean_pose(SK), (2, 1))
    state[:, SK.position_slice] = [0.0, 0.0, 9.0]
    C = np.zeros((2, SK.n_state, SK.n_state))
    C[0, SK.position_slice, SK.position_slice] = np.diag([0.1, 0.2, 0.3]) ** 2
    C[1, SK.base_index, SK.base_index] = 0.01**2
    view = still_view(camera, np.zeros((2, 9, 2)), np.ones((2, 9)))
    told = {"reports": (None, None), "travel": Travel(np.zeros((2, 3)), np.zeros(2)), "objectives": (), "fps": 30.0}
    found = frame.in_world(view, SK, state, C, **told)
    R = camera.rotation.T
    expected = R @ np.diag([0.1, 0.2, 0.3]) ** 2 @ R.T
    np.testing.assert_allclose(found.covariance_m2[0], np.tile(expected, (9, 1, 1)), atol=1e-15)
    np.testing.assert_allclose(found.relative_covariance_m2[0], 0, atol=1e-15)
    joints = SK.pose(state[:1]).joints_m[0] - [0.0, 0.0, 9.0]
    per_base = joints @ R.T / state[0, SK.base_index]
    for points, covariance in (
        (per_base, found.covariance_m2[1]),
        (per_base - per_base.mean(axis=0), found.relative_covariance_m2[1]),
    ):
        np.testing.assert_allclose(covariance, 0.01**2 * points[:, :, None] * points[:, None, :], atol=1e-15)


def test_standard_deviations_of_the_angles_computed_by_hand():
    """Standard deviations are the chain's for links, and follow from the Euler angles for the root."""
    view = still_view(gallop(n_frames=2).camera, np.zeros((1, 9, 2)), np.ones((1, 9)))
    rng = np.random.default_rng(0)
    state, root = mean_pose(SK)[None], rng.normal(0, 0.01, (SK.n_state, SK.n_state))
    C, travel = (root @ root.T)[None], Travel(np.zeros((1, 3)), np.zeros(1))
    found = frame.in_world(view, SK, state, C, reports=(None,), travel=travel, objectives=(), fps=30.0)
    sigma = dict(zip(SK.body.state_names[3:], found.angle_sigma_rad[0], strict=True))
    for name, own in zip(SK.angle_names, np.sqrt(np.diagonal(C[0])), strict=False):
        assert sigma[name] == own
    # rotations by small Euler angles, drawn from their covariance
    drawn = np.tile(state, (4000, 1))
    drawn[:, SK.euler_slice] += rng.multivariate_normal(np.zeros(3), C[0, SK.euler_slice, SK.euler_slice], 4000)
    turned = SK.to_body(drawn, inverse(view.T_camera_world))[0][:, 3:6]
    np.testing.assert_allclose(found.angle_sigma_rad[0, :3], turned.std(axis=0), rtol=0.04)


def test_reprojection_as_printed_is_neither_weighted_nor_robust():
    """The residual of a detection that is 500 px off with confidence 0.01 is its distance in standard deviations."""
    clip = gallop(n_frames=1)
    xy, confidence = near(clip, clip.keypoints.xy_px).copy(), near(clip, clip.keypoints.confidence).copy()
    pixels = clip.camera.project(SK.pose(mean_start := level_states(1)).joints_m)[0]
    xy[0], confidence[0, 4] = pixels[0], 0.01
    xy[0, 4] += (300.0, 400.0)
    view, printed = still_view(clip.camera, xy, confidence), replace(NOISY, reprojection="printed")
    problem = FrameSolver(view, SK, 30.0, printed).problem(0, sigma_px=2.0)
    residual, _ = problem.by_term(mean_start[0])["reprojection"]
    expected = np.zeros((9, 2))
    expected[4] = -150.0, -200.0
    np.testing.assert_allclose(residual.reshape(9, 2), expected, atol=1e-3)
