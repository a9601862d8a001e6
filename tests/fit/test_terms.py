"""Every term's rows have the exact gradient of its cost, at random points; a new term is one line in `terms`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.animal.prior import load_prior
from recon.animal.skeleton_file import load_skeleton
from recon.clip import View, still_view
from recon.fit.least_squares import LeastSquares
from recon.fit.terms import (
    Heading,
    KnownAngles,
    Linear,
    OnGround,
    PoseMixture,
    Reprojection,
    Span,
    StanceVelocity,
    climb_term,
    dynamics_term,
    pose_term,
    root_term,
)
from recon.geometry.camera import Camera

FPS = 90.0
T = 5
CAMERA = Camera.from_hfov(60.0, (1920, 1080))
BODY = load_skeleton("cheetah-24", "phantom")
PRIOR = load_prior("running-cheetah", BODY)
FEET = np.array([BODY.markers.index(foot) for foot in BODY.feet])


def some_states(seed: int = 0) -> np.ndarray:
    """A body that runs past the camera, every angle off its mean."""
    rng = np.random.default_rng(seed)
    states = np.zeros((T, BODY.n_state))
    states[:, 4:] = PRIOR.mean + 0.2 * rng.normal(size=(T, BODY.n_state - 4))
    states[:, :3] = [0.3, 7.0, -0.2] + np.arange(T)[:, None] * [0.1, 0.02, 0.01] + 0.02 * rng.normal(size=(T, 3))
    states[:, 3] = 0.3 + 0.05 * rng.normal(size=T)
    return states


def view(xy_px: np.ndarray, confidence: np.ndarray | None = None, camera: Camera = CAMERA) -> View:
    """The view of a camera in the origin that stands level."""
    return still_view(camera, xy_px, np.ones(xy_px.shape[:2]) if confidence is None else confidence)


def pixels(states: np.ndarray) -> np.ndarray:
    points_m = BODY.tree.pose(states).points_m
    return view(np.zeros((*points_m.shape[:2], 2))).project(points_m)[0]


def detections(states: np.ndarray) -> np.ndarray:
    """Off by some 10 px, one of them grossly, one missing."""
    xy_px = pixels(states)
    xy_px = xy_px + 10 * np.random.default_rng(1).normal(size=xy_px.shape)
    xy_px[1, 3] += 200.0
    xy_px[2, 5] = np.nan
    return xy_px


def moving_view(xy_px: np.ndarray, confidence: np.ndarray) -> View:
    """A fisheye that pans, travels and zooms."""
    lens = replace(CAMERA, model="fisheye", distortion=np.array([0.05, -0.01, 0.0, 0.0]))
    still, turn = view(xy_px, confidence, lens), 0.03 * np.arange(T)
    pan = np.tile(np.eye(4), (T, 1, 1))
    pan[:, 0, 0], pan[:, 0, 2], pan[:, 2, 0], pan[:, 2, 2] = np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)
    pan[:, :3, 3] = np.outer(np.arange(T), [0.1, 0.02, -0.05])
    zoom = np.array([1500.0, 1510.0, 950.0, 545.0]) + np.outer(np.arange(T), [30.0, 30.0, 1.0, -1.0])
    return replace(still, T_camera_world=pan @ still.T_camera_world, intrinsics_px=zoom)


def terms():
    xy_px = detections(some_states(1))
    confidence, sigma = np.linspace(0.5, 1, xy_px[..., 0].size).reshape(xy_px.shape[:2]), np.full(xy_px.shape[:2], 8.0)
    contact = np.random.default_rng(3).uniform(size=(T - 1, len(FEET)))
    D = BODY.n_state
    rear, front = (BODY.markers.index(marker) for marker in BODY.forward)
    return [
        pose_term(PRIOR, D, FPS, 2.0),
        dynamics_term(PRIOR, D, FPS, 1.5),
        root_term(D, FPS, np.array([12.0, 12.0, 9.0]), 40.0),
        climb_term(D, FPS, 0.5),
        PoseMixture(PRIOR, FPS, 0.7),
        PoseMixture(PRIOR, FPS, 1.0, temperature=5.0),
        Reprojection(view(xy_px, confidence), sigma, 3.0, np.zeros(3)),
        Reprojection(replace(view(xy_px, confidence), offset_frames=0.3), sigma, 3.0, np.zeros(3)),
        Reprojection(moving_view(xy_px, confidence), sigma, 3.0, np.zeros(3)),
        Heading(rear, front, FPS, 0.5),
        KnownAngles(some_states(1), 0.05),
        StanceVelocity(FEET, FPS, 2.5, 2.0),
        OnGround(FEET, contact, np.array([-0.8, 0.01, -0.02]), np.array([0.3, 7.0]), FPS, 0.04),
    ]


def gradient(term, states: np.ndarray) -> np.ndarray:
    problem = LeastSquares(BODY.tree, [term], []) if isinstance(term, Linear) else LeastSquares(BODY.tree, [], [term])
    return problem.normal(states).gradient


def cost(term, states: np.ndarray) -> float:
    problem = LeastSquares(BODY.tree, [term], []) if isinstance(term, Linear) else LeastSquares(BODY.tree, [], [term])
    return problem.cost(states)


@pytest.mark.parametrize("term", terms(), ids=lambda t: t.name)
def test_rows_have_the_gradient_of_the_cost(term):
    """Central differences along 20 random directions."""
    states, rng = some_states(), np.random.default_rng(2)
    exact = gradient(term, states)
    for _ in range(20):
        direction = rng.normal(size=states.shape)
        h = 1e-5
        slope = (cost(term, states + h * direction) - cost(term, states - h * direction)) / (2 * h)
        assert slope == pytest.approx(np.sum(exact * direction), rel=2e-5, abs=1e-4 * np.linalg.norm(exact))


@pytest.mark.parametrize("term", terms(), ids=lambda t: t.name)
def test_says_which_frames_it_reads(term):
    """A change of one frame changes the gradient within the stencil's reach only, and there somewhere."""
    states, reach = some_states(), term.stencil[-1] - term.stencil[0]
    other = states.copy()
    other[2] += 0.01
    changed = np.abs(gradient(term, other) - gradient(term, states)).max(axis=1) > 0
    assert changed.any()
    assert not changed[np.abs(np.arange(T) - 2) > reach].any()


def test_priors_count_the_same_per_second_at_any_frame_rate():
    """Twice the frames, half the weight each."""
    states = some_states()
    for make in (lambda fps: pose_term(PRIOR, BODY.n_state, fps, 1.0), lambda fps: PoseMixture(PRIOR, fps, 1.0)):
        assert cost(make(FPS), states) == pytest.approx(2 * cost(make(2 * FPS), states))


def test_a_steady_gait_of_the_prior_costs_no_motion():
    """The dynamics' own path: z'' = drift [z - mean, z'] stepped exactly as the term differences it."""
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


def test_a_component_on_its_own_is_a_gaussian():
    """K = 1: the mixture's cost less its constant is the Gaussian's."""
    from recon.animal.prior_fit import as_one_gaussian

    one = as_one_gaussian(PRIOR)
    a, b = some_states(0), some_states(1)
    linear, mixture = pose_term(one, BODY.n_state, FPS, 1.0), PoseMixture(one, FPS, 1.0)
    assert cost(mixture, a) - cost(mixture, b) == pytest.approx(cost(linear, a) - cost(linear, b))


def test_a_detection_far_off_hardly_pulls():
    """The pull of 1000 px is less than that of 20 px, and a missing point has none."""
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


def test_joints_behind_the_camera_cost_much_and_finitely():
    states = some_states()
    xy_px = pixels(states)
    term = Reprojection(view(xy_px), np.full(xy_px.shape[:2], 5.0), 3.0, np.zeros(3))
    behind = states.copy()
    behind[:, 1] = -5.0
    assert cost(term, states) == pytest.approx(0, abs=1e-9)
    assert 1e3 < cost(term, behind) < np.inf


def test_spans_overlap_by_one_frame():
    """Each row stands for a frame once, however the clip is cut."""
    pose = BODY.tree.pose_with_jacobian(some_states())
    assert Span(0, some_states(), pose, is_last=True).own_rows == slice(0, T)
    assert Span(0, some_states(), pose, is_last=False).own_rows == slice(0, T - 1)
