"""Forward kinematics of a tree of rigid segments, with its exact derivatives, for many frames at once.

Every segment has an origin fixed in its parent's frame and up to three rotations about its own z, y and x axes, in that
order (yaw, pitch, roll; right-handed; x forwards, y left, z up):

    O_segment = O_parent Rz(yaw) Ry(pitch) Rx(roll)        o_segment = o_parent + size O_parent offset

The first segment is the root: it is free, its frame's parent is the world. Markers are points fixed on segments. One
frame's unknowns, the state, are

    [root's origin (3), metres; root's yaw, pitch, roll, rad; the other segments' angles in their order]

Joint kinds differ in their axes only: hinge y, universal z y, ball z y x, free for the root; those of machines turn
about z ("turn") or slide along it ("slide", metres in place of an angle), their frames at a fixed rotation to the
parent's.
A "summed" universal joint has the angles of all its summed ancestors added to its own and turns relative to the root,
which is how the 8U chain (`recon.animal.chain`) counts its angles:

    O_segment = O_root Rz(sum of yaw) Ry(sum of pitch)

A marker is the root's origin plus vectors fixed in the frames of the segments between the root and it. An angle turns
some of these frames, and its derivative is axis x (the sum of the vectors in them): all frames that follow, or for a
summed joint those up to the next summed one, which is shifted without being turned. Of two angles, the outer turns what
the inner moves: the second derivative is the outer's axis x the derivative by the inner.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np

from recon.base.arrays import Array, Index

Joint = Literal["free", "ball", "universal", "hinge", "fixed", "summed", "turn", "slide"]

_OF_ANIMALS = {"free": "zyx", "ball": "zyx", "universal": "zy", "hinge": "y", "fixed": "", "summed": "zy"}
AXES: dict[str, str] = _OF_ANIMALS | {"turn": "z", "slide": "s"}
"""Rotations of each kind of joint, in the order of the state; "s" is a slide along z."""

ANGLE_OF_AXIS = {"z": "yaw", "y": "pitch", "x": "roll"}
"""What a rotation about each axis is called."""
_NAMES = ANGLE_OF_AXIS | {"s": "slide"}
_SUMMED = {"z": "phi", "y": "theta"}
"""What it is called of a summed joint, as published of the 8U chain."""

_BLOCK = 64
"""Frames whose Jacobian is worked out at once: the arrays in between stay in the processor's cache."""

_CYCLE = np.array([0, 1, 2, 0, 1])
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


@dataclass(frozen=True)
class _Plan:
    """What a tree's kinematics need besides the state.

    S + 1 frames: the world's, then the segments' in the order in which they can be computed. S + J points: the
    segments' origins, then the markers. K rotations. M pairs of a marker and a rotation that moves it. P pairs of a
    marker and an angle of the state.
    """

    frame: Index
    """(S,), of each segment."""
    angle: Index
    """(3, S + 1): which angle turns each frame about z, y and x; K: none."""
    levels: list[tuple[slice, Index]]
    """Frames that depend on earlier levels only, and the frames that they turn from."""
    points: Array
    """(S + J, 3 (S + 1)): each point as vectors in all frames."""
    axes: Index
    """(K,): the column of a frame that each rotation turns about."""
    pitched: Index
    """The axes that are turned back by the angles `rolls`, with the columns `z_axes`."""
    rolls: Index
    z_axes: Index
    turning: Index
    """(M,): rotation of each pair, which moves by axis x (arm - centre)."""
    arm: Index
    """(M,): point of each pair."""
    centre: Index
    """(M,): point of each pair."""
    merge: Array | None
    """(P, M): from the M pairs to those of a marker and an angle of the state. None: identity."""
    entries: Index
    """(P, 3): their places in a Jacobian (J, 3, D)."""
    placed: Array | None
    """(S + 1, 3, 3), the segments' rotations; None where none has any."""
    slides: Index
    """(L,): the rotations that are slides."""
    slid: Array
    """(S + J, L): 1 for the points that each slide shifts, otherwise 0."""
    sliding: Index
    """The pairs whose rotation is a slide."""
    outer: Array
    """(K, K): 1 where the first of two rotations turns what the second moves, otherwise 0."""
    gathered: Array
    """(K, M): 1 for the pairs of each rotation, otherwise 0."""
    marker: Index
    """(M,): marker of each pair."""


@dataclass(frozen=True)
class Tree:
    """Segments, root first and parents before children, and J markers; D = 6 + number of angles."""

    segments: tuple[Segment, ...]
    markers: tuple[Marker, ...]

    def scaled(self, size: float) -> Tree:
        """With all lengths times a factor."""

        def longer(offset_m: tuple[float, float, float]) -> tuple[float, float, float]:
            x, y, z = offset_m
            return size * x, size * y, size * z

        return Tree(
            tuple(replace(s, offset_m=longer(s.offset_m)) for s in self.segments),
            tuple(replace(m, offset_m=longer(m.offset_m)) for m in self.markers),
        )

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
        return tuple(axis for _, axis in self._rotations)

    @cached_property
    def n_state(self) -> int:
        return len(self.state_names)

    # -- what does not depend on the state -------------------------------------------------------------------------

    @cached_property
    def _index(self) -> dict[str, int]:
        return {s.name: i for i, s in enumerate(self.segments)}

    def _way(self, name: str | None) -> list[int]:
        """Segments from the root to that one."""
        way: list[int] = []
        while name is not None:
            way.insert(0, self._index[name])
            name = self.segments[way[0]].parent
        return way

    @cached_property
    def _rotations(self) -> list[tuple[int, str]]:
        """(segment, axis) of every angle of the state."""
        return [(i, axis) for i, s in enumerate(self.segments) for axis in AXES[s.joint]]

    @cached_property
    def _sums(self) -> Array:
        """(K + 1, K): which angles of the state add up to the angle that each rotation turns by; the last is 0."""
        sums = np.eye(len(self._rotations) + 1, len(self._rotations))
        for k, (i, axis) in enumerate(self._rotations):
            if self.segments[i].joint == "summed":
                for j in self._way(self.segments[i].parent):
                    if self.segments[j].joint == "summed":
                        sums[k, self._rotations.index((j, axis))] = 1.0
        return sums

    @cached_property
    def _ways(self) -> list[list[int]]:
        return [self._way(s.name) for s in self.segments]

    @cached_property
    def _bases(self) -> list[int]:
        """The segment whose frame each one but the root turns from: its parent's, of a summed one the root's."""
        return [0 if self.segments[way[-1]].joint == "summed" else way[-2] for way in self._ways[1:]]

    @cached_property
    def _order(self) -> tuple[Index, Index, list[tuple[slice, Index]]]:
        """Every segment's frame (S,), the frame that it turns from (S,), and the levels of `_Plan`."""
        bases = self._bases
        depth = [0]
        for base in bases:
            depth.append(depth[base] + 1)
        order = np.argsort(depth, kind="stable")
        frame = np.empty(len(depth), dtype=np.intp)
        frame[order] = np.arange(1, len(depth) + 1)
        base_frame = np.array([0, *frame[bases]], dtype=np.intp)
        ends = (1 + np.cumsum(np.bincount(depth))).tolist()
        return frame, base_frame, [(slice(a, b), base_frame[order[a - 1 : b - 1]]) for a, b in pairwise(ends)]

    @cached_property
    def _points(self) -> Array:
        """(S + J, 3, S + 1): segments' origins and markers as the sum of one vector in every frame."""
        S, frame = len(self.segments), self._order[0]
        points = np.zeros((S + len(self.markers), 3, S + 1))
        on = [way[-2] for way in self._ways[1:]] + [self._index[m.segment] for m in self.markers]
        for i, (parent, item) in enumerate(zip(on, (*self.segments[1:], *self.markers), strict=True), start=1):
            points[i] = points[parent]
            points[i, :, frame[parent]] = item.offset_m
        return points

    @cached_property
    def _pairs(self) -> list[tuple[int, int, int, int]]:
        """(marker, rotation, arm, centre): every marker that a rotation moves, and the points of `_Plan` that say how.

        The arm ends at the marker, or at the first summed joint on the way to it: what follows is not turned. The root
        turns all.
        """
        S, pairs = len(self.segments), []
        for j, marker in enumerate(self.markers):
            way = self._ways[self._index[marker.segment]]
            for k, (i, axis) in enumerate(self._rotations):
                if i in way:
                    later = way[way.index(i) + 1 :] if i > 0 else []
                    arm = next((s for s in later if self.segments[s].joint == "summed"), S + j)
                    slides = axis == "s" or any(self.segments[s].joint == "slide" for s in later)
                    if slides or (self._points[arm] != self._points[i]).any():
                        pairs.append((j, k, arm, i))
        return pairs

    @cached_property
    def _outer(self) -> Array:
        """As `_Plan.outer`: a segment is turned by those whose frames its own turns from, and by its own earlier
        angles."""
        outer = np.zeros((len(self._rotations), len(self._rotations)))
        for k, (inner, _) in enumerate(self._rotations):
            turned_by = [inner]
            while turned_by[-1] != 0:
                turned_by.append(self._bases[turned_by[-1] - 1])
            for i, (segment, axis) in enumerate(self._rotations[: k + 1]):
                outer[i, k] = axis != "s" and segment in turned_by
        return outer

    @cached_property
    def _plan(self) -> _Plan:
        S, K, J = len(self.segments), len(self._rotations), len(self.markers)
        frame, base_frame, levels = self._order
        angle = np.full((3, S + 1), K, dtype=np.intp)
        axes = np.empty((K, 2), dtype=np.intp)
        for k, (i, axis) in enumerate(self._rotations):
            if axis != "s":
                angle["zyx".index(axis), frame[i]] = k
            # Yaw turns about the z axis that the joint starts from, roll about the segment's x axis, and so does pitch
            # about its y axis where there is no roll. A joint of z alone has it in common with its segment.
            starts = axis == "z" and AXES[self.segments[i].joint] != "z"
            axes[k] = "xyz".index("z" if axis == "s" else axis), base_frame[i] if starts else frame[i]
        pitched = [k for k, (i, axis) in enumerate(self._rotations) if axis == "y" and (i, "x") in self._rotations]

        marker, turning, arm, centre = np.array(self._pairs, dtype=np.intp).reshape(-1, 4).T
        at, by, merge = marker, turning, None
        if any(s.joint == "summed" for s in self.segments):
            moving = (marker == np.arange(J)[:, None])[:, None] * self._sums[turning].T  # (J, K, M)
            at, by = np.nonzero(moving.any(axis=2))
            merge = moving[at, by]
        placed = np.tile(_IDENTITY, (S + 1, 1, 1))
        for i, segment in enumerate(self.segments):
            if segment.rotation is not None:
                placed[frame[i]] = segment.rotation
        slides = [k for k, (_, axis) in enumerate(self._rotations) if axis == "s"]
        ways = [*self._ways, *(self._ways[self._index[m.segment]] for m in self.markers)]
        return _Plan(
            frame=frame,
            angle=angle,
            levels=levels,
            points=self._points.reshape(S + J, 3 * (S + 1)),
            axes=axes @ (S + 1, 1),
            pitched=np.array(pitched, dtype=np.intp),
            rolls=np.array(pitched, dtype=np.intp) + 1,
            z_axes=2 * (S + 1) + axes[pitched, 1],
            turning=turning.copy(),
            arm=arm.copy(),
            centre=centre.copy(),
            merge=merge,
            entries=(3 * at[:, None] + np.arange(3)) * self.n_state + 3 + by[:, None],
            placed=placed if any(segment.rotation is not None for segment in self.segments) else None,
            slides=np.array(slides, dtype=np.intp),
            slid=np.array([[float(self._rotations[k][0] in way) for k in slides] for way in ways]),
            sliding=np.flatnonzero(np.isin(turning, slides)),
            outer=self._outer,
            gathered=(np.arange(K)[:, None] == turning).astype(float),
            marker=marker.copy(),
        )

    # -- kinematics ------------------------------------------------------------------------------------------------

    def _frames(self, state: Array) -> tuple[Array, Array, Array]:
        """Frames (3 columns, S + 1, 3, N), and cosine and sine (K + 1, N) of the angles; the last angle is 0."""
        plan, N = self._plan, len(state)
        angles = self._sums @ state[:, 3:].T
        cosine, sine = np.cos(angles), np.sin(angles)
        cz, cy, cx = cosine.take(plan.angle, axis=0)
        sz, sy, sx = sine.take(plan.angle, axis=0)
        czsy, szsy = cz * sy, sz * sy
        columns = (
            *(cz * cy, sz * cy, -sy),
            *(czsy * sx - sz * cx, szsy * sx + cz * cx, cy * sx),
            *(czsy * cx + sz * sx, szsy * cx - cz * sx, cy * cx),
        )
        turned = np.array(columns).reshape(3, 3, len(self.segments) + 1, N)  # of Rz Ry Rx
        if plan.placed is not None:
            turned = np.einsum("sab,cbsn->casn", plan.placed, turned)
        frames = np.empty((3, len(self.segments) + 1, 3, N))
        frames[:, :2] = turned[:, :, :2].swapaxes(1, 2)
        for level, base in plan.levels:
            np.einsum("cbsn,bsan->csan", turned[:, :, level], frames.take(base, axis=1), out=frames[:, level])
        return frames, cosine, sine

    def orientations(self, state: Array) -> Array:
        """T_world_segment's rotation for every segment, (N, S, 3, 3)."""
        return self._frames(state)[0][:, self._plan.frame].transpose(3, 1, 2, 0)

    def pose(self, state: Array, size: Array | float = 1.0) -> TreePose:
        """Markers for states (N, D); size: a factor on all offsets, one or (N,)."""
        relative = self._relative(self._frames(state)[0], state, size, slice(len(self.segments), None))
        return TreePose(state[:, None, ROOT] + relative.transpose(2, 0, 1))

    def origins(self, state: Array, size: Array | float = 1.0) -> Array:
        """The segments' origins in the world (N, S, 3), for states (N, D)."""
        relative = self._relative(self._frames(state)[0], state, size, slice(0, len(self.segments)))
        return state[:, None, ROOT] + relative.transpose(2, 0, 1)

    def _relative(self, frames: Array, state: Array, size: Array | float, which: slice) -> Array:
        """Some of `_Plan.points`, relative to the root (., 3, N), of the frames of `_frames`."""
        plan, N = self._plan, len(state)
        vectors = plan.points[which]
        relative = (vectors @ frames.reshape(vectors.shape[1], 3 * N)).reshape(len(vectors), 3, N) * size
        if len(plan.slides):
            along = frames.reshape(-1, 3, N).take(plan.axes[plan.slides], axis=0) * state.T[3 + plan.slides, None]
            relative += np.tensordot(plan.slid[which], along, 1)
        return relative

    def pose_with_jacobian(self, state: Array, size: Array | float = 1.0) -> TreePose:
        """Markers and their exact derivatives for states (N, D)."""
        N, J = len(state), len(self.markers)
        sizes = np.ones(N) * size
        relative, jacobian = np.empty((N, J, 3)), np.zeros((N, J, 3, self.n_state))
        rows = jacobian.reshape(N, J * 3 * self.n_state)
        for first in range(0, N, _BLOCK):
            block = slice(first, first + _BLOCK)
            points, _, moved = self._moved(state[block], sizes[block])
            if self._plan.merge is not None:
                moved = (self._plan.merge @ moved.reshape(len(moved), -1)).reshape(len(self._plan.merge), 3, -1)
            relative[block] = points.transpose(2, 0, 1)
            rows[block, self._plan.entries] = moved.transpose(2, 0, 1)
        jacobian[..., ROOT] = _IDENTITY
        return TreePose(state[:, None, ROOT] + relative, jacobian, relative)

    def derivatives(self, state: Array, size: float = 1.0) -> tuple[Array, Array, Callable[[Array], Array]]:
        """For one state (D,): the markers' Jacobian (J, 3, D), the axes (D - 3, 3) that each angle turns about or
        slides along, and a function that makes of weights (J, 3) the weighted sum (D - 3, D - 3) of the markers' second
        derivatives by the angles. The axes are those of joints that are not summed."""
        plan, J = self._plan, len(self.markers)
        _, axes, moved = self._moved(state[None], np.full(1, size))
        axes, moved = axes[..., 0], moved[..., 0]
        jacobian = np.zeros((J, 3, self.n_state))
        jacobian.reshape(-1)[plan.entries] = moved if plan.merge is None else plan.merge @ moved
        jacobian[..., ROOT] = _IDENTITY
        sums = self._sums[:-1]

        def curvature(weights: Array) -> Array:
            # weight . (outer axis x moved) = outer axis . (moved x weight)
            swept = plan.gathered @ np.cross(moved, weights.take(plan.marker, axis=0))
            pairs = plan.outer * (axes @ swept.T)
            pairs = pairs + np.triu(pairs, 1).T
            return sums.T @ pairs @ sums

        return jacobian, axes, curvature

    def _moved(self, state: Array, size: Array) -> tuple[Array, Array, Array]:
        """Markers relative to the root (J, 3, N), the rotations' axes (K, 3, N), and what each of `_Plan`'s pairs does,
        the derivative of its marker by its rotation (M, 3, N)."""
        plan, S, N = self._plan, len(self.segments), len(state)
        frames, cosine, sine = self._frames(state)
        # x, y, z, x, y: then the cross product's cyclic neighbours are slices.
        columns = frames.reshape(3 * (S + 1), 3, N).take(_CYCLE, axis=1)
        points = (plan.points @ columns.reshape(3 * (S + 1), 5 * N)).reshape(len(plan.points), 5, N) * size
        axes = columns.take(plan.axes, axis=0)
        if len(plan.pitched):
            y, z = axes[plan.pitched], columns[plan.z_axes]
            axes[plan.pitched] = cosine[plan.rolls, None] * y - sine[plan.rolls, None] * z
        if len(plan.slides):
            points += np.tensordot(plan.slid, axes[plan.slides] * state.T[3 + plan.slides, None], 1)
        about = axes.take(plan.turning, axis=0)
        arms = points.take(plan.arm, axis=0) - points.take(plan.centre, axis=0)
        moved = about[:, 1:4] * arms[:, 2:] - about[:, 2:] * arms[:, 1:4]
        moved[plan.sliding] = about[plan.sliding, :3]
        return points[S:, :3], axes[:, :3], moved
