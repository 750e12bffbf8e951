"""Eigenvectors of small symmetric matrices inside Numba kernels.

Here: Householder's reduction to three diagonals and the implicit QL iteration, in float32 and without any allocation.
LAPACK would be called for each of a hundred thousand small matrices, with threads and buffers of its own. Not here:
what the eigenvectors are for (`low_rank`).
"""

from typing import Final

import numba
import numpy as np

from gs2ci.core.arrays import F32

# Sums may be taken in any order and fused; NaN and infinity keep their meaning.
REORDERED: Final = {"reassoc", "contract", "nsz"}
_ZERO, _HALF, _ONE, _TWO = (np.float32(value) for value in (0.0, 0.5, 1.0, 2.0))
# An entry beside the diagonal counts as 0 below this share of its neighbours on it: float32's rounding.
_ROUNDING: Final = np.float32(2.0**-23)
# A column of which less than this is left, squared, is reduced: float32's smallest normal number, with a margin.
_NOTHING: Final = np.float32(1e-30)
# Each eigenvalue takes two or three; EISPACK gives up after 30.
_MOST_STEPS: Final = 40


@numba.njit(cache=True, fastmath=REORDERED, error_model="numpy")
def eigen_rows(matrix: F32, vectors: F32, values: F32, beside: F32, reflector: F32, product: F32) -> None:
    """Find eigenvalues and eigenvectors of a symmetric matrix.

    Args:
        matrix: [D, D], symmetric; destroyed.
        vectors: [D, D]; row k becomes the unit eigenvector of value k.
        values: [D]; becomes the eigenvalues, in no particular order.
        beside: [D], for the entries beside the diagonal.
        reflector: [D], for one of Householder's vectors.
        product: [D], for the matrix times it.

    After EISPACK's tred2 and tql2 (Wilkinson and Reinsch 1971), with eigenvectors as rows, so that every inner loop
    walks along memory. Errors stay near 1e-6 of the largest eigenvalue.
    """
    _reduce(matrix, vectors, values, beside, reflector, product)
    _diagonalise(vectors, values, beside)


@numba.njit(cache=True, fastmath=REORDERED, error_model="numpy")
def _reduce(matrix: F32, vectors: F32, values: F32, beside: F32, reflector: F32, product: F32) -> None:
    """Turn the matrix into three diagonals, and note the turns' transpose in `vectors`."""
    size = matrix.shape[0]
    for i in range(size):
        for j in range(size):
            vectors[i, j] = _ZERO
        vectors[i, i] = _ONE
    for k in range(size - 2):
        rest = _ZERO
        for j in range(k + 2, size):
            rest += matrix[k, j] * matrix[k, j]
        first = matrix[k, k + 1]
        if rest <= _NOTHING:
            beside[k] = first
            continue
        length = np.sqrt(first * first + rest)
        beside[k] = -length if first >= 0 else length
        reflector[k + 1] = first - beside[k]
        for j in range(k + 2, size):
            reflector[j] = matrix[k, j]
        scale = _TWO / (reflector[k + 1] * reflector[k + 1] + rest)
        _reflect(matrix, vectors, reflector, product, scale, k + 1)
    for i in range(size):
        values[i] = matrix[i, i]
    if size > 1:
        beside[size - 2] = matrix[size - 2, size - 1]
    beside[size - 1] = _ZERO


@numba.njit(cache=True, fastmath=REORDERED, error_model="numpy")
def _reflect(matrix: F32, vectors: F32, reflector: F32, product: F32, scale: float, first: int) -> None:
    """Apply 1 − scale v vᵀ to both sides of the matrix from row `first` on, and to the left of `vectors`."""
    size = matrix.shape[0]
    for j in range(first, size):
        product[j] = _ZERO
    for i in range(first, size):
        factor = reflector[i] * scale
        for j in range(first, size):
            product[j] += factor * matrix[i, j]
    along = _ZERO
    for j in range(first, size):
        along += reflector[j] * product[j]
    along *= scale * _HALF
    for j in range(first, size):
        product[j] -= along * reflector[j]
    for i in range(first, size):
        by_product, by_reflector = reflector[i], product[i]
        for j in range(first, size):
            matrix[i, j] -= by_product * product[j] + by_reflector * reflector[j]
    for j in range(size):
        product[j] = _ZERO
    for i in range(first, size):
        factor = reflector[i] * scale
        for j in range(size):
            product[j] += factor * vectors[i, j]
    for i in range(first, size):
        factor = reflector[i]
        for j in range(size):
            vectors[i, j] -= factor * product[j]


@numba.njit(cache=True, fastmath=REORDERED, error_model="numpy")
def _diagonalise(vectors: F32, values: F32, beside: F32) -> None:
    size = values.shape[0]
    for low in range(size):
        for _ in range(_MOST_STEPS):
            high = low
            while high < size - 1:
                if abs(beside[high]) <= _ROUNDING * (abs(values[high]) + abs(values[high + 1])):
                    break
                high += 1
            if high == low:
                break
            _ql_step(vectors, values, beside, low, high)


@numba.njit(cache=True, fastmath=REORDERED, error_model="numpy")
def _ql_step(vectors: F32, values: F32, beside: F32, low: int, high: int) -> None:
    """One implicit QL step with Wilkinson's shift on the block from `low` to `high`."""
    size = values.shape[0]
    g = (values[low + 1] - values[low]) / (_TWO * beside[low])
    r = np.sqrt(g * g + _ONE)
    g = values[high] - values[low] + beside[low] / (g + (r if g >= 0 else -r))
    sine, cosine, shift = _ONE, _ONE, _ZERO
    for i in range(high - 1, low - 1, -1):
        f, b = sine * beside[i], cosine * beside[i]
        r = np.sqrt(f * f + g * g)
        beside[i + 1] = r
        if r == 0:
            values[i + 1] -= shift
            beside[high] = _ZERO
            return
        sine, cosine = f / r, g / r
        g = values[i + 1] - shift
        r = (values[i] - g) * sine + _TWO * cosine * b
        shift = sine * r
        values[i + 1] = g + shift
        g = cosine * r - b
        for k in range(size):
            upper, lower = vectors[i + 1, k], vectors[i, k]
            vectors[i + 1, k] = sine * lower + cosine * upper
            vectors[i, k] = cosine * lower - sine * upper
    values[low] -= shift
    beside[low] = g
    beside[high] = _ZERO
