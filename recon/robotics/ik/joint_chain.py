"""Serial chains of any joints in space: joints that turn or slide, each placed rigidly on the link before it.

Joint j is at rotation R_j, offset p_j in the frame of the link before (the first: the base's) and turns about its axis
a_j, or slides along it. Written with frames whose z axis is the joint's, F_j = F_{j-1} S_j Z(q_j), where S_j is fixed
and Z a rotation about z or a translation along it. With w_j and o_j the axis and the origin of F_j in the base frame,
and p the end effector,

    J_j = w_j x (p - o_j) where joint j turns, w_j where it slides
    d J_j / d q_i = w_i x J_j for i <= j where joint i turns, 0 where it slides

and the second derivatives are symmetric.
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools, Index
from recon.robotics.ik.chain import MAX_RATE_RAD_S, Curvature, SerialChain

_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


class JointChain(SerialChain):
    """n joints in space: q (n,), rad, or metres of those that slide.

    offsets_m (n, 3), rotations (n): each joint's place on the link before it, None: not turned; axes (n, 3): in its own
    frame; sliding: one or (n,), which slide along their axes; tool_m (3,), tool_rotation: the end effector on the last
    link; limits_rad: lower and upper, each one number or (n,); max_rate_rad_s: one or (n,); groups: joints of one kind
    in their order along the chain, None: all are. Raises ValueError.

    lengths_m (n,): from each joint to the next, the last to the end effector, with nothing slid out.
    """

    lengths_m: Array
    sliding: Bools

    def __init__(
        self,
        offsets_m: ArrayLike,
        axes: ArrayLike,
        rotations: Rotation | None = None,
        sliding: ArrayLike = False,
        tool_m: ArrayLike = (0.0, 0.0, 0.0),
        tool_rotation: Rotation | None = None,
        limits_rad: tuple[ArrayLike, ArrayLike] | None = None,
        max_rate_rad_s: ArrayLike = MAX_RATE_RAD_S,
        groups: tuple[tuple[int, ...], ...] | None = None,
    ) -> None:
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
        super().__init__(n, limits_rad, max_rate_rad_s, (tuple(range(n)),) if groups is None else groups)

        placed = np.tile(np.eye(4), (n + 1, 1, 1))
        placed[:n, :3, :3], placed[:n, :3, 3], placed[n, :3, 3] = turned, offsets, tool
        if tool_rotation is not None:
            placed[n, :3, :3] = tool_rotation.as_matrix()
        z_along = np.tile(np.eye(4), (n + 1, 1, 1))
        z_along[:n, :3, :3] = _with_z_along(axes / sizes[:, None])
        placed[1:] = z_along[:-1].transpose(0, 2, 1) @ placed[1:]
        slides = np.array(np.broadcast_to(sliding, n), bool)
        fixed = placed @ z_along
        order = np.arange(n)
        self._set(
            lengths_m=np.linalg.norm(fixed[1:, :3, 3], axis=1),
            sliding=slides,
            _fixed=fixed[:n],
            _tool=fixed[n],
            _turns=(~slides).astype(float),
            _pairs=np.minimum(order[:, None], order) * n + np.maximum(order[:, None], order),
        )

    _fixed: Array
    """(n, 4, 4): S_j."""
    _tool: Array
    """(4, 4): the end effector in F_n."""
    _turns: Array
    """(n,): 1 for the joints that turn, 0 for those that slide."""
    _pairs: Index
    """(n, n): index into a flat (n, n) of the earlier and the later of two joints."""

    @property
    def dim(self) -> int:
        return 3

    @property
    def joint_lengths_m(self) -> Array:
        """(n,): to the next place along the chain that is not the joint's own; 0 where there is none."""
        lengths = self.lengths_m.copy()
        for j in range(self.n - 2, -1, -1):
            if lengths[j] == 0:
                lengths[j] = lengths[j + 1]
        return lengths

    @property
    def reach_m(self) -> tuple[float, float]:
        """From the triangle inequality: not every distance between has to be reached."""
        base = float(np.linalg.norm(self._fixed[0, :3, 3]))
        hops = [(base, base)]
        for j, fixed in enumerate((*self._fixed[1:], self._tool)):
            start = fixed[:3, 3]
            if not self.sliding[j]:
                length = float(self.lengths_m[j])
                hops.append((length, length))
                continue
            # The next place is start + q z in this joint's frame before it slides.
            across, low, high = float(np.hypot(*start[:2])), start[2] + self.lower_rad[j], start[2] + self.upper_rad[j]
            nearest = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
            hops.append((float(np.hypot(across, nearest)), float(np.hypot(across, max(abs(low), abs(high))))))
        most = sum(longest for _, longest in hops)
        others = [sum(longest for k, (_, longest) in enumerate(hops) if k != j) for j in range(len(hops))]
        return max(0.0, *(shortest - rest for (shortest, _), rest in zip(hops, others, strict=True))), most

    def _frames(self, q: Array) -> Array:
        """F_j (n, 4, 4)."""
        turn, slide = q * self._turns, q * (1.0 - self._turns)
        moved = np.zeros((len(q), 4, 4))
        cosine, sine = np.cos(turn), np.sin(turn)
        moved[:, 0, 0] = moved[:, 1, 1] = cosine
        moved[:, 0, 1], moved[:, 1, 0], moved[:, 2, 3] = -sine, sine, slide
        moved[:, 2, 2] = moved[:, 3, 3] = 1.0
        return np.array(list(accumulate(self._fixed @ moved, np.dot)))

    def positions(self, q: Array) -> Array:
        """The joints' origins and the end effector (n + 1, 3)."""
        frames = self._frames(q)
        return np.concatenate([frames[:, :3, 3], (frames[-1] @ self._tool)[None, :3, 3]])

    def end(self, q: Array) -> Array:
        return self.pose(q)[1]

    def pose(self, q: Array) -> tuple[Array, Array]:
        """T_base_end: rotation (3, 3) and position (3,) of the end effector."""
        end = self._frames(q)[-1] @ self._tool
        return end[:3, :3], end[:3, 3]

    def joint_axes(self, q: Array) -> Array:
        """(n, 3): unit vectors along the joints' axes, in the base frame."""
        return self._frames(q)[:, :3, 2]

    def geometric_jacobian(self, q: Array) -> Array:
        """(6, n): velocity (m/s) and angular velocity (rad/s) of the end effector, in the base frame."""
        J, turning = self._axes(q)
        return np.concatenate([J, turning])

    def derivatives(self, q: Array) -> tuple[Array, Curvature]:
        J, turning = self._axes(q)

        def curvature(mu: Array) -> Array:
            # mu . (w_i x J_j) = w_i . (J_j x mu) for i <= j.
            return (turning.T @ _cross(J, mu[:, None])).take(self._pairs)

        return J, curvature

    def _axes(self, q: Array) -> tuple[Array, Array]:
        """J (3, n), and w (3, n) of the joints that turn, 0 for the others."""
        frames = self._frames(q)
        axes, origins = frames[:, :3, 2].T, frames[:, :3, 3].T
        end = frames[-1] @ self._tool
        turning = axes * self._turns
        J = _cross(turning, end[:3, 3:] - origins)
        return (J + (axes - turning) if self.sliding.any() else J), turning


def _cross(a: Array, b: Array) -> Array:
    """Cross products of columns, (3, n) each; several times quicker than `numpy.cross`."""
    return a[_NEXT] * b[_AFTER] - a[_AFTER] * b[_NEXT]


def _with_z_along(axes: Array) -> Array:
    """Rotations (n, 3, 3) whose z axes are the given unit vectors (n, 3); none for the z axis itself."""
    out = np.empty((len(axes), 3, 3))
    for k, z in enumerate(axes):
        x = np.eye(3)[np.argmin(np.abs(z))]
        x = x - (x @ z) * z
        x /= np.linalg.norm(x)
        out[k] = np.column_stack([x, np.cross(z, x), z])
    return out
