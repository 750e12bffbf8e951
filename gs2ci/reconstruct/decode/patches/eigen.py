"""Eigenvectors of small symmetric matrices inside Numba kernels.

Here: Householder's reduction to three diagonals and the implicit QL iteration, in float32, on rows of whole vectors of
16 lanes and without any allocation. LAPACK would be called for each of a hundred thousand small matrices, with threads
and buffers of its own, and loops over 36 numbers that a compiler vectorises by itself take two to five times as long.
Not here: what the eigenvectors are for (`low_rank`).

Matrices are flat: row i of D begins at i times the width, D rounded up to whole vectors; what is beyond D is 0.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import EXACT, helper
from gs2ci.render.simd.vector import LANES, broadcast, fused, get, load, put, store, sum_of_lanes, where_ge

# Sums may be taken in any order and fused; NaN and infinity keep their meaning.
REORDERED: Final = frozenset({"reassoc", "contract", "nsz"})
_ZERO, _HALF, _ONE, _TWO = (np.float32(value) for value in (0.0, 0.5, 1.0, 2.0))
# An entry beside the diagonal counts as 0 below this share of its neighbours on it: float32's rounding.
_ROUNDING: Final = np.float32(2.0**-23)
# A column of which less than this is left, squared, is reduced: float32's smallest normal number, with a margin.
_NOTHING: Final = np.float32(1e-30)
# Each eigenvalue takes two or three; EISPACK gives up after 30.
_MOST_STEPS: Final = 40
# Rows of `lines`: eigenvalues, entries beside the diagonal, a Householder vector, the matrix times it, lane numbers.
LINES: Final = 5


@helper(fastmath=EXACT)
def padded(size: int) -> int:
    """Return the width of rows of so many numbers."""
    return (size + LANES - 1) // LANES * LANES


@helper(fastmath=REORDERED)
def eigen_rows(matrix: F32, vectors: F32, lines: F32, size: int) -> None:
    """Find eigenvalues and eigenvectors of a symmetric matrix.

    Args:
        matrix: Its rows, [D * width], beyond D zero; destroyed.
        vectors: [D * width]; row k becomes the unit eigenvector of value k, and 0 beyond D.
        lines: [LINES, width], for the work; the first D of its first row become the eigenvalues, in no particular
            order.
        size: D.

    After EISPACK's tred2 and tql2 (Wilkinson and Reinsch 1971), with eigenvectors as rows, so that every inner loop
    walks along memory. Errors stay near 1e-6 of the largest eigenvalue.
    """
    values, beside = lines[0], lines[1]
    _reduce(matrix, vectors, lines, size)
    _diagonalise(vectors, values, beside, size)


@helper(fastmath=REORDERED)
def _reduce(matrix: F32, vectors: F32, lines: F32, size: int) -> None:
    """Turn the matrix into three diagonals, and note the turns' transpose in `vectors`."""
    values, beside, reflector, product, numbers = lines[0], lines[1], lines[2], lines[3], lines[4]
    width = values.shape[0]
    for b in range(0, size * width, LANES):
        store(vectors, b, broadcast(_ZERO))
    for i in range(size):
        put(vectors, i * width + i, _ONE)
    for j in range(width):
        numbers[j] = np.float32(j)
        reflector[j] = _ZERO
    for k in range(size - 2):
        after = np.float32(k + 2)
        sums = broadcast(_ZERO)
        for b in range((k + 2) // LANES * LANES, width, LANES):
            row = where_ge(load(numbers, b), after, load(matrix, k * width + b), _ZERO)
            sums = fused(row, row, sums)
        rest, first = sum_of_lanes(sums), get(matrix, k * width + k + 1)
        if rest <= _NOTHING:
            beside[k] = first
            continue
        length = np.sqrt(first * first + rest)
        beside[k] = -length if first >= 0 else length
        for b in range((k + 1) // LANES * LANES, width, LANES):
            store(reflector, b, where_ge(load(numbers, b), after, load(matrix, k * width + b), _ZERO))
        reflector[k + 1] = first - beside[k]
        scale = _TWO / (reflector[k + 1] * reflector[k + 1] + rest)
        _reflect(matrix, vectors, reflector, product, numbers, scale, k + 1, size)
    for i in range(size):
        values[i] = matrix[i * width + i]
    if size > 1:
        beside[size - 2] = matrix[(size - 2) * width + size - 1]
    beside[size - 1] = _ZERO


@helper(fastmath=REORDERED)
def _reflect(
    matrix: F32, vectors: F32, reflector: F32, product: F32, numbers: F32, scale: float, first: int, size: int
) -> None:
    """Apply 1 − scale v vᵀ to both sides of the matrix from row `first` on, and to the left of `vectors`."""
    width = reflector.shape[0]
    start, lowest = first // LANES * LANES, np.float32(first)
    sums = broadcast(_ZERO)
    for b in range(start, width, LANES):
        turned = broadcast(_ZERO)
        for i in range(first, size):
            turned = fused(broadcast(get(reflector, i)), load(matrix, i * width + b), turned)
        # Columns before the first are done with, and hold what was left there.
        turned = where_ge(load(numbers, b), lowest, turned * scale, _ZERO)
        store(product, b, turned)
        sums = fused(turned, load(reflector, b), sums)
    along = sum_of_lanes(sums) * scale * _HALF
    for b in range(start, width, LANES):
        store(product, b, fused(broadcast(-along), load(reflector, b), load(product, b)))
    for b in range(start, width, LANES):
        turned, mirror = load(product, b), load(reflector, b)
        for i in range(first, size):
            at = i * width + b
            left = fused(broadcast(-get(reflector, i)), turned, load(matrix, at))
            store(matrix, at, fused(broadcast(-get(product, i)), mirror, left))
    for b in range(0, width, LANES):
        turned = broadcast(_ZERO)
        for i in range(first, size):
            turned = fused(broadcast(get(reflector, i)), load(vectors, i * width + b), turned)
        turned = turned * scale
        for i in range(first, size):
            at = i * width + b
            store(vectors, at, fused(broadcast(-get(reflector, i)), turned, load(vectors, at)))


@helper(fastmath=REORDERED)
def _diagonalise(vectors: F32, values: F32, beside: F32, size: int) -> None:
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


@helper(fastmath=REORDERED)
def _ql_step(vectors: F32, values: F32, beside: F32, low: int, high: int) -> None:
    """One implicit QL step with Wilkinson's shift on the block from `low` to `high`."""
    width = values.shape[0]
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
        _turn(vectors, i * width, width, sine, cosine)
    values[low] -= shift
    beside[low] = g
    beside[high] = _ZERO


@helper(fastmath=REORDERED)
def _turn(vectors: F32, at: int, width: int, sine: float, cosine: float) -> None:
    """Turn the row that begins at `at` and the next one into each other."""
    for b in range(at, at + width, LANES):
        lower, upper = load(vectors, b), load(vectors, b + width)
        store(vectors, b + width, fused(broadcast(sine), lower, upper * cosine))
        store(vectors, b, fused(broadcast(-sine), upper, lower * cosine))
