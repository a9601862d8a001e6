"""Test banded equations against dense results of numpy, scipy's banded solver, a naive loop and an AR(1) process."""

from __future__ import annotations

import tracemalloc
import weakref

import numpy as np
import pytest
from scipy.linalg import solveh_banded
from term_cases import to_dense

from recon.fit.banded import Normal, add_normal, doubled, eliminated, factored, lower_band, step

SIZES = [
    # frames T, unknowns D of a frame, coupled frames W
    (1, 1, 0),
    (1, 3, 0),
    (1, 2, 3),
    (2, 3, 3),
    (3, 4, 3),
    (4, 2, 3),
    (7, 3, 0),
    (9, 1, 1),
    (9, 1, 2),
    (12, 5, 1),
    (12, 5, 2),
    (20, 4, 3),
]


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def dense_system(rng, T, D, W):
    """Return a random block-banded, symmetric positive definite matrix (TD, TD), condition number below 1e5."""
    n = T * D
    frame = np.arange(n) // D
    L = np.tril(rng.normal(size=(n, n))) * (frame[:, None] - frame <= W) / np.sqrt((W + 1) * D)
    L[np.diag_indices(n)] = rng.uniform(1.0, 2.0, n)
    assert np.linalg.cond(L @ L.T) < 1e5
    return L @ L.T


def blocks_of(dense, T, D, W, outside=0.0):
    """Return the blocks (T, W + 1, D, D) of a dense matrix; blocks beyond its edges have the value `outside`."""
    grid = dense.reshape(T, D, T, D)
    blocks = np.full((T, W + 1, D, D), outside)
    for t in range(T):
        for k in range(min(W + 1, T - t)):
            blocks[t, k] = grid[t + k, :, t]
    return blocks


def split(dense, T, D, W):
    """Split a dense vector or matrix into frames, with NaN in the parts that H ignores."""
    return blocks_of(dense, T, D, W, np.nan)


def solved(factor, b: np.ndarray) -> np.ndarray:
    return factor.unwhiten(factor.whiten(b))


def assert_close(actual, expected, rtol=1e-9):
    """Check that values are close relative to the largest expected value, because single entries may cancel."""
    np.testing.assert_allclose(actual, expected, rtol=0, atol=rtol * np.abs(expected).max(initial=0.0))


@pytest.mark.parametrize(("T", "D", "W"), SIZES)
def test_matrix_equals_the_dense_matrix(rng, T, D, W):
    dense = dense_system(rng, T, D, W)
    np.testing.assert_array_equal(to_dense(split(dense, T, D, W)), dense)


@pytest.mark.parametrize(("T", "D", "W"), SIZES)
def test_lower_band_follows_lapack(rng, T, D, W):
    """The lower band follows LAPACK's definition, band[i - j, j] = H[i, j], and scipy's solver accepts it."""
    H = split(dense_system(rng, T, D, W), T, D, W)
    dense, band = to_dense(H), lower_band(H)
    n = T * D
    assert band.flags.f_contiguous
    assert np.isfinite(band).all()
    for p in range(min(len(band), n)):
        np.testing.assert_array_equal(band[p, : n - p], np.diag(dense, -p))
    b = rng.normal(size=n)
    assert_close(solved(factored(H), b.reshape(T, D)).ravel(), solveh_banded(band[:n], b, lower=True))


@pytest.mark.parametrize(("T", "D", "W"), SIZES)
def test_solution_and_inverse_equal_dense_results(rng, T, D, W):
    """The solution equals the dense solution, and marginal blocks are blocks of the dense inverse, or 0 outside it."""
    dense = dense_system(rng, T, D, W)
    factor = factored(split(dense, T, D, W))
    b = rng.normal(size=(T, D))
    assert_close(solved(factor, b).ravel(), np.linalg.solve(dense, b.ravel()))
    assert_close(factor.marginal_blocks(), blocks_of(np.linalg.inv(dense), T, D, W))


def test_damping_is_added_to_the_diagonal_of_a_copy(rng):
    T, D, W = 6, 3, 2
    dense = dense_system(rng, T, D, W)
    H = split(dense, T, D, W)
    before = H.copy()
    damping, b = rng.uniform(1.0, 5.0, (T, D)), rng.normal(size=(T, D))
    x = solved(factored(H, damping), b)
    assert_close(x.ravel(), np.linalg.solve(dense + np.diag(damping.ravel()), b.ravel()))
    np.testing.assert_array_equal(H, before)


def test_unknowns_may_differ_in_scale(rng):
    """If unknowns are scaled by s, H becomes s H s and its inverse s^-1 Z s^-1, to rounding."""
    T, D, W = 15, 4, 2
    dense = dense_system(rng, T, D, W)
    s = 10.0 ** rng.uniform(-3.0, 3.0, (T, D))
    factor = factored(split(s.reshape(-1, 1) * dense * s.ravel(), T, D, W))
    b = rng.normal(size=(T, D))
    assert_close((s * solved(factor, s * b)).ravel(), np.linalg.solve(dense, b.ravel()))
    marginals = factor.marginal_blocks()
    for k in range(W + 1):
        marginals[: T - k, k] *= s[k:, :, None] * s[: T - k, None, :]
    assert_close(marginals, blocks_of(np.linalg.inv(dense), T, D, W))


@pytest.mark.parametrize("where", [0, 7, 17])
@pytest.mark.parametrize("value", [-1.0, np.nan])
def test_matrix_that_is_not_positive_definite_raises(rng, where, value):
    T, D, W = 6, 3, 1
    H = split(dense_system(rng, T, D, W), T, D, W)
    H[where // D, 0, where % D, where % D] = value
    with pytest.raises(np.linalg.LinAlgError):
        factored(H)


@pytest.mark.parametrize(
    ("stencil", "W"), [((0,), 0), ((0,), 2), ((-1, 0), 1), ((-1, 0, 1), 2), ((-2, 0), 3), ((1, -1, 0), 2)]
)
def test_normal_equations_equal_products_of_the_dense_jacobian(rng, stencil, W):
    """The normal equations are J'J and J'r of the dense Jacobian (NM, TD), and two calls add up."""
    T, D, M = 9, 3, 4
    frames = np.arange(max(0, -min(stencil)), T - max(0, *stencil))[:5]
    blocks, gradient = np.zeros((T, W + 1, D, D)), np.zeros((T, D))
    H, b = np.zeros((T * D, T * D)), np.zeros(T * D)
    for _ in range(2):
        residual = rng.normal(size=(len(frames), M))
        jacobian = rng.normal(size=(len(frames), M, len(stencil), D))
        J = np.zeros((len(frames), M, T, D))
        for n, frame in enumerate(frames):
            for slot, offset in enumerate(stencil):
                J[n, :, frame + offset] = jacobian[n, :, slot]
        J = J.reshape(-1, T * D)
        H += J.T @ J
        b += J.T @ residual.ravel()
        add_normal(blocks, gradient, int(frames[0]), stencil, residual, jacobian)
    assert_close(to_dense(blocks), H)
    assert_close(gradient.ravel(), b)


@pytest.mark.parametrize(("frames", "stencil"), [([0, 1], (-1, 0)), ([3, 4], (0, 1)), ([2], (-2, 0))])
def test_stencil_outside_the_clip_or_the_band_raises(frames, stencil):
    blocks, gradient = np.zeros((5, 2, 3, 3)), np.zeros((5, 3))
    residual, jacobian = np.ones((len(frames), 4)), np.ones((len(frames), 4, 2, 3))
    with pytest.raises(IndexError):
        add_normal(blocks, gradient, frames[0], stencil, residual, jacobian)


def test_term_without_frames_adds_nothing():
    blocks, gradient = np.zeros((5, 2, 3, 3)), np.zeros((5, 3))
    add_normal(blocks, gradient, 0, (-1, 0), np.zeros((0, 4)), np.zeros((0, 4, 2, 3)))
    assert not blocks.any()
    assert not gradient.any()


def test_long_clip_has_stationary_covariances_in_linear_memory(rng):
    """A long clip of the process x_t+1 = φ x_t + noise of covariance Q has its stationary covariances.

    They are cov(x_t+k, x_t) = φ^k Q / (1 - φ²), exactly. The precision is Q^-1 times the tridiagonal matrix of 1 + φ²
    (1 at both ends) and -φ. A dense matrix would take 2.6 GB, the blocks take 3.5 MB.
    """
    T, D, W, phi = 3000, 6, 3, 0.9
    mixing = rng.normal(size=(D, D)) + 3 * np.eye(D)
    precision = mixing.T @ mixing
    Q = np.linalg.inv(precision)
    b = rng.normal(size=(T, D))

    tracemalloc.start()
    blocks = np.zeros((T, W + 1, D, D))
    blocks[:, 0] = (1 + phi**2) * precision
    blocks[[0, -1], 0] = precision
    blocks[:-1, 1] = -phi * precision
    factor = factored(blocks)
    x = solved(factor, b)
    marginals = factor.marginal_blocks()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert peak < 8 * blocks.nbytes
    along = (1 + phi**2) * x
    along[[0, -1]] = x[[0, -1]]
    along[1:] -= phi * x[:-1]
    along[:-1] -= phi * x[1:]
    assert_close(along @ precision, b)
    for k in range(W + 1):
        assert_close(marginals[: T - k, k], np.broadcast_to(phi**k * Q / (1 - phi**2), (T - k, D, D)))


def test_marginals_of_a_stiff_smoother_are_columns_of_the_inverse(rng):
    """The data are weak and the prior on second differences is strong, so gain_t extrapolates to 2 x_t+1 - x_t+2.

    The expected columns come from the solver for unit vectors. A rounding error that makes the window's blocks
    asymmetric would grow without bound.
    """
    T, D, W = 400, 3, 2
    blocks, unused = np.zeros((T, W + 1, D, D)), np.zeros((T, D))
    bending = 1e3 * np.array([1.0, -2.0, 1.0])[:, None] * np.eye(D)[:, None]  # (M, S, D)
    add_normal(blocks, unused, 1, (-1, 0, 1), np.zeros((T - 2, D)), np.broadcast_to(bending, (T - 2, D, 3, D)))
    add_normal(blocks, unused, 0, (0,), np.zeros((T, 2)), rng.normal(size=(T, 2, 1, D)))
    factor = factored(blocks)
    marginals = factor.marginal_blocks()
    for t in (0, 1, T // 2, T - 2, T - 1):
        for d in range(D):
            unit = np.zeros((T, D))
            unit[t, d] = 1.0
            column = solved(factor, unit)
            assert_close(marginals[t, : T - t, :, d], column[t : t + W + 1])


def in_pieces(rng, dense, T, D, W, P, stops):
    """Return normal equations with P shared unknowns, in pieces that end at `stops` and as a dense system."""
    border, gradient = rng.normal(size=(T, D, P)), rng.normal(size=(T, D))
    flat = border.reshape(T * D, P)
    corner, of_shared = flat.T @ np.linalg.solve(dense, flat) + 2 * np.eye(P), rng.normal(size=P)
    blocks, pieces, start = blocks_of(dense, T, D, W), [], 0
    for stop in stops:
        own, fraction = slice(start, stop), (stop - start) / T
        pieces.append(Normal(blocks[own], gradient[own], border[own], fraction * corner, fraction * of_shared))
        start = stop
    whole = np.block([[dense, flat], [flat.T, corner]])
    return pieces, whole, np.concatenate([gradient.ravel(), of_shared])


@pytest.mark.parametrize("P", [0, 3, 9])
@pytest.mark.parametrize(("D", "W"), [(3, 1), (2, 2), (4, 2)])
def test_step_in_two_overlapping_pieces_is_exact(rng, D, W, P):
    T = 12
    pieces, whole, right = in_pieces(rng, dense_system(rng, T, D, W), T, D, W, P, [6, T])
    moved, shared, slope, _ = step(pieces, 0.01)
    expected = np.linalg.solve(whole + 0.01 * np.eye(len(whole)), -right)
    assert_close(moved.ravel(), expected[: T * D])
    assert_close(np.append(shared, 0.0), np.append(expected[T * D :], 0.0))
    assert slope == pytest.approx(right @ expected)


def test_frames_before_a_piece_are_eliminated_exactly(rng):
    """The last piece has exact covariances and shared unknowns after all frames before it are eliminated."""
    T, D, W, P = 17, 3, 2, 2
    dense = dense_system(rng, T, D, W)
    pieces, whole, right = in_pieces(rng, dense, T, D, W, P, [4, 8, 12, T])
    *others, window = eliminated(pieces)
    reduced = np.sum([one.reduced() for one in (*others, window)], axis=0)
    assert window.rows == slice(12, 17)
    inverse = np.linalg.inv(dense)
    assert_close(window.marginal_blocks(), blocks_of(inverse, T, D, W)[12:])
    assert_close(window.solved()[..., 0].ravel(), (inverse @ right[: T * D])[12 * D :])
    schur = whole[T * D :, T * D :] - whole[T * D :, : T * D] @ inverse @ whole[: T * D, T * D :]
    assert_close(reduced[:, :-1], schur)
    assert_close(reduced[:, -1], right[T * D :] - whole[T * D :, : T * D] @ inverse @ right[: T * D])


@pytest.mark.parametrize("ahead", [None, 15])
@pytest.mark.parametrize("P", [0, 3, 9])
def test_frames_beyond_those_ahead_hardly_matter(rng, P, ahead):
    T, D, W = 60, 2, 2
    dense = dense_system(rng, T, D, W)
    pieces, whole, right = in_pieces(rng, dense, T, D, W, P, [20, 40, T])
    moved, shared, _, _ = step(pieces, 0.0, ahead)
    assert_close(np.append(moved.ravel(), shared), np.linalg.solve(whole, -right), rtol=1e-3)
    first, second, _ = eliminated(pieces, ahead=ahead)
    assert (first.rows_with_following, second.rows) == (slice(0, 20 + (ahead or 20)), slice(20, 40))
    assert_close(first.marginal_blocks(), blocks_of(np.linalg.inv(dense), T, D, W)[:20], rtol=1e-3)


def test_doubled_pieces_are_computed_once_and_freed_when_both_iterators_have_passed_them(rng):
    alive: list[weakref.ref[Normal]] = []

    def made(count):
        for _ in range(count):
            piece = Normal(*rng.normal(size=(5, 1)))
            alive.append(weakref.ref(piece))
            yield piece
            del piece

    first, second = doubled(made(9))
    ahead = next(first), next(first)
    assert next(second) is ahead[0]
    del ahead
    for _ in range(7):
        assert next(first) is not next(second)
        assert sum(piece() is not None for piece in alive) <= 2
    assert next(second) is not None
    assert [*first] == [*second] == []
    assert len(alive) == 9


def test_whitened_values_of_other_frames_are_refused(rng):
    T, D, W = 12, 2, 2
    pieces, _, _ = in_pieces(rng, dense_system(rng, T, D, W), T, D, W, 0, [4, 8, T])
    first, *_, last = eliminated(pieces)
    assert first.unwhiten(np.ones((8, D))).shape == last.unwhiten(np.ones((4, D))).shape == (4, D)
    for window in (first, last):
        with pytest.raises(ValueError, match="frames"):
            window.unwhiten(np.ones((6, D)))
