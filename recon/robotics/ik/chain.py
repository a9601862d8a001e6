"""Serial chains: a tree (`recon.geometry.kinematics`) of one branch, with the limits of its joints.

Three ways to make one. The publication's chains have angles that are relative to the link before and add up; T_k, P_k
are the sums up to link k, r_k its length. In two dimensions (`planar_chain`) link k adds r_k (cos T_k, sin T_k), in
three (`summed_chain`), with q = [theta..., phi...],

    r_k (cos T_k cos P_k,  sin T_k,  cos T_k sin P_k)

in the base frame UVW of `recon.animal.chain`. `joint_chain` has joints in space, each placed rigidly on the link
before it, which turn about their axes or slide along them: tables of Denavit and Hartenberg, legs, URDF files.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from recon.animal.chain import UVW_BODY
from recon.base.arrays import Array, Bools, Index
from recon.geometry.kinematics import AXES, Marker, Segment, Tree

Curvature = Callable[[Array], Array]
"""mu (dim,) -> sum_i mu_i Hess f_i (n, n)."""
Limits = tuple[ArrayLike, ArrayLike]
"""Lower and upper."""

MAX_RATE_RAD_S = 50.0
"""Where a chain has no rate limit of its own."""


@dataclass(frozen=True, eq=False)
class SerialChain:
    """A chain with n joints in dim dimensions, its base at the origin. Joint angles q are (n,) or, for many
    configurations at once, (..., n): rad, and metres of joints that slide."""

    tree: Tree
    """Of one branch, with one marker: the end effector."""
    columns: Index
    """(n,): where the tree's state has the joints."""
    lower_rad: Array
    """(n,); metres for joints that slide, as of all limits."""
    upper_rad: Array
    """(n,)"""
    max_rate_rad_s: Array
    """(n,), finite."""
    names: tuple[str, ...]
    """(n,): what the joints are called."""
    groups: tuple[tuple[int, ...], ...]
    """The joints that follow each other along the chain, one tuple for each kind of angle."""
    base: Array
    """(dim, 3): from the axes of the tree's world to those of the base frame."""
    tool_rotation: Array
    """(3, 3): of the end effector on the last link."""

    @classmethod
    def of(
        cls,
        tree: Tree,
        columns: Index,
        limits_rad: Limits | None = None,
        max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S,
        groups: tuple[tuple[int, ...], ...] | None = None,
        base: Array | None = None,
        tool_rotation: Array | None = None,
        names: tuple[str, ...] | None = None,
    ) -> SerialChain:
        """limits_rad: lower and upper, each one number or (n,); max_rate_rad_s: one or (n,); groups: None: all joints
        are of one kind; names: None: those of the tree's state. Raises ValueError."""
        n = len(columns)
        lower, upper = (-np.inf, np.inf) if limits_rad is None else limits_rad
        lower, upper, rate = (np.array(np.broadcast_to(x, n), float) for x in (lower, upper, max_rate_rad_s))
        if not np.all(lower <= upper):
            raise ValueError("a lower limit is above the upper one")
        if not np.all(np.isfinite(rate) & (rate > 0)):
            raise ValueError("rate limits must be positive and finite")
        groups = (tuple(range(n)),) if groups is None else groups
        base, tool = (np.eye(3) if rotation is None else rotation for rotation in (base, tool_rotation))
        names = tuple(tree.state_names[column] for column in columns) if names is None else names
        return cls(tree, columns, lower, upper, rate, names, groups, base, tool)

    @property
    def n(self) -> int:
        return len(self.columns)

    @property
    def dim(self) -> int:
        return len(self.base)

    # -- where it is -------------------------------------------------------------------------------------------------

    def positions(self, q: Array) -> Array:
        """The joints' places along the chain and, last, the end effector (..., ., dim), metres."""
        states = self._states(q)
        points = np.concatenate([self.tree.origins(states)[:, self._moving], self.tree.pose(states).points_m], axis=1)
        return (points @ self.base.T).reshape(*q.shape[:-1], -1, self.dim)

    def end(self, q: Array) -> Array:
        """The end effector (..., dim), metres."""
        if q.ndim == 1:
            return self._moved(q)[0]
        return (self.tree.pose(self._states(q)).points_m[:, 0] @ self.base.T).reshape(*q.shape[:-1], self.dim)

    def frames(self, q: Array) -> Array:
        """Of a chain of `joint_chain` (N, n, 3, 3), for q (N, n): the frames that the joints move, each with its
        joint's axis as z, in the base frame."""
        return (self.base @ self.tree.orientations(self._states(q)))[:, self._moving]

    def pose(self, q: Array) -> tuple[Array, Array]:
        """Of a chain in space, T_base_end: rotation (3, 3) and position (3,) of the end effector, for q (n,)."""
        return self.base @ self.tree.orientations(self._states(q))[0, -1] @ self.tool_rotation, self.end(q)

    # -- how it moves, for q (n,) ------------------------------------------------------------------------------------

    def derivatives(self, q: Array) -> tuple[Array, Curvature]:
        """The end effector's Jacobian (dim, n), and its curvature, which is worked out where it is asked for."""
        pick = np.ix_(self.columns - 3, self.columns - 3)
        of_tree = cache(lambda: self.tree.derivatives(self._states(q)[0])[2])

        def curvature(mu: Array) -> Array:
            return of_tree()(mu[None] @ self.base)[pick]

        return self.jacobian(q), curvature

    def jacobian(self, q: Array) -> Array:
        """(dim, n) of the end effector."""
        return self._moved(q)[1]

    def hessian(self, q: Array) -> Array:
        """(dim, n, n)"""
        curvature = self.derivatives(q)[1]
        return np.stack([curvature(axis) for axis in np.eye(self.dim)])

    def joint_axes(self, q: Array) -> Array:
        """Of a chain of `joint_chain` (n, 3): unit vectors along the joints' axes, in the base frame."""
        return self.tree.derivatives(self._states(q)[0])[1]

    def geometric_jacobian(self, q: Array) -> Array:
        """Of a chain of `joint_chain` (6, n): velocity (m/s) and angular velocity (rad/s) of the end effector."""
        jacobian, axes, _ = self.tree.derivatives(self._states(q)[0])
        return np.concatenate([jacobian[0, :, self.columns].T, axes.T * ~self.sliding])

    def _states(self, q: Array) -> Array:
        """(N, D)"""
        states = np.zeros((q.size // self.n, self.tree.n_state))
        states[:, self.columns] = q.reshape(-1, self.n)
        return states

    # -- one configuration, in floats: numpy takes as long for one of so few numbers as all of this does -----------

    @cached_property
    def _steps(self) -> list[tuple[str, tuple[float, ...], tuple[tuple[float, ...], ...] | None, list[int]]]:
        """Of each segment its joint, offset and rotation, and which of the joints turn it about z, y, x; -1: none."""
        joint_of = {int(column): j for j, column in enumerate(self.columns)}
        steps, column = [], 3
        for segment in self.tree.segments:
            turning = [joint_of.get(k, -1) for k in range(column, column + len(AXES[segment.joint]))]
            column += len(turning)
            steps.append((segment.joint, segment.offset_m, segment.rotation, turning))
        return steps

    def _moved(self, q: Array) -> tuple[Array, Array]:
        """The end effector (dim,) and its Jacobian (dim, n) for q (n,)."""
        angles = [*q.tolist(), 0.0]
        place, x, y, z = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
        moving = []  # (joint, whether it turns, axis, place of a joint that turns)
        links = []  # of summed joints: (of theta, of phi, own axis of theta, place)
        theta = phi = 0.0
        for joint, offset, rotation, turning in self._steps:
            place = _combined(place, offset, x, y, z)
            if joint == "summed":
                phi, theta = phi + angles[turning[0]], theta + angles[turning[1]]
                c, s, ct, st = math.cos(phi), math.sin(phi), math.cos(theta), math.sin(theta)
                x, y, z = (c * ct, s * ct, -st), (-s, c, 0.0), (c * st, s * st, ct)
                links.append((turning[1], turning[0], y, place))
                continue
            if rotation is not None:
                x, y, z = (_combined((0.0, 0.0, 0.0), column, x, y, z) for column in zip(*rotation, strict=True))
            for axis, j in zip(AXES[joint], turning, strict=True):
                if axis == "s":
                    place = _combined(place, (0.0, 0.0, angles[j]), x, y, z)
                    moving.append((j, False, z, place))
                    continue
                c, s = math.cos(angles[j]), math.sin(angles[j])
                moving.append((j, True, {"x": x, "y": y, "z": z}[axis], place))
                if axis == "z":
                    x, y = _mixed(x, y, c, s), _mixed(y, x, c, -s)
                elif axis == "y":
                    z, x = _mixed(z, x, c, s), _mixed(x, z, c, -s)
                else:
                    y, z = _mixed(y, z, c, s), _mixed(z, y, c, -s)
        end = _combined(place, self.tree.markers[0].offset_m, x, y, z)
        columns = [(0.0, 0.0, 0.0)] * (self.n + 1)
        for j, turns, axis, at in moving:
            columns[j] = _cross(axis, _less(end, at)) if turns else axis
        swept, tip = (0.0, 0.0, 0.0), end
        for of_theta, of_phi, axis, at in reversed(links):
            along = _cross(axis, _less(tip, at))  # theta turns each later link about that link's own axis
            swept, tip = (swept[0] + along[0], swept[1] + along[1], swept[2] + along[2]), at
            columns[of_theta], columns[of_phi] = swept, (at[1] - end[1], end[0] - at[0], 0.0)
        return self.base @ end, self.base @ np.array(columns[: self.n]).T

    # -- how long it is ----------------------------------------------------------------------------------------------

    @cached_property
    def sliding(self) -> Bools:
        """(n,): the joints that slide along their axes."""
        return np.array(["s" in self.tree.axes[column - 3] for column in self.columns])

    @cached_property
    def _moving(self) -> Index:
        """The segments with joints."""
        return np.array([i for i, segment in enumerate(self.tree.segments) if AXES[segment.joint]])

    @cached_property
    def lengths_m(self) -> Array:
        """(L,): from each place with joints to the next, the last to the end effector, with nothing slid out."""
        return np.linalg.norm(np.diff(self.positions(np.zeros(self.n)), axis=0), axis=1)

    @cached_property
    def joint_lengths_m(self) -> Array:
        """(n,): of the link that each joint turns, to the next place along the chain that is not the joint's own; 0
        where there is none."""
        lengths = self.lengths_m.copy()
        for k in range(len(lengths) - 2, -1, -1):
            if lengths[k] == 0:
                lengths[k] = lengths[k + 1]
        joints = [len(AXES[self.tree.segments[i].joint]) for i in self._moving]
        return np.repeat(lengths, joints)[self.columns - 3]

    @cached_property
    def reach_m(self) -> tuple[float, float]:
        """Bounds of the end effector's distance from the base, which no angles leave. From the triangle inequality: of
        a chain in space not every distance between has to be reached."""
        zero = np.zeros(self.n)
        places, frames = self.positions(zero), self.tree.orientations(self._states(zero))[0, self._moving]
        hops = [(float(np.linalg.norm(places[0])),) * 2]
        for k, (length, i) in enumerate(zip(self.lengths_m.tolist(), self._moving, strict=True)):
            if self.tree.segments[i].joint != "slide":
                hops.append((length, length))
                continue
            # The next place is start + q z in this joint's frame before it slides.
            start = (places[k + 1] - places[k]) @ frames[k]
            across, low, high = math.hypot(*start[:2]), start[2] + self.lower_rad[k], start[2] + self.upper_rad[k]
            nearest = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
            hops.append((math.hypot(across, nearest), math.hypot(across, max(abs(low), abs(high)))))
        shortest, longest = np.array(hops).T
        others = [longest[np.arange(len(hops)) != k].sum() for k in range(len(hops))]
        return max(0.0, float((shortest - others).max())), float(longest.sum())


_Vector = tuple[float, float, float]


def _combined(start: _Vector, of: tuple[float, ...], x: _Vector, y: _Vector, z: _Vector) -> _Vector:
    """start + of[0] x + of[1] y + of[2] z."""
    a, b, c = of
    return (
        start[0] + a * x[0] + b * y[0] + c * z[0],
        start[1] + a * x[1] + b * y[1] + c * z[1],
        start[2] + a * x[2] + b * y[2] + c * z[2],
    )


def _mixed(u: _Vector, v: _Vector, c: float, s: float) -> _Vector:
    """c u + s v."""
    return c * u[0] + s * v[0], c * u[1] + s * v[1], c * u[2] + s * v[2]


def _less(u: _Vector, v: _Vector) -> _Vector:
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


def _cross(u: _Vector, v: _Vector) -> _Vector:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


# -- chains that are made --------------------------------------------------------------------------------------------


def mobility(bodies: int, freedoms: Sequence[int], of_a_body: Literal[3, 6] = 6) -> int:
    """Grübler's count of what a mechanism is free to do: b (bodies - 1 - joints) + the joints' freedoms.

    bodies: with the ground; freedoms: of every joint, of a hinge 1, of a universal joint 2, of a free body 6;
    of_a_body: b, 6 in space, 3 in a plane. It takes constraints for independent of each other.
    """
    return of_a_body * (bodies - 1 - len(freedoms)) + sum(freedoms)


def planar_chain(
    lengths_m: ArrayLike, limits_rad: Limits | None = None, max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S
) -> SerialChain:
    """Links in a plane: q (L,), angle 0 along +x, positive towards +y, of lengths_m (L,). Limits and rates as
    `SerialChain.of`. Raises ValueError."""
    return _summed(lengths_m, 2, limits_rad, max_rate_rad_s)


def summed_chain(
    lengths_m: ArrayLike, limits_rad: Limits | None = None, max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S
) -> SerialChain:
    """Universal joints in space whose angles add up: q (2 L,) = [theta..., phi...], base frame UVW, of lengths_m (L,).
    Limits and rates as `SerialChain.of`. Raises ValueError."""
    return _summed(lengths_m, 3, limits_rad, max_rate_rad_s)


def _summed(
    lengths_m: ArrayLike, dim: Literal[2, 3], limits_rad: Limits | None, max_rate_rad_s: ArrayLike
) -> SerialChain:
    lengths = np.array(lengths_m, float)
    if lengths.ndim != 1 or not len(lengths) or not np.all(np.isfinite(lengths) & (lengths > 0)):
        raise ValueError(f"positive lengths (L,) expected, got {lengths_m}")
    L, along = len(lengths), [(float(x), 0.0, 0.0) for x in (0.0, *lengths)]
    names = ["base", *(f"link_{k}" for k in range(1, L + 1))]
    links = [Segment(names[k + 1], names[k], "summed", along[k]) for k in range(L)]
    tree = Tree((Segment("base", None, "fixed"), *links), (Marker("end", names[-1], along[-1]),))
    # Of every link the tree has phi, then theta.
    phi = 3 + 2 * np.arange(L)
    columns = np.concatenate([phi + 1, phi])[: L * (dim - 1)]
    groups = tuple(tuple(range(k * L, (k + 1) * L)) for k in range(dim - 1))
    return SerialChain.of(tree, columns, limits_rad, max_rate_rad_s, groups, UVW_BODY[:dim])


def joint_chain(
    offsets_m: ArrayLike,
    axes: ArrayLike,
    rotations: Rotation | None = None,
    sliding: ArrayLike = False,
    tool_m: ArrayLike = (0.0, 0.0, 0.0),
    tool_rotation: Rotation | None = None,
    limits_rad: Limits | None = None,
    max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S,
    names: tuple[str, ...] | None = None,
) -> SerialChain:
    """n joints in space: q (n,), rad, or metres of those that slide.

    offsets_m (n, 3), rotations (n): each joint's place on the link before it, None: not turned; axes (n, 3): in its own
    frame; sliding: one or (n,), which slide along their axes; tool_m (3,), tool_rotation: the end effector on the last
    link; names: None: joint 1 and so on; limits and rates as `SerialChain.of`. Raises ValueError.
    """
    offsets, axes, tool = (np.array(x, float) for x in (offsets_m, axes, tool_m))
    n = len(offsets)
    if not n or offsets.shape != (n, 3) or axes.shape != (n, 3) or tool.shape != (3,):
        raise ValueError(f"offsets and axes (n, 3) and a tool (3,) expected: {offsets.shape}, {axes.shape}")
    sizes = np.linalg.norm(axes, axis=1)
    if not all(np.isfinite(x).all() for x in (offsets, axes, tool)) or not (sizes > 0).all():
        raise ValueError("offsets, axes and tool must be finite, and no axis zero")
    turned = np.tile(np.eye(3), (n, 1, 1)) if rotations is None else rotations.as_matrix()
    if turned.shape != (n, 3, 3):
        raise ValueError(f"{n} rotations expected, got {turned.shape}")
    # Frames whose z axes are the joints': what hangs on one of them is turned back first.
    to_z = np.array([_with_z_along(axis) for axis in axes / sizes[:, None]])
    before = np.concatenate([np.eye(3)[None], to_z]).transpose(0, 2, 1)
    segments = [Segment("base", None, "fixed")]
    for j, slides in enumerate(np.broadcast_to(sliding, n).tolist()):
        placed = before[j] @ turned[j] @ to_z[j]
        kind: Literal["turn", "slide"] = "slide" if slides else "turn"
        offset, rotation = _triple(before[j] @ offsets[j]), tuple(map(_triple, placed))
        segments.append(Segment(f"joint_{j + 1}", segments[-1].name, kind, offset, rotation))
    tree = Tree(tuple(segments), (Marker("end", segments[-1].name, _triple(before[n] @ tool)),))
    end = before[n] if tool_rotation is None else before[n] @ tool_rotation.as_matrix()
    names = tuple(f"joint {j + 1}" for j in range(n)) if names is None else names
    return SerialChain.of(tree, 3 + np.arange(n), limits_rad, max_rate_rad_s, tool_rotation=end, names=names)


def _triple(v: Array) -> tuple[float, float, float]:
    x, y, z = v.tolist()
    return x, y, z


def _with_z_along(z: Array) -> Array:
    """A rotation (3, 3) whose z axis is the given unit vector (3,); none for the z axis itself."""
    x = np.eye(3)[np.argmin(np.abs(z))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.asarray(np.cross(z, x), dtype=float), z])


# -- what is asked of them -------------------------------------------------------------------------------------------


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
    N = np.asarray(np.linalg.qr(J.T, mode="complete")[0][:, len(J) :], float)
    if like is None:
        return N
    u, _, vt = np.linalg.svd(N.T @ like)
    return N @ u @ vt
