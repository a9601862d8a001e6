"""Serial chains with exact derivatives, and the spine-front-leg chain of the 8U skeleton.

Joint angles are relative to the link before and add up along the chain; T_k, P_k are the sums up to link k, r_k its
length. In two dimensions link k adds r_k (cos T_k, sin T_k), in three, with q = [theta..., phi...],

    r_k (cos T_k cos P_k,  sin T_k,  cos T_k sin P_k)

(`recon.skeleton`). Every joint turns all links after it, so the derivative by joint j is the sum over the links k >= j,
and the second derivative by i and j the one over k >= max(i, j).

The base frame of the spine-front-leg chain sits at the root joint: U level along the direction of travel, V down, W to
the side, right-handed; the planar chain's x and y are U and V. Its first link, which has no angles of its own in the
skeleton (it lies on the skeleton's U), is free here: the angles follow from the rotation of the skeleton.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from recon.initialise import upright_rotation
from recon.rotations import euler_rotation
from recon.skeleton import Skeleton

Array = NDArray[np.float64]

MAX_RATE_RAD_S = 50.0
"""Where a chain has no rate limit of its own."""
BASE_THETA_RAD = 0.9
"""Limit of the first link's pitch: three standard deviations of a running animal's."""
_TRAVEL_M = 0.1
"""A shorter path of the root has no direction."""


class SerialChain(Protocol):
    """A chain with n joint angles in dim dimensions, its base at the origin.

    lengths_m (L,); lower_rad, upper_rad, max_rate_rad_s (n,): limits, the rates' are finite; groups: the joints that
    follow each other along the chain, one tuple for each kind of angle.
    """

    @property
    def lengths_m(self) -> Array: ...
    @property
    def lower_rad(self) -> Array: ...
    @property
    def upper_rad(self) -> Array: ...
    @property
    def max_rate_rad_s(self) -> Array: ...
    @property
    def n(self) -> int: ...
    @property
    def dim(self) -> int: ...
    @property
    def groups(self) -> tuple[tuple[int, ...], ...]: ...
    def positions(self, q: Array) -> Array:
        """Base and the links' ends (L + 1, dim), metres."""
        ...

    def end(self, q: Array) -> Array:
        """The end effector (dim,), metres."""
        ...

    def jacobian(self, q: Array) -> Array:
        """(dim, n) of the end effector."""
        ...

    def hessian(self, q: Array) -> Array:
        """(dim, n, n) of the end effector."""
        ...

    def curvature(self, q: Array, mu: Array) -> Array:
        """sum_i mu_i Hess f_i (n, n), for mu (dim,)."""
        ...


@dataclass(frozen=True, eq=False)
class _Chain:
    lengths_m: Array
    lower_rad: Array
    upper_rad: Array
    max_rate_rad_s: Array
    lengths: list[float] = field(init=False, repr=False)
    """The same as floats, which are several times quicker than numpy's in loops."""

    def __init__(
        self,
        lengths_m: ArrayLike,
        limits_rad: tuple[ArrayLike, ArrayLike] | None = None,
        max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S,
    ) -> None:
        lengths = np.array(lengths_m, float)
        if lengths.ndim != 1 or not len(lengths) or not np.all(np.isfinite(lengths) & (lengths > 0)):
            raise ValueError(f"positive lengths (L,) expected, got {lengths_m}")
        n = self._angles_per_link * len(lengths)
        lower, upper = (-np.inf, np.inf) if limits_rad is None else limits_rad
        lower, upper, rate = (np.array(np.broadcast_to(x, n), float) for x in (lower, upper, max_rate_rad_s))
        if not np.all(lower <= upper):
            raise ValueError("a lower limit is above the upper one")
        if not np.all(np.isfinite(rate) & (rate > 0)):
            raise ValueError("rate limits must be positive and finite")
        values = {"lengths_m": lengths, "lower_rad": lower, "upper_rad": upper, "max_rate_rad_s": rate}
        for name, value in (values | {"lengths": lengths.tolist()}).items():
            object.__setattr__(self, name, value)
        links = np.arange(len(lengths))
        object.__setattr__(self, "_later", np.maximum(links[:, None], links))

    _angles_per_link = 1
    _later: NDArray[np.intp] = field(init=False, repr=False)
    """(L, L): the later of two joints."""

    @property
    def n(self) -> int:
        return self._angles_per_link * len(self.lengths)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        L = len(self.lengths)
        return tuple(tuple(range(k * L, (k + 1) * L)) for k in range(self._angles_per_link))


class PlanarChain(_Chain):
    """Links in a plane: q (L,), angle 0 along +x, positive towards +y.

    lengths_m (L,); limits_rad: lower and upper, each one number or (L,); max_rate_rad_s: one or (L,).
    """

    _angles_per_link = 1

    @property
    def dim(self) -> int:
        return 2

    def positions(self, q: Array) -> Array:
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

    def _tails(self, q: Array) -> tuple[list[float], list[float]]:
        """x and y of the links from each joint on, (L,) each."""
        T, x, y = 0.0, [], []
        for angle, r in zip(q.tolist(), self.lengths, strict=True):
            T += angle
            x.append(r * math.cos(T))
            y.append(r * math.sin(T))
        for k in range(len(x) - 2, -1, -1):
            x[k] += x[k + 1]
            y[k] += y[k + 1]
        return x, y

    def jacobian(self, q: Array) -> Array:
        x, y = self._tails(q)
        return np.array(([-v for v in y], x))

    def hessian(self, q: Array) -> Array:
        return -np.array(self._tails(q))[:, self._later]

    def curvature(self, q: Array, mu: Array) -> Array:
        (a, b), (x, y) = mu.tolist(), self._tails(q)
        return np.array([-a * u - b * v for u, v in zip(x, y, strict=True)])[self._later]


class SummedChain(_Chain):
    """Universal joints in space, the convention of `recon.skeleton`: q (2 L,) = [theta..., phi...], base frame UVW.

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
        links = [(r * ct * cp, r * st, r * ct * sp) for r, ct, st, cp, sp in self._directions(q)]
        return np.cumsum([(0.0, 0.0, 0.0), *links], axis=0)

    def end(self, q: Array) -> Array:
        u = v = w = 0.0
        for r, ct, st, cp, sp in self._directions(q):
            u += r * ct * cp
            v += r * st
            w += r * ct * sp
        return np.array((u, v, w))

    def jacobian(self, q: Array) -> Array:
        rows = [(-r * st * cp, r * ct, -r * st * sp, -r * ct * sp, r * ct * cp) for r, ct, st, cp, sp in
                self._directions(q)]  # fmt: skip
        ut, vt, wt, up, wp = _sums_from_the_end(rows)
        return np.array((ut + up, vt + [0.0] * len(up), wt + wp))

    def hessian(self, q: Array) -> Array:
        return np.stack([self.curvature(q, axis) for axis in np.eye(3)])

    def curvature(self, q: Array, mu: Array) -> Array:
        a, b, c = mu.tolist()
        rows = []
        for r, ct, st, cp, sp in self._directions(q):
            outwards, sideways = a * cp + c * sp, c * cp - a * sp
            rows.append((-r * (ct * outwards + b * st), -r * st * sideways, -r * ct * outwards))
        tt, tp, pp = (np.array(sums)[self._later] for sums in _sums_from_the_end(rows))
        L = len(self.lengths)
        out = np.empty((2 * L, 2 * L))
        out[:L, :L], out[:L, L:], out[L:, :L], out[L:, L:] = tt, tp, tp, pp
        return out


def _sums_from_the_end(rows: list[tuple[float, ...]]) -> list[list[float]]:
    """The columns of rows, each summed from its entry to the last."""
    columns = [list(column) for column in zip(*rows, strict=True)]
    for column in columns:
        for k in range(len(column) - 2, -1, -1):
            column[k] += column[k + 1]
    return columns


def reach(chain: SerialChain) -> tuple[float, float]:
    """Least and greatest distance of the end effector from the base without limits, metres: an annulus or a shell."""
    total, longest = float(chain.lengths_m.sum()), float(chain.lengths_m.max())
    return max(0.0, 2 * longest - total), total


def unreachable(chain: SerialChain, target_m: Array, tolerance_m: float = 0.0) -> str:
    """Why no angles put the end effector within the tolerance of a target (dim,); empty where some do."""
    if not np.isfinite(target_m).all():
        return "unreachable: the target is not finite"
    distance, (least, most) = float(np.linalg.norm(target_m)), reach(chain)
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


# -- the spine-front-leg chain ---------------------------------------------------------------------------------------


def spine_front_leg(
    skeleton: Skeleton, base_length_m: float | None = None, dim: Literal[2, 3] = 3, limited: bool = True
) -> PlanarChain | SummedChain:
    """The chain from the root to the front foot, r5, r1, r2, r3, r4 of the 8U skeleton, in its level base frame.

    base_length_m: None for the nominal one. Limits are the skeleton's expected ranges, those of the first link
    `BASE_THETA_RAD` and three standard deviations of the heading about the direction of travel; it turns no faster
    than the next one. limited: False leaves them out, but for the rates'.
    """
    links = _path(skeleton)
    base = skeleton.nominal_base_length_m if base_length_m is None else base_length_m
    lengths = [skeleton.links[i].length_ratio * base for i in links]
    free = _angle_index(skeleton, links)
    lower, upper, rate = [], [], []
    for ranges, base_limit in ((skeleton.theta, BASE_THETA_RAD), (skeleton.phi, 3 * skeleton.scales.travel_rad)):
        rates = [float(ranges.max_rate_rad_s[k]) for k in free if k is not None]
        for k in free:
            lower.append(-base_limit if k is None else ranges.mean_rad[k] - ranges.tolerance_rad[k])
            upper.append(base_limit if k is None else ranges.mean_rad[k] + ranges.tolerance_rad[k])
            rate.append(rates[0] if k is None else ranges.max_rate_rad_s[k])
    kind = PlanarChain if dim == 2 else SummedChain
    n = len(links) * (dim - 1)
    return kind(lengths, (lower[:n], upper[:n]) if limited else None, rate[:n])


def chain_angles(
    skeleton: Skeleton, states: Array, up: Array, travel: Array | None = None, dim: Literal[2, 3] = 3
) -> Array:
    """Joint angles (T, n) of `spine_front_leg` in its level base frame, for states (T, D) of the frame method.

    up: unit vector (3,), camera frame. travel: direction of travel, camera frame, (3,) or (T, 3), of which the level
    part counts; None: from the first to the last place of the root, or the way the animal faces where that is short.
    All links keep their directions in space exactly (dim 3); of the two angle pairs for a direction, and of their
    turns, it is the one nearer to that of the skeleton without roll. dim 2: the thetas, the chain turned into the
    sagittal plane.
    """
    R = euler_rotation(states[:, skeleton.euler_slice])
    down = -up / np.linalg.norm(up)
    heading = _direction_of_travel(skeleton, states, R, down) if travel is None else np.asarray(travel, float)
    heading = heading - (heading @ down)[..., None] * down
    heading = np.broadcast_to(heading / np.linalg.norm(heading, axis=-1, keepdims=True), (len(states), 3))
    R_base_local = upright_rotation(heading, -down).transpose(0, 2, 1) @ R

    links = _path(skeleton)
    free = _angle_index(skeleton, links)
    zero = np.zeros(len(states))
    theta, phi = (
        np.cumsum([zero if k is None else states[:, where][:, k] for k in free], axis=0).T
        for where in (skeleton.theta_slice, skeleton.phi_slice)
    )
    local = np.stack([np.cos(theta) * np.cos(phi), np.sin(theta), np.cos(theta) * np.sin(phi)], axis=-1)
    U = R_base_local[:, None, :, 0]
    T, P = _angles_near(
        local @ R_base_local.transpose(0, 2, 1),
        theta + np.arcsin(np.clip(U[..., 1], -1, 1)),
        phi + np.arctan2(U[..., 2], U[..., 0]),
    )
    joints = [np.diff(sums, axis=1, prepend=0.0) for sums in (T, P)]
    return joints[0] if dim == 2 else np.concatenate(joints, axis=1)


def _angles_near(directions: Array, theta: Array, phi: Array) -> tuple[Array, Array]:
    """T, P (T, L) of unit vectors (T, L, 3), nearest to theta, phi (T, L)."""
    T = np.arcsin(np.clip(directions[..., 1], -1, 1))
    P = np.arctan2(directions[..., 2], directions[..., 0])
    pairs = [
        (theta + np.angle(np.exp(1j * (t - theta))), phi + np.angle(np.exp(1j * (p - phi))))
        for t, p in ((T, P), (np.pi - T, P + np.pi))
    ]
    # Phi counts as far as it turns the link.
    far = [(t - theta) ** 2 + (np.cos(t) * (p - phi)) ** 2 for t, p in pairs]
    first = far[0] <= far[1]
    return np.where(first, pairs[0][0], pairs[1][0]), np.where(first, pairs[0][1], pairs[1][1])


def _direction_of_travel(skeleton: Skeleton, states: Array, R: Array, down: Array) -> Array:
    """(3,), camera frame, level."""
    known = np.isfinite(states).all(axis=1)
    if not known.any():
        return np.full(3, np.nan)
    root = np.einsum("tij,tj->ti", R[known], states[known][:, skeleton.place_slice])
    chord = root[-1] - root[0]
    chord = chord - (chord @ down) * down
    if np.linalg.norm(chord) >= _TRAVEL_M:
        return chord
    facing = R[known, :, 0].mean(axis=0)
    return facing - (facing @ down) * down


def _path(skeleton: Skeleton) -> list[int]:
    """Indices of the links from the root to the foot that hangs from the front end of the spine."""
    into = {link.end: i for i, link in enumerate(skeleton.links)}
    for foot in skeleton.body.feet:
        links, joint = [], foot
        while joint in into:
            links.insert(0, into[joint])
            joint = skeleton.links[links[0]].start
        if any(skeleton.links[i].end == skeleton.forward[1] for i in links):
            return links
    raise ValueError(f"{skeleton.name} has no leg beyond {skeleton.forward[1]}")


def _angle_index(skeleton: Skeleton, links: list[int]) -> list[int | None]:
    """Where links have their theta among the thetas, None for a link without."""
    free = [i for i, link in enumerate(skeleton.links) if link.free]
    return [free.index(i) if i in free else None for i in links]
