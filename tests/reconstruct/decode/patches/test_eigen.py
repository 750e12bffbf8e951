"""The kernel's eigenvectors against LAPACK's, in float64."""

import numba
import numpy as np
import pytest

from gs2ci.reconstruct.decode.patches.eigen import LINES, eigen_rows, padded


@numba.njit
def find_eigen_rows(matrix, vectors, lines, size):
    eigen_rows(matrix, vectors, lines, size)


def decompose(matrix):
    size = len(matrix)
    width = padded(size)
    rows, vectors = np.zeros((size, width), np.float32), np.full((size, width), np.nan, np.float32)
    rows[:, :size] = matrix
    lines = np.full((LINES, width), np.nan, np.float32)
    find_eigen_rows(rows.reshape(-1), vectors.reshape(-1), lines, size)
    assert (vectors[:, size:] == 0).all()
    return lines[0, :size], vectors[:, :size]


def check(matrix):
    values, vectors = decompose(matrix)
    scale = max(np.abs(matrix).max(), 1e-20)
    np.testing.assert_allclose(np.sort(values), np.linalg.eigvalsh(matrix), atol=5e-6 * len(matrix) * scale)
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(len(matrix)), atol=2e-5)
    np.testing.assert_allclose(vectors.T * values @ vectors, matrix, atol=1e-5 * len(matrix) * scale)


@pytest.mark.parametrize("size", [1, 2, 3, 16, 25, 36, 49])
@pytest.mark.parametrize("rank", [1, 5, 60])
def test_covariances_of_any_rank(size, rank):
    rng = np.random.default_rng(size + rank)
    factors = rng.normal(size=(size, rank)) * 3
    check(factors @ factors.T)


@pytest.mark.parametrize("scale", [1e-12, 1e-4, 1e6])
def test_any_unit(scale):
    factors = np.random.default_rng(0).normal(size=(12, 20))
    check(scale * factors @ factors.T)


@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((5, 5)),
        np.eye(6),
        np.ones((7, 7)),
        np.diag([3.0, 0.0, 1.0, 1.0]),
        np.diag(np.full(5, 2.0)) + np.diag(np.ones(4), 1) + np.diag(np.ones(4), -1),
        np.diag([1.0, 1e-7, 1e7]),
    ],
)
def test_matrices_with_equal_or_far_apart_eigenvalues(matrix):
    check(matrix)
