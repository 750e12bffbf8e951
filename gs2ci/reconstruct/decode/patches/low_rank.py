"""Denoising of groups of similar patches by low rank, and the picture put together from all groups.

Similar patches, as columns of a matrix, span few dimensions; noise spans all. So the patches, minus their mean, are
expanded in the eigenvectors of their covariance, and each coefficient is shrunk by the weighted nuclear norm (Gu 2014):
weak ones to zero, strong ones hardly.

Here: the kernels. Every task adds up a part of the groups in buffers of its own, and the parts are added in order, so
the result is bitwise the same for any number of threads. Not here: where similar patches lie (`matching`). The readable
float64 statement is in the tests.
"""

import math
from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, I32, Size
from gs2ci.core.kernels import EXACT, f32, f32_3, f32_4, f32_5, helper, i32_3, i64, in_parts, kernel
from gs2ci.reconstruct.decode.patches.eigen import LINES, REORDERED, eigen_rows_above, padded
from gs2ci.render.simd.vector import LANES, broadcast, fused, get, load, put, store, sum_of_lanes, where_ge

_ZERO, _ONE = np.float32(0), np.float32(1)
# Parts of the groups: enough for the cores of a workstation, as long as the buffers of a plane stay within bounds.
_MOST_PARTS: Final = 16
_BUFFER_BYTES: Final = 128 * 2**20


def denoise_groups(planes: F32, corners: I32, patch: Size, sigma: float, fallback: F32) -> F32:
    """Denoise the colour planes of views by the same groups of similar patches.

    Args:
        planes: [C, N, H, W] float32.
        corners: View, row and column of the upper left corner of each patch of each group, [G, M, 3] int32.
        patch: Height and width of a patch.
        sigma: Standard deviation of the noise.
        fallback: Values of pixels without a patch, [C, N, H, W].

    Returns:
        The mean over all patches that contain a pixel, [C, N, H, W].

    Where a group has fewer patches than a patch has pixels, its planes are denoised together (`shrink_group`).
    """
    if len(planes) > 1 and corners.shape[1] >= patch[0] * patch[1]:
        each = (slice(c, c + 1) for c in range(len(planes)))
        return np.concatenate([denoise_groups(planes[c], corners, patch, sigma, fallback[c]) for c in each])
    parts = int(np.clip(_BUFFER_BYTES // planes[0].nbytes, 2, _MOST_PARTS))
    sums, denoised = np.zeros((parts, *planes.shape), np.float32), np.empty_like(planes)
    in_parts(_shrink_all, parts, planes, corners, patch, np.float32(sigma), sums)
    numbers = patches_over(corners, patch, planes.shape[1:])
    in_parts(_average, planes.shape[1] * planes.shape[2], sums, numbers, fallback, denoised)
    return denoised


def patches_over(corners: I32, patch: Size, shape: tuple[int, ...]) -> F32:
    """Count the patches that contain each pixel, [N, H, W]."""
    numbers = np.bincount(np.ravel_multi_index(tuple(corners.reshape(-1, 3).T), shape), minlength=math.prod(shape))
    last = (patch[1] - 1, patch[0] - 1)
    each = (
        cv2.boxFilter(one, -1, patch[::-1], anchor=last, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for one in numbers.reshape(shape).astype(np.float32)
    )
    return np.stack([one.reshape(shape[1:]) for one in each])


@kernel(i64, i64, f32_4, i32_3, (i64, i64), f32, f32_5, fastmath=EXACT)
def _shrink_all(from_part, to_part, planes, corners, patch, sigma, sums):
    """Denoise all groups, and add up their patches by parts of the groups, [parts, C, N, H, W]."""
    parts, (colours, views, height, width) = sums.shape[0], planes.shape
    groups, members = corners.shape[0], corners.shape[1]
    size, in_plane = colours * patch[0] * patch[1], views * height * width
    lying = members < size
    row = padded(min(members, size))
    step = row if lying else 1
    given = planes.reshape(-1)
    for part in range(from_part, to_part):
        group, work, lines, mean = workspace(members, size)
        added = sums[part].reshape(-1)
        for g in range(groups * part // parts, groups * (part + 1) // parts):
            for m in range(members):
                at, corner = m if lying else m * row, _place(corners, g, m, height, width)
                for c in range(colours):
                    for y in range(patch[0]):
                        for x in range(patch[1]):
                            put(group, at, get(given, c * in_plane + corner + y * width + x))
                            at += step
            shrink_group(group, members, size, members * colours, sigma, work, lines, mean)
            for m in range(members):
                at, corner = m if lying else m * row, _place(corners, g, m, height, width)
                for c in range(colours):
                    for y in range(patch[0]):
                        for x in range(patch[1]):
                            pixel = c * in_plane + corner + y * width + x
                            put(added, pixel, get(added, pixel) + get(group, at))
                            at += step


@helper(fastmath=EXACT)
def _place(corners: I32, group: int, member: int, height: int, width: int) -> int:
    """Return where the first pixel of a patch lies in a plane."""
    return (corners[group, member, 0] * height + corners[group, member, 1]) * width + corners[group, member, 2]


@kernel(i64, i64, f32_5, f32_3, f32_4, f32_4, fastmath=EXACT)
def _average(from_row, to_row, sums, numbers, fallback, denoised):
    """Divide the sums by the numbers of patches; rows are those of all views."""
    parts = sums.shape[0]
    colours, _, height, width = denoised.shape
    for task in range(from_row, to_row):
        i, at = task // height, task % height
        for column in range(width):
            number = numbers[i, at, column]
            for c in range(colours):
                total = _ZERO
                for part in range(parts):
                    total += sums[part, c, i, at, column]
                denoised[c, i, at, column] = total / number if number > 0 else fallback[c, i, at, column]


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
def shrink_group(
    group: F32, members: int, size: int, spread: int, sigma: float, work: F32, lines: F32, mean: F32
) -> None:
    """Remove the noise of one group, in place.

    Args:
        group: Its M patches of D pixels, as `workspace` says.
        members: M.
        size: D.
        spread: K, M times the number of colour planes whose pixels a patch has.
        sigma: Standard deviation of its noise, above 0.
        work: For covariance, eigenvectors, projection, and the search.
        lines: For the eigenvectors' search.
        mean: For the mean patch.

    A singular value s of the centred patches becomes max(0, s − √K σ² / s₀), where s₀² = s² − K σ² is its energy
    without noise (Gu 2014, eq. 6 with its constant at 1); below s² = K σ² it becomes 0.
    """
    covariance, vectors, projection = work[0], work[1], work[2]
    lying, rows, columns = members < size, max(members, size), min(members, size)
    row, numbers = lines.shape[1], lines[LINES - 1]
    if lying:
        _centre_rows(group, rows, columns, mean, numbers)
    else:
        _centre(group, members, row, mean)
    _multiply(group, rows, columns, row, covariance)
    kept = 0
    # No eigenvalue is above the root of the sum of squares: most groups of smooth places, above all in colours, need no
    # search for any.
    noise = spread * sigma * sigma
    if _sum_of_squares(covariance, columns * row) > noise**2:
        found = eigen_rows_above(covariance, vectors, projection, work[3], lines, columns, noise)
        kept = _weigh(lines[0], vectors, found, spread, columns, sigma, projection)
    _restore(group, rows, columns if kept > 0 else 0, projection, lines, mean, lying)


@helper(fastmath=REORDERED)
def _restore(group: F32, rows: int, columns: int, projection: F32, lines: F32, mean: F32, lying: bool) -> None:
    """Multiply the group by the projection, if any of its columns count, and add the mean patch."""
    row, numbers, beyond = lines.shape[1], lines[LINES - 1], np.float32(len(projection) // lines.shape[1])
    l0, l1, l2, l3 = lines[1], lines[2], lines[3], lines[4]
    # Four rows at once, whose sums are independent, as in `_multiply`; the lines for the search are free by now.
    for r in range(0, rows, 4):
        r1, r2, r3 = min(r + 1, rows - 1), min(r + 2, rows - 1), min(r + 3, rows - 1)
        for b in range(0, row, LANES):
            if lying:
                outside = load(numbers, b)
                s0 = where_ge(outside, beyond, _ZERO, broadcast(mean[r]))
                s1 = where_ge(outside, beyond, _ZERO, broadcast(mean[r1]))
                s2 = where_ge(outside, beyond, _ZERO, broadcast(mean[r2]))
                s3 = where_ge(outside, beyond, _ZERO, broadcast(mean[r3]))
            else:
                s0 = s1 = s2 = s3 = load(mean, b)
            for i in range(columns):
                part = load(projection, i * row + b)
                s0 = fused(broadcast(get(group, r * row + i)), part, s0)
                s1 = fused(broadcast(get(group, r1 * row + i)), part, s1)
                s2 = fused(broadcast(get(group, r2 * row + i)), part, s2)
                s3 = fused(broadcast(get(group, r3 * row + i)), part, s3)
            store(l0, b, s0)
            store(l1, b, s1)
            store(l2, b, s2)
            store(l3, b, s3)
        for b in range(0, row, LANES):
            store(group, r * row + b, load(l0, b))
            store(group, r1 * row + b, load(l1, b))
            store(group, r2 * row + b, load(l2, b))
            store(group, r3 * row + b, load(l3, b))


@helper(fastmath=REORDERED)
def _sum_of_squares(matrix: F32, size: int) -> float:
    total = broadcast(_ZERO)
    for b in range(0, size, LANES):
        row = load(matrix, b)
        total = fused(row, row, total)
    return sum_of_lanes(total)


@helper(fastmath=REORDERED)
def _weigh(values: F32, vectors: F32, found: int, spread: int, size: int, sigma: float, projection: F32) -> int:
    """Make the matrix that weights the eigenvectors' parts of a patch, and count those with a weight above 0."""
    row = values.shape[0]
    noise = spread * sigma * sigma
    threshold = np.sqrt(np.float32(spread)) * sigma * sigma
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
