"""One adjustment of all frames and keyframes to what each saw of the others, so that a return shows no drift.

What a frame saw of a keyframe is kept as one link: the turn between them and its normal equations, not its points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Index
from recon.calibrate.camera_motion.rotation import Orientation

STEPS = 4
FLOOR_PX = 0.1
"""Of what all points of a picture may be off together, which their scatter does not show."""


@dataclass(frozen=True, eq=False)
class FrameLink:
    """A frame's points in a keyframe (both by their place among the frames). Their cost is e'He - 2 g'e; e: how much
    further the frame is turned (rad) from the keyframe than by `turn` (3, 3), and how far the log zooms of frame and
    keyframe are from `log_zooms` (2,). normal: H (5, 5). gradient: g (5,)."""

    frame: int
    key: int
    turn: Array
    log_zooms: Array
    normal: Array
    gradient: Array


def adjust(
    turns: Sequence[Orientation], links: Sequence[FrameLink], solve_zoom: bool, floor_rad: float
) -> tuple[tuple[Orientation, ...], Array, Array]:
    """The turns of the N frames, of which the first stays; their standard deviations (N,), rad per axis, against the
    first frame; and those of the zooms (N,), relative. links: of every other frame at least one. floor_rad: see
    FLOOR_PX."""
    n, p = len(turns), 4 if solve_zoom else 3
    rotation = np.stack([turn.rotation for turn in turns])
    log_zoom = np.log([turn.zoom for turn in turns])
    frame = np.array([link.frame for link in links], dtype=np.intp)
    key = np.array([link.key for link in links], dtype=np.intp)
    columns = np.concatenate([(end[:, None] * p + np.arange(p)) for end in (frame, key)], axis=1)
    rows_of, columns_of = np.repeat(columns, 2 * p, axis=1), np.tile(columns, (1, 2 * p))
    normal = np.stack([link.normal for link in links])
    gradient = np.stack([link.gradient for link in links])
    measured, at = np.stack([link.turn for link in links]), np.stack([link.log_zooms for link in links])
    factor = None
    blocks = np.zeros((0, 2 * p, 2 * p))
    for _ in range(STEPS):
        between = rotation[frame] @ rotation[key].swapaxes(1, 2)
        e = np.zeros((len(links), 5))
        e[:, :3] = Rotation.from_matrix(between @ measured.swapaxes(1, 2)).as_rotvec()
        e[:, 3], e[:, 4] = log_zoom[frame] - at[:, 0], log_zoom[key] - at[:, 1]
        J = np.zeros((len(links), 5, 2 * p))
        J[:, :3, :3], J[:, :3, p : p + 3] = np.eye(3), -between
        if solve_zoom:
            J[:, 3, 3] = J[:, 4, 7] = 1.0
        blocks = J.swapaxes(1, 2) @ normal @ J
        downhill = np.einsum("lea,le->la", J, gradient - np.einsum("lef,lf->le", normal, e))
        fixed = np.arange(p), np.arange(p), np.full(p, 1e6 * blocks[:, range(p), range(p)].max())
        values = np.concatenate([blocks.ravel(), fixed[2]])
        places = np.concatenate([rows_of.ravel(), fixed[0]]), np.concatenate([columns_of.ravel(), fixed[1]])
        factor = splu(coo_array((values, places), shape=(n * p, n * p)).tocsc())
        right = np.bincount(columns.ravel(), downhill.ravel(), minlength=n * p)
        step = factor.solve(right).reshape(n, p)
        rotation = Rotation.from_rotvec(step[:, :3]).as_matrix() @ rotation
        if solve_zoom:
            log_zoom = log_zoom + step[:, 3]
    assert factor is not None
    sigma = _sigma(factor.solve, blocks, frame, key, n, p)
    found = tuple(Orientation(r, float(z)) for r, z in zip(rotation, np.exp(log_zoom), strict=True))
    sigma_zoom = sigma[:, 3] if solve_zoom else np.zeros(n)
    return found, np.hypot(np.sqrt((sigma[:, :3] ** 2).mean(axis=1)), floor_rad), sigma_zoom


def _sigma(solve: Callable[[Array], Array], blocks: Array, frame: Index, key: Index, n: int, p: int) -> Array:
    """(n, p): of keyframes from the inverse; of a frame that is none, its own and its keyframes' on average."""
    variance = np.full((n, p), np.nan)
    for k in np.unique(key):
        unit = np.zeros((n * p, p))
        unit[k * p + np.arange(p), np.arange(p)] = 1.0
        variance[k] = np.diag(solve(unit)[k * p : (k + 1) * p])
    own, keys, count = np.zeros((n, p, p)), np.zeros((n, p)), np.zeros(n)
    np.add.at(own, frame, blocks[:, :p, :p])
    np.add.at(keys, frame, variance[key])
    np.add.at(count, frame, 1)
    others = np.flatnonzero(np.isnan(variance[:, 0]))
    inverse = np.linalg.inv(own[others])
    variance[others] = inverse[:, range(p), range(p)] + keys[others] / count[others, None]
    return np.sqrt(np.maximum(variance, 0))
