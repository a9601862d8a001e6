"""Test the accelerations that the detections of several cameras make likely."""

from __future__ import annotations

import numpy as np
import pytest

from recon.animal.prior import ANGLES, prior_from_body
from recon.animal.skeleton_file import load_skeleton
from recon.fit.least_squares import LeastSquares
from recon.fit.smoothness import SCALES, likely_scale
from recon.fit.terms import KnownAngles, dynamics_term, root_term

FPS, T, NOISE_RAD = 60.0, 300, 0.02


def solved_problem(acceleration_share: float) -> tuple[LeastSquares, np.ndarray]:
    """Return a problem whose angles accelerate by a fraction of the skeleton's expectation, and its noisy states."""
    body, random = load_skeleton("mouse-top"), np.random.default_rng(0)
    D, prior = body.n_state, prior_from_body(body)
    # scaled as in the acceleration term
    per_frame = acceleration_share * body.acceleration_rad_s2 / FPS**2 * np.sqrt(FPS / 90.0)
    angles = np.cumsum(np.cumsum(random.normal(size=(T, D - 4)) * per_frame, axis=0), axis=0)
    states = np.zeros((T, D))
    states[:, ANGLES] = angles + random.normal(0, NOISE_RAD, angles.shape)
    linear = [root_term(D, FPS, np.ones(3), 1.0), dynamics_term(prior, D, FPS, 1.0)]
    return LeastSquares(body.detected, linear, [KnownAngles(states, NOISE_RAD)]), states


@pytest.mark.parametrize("share", [0.05, 0.5])
def test_likely_accelerations_agree_with_the_motion(share):
    problem, states = solved_problem(share)
    scale = likely_scale(problem, states, {}, np.ones(states.shape[1]))
    assert np.median(scale[ANGLES]) == pytest.approx(share, rel=0.25)
    assert np.all(scale[:3] == scale[0])  # no detection determines the position


def test_accelerations_of_few_frames_stay_as_expected():
    problem, states = solved_problem(0.5)
    scale = np.full(states.shape[1], 0.7)
    np.testing.assert_array_equal(likely_scale(problem, states[:5], {}, scale), scale)


def test_a_factor_does_not_leave_its_range():
    problem, states = solved_problem(1e-6)
    scale = likely_scale(problem, states, {}, np.ones(states.shape[1]))
    assert scale.min() >= SCALES[0]
    assert scale[ANGLES].max() < 0.2
