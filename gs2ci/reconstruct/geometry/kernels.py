"""Numba kernels of the plane sweep: matching cost and semi-global smoothing. Only `sweep` imports this file.

Every task writes its own rows or columns and nothing is summed across tasks, so the result is bitwise the same for
any number of threads. The readable statement of the same steps, in numpy float64, is in the tests
(`tests/reconstruct/geometry/test_sweep.py`), which hold these kernels to it.
"""

import numba
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

HALF_WINDOW = 3
# Sum of absolute differences at which two pixels count as different, and the cost of a pixel that a view cannot see.
TRUNCATED_AT = 0.6
UNSEEN_COST = 0.3
# Semi-global penalties, in the unit of the cost: for one step in inverse depth, and for any jump.
SMALL_JUMP = 0.01
LARGE_JUMP = 0.08

_STRIP_ROWS = 32
_STRIP_COLUMNS = 32
# Planes worked on together: their costs of one pixel fill one cache line.
_CHUNK = 16
_LEAST_DEPTH = np.float32(1e-3)
_FAR = np.float32(1e9)


@numba.njit(cache=True)
def _difference_row(reference: F32, view: F32, homography: F64, r: int, out: F32) -> None:
    """Compare row r of the reference features with where a plane sends it in another view; [W] costs."""
    height, width, features = view.shape
    u0, du = homography[0, 1] * r + homography[0, 2], homography[0, 0]
    v0, dv = homography[1, 1] * r + homography[1, 2], homography[1, 0]
    z0, dz = homography[2, 1] * r + homography[2, 2], homography[2, 0]
    for c in range(width):
        z = np.float32(z0 + dz * c)
        if z < _LEAST_DEPTH:
            out[c] = UNSEEN_COST
            continue
        u, v = np.float32(u0 + du * c) / z, np.float32(v0 + dv * c) / z
        if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
            out[c] = UNSEEN_COST
            continue
        col, row = min(int(u), width - 2), min(int(v), height - 2)
        a, b = u - np.float32(col), v - np.float32(row)
        w00, w01 = (1 - a) * (1 - b), a * (1 - b)
        w10, w11 = (1 - a) * b, a * b
        total = np.float32(0.0)
        for k in range(features):
            sample = w00 * view[row, col, k] + w01 * view[row, col + 1, k]
            sample += w10 * view[row + 1, col, k] + w11 * view[row + 1, col + 1, k]
            total += abs(sample - reference[r, c, k])
        out[c] = min(total, np.float32(TRUNCATED_AT))


@numba.njit(cache=True)
def _box_row(values: F32, out: F32) -> None:
    """Sum over 7 neighbours in a row, the window cut off at the ends."""
    width = values.shape[0]
    for c in range(width):
        out[c] = values[c]
    for shift in range(1, HALF_WINDOW + 1):
        for c in range(width - shift):
            out[c] += values[c + shift]
        for c in range(shift, width):
            out[c] += values[c - shift]


@numba.njit(cache=True)
def _sum_smallest(costs: F32, count: int, out: F32) -> None:
    """Sum the `count` smallest of V costs per pixel; costs [V, W] are reordered."""
    views, width = costs.shape
    out[:] = 0
    for j in range(count):
        # One bubble pass brings the smallest of the rest to row j.
        for i in range(views - 1, j, -1):
            for c in range(width):
                low, high = min(costs[i - 1, c], costs[i, c]), max(costs[i - 1, c], costs[i, c])
                costs[i - 1, c], costs[i, c] = low, high
        for c in range(width):
            out[c] += costs[j, c]


@numba.njit(cache=True)
def _plane_of_strip(
    reference: F32, views: F32, homographies: F64, best: int, top: int, bottom: int, ring: F32, out: F32
) -> None:
    """Fill out[top:bottom, :] (any strides) with the cost of one plane."""
    height, width = reference.shape[:2]
    count = views.shape[0]
    window = 2 * HALF_WINDOW + 1
    row_costs, per_view = np.empty(width, np.float32), np.empty((count, width), np.float32)
    total, columns = np.empty(width, np.float32), np.empty(width, np.float32)
    for c in range(width):
        columns[c] = min(c, HALF_WINDOW) + min(width - 1 - c, HALF_WINDOW) + 1
    for r in range(max(top - HALF_WINDOW, 0), min(bottom + HALF_WINDOW, height) + HALF_WINDOW):
        if r < min(bottom + HALF_WINDOW, height):
            for i in range(count):
                _difference_row(reference, views[i], homographies[i], r, row_costs)
                _box_row(row_costs, ring[i, r % window])
        centre = r - HALF_WINDOW
        if centre < top or centre >= bottom:
            continue
        low, high = max(centre - HALF_WINDOW, 0), min(centre + HALF_WINDOW, height - 1)
        per_view[:] = 0
        for i in range(count):
            for q in range(low, high + 1):
                for c in range(width):
                    per_view[i, c] += ring[i, q % window, c]
        _sum_smallest(per_view, best, total)
        for c in range(width):
            out[centre, c] = total[c] / (columns[c] * (high - low + 1) * best)


@numba.njit(cache=True, parallel=True)
def matching_cost(reference: F32, views: F32, homographies: F64, best: int) -> F32:
    """Compare every pixel of the reference view with the others, on every plane.

    Args:
        reference: Features of the reference view, [H, W, F]; H, W >= 2.
        views: Features of the other views, [V, H, W, F].
        homographies: From array coordinates of the reference view to those of each view, for each plane,
            [D, V, 3, 3].
        best: So many views with the smallest cost count; the others may be occluded.

    Returns:
        Mean truncated absolute difference in a 7x7 window, [H, W, D].
    """
    height, width = reference.shape[:2]
    planes, count = homographies.shape[:2]
    cost = np.empty((height, width, planes), np.float32)
    strips = (height + _STRIP_ROWS - 1) // _STRIP_ROWS
    for strip in numba.prange(strips):
        top, bottom = strip * _STRIP_ROWS, min((strip + 1) * _STRIP_ROWS, height)
        ring = np.empty((count, 2 * HALF_WINDOW + 1, width), np.float32)
        for d in range(planes):
            _plane_of_strip(reference, views, homographies[d], best, top, bottom, ring, cost[:, :, d])
    return cost


@numba.njit(cache=True, fastmath={"nnan", "nsz"})
def _walk(cost: F32, before: F32, after: F32) -> None:
    """One step of a path: the cheapest way to each plane of this pixel from the pixel before, [D].

    `before` and `after` carry one cell of padding at each end, so that every plane has two neighbours.
    """
    planes = cost.shape[0]
    least = _FAR
    for d in range(1, planes + 1):
        least = min(least, before[d])
    for d in range(planes):
        neighbour = min(before[d], before[d + 2]) + np.float32(SMALL_JUMP)
        way = min(min(before[d + 1], neighbour), least + np.float32(LARGE_JUMP))
        after[d + 1] = cost[d] + (way - least)
    after[0] = _FAR
    after[planes + 1] = _FAR


@numba.njit(cache=True)
def _start(cost: F32, after: F32) -> None:
    planes = cost.shape[0]
    after[0] = _FAR
    after[planes + 1] = _FAR
    after[1 : planes + 1] = cost


@numba.njit(cache=True, parallel=True)
def sum_along_rows(cost: F32) -> F32:
    """Sum the path costs from the left and from the right, [H, W, D]."""
    height, width, planes = cost.shape
    total = np.empty_like(cost)
    for r in numba.prange(height):
        paths = np.empty((2, planes + 2), np.float32)
        for i in range(width):
            if i == 0:
                _start(cost[r, 0], paths[0])
            else:
                _walk(cost[r, i], paths[(i - 1) % 2], paths[i % 2])
            total[r, i] = paths[i % 2, 1 : planes + 1]
        for i in range(width):
            c = width - 1 - i
            if i == 0:
                _start(cost[r, c], paths[0])
            else:
                _walk(cost[r, c], paths[(i - 1) % 2], paths[i % 2])
            total[r, c] += paths[i % 2, 1 : planes + 1]
    return total


@numba.njit(cache=True)
def _lowest(total: F32) -> float:
    """Find the plane of least cost, to a fraction of a step by a parabola through its neighbours."""
    planes = total.shape[0]
    k = 0
    for d in range(1, planes):
        if total[d] < total[k]:
            k = d
    k = min(max(k, 1), planes - 2)
    before, here, after = total[k - 1], total[k], total[k + 1]
    bend = before - 2 * here + after
    if bend <= 0:
        # The least cost lies at the end of the range, and the three costs are no valley.
        return k + (-0.5 if before < after else 0.5 if after < before else 0.0)
    return k + min(max((before - after) / (2 * bend), np.float32(-0.5)), np.float32(0.5))


@numba.njit(cache=True, parallel=True)
def best_plane(cost: F32, along_rows: F32) -> F32:
    """Add the path costs from above and from below and find the best plane of each pixel.

    Args:
        cost: [H, W, D], D >= 3.
        along_rows: Path costs of the other two directions, [H, W, D]; used up.

    Returns:
        Plane index with its fraction, [H, W].
    """
    height, width, planes = cost.shape
    index = np.empty((height, width), np.float32)
    strips = (width + _STRIP_COLUMNS - 1) // _STRIP_COLUMNS
    for strip in numba.prange(strips):
        left, right = strip * _STRIP_COLUMNS, min((strip + 1) * _STRIP_COLUMNS, width)
        paths = np.empty((2, right - left, planes + 2), np.float32)
        for r in range(height):
            for c in range(left, right):
                after = paths[r % 2, c - left]
                if r == 0:
                    _start(cost[r, c], after)
                else:
                    _walk(cost[r, c], paths[(r - 1) % 2, c - left], after)
                along_rows[r, c] += after[1 : planes + 1]
        for i in range(height):
            r = height - 1 - i
            for c in range(left, right):
                after = paths[i % 2, c - left]
                if i == 0:
                    _start(cost[r, c], after)
                else:
                    _walk(cost[r, c], paths[(i - 1) % 2, c - left], after)
                along_rows[r, c] += after[1 : planes + 1]
                index[r, c] = _lowest(along_rows[r, c])
    return index
