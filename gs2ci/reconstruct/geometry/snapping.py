"""Jumps of a depth map moved to the edges of its view: a median weighted by likeness of colour.

A sweep compares windows, and a fit paints the colours of an edge on both of its sides: what stands before a plain wall
comes out some pixels too wide. Here: the filter. Not here: the sweep (`sweep`). OpenCV's filter of this kind clusters
colours at random, so that no two of its results are alike.
"""

import numba
import numpy as np

from gs2ci.core.arrays import F32

# How far an edge may be off: by somewhat less than half of this, as the majority of a window decides.
_REACH_PX = 10
# The standard deviation of colours that are alike, in full scales.
_SIGMA = 0.04
_LEVELS = 256
# What the median moves by no more levels than these keeps its own value.
_KEPT_LEVELS = 2


def snapped(inverse_depth: F32, view: F32) -> F32:
    """Return a map, [H, W], with its jumps at the edges of its view, [H, W, C] in full scales."""
    low, high = float(inverse_depth.min()), float(inverse_depth.max())
    if not low < high:
        return inverse_depth
    levels = np.rint((inverse_depth - low) / (high - low) * (_LEVELS - 1)).astype(np.int64)
    found = np.empty(inverse_depth.shape, np.float32)
    _snap(inverse_depth, levels, np.ascontiguousarray(view, np.float32), found)
    return found


@numba.njit(cache=True, parallel=True)
def _snap(inverse_depth, levels, view, found):  # type: ignore[no-untyped-def]
    """Fill `found`, row by row: each pixel's histogram of its neighbours' levels, weighted, and its median."""
    height, width, channels = view.shape
    scale = 1 / (2 * _SIGMA**2)
    for r in numba.prange(height):
        histogram, sums = np.empty(_LEVELS), np.empty(_LEVELS)
        for c in range(width):
            histogram[:] = 0.0
            sums[:] = 0.0
            total = 0.0
            for i in range(max(r - _REACH_PX, 0), min(r + _REACH_PX + 1, height)):
                for j in range(max(c - _REACH_PX, 0), min(c + _REACH_PX + 1, width)):
                    square = 0.0
                    for k in range(channels):
                        square += (view[i, j, k] - view[r, c, k]) ** 2
                    weight = np.exp(-scale * square)
                    histogram[levels[i, j]] += weight
                    sums[levels[i, j]] += weight * inverse_depth[i, j]
                    total += weight
            reached, median = histogram[0], 0
            while reached < 0.5 * total and median < _LEVELS - 1:
                median += 1
                reached += histogram[median]
            if abs(median - levels[r, c]) <= _KEPT_LEVELS or histogram[median] == 0.0:
                found[r, c] = inverse_depth[r, c]
            else:
                found[r, c] = sums[median] / histogram[median]
