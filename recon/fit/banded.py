"""Normal equations of a clip: each of T frames has D unknowns and is coupled with the W frames before and after it.

H (TD, TD) is symmetric and positive definite; its block (t + k, t), D x D, is zero for k > W. Time and memory are
linear in T. H = L L', and L has the band of H.

The inverse of H is the covariance of a Gaussian x, and is full; only its blocks near the diagonal are needed. L' x = z
with z white. Its block row t gives frame t from the W frames after it,

    x_t = gain_t x_later + L_tt^-T z_t,   gain_t = -L_tt^-T [L_t+1,t' ... L_t+W,t'],   later = t + 1, ..., t + W

so that Z = H^-1 follows backwards from the last frame, the window Z[later, later] moving along:

    Z[t, later] = gain_t Z[later, later],   Z[t, t] = L_tt^-T L_tt^-1 + Z[t, later] gain_t'

These are Takahashi's equations in blocks, and the smoother of Rauch, Tung and Striebel. Both terms of Z[t, t] are
positive semidefinite: nothing is lost by a difference.

Unknowns that all frames share border the matrix:

    [H  B] [x]   [b]          S = C - B' Y,  Y = H^-1 B
    [B' C] [s] = [c],    s = S^-1 (c - Y' b),  x = H^-1 b - Y s

S^-1 is the covariance of s, -Y S^-1 that of x with s, and H^-1 + Y S^-1 Y' that of x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs

from recon.base.arrays import Array, Index

_COLUMNS_AT_ONCE = 32


@dataclass(frozen=True)
class BlockBanded:
    """A symmetric block-banded matrix H, by the blocks of its lower triangle.

    blocks (T, W+1, D, D): blocks[t, k] is the block in block row t + k and block column t. blocks[:, 0] are symmetric.
    Blocks with t + k >= T lie outside and are ignored.
    """

    blocks: Array

    def to_lower_band(self) -> Array:
        """LAPACK's lower band storage, ((W+1)D, TD) in Fortran order: band[i - j, j] = H[i, j] for i >= j."""
        T, n_blocks, D, _ = self.blocks.shape
        P = n_blocks * D
        columns = np.zeros((T, D, P))  # one column of H each, from its diagonal down
        for j in range(D):
            columns[:, j, : P - j] = self.blocks[..., j].reshape(T, P)[:, j:]
        band = columns.reshape(T * D, P).T
        last = min(P, T * D)
        band[:, -last:][np.add.outer(np.arange(P), np.arange(last)) >= last] = 0.0  # what lies outside
        return band


@dataclass(frozen=True)
class Normal:
    """Normal equations: H, its gradient (T, D), and the border of P shared unknowns: border (T, D, P), corner (P, P)
    and their gradient (P,). P may be 0."""

    H: BlockBanded
    gradient: Array
    border: Array
    corner: Array
    shared_gradient: Array

    def step(self, damping: float) -> tuple[Array, Array]:
        """The step (T, D) and (P,) towards the minimum, with damping added to the diagonal.

        Raises numpy.linalg.LinAlgError if the matrix is not positive definite to rounding.
        """
        factored = factor(self.H, np.full(self.gradient.shape, damping))
        step = factored.solve(-self.gradient)
        if not len(self.corner):
            return step, self.shared_gradient
        Y = factored.solve_many(self.border)
        schur = self.corner + damping * np.eye(len(self.corner)) - np.tensordot(self.border, Y, ((0, 1), (0, 1)))
        pull = np.tensordot(Y, self.gradient, ((0, 1), (0, 1))) - self.shared_gradient
        shared = np.asarray(np.linalg.solve(schur, pull), dtype=float)
        return step - Y @ shared, shared


def add_normal(
    blocks: Array, gradient: Array, frames: Index, stencil: Sequence[int], residual: Array, jacobian: Array
) -> None:
    """Add a term's J'J to blocks (T, W+1, D, D) and its J'r to gradient (T, D), in place.

    residual (N, M) and jacobian (N, M, S, D) stand for the frames (N,), all distinct; slot s of the jacobian is by the
    unknowns of frame + stencil[s]. The stencil's S offsets are distinct and at most W apart.
    """
    if len(frames) and (frames.min() + min(stencil) < 0 or frames.max() + max(stencil) >= len(blocks)):
        raise IndexError("the stencil reaches beyond the first or the last frame")  # numpy would wrap around
    for a, column in enumerate(stencil):
        by_column = jacobian[:, :, a]
        # within one pair of slots every frame has a target of its own, so += loses nothing
        gradient[frames + column] += (residual[:, None] @ by_column)[:, 0]
        for b, row in enumerate(stencil):
            if row >= column:
                blocks[frames + column, row - column] += jacobian[:, :, b].swapaxes(1, 2) @ by_column


@dataclass(frozen=True)
class Factor:
    """The factored system; `factor` makes it. band ((W+1)D, TD): L in LAPACK's lower band storage. shape: (T, D)."""

    band: Array
    shape: tuple[int, int]

    def solve(self, gradient: Array) -> Array:
        """x (T, D) for the right-hand side b (T, D)."""
        return cho_solve_banded((self.band, True), gradient.ravel(), check_finite=False).reshape(self.shape)

    def solve_many(self, columns: Array) -> Array:
        """X (T, D, P) for P right-hand sides (T, D, P)."""
        flat = columns.reshape(len(self.band.T), -1)
        found = np.empty_like(flat)
        for first in range(0, flat.shape[1], _COLUMNS_AT_ONCE):  # LAPACK works on copies
            part = slice(first, first + _COLUMNS_AT_ONCE)
            found[:, part] = cho_solve_banded((self.band, True), flat[:, part], check_finite=False)
        return found.reshape(columns.shape)

    def coloured(self, white: Array) -> Array:
        """x (T, D) = L^-T z of z (T, D): of a white z one whose covariance is H's inverse."""
        found, info = dtbtrs(self.band, white.ravel(), uplo="L", trans="T")
        assert info == 0
        return np.asarray(found, dtype=float).reshape(self.shape)

    def marginal_blocks(self) -> Array:
        """(T, W+1, D, D), the inverse's blocks: [t, k] is the covariance of frame t + k (rows) with frame t (columns),
        of which [:, 0] are the frames' own; zero where t + k >= T."""
        (T, D), P = self.shape, len(self.band)
        columns = self.band.T.reshape(T, D, P)
        rows = np.zeros((T, D, P))  # rows[t] is L_tt', L_t+1,t', ... at first, and Z[t, t], Z[t, later] in the end
        for j in range(D):
            rows[:, j, j:] = columns[:, j, : P - j]
        # L_tt' is an upper triangle: the LU decomposition inside has nothing to do, and does not pivot
        roots = np.linalg.inv(rows[:, :, :D])

        window = np.zeros((P, P))  # Z of the frames t, later; a frame after the last one is zero
        later = window[: P - D, : P - D]
        for t in range(T - 1, -1, -1):
            root = roots[t]
            gain = -root @ rows[t, :, D:]
            across = gain @ later
            own = root @ root.T + across @ gain.T
            window[D:, D:] = later
            window[:D, :D] = (own + own.T) / 2  # an antisymmetric rounding error would grow from frame to frame
            window[:D, D:] = across
            window[D:, :D] = across.T
            rows[t] = window[:D]
        return rows.reshape(T, D, P // D, D).transpose(0, 2, 3, 1)


def factor(H: BlockBanded, damping: Array | None = None) -> Factor:
    """Factor H, with damping (T, D) added to its diagonal.

    Raises numpy.linalg.LinAlgError if that is not positive definite.
    """
    T, _, D, _ = H.blocks.shape
    band = H.to_lower_band()
    if damping is not None:
        band[0] += damping.ravel()
    band = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    if not np.isfinite(band[0]).all():  # LAPACK lets NaN pass
        raise np.linalg.LinAlgError("a matrix that is not finite is not positive definite")
    return Factor(band, (T, D))
