"""Parameters of the methods from given joint rates, by least squares: sum |dq - rates(q, dx)|^2 over T frames.

q (T, n), rad; dx (T, dim), m/s; dq (T, n), rad/s; frames with a NaN do not count. The rates are those of the formulas,
without limits. To make the parameters identifiable, diag W has mean 1, and of the motion along the null space k = 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from recon.arrays import Array
from recon.ik.chain import SerialChain
from recon.ik.costs import Cost
from recon.ik.methods import (
    INTERVAL_S,
    LOST,
    DampedLeastSquares,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    Method,
    SelectivelyDamped,
    WeightedLeastNorm,
)

DAMPING_M = (1e-4, 1e2)
"""Range of lambda: beyond, it makes no difference, or no motion."""
GAMMA_RAD = (1e-4, 1e2)
"""Range of gamma_max."""
WEIGHT_RANGE = 1e3
"""Greatest ratio of a weight to the one it starts from."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A method with its parameter, and how well it fits."""

    method: Method
    parameter: Array
    """As an array."""
    rms_rad_s: float
    """Of the residuals."""
    explained: float
    """The share of sum dq^2 that the rates explain, 1 - sum r^2 / sum dq^2."""
    note: str = ""
    """Where a parameter lies at the edge of its range."""


@dataclass(frozen=True, eq=False)
class SumOfCosts:
    """The gradient sum_i c_i grad g_i, or with no costs the constant vector c (n,)."""

    coefficients: Array
    costs: tuple[Cost, ...] = ()

    def __call__(self, q: Array) -> Array:
        if not self.costs:
            return self.coefficients
        return self.coefficients @ np.array([cost.gradient(q) for cost in self.costs])


def fit_least_norm(chain: SerialChain, q: Array, dx: Array, dq: Array) -> Fitted:
    """Nothing to fit: for comparison."""
    _, J, dx, dq = _frames(chain, q, dx, dq)
    return _fitted(LeastNorm(), np.empty(0), _weighted(J, np.ones(chain.n), dx), dq)


def fit_damped(chain: SerialChain, q: Array, dx: Array, dq: Array) -> Fitted:
    """lambda, metres: the best of a logarithmic grid, refined."""
    _, J, dx, dq = _frames(chain, q, dx, dq)

    def rates(log_damping: float) -> Array:
        gram = J @ J.transpose(0, 2, 1) + np.exp(2 * log_damping) * np.eye(chain.dim)
        return np.einsum("tdn,td->tn", J, np.linalg.solve(gram, dx[..., None])[..., 0])

    best, edge = _best_log(rates, dq, DAMPING_M)
    note = f"lambda at the edge of {DAMPING_M[0]:g} to {DAMPING_M[1]:g} m" if edge else ""
    value = float(np.exp(best))
    return _fitted(DampedLeastSquares(value), np.array([value]), rates(best), dq, note)


def fit_selectively_damped(chain: SerialChain, q: Array, dx: Array, dq: Array) -> Fitted:
    """gamma_max, rad, for `INTERVAL_S`: the best of a logarithmic grid, refined. Above some value nothing is damped."""
    _, J, dx, dq = _frames(chain, q, dx, dq)
    u, s, vt = np.linalg.svd(J, full_matrices=False)
    kept = s > LOST * s[:, :1]
    value = np.where(kept, s, 1.0)
    turns = (kept * np.einsum("tdi,td->ti", u, dx) / value)[..., None] * vt
    sways = np.einsum("tin,tn->ti", np.abs(vt), np.linalg.norm(J, axis=1))
    room = np.minimum(1.0, np.divide(s, sways, out=np.ones_like(s), where=sways > 0))

    def rates(log_gamma: float) -> Array:
        limit = np.exp(log_gamma) / INTERVAL_S
        return _clamped(_clamped(turns, room * limit).sum(axis=1), np.full(len(dq), limit))

    best, _ = _best_log(rates, dq, GAMMA_RAD)
    free = np.array_equal(rates(best), rates(np.log(GAMMA_RAD[1])))
    gamma = float(np.exp(best))
    note = f"nothing is damped, with this gamma_max or any from there to {GAMMA_RAD[1]:g} rad" if free else ""
    return _fitted(SelectivelyDamped(gamma, INTERVAL_S), np.array([gamma]), rates(best), dq, note)


def fit_weights(chain: SerialChain, q: Array, dx: Array, dq: Array) -> Fitted:
    """diag W (n,), positive with mean 1."""
    _, J, dx, dq = _frames(chain, q, dx, dq)

    def weights(p: Array) -> Array:
        w = np.exp(p)
        return w / w.mean()

    bound = np.log(WEIGHT_RANGE)
    found = least_squares(
        lambda p: (_weighted(J, weights(p), dx) - dq).ravel(), np.zeros(chain.n), bounds=(-bound, bound), x_scale=1.0
    )
    w = weights(found.x)
    edge = np.flatnonzero(np.abs(found.x) > 0.99 * bound)
    note = f"weights of joints {', '.join(map(str, edge))} at the edge of their range" if len(edge) else ""
    return _fitted(WeightedLeastNorm(w), w, _weighted(J, w, dx), dq, note)


def fit_gradient(chain: SerialChain, q: Array, dx: Array, dq: Array, costs: Sequence[Cost] = ()) -> Fitted:
    """Coefficients c of g = sum_i c_i grad g_i, or without costs of a constant g (n,), with k = 1: dq = J+ dx + P g, P
    the projection on the null space. Linear; of several solutions the smallest."""
    q, J, dx, dq = _frames(chain, q, dx, dq)
    pseudo = np.linalg.pinv(J)
    P = np.eye(chain.n) - pseudo @ J
    least = np.einsum("tnd,td->tn", pseudo, dx)
    basis = np.stack([np.stack([c.gradient(x) for c in costs], axis=1) for x in q]) if costs else np.eye(chain.n)
    A = P @ basis
    c = np.linalg.lstsq(A.reshape(-1, A.shape[-1]), (dq - least).ravel())[0]
    return _fitted(GradientProjection(SumOfCosts(c, tuple(costs)), k=1.0), c, least + A @ c, dq)


def fit_transpose(chain: SerialChain, q: Array, dx: Array, dq: Array) -> Fitted:
    """alpha, 1/m^2."""
    _, J, dx, dq = _frames(chain, q, dx, dq)
    turned = np.einsum("tdn,td->tn", J, dx)
    square = float(np.sum(turned**2))
    alpha = float(np.sum(turned * dq)) / square if square > 0 else 0.0
    return _fitted(JacobianTranspose(alpha), np.array([alpha]), alpha * turned, dq)


def _frames(chain: SerialChain, q: Array, dx: Array, dq: Array) -> tuple[Array, Array, Array, Array]:
    """q, J (T, dim, n), dx and dq of the frames without a NaN. Raises ValueError for other shapes, or no frame."""
    T = len(q)
    if q.shape != (T, chain.n) or dq.shape != q.shape or dx.shape != (T, chain.dim):
        raise ValueError(
            f"q and dq (T, {chain.n}), dx (T, {chain.dim}) expected, got {q.shape}, {dq.shape}, {dx.shape}"
        )
    known = np.isfinite(np.concatenate([q, dx, dq], axis=1)).all(axis=1)
    if not known.any():
        raise ValueError("no frame without a missing value")
    q, dx, dq = q[known], dx[known], dq[known]
    return q, np.stack([chain.jacobian(x) for x in q]), dx, dq


def _best_log(rates: Callable[[float], Array], dq: Array, bounds: tuple[float, float]) -> tuple[float, bool]:
    """The logarithm of a parameter within bounds whose rates (T, n) are nearest to dq, and whether it is at an edge."""

    def cost(log_value: float) -> float:
        return float(np.sum((rates(log_value) - dq) ** 2))

    grid = np.linspace(np.log(bounds[0]), np.log(bounds[1]), 61)
    i = int(np.argmin([cost(x) for x in grid]))
    around = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
    refined = float(minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-8}).x)
    return refined if cost(refined) < cost(grid[i]) else float(grid[i]), i in (0, len(grid) - 1)


def _clamped(values: Array, limit: Array) -> Array:
    """Scaled down, along the last axis, to a largest magnitude of `limit`, whose shape lacks that axis."""
    largest = np.abs(values).max(axis=-1)
    return values * np.divide(limit, largest, out=np.ones_like(largest), where=largest > limit)[..., None]


def _weighted(J: Array, weights: Array, dx: Array) -> Array:
    """W^-1 J' (J W^-1 J')^-1 dx (T, n), with the pseudo-inverse where J is singular."""
    root = 1 / np.sqrt(weights)
    return root * np.einsum("tnd,td->tn", np.linalg.pinv(J * root), dx)


def _fitted(method: Method, parameter: Array, rates: Array, dq: Array, note: str = "") -> Fitted:
    residual, total = float(np.sum((dq - rates) ** 2)), float(np.sum(dq**2))
    rms = float(np.sqrt(residual / dq.size))
    return Fitted(method, parameter, rms, 1 - residual / total if total > 0 else float("nan"), note)
