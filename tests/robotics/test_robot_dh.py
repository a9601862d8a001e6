"""Compare Denavit-Hartenberg chains with an independent library, and move them by inverse kinematics."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from recon.ik.costs import joint_differences
from recon.ik.drive import drive_to
from recon.ik.methods import (
    ExtendedJacobian,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    SelectivelyDamped,
    damped_least_squares,
    weighted_least_norm,
)
from recon.robotics.dh import DHRow, all_solutions, dh_chain, dh_table

QUARTER = np.pi / 2
PUMA_MODIFIED = tuple(
    DHRow(a, alpha, d)
    for a, alpha, d in (
        (0.0, 0.0, 0.0),
        (0.0, -QUARTER, 0.0),
        (0.4318, 0.0, 0.15005),
        (-0.0203, -QUARTER, 0.4318),
        (0.0, QUARTER, 0.0),
        (0.0, -QUARTER, 0.0),
    )
)
PUMA_STANDARD = tuple(
    DHRow(a, alpha, d)
    for a, alpha, d in (
        (0.0, QUARTER, 0.0),
        (0.4318, 0.0, 0.0),
        (0.0203, -QUARTER, 0.15005),
        (0.0, QUARTER, 0.4318),
        (0.0, -QUARTER, 0.0),
        (0.0, 0.0, 0.0),
    )
)
METHODS = {
    "least norm": LeastNorm(),
    "transpose": JacobianTranspose(),
    "damped": damped_least_squares(),
    "selectively damped": SelectivelyDamped(),
    "weighted": weighted_least_norm(np.array([3.0, 2.0, 1.0, 1.0, 1.0, 1.0])),
}


@pytest.mark.parametrize(
    ("rows", "convention", "name"),
    [(PUMA_MODIFIED, "modified", "modified"), (PUMA_STANDARD, "standard", "classic")],
    ids=["modified", "standard"],
)
def test_puma_560_agrees_with_ikpy(rows, convention, name):
    from ikpy.chain import Chain
    from ikpy.link import DHLink

    chain = dh_chain(rows, convention)
    links = [DHLink(d=r.d_m, a=r.a_m, alpha=r.alpha_rad, theta=r.theta_rad, convention=name) for r in rows]
    oracle = Chain(links, active_links_mask=[True] * 6)
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (30, 6)):
        R, p = chain.pose(q)
        T = oracle.forward_kinematics(q)
        np.testing.assert_allclose(R, T[:3, :3], atol=1e-12)
        np.testing.assert_allclose(p, T[:3, 3], atol=1e-12)


def elementary(convention, row, q):
    """Return the transform (4, 4) of one row of a table at q, as a product of elementary rotations and translations."""

    def turn(axis, angle):
        c, s = np.cos(angle), np.sin(angle)
        T = np.eye(4)
        T[:3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]] if axis == "x" else [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        return T

    def shift(x, z):
        T = np.eye(4)
        T[:3, 3] = x, 0, z
        return T

    theta, d = row.theta_rad + (0 if row.slides else q), row.d_m + (q if row.slides else 0)
    link = turn("x", row.alpha_rad) @ shift(row.a_m, 0)
    joint = turn("z", theta) @ shift(0, d)
    return link @ joint if convention == "modified" else joint @ link


@pytest.mark.parametrize("convention", ["modified", "standard"])
def test_sliding_joints_and_the_jacobian(convention):
    rng = np.random.default_rng(2)
    rows = [DHRow(*rng.uniform(-1, 1, 4), slides=slides) for slides in (False, True, False, True, False)]
    chain = dh_chain(rows, convention)
    q = rng.uniform(-1, 1, 5)
    T = np.eye(4)
    for row, value in zip(rows, q, strict=True):
        T = T @ elementary(convention, row, value)
    R, p = chain.pose(q)
    np.testing.assert_allclose(R, T[:3, :3], atol=1e-12)
    np.testing.assert_allclose(p, T[:3, 3], atol=1e-12)
    step = 1e-6
    for j in range(5):
        (Ra, pa), (Rb, pb) = (chain.pose(q + sign * step * np.eye(5)[j]) for sign in (1, -1))
        spin = (Ra - Rb) @ R.T / (2 * step)
        expected = [*(pa - pb) / (2 * step), spin[2, 1], spin[0, 2], spin[1, 0]]
        np.testing.assert_allclose(chain.geometric_jacobian(q)[:, j], expected, atol=1e-8)


@pytest.mark.parametrize("name", [*METHODS, "gradient projection", "extended Jacobian"])
@pytest.mark.parametrize("convention", ["modified", "standard"])
def test_every_method_reaches_a_target_of_the_puma(name, convention):
    # The wrist's axes meet: without a tool the last three joints do not move the end effector.
    rows = list(PUMA_MODIFIED if convention == "modified" else PUMA_STANDARD)
    rows.append(DHRow(a_m=0.1)) if convention == "modified" else rows.__setitem__(5, DHRow(a_m=0.1))
    chain = dh_chain(rows, convention)
    costs = {
        "gradient projection": lambda: GradientProjection(joint_differences(chain)),
        "extended Jacobian": lambda: ExtendedJacobian(joint_differences(chain)),
        "weighted": lambda: weighted_least_norm(np.linspace(3.0, 1.0, chain.n)),
    }
    method = costs[name]() if name in costs else METHODS[name]
    start = np.linspace(0.1, 0.8, chain.n)
    target = chain.end(start + 0.3 * np.cos(np.arange(chain.n)))
    run = drive_to(chain, start, target, method)
    assert run.reason == "reached"
    assert np.linalg.norm(chain.end(run.q[-1]) - target) <= 0.003


def random_rows():
    rng = np.random.default_rng(7)
    return [DHRow(*rng.uniform(-1, 1, 4), slides=slides) for slides in (False, True, False, True, False)]


@pytest.mark.parametrize(
    ("rows", "convention"),
    [
        (PUMA_MODIFIED, "modified"),
        (PUMA_STANDARD, "standard"),
        (random_rows(), "modified"),
        (random_rows(), "standard"),
        ([DHRow(d_m=0.1), DHRow(a_m=1.0), DHRow(a_m=0.5, d_m=0.2)], "modified"),  # all axes parallel
    ],
)
def test_a_chain_and_the_chain_of_its_table_are_equal(rows, convention):
    chain = dh_chain(rows, convention)
    base, found, tool = dh_table(chain)
    assert (found[0].a_m, found[0].alpha_rad) == (0, 0)
    assert [row.slides for row in found] == [row.slides for row in rows]
    for q in np.random.default_rng(1).uniform(-1, 1, (5, chain.n)):
        R, p = chain.pose(q)
        along, at = dh_chain(found, "modified").pose(q)
        end = base * RigidTransform.from_components(at, Rotation.from_matrix(along)) * tool
        np.testing.assert_allclose(end.rotation.as_matrix(), R, atol=1e-12)
        np.testing.assert_allclose(end.translation, p, atol=1e-12)


def test_the_table_of_the_puma_has_the_published_lengths():
    sizes = [
        (abs(row.a_m), abs(row.d_m), abs(row.alpha_rad)) for row in dh_table(dh_chain(PUMA_STANDARD, "standard"))[1]
    ]
    expected = [(abs(row.a_m), abs(row.d_m), abs(row.alpha_rad)) for row in PUMA_MODIFIED]
    np.testing.assert_allclose(sizes, expected, atol=1e-12)


@pytest.mark.slow
def test_the_puma_has_eight_solutions():
    chain = dh_chain(PUMA_MODIFIED, "modified")
    q = np.array([0.3, -0.8, 0.4, 0.9, 0.6, -0.5])
    R, p = chain.pose(q)
    found, isolated = all_solutions(chain, p, R)
    assert isolated
    assert found.shape == (8, 6)
    assert np.abs(np.angle(np.exp(1j * (found - q)))).max(axis=1).min() < 1e-6
    for other in found:
        np.testing.assert_allclose(chain.pose(other)[0], R, atol=1e-6)
        np.testing.assert_allclose(chain.end(other), p, atol=1e-6)
    # The wrist has two solutions: half a turn of the fourth and the sixth joint, and the opposite angle of the fifth.
    flipped = np.angle(np.exp(1j * (q * [1, 1, 1, 1, -1, 1] + [0, 0, 0, np.pi, 0, np.pi])))
    assert np.abs(found - flipped).max(axis=1).min() < 1e-6


def test_infinitely_many_and_no_solutions_are_recognised():
    chain = dh_chain(PUMA_MODIFIED, "modified")
    free, isolated = all_solutions(chain, (0.4, 0.1, 0.3), starts=3)
    assert (len(free), isolated) == (1, False)
    assert all_solutions(chain, (2.0, 0.0, 0.0), starts=3)[0].shape == (0, 6)


def test_missing_rows_and_unknown_conventions_are_refused():
    with pytest.raises(ValueError, match="standard"):
        dh_chain(PUMA_MODIFIED, "craig")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="rows"):
        dh_chain([], "standard")
