"""Describe serial chains as trees (`recon.geometry.kinematics`) with a single branch and joint limits.

There are three ways to make a chain. In the chains of C. van der Leek (2022), each angle is relative to the previous
link, and the angles add up. T_k and P_k are the sums up to link k, and r_k is its length. In two dimensions
(`planar_chain`) link k adds r_k (cos T_k, sin T_k). In three (`summed_chain`), with q = [theta..., phi...], it adds

    r_k (cos T_k cos P_k,  sin T_k,  cos T_k sin P_k)

in the base frame UVW of `recon.animal.chain`. The joints of a `joint_chain` turn about axes in space, or slide along
them. The axes are given for all joints at 0, as in Denavit-Hartenberg tables, robots' legs and URDF files. All three
kinds are trees, so positions, Jacobians and second derivatives have one implementation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from recon.animal.chain import UVW_BODY
from recon.base.arrays import Array, Bools, Index
from recon.geometry.kinematics import AXES, Marker, Moved, Segment, Tree, derivatives_of

Curvature = Callable[[Array], Array]
Limits = tuple[ArrayLike, ArrayLike]
"""Lower and upper limits of a chain's joints, rad or m, each as one number or as one number for each joint."""
FREE: Limits = (-np.inf, np.inf)
MAX_RATE_RAD_S = 50.0
"""Default maximum rate of a chain's joints, rad/s."""


@dataclass(frozen=True, eq=False)
class SerialChain:
    """A chain with n joints in dim dimensions, with its base at the origin.

    Joint angles q have the shape (n,) or, for many configurations at once, (..., n). They are in rad, or in metres for
    joints that slide.
    """

    tree: Tree
    """Kinematic tree with a single branch, whose only marker is the end effector."""
    columns: Index
    """Indices of the joints among the unknowns of the tree's state, shape (n,)."""
    names: tuple[str, ...]
    """Names of the n joints."""
    groups: tuple[tuple[int, ...], ...]
    """Indices of the joints in their order along the chain, one tuple for each kind of angle."""
    lower_rad: Array
    """Lower limits of the joints, shape (n,), rad; metres for joints that slide."""
    upper_rad: Array
    """Upper limits of the joints, shape (n,), rad; metres for joints that slide."""
    max_rate_rad_s: Array
    """Largest allowed or expected rates of the joints, shape (n,), rad/s or m/s."""
    base: Array = field(default_factory=lambda: np.eye(3))
    """Rotation from the axes of the tree's world to the axes of the base frame, shape (dim, 3)."""
    tool_rotation: Array = field(default_factory=lambda: np.eye(3))
    """Rotation of the end effector relative to the last link, shape (3, 3)."""
    _latest: dict[bytes, Moved] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        if not np.all(self.lower_rad <= self.upper_rad):
            raise ValueError("a lower limit is above the upper limit")
        if not np.all(np.isfinite(self.max_rate_rad_s) & (self.max_rate_rad_s > 0)):
            raise ValueError("rate limits must be positive and finite")

    @property
    def n(self) -> int:
        """Return the number of joints."""
        return len(self.columns)

    @property
    def dim(self) -> int:
        """Return the number of dimensions, 2 or 3."""
        return len(self.base)

    def positions(self, q: Array) -> Array:
        """Return the positions (..., L + 1, dim) of the chain's joints and its end effector for q (..., n), metres."""
        states = self._states(q)
        points = np.concatenate([self.tree.origins(states)[:, self._moving], self.tree.pose(states).points_m], axis=1)
        return (points @ self.base.T).reshape(*q.shape[:-1], -1, self.dim)

    def end(self, q: Array) -> Array:
        """Return the position (..., dim) of the end effector in the base frame for joint angles q (..., n), metres."""
        if q.ndim == 1:
            return (0.0 + self._moved(q)[0][..., 0] @ self.base.T).reshape(self.dim)  # the root is at the origin
        return (self.tree.pose(self._states(q)).points_m[:, 0] @ self.base.T).reshape(*q.shape[:-1], self.dim)

    def pose(self, q: Array) -> tuple[Array, Array]:
        """Return the rotation (3, 3) and position (3,) of T_base_end, the end effector's pose in space, for q (n,)."""
        return self.base @ self.tree.orientations(self._states(q))[0, -1] @ self.tool_rotation, self.end(q)

    def inside_limits(self, q: Array) -> Array:
        """Return the angles within the limits that are closest to q (..., n)."""
        return np.minimum(np.maximum(q, self.lower_rad), self.upper_rad)

    def derivatives(self, q: Array) -> tuple[Array, Curvature]:
        """Return the Jacobian (dim, n) of the end effector, and its curvature.

        The curvature is a function of mu (dim,). It returns the sum (n, n) of mu_i times the Hessian of coordinate i.
        """
        jacobian, _, curvature = derivatives_of(self.tree, self._moved(q))

        def weighted_curvature(mu: Array) -> Array:
            return curvature(mu[None] @ self.base)[np.ix_(self.columns - 3, self.columns - 3)]

        return self.base @ jacobian[0][:, self.columns], weighted_curvature

    def jacobian(self, q: Array) -> Array:
        """Return the Jacobian (..., dim, n) of the end effector, for q (..., n)."""
        jacobian = self.tree.pose_with_jacobian(self._states(q)).jacobian[:, 0]
        return (self.base @ jacobian[..., self.columns]).reshape(*q.shape[:-1], self.dim, self.n)

    def joint_axes(self, q: Array) -> Array:
        """Return unit vectors (n, 3) along the joint axes, in the base frame, of a chain that `joint_chain` made."""
        return self._moved(q)[1][..., 0].copy()

    def geometric_jacobian(self, q: Array) -> Array:
        """Return the geometric Jacobian (6, n) of a chain that `joint_chain` made.

        Its rows are the velocity (m/s) and the angular velocity (rad/s) of the end effector.
        """
        jacobian, axes, _ = derivatives_of(self.tree, self._moved(q))
        return np.concatenate([jacobian[0, :, self.columns].T, axes.T * ~self.sliding])

    def _moved(self, q: Array) -> Moved:
        """Move the tree to q (n,), and cache the result for this q because a step begins where the last one ended."""
        key = q.tobytes()
        moved = self._latest.get(key)
        if moved is None:
            moved = self.tree.moved(self._states(q), np.ones(1))
            self._latest.clear()
            self._latest[key] = moved
        return moved

    def _states(self, q: Array) -> Array:
        """Return the states (N, D) of the tree for q (..., n)."""
        states = np.zeros((q.size // self.n, self.tree.n_state))
        states[:, self.columns] = q.reshape(-1, self.n)
        return states

    @cached_property
    def sliding(self) -> Bools:
        """Return whether each joint slides along its axis, shape (n,)."""
        return np.array(["s" in self.tree.axes[column - 3] for column in self.columns])

    @cached_property
    def _moving(self) -> Index:
        """Return the indices of the segments that have joints."""
        return np.array([i for i, segment in enumerate(self.tree.segments) if AXES[segment.joint]])

    @cached_property
    def lengths_m(self) -> Array:
        """Return the distances (L,) between consecutive joints, and from the last joint to the end effector, metres.

        Joints that slide are taken at 0.
        """
        return np.linalg.norm(np.diff(self.positions(np.zeros(self.n)), axis=0), axis=1)

    @cached_property
    def joint_lengths_m(self) -> Array:
        """Return the length (n,) of the link that each joint turns, metres.

        The link ends at the next position along the chain that differs from the joint's. Its length is 0 if no position
        differs.
        """
        lengths = self.lengths_m.copy()
        for k in range(len(lengths) - 2, -1, -1):
            if lengths[k] == 0:
                lengths[k] = lengths[k + 1]
        joints = [len(AXES[self.tree.segments[i].joint]) for i in self._moving]
        return np.repeat(lengths, joints)[self.columns - 3]

    @cached_property
    def reach_m(self) -> tuple[float, float]:
        """Return the smallest and the largest distance of the end effector from the base, by the triangle inequality.

        A chain in space may not reach every distance between the two. A chain with joints that slide has no bounds.
        """
        if self.sliding.any():
            return 0.0, math.inf
        hops = np.append(np.linalg.norm(self.positions(np.zeros(self.n))[0]), self.lengths_m)
        return max(0.0, float(2 * hops.max() - hops.sum())), float(hops.sum())


def mobility(bodies: int, freedoms: Sequence[int], body_freedoms: Literal[3, 6] = 6) -> int:
    """Return the degrees of freedom of a mechanism by Grübler's formula.

    The result is b (bodies - 1 - joints) plus the freedoms of all joints. The formula holds if the constraints are
    independent.

    Parameters
    ----------
    bodies
        Number of bodies, including the ground.
    freedoms
        Degrees of freedom of each joint: 1 for a hinge, 2 for a universal joint, 6 for a free body.
    body_freedoms
        b, the degrees of freedom of a free body: 6 in space, 3 in a plane.
    """
    return body_freedoms * (bodies - 1 - len(freedoms)) + sum(freedoms)


def planar_chain(
    lengths_m: ArrayLike, limits_rad: Limits = FREE, max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S
) -> SerialChain:
    """Return a chain of links in a plane, with angles q (L,) that are 0 along +x and positive towards +y.

    See `summed_chain` for the parameters.
    """
    return summed_chain(lengths_m, limits_rad, max_rate_rad_s, dim=2)


def summed_chain(
    lengths_m: ArrayLike,
    limits_rad: Limits = FREE,
    max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S,
    dim: Literal[2, 3] = 3,
) -> SerialChain:
    """Return a chain of universal joints in space whose angles add up, in the base frame UVW.

    Parameters
    ----------
    lengths_m
        Lengths (L,) of the links, metres.
    limits_rad
        Lower and upper limits, rad, each one number or one for each joint.
    max_rate_rad_s
        Largest rates, rad/s, one number or one for each joint.
    dim
        3 for q (2 L,) = [theta..., phi...]; 2 for the thetas alone.

    Raises
    ------
    ValueError
        If a length is not positive, or a limit or rate is not valid.
    """
    lengths = np.array(lengths_m, float)
    if lengths.ndim != 1 or not len(lengths) or not np.all(np.isfinite(lengths) & (lengths > 0)):
        raise ValueError(f"expected positive lengths (L,), got {lengths_m}")
    L, along = len(lengths), [(float(x), 0.0, 0.0) for x in (0.0, *lengths)]
    ends = ["base", *(f"link_{k}" for k in range(1, L + 1))]
    links = [Segment(ends[k + 1], ends[k], "summed", along[k]) for k in range(L)]
    tree = Tree((Segment("base", None, "fixed"), *links), (Marker("end", ends[-1], along[-1]),))
    # The tree has the phi and then the theta of every link.
    phi = 3 + 2 * np.arange(L)
    columns = np.concatenate([phi + 1, phi])[: L * (dim - 1)]
    groups = tuple(tuple(range(k * L, (k + 1) * L)) for k in range(dim - 1))
    names = tuple(tree.state_names[column] for column in columns)
    limits = values_by_joint(len(columns), *limits_rad, max_rate_rad_s)
    return SerialChain(tree, columns, names, groups, *limits, base=UVW_BODY[:dim])


def joint_chain(
    offsets_m: ArrayLike,
    axes: ArrayLike,
    sliding: ArrayLike = False,
    tool_m: ArrayLike = (0.0, 0.0, 0.0),
    tool_rotation: Rotation | None = None,
    limits_rad: Limits = FREE,
    max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S,
    names: tuple[str, ...] | None = None,
) -> SerialChain:
    """Return a chain of n joints in space, with q (n,) in radians, or in metres for joints that slide.

    The chain is described in the axes of its base, with all joints at 0.

    Parameters
    ----------
    offsets_m
        Position (n, 3) of each joint relative to the previous joint, metres.
    axes
        Axes (n, 3) of the joints, of any length.
    sliding
        Whether joints slide along their axes, one value or (n,).
    tool_m, tool_rotation
        Position (3,) in metres and rotation of the end effector, relative to the last joint.
    limits_rad
        Lower and upper limits, rad or metres, each one number or one for each joint.
    max_rate_rad_s
        Largest rates, rad/s or m/s, one number or one for each joint.
    names
        Names (n,) of the joints; None for "joint 1", "joint 2" and so on.

    Raises
    ------
    ValueError
        If shapes do not match, a number is not finite, an axis is zero, or a limit or rate is not valid.
    """
    offsets, axes, tool = (np.array(x, float) for x in (offsets_m, axes, tool_m))
    n = len(offsets)
    if not n or offsets.shape != (n, 3) or axes.shape != (n, 3) or tool.shape != (3,):
        shapes = offsets.shape, axes.shape, tool.shape
        raise ValueError(f"expected offsets (n, 3), axes (n, 3) and a tool (3,), got the shapes {shapes}")
    sizes = np.linalg.norm(axes, axis=1)
    if not all(np.isfinite(x).all() for x in (offsets, axes, tool)) or not (sizes > 0).all():
        raise ValueError("offsets, axes and tool must be finite, and no axis may be zero")
    # The z axis of each joint's frame is the joint's axis. `back` turns vectors from the base's axes into each frame.
    to_z = np.array([_with_z_along(axis) for axis in axes / sizes[:, None]])
    back = np.concatenate([np.eye(3)[None], to_z]).transpose(0, 2, 1)
    segments = [Segment("base", None, "fixed")]
    for j, slides in enumerate(np.broadcast_to(sliding, n).tolist()):
        kind: Literal["turn", "slide"] = "slide" if slides else "turn"
        offset, rotation = _triple(back[j] @ offsets[j]), tuple(map(_triple, back[j] @ to_z[j]))
        segments.append(Segment(f"joint_{j + 1}", segments[-1].name, kind, offset, rotation))
    tree = Tree(tuple(segments), (Marker("end", segments[-1].name, _triple(back[n] @ tool)),))
    end = back[n] if tool_rotation is None else back[n] @ tool_rotation.as_matrix()
    names = tuple(f"joint {j + 1}" for j in range(n)) if names is None else names
    columns, groups, limits = 3 + np.arange(n), (tuple(range(n)),), values_by_joint(n, *limits_rad, max_rate_rad_s)
    return SerialChain(tree, columns, names, groups, *limits, tool_rotation=end)


def values_by_joint(n: int, *numbers: ArrayLike) -> list[Array]:
    """Expand each argument, one number or one for each joint, to an array (n,)."""
    return [np.array(np.broadcast_to(number, n), float) for number in numbers]


def _triple(v: Array) -> tuple[float, float, float]:
    x, y, z = v.tolist()
    return x, y, z


def _with_z_along(z: Array) -> Array:
    """Return a rotation (3, 3) whose z axis is the given unit vector (3,); the identity for the z axis itself."""
    x = np.eye(3)[np.argmin(np.abs(z))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.asarray(np.cross(z, x), dtype=float), z])


def unreachable(chain: SerialChain, target_m: Array, tolerance_m: float = 0.0) -> str:
    """Return why the end effector cannot come within the tolerance of a target (dim,) in metres, or "" if it might."""
    if not np.isfinite(target_m).all():
        return "unreachable: the target is not finite"
    distance, (nearest, farthest) = float(np.linalg.norm(target_m)), chain.reach_m
    if nearest - tolerance_m <= distance <= farthest + tolerance_m:
        return ""
    reach = f"{nearest:.3f} to {farthest:.3f} m"
    return f"unreachable: the target is {distance:.3f} m from the base, and the chain reaches {reach}"


def manipulability(J: Array) -> Array:
    """Return the manipulability sqrt(det J J') (Yoshikawa 1985) of a Jacobian J (..., dim, n).

    The manipulability is 0 if the end effector cannot move in some direction.
    """
    return np.sqrt(np.maximum(0.0, np.linalg.det(J @ J.swapaxes(-1, -2))))


def null_basis(J: Array) -> Array:
    """Return an orthonormal basis N (n, n - dim) of the null space of J (dim, n), with J N = 0."""
    return np.asarray(np.linalg.qr(J.T, mode="complete")[0][:, len(J) :], float)
