"""Joint rates dq (n,), rad/s, for a velocity of the end effector dx (dim,), m/s: one class for each method.

All have `rates(chain, q, dx, free)`; free (n,), bool: joints that may move, the others are taken out of the chain.
Rates are finite and within the chain's limits: where one is passed, what moves along the null space is scaled down
first, then all together. J is the Jacobian, J' its transpose. Near a singular configuration, det J J' small, the
inverse of J J' is damped, and the step says so.

Formulas: least norm, gradient projection, weighted and damped least squares as in C. van der Leek, MSc(Eng),
University of Cape Town, 2022, with inverses where print lost them; selectively damped least squares: S. R. Buss and
J.-S. Kim, J. Graphics Tools 10 (2005); extended Jacobian: J. Baillieul, ICRA 1985. See docs/ik.md. Costs on the joint
angles of redundant chains are the thesis', too, with their gradients and Hessians; of the rotational energies each link
has its own length (printed with r5 throughout).

Parameters of methods come from given joint rates by least squares, sum |dq - rates|^2 over frames. The rates are those
of the formulas, without limits. To make the parameters identifiable, diag W has mean 1, and of the motion along the
null space k = 1. Frames of several chains of one kind can be joined, and what is fitted to some can be held against
others. One frame alone gives the parameters of one configuration.

A method moves a chain's end effector to a target or along a path, and the chain along the null space with it held. One
iteration is an interval of time: the end effector is sent to the next point at the velocity that gets it there
(which takes away the drift of the one before), no faster than `MAX_STEP_M` an interval, the method gives the rates, and
the joints move by rates times interval. Joints that would leave their limits stay where they are and are taken out of
the chain for that iteration. The extended Jacobian starts at G = 0, to which it is moved along the null space first,
and is kept there by a gain of 1 / interval.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dposv
from scipy.optimize import least_squares, minimize_scalar

from recon.base.arrays import Array, Bools
from recon.gait import phase
from recon.ik.chain import Curvature, SerialChain, manipulability, null_basis, unreachable

INTERVAL_S = 1 / 90
"""What one iteration of `drive_to` and `follow` takes."""
SINGULAR = 1e-6
"""The least over the largest eigenvalue of J J', below which it is singular: a ratio of singular values of a
thousandth."""
LOST = 1e-12
"""The least share of the largest singular value of J: below are directions without motion."""
EXTENDED_SINGULAR = 1e-3
"""The least over the largest eigenvalue of N' M N, by magnitude, below which it is singular."""
MAX_CORRECTION_RAD = 0.05
"""What the gain takes away at once, at most: a longer step along the null space would move the end effector, to second
order, by more than millimetres."""
ALL = slice(None)
"""Every joint may move."""
Free = Bools | slice


class JointRates(NamedTuple):
    """How fast the joints are to move."""

    dq: Array
    """The joints' rates, rad/s, shape (n,)."""
    singular: bool = False
    """Whether the rates are damped because a direction is lost."""
    note: str = ""
    """What is held back or damped, in words, or empty."""
    along: Array | float = 0.0
    """A motion along the null space that comes on top, before limits."""


@dataclass(frozen=True, eq=False)
class Cost:
    """A cost on joint angles q (n,), rad: three functions of them."""

    value: Callable[[Array], float]
    gradient: Callable[[Array], Array]
    """The gradient of the cost, shape (n,)."""
    hessian: Callable[[Array], Array]
    """The second derivatives of the cost, shape (n, n)."""


@dataclass(frozen=True, eq=False)
class Method(ABC):
    """A way to joint rates, with a factor on all of them."""

    alpha: float | None = field(default=1.0, kw_only=True)
    """None: <dx, J dq> / |J dq|^2 at every step, with which J dq is nearest to dx."""

    def rates(self, chain: SerialChain, q: Array, dx: Array, free: Free = ALL) -> JointRates:
        """Rates for q (n,) and dx (dim,)."""
        J, curvature = chain.derivatives(q)
        step = _within_limits(chain, free, self._solve(J[:, free], dx, q, free, curvature))
        if self.alpha == 1.0:
            return step
        alpha = best_scale(J @ step.dq, dx) if self.alpha is None else self.alpha
        return _within_limits(chain, free, step._replace(dq=alpha * step.dq[free]))

    def formula(self, J: Array, dx: Array, q: Array) -> Array:
        """Rates (n,) without limits, for J (dim, n), dx (dim,) and q (n,); of the extended Jacobian with N constant."""
        solved = self._solve(J, dx, q, ALL, None)
        total = solved.dq + solved.along
        return total * (best_scale(J @ total, dx) if self.alpha is None else self.alpha)

    @abstractmethod
    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        """Rates of the m free joints, of which J (dim, m) is; q, curvature: of all."""


@dataclass(frozen=True, eq=False)
class LeastNorm(Method):
    """W^-1 J' (J W^-1 J' + lambda^2 I)^-1 dx, which minimises dq' W dq + |J dq - dx|^2 / lambda^2: the smallest rates.

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
    """W^-1 J' (J W^-1 J')^-1 dx, which minimises dq' W dq. weights: diag W (n,), positive."""
    return LeastNorm(weights)


def damped_least_squares(damping_m: float = 0.05) -> LeastNorm:
    """J' (J J' + lambda^2 I)^-1 dx, which minimises |J dq - dx|^2 + lambda^2 |dq|^2. damping_m: lambda, metres."""
    return LeastNorm(damping_m=damping_m)


@dataclass(frozen=True, eq=False)
class JacobianTranspose(Method):
    """alpha J' dx, by default with the alpha of every step."""

    alpha: float | None = None

    def _solve(self, J: Array, dx: Array, q: Array, free: Free, curvature: Curvature | None) -> JointRates:
        return JointRates(J.T @ dx, _is_singular(J @ J.T))


@dataclass(frozen=True, eq=False)
class GradientProjection(Method):
    """J+ dx + k (I - J+ J) g."""

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
    """Each singular direction i damped by itself: (v_i (u_i . dx) / s_i), no joint of which turns more than

        gamma_i = min(1, 1 / M_i) gamma_max,   M_i = sum_j |v_ji| |J_j| / s_i

    in an interval, and their sum no more than gamma_max. Buss and Kim 2005, for one end effector.
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
    """Keeps G = N' grad g = 0, N an orthonormal basis of the null space of J: [J; dG/dq] dq = [dx; -gain G].

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
    """grad g (m,) and M = Hess g - sum_i mu_i Hess f_i (m, m) of the free joints, whose J+ is pseudo (m, dim).
    curvature: of all joints; None leaves the sum out."""
    g, M = cost.gradient(q)[free], cost.hessian(q)[free][:, free]
    return g, M if curvature is None else M - curvature(g @ pseudo)[free][:, free]


def best_scale(rates: Array, wanted: Array) -> float:
    """The factor that brings rates nearest to those wanted, <wanted, rates> / |rates|^2; 1 where nothing moves."""
    square = float(np.vdot(rates, rates))
    return float(np.vdot(wanted, rates)) / square if square > 0 else 1.0


# -- costs ------------------------------------------------------------------------------------------------------------


def quadratic(matrix: Array, about: Array | float = 0.0) -> Cost:
    """g = (q - about)' H (q - about) / 2 with a constant symmetric matrix H (n, n); about: (n,), or 0 for all."""
    return Cost(
        lambda q: float((q - about) @ matrix @ (q - about)) / 2, lambda q: matrix @ (q - about), lambda _: matrix
    )


def joint_differences(chain: SerialChain) -> Cost:
    """sum (q_{k+1} - q_k)^2 over the joints that follow each other, thetas and phis apart: an even bend."""
    D = np.concatenate([np.diff(np.eye(chain.n)[[*group]], axis=0) for group in chain.groups])
    return quadratic(2 * D.T @ D)


def rotational_energy(chain: SerialChain) -> Cost:
    """sum (r_k q_k)^2 with each joint's own link length r_k, m^2: least rotation, least in the long links."""
    return quadratic(2 * np.diag(chain.joint_lengths_m**2))


def pose_distance(pose: Array) -> Cost:
    """sum (q_k - p_k)^2 from a pose p (n,), of the animal for instance."""
    return quadratic(2 * np.eye(len(pose)), pose)


def weighted_sum(costs: Sequence[Cost], weights: Sequence[float]) -> Cost:
    """sum_i w_i g_i of other costs."""

    def added(part: str, q: Array) -> Any:
        return sum(w * getattr(cost, part)(q) for w, cost in zip(weights, costs, strict=True))

    return Cost(partial(added, "value"), partial(added, "gradient"), partial(added, "hessian"))


def harmonic_map(a: float = 1.0, b: float = 0.0, joints: Sequence[int] = (2, 3, 4)) -> Cost:
    """g = q2 (a q1 + b) sqrt(1 + q1^2) with q1 = q[i] - q[j], q2 = q[k] - q[j].

    joints: (i, j, k), by default theta_2, theta_3, theta_4 of the spine-front-leg chain. Its Hessian has rank 2, and
    its stationary points are saddles: the extended Jacobian can be singular at G = 0.
    """
    i, j, k = joints

    def parts(q: Array) -> tuple[float, float, float, float]:
        """q2, f, f' and f'' of f = (a q1 + b) sqrt(1 + q1^2)."""
        q1, q2 = float(q[i] - q[j]), float(q[k] - q[j])
        root, line = math.sqrt(1 + q1 * q1), a * q1 + b
        first = a * root + line * q1 / root
        second = (3 * a * q1 + b) / root - line * q1 * q1 / root**3
        return q2, line * root, first, second

    def differences(q: Array) -> Array:
        """(2, n): q1 and q2 by q."""
        out = np.zeros((2, len(q)))
        out[[0, 1], [i, k]], out[:, j] = 1.0, -1.0
        return out

    def gradient(q: Array) -> Array:
        q2, f, first, _ = parts(q)
        return np.array([q2 * first, f]) @ differences(q)

    def hessian(q: Array) -> Array:
        q2, _, first, second = parts(q)
        return differences(q).T @ np.array([[q2 * second, first], [first, 0.0]]) @ differences(q)

    return Cost(lambda q: math.prod(parts(q)[:2]), gradient, hessian)


def user_cost(function: Callable[[Array], float], step_rad: float = 1e-4) -> Cost:
    """Any smooth function of q (n,), with derivatives from central differences over step_rad."""

    def slopes(of: Callable[[Array], Array | float], q: Array) -> Array:
        with np.errstate(invalid="ignore"):  # a cost that is infinite has no slope
            return np.array([np.subtract(of(q + e), of(q - e)) for e in step_rad * np.eye(len(q))]) / (2 * step_rad)

    def hessian(q: Array) -> Array:
        bent = slopes(lambda x: slopes(function, x), q)
        return (bent + bent.T) / 2

    return Cost(lambda q: float(function(q)), lambda q: slopes(function, q), hessian)


# -- small linear algebra --------------------------------------------------------------------------------------------


def right_inverse(J: Array, along: Array | None = None, damping: float = 0.0) -> tuple[Array, bool]:
    """A' (J A' + damping I)^-1 (n, dim) with A (dim, n) = along, or J, which gives J+; and whether J A' is singular
    without the damping. If it is, at least SINGULAR times its trace is added; zero where it is zero or not finite."""
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
    trace, others = float(gram.trace()), max(len(gram) - 1, 1)
    if not 0.0 < trace < math.inf:
        return True
    return bool(np.linalg.det(gram) <= SINGULAR * trace * (trace / others) ** others)


def _reduced_inverse(M: Array, N: Array) -> tuple[Array, bool]:
    """N (N' M N)^-1 N' (n, n), for a symmetric M (n, n) and a basis N (n, m), and whether an eigenvalue of N' M N is
    lost against the largest; those are damped."""
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
    """Scaled down to a largest magnitude of `limit`."""
    largest = float(np.abs(values).max())
    return values * (limit / largest) if largest > limit else values


def _within_limits(chain: SerialChain, free: Free, solved: JointRates) -> JointRates:
    """Rates of all joints from those of the free ones, with as much of the motion along the null space as the limits
    leave to it; 0 for the others. The note says what was held back, and where."""
    dq, singular, note, along = solved
    limit = chain.max_rate_rad_s[free]
    total = dq + along
    if not (np.abs(total) <= limit).all():
        if isinstance(along, np.ndarray):
            total = dq + _share_within(dq, along, limit) * along
            note = note or "rate limit: part of the motion along the null space"
        most = float((np.abs(total) / limit).max())
        if not math.isfinite(most):
            return JointRates(np.zeros(chain.n), True, "singular: rates that are not finite")
        total = total / max(most, 1.0)
    if singular and not note.startswith("singular"):
        note = "singular: the Jacobian"
    rates = np.zeros(chain.n)
    rates[free] = total
    return JointRates(rates, singular, note)


def _share_within(rates: Array, along: Array, limit: Array) -> float:
    """The largest share of `along`, up to 1, that brings no rate beyond its limit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = (np.copysign(limit, along) - rates) / along
        shares = np.where(along != 0, room, np.abs(rates) <= limit)
    return max(0.0, float(np.fmin.reduce(shares, initial=1.0)))


# -- their parameters, from given joint rates -----------------------------------------------------------------------

RANGE = (1e-4, 1e2)
"""Limits of lambda (m) and of gamma_max (rad): beyond, it makes no difference, or no motion."""
WEIGHT_RANGE = 1e3
"""Greatest ratio of a weight to the one it starts from."""
PULL = 0.01
"""The pull of the weights of one configuration towards even ones, which otherwise many explain: what a factor of e
costs, as a share of the rates."""

PARAMETERS = {
    "transpose": ("alpha_1_m2",),
    "gradient-projection": ("k_1_s",),
    "damped": ("lambda_m",),
    "selectively-damped": ("gamma_max_rad",),
}
"""What the only parameter of some methods is called in tables."""


@dataclass(frozen=True, eq=False)
class Frames:
    """T frames of a chain, or, one after the other, of several of one kind."""

    q: Array
    """(T, n), rad."""
    jacobian: Array
    """(T, dim, n)"""
    dx: Array
    """(T, dim), m/s."""
    dq: Array
    """(T, n), rad/s."""
    names: tuple[str, ...]
    """(n,): of the joints."""

    @classmethod
    def of(cls, chain: SerialChain, q: Array, dx: Array, dq: Array) -> Frames:
        """The frames without a NaN. Raises ValueError where there is none."""
        known = np.isfinite(np.concatenate([q, dx, dq], axis=1)).all(axis=1)
        if not known.any():
            raise ValueError("no frame without a missing value")
        return cls(q[known], chain.jacobian(q[known]), dx[known], dq[known], chain.names)

    def __getitem__(self, rows: slice) -> Frames:
        return Frames(self.q[rows], self.jacobian[rows], self.dx[rows], self.dq[rows], self.names)


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """A method with its parameter, and how well it fits."""

    method: Method
    parameter: Array
    """(p,)"""
    rms_rad_s: float
    """The root mean square of the residuals."""
    explained: float
    """As `explained_by`, of the frames that it was fitted to."""
    alpha: float
    """The factor on the rates with which they would explain the most of those."""
    note: str
    """Where a parameter lies at the edge of its range."""


Fit = Callable[[Frames], ParameterFit]


def fits(costs: Sequence[Cost] = (), pull: float = 0.0) -> dict[str, Fit]:
    """By method with a parameter that can be fitted, and least norm for comparison.

    Of the transpose its alpha, 1/m^2; of gradient projection, with k = 1, coefficients of the costs, or without costs a
    constant g (n,), of several solutions the smallest; diag W, positive with mean 1, for pull see `PULL`; lambda,
    metres; gamma_max, rad, for `INTERVAL_S`.
    """

    def projection(c: Array) -> Method:
        return GradientProjection(weighted_sum(costs, c.tolist()) if len(costs) else lambda _: c, k=1.0)

    return {
        "least-norm": lambda frames: _fitted(LeastNorm(), np.empty(0), frames),
        "transpose": lambda frames: _linear(lambda c: JacobianTranspose(float(c[0])), 1, frames),
        "gradient-projection": lambda frames: _linear(projection, len(costs) or frames.q.shape[1], frames),
        "weighted": lambda frames: _weights(frames, pull),
        "damped": lambda frames: _in_range(damped_least_squares, ("lambda", "m"), frames),
        "selectively-damped": lambda frames: _in_range(SelectivelyDamped, ("gamma_max", "rad"), frames),
    }


def rates_of(method: Method, frames: Frames) -> Array:
    """(T, n): what the method's formula gives."""
    given = zip(frames.jacobian, frames.dx, frames.q, strict=True)
    return np.array([method.formula(J, dx, q) for J, dx, q in given])


def explained_by(rates: Array, dq: Array) -> float:
    """The share of sum dq^2 that rates (T, n) explain, 1 - sum |dq - rates|^2 / sum dq^2."""
    total = float(np.sum(dq**2))
    return 1 - float(np.sum((dq - rates) ** 2)) / total if total > 0 else float("nan")


def _weights(frames: Frames, pull: float) -> ParameterFit:
    dq = frames.dq
    n, bound = dq.shape[1], np.log(WEIGHT_RANGE)
    held = pull * float(np.sqrt(np.sum(dq**2))) * np.eye(n)

    def residuals(p: Array) -> Array:
        return np.concatenate([(rates_of(weighted_least_norm(np.exp(p)), frames) - dq).ravel(), held @ p])

    def derivatives(p: Array) -> Array:
        rates = rates_of(weighted_least_norm(np.exp(p)), frames)
        inverse = np.array([right_inverse(J, J / np.exp(p))[0] for J in frames.jacobian])
        change = (inverse @ frames.jacobian - np.eye(n)) * rates[:, None, :]
        return np.concatenate([change.reshape(-1, n), held])

    p = least_squares(residuals, np.zeros(n), derivatives, bounds=(-bound, bound), x_scale=1.0).x
    w = np.exp(p) / np.exp(p).mean()
    edge = np.flatnonzero(np.abs(p) > 0.99 * bound)
    note = f"weights of {', '.join(frames.names[j] for j in edge)} at the edge of their range" if len(edge) else ""
    return _fitted(weighted_least_norm(w), w, frames, note)


def _linear(method: Callable[[Array], Method], n: int, frames: Frames) -> ParameterFit:
    """A fit of n coefficients on which the rates depend linearly."""
    base = rates_of(method(np.zeros(n)), frames)
    columns = np.array([(rates_of(method(one), frames) - base).ravel() for one in np.eye(n)])
    c = np.array(np.linalg.lstsq(columns.T, (frames.dq - base).ravel())[0], float)
    return _fitted(method(c), c, frames)


def _in_range(method: Callable[[float], Method], called: tuple[str, str], frames: Frames) -> ParameterFit:
    """The parameter within `RANGE` whose rates are nearest to the frames': the best of a logarithmic grid, refined."""

    def cost(log_value: float) -> float:
        return float(np.sum((rates_of(method(float(np.exp(log_value))), frames) - frames.dq) ** 2))

    grid = np.linspace(np.log(RANGE[0]), np.log(RANGE[1]), 61)
    i = int(np.argmin([cost(x) for x in grid]))
    around = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
    refined = float(minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-8}).x)
    value = float(np.exp(refined if cost(refined) < cost(grid[i]) else grid[i]))
    (low, high), (name, unit), note = RANGE, called, ""
    if i in (0, len(grid) - 1):
        note = f"{name} at the edge of {low:g} to {high:g} {unit}"
    elif np.array_equal(rates_of(method(value), frames), rates_of(method(high), frames)):
        note = f"nothing is damped, with this {name} or any from there to {high:g} {unit}"
    return _fitted(method(value), np.array([value]), frames, note)


def _fitted(method: Method, parameter: Array, frames: Frames, note: str = "") -> ParameterFit:
    rates, dq = rates_of(method, frames), frames.dq
    rms = float(np.sqrt(np.mean((dq - rates) ** 2)))
    return ParameterFit(method, parameter, rms, explained_by(rates, dq), best_scale(rates, dq), note)


# -- to a target, along a path, along the null space -------------------------------------------------------------------

TOLERANCE_M = 0.003
MAX_STEP_M = 0.02
"""Longest way of the end effector in one iteration."""
PATIENCE = 100
"""Iterations in which the distance has to shrink by `PROGRESS`."""
PROGRESS = 0.01
STILL_RAD = 1e-10
"""Rounding, no motion."""
_NULL_STEP_RAD = 0.3
"""Longest step along the null space."""
_TOLERANCE = 1e-10
"""On |G|, relative to 1 + |Hess g|."""
_MAX_ITERATIONS = 500
KINDS = ("minimum", "saddle", "maximum", "degenerate")


@dataclass(frozen=True, eq=False)
class Run:
    """What a chain did on its way to a target or along a path: K configurations, K - 1 steps."""

    q: Array
    """(K, n), rad."""
    dq: Array
    """(K, n), rad/s: the rates with which each configuration is left. The last ones are 0 at a target, those with which
    a closed path begins anew, or those with which an open one ends."""
    interval_s: float
    """From one configuration to the next."""
    end_m: Array
    """(K, dim)"""
    aim_m: Array
    """The target (dim,), or the points of the path (K, dim)."""
    manipulability: Array
    """(K,): sqrt(det J J')."""
    singular: Bools
    """(K - 1,): whether the step was damped at a singular configuration."""
    solve_s: Array
    """(K - 1,): computing time of each step."""
    limits: dict[str, str]
    """By joint that a limit stopped, in their order: which limit, and in which step the first time."""
    closed: bool
    """Whether it was along a closed path."""
    note: str
    """What kept it from a target, "unreachable: ...", "singular: ...", "limits: ..." or "no progress: ..."; along a
    path the first thing that went wrong, with its step. Empty where nothing did."""

    @property
    def driven(self) -> bool:
        """Whether it was to a target."""
        return self.aim_m.ndim == 1

    @property
    def distance_m(self) -> Array:
        """How far the end effector is from the target, or from the path, shape (K,)."""
        return np.linalg.norm(self.aim_m - self.end_m, axis=1)

    @property
    def reached(self) -> bool:
        return not self.note

    @property
    def reason(self) -> str:
        """Why a way to a target ended."""
        return self.note or "reached"

    @property
    def time_s(self) -> Array:
        """The times of the K steps from the start, shape (K,)."""
        return np.asarray(self.interval_s * np.arange(len(self.q)), float)

    @cached_property
    def control(self) -> tuple[Array, Array]:
        """Rates and accelerations (K, n) as a controller takes them: those of the parabola through a sample and its
        neighbours. The way along a closed path comes from where its last step came from, any other starts at rest."""
        q, interval_s = self.q, self.interval_s
        before = q[0] - (q[-1] - q[-2]) if self.closed else q[0]
        known = np.vstack([before, q, q[-1] + interval_s * self.dq[-1]])
        return (known[2:] - known[:-2]) / (2 * interval_s), (known[2:] - 2 * q + known[:-2]) / interval_s**2

    @property
    def iterations(self) -> int:
        return len(self.q) - 1

    @property
    def length_m(self) -> float:
        """The length of the end effector's path."""
        return float(np.linalg.norm(np.diff(self.end_m, axis=0), axis=1).sum())

    @property
    def roughness_rad2(self) -> float:
        """Mean over the inner configurations of |q_{k+1} - 2 q_k + q_{k-1}|^2: 0 is smoothest."""
        return float(np.mean(np.sum(np.diff(self.q, 2, axis=0) ** 2, axis=1))) if len(self.q) > 2 else 0.0

    def closures(self) -> dict[str, Array]:
        """Degrees of closure in percent of each joint (n,), from the first configuration to the last: of its "angle",
        and of its path in the (angle, rate) "plane". NaN for a joint that does not move."""
        planes = [np.column_stack(path) for path in zip(self.q.T, self.dq.T, strict=True)]
        return {
            "angle": np.array([degree_of_closure(plane[:, 0]) for plane in planes]),
            "plane": np.array([degree_of_closure(plane) for plane in planes]),
        }

    def measures(self) -> dict[str, Any]:
        """The figures of the run for the tables."""
        if self.driven:
            found = {"reached": self.reached, "reason": self.reason, "iterations": self.iterations}
        else:
            found = {"worst_error_m": float(self.distance_m.max()), "note": self.note}
        return found | {
            "us_per_step": 1e6 * float(np.median(self.solve_s)) if len(self.solve_s) else None,
            "length_m": self.length_m,
            "roughness_rad2": self.roughness_rad2,
            "least_manipulability": float(self.manipulability.min()),
            "limits_hit": list(self.limits),
            "first_limit": next(iter(self.limits.values()), ""),
        }


def control_columns(names: Sequence[str]) -> list[str]:
    """What the rates and accelerations of joints are called in tables."""
    return [f"{name}_{what}" for what in ("rate_rad_s", "acceleration_rad_s2") for name in names]


def drive_to(
    chain: SerialChain,
    q0: ArrayLike,
    target_m: ArrayLike,
    method: Method,
    tolerance_m: float = TOLERANCE_M,
    max_iterations: int = 2000,
    interval_s: float = INTERVAL_S,
) -> Run:
    """Drives the end effector from q0 (n,) to a target (dim,). What goes wrong is the run's note.

    The extended Jacobian goes to G = 0 first; those configurations are not part of the path.
    """
    q, target = chain.inside_limits(np.asarray(q0, float)), np.asarray(target_m, float)
    note = unreachable(chain, target, tolerance_m)
    if not np.isfinite(q).all():
        q, note = np.zeros(chain.n), "no progress: the start is not finite"
    if not note and isinstance(method, ExtendedJacobian):
        q = to_null_space_optimum(chain, q, method.cost)[0]
    best, best_at = np.inf, 0

    def ask(k: int, end: Array, last: JointRates, stopped: list[int]) -> Array | str:
        nonlocal best, best_at
        distance = float(np.linalg.norm(target - end))
        if note or distance <= tolerance_m:
            return note
        if distance < (1 - PROGRESS) * best:
            best, best_at = distance, k
        if k >= max_iterations or k - best_at >= PATIENCE or (k and float(np.abs(last.dq).max()) <= STILL_RAD):
            left = f"{1000 * distance:.1f} mm left after {k} iterations"
            if stopped:
                return f"limits: joints {_listed(chain, stopped)} at theirs, {left}"
            if last.singular:
                return f"{last.note}, {left}"
            return f"no progress: {left}" + (", the most that are allowed" if k >= max_iterations else "")
        return (target - end) * (min(1.0, MAX_STEP_M / distance) / interval_s)

    return _moved(chain, q, target, ask, lambda _: method, interval_s)


def follow(
    chain: SerialChain,
    q0: ArrayLike,
    path_m: Array,
    method: Method | Callable[[int], Method],
    turns: int = 1,
    interval_s: float = INTERVAL_S,
) -> Run:
    """Follows a path (K, dim), whose points are an interval apart, from q0 (n,), whose end effector is at its start.

    Each step goes from where the end effector is to the next point, and the extended Jacobian (full) keeps G. method:
    one for all steps, or a function of the step's number. turns: a closed path (last point = first) again and again.
    Raises ValueError for a path that is not one.
    """
    path = np.asarray(path_m, float)
    if path.ndim != 2 or len(path) < 2 or path.shape[1] != chain.dim or not np.isfinite(path).all():
        raise ValueError(f"a finite path (K, {chain.dim}) of two points or more expected, got {path.shape}")
    closed = bool(np.allclose(path[0], path[-1], rtol=0, atol=1e-9))
    if turns > 1 and not closed:
        raise ValueError("only a closed path can be followed more than once")
    points = np.concatenate([path[:1], *[path[1:]] * turns])
    note = ""

    def of_step(k: int) -> Method:
        return method if isinstance(method, Method) else method(k)

    def ask(k: int, end: Array, last: JointRates, stopped: list[int]) -> Array | str:
        nonlocal note
        if not note and last.note:
            note = f"{last.note} (step {k - 1})"
        return note if k == len(points) - 1 else (points[k + 1] - end) / interval_s

    run = _moved(chain, chain.inside_limits(np.asarray(q0, float)), points, ask, of_step, interval_s)
    again = path[1] - path[0] if closed else path[-1] - path[-2]
    last = _one_interval(chain, run.q[-1], again / interval_s, of_step(run.iterations), interval_s)[0].dq
    return replace(run, dq=np.vstack([run.dq[:-1], last]), closed=closed)


def _moved(
    chain: SerialChain,
    q: Array,
    aim_m: Array,
    ask: Callable[[int, Array, JointRates, list[int]], Array | str],
    method: Callable[[int], Method],
    interval_s: float,
) -> Run:
    """From q (n,) on, an interval after the other, at the velocity (dim,) that ask(k, end, last rates, joints stopped)
    wants in step k, until it gives the run's note in its place."""
    path, ends, limits = [q], [chain.end(q)], {}
    steps: list[JointRates] = []
    times: list[float] = []
    last, stopped = JointRates(np.zeros(chain.n)), []
    while not isinstance(dx := ask(len(steps), ends[-1], last, stopped), str):
        started = time.perf_counter()
        last, q, stopped = _one_interval(chain, q, dx, method(len(steps)), interval_s)
        times.append(time.perf_counter() - started)
        for joint in stopped:
            low, high = float(chain.lower_rad[joint]), float(chain.upper_rad[joint])
            side, limit = ("upper", high) if 2 * float(q[joint]) > low + high else ("lower", low)
            name = chain.names[joint]
            limits.setdefault(name, f"{name} at its {side} limit of {limit:.2f} rad (step {len(steps)})")
        steps.append(last)
        path.append(q)
        ends.append(chain.end(q))
    return Run(
        q=np.array(path),
        dq=np.array([*(step.dq for step in steps), np.zeros(chain.n)]),
        interval_s=interval_s,
        end_m=np.array(ends),
        aim_m=aim_m,
        manipulability=manipulability(chain.jacobian(np.array(path))),
        singular=np.array([step.singular for step in steps], bool),
        solve_s=np.array(times),
        limits=limits,
        closed=False,
        note=dx,
    )


def degree_of_closure(path: Array) -> float:
    """D = 100 (1 - d / d_max) in percent: d from start to end, d_max the path's diameter; NaN if it does not move.

    path: an angle (K,), or (angle, rate) (K, 2), whose axes are divided by their ranges. An angle that stays within
    `STILL_RAD` does not move.
    """
    if np.ptp(path if path.ndim == 1 else path[:, 0]) <= STILL_RAD:
        return math.nan
    return phase.degree_of_closure(path[:, None] if path.ndim == 1 else phase.scaled(path))


def _one_interval(
    chain: SerialChain, q: Array, dx: Array, method: Method, interval_s: float
) -> tuple[JointRates, Array, list[int]]:
    """One interval: the step, where it leads, and the joints that a limit stopped. The extended Jacobian has the gain
    that keeps it at G = 0."""
    if isinstance(method, ExtendedJacobian) and method.full and not method.gain_per_s:
        method = replace(method, gain_per_s=1 / interval_s)
    free = np.ones(chain.n, bool)
    while True:
        step = method.rates(chain, q, dx, ALL if free.all() else free)
        moved = q + interval_s * step.dq
        outside = chain.inside_limits(moved) != moved
        if not outside.any():
            return step, moved, (~free).nonzero()[0].tolist()
        free &= ~outside
        if not free.any():
            return JointRates(np.zeros(chain.n), step.singular, step.note), q, [*range(chain.n)]


def _listed(chain: SerialChain, joints: Iterable[int]) -> str:
    return ", ".join(chain.names[joint] for joint in joints)


# -- along the null space --------------------------------------------------------------------------------------------


def to_null_space_optimum(chain: SerialChain, q0: ArrayLike, cost: Cost) -> tuple[Array, str]:
    """Moves along the null space of J to G = N' grad g = 0 and keeps the end effector where it is at q0 (n,): q (n,),
    and what it is of the cost, "minimum", "saddle", "maximum" or "degenerate", or what kept it from there.

    Newton steps on N' M N (see `ExtendedJacobian`), with the eigenvalues' magnitudes and a line search, down to a
    minimum; where that finds none, plain ones to the stationary point nearby, which can be a saddle. Limits hold; a
    joint at one is taken out.
    """
    q0 = chain.inside_limits(np.asarray(q0, float))
    found = _null_space_newton(chain, q0, cost, descend=True)
    if found[1] in KINDS:
        return found
    other = _null_space_newton(chain, q0, cost, descend=False)
    return other if other[1] in KINDS else found


def _null_space_newton(chain: SerialChain, q0: Array, cost: Cost, descend: bool) -> tuple[Array, str]:
    home, q, stuck = chain.end(q0), q0, np.zeros(chain.n, bool)
    for _ in range(_MAX_ITERATIONS):
        free = ~stuck
        J, curvature = chain.derivatives(q)
        J = J[:, free]
        if J.shape[1] <= chain.dim:
            return q, f"limits: joints {_listed(chain, stuck.nonzero()[0].tolist())}"
        N = null_basis(J)
        g, M = reduced_gradient(cost, q, right_inverse(J)[0], curvature, free)
        G = N.T @ g
        gradient = float(np.linalg.norm(G))
        if not (np.isfinite(gradient) and np.isfinite(M).all()):
            return q, "no progress: the cost's derivatives are not finite"
        values, vectors = np.linalg.eigh(N.T @ M @ N)
        if gradient <= _TOLERANCE * (1 + float(np.abs(M).max())):
            if np.abs(values).min() <= 1e-8 * np.abs(values).max():
                return q, "degenerate"
            return q, "minimum" if values[0] > 0 else "maximum" if values[-1] < 0 else "saddle"
        floor = 1e-8 * float(np.abs(values).max()) + 1e-300
        size = np.maximum(np.abs(values), floor)
        parts = (vectors.T @ G) / (size if descend else np.where(values < 0, -size, size))
        step = np.zeros(chain.n)
        step[free] = -N @ (vectors @ parts)
        step *= min(1.0, _NULL_STEP_RAD / max(float(np.linalg.norm(step)), 1e-300))
        moved, here, share = q, cost.value(q), 1.0
        for _ in range(30):
            moved = _back_home(chain, q + share * step, home, free)
            if moved is not None and (not descend or cost.value(moved) <= here + 1e-14 * (1 + abs(here))):
                break
            share /= 2
        else:
            return q, "singular: no step along the null space keeps the end effector and lowers the cost"
        assert moved is not None
        inside = chain.inside_limits(moved)
        outside = (inside != moved) & free
        if outside.any():
            # The joint stays where it is, which is within its limits, and the others go on.
            stuck = stuck | outside
            continue
        q = moved
    return q, "no progress: out of iterations"


def _back_home(chain: SerialChain, q: Array, home: Array, free: Bools) -> Array | None:
    """q with the end effector back at home, by least-norm steps; None if they do not lead there."""
    for _ in range(12):
        miss = home - chain.end(q)
        if float(np.linalg.norm(miss)) <= 1e-13:
            return q
        q = q + LeastNorm().rates(chain, q, miss, free).dq
    return q if float(np.linalg.norm(home - chain.end(q))) <= 1e-9 else None
