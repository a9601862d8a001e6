"""Test states that are fitted to known 3D markers, for every built-in skeleton."""

from __future__ import annotations

import numpy as np
import pytest

from recon.animal.body import Body
from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.fit.points import MIN_MARKERS, solve_points
from recon.geometry.kinematics import PITCH, ROOT, YAW

FAINT = 1e-6
"""Weight of the angles' deviations, m/rad, small enough to move no marker visibly."""


LIKE_OTHERS = ("cheetah-8u", "cheetah-8u-jules", "cheetah-8u-phantom")
"""Chains that differ only in their lengths. Their tests are slow."""


@pytest.fixture(
    params=[pytest.param(name, marks=[pytest.mark.slow] * (name in LIKE_OTHERS)) for name in builtin_names()]
)
def body(request: pytest.FixtureRequest) -> Body:
    return load_skeleton(request.param)


@pytest.fixture
def cheetah() -> Body:
    return load_skeleton("cheetah-24")


def random_states(body: Body, n: int) -> np.ndarray:
    """Return states around the expected pose, at any position and heading, with half the usual spread of angles."""
    rng = np.random.default_rng(0)
    angles = rng.normal(body.mean_rad, 0.5 * body.sigma_rad, (n, body.n_state - 4))
    return np.concatenate([rng.uniform(-5, 5, (n, 3)), rng.uniform(-3, 3, (n, 1)), angles], axis=1)


def test_finds_the_markers(body: Body):
    points = body.tree.pose(random_states(body, 30), 1.1).points_m
    states, rms_m, _ = solve_points(body, points, 1.1, FAINT)
    assert rms_m.max() < 1e-6
    np.testing.assert_allclose(body.tree.pose(states, 1.1).points_m, points, rtol=0, atol=3e-6)


def test_finds_states_that_the_markers_determine(cheetah):
    truth = random_states(cheetah, 60)
    states, *_ = solve_points(cheetah, cheetah.tree.pose(truth).points_m, pull_m_per_rad=FAINT)
    states[:, YAW] -= 2 * np.pi * np.round((states - truth)[:, YAW] / (2 * np.pi))
    np.testing.assert_allclose(states, truth, rtol=0, atol=1e-5)


def test_finds_the_size(cheetah):
    truth = random_states(cheetah, 30)
    points = cheetah.tree.pose(truth, 0.87).points_m
    _, rms_m, size = solve_points(cheetah, points, None, FAINT)
    assert size == pytest.approx(0.87, abs=1e-8)
    assert rms_m.max() < 1e-6


def test_missing_markers(cheetah):
    truth = random_states(cheetah, 6)
    points = cheetah.tree.pose(truth).points_m
    points[0] = np.nan
    points[1, MIN_MARKERS - 1 :] = np.nan
    points[2, cheetah.markers.index("l_eye")] = np.nan
    points[3, cheetah.markers.index("l_front_paw"), 2] = np.nan
    states, rms_m, _ = solve_points(cheetah, points, pull_m_per_rad=FAINT)
    assert np.isnan(states[:2]).all()
    assert np.isnan(rms_m[:2]).all()
    assert np.isfinite(states[2:]).all()
    assert rms_m[2:].max() < 1e-6
    np.testing.assert_allclose(states[2, PITCH:], truth[2, PITCH:], rtol=0, atol=1e-5)
    # Only the prior determines the direction of the foot.
    foot = cheetah.state_names.index("l_fore_foot_pitch")
    assert states[3, foot] == pytest.approx(cheetah.mean_rad[foot - 4], abs=1e-6)


def test_least_squares_of_noisy_markers(cheetah):
    rng = np.random.default_rng(1)
    truth = random_states(cheetah, 20)
    points = cheetah.tree.pose(truth).points_m + rng.normal(0, 0.01, (20, len(cheetah.markers), 3))
    states, rms_m, _ = solve_points(cheetah, points)
    pose = cheetah.tree.pose_with_jacobian(states)
    off = (pose.points_m - points).reshape(20, -1)
    np.testing.assert_allclose(rms_m, np.sqrt((off**2).sum(axis=1) / len(cheetah.markers)), rtol=1e-9)
    gradient = np.einsum("ni,nid->nd", off, pose.jacobian.reshape(20, off.shape[1], -1))
    gradient[:, PITCH:] += 1e-4 * (states[:, PITCH:] - cheetah.mean_rad)
    np.testing.assert_allclose(gradient, 0, atol=1e-9)


def test_a_tail_that_points_up_does_not_turn_over(cheetah):
    """The direction (yaw, pitch) of the tail is the same as (yaw + pi, pi - pitch)."""
    T, names = 60, list(cheetah.state_names)
    truth = np.zeros((T, cheetah.n_state))
    truth[:, PITCH:] = cheetah.mean_rad
    truth[:, names.index("tail_2_pitch")] = np.linspace(0.9, 1.45, T)
    truth[:, names.index("tail_2_yaw")] = np.linspace(-0.9, 0.9, T)
    rng = np.random.default_rng(2)
    points = cheetah.tree.pose(truth).points_m + rng.normal(0, 0.005, (T, len(cheetah.markers), 3))
    states, *_ = solve_points(cheetah, points)
    assert np.abs(np.diff(states[:, PITCH:], axis=0)).max() < 0.6


def test_heading_is_continuous(cheetah):
    truth = random_states(cheetah, 1).repeat(50, axis=0)
    truth[:, YAW] = np.linspace(0, 4 * np.pi, 50)
    truth[:, ROOT] = 0
    states, *_ = solve_points(cheetah, cheetah.tree.pose(truth).points_m)
    assert np.ptp(states[:, YAW]) == pytest.approx(4 * np.pi, abs=1e-3)


def test_points_that_cannot_be_fitted(cheetah):
    with pytest.raises(ValueError, match="24 markers"):
        solve_points(cheetah, np.zeros((5, 23, 3)))
    nothing = np.full((5, 24, 3), np.nan)
    assert np.isnan(solve_points(cheetah, nothing)[0]).all()
    assert solve_points(cheetah, nothing[:0])[0].shape == (0, cheetah.n_state)
    with pytest.raises(ValueError, match="no frame"):
        solve_points(cheetah, nothing, None)
