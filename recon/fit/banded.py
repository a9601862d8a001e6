"""Solve the normal equations of a clip, in which each frame is coupled only with the W frames before and after it.

**Input and output.** A clip has T frames with D unknowns each. Each piece of the clip (`Normal`) gives the blocks of a
symmetric, positive definite matrix H (TD, TD), the gradient, and the border of the unknowns that all frames share. The
block (t + k, t) of H, D x D, is zero for k > W. `step` returns the step towards the minimum. `eliminated` yields
windows (`Window`), which give solutions, random draws and covariances.

**Idea.** The Cholesky factor L of H = L L' has the same band as H, so time and memory are linear in T.

**Covariances.** The covariance Z = H^-1 is full, but only its blocks near the diagonal are needed. These blocks follow
one after the other, backwards from the last frame. If z is white noise, block row t of L' x = z gives frame t from the
W frames after it:

    x_t = gain_t x_later + L_tt^-T z_t,   gain_t = -L_tt^-T [L_t+1,t' ... L_t+W,t'],   later = t + 1, ..., t + W

The covariance of frame t is therefore known once the window Z[later, later] of the W frames after it is known:

    Z[t, later] = gain_t Z[later, later],   Z[t, t] = L_tt^-T L_tt^-1 + Z[t, later] gain_t'

These are Takahashi's equations for blocks, which are also the smoother of Rauch, Tung and Striebel.

**Shared unknowns.** Unknowns s that all frames share add a border B and a corner C to the matrix:

    [H  B] [x]   [b]          S = C - B' Y,  Y = H^-1 B
    [B' C] [s] = [c],    s = S^-1 (c - Y' b),  x = H^-1 b - Y s

Then cov(s) = S^-1, cov(x, s) = -Y S^-1, and cov(x) = H^-1 + Y S^-1 Y'.

**Pieces.** A long clip is processed piece by piece, from its first frame to its last (`eliminated`). The frames of a
piece are eliminated exactly. This adds -L21 L21' to H and -L21 z to a right-hand side b in the first W frames of the
next piece, where L21 holds the rows of L for these W frames and its columns for the last W frames of the piece, and z =
L^-1 b. The matrix B' H^-1 B is the sum of (L^-1 B)' (L^-1 B) over the rows of all pieces. On the way back, a piece is
solved together with the next piece only, because the influence of later frames decays exponentially.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.linalg import cholesky_banded
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dtbtrs, dtrtri

from recon.base.arrays import Array

_REGULARISATION = 1e-9
"""Relative increase of the diagonal with which `factored` retries if `bounded` and H is not positive definite."""
_MIN_BLOCK_COLUMNS = 8
"""Minimum number of right-hand sides for which matrix products replace LAPACK's solver.

LAPACK solves for one right-hand side after the other, which is slower for many of them.
"""
_FRAMES_AT_ONCE = 64
"""Number of frames whose blocks are rearranged at once, few enough for the processor's cache."""
_MAX_KEPT_VALUES = 1 << 24
"""Maximum number of values (128 MB) in the windows that are kept until the shared unknowns are solved."""


@dataclass(frozen=True)
class Normal:
    """Normal equations of a clip, or of a piece of T frames, with P >= 0 shared unknowns."""

    blocks: Array
    """Blocks of H, shape (T, W+1, D, D); [t, k] is in block row t + k and block column t."""
    gradient: Array
    """Gradient of the cost with respect to the frames' unknowns, shape (T, D)."""
    border: Array
    """Mixed curvature of the cost between frames and shared unknowns, B, shape (T, D, P)."""
    corner: Array
    """Curvature of the cost with respect to the shared unknowns, C, shape (P, P)."""
    shared_gradient: Array
    """Gradient of the cost with respect to the shared unknowns, shape (P,)."""
    cost: float = 0.0
    """Contribution to the cost. The contributions of all pieces of a clip add up to the cost of the clip."""

    def without_shared(self) -> Normal:
        """Return the normal equations of the frames alone, with the shared unknowns fixed."""
        return replace(self.without_border(), corner=np.zeros((0, 0)), shared_gradient=np.zeros(0))

    def without_border(self) -> Normal:
        """Return the normal equations without `border`, which takes most of their memory."""
        return replace(self, border=np.zeros((*self.gradient.shape, 0)))


_EMPTY = np.zeros(0)
_NO_PIECE = Normal(_EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY)


@dataclass(frozen=True)
class Window:
    """Piece of n frames of a clip, with all earlier frames eliminated from its normal equations."""

    rows: slice
    piece: Normal
    """Normal equations of the n frames, without the border."""
    factor: _Factor
    """Columns of L for the n frames, including the rows of the W frames that follow."""
    whitened: Array
    """Solutions z of L z = b for the gradient and each column of the border, shape (n, D, 1 + P)."""
    following: Window | None = None
    """The next piece, or its first m frames, which represents all later frames; None for the last piece."""

    @property
    def rows_with_following(self) -> slice:
        """Return the slice of the clip's frames in this window and in the next piece."""
        last = self if self.following is None else self.following
        return slice(self.rows.start, last.rows.stop)

    def first_frames(self, n: int) -> Window:
        """Return the window of the first n frames, without its normal equations."""
        rows = slice(self.rows.start, min(self.rows.start + n, self.rows.stop))
        return Window(rows, _NO_PIECE, self.factor.first_frames(n), self.whitened[:n])

    def without_piece(self) -> Window:
        """Return the window without its normal equations, to free memory, because `solved_for` does not need them."""
        following = None if self.following is None else self.following.without_piece()
        return replace(self, piece=_NO_PIECE, following=following)

    def solved(self) -> Array:
        """Return the solutions of H x = b for the gradient and each column of the border, (n, D, 1 + P)."""
        later = None if self.following is None else self.following.whitened
        return self._unwhiten(self.whitened, later)

    def solved_for(self, shared: Array) -> Array:
        """Return the solution (n, D) of H x = gradient + border s, for values s (P,) of the shared unknowns."""
        windows = [self] if self.following is None else [self, self.following]
        whites = [window.whitened[..., 0] + window.whitened[..., 1:] @ shared for window in windows]
        return self._unwhiten(whites[0], None if self.following is None else whites[1])

    def unwhiten(self, white: Array) -> Array:
        """Return L^-T z in the n frames of this window, (n, D, ...).

        `white` is z (n + m, D, ...) in the frames of this window and of the next piece. If z is white noise, the result
        has the covariance H^-1.
        """
        if len(white) != self.rows_with_following.stop - self.rows.start:
            raise ValueError(
                f"white has {len(white)} frames, but rows {self.rows_with_following} of the clip are needed"
            )
        n = len(self.whitened)
        return self._unwhiten(white[:n], white[n:])

    def _unwhiten(self, white: Array, later: Array | None) -> Array:
        if self.following is None or later is None:
            return self.factor.unwhiten(white)
        x_later = self.following.factor.unwhiten(later)
        (n, D), W = white.shape[:2], self.factor.width // white.shape[1]
        white = white.copy()
        by_later = self.factor.below_end().T @ x_later[:W].reshape(W * D, -1)
        white[n - W :] -= by_later.reshape(white[n - W :].shape)
        return self.factor.unwhiten(white, overwrite=True)

    def marginal_blocks(self) -> Array:
        """Return the blocks of H^-1 near the diagonal, (n, W+1, D, D), in the order of `_Factor.marginal_blocks`."""
        later = None if self.following is None else self.following.factor.first_marginals()
        return self.factor.marginal_blocks(later)

    def reduced(self) -> Array:
        """Return the window's contribution to the equations of the shared unknowns, [S, c - Y' b], (P, P + 1).

        The contributions of all windows add up to the Schur complement S and the reduced gradient c - Y' b.
        """
        flat = self.whitened.reshape(-1, self.whitened.shape[-1])
        by_frames = flat.T @ flat
        corner, gradient = self.piece.corner - by_frames[1:, 1:], self.piece.shared_gradient - by_frames[1:, 0]
        return np.concatenate([corner, gradient[:, None]], axis=1)


def step(pieces: Iterable[Normal], damping: float, ahead: int | None = None) -> tuple[Array, Array, float, float]:
    """Return the damped step of frames (T, D) and shared unknowns (P,), the cost's slope along it, and the cost.

    The parameters are those of `eliminated`.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a damped matrix is not positive definite (`factored`).
    """
    windows, gradients, kept = list[tuple[Window | Array, Array]](), list[Array](), 0
    shared_gradient: Array | float = 0.0
    cost = 0.0
    for window in eliminated(pieces, damping, ahead=ahead):
        # With many shared unknowns, it is faster to keep a window, and to solve only for the step in the end.
        kept += window.factor.band.size + window.whitened.size
        is_kept = window.whitened.shape[-1] >= _MIN_BLOCK_COLUMNS and kept < _MAX_KEPT_VALUES
        windows.append((window.without_piece() if is_kept else window.solved(), window.reduced()))
        gradients.append(window.piece.gradient)
        shared_gradient = shared_gradient + window.piece.shared_gradient
        cost += window.piece.cost
    reduced = np.sum([part for _, part in windows], axis=0)
    corner, gradient = reduced[:, :-1], reduced[:, -1]
    shared = -np.asarray(np.linalg.solve(corner + damping * np.eye(len(corner)), gradient), dtype=float)

    def frames_step(part: Window | Array) -> Array:
        if not isinstance(part, Window):
            return -part[..., 0] - part[..., 1:] @ shared
        return -part.solved_for(shared)

    steps = [frames_step(part) for part, _ in windows]
    slope = sum(float(np.vdot(*pair)) for pair in zip(gradients, steps, strict=True))
    return np.concatenate(steps), shared, slope + float(np.vdot(shared_gradient, shared)), cost


def eliminated(
    pieces: Iterable[Normal], damping: float | Array = 0.0, bounded: bool = False, ahead: int | None = None
) -> Iterator[Window]:
    """Yield the windows of a clip in order, each with all earlier frames eliminated.

    Parameters
    ----------
    pieces : iterable of Normal
        The clip's pieces, in order.
    damping, bounded
        As in `factored`, which also describes the errors.
    ahead
        Number of frames of the next piece that represent all later frames; None for the whole piece.
    """
    remaining, start, carry, last = iter(pieces), 0, None, None
    piece = next(remaining, None)
    while piece is not None:
        next_piece, n = next(remaining, None), len(piece.gradient)
        W = 0 if next_piece is None else piece.blocks.shape[1] - 1
        right_side = np.concatenate([piece.gradient[..., None], piece.border], axis=2)
        piece = piece.without_border()
        blocks = [piece.blocks] if next_piece is None else [piece.blocks, next_piece.blocks[:W]]
        if carry is not None:
            on_blocks, on_right = carry
            first = piece.blocks[: len(on_right)].copy()
            for row in range(len(on_right)):
                for column in range(row + 1):
                    first[column, row - column] += on_blocks[row, :, column]
            blocks = [first, piece.blocks[len(on_right) :], *blocks[1:]]
            right_side[: len(on_right)] += on_right
        all_damping = np.broadcast_to(damping, (n + W, piece.gradient.shape[1]))
        factor = _factored_of(blocks, all_damping, bounded).first_frames(n)
        white = factor.whiten(right_side, overwrite=True)
        if next_piece is not None:
            carry = _carried(factor, white)
        window = Window(slice(start, start + n), piece, factor, white)
        if last is not None:
            yield replace(last, following=window if ahead is None else window.first_frames(ahead))
        last, start, piece = window, start + n, next_piece
    if last is not None:
        yield last


def doubled(pieces: Iterable[Normal]) -> tuple[Iterator[Normal], Iterator[Normal]]:
    """Return two iterators over the same pieces, each of which is computed only once.

    A piece is freed when both iterators have passed it. `itertools.tee` would free its items only after each 57th one,
    and pieces are large.
    """
    source, queues = iter(pieces), (deque[Normal](), deque[Normal]())

    def iterator(waiting: deque[Normal]) -> Iterator[Normal]:
        while True:
            if not waiting:
                piece = next(source, None)
                if piece is None:
                    return
                for queue in queues:
                    queue.append(piece)
                del piece  # the queues alone keep it
            yield waiting.popleft()

    return iterator(queues[0]), iterator(queues[1])


def _carried(factor: _Factor, white: Array) -> tuple[Array, Array]:
    """Return the contribution of a window's frames, once eliminated, to the next window.

    The contribution is (W, D, W, D) to H and (W, D, ...) to the right-hand sides.
    """
    (n, D), width = white.shape[:2], factor.width
    coupling = factor.below_end()
    W = width // D
    on_right = -coupling @ white[n - W :].reshape(width, -1)
    return (-coupling @ coupling.T).reshape(W, D, W, D), on_right.reshape(W, D, -1)


def add_normal(
    blocks: Array, gradient: Array, first: int, stencil: Sequence[int], residual: Array, jacobian: Array
) -> None:
    """Add J'J of one term of the cost to blocks (T, W+1, D, D) and its J'r to gradient (T, D), in place.

    The residual (N, M) and Jacobian (N, M, S, D) belong to the frames first, first + 1, ... Slot s holds the
    derivatives with respect to the unknowns of frame + stencil[s].
    """
    if len(residual) and (first + min(stencil) < 0 or first + len(residual) + max(stencil) > len(blocks)):
        # NumPy would take negative indices from the end.
        raise IndexError("the stencil reaches beyond the first or the last frame")
    for a, column in enumerate(stencil):
        by_column, frames = jacobian[:, :, a], slice(first + column, first + column + len(residual))
        gradient[frames] += (residual[:, None] @ by_column)[:, 0]
        for b, row in enumerate(stencil):
            if row >= column:
                blocks[frames, row - column] += jacobian[:, :, b].swapaxes(1, 2) @ by_column


@dataclass(frozen=True)
class _Factor:
    """Cholesky factor L of H for T frames, which are all or the first frames of a piece."""

    band: Array
    """L in LAPACK's lower band storage, shape ((W+1)D, TD)."""
    D: int

    @property
    def width(self) -> int:
        """Return the number of rows of L in W frames."""
        return len(self.band) - self.D

    def first_frames(self, n: int) -> _Factor:
        """Return the columns of the first n frames, including the rows of the W frames that follow."""
        return _Factor(self.band[:, : n * self.D], self.D)

    def whiten(self, right: Array, *, overwrite: bool = False) -> Array:
        """Return L^-1 b for right-hand sides b (T, D, ...), which may be overwritten."""
        return self._solved(right, "N", overwrite)

    def unwhiten(self, white: Array, *, overwrite: bool = False) -> Array:
        """Return x = L^-T z for z (T, D, ...). If z is white noise, the covariance of x is H^-1."""
        return self._solved(white, "T", overwrite)

    def _solved(self, right: Array, transposed: Literal["N", "T"], overwrite: bool) -> Array:
        flat = np.reshape(right, (self.band.shape[1], -1))
        if flat.shape[1] >= _MIN_BLOCK_COLUMNS:
            solution = np.ascontiguousarray(flat) if overwrite else np.array(flat, dtype=float, order="C")
            self._solve_frame_by_frame(solution.reshape(-1, self.D, flat.shape[1]), transposed)
            return solution.reshape(right.shape)
        return dtbtrs(self.band, flat, uplo="L", trans=transposed)[0].reshape(right.shape)

    def _solve_frame_by_frame(self, solution: Array, transposed: Literal["N", "T"]) -> None:
        """Solve for right-hand sides (T, D, K) in place."""
        T, _, K = solution.shape
        W, roots, below = self.width // self.D, self._roots, self._columns[:, self.D :]
        for t in range(T) if transposed == "N" else range(T - 1, -1, -1):
            frame, later = solution[t], solution[t + 1 : t + 1 + W].reshape(-1, K)
            if transposed == "N":
                dtrmm(1.0, roots[t].T, frame.T, side=1, lower=1, trans_a=1, overwrite_b=1)
                later -= below[t, : len(later)] @ frame
            else:
                frame -= below[t, : len(later)].T @ later
                dtrmm(1.0, roots[t].T, frame.T, side=1, lower=1, overwrite_b=1)

    @cached_property
    def _roots(self) -> Array:
        """Return L_tt^-T of each frame, which are upper triangles, (T, D, D)."""
        roots = np.triu(self._columns[:, : self.D].swapaxes(1, 2))
        for root in roots:
            dtrtri(root.T, lower=1, overwrite_c=1)
        return roots

    @property
    def _columns(self) -> Array:
        """Return a view of the blocks L_tt, L_t+1,t, ..., L_t+W,t of each frame t, one below the other, (T, (W+1)D, D).

        Entry (i, j) of L is `band[i - j, j]`, so the view is the band with a shorter column stride. Entries above the
        diagonal of L have arbitrary values.
        """
        D, (row_stride, column_stride) = self.D, self.band.strides
        shape = (self.band.shape[1] // D, len(self.band), D)
        return np.lib.stride_tricks.as_strided(
            self.band, shape, (D * column_stride, row_stride, column_stride - row_stride)
        )

    def below_end(self) -> Array:
        """Return the block of L between the last W frames and the W frames after them, (WD, WD)."""
        D, W = self.D, self.width // self.D
        block = np.zeros((W, D, W, D))
        for i, column in enumerate(self._columns[-W:]):
            block[: i + 1, :, i] = column.reshape(W + 1, D, D)[W - i :]
        return block.reshape(W * D, W * D)

    def marginal_blocks(self, later: Array | None = None) -> Array:
        """Return the blocks of the inverse near the diagonal, (T, W+1, D, D).

        Block [t, k] is the covariance of frame t + k (rows) with frame t (columns). For k = 0 it is the covariance of
        frame t. Blocks with t + k >= T are zero, unless `later` gives the covariance (WD, WD) of the W frames that
        follow.
        """
        return self._marginals(later)[0]

    def first_marginals(self) -> Array:
        """Return the covariance (WD, WD) of the first W frames."""
        return self._marginals(None)[1][: self.width, : self.width]

    def _marginals(self, later: Array | None) -> tuple[Array, Array]:
        """Return `marginal_blocks`, and the covariance ((W+1)D, (W+1)D) of the first W + 1 frames."""
        D, P, roots, below = self.D, len(self.band), self._roots, self._columns[:, self.D :]
        T, width = len(roots), self.width
        rows = np.empty((T, D, P))  # Z[t, t], Z[t, later]
        window, last = np.zeros((P, P)), np.zeros((P, P))  # Z of frames t, later, which is zero beyond the last frame
        if later is not None:
            last[:width, :width] = later
        for t in range(T - 1, -1, -1):
            covariance_later = last[:width, :width]
            minus_gain = roots[t] @ below[t].T
            across = minus_gain @ covariance_later
            block = roots[t] @ roots[t].T + across @ minus_gain.T
            window[:D, :D] = (block + block.T) / 2  # an antisymmetric rounding error would grow from frame to frame
            np.negative(across, out=window[:D, D:])
            window[D:, :D] = window[:D, D:].T
            window[D:, D:] = covariance_later
            rows[t] = window[:D]
            window, last = last, window
        return rows.reshape(T, D, P // D, D).transpose(0, 2, 3, 1), last


def factored(blocks: Array, damping: float | Array = 0.0, bounded: bool = False) -> _Factor:
    """Return the Cholesky factor of a banded matrix H of normal equations, given as `Normal.blocks`.

    Parameters
    ----------
    blocks
        Blocks of H, shape (T, W+1, D, D), as in `Normal`.
    damping
        Values added to the diagonal of H, shape (T, D) or (D,), or one number for all of it.
    bounded
        Whether to give undetermined unknowns a very large variance instead of raising an error.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the damped matrix is not positive definite to rounding, unless `bounded`.
    """
    T, _, D, _ = blocks.shape
    return _factored_of([blocks], np.broadcast_to(damping, (T, D)), bounded)


def _factored_of(parts: Sequence[Array], damping: Array, bounded: bool) -> _Factor:
    """Return the Cholesky factor of H plus damping (T, D), from parts of its blocks in the order of time."""
    band = lower_band(*parts)
    band[0] += damping.ravel()
    try:
        band = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
        if not np.isfinite(band[0]).all():  # LAPACK does not report NaN
            raise np.linalg.LinAlgError("a matrix that is not finite is not positive definite")
    except np.linalg.LinAlgError:
        if not bounded:
            raise
        diagonal = np.concatenate([np.diagonal(blocks[:, 0], axis1=1, axis2=2) for blocks in parts])
        return _factored_of(parts, _REGULARISATION * np.maximum(diagonal, 1.0) + damping, bounded=False)
    return _Factor(band, damping.shape[1])


def lower_band(*parts: Array) -> Array:
    """Return LAPACK's lower band storage, ((W+1)D, TD) in Fortran order: band[i - j, j] = H[i, j] for i >= j.

    The blocks of H may come in several parts, in the order of time.
    """
    _, n_blocks, D, _ = parts[0].shape
    T, P, first = sum(map(len, parts)), n_blocks * D, 0
    columns = np.empty((T, D, P))  # holds the columns of H, each from its diagonal down
    for blocks in parts:
        for start in range(0, len(blocks), _FRAMES_AT_ONCE):
            flat = blocks[start : start + _FRAMES_AT_ONCE].reshape(-1, P, D)
            in_order = columns[first : first + len(flat)]
            for j in range(D):
                in_order[:, j, : P - j] = flat[:, j:, j]
                in_order[:, j, P - j :] = 0.0
            first += len(flat)
    band = columns.reshape(T * D, P).T
    last = min(P, T * D)
    band[:, -last:][np.add.outer(np.arange(P), np.arange(last)) >= last] = 0.0  # these entries lie outside the matrix
    return band
