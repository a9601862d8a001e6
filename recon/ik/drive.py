"""Moving a chain: the end effector to a target or along a path, and the joints along the null space to an optimum.

One iteration is an interval of time: the end effector is sent to the next point at the velocity that gets it there
(which takes away the drift of the one before), no faster than `MAX_STEP_M` an interval, the method gives the rates, and
the joints move by rates times interval. Joints that would leave their limits stay where they are and are taken out of
the chain for that iteration. The extended Jacobian starts at G = 0, to which it is moved along the null space first,
and is kept there by a gain of 1 / interval.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.analysis import phase
from recon.ik.chain import SerialChain, manipulability, null_basis, unreachable
from recon.ik.costs import Cost
from recon.ik.methods import INTERVAL_S, ExtendedJacobian, LeastNorm, Method, Step, reduced_gradient

Array = NDArray[np.float64]

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


@dataclass(frozen=True, eq=False)
class Drive:
    """The way to a target; K = iterations + 1 configurations.

    reason: "reached", or what stopped it: "unreachable: ...", "singular: ...", "limits: ..." or "no progress: ...".
    q (K, n), rad; end_m (K, dim); distance_m (K,) to the target; manipulability (K,): sqrt(det J J'). singular
    (K - 1,): whether the step was damped at a singular configuration; solve_s (K - 1,): computing time of each step.
    length_m: of the end effector's path; roughness_rad2: mean over the inner configurations of
    |q_{k+1} - 2 q_k + q_{k-1}|^2, 0 is smoothest; limits_hit: the joints that were stopped by a limit.
    """

    reason: str
    q: Array
    end_m: Array
    distance_m: Array
    manipulability: Array
    singular: NDArray[np.bool_]
    solve_s: Array
    length_m: float
    roughness_rad2: float
    limits_hit: tuple[int, ...]

    @property
    def reached(self) -> bool:
        return self.reason == "reached"

    @property
    def iterations(self) -> int:
        return len(self.q) - 1


@dataclass(frozen=True, eq=False)
class Closures:
    """Degrees of closure in percent, (n,): of each joint's angle, and of its path in the (angle, rate) plane. NaN for a
    joint that does not move."""

    angle: Array
    plane: Array


@dataclass(frozen=True, eq=False)
class Follow:
    """Joints along a path of K points, turns times: N = turns (K - 1) + 1 configurations.

    q (N, n), rad; dq (N, n), rad/s: the method's at each configuration, at the last one for the velocity with which a
    closed path begins anew, or an open one ends; end_m (N, dim); error_m (N,) from the path; singular (N - 1,); note:
    the first thing that went wrong, with its step, or empty; limits_hit: the joints that were stopped by a limit.
    """

    q: Array
    dq: Array
    end_m: Array
    error_m: Array
    singular: NDArray[np.bool_]
    note: str
    limits_hit: tuple[int, ...]
    turns: int

    def closures(self) -> Closures:
        """Of each joint, from the start of the first turn to the end of the last."""
        joints = range(self.q.shape[1])
        return Closures(
            np.array([degree_of_closure(self.q[:, j]) for j in joints]),
            np.array([degree_of_closure(np.column_stack([self.q[:, j], self.dq[:, j]])) for j in joints]),
        )


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where the null space leads; K configurations q (K, n). reason: "reached", or what stopped it. gradient: |G| at
    the end; kind: "minimum", "saddle" or "maximum" of the cost with the end effector held, or "degenerate"."""

    reason: str
    q: Array
    gradient: float
    kind: str

    @property
    def reached(self) -> bool:
        return self.reason == "reached"


def drive_to(
    chain: SerialChain,
    q0: ArrayLike,
    target_m: ArrayLike,
    method: Method,
    tolerance_m: float = TOLERANCE_M,
    max_iterations: int = 2000,
    max_step_m: float = MAX_STEP_M,
    interval_s: float = INTERVAL_S,
    settle: bool = True,
) -> Drive:
    """Drives the end effector from q0 (n,) to a target (dim,). What goes wrong is a reason in the result.

    settle: with the extended Jacobian, go to G = 0 first (those configurations are not part of the path).
    """
    q, target = _inside(chain, np.asarray(q0, float)), np.asarray(target_m, float)
    reason = unreachable(chain, target, tolerance_m)
    if not np.isfinite(q).all():
        reason = "no progress: the start is not finite"
        q = np.zeros(chain.n)
    if not reason and isinstance(method, ExtendedJacobian) and settle:
        q = to_null_space_optimum(chain, q, method.cost).q[-1]
    method = _kept(method, interval_s)

    end = chain.end(q)
    distance = float(np.linalg.norm(target - end))
    path, ends, distances, singular, times, hit = [q], [end], [distance], [], [], set()
    best, best_at, last = distance, 0, Step(np.zeros(chain.n))
    stopped: tuple[int, ...] = ()
    while not reason and distance > tolerance_m:
        k = len(path) - 1
        if k >= max_iterations or k - best_at >= PATIENCE or (k and float(np.abs(last.dq).max()) <= STILL_RAD):
            reason = _why(k, max_iterations, distance, last, stopped)
            break
        started = time.perf_counter()
        dx = (target - end) * (min(1.0, max_step_m / distance) / interval_s)
        last, q, stopped = _move(chain, q, dx, method, interval_s)
        times.append(time.perf_counter() - started)
        hit.update(stopped)
        end = chain.end(q)
        distance = float(np.linalg.norm(target - end))
        if distance < (1 - PROGRESS) * best:
            best, best_at = distance, k + 1
        path.append(q)
        ends.append(end)
        distances.append(distance)
        singular.append(last.singular)
    joints, end_path = np.array(path), np.array(ends)
    return Drive(
        reason=reason or "reached",
        q=joints,
        end_m=end_path,
        distance_m=np.array(distances),
        manipulability=np.array([manipulability(chain.jacobian(x)) for x in path]),
        singular=np.array(singular, bool),
        solve_s=np.array(times),
        length_m=float(np.linalg.norm(np.diff(end_path, axis=0), axis=1).sum()),
        roughness_rad2=roughness(joints),
        limits_hit=tuple(sorted(hit)),
    )


def follow(
    chain: SerialChain,
    q0: ArrayLike,
    path_m: Array,
    method: Method,
    turns: int = 1,
    interval_s: float = INTERVAL_S,
    correct: bool = True,
) -> Follow:
    """Follows a path (K, dim), whose points are an interval apart, from q0 (n,), whose end effector is at its start.

    correct: each step goes from where the end effector is to the next point, and the extended Jacobian (full) keeps
    G; otherwise the velocities of the path alone are integrated. turns: a closed path (last point = first) again and
    again. Raises ValueError for a path that is not one.
    """
    path = np.asarray(path_m, float)
    if path.ndim != 2 or len(path) < 2 or path.shape[1] != chain.dim or not np.isfinite(path).all():
        raise ValueError(f"a finite path (K, {chain.dim}) of two points or more expected, got {path.shape}")
    closed = np.allclose(path[0], path[-1], rtol=0, atol=1e-9)
    if turns > 1 and not closed:
        raise ValueError("only a closed path can be followed more than once")
    points = np.concatenate([path[:1], *[path[1:]] * turns])
    if correct:
        method = _kept(method, interval_s)
    q = _inside(chain, np.asarray(q0, float))
    joints, rates, ends, singular, note, hit = [q], [], [chain.end(q)], [], "", set()
    for k in range(len(points) - 1):
        dx = (points[k + 1] - (ends[-1] if correct else points[k])) / interval_s
        step, q, stopped = _move(chain, q, dx, method, interval_s)
        if not note and step.note:
            note = f"{step.note} (step {k})"
        hit.update(stopped)
        joints.append(q)
        rates.append(step.dq)
        ends.append(chain.end(q))
        singular.append(step.singular)
    again = path[1] - path[0] if closed else path[-1] - path[-2]
    rates.append(_move(chain, q, again / interval_s, method, interval_s)[0].dq)
    end_m = np.array(ends)
    return Follow(
        q=np.array(joints),
        dq=np.array(rates),
        end_m=end_m,
        error_m=np.linalg.norm(end_m - points, axis=1),
        singular=np.array(singular, bool),
        note=note,
        limits_hit=tuple(sorted(hit)),
        turns=turns,
    )


def to_null_space_optimum(
    chain: SerialChain,
    q0: ArrayLike,
    cost: Cost,
    tolerance: float = 1e-10,
    max_iterations: int = 500,
    descend: bool = True,
) -> Optimum:
    """Moves along the null space of J to G = N' grad g = 0 and keeps the end effector where it is at q0 (n,).

    Newton steps on N' M N (see `ExtendedJacobian`). descend: with the eigenvalues' magnitudes and a line search, down
    to a minimum; otherwise, and where that finds none, plain ones to the stationary point nearby, which can be a
    saddle. tolerance: on |G|, relative to 1 + |Hess g|. Limits hold; a joint at one is taken out.
    """
    q0 = _inside(chain, np.asarray(q0, float))
    found = _null_space_newton(chain, q0, cost, tolerance, max_iterations, descend)
    if descend and not found.reached:
        other = _null_space_newton(chain, q0, cost, tolerance, max_iterations, False)
        return other if other.reached else found
    return found


def _null_space_newton(
    chain: SerialChain, q0: Array, cost: Cost, tolerance: float, max_iterations: int, descend: bool
) -> Optimum:
    home, path = chain.end(q0), [q0]
    q, stuck = q0, np.zeros(chain.n, bool)
    reason, gradient, values = "no progress: out of iterations", math.inf, np.zeros(0)
    for _ in range(max_iterations):
        free = ~stuck
        J = chain.jacobian(q)[:, free]
        if J.shape[1] <= chain.dim:
            reason = f"limits: joints {_listed(stuck.nonzero()[0])}"
            break
        N = null_basis(J)
        g, M = reduced_gradient(chain, cost, q, J, free)
        G = N.T @ g
        gradient = float(np.linalg.norm(G))
        if not (np.isfinite(gradient) and np.isfinite(M).all()):
            reason = "no progress: the cost's derivatives are not finite"
            break
        values, vectors = np.linalg.eigh(N.T @ M @ N)
        if gradient <= tolerance * (1 + float(np.abs(M).max())):
            reason = "reached"
            break
        floor = 1e-8 * float(np.abs(values).max()) + 1e-300
        size = np.maximum(np.abs(values), floor)
        parts = (vectors.T @ G) / (size if descend else np.where(values < 0, -size, size))
        step = np.zeros(chain.n)
        step[free] = -N @ (vectors @ parts)
        step *= min(1.0, _NULL_STEP_RAD / max(float(np.linalg.norm(step)), 1e-300))
        moved, here, share = q, cost.value(q), 1.0
        for _ in range(30):
            moved = _returned(chain, q + share * step, home, free)
            if moved is not None and (not descend or cost.value(moved) <= here + 1e-14 * (1 + abs(here))):
                break
            share /= 2
        else:
            reason = "singular: no step along the null space keeps the end effector and lowers the cost"
            break
        assert moved is not None
        inside = _inside(chain, moved)
        outside = (inside != moved) & free
        if outside.any():
            # The joint stays where it is, which is within its limits, and the others go on.
            stuck = stuck | outside
            continue
        q = moved
        path.append(q)
    kind = "degenerate"
    if len(values) and np.abs(values).min() > 1e-8 * np.abs(values).max():
        kind = "minimum" if values[0] > 0 else "maximum" if values[-1] < 0 else "saddle"
    return Optimum(reason, np.array(path), gradient, kind)


def _returned(chain: SerialChain, q: Array, home: Array, free: NDArray[np.bool_]) -> Array | None:
    """q with the end effector back at home, by least-norm steps; None if they do not lead there."""
    for _ in range(12):
        miss = home - chain.end(q)
        if float(np.linalg.norm(miss)) <= 1e-13:
            return q
        q = q + LeastNorm().rates(chain, q, miss, free).dq
    return q if float(np.linalg.norm(home - chain.end(q))) <= 1e-9 else None


def degree_of_closure(path: Array) -> float:
    """D = 100 (1 - d / d_max) in percent: d from start to end, d_max the path's diameter; NaN if it does not move.

    path: an angle (K,), or (angle, rate) (K, 2), whose axes are divided by their ranges. An angle that stays within
    `STILL_RAD` does not move.
    """
    if np.ptp(path if path.ndim == 1 else path[:, 0]) <= STILL_RAD:
        return math.nan
    return phase.degree_of_closure(path[:, None] if path.ndim == 1 else phase.scaled(path))


def roughness(q: Array) -> float:
    """Mean squared second difference of a path (K, n): mean over the inner points of |q_{k+1} - 2 q_k + q_{k-1}|^2."""
    return float(np.mean(np.sum(np.diff(q, 2, axis=0) ** 2, axis=1))) if len(q) > 2 else 0.0


def _move(
    chain: SerialChain, q: Array, dx: Array, method: Method, interval_s: float
) -> tuple[Step, Array, tuple[int, ...]]:
    """One interval: the step, where it leads, and the joints that a limit stopped."""
    step = method.rates(chain, q, dx)
    moved = q + interval_s * step.dq
    inside = _inside(chain, moved)
    if (inside == moved).all():
        return step, moved, ()
    free = np.ones(chain.n, bool)
    while not (inside == moved).all():
        outside = (inside != moved) & free
        free &= ~outside
        if not free.any():
            return Step(np.zeros(chain.n), step.singular, step.note), q, tuple(range(chain.n))
        step = method.rates(chain, q, dx, free)
        moved = q + interval_s * step.dq
        inside = _inside(chain, moved)
    return step, moved, tuple((~free).nonzero()[0].tolist())


def _inside(chain: SerialChain, q: Array) -> Array:
    return np.minimum(np.maximum(q, chain.lower_rad), chain.upper_rad)


def _kept(method: Method, interval_s: float) -> Method:
    """The extended Jacobian with the gain that keeps it at G = 0."""
    if isinstance(method, ExtendedJacobian) and method.full and not method.gain_per_s:
        return replace(method, gain_per_s=1 / interval_s)
    return method


def _why(k: int, max_iterations: int, distance: float, step: Step, stopped: tuple[int, ...]) -> str:
    left = f"{1000 * distance:.1f} mm left after {k} iterations"
    if stopped:
        return f"limits: joints {_listed(stopped)} at theirs, {left}"
    if step.singular:
        return f"{step.note}, {left}"
    return f"no progress: {left}" + (", the most that are allowed" if k >= max_iterations else "")


def _listed(joints: ArrayLike) -> str:
    return ", ".join(str(int(j)) for j in np.asarray(joints))
