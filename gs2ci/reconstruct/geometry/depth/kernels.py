"""Numba kernels of the plane sweep: matching cost, of planes and of a map, and semi-global smoothing.

Every task writes its own rows or columns and nothing is summed across tasks, so the result is bitwise the same for
any number of threads. The readable statement of the same steps, in numpy float64, is in the tests
(`tests/reconstruct/geometry/depth/test_sweep.py`), which hold these kernels to it.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32, F64, I32, Size
from gs2ci.core.kernels import EXACT, f32_1, f32_3, f64_4, helper, i64, i64_1, in_parts, kernel
from gs2ci.reconstruct.geometry.depth.eight import FEATURES, differ

# Sum of absolute differences at which two pixels count as different, and the cost of a pixel that a view cannot see.
TRUNCATED_AT = 0.6
UNSEEN_COST = TRUNCATED_AT / 2
# Semi-global penalties, in the unit of the cost: for one step in inverse depth, and for any jump. Smoother maps (9x9
# windows, penalties of 0.02 and 0.3, a median filter) have a smaller median error, 5.2 against 6.0 % on fourteen
# scenes, but lose thin things that the fit does not find again: it ended at 30.3 against 31.2 dB on a rendered fern
# and at 33.4 against 33.9 dB on a motorcycle.
SMALL_JUMP = 0.01
LARGE_JUMP = 8 * SMALL_JUMP

# Rows of a strip of which costs are computed, and columns that are smoothed, at once.
_STRIP = 32
# Planes whose costs of a pixel fill a line of the cache.
_TOGETHER = 16
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
LEAST_DEPTH = np.float32(1e-3)
_FAR = np.float32(1e9)


@helper(fastmath=frozenset({"contract", "nsz"}))
def _aim_pixel(u: np.float32, v: np.float32, z: np.float32, size: Size, c: int, corner: I32, aim: F32) -> None:
    """Find the four pixels around (u, v) / z in a view of this height and width, and their weights; see `_aim_row`."""
    right, down = np.float32(size[1] - 1), np.float32(size[0] - 1)
    inverse_z = _ONE / max(z, LEAST_DEPTH)
    u, v = u * inverse_z, v * inverse_z
    lost = (u < 0) | (u > right) | (v < 0) | (v > down) | (z < LEAST_DEPTH)
    u, v = min(max(u, _ZERO), right), min(max(v, _ZERO), down)
    col, row = min(np.int32(u), np.int32(size[1] - 2)), min(np.int32(v), np.int32(size[0] - 2))
    corner[c] = row * np.int32(size[1]) + col
    across, down_by = u - np.float32(col), v - np.float32(row)
    corners = across * down_by
    aim[0, c], aim[1, c] = _ONE - across - (down_by - corners), across - corners
    aim[2, c], aim[3, c] = down_by - corners, corners
    aim[4, c] = _ONE if lost else _ZERO


@helper(fastmath=frozenset({"contract", "nsz"}))
def _aim_row(homography: F64, r: int, size: Size, corner: I32, aim: F32) -> None:
    """Find where a plane sends row r of the reference view in another view.

    Args:
        homography: From the array coordinates of the one to those of the other, [3, 3].
        r: The row.
        size: Height and width.
        corner: Receives the flat index of the pixel up and left of each target, [W].
        aim: Receives the weights of that pixel, of the one to the right, of the two below them, and 1 where the view
            cannot see the target, else 0, [5, W].
    """
    u0, du = np.float32(homography[0, 1] * r + homography[0, 2]), np.float32(homography[0, 0])
    v0, dv = np.float32(homography[1, 1] * r + homography[1, 2]), np.float32(homography[1, 0])
    z0, dz = np.float32(homography[2, 1] * r + homography[2, 2]), np.float32(homography[2, 0])
    for c in range(size[1]):
        at = np.float32(c)
        _aim_pixel(u0 + du * at, v0 + dv * at, z0 + dz * at, size, c, corner, aim)


@helper(fastmath=frozenset({"contract", "nsz"}))
def _difference_row(reference: F32, view: F32, corner: I32, aim: F32, out: F32) -> None:
    """Compare a row of reference features, [W, 8], with features [H * W, 8] at interpolated places; [W] costs."""
    width = reference.shape[0]
    unseen = aim[4]
    for c in range(width):
        out[c] = differ(reference, view, aim, c, corner[c], width)
    for c in range(width):
        out[c] = np.float32(UNSEEN_COST) if unseen[c] > 0 else min(out[c], np.float32(TRUNCATED_AT))


@helper(fastmath=EXACT)
def _add(values: F32, out: F32) -> None:
    for c in range(out.shape[0]):
        out[c] += values[c]


@helper(fastmath=EXACT)
def _box_row(values: F32, reach: int, out: F32) -> None:
    """Sum over `reach` neighbours to each side in a row, the window cut off at the ends."""
    width = values.shape[0]
    for c in range(width):
        out[c] = values[c]
    for shift in range(1, min(reach, width - 1) + 1):
        _add(values[shift:], out[: width - shift])
        _add(values[: width - shift], out[shift:])


@helper(fastmath=EXACT)
def _order(low: F32, high: F32) -> None:
    """Put the smaller of each pair into `low` and the larger into `high`."""
    for c in range(low.shape[0]):
        a, b = low[c], high[c]
        low[c], high[c] = min(a, b), max(a, b)


@helper(fastmath=EXACT)
def _sum_smallest(costs: F32, count: int, out: F32) -> None:
    """Sum the `count` smallest of V costs per pixel; costs [V, W] are reordered."""
    out[:] = 0
    for j in range(count):
        # One bubble pass brings the smallest of the rest to row j.
        for i in range(costs.shape[0] - 1, j, -1):
            _order(costs[i - 1], costs[i])
        _add(costs[j], out)


@helper(fastmath=EXACT)
def _cost_of_row(ring: F32, centre: int, height: int, best: int, per_view: F32, total: F32, out: F32) -> None:
    """Average a window's rows of each view, ring [V, window, W], over the best views, to a row of the cost, out [W].

    per_view, [V, W], and total, [W], are scratch.
    """
    count, window, width = ring.shape
    reach = window // 2
    low, high = max(centre - reach, 0), min(centre + reach, height - 1)
    per_view[:] = 0
    for i in range(count):
        for q in range(low, high + 1):
            _add(ring[i, q % window], per_view[i])
    _sum_smallest(per_view, best, total)
    for c in range(width):
        across = min(c, reach) + min(width - 1 - c, reach) + 1
        out[c] = total[c] / np.float32(across * (high - low + 1) * best)


@helper(fastmath=EXACT)
def _cost_of_strip(reference, views, order, homographies, best, top, bottom, rings, out):
    """Fill out[top:bottom, :, D] (any strides) with the cost of D planes, [D, V, 3, 3].

    Row by row for all of them, since their costs of a pixel are neighbours in memory. rings, [D, V, window, W], is
    scratch.
    """
    height, width = reference.shape[:2]
    count, window = rings.shape[1:3]
    reach = window // 2
    corner, aim = np.empty(width, np.int32), np.empty((5, width), np.float32)
    row_costs, total = np.empty(width, np.float32), np.empty(width, np.float32)
    per_view = np.empty((count, width), np.float32)
    for r in range(max(top - reach, 0), bottom + reach):
        for d in range(len(homographies)):
            if r < min(bottom + reach, height):
                for i in range(count):
                    _aim_row(homographies[d, i], r, (height, width), corner, aim)
                    _difference_row(reference[r], views[order[i]], corner, aim, row_costs)
                    _box_row(row_costs, reach, rings[d, i, r % window])
            if r - reach >= top:
                _cost_of_row(rings[d], r - reach, height, best, per_view, total, out[r - reach, :, d])


@kernel(i64, i64, f32_3, f32_3, i64_1, f64_4, i64, i64, f32_3, fastmath=EXACT)
def _cost(from_strip, to_strip, reference, views, order, homographies, best, window, cost):
    """Fill strips of rows of the cost, [H, W, D], of D planes."""
    height, width = reference.shape[:2]
    planes, count = homographies.shape[:2]
    rings = np.empty((_TOGETHER, count, window, width), np.float32)
    for strip in range(from_strip, to_strip):
        top, bottom = strip * _STRIP, min((strip + 1) * _STRIP, height)
        for d in range(0, planes, _TOGETHER):
            some, out = homographies[d : d + _TOGETHER], cost[:, :, d : d + _TOGETHER]
            _cost_of_strip(reference, views, order, some, best, top, bottom, rings, out)


def matching_cost(views: F32, order: Sequence[int], homographies: F64, best: int, window: int) -> F32:
    """Compare every pixel of a reference view with others, on every plane.

    Args:
        views: Features of views, [N, H, W, 8]; H, W >= 2.
        order: Which of them is the reference view, and which V are compared with it.
        homographies: From array coordinates of the reference view to those of each of these, for each plane,
            [D, V, 3, 3].
        best: So many views with the smallest cost count; the others may be occluded.
        window: Side of the window, odd, px.

    Returns:
        Mean truncated absolute difference in the window, [H, W, D].
    """
    height, width = views.shape[1:3]
    cost = np.empty((height, width, len(homographies)), np.float32)
    flat, others = views.reshape(len(views), height * width, FEATURES), np.array(order[1:], np.int64)
    in_parts(_cost, -(-height // _STRIP), views[order[0]], flat, others, homographies, best, window, cost)
    return cost


@helper(fastmath=frozenset({"nnan", "nsz"}))
def _walk(cost: F32, before: F32, after: F32, total: F32) -> None:
    """One step of a path: add the cheapest way to each plane of this pixel from the pixel before to the total, [D].

    `before` and `after` carry one cell of padding at each end, so that every plane has two neighbours.
    """
    planes = cost.shape[0]
    least = _FAR
    for d in range(1, planes + 1):
        least = min(least, before[d])
    for d in range(planes):
        neighbour = min(before[d], before[d + 2]) + np.float32(SMALL_JUMP)
        way = min(before[d + 1], neighbour, least + np.float32(LARGE_JUMP))
        after[d + 1] = cost[d] + (way - least)
    after[0] = _FAR
    after[planes + 1] = _FAR
    # A loop, as `total += after[...]` is one that the compiler makes no vectors of.
    for d in range(planes):
        total[d] += after[d + 1]


def smoothed(cost: F32) -> F32:
    """Sum the path costs from the left, from the right, from above and from below, [H, W, D]."""
    height, width, planes = cost.shape
    total = np.zeros_like(cost)
    for lines, length, apart, step, together in (
        (height, width, width * planes, planes, 1),
        (width, height, planes, width * planes, _STRIP),
    ):
        tasks = -(-lines // together)
        in_parts(_walk_lines, tasks, cost.ravel(), lines, length, planes, apart, step, together, total.ravel())
    return total


@kernel(i64, i64, f32_1, i64, i64, i64, i64, i64, i64, f32_1, fastmath=EXACT)
def _walk_lines(from_task, to_task, cost, lines, length, planes, apart, step, together, total):
    """Add the path costs of both directions of lines; `apart` numbers lie between two lines, `step` between pixels."""
    for task in range(from_task, to_task):
        first, end = task * together, min((task + 1) * together, lines)
        for backwards in range(2):
            # A path begins as from a pixel that cost nothing.
            paths = np.zeros((together, 2, planes + 2), np.float32)
            for i in range(length):
                place = (length - 1 - i if backwards else i) * step
                # Columns go side by side, since their pixels are neighbours in memory.
                for line in range(first, end):
                    at, path = line * apart + place, paths[line - first]
                    _walk(cost[at : at + planes], path[i % 2], path[(i + 1) % 2], total[at : at + planes])


def best_plane(total: Tensor) -> Tensor:
    """Find the first plane of least cost of each pixel, to a fraction of a step by a parabola through its neighbours.

    Args:
        total: Path costs, [H, W, D], D >= 3, on any device.

    Returns:
        Plane index with its fraction, [H, W] float32.
    """
    place = total.argmin(dim=2, keepdim=True).clamp(1, total.shape[2] - 2)
    before, here, after = (total.gather(2, place + k)[..., 0] for k in (-1, 0, 1))
    # At the end of the range, or on a flat bottom, the three costs are no valley: then the half step is the limit.
    bend = (before - 2 * here.double() + after).clamp(min=torch.finfo(torch.float32).tiny)
    return (place[..., 0] + ((before - after) / (2 * bend)).clamp(-0.5, 0.5)).float()
