"""Eigenvectors of small symmetric matrices inside Numba kernels, those of large eigenvalues alone.

Here: Householder's reduction to three diagonals, bisection of sixteen eigenvalues at once and their vectors by twisted
factorisations; where eigenvalues are alike, the implicit QL iteration of all. In float32, on rows of whole vectors of
16 lanes and without any allocation. LAPACK would be called for each of a hundred thousand small matrices, with threads
and buffers of its own, and loops over 36 numbers that a compiler vectorises by itself take two to five times as long.
Not here: what the eigenvectors are for (`low_rank`).

Matrices are flat: row i of D begins at i times the width, D rounded up to whole vectors; what is beyond D is 0.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import EXACT, helper
from gs2ci.render.simd.vector import (
    LANES,
    broadcast,
    fused,
    get,
    load,
    maximum,
    minimum,
    put,
    store,
    sum_of_lanes,
    where_ge,
)

# Sums may be taken in any order and fused; NaN and infinity keep their meaning.
REORDERED: Final = frozenset({"reassoc", "contract", "nsz"})
_ZERO, _HALF, _ONE, _TWO = (np.float32(value) for value in (0.0, 0.5, 1.0, 2.0))
# An entry beside the diagonal counts as 0 below this share of its neighbours on it: float32's rounding.
_ROUNDING: Final = np.float32(2.0**-23)
# A column of which less than this is left, squared, is reduced: float32's smallest normal number, with a margin.
_NOTHING: Final = np.float32(1e-30)
# Each eigenvalue takes two or three; EISPACK gives up after 30.
_MOST_STEPS: Final = 40
# Halvings of an interval until it is as narrow as float32's rounding.
_HALVINGS: Final = int(np.finfo(np.float32).nmant) + 1
# Values that differ by a smaller share of the largest: their eigenvectors have to be sought together.
_ALIKE: Final = np.float32(1e-5)
# No squared norm of a sound vector with an entry of 1 at its place is near this.
_ENDLESS: Final = np.float32(1e30)
# Rows of `lines`: eigenvalues, entries beside the diagonal, a Householder vector, the matrix times it, scales of all
# Householder vectors, eigenvalues found apart, lane numbers.
LINES: Final = 7


@helper(fastmath=EXACT)
def padded(size: int) -> int:
    """Return the width of rows of so many numbers."""
    return (size + LANES - 1) // LANES * LANES


@helper(fastmath=REORDERED)
def eigen_rows_above(
    matrix: F32, vectors: F32, forward: F32, backward: F32, lines: F32, size: int, least: float
) -> int:
    """Find the eigenvectors of a symmetric matrix whose eigenvalues are above a number.

    Args:
        matrix: Its rows, [D * width], beyond D zero; destroyed.
        vectors: [D * width]; row k becomes the unit eigenvector of value k, and 0 beyond D.
        forward: [D * width], for the work.
        backward: Likewise.
        lines: [LINES, width], for the work; its first row begins with the eigenvalues.
        size: D.
        least: The number.

    Returns:
        How many were found: those above it, in descending order; or all, in no particular order, if two of these are
        alike.

    Reduction and QL iteration are EISPACK's tred2 and tql2 (Wilkinson and Reinsch 1971), with eigenvectors as rows, so
    that every inner loop walks along memory. Errors stay near 1e-6 of the largest eigenvalue.
    """
    _reduce(matrix, lines, size)
    found = _apart(matrix, vectors, forward, backward, lines, size, least)
    if found >= 0:
        return found
    width = lines.shape[1]
    for b in range(0, size * width, LANES):
        store(vectors, b, broadcast(_ZERO))
    for i in range(size):
        put(vectors, i * width + i, _ONE)
    for k in range(size - 2):
        for b in range(0, width, LANES):
            _mirror(matrix, lines, k, size, vectors, b, width)
    _diagonalise(vectors, lines[0], lines[1], size)
    return size


@helper(fastmath=REORDERED)
def _reduce(matrix: F32, lines: F32, size: int) -> None:
    """Turn the matrix into three diagonals; row k keeps its reflector from column k + 1 on."""
    values, beside, reflector, product, scales, numbers = lines[0], lines[1], lines[2], lines[3], lines[4], lines[6]
    width = values.shape[0]
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
            beside[k], scales[k] = first, _ZERO
            continue
        length = np.sqrt(first * first + rest)
        beside[k] = -length if first >= 0 else length
        for b in range((k + 1) // LANES * LANES, width, LANES):
            store(reflector, b, where_ge(load(numbers, b), after, load(matrix, k * width + b), _ZERO))
        reflector[k + 1] = first - beside[k]
        scales[k] = _TWO / (reflector[k + 1] * reflector[k + 1] + rest)
        put(matrix, k * width + k + 1, reflector[k + 1])
        _reflect(matrix, reflector, product, numbers, scales[k], k + 1, size)
    for i in range(size):
        values[i] = matrix[i * width + i]
    if size > 1:
        beside[size - 2] = matrix[(size - 2) * width + size - 1]
    beside[size - 1] = _ZERO


@helper(fastmath=REORDERED)
def _reflect(matrix: F32, reflector: F32, product: F32, numbers: F32, scale: float, first: int, size: int) -> None:
    """Apply 1 − scale v vᵀ to both sides of the matrix from row `first` on."""
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


@helper(fastmath=REORDERED)
def _mirror(matrix: F32, lines: F32, k: int, size: int, columns: F32, at: int, stride: int) -> None:
    """Apply reflector k to 16 columns, which begin at `at`; their rows are `stride` apart."""
    width, scale = lines.shape[1], lines[4, k]
    turned = broadcast(_ZERO)
    for i in range(k + 1, size):
        turned = fused(broadcast(get(matrix, k * width + i)), load(columns, at + i * stride), turned)
    turned = turned * scale
    for i in range(k + 1, size):
        left = load(columns, at + i * stride)
        store(columns, at + i * stride, fused(broadcast(-get(matrix, k * width + i)), turned, left))


@helper(fastmath=REORDERED)
def _apart(matrix: F32, vectors: F32, forward: F32, backward: F32, lines: F32, size: int, least: float) -> int:
    """Find the pairs above a number, each by itself, 16 at once; return −1 if two values are alike.

    By twisted factorisations (Dhillon and Parlett 2004), whose vectors are at right angles as long as values are far
    enough apart.
    """
    values, beside, squares, taken, found = lines[0], lines[1], lines[2], lines[3], lines[5]
    width = values.shape[0]
    most, before = least, _ZERO
    for i in range(size):
        most, before = max(most, values[i] + abs(beside[i]) + before), abs(beside[i])
    tiny = _ROUNDING * most
    for i in range(size):
        squares[i] = max(beside[i] * beside[i], tiny * tiny)
    above = _bisect(values, squares, lines[6], found, size, least, most)
    for k in range(above - 1):
        if found[k] - found[k + 1] <= _ALIKE * most:
            return -1
    for b in range(0, above * width, LANES):
        store(vectors, b, broadcast(_ZERO))
    for b in range(0, above, LANES):
        store(taken, 0, _twisted(values, beside, load(found, b), tiny, size, forward, backward))
        for k in range(size - 3, -1, -1):
            _mirror(matrix, lines, k, size, forward, 0, LANES)
        for k in range(min(LANES, above - b)):
            if not 0 < taken[k] < _ENDLESS:
                return -1
            per_norm = _ONE / np.sqrt(taken[k])
            for i in range(size):
                put(vectors, (b + k) * width + i, get(forward, i * LANES + k) * per_norm)
    for b in range(0, above, LANES):
        store(values, b, load(found, b))
    return above


@helper(fastmath=REORDERED)
def _bisect(values: F32, squares: F32, numbers: F32, found: F32, size: int, least: float, most: float) -> int:
    """Write the eigenvalues of three diagonals from `least` to `most` in descending order, and count them."""
    above = int(sum_of_lanes(_count_above(values, squares, broadcast(np.float32(least)), size))) // LANES
    for b in range(0, above, LANES):
        low, high, rank = broadcast(np.float32(least)), broadcast(most), load(numbers, b) + _ONE
        for _ in range(_HALVINGS):
            middle = (low + high) * _HALF
            beyond = _count_above(values, squares, middle, size)
            low, high = where_ge(beyond, rank, middle, low), where_ge(beyond, rank, high, middle)
        store(found, b, (low + high) * _HALF)
    return above


@helper(fastmath=EXACT)
def _count_above(values, squares, at, size):
    """Count the eigenvalues of three diagonals above 16 numbers by Sturm's sequence, from both ends at once."""
    half = (size - 1) // 2
    top = bottom = broadcast(np.float32(np.inf))
    above = broadcast(_ZERO)
    before = after = _ZERO
    for i in range(half):
        j = size - 1 - i
        top = (get(values, i) - at) - before / top
        bottom = (get(values, j) - at) - after / bottom
        before, after = get(squares, i), get(squares, j - 1)
        above = above + where_ge(top, _ZERO, _ONE, _ZERO) + where_ge(bottom, _ZERO, _ONE, _ZERO)
    for i in range(half, size - 1 - half):
        top = (get(values, i) - at) - before / top
        before = get(squares, i)
        above = above + where_ge(top, _ZERO, _ONE, _ZERO)
    last = size - 1 - half
    middle = (get(values, last) - at) - before / top - after / bottom
    return above + where_ge(middle, _ZERO, _ONE, _ZERO)


@helper(fastmath=EXACT)
def _twisted(values, beside, at, tiny, size, vectors, backward):
    """Write eigenvectors of three diagonals for 16 eigenvalues, [D, 16], 1 at one place each; return squared norms."""
    below = broadcast(_ZERO)
    for i in range(size - 1, -1, -1):
        below = _not_zero((get(values, i) - at) - below, tiny)
        store(backward, i * LANES, below)
        if i > 0:
            below = (get(beside, i - 1) * get(beside, i - 1)) / below
    least, place, above = broadcast(np.float32(np.inf)), broadcast(_ZERO), broadcast(_ZERO)
    for i in range(size):
        here = get(values, i) - at
        pivot = _not_zero(here - above, tiny)
        store(vectors, i * LANES, pivot)
        twist = (pivot + load(backward, i * LANES)) - here
        twist = maximum(twist, -twist)
        place = where_ge(twist, least, place, broadcast(np.float32(i)))
        least = minimum(twist, least)
        above = (get(beside, i) * get(beside, i)) / pivot
    part, norms = broadcast(_ZERO), broadcast(_ZERO)
    for i in range(size - 1, -1, -1):
        number = broadcast(np.float32(i))
        part = where_ge(place, number, (part * (-get(beside, i))) / load(vectors, i * LANES), _ZERO)
        part = where_ge(number, place, where_ge(place, number, _ONE, _ZERO), part)
        store(vectors, i * LANES, part)
        norms = fused(part, part, norms)
    part = load(vectors, 0)
    for i in range(1, size):
        number = broadcast(np.float32(i))
        further = (part * (-get(beside, i - 1))) / load(backward, i * LANES)
        part = where_ge(place, number, load(vectors, i * LANES), further)
        store(vectors, i * LANES, part)
        norms = norms + where_ge(place, number, _ZERO, part * part)
    return norms


@helper(fastmath=EXACT)
def _not_zero(pivot, tiny):
    return where_ge(pivot * pivot, tiny * tiny, pivot, tiny)


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
