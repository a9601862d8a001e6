"""Methods of inverse kinematics: joint rates dq (n,), rad/s, for an end-effector velocity dx (dim,), m/s.

Each method is one class. All have `rates(chain, q, dx, free)`; free (n,), bool: joints that may move, the others are
taken out of the chain. Rates are finite and within the chain's limits: where a limit is passed, the motion along the
null space is scaled down first, then all rates together. J is the Jacobian, J' its transpose. Near a singular
configuration (det J J' small) the inverse of J J' is damped, and the step says so.

References
----------
Least norm, gradient projection, weighted and damped least squares: C. van der Leek, MSc(Eng), University of Cape Town,
2022, with the inverses that are missing in print. Selectively damped least squares: S. R. Buss and J.-S. Kim, J.
Graphics Tools 10 (2005). Extended Jacobian: J. Baillieul, ICRA 1985. See docs/ik.md.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from recon.base.arrays import Array, Bools
from recon.ik.chain import Curvature, SerialChain, null_basis
from recon.ik.costs import Cost

INTERVAL_S = 1 / 90
"""Duration of one iteration of `drive_to` and `follow`."""
SINGULAR = 1e-6
"""The least over the largest eigenvalue of J J', below which it is singular: a ratio of singular values of a
thousandth."""
LOST = 1e-12
"""The least share of the largest singular value of J: below are directions without motion."""
EXTENDED_SINGULAR = 1e-3
"""The least over the largest eigenvalue of N' M N, by magnitude, below which it is singular."""
MAX_CORRECTION_RAD = 0.05
"""Most that the gain takes away at once: a longer step along the null space would move the end effector, to second
order, by more than millimetres."""
ALL = slice(None)
"""Every joint may move."""
Free = Bools | slice


class JointRates(NamedTuple):
    """Hold the rates with which the joints are to move."""

    dq: Array
    """The joints' rates, rad/s, shape (n,)."""
    singular: bool = False
    """Whether the rates are damped because a direction is lost."""
    note: str = ""
    """What is held back or damped, in words, or empty."""
    along: Array | float = 0.0
    """A motion along the null space in addition, before limits."""


@dataclass(frozen=True, eq=False)
class Method(ABC):
    """Find joint rates, with a factor on all of them."""

    alpha: float | None = field(default=1.0, kw_only=True)
    """None: <dx, J dq> / |J dq|^2 at every step, with which J dq is nearest to dx."""

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Free = ALL) -> JointRates:
        """Return the rates for q (n,) and dx (dim,)."""
        J, curvature = chain.derivatives(q)
        step = _within_limits(chain, free, self._solve(J[:, free], dx, q, free, curvature))
        if self.alpha == 1.0:
            return step
        alpha = best_scale(J @ step.dq, dx) if self.alpha is None else self.alpha
        return _within_limits(chain, free, step._replace(dq=alpha * step.dq[free]))

    def formula(self, J: Array, dx: Array, q: Array) -> Array:
        """Return rates (n,) without limits for J (dim, n), dx (dim,), q (n,); the extended Jacobian's N is constant."""
        solved = self._solve(J, dx, q, ALL, None)
        total = solved.dq + solved.along
        return total * (best_scale(J @ total, dx) if self.alpha is None else self.alpha)

    @abstractmethod
    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        """Return the rates of the m free joints, with their Jacobian J (dim, m), and q and curvature of all joints."""


@dataclass(frozen=True, eq=False)
class LeastNorm(Method):
    """Take the smallest rates: W^-1 J' (J W^-1 J' + lambda^2 I)^-1 dx minimises dq' W dq + |J dq - dx|^2 / lambda^2.

    With neither weights nor damping that is J+ dx.
    """

    weights: Array | None = None
    """diag W (n,), positive; None: all 1."""
    damping_m: float = 0.0
    """The damping lambda, in metres."""

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        along = J if self.weights is None else J / self.weights[free]
        inverse, singular = right_inverse(J, along, self.damping_m**2)
        return JointRates(inverse @ dx, singular)


def weighted_least_norm(weights: Array) -> LeastNorm:
    """Return the method W^-1 J' (J W^-1 J')^-1 dx, which minimises dq' W dq. weights: diag W (n,), positive."""
    return LeastNorm(weights)


def damped_least_squares(damping_m: float = 0.05) -> LeastNorm:
    """Return the method J' (J J' + lambda^2 I)^-1 dx, which minimises |J dq - dx|^2 + lambda^2 |dq|^2.

    damping_m: lambda, metres.
    """
    return LeastNorm(damping_m=damping_m)


@dataclass(frozen=True, eq=False)
class JacobianTranspose(Method):
    """Take alpha J' dx, by default with the alpha of every step."""

    alpha: float | None = None

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        return JointRates(J.T @ dx, _is_singular(J @ J.T))


@dataclass(frozen=True, eq=False)
class GradientProjection(Method):
    """Take J+ dx + k (I - J+ J) g."""

    gradient: Cost | Callable[[Array], Array]
    """g (n,) as a function of q, or a cost, whose gradient it is."""
    k: float = -1.0
    """The step along the cost, 1/s, negative to descend."""

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        gradient = self.gradient.gradient if isinstance(self.gradient, Cost) else self.gradient
        g = self.k * gradient(q)[free]
        pseudo, singular = right_inverse(J)
        return JointRates(pseudo @ dx, singular, along=g - pseudo @ (J @ g))


@dataclass(frozen=True, eq=False)
class SelectivelyDamped(Method):
    """Damp each singular direction i, v_i (u_i . dx) / s_i, separately (Buss and Kim 2005, one end effector).

    In an interval, no joint of a direction turns by more than

        gamma_i = min(1, 1 / M_i) gamma_max,   M_i = sum_j |v_ji| |J_j| / s_i

    and the sum of the directions turns no joint by more than gamma_max.
    """

    gamma_max_rad: float = math.pi / 4
    interval_s: float = INTERVAL_S

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        limit = self.gamma_max_rad / self.interval_s
        dq = np.zeros(J.shape[1])
        if not J.size or not np.isfinite(J).all():
            return JointRates(dq, True)
        u, s, vt = np.linalg.svd(J, full_matrices=False)
        sways = np.abs(vt) @ np.linalg.norm(J, axis=0)
        for value, part, sway, way in zip(s, dx @ u, sways, vt, strict=True):
            if value > LOST * s[0]:
                dq += _clamped(way * (part / value), min(1.0, value / sway) * limit)
        return JointRates(_clamped(dq, limit), bool(s[-1] ** 2 <= SINGULAR * s[0] ** 2))


@dataclass(frozen=True, eq=False)
class ExtendedJacobian(Method):
    """Keep G = N' grad g = 0, N an orthonormal basis of the null space of J: [J; dG/dq] dq = [dx; -gain G].

    full: dG/dq = N' (Hess g - sum_i mu_i Hess f_i) with J' mu = grad g, f the forward kinematics; otherwise N is held
    constant, N' Hess g. gain_per_s: 0 keeps G as it is; 1 / interval takes away what an integration step has left.

    The rates do not depend on which basis N is (another one multiplies the lower rows, and G, by an orthogonal matrix),
    so that a continuous one need not be tracked. With M the bracket above and K = N (N' M N)^-1 N' the square system's
    solution is

        dq = J+ dx - K (M J+ dx + gain grad g)

    where the gain takes away `MAX_CORRECTION_RAD` at most. The extended matrix is singular where J is or where N' M N
    is: there, its small eigenvalues are damped, and the step says so.
    """

    cost: Cost
    full: bool = True
    gain_per_s: float = 0.0

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        pseudo, singular = right_inverse(J)
        dq = pseudo @ dx
        if J.shape[1] <= J.shape[0] or (singular and not np.isfinite(J).all()):
            return JointRates(dq, singular)
        g, M = reduced_gradient(self.cost, q, pseudo, curvature if self.full else None, free)
        K, lost = _reduced_inverse(M, null_basis(J))
        along = -(K @ (M @ dq))
        if self.gain_per_s:
            back = K @ g
            size = float(np.linalg.norm(back))
            along -= back * (self.gain_per_s * min(1.0, MAX_CORRECTION_RAD / size if size > 0 else 1.0))
        return JointRates(dq, singular or lost, "singular: the extended Jacobian" if lost else "", along)


STANDARD: dict[str, Method] = {
    "least-norm": LeastNorm(),
    "transpose": JacobianTranspose(),
    "damped": damped_least_squares(),
    "selectively-damped": SelectivelyDamped(),
}
"""Methods with their standard parameters."""


def reduced_gradient(
    cost: Cost, q: Array, pseudo: Array, curvature: Curvature | None, free: Free = ALL
) -> tuple[Array, Array]:
    """Return grad g (m,) and M = Hess g - sum_i mu_i Hess f_i (m, m) of the free joints.

    pseudo: their J+ (m, dim); curvature: of all joints; None leaves the sum out.
    """
    g, M = cost.gradient(q)[free], cost.hessian(q)[free][:, free]
    return g, M if curvature is None else M - curvature(g @ pseudo)[free][:, free]


def best_scale(rates: Array, wanted: Array) -> float:
    """Return the factor that brings rates closest to those wanted, <wanted, rates> / |rates|^2; 1 if nothing moves."""
    square = float(np.vdot(rates, rates))
    return float(np.vdot(wanted, rates)) / square if square > 0 else 1.0


def right_inverse(J: Array, along: Array | None = None, damping: float = 0.0) -> tuple[Array, bool]:
    """Return A' (J A' + damping I)^-1 (n, dim), and whether J A' is singular without the damping.

    A (dim, n) is `along`, or J, which gives J+. If J A' is singular, at least SINGULAR times its trace is added. The
    result is zero if J A' is zero or not finite.
    """
    A = J if along is None else along
    gram = J @ A.T
    if singular := _is_singular(gram):
        trace = float(gram.trace())
        if not 0.0 < trace < math.inf:
            return np.zeros(A.shape[::-1]), True
        damping = max(damping, SINGULAR * trace)
    if damping:
        gram = gram + damping * np.eye(len(gram))
    return np.asarray(dposv(gram, A)[1]).T, singular


def _is_singular(gram: Array) -> bool:
    """Whether a symmetric gram (dim, dim) of no negative eigenvalue is singular, zero or not finite.

    The ratio of the eigenvalues is estimated from below, by the determinant: all but the least multiply to their mean's
    power at most.
    """
    trace, rest = float(gram.trace()), max(len(gram) - 1, 1)
    if not 0.0 < trace < math.inf:
        return True
    return bool(np.linalg.det(gram) <= SINGULAR * trace * (trace / rest) ** rest)


def _reduced_inverse(M: Array, N: Array) -> tuple[Array, bool]:
    """Return N (N' M N)^-1 N' (n, n), for a symmetric M (n, n) and a basis N (n, m), and whether it is nearly singular.

    Eigenvalues of N' M N that vanish against the largest are damped.
    """
    A = N.T @ M @ N
    if not np.isfinite(A).all():
        return np.zeros(M.shape), True
    values, vectors = np.linalg.eigh(A)
    largest, least = np.abs(values).max(), np.abs(values).min()
    if not largest > 0.0:
        return np.zeros(M.shape), True
    lost = bool(least <= EXTENDED_SINGULAR * largest)
    floor = EXTENDED_SINGULAR * largest if lost else 0.0
    turned = N @ vectors
    return (turned * (values / (values * values + floor * floor))) @ turned.T, lost


def _clamped(values: Array, limit: float) -> Array:
    """Return values scaled down to a largest magnitude of `limit`."""
    largest = float(np.abs(values).max())
    return values * (limit / largest) if largest > limit else values


def _within_limits(chain: SerialChain, free: Free, solved: JointRates) -> JointRates:
    """Return the rates of all joints from those of the free ones, 0 for the others.

    The motion along the null space is reduced as far as the limits require. The note says what was reduced, and where.
    """
    dq, singular, note, along = solved
    limit = chain.max_rate_rad_s[free]
    total = dq + along
    if not (np.abs(total) <= limit).all():
        if isinstance(along, np.ndarray):
            total = dq + _share_within(dq, along, limit) * along
            note = note or "rate limit: part of the motion along the null space"
        excess = float((np.abs(total) / limit).max())
        if not math.isfinite(excess):
            return JointRates(np.zeros(chain.n), True, "singular: rates that are not finite")
        total = total / max(excess, 1.0)
    if singular and not note.startswith("singular"):
        note = "singular: the Jacobian"
    rates = np.zeros(chain.n)
    rates[free] = total
    return JointRates(rates, singular, note)


def _share_within(rates: Array, along: Array, limit: Array) -> float:
    """Return the largest share of `along`, up to 1, that brings no rate beyond its limit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = (np.copysign(limit, along) - rates) / along
        shares = np.where(along != 0, room, np.abs(rates) <= limit)
    return max(0.0, float(np.fmin.reduce(shares, initial=1.0)))
