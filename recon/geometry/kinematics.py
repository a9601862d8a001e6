"""Forward kinematics of a tree of rigid segments, with its exact derivatives, for many frames at once.

Every segment has an origin fixed in its parent's frame and up to three rotations about its own z, y and x axes, in that
order (yaw, pitch, roll; right-handed; x forwards, y left, z up):

    O_segment = O_parent Rz(yaw) Ry(pitch) Rx(roll)        o_segment = o_parent + size O_parent offset

The first segment is the root: it is free, its frame's parent is the world. Markers are points fixed on segments. One
frame's unknowns, the state, are [root's origin (3), metres; root's yaw, pitch, roll, rad; the other segments' angles].

Joint kinds differ in their axes only: hinge y, universal z y, ball z y x, free for the root; those of machines turn
about z ("turn") or slide along it ("slide", metres in place of an angle), their frames at a fixed rotation to the
parent's. A "summed" universal joint, of the 8U chain (`recon.animal.chain`), has the angles of all its summed ancestors
added to its own and turns relative to the root: O_segment = O_root Rz(sum of yaw) Ry(sum of pitch).

A marker is the root's origin plus vectors fixed in the frames between the root and it. An angle's derivative is axis x
(the sum of the vectors in the frames that it turns): all that follow, or for a summed joint those up to the next summed
one. Of two angles, the second derivative is the outer's axis x the derivative by the inner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from recon.base.arrays import Array, Brief

Joint = Literal["free", "ball", "universal", "hinge", "fixed", "summed", "turn", "slide"]

AXES: dict[str, str] = {"free": "zyx", "ball": "zyx", "universal": "zy", "hinge": "y", "fixed": "", "summed": "zy"}
AXES |= {"turn": "z", "slide": "s"}
"""Rotations of each kind of joint, in the order of the state; "s" is a slide along z."""

ANGLE_OF_AXIS = {"z": "yaw", "y": "pitch", "x": "roll"}
"""What a rotation about each axis is called."""
_NAMES = ANGLE_OF_AXIS | {"s": "slide"}
_SUMMED = {"z": "phi", "y": "theta"}
"""What it is called of a summed joint, as published of the 8U chain."""

_BLOCK, _FRAMES_AT_ONCE = 64, 4096
"""Frames whose Jacobian is worked out at once, to stay in the processor's cache; and whose poses are, to stay small."""

CYCLE = np.array([0, 1, 2, 0, 1])
_IDENTITY, _NONE = np.eye(3), np.zeros(0)

ROOT = slice(0, 3)
"""The root's origin in the state."""
YAW, PITCH, ROLL = 3, 4, 5
"""The root's rotation in the state."""


@dataclass(frozen=True)
class Segment:
    """A rigid part of a tree."""

    name: str
    parent: str | None
    """The name of an earlier segment, None for the root."""
    joint: Joint
    """How it turns against its parent."""
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Its origin in its parent's frame, (x, y, z)."""
    rotation: tuple[tuple[float, ...], ...] | None = None
    """(3, 3), from its frame to its parent's before its joint moves; of the joints turn, slide and fixed only."""


@dataclass(frozen=True)
class Marker:
    """A point fixed on a segment, offset_m (x, y, z) from its origin in its frame."""

    name: str
    segment: str
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TreePose:
    """Where N states put a tree's J markers; the derivatives are empty unless they were asked for."""

    points_m: Array
    """(N, J, 3), the markers in the world."""
    jacobian: Array = field(default_factory=lambda: _NONE)
    """(N, J, 3, D), by the state."""
    d_size: Array = field(default_factory=lambda: _NONE)
    """(N, J, 3), by the logarithm of the size."""


class _Plan:
    """What a tree's kinematics need besides the state, of S segments, J markers, K rotations, M pairs of a marker and a
    rotation that moves it, and P pairs of a marker and an angle of the state."""

    def __init__(self, tree: Tree) -> None:
        segments, markers, rotations = tree.segments, tree.markers, tree.rotations
        S, K, J = len(segments), len(rotations), len(markers)
        at = {segment.name: i for i, segment in enumerate(segments)}
        summed = [segment.joint == "summed" for segment in segments]
        ways: list[list[int]] = []
        """The segments from the root to each one."""
        for i, segment in enumerate(segments):
            ways.append([i] if segment.parent is None else [*ways[at[segment.parent]], i])
        bases = [0 if summed[way[-1]] else way[-2] for way in ways[1:]]
        """The segment whose frame each one but the root turns from: its parent's, of a summed one the root's."""
        on = [way[-2] for way in ways[1:]] + [at[marker.segment] for marker in markers]
        """The segment that each origin but the root's, and each marker, is fixed on."""

        self.sums = np.eye(K + 1, K)
        """(K + 1, K): which angles of the state add up to the angle that each rotation turns by; the last is 0."""
        for k, (i, axis) in enumerate(rotations):
            for j in ways[i][:-1]:
                if summed[i] and summed[j]:
                    self.sums[k, rotations.index((j, axis))] = 1.0

        depth, base_frame = [0], np.array([0, *(base + 1 for base in bases)], dtype=np.intp)
        for base in bases:
            depth.append(depth[base] + 1)
        levels = [np.flatnonzero(np.equal(depth, level)) for level in range(max(depth) + 1)]
        self.levels = [(1 + level, base_frame[level]) for level in levels]
        """Frames that depend on earlier levels only, and the frames that they turn from."""

        points = np.zeros((S + J, 3, S + 1))
        for i, (parent, item) in enumerate(zip(on, (*segments[1:], *markers), strict=True), start=1):
            points[i] = points[parent]
            points[i, :, parent + 1] = item.offset_m
        self.points = points.reshape(S + J, 3 * (S + 1))
        """(S + J, 3 (S + 1)): each point as vectors in all frames."""

        self.angle = np.full((3 if any(axis == "x" for _, axis in rotations) else 2, S + 1), K, dtype=np.intp)
        """(3, S + 1): which angle turns each frame about z, y and, where any is turned about that, x; K: none."""
        axes = np.empty((K, 2), dtype=np.intp)
        for k, (i, axis) in enumerate(rotations):
            if axis != "s":
                self.angle["zyx".index(axis), i + 1] = k
            # Yaw turns about the z axis that the joint starts from, roll about the segment's x axis, and so does pitch
            # about its y axis where there is no roll. A joint of z alone has it in common with its segment.
            starts = axis == "z" and AXES[segments[i].joint] != "z"
            axes[k] = "xyz".index("z" if axis == "s" else axis), base_frame[i] if starts else i + 1
        self.axes = axes @ (S + 1, 1)
        """(K,): the column of a frame that each rotation turns about."""
        pitched = [k for k, (i, axis) in enumerate(rotations) if axis == "y" and (i, "x") in rotations]
        self.pitched = np.array(pitched, dtype=np.intp)
        """The axes that are turned back by the angles `rolls`, with the columns `z_axes`."""
        self.rolls = self.pitched + 1
        self.z_axes = 2 * (S + 1) + axes[pitched, 1]

        # The arm ends at the marker, or at the first summed joint on the way to it: what follows is not turned. The
        # root turns all.
        pairs = []
        for j, way in enumerate(ways[i] for i in on[S - 1 :]):
            for k, (i, axis) in enumerate(rotations):
                later = way[way.index(i) + 1 :] if i in way and i > 0 else []
                arm = next((s for s in later if summed[s]), S + j)
                slides = axis == "s" or any(segments[s].joint == "slide" for s in later)
                if i in way and (slides or (points[arm] != points[i]).any()):
                    pairs.append((j, k, arm, i))
        self.marker, self.turning, self.arm, self.centre = np.array(pairs, dtype=np.intp).reshape(-1, 4).T.copy()
        """(M,) each: marker and rotation of each pair, which moves by axis x (arm - centre), two points."""
        marker, by, self.merge = self.marker, self.turning, None
        """merge (P, M): from the M pairs to those of a marker and an angle of the state. None: identity."""
        if any(summed):
            moving = (marker == np.arange(J)[:, None])[:, None] * self.sums[self.turning].T  # (J, K, M)
            marker, by = np.nonzero(moving.any(axis=2))
            self.merge = moving[marker, by]
        self.entries = (3 * marker[:, None] + np.arange(3)) * tree.n_state + 3 + by[:, None]
        """(P, 3): their places in a Jacobian (J, 3, D)."""

        self.placed = None
        """(S + 1, 3, 3), the segments' rotations; None where none has any."""
        if any(segment.rotation is not None for segment in segments):
            self.placed = np.array([_IDENTITY, *(_IDENTITY if s.rotation is None else s.rotation for s in segments)])
        slides = [k for k, (_, axis) in enumerate(rotations) if axis == "s"]
        self.slides = np.array(slides, dtype=np.intp)
        """(L,): the rotations that are slides."""
        reached = [*ways, *(ways[i] for i in on[S - 1 :])]
        self.slid = np.array([[float(rotations[k][0] in way) for k in slides] for way in reached])
        """(S + J, L): 1 for the points that each slide shifts, otherwise 0."""
        self.sliding = np.flatnonzero(np.isin(self.turning, slides))
        """The pairs whose rotation is a slide."""

        # A segment is turned by those whose frames its own turns from, and by its own earlier angles.
        self.outer = np.zeros((K, K))
        """(K, K): 1 where the first of two rotations turns what the second moves, otherwise 0."""
        for k, (inner, _) in enumerate(rotations):
            turned_by = [inner]
            while turned_by[-1] != 0:
                turned_by.append(bases[turned_by[-1] - 1])
            for i, (segment, axis) in enumerate(rotations[: k + 1]):
                self.outer[i, k] = axis != "s" and segment in turned_by
        self.gathered = (np.arange(K)[:, None] == self.turning).astype(float)
        """(K, M): 1 for the pairs of each rotation, otherwise 0."""


@dataclass(frozen=True, repr=False)
class Tree(Brief):
    """Segments, root first and parents before children, and J markers; D = 6 + number of angles."""

    segments: tuple[Segment, ...]
    markers: tuple[Marker, ...]

    def lengthened(self, factor_of: Callable[[str], float]) -> Tree:
        """With the offsets of segments and markers longer by a factor of their names."""

        def longer(one: Any) -> Any:
            return replace(one, offset_m=tuple(float(factor_of(one.name)) * value for value in one.offset_m))

        return Tree(tuple(map(longer, self.segments)), tuple(map(longer, self.markers)))

    def scaled(self, size: float) -> Tree:
        """With all lengths times a factor."""
        return self.lengthened(lambda _: size)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """(D,): x_m, y_m, z_m, then <segment>_yaw and so on; of the summed joint of segment J6 phi_6 and theta_6."""
        names = [
            f"{_SUMMED[axis]}_{s.name.lstrip('J')}" if s.joint == "summed" else f"{s.name}_{_NAMES[axis]}"
            for s in self.segments
            for axis in AXES[s.joint]
        ]
        return ("x_m", "y_m", "z_m", *names)

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """(D - 3,): what each angle of the state turns about, "x", "y" or "z"."""
        return tuple(axis for _, axis in self.rotations)

    @cached_property
    def n_state(self) -> int:
        return len(self.state_names)

    @cached_property
    def rotations(self) -> list[tuple[int, str]]:
        """The segment, by its place, and the axis of every angle of the state."""
        return [(i, axis) for i, s in enumerate(self.segments) for axis in AXES[s.joint]]

    @cached_property
    def plan(self) -> _Plan:
        return _Plan(self)

    # -- kinematics ------------------------------------------------------------------------------------------------

    def _frames(self, state: Array) -> tuple[Array, Array, Array]:
        """Frames (3 columns, S + 1, 3, N), and cosine and sine (K + 1, N) of the angles; the last angle is 0."""
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
        turned = columns.reshape(3, 3, len(self.segments) + 1, N)  # of Rz Ry Rx
        if plan.placed is not None:
            turned = np.einsum("sab,cbsn->casn", plan.placed, turned)
        frames = np.empty((3, len(self.segments) + 1, 3, N))
        frames[:, :2] = turned[:, :, :2].swapaxes(1, 2)
        for level, base in plan.levels:
            frames[:, level] = np.einsum("cbsn,bsan->csan", turned[:, :, level], frames.take(base, axis=1))
        return frames, cosine, sine

    def orientations(self, state: Array) -> Array:
        """T_world_segment's rotation for every segment, (N, S, 3, 3)."""
        return self._frames(state)[0][:, 1:].transpose(3, 1, 2, 0)

    def pose(self, state: Array, size: Array | float = 1.0) -> TreePose:
        """Markers for states (N, D); size: a factor on all offsets, one or (N,)."""
        sizes, relative = np.ones(len(state)) * size, np.empty((len(state), len(self.markers), 3))
        for first in range(0, len(state), _FRAMES_AT_ONCE):
            block = slice(first, first + _FRAMES_AT_ONCE)
            points = self._points(self._frames(state[block])[0], state[block], sizes[block])
            relative[block] = points[len(self.segments) :].transpose(2, 0, 1)
        return TreePose(state[:, None, ROOT] + relative)

    def origins(self, state: Array) -> Array:
        """The segments' origins in the world (N, S, 3), for states (N, D)."""
        relative = self._points(self._frames(state)[0], state, 1.0)[: len(self.segments)]
        return state[:, None, ROOT] + relative.transpose(2, 0, 1)

    def _points(self, frames: Array, state: Array, size: Array | float) -> Array:
        """`_Plan.points` relative to the root (S + J, 3, N), of the frames of `_frames`."""
        plan, N = self.plan, len(state)
        columns = frames.reshape(plan.points.shape[1], 3, N)
        points = np.tensordot(plan.points, columns, 1) * size
        if len(plan.slides):
            along = columns.take(plan.axes[plan.slides], axis=0) * state.T[3 + plan.slides, None]
            points += np.tensordot(plan.slid, along, 1)
        return points

    def pose_with_jacobian(self, state: Array, size: Array | float = 1.0) -> TreePose:
        """Markers and their exact derivatives for states (N, D)."""
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
        """Markers relative to the root (J, 3, N), the rotations' axes (K, 3, N), and for each of `_Plan`'s pairs the
        derivative of its marker by its rotation (M, 3, N)."""
        plan, N = self.plan, len(state)
        frames, cosine, sine = self._frames(state)
        points, columns = self._points(frames, state, size), frames.reshape(plan.points.shape[1], 3, N)
        axes = columns.take(plan.axes, axis=0)
        if len(plan.pitched):
            y, z = axes[plan.pitched], columns[plan.z_axes]
            axes[plan.pitched] = cosine[plan.rolls, None] * y - sine[plan.rolls, None] * z
        # x, y, z, x, y: then the cross product's cyclic neighbours are slices
        about = axes.take(CYCLE, axis=1).take(plan.turning, axis=0)
        cyclic = points.take(CYCLE, axis=1)
        arms = cyclic.take(plan.arm, axis=0) - cyclic.take(plan.centre, axis=0)
        moved = about[:, 1:4] * arms[:, 2:] - about[:, 2:] * arms[:, 1:4]
        if len(plan.sliding):
            moved[plan.sliding] = about[plan.sliding, :3]
        return points[len(self.segments) :], axes, moved


def derivatives(tree: Tree, state: Array) -> tuple[Array, Array, Callable[[Array], Array]]:
    """For one state (D,), as inverse kinematics needs them: the markers' Jacobian (J, 3, D), the axes (D - 3, 3) of the
    angles, of joints that are not summed, and a function from weights (J, 3) to the weighted sum (D - 3, D - 3) of the
    markers' second derivatives."""
    plan, J = tree.plan, len(tree.markers)
    _, axes, moved = tree.moved(state[None], np.ones(1))
    axes, moved = axes[..., 0], moved[..., 0]
    jacobian = np.zeros((J, 3, tree.n_state))
    jacobian.reshape(-1)[plan.entries] = moved if plan.merge is None else plan.merge @ moved
    jacobian[..., ROOT] = np.eye(3)
    sums = plan.sums[:-1]

    def curvature(weights: Array) -> Array:
        # weight . (outer axis x moved) = outer axis . (moved x weight)
        by = weights.take(plan.marker, axis=0).take(CYCLE, axis=1)
        along = moved.take(CYCLE, axis=1)
        swept = plan.gathered @ (along[:, 1:4] * by[:, 2:] - along[:, 2:] * by[:, 1:4])
        pairs = plan.outer * (axes @ swept.T)
        pairs = pairs + np.triu(pairs, 1).T
        return sums.T @ pairs @ sums

    return jacobian, axes, curvature
