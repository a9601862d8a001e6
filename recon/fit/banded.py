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

A long clip comes in pieces, so that memory follows the piece (`eliminated`). Frames before a piece are eliminated
exactly: with L21 the rows of L that lead from the last W frames of a piece to the first W of the next, these get
-L21 L21' on H and -L21 z on a right-hand side, z = L^-1 b being known so far. B' H^-1 B is the sum over all pieces of
(L^-1 B)' (L^-1 B) in their own rows. On the way back, a piece takes as many frames of the next along, which stand for
all that come after it: what lies further on matters less and less, as e to the power of minus its distance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs

from recon.base.arrays import Array, Index

_COLUMNS_AT_ONCE = 32
_UNKNOWN = 1e-9
"""Part of its own precision that is added to an unknown where rounding leaves no covariance: nothing but a bound."""


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
    """Normal equations of a clip, or what a piece of T frames of it has in them: H, whose blocks lead from its frames
    to those that follow, its gradient (T, D), and the border of P shared unknowns: border (T, D, P), corner (P, P) and
    their gradient (P,). P may be 0."""

    H: BlockBanded
    gradient: Array
    border: Array
    corner: Array
    shared_gradient: Array


@dataclass(frozen=True)
class Window:
    """A piece of a clip with all before it eliminated. rows: its n frames. factor: of these and those taken along.
    white (n + those, D, 1 + P): L^-1 of the gradient and the border."""

    rows: slice
    piece: Normal
    factor: Factor
    white: Array

    @property
    def own_white(self) -> Array:
        """(n, D, 1 + P)"""
        return self.white[: len(self.piece.gradient)]

    def solved(self) -> Array:
        """(n, D, 1 + P): H^-1 of the gradient and the border."""
        return self.coloured(self.white)

    def coloured(self, white: Array) -> Array:
        """(n, D, ...): of white values of these frames and those taken along, see `Factor.coloured`."""
        return self.factor.coloured(white)[: len(self.piece.gradient)]

    def marginal_blocks(self) -> Array:
        """(n, W+1, D, D), see `Factor.marginal_blocks`."""
        return self.factor.marginal_blocks()[: len(self.piece.gradient)]


Made = TypeVar("Made")


@dataclass(frozen=True)
class Again(Generic[Made]):
    """What is made anew each time that it is gone through, a piece at a time."""

    made: Callable[[], Iterator[Made]]

    def __iter__(self) -> Iterator[Made]:
        return self.made()


def step(pieces: Iterable[Normal], damping: float) -> tuple[Array, Array]:
    """The step (T, D) and (P,) towards the minimum, with damping added to the diagonal.

    Raises numpy.linalg.LinAlgError if the matrix is not positive definite to rounding.
    """
    solved: list[Array] = []
    reduced = Reduced()
    for window in eliminated(pieces, damping):
        solved.append(window.solved())
        reduced.add(window)
    every = solved[0] if len(solved) == 1 else np.concatenate(solved)
    if not len(reduced.corner):
        return -every[..., 0], reduced.gradient
    schur = reduced.corner + damping * np.eye(len(reduced.corner))
    shared = -np.asarray(np.linalg.solve(schur, reduced.gradient), dtype=float)
    return -every[..., 0] - every[..., 1:] @ shared, shared


class Reduced:
    """What is left of the shared unknowns once all frames are eliminated, summed up over the windows: the corner S
    (P, P) and the gradient c - Y' b (P,)."""

    def __init__(self) -> None:
        self.corner: Array = np.zeros((0, 0))
        self.gradient: Array = np.zeros(0)

    def add(self, window: Window) -> None:
        piece, flat = window.piece, window.own_white.reshape(-1, window.white.shape[-1])
        by_frames = flat.T @ flat
        corner, gradient = piece.corner - by_frames[1:, 1:], piece.shared_gradient - by_frames[1:, 0]
        first = window.rows.start == 0
        self.corner, self.gradient = (corner, gradient) if first else (self.corner + corner, self.gradient + gradient)


def eliminated(pieces: Iterable[Normal], damping: float | Array = 0.0, bounded: bool = False) -> Iterator[Window]:
    """The windows of a clip, in their order. damping: on the diagonal, for all unknowns or (D,). bounded: as `factored`
    does it.

    Raises numpy.linalg.LinAlgError if the matrix is not positive definite to rounding.
    """
    follow, start, carried = iter(pieces), 0, None
    piece = next(follow, None)
    while piece is not None:
        ahead, n = next(follow, None), len(piece.gradient)
        blocks, right = piece.H.blocks, np.concatenate([piece.gradient[..., None], piece.border], axis=2)
        if ahead is not None:
            blocks = np.concatenate([blocks, ahead.H.blocks[:n]])
            taken = [ahead.gradient[:n, :, None], ahead.border[:n]]
            right = np.concatenate([right, np.concatenate(taken, axis=2)])
        if carried is not None:
            blocks = blocks if ahead is not None else blocks.copy()
            of_blocks, of_right = carried
            for row in range(len(of_blocks)):
                for column in range(row + 1):
                    blocks[column, row - column] += of_blocks[row][column]
            right[: len(of_right)] += of_right
        solved = (factored if bounded else factor)(BlockBanded(blocks), damping)
        white = solved.white(right)
        if ahead is not None:
            carried = _carried(solved, white, n)
        yield Window(slice(start, start + n), piece, solved, white)
        start, piece = start + n, ahead


def _carried(solved: Factor, white: Array, n: int) -> tuple[list[list[Array]], Array]:
    """What the elimination of a window's first n frames leaves on the W frames after them: on H by block, and on the
    right-hand sides (W, D, ...)."""
    (_, D), P = solved.shape, len(solved.band)
    width = P - D  # W frames
    first = n * D - width
    below = width + np.subtract.outer(np.arange(width), np.arange(width))
    L21 = np.where(below < P, solved.band[np.minimum(below, P - 1), first + np.arange(width)], 0.0)
    W = width // D
    by_block = (-L21 @ L21.T).reshape(W, D, W, D)
    on_right = -L21 @ white[n - W : n].reshape(width, -1)
    return [[by_block[r, :, c] for c in range(W)] for r in range(W)], on_right.reshape(W, D, -1)


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

    def white(self, right: Array) -> Array:
        """L^-1 b of right-hand sides (T, D, ...)."""
        return self._triangular(right, "N")

    def coloured(self, white: Array) -> Array:
        """x (T, D, ...) = L^-T z of z (T, D, ...): of a white z one whose covariance is H's inverse."""
        return self._triangular(white, "T")

    def _triangular(self, right: Array, transposed: str) -> Array:
        flat = right.reshape(len(self.band.T), -1)
        found = np.empty_like(flat)
        for first in range(0, flat.shape[1], _COLUMNS_AT_ONCE):  # LAPACK works on copies
            part = slice(first, first + _COLUMNS_AT_ONCE)
            found[:, part], info = dtbtrs(self.band, flat[:, part], uplo="L", trans=transposed)
            assert info == 0
        return found.reshape(right.shape)

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


def factor(H: BlockBanded, damping: float | Array = 0.0) -> Factor:
    """Factor H, with damping added to its diagonal: (T, D), or what is that for all frames or unknowns.

    Raises numpy.linalg.LinAlgError if that is not positive definite.
    """
    T, _, D, _ = H.blocks.shape
    band = H.to_lower_band()
    band[0] += np.broadcast_to(damping, (T, D)).ravel()
    band = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    if not np.isfinite(band[0]).all():  # LAPACK lets NaN pass
        raise np.linalg.LinAlgError("a matrix that is not finite is not positive definite")
    return Factor(band, (T, D))


def factored(H: BlockBanded, damping: float | Array = 0.0) -> Factor:
    """H's factor; where nothing determines an unknown, as the place of a frame beside a single other one, it is held so
    weakly that its variance is that of nothing known."""
    try:
        return factor(H, damping)
    except np.linalg.LinAlgError:
        own = np.diagonal(H.blocks[:, 0], axis1=1, axis2=2)
        return factor(H, _UNKNOWN * np.maximum(own, 1.0) + damping)
