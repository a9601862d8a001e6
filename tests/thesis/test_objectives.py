"""Test the Jacobian and the residuals of every objective in `TERMS`, to which a new term is added."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from recon.geometry.camera import Camera
from recon.thesis.chain import ChainPose, load_chain
from recon.thesis.objectives import (
    AngleRange,
    DirectionPrior,
    GaussianPrior,
    JointReprojection,
    Objective,
    RateLimit,
)
from recon.thesis.path import PathTie

SK = load_chain("cheetah-8u")
RNG = np.random.default_rng(1)
N = 10
UP = np.array([0.05, -0.99, 0.1]) / np.linalg.norm([0.05, -0.99, 0.1])
CAMERA = Camera(
    "cam", np.array([[860.0, 3, 957], [0, 864, 545], [0, 0, 1]]), np.array([0.12, -0.05, 0.015, -0.001]), "fisheye",
    (1920, 1080),
)  # fmt: skip


def states(seed: int) -> np.ndarray:
    """Return states in front of the camera with angles inside and outside their ranges."""
    rng = np.random.default_rng(seed)
    x = np.zeros((N, SK.n_state))
    x[:, SK.theta_slice] = SK.theta.mean_rad + rng.normal(0, 1.2, (N, 7))
    x[:, SK.phi_slice] = rng.normal(0, 0.6, (N, 7))
    x[:, SK.euler_slice] = rng.normal(0, 0.3, (N, 3))
    x[:, SK.position_slice] = rng.normal([0, 0, 6], 0.3, (N, 3))
    x[:, SK.base_index] = 0.2
    return x


NOW, BEFORE = states(1), states(2)
DETECTED = CAMERA.project(SK.pose(NOW).joints_m)[0] + RNG.normal(0, 20, (N, 9, 2))
DETECTED[2, 3] = np.nan
LEVEL = np.eye(3) - np.outer(UP, UP)
HEADING = np.tile(np.array([1.0, 0, 0]), (N, 1))

TERMS: list[Objective] = [
    JointReprojection(CAMERA, DETECTED, RNG.uniform(0.2, 1, (N, 9)), 8.0, 4.0),
    *(AngleRange("theta range", SK.theta_slice, 0.15, form, SK.theta) for form in ("deadband", "printed")),
    *(AngleRange("phi range", SK.phi_slice, 0.15, form, SK.phi) for form in ("deadband", "printed")),
    *(RateLimit("theta rate", SK.theta_slice, 0.15, f, SK.theta.max_rate_rad_s) for f in ("deadband", "printed")),
    *(RateLimit("phi rate", SK.phi_slice, 0.15, f, SK.phi.max_rate_rad_s) for f in ("deadband", "printed")),
    GaussianPrior("theta prior", SK.theta_slice, SK.theta.mean_rad, 0.8),
    GaussianPrior("base length prior", slice(SK.base_index, SK.base_index + 1), 0.21, 0.02),
    DirectionPrior("roll prior", 2, UP[None], np.zeros((N, 3)), 0.12, SK.euler_slice),
    DirectionPrior("heading tie", 0, LEVEL, None, 1.0, SK.euler_slice),
    DirectionPrior("travel prior", 0, LEVEL, HEADING, 0.25, SK.euler_slice),
    PathTie(np.tile([0.1, 0.2, 6.0], (N, 1)), 0.2, SK.base_index, 0.5),
]


@cache
def posed(state: bytes) -> ChainPose:
    """Return the pose at a state, from a cache because all terms are evaluated at the same states."""
    return SK.pose_with_jacobian(np.frombuffer(state)[None])


def evaluate(term: Objective, now: np.ndarray, before: np.ndarray = BEFORE, dt: float = 1 / 90):
    """Return residuals (N, M) and Jacobians (N, M, D) of a term in N frames."""
    found = [term.evaluate(posed(now[t].tobytes()), posed(before[t].tobytes()), t, dt) for t in range(len(now))]
    residuals, jacobians = zip(*found, strict=True)
    return np.stack(residuals), np.stack(jacobians)


@pytest.mark.parametrize("term", TERMS, ids=lambda t: f"{t.name}-{getattr(t, 'form', '')}")
def test_jacobian_against_central_differences(term: Objective):
    """The Jacobian agrees with central differences at ten random states."""
    h = 1e-6
    residual, jacobian = evaluate(term, NOW)
    assert jacobian.shape == (*residual.shape, SK.n_state)
    steps = h * np.eye(SK.n_state)
    columns = [(evaluate(term, NOW + step)[0] - evaluate(term, NOW - step)[0]) / (2 * h) for step in steps]
    numeric = np.stack(columns, axis=-1)
    error = np.linalg.norm(jacobian - numeric, axis=(1, 2))
    assert np.all(error <= 1e-6 * np.maximum(np.linalg.norm(numeric, axis=(1, 2)), 1.0))


def test_only_terms_that_tie_frames_depend_on_the_previous_frame():
    for term in TERMS:
        same = np.array_equal(evaluate(term, NOW, BEFORE)[0], evaluate(term, NOW, BEFORE + 0.1)[0])
        assert same == (not term.ties)


def test_every_deadband_term_is_active_outside_the_range_and_zero_inside():
    for term in TERMS:
        if getattr(term, "form", None) == "deadband":
            assert np.any(evaluate(term, NOW)[0] > 0), term.name
            assert np.any(evaluate(term, NOW)[0] == 0), term.name


def test_printed_form_pulls_towards_the_edge():
    at_mean = NOW.copy()
    at_mean[:, SK.theta_slice] = SK.theta.mean_rad
    printed, deadband = (AngleRange("f2", SK.theta_slice, 0.15, f, SK.theta) for f in ("printed", "deadband"))
    np.testing.assert_allclose(evaluate(printed, at_mean)[0], np.tile(-SK.theta.tolerance_rad / 0.15, (N, 1)))
    assert np.all(evaluate(deadband, at_mean)[0] == 0)


def test_rate_limit_counts_the_chord_so_that_a_flip_is_not_free():
    """A link that turns by pi moves its tip by a chord of 2 link lengths, which the rate limit penalises."""
    after = BEFORE.copy()
    after[:, 0] += np.pi
    for form, swept in (("deadband", 2.0), ("printed", 0.0)):
        term = RateLimit("f4", SK.theta_slice, 0.15, form, SK.theta.max_rate_rad_s)
        residual = evaluate(term, after, dt=0.01)[0][:, 0]
        np.testing.assert_allclose(residual, (swept - 30 * 0.01) / 0.15, atol=1e-12)


def test_reprojection_is_zero_at_the_target_and_saturates():
    exact = CAMERA.project(SK.pose(NOW).joints_m)[0]
    term = JointReprojection(CAMERA, exact, np.ones((N, 9)), 2.0, 4.0)
    np.testing.assert_allclose(evaluate(term, NOW)[0], 0, atol=1e-9)
    far = replace(term, xy_px=exact + np.array([1e5, 0]))
    np.testing.assert_allclose(np.linalg.norm(evaluate(far, NOW)[0].reshape(N, 9, 2), axis=2), 4.0, rtol=1e-6)


def test_reprojection_rows_of_missing_points_are_zero_and_of_hidden_joints_at_the_limit():
    term = TERMS[0]
    residual, jacobian = evaluate(term, NOW)
    assert np.all(residual[2, 6:8] == 0)
    assert np.all(jacobian[2, 6:8] == 0)
    behind = NOW.copy()
    behind[:, SK.position_slice] *= -1
    residual, jacobian = evaluate(term, behind)
    np.testing.assert_allclose(np.linalg.norm(residual[0].reshape(9, 2), axis=1), 4.5 - 0.5)
    assert np.all(jacobian == 0)


def test_reprojection_weighs_by_confidence():
    term = replace(TERMS[0], c=1e9, confidence=np.ones((N, 9)))
    half = replace(term, confidence=np.full((N, 9), 0.5))
    np.testing.assert_allclose(evaluate(half, NOW)[0] * np.sqrt(2), evaluate(term, NOW)[0])


def test_roll_prior_is_zero_for_a_level_animal_and_grows_with_roll():
    level = np.zeros((1, SK.n_state))
    term = DirectionPrior("roll prior", 2, np.array([[0.0, -1, 0]]), np.zeros((1, 3)), 0.1, SK.euler_slice)
    assert term.evaluate(SK.pose_with_jacobian(level), None, 0, 1.0)[0] == 0
    level[0, SK.euler_slice] = [0.1, 0, 0]
    rolled = term.evaluate(SK.pose_with_jacobian(level), None, 0, 1.0)[0]
    assert abs(float(rolled[0])) == pytest.approx(np.sin(0.1) / 0.1)


def test_an_unknown_direction_of_travel_has_no_effect():
    silent = DirectionPrior("travel prior", 0, LEVEL, np.full((N, 3), np.nan), 0.25, SK.euler_slice)
    residual, jacobian = evaluate(silent, NOW)
    assert np.all(residual == 0)
    assert np.all(jacobian == 0)
