"""Test runs to targets, along closed paths, and along the null space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.animal.chain import load_chain
from recon.ik.animal_chain import spine_front_leg
from recon.ik.chain import null_basis, planar_chain
from recon.ik.costs import harmonic_map, joint_differences, rotational_energy, user_cost
from recon.ik.drive import degree_of_closure, drive_to, follow
from recon.ik.methods import (
    ExtendedJacobian,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    SelectivelyDamped,
    damped_least_squares,
    weighted_least_norm,
)
from recon.ik.null_space import to_null_space_optimum

STARTS = 8


def methods(chain):
    energy = rotational_energy(chain)
    return {
        "least norm": LeastNorm(),
        "transpose": JacobianTranspose(),
        "gradient projection": GradientProjection(joint_differences(chain)),
        "weighted": weighted_least_norm(chain.joint_lengths_m),
        "damped": damped_least_squares(),
        "selectively damped": SelectivelyDamped(),
        "extended, differences": ExtendedJacobian(joint_differences(chain)),
        "extended, energy": ExtendedJacobian(energy),
        "extended, N constant": ExtendedJacobian(energy, full=False),
    }


def front_leg(dim, limited=False):
    return spine_front_leg(load_chain("cheetah-8u"), dim=dim, limited=limited)


def random_tasks(dim, count=STARTS, seed=0):
    """Draw start angles and targets from random poses within the expected ranges."""
    chain, rng = front_leg(dim, limited=True), np.random.default_rng(seed)
    starts, ends = rng.uniform(chain.lower_rad, chain.upper_rad, (2, count, chain.n))
    return starts, np.array([chain.end(q) for q in ends])


@pytest.mark.parametrize("dim", [pytest.param(2, marks=pytest.mark.slow), 3])
@pytest.mark.parametrize("name", methods(front_leg(2)))
def test_every_method_reaches_reachable_targets(name, dim):
    chain = front_leg(dim)
    drives = [drive_to(chain, q, x, methods(chain)[name]) for q, x in zip(*random_tasks(dim), strict=True)]
    assert np.mean([d.reached for d in drives]) >= 0.95
    for drive in drives:
        if drive.reached:
            assert drive.distance_m[-1] <= 0.003
        assert np.isfinite(drive.q).all()
        np.testing.assert_allclose(chain.end(drive.q[-1]), drive.end_m[-1])
        assert len(drive.q) == len(drive.end_m) == len(drive.distance_m) == len(drive.manipulability)
        assert len(drive.singular) == len(drive.solve_s) == drive.iterations


@pytest.mark.parametrize("dim", [2, 3])
def test_limits_hold_and_a_stopped_run_has_a_reason(dim):
    chain, reached = front_leg(dim, limited=True), 0
    for q, x in zip(*random_tasks(dim, 12), strict=True):
        drive = drive_to(chain, q, x, LeastNorm())
        assert (drive.q >= chain.lower_rad).all()
        assert (drive.q <= chain.upper_rad).all()
        assert drive.reached or (drive.reason.startswith("limits: joints") and drive.limits)
        reached += drive.reached
    assert reached >= 0.8 * 12


@pytest.mark.parametrize("name", methods(front_leg(2)))
def test_unreachable_targets_have_a_reason(name):
    chain = front_leg(2)
    for target in ([2.0, 0.0], [np.nan, 0.0]):
        drive = drive_to(chain, np.full(5, 0.3), target, methods(chain)[name])
        assert drive.reason.startswith("unreachable")
        assert drive.iterations == 0
    arm = planar_chain((1.0, 0.3))
    assert "0.700 to 1.300 m" in drive_to(arm, [0.1, 0.2], [0.5, 0.0], LeastNorm()).reason


@pytest.mark.parametrize("name", methods(front_leg(2)))
def test_stretched_chain_ends_with_a_reason(name):
    chain = front_leg(2)
    drive = drive_to(chain, np.zeros(5), chain.end(np.zeros(5)) / 2, methods(chain)[name])
    assert drive.reached or drive.reason.startswith("singular"), drive.reason
    assert np.isfinite(drive.q).all()
    assert (np.abs(np.diff(drive.q, axis=0)) <= chain.max_rate_rad_s / 90 + 1e-12).all()
    if name == "least norm":
        assert drive.reason.startswith("singular: the Jacobian")


def test_too_few_iterations_and_a_bad_start_have_a_reason():
    chain = front_leg(2)
    assert (
        "largest number allowed" in drive_to(chain, np.full(5, 0.3), [0.5, 0.5], LeastNorm(), max_iterations=3).reason
    )
    assert drive_to(chain, np.full(5, np.inf), [0.5, 0.5], LeastNorm()).reason == "no progress: the start is not finite"


def test_measures_of_a_run_to_a_target():
    chain = front_leg(2)
    q, target = np.full(5, 0.3), np.array([0.6, 0.9])
    drive = drive_to(chain, q, target, LeastNorm())
    assert drive.reached
    # The path is nearly straight, with 20 mm per iteration.
    straight = np.linalg.norm(target - chain.end(q))
    assert drive.length_m == pytest.approx(straight, abs=0.02)
    assert drive.iterations == pytest.approx(straight / 0.02, abs=2)
    assert replace(drive, q=np.arange(5.0)[:, None] ** 2).roughness_rad2 == pytest.approx(4.0)
    np.testing.assert_allclose(np.diff(drive.q, axis=0), drive.dq[:-1] / 90, atol=1e-15)
    np.testing.assert_array_equal(drive.dq[-1], 0)
    assert (drive.solve_s > 0).all()
    J = chain.jacobian(drive.q[3])
    assert drive.manipulability[3] == pytest.approx(np.sqrt(np.linalg.det(J @ J.T)))


def circle(chain, q, radius_m=0.15, points=400):
    """Return a circle that starts at the end effector, in 3D tilted out of the sagittal plane."""
    a, start = np.linspace(0, 2 * np.pi, points + 1), chain.end(q)
    u = np.array([1.0, 0.0, 0.0])[: chain.dim]
    v = np.array([0.0, 0.8, 0.6])[: chain.dim]
    path = start + radius_m * ((np.cos(a) - 1)[:, None] * u + np.sin(a)[:, None] * v)
    path[-1] = path[0]
    return path


def bent(chain):
    """Return joint angles in the middle of their ranges, in 3D bent to the side."""
    limited = front_leg(chain.dim, limited=True)
    q = (limited.lower_rad + limited.upper_rad) / 2
    q[5:] = [0.1, 0.15, -0.1, 0.2, 0.15][: len(q[5:])]
    return q


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_extended_jacobian_closes_paths_and_least_norm_drifts(dim):
    chain = front_leg(dim)
    cost = rotational_energy(chain)
    q, kind = to_null_space_optimum(chain, bent(chain), cost)
    assert kind == "minimum"
    path = circle(chain, q)
    runs = {
        name: follow(chain, q, path, method, turns=2)
        for name, method in (
            ("full", ExtendedJacobian(cost)),
            ("constant", ExtendedJacobian(cost, full=False)),
            ("least norm", LeastNorm()),
        )
    }
    for run in runs.values():
        assert run.distance_m.max() < 1e-3
        assert run.iterations == 2 * 400
    closures = {name: run.closures() for name, run in runs.items()}
    assert not runs["full"].singular.any()
    assert closures["full"]["angle"].min() >= 99.9
    assert closures["full"]["plane"].min() >= 99.9
    assert closures["constant"]["angle"].min() < 99.5
    assert closures["least norm"]["angle"].min() < 95


def test_follow_refuses_invalid_paths():
    chain = front_leg(2)
    with pytest.raises(ValueError, match="closed"):
        follow(chain, np.zeros(5), np.array([[1.0, 0.0], [0.9, 0.0]]), LeastNorm(), turns=2)
    with pytest.raises(ValueError, match="finite path"):
        follow(chain, np.zeros(5), np.array([[1.0, np.nan], [0.9, 0.0]]), LeastNorm())


def test_degree_of_closure_has_known_values():
    assert degree_of_closure(np.array([0.0, 1.0, 0.25])) == pytest.approx(75)
    # Axes divided by their ranges: start and end are (0.5, 0.2) apart, the diameter is sqrt 2.
    path = np.array([[0.0, 0.0], [2.0, 50.0], [1.0, 10.0]])
    assert degree_of_closure(path) == pytest.approx(100 * (1 - np.hypot(0.5, 0.2) / np.sqrt(2)))
    assert np.isnan(degree_of_closure(np.full(4, 1.3)))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["differences", "energy", "harmonic"])
def test_null_space_optimum_is_stationary(dim, kind):
    chain = front_leg(dim)
    cost = {"differences": joint_differences, "energy": rotational_energy, "harmonic": lambda _: harmonic_map()}[kind](
        chain
    )
    q = bent(chain)
    found, what = to_null_space_optimum(chain, q, cost)
    np.testing.assert_allclose(chain.end(found), chain.end(q), atol=1e-9)
    G = null_basis(chain.jacobian(found)).T @ cost.gradient(found)
    np.testing.assert_allclose(G, 0, atol=1e-8)
    assert what in ("minimum", "saddle")
    if kind != "harmonic":
        assert what == "minimum"
        assert cost.value(found) < cost.value(q)


def test_null_space_optimum_reports_a_failure():
    chain = front_leg(2)
    unbounded = user_cost(lambda q: float(np.exp(q[0]) * q[0] * np.inf) if q[0] > 0 else 0.0)
    assert "not finite" in to_null_space_optimum(chain, bent(chain) + 0.3, unbounded)[1]


def test_null_space_optimum_stays_within_limits():
    chain = front_leg(2, limited=True)
    q = np.array([0.5, 0.4, 1.2, 0.1, 0.5])
    found, _ = to_null_space_optimum(chain, q, rotational_energy(chain))
    assert (found <= chain.upper_rad).all()
    assert (found >= chain.lower_rad).all()
    np.testing.assert_allclose(chain.end(found), chain.end(q), atol=1e-9)
