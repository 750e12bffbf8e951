"""Denoising of groups of similar patches by low rank, and the picture put together from all groups.

Similar patches, as columns of a matrix, span few dimensions; noise spans all. So the patches, minus their mean, are
expanded in the eigenvectors of their covariance, and each coefficient is shrunk by the weighted nuclear norm (Gu 2014):
weak ones to zero, strong ones hardly.

Here: the kernels. Every task adds up a part of the groups in buffers of its own, and the parts are added in order, so
the result is bitwise the same for any number of threads. Not here: where similar patches lie (`matching`). The readable
float64 statement is in the tests.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import EXACT, f32, f32_3, f32_5, helper, i32_3, i64, in_parts, kernel
from gs2ci.reconstruct.decode.patches.eigen import LINES, REORDERED, eigen_rows_above, padded
from gs2ci.render.simd.vector import LANES, broadcast, fused, get, load, store, sum_of_lanes, where_ge

_ZERO, _ONE = np.float32(0), np.float32(1)
# Parts of the groups: enough for the cores of a workstation, as long as their buffers stay within bounds.
_MOST_PARTS: Final = 16
_BUFFER_BYTES: Final = 256 * 2**20


def denoise_groups(views: F32, corners: NDArray[np.int32], patch: tuple[int, int], sigma: float, fallback: F32) -> F32:
    """Denoise views by groups of similar patches.

    Args:
        views: [N, H, W] float32.
        corners: View, row and column of the upper left corner of each patch of each group, [G, M, 3] int32.
        patch: Height and width of a patch.
        sigma: Standard deviation of the noise.
        fallback: Values of pixels without a patch, [N, H, W].

    Returns:
        The mean over all patches that contain a pixel, [N, H, W].
    """
    parts = int(np.clip(_BUFFER_BYTES // (2 * views.nbytes), 2, _MOST_PARTS))
    # Sum of patches and their number, beside each other.
    sums = np.zeros((parts, *views.shape, 2), np.float32)
    in_parts(_shrink_all, parts, views, corners, patch, np.float32(sigma), sums)
    denoised = np.empty_like(views)
    in_parts(_average, len(views) * views.shape[1], sums, fallback, denoised)
    return denoised


@kernel(i64, i64, f32_3, i32_3, (i64, i64), f32, f32_5, fastmath=EXACT)
def _shrink_all(from_part, to_part, views, corners, patch, sigma, sums):
    """Denoise all groups, and add up their patches by parts of the groups, [parts, N, H, W, 2]."""
    parts = sums.shape[0]
    groups, members = corners.shape[0], corners.shape[1]
    size = patch[0] * patch[1]
    lying = members < size
    row = padded(min(members, size))
    for part in range(from_part, to_part):
        group, work, lines, mean = workspace(members, size)
        for g in range(groups * part // parts, groups * (part + 1) // parts):
            for m in range(members):
                i, top, left = corners[g, m, 0], corners[g, m, 1], corners[g, m, 2]
                for y in range(patch[0]):
                    for x in range(patch[1]):
                        pixel = y * patch[1] + x
                        at = pixel * row + m if lying else m * row + pixel
                        group[at] = views[i, top + y, left + x]
            shrink_group(group, members, size, sigma, work, lines, mean)
            for m in range(members):
                i, top, left = corners[g, m, 0], corners[g, m, 1], corners[g, m, 2]
                for y in range(patch[0]):
                    for x in range(patch[1]):
                        pixel = y * patch[1] + x
                        at = pixel * row + m if lying else m * row + pixel
                        sums[part, i, top + y, left + x, 0] += group[at]
                        sums[part, i, top + y, left + x, 1] += _ONE


@kernel(i64, i64, f32_5, f32_3, f32_3, fastmath=EXACT)
def _average(from_row, to_row, sums, fallback, denoised):
    """Divide the sums by the numbers of patches; rows are those of all views."""
    parts = sums.shape[0]
    _, height, width = denoised.shape
    for task in range(from_row, to_row):
        i, at = task // height, task % height
        for column in range(width):
            total, number = _ZERO, _ZERO
            for part in range(parts):
                total += sums[part, i, at, column, 0]
                number += sums[part, i, at, column, 1]
            denoised[i, at, column] = total / number if number > 0 else fallback[i, at, column]


@helper(fastmath=EXACT)
def workspace(members: int, size: int) -> tuple[F32, F32, F32, F32]:
    """Return the working memory of `shrink_group`: a group, four matrices, single rows, and the mean patch.

    A group of M patches of D pixels has a row for each patch or, if there are fewer patches than pixels, a row for each
    pixel: the singular values are the same, and the matrix whose eigenvectors are needed is the smaller one of two.
    All are 0; rows are padded to whole vectors (`eigen`), and what is beyond their numbers has to stay 0.
    """
    columns = min(members, size)
    row = padded(columns)
    lines = np.zeros((LINES, row), np.float32)
    for j in range(row):
        lines[LINES - 1, j] = np.float32(j)
    group, work = np.zeros(max(members, size) * row, np.float32), np.zeros((4, columns * row), np.float32)
    return group, work, lines, np.zeros(padded(size), np.float32)


@helper(fastmath=REORDERED)
def shrink_group(group: F32, members: int, size: int, sigma: float, work: F32, lines: F32, mean: F32) -> None:
    """Remove the noise of one group, in place.

    Args:
        group: Its M patches of D pixels, as `workspace` says.
        members: M.
        size: D.
        sigma: Standard deviation of its noise, above 0.
        work: For covariance, eigenvectors, projection, and the search.
        lines: For the eigenvectors' search.
        mean: For the mean patch.

    A singular value s of the centred patches becomes max(0, s − √M σ² / s₀), where s₀² = s² − M σ² is its energy
    without noise (Gu 2014, eq. 6 with its constant at 1); below s² = M σ² it becomes 0.
    """
    covariance, vectors, projection = work[0], work[1], work[2]
    lying, rows, columns = members < size, max(members, size), min(members, size)
    row, numbers, beyond = lines.shape[1], lines[LINES - 1], np.float32(columns)
    if lying:
        _centre_rows(group, rows, columns, mean, numbers)
    else:
        _centre(group, members, row, mean)
    _multiply(group, rows, columns, row, covariance)
    kept = 0
    # No eigenvalue is above the root of the sum of squares: most groups of smooth places, above all in colours, need no
    # search for any.
    if _sum_of_squares(covariance, columns * row) > (members * sigma * sigma) ** 2:
        noise = members * sigma * sigma
        found = eigen_rows_above(covariance, vectors, projection, work[3], lines, columns, noise)
        kept = _weigh(lines[0], vectors, found, members, columns, sigma, projection)
    restored = lines[1]
    for r in range(rows):
        for b in range(0, row, LANES):
            total = where_ge(load(numbers, b), beyond, _ZERO, broadcast(mean[r])) if lying else load(mean, b)
            if kept > 0:
                for i in range(columns):
                    total = fused(broadcast(get(group, r * row + i)), load(projection, i * row + b), total)
            store(restored, b, total)
        for b in range(0, row, LANES):
            store(group, r * row + b, load(restored, b))


@helper(fastmath=REORDERED)
def _sum_of_squares(matrix: F32, size: int) -> float:
    total = broadcast(_ZERO)
    for b in range(0, size, LANES):
        row = load(matrix, b)
        total = fused(row, row, total)
    return sum_of_lanes(total)


@helper(fastmath=REORDERED)
def _weigh(values: F32, vectors: F32, found: int, members: int, size: int, sigma: float, projection: F32) -> int:
    """Make the matrix that weights the eigenvectors' parts of a patch, and count those with a weight above 0."""
    row = values.shape[0]
    noise = members * sigma * sigma
    threshold = np.sqrt(np.float32(members)) * sigma * sigma
    for b in range(0, size * row, LANES):
        store(projection, b, broadcast(_ZERO))
    kept = 0
    for k in range(found):
        if values[k] <= noise:
            continue
        weight = _ONE - threshold / (np.sqrt(values[k] - noise) * np.sqrt(values[k]))
        if weight <= 0:
            continue
        kept += 1
        for b in range(0, row, LANES):
            vector = load(vectors, k * row + b) * weight
            for i in range(size):
                at = i * row + b
                store(projection, at, fused(broadcast(get(vectors, k * row + i)), vector, load(projection, at)))
    return kept


@helper(fastmath=REORDERED)
def _centre(group: F32, members: int, row: int, mean: F32) -> None:
    """Subtract the mean patch from patches in rows."""
    share = _ONE / np.float32(members)
    for b in range(0, row, LANES):
        total = broadcast(_ZERO)
        for m in range(members):
            total = total + load(group, m * row + b)
        total = total * share
        store(mean, b, total)
        for m in range(members):
            store(group, m * row + b, load(group, m * row + b) - total)


@helper(fastmath=REORDERED)
def _centre_rows(group: F32, size: int, members: int, mean: F32, numbers: F32) -> None:
    """Subtract the mean patch from patches in columns."""
    row, beyond = numbers.shape[0], np.float32(members)
    for r in range(size):
        total = broadcast(_ZERO)
        for b in range(r * row, (r + 1) * row, LANES):
            total = total + load(group, b)
        mean[r] = sum_of_lanes(total) / beyond
        for b in range(0, row, LANES):
            centred = load(group, r * row + b) - mean[r]
            store(group, r * row + b, where_ge(load(numbers, b), beyond, _ZERO, centred))


@helper(fastmath=REORDERED)
def _multiply(group: F32, rows: int, columns: int, row: int, covariance: F32) -> None:
    """Sum the products of all pairs of columns."""
    # Four rows at once: each row of the group is read once for all four, and their sums are independent.
    for i in range(0, columns, 4):
        i1, i2, i3 = min(i + 1, columns - 1), min(i + 2, columns - 1), min(i + 3, columns - 1)
        for b in range(0, row, LANES):
            s0, s1, s2, s3 = broadcast(_ZERO), broadcast(_ZERO), broadcast(_ZERO), broadcast(_ZERO)
            for m in range(0, rows * row, row):
                patch = load(group, m + b)
                s0 = fused(broadcast(get(group, m + i)), patch, s0)
                s1 = fused(broadcast(get(group, m + i1)), patch, s1)
                s2 = fused(broadcast(get(group, m + i2)), patch, s2)
                s3 = fused(broadcast(get(group, m + i3)), patch, s3)
            store(covariance, i * row + b, s0)
            store(covariance, i1 * row + b, s1)
            store(covariance, i2 * row + b, s2)
            store(covariance, i3 * row + b, s3)
