"""Moving a chain's end effector to a target or along a path.

One iteration is an interval of time: the end effector is sent to the next point at the velocity that gets it there
(which takes away the drift of the one before), no faster than `MAX_STEP_M` an interval, the method gives the rates, and
the joints move by rates times interval. Joints that would leave their limits stay where they are and are taken out of
the chain for that iteration. The extended Jacobian starts at G = 0, to which it is moved along the null space first,
and is kept there by a gain of 1 / interval.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from recon.base.arrays import Array, Bools
from recon.gait import phase
from recon.robotics.control import control_rates
from recon.robotics.ik.chain import SerialChain, manipulability, unreachable
from recon.robotics.ik.methods import INTERVAL_S, ExtendedJacobian, JointRates, Method, Scaled, kept_cost
from recon.robotics.ik.null_space import inside_limits, listed, to_null_space_optimum

TOLERANCE_M = 0.003
MAX_STEP_M = 0.02
"""Longest way of the end effector in one iteration."""
PATIENCE = 100
"""Iterations in which the distance has to shrink by `PROGRESS`."""
PROGRESS = 0.01
STILL_RAD = 1e-10
"""Rounding, no motion."""


@dataclass(frozen=True)
class LimitStop:
    """A limit that stopped a joint."""

    joint: int
    limit_rad: float
    upper: bool
    step: int
    """The first in which it did."""

    def text(self, names: Sequence[str]) -> str:
        """names (n,): of the chain's joints."""
        at = f"{'upper' if self.upper else 'lower'} limit of {self.limit_rad:.2f} rad"
        return f"{names[self.joint]} at its {at} (step {self.step})"


@dataclass(frozen=True, eq=False)
class _Run:
    """What the chain did: K configurations, K - 1 steps."""

    q: Array
    """(K, n), rad."""
    dq: Array
    """(K, n), rad/s: the rates with which each configuration is left."""
    interval_s: float
    """From one configuration to the next."""
    end_m: Array
    """(K, dim)"""
    distance_m: Array
    """(K,): from the target, or from the path."""
    manipulability: Array
    """(K,): sqrt(det J J')."""
    singular: Bools
    """(K - 1,): whether the step was damped at a singular configuration."""
    solve_s: Array
    """(K - 1,): computing time of each step."""
    limits: tuple[LimitStop, ...]
    """Of every joint that one stopped the first, in their order."""
    closed: bool
    """Whether it was along a closed path."""

    @property
    def time_s(self) -> Array:
        """(K,): from the start."""
        return np.asarray(self.interval_s * np.arange(len(self.q)), float)

    @cached_property
    def control(self) -> tuple[Array, Array]:
        """Rates and accelerations (K, n) as a controller takes them: `control_rates`. The way along a closed path comes
        from where its last step came from, any other starts at rest."""
        q = self.q
        before = q[0] - (q[-1] - q[-2]) if self.closed else q[0]
        return control_rates(q, self.interval_s, before, q[-1] + self.interval_s * self.dq[-1])

    @property
    def limits_hit(self) -> tuple[int, ...]:
        """The joints that were stopped by a limit."""
        return tuple(sorted(stop.joint for stop in self.limits))

    @property
    def iterations(self) -> int:
        return len(self.q) - 1

    @property
    def length_m(self) -> float:
        """Of the end effector's path."""
        return float(np.linalg.norm(np.diff(self.end_m, axis=0), axis=1).sum())

    @property
    def roughness_rad2(self) -> float:
        """Mean over the inner configurations of |q_{k+1} - 2 q_k + q_{k-1}|^2: 0 is smoothest."""
        return roughness(self.q)

    def closures(self) -> dict[str, Array]:
        """Degrees of closure in percent of each joint (n,), from the first configuration to the last: of its "angle",
        and of its path in the (angle, rate) "plane". NaN for a joint that does not move."""
        paths = [(angle, np.column_stack([angle, rate])) for angle, rate in zip(self.q.T, self.dq.T, strict=True)]
        angle, plane = np.array([[degree_of_closure(path) for path in of_joint] for of_joint in paths]).T
        return {"angle": angle, "plane": plane}


@dataclass(frozen=True, eq=False)
class Drive(_Run):
    """The way to a target, where the chain stops: the last rates are 0.

    reason: "reached", or what stopped it: "unreachable: ...", "singular: ...", "limits: ..." or "no progress: ...".
    """

    reason: str

    @property
    def reached(self) -> bool:
        return self.reason == "reached"


@dataclass(frozen=True, eq=False)
class Follow(_Run):
    """The way along a path, turns times. The last rates are those with which a closed path begins anew, or an open
    one ends."""

    note: str
    """The first thing that went wrong, with its step, or empty."""
    turns: int


def drive_to(
    chain: SerialChain,
    q0: ArrayLike,
    target_m: ArrayLike,
    method: Method,
    tolerance_m: float = TOLERANCE_M,
    max_iterations: int = 2000,
    interval_s: float = INTERVAL_S,
) -> Drive:
    """Drives the end effector from q0 (n,) to a target (dim,). What goes wrong is a reason in the result.

    The extended Jacobian goes to G = 0 first; those configurations are not part of the path.
    """
    q, target = inside_limits(chain, np.asarray(q0, float)), np.asarray(target_m, float)
    reason = unreachable(chain, target, tolerance_m)
    if not np.isfinite(q).all():
        reason = "no progress: the start is not finite"
        q = np.zeros(chain.n)
    if not reason and (cost := kept_cost(method)) is not None:
        q = to_null_space_optimum(chain, q, cost).q[-1]
    method = _with_gain(method, interval_s)

    taken = _Taken(chain, q)
    distance = float(np.linalg.norm(target - taken.end))
    distances, best, best_at, last = [distance], distance, 0, JointRates(np.zeros(chain.n))
    stopped: tuple[int, ...] = ()
    while not reason and distance > tolerance_m:
        k = len(taken.rates)
        if k >= max_iterations or k - best_at >= PATIENCE or (k and float(np.abs(last.dq).max()) <= STILL_RAD):
            reason = _reason(chain, k, max_iterations, distance, last, stopped)
            break
        dx = (target - taken.end) * (min(1.0, MAX_STEP_M / distance) / interval_s)
        last, stopped = taken.step(dx, method, interval_s)
        distance = float(np.linalg.norm(target - taken.end))
        if distance < (1 - PROGRESS) * best:
            best, best_at = distance, k + 1
        distances.append(distance)
    return Drive(**taken.run(np.zeros(chain.n), np.array(distances), interval_s, False), reason=reason or "reached")


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
    closed = bool(np.allclose(path[0], path[-1], rtol=0, atol=1e-9))
    if turns > 1 and not closed:
        raise ValueError("only a closed path can be followed more than once")
    points = np.concatenate([path[:1], *[path[1:]] * turns])
    if correct:
        method = _with_gain(method, interval_s)
    taken, note = _Taken(chain, inside_limits(chain, np.asarray(q0, float))), ""
    for k in range(len(points) - 1):
        dx = (points[k + 1] - (taken.end if correct else points[k])) / interval_s
        step, _ = taken.step(dx, method, interval_s)
        if not note and step.note:
            note = f"{step.note} (step {k})"
    again = path[1] - path[0] if closed else path[-1] - path[-2]
    last = _one_interval(chain, taken.q, again / interval_s, method, interval_s)[0].dq
    error = np.linalg.norm(np.array(taken.ends) - points, axis=1)
    return Follow(**taken.run(last, error, interval_s, closed), note=note, turns=turns)


class _Taken:
    """The steps of a run so far."""

    def __init__(self, chain: SerialChain, q: Array) -> None:
        self.chain, self.q, self.end = chain, q, chain.end(q)
        self.path, self.ends = [q], [self.end]
        self.rates: list[Array] = []
        self.singular: list[bool] = []
        self.times: list[float] = []
        self.limits: dict[int, LimitStop] = {}

    def step(self, dx: Array, method: Method, interval_s: float) -> tuple[JointRates, tuple[int, ...]]:
        """One interval at the velocity dx; what the method gave, and the joints that a limit stopped."""
        started = time.perf_counter()
        step, self.q, stopped = _one_interval(self.chain, self.q, dx, method, interval_s)
        self.times.append(time.perf_counter() - started)
        for joint in stopped:
            low, high = float(self.chain.lower_rad[joint]), float(self.chain.upper_rad[joint])
            upper = 2 * float(self.q[joint]) > low + high
            self.limits.setdefault(joint, LimitStop(joint, high if upper else low, upper, len(self.rates)))
        self.end = self.chain.end(self.q)
        self.path.append(self.q)
        self.ends.append(self.end)
        self.rates.append(step.dq)
        self.singular.append(step.singular)
        return step, stopped

    def run(self, last_dq: Array, distance_m: Array, interval_s: float, closed: bool) -> dict[str, Any]:
        """The fields of `_Run`."""
        return {
            "q": np.array(self.path),
            "dq": np.array([*self.rates, last_dq]),
            "interval_s": interval_s,
            "closed": closed,
            "end_m": np.array(self.ends),
            "distance_m": distance_m,
            "manipulability": np.array([manipulability(self.chain.jacobian(q)) for q in self.path]),
            "singular": np.array(self.singular, bool),
            "solve_s": np.array(self.times),
            "limits": tuple(self.limits.values()),
        }


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


def _one_interval(
    chain: SerialChain, q: Array, dx: Array, method: Method, interval_s: float
) -> tuple[JointRates, Array, tuple[int, ...]]:
    """One interval: the step, where it leads, and the joints that a limit stopped."""
    step = method.rates(chain, q, dx)
    moved = q + interval_s * step.dq
    inside = inside_limits(chain, moved)
    if (inside == moved).all():
        return step, moved, ()
    free = np.ones(chain.n, bool)
    while not (inside == moved).all():
        outside = (inside != moved) & free
        free &= ~outside
        if not free.any():
            return JointRates(np.zeros(chain.n), step.singular, step.note), q, tuple(range(chain.n))
        step = method.rates(chain, q, dx, free)
        moved = q + interval_s * step.dq
        inside = inside_limits(chain, moved)
    return step, moved, tuple((~free).nonzero()[0].tolist())


def _with_gain(method: Method, interval_s: float) -> Method:
    """The extended Jacobian with the gain that keeps it at G = 0."""
    if isinstance(method, Scaled):
        return replace(method, method=_with_gain(method.method, interval_s))
    if isinstance(method, ExtendedJacobian) and method.full and not method.gain_per_s:
        return replace(method, gain_per_s=1 / interval_s)
    return method


def _reason(
    chain: SerialChain, k: int, max_iterations: int, distance: float, step: JointRates, stopped: tuple[int, ...]
) -> str:
    left = f"{1000 * distance:.1f} mm left after {k} iterations"
    if stopped:
        return f"limits: joints {listed(chain, stopped)} at theirs, {left}"
    if step.singular:
        return f"{step.note}, {left}"
    return f"no progress: {left}" + (", the most that are allowed" if k >= max_iterations else "")
