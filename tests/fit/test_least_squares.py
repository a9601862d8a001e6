"""Test that the banded solution of a clip's least-squares problem equals the dense solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from term_cases import BODY, FEET, FPS, PRIOR, T, detections, gradient, some_states, terms, to_dense, view

from recon.fit import least_squares as module
from recon.fit.body_shape import FreeShape
from recon.fit.least_squares import Estimate, LeastSquares, SharedUnknown
from recon.fit.posterior import posterior
from recon.fit.terms import (
    COMMON_KEYPOINT_BIAS,
    LENGTHS,
    SIDESLIP,
    SIZE,
    Heading,
    Linear,
    OnGround,
    Reprojection,
    StanceVelocity,
    climb_term,
    dynamics_term,
    extrinsic_correction,
    focal_scale,
    keypoint_bias,
    pose_term,
    root_term,
    time_offset,
)
from recon.geometry.kinematics import Marker, Segment, Tree


def whole_problem() -> LeastSquares:
    every = terms()
    return LeastSquares(
        BODY.tree, [t for t in every if isinstance(t, Linear)], [t for t in every if not isinstance(t, Linear)]
    )


def equations(problem: LeastSquares, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    normal = problem.normal(states)
    return normal.blocks, normal.gradient


def dense_rows(problem: LeastSquares, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all rows of all terms and their Jacobian (M, TD), as a slow reference."""
    residuals, jacobians = [], []
    D = states.shape[1]

    def put(frame: int, stencil, r: np.ndarray, slots: np.ndarray) -> None:
        J = np.zeros((len(r), states.size))
        for offset, slot in zip(stencil, slots, strict=True):
            J[:, (frame + offset) * D : (frame + offset + 1) * D] += slot
        residuals.append(r)
        jacobians.append(J)

    for term in problem.linear:
        for frame, r in zip(term.frames(len(states)), term.residual(states), strict=True):
            put(frame, term.stencil, r, term.slots)
    (span,) = problem.spans(states, {}, jacobian=True)
    for term in problem.terms:
        rows = term.evaluate(span, jacobian=True)
        for i in range(len(rows.cost)):
            put(i, term.stencil, rows.residual[i], rows.jacobian[i].transpose(1, 0, 2))
    return np.concatenate(residuals), np.concatenate(jacobians)


def test_normal_equations_equal_dense_equations():
    problem, states = whole_problem(), some_states()
    r, J = dense_rows(problem, states)
    H, g = equations(problem, states)
    np.testing.assert_allclose(to_dense(H), J.T @ J, rtol=1e-9, atol=1e-9 * np.abs(J.T @ J).max())
    np.testing.assert_allclose(g.ravel(), J.T @ r, rtol=1e-9, atol=1e-9 * np.abs(J.T @ r).max())


def seen_late(shared: bool = True) -> LeastSquares:
    """Return a problem of two views with unknowns that all frames share, including the size."""
    rng, xy_px = np.random.default_rng(5), detections(some_states(1))
    sigma, J = np.full(xy_px.shape[:2], 8.0), xy_px.shape[1]
    seen = [
        Reprojection(of, sigma, 3.0, np.zeros(3), i, 0.1 * rng.normal(size=(T, J, 3)), rng.uniform(100, 200, T))
        for i, of in enumerate((view(xy_px), replace(view(xy_px), offset_frames=0.3)))
    ]
    unknown = [SharedUnknown(SIZE, np.ones(1), np.array([0.1])), SharedUnknown(SIDESLIP, np.zeros(1), np.array([0.2]))]
    unknown += [SharedUnknown(time_offset(i), np.zeros(1), np.array([0.3])) for i in range(2)]
    unknown += [SharedUnknown(focal_scale(i), np.zeros(1), np.array([0.1])) for i in range(2)]
    unknown += [SharedUnknown(extrinsic_correction(1), np.zeros(6), np.repeat([0.1, 0.5], 3))]
    displaced = [SharedUnknown(keypoint_bias(i), np.zeros(2 * J), np.full(2 * J, 0.03)) for i in range(2)]
    common = [] if shared else [SharedUnknown(COMMON_KEYPOINT_BIAS, np.zeros(3 * J), np.full(3 * J, 0.02))]
    linear = [t for t in terms() if isinstance(t, Linear)]
    held = Linear("held", (0,), 0.01 * np.eye(BODY.n_state)[None], np.zeros(BODY.n_state))  # determines the last frame
    free = [*unknown, *displaced] if shared else unknown
    stance = StanceVelocity(FEET, FPS, 2.5, 2.0)
    driven = replace(stance, at=0.9, by_size=rng.normal(size=(T - 1, len(FEET), 3)))
    contact, plane = rng.uniform(size=(T - 1, len(FEET))), np.array([-0.8, 0.01, -0.02])
    ground = OnGround(FEET, contact, plane, np.array([0.3, 7.0]), FPS, 0.04, at=0.9)
    rear, front = (BODY.markers.index(marker) for marker in BODY.forward)
    return LeastSquares(
        BODY.tree,
        [*linear, held],
        [*seen, stance, driven, ground, Heading(rear, front, FPS, 0.5)],
        free,
        () if shared else [*displaced, *common],
    )


def some_shared(problem: LeastSquares) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(6)
    return {u.name: u.mean + 0.3 * u.sigma * rng.normal(size=len(u.mean)) for u in problem.shared}


def with_shape() -> LeastSquares:
    """Return a problem with the body's lengths and keypoint offsets among the shared unknowns."""
    problem, shape, J = seen_late(), FreeShape.of_body(BODY), len(BODY.markers)
    unknown = [
        SharedUnknown(LENGTHS, np.zeros(len(shape.lengths)), np.full(len(shape.lengths), 0.1)),
        SharedUnknown(COMMON_KEYPOINT_BIAS, np.zeros(3 * J), np.full(3 * J, 0.02)),
    ]
    return replace(problem, shared=[*problem.shared, *unknown], shape=shape, tree=BODY.detected)


@pytest.mark.parametrize("problem", [seen_late(), with_shape()], ids=["shared", "shape"])
def test_shared_unknowns_have_the_gradient_of_the_cost(problem):
    """The gradient agrees with central differences along random directions of all unknowns together."""
    states = some_states()
    shared, rng, h = some_shared(problem), np.random.default_rng(2), 1e-5
    normal = problem.normal(states, shared)
    for _ in range(10):
        step, by_name = rng.normal(size=states.shape), {name: rng.normal(size=v.shape) for name, v in shared.items()}
        up, down = (
            problem.cost(states + s * h * step, {name: v + s * h * by_name[name] for name, v in shared.items()})
            for s in (1, -1)
        )
        along = sum(normal.shared_gradient[own] @ by_name[name] for name, own in problem.columns.items())
        exact = float(np.sum(normal.gradient * step) + along)
        assert (up - down) / (2 * h) == pytest.approx(exact, rel=2e-5, abs=1e-4 * np.linalg.norm(normal.gradient))


def of_three_cameras(*, free_shape: bool) -> LeastSquares:
    """Return a problem of three cameras, one of them late, and a body with a free shape or a common keypoint bias."""
    problem, J, rng = with_shape() if free_shape else seen_late(), len(BODY.markers), np.random.default_rng(5)
    late = next(term for term in problem.terms if isinstance(term, Reprojection))
    cameras = [replace(late, view=replace(late.view, offset_frames=0.0), number=number) for number in (1, 2)]
    cameras = [replace(camera, sigma_px=rng.uniform(5.0, 20.0, camera.sigma_px.shape)) for camera in cameras]
    unknown = [
        SharedUnknown(name(number), np.zeros(count), np.full(count, 0.1))
        for number in (1, 2)
        for name, count in ((extrinsic_correction, 6), (focal_scale, 1), (time_offset, 1), (keypoint_bias, 2 * J))
    ]
    if not free_shape:
        unknown.append(SharedUnknown(COMMON_KEYPOINT_BIAS, np.zeros(3 * J), np.full(3 * J, 0.1)))
    names = {u.name for u in problem.shared}
    shared = [*problem.shared, *(u for u in unknown if u.name not in names)]
    return replace(problem, terms=[*problem.terms, *cameras], shared=shared)


@pytest.mark.parametrize("frames_at_once", [2, 128])
@pytest.mark.parametrize("free_shape", [True, False])
def test_summed_cameras_and_feet_give_the_equations_of_each_terms_rows(monkeypatch, free_shape, frames_at_once):
    monkeypatch.setattr(module, "_FRAMES_AT_ONCE", frames_at_once)
    problem, states, rng = of_three_cameras(free_shape=free_shape), some_states(), np.random.default_rng(6)
    shared = {name: mean + 0.01 * rng.normal(size=mean.shape) for name, mean in problem.expected().items()}
    summed = problem.normal(states, shared)
    monkeypatch.setattr(LeastSquares, "_cameras_in_step", lambda *_: [])
    by_rows = problem.normal(states, shared)
    for name in ("blocks", "gradient", "border", "corner", "shared_gradient"):
        expected = getattr(by_rows, name)
        np.testing.assert_allclose(getattr(summed, name), expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_residuals_follow_a_common_keypoint_bias():
    """The residuals agree with keypoints displaced in all cameras, also between two frames."""
    problem, states, h = seen_late(shared=False), some_states(), 1e-6
    J = len(BODY.markers)
    shared = problem.expected() | {COMMON_KEYPOINT_BIAS: np.zeros(3 * J)}
    (span,) = problem.spans(states, shared, jacobian=True)
    for term in problem.terms[:2]:
        rows = term.evaluate(span, jacobian=True)
        of_marker = rows.by_shared[COMMON_KEYPOINT_BIAS].reshape(*rows.by_shared[COMMON_KEYPOINT_BIAS].shape[:2], J, 3)
        for marker in ("l_hip", "nose"):
            moved = []
            for step in (h, -h):
                tree = replace(BODY, keypoint_offset_m={marker: (0.0, step, 2 * step)}).detected
                (there,) = replace(problem, tree=tree).spans(states, shared, jacobian=True)
                moved.append(term.evaluate(there, jacobian=False).cost)
            slope = (moved[0] - moved[1]) / (2 * h)
            along = of_marker[:, :, BODY.markers.index(marker)] @ [0.0, 1.0, 2.0]
            np.testing.assert_allclose(np.sum(rows.residual * along, axis=1), slope, rtol=1e-4, atol=1e-3)


def test_posterior_equals_the_dense_posterior():
    """The posterior's covariances of the joints at a given size, and of the size, equal the dense ones."""
    problem, states = seen_late(shared=False), some_states()
    shared, factor = some_shared(problem), 3.0
    found = posterior(problem, BODY, Estimate(states, 0.0, 1, True, shared), factor)
    every = replace(problem, shared=[*problem.shared, *problem.nuisance], nuisance=())
    normal = every.normal(states, every.expected() | shared)
    n, P = states.size, len(normal.corner)
    border = normal.border.reshape(n, P)
    whole = np.block([[to_dense(normal.blocks), border], [border.T, normal.corner]])
    # The size is the first unknown of the border.
    given = np.linalg.inv(np.delete(np.delete(whole, n, 0), n, 1))[:n, :n]
    jacobian = BODY.tree.pose_with_jacobian(states).jacobian
    assert jacobian is not None
    D = states.shape[1]
    for t in range(T):
        own = given[t * D : (t + 1) * D, t * D : (t + 1) * D]
        dense = factor * jacobian[t] @ own @ jacobian[t].swapaxes(1, 2)
        np.testing.assert_allclose(found.covariance_m2[t], dense, rtol=1e-5, atol=1e-9)
    of_size = 1.0 / np.linalg.inv(whole)[n, n] - problem.shared[0].sigma[0] ** -2
    assert found.size_precision == pytest.approx(of_size / factor, rel=1e-5)


def test_step_equals_the_dense_step():
    from recon.fit.banded import factored

    problem, states = whole_problem(), some_states()
    r, J = dense_rows(problem, states)
    H, g = equations(problem, states)
    factor = factored(H, np.full(g.shape, 1e-3))
    step = factor.unwhiten(factor.whiten(-g))
    dense = np.linalg.solve(J.T @ J + 1e-3 * np.eye(states.size), -J.T @ r)
    np.testing.assert_allclose(step.ravel(), dense, rtol=1e-6, atol=1e-8)


def test_pieces_of_a_clip_add_up(monkeypatch):
    """The costs and equations of pieces of two frames add up to the cost and equations of the clip."""
    problem, states = whole_problem(), some_states()
    whole_cost, (H, g) = problem.cost(states), equations(problem, states)
    monkeypatch.setattr(module, "_FRAMES_AT_ONCE", 2)
    assert problem.cost(states) == pytest.approx(whole_cost)
    cut, cut_g = equations(problem, states)
    np.testing.assert_allclose(to_dense(cut), to_dense(H), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(cut_g, g, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("piece", [2, 3])
def test_the_equations_of_a_long_clip_come_in_pieces(monkeypatch, piece):
    """The pieces add up to the equations of the whole clip, with its shared unknowns."""
    monkeypatch.setattr(module, "_FRAMES_AT_ONCE", 1)
    problem, states = seen_late(shared=True), some_states()
    shared = some_shared(problem)
    whole, parts = problem.normal(states, shared), [*replace(problem, piece=piece).normals(states, shared)()]
    assert len(parts) == (T - 1) // piece
    for name in ("gradient", "border"):
        both = np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name)
        np.testing.assert_allclose(*both, rtol=1e-9, atol=1e-6)
    joined = np.concatenate([part.blocks for part in parts])
    np.testing.assert_allclose(to_dense(joined), to_dense(whole.blocks), rtol=1e-9, atol=1e-6)
    for name in ("corner", "shared_gradient"):
        both = sum(getattr(part, name) for part in parts), getattr(whole, name)
        np.testing.assert_allclose(*both, rtol=1e-9, atol=1e-6)
    assert sum(part.cost for part in parts) == pytest.approx(problem.cost(states, shared))


def test_a_middle_piece_equals_its_part_of_the_clip(monkeypatch):
    monkeypatch.setattr(module, "_FRAMES_AT_ONCE", 1)
    problem, states = replace(seen_late(shared=True), piece=2), some_states()
    shared = some_shared(problem)
    rows, middle = problem.middle_piece(states, shared)
    assert 0 < rows.start <= T // 2 < rows.stop
    parts = [*problem.normals(states, shared)()]
    starts = np.cumsum([0, *(len(part.gradient) for part in parts)]).tolist()
    part = parts[starts.index(rows.start)]
    for name in ("blocks", "gradient", "border", "corner", "shared_gradient"):
        np.testing.assert_array_equal(getattr(middle, name), getattr(part, name))
    rows, whole = replace(problem, piece=T).middle_piece(states, shared)
    assert rows == slice(0, T)
    np.testing.assert_array_equal(whole.blocks, problem.normal(states, shared).blocks)


def test_minimum_of_a_linear_problem_takes_one_step():
    """The minimum agrees with the closed form of least squares."""
    D = BODY.n_state
    position = Linear("place", (0,), np.eye(D)[None, :4], np.array([1.0, 5.0, -0.3, 0.2]))
    linear = [
        pose_term(PRIOR, D, FPS, 1.0),
        dynamics_term(PRIOR, D, FPS, 1.0),
        root_term(D, FPS, np.array([12.0, 12.0, 9.0]), 40.0),
        climb_term(D, FPS, 0.5),
        position,
    ]
    problem, states = LeastSquares(BODY.tree, linear, []), some_states()
    r, J = dense_rows_of_linear(linear, states)
    found = problem.minimise(states, 1e-12, 20)
    assert found.converged
    np.testing.assert_allclose(found.states.ravel(), states.ravel() - np.linalg.lstsq(J, r, rcond=None)[0], atol=1e-5)


def dense_rows_of_linear(linear, states):
    return dense_rows(_Quiet(BODY.tree, linear, []), states)


class _Quiet(LeastSquares):
    """Problem without non-linear terms, which never computes the pose of a span."""


@pytest.mark.slow
def test_no_direction_leads_below_the_minimum():
    """The cost is higher along all directions, and scipy's solver stays at the minimum."""
    problem = whole_problem()
    found = problem.minimise(some_states(), 1e-10, 200)
    assert found.converged
    H, g = equations(problem, found.states)
    assert np.abs(g).max() < 1e-3 * np.sqrt(np.diagonal(H[:, 0], axis1=1, axis2=2).max())
    other = least_squares(lambda x: np.sqrt(2 * problem.cost(x.reshape(T, -1)) + 1e4), found.states.ravel(), max_nfev=2)
    assert problem.cost(other.x.reshape(T, -1)) > found.cost - 1e-3


def test_search_reports_that_it_did_not_converge():
    found = whole_problem().minimise(some_states(), 1e-12, 2)
    assert not found.converged
    assert found.iterations == 2


def test_a_search_without_any_step_ends_at_its_start(monkeypatch):
    def no_step(*_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(module, "step", no_step)
    problem, states = whole_problem(), some_states()
    found = problem.minimise(states, 1e-6, 10)
    assert (found.converged, found.iterations, found.cost) == (True, 1, problem.cost(states))
    np.testing.assert_array_equal(found.states, states)


@pytest.mark.parametrize(
    ("whole_until", "iterations"),
    [
        (9, 3),  # decreases of 500, 50 and 5: the next one will be 0.5, less than 400 x 0.002
        (0, 4),  # shortened steps do not predict the next decrease
    ],
)
def test_a_search_ends_when_the_next_step_will_gain_too_little(monkeypatch, whole_until, iterations):
    decreases = iter((500.0, 50.0, 5.0, 0.5, 0.05))

    def damped_step(problem, current, damping, tolerance):
        current = replace(current, cost=1000.0) if np.isnan(current.cost) else current
        lower = replace(current, cost=current.cost - next(decreases))
        return current, lower, current.iterations < whole_until, damping

    monkeypatch.setattr(LeastSquares, "_damped_step", damped_step)
    estimate = whole_problem().minimise(some_states(), 0.002, 10)
    assert estimate.converged
    assert estimate.iterations == iterations


def test_costs_are_named():
    problem, states = whole_problem(), some_states()
    costs = problem.costs(states)
    assert set(costs) == {t.name for t in terms()}
    assert sum(costs.values()) == pytest.approx(problem.cost(states))
    reprojections = [t for t in terms() if t.name == "reprojection"]
    rest = replace(problem, terms=[t for t in problem.terms if t.name != "reprojection"])
    H, g = equations(rest, states)
    np.testing.assert_allclose(
        g + sum(gradient(t, states) for t in reprojections), problem.normal(states).gradient, atol=1e-6
    )
    assert np.abs(to_dense(H)).max() > 0


def test_a_slow_shift_in_depth_is_found():
    """The whole path starts one metre too far away, and is found in few steps.

    A single marker on a moving root shows its distance only weakly, and every frame is stiff against its neighbours.
    Damping by the diagonal would need many steps.
    """
    tree = Tree((Segment("root", None, "free"),), (Marker("m", "root"),))
    D, frames = tree.n_state, 60
    stiff = np.array([np.eye(D), -2 * np.eye(D), np.eye(D)]) * 1e4
    smooth = Linear("smooth", (-1, 0, 1), stiff, np.zeros(D))
    weak = Linear("weak", (0,), np.eye(D)[None] * 0.1, np.full(D, 0.1))
    found = LeastSquares(tree, [smooth, weak], []).minimise(np.zeros((frames, D)), 1e-9, 6)
    np.testing.assert_allclose(found.states, 1.0, atol=2e-2)


def test_step_of_the_size_keeps_the_position():
    """Two cameras see a marker 20 m from the origin, while the size has to grow by a third and the root to shrink.

    A straight step in root and size would move the marker by a metre.
    """
    tree = Tree((Segment("root", None, "free"),), (Marker("m", "root"),))
    states = np.zeros((40, tree.n_state))
    states[:, :3] = [0.5, 20.0, 0.3] + np.arange(40)[:, None] * [0.1, 0.0, 0.0]
    sights = []
    for number, shift_m in enumerate((-10.0, 10.0)):
        camera = view(np.zeros((40, 1, 2)))
        camera = replace(camera, T_camera_world=camera.T_camera_world.copy())
        camera.T_camera_world[:3, 3] = [shift_m, 0.0, 0.0]
        seen = replace(camera, xy_px=camera.project(tree.pose(states).points_m)[0])
        sights.append(Reprojection(seen, np.ones((40, 1)), 3.0, np.zeros(3), number))
    weak = Linear("weak", (0,), np.eye(tree.n_state)[None] * 1e-4, np.zeros(tree.n_state))
    size = SharedUnknown(SIZE, np.array([4 / 3]), np.array([1e-3]))
    found = LeastSquares(tree, [weak], sights, [size]).minimise(states, 1e-6, 3, {SIZE: np.ones(1)})
    assert found.shared[SIZE] == pytest.approx(4 / 3, abs=1e-4)
    np.testing.assert_allclose(found.shared[SIZE] * found.states[:, :3], states[:, :3], atol=1e-3)


def test_a_step_of_the_size_keeps_the_animal_in_the_picture_of_one_camera():
    """For a camera at the origin, a marker looks the same for each size.

    If the root moved by less because the size grows, the marker would not reach the detection.
    """
    tree = Tree((Segment("root", None, "free"),), (Marker("m", "root"),))
    states = np.zeros((40, tree.n_state))
    states[:, :3] = [0.5, 20.0, 0.3]
    camera = view(np.zeros((40, 1, 2)))
    seen = replace(camera, xy_px=camera.project(tree.pose(states).points_m)[0])
    sight = Reprojection(seen, np.ones((40, 1)), 1e6, np.zeros(3), 0)
    weak = Linear("weak", (0,), np.eye(tree.n_state)[None] * 1e-2, 1e-2 * states[0])
    size = SharedUnknown(SIZE, np.array([4 / 3]), np.array([1e-3]))
    begin = states + np.eye(tree.n_state)[0]
    found = LeastSquares(tree, [weak], [sight], [size]).minimise(begin, 1e-6, 1, {SIZE: np.ones(1)})
    assert found.shared[SIZE] == pytest.approx(4 / 3, abs=1e-2)
    np.testing.assert_allclose(found.states[:, 0], 0.5, atol=1e-2)


def test_an_animal_that_stays_where_it_is_shows_no_sideslip():
    rear, front = (BODY.markers.index(marker) for marker in BODY.forward)
    unknown = SharedUnknown(SIDESLIP, np.zeros(1), np.array([0.2]))
    problem = LeastSquares(BODY.detected, [], [Heading(rear, front, FPS, 0.5)], [unknown])
    normal = problem.normal(np.repeat(some_states()[:1], 3, axis=0))
    np.testing.assert_array_equal(normal.corner, [[0.2**-2.0]])
    np.testing.assert_array_equal(normal.border, 0.0)


def test_a_step_is_extended_to_the_least_cost_on_its_parabola():
    from recon.fit.least_squares import _best_length

    cost = np.polynomial.Polynomial([3.0, -2.0, 0.5])  # the minimum is at 2
    assert _best_length(float(cost(0.0) - cost(1.0)), -2.0) == pytest.approx(2.0)
    assert _best_length(2.5, -2.0) == 4.0  # the cost bends downwards
