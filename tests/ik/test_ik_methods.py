"""Test the joint rates of the inverse-kinematics methods, and the fit of their parameters to given rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import orthogonal_procrustes

from recon.ik.chain import null_basis, planar_chain, summed_chain
from recon.ik.costs import harmonic_map, joint_differences, rotational_energy, user_cost, weighted_sum
from recon.ik.methods import (
    ExtendedJacobian,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    SelectivelyDamped,
    damped_least_squares,
    reduced_gradient,
    right_inverse,
    weighted_least_norm,
)
from recon.ik.parameters import EQUAL_WEIGHT_PULL, Frames, explained_by, fits, rates_of

LENGTHS = (0.4, 0.3, 0.25, 0.28, 0.2)
CHAINS = {"planar": planar_chain(LENGTHS), "summed": summed_chain(LENGTHS)}
EACH = pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)


def methods(chain):
    cost = rotational_energy(chain)
    return (
        LeastNorm(),
        JacobianTranspose(),
        GradientProjection(cost),
        weighted_least_norm(np.linspace(0.5, 1.5, chain.n)),
        damped_least_squares(),
        SelectivelyDamped(),
        ExtendedJacobian(cost),
        ExtendedJacobian(cost, full=False),
        ExtendedJacobian(harmonic_map(), gain_per_s=90.0),
        replace(damped_least_squares(0.3), alpha=None),
    )


def configuration(chain, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(0.2, 1.0, chain.n), rng.normal(size=chain.dim) * 0.5


@EACH
def test_methods_agree_with_their_formulas(chain):
    q, dx = configuration(chain)
    J = chain.jacobian(q)
    P = np.eye(chain.n) - np.linalg.pinv(J) @ J
    W = np.diag(np.linspace(0.5, 1.5, chain.n))
    g = rotational_energy(chain).gradient(q)
    least = np.linalg.pinv(J) @ dx
    weighted = np.linalg.inv(W) @ J.T @ np.linalg.inv(J @ np.linalg.inv(W) @ J.T) @ dx
    damped = J.T @ np.linalg.inv(J @ J.T + 0.2**2 * np.eye(chain.dim)) @ dx
    for method, expected in (
        (LeastNorm(), least),
        (GradientProjection(rotational_energy(chain), k=-0.7), least - 0.7 * P @ g),
        (GradientProjection(lambda _: np.ones(chain.n), k=2.0), least + 2 * P @ np.ones(chain.n)),
        (weighted_least_norm(np.diag(W)), weighted),
        (damped_least_squares(0.2), damped),
        # A large gamma_max damps nothing.
        (SelectivelyDamped(gamma_max_rad=1e6), least),
    ):
        step = method.rates(chain, q, dx)
        assert not step.singular
        np.testing.assert_allclose(step.dq, expected, atol=1e-12)


def test_damped_rates_of_one_link_have_a_known_value():
    # One link of length r at angle q: J = r (-sin q, cos q), and J' (J J' + l^2)^-1 dx = r t . dx / (r^2 + l^2).
    chain, q, dx = planar_chain((0.7,)), np.array([0.6]), np.array([0.3, -0.2])
    expected = 0.7 * (-np.sin(0.6) * 0.3 - np.cos(0.6) * 0.2) / (0.7**2 + 0.1**2)
    np.testing.assert_allclose(damped_least_squares(0.1).rates(chain, q, dx).dq, [expected], atol=1e-12)


@EACH
def test_transpose_scales_its_direction_to_the_nearest_motion(chain):
    q, dx = configuration(chain)
    J = chain.jacobian(q)
    dq = JacobianTranspose().rates(chain, q, dx).dq
    assert abs(J @ dq @ (dx - J @ dq)) < 1e-12
    np.testing.assert_allclose(JacobianTranspose(0.5).rates(chain, q, dx).dq, 0.5 * J.T @ dx)


def test_selective_damping_limits_each_direction():
    # The arm is nearly straight: the singular value along the arm is small, so this direction is damped.
    chain, q = planar_chain((0.5, 0.5)), np.array([0.0, 0.02])
    method = SelectivelyDamped(gamma_max_rad=0.5, interval_s=1.0)
    along = method.rates(chain, q, np.array([-0.1, 0.0])).dq
    assert np.abs(along).max() < 0.02
    assert np.abs(LeastNorm().rates(chain, q, np.array([-0.1, 0.0])).dq).max() > 5
    across = method.rates(chain, q, np.array([0.0, 0.1])).dq
    np.testing.assert_allclose(chain.jacobian(q) @ across, [0.0, 0.1], atol=2e-3)


def extended_jacobian(chain, cost, q, N, full=True):
    """Return the matrix [J; dG/dq] (n, n) with a basis N (n, n - dim) of the null space."""
    J, curvature = chain.derivatives(q)
    _, M = reduced_gradient(cost, q, right_inverse(J)[0], curvature if full else None)
    return np.concatenate([J, N.T @ M])


@EACH
@pytest.mark.parametrize("full", [True, False])
def test_extended_jacobian_solves_the_square_system(chain, full):
    q, dx = configuration(chain)
    cost = rotational_energy(chain)
    J = chain.jacobian(q)
    dq = ExtendedJacobian(cost, full).rates(chain, q, dx).dq
    turned = np.linalg.qr(np.random.default_rng(1).normal(size=(chain.n - chain.dim,) * 2))[0]
    for N in (null_basis(J), null_basis(J) @ turned):
        E = extended_jacobian(chain, cost, q, N, full)
        right = np.concatenate([dx, np.zeros(chain.n - chain.dim)])
        np.testing.assert_allclose(dq, np.linalg.solve(E, right), atol=1e-9)


@EACH
def test_full_derivative_of_g_agrees_with_differences(chain):
    # In the finite differences of G = N' grad g, the basis N does not turn.
    cost = user_cost(lambda q: float(np.sum(np.cos(q)) + q[0] * q[2] ** 2))
    q, _ = configuration(chain)
    N = null_basis(chain.jacobian(q))

    def G(x):
        basis = null_basis(chain.jacobian(x))
        return (basis @ orthogonal_procrustes(basis, N)[0]).T @ cost.gradient(x)

    h = 1e-5 * np.eye(chain.n)
    numeric = np.stack([(G(q + e) - G(q - e)) / 2e-5 for e in h], axis=1)
    np.testing.assert_allclose(extended_jacobian(chain, cost, q, N)[chain.dim :], numeric, atol=1e-5)


@EACH
def test_rates_are_finite_and_bounded_everywhere(chain):
    rng = np.random.default_rng(5)
    stretched = np.zeros(chain.n)
    folded = np.tile([0.0, np.pi, np.pi, np.pi, np.pi], len(chain.groups))
    wild = [rng.normal(size=chain.n) * 10 for _ in range(20)]
    for q in (stretched, folded, stretched + 1e-9, np.full(chain.n, np.pi / 2), *wild):
        for dx in (*np.eye(chain.dim), np.zeros(chain.dim), np.full(chain.dim, 1e6), np.full(chain.dim, 1e-300)):
            for method in methods(chain):
                step = method.rates(chain, q, dx)
                assert np.isfinite(step.dq).all()
                assert (np.abs(step.dq) <= chain.max_rate_rad_s * (1 + 1e-12)).all()
    for method in methods(chain):
        step = method.rates(chain, stretched, np.eye(chain.dim)[0])
        assert step.singular
        assert step.note.startswith("singular")
        assert np.isfinite(method.rates(chain, np.full(chain.n, np.nan), np.ones(chain.dim)).dq).all()


@EACH
def test_fixed_joints_do_not_move(chain):
    q, dx = configuration(chain)
    free = np.ones(chain.n, bool)
    free[[0, chain.n - 1]] = False
    for method in methods(chain)[:-1]:
        dq = method.rates(chain, q, dx, free).dq
        assert not dq[~free].any()
        if not isinstance(method, JacobianTranspose) and not getattr(method, "damping_m", 0):
            np.testing.assert_allclose(chain.jacobian(q) @ dq, dx, atol=1e-9)


def test_rate_limits_reduce_the_null_space_motion_first():
    chain = planar_chain(LENGTHS, max_rate_rad_s=3.0)
    q, dx = configuration(chain)
    step = GradientProjection(rotational_energy(chain), k=-1e3).rates(chain, q, dx)
    assert step.note.startswith("rate limit")
    assert np.abs(step.dq).max() == pytest.approx(3.0)
    np.testing.assert_allclose(chain.jacobian(q) @ step.dq, dx, atol=1e-12)


def test_singular_extended_jacobian_is_reported():
    # A cost that does not depend on the angles leaves dG/dq without rank.
    chain = CHAINS["planar"]
    q, dx = configuration(chain)
    step = ExtendedJacobian(user_cost(lambda _: 0.0)).rates(chain, q, dx)
    assert step.singular
    assert step.note == "singular: the extended Jacobian"
    np.testing.assert_allclose(chain.jacobian(q) @ step.dq, dx, atol=1e-9)


@EACH
def test_fits_recover_the_parameters(chain):
    rng = np.random.default_rng(6)
    q, dx = rng.uniform(0.2, 1.0, (40, chain.n)), rng.normal(size=(40, chain.dim))
    weights = rng.uniform(0.4, 1.6, chain.n)
    weights /= weights.mean()
    constant = rng.normal(size=chain.n)
    costs = (joint_differences(chain), rotational_energy(chain))
    combined = weighted_sum(costs, (-0.8, 1.7))
    for true, fit, parameter in (
        (damped_least_squares(0.13), fits()["damped"], [0.13]),
        (weighted_least_norm(weights), fits()["weighted"], weights),
        (JacobianTranspose(0.6), fits()["transpose"], [0.6]),
        (GradientProjection(lambda _: constant, k=1.0), fits()["gradient-projection"], constant),
        (GradientProjection(combined, k=1.0), fits(costs)["gradient-projection"], [-0.8, 1.7]),
        (LeastNorm(), fits()["least-norm"], []),
    ):
        dq = np.stack([true.rates(chain, x, v).dq for x, v in zip(q, dx, strict=True)])
        dq[3] = np.nan
        found = fit(Frames.without_gaps(chain, q, dx, dq))
        np.testing.assert_allclose(found.parameter, parameter, rtol=1e-4)
        assert found.explained > 1 - 1e-8
        assert found.rms_rad_s < 1e-3
        assert abs(found.alpha - 1) < 1e-5
        again = found.method.rates(chain, q[0], dx[0]).dq
        np.testing.assert_allclose(again, dq[0], atol=1e-3)


@EACH
def test_fit_recovers_gamma_max(chain):
    rng = np.random.default_rng(8)
    q, dx = rng.uniform(0.2, 1.0, (40, chain.n)), rng.normal(size=(40, chain.dim))
    true = SelectivelyDamped(0.02)
    dq, least = (
        np.stack([method.rates(chain, x, v).dq for x, v in zip(q, dx, strict=True)]) for method in (true, LeastNorm())
    )
    assert np.abs(dq - least).max() > 0.5
    found = fits()["selectively-damped"](Frames.without_gaps(chain, q, dx, dq))
    np.testing.assert_allclose(found.parameter, [0.02], rtol=1e-5)
    assert found.explained > 1 - 1e-9
    assert found.note == ""
    again = [found.method.rates(chain, x, v).dq for x, v in zip(q, dx, strict=True)]
    np.testing.assert_allclose(again, dq, atol=1e-3)
    # Without damping, the rates equal the least-norm rates for any gamma_max.
    found = fits()["selectively-damped"](Frames.without_gaps(chain, q, dx, least))
    assert found.explained > 1 - 1e-12
    assert "no value between this one and" in found.note


def test_fit_notes_a_parameter_at_the_edge_of_its_range():
    chain = CHAINS["planar"]
    q, dx = np.random.default_rng(7).uniform(0.2, 1.0, (10, 5)), np.ones((10, 2))
    dq = np.stack([LeastNorm().rates(chain, x, v).dq for x, v in zip(q, dx, strict=True)])
    assert "is 0" in fits()["damped"](Frames.without_gaps(chain, q, dx, dq)).note
    with pytest.raises(ValueError, match="no frame"):
        Frames.without_gaps(chain, q * np.nan, dx, dq)


@EACH
def test_a_fit_to_some_frames_is_tested_on_others(chain):
    rng = np.random.default_rng(9)
    q, dx = rng.uniform(0.2, 1.0, (30, chain.n)), rng.normal(size=(30, chain.dim))
    true = weighted_least_norm(np.linspace(0.5, 1.5, chain.n))
    dq = np.stack([true.rates(chain, x, v).dq for x, v in zip(q, dx, strict=True)])
    every = Frames.without_gaps(chain, q, dx, dq)
    some, others = every[:20], every[20:]
    found = fits()["weighted"](some)
    assert explained_by(rates_of(found.method, others), others.dq) > 1 - 1e-8
    # Rates of half the size explain 1 - 0.5^2 of the square, and the fitted factor doubles.
    assert abs(explained_by(0.5 * others.dq, others.dq) - 0.75) < 1e-12
    half = fits()["least-norm"](replace(every, dx=0.5 * every.dx))
    assert abs(half.alpha - 2 * fits()["least-norm"](every).alpha) < 1e-9


@EACH
def test_parameters_of_each_configuration(chain):
    rng = np.random.default_rng(10)
    q, dx = rng.uniform(0.2, 1.0, (6, chain.n)), rng.normal(size=(6, chain.dim))
    damping = np.linspace(0.05, 0.4, 6)
    dq = np.stack([damped_least_squares(d).rates(chain, x, v).dq for d, x, v in zip(damping, q, dx, strict=True)])
    frames = Frames.without_gaps(chain, q, dx, dq)
    each = [frames[t : t + 1] for t in range(6)]
    for one, value in zip(map(fits()["damped"], each), damping, strict=True):
        assert one.parameter == pytest.approx([value], rel=1e-4)
        assert one.explained == pytest.approx(1.0, abs=1e-8)
        assert one.alpha == pytest.approx(1.0, abs=1e-4)
    # Many weights explain a single configuration. The fit returns the most even of them, within their range.
    weights = [fits(pull=EQUAL_WEIGHT_PULL)["weighted"](one) for one in each]
    np.testing.assert_allclose([w.parameter.mean() for w in weights], 1.0)
    assert min(w.explained for w in weights) >= min(fits()["least-norm"](one).explained for one in each) - 1e-9


def test_alpha_is_the_given_or_the_best_factor():
    chain = CHAINS["planar"]
    q, dx = configuration(chain)
    damped = damped_least_squares(0.5)
    plain, scaled = damped.rates(chain, q, dx).dq, replace(damped, alpha=None).rates(chain, q, dx).dq
    J = chain.jacobian(q)
    alpha = scaled[0] / plain[0]
    assert alpha > 1.2
    np.testing.assert_allclose(scaled, alpha * plain)
    assert abs((J @ scaled - dx) @ (J @ scaled)) < 1e-12
    np.testing.assert_allclose(replace(damped, alpha=0.5).rates(chain, q, dx).dq, 0.5 * plain)
    # Rates that follow the path exactly need no factor, and neither do rates in the null space.
    projected = GradientProjection(joint_differences(chain))
    np.testing.assert_allclose(replace(projected, alpha=None).rates(chain, q, dx).dq, projected.rates(chain, q, dx).dq)


def test_no_damping_explains_any_rates_best():
    # If dx = J dq, least norm gives the rates' part in the row space of J, and damping only reduces this part.
    chain, rng = CHAINS["planar"], np.random.default_rng(11)
    q, dq = rng.uniform(0.2, 1.0, (20, 5)), rng.normal(0.0, 2.0, (20, 5))
    dx = np.einsum("tij,tj->ti", chain.jacobian(q), dq)
    found = fits()["damped"](Frames.without_gaps(chain, q, dx, dq))
    assert found.parameter[0] == pytest.approx(1e-4)
    assert found.note.startswith("lambda is 0")
    assert found.explained == pytest.approx(
        fits()["least-norm"](Frames.without_gaps(chain, q, dx, dq)).explained, abs=1e-6
    )
