"""Serial chains: a tree (`recon.geometry.kinematics`) of one branch, with the limits of its joints; and what an
animal gives: its chains, from the root of a skeleton to a foot, their joint angles in a reconstruction, and a stride as
a task.

Three ways to make one. The publication's chains have angles that are relative to the link before and add up; T_k, P_k
are the sums up to link k, r_k its length. In two dimensions (`planar_chain`) link k adds r_k (cos T_k, sin T_k), in
three (`summed_chain`), with q = [theta..., phi...],

    r_k (cos T_k cos P_k,  sin T_k,  cos T_k sin P_k)

in the base frame UVW of `recon.animal.chain`. `joint_chain` has joints in space, which turn about their axes or slide
along them, as they are placed with all of them at 0: tables of Denavit and Hartenberg, legs, URDF files.

An animal's chains sit in a level base frame at the root. The spine-front-leg chain of the 8U skeleton and planar chains
have U along the direction of travel, V down, W to the side, right-handed; the planar chains' x and y are U and V. The
spine's first link, which has no angles of its own in the skeleton (it lies on the skeleton's U), is free here: the
angles follow from the rotation of the skeleton. The chains of whole animals have x along the direction of travel, y
left, z up, as `recon.geometry.kinematics`.

A stride is the closed path of the end effector. Between the frames the end effector, relative to the base, follows a
cubic spline (angles can jump where two of them say the same, its place does not). A stride begins at a frame, where the
angles are known, and ends when it does: rounded to frames, one of nine is wrong by up to a ninth, and leaves a gap as
wide as the foot moves in a frame.

It begins at the frame next to where it is told to, the touchdown of a foot for instance, and lasts as long as it is
told to. Otherwise it is the return of the end effector that comes nearest to where it began. From each frame it goes
half the path's diameter away and comes back to within a quarter of it, moving less than a right angle off its first
direction; that first return ends where it is nearest. It counts where it spans most of the path's diameter, and of all
that do the one with the smallest gap at a frame is taken, or, of a clip without any, all frames. The gap that is left
is spread evenly over the path.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from recon.animal.body import Body
from recon.animal.chain import UVW_BODY, Chain, upright_rotation
from recon.base.arrays import Array, Bools, Index
from recon.gait.phase import diameter
from recon.geometry.kinematics import AXES, PITCH, ROOT, YAW, Marker, Segment, Tree, derivatives

Curvature = Callable[[Array], Array]
Limits = tuple[ArrayLike, ArrayLike]
"""The lower and the upper limit."""
FREE: Limits = (-np.inf, np.inf)

MAX_RATE_RAD_S = 50.0
"""Where a chain has no rate limit of its own."""


@dataclass(frozen=True, eq=False)
class SerialChain:
    """A chain with n joints in dim dimensions, its base at the origin. Joint angles q are (n,) or, for many
    configurations at once, (..., n): rad, and metres of joints that slide."""

    tree: Tree
    """The tree of one branch, with one marker: the end effector."""
    columns: Index
    """(n,): where the tree's state has the joints."""
    names: tuple[str, ...]
    """(n,): what the joints are called."""
    groups: tuple[tuple[int, ...], ...]
    """The joints that follow each other along the chain, one tuple for each kind of angle."""
    lower_rad: Array
    """The lower limits of the joints, shape (n,); metres for joints that slide, as of all limits."""
    upper_rad: Array
    """The upper limits of the joints, shape (n,)."""
    max_rate_rad_s: Array
    """The fastest rates of the joints that are allowed or expected, shape (n,)."""
    base: Array = field(default_factory=lambda: np.eye(3))
    """(dim, 3): from the axes of the tree's world to those of the base frame."""
    tool_rotation: Array = field(default_factory=lambda: np.eye(3))
    """(3, 3): of the end effector on the last link."""

    def __post_init__(self) -> None:
        if not np.all(self.lower_rad <= self.upper_rad):
            raise ValueError("a lower limit is above the upper one")
        if not np.all(np.isfinite(self.max_rate_rad_s) & (self.max_rate_rad_s > 0)):
            raise ValueError("rate limits must be positive and finite")

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
        return (self.tree.pose(self._states(q)).points_m[:, 0] @ self.base.T).reshape(*q.shape[:-1], self.dim)

    def pose(self, q: Array) -> tuple[Array, Array]:
        """The pose T_base_end of a chain in space: rotation (3, 3) and position (3,) of the end effector, for q
        (n,)."""
        return self.base @ self.tree.orientations(self._states(q))[0, -1] @ self.tool_rotation, self.end(q)

    def inside_limits(self, q: Array) -> Array:
        """The nearest angles to q (..., n) within the limits."""
        return np.minimum(np.maximum(q, self.lower_rad), self.upper_rad)

    # -- how it moves, for q (n,) ------------------------------------------------------------------------------------

    def derivatives(self, q: Array) -> tuple[Array, Curvature]:
        """The end effector's Jacobian (dim, n), and its curvature, a function that makes of mu (dim,) the sum (n, n) of
        mu_i times the Hessian of coordinate i."""
        jacobian, _, curvature = derivatives(self.tree, self._states(q)[0])

        def bent(mu: Array) -> Array:
            return curvature(mu[None] @ self.base)[np.ix_(self.columns - 3, self.columns - 3)]

        return self.base @ jacobian[0][:, self.columns], bent

    def jacobian(self, q: Array) -> Array:
        """(..., dim, n) of the end effector, for q (..., n)."""
        jacobian = self.tree.pose_with_jacobian(self._states(q)).jacobian[:, 0]
        return (self.base @ jacobian[..., self.columns]).reshape(*q.shape[:-1], self.dim, self.n)

    def joint_axes(self, q: Array) -> Array:
        """Unit vectors (n, 3) along the joints' axes of a chain of `joint_chain`, in the base frame."""
        return derivatives(self.tree, self._states(q)[0])[1]

    def geometric_jacobian(self, q: Array) -> Array:
        """The geometric Jacobian (6, n) of a chain of `joint_chain`: velocity (m/s) and angular velocity (rad/s) of the
        end effector."""
        jacobian, axes, _ = derivatives(self.tree, self._states(q)[0])
        return np.concatenate([jacobian[0, :, self.columns].T, axes.T * ~self.sliding])

    def _states(self, q: Array) -> Array:
        """(N, D)"""
        states = np.zeros((q.size // self.n, self.tree.n_state))
        states[:, self.columns] = q.reshape(-1, self.n)
        return states

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
        a chain in space not every distance between has to be reached. Joints that slide leave none."""
        if self.sliding.any():
            return 0.0, math.inf
        hops = np.append(np.linalg.norm(self.positions(np.zeros(self.n))[0]), self.lengths_m)
        return max(0.0, float(2 * hops.max() - hops.sum())), float(hops.sum())


# -- chains that are made --------------------------------------------------------------------------------------------


def mobility(bodies: int, freedoms: Sequence[int], of_a_body: Literal[3, 6] = 6) -> int:
    """Grübler's count of what a mechanism is free to do: b (bodies - 1 - joints) + the joints' freedoms.

    bodies: with the ground; freedoms: of every joint, of a hinge 1, of a universal joint 2, of a free body 6;
    of_a_body: b, 6 in space, 3 in a plane. It takes constraints for independent of each other.
    """
    return of_a_body * (bodies - 1 - len(freedoms)) + sum(freedoms)


def planar_chain(
    lengths_m: ArrayLike, limits_rad: Limits = FREE, max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S
) -> SerialChain:
    """Links in a plane: q (L,), angle 0 along +x, positive towards +y. Otherwise as `summed_chain`."""
    return summed_chain(lengths_m, limits_rad, max_rate_rad_s, dim=2)


def summed_chain(
    lengths_m: ArrayLike,
    limits_rad: Limits = FREE,
    max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S,
    dim: Literal[2, 3] = 3,
) -> SerialChain:
    """Universal joints in space whose angles add up: q (2 L,) = [theta..., phi...], base frame UVW, of lengths_m (L,).
    dim 2: only the thetas. Limits: lower and upper, rates: the fastest, each one number or one for each joint. Raises
    ValueError."""
    lengths = np.array(lengths_m, float)
    if lengths.ndim != 1 or not len(lengths) or not np.all(np.isfinite(lengths) & (lengths > 0)):
        raise ValueError(f"positive lengths (L,) expected, got {lengths_m}")
    L, along = len(lengths), [(float(x), 0.0, 0.0) for x in (0.0, *lengths)]
    ends = ["base", *(f"link_{k}" for k in range(1, L + 1))]
    links = [Segment(ends[k + 1], ends[k], "summed", along[k]) for k in range(L)]
    tree = Tree((Segment("base", None, "fixed"), *links), (Marker("end", ends[-1], along[-1]),))
    # Of every link the tree has phi, then theta.
    phi = 3 + 2 * np.arange(L)
    columns = np.concatenate([phi + 1, phi])[: L * (dim - 1)]
    groups = tuple(tuple(range(k * L, (k + 1) * L)) for k in range(dim - 1))
    names = tuple(tree.state_names[column] for column in columns)
    limits = _each(len(columns), *limits_rad, max_rate_rad_s)
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
    """n joints in space: q (n,), rad, or metres of those that slide. It is described as it is with all of them at 0, in
    the axes of its base.

    offsets_m (n, 3): each joint's place from that of the joint before it; axes (n, 3); sliding: one or (n,), which
    slide along their axes; tool_m (3,), tool_rotation: the end effector from the last joint; names: None: joint 1 and
    so on; limits: lower and upper, rates: the fastest, each one number or one for each joint. Raises ValueError.
    """
    offsets, axes, tool = (np.array(x, float) for x in (offsets_m, axes, tool_m))
    n = len(offsets)
    if not n or offsets.shape != (n, 3) or axes.shape != (n, 3) or tool.shape != (3,):
        raise ValueError(f"offsets and axes (n, 3) and a tool (3,) expected: {offsets.shape}, {axes.shape}")
    sizes = np.linalg.norm(axes, axis=1)
    if not all(np.isfinite(x).all() for x in (offsets, axes, tool)) or not (sizes > 0).all():
        raise ValueError("offsets, axes and tool must be finite, and no axis zero")
    # Frames whose z axes are the joints', and back to the base's axes from that of the base and of each joint.
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
    columns, groups, limits = 3 + np.arange(n), (tuple(range(n)),), _each(n, *limits_rad, max_rate_rad_s)
    return SerialChain(tree, columns, names, groups, *limits, tool_rotation=end)


def _each(n: int, *numbers: ArrayLike) -> list[Array]:
    """Numbers, one or (n,) each, of n joints."""
    return [np.array(np.broadcast_to(one, n), float) for one in numbers]


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


def manipulability(J: Array) -> Array:
    """sqrt(det J J') of J (..., dim, n) (Yoshikawa 1985): 0 where a direction is lost."""
    return np.sqrt(np.maximum(0.0, np.linalg.det(J @ J.swapaxes(-1, -2))))


def null_basis(J: Array) -> Array:
    """Orthonormal basis N (n, n - dim) of the null space of J (dim, n), J N = 0."""
    return np.asarray(np.linalg.qr(J.T, mode="complete")[0][:, len(J) :], float)


# -- the planar arm of two links in closed form ----------------------------------------------------------------------


def two_link(lengths_m: tuple[float, float], target_m: ArrayLike) -> tuple[Array, str]:
    """Both branches (2, 2) of a planar arm for a target (2,), metres: (q1, q2) with q2 <= 0, then with q2 >= 0, in
    (-pi, pi], NaN without a solution; and why there is none or only one, empty for two.

    cos q2 = (x^2 + y^2 - r1^2 - r2^2) / (2 r1 r2),   q1 = atan2(y, x) - atan2(r2 sin q2, r1 + r2 cos q2)

    Angle 0 lies along +x, the second is relative to the first link. Raises ValueError for lengths that are not
    positive.
    """
    target = np.asarray(target_m, float)
    # Rounding must not put the stretched arm out of its own reach.
    reason = unreachable(planar_chain(lengths_m), target, 1e-12 * sum(lengths_m))
    if reason:
        return np.full((2, 2), np.nan), reason
    (r1, r2), (x, y) = lengths_m, target.tolist()
    cosine = (x * x + y * y - r1 * r1 - r2 * r2) / (2 * r1 * r2)
    bend = math.acos(max(-1.0, min(1.0, cosine)))
    q2 = np.array([-bend, bend])
    q1 = math.atan2(y, x) - np.arctan2(r2 * np.sin(q2), r1 + r2 * np.cos(q2))
    singular = "singular: " + ("stretched" if bend < 1.0 else "folded") + ", the branches coincide"
    branches = np.column_stack([math.pi - (math.pi - q1) % (2 * math.pi), q2])
    return branches, singular if math.sin(bend) < 1e-9 else ""


# -- an animal's chains ------------------------------------------------------------------------------------------------

BASE_THETA_RAD = 0.9
"""Limit of the first link's pitch: three standard deviations of a running animal's."""
LIMIT_SIGMAS = 3.0
"""Limits of a whole animal's angles, in standard deviations."""
_TRAVEL_M = 0.1
"""A shorter path of the root has no direction."""
_UP = np.array([0.0, 0.0, 1.0])

# -- the spine-front-leg chain ---------------------------------------------------------------------------------------


def spine_front_leg(
    chain: Chain, base_length_m: float | None = None, dim: Literal[2, 3] = 3, limited: bool = True
) -> SerialChain:
    """The chain from the root to the front foot, r5, r1, r2, r3, r4 of the 8U skeleton, in its level base frame.

    Its joints are called as the chain's own angles, after the joint at the link's end: theta_9, theta_1 to theta_4, and
    so the phis. base_length_m: None for the nominal one. Limits are the skeleton's expected ranges, those of the first
    link `BASE_THETA_RAD` and three standard deviations of the heading about the direction of travel; it turns no faster
    than the next one. limited: False leaves them out, but for the rates'.
    """
    links = _path(chain)
    base = chain.nominal_base_length_m if base_length_m is None else base_length_m
    lengths = [chain.links[i].length_ratio * base for i in links]
    free = _angle_index(chain, links)
    lower, upper, rate = [], [], []
    for ranges, base_limit in ((chain.theta, BASE_THETA_RAD), (chain.phi, 3 * chain.file.prior.travel_sigma_rad)):
        rates = [float(ranges.max_rate_rad_s[k]) for k in free if k is not None]
        for k in free:
            lower.append(-base_limit if k is None else ranges.mean_rad[k] - ranges.tolerance_rad[k])
            upper.append(base_limit if k is None else ranges.mean_rad[k] + ranges.tolerance_rad[k])
            rate.append(rates[0] if k is None else ranges.max_rate_rad_s[k])
    kind = planar_chain if dim == 2 else summed_chain
    n = len(links) * (dim - 1)
    numbers = [chain.links[i].end.lstrip("J") for i in links]
    names = tuple(f"{angle}_{number}" for angle in ("theta", "phi")[: dim - 1] for number in numbers)
    return replace(kind(lengths, (lower[:n], upper[:n]) if limited else FREE, rate[:n]), names=names)


def chain_angles(chain: Chain, states: Array, travel: Array | None = None, dim: Literal[2, 3] = 3) -> Array:
    """Joint angles (T, n) of `spine_front_leg` in its level base frame, for states (T, D) of the chain's body.

    travel: direction of travel, (3,) or (T, 3), of which the level part counts; None: as `body_travel`. All links keep
    their directions in space exactly (dim 3); of the two angle pairs for a direction, and of their turns, it is the one
    nearer to that of the chain without roll. dim 2: the thetas, the chain turned into the sagittal plane.
    """
    R = chain.body.tree.orientations(states)[:, 0] @ UVW_BODY.T
    heading = (body_travel(states) if travel is None else np.asarray(travel, float)) * (1.0, 1.0, 0.0)
    heading = np.broadcast_to(heading / np.linalg.norm(heading, axis=-1, keepdims=True), (len(states), 3))
    R_base_local = upright_rotation(heading, _UP).transpose(0, 2, 1) @ R

    free = _angle_index(chain, _path(chain))
    zero, angles = np.zeros(len(states)), states[:, chain.body_angles]
    theta, phi = (
        np.cumsum([zero if k is None else of_kind[:, k] for k in free], axis=0).T
        for of_kind in np.split(angles, 2, axis=1)
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


def _path(chain: Chain) -> list[int]:
    """Indices of the links from the root to the fore foot."""
    joint = chain.body.feet_by_label().get("F")
    if joint is None:
        raise ValueError(f"{chain.name} has no fore foot")
    into = {link.end: i for i, link in enumerate(chain.links)}
    links = []
    while joint in into:
        links.insert(0, into[joint])
        joint = chain.links[links[0]].start
    return links


def _angle_index(chain: Chain, links: list[int]) -> list[int | None]:
    """Where links have their theta among the thetas, None for a link without."""
    free = [i for i, link in enumerate(chain.links) if link.free]
    return [free.index(i) if i in free else None for i in links]


# -- whole animals ---------------------------------------------------------------------------------------------------


def body_chain(body: Body, foot: str, size: float = 1.0, limited: bool = True) -> SerialChain:
    """The chain from the root segment's origin to a marker, its joints' names those of the state.

    The first joints are the root's yaw against the direction of travel, its pitch and its roll. Limits are the body's
    expectations, `LIMIT_SIGMAS` standard deviations each way, of the yaw half a turn. limited: False leaves them out,
    but for the rates'. Raises ValueError for a marker that the body lacks, or one behind joints whose angles add up.
    """
    marker = next((m for m in body.tree.markers if m.name == foot), None)
    if marker is None:
        raise ValueError(f"{body.name} has no marker {foot}, only {', '.join(body.markers)}")
    by_name = {segment.name: segment for segment in body.tree.segments}
    way = [by_name[marker.segment]]
    while way[0].parent is not None:
        way.insert(0, by_name[way[0].parent])
    if summed := [segment.name for segment in way if segment.joint == "summed"]:
        raise ValueError(f"{body.name}: the angles of {summed[0]} add up, which is `summed_chain`")
    tree = Tree(tuple(way), (marker,)).scaled(size)
    names = tree.state_names[3:]
    where = np.array([body.state_names.index(name) for name in names])
    mean, sigma = np.concatenate([[0.0], body.mean_rad]), np.concatenate([[np.inf], body.sigma_rad])
    low, high = ((mean + sign * LIMIT_SIGMAS * sigma)[where - YAW] for sign in (-1, 1))
    low[0], high[0] = -np.pi, np.pi
    groups = (tuple(i for i, about in enumerate(tree.axes) if about == axis) for axis in "zyx")
    limits = _each(len(names), *((low, high) if limited else FREE), MAX_RATE_RAD_S)
    columns = 3 + np.arange(len(names))
    return SerialChain(tree, columns, names, tuple(group for group in groups if group), *limits)


def body_chain_angles(body: Body, foot: str, states: Array, travel: Array | None = None) -> Array:
    """Joint angles (T, n) of `body_chain` for states (T, D) of the body, in a world with z up.

    travel: direction of travel, (3,) or (T, 3), of which the level part counts; None: from the first to the last place
    of the root, or the way the animal faces where that is short.
    """
    q = states[:, [body.state_names.index(name) for name in body_chain(body, foot).names]]
    ahead = body_travel(states) if travel is None else np.asarray(travel, float)
    yaw = q[:, 0] - np.arctan2(ahead[..., 1], ahead[..., 0])
    q[:, 0] = _unwrapped(np.angle(np.exp(1j * yaw)))
    return q


def body_travel(states: Array) -> Array:
    """Direction of travel (3,), level, of states (T, D) of a body: from the first to the last place of the root, or the
    way the animal faces where that is short."""
    known = states[np.isfinite(states).all(axis=1)]
    if not len(known):
        return np.full(3, np.nan)
    chord = known[-1, ROOT] - known[0, ROOT]
    if np.hypot(chord[0], chord[1]) < _TRAVEL_M:
        yaw, pitch = known[:, YAW], known[:, PITCH]
        chord = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), 0 * yaw]).mean(axis=1)
    return np.array([chord[0], chord[1], 0.0]) / np.hypot(chord[0], chord[1])


def projected_chain(points_m: Array, travel: ArrayLike) -> tuple[SerialChain, Array, Array]:
    """A planar chain through consecutive joints of any skeleton: the chain, q (T, K - 1), and its misfit (T,), metres.

    points_m (T, K, 3): joints, world z up, NaN where missing; travel (3,). Everything is projected into the vertical
    plane along the travel. Lengths are the medians of the projected ones, so that the chain's end does not lie quite
    where the last joint is seen: the misfit is that distance. Angles do not jump by whole turns. Without limits.
    """
    ahead = np.asarray(travel, float) * (1.0, 1.0, 0.0)
    plane = np.array([ahead / np.linalg.norm(ahead), -_UP])
    points = (points_m - points_m[:, :1]) @ plane.T
    links = np.diff(points, axis=1)
    lengths = np.nanmedian(np.linalg.norm(links, axis=2), axis=0)
    directions = np.arctan2(links[..., 1], links[..., 0])
    turns = np.diff(directions, axis=1, prepend=0.0)
    q = np.apply_along_axis(_unwrapped, 0, np.angle(np.exp(1j * turns)))
    chain = planar_chain(lengths)
    return chain, q, np.linalg.norm(chain.end(q) - points[:, -1], axis=1)


def _unwrapped(angle: Array) -> Array:
    """(T,) without jumps of whole turns between known frames."""
    out, known = angle.copy(), np.isfinite(angle)
    out[known] = np.unwrap(angle[known])
    return out


# -- a stride ---------------------------------------------------------------------------------------------------------

OVERSAMPLING = 10
"""Points of the path in a frame."""
MIN_FRAMES = 4
"""Fewer known frames do not make a spline."""
MAX_GAP_FRAMES = 4
"""Longest stretch without data that the spline bridges."""
AWAY, BACK, SPAN = 0.5, 0.25, 0.8
"""Shares of the path's diameter: how far a return leads away and how near back, and how much of it it spans."""


@dataclass(frozen=True, eq=False)
class StridePath:
    """A stride of F frames in a clip whose frame 0 is at 0 s, as a task; its end may lie between two."""

    start_s: float
    end_s: float
    how: str
    """How it was found: "given", "gait" where it is a complete one, "return" or "whole clip"."""
    q: Array
    """(F, n): the animal's joint angles, NaN where missing, of which the first is where to start from."""
    path_m: Array
    """(K, dim): the end effector's path, closed, its points `interval_s` apart."""
    interval_s: float
    gap_m: float
    """The gap that was closed."""
    gap_percent: float
    """The same, of the path's diameter."""
    notes: tuple[str, ...] = ()
    """Strides that do not count, and what else is to be known of it."""


def find_stride(
    chain: SerialChain,
    q: Array,
    fps: float,
    span_s: tuple[float, float] | None = None,
    lasts_s: tuple[float, float] = (0.0, np.inf),
) -> StridePath:
    """The stride of a chain's joint angles q (T, n) at the frames, NaN where missing; see the module.

    span_s: from when to when, where that is known; lasts_s: how long a return may take, as far as that is known. Only
    the longest stretch of frames without a gap of more than `MAX_GAP_FRAMES` counts. Raises ValueError for times that
    it does not hold, or too few frames.
    """
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    known = max(np.split(known, np.flatnonzero(np.diff(known) > MAX_GAP_FRAMES + 1) + 1), key=np.size)
    if len(known) < MIN_FRAMES:
        raise ValueError(f"a stride needs {MIN_FRAMES} known frames in a row or more, got {len(known)}")
    ends = chain.end(q[known])
    curve = CubicSpline(known, ends)
    how = "given"
    if span_s is not None:
        (start_s, end_s), half = span_s, 0.5 / fps
        first, last = known[0] / fps, known[-1] / fps
        if not first - half <= start_s < end_s <= last + half:
            raise ValueError(
                f"a stride within {first:.3f} to {last:.3f} s expected, got {start_s:.3f} to {end_s:.3f} s"
            )
        frames = (end_s - start_s) * fps
        # Not so late that it would end after the last frame.
        begins = known[(known + frames <= known[-1] + 1e-6) | (known == known[0])]
        start = int(begins[np.argmin(np.abs(begins - start_s * fps))])
        end = min(start + frames, float(known[-1]))
    else:
        found = _return(known, ends, lasts_s[0] * fps, lasts_s[1] * fps)
        how = "return" if found else "whole clip"
        i, j = found or (0, len(known) - 1)
        start, end = int(known[i]), float(known[j])
        if found:
            near = np.linspace(max(end - 1, start), min(end + 1, known[-1]), 20 * OVERSAMPLING + 1)
            end = float(near[np.argmin(np.linalg.norm(curve(near) - ends[i], axis=1))])
    if end <= start + 1 - 1e-6:
        raise ValueError("a stride needs two frames or more")
    points = round((end - start) * OVERSAMPLING) + 1
    path = curve(np.linspace(start, end, points))
    gap, extent = path[-1] - path[0], diameter(path)
    closed = path - np.linspace(0.0, 1.0, points)[:, None] * gap
    closed[-1] = closed[0]
    size = float(np.linalg.norm(gap))
    return StridePath(
        start_s=start / fps,
        end_s=end / fps,
        how=how,
        q=q[start : int(end + 1e-6) + 1],
        path_m=closed,
        interval_s=(end - start) / fps / (points - 1),
        gap_m=size,
        gap_percent=100 * size / extent if extent > 0 else 0.0,
    )


def farthest_reach(chain: SerialChain, q: Array) -> tuple[Array, Array]:
    """From joint angles (K, n), a stride's for instance, NaN where missing: q0 (n,) where the end effector is rearmost,
    and the target (dim,) where it is foremost. Forwards is the base frame's first axis. Raises ValueError."""
    known = q[np.isfinite(q).all(axis=1)]
    if not len(known):
        raise ValueError("no frame without a missing value")
    ends = chain.end(known)
    return known[np.argmin(ends[:, 0])], ends[np.argmax(ends[:, 0])]


def _return(frames: Index, ends: Array, least: float, most: float) -> tuple[int, int] | None:
    """Rows of the return (see the module) of a path (F, dim), of least to most frames, with the smallest gap; None
    without any."""
    velocity = np.gradient(ends, frames, axis=0)
    extent = diameter(ends)
    best, smallest = None, np.inf
    for i in range(len(ends)):
        distance = np.linalg.norm(ends[i:] - ends[i], axis=1)
        left = np.flatnonzero(distance >= AWAY * extent)
        if not len(left):
            continue
        back = np.flatnonzero((distance < BACK * extent) & (velocity[i:] @ velocity[i] > 0))
        lag = frames[i + back] - frames[i]
        back = back[(back > left[0]) & (lag >= least) & (lag <= most)]
        if not len(back):
            continue
        # Up to where it leaves again.
        once = back[: np.argmax(np.append(np.diff(back), 2) > 1) + 1]
        j = int(once[np.argmin(distance[once])])
        if distance[j] < smallest and diameter(ends[i : i + j + 1]) >= SPAN * extent:
            best, smallest = (i, i + j), float(distance[j])
    return best
