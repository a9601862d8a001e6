"""Serial chains with exact derivatives: what the methods ask of a chain, and chains whose angles add up.

Joint angles are relative to the link before and add up along the chain; T_k, P_k are the sums up to link k, r_k its
length. In two dimensions link k adds r_k (cos T_k, sin T_k), in three, with q = [theta..., phi...],

    r_k (cos T_k cos P_k,  sin T_k,  cos T_k sin P_k)

(`recon.animal.chain`). Every joint turns all links after it, so the derivative by joint j is the sum over the links k
>= j, and the second derivative by i and j the one over k >= max(i, j). Chains of any joints:
`recon.robotics.ik.joint_chain`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from recon.base.arrays import Array, Index

Curvature = Callable[[Array], Array]
"""mu (dim,) -> sum_i mu_i Hess f_i (n, n)."""

MAX_RATE_RAD_S = 50.0
"""Where a chain has no rate limit of its own."""


@dataclass(frozen=True, eq=False)
class SerialChain(ABC):
    """A chain with n joint angles in dim dimensions, its base at the origin. A kind of chain says how it is
    differentiated; its rates and curvatures follow."""

    lower_rad: Array
    """(n,); metres for joints that slide, as of all limits."""
    upper_rad: Array
    """(n,)"""
    max_rate_rad_s: Array
    """(n,), finite."""
    groups: tuple[tuple[int, ...], ...]
    """The joints that follow each other along the chain, one tuple for each kind of angle."""
    _later: Index = field(init=False, repr=False)
    """(n, n): the later of two joints."""

    def __init__(
        self,
        n: int,
        limits_rad: tuple[ArrayLike, ArrayLike] | None,
        max_rate_rad_s: ArrayLike,
        groups: tuple[tuple[int, ...], ...],
    ) -> None:
        lower, upper = (-np.inf, np.inf) if limits_rad is None else limits_rad
        lower, upper, rate = (np.array(np.broadcast_to(x, n), float) for x in (lower, upper, max_rate_rad_s))
        if not np.all(lower <= upper):
            raise ValueError("a lower limit is above the upper one")
        if not np.all(np.isfinite(rate) & (rate > 0)):
            raise ValueError("rate limits must be positive and finite")
        later = np.maximum(np.arange(n)[:, None], np.arange(n))
        self._set(lower_rad=lower, upper_rad=upper, max_rate_rad_s=rate, groups=groups, _later=later)

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        return len(self.lower_rad)

    @property
    @abstractmethod
    def dim(self) -> int: ...

    @property
    @abstractmethod
    def joint_lengths_m(self) -> Array:
        """(n,): of the link that each joint turns."""

    @property
    @abstractmethod
    def reach_m(self) -> tuple[float, float]:
        """Bounds of the end effector's distance from the base, which no angles leave."""

    @abstractmethod
    def positions(self, q: Array) -> Array:
        """The joints along the chain and, last, the end effector (., dim), metres."""

    @abstractmethod
    def end(self, q: Array) -> Array:
        """The end effector (dim,), metres."""

    @abstractmethod
    def derivatives(self, q: Array) -> tuple[Array, Curvature]:
        """The end effector's Jacobian (dim, n) and its curvature, for both of which the chain is gone through once."""

    def jacobian(self, q: Array) -> Array:
        """(dim, n) of the end effector."""
        return self.derivatives(q)[0]

    def curvature(self, q: Array, mu: Array) -> Array:
        """sum_i mu_i Hess f_i (n, n), for mu (dim,)."""
        return self.derivatives(q)[1](mu)

    def hessian(self, q: Array) -> Array:
        """(dim, n, n)"""
        curvature = self.derivatives(q)[1]
        return np.stack([curvature(axis) for axis in np.eye(self.dim)])


class _SummedAngles(SerialChain):
    lengths_m: Array
    lengths: list[float]
    """The same as floats, which are several times quicker than numpy's in loops."""
    _angles_per_link = 1

    def __init__(
        self,
        lengths_m: ArrayLike,
        limits_rad: tuple[ArrayLike, ArrayLike] | None = None,
        max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S,
    ) -> None:
        lengths = np.array(lengths_m, float)
        if lengths.ndim != 1 or not len(lengths) or not np.all(np.isfinite(lengths) & (lengths > 0)):
            raise ValueError(f"positive lengths (L,) expected, got {lengths_m}")
        links, kinds = len(lengths), self._angles_per_link
        groups = tuple(tuple(range(k * links, (k + 1) * links)) for k in range(kinds))
        super().__init__(kinds * links, limits_rad, max_rate_rad_s, groups)
        self._set(lengths_m=lengths, lengths=lengths.tolist(), _later=np.ascontiguousarray(self._later[:links, :links]))

    @property
    def joint_lengths_m(self) -> Array:
        return np.tile(self.lengths_m, self._angles_per_link)

    @property
    def reach_m(self) -> tuple[float, float]:
        """Of an annulus or a shell, which the end effector fills."""
        total, longest = sum(self.lengths), max(self.lengths)
        return max(0.0, 2 * longest - total), total


class PlanarChain(_SummedAngles):
    """Links in a plane: q (L,), angle 0 along +x, positive towards +y.

    lengths_m (L,); limits_rad: lower and upper, each one number or (L,); max_rate_rad_s: one or (L,).
    """

    @property
    def dim(self) -> int:
        return 2

    def positions(self, q: Array) -> Array:
        """Base and the links' ends (L + 1, 2)."""
        T = np.cumsum(q)
        points = np.zeros((len(self.lengths) + 1, 2))
        np.cumsum(self.lengths_m * np.cos(T), out=points[1:, 0])
        np.cumsum(self.lengths_m * np.sin(T), out=points[1:, 1])
        return points

    def end(self, q: Array) -> Array:
        T = x = y = 0.0
        for angle, r in zip(q.tolist(), self.lengths, strict=True):
            T += angle
            x += r * math.cos(T)
            y += r * math.sin(T)
        return np.array((x, y))

    def derivatives(self, q: Array) -> tuple[Array, Curvature]:
        # x and y of the links from each joint on.
        T, x, y = 0.0, [], []
        for angle, r in zip(q.tolist(), self.lengths, strict=True):
            T += angle
            x.append(r * math.cos(T))
            y.append(r * math.sin(T))
        for k in range(len(x) - 2, -1, -1):
            x[k] += x[k + 1]
            y[k] += y[k + 1]

        def curvature(mu: Array) -> Array:
            a, b = mu.tolist()
            return np.array([-a * u - b * v for u, v in zip(x, y, strict=True)]).take(self._later)

        return np.array(([-v for v in y], x)), curvature


class SummedChain(_SummedAngles):
    """Universal joints in space, the convention of `recon.animal.chain`: q (2 L,) = [theta..., phi...], base frame UVW.

    lengths_m (L,); limits_rad: lower and upper, each one number or (2 L,); max_rate_rad_s: one or (2 L,).
    """

    _angles_per_link = 2

    @property
    def dim(self) -> int:
        return 3

    def _directions(self, q: Array) -> Iterator[tuple[float, float, float, float, float]]:
        """Length, cos T, sin T, cos P, sin P of each link."""
        T = P = 0.0
        angles, L = q.tolist(), len(self.lengths)
        for theta, phi, r in zip(angles[:L], angles[L:], self.lengths, strict=True):
            T += theta
            P += phi
            yield r, math.cos(T), math.sin(T), math.cos(P), math.sin(P)

    def positions(self, q: Array) -> Array:
        """Base and the links' ends (L + 1, 3)."""
        links = [(r * ct * cp, r * st, r * ct * sp) for r, ct, st, cp, sp in self._directions(q)]
        return np.cumsum([(0.0, 0.0, 0.0), *links], axis=0)

    def end(self, q: Array) -> Array:
        u = v = w = 0.0
        for r, ct, st, cp, sp in self._directions(q):
            u += r * ct * cp
            v += r * st
            w += r * ct * sp
        return np.array((u, v, w))

    def derivatives(self, q: Array) -> tuple[Array, Curvature]:
        # The links' u, v, w and what they change by with T (v, w with P as well), summed from each joint on.
        rows = [(r * ct * cp, r * st, r * ct * sp, -r * st * cp, r * ct, -r * st * sp) for r, ct, st, cp, sp in
                self._directions(q)]  # fmt: skip
        u, v, w, u_T, v_T, w_T = np.array(rows)[::-1].cumsum(axis=0)[::-1].T
        L = len(rows)
        J = np.zeros((3, 2 * L))
        J[0, :L], J[1, :L], J[2, :L], J[0, L:], J[2, L:] = u_T, v_T, w_T, -w, u

        def curvature(mu: Array) -> Array:
            a, b, c = mu.tolist()
            level = -a * u - c * w
            out = np.empty((2 * L, 2 * L))
            out[:L, :L] = (level - b * v).take(self._later)
            out[:L, L:] = out[L:, :L] = (c * u_T - a * w_T).take(self._later)
            out[L:, L:] = level.take(self._later)
            return out

        return J, curvature


def unreachable(chain: SerialChain, target_m: Array, tolerance_m: float = 0.0) -> str:
    """Why no angles put the end effector within the tolerance of a target (dim,); empty where some may."""
    if not np.isfinite(target_m).all():
        return "unreachable: the target is not finite"
    distance, (least, most) = float(np.linalg.norm(target_m)), chain.reach_m
    if least - tolerance_m <= distance <= most + tolerance_m:
        return ""
    return f"unreachable: {distance:.3f} m from the base, the chain reaches {least:.3f} to {most:.3f} m"


def manipulability(J: Array) -> float:
    """sqrt(det J J') of J (dim, n) (Yoshikawa 1985): 0 where a direction is lost."""
    return math.sqrt(max(0.0, float(np.linalg.det(J @ J.T))))


def null_basis(J: Array, like: Array | None = None) -> Array:
    """Orthonormal basis N (n, n - dim) of the null space of J (dim, n), J N = 0.

    like: a basis at a neighbouring configuration. N is then the nearest basis to it, without turning within the null
    space, which makes it continuous along a path.
    """
    dim, n = J.shape
    columns = np.zeros((n, n), order="F")
    # LAPACK without numpy's checks takes a quarter of the time of `numpy.linalg.qr`.
    factors, tau, _, _ = lapack.dgeqrf(J.T)
    columns[:, :dim] = factors
    N = lapack.dorgqr(columns, tau, overwrite_a=True)[0][:, dim:]
    if like is None:
        return N
    u, _, vt = np.linalg.svd(N.T @ like)
    return N @ u @ vt
