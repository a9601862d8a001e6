"""Add the normal equations of several cameras' detections and of the feet, which are summed at the markers first.

Every residual r of these terms depends on a marker only through its position p, with the derivatives B. The position
has the derivatives A with respect to the state, L with respect to the lengths, and R with respect to the marker's own
keypoint bias. If W is the sum of B'B over the terms, the curvature is A'W A, A'W L and so on, so the wide products are
computed once for all terms. The feet also couple each frame with the next one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from recon.base.arrays import Array, Index, Integers
from recon.fit.banded import Normal
from recon.fit.terms import COMMON_KEYPOINT_BIAS, LENGTHS, SIZE, FootRows, PointRows, Span, keypoint_bias

ByShape = tuple[Array, Array]
"""Derivatives of the markers with respect to the lengths, (n, J, 3, L), and to each marker's own offset, (n, J, 3, 3).
"""


def add_markers(
    sums: Normal,
    columns: Mapping[str, slice],
    every_camera: Sequence[PointRows],
    every_foot: Sequence[FootRows],
    span: Span,
    start: int,
    by_shape: ByShape | None,
) -> float:
    """Add the normal equations of several cameras' detections and of the feet in place, and return their cost.

    The result is the same as from the residuals of each term, one after the other. `start` is the first frame of the
    sums.
    """
    own_frames = len(span.pose.points_m[span.own_rows])
    A = span.pose.jacobian if every_foot else span.pose.jacobian[span.own_rows]
    (N, J), D = A.shape[:2], A.shape[3]
    rows = slice(span.first - start, span.first - start + N)
    by_state = A.reshape(N, 3 * J, D).swapaxes(1, 2)
    L, R = _by_lengths_and_bias(columns, span, by_shape, N)
    border, corner, gradient = sums.border[rows], sums.corner, sums.shared_gradient
    weights = _marker_weights(columns, every_camera, every_foot, corner, gradient, (own_frames, N))
    own_columns, across, pull = weights.own_columns, weights.across, weights.pull
    if len(own_columns):
        add_to_columns(border, own_columns, by_state @ across.reshape(N, 3 * J, -1))
        if L is not None:
            _add_pair(corner, columns[LENGTHS], own_columns, L.T @ across.reshape(3 * N * J, -1))
        if R is not None:
            _add_pair(corner, columns[COMMON_KEYPOINT_BIAS], own_columns, _by_joint(R, across))
    biased = [p for p in every_camera if p.by_bias is not None and keypoint_bias(p.number) in columns]
    if biased:
        detected, by_length = slice(own_frames), None if L is None else L[: 3 * J * own_frames]
        _add_keypoint_bias(
            border[detected], corner, columns, biased, A[detected], by_length, None if R is None else R[detected]
        )
    sums.blocks[rows, 0] += by_state @ (weights.W @ A).reshape(N, 3 * J, D)
    if len(weights.feet):
        foot = A[:, weights.feet].reshape(N, -1, D)
        coupled = (weights.coupling @ A[:-1, weights.feet]).reshape(N - 1, -1, D)
        sums.blocks[rows.start : rows.stop - 1, 1] += foot[1:].swapaxes(1, 2) @ coupled
    sums.gradient[rows] += (by_state @ pull.reshape(N, 3 * J, 1))[..., 0]
    W_L = None if L is None else weights.times(L.reshape(N, J, 3, -1)).reshape(3 * N * J, -1)
    if L is not None and W_L is not None:
        lengths = columns[LENGTHS]
        border[..., lengths] += by_state @ W_L.reshape(N, 3 * J, -1)
        corner[lengths, lengths] += L.T @ W_L
        gradient[lengths] += L.T @ pull.ravel()
    if R is not None:
        bias, R_T, joints = columns[COMMON_KEYPOINT_BIAS], R.swapaxes(2, 3), np.arange(J)
        W_R = weights.times(R)
        border[..., bias] += (W_R.swapaxes(2, 3) @ A).reshape(N, 3 * J, D).swapaxes(1, 2)
        diagonal = (bias.start + 3 * joints)[:, None] + np.arange(3)
        corner[diagonal[:, :, None], diagonal[:, None]] += np.sum(R_T @ W_R, axis=0)
        gradient[bias] += np.sum(R_T @ pull[..., None], axis=0).ravel()
        if W_L is not None:
            _add_pair(corner, bias, np.r_[columns[LENGTHS]], _by_joint(R, W_L.reshape(N, J, 3, -1)))
    return sum(float(part.cost.sum()) for part in (*every_camera, *every_foot))


@dataclass(frozen=True)
class _MarkerWeights:
    """Sums of B'B, B'r and B'K over the terms of N frames, as the module defines them.

    K holds the derivatives of the residuals r with respect to the P shared unknowns `own_columns`, which are the size
    and the cameras' own unknowns except their keypoint bias.
    """

    W: Array
    """Sum of B'B, shape (N, J, 3, 3)."""
    feet: Index
    """Indices (F,) of the markers of the feet."""
    coupling: Array
    """Sum of B'B between a foot in the next frame (rows) and in a frame (columns), shape (N - 1, F, 3, 3)."""
    pull: Array
    """Sum of B'r, shape (N, J, 3)."""
    own_columns: Integers
    """Columns (P,) of the unknowns in K."""
    across: Array
    """Sum of B'K, shape (N, J, 3, P)."""

    def times(self, motion: Array) -> Array:
        """Return the curvature times a motion of the markers (N, J, 3, M), which includes that of neighbour frames."""
        product = self.W @ motion
        if len(self.feet):
            product[:-1, self.feet] += self.coupling.swapaxes(2, 3) @ motion[1:, self.feet]
            product[1:, self.feet] += self.coupling @ motion[:-1, self.feet]
        return product


def _marker_weights(
    columns: Mapping[str, slice],
    every_camera: Sequence[PointRows],
    every_foot: Sequence[FootRows],
    corner: Array,
    gradient: Array,
    frames: tuple[int, int],
) -> _MarkerWeights:
    """Return the sums over the terms of a span, and add the part of the cameras' own unknowns to corner and gradient.

    `frames` are the numbers of frames of the cameras and of all terms.
    """
    (n, N), J = frames, every_camera[0].residual.shape[1]
    names = {name for points in every_camera for name in points.by_shared if name in columns}
    own_columns = np.concatenate([np.zeros(0, dtype=int), *(np.r_[columns[name]] for name in names)])
    own_columns.sort()
    position = {name: int(np.searchsorted(own_columns, columns[name].start)) for name in names}
    by_point = np.concatenate([points.by_point for points in every_camera], axis=2)  # (n, J, 2V, 3)
    residual = np.concatenate([points.residual for points in every_camera], axis=2)  # (n, J, 2V)
    B_T = by_point.swapaxes(2, 3)
    W, pull, across = np.zeros((N, J, 3, 3)), np.zeros((N, J, 3)), np.zeros((N, J, 3, len(own_columns)))
    np.matmul(B_T, by_point, out=W[:n])
    np.matmul(B_T, residual[..., None], out=pull[:n, ..., None])
    for points in every_camera:
        of_camera = [name for name in points.by_shared if name in columns]
        K = np.concatenate([np.zeros((n, 2 * J, 0)), *(points.by_shared[name] for name in of_camera)], axis=2)
        own_of_camera = np.concatenate([np.zeros(0, dtype=int), *(np.r_[columns[name]] for name in of_camera)])
        for name in of_camera:
            part = slice(position[name], position[name] + points.by_shared[name].shape[2])
            by_own = points.by_shared[name].reshape(n, J, 2, -1)
            across[:n, ..., part] += np.einsum("njra,njrp->njap", points.by_point, by_own)
        _add_alone(corner, gradient, own_of_camera, K, points.residual)
        bias = columns.get(keypoint_bias(points.number))
        if points.by_bias is not None and bias is not None:
            by_bias = np.repeat(points.by_bias, 2, axis=1)  # the derivatives with respect to the bias are diagonal
            corner[bias, bias] += np.diag(np.sum(by_bias**2, axis=0))
            gradient[bias] += np.sum(by_bias * points.residual.reshape(by_bias.shape), axis=0)
            _add_pair(corner, bias, own_of_camera, np.einsum("nk,nkp->kp", by_bias, K))
    of_size = across[..., position[SIZE]] if SIZE in position else None
    feet, coupling = _add_feet(W, pull, of_size, every_foot)
    for rows in every_foot:
        if of_size is not None and rows.by_size is not None:
            _add_alone(corner, gradient, np.r_[columns[SIZE]], rows.by_size[..., None], rows.residual)
    return _MarkerWeights(W, feet, coupling, pull, own_columns, across)


def _add_feet(W: Array, pull: Array, of_size: Array | None, every_foot: Sequence[FootRows]) -> tuple[Index, Array]:
    """Add the terms of the feet to sums over N frames in place, and return `feet` and `coupling` of `_MarkerWeights`.

    `of_size` (N, J, 3) is the sum of B'K for the size; None if the size is fixed.
    """
    N, J = W.shape[:2]
    feet = np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *(rows.feet for rows in every_foot)]))
    coupling = np.zeros((N - 1, J if every_foot else 0, 3, 3))
    for rows in every_foot:
        square, (first, second) = rows.directions.T @ rows.directions, rows.scales
        coupling[:, rows.feet] += (first * second)[..., None, None] * square
        for scale, frames in ((first, slice(N - 1)), (second, slice(1, N))):
            W[frames, rows.feet] += (scale**2)[..., None, None] * square
            pull[frames, rows.feet] += scale[..., None] * (rows.residual @ rows.directions)
            if of_size is not None and rows.by_size is not None:
                of_size[frames, rows.feet] += scale[..., None] * (rows.by_size @ rows.directions)
    return feet, coupling[:, feet]


def _add_alone(corner: Array, gradient: Array, columns: Integers, K: Array, residual: Array) -> None:
    """Add K'K and K'r of some shared unknowns (P,) in place, from their derivatives K (..., P)."""
    flat = K.reshape(residual.size, len(columns))
    corner[np.ix_(columns, columns)] += flat.T @ flat
    gradient[columns] += flat.T @ residual.ravel()


def _add_keypoint_bias(
    border: Array,
    corner: Array,
    columns: Mapping[str, slice],
    biased: Sequence[PointRows],
    A: Array,
    L: Array | None,
    R: Array | None,
) -> None:
    """Add the curvature between the cameras' keypoint bias and states, lengths and common bias, in place.

    The keypoint bias of a joint in one camera moves only the two coordinates of that joint. A, L and R are defined at
    the top of this module.
    """
    N, J, _, D = A.shape
    across = np.concatenate(
        [p.by_point.swapaxes(2, 3) * np.expand_dims(np.asarray(p.by_bias), (2, 3)) for p in biased], axis=3
    )
    by_view = np.array([np.r_[columns[keypoint_bias(p.number)]] for p in biased]).reshape(-1, J, 2)
    bias_columns = by_view.swapaxes(0, 1).reshape(J, -1)  # (J, 2V), as the last axes of B'K (N, J, 3, 2V)
    by_state = (across.swapaxes(2, 3) @ A).reshape(N, J, -1, 2, D)
    for number, points in enumerate(biased):
        border[..., columns[keypoint_bias(points.number)]] += by_state[:, :, number].reshape(N, 2 * J, D).swapaxes(1, 2)
    stacked = across.swapaxes(0, 1).reshape(J, 3 * N, -1)
    if L is not None:
        by_length = L.reshape(N, J, 3, -1).transpose(1, 3, 0, 2).reshape(J, -1, 3 * N) @ stacked  # (J, L, 2V)
        _add_pair(corner, columns[LENGTHS], bias_columns.ravel(), by_length.swapaxes(0, 1).reshape(L.shape[1], -1))
    if R is not None:
        by_common = R.transpose(1, 3, 0, 2).reshape(J, 3, 3 * N) @ stacked  # (J, 3, 2V)
        for joint, values in enumerate(by_common):
            start = columns[COMMON_KEYPOINT_BIAS].start + 3 * joint
            _add_pair(corner, slice(start, start + 3), bias_columns[joint], values)


def _by_lengths_and_bias(
    columns: Mapping[str, slice], span: Span, by_shape: ByShape | None, N: int
) -> tuple[Array | None, Array | None]:
    """Return the derivatives of markers with respect to the lengths, (3NJ, L), and to their own keypoint bias.

    The derivatives with respect to the bias have the shape (N, J, 3, 3). Either array is None if its unknowns are
    fixed.
    """
    if by_shape is None:
        is_free = span.rotations is not None and COMMON_KEYPOINT_BIAS in columns
        return None, span.rotations[:N] if is_free and span.rotations is not None else None
    by_length, by_offset = (values[:N] for values in by_shape)
    by_length = by_length.reshape(-1, by_length.shape[3])
    if COMMON_KEYPOINT_BIAS not in columns:
        return by_length, None
    # Products for each joint are faster if its values are contiguous.
    return by_length, by_offset.swapaxes(0, 1).copy().swapaxes(0, 1)


def _by_joint(R: Array, values: Array) -> Array:
    """Return the sum over frames of R' v, (3J, P), for each joint, from R (N, J, 3, 3) and v (N, J, 3, P)."""
    N, J = R.shape[:2]
    transposed = R.transpose(1, 3, 0, 2).reshape(J, 3, 3 * N)
    return (transposed @ values.swapaxes(0, 1).reshape(J, 3 * N, -1)).reshape(3 * J, -1)


def _add_pair(corner: Array, rows: slice, columns: Integers, values: Array) -> None:
    """Add the curvature between two kinds of shared unknowns, in place, on both sides of the diagonal."""
    corner[rows, columns] += values
    corner[columns, rows] += values.T


def add_to_columns(border: Array, columns: Integers, values: Array) -> None:
    """Add values (n, D, C) to some columns (C,) of a border (n, D, P), in place."""
    breaks = [0, *(1 + np.flatnonzero(np.diff(columns) != 1)), len(columns)]
    for begin, end in pairwise(breaks if len(columns) else []):  # slices are many times faster than indices
        border[..., int(columns[begin]) : int(columns[end - 1]) + 1] += values[..., begin:end]
