"""Test the gain of a correction against equations that are solved again with the correction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon import Motion
from recon.animal.prior import load_prior, prior_from_body
from recon.animal.skeleton_file import load_skeleton
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.correction_gain import (
    _covariances_and_derivatives,
    correction_gain_m2,
    problems_at,
)
from recon.fit.result import TrajectorySolution
from recon.fit.terms import Reprojection, time_offset
from recon.fit.trajectory import solve_trajectory
from recon.testing import rigs


@pytest.fixture(scope="module")
def solved(whole_results) -> Motion:
    return Motion.load(whole_results)


def gains(motion: Motion, **changes) -> np.ndarray:
    prior = load_prior("running-cheetah", motion.body)
    assert isinstance(motion.solution, TrajectorySolution)
    return correction_gain_m2(replace(motion.solution, **changes), prior, motion.fps, TrajectoryOptions())


def test_fit_states_the_gain_of_corrections(solved: Motion):
    gain_m2 = solved.correction_gain_m2
    assert gain_m2 is not None
    assert gain_m2.shape == (1, len(solved.frames), len(solved.joints))
    np.testing.assert_allclose(gains(solved), gain_m2, rtol=1e-6)
    assert np.nanmin(gain_m2) >= 0


def test_derivative_of_the_covariance_matches_the_dense_inverse(solved: Motion):
    solution = solved.solution
    assert isinstance(solution, TrajectorySolution)
    clip = ClipProblem.from_views(
        solution.views, solution.body, load_prior("running-cheetah", solved.body), solved.fps, TrajectoryOptions()
    )
    ((_, _part, problem, estimate),) = problems_at(clip, solution)
    T, D = estimate.states.shape
    rng = np.random.default_rng(0)
    root = rng.normal(size=(T, D, 3))
    G = root @ root.swapaxes(1, 2)
    blocks = replace(problem, shared=(), nuisance=()).normal(estimate.states, estimate.shared).blocks
    H = np.zeros((T, D, T, D))
    for t in range(T):
        for k in range(min(blocks.shape[1], T - t)):
            H[t + k, :, t] = blocks[t, k]
            H[t, :, t + k] = blocks[t, k].T
    inverse = np.linalg.inv(H.reshape(T * D, T * D)).reshape(T, D, T, D)
    step = 1e-4 / np.einsum("tatb,tba->t", inverse, G).max()
    parts = _covariances_and_derivatives(problem, estimate, step, lambda frames: G[frames])
    Z, Q = np.concatenate([of_states for _, of_states in parts], axis=1)
    np.testing.assert_allclose(Z[5], inverse[5, :, 5], rtol=1e-5, atol=1e-9)
    whole = np.einsum("asb,sbc,scd->ad", inverse[5], G, inverse[:, :, 5], optimize=True)
    np.testing.assert_allclose(Q[5], whole, rtol=2e-3, atol=2e-3 * np.abs(whole).max())


def test_last_frame_has_a_gain_despite_a_time_offset():
    """The time offset is an unknown, as in the fit, because interpolated pictures would need a next frame."""
    body = load_skeleton("human-25")
    prior, options = prior_from_body(body), TrajectoryOptions(fast=True)
    views, _ = rigs.random_clip(body, 0.0, 2, 0)
    solution = solve_trajectory(views, body, prior, rigs.FPS, options)
    assert np.abs(solution.time_offset_frames).min() > 0
    ((_, _part, problem, estimate),) = problems_at(
        ClipProblem.from_views(solution.views, body, prior, rigs.FPS, options), solution
    )
    assert all(term.stencil == (0,) for term in problem.terms if isinstance(term, Reprojection))
    (offset,) = estimate.shared[time_offset(1)]
    assert offset == solution.time_offset_frames[1]
    gain_m2 = np.nanmedian(correction_gain_m2(solution, prior, rigs.FPS, options), axis=2)
    assert (gain_m2[:, -1] < 4 * gain_m2[:, -2]).all()


def test_a_missing_detection_gains_more_than_one_that_is_used(solved: Motion):
    """The gain of the same detection is larger if it is missing than if it agrees with the pose."""
    solution, (view,) = solved.solution, solved.solution.views
    weight = np.nan_to_num(solution.weight[0])
    weight[:5], weight[-5:] = 0.0, 0.0
    t, j = np.unravel_index(int(np.argmax(weight)), weight.shape)
    before = gains(solved)[0, t, j]
    xy_px, confidence = view.xy_px.copy(), view.confidence.copy()
    xy_px[t, j], confidence[t, j] = np.nan, 0.0
    without = replace(view, xy_px=xy_px, confidence=confidence)
    weights = solution.weight.copy()
    weights[0, t, j] = np.nan
    after = gains(solved, views=(without,), weight=weights)[0, t, j]
    assert after > 3 * before


def test_a_distant_detection_pulls_more_than_one_that_agrees(solved: Motion):
    """A detection that is moved by two standard deviations, with its weight unchanged, pulls more than before."""
    solution, (view,) = solved.solution, solved.solution.views
    t, j = 20, int(np.nanargmax(np.nan_to_num(solution.weight[0, 20])))
    xy_px = view.xy_px.copy()
    xy_px[t, j] += 2 * solution.noise_px[0, t, j]
    assert gains(solved, views=(replace(view, xy_px=xy_px),))[0, t, j] > 2 * gains(solved)[0, t, j]
