"""Costs on the joint angles for redundant chains, with their gradients and Hessians.

Source: C. van der Leek, MSc(Eng), University of Cape Town, 2022; of the rotational energies each link has its own
length (printed with r5 throughout).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from recon.base.arrays import Array
from recon.robotics.ik.chain import SerialChain


class Cost(Protocol):
    def value(self, q: Array) -> float: ...
    def gradient(self, q: Array) -> Array:
        """(n,)"""
        ...

    def hessian(self, q: Array) -> Array:
        """(n, n)"""
        ...


@dataclass(frozen=True, eq=False)
class Quadratic:
    """g = (q - about)' H (q - about) / 2 with a constant symmetric H (n, n); about: (n,), or 0 for all."""

    matrix: Array
    about: Array | float = 0.0

    def value(self, q: Array) -> float:
        off = q - self.about
        return float(off @ self.matrix @ off) / 2

    def gradient(self, q: Array) -> Array:
        return self.matrix @ (q - self.about)

    def hessian(self, q: Array) -> Array:
        return self.matrix


def joint_differences(chain: SerialChain) -> Quadratic:
    """sum (q_{k+1} - q_k)^2 over the joints that follow each other, thetas and phis apart: an even bend."""
    H = np.zeros((chain.n, chain.n))
    for group in chain.groups:
        for i, j in pairwise(group):
            H[i, i] += 2
            H[j, j] += 2
            H[i, j] -= 2
            H[j, i] -= 2
    return Quadratic(H)


def rotational_energy(chain: SerialChain) -> Quadratic:
    """sum (r_k q_k)^2 with each joint's own link length r_k, m^2: least rotation, least in the long links."""
    return Quadratic(2 * np.diag(chain.joint_lengths_m**2))


def pose_distance(pose: Array) -> Quadratic:
    """sum (q_k - p_k)^2 from a pose p (n,), of the animal for instance."""
    return Quadratic(2 * np.eye(len(pose)), pose)


@dataclass(frozen=True)
class WeightedSum:
    """sum_i w_i g_i of other costs."""

    costs: tuple[Cost, ...]
    weights: tuple[float, ...]

    def value(self, q: Array) -> float:
        return sum(w * cost.value(q) for w, cost in zip(self.weights, self.costs, strict=True))

    def gradient(self, q: Array) -> Array:
        return np.sum([w * cost.gradient(q) for w, cost in zip(self.weights, self.costs, strict=True)], axis=0)

    def hessian(self, q: Array) -> Array:
        return np.sum([w * cost.hessian(q) for w, cost in zip(self.weights, self.costs, strict=True)], axis=0)


@dataclass(frozen=True)
class HarmonicMap:
    """g = q2 (a q1 + b) sqrt(1 + q1^2) with q1 = q[i] - q[j], q2 = q[k] - q[j].

    joints: (i, j, k), by default theta_2, theta_3, theta_4 of the spine-front-leg chain. Its Hessian has rank 2, and
    its stationary points are saddles: the extended Jacobian can be singular at G = 0.
    """

    a: float = 1.0
    b: float = 0.0
    joints: tuple[int, int, int] = (2, 3, 4)

    def _map(self, q: Array) -> tuple[float, float, float, float]:
        """q2, f, f' and f'' of f = (a q1 + b) sqrt(1 + q1^2)."""
        i, j, k = self.joints
        q1, q2 = float(q[i] - q[j]), float(q[k] - q[j])
        root, line = math.sqrt(1 + q1 * q1), self.a * q1 + self.b
        first = self.a * root + line * q1 / root
        second = (3 * self.a * q1 + self.b) / root - line * q1 * q1 / root**3
        return q2, line * root, first, second

    def value(self, q: Array) -> float:
        q2, f, _, _ = self._map(q)
        return q2 * f

    def gradient(self, q: Array) -> Array:
        i, j, k = self.joints
        q2, f, first, _ = self._map(q)
        out = np.zeros(len(q))
        out[i], out[j], out[k] = q2 * first, -q2 * first - f, f
        return out

    def hessian(self, q: Array) -> Array:
        i, j, k = self.joints
        q2, _, first, second = self._map(q)
        c = q2 * second
        out = np.zeros((len(q), len(q)))
        out[i, i], out[j, j] = c, c + 2 * first
        out[i, j] = out[j, i] = -c - first
        out[i, k] = out[k, i] = first
        out[j, k] = out[k, j] = -first
        return out


@dataclass(frozen=True)
class UserCost:
    """Any smooth function of q (n,), with derivatives from central differences over `step_rad`."""

    function: Callable[[Array], float]
    step_rad: float = 1e-4

    def value(self, q: Array) -> float:
        return float(self.function(q))

    def gradient(self, q: Array) -> Array:
        h = self.step_rad * np.eye(len(q))
        return np.array([(self.value(q + e) - self.value(q - e)) / (2 * self.step_rad) for e in h])

    def hessian(self, q: Array) -> Array:
        h, n = self.step_rad * np.eye(len(q)), len(q)
        out, here = np.empty((n, n)), self.value(q)
        for i in range(n):
            out[i, i] = self.value(q + h[i]) - 2 * here + self.value(q - h[i])
            for j in range(i):
                mixed = [self.value(q + a * h[i] + b * h[j]) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
                out[i, j] = out[j, i] = (mixed[0] - mixed[1] - mixed[2] + mixed[3]) / 4
        return out / self.step_rad**2
