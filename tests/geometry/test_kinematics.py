"""Test trees of segments: poses computed by hand, exact derivatives for every kind of joint, and constant lengths."""

from __future__ import annotations

import numpy as np
import pytest

from recon.geometry.kinematics import PITCH, ROLL, ROOT, YAW, Joint, Marker, Segment, Tree, derivatives_of


def tree(*joints: Joint) -> Tree:
    """Return a tree of a root, a chain of segments with the given joints, and a branch, each with a marker."""
    names = ["root", *(f"s{i}" for i in range(len(joints)))]
    offset = (0.3, 0.1, -0.2)
    chain = [Segment(n, p, j, offset) for n, p, j in zip(names[1:], names, joints, strict=False)]
    branch = Segment("branch", "root", "hinge", (-0.2, 0.1, 0.0))
    markers = [Marker(f"m_{name}", name, (0.1, -0.2, 0.3)) for name in (*names, "branch")]
    return Tree((Segment("root", None, "free"), *chain, branch), (*markers, Marker("at_root", "root")))


TREES = {
    "root only": tree(),
    "ball": tree("ball", "ball"),
    "universal": tree("universal", "hinge"),
    "hinge": tree("hinge", "hinge", "hinge"),
    "fixed": tree("fixed", "hinge", "fixed"),
    "summed": tree("summed", "summed", "summed"),
    "summed with fixed": tree("fixed", "summed", "fixed", "summed", "fixed"),
    "summed with others": tree("ball", "summed", "hinge", "summed", "ball"),
}


@pytest.fixture(params=TREES)
def some_tree(request: pytest.FixtureRequest) -> Tree:
    return TREES[request.param]


def states_and_sizes(some_tree: Tree, n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.uniform(-3, 3, (n, some_tree.n_state)), rng.uniform(0.5, 2, n)


def test_jacobian_against_central_differences(some_tree: Tree):
    states, sizes = states_and_sizes(some_tree, 10)
    exact, h = some_tree.pose_with_jacobian(states, sizes), 1e-5
    steps = h * np.eye(some_tree.n_state)
    columns = [
        (some_tree.pose(states + s, sizes).points_m - some_tree.pose(states - s, sizes).points_m) / (2 * h)
        for s in steps
    ]
    np.testing.assert_allclose(exact.jacobian, np.stack(columns, axis=-1), rtol=0, atol=1e-7)
    larger, smaller = (some_tree.pose(states, sizes * np.exp(s)).points_m for s in (h, -h))
    np.testing.assert_allclose(exact.d_size, (larger - smaller) / (2 * h), rtol=0, atol=1e-7)
    np.testing.assert_allclose(exact.points_m, some_tree.pose(states, sizes).points_m, rtol=0, atol=1e-12)


def test_frames_are_rotations_and_segments_keep_their_lengths(some_tree: Tree):
    """Frames are rotations, and segments keep their lengths, which are the lengths of the offsets times the size."""
    origins = Tree(some_tree.segments, tuple(Marker(s.name, s.name) for s in some_tree.segments))
    states, sizes = states_and_sizes(some_tree, 20)
    R = some_tree.orientations(states)
    np.testing.assert_allclose(R.transpose(0, 1, 3, 2) @ R, np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-14)
    at = origins.pose(states, sizes).points_m
    names = [s.name for s in some_tree.segments]
    for i, segment in enumerate(some_tree.segments[1:], start=1):
        parent = names.index(str(segment.parent))
        shift = at[:, i] - at[:, parent]
        np.testing.assert_allclose(shift, sizes[:, None] * (R[:, parent] @ segment.offset_m), rtol=0, atol=1e-12)


def test_a_pose_by_hand():
    """Positive yaw turns to the left, pitch lowers the front, and roll lowers the right side."""
    root = Tree(
        (Segment("root", None, "free"),), tuple(Marker("xyz"[i], "root", tuple(np.eye(3)[i])) for i in range(3))
    )
    state = np.zeros((4, 6))
    state[0, ROOT] = 1, 2, 3
    state[1, YAW], state[2, PITCH], state[3, ROLL] = np.pi / 2, np.pi / 2, np.pi / 2
    points = root.pose(state, 2.0).points_m
    np.testing.assert_allclose(points[0], [[3, 2, 3], [1, 4, 3], [1, 2, 5]], atol=1e-15)
    np.testing.assert_allclose(points[1], [[0, 2, 0], [-2, 0, 0], [0, 0, 2]], atol=1e-15)
    np.testing.assert_allclose(points[2], [[0, 0, -2], [0, 2, 0], [2, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(points[3], [[2, 0, 0], [0, 0, 2], [0, -2, 0]], atol=1e-15)


def test_the_order_of_rotations_is_yaw_pitch_roll():
    angles = np.random.default_rng(1).uniform(-3, 3, (5, 3))
    (cz, cy, cx), (sz, sy, sx) = np.cos(angles).T, np.sin(angles).T
    one, zero = np.ones(5), np.zeros(5)
    Rz = np.array([[cz, -sz, zero], [sz, cz, zero], [zero, zero, one]]).transpose(2, 0, 1)
    Ry = np.array([[cy, zero, sy], [zero, one, zero], [-sy, zero, cy]]).transpose(2, 0, 1)
    Rx = np.array([[one, zero, zero], [zero, cx, -sx], [zero, sx, cx]]).transpose(2, 0, 1)
    ball = Tree((Segment("root", None, "free"), Segment("ball", "root", "ball")), (Marker("m", "ball"),))
    R = ball.orientations(np.concatenate([np.zeros((5, 3)), angles[::-1], angles], axis=1))
    np.testing.assert_allclose(R[:, 0], (Rz @ Ry @ Rx)[::-1], atol=1e-15)
    np.testing.assert_allclose(R[:, 1], (Rz @ Ry @ Rx)[::-1] @ (Rz @ Ry @ Rx), atol=1e-14)


def test_summed_joints_add_the_angles_of_their_summed_ancestors():
    summed = TREES["summed with others"]
    states, _ = states_and_sizes(summed, 5)
    at = summed.state_names.index
    yaw = states[:, at("phi_s1")] + states[:, at("phi_s3")]
    pitch = states[:, at("theta_s1")] + states[:, at("theta_s3")]
    alone = Tree((Segment("root", None, "free"), Segment("u", "root", "universal")), (Marker("m", "u"),))
    expected = alone.orientations(np.concatenate([states[:, :6], yaw[:, None], pitch[:, None]], axis=1))[:, 1]
    index = [s.name for s in summed.segments].index("s3")
    np.testing.assert_allclose(summed.orientations(states)[:, index], expected, atol=1e-14)


def test_names_of_the_state():
    assert TREES["universal"].state_names == (
        *("x_m", "y_m", "z_m", "root_yaw", "root_pitch", "root_roll"),
        *("s0_yaw", "s0_pitch", "s1_pitch", "branch_pitch"),
    )
    summed = Tree((Segment("J0", None, "free"), Segment("J6", "J0", "summed")), (Marker("m", "J6"),))
    assert summed.state_names[6:] == ("phi_6", "theta_6")
    assert summed.axes == ("z", "y", "x", "z", "y")


def test_many_frames_and_none(some_tree: Tree):
    """The poses of many frames equal those of single frames, and no frames give empty arrays."""
    states, sizes = states_and_sizes(some_tree, 150)
    many, one = some_tree.pose_with_jacobian(states, sizes), some_tree.pose_with_jacobian(states[-1:], sizes[-1:])
    np.testing.assert_allclose(many.points_m[-1:], one.points_m, rtol=0, atol=1e-12)
    np.testing.assert_allclose(many.jacobian[-1:], one.jacobian, rtol=0, atol=1e-12)
    none = some_tree.pose_with_jacobian(states[:0])
    assert none.jacobian.shape == (0, len(some_tree.markers), 3, some_tree.n_state)
    assert some_tree.pose(states[:0]).points_m.shape == (0, len(some_tree.markers), 3)


MACHINE = Tree(
    (
        Segment("base", None, "free"),
        Segment("a", "base", "turn", (0.1, 0.2, 0.3), ((1.0, 0.0, 0.0), (0.0, 0.6, -0.8), (0.0, 0.8, 0.6))),
        Segment("b", "a", "slide", (0.0, 0.1, -0.2), ((0.6, 0.0, 0.8), (0.0, 1.0, 0.0), (-0.8, 0.0, 0.6))),
        Segment("c", "b", "turn", (0.3, 0.0, 0.0)),
    ),
    (Marker("on_b", "b"), Marker("tip", "c", (0.2, -0.1, 0.1))),
)


@pytest.mark.parametrize("some_tree", [*TREES.values(), MACHINE], ids=[*TREES, "machine"])
def test_second_derivatives_against_central_differences(some_tree: Tree):
    rng, h = np.random.default_rng(2), 1e-5

    def derivatives(state):
        return derivatives_of(some_tree, some_tree.moved(state[None], np.ones(1)))

    for state in rng.uniform(-2, 2, (3, some_tree.n_state)):
        weights = rng.normal(size=(len(some_tree.markers), 3))
        jacobian, _, curvature = derivatives(state)
        whole = some_tree.pose_with_jacobian(state[None])
        np.testing.assert_allclose(jacobian, whole.jacobian[0], atol=1e-14)
        steps = h * np.eye(some_tree.n_state)
        both = [(derivatives(state + s)[0], derivatives(state - s)[0]) for s in steps]
        numeric = np.array([((a - b) / (2 * h) * weights[..., None]).sum(axis=(0, 1)) for a, b in both])
        np.testing.assert_allclose(curvature(weights), numeric[3:, 3:], atol=1e-7)


def test_a_slide_shifts_its_descendants_along_its_axis():
    state = np.random.default_rng(3).uniform(-1, 1, (1, MACHINE.n_state))
    moved = state.copy()
    moved[0, MACHINE.state_names.index("b_slide")] += 0.25
    axis = MACHINE.orientations(state)[0, 2, :, 2]
    np.testing.assert_allclose(
        MACHINE.pose(moved).points_m - MACHINE.pose(state).points_m, [[0.25 * axis] * 2], atol=1e-14
    )
    shifts = (MACHINE.origins(moved) - MACHINE.origins(state))[0]
    np.testing.assert_allclose(shifts, [0 * axis, 0 * axis, 0.25 * axis, 0.25 * axis], atol=1e-14)


def test_a_tree_may_use_the_plan_of_a_tree_with_other_lengths(some_tree: Tree):
    longer, shrunk = some_tree.scaled(1.3), some_tree.scaled(0.0)
    state, _ = states_and_sizes(some_tree, 3)
    expected = some_tree.scaled(1.3).pose_with_jacobian(state)
    longer.use_plan_of(some_tree)
    shrunk.use_plan_of(some_tree)
    assert "plan" in longer.__dict__
    assert "plan" not in shrunk.__dict__
    np.testing.assert_array_equal(longer.pose_with_jacobian(state).jacobian, expected.jacobian)
    np.testing.assert_array_equal(longer.pose(state).points_m, expected.points_m)
