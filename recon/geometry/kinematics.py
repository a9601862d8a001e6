"""Compute forward kinematics of a tree of rigid segments, with exact derivatives, for many frames.

Every segment has an origin fixed in its parent's frame and up to three rotations about its own z, y and x axes, in that
order (yaw, pitch, roll; right-handed; x forwards, y left, z up):

    O_segment = O_parent Rz(yaw) Ry(pitch) Rx(roll)        o_segment = o_parent + size O_parent offset

The first segment is the root. It moves freely, and its parent frame is the world. Markers are points fixed on segments.
The unknowns of one frame, the state, are [root's origin (3), metres; root's yaw, pitch, roll, rad; the other segments'
angles, rad].

The kinds of joints differ in their axes: y for a hinge, z and y for a universal joint, z, y and x for a ball joint and
for the free root. Joints of machines turn about z ("turn") or slide along z ("slide", with a distance in metres instead
of an angle); a fixed rotation leads from their frame to the parent's. A "summed" universal joint belongs to the 8U
chain (`recon.animal.chain`). It adds the angles of all its summed ancestors to its own, and turns relative to the root:
O_segment = O_root Rz(sum of yaw) Ry(sum of pitch).

A marker's position is the root's origin plus vectors fixed in the frames between the root and the marker. Its
derivative with respect to an angle is axis x (sum of the vectors in the frames that the angle turns). An angle turns
all frames that follow; the angle of a summed joint only turns those up to the next summed joint. The second derivative
with respect to two angles is the outer angle's axis x the derivative with respect to the inner angle.
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
"""Axes about which each kind of joint rotates, in the order of the state; "s" is a slide along z."""

ANGLE_OF_AXIS = {"z": "yaw", "y": "pitch", "x": "roll"}
"""Name of the rotation angle about each axis."""
_NAMES = ANGLE_OF_AXIS | {"s": "slide"}
_SUMMED = {"z": "phi", "y": "theta"}
"""Names of a summed joint's angles, by axis, as published for the 8U chain (`recon.animal.chain`)."""

_BLOCK = 64
"""Number of frames whose Jacobians are computed at once: few enough for the processor's cache."""
_FRAMES_AT_ONCE = 4096
"""Number of frames whose markers are computed at once without Jacobians, to limit memory."""

CYCLE = np.array([0, 1, 2, 0, 1])
"""Indices of the components x, y, z, x, y, of which the factors of a cross product are slices."""
_IDENTITY, _NONE = np.eye(3), np.zeros(0)

ROOT = slice(0, 3)
"""Elements of the state that are the root's origin, m."""
YAW, PITCH, ROLL = 3, 4, 5
"""Elements of the state that are the root's rotation angles, rad."""


@dataclass(frozen=True)
class Segment:
    """A rigid segment of a kinematic tree, joined to its parent."""

    name: str
    parent: str | None
    """Name of the segment that carries this one, which comes earlier; None for the root."""
    joint: Joint
    """Kind of joint between the segment and its parent."""
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the segment in the parent's frame, (x, y, z)."""
    rotation: tuple[tuple[float, ...], ...] | None = None
    """Rotation (3, 3) from the segment's frame to its parent's before the joint moves.

    Only joints of the kinds turn, slide and fixed have one.
    """


@dataclass(frozen=True)
class Marker:
    """A point fixed on a segment, at `offset_m` (x, y, z) from the segment's origin in the segment's frame."""

    name: str
    segment: str
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TreePose:
    """Positions of a tree's J markers for N states, and their derivatives, which are empty unless requested."""

    points_m: Array
    """Positions of the markers in the world frame, shape (N, J, 3)."""
    jacobian: Array = field(default_factory=lambda: _NONE)
    """Derivatives of the markers with respect to the state, shape (N, J, 3, D)."""
    d_size: Array = field(default_factory=lambda: _NONE)
    """Derivatives of the markers with respect to the logarithm of the size, shape (N, J, 3)."""


class _Plan:
    """Index arrays and masks, computed once for a tree, from which its kinematics follow for any state.

    Dimensions: S segments, J markers, K rotations, M pairs of a marker and a rotation that moves it, and P pairs of a
    marker and an angle of the state.
    """

    def __init__(self, tree: Tree) -> None:
        segments, markers, rotations = tree.segments, tree.markers, tree.rotations
        S, K, J = len(segments), len(rotations), len(markers)
        index_of = {segment.name: i for i, segment in enumerate(segments)}
        paths = _paths_of(segments)
        base_segments = [0 if segments[path[-1]].joint == "summed" else path[-2] for path in paths[1:]]
        """(S - 1,): for each segment but the root, the segment relative to which it turns: its parent, or the root if
        its joint is summed."""
        carriers = [path[-2] for path in paths[1:]] + [index_of[marker.segment] for marker in markers]

        self.sums = _sums_of(tree, paths)
        """(K + 1, K): 1 where an angle of the state is part of a rotation's angle; the last row is 0."""
        base_frame = np.array([0, *(base + 1 for base in base_segments)], dtype=np.intp)
        self.levels = [(1 + level, base_frame[level]) for level in _levels_of(base_segments)]
        """For each depth in the tree, the frames at this depth, and the frames relative to which they turn."""

        self.carriers = carriers
        """(S - 1 + J,): the segment to which each origin (except the root's) and each marker is fixed."""
        self.points = self._points_of(tree)
        """(S + J, 3 (S + 1)): for each origin and each marker, the vector in every frame; the point is their sum."""
        points = self.points.reshape(S + J, 3, S + 1)

        self.angle = _angles_of_frames(tree)
        """(2 or 3, S + 1): angle that turns each frame about z, y and, if any joint rolls, x; K if none."""
        axes = _axes_of_rotations(tree, base_frame)
        self.axes = axes @ (S + 1, 1)
        """(K,): for each rotation, the index of the frame's column that is its axis."""
        pitched = [k for k, (i, axis) in enumerate(rotations) if axis == "y" and (i, "x") in rotations]
        self.pitched = np.array(pitched, dtype=np.intp)
        """Pitch rotations of joints that also roll: the axis is the segment's y axis turned back by the roll angle."""
        self.rolls = self.pitched + 1
        self.z_axes = 2 * (S + 1) + axes[pitched, 1]

        pairs = _pairs_of(tree, paths, carriers, points)
        self.marker, self.turning, self.arm, self.centre = pairs.T.copy()
        """(M,) each: marker and rotation of each pair, and the points at the end (`arm`) and the start (`centre`) of
        its lever arm. The rotation moves the marker by axis x (arm - centre).
        """
        marker, moving_angle, self.merge = self.marker, self.turning, None
        """(P, M): matrix that sums the M pairs to the P pairs of a marker and an angle of the state; None for the
        identity."""
        if any(segment.joint == "summed" for segment in segments):
            moving = (marker == np.arange(J)[:, None])[:, None] * self.sums[self.turning].T  # (J, K, M)
            marker, moving_angle = np.nonzero(moving.any(axis=2))
            self.merge = moving[marker, moving_angle]
        self.entries = (3 * marker[:, None] + np.arange(3)) * tree.n_state + 3 + moving_angle[:, None]
        """(P, 3): indices of the P pairs in a flat Jacobian (J, 3, D)."""

        self.placed = None
        """(S + 1, 3, 3): fixed rotations of the segments; None if no segment has one."""
        if any(segment.rotation is not None for segment in segments):
            self.placed = np.array([_IDENTITY, *(_IDENTITY if s.rotation is None else s.rotation for s in segments)])
        slides = [k for k, (_, axis) in enumerate(rotations) if axis == "s"]
        self.slides = np.array(slides, dtype=np.intp)
        """(L,): indices of the rotations that are slides."""
        reached = [*paths, *(paths[i] for i in carriers[S - 1 :])]
        self.slid = np.array([[float(rotations[k][0] in path) for k in slides] for path in reached])
        """(S + J, L): 1 for the points that each slide shifts, otherwise 0."""
        self.sliding = np.flatnonzero(np.isin(self.turning, slides))
        """Indices of the pairs whose rotation is a slide."""

        self.outer = _outer_of(tree, base_segments)
        """(K, K): 1 where the first of two rotations turns the axis and the points of the second, otherwise 0."""
        self.gathered = (np.arange(K)[:, None] == self.turning).astype(float)
        """(K, M): 1 where a pair has the rotation, otherwise 0."""

    def _points_of(self, tree: Tree) -> Array:
        """Return the vectors in every frame whose sum is an origin or a marker, (S + J, 3 (S + 1))."""
        S, J = len(tree.segments), len(tree.markers)
        points = np.zeros((S + J, 3, S + 1))
        for i, (parent, item) in enumerate(
            zip(self.carriers, (*tree.segments[1:], *tree.markers), strict=True), start=1
        ):
            points[i] = points[parent]
            points[i, :, parent + 1] = item.offset_m
        return points.reshape(S + J, 3 * (S + 1))

    def with_lengths_of(self, tree: Tree) -> _Plan:
        """Return this plan for a tree that differs only in lengths (`Tree.use_plan_of`)."""
        plan = copy(self)
        plan.points = self._points_of(tree)
        return plan


def _paths_of(segments: Sequence[Segment]) -> list[list[int]]:
    """Return the path to each of the S segments: the indices of all segments from the root to it."""
    index_of = {segment.name: i for i, segment in enumerate(segments)}
    paths: list[list[int]] = []
    for i, segment in enumerate(segments):
        paths.append([i] if segment.parent is None else [*paths[index_of[segment.parent]], i])
    return paths


def _sums_of(tree: Tree, paths: Sequence[Sequence[int]]) -> Array:
    """Return a mask (K + 1, K) of the angles of the state that add up to each rotation's angle."""
    sums = np.eye(len(tree.rotations) + 1, len(tree.rotations))
    for k, (i, axis) in enumerate(tree.rotations):
        for j in paths[i][:-1]:
            if tree.segments[i].joint == tree.segments[j].joint == "summed":
                sums[k, tree.rotations.index((j, axis))] = 1.0
    return sums


def _levels_of(base_segments: Sequence[int]) -> list[Index]:
    """Return the indices of the segments at each depth, where the root has depth 0."""
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
    """Return the index of the angle that turns each frame about z, y and, if any joint rolls, x, (2 or 3, S + 1).

    The index is K where a frame has no such angle.
    """
    rotations, S = tree.rotations, len(tree.segments)
    angles = np.full((3 if any(axis == "x" for _, axis in rotations) else 2, S + 1), len(rotations), dtype=np.intp)
    for k, (i, axis) in enumerate(rotations):
        if axis != "s":
            angles["zyx".index(axis), i + 1] = k
    return angles


def _axes_of_rotations(tree: Tree, base_frame: Index) -> Index:
    """Return the axis of each rotation (0 to 2 for x to z) and the index of the frame that has this axis, (K, 2).

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
    """Return a mask (K, K) of the pairs of rotations of which the first turns the axis and the points of the second.

    A segment is turned by the segment relative to which it turns, by that segment's own base and so on to the root, and
    by its own earlier angles.
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
    """A tree of rigid segments with J markers, whose state has D unknowns: 6 of the root, and all other angles.

    The root is the first segment, and every parent comes before its children.
    """

    segments: tuple[Segment, ...]
    markers: tuple[Marker, ...]

    def lengthened(self, factor_of: Callable[[str], float]) -> Tree:
        """Return the tree with the offset of each segment and marker multiplied by `factor_of` its name."""

        def longer(item: _Placed) -> _Placed:
            return replace(item, offset_m=tuple(float(factor_of(item.name)) * value for value in item.offset_m))

        return Tree(tuple(map(longer, self.segments)), tuple(map(longer, self.markers)))

    def scaled(self, size: float) -> Tree:
        """Return the tree with all lengths multiplied by a factor."""
        return self.lengthened(lambda _: size)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the state's unknowns, (D,).

        The names are x_m, y_m, z_m, then <segment>_yaw etc., and phi_6 and theta_6 for the summed joint of segment J6.
        """
        names = [
            f"{_SUMMED[axis]}_{s.name.lstrip('J')}" if s.joint == "summed" else f"{s.name}_{_NAMES[axis]}"
            for s in self.segments
            for axis in AXES[s.joint]
        ]
        return ("x_m", "y_m", "z_m", *names)

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Return the axis of each angle of the state, (D - 3,): "x", "y", "z", or "s" for a slide along z."""
        return tuple(axis for _, axis in self.rotations)

    @cached_property
    def n_state(self) -> int:
        """Return D, the number of unknowns of a frame."""
        return len(self.state_names)

    @cached_property
    def rotations(self) -> list[tuple[int, str]]:
        """Return the index of the segment and the axis of every angle of the state."""
        return [(i, axis) for i, s in enumerate(self.segments) for axis in AXES[s.joint]]

    @cached_property
    def plan(self) -> _Plan:
        """Return the precomputed arrays that the kinematics need in addition to the state."""
        return _Plan(self)

    def use_plan_of(self, tree: Tree) -> None:
        """Take over the plan of another tree if the two trees differ only in the lengths of offsets that are not zero.

        This is much faster than a new plan. Other trees are ignored.
        """
        if self._pattern == tree._pattern:
            self.__dict__["plan"] = tree.plan.with_lengths_of(self)

    @cached_property
    def _pattern(self) -> tuple[object, ...]:
        """Return the tree without its lengths: its segments, its markers, and which of their offsets are zero."""
        segments = tuple((s.name, s.parent, s.joint, s.rotation, any(s.offset_m)) for s in self.segments)
        return segments, tuple((m.name, m.segment, any(m.offset_m)) for m in self.markers)

    # Kinematics

    def _frames(self, state: Array) -> tuple[Array, Array, Array]:
        """Return the orientations of all frames, and cosine and sine of the angles, for states (N, D).

        Returns
        -------
        frames : (3, S + 1, 3, N)
            Rotation matrices, by column, frame (the world first) and component.
        cosine, sine : (K + 1, N)
            Cosine and sine of each rotation's angle; the last angle is 0.
        """
        plan, N = self.plan, len(state)
        angles = plan.sums @ state[:, 3:].T
        cosine, sine = np.cos(angles), np.sin(angles)
        (cz, cy, *cx), (sz, sy, *sx) = cosine.take(plan.angle, axis=0), sine.take(plan.angle, axis=0)
        y, z = [-sz, cz, np.zeros(cz.shape)], [cz * sy, sz * sy, cy]
        for c, s in zip(cx, sx, strict=True):
            y, z = (
                [c * a + s * b for a, b in zip(y, z, strict=True)],
                [c * b - s * a for a, b in zip(y, z, strict=True)],
            )
        columns = np.array((cz * cy, sz * cy, -sy, *y, *z))
        turned = columns.reshape(3, 3, len(self.segments) + 1, N)  # Rz Ry Rx
        if plan.placed is not None:
            turned = np.einsum("sab,cbsn->casn", plan.placed, turned)
        frames = np.empty((3, len(self.segments) + 1, 3, N))
        frames[:, :2] = turned[:, :, :2].swapaxes(1, 2)
        for level, base in plan.levels:
            frames[:, level] = np.einsum("cbsn,bsan->csan", turned[:, :, level], frames.take(base, axis=1))
        return frames, cosine, sine

    def orientations(self, state: Array) -> Array:
        """Return the rotation R_world_segment of every segment, (N, S, 3, 3)."""
        return self._frames(state)[0][:, 1:].transpose(3, 1, 2, 0)

    def pose(self, state: Array, size: Array | float = 1.0) -> TreePose:
        """Return the markers for states (N, D), without derivatives; `size`, a scalar or (N,), scales all offsets."""
        sizes, relative = np.ones(len(state)) * size, np.empty((len(state), len(self.markers), 3))
        for first in range(0, len(state), _FRAMES_AT_ONCE):
            block = slice(first, first + _FRAMES_AT_ONCE)
            points = self._points(self._frames(state[block])[0], state[block], sizes[block])
            relative[block] = points[len(self.segments) :].transpose(2, 0, 1)
        return TreePose(state[:, None, ROOT] + relative)

    def origins(self, state: Array) -> Array:
        """Return the segments' origins in the world (N, S, 3), for states (N, D)."""
        relative = self._points(self._frames(state)[0], state, 1.0)[: len(self.segments)]
        return state[:, None, ROOT] + relative.transpose(2, 0, 1)

    def _points(self, frames: Array, state: Array, size: Array | float) -> Array:
        """Return the positions of `_Plan.points` relative to the root (S + J, 3, N), for the frames of `_frames`."""
        plan, N = self.plan, len(state)
        columns = frames.reshape(plan.points.shape[1], 3, N)
        points = np.tensordot(plan.points, columns, 1) * size
        if len(plan.slides):
            direction = columns.take(plan.axes[plan.slides], axis=0) * state.T[3 + plan.slides, None]
            points += np.tensordot(plan.slid, direction, 1)
        return points

    def pose_with_jacobian(self, state: Array, size: Array | float = 1.0) -> TreePose:
        """Return the markers and their exact derivatives for states (N, D); `size` is as in `pose`."""
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
        """Return marker positions, rotation axes, and the derivative of each marker with respect to each rotation.

        Returns
        -------
        points : (J, 3, N)
            Positions of the markers relative to the root's origin, in the axes of the world.
        axes : (K, 3, N)
            Unit vectors along the axes of the rotations, in the world frame.
        moved : (M, 3, N)
            Derivative of the marker with respect to the rotation, for each pair of `_Plan`.
        """
        plan, N = self.plan, len(state)
        frames, cosine, sine = self._frames(state)
        points, columns = self._points(frames, state, size), frames.reshape(plan.points.shape[1], 3, N)
        axes = columns.take(plan.axes, axis=0)
        if len(plan.pitched):
            y, z = axes[plan.pitched], columns[plan.z_axes]
            axes[plan.pitched] = cosine[plan.rolls, None] * y - sine[plan.rolls, None] * z
        # In the order x, y, z, x, y, the factors of a cross product are slices.
        turn_axes = axes.take(CYCLE, axis=1).take(plan.turning, axis=0)
        cyclic = points.take(CYCLE, axis=1)
        arms = cyclic.take(plan.arm, axis=0) - cyclic.take(plan.centre, axis=0)
        moved = turn_axes[:, 1:4] * arms[:, 2:] - turn_axes[:, 2:] * arms[:, 1:4]
        if len(plan.sliding):
            moved[plan.sliding] = turn_axes[plan.sliding, :3]
        return points[len(self.segments) :], axes, moved


Moved = tuple[Array, Array, Array]
"""Marker positions, rotation axes and derivatives, as `Tree.moved` returns them."""


def derivatives(tree: Tree, state: Array) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Return first and second derivatives of the markers for one state (D,), for inverse kinematics.

    The tree must not have summed joints.

    Returns
    -------
    jacobian : (J, 3, D)
    axes : (D - 3, 3)
        Axes of the angles.
    curvature : function
        Function from weights (J, 3) to the weighted sum (D - 3, D - 3) of the markers' second derivatives.
    """
    return derivatives_of(tree, tree.moved(state[None], np.ones(1)))


def derivatives_of(tree: Tree, moved_now: Moved) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Return first and second derivatives as `derivatives` does, given the result of `Tree.moved` for one state."""
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
