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
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv
from scipy.optimize import least_squares, minimize_scalar

from recon.base.arrays import Array, Bools
from recon.wings.robotics.ik.chain import Curvature, SerialChain, null_basis

INTERVAL_S = 1 / 90
"""What one iteration of `recon.wings.robotics.ik.drive` takes."""
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
    H = np.zeros((chain.n, chain.n))
    for group in chain.groups:
        for i, j in pairwise(group):
            H[[i, j], [i, j]] += 2
            H[[i, j], [j, i]] -= 2
    return quadratic(H)


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

    def gradient(q: Array) -> Array:
        q2, f, first, _ = parts(q)
        out = np.zeros(len(q))
        out[i], out[j], out[k] = q2 * first, -q2 * first - f, f
        return out

    def hessian(q: Array) -> Array:
        q2, _, first, second = parts(q)
        c = q2 * second
        out = np.zeros((len(q), len(q)))
        out[np.ix_(joints, joints)] = (
            (c, -c - first, first),
            (-c - first, c + 2 * first, -first),
            (first, -first, 0.0),
        )
        return out

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

DAMPING_M = (1e-4, 1e2)
"""Range of lambda: beyond, it makes no difference, or no motion."""
GAMMA_RAD = (1e-4, 1e2)
"""Range of gamma_max."""
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
        "damped": lambda frames: _in_range(damped_least_squares, DAMPING_M, ("lambda", "m"), frames),
        "selectively-damped": lambda frames: _in_range(SelectivelyDamped, GAMMA_RAD, ("gamma_max", "rad"), frames),
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


def _in_range(
    method: Callable[[float], Method], bounds: tuple[float, float], called: tuple[str, str], frames: Frames
) -> ParameterFit:
    """The parameter within bounds whose rates are nearest to the frames': the best of a logarithmic grid, refined."""

    def cost(log_value: float) -> float:
        return float(np.sum((rates_of(method(float(np.exp(log_value))), frames) - frames.dq) ** 2))

    grid = np.linspace(np.log(bounds[0]), np.log(bounds[1]), 61)
    i = int(np.argmin([cost(x) for x in grid]))
    around = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
    refined = float(minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-8}).x)
    value = float(np.exp(refined if cost(refined) < cost(grid[i]) else grid[i]))
    (low, high), (name, unit), note = bounds, called, ""
    if i in (0, len(grid) - 1):
        note = f"{name} at the edge of {low:g} to {high:g} {unit}"
    elif np.array_equal(rates_of(method(value), frames), rates_of(method(high), frames)):
        note = f"nothing is damped, with this {name} or any from there to {high:g} {unit}"
    return _fitted(method(value), np.array([value]), frames, note)


def _fitted(method: Method, parameter: Array, frames: Frames, note: str = "") -> ParameterFit:
    rates, dq = rates_of(method, frames), frames.dq
    rms = float(np.sqrt(np.mean((dq - rates) ** 2)))
    return ParameterFit(method, parameter, rms, explained_by(rates, dq), best_scale(rates, dq), note)
