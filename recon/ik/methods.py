"""Joint rates dq (n,), rad/s, for a velocity of the end effector dx (dim,), m/s: one class for each method.

All have `rates(chain, q, dx, free=None)`; free (n,), bool: joints that may move, the others are taken out of the chain.
Rates are finite and within the chain's limits: where one is passed, what moves along the null space is scaled down
first, then all together. J is the Jacobian, J' its transpose. Near a singular configuration, det J J' small, the
inverse of J J' is damped, and the step says so.

Formulas: least norm, gradient projection, weighted and damped least squares as in C. van der Leek, MSc(Eng),
University of Cape Town, 2022, with inverses where print lost them; selectively damped least squares: S. R. Buss and
J.-S. Kim, J. Graphics Tools 10 (2005); extended Jacobian: J. Baillieul, ICRA 1985. See docs/ik.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from recon.ik.chain import SerialChain, null_basis
from recon.ik.costs import Cost

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

INTERVAL_S = 1 / 90
"""What one iteration of `recon.ik.drive` takes."""
SINGULAR = 1e-6
"""Of the eigenvalues of J J', least over largest: a ratio of singular values of a thousandth."""
EXTENDED_SINGULAR = 1e-3
"""Of the eigenvalues of N' M N, least over largest by magnitude."""
MAX_CORRECTION_RAD = 0.05
"""What the gain takes away at once, at most: a longer step along the null space would move the end effector, to second
order, by more than millimetres."""


class Step(NamedTuple):
    """Rates dq (n,), rad/s; singular: whether they are damped because a direction is lost; note: what, in words."""

    dq: Array
    singular: bool = False
    note: str = ""


class Method(Protocol):
    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Mask | None = None) -> Step:
        """Rates for q (n,) and dx (dim,)."""
        ...


@dataclass(frozen=True)
class LeastNorm:
    """J+ dx = J' (J J')^-1 dx: the smallest rates."""

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Mask | None = None) -> Step:
        J = _jacobian(chain, q, free)
        y, singular = _solve(J @ J.T, dx)
        return _step(chain, J.T @ y, "", free, singular)


@dataclass(frozen=True)
class JacobianTranspose:
    """alpha J' dx; alpha None: <dx, J J' dx> / |J J' dx|^2 at every step, with which J dq is nearest to dx."""

    alpha: float | None = None

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Mask | None = None) -> Step:
        J = _jacobian(chain, q, free)
        dq = J.T @ dx
        alpha = self.alpha
        if alpha is None:
            moved = J @ dq
            square = float(moved @ moved)
            alpha = float(dx @ moved) / square if square > 0 else 0.0
        _, singular = _solve(J @ J.T, dx)
        return _step(chain, alpha * dq, "", free, singular)


@dataclass(frozen=True)
class GradientProjection:
    """J+ dx + k (I - J+ J) g.

    gradient: g (n,) as a function of q, or a cost, whose gradient it is; k, 1/s, is negative to descend.
    """

    gradient: Cost | Callable[[Array], Array]
    k: float = -1.0

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Mask | None = None) -> Step:
        J = _jacobian(chain, q, free)
        g = self.gradient(q) if callable(self.gradient) else self.gradient.gradient(q)
        g = self.k * (g if free is None else g[free])
        gram = J @ J.T
        y, singular = _solve(gram, dx)
        across, _ = _solve(gram, J @ g)
        return _step(chain, *_with_priority(chain, J.T @ y, g - J.T @ across, free), free, singular)


@dataclass(frozen=True, eq=False)
class WeightedLeastNorm:
    """W^-1 J' (J W^-1 J')^-1 dx, which minimises dq' W dq. weights: diag W (n,), positive."""

    weights: Array

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Mask | None = None) -> Step:
        J = _jacobian(chain, q, free)
        scaled = J / (self.weights if free is None else self.weights[free])
        y, singular = _solve(scaled @ J.T, dx)
        return _step(chain, scaled.T @ y, "", free, singular)


@dataclass(frozen=True)
class DampedLeastSquares:
    """J' (J J' + lambda^2 I)^-1 dx, which minimises |J dq - dx|^2 + lambda^2 |dq|^2. damping_m: lambda, metres."""

    damping_m: float = 0.05

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Mask | None = None) -> Step:
        J = _jacobian(chain, q, free)
        y, singular = _solve(J @ J.T, dx, self.damping_m**2)
        return _step(chain, J.T @ y, "", free, singular)


@dataclass(frozen=True)
class SelectivelyDamped:
    """Each singular direction i damped by itself: (v_i (u_i . dx) / s_i), no joint of which turns more than

        gamma_i = min(1, 1 / M_i) gamma_max,   M_i = sum_j |v_ji| |J_j| / s_i

    in an interval, and their sum no more than gamma_max. Buss and Kim 2005, for one end effector.
    """

    gamma_max_rad: float = math.pi / 4
    interval_s: float = INTERVAL_S

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Mask | None = None) -> Step:
        J = _jacobian(chain, q, free)
        limit = self.gamma_max_rad / self.interval_s
        if not J.size or not np.isfinite(J).all():
            return _step(chain, np.zeros(J.shape[1]), "", free, True)
        u, s, vt, _ = lapack.dgesdd(J, full_matrices=False)
        along = (dx @ u).tolist()
        sways = (np.abs(vt) @ np.sqrt((J * J).sum(axis=0))).tolist()
        dq, values = np.zeros(J.shape[1]), s.tolist()
        for i, (value, part, sway) in enumerate(zip(values, along, sways, strict=True)):
            if value <= 1e-12 * values[0]:
                continue
            turn = vt[i] * (part / value)
            dq += _clamped(turn, min(1.0, value / sway) * limit)
        return _step(chain, _clamped(dq, limit), "", free, values[-1] ** 2 <= SINGULAR * values[0] ** 2)


@dataclass(frozen=True)
class ExtendedJacobian:
    """Keeps G = N' grad g = 0, N an orthonormal basis of the null space of J: [J; dG/dq] dq = [dx; -gain G].

    full: dG/dq = N' (Hess g - sum_i mu_i Hess f_i) with J' mu = grad g, f the forward kinematics; otherwise N is held
    constant, N' Hess g. gain_per_s: 0 keeps G as it is; 1 / interval takes away what an integration step has left.

    The rates do not depend on which basis N is (another one multiplies the lower rows, and G, by an orthogonal matrix),
    so that a continuous one need not be tracked. With dq = J+ dx + N z the square system becomes
    (N' M N) z = -N' (M J+ dx + gain grad g), M the bracket above; the gain takes away `MAX_CORRECTION_RAD` at most. The
    extended matrix is singular where J is or where N' M N is: there, its small eigenvalues are damped, and the step
    says so.
    """

    cost: Cost
    full: bool = True
    gain_per_s: float = 0.0

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Mask | None = None) -> Step:
        J = _jacobian(chain, q, free)
        dim, n = J.shape
        y, singular = _solve(J @ J.T, dx)
        dq = J.T @ y
        if n <= dim or not np.isfinite(J).all():
            return _step(chain, dq, "", free, singular)
        N = null_basis(J)
        g, M = reduced_gradient(chain, self.cost, q, J, free, self.full)
        z, lost = _solve_damped(N.T @ M @ N, np.array((M @ dq, g)) @ N)
        along, back = -(z @ N.T)
        if self.gain_per_s:
            size = math.sqrt(float(back @ back))
            along = along + back * (self.gain_per_s * min(1.0, MAX_CORRECTION_RAD / size if size > 0 else 1.0))
        dq, held = _with_priority(chain, dq, along, free)
        return _step(chain, dq, "singular: the extended Jacobian" if lost else held, free, singular or lost)


def extended_jacobian(chain: SerialChain, cost: Cost, q: Array, N: Array, full: bool = True) -> Array:
    """The matrix [J; dG/dq] (n, n) with a basis N (n, n - dim) of the null space."""
    J = chain.jacobian(q)
    return np.concatenate([J, N.T @ reduced_gradient(chain, cost, q, J, None, full)[1]])


def reduced_gradient(
    chain: SerialChain, cost: Cost, q: Array, J: Array, free: Mask | None = None, full: bool = True
) -> tuple[Array, Array]:
    """grad g (n,) and M = Hess g - sum_i mu_i Hess f_i (n, n) of the free joints, for their J (dim, n)."""
    g, M = cost.gradient(q), cost.hessian(q)
    if free is not None:
        g, M = g[free], M[np.ix_(free, free)]
    if not full:
        return g, M
    mu, _ = _solve(J @ J.T, J @ g)
    curvature = chain.curvature(q, mu)
    return g, M - (curvature if free is None else curvature[np.ix_(free, free)])


# -- small linear algebra --------------------------------------------------------------------------------------------


def _jacobian(chain: SerialChain, q: Array, free: Mask | None) -> Array:
    return chain.jacobian(q) if free is None else chain.jacobian(q)[:, free]


def _solve(gram: Array, b: Array, damping: float = 0.0) -> tuple[Array, bool]:
    """(gram + damping I)^-1 b for a symmetric gram (2, 2) or (3, 3) of no negative eigenvalue, and whether it is
    singular without the damping; if so, at least SINGULAR trace is added.

    The closed forms are a tenth of the time of a general solver. The ratio of the eigenvalues is estimated from below.
    """
    trace = float(gram.trace())
    if not math.isfinite(trace) or trace <= 0.0:
        return np.zeros(len(b)), True
    if len(b) == 2:
        (a, c), (_, d) = gram.tolist()
        singular = a * d - c * c <= SINGULAR * trace * trace
        if singular:
            damping = max(damping, SINGULAR * trace)
        a, d = a + damping, d + damping
        determinant = a * d - c * c
        x, y = b.tolist()
        return np.array(((d * x - c * y) / determinant, (a * y - c * x) / determinant)), singular
    if len(b) == 3:
        (a, p, r), (_, d, s), (_, _, f) = gram.tolist()
        determinant = a * (d * f - s * s) - p * (p * f - s * r) + r * (p * s - d * r)
        # The two larger eigenvalues' product is at most trace^2 / 4.
        singular = determinant <= SINGULAR * trace**3 / 4
        if singular:
            damping = max(damping, SINGULAR * trace)
        a, d, f = a + damping, d + damping, f + damping
        x, y, z = b.tolist()
        aa, pp, rr = d * f - s * s, r * s - p * f, p * s - d * r
        dd, ss, ff = a * f - r * r, p * r - a * s, a * d - p * p
        determinant = a * aa + p * pp + r * rr
        if determinant <= 0.0:
            return np.zeros(3), True
        return (
            np.array(
                (
                    (aa * x + pp * y + rr * z) / determinant,
                    (pp * x + dd * y + ss * z) / determinant,
                    (rr * x + ss * y + ff * z) / determinant,
                )
            ),
            singular,
        )
    values, vectors = np.linalg.eigh(gram)
    singular = bool(values[0] <= SINGULAR * values[-1])
    if singular:
        damping = max(damping, SINGULAR * trace)
    return vectors @ ((vectors.T @ b) / (np.maximum(values, 0.0) + damping)), singular


def _solve_damped(A: Array, B: Array) -> tuple[Array, bool]:
    """The rows of B (k, m) times A^-1, for a symmetric A (m, m), and whether an eigenvalue is lost against the largest;
    those are damped."""
    if not math.isfinite(float(A.sum())):
        return np.zeros(B.shape), True
    values, vectors, _ = lapack.dsyev(A)
    sizes = [abs(value) for value in values.tolist()]
    largest, least = max(sizes), min(sizes)
    if not largest > 0.0:
        return np.zeros(B.shape), True
    lost = least <= EXTENDED_SINGULAR * largest
    floor = EXTENDED_SINGULAR * largest if lost else 0.0
    inverse = values / (values * values + floor * floor)
    return ((B @ vectors) * inverse) @ vectors.T, lost


def _clamped(values: Array, limit: float) -> Array:
    """Scaled down to a largest magnitude of `limit`."""
    largest = float(np.abs(values).max())
    return values * (limit / largest) if largest > limit else values


def _with_priority(chain: SerialChain, dq: Array, along: Array, free: Mask | None) -> tuple[Array, str]:
    """dq and as much of a motion along the null space as the limits of the rates leave to it; a note if not all."""
    both = dq + along
    limit = chain.max_rate_rad_s if free is None else chain.max_rate_rad_s[free]
    if (np.abs(both) <= limit).all():
        return both, ""
    share = 1.0
    for rate, more, most in zip(dq.tolist(), along.tolist(), limit.tolist(), strict=True):
        if abs(rate + share * more) > most:
            share = max(0.0, (math.copysign(most, more) - rate) / more) if more else 0.0
    return dq + share * along, "rate limit: part of the motion along the null space"


def _step(chain: SerialChain, dq: Array, note: str, free: Mask | None, singular: bool) -> Step:
    """Rates of the free joints within the limits, 0 for the others."""
    if free is not None:
        some, dq = dq, np.zeros(chain.n)
        dq[free] = some
    share = float((np.abs(dq) / chain.max_rate_rad_s).max())
    if not math.isfinite(share):
        return Step(np.zeros(chain.n), True, "singular: rates that are not finite")
    if singular and not note.startswith("singular"):
        note = "singular: the Jacobian"
    return Step(dq / share if share > 1.0 else dq, singular, note)
