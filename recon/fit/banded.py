"""Normal equations of a clip: each of T frames has D unknowns and is coupled with the W frames before and after it.

H (TD, TD) is symmetric and positive definite; its block (t + k, t), D x D, is zero for k > W. Time and memory are
linear in T. H = L L', and L has the band of H.

The inverse of H, a covariance, is full; only its blocks near the diagonal are needed. Block row t of L' x = z, z white,
gives frame t from the W frames after it,

    x_t = gain_t x_later + L_tt^-T z_t,   gain_t = -L_tt^-T [L_t+1,t' ... L_t+W,t'],   later = t + 1, ..., t + W

so that Z = H^-1 follows backwards from the last frame, the window Z[later, later] moving along:

    Z[t, later] = gain_t Z[later, later],   Z[t, t] = L_tt^-T L_tt^-1 + Z[t, later] gain_t'

These are Takahashi's equations in blocks, and the smoother of Rauch, Tung and Striebel.

Unknowns that all frames share border the matrix:

    [H  B] [x]   [b]          S = C - B' Y,  Y = H^-1 B
    [B' C] [s] = [c],    s = S^-1 (c - Y' b),  x = H^-1 b - Y s

S^-1 is the covariance of s, -Y S^-1 that of x with s, and H^-1 + Y S^-1 Y' that of x.

A long clip comes in pieces (`eliminated`). Frames before a piece are eliminated exactly: with L21 the rows of L from
the last W frames of a piece to the first W of the next, these get -L21 L21' on H and -L21 z on a right-hand side, z =
L^-1 b. B' H^-1 B is the sum over all pieces of (L^-1 B)' (L^-1 B) in their own rows. On the way back, a piece takes as
many frames of the next along, which stand for all after it: what lies further on matters exponentially less."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs

from recon.base.arrays import Array

_UNKNOWN = 1e-9
"""Part of its own precision that is added to an unknown where rounding leaves no covariance: nothing but a bound."""


@dataclass(frozen=True)
class Normal:
    """Normal equations of a clip, or of a piece of T frames: the blocks (T, W+1, D, D) of H, of which [t, k] stands in
    block row t + k and block column t, its gradient (T, D), and of P >= 0 shared unknowns the border (T, D, P), the
    corner (P, P) and their gradient (P,)."""

    blocks: Array
    gradient: Array
    border: Array
    corner: Array
    shared_gradient: Array


@dataclass(frozen=True)
class Window:
    """A piece of a clip, n frames, with all before it eliminated; white (n + those taken along, D, 1 + P)."""

    rows: slice
    piece: Normal
    factor: _Factor
    white: Array

    def solved(self) -> Array:
        """(n, D, 1 + P): H^-1 of the gradient and the border."""
        return self.coloured(self.white)

    def coloured(self, white: Array) -> Array:
        """(n, D, ...): of white values of these frames and those taken along, see `_Factor.coloured`."""
        return self.factor.coloured(white)[: len(self.piece.gradient)]

    def marginal_blocks(self) -> Array:
        """(n, W+1, D, D), see `_Factor.marginal_blocks`."""
        return self.factor.marginal_blocks()[: len(self.piece.gradient)]

    def reduced(self) -> Array:
        """(P, P + 1): what is left of corner and gradient; the sum over the windows is S and c - Y' b."""
        flat = self.white[: len(self.piece.gradient)].reshape(-1, self.white.shape[-1])
        by_frames = flat.T @ flat
        corner, gradient = self.piece.corner - by_frames[1:, 1:], self.piece.shared_gradient - by_frames[1:, 0]
        return np.concatenate([corner, gradient[:, None]], axis=1)


def step(pieces: Iterable[Normal], damping: float) -> tuple[Array, Array]:
    """The step (T, D) and (P,) towards the minimum, damped. Raises LinAlgError as `factored`."""
    both = [(window.solved(), window.reduced()) for window in eliminated(pieces, damping)]
    solved, reduced = np.concatenate([one for one, _ in both]), np.sum([one for _, one in both], axis=0)
    corner, gradient = reduced[:, :-1], reduced[:, -1]
    shared = -np.asarray(np.linalg.solve(corner + damping * np.eye(len(corner)), gradient), dtype=float)
    return -solved[..., 0] - solved[..., 1:] @ shared, shared


def eliminated(pieces: Iterable[Normal], damping: float | Array = 0.0, bounded: bool = False) -> Iterator[Window]:
    """The windows of a clip, in their order; damping, bounded, and what is raised: as of `factored`."""
    follow, start, carried = iter(pieces), 0, None
    piece = next(follow, None)
    while piece is not None:
        ahead, n = next(follow, None), len(piece.gradient)
        blocks, right = piece.blocks, np.concatenate([piece.gradient[..., None], piece.border], axis=2)
        if ahead is not None:
            blocks = np.concatenate([blocks, ahead.blocks[:n]])
            taken = [ahead.gradient[:n, :, None], ahead.border[:n]]
            right = np.concatenate([right, np.concatenate(taken, axis=2)])
        if carried is not None:
            blocks = blocks if ahead is not None else blocks.copy()
            of_blocks, of_right = carried
            for row in range(len(of_right)):
                for column in range(row + 1):
                    blocks[column, row - column] += of_blocks[row, :, column]
            right[: len(of_right)] += of_right
        solved = factored(blocks, damping, bounded)
        white = solved.white(right)
        if ahead is not None:
            carried = _carried(solved, white, n)
        yield Window(slice(start, start + n), piece, solved, white)
        start, piece = start + n, ahead


def _carried(solved: _Factor, white: Array, n: int) -> tuple[Array, Array]:
    """What eliminating a window's first n frames leaves on H (W, D, W, D) and on the right-hand sides (W, D, ...)."""
    D, width = white.shape[1], solved.width
    L21 = solved.below(n * D - width)
    W = width // D
    on_right = -L21 @ white[n - W : n].reshape(width, -1)
    return (-L21 @ L21.T).reshape(W, D, W, D), on_right.reshape(W, D, -1)


def add_normal(
    blocks: Array, gradient: Array, first: int, stencil: Sequence[int], residual: Array, jacobian: Array
) -> None:
    """Add a term's J'J to blocks (T, W+1, D, D) and its J'r to gradient (T, D), in place. residual (N, M) and jacobian
    (N, M, S, D) stand for the frames first, first + 1, ...; slot s is by the unknowns of frame + stencil[s]."""
    if len(residual) and (first + min(stencil) < 0 or first + len(residual) + max(stencil) > len(blocks)):
        raise IndexError("the stencil reaches beyond the first or the last frame")  # numpy would wrap around
    for a, column in enumerate(stencil):
        by_column, at = jacobian[:, :, a], slice(first + column, first + column + len(residual))
        gradient[at] += (residual[:, None] @ by_column)[:, 0]
        for b, row in enumerate(stencil):
            if row >= column:
                blocks[at, row - column] += jacobian[:, :, b].swapaxes(1, 2) @ by_column


@dataclass(frozen=True)
class _Factor:
    """The factored system of T frames; `factored` makes it. band ((W+1)D, TD): L in LAPACK's lower band storage."""

    band: Array
    D: int

    @property
    def width(self) -> int:
        """How many rows of L one block of it has here: no row reaches beyond the block before its own."""
        return max(len(self.band) - self.D, self.D)

    def white(self, right: Array) -> Array:
        """L^-1 b of right-hand sides (T, D, ...)."""
        return self._solved(right, "N")

    def coloured(self, white: Array) -> Array:
        """x (T, D, ...) = L^-T z of z (T, D, ...): of a white z one whose covariance is H's inverse."""
        return self._solved(white, "T")

    def _solved(self, right: Array, transposed: Literal["N", "T"]) -> Array:
        flat = np.reshape(right, (self.band.shape[1], -1))
        return dtbtrs(self.band, flat, uplo="L", trans=transposed)[0].reshape(right.shape)

    def below(self, column: int) -> Array:
        """(width, width): the block of L below its diagonal block that begins at a column."""
        row, own = np.indices((self.width, self.width))
        down = self.width + row - own
        return np.where(down < len(self.band), self.band[np.minimum(down, len(self.band) - 1), column + own], 0.0)

    def marginal_blocks(self) -> Array:
        """(T, W+1, D, D), the inverse's blocks: [t, k] is the covariance of frame t + k (rows) with frame t (columns),
        of which [:, 0] are the frames' own; zero where t + k >= T."""
        D, P = self.D, len(self.band)
        T = self.band.shape[1] // D
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


def factored(blocks: Array, damping: float | Array = 0.0, bounded: bool = False) -> _Factor:
    """The factor of H, of which these are the blocks (T, W+1, D, D), with damping (T, D), (D,) or one on its diagonal.
    Raises numpy.linalg.LinAlgError if that is not positive definite to rounding; bounded: then an unknown that nothing
    determines is held so weakly that its variance is that of nothing known."""
    T, _, D, _ = blocks.shape
    band = lower_band(blocks)
    band[0] += np.broadcast_to(damping, (T, D)).ravel()
    try:
        band = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
        if not np.isfinite(band[0]).all():  # LAPACK lets NaN pass
            raise np.linalg.LinAlgError("a matrix that is not finite is not positive definite")
    except np.linalg.LinAlgError:
        if not bounded:
            raise
        own = np.diagonal(blocks[:, 0], axis1=1, axis2=2)
        return factored(blocks, _UNKNOWN * np.maximum(own, 1.0) + damping)
    return _Factor(band, D)


def lower_band(blocks: Array) -> Array:
    """LAPACK's lower band storage, ((W+1)D, TD) in Fortran order: band[i - j, j] = H[i, j] for i >= j."""
    T, n_blocks, D, _ = blocks.shape
    P = n_blocks * D
    columns = np.zeros((T, D, P))  # one column of H each, from its diagonal down
    for j in range(D):
        columns[:, j, : P - j] = blocks[..., j].reshape(T, P)[:, j:]
    band = columns.reshape(T * D, P).T
    last = min(P, T * D)
    band[:, -last:][np.add.outer(np.arange(P), np.arange(last)) >= last] = 0.0  # what lies outside
    return band
