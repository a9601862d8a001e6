"""Test chains in space whose joints turn or slide."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recon.ik.chain import joint_chain, planar_chain, unreachable
from recon.ik.costs import joint_differences, rotational_energy
from recon.ik.drive import drive_to
from recon.ik.methods import ExtendedJacobian, LeastNorm, damped_least_squares

SLIDING = np.array([False, True, False, False, False, True])


def random_parts(seed=0):
    rng = np.random.default_rng(seed)
    return {
        "offsets_m": rng.normal(size=(6, 3)) * 0.4,
        "axes": rng.normal(size=(6, 3)),
        "tool_m": rng.normal(size=3) * 0.3,
        "tool_rotation": Rotation.random(None, rng),
    }


def random_chain(seed=0, **more):
    return joint_chain(**random_parts(seed), sliding=SLIDING, **more)


def differences(function, q, step=1e-6):
    """Return the derivatives (..., n) of a function at q (n,) by central differences."""
    h = step * np.eye(len(q))
    return np.stack([(function(q + e) - function(q - e)) / (2 * step) for e in h], axis=-1)


def test_pose_is_the_product_of_placements_and_motions():
    parts, q = random_parts(), np.random.default_rng(1).normal(size=6)
    turn, position, origins = Rotation.identity(), np.zeros(3), []
    for j in range(6):
        position = position + turn.apply(parts["offsets_m"][j])
        axis = parts["axes"][j] / np.linalg.norm(parts["axes"][j])
        if SLIDING[j]:
            position = position + turn.apply(axis * q[j])
        else:
            turn = turn * Rotation.from_rotvec(axis * q[j])
        origins.append(position)
    chain = random_chain()
    R, p = chain.pose(q)
    np.testing.assert_allclose(p, position + turn.apply(parts["tool_m"]), atol=1e-14)
    np.testing.assert_allclose(R, (turn * parts["tool_rotation"]).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(chain.end(q), p)
    np.testing.assert_allclose(chain.positions(q), [*origins, p], atol=1e-14)
    assert (chain.n, chain.dim, chain.groups) == (6, 3, (tuple(range(6)),))


def test_derivatives_agree_with_differences():
    chain, rng = random_chain(), np.random.default_rng(2)
    for _ in range(5):
        q, mu = rng.normal(size=6), rng.normal(size=3)
        J = chain.jacobian(q)
        np.testing.assert_allclose(J, differences(chain.end, q), atol=1e-8)
        bent = chain.derivatives(q)[1](mu)
        np.testing.assert_allclose(bent, np.tensordot(mu, differences(chain.jacobian, q), 1), atol=1e-8)
        np.testing.assert_allclose(bent, bent.T, atol=1e-14)
        # The derivative of R satisfies dR R' = [w]x, with the angular velocity w.
        spin = differences(lambda x: chain.pose(x)[0], q).transpose(2, 0, 1) @ chain.pose(q)[0].T
        angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]])
        np.testing.assert_allclose(chain.geometric_jacobian(q), np.concatenate([J, angular]), atol=1e-8)


def test_a_joint_chain_reproduces_a_planar_chain():
    lengths, q, mu = (0.4, 0.3, 0.2), np.array([0.3, -0.7, 1.2]), np.array([0.6, -1.1])
    flat = planar_chain(lengths)
    chain = joint_chain([(0, 0, 0), (0.4, 0, 0), (0.3, 0, 0)], [(0, 0, 2.0)] * 3, tool_m=(0.2, 0, 0))
    np.testing.assert_allclose(chain.positions(q)[:, :2], flat.positions(q), atol=1e-15)
    np.testing.assert_allclose(chain.jacobian(q)[:2], flat.jacobian(q), atol=1e-15)
    np.testing.assert_allclose(chain.derivatives(q)[1](np.array([*mu, 0])), flat.derivatives(q)[1](mu), atol=1e-15)
    np.testing.assert_allclose(chain.reach_m, flat.reach_m)
    np.testing.assert_allclose(chain.joint_lengths_m, flat.joint_lengths_m)


def test_joints_at_the_same_point_turn_the_same_link():
    chain = joint_chain(
        [(0, 0, 0), (0, 0, 0), (0.5, 0, 0), (0, 0, 0)], [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0)], tool_m=(0.2, 0, 0)
    )
    np.testing.assert_allclose(chain.lengths_m, [0, 0.5, 0, 0.2])
    np.testing.assert_allclose(chain.joint_lengths_m, [0.5, 0.5, 0.2, 0.2])


def test_the_end_effector_stays_within_the_stated_reach():
    rng = np.random.default_rng(3)
    for offsets in rng.normal(size=(5, 4, 3)):
        chain = joint_chain(offsets, rng.normal(size=(4, 3)), tool_m=rng.normal(size=3))
        least, most = chain.reach_m
        distance = [np.linalg.norm(chain.end(q)) for q in rng.uniform(-np.pi, np.pi, (500, 4))]
        assert least <= min(distance)
        assert max(distance) <= most < np.inf
    assert random_chain().reach_m == (0.0, np.inf)
    # A long and a short link leave a hole in the middle of the workspace.
    hole = joint_chain([(0, 0, 0), (1.0, 0, 0)], [(0, 0, 1), (0, 0, 1)], tool_m=(0.3, 0, 0))
    assert hole.reach_m == pytest.approx((0.7, 1.3))
    assert "reaches 0.700 to 1.300 m" in unreachable(hole, np.array([0.4, 0.0, 0.0]))


def test_bad_chains_are_refused():
    with pytest.raises(ValueError, match=r"\(n, 3\)"):
        joint_chain([(0, 0)], [(0, 0, 1)])
    with pytest.raises(ValueError, match="no axis may be zero"):
        joint_chain([(0, 0, 0)], [(0, 0, 0)])
    with pytest.raises(ValueError, match="above"):
        joint_chain([(0, 0, 0)], [(0, 0, 1)], limits_rad=(1.0, -1.0))


@pytest.mark.parametrize("kind", ["damped", "least norm", "energy", "differences"])
def test_methods_reach_targets_with_joint_chains(kind):
    chain = random_chain()
    method = {
        "damped": damped_least_squares(),
        "least norm": LeastNorm(),
        "energy": ExtendedJacobian(rotational_energy(chain)),
        "differences": ExtendedJacobian(joint_differences(chain)),
    }[kind]
    rng = np.random.default_rng(4)
    for q, other in rng.uniform(-1, 1, (5, 2, 6)):
        drive = drive_to(chain, q, chain.end(other), method)
        assert drive.reached, drive.reason
        assert drive.distance_m[-1] <= 0.003
