"""Compute the forward kinematics of a tree of rigid segments, with exact derivatives, for many frames.

Every segment has an origin fixed in its parent's frame and up to three rotations about its own z, y and x axes, in that
order (yaw, pitch, roll; right-handed; x forwards, y left, z up):

    O_segment = O_parent Rz(yaw) Ry(pitch) Rx(roll)        o_segment = o_parent + size O_parent offset

The first segment is the root. It moves freely, and its parent frame is the world. Markers are points fixed on segments.
The state contains the unknowns of one frame: the root's origin (x, y, z), metres, the root's yaw, pitch and roll, rad,
and the angles of the other segments, rad.

The kinds of joints differ in their axes: y for a hinge, z and y for a universal joint, z, y and x for a ball joint and
for the free root. Joints of machines turn about z ("turn") or slide along z ("slide", with a distance in metres instead
of an angle). Their frame has a fixed rotation relative to the parent's frame. A "summed" universal joint belongs to the
8U chain (`recon.animal.chain`). It adds the angles of all its summed ancestors to its own, and turns relative to the
root: O_segment = O_root Rz(sum of yaw) Ry(sum of pitch).

A marker's position is the root's origin plus a vector in each frame between the root and the marker. Its derivative
with respect to an angle is the cross product of the angle's axis and the sum of the vectors in the frames that the
angle turns. An angle turns all frames further from the root, but the angle of a summed joint only turns the frames
before the next summed joint. The second derivative with respect to two angles is the cross product of the axis of the
angle nearer to the root and the derivative with respect to the other angle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np

from recon.base.arrays import Array, Brief, Index

Joint = Literal["free", "ball", "universal", "hinge", "fixed", "summed", "turn", "slide"]

AXES: dict[str, str] = {
    "free": "zyx",
    "ball": "zyx",
    "universal": "zy",
    "hinge": "y",
    "fixed": "",
    "summed": "zy",
    "turn": "z",
    "slide": "s",
}
"""Axes about which each kind of joint rotates, in the order of the state; "s" means sliding along z."""

ANGLE_OF_AXIS = {"z": "yaw", "y": "pitch", "x": "roll"}
"""Name of the rotation angle about each axis."""
_NAMES = ANGLE_OF_AXIS | {"s": "slide"}
_SUMMED = {"z": "phi", "y": "theta"}
"""Published names of the angles of a summed joint about each axis, for the 8U chain (`recon.animal.chain`)."""

_BLOCK = 64
"""Number of frames whose Jacobians are computed at once, small enough for the processor's cache."""
_FRAMES_AT_ONCE = 4096
"""Number of frames whose markers are computed at once without Jacobians, to limit memory."""

CYCLE = np.array([0, 1, 2, 0, 1])
"""Indices that repeat the components as x, y, z, x, y, so that the factors of a cross product are slices."""
_IDENTITY, _NONE = np.eye(3), np.zeros(0)

ROOT = slice(0, 3)
"""Elements of the state that contain the root's origin, m."""
YAW, PITCH, ROLL = 3, 4, 5
"""Elements of the state that are the root's rotation angles, rad."""


@dataclass(frozen=True)
class Segment:
    """A rigid segment of a kinematic tree, joined to its parent."""

    name: str
    parent: str | None
    """Name of the parent segment, which precedes this one in the tree; None for the root."""
    joint: Joint
    """Kind of joint between the segment and its parent."""
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the segment in the parent's frame, (x, y, z)."""
    rotation: tuple[tuple[float, ...], ...] | None = None
    """Rotation from the segment's frame to its parent's at the joint's zero position, shape (3, 3).

    Only joints of the kinds turn, slide and fixed have such a rotation. None means the identity.
    """


@dataclass(frozen=True)
class Marker:
    """Point fixed on a segment, at the offset (x, y, z) from the segment's origin in the segment's frame."""

    name: str
    segment: str
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TreePose:
    """Positions of a tree's J markers for N states, and their derivatives, which are empty arrays unless requested."""

    points_m: Array
    """Positions of the markers in the world frame, shape (N, J, 3)."""
    jacobian: Array = field(default_factory=lambda: _NONE)
    """Derivatives of the markers' positions with respect to the D unknowns of the state, shape (N, J, 3, D)."""
    d_size: Array = field(default_factory=lambda: _NONE)
    """Derivatives of the markers' positions with respect to the logarithm of the size, shape (N, J, 3)."""


class _Plan:
    """Index arrays and masks that are computed once for a tree, and used for the kinematics of every state.

    The tree has S segments, J markers, K rotations, M pairs of a marker and a rotation that moves it, and P pairs of a
    marker and an angle of the state that moves it. There is one frame for each segment, and one for the world.
    """

    def __init__(self, tree: Tree) -> None:
        segments, markers, rotations = tree.segments, tree.markers, tree.rotations
        S, K, J = len(segments), len(rotations), len(markers)
        index_of = {segment.name: i for i, segment in enumerate(segments)}
        paths = _paths_of(segments)
        base_segments = [0 if segments[path[-1]].joint == "summed" else path[-2] for path in paths[1:]]
        """Segment relative to which each segment except the root turns, shape (S - 1,).

        This is the parent, or the root if the segment's joint is summed.
        """
        carriers = [path[-2] for path in paths[1:]] + [index_of[marker.segment] for marker in markers]

        self.sums = _sums_of(tree, paths)
        """Matrix with 1 where an angle of the state is part of a rotation's angle, shape (K + 1, K).

        The last row is 0.
        """
        base_frame = np.array([0, *(base + 1 for base in base_segments)], dtype=np.intp)
        self.levels = [(1 + level, base_frame[level]) for level in _levels_of(base_segments)]
        """Indices of the frames at each depth in the tree, and of the frames relative to which they turn."""

        self.carriers = carriers
        """Segment to which each origin (except the root's) and each marker is fixed, shape (S - 1 + J,)."""
        self.points = self._points_of(tree)
        """Vectors in all frames whose sum is an origin or a marker, shape (S + J, 3 (S + 1))."""
        points = self.points.reshape(S + J, 3, S + 1)

        self.angle = _angles_of_frames(tree)
        """Index of the angle that turns each frame about z, y and, if any joint rolls, x; K if there is none."""
        axes = _axes_of_rotations(tree, base_frame)
        self.axes = axes @ (S + 1, 1)
        """Index of the column, in the matrices of all frames, that is the axis of each rotation, shape (K,)."""
        pitched = [k for k, (i, axis) in enumerate(rotations) if axis == "y" and (i, "x") in rotations]
        self.pitched = np.array(pitched, dtype=np.intp)
        """Indices of the pitch rotations of joints that also roll.

        Their axis is the segment's y axis, turned back by the roll angle.
        """
        self.rolls = self.pitched + 1
        self.z_axes = 2 * (S + 1) + axes[pitched, 1]

        pairs = _pairs_of(tree, paths, carriers, points)
        self.marker, self.turning, self.arm, self.centre = pairs.T.copy()
        """Marker and rotation of each pair, and the end (`arm`) and the start (`centre`) of its lever arm, shape (M,).

        The ends are indices of points. The rotation moves the marker by axis x (arm - centre).
        """
        marker, moving_angle, self.merge = self.marker, self.turning, None
        """Matrix that sums the M pairs to the P pairs of a marker and an angle of the state, shape (P, M).

        None means the identity.
        """
        if any(segment.joint == "summed" for segment in segments):
            moving = (marker == np.arange(J)[:, None])[:, None] * self.sums[self.turning].T  # (J, K, M)
            marker, moving_angle = np.nonzero(moving.any(axis=2))
            self.merge = moving[marker, moving_angle]
        self.entries = (3 * marker[:, None] + np.arange(3)) * tree.n_state + 3 + moving_angle[:, None]
        """Indices of the P pairs in a flattened Jacobian (J, 3, D), shape (P, 3)."""

        self.placed = None
        """Fixed rotation of each frame, shape (S + 1, 3, 3); None if no segment has a fixed rotation."""
        if any(segment.rotation is not None for segment in segments):
            self.placed = np.array([_IDENTITY, *(_IDENTITY if s.rotation is None else s.rotation for s in segments)])
        slides = [k for k, (_, axis) in enumerate(rotations) if axis == "s"]
        self.slides = np.array(slides, dtype=np.intp)
        """Indices of the L entries of `rotations` that are translations along a sliding joint, shape (L,)."""
        reached = [*paths, *(paths[i] for i in carriers[S - 1 :])]
        self.slid = np.array([[float(rotations[k][0] in path) for k in slides] for path in reached])
        """Matrix with 1 where a slide shifts an origin or a marker, otherwise 0, shape (S + J, L)."""
        self.sliding = np.flatnonzero(np.isin(self.turning, slides))
        """Indices of the M pairs whose rotation is a slide."""

        self.outer = _outer_of(tree, base_segments)
        """Matrix with 1 where the first of two rotations turns the axis and the points of the second, shape (K, K)."""
        self.gathered = (np.arange(K)[:, None] == self.turning).astype(float)
        """Matrix with 1 where a pair has a rotation, otherwise 0, shape (K, M)."""

    def _points_of(self, tree: Tree) -> Array:
        """Return the vectors, in all frames, whose sum is an origin or a marker, shape (S + J, 3 (S + 1))."""
        S, J = len(tree.segments), len(tree.markers)
        points = np.zeros((S + J, 3, S + 1))
        for i, (parent, item) in enumerate(
            zip(self.carriers, (*tree.segments[1:], *tree.markers), strict=True), start=1
        ):
            points[i] = points[parent]
            points[i, :, parent + 1] = item.offset_m
        return points.reshape(S + J, 3 * (S + 1))

    def with_lengths_of(self, tree: Tree) -> _Plan:
        """Return this plan, adapted to a tree that differs only in its lengths (`Tree.use_plan_of`)."""
        plan = copy(self)
        plan.points = self._points_of(tree)
        return plan


def _paths_of(segments: Sequence[Segment]) -> list[list[int]]:
    """Return the path from the root to each of the S segments, as the indices of the segments along the path."""
    index_of = {segment.name: i for i, segment in enumerate(segments)}
    paths: list[list[int]] = []
    for i, segment in enumerate(segments):
        paths.append([i] if segment.parent is None else [*paths[index_of[segment.parent]], i])
    return paths


def _sums_of(tree: Tree, paths: Sequence[Sequence[int]]) -> Array:
    """Return a mask of the angles of the state that add up to the angle of each rotation, shape (K + 1, K)."""
    sums = np.eye(len(tree.rotations) + 1, len(tree.rotations))
    for k, (i, axis) in enumerate(tree.rotations):
        for j in paths[i][:-1]:
            if tree.segments[i].joint == tree.segments[j].joint == "summed":
                sums[k, tree.rotations.index((j, axis))] = 1.0
    return sums


def _levels_of(base_segments: Sequence[int]) -> list[Index]:
    """Return the indices of the segments at each depth in the tree, beginning with the root at depth 0."""
    depth = [0]
    for base in base_segments:
        depth.append(depth[base] + 1)
    return [np.flatnonzero(np.equal(depth, level)) for level in range(max(depth) + 1)]


def _pairs_of(tree: Tree, paths: Sequence[Sequence[int]], carriers: Sequence[int], points: Array) -> Index:
    """Return all pairs (M, 4) of a marker and a rotation that moves it, with end and start of the lever arm.

    The arm starts at the rotating segment's origin. It ends at the marker, or at the first summed joint on the path to
    the marker, because a summed joint is not turned by its ancestors except the root, which turns all segments.
    """
    S, pairs = len(tree.segments), []
    for j, path in enumerate(paths[i] for i in carriers[S - 1 :]):
        for k, (i, axis) in enumerate(tree.rotations):
            later = path[path.index(i) + 1 :] if i in path and i > 0 else []
            arm = next((s for s in later if tree.segments[s].joint == "summed"), S + j)
            slides = axis == "s" or any(tree.segments[s].joint == "slide" for s in later)
            if i in path and (slides or (points[arm] != points[i]).any()):
                pairs.append((j, k, arm, i))
    return np.array(pairs, dtype=np.intp).reshape(-1, 4)


def _angles_of_frames(tree: Tree) -> Index:
    """Return the index of the angle that turns each frame about z, y and, if any joint rolls, x.

    The shape is (2, S + 1) or (3, S + 1). Where no angle turns a frame about an axis, the index is K, the number of
    rotations.
    """
    rotations, S = tree.rotations, len(tree.segments)
    angles = np.full((3 if any(axis == "x" for _, axis in rotations) else 2, S + 1), len(rotations), dtype=np.intp)
    for k, (i, axis) in enumerate(rotations):
        if axis != "s":
            angles["zyx".index(axis), i + 1] = k
    return angles


def _axes_of_rotations(tree: Tree, base_frame: Index) -> Index:
    """Return the axis of each rotation (0 to 2 for x to z) and the index of the frame with this axis, shape (K, 2).

    Yaw turns about the z axis of the frame from which the joint starts (`base_frame`, by segment), roll about the
    segment's x axis, and pitch about the segment's y axis if the joint does not roll. A joint that only turns about z
    shares its axis with its segment.
    """
    axes = np.empty((len(tree.rotations), 2), dtype=np.intp)
    for k, (i, axis) in enumerate(tree.rotations):
        starts = axis == "z" and AXES[tree.segments[i].joint] != "z"
        axes[k] = "xyz".index("z" if axis == "s" else axis), base_frame[i] if starts else i + 1
    return axes


def _outer_of(tree: Tree, base_segments: Sequence[int]) -> Array:
    """Return a mask (K, K) of the pairs of rotations in which the first turns the axis and the points of the second.

    These are the rotations of all segments between the root and the second rotation's segment, and the segment's own
    rotations up to the second. A summed joint turns relative to the root, so only the root's rotations turn it.
    """
    outer = np.zeros((len(tree.rotations), len(tree.rotations)))
    for k, (inner, _) in enumerate(tree.rotations):
        turned_by = [inner]
        while turned_by[-1] != 0:
            turned_by.append(base_segments[turned_by[-1] - 1])
        for i, (segment, axis) in enumerate(tree.rotations[: k + 1]):
            outer[i, k] = axis != "s" and segment in turned_by
    return outer


_Placed = TypeVar("_Placed", Segment, Marker)


@dataclass(frozen=True, repr=False)
class Tree(Brief):
    """Tree of S rigid segments with J markers, whose state has D unknowns: 6 of the root, and all other angles.

    The root is the first segment, and every parent precedes its children.
    """

    segments: tuple[Segment, ...]
    markers: tuple[Marker, ...]

    def lengthened(self, factor_of: Callable[[str], float]) -> Tree:
        """Return the tree with the offset of each segment and marker multiplied by a factor, a function of its name."""

        def longer(item: _Placed) -> _Placed:
            return replace(item, offset_m=tuple(float(factor_of(item.name)) * value for value in item.offset_m))

        return Tree(tuple(map(longer, self.segments)), tuple(map(longer, self.markers)))

    def scaled(self, size: float) -> Tree:
        """Return the tree with all lengths multiplied by a factor."""
        return self.lengthened(lambda _: size)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the D unknowns of the state.

        The names are x_m, y_m, z_m, then <segment>_yaw and so on. For a summed joint of segment J6, they are phi_6 and
        theta_6.
        """
        names = [
            f"{_SUMMED[axis]}_{s.name.lstrip('J')}" if s.joint == "summed" else f"{s.name}_{_NAMES[axis]}"
            for s in self.segments
            for axis in AXES[s.joint]
        ]
        return ("x_m", "y_m", "z_m", *names)

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Return the axes of the D - 3 angles of the state, each "x", "y", "z", or "s" for sliding along z."""
        return tuple(axis for _, axis in self.rotations)

    @cached_property
    def n_state(self) -> int:
        """Return D, the number of unknowns of a frame."""
        return len(self.state_names)

    @cached_property
    def rotations(self) -> list[tuple[int, str]]:
        """Return the index of the segment and the axis for every angle of the state."""
        return [(i, axis) for i, s in enumerate(self.segments) for axis in AXES[s.joint]]

    @cached_property
    def plan(self) -> _Plan:
        """Return the arrays that are computed once for the tree and used for the kinematics of every state."""
        return _Plan(self)

    def use_plan_of(self, tree: Tree) -> None:
        """Use the plan of another tree, which is much faster than computing a new one.

        The other tree is ignored unless the two trees differ only in the lengths of offsets that are not zero.
        """
        if self._pattern == tree._pattern:
            self.__dict__["plan"] = tree.plan.with_lengths_of(self)

    @cached_property
    def _pattern(self) -> tuple[object, ...]:
        """Return a description of the tree without its lengths, which is equal for trees that can share a plan.

        The description contains the segments, the markers, and which of their offsets are zero.
        """
        segments = tuple((s.name, s.parent, s.joint, s.rotation, any(s.offset_m)) for s in self.segments)
        return segments, tuple((m.name, m.segment, any(m.offset_m)) for m in self.markers)

    # Kinematics

    def _frames(self, state: Array) -> tuple[Array, Array, Array]:
        """Return the orientations of all frames, and the cosine and sine of the angles, for states (N, D).

        Returns
        -------
        frames : ndarray
            Rotation matrices, shape (3, S + 1, 3, N), in the order column, frame (the world first), component.
        cosine, sine : ndarray
            Cosine and sine of each rotation's angle, shape (K + 1, N); the last angle is 0.
        """
        plan, N = self.plan, len(state)
        angles = plan.sums @ state[:, 3:].T
        cosine, sine = np.cos(angles), np.sin(angles)
        (cz, cy, *cx), (sz, sy, *sx) = cosine.take(plan.angle, axis=0), sine.take(plan.angle, axis=0)
        x, y, z = np.array((cz * cy, sz * cy, -sy, -sz, cz, np.zeros(cz.shape), cz * sy, sz * sy, cy)).reshape(
            3, 3, len(self.segments) + 1, N
        )
        for c, s in zip(cx, sx, strict=True):
            y, z = c * y + s * z, c * z - s * y
        turned = np.array((x, y, z))  # Rz Ry Rx
        if plan.placed is not None:
            turned = np.einsum("sab,cbsn->casn", plan.placed, turned)
        frames = np.empty((3, len(self.segments) + 1, 3, N))
        frames[:, :2] = turned[:, :, :2].swapaxes(1, 2)
        for level, base in plan.levels:
            frames[:, level] = np.einsum("cbsn,bsan->csan", turned[:, :, level], frames.take(base, axis=1))
        return frames, cosine, sine

    def orientations(self, state: Array) -> Array:
        """Return the rotation from each segment's frame to the world for states (N, D), shape (N, S, 3, 3)."""
        return self._frames(state)[0][:, 1:].transpose(3, 1, 2, 0)

    def pose(self, state: Array, size: Array | float = 1.0) -> TreePose:
        """Return the positions of the markers for states (N, D), without derivatives.

        `size` is the factor by which all offsets are scaled, a number or an array (N,).
        """
        sizes, relative = np.ones(len(state)) * size, np.empty((len(state), len(self.markers), 3))
        for first in range(0, len(state), _FRAMES_AT_ONCE):
            block = slice(first, first + _FRAMES_AT_ONCE)
            points = self._points(self._frames(state[block])[0], state[block], sizes[block])
            relative[block] = points[len(self.segments) :].transpose(2, 0, 1)
        return TreePose(state[:, None, ROOT] + relative)

    def origins(self, state: Array) -> Array:
        """Return the segments' origins in the world for states (N, D), metres, shape (N, S, 3)."""
        relative = self._points(self._frames(state)[0], state, 1.0)[: len(self.segments)]
        return state[:, None, ROOT] + relative.transpose(2, 0, 1)

    def _points(self, frames: Array, state: Array, size: Array | float) -> Array:
        """Return the positions of all origins and markers relative to the root's origin, shape (S + J, 3, N).

        `frames` are the orientations that `_frames` returns.
        """
        plan, N = self.plan, len(state)
        columns = frames.reshape(plan.points.shape[1], 3 * N)
        points = (plan.points @ columns).reshape(len(plan.points), 3, N) * size
        if len(plan.slides):
            columns = columns.reshape(-1, 3, N)
            direction = columns.take(plan.axes[plan.slides], axis=0) * state.T[3 + plan.slides, None]
            points += np.tensordot(plan.slid, direction, 1)
        return points

    def pose_with_jacobian(self, state: Array, size: Array | float = 1.0) -> TreePose:
        """Return the positions of the markers and their exact derivatives for states (N, D).

        `size` is the factor by which all offsets are scaled, a number or an array (N,).
        """
        N, J = len(state), len(self.markers)
        sizes = np.ones(N) * size
        relative, jacobian = np.empty((N, J, 3)), np.zeros((N, J, 3, self.n_state))
        rows = jacobian.reshape(N, J * 3 * self.n_state)
        for first in range(0, N, _BLOCK):
            block = slice(first, first + _BLOCK)
            points, _, moved = self.moved(state[block], sizes[block])
            if self.plan.merge is not None:
                moved = (self.plan.merge @ moved.reshape(len(moved), -1)).reshape(len(self.plan.merge), 3, -1)
            relative[block] = points.transpose(2, 0, 1)
            rows[block, self.plan.entries] = moved.transpose(2, 0, 1)
        jacobian[..., ROOT] = _IDENTITY
        return TreePose(state[:, None, ROOT] + relative, jacobian, relative)

    def moved(self, state: Array, size: Array) -> tuple[Array, Array, Array]:
        """Return the markers, the axes of the rotations, and the markers' derivatives, for states (N, D).

        Returns
        -------
        points : ndarray
            Positions of the markers minus that of the root's origin, in the world frame, shape (J, 3, N), m.
        axes : ndarray
            Unit vectors along the axes of the rotations, in the world frame, shape (K, 3, N).
        moved : ndarray
            Derivative of a marker with respect to a rotation, m/rad, for each of the M pairs of `_Plan`, (M, 3, N).
        """
        plan, N = self.plan, len(state)
        frames, cosine, sine = self._frames(state)
        points, columns = self._points(frames, state, size), frames.reshape(plan.points.shape[1], 3, N)
        axes = columns.take(plan.axes, axis=0)
        if len(plan.pitched):
            y, z = axes[plan.pitched], columns[plan.z_axes]
            axes[plan.pitched] = cosine[plan.rolls, None] * y - sine[plan.rolls, None] * z
        turn_axes = axes.take(CYCLE, axis=1).take(plan.turning, axis=0)
        cyclic = points.take(CYCLE, axis=1)
        arms = cyclic.take(plan.arm, axis=0) - cyclic.take(plan.centre, axis=0)
        moved = turn_axes[:, 1:4] * arms[:, 2:] - turn_axes[:, 2:] * arms[:, 1:4]
        if len(plan.sliding):
            moved[plan.sliding] = turn_axes[plan.sliding, :3]
        return points[len(self.segments) :], axes, moved


Moved = tuple[Array, Array, Array]
"""Markers, axes of the rotations, and derivatives, as `Tree.moved` returns them."""


def derivatives_of(tree: Tree, moved_now: Moved) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Return the first and second derivatives of the markers for one state (D,), for inverse kinematics.

    `moved_now` is the result of `Tree.moved` for this state.

    Returns
    -------
    jacobian : ndarray
        Derivatives of the markers' positions with respect to the state, shape (J, 3, D).
    axes : ndarray
        Unit vectors along the axes of the angles in the world frame, shape (D - 3, 3).
    curvature : function
        Function that returns the weighted sum (D - 3, D - 3) of the markers' second derivatives, given weights (J, 3).
    """
    plan, J = tree.plan, len(tree.markers)
    _, axes, moved = moved_now
    axes, moved = axes[..., 0], moved[..., 0]
    jacobian = np.zeros((J, 3, tree.n_state))
    jacobian.reshape(-1)[plan.entries] = moved if plan.merge is None else plan.merge @ moved
    jacobian[..., ROOT] = np.eye(3)
    sums = plan.sums[:-1]

    def curvature(weights: Array) -> Array:
        # weight . (outer axis x moved) = outer axis . (moved x weight)
        arms = weights.take(plan.marker, axis=0).take(CYCLE, axis=1)
        cyclic_moved = moved.take(CYCLE, axis=1)
        swept = plan.gathered @ (cyclic_moved[:, 1:4] * arms[:, 2:] - cyclic_moved[:, 2:] * arms[:, 1:4])
        pairs = plan.outer * (axes @ swept.T)
        pairs = pairs + np.triu(pairs, 1).T
        return sums.T @ pairs @ sums

    return jacobian, axes, curvature
