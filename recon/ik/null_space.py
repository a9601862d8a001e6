"""Move a redundant chain to a stationary point of a cost, with the end effector fixed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from recon.base.arrays import Array, Bools
from recon.ik.chain import SerialChain, null_basis
from recon.ik.costs import Cost
from recon.ik.methods import LeastNorm, reduced_gradient, right_inverse

_NULL_STEP_RAD = 0.3
"""Longest step along the null space, rad."""
_TOLERANCE = 1e-10
"""Largest |G|, as a fraction of 1 + |Hess g|, at which a configuration counts as stationary."""
_MAX_ITERATIONS = 500
KINDS = ("minimum", "saddle", "maximum", "degenerate")


def joint_names(chain: SerialChain, joints: Iterable[int]) -> str:
    """Return the names of the joints with the given indices, separated by commas."""
    return ", ".join(chain.names[joint] for joint in joints)


def to_null_space_optimum(chain: SerialChain, q0: ArrayLike, cost: Cost) -> tuple[Array, str]:
    """Move along the null space of J from q0 (n,) to G = N' grad g = 0, with the end effector fixed.

    Newton steps on N' M N (see `ExtendedJacobian`), with the magnitudes of its eigenvalues and a line search, lead to a
    minimum. If they fail, plain Newton steps lead to the nearest stationary point, which can be a saddle. A joint at
    its limit is taken out of the chain.

    Returns
    -------
    tuple
        q (n,), rad, and the kind of the stationary point: "minimum", "saddle", "maximum" or "degenerate". If none was
        reached, the second value is the reason.
    """
    q0 = chain.inside_limits(np.asarray(q0, float))
    minimum = _null_space_newton(chain, q0, cost, descend=True)
    if minimum[1] in KINDS:
        return minimum
    stationary = _null_space_newton(chain, q0, cost, descend=False)
    return stationary if stationary[1] in KINDS else minimum


def _null_space_newton(chain: SerialChain, q0: Array, cost: Cost, descend: bool) -> tuple[Array, str]:
    home, q, stuck = chain.end(q0), q0, np.zeros(chain.n, bool)
    for _ in range(_MAX_ITERATIONS):
        free = ~stuck
        J, curvature = chain.derivatives(q)
        J = J[:, free]
        if J.shape[1] <= chain.dim:
            return q, f"limits: joints {joint_names(chain, stuck.nonzero()[0].tolist())}"
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
        moved, height, fraction = q, cost.value(q), 1.0
        for _ in range(30):
            moved = _return_to_position(chain, q + fraction * step, home, free)
            if moved is not None and (not descend or cost.value(moved) <= height + 1e-14 * (1 + abs(height))):
                break
            fraction /= 2
        else:
            return q, "singular: no step along the null space keeps the end effector and lowers the cost"
        assert moved is not None
        inside = chain.inside_limits(moved)
        outside = (inside != moved) & free
        if outside.any():
            # The joint keeps its value, which is within its limits, while the other joints move on.
            stuck = stuck | outside
            continue
        q = moved
    return q, "no progress: out of iterations"


def _return_to_position(chain: SerialChain, q: Array, home: Array, free: Bools) -> Array | None:
    """Return q after least-norm steps of the end effector back to `home` (dim,), or None if they do not reach it."""
    for _ in range(12):
        miss = home - chain.end(q)
        if float(np.linalg.norm(miss)) <= 1e-13:
            return q
        q = q + LeastNorm().rates(chain, q, miss, free).dq
    return q if float(np.linalg.norm(home - chain.end(q))) <= 1e-9 else None
