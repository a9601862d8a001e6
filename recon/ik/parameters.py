"""Fit the parameters of the inverse-kinematics methods to given joint rates, by least squares over all frames.

The fit minimises the sum of |dq - rates|^2. The rates come from the methods' formulas, without limits. Two conventions
make the parameters identifiable: diag W has mean 1, and the motion along the null space has k = 1. Frames of several
chains of one kind can be joined, and a fit to some frames can be tested on others. A single frame gives the parameters
of its configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from recon.base.arrays import Array
from recon.ik.chain import SerialChain
from recon.ik.costs import Cost, weighted_sum
from recon.ik.methods import (
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    Method,
    SelectivelyDamped,
    SingularDirections,
    best_scale,
    damped_least_squares,
    right_inverse,
    weighted_least_norm,
)

SEARCH_RANGE = (1e-4, 1e2)
"""Range in which lambda (m) and gamma_max (rad) are searched.

Outside this range, the rates no longer change or are close to zero.
"""
WEIGHT_RANGE = 1e3
"""Largest factor by which a fitted weight can be above or below its starting value."""
EQUAL_WEIGHT_PULL = 0.01
"""Strength with which the weights of one configuration are drawn towards equal weights.

Without this pull, many sets of weights would explain a single configuration equally well. The value is the residual of
a weight that is e times the starting value, as a fraction of the norm of the rates.
"""
PARAMETERS = {
    "transpose": ("alpha_1_m2",),
    "gradient-projection": ("k_1_s",),
    "damped": ("lambda_m",),
    "selectively-damped": ("gamma_max_rad",),
}
"""Column of the parameter table for each method that has a single parameter."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Joint angles and velocities in T frames of a chain, or in the concatenated frames of several similar chains."""

    q: Array
    """Joint angles, shape (T, n), rad."""
    jacobian: Array
    """Jacobians of the end effector's position, shape (T, dim, n)."""
    dx: Array
    """Velocities of the end effector, shape (T, dim), m/s."""
    dq: Array
    """Rates of the joints, shape (T, n), rad/s."""
    names: tuple[str, ...]
    """Names of the n joints."""

    @classmethod
    def without_gaps(cls, chain: SerialChain, q: Array, dx: Array, dq: Array) -> Frames:
        """Collect the frames of a chain in which no angle or velocity is NaN.

        Raises
        ------
        ValueError
            If there are no such frames.
        """
        known = np.isfinite(np.concatenate([q, dx, dq], axis=1)).all(axis=1)
        if not known.any():
            raise ValueError("no frame without a missing value")
        return cls(q[known], chain.jacobian(q[known]), dx[known], dq[known], chain.names)

    def __getitem__(self, rows: slice) -> Frames:
        return Frames(self.q[rows], self.jacobian[rows], self.dx[rows], self.dq[rows], self.names)


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """A method with its fitted parameter and the quality of the fit."""

    method: Method
    parameter: Array
    """Fitted values of the method's p parameters, shape (p,)."""
    rms_rad_s: float
    """Root mean square of the residual joint rates, rad/s."""
    explained: float
    """Explained fraction of the squared rates (`explained_by`) in the frames of the fit."""
    alpha: float
    """Factor on the method's rates that maximises the explained fraction in the frames of the fit."""
    note: str
    """Sentence about a parameter at the edge of its range or without effect; empty otherwise."""


Fit = Callable[[Frames], ParameterFit]


def fits(costs: Sequence[Cost] = (), pull: float = 0.0) -> dict[str, Fit]:
    """Return a function for each method that fits its parameters, and one for least norm for comparison.

    The methods have these parameters:

    - transpose: alpha, 1/m^2
    - gradient-projection, with k = 1: coefficients of the costs, or the smallest constant g (n,) if there are none
    - weighted: diag W, positive, with a mean of 1; `pull` is the strength described at `EQUAL_WEIGHT_PULL`
    - damped: lambda, metres
    - selectively-damped: gamma_max in rad, for steps of `INTERVAL_S`
    """

    def projection(c: Array) -> Method:
        return GradientProjection(weighted_sum(costs, c.tolist()) if len(costs) else lambda _: c, k=1.0)

    return {
        "least-norm": lambda frames: _fitted(LeastNorm(), np.empty(0), frames),
        "transpose": lambda frames: _linear(lambda c: JacobianTranspose(float(c[0])), 1, frames),
        "gradient-projection": lambda frames: _linear(projection, len(costs) or frames.q.shape[1], frames),
        "weighted": lambda frames: _weights(frames, pull),
        "damped": lambda frames: _in_range(damped_least_squares, ("lambda", "m"), frames),
        "selectively-damped": lambda frames: _in_range(
            SelectivelyDamped, ("gamma_max", "rad"), frames, _selectively_damped(frames)
        ),
    }


def rates_of(method: Method, frames: Frames) -> Array:
    """Return the joint rates given by the formula of a method, shape (T, n), rad/s."""
    rows = zip(frames.jacobian, frames.dx, frames.q, strict=True)
    return np.array([method.formula(J, dx, q) for J, dx, q in rows])


def explained_by(rates: Array, dq: Array) -> float:
    """Return the fraction of sum dq^2 that the rates (T, n) explain, 1 - sum |dq - rates|^2 / sum dq^2."""
    total = float(np.sum(dq**2))
    return 1 - float(np.sum((dq - rates) ** 2)) / total if total > 0 else float("nan")


def _weights(frames: Frames, pull: float) -> ParameterFit:
    dq = frames.dq
    n, bound = dq.shape[1], np.log(WEIGHT_RANGE)
    pulls = pull * float(np.sqrt(np.sum(dq**2))) * np.eye(n)

    def residuals(p: Array) -> Array:
        return np.concatenate([(rates_of(weighted_least_norm(np.exp(p)), frames) - dq).ravel(), pulls @ p])

    def derivatives(p: Array) -> Array:
        rates = rates_of(weighted_least_norm(np.exp(p)), frames)
        inverse = np.array([right_inverse(J, J / np.exp(p))[0] for J in frames.jacobian])
        change = (inverse @ frames.jacobian - np.eye(n)) * rates[:, None, :]
        return np.concatenate([change.reshape(-1, n), pulls])

    p = least_squares(residuals, np.zeros(n), derivatives, bounds=(-bound, bound), x_scale=1.0).x
    w = np.exp(p) / np.exp(p).mean()
    edge = np.flatnonzero(np.abs(p) > 0.99 * bound)
    note = f"weights of {', '.join(frames.names[j] for j in edge)} at the edge of their range" if len(edge) else ""
    return _fitted(weighted_least_norm(w), w, frames, note)


def _linear(method: Callable[[Array], Method], n: int, frames: Frames) -> ParameterFit:
    """Fit the n coefficients of a method whose joint rates depend linearly on them."""
    base = rates_of(method(np.zeros(n)), frames)
    columns = np.array([(rates_of(method(unit), frames) - base).ravel() for unit in np.eye(n)])
    c = np.array(np.linalg.lstsq(columns.T, (frames.dq - base).ravel())[0], float)
    return _fitted(method(c), c, frames)


def _in_range(
    method: Callable[[float], Method],
    name_and_unit: tuple[str, str],
    frames: Frames,
    rates_with: Callable[[float], Array] | None = None,
) -> ParameterFit:
    """Fit a parameter within `SEARCH_RANGE` to the frames' rates: search a logarithmic grid, and refine the best value.

    `rates_with` returns the rates (T, n) for a value of the parameter; None to use the formula of the method.
    """
    rates_at = rates_with or (lambda value: rates_of(method(value), frames))

    def cost(log_value: float) -> float:
        return float(np.sum((rates_at(float(np.exp(log_value))) - frames.dq) ** 2))

    grid = np.linspace(np.log(SEARCH_RANGE[0]), np.log(SEARCH_RANGE[1]), 61)
    i = int(np.argmin([cost(x) for x in grid]))
    around = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
    refined = float(minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-8}).x)
    value = float(np.exp(refined if cost(refined) < cost(grid[i]) else grid[i]))
    (low, high), (name, unit), note = SEARCH_RANGE, name_and_unit, ""
    if i == 0 and name == "lambda":
        # Because dx is J dq, damping can only add to the error of the least-norm method.
        note = "lambda is 0, because damping only reduces the least-norm rates, which are too small already"
    elif i in (0, len(grid) - 1):
        note = f"{name} at the edge of {low:g} to {high:g} {unit}"
    elif np.array_equal(rates_at(value), rates_at(high)):
        note = f"{name} has no effect: no value between this one and {high:g} {unit} damps the rates"
    return _fitted(method(value), np.array([value]), frames, note)


def _selectively_damped(frames: Frames) -> Callable[[float], Array]:
    """Return a function from gamma_max to rates (T, n) that computes the singular directions only once."""
    by_frame = [SingularDirections.of_motion(J, dx) for J, dx in zip(frames.jacobian, frames.dx, strict=True)]
    directions = SingularDirections(*map(np.array, zip(*by_frame, strict=True)))
    return lambda gamma_max_rad: SelectivelyDamped(gamma_max_rad).damped(directions)


def _fitted(method: Method, parameter: Array, frames: Frames, note: str = "") -> ParameterFit:
    rates, dq = rates_of(method, frames), frames.dq
    rms = float(np.sqrt(np.mean((dq - rates) ** 2)))
    return ParameterFit(method, parameter, rms, explained_by(rates, dq), best_scale(rates, dq), note)
