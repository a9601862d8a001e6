"""Move the end effector of a chain to a target or along a path by one of the methods of inverse kinematics.

Each iteration covers one interval of time. The end effector gets the velocity that would take it to the next point
within the interval, which also corrects the drift of the previous iteration. On the way to a target, it moves by at
most `MAX_STEP_M`. The method computes the rates of the joints, which move by the rates times the interval. A joint that
would leave its limits stays where it is, and is taken out of the chain for that iteration. The extended Jacobian starts
at G = 0 (`recon.ik.null_space`) and is kept there by a gain of 1 / interval.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from recon.base.arrays import Array, Bools
from recon.gait import phase
from recon.ik.chain import SerialChain, manipulability, unreachable
from recon.ik.methods import ALL_JOINTS, INTERVAL_S, ExtendedJacobian, JointRates, Method
from recon.ik.null_space import joint_names, to_null_space_optimum

TOLERANCE_M = 0.003
MAX_STEP_M = 0.02
"""Longest motion of the end effector towards a target in one iteration, metres."""
PROGRESS_ITERATIONS = 100
"""Number of iterations within which the distance from the target must shrink by `MIN_PROGRESS`."""
MIN_PROGRESS = 0.01
"""Smallest reduction of the distance from the target, as a fraction of it, that counts as progress."""
STILL_RAD = 1e-10
"""Maximum motion (rad) or rate (rad/s) of a joint that counts as still, because only rounding errors remain."""


@dataclass(frozen=True, eq=False)
class Run:
    """Motion of a chain to a target or along a path, with K configurations and K - 1 steps."""

    q: Array
    """Joint angles, shape (K, n), rad."""
    dq: Array
    """Rates of the joints on leaving each configuration, shape (K, n), rad/s.

    The last row is 0 at a target, equals the first row on a closed path, and repeats the last rates on an open path.
    """
    interval_s: float
    """Time from one configuration to the next, seconds."""
    end_m: Array
    """Positions of the end effector, shape (K, dim), metres."""
    aim_m: Array
    """The target (dim,), or the points of the path (K, dim), metres."""
    manipulability: Array
    """Manipulability sqrt(det J J'), shape (K,)."""
    singular: Bools
    """Whether each step was damped at a singular configuration, shape (K - 1,)."""
    solve_s: Array
    """Computing time of each step, shape (K - 1,), seconds."""
    limits: dict[str, str]
    """Text for each joint that a limit stopped, by joint name, with the limit and the step of the first stop."""
    closed: bool
    """Whether the path was closed."""
    note: str
    """Reason why the target was not reached: "unreachable: ...", "singular: ...", "limits: ..." or "no progress: ...".

    Along a path, the note states the first problem and its step. Without a problem, the note is empty.
    """

    @property
    def driven(self) -> bool:
        """Return whether the motion was to a target, not along a path."""
        return self.aim_m.ndim == 1

    @property
    def distance_m(self) -> Array:
        """Return the distance of the end effector from the target, or from the path's points, shape (K,), metres."""
        return np.linalg.norm(self.aim_m - self.end_m, axis=1)

    @property
    def reached(self) -> bool:
        """Return whether the run ended at its target."""
        return not self.note

    @property
    def reason(self) -> str:
        """Return why the motion to a target ended."""
        return self.note or "reached"

    @property
    def time_s(self) -> Array:
        """Return the times of the K configurations from the start, shape (K,), seconds."""
        return np.asarray(self.interval_s * np.arange(len(self.q)), float)

    @cached_property
    def control(self) -> tuple[Array, Array]:
        """Return joint rates (rad/s) and accelerations (rad/s²) for a controller, both with the shape (K, n).

        Both are derivatives of the parabola through a sample and its two neighbours. A closed path is continued
        periodically. Any other path starts at rest.
        """
        q, interval_s = self.q, self.interval_s
        previous = q[0] - (q[-1] - q[-2]) if self.closed else q[0]
        known = np.vstack([previous, q, q[-1] + interval_s * self.dq[-1]])
        return (known[2:] - known[:-2]) / (2 * interval_s), (known[2:] - 2 * q + known[:-2]) / interval_s**2

    @property
    def iterations(self) -> int:
        """Return the number of steps."""
        return len(self.q) - 1

    @property
    def length_m(self) -> float:
        """Return the length of the end effector's path, metres."""
        return float(np.linalg.norm(np.diff(self.end_m, axis=0), axis=1).sum())

    @property
    def roughness_rad2(self) -> float:
        """Return the mean of |q_{k+1} - 2 q_k + q_{k-1}|^2, rad^2, which is 0 for a perfectly smooth motion."""
        return float(np.mean(np.sum(np.diff(self.q, 2, axis=0) ** 2, axis=1))) if len(self.q) > 2 else 0.0

    def closures(self) -> dict[str, Array]:
        """Return the degree of closure of each joint from the first configuration to the last, shape (n,), in percent.

        Three measures are returned, each NaN for a joint that does not move. "angle" is the closure of the angle.
        "plane" is the closure of the path in the plane of angle and rate, with each axis divided by its range.
        "unscaled" is the closure in the plane of rad and rad/s, as published.
        """
        planes = [np.column_stack(path) for path in zip(self.q.T, self.dq.T, strict=True)]
        return {
            "angle": np.array([degree_of_closure(plane[:, 0]) for plane in planes]),
            "plane": np.array([degree_of_closure(plane) for plane in planes]),
            "unscaled": np.array([degree_of_closure(plane, is_scaled=False) for plane in planes]),
        }

    def measures(self) -> dict[str, Any]:
        """Return the measures of the run that the tables of `recon ik` show."""
        if self.driven:
            left_m = float(self.distance_m[-1])
            outcome = {"reached": self.reached, "reason": self.reason, "iterations": self.iterations, "left_m": left_m}
        else:
            outcome = {"worst_error_m": float(self.distance_m.max()), "note": self.note}
        return outcome | {
            "us_per_step": 1e6 * float(np.median(self.solve_s)) if len(self.solve_s) else None,
            "solve_ms": 1e3 * float(self.solve_s.sum()),
            "length_m": self.length_m,
            "roughness_rad2": self.roughness_rad2,
            "least_manipulability": float(self.manipulability.min()),
            "limits_hit": list(self.limits),
            "first_limit": next(iter(self.limits.values()), ""),
        }


def control_columns(names: Sequence[str]) -> list[str]:
    """Return the column names for the joints' rates and accelerations."""
    return [f"{name}_{quantity}" for quantity in ("rate_rad_s", "acceleration_rad_s2") for name in names]


def drive_to(
    chain: SerialChain,
    q0: ArrayLike,
    target_m: ArrayLike,
    method: Method,
    tolerance_m: float = TOLERANCE_M,
    max_iterations: int = 2000,
    interval_s: float = INTERVAL_S,
) -> Run:
    """Drive the end effector from joint angles q0 (n,) in rad to a target (dim,) in metres.

    The run starts at q0, moved to within the limits. The extended Jacobian first moves from there to G = 0 with the end
    effector fixed. If the target is not reached, the run's note gives the reason.
    """
    q, target = chain.inside_limits(np.asarray(q0, float)), np.asarray(target_m, float)
    note = unreachable(chain, target, tolerance_m)
    if not np.isfinite(q).all():
        q, note = np.zeros(chain.n), "no progress: the start is not finite"
    if not note and isinstance(method, ExtendedJacobian):
        q = to_null_space_optimum(chain, q, method.cost)[0]
    best, best_at = np.inf, 0

    def next_velocity(k: int, end: Array, last: JointRates, stopped: list[int]) -> Array | str:
        nonlocal best, best_at
        distance = float(np.linalg.norm(target - end))
        if note or distance <= tolerance_m:
            return note
        if distance < (1 - MIN_PROGRESS) * best:
            best, best_at = distance, k
        if (
            k >= max_iterations
            or k - best_at >= PROGRESS_ITERATIONS
            or (k and float(np.abs(last.dq).max()) <= STILL_RAD)
        ):
            left = f"{1000 * distance:.1f} mm left after {k} iterations"
            if stopped:
                return f"limits: joints {joint_names(chain, stopped)} at their limits, {left}"
            if last.singular:
                return f"{last.note}, {left}"
            return f"no progress: {left}" + (", the largest number allowed" if k >= max_iterations else "")
        return (target - end) * (min(1.0, MAX_STEP_M / distance) / interval_s)

    return _moved(chain, q, target, next_velocity, lambda _: method, interval_s)


def follow(
    chain: SerialChain,
    q0: ArrayLike,
    path_m: Array,
    method: Method | Callable[[int], Method],
    turns: int = 1,
    interval_s: float = INTERVAL_S,
) -> Run:
    """Move the end effector along a path (K, dim), m, from joint angles q0 (n,) that put it at the path's start.

    Each step goes from the position of the end effector to the next point. The gain of the full extended Jacobian keeps
    G = 0.

    Parameters
    ----------
    chain
        The chain to move.
    q0
        Joint angles (n,) at the start, rad.
    path_m
        Points (K, dim) of the path, metres, one interval apart.
    method
        One method for all steps, or a function that returns the method of each step from its number.
    turns
        Number of times to follow a closed path, whose last point is its first.
    interval_s
        Time from one point to the next, seconds.

    Raises
    ------
    ValueError
        If the path does not have two or more finite points, or if an open path is to be followed several times.
    """
    path = np.asarray(path_m, float)
    if path.ndim != 2 or len(path) < 2 or path.shape[1] != chain.dim or not np.isfinite(path).all():
        raise ValueError(f"expected a finite path (K, {chain.dim}) of two or more points, got the shape {path.shape}")
    closed = bool(np.allclose(path[0], path[-1], rtol=0, atol=1e-9))
    if turns > 1 and not closed:
        raise ValueError("only a closed path can be followed more than once")
    points = np.concatenate([path[:1], *[path[1:]] * turns])
    note = ""

    def method_at(k: int) -> Method:
        return method if isinstance(method, Method) else method(k)

    def next_velocity(k: int, end: Array, last: JointRates, stopped: list[int]) -> Array | str:
        nonlocal note
        if not note and last.note:
            note = f"{last.note} (step {k - 1})"
        return note if k == len(points) - 1 else (points[k + 1] - end) / interval_s

    run = _moved(chain, chain.inside_limits(np.asarray(q0, float)), points, next_velocity, method_at, interval_s)
    onwards = path[1] - path[0] if closed else path[-1] - path[-2]
    last = _one_interval(chain, run.q[-1], onwards / interval_s, method_at(run.iterations), interval_s)[0].dq
    return replace(run, dq=np.vstack([run.dq[:-1], last]), closed=closed)


def _moved(
    chain: SerialChain,
    q: Array,
    aim_m: Array,
    next_velocity: Callable[[int, Array, JointRates, list[int]], Array | str],
    method: Callable[[int], Method],
    interval_s: float,
) -> Run:
    """Move the chain from q (n,), interval by interval, until `next_velocity` returns the note of the run.

    next_velocity(k, end, last rates, stopped joints) returns the velocity (dim,) of step k, or the note.
    """
    path, ends, limits = [q], [chain.end(q)], {}
    steps: list[JointRates] = []
    times: list[float] = []
    last, stopped = JointRates(np.zeros(chain.n)), []
    while not isinstance(dx := next_velocity(len(steps), ends[-1], last, stopped), str):
        started = time.perf_counter()
        last, q, stopped = _one_interval(chain, q, dx, method(len(steps)), interval_s)
        ends.append(chain.end(q))
        times.append(time.perf_counter() - started)
        for joint in stopped:
            low, high = float(chain.lower_rad[joint]), float(chain.upper_rad[joint])
            side, limit = ("upper", high) if 2 * float(q[joint]) > low + high else ("lower", low)
            name = chain.names[joint]
            limits.setdefault(name, f"{name} at its {side} limit of {limit:.2f} rad (step {len(steps)})")
        steps.append(last)
        path.append(q)
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


def degree_of_closure(path: Array, is_scaled: bool = True) -> float:
    """Return the degree of closure D = 100 (1 - d / d_max) of a path, in percent.

    d is the distance from the start to the end, and d_max is the diameter of the path. The path is an angle (K,), or
    angle and rate (K, 2), with both axes divided by their ranges unless `is_scaled` is False. D is NaN for an angle
    that stays within `STILL_RAD`.
    """
    if np.ptp(path if path.ndim == 1 else path[:, 0]) <= STILL_RAD:
        return math.nan
    if path.ndim == 1:
        return phase.degree_of_closure(path[:, None])
    return phase.degree_of_closure(phase.scaled(path) if is_scaled else path)


def _one_interval(
    chain: SerialChain, q: Array, dx: Array, method: Method, interval_s: float
) -> tuple[JointRates, Array, list[int]]:
    """Return the joint rates of one interval, the angles (n,) at its end, and the joints that a limit stopped.

    The extended Jacobian gets the gain that keeps it at G = 0.
    """
    if isinstance(method, ExtendedJacobian) and method.full and not method.gain_per_s:
        method = replace(method, gain_per_s=1 / interval_s)
    free = np.ones(chain.n, bool)
    while True:
        step = method.rates(chain, q, dx, ALL_JOINTS if free.all() else free)
        moved = q + interval_s * step.dq
        outside = chain.inside_limits(moved) != moved
        if not outside.any():
            return step, moved, (~free).nonzero()[0].tolist()
        free &= ~outside
        if not free.any():
            return JointRates(np.zeros(chain.n), step.singular, step.note), q, [*range(chain.n)]
