"""What a group of similar patches has in common, and the picture put together from all groups.

Similar patches, as columns of a matrix, span few dimensions; noise spans all. So the patches, less their mean, are
taken apart by the eigenvectors of their covariance, and each part shortened by what the weighted nuclear norm asks for
(Gu 2014): the weak ones to nothing, the strong ones hardly.

Here: the kernels. Every task of a parallel loop adds up a part of the groups in buffers of its own, and the parts are
added in order, so the result is bitwise the same for any number of threads. Not here: where similar patches lie
(`matching`). The readable float64 statement is in the tests.
"""

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.decode.patches.eigen import REORDERED, eigen_rows

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
        fallback: Taken where no group has a patch, [N, H, W].

    Returns:
        The mean over all patches that hold a pixel, [N, H, W].
    """
    parts = int(np.clip(_BUFFER_BYTES // (2 * views.nbytes), 2, _MOST_PARTS))
    denoised: F32 = _denoise(views, corners, patch, sigma, fallback, parts)
    return denoised


@numba.njit(cache=True, parallel=True)
def _denoise(
    views: F32, corners: NDArray[np.int32], patch: tuple[int, int], sigma: float, fallback: F32, parts: int
) -> F32:
    count, height, width = views.shape
    groups, members = corners.shape[0], corners.shape[1]
    size = patch[0] * patch[1]
    # Sum of patches and their number, beside each other.
    sums = np.zeros((parts, count, height, width, 2), np.float32)
    for part in numba.prange(parts):
        group, mean = np.empty((members, size), np.float32), np.empty(size, np.float32)
        squares = np.empty((3, size, size), np.float32)
        lines = np.empty((4, size), np.float32)
        for g in range(groups * part // parts, groups * (part + 1) // parts):
            for m in range(members):
                i, top, left = corners[g, m, 0], corners[g, m, 1], corners[g, m, 2]
                for y in range(patch[0]):
                    for x in range(patch[1]):
                        group[m, y * patch[1] + x] = views[i, top + y, left + x]
            shrink_group(group, np.float32(sigma), mean, squares, lines)
            for m in range(members):
                i, top, left = corners[g, m, 0], corners[g, m, 1], corners[g, m, 2]
                for y in range(patch[0]):
                    for x in range(patch[1]):
                        sums[part, i, top + y, left + x, 0] += group[m, y * patch[1] + x]
                        sums[part, i, top + y, left + x, 1] += _ONE
    denoised = np.empty_like(views)
    for task in numba.prange(count * height):
        i, row = task // height, task % height
        for column in range(width):
            total, number = _ZERO, _ZERO
            for part in range(parts):
                total += sums[part, i, row, column, 0]
                number += sums[part, i, row, column, 1]
            denoised[i, row, column] = total / number if number > 0 else fallback[i, row, column]
    return denoised


@numba.njit(cache=True, fastmath=REORDERED, error_model="numpy")
def shrink_group(group: F32, sigma: float, mean: F32, squares: F32, lines: F32) -> None:
    """Take the noise off one group, in place.

    Args:
        group: [M, D].
        sigma: Standard deviation of its noise, above 0.
        mean: [D], for the mean patch.
        squares: [3, D, D], for covariance, eigenvectors and projection.
        lines: [4, D], for the eigenvectors' search.

    A singular value s of the centred patches becomes max(0, s − √M σ² / s₀), where s₀² = s² − M σ² is what would be
    left of its energy without noise (Gu 2014, eq. 6 with its constant at 1); below s² = M σ² nothing is left.
    """
    members, size = group.shape
    covariance, vectors, projection = squares[0], squares[1], squares[2]
    _centre(group, mean, covariance)
    eigen_rows(covariance, vectors, lines[0], lines[1], lines[2], lines[3])
    kept = _weigh(lines[0], vectors, members, sigma, projection)
    restored = lines[1]
    for m in range(members):
        for j in range(size):
            restored[j] = mean[j]
        if kept > 0:
            for i in range(size):
                factor = group[m, i]
                for j in range(size):
                    restored[j] += factor * projection[i, j]
        for j in range(size):
            group[m, j] = restored[j]


@numba.njit(cache=True, fastmath=REORDERED, error_model="numpy")
def _weigh(values: F32, vectors: F32, members: int, sigma: float, projection: F32) -> int:
    """Make the matrix that weighs each eigenvector's part of a patch, and count those of any weight."""
    size = values.shape[0]
    noise = members * sigma * sigma
    threshold = np.sqrt(np.float32(members)) * sigma * sigma
    for i in range(size):
        for j in range(size):
            projection[i, j] = _ZERO
    kept = 0
    for k in range(size):
        if values[k] <= noise:
            continue
        weight = _ONE - threshold / (np.sqrt(values[k] - noise) * np.sqrt(values[k]))
        if weight <= 0:
            continue
        kept += 1
        for i in range(size):
            factor = weight * vectors[k, i]
            for j in range(size):
                projection[i, j] += factor * vectors[k, j]
    return kept


@numba.njit(cache=True, fastmath=REORDERED, error_model="numpy")
def _centre(group: F32, mean: F32, covariance: F32) -> None:
    """Subtract the mean patch, and sum the products of what is left."""
    members, size = group.shape
    for j in range(size):
        mean[j] = _ZERO
    for m in range(members):
        for j in range(size):
            mean[j] += group[m, j]
    share = _ONE / np.float32(members)
    for i in range(size):
        mean[i] *= share
        for j in range(size):
            covariance[i, j] = _ZERO
    for m in range(members):
        for j in range(size):
            group[m, j] -= mean[j]
        for i in range(size):
            factor = group[m, i]
            for j in range(size):
                covariance[i, j] += factor * group[m, j]
