"""Define costs on the joint angles of redundant chains, with their gradients and Hessians.

The costs come from C. van der Leek's thesis (2022), except that each link has its own length in the rotational
energies, where the thesis prints r5 for all links.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from recon.base.arrays import Array
from recon.ik.chain import SerialChain


@dataclass(frozen=True, eq=False)
class Cost:
    """A cost on joint angles q (n,) in rad, with functions for its value, gradient and Hessian."""

    value: Callable[[Array], float]
    gradient: Callable[[Array], Array]
    """Function that returns the gradient of the cost at q, shape (n,)."""
    hessian: Callable[[Array], Array]
    """Function that returns the second derivatives of the cost at q, shape (n, n)."""


def quadratic(matrix: Array, about: Array | float = 0.0) -> Cost:
    """Return the cost (q - about)' H (q - about) / 2, with a constant symmetric H (n, n) and `about` (n,) or 0."""
    return Cost(
        lambda q: float((q - about) @ matrix @ (q - about)) / 2, lambda q: matrix @ (q - about), lambda _: matrix
    )


def joint_differences(chain: SerialChain) -> Cost:
    """Return the cost sum (q_{k+1} - q_k)^2 over consecutive joints, which favours an even bend.

    Thetas and phis are summed separately.
    """
    D = np.concatenate([np.diff(np.eye(chain.n)[[*group]], axis=0) for group in chain.groups])
    return quadratic(2 * D.T @ D)


def rotational_energy(chain: SerialChain) -> Cost:
    """Return the cost sum (r_k q_k)^2, m^2, with link lengths r_k, so that long links rotate least."""
    return quadratic(2 * np.diag(chain.joint_lengths_m**2))


def pose_distance(pose: Array) -> Cost:
    """Return the cost sum (q_k - p_k)^2, the squared distance from a pose p (n,), such as the animal's mean pose."""
    return quadratic(2 * np.eye(len(pose)), pose)


def weighted_sum(costs: Sequence[Cost], weights: Sequence[float]) -> Cost:
    """Return the weighted sum of costs, sum_i w_i g_i."""
    weighted = list(zip(weights, costs, strict=True))

    def value(q: Array) -> float:
        return sum(weight * cost.value(q) for weight, cost in weighted)

    def gradient(q: Array) -> Array:
        return np.sum([weight * cost.gradient(q) for weight, cost in weighted], axis=0)

    def hessian(q: Array) -> Array:
        return np.sum([weight * cost.hessian(q) for weight, cost in weighted], axis=0)

    return Cost(value, gradient, hessian)


def harmonic_map(a: float = 1.0, b: float = 0.0, joints: Sequence[int] = (2, 3, 4)) -> Cost:
    """Return the cost q2 (a q1 + b) sqrt(1 + q1^2) with q1 = q[i] - q[j], q2 = q[k] - q[j].

    `joints` are (i, j, k), by default theta_2, theta_3, theta_4 of the spine-front-leg chain. The Hessian of the cost
    has rank 2, and its stationary points are saddles, at which the extended Jacobian can be singular.
    """
    i, j, k = joints

    def parts(q: Array) -> tuple[float, float, float, float]:
        """Return q2, f, f' and f'' of f = (a q1 + b) sqrt(1 + q1^2)."""
        q1, q2 = float(q[i] - q[j]), float(q[k] - q[j])
        root, line = math.sqrt(1 + q1 * q1), a * q1 + b
        first = a * root + line * q1 / root
        second = (3 * a * q1 + b) / root - line * q1 * q1 / root**3
        return q2, line * root, first, second

    def differences(q: Array) -> Array:
        """Return the derivatives (2, n) of q1 and q2 with respect to q."""
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
    """Build a cost from any smooth function of q (n,), with derivatives from central differences of step_rad."""

    def slopes(f: Callable[[Array], Array | float], q: Array) -> Array:
        with np.errstate(invalid="ignore"):  # an infinite cost has no slope
            return np.array([np.subtract(f(q + e), f(q - e)) for e in step_rad * np.eye(len(q))]) / (2 * step_rad)

    def hessian(q: Array) -> Array:
        bent = slopes(lambda x: slopes(function, x), q)
        return (bent + bent.T) / 2

    return Cost(lambda q: float(function(q)), lambda q: slopes(function, q), hessian)
