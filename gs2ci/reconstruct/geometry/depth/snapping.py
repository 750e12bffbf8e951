"""Jumps of a depth map moved to the edges of its view: a median weighted by similarity of colour.

A sweep compares windows, and a fit shows the colours of an edge on both of its sides: things in front of a plain wall
get some pixels too wide. Here: the filter. Not here: the sweep (`sweep`). OpenCV's filter of this kind clusters colours
at random, so that its results are not reproducible.
"""

import math
from typing import Final

import numpy as np
import torch
from scipy.ndimage import maximum_filter, minimum_filter

from gs2ci.core.arrays import F32, I32, Bool
from gs2ci.core.kernels import EXACT, b1_2, f32_2, f32_3, i32_2, i64, in_parts, kernel
from gs2ci.reconstruct.geometry.depth.device_sweep import AT_ONCE
from gs2ci.render.places import working_device

# Radius of the window. An edge is corrected over somewhat less than half of it, since the majority of a window decides.
_REACH_PX: Final = 10
# -1/(2 s^2), s: the standard deviation of similar colours, 0.04 full scales.
_LOG_PER_SQUARE: Final = -1 / (2 * 0.04**2)
# Colours whose weight would be below e^-16, 1e-7, have none.
_LEAST_LOG: Final = -16.0
_LEVELS: Final = 256
# A pixel that the median would move by at most so many levels keeps its value.
_KEPT_LEVELS: Final = 2


def snapped(inverse_depth: F32, view: F32) -> F32:
    """Return a map, [H, W], with its jumps at the edges of its view, [H, W, C] in full scales."""
    low, high = float(inverse_depth.min()), float(inverse_depth.max())
    if not low < high:
        return inverse_depth
    levels = np.rint((inverse_depth - low) / (high - low) * (_LEVELS - 1)).astype(np.int32)
    # Around most pixels all levels are such as they may keep.
    side = 2 * _REACH_PX + 1
    jumps = maximum_filter(levels, side) - minimum_filter(levels, side) > _KEPT_LEVELS
    depths = np.ascontiguousarray(inverse_depth, np.float32)
    found = depths.copy()
    device = working_device()
    if device is not None:
        _snap_on_device(depths, levels, jumps, view, found, device)
        return found
    in_parts(_snap, len(depths), depths, levels, jumps, np.ascontiguousarray(view, np.float32), found)
    return found


def _snap_on_device(inverse_depth: F32, levels: I32, jumps: Bool, view: F32, found: F32, device: torch.device) -> None:
    """Do as `_snap`, in torch on a device: a window in each row, its levels in order. Never run on a GPU so far.

    Arguments as there, and the device.
    """
    reach, side = _REACH_PX, 2 * _REACH_PX + 1
    depths, level, colours = (
        torch.nn.functional.pad(torch.from_numpy(one).to(device), (0, 0, reach, reach, reach, reach))
        for one in (inverse_depth[..., None], levels[..., None], np.ascontiguousarray(view, np.float32))
    )
    inside = torch.nn.functional.pad(torch.ones(levels.shape, device=device), (reach, reach, reach, reach)) > 0
    rows, columns = (torch.from_numpy(one).to(device) for one in np.nonzero(jumps))
    window = torch.arange(side, device=device)
    some = max(1, AT_ONCE // (side * side))
    for row, column in zip(torch.split(rows, some), torch.split(columns, some), strict=True):
        at = row[:, None, None] + window[:, None], column[:, None, None] + window
        squares = (colours[at] - colours[row + reach, column + reach][:, None, None]).square().sum(-1).double()
        log = (_LOG_PER_SQUARE * squares).flatten(1)
        weights = torch.where((log > _LEAST_LOG) & inside[at].flatten(1), log.exp(), 0.0)
        around, own = level[at].flatten(1), level[row + reach, column + reach]
        order = around.argsort(dim=1, stable=True)
        reached = weights.gather(1, order).cumsum(dim=1)
        # The first level with which half of all weight is reached.
        place = (reached < 0.5 * reached[:, -1:]).sum(dim=1, keepdim=True).clamp(max=side * side - 1)
        median = around.gather(1, order.gather(1, place))
        same = torch.where(around == median, weights, 0.0)
        sums = (same * depths[at].flatten(1)).sum(dim=1) / same.sum(dim=1)
        moves = ((median - own).abs() > _KEPT_LEVELS)[:, 0] & (same.sum(dim=1) > 0)
        chosen = torch.where(moves, sums, depths[row + reach, column + reach][:, 0].double())
        found[row.cpu().numpy(), column.cpu().numpy()] = chosen.float().cpu().numpy()


@kernel(i64, i64, f32_2, i32_2, b1_2, f32_3, f32_2, fastmath=EXACT)
def _snap(from_task: int, to_task: int, inverse_depth: F32, levels: I32, jumps: Bool, view: F32, found: F32) -> None:
    """Write the mean of what shares the weighted median of the levels around each pixel, where that is another level.

    Args:
        from_task: The first row.
        to_task: The end of them.
        inverse_depth: [H, W].
        levels: Of it, [H, W].
        jumps: Pixels around which levels differ, [H, W].
        view: [H, W, C].
        found: Changed, [H, W].
    """
    height, width = levels.shape
    weights, sums = np.zeros(_LEVELS), np.zeros(_LEVELS)
    for r in range(from_task, to_task):
        for c in range(width):
            if not jumps[r, c]:
                continue
            weights[:], sums[:], total = 0.0, 0.0, 0.0
            for i in range(max(r - _REACH_PX, 0), min(r + _REACH_PX + 1, height)):
                for j in range(max(c - _REACH_PX, 0), min(c + _REACH_PX + 1, width)):
                    squares = 0.0
                    for k in range(view.shape[2]):
                        difference = view[i, j, k] - view[r, c, k]
                        squares += difference * difference
                    log = _LOG_PER_SQUARE * squares
                    if log > _LEAST_LOG:
                        weight = math.exp(log)
                        weights[levels[i, j]] += weight
                        sums[levels[i, j]] += weight * inverse_depth[i, j]
                        total += weight
            reached, median = weights[0], 0
            while reached < 0.5 * total and median < _LEVELS - 1:
                median += 1
                reached += weights[median]
            if weights[median] > 0 and abs(median - levels[r, c]) > _KEPT_LEVELS:
                found[r, c] = sums[median] / weights[median]
