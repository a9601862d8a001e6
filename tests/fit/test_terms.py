"""Test that the rows of every term have the exact gradient of the term's cost, at random states.

A new term is one line in `terms` of tests/term_cases.py.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from term_cases import (
    BODY,
    FPS,
    PRIOR,
    T,
    detections,
    gradient,
    pixels,
    some_states,
    terms,
    view,
)

from recon.fit.clip_problem import ClipProblem, TrajectoryOptions, contacts
from recon.fit.least_squares import LeastSquares
from recon.fit.terms import (
    MARKER_TERMS,
    Linear,
    PoseMixture,
    Reprojection,
    Span,
    dynamics_term,
    pose_term,
)
from recon.geometry.kinematics import TreePose


def cost(term, states: np.ndarray) -> float:
    problem = LeastSquares(BODY.tree, [term], []) if isinstance(term, Linear) else LeastSquares(BODY.tree, [], [term])
    return problem.cost(states)


def test_every_term_of_a_fit_is_tested_and_on_the_page_of_the_method():
    states = some_states()
    options = TrajectoryOptions()
    clip = ClipProblem.from_views([view(detections(states))], BODY, PRIOR, FPS, options, ground_near_zero=True)
    clip = replace(clip, known_states=states, prior_weight=0.5)
    points_m = clip.markers(states)
    problems = (clip.problem(np.ones((1, T, len(BODY.markers))), temperature) for temperature in (None, 1.0))
    of_fit = {term.name for problem in problems for term in (*problem.linear, *problem.terms)}
    of_fit |= {term.name for term in contacts(clip, points_m, 1.0)[2]}
    assert {"reprojection", "climb", "stance", "known angles"} <= of_fit <= {term.name for term in terms()}
    page = (Path(__file__).parents[2] / "docs" / "method" / "trajectory.md").read_text(encoding="utf-8")
    of_clips = of_fit - {"known angles"}  # only for measuring an animal against known poses
    assert not [name for name in of_clips if f"\n**{name.capitalize()}" not in page]


@pytest.mark.parametrize("term", terms(), ids=lambda t: t.name)
def test_rows_have_the_gradient_of_the_cost(term):
    """The gradient agrees with central differences along 20 random directions."""
    states, rng = some_states(), np.random.default_rng(2)
    exact = gradient(term, states)
    for _ in range(20):
        direction = rng.normal(size=states.shape)
        h = 1e-5
        slope = (cost(term, states + h * direction) - cost(term, states - h * direction)) / (2 * h)
        assert slope == pytest.approx(np.sum(exact * direction), rel=2e-5, abs=1e-4 * np.linalg.norm(exact))


@pytest.mark.parametrize("term", terms(), ids=lambda t: t.name)
def test_stencil_names_the_frames_that_a_term_reads(term):
    """A change of one frame changes the gradient only within the stencil."""
    states, reach = some_states(), term.stencil[-1] - term.stencil[0]
    other = states.copy()
    other[2] += 0.01
    changed = np.abs(gradient(term, other) - gradient(term, states)).max(axis=1) > 0
    assert changed.any()
    assert not changed[np.abs(np.arange(T) - 2) > reach].any()


def test_priors_count_the_same_per_second_at_any_frame_rate():
    """A pose costs half as much per frame at twice the frame rate."""
    states = some_states()
    for make in (lambda fps: pose_term(PRIOR, BODY.n_state, fps, 1.0), lambda fps: PoseMixture(PRIOR, fps, 1.0)):
        assert cost(make(FPS), states) == pytest.approx(2 * cost(make(2 * FPS), states))


def test_steady_gait_of_the_prior_has_no_motion_cost():
    """The gait follows z'' = drift [z - mean, z'], with the term's own differences."""
    dt, A = 1 / FPS, len(PRIOR.mean)
    by_angle, by_rate = PRIOR.drift[:, :A], PRIOR.drift[:, A:]
    z = [PRIOR.mean + 0.1, PRIOR.mean + 0.102]
    for _ in range(T - 2):
        before, now = z[-2:]
        left = np.eye(A) / dt**2 - by_rate / (2 * dt)
        right = (2 * now - before) / dt**2 + by_angle @ (now - PRIOR.mean) - by_rate @ before / (2 * dt)
        z.append(np.linalg.solve(left, right))
    states = np.zeros((T, BODY.n_state))
    states[:, 4:] = z
    assert cost(dynamics_term(PRIOR, BODY.n_state, FPS, 1.0), states) < 1e-12


def test_mixture_of_one_component_is_a_gaussian():
    """A mixture of one component has the cost of a Gaussian, up to a constant."""
    from recon.animal.prior_fit import as_one_gaussian

    one = as_one_gaussian(PRIOR)
    a, b = some_states(0), some_states(1)
    linear, mixture = pose_term(one, BODY.n_state, FPS, 1.0), PoseMixture(one, FPS, 1.0)
    assert cost(mixture, a) - cost(mixture, b) == pytest.approx(cost(linear, a) - cost(linear, b))


def test_distant_detection_hardly_pulls():
    """An error of 1000 px has a smaller gradient than an error of 20 px, and a missing point has no gradient."""
    states = some_states()
    xy_px = pixels(states)
    pulls = []
    for off in (20.0, 1000.0, np.nan):
        moved = xy_px.copy()
        moved[2, 4, 0] += off
        term = Reprojection(view(moved), np.full(xy_px.shape[:2], 5.0), 3.0, np.zeros(3))
        pulls.append(np.linalg.norm(gradient(term, states)))
    assert pulls[1] < pulls[0] / 5
    assert pulls[2] == pytest.approx(0, abs=1e-6)


def test_joints_behind_the_camera_have_a_large_finite_cost():
    states = some_states()
    xy_px = pixels(states)
    term = Reprojection(view(xy_px), np.full(xy_px.shape[:2], 5.0), 3.0, np.zeros(3))
    behind = states.copy()
    behind[:, 1] = -5.0
    assert cost(term, states) == pytest.approx(0, abs=1e-9)
    assert 1e3 < cost(term, behind) < np.inf


def test_spans_overlap_by_one_frame():
    """Each row belongs to one frame, for any division of the clip into spans."""
    pose = BODY.tree.pose_with_jacobian(some_states())
    assert Span(0, some_states(), pose, is_last=True).own_rows == slice(0, T)
    assert Span(0, some_states(), pose, is_last=False).own_rows == slice(0, T - 1)


def test_every_term_that_reads_markers_is_listed():
    """A term missing in `MARKER_TERMS` would lack derivatives with respect to lengths and offsets."""
    states, poseless = some_states(), cast(TreePose, None)
    for term in terms():
        if not isinstance(term, (Linear, *MARKER_TERMS)):
            term.evaluate(Span(0, states, poseless, True), jacobian=True)
