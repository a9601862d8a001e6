"""Test that a motion unlike the prior's is reported, and is fitted no worse than without a prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.animal.prior import ANGLES, MotionPrior, prior_from_body
from recon.animal.skeleton_file import load_skeleton
from recon.clip import still_view
from recon.fit import constants
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.posterior import PriorMisfit, prior_misfit_of
from recon.fit.result import TrajectorySolution
from recon.fit.terms import POSE, Linear, pose_term
from recon.fit.trajectory import solve_trajectory
from recon.geometry.camera import Camera

BODY = load_skeleton("cheetah-24", "phantom")
PLAIN = prior_from_body(BODY)
NARROW = replace(
    PLAIN,
    name="narrow",
    means=PLAIN.means + 0.2,
    mean=PLAIN.mean + 0.2,
    covariances=PLAIN.covariances / 25,
    covariance=PLAIN.covariance / 25,
)
"""Prior with other means than `PLAIN`, and a fifth of its standard deviations."""
FPS, T = 60.0, 16
CAMERA = Camera.from_hfov(60.0, (1920, 1080))


@pytest.mark.parametrize("fps", [45.0, 200.0])
def test_misfit_is_the_scale_of_the_variances(fps):
    """The misfit has this scale if the angles are measured directly in all frames."""
    rng = np.random.default_rng(0)
    prior = pose_term(NARROW, BODY.n_state, fps, 1.0)
    sigma = np.sqrt(np.diagonal(NARROW.covariance) * fps / 90.0)
    for scale, weight in ((1.0, 1.0), (np.sqrt(3.0), 1 / 3)):
        truth = np.zeros((300, BODY.n_state))
        truth[:, ANGLES] = NARROW.mean + scale * np.sqrt(constants.MISFIT_USUAL) * sigma * rng.normal(
            size=(300, len(sigma))
        )
        # The data are so precise that the prior has hardly any effect.
        seen = Linear("seen", (0,), 1e3 * np.eye(BODY.n_state)[None], np.zeros(BODY.n_state))
        problem = LeastSquares(BODY.tree, [prior, seen], [])
        found = prior_misfit_of(problem, Estimate(truth, 0.0, 1, True))
        assert found.freedom == pytest.approx(truth[:, ANGLES].size, rel=1e-2)
        assert found.level == pytest.approx(scale**2, rel=0.05)
        assert found.prior_weight == pytest.approx(weight, rel=0.1)


def test_uninformative_pixels_give_no_misfit():
    states = np.zeros((5, BODY.n_state))
    states[:, ANGLES] = NARROW.mean
    hardly = Linear("seen", (0,), 1e-3 * np.eye(BODY.n_state)[None], np.zeros(BODY.n_state))
    problem = LeastSquares(BODY.tree, [pose_term(NARROW, BODY.n_state, FPS, 1.0), hardly], [])
    found = prior_misfit_of(problem, Estimate(states, 0.0, 1, True))
    assert (found.level, found.freedom, found.prior_weight) == (pytest.approx(0.0, abs=1e-9), 1.0, 1.0)
    assert [term.name for term in problem.subset((POSE,)).linear] == [POSE]


def test_few_unknowns_need_a_larger_misfit():
    assert not PriorMisfit(1.99, 1e4).unlike
    assert PriorMisfit(2.01, 1e4).unlike
    assert not PriorMisfit(2.2, 10.0).unlike  # 2.32 is the 99 % quantile of chi square / 10 with ten degrees of freedom
    assert PriorMisfit(2.4, 10.0).unlike


def test_prior_weight_decreases_gradually():
    trusts = [PriorMisfit(level, 1e3).prior_weight for level in (0.5, 1.0, 1.001, 1.999, 2.001)]
    assert trusts == pytest.approx([1.0, 1.0, 1 / 1.001, 1 / 1.999, 1 / 2.001])


def solved(prior: MotionPrior, at: np.ndarray, **options) -> tuple[TrajectorySolution, float]:
    """Return the solution of a clip with constant angles, and the error of its pose, m."""
    states = np.zeros((T, BODY.n_state))
    states[:, ANGLES] = at
    states[:, :3] = np.array([-0.5, 6.0, -0.3]) + np.outer(np.arange(T) / FPS, [5.0, 0.0, 0.0])
    truth_m = BODY.tree.pose(states).points_m @ np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]).T
    px = CAMERA.project(truth_m)[0] + np.random.default_rng(1).normal(size=(T, len(BODY.markers), 2))
    view = still_view(CAMERA, px, np.ones(px.shape[:2]))
    solution = solve_trajectory([view], BODY, prior, FPS, TrajectoryOptions(ground="none", **options))
    off = solution.joints_camera_m - truth_m
    return solution, float(np.linalg.norm(off - off.mean(axis=1, keepdims=True), axis=-1).mean())


@pytest.mark.parametrize("fast", [False, True])
def test_prior_of_other_motions_loses_its_weight(fast, monkeypatch):
    """With a prior of other motions, angles stay near the skeleton's expectation."""
    at = PLAIN.mean + 0.1 * np.random.default_rng(3).normal(size=len(PLAIN.mean))
    solution, error_m = solved(NARROW, at, fast=fast)
    (segment,) = solution.segments
    assert segment.prior_misfit is not None
    assert segment.prior_misfit > 2
    assert segment.prior_weight <= (1 + 1e-9) / segment.prior_misfit
    assert segment.unlike_prior
    monkeypatch.setattr(PriorMisfit, "prior_weight", 1.0)
    held, held_m = solved(NARROW, at, fast=fast)
    assert held.segments[0].prior_weight == 1.0
    assert error_m < (0.9 if fast else 0.7) * held_m


def test_fit_without_a_prior_has_no_misfit():
    (segment,) = solved(PLAIN, NARROW.mean, fast=True)[0].segments
    assert (segment.prior_misfit, segment.prior_weight) == (None, 1.0)


def test_a_prior_that_fits_keeps_its_weight():
    (segment,) = solved(NARROW, NARROW.mean)[0].segments
    assert segment.prior_misfit is not None
    assert segment.prior_misfit < 1
    assert segment.prior_weight == 1
