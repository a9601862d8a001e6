"""Compute joint rates dq (n,) in rad/s for an end-effector velocity dx (dim,) in m/s, by several methods.

Each method is a class with `rates(chain, q, dx, free)`. `free` (n,) selects the joints that may move. The other joints
are taken out of the chain. The rates are finite and within the limits of the chain. If they exceed a limit, the motion
along the null space is scaled down first, and then all rates together. J is the Jacobian, J' its transpose. Near a
singular configuration (small det J J') the inverse of J J' is damped, and the note of the step says so.

References
----------
Least norm, gradient projection, weighted and damped least squares: C. van der Leek, MSc(Eng), University of Cape Town,
2022, with the inverses that the printed formulas lack. Selectively damped least squares: S. R. Buss and J.-S. Kim, J.
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
"""Default duration of one iteration of `drive_to` and `follow`, seconds."""
MIN_EIGENVALUE_RATIO = 1e-6
"""Minimum ratio of the smallest to the largest eigenvalue of J J' for which J J' counts as regular.

The corresponding ratio of the singular values of J is one thousandth.
"""
MIN_SINGULAR_RATIO = 1e-12
"""Minimum singular value of J, as a fraction of the largest, for a singular direction in which motion is possible."""
EXTENDED_SINGULAR = 1e-3
"""Minimum ratio, in magnitude, of the smallest to the largest eigenvalue of N' M N if N' M N counts as regular."""
MAX_CORRECTION_RAD = 0.05
"""Largest joint motion by which the gain of the extended Jacobian corrects G in one step, rad.

A longer step along the null space would move the end effector by millimetres, to second order.
"""
ALL_JOINTS = slice(None)
"""Value of `free` with which all joints may move."""
Free = Bools | slice


class JointRates(NamedTuple):
    """Joint rates that a method computed for one step, with a note."""

    dq: Array
    """Rates of the joints, shape (n,), rad/s."""
    singular: bool = False
    """Whether the rates were damped because the end effector cannot move in some direction."""
    note: str = ""
    """Sentence that says how the rates were reduced or damped; empty if they were not."""
    along: Array | float = 0.0
    """Rates along the null space in rad/s, to add to `dq` as far as the limits allow."""


@dataclass(frozen=True, eq=False)
class Method(ABC):
    """Base class of the methods that compute joint rates."""

    alpha: float | None = field(default=1.0, kw_only=True)
    """Factor on all rates; None for <dx, J dq> / |J dq|^2, which brings J dq nearest to dx at every step."""

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Free = ALL_JOINTS) -> JointRates:
        """Return the joint rates at q (n,) for an end-effector velocity dx (dim,).

        `free` selects the joints that may move.
        """
        J, curvature = chain.derivatives(q)
        step = _within_limits(chain, free, self._solve(J[:, free], dx, q, free, curvature))
        if self.alpha == 1.0:
            return step
        alpha = best_scale(J @ step.dq, dx) if self.alpha is None else self.alpha
        return _within_limits(chain, free, step._replace(dq=alpha * step.dq[free]))

    def formula(self, J: Array, dx: Array, q: Array) -> Array:
        """Return the rates (n,) without limits, for J (dim, n), dx (dim,) and q (n,).

        The basis N of the extended Jacobian is treated as constant.
        """
        solved = self._solve(J, dx, q, ALL_JOINTS, None)
        total = solved.dq + solved.along
        return total * (best_scale(J @ total, dx) if self.alpha is None else self.alpha)

    @abstractmethod
    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        """Return the rates of the m free joints, given their Jacobian J (dim, m).

        `q` (n,) and `curvature` belong to all joints.
        """


@dataclass(frozen=True, eq=False)
class LeastNorm(Method):
    """Method that computes the smallest joint rates, dq = W^-1 J' (J W^-1 J' + lambda^2 I)^-1 dx.

    The rates minimise dq' W dq + |J dq - dx|^2 / lambda^2. Without weights and damping, they are J+ dx.
    """

    weights: Array | None = None
    """Diagonal of W, shape (n,), positive; None for the identity."""
    damping_m: float = 0.0
    """Damping lambda, in metres."""

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        along = J if self.weights is None else J / self.weights[free]
        inverse, singular = right_inverse(J, along, self.damping_m**2)
        return JointRates(inverse @ dx, singular)


def weighted_least_norm(weights: Array) -> LeastNorm:
    """Return the method dq = W^-1 J' (J W^-1 J')^-1 dx, which minimises dq' W dq.

    `weights` is the diagonal of W, (n,), positive.
    """
    return LeastNorm(weights)


def damped_least_squares(damping_m: float = 0.05) -> LeastNorm:
    """Return the method dq = J' (J J' + lambda^2 I)^-1 dx, which minimises |J dq - dx|^2 + lambda^2 |dq|^2.

    `damping_m` is lambda, in metres.
    """
    return LeastNorm(damping_m=damping_m)


@dataclass(frozen=True, eq=False)
class JacobianTranspose(Method):
    """Method that computes the joint rates alpha J' dx, by default with the best alpha at every step."""

    alpha: float | None = None

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        return JointRates(J.T @ dx, _is_singular(J @ J.T))


@dataclass(frozen=True, eq=False)
class GradientProjection(Method):
    """Method that computes the joint rates J+ dx + k (I - J+ J) g."""

    gradient: Cost | Callable[[Array], Array]
    """g (n,) as a function of q, or a cost with g as its gradient."""
    k: float = -1.0
    """Gain along the gradient, 1/s; negative to descend."""

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        gradient = self.gradient.gradient if isinstance(self.gradient, Cost) else self.gradient
        g = self.k * gradient(q)[free]
        pseudo, singular = right_inverse(J)
        return JointRates(pseudo @ dx, singular, along=g - pseudo @ (J @ g))


@dataclass(frozen=True, eq=False)
class SelectivelyDamped(Method):
    """Inverse kinematics by selectively damped least squares (Buss and Kim 2005).

    The singular value decomposition of the Jacobian J, with singular values s_i and vectors u_i and v_i, splits the
    joint rates for a foot velocity dx into directions v_i (u_i . dx) / s_i. Each direction is damped separately. J_j is
    column j of J. Within one interval, direction i turns no joint by more than

        gamma_i = min(1, 1 / M_i) gamma_max,   M_i = sum_j |v_ji| |J_j| / s_i

    and all directions together turn no joint by more than gamma_max.
    """

    gamma_max_rad: float = math.pi / 4
    interval_s: float = INTERVAL_S

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        if not J.size or not np.isfinite(J).all():
            return JointRates(np.zeros(J.shape[1]), True)
        directions = SingularDirections.of_motion(J, dx)
        return JointRates(self.damped(directions), bool(directions.singular))

    def damped(self, directions: SingularDirections) -> Array:
        """Return the damped rates (..., n) of motions that are split into singular directions."""
        limit = self.gamma_max_rad / self.interval_s
        damped = _clamped(directions.rates, directions.shares * limit)
        total = np.zeros(damped.shape[:-2] + damped.shape[-1:])
        for m in range(damped.shape[-2]):
            total += damped[..., m, :]
        return _clamped(total, np.asarray(limit))


class SingularDirections(NamedTuple):
    """A motion, or the motions of several frames, split into the singular directions of J."""

    rates: Array
    """Undamped rates of each direction, v_i (u_i . dx) / s_i, shape (..., m, n); 0 for a direction without motion."""
    shares: Array
    """Limit gamma_i / gamma_max of each direction, shape (..., m), 0 to 1."""
    singular: Array
    """Whether J is singular, shape (...)."""

    @classmethod
    def of_motion(cls, J: Array, dx: Array) -> SingularDirections:
        """Split a motion dx (dim,) into the singular directions of J (dim, n)."""
        u, s, vt = np.linalg.svd(J, full_matrices=False)
        sways, moves = np.abs(vt) @ np.linalg.norm(J, axis=0), s > MIN_SINGULAR_RATIO * s[0]
        parts = np.divide(dx @ u, s, out=np.zeros_like(s), where=moves)
        shares = np.minimum(1.0, np.divide(s, sways, out=np.ones_like(s), where=moves))
        return cls(vt * parts[:, None], shares, np.asarray(s[-1] ** 2 <= MIN_EIGENVALUE_RATIO * s[0] ** 2))


@dataclass(frozen=True, eq=False)
class ExtendedJacobian(Method):
    """A method that keeps G = N' grad g = 0 by solving [J; dG/dq] dq = [dx; -gain G].

    N is an orthonormal basis of the null space of J. If `full` is true, dG/dq = N' (Hess g - sum_i mu_i Hess f_i) with
    J' mu = grad g and the forward kinematics f. Otherwise N is treated as constant, and dG/dq = N' Hess g. A
    `gain_per_s` of 0 keeps G as it is, and 1 / interval removes the G left by an integration step.

    The rates do not depend on the choice of N, because another basis multiplies the lower rows and G by an orthogonal
    matrix. A continuous basis therefore need not be tracked. With the bracket above called M, and
    K = N (N' M N)^-1 N', the solution of the square system is

        dq = J+ dx - K (M J+ dx + gain grad g)

    in which the gain removes `MAX_CORRECTION_RAD` at most. The extended matrix is singular if J or N' M N is singular.
    Its small eigenvalues are then damped, and the note of the step says so.
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
"""Each method of inverse kinematics with its standard parameters."""


def reduced_gradient(
    cost: Cost, q: Array, pseudo: Array, curvature: Curvature | None, free: Free = ALL_JOINTS
) -> tuple[Array, Array]:
    """Return grad g (m,) and M = Hess g - sum_i mu_i Hess f_i (m, m) of the m free joints.

    `pseudo` is the free joints' J+ (m, dim). `curvature` belongs to all joints; None leaves the sum out.
    """
    g, M = cost.gradient(q)[free], cost.hessian(q)[free][:, free]
    return g, M if curvature is None else M - curvature(g @ pseudo)[free][:, free]


def best_scale(rates: Array, wanted: Array) -> float:
    """Return the factor <wanted, rates> / |rates|^2 that brings `rates` closest to `wanted`; 1 without motion."""
    square = float(np.vdot(rates, rates))
    return float(np.vdot(wanted, rates)) / square if square > 0 else 1.0


def right_inverse(J: Array, along: Array | None = None, damping: float = 0.0) -> tuple[Array, bool]:
    """Return A' (J A' + damping I)^-1 (n, dim), and whether J A' is singular without the damping.

    A (dim, n) is `along`, or J, which gives J+. If J A' is singular, at least MIN_EIGENVALUE_RATIO times its trace is
    added to its diagonal. The result is zero if J A' is zero or not finite.
    """
    A = J if along is None else along
    gram = J @ A.T
    if singular := _is_singular(gram):
        trace = float(gram.trace())
        if not 0.0 < trace < math.inf:
            return np.zeros(A.shape[::-1]), True
        damping = max(damping, MIN_EIGENVALUE_RATIO * trace)
    if damping:
        gram = gram + damping * np.eye(len(gram))
    return np.asarray(dposv(gram, A)[1]).T, singular


def _is_singular(gram: Array) -> bool:
    """Return whether a symmetric matrix (dim, dim) without negative eigenvalues is singular, zero or not finite.

    The ratio of its smallest to its largest eigenvalue is estimated from below by the determinant, because the product
    of the other dim - 1 eigenvalues is at most their mean to the power of dim - 1.
    """
    trace, rest = float(gram.trace()), max(len(gram) - 1, 1)
    if not 0.0 < trace < math.inf:
        return True
    return bool(np.linalg.det(gram) <= MIN_EIGENVALUE_RATIO * trace * (trace / rest) ** rest)


def _reduced_inverse(M: Array, N: Array) -> tuple[Array, bool]:
    """Return N (N' M N)^-1 N' (n, n), and whether N' M N is nearly singular.

    M (n, n) is symmetric, and N (n, m) is a basis. Eigenvalues of N' M N that are tiny relative to the largest are
    damped.
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


def _clamped(values: Array, limit: Array) -> Array:
    """Scale down each row of values (..., n) until its largest magnitude is at most the row's limit (...)."""
    largest = np.abs(values).max(axis=-1)
    factor = np.divide(limit, largest, out=np.ones_like(largest), where=largest > limit)
    return values * factor[..., None]


def _within_limits(chain: SerialChain, free: Free, solved: JointRates) -> JointRates:
    """Return the rates of all joints within their limits, with rate 0 for joints that are not free.

    The motion along the null space is reduced as far as the limits require, and the note says so.
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
    """Return the largest fraction of `along`, up to 1, that can be added to the rates within their limits."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = (np.copysign(limit, along) - rates) / along
        shares = np.where(along != 0, room, np.abs(rates) <= limit)
    return max(0.0, float(np.fmin.reduce(shares, initial=1.0)))
