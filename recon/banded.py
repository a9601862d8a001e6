"""Normal equations of a clip: each of T frames has D unknowns and is coupled with the W frames before and after it.

    | H        border | | x |   | b |     H (TD, TD): block (t + k, t), D x D, is zero for k > W
    | border'  corner | | g | = | c |     border (TD, G), corner (G, G): a few unknowns g that all frames share

The whole matrix is symmetric and positive definite. Time and memory are linear in T. The frames are eliminated first
and the border last, H = L L' (L has the band of H) and

    V = H^-1 border,   S = corner - border' V = (root root')^-1,   log det = log det H + log det S
    g = S^-1 (c - V' b),   x = H^-1 b - V g

The inverse of the whole matrix is the covariance of a Gaussian (x, g), and is full; only its blocks near the diagonal
are needed. Without the border, L' x = z with z white. Its block row t gives frame t from the W frames after it,

    x_t = gain_t x_later + L_tt^-T z_t,   gain_t = -L_tt^-T [L_t+1,t' ... L_t+W,t'],   later = t + 1, ..., t + W

so that Z = H^-1 follows backwards from the last frame, the window Z[later, later] moving along:

    Z[t, later] = gain_t Z[later, later],   Z[t, t] = L_tt^-T L_tt^-1 + Z[t, later] gain_t'

These are Takahashi's equations in blocks, and the smoother of Rauch, Tung and Striebel. Both terms of Z[t, t] are
positive semidefinite: nothing is lost by a difference. The border adds V S^-1 V' to Z; g has the covariance S^-1, and x
with g has -V S^-1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BlockBanded:
    """A symmetric block-banded matrix H, by the blocks of its lower triangle.

    blocks (T, W+1, D, D): blocks[t, k] is the block in block row t + k and block column t. blocks[:, 0] are symmetric.
    Blocks with t + k >= T lie outside and are ignored.
    """

    blocks: Array

    def diagonal(self) -> Array:
        """(T, D)."""
        return np.diagonal(self.blocks[:, 0], axis1=1, axis2=2)

    def matvec(self, x: Array) -> Array:
        """H x, (T, D), for x (T, D)."""
        T, n_blocks, _, _ = self.blocks.shape
        product = (self.blocks[:, 0] @ x[:, :, None])[:, :, 0]
        for k in range(1, min(n_blocks, T)):
            below = self.blocks[: T - k, k]
            product[k:] += (below @ x[: T - k, :, None])[:, :, 0]
            product[: T - k] += (x[k:, None, :] @ below)[:, 0]
        return product

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

    def to_dense(self) -> Array:
        """(TD, TD), of which both triangles are filled. For tests: the size is quadratic in T."""
        T, n_blocks, D, _ = self.blocks.shape
        dense = np.zeros((T, D, T, D))
        for t in range(T):
            for k in range(min(n_blocks, T - t)):
                dense[t + k, :, t] = self.blocks[t, k]
                dense[t, :, t + k] = self.blocks[t, k].T
        return dense.reshape(T * D, T * D)


def add_normal(
    blocks: Array,
    gradient: Array,
    frames: NDArray[np.intp],
    stencil: Sequence[int],
    residual: Array,
    jacobian: Array,
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
class Marginals:
    """The blocks near the diagonal of the inverse of the whole matrix, border included.

    blocks (T, W+1, D, D): blocks[t, k] is the covariance of frame t + k (rows) with frame t (columns), of which
    blocks[:, 0] are the frames' own; zero where t + k >= T. cross (T, D, G): frames with the border's unknowns.
    corner (G, G): the border's unknowns.
    """

    blocks: Array
    cross: Array
    corner: Array


@dataclass(frozen=True)
class Factor:
    """The factored system; `factor` makes it. Letters as in the module's text.

    band ((W+1)D, TD): L in LAPACK's lower band storage. V (T, D, G). root (G, G): upper triangle.
    """

    band: Array
    V: Array
    root: Array

    def solve(self, gradient: Array, corner_gradient: Array | None = None) -> tuple[Array, Array]:
        """x (T, D) and g (G,) for the right-hand side b (T, D) and c (G,), by default zero."""
        rest = -np.tensordot(gradient, self.V, axes=2)
        if corner_gradient is not None:
            rest += corner_gradient
        g = self.root @ (rest @ self.root)
        return _solve_band(self.band, gradient.reshape(-1, 1)).reshape(gradient.shape) - self.V @ g, g

    def log_determinant(self) -> float:
        """Natural logarithm of the whole matrix's determinant."""
        return float(2.0 * (np.log(self.band[0]).sum() - np.log(np.diagonal(self.root)).sum()))

    def marginal_blocks(self) -> Marginals:
        """What the band's pattern holds of the inverse of the whole matrix."""
        T, D, _ = self.V.shape
        P = len(self.band)
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

        blocks = rows.reshape(T, D, P // D, D).transpose(0, 2, 3, 1)
        V_root = self.V @ self.root
        for k in range(min(P // D, T)):
            blocks[: T - k, k] += V_root[k:] @ V_root[: T - k].swapaxes(1, 2)
        return Marginals(blocks, -V_root @ self.root.T, self.root @ self.root.T)


def factor(
    H: BlockBanded,
    border: Array | None = None,
    corner: Array | None = None,
    damping: Array | None = None,
    corner_damping: Array | None = None,
) -> Factor:
    """Factor the system of H, border (T, D, G) and corner (G, G), by default without border.

    damping (T, D) is added to the diagonal of H, corner_damping (G,) to that of the corner. Raises
    numpy.linalg.LinAlgError if the whole matrix is not positive definite.
    """
    T, _, D, _ = H.blocks.shape
    border = np.zeros((T, D, 0)) if border is None else border
    G = border.shape[2]
    corner = np.zeros((G, G)) if corner is None else corner
    band = H.to_lower_band()
    if damping is not None:
        band[0] += damping.ravel()
    if corner_damping is not None:
        corner = corner + np.diag(corner_damping)
    band = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    flat = border.reshape(T * D, G)
    V = _solve_band(band, flat)
    root = np.asarray(np.linalg.inv(np.linalg.cholesky(corner - flat.T @ V).T), dtype=np.float64)
    factored = Factor(band, V.reshape(T, D, G), root)
    if not np.isfinite(factored.log_determinant()):  # LAPACK lets NaN pass
        raise np.linalg.LinAlgError("a matrix that is not finite is not positive definite")
    return factored


def _solve_band(band: Array, right: Array) -> Array:
    """H^-1 right (TD, n), where band is L; n may be zero, which LAPACK does not take."""
    return cho_solve_banded((band, True), right, check_finite=False) if right.size else right.copy()
