"""Test chains with summed angles, their derivatives, costs, and the two-link arm."""

from __future__ import annotations

import numpy as np
import pytest

from recon import load_skeleton
from recon.ik.animal_chain import body_chain
from recon.ik.chain import joint_chain, manipulability, mobility, null_basis, planar_chain, summed_chain
from recon.ik.costs import harmonic_map, joint_differences, pose_distance, rotational_energy, user_cost, weighted_sum
from recon.ik.two_link import two_link
from recon.thesis.chain import load_chain

LENGTHS = (0.4, 0.3, 0.25, 0.28, 0.2)
CHAINS = {"planar": planar_chain(LENGTHS), "summed": summed_chain(LENGTHS)}


def differences(function, q, step=1e-6):
    """Return the derivatives (..., n) of a function at q (n,) by central differences."""
    h = step * np.eye(len(q))
    return np.stack([(function(q + e) - function(q - e)) / (2 * step) for e in h], axis=-1)


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_derivatives_agree_with_differences(chain):
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, mu = rng.normal(size=chain.n), rng.normal(size=chain.dim)
        np.testing.assert_allclose(chain.jacobian(q), differences(chain.end, q), atol=1e-8)
        hessian = differences(chain.jacobian, q)
        np.testing.assert_allclose(chain.derivatives(q)[1](mu), np.tensordot(mu, hessian, 1), atol=1e-8)


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_positions_are_one_link_length_apart(chain):
    q = np.random.default_rng(1).normal(size=chain.n)
    points = chain.positions(q)
    assert points.shape == (6, chain.dim)
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), LENGTHS)
    np.testing.assert_allclose(points[-1], chain.end(q), atol=1e-15)
    np.testing.assert_array_equal(points[0], 0)


def test_planar_and_spatial_chain_agree_without_phi():
    q = np.array([0.2, -0.4, 1.1, 0.3, -0.8])
    u, v, w = CHAINS["summed"].end(np.concatenate([q, np.zeros(5)]))
    np.testing.assert_allclose((u, v, w), (*CHAINS["planar"].end(q), 0.0), atol=1e-15)


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_null_basis_is_an_orthonormal_basis_of_the_null_space(chain):
    rng = np.random.default_rng(2)
    J = chain.jacobian(rng.normal(size=chain.n))
    N = null_basis(J)
    np.testing.assert_allclose(J @ N, 0, atol=1e-14)
    np.testing.assert_allclose(N.T @ N, np.eye(chain.n - chain.dim), atol=1e-14)


def test_bad_chains_are_refused():
    with pytest.raises(ValueError, match="positive lengths"):
        planar_chain((1.0, 0.0))
    with pytest.raises(ValueError, match="above"):
        planar_chain((1.0, 1.0), (1.0, -1.0))
    with pytest.raises(ValueError, match="rate"):
        summed_chain((1.0, 1.0), max_rate_rad_s=np.inf)


def test_reach_and_manipulability_of_two_links():
    assert planar_chain((1.0, 0.5)).reach_m == pytest.approx((0.5, 1.5))
    assert planar_chain((1.0, 0.5, 0.6)).reach_m == pytest.approx((0.0, 2.1))
    # The manipulability of two links is r1 r2 |sin q2|.
    arm = planar_chain((1.0, 0.5))
    assert manipulability(arm.jacobian(np.array([0.3, 0.7]))) == pytest.approx(0.5 * np.sin(0.7))
    assert manipulability(arm.jacobian(np.zeros(2))) == 0


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
@pytest.mark.parametrize("kind", ["differences", "energy", "harmonic", "pose", "sum", "user"])
def test_costs_agree_with_differences(chain, kind):
    cost = {
        "differences": joint_differences(chain),
        "energy": rotational_energy(chain),
        "harmonic": harmonic_map(a=0.7, b=0.3),
        "pose": pose_distance(np.linspace(-1.0, 1.0, chain.n)),
        "sum": weighted_sum((joint_differences(chain), harmonic_map()), (0.5, -2.0)),
        "user": user_cost(lambda q: float(np.sin(q[0]) * q[1] + np.sum(q**4))),
    }[kind]
    q = np.random.default_rng(3).normal(size=chain.n)
    # A user's cost is differentiated numerically, which adds errors.
    rtol, atol = (1e-4, 1e-3) if kind == "user" else (1e-7, 1e-7)
    np.testing.assert_allclose(cost.gradient(q), differences(cost.value, q), rtol=rtol, atol=atol)
    np.testing.assert_allclose(cost.hessian(q), differences(cost.gradient, q), rtol=rtol, atol=atol)
    np.testing.assert_allclose(cost.hessian(q), cost.hessian(q).T)


def test_costs_have_known_values():
    q = np.array([0.1, 0.3, 0.6, 1.0, 1.5])
    planar, spatial = CHAINS["planar"], CHAINS["summed"]
    assert joint_differences(planar).value(q) == pytest.approx(0.04 + 0.09 + 0.16 + 0.25)
    # The difference between the last theta and the first phi does not count.
    assert joint_differences(spatial).value(np.concatenate([q, q])) == pytest.approx(2 * 0.54)
    assert rotational_energy(planar).value(q) == pytest.approx(np.sum((np.array(LENGTHS) * q) ** 2))
    assert pose_distance(q + np.array([0.1, 0, 0, 0, 0.2])).value(q) == pytest.approx(0.05)
    assert weighted_sum((pose_distance(0 * q), harmonic_map()), (2.0, 0.0)).value(q) == pytest.approx(2 * np.sum(q**2))
    assert harmonic_map().value(q) == pytest.approx(0.5 * -0.4 * np.sqrt(1.16))


def test_two_link_has_a_known_solution():
    branches_rad, reason = two_link((1.0, 0.5), (1.359462, 0.211309))
    assert reason == ""
    np.testing.assert_allclose(branches_rad, [(0.4363, -0.8727), (-0.1279, 0.8727)], atol=5e-5)


def test_two_link_reaches_its_target():
    rng = np.random.default_rng(4)
    for _ in range(50):
        r1, r2 = rng.uniform(0.2, 1.0, 2)
        arm = planar_chain((r1, r2))
        target = arm.end(rng.uniform(-3, 3, 2))
        for q in two_link((r1, r2), target)[0]:
            np.testing.assert_allclose(arm.end(q), target, atol=1e-12)


@pytest.mark.parametrize("target", [(1.6, 0.0), (0.0, -0.4), (0.0, 0.0), (np.nan, 0.0)])
def test_two_link_has_no_solution_outside_the_annulus(target):
    branches_rad, reason = two_link((1.0, 0.5), target)
    assert np.isnan(branches_rad).all()
    assert reason.startswith("unreachable")
    if target[0] == 1.6:
        assert reason == "unreachable: the target is 1.600 m from the base, and the chain reaches 0.500 to 1.500 m"


def test_two_link_reaches_the_edge_of_the_annulus():
    for target, how in (((1.5, 0.0), "stretched"), ((0.0, 0.5), "folded")):
        branches_rad, reason = two_link((1.0, 0.5), target)
        assert how in reason
        np.testing.assert_allclose(planar_chain((1.0, 0.5)).end(branches_rad[0]), target, atol=1e-12)


def test_chains_of_every_kind_of_joint_have_the_jacobian_of_their_end():
    rng = np.random.default_rng(7)
    sliding = joint_chain(rng.normal(size=(4, 3)), rng.normal(size=(4, 3)), sliding=[False, True, False, True])
    animal = body_chain(load_skeleton("cheetah-24"), "l_front_paw")
    for chain in (planar_chain([0.3, 0.2, 0.1]), summed_chain([0.3, 0.2, 0.1]), sliding, animal):
        q = 0.7 * rng.normal(size=(5, chain.n))
        np.testing.assert_allclose([chain.end(one) for one in q], chain.end(q), atol=1e-14)
        step = 1e-6 * np.eye(chain.n)
        for one in q:
            slopes = (chain.end(one + step) - chain.end(one - step)).T / 2e-6
            np.testing.assert_allclose(chain.jacobian(one), slopes, atol=1e-8)


def test_mobility_of_known_mechanisms():
    # The 8U chain has eight links and the ground; the first link is free, and the other joints are universal.
    skeleton = load_chain("cheetah-8u")
    joints = [2 for link in skeleton.links if link.free] + [6]
    assert mobility(len(skeleton.links) + 1, joints) == 20 == skeleton.n_state - 1
    assert mobility(4, [1, 1, 1, 1], body_freedoms=3) == 1  # the four-bar linkage
    assert mobility(7, [1] * 6) == 6  # an arm of six hinges
    assert mobility(14, [2] * 6 + [1] * 6 + [3] * 6) == 6  # Stewart's platform, with universal and ball joints
