"""The kernel's eigenvectors against LAPACK's, in float64."""

import numba
import numpy as np
import pytest

from gs2ci.reconstruct.decode.patches.eigen import LINES, eigen_rows_above, padded


@numba.njit
def find_eigen_rows(matrix, vectors, forward, backward, lines, size, least):
    return eigen_rows_above(matrix, vectors, forward, backward, lines, size, least)


def decompose(matrix, least):
    size = len(matrix)
    width = padded(size)
    rows, *work = np.zeros((size, width), np.float32), *np.full((3, size, width), np.nan, np.float32)
    rows[:, :size] = matrix
    lines = np.full((LINES, width), np.nan, np.float32)
    flat = (one.reshape(-1) for one in (rows, *work))
    found = find_eigen_rows(*flat, lines, size, np.float32(least))
    assert (work[0][:found, size:] == 0).all()
    return lines[0, :found], work[0][:found, :size]


def check(matrix, least=None):
    """Check those above a number, all of them by default."""
    wanted, exact = np.linalg.eigh(matrix)
    scale = max(np.abs(matrix).max(), 1e-20)
    least = -scale if least is None else least
    values, vectors = decompose(matrix, least)
    above = values > least
    np.testing.assert_allclose(np.sort(values[above]), wanted[wanted > least], atol=5e-6 * len(matrix) * scale)
    values, vectors = values[above], vectors[above]
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(len(vectors)), atol=5e-4)
    exact = (exact * wanted)[:, wanted > least] @ exact[:, wanted > least].T
    np.testing.assert_allclose(vectors.T * values @ vectors, exact, atol=1e-5 * len(matrix) * scale)
    return len(values)


@pytest.mark.parametrize("size", [1, 2, 3, 16, 25, 36, 49])
@pytest.mark.parametrize("rank", [1, 5, 60])
def test_covariances_of_any_rank(size, rank):
    rng = np.random.default_rng(size + rank)
    factors = rng.normal(size=(size, rank)) * 3
    check(factors @ factors.T)


@pytest.mark.parametrize("size", [1, 2, 3, 4, 16, 32, 36, 49])
@pytest.mark.parametrize("above", [0, 1, 5, 16, 17, 33])
def test_only_those_above_a_number_are_sought(size, above):
    factors = np.random.default_rng(size).normal(size=(size, size + 20))
    matrix = factors * np.geomspace(3, 0.3, size)[:, None]
    matrix = matrix @ matrix.T
    values = np.append(np.linalg.eigvalsh(matrix)[::-1], 0)
    above = min(above, size)
    least = 2 * values[0] if above == 0 else (values[above - 1] + values[above]) / 2
    assert check(matrix, least) == len(decompose(matrix, least)[0]) == above


def test_vectors_of_equal_values_above_a_number_are_at_right_angles():
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(36, 36)))[0]
    assert check(turned * np.repeat([5.0, 2.0, 0.1], 12) @ turned.T, 1.0) == 24
    assert check(turned[:, :6] * np.repeat([5.0, 2.0], 3) @ turned[:, :6].T, 1.0) == 6


@pytest.mark.parametrize("scale", [1e-12, 1e-4, 1e6])
@pytest.mark.parametrize("least", [None, 10.0])
def test_any_unit(scale, least):
    factors = np.random.default_rng(0).normal(size=(12, 20))
    check(scale * factors @ factors.T, least and scale * least)


@pytest.mark.parametrize("least", [None, 0.5])
@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((5, 5)),
        np.eye(6),
        np.ones((7, 7)),
        np.diag([3.0, 0.0, 1.0, 1.0]),
        np.diag([5.0, 4.0, 3.0, 2.0, 1.0, 0.0]),
        np.diag(np.full(5, 2.0)) + np.diag(np.ones(4), 1) + np.diag(np.ones(4), -1),
        np.diag([1.0, 1e-7, 1e7]),
    ],
)
def test_matrices_with_equal_or_far_apart_eigenvalues(matrix, least):
    check(matrix, least)
