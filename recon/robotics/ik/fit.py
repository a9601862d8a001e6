"""Parameters of the methods from given joint rates, by least squares: sum |dq - rates|^2 over frames.

The rates are those of the formulas, without limits. To make the parameters identifiable, diag W has mean 1, and of the
motion along the null space k = 1. Frames of several chains of one kind can be joined, and what is fitted to some can be
held against others. One frame alone gives the parameters of one configuration (`fit_series`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from recon.base.arrays import Array
from recon.robotics.ik.chain import SerialChain
from recon.robotics.ik.costs import Cost, weighted_sum
from recon.robotics.ik.methods import (
    INTERVAL_S,
    LOST,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    Method,
    SelectivelyDamped,
    damped_least_squares,
    weighted_least_norm,
)

DAMPING_M = (1e-4, 1e2)
"""Range of lambda: beyond, it makes no difference, or no motion."""
GAMMA_RAD = (1e-4, 1e2)
"""Range of gamma_max."""
WEIGHT_RANGE = 1e3
"""Greatest ratio of a weight to the one it starts from."""
PULL = 0.01
"""Of the weights of one configuration towards even ones, which otherwise many explain: what a factor of e costs, as a
share of the rates."""


@dataclass(frozen=True, eq=False)
class Frames:
    """T frames of a chain, or of several of one kind."""

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
        """Those without a NaN. Raises ValueError for other shapes than those above, or no frame."""
        T = len(q)
        if q.shape != (T, chain.n) or dq.shape != q.shape or dx.shape != (T, chain.dim):
            raise ValueError(
                f"q and dq (T, {chain.n}), dx (T, {chain.dim}) expected, got {q.shape}, {dq.shape}, {dx.shape}"
            )
        known = np.isfinite(np.concatenate([q, dx, dq], axis=1)).all(axis=1)
        if not known.any():
            raise ValueError("no frame without a missing value")
        return cls(q[known], np.stack([chain.jacobian(x) for x in q[known]]), dx[known], dq[known], chain.names)

    @classmethod
    def joined(cls, parts: Sequence[Frames]) -> Frames:
        q, jacobian, dx, dq = (np.concatenate([getattr(p, of) for p in parts]) for of in ("q", "jacobian", "dx", "dq"))
        return cls(q, jacobian, dx, dq, parts[0].names)

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, rows: slice) -> Frames:
        return Frames(self.q[rows], self.jacobian[rows], self.dx[rows], self.dq[rows], self.names)


Formula = Callable[[Frames], Array]
"""The rates (T, n) that a method with its parameter gives."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A method with its parameter, and how well it fits."""

    method: Method
    parameter: Array
    """As an array."""
    formula: Formula
    rms_rad_s: float
    """Of the residuals."""
    explained: float
    """As `explained_by`, of the frames that it was fitted to."""
    alpha: float
    """The factor on the rates with which they would explain the most of those."""
    note: str = ""
    """Where a parameter lies at the edge of its range."""


Fit = Callable[[Frames], Fitted]


@dataclass(frozen=True, eq=False)
class FittedSeries:
    """A parameter of each of T configurations."""

    parameter: Array
    """(T, p)"""
    alpha: Array
    """(T,)"""
    explained: Array
    """(T,)"""


def explained_by(rates: Array, dq: Array) -> float:
    """The share of sum dq^2 that rates (T, n) explain, 1 - sum |dq - rates|^2 / sum dq^2."""
    total = float(np.sum(dq**2))
    return 1 - float(np.sum((dq - rates) ** 2)) / total if total > 0 else float("nan")


def best_scale(rates: Array, dq: Array) -> float:
    """The factor that brings rates (T, n) nearest to dq; 1 where there are none."""
    square = float(np.sum(rates**2))
    return float(np.sum(rates * dq)) / square if square > 0 else 1.0


def fit_series(fit: Fit, frames: Frames) -> FittedSeries:
    """Of each frame by itself."""
    found = [fit(frames[t : t + 1]) for t in range(len(frames))]
    return FittedSeries(
        np.array([f.parameter for f in found]),
        np.array([f.alpha for f in found]),
        np.array([f.explained for f in found]),
    )


def fit_least_norm(frames: Frames) -> Fitted:
    """Nothing to fit: for comparison."""
    weights = np.ones(frames.q.shape[1])
    return _fitted(LeastNorm(), np.empty(0), lambda f: _weighted(f, weights)[0], frames)


def fit_damped(frames: Frames) -> Fitted:
    """lambda, metres: the best of a logarithmic grid, refined."""

    def rates(frames: Frames, damping_m: float) -> Array:
        J = frames.jacobian
        gram = J @ J.transpose(0, 2, 1) + damping_m**2 * np.eye(J.shape[1])
        return np.einsum("tdn,td->tn", J, np.linalg.solve(gram, frames.dx[..., None])[..., 0])

    value, edge = _best(lambda damping_m: rates(frames, damping_m), frames.dq, DAMPING_M)
    note = f"lambda at the edge of {DAMPING_M[0]:g} to {DAMPING_M[1]:g} m" if edge else ""
    return _fitted(damped_least_squares(value), np.array([value]), lambda f: rates(f, value), frames, note)


def fit_selectively_damped(frames: Frames) -> Fitted:
    """gamma_max, rad, for `INTERVAL_S`: the best of a logarithmic grid, refined. Above some value nothing is damped."""
    turns, room = _singular_turns(frames)

    def rates(turns: Array, room: Array, gamma_rad: float) -> Array:
        limit = gamma_rad / INTERVAL_S
        return _clamped(_clamped(turns, room * limit).sum(axis=1), np.full(len(turns), limit))

    gamma, _ = _best(lambda gamma_rad: rates(turns, room, gamma_rad), frames.dq, GAMMA_RAD)
    free = np.array_equal(rates(turns, room, gamma), rates(turns, room, GAMMA_RAD[1]))
    note = f"nothing is damped, with this gamma_max or any from there to {GAMMA_RAD[1]:g} rad" if free else ""
    method = SelectivelyDamped(gamma, INTERVAL_S)
    return _fitted(method, np.array([gamma]), lambda f: rates(*_singular_turns(f), gamma), frames, note)


def fit_weights(frames: Frames, pull: float = 0.0) -> Fitted:
    """diag W (n,), positive with mean 1. pull: towards even weights, as `PULL`."""
    dq = frames.dq
    n, bound = dq.shape[1], np.log(WEIGHT_RANGE)
    held = pull * float(np.sqrt(np.sum(dq**2))) * np.eye(n)

    def residuals(p: Array) -> Array:
        return np.concatenate([(_weighted(frames, np.exp(p))[0] - dq).ravel(), held @ p])

    def derivatives(p: Array) -> Array:
        rates, inverse = _weighted(frames, np.exp(p))
        change = (inverse @ frames.jacobian - np.eye(n)) * rates[:, None, :]
        return np.concatenate([change.reshape(-1, n), held])

    p = least_squares(residuals, np.zeros(n), derivatives, bounds=(-bound, bound), x_scale=1.0).x
    w = np.exp(p) / np.exp(p).mean()
    edge = np.flatnonzero(np.abs(p) > 0.99 * bound)
    note = f"weights of {', '.join(frames.names[j] for j in edge)} at the edge of their range" if len(edge) else ""
    return _fitted(weighted_least_norm(w), w, lambda f: _weighted(f, w)[0], frames, note)


def fit_gradient(frames: Frames, costs: Sequence[Cost] = ()) -> Fitted:
    """Coefficients c of g = sum_i c_i grad g_i, or without costs of a constant g (n,), with k = 1: dq = J+ dx + P g, P
    the projection on the null space. Linear; of several solutions the smallest."""

    def parts(frames: Frames) -> tuple[Array, Array]:
        J, n = frames.jacobian, frames.q.shape[1]
        pseudo = np.linalg.pinv(J)
        gradients = [np.stack([cost.gradient(q) for cost in costs], axis=1) for q in frames.q] if costs else np.eye(n)
        P = np.eye(n) - pseudo @ J
        return np.einsum("tnd,td->tn", pseudo, frames.dx), P @ np.array(gradients)

    def rates(frames: Frames) -> Array:
        least, A = parts(frames)
        return least + A @ c

    least, A = parts(frames)
    c = np.array(np.linalg.lstsq(A.reshape(-1, A.shape[-1]), (frames.dq - least).ravel())[0], float)
    method = GradientProjection(weighted_sum(tuple(costs), tuple(c.tolist())) if costs else lambda _: c, k=1.0)
    return _fitted(method, c, rates, frames)


def fit_transpose(frames: Frames) -> Fitted:
    """alpha, 1/m^2."""

    def turned(frames: Frames) -> Array:
        return np.einsum("tdn,td->tn", frames.jacobian, frames.dx)

    square = np.sum(turned(frames) ** 2)
    alpha = best_scale(turned(frames), frames.dq) if square > 0 else 0.0
    return _fitted(JacobianTranspose(alpha), np.array([alpha]), lambda f: alpha * turned(f), frames)


def _best(rates: Callable[[float], Array], dq: Array, bounds: tuple[float, float]) -> tuple[float, bool]:
    """The parameter within bounds whose rates (T, n) are nearest to dq, on a logarithmic scale, and whether it is at an
    edge."""

    def cost(log_value: float) -> float:
        return float(np.sum((rates(float(np.exp(log_value))) - dq) ** 2))

    grid = np.linspace(np.log(bounds[0]), np.log(bounds[1]), 61)
    i = int(np.argmin([cost(x) for x in grid]))
    around = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
    refined = float(minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-8}).x)
    best = refined if cost(refined) < cost(grid[i]) else float(grid[i])
    return float(np.exp(best)), i in (0, len(grid) - 1)


def _singular_turns(frames: Frames) -> tuple[Array, Array]:
    """Of each singular direction (i) what it turns without damping (T, i, n), and its share (T, i) of gamma_max."""
    J = frames.jacobian
    u, s, vt = np.linalg.svd(J, full_matrices=False)
    kept = s > LOST * s[:, :1]
    value = np.where(kept, s, 1.0)
    turns = (kept * np.einsum("tdi,td->ti", u, frames.dx) / value)[..., None] * vt
    sways = np.einsum("tin,tn->ti", np.abs(vt), np.linalg.norm(J, axis=1))
    return turns, np.minimum(1.0, np.divide(s, sways, out=np.ones_like(s), where=sways > 0))


def _clamped(values: Array, limit: Array) -> Array:
    """Scaled down, along the last axis, to a largest magnitude of `limit`, whose shape lacks that axis."""
    largest = np.abs(values).max(axis=-1)
    return values * np.divide(limit, largest, out=np.ones_like(largest), where=largest > limit)[..., None]


def _weighted(frames: Frames, weights: Array) -> tuple[Array, Array]:
    """The rates A dx (T, n) and A = W^-1 J' (J W^-1 J')^-1 (T, n, dim), with the pseudo-inverse where J is singular."""
    root = 1 / np.sqrt(weights)
    inverse = root[:, None] * np.linalg.pinv(frames.jacobian * root)
    return np.einsum("tnd,td->tn", inverse, frames.dx), inverse


def _fitted(method: Method, parameter: Array, formula: Formula, frames: Frames, note: str = "") -> Fitted:
    rates, dq = formula(frames), frames.dq
    rms = float(np.sqrt(np.mean((dq - rates) ** 2)))
    return Fitted(method, parameter, formula, rms, explained_by(rates, dq), best_scale(rates, dq), note)
