"""Jumps of a depth map moved to the edges of its view: a median weighted by similarity of colour.

A sweep compares windows, and a fit shows the colours of an edge on both of its sides: things in front of a plain wall
get some pixels too wide. Here: the filter. Not here: the sweep (`sweep`). OpenCV's filter of this kind clusters colours
at random, so that its results are not reproducible.
"""

import cv2
import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import EXACT, b1_2, f32_1, f32_2, helper, i64, in_parts, kernel
from gs2ci.render.simd.elementary import exp2_blend
from gs2ci.render.simd.vector import LANES, broadcast, get, load, maximum, store, where_ge

# Radius of the window. An edge is corrected over somewhat less than half of it, since the majority of a window decides.
_REACH_PX = 10
_SIDE = 2 * _REACH_PX + 1
# The standard deviation of similar colours, in full scales.
_SIGMA = 0.04
_LEVELS = 256
# Least exponent of 2^x: weights below are zero, and `exp2_blend` is valid above.
_LEAST_LOG2 = np.float32(-120.0)
_LOG2_PER_SQUARE = np.float32(-1 / (2 * _SIGMA**2) / np.log(2))
# A pixel that the median would move by at most so many levels keeps its value.
_KEPT_LEVELS = 2
# A colour unlike any other, in full scales, around a picture, so that pixels outside get no weight.
_NO_COLOUR = np.float32(1e3)
_ZERO = np.float32(0)


def snapped(inverse_depth: F32, view: F32) -> F32:
    """Return a map, [H, W], with its jumps at the edges of its view, [H, W, C] in full scales.

    Weights are computed in float32, to 1e-5 of themselves.
    """
    low, high = float(inverse_depth.min()), float(inverse_depth.max())
    if not low < high:
        return inverse_depth
    levels = np.rint((inverse_depth - low) / (high - low) * (_LEVELS - 1)).astype(np.uint8)
    # Pixels outside the picture affect neither bound.
    window = np.ones((_SIDE, _SIDE), np.uint8)
    still = cv2.dilate(levels, window) - cv2.erode(levels, window) <= _KEPT_LEVELS
    planes = np.stack([_framed(view[..., k], _NO_COLOUR) for k in range(view.shape[2])])
    found = np.array(inverse_depth, np.float32)
    depths = np.ascontiguousarray(inverse_depth, np.float32)
    framed = _framed(levels, _ZERO).reshape(-1)
    in_parts(_snap, len(found), depths, framed, planes.reshape(-1), view.shape[2], still, found)
    return found


def _framed(values: F32, around: np.float32) -> F32:
    """Return an image, [H, W], with a frame at its left and right, so wide that no vector of a window leaves it."""
    beside = ((0, 0), (_REACH_PX, _REACH_PX + 2 * LANES))
    return np.pad(values.astype(np.float32), beside, constant_values=around)


@helper()
def _weights(planes, channels, apart, here, there):  # type: ignore[no-untyped-def]
    """Return the similarity of the colours of 16 pixels from `here` and 16 from `there`, offsets in a plane.

    Planes are so many values `apart`.
    """
    squares = broadcast(_ZERO)
    for k in range(channels):
        difference = load(planes, k * apart + here) - load(planes, k * apart + there)
        squares = squares + difference * difference
    return exp2_blend(maximum(squares * _LOG2_PER_SQUARE, _LEAST_LOG2))


@kernel(i64, i64, f32_2, f32_1, f32_1, i64, b1_2, f32_2)
def _snap(from_task, to_task, inverse_depth, levels, planes, channels, still, found):  # type: ignore[no-untyped-def]
    """Move pixels of `found` to the weighted median of the levels around them.

    Whether the median is a level that the pixel may keep is found for 16 pixels of a row at once; only where it is
    not, which is at jumps, is there a histogram.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        inverse_depth: [H, W] float32.
        levels: Of it, framed and flattened, float32.
        planes: Colours, C planes, likewise.
        channels: C.
        still: Pixels around which all levels are those that they may keep, [H, W] bool.
        found: Changed, [H, W] float32.
    """
    height, width = inverse_depth.shape
    stride = levels.shape[0] // height
    for r in range(from_task, to_task):
        sums, histogram = np.empty(3 * LANES, np.float32), np.empty(_LEVELS)
        weights = np.empty(_SIDE * 2 * LANES, np.float32)
        top, bottom = max(r - _REACH_PX, 0), min(r + _REACH_PX + 1, height)
        for left in range(0, width, LANES):
            right = min(left + LANES, width)
            if still[r, left:right].all():
                continue
            here = r * stride + _REACH_PX + left
            own = load(levels, here)
            lowest, highest = own - np.float32(_KEPT_LEVELS), own + np.float32(_KEPT_LEVELS)
            zero = broadcast(_ZERO)
            below, kept, total = zero, zero, zero
            for i in range(top, bottom):
                for there in range(i * stride + left, i * stride + left + _SIDE):
                    weight, level = _weights(planes, channels, levels.shape[0], here, there), load(levels, there)
                    below = below + where_ge(level, lowest, zero, weight)
                    kept = kept + where_ge(level, lowest, where_ge(highest, level, weight, zero), zero)
                    total = total + weight
            store(sums, 0, below)
            store(sums, LANES, kept)
            store(sums, 2 * LANES, total)
            for c in range(left, right):
                lower, same = sums[c - left], sums[LANES + c - left]
                half = np.float32(0.5) * sums[2 * LANES + c - left]
                if lower >= half or lower + same < half:
                    found[r, c] = _median(
                        inverse_depth, levels, planes, channels, r, c, top, bottom, weights, histogram
                    )


@helper(fastmath=EXACT)
def _median(inverse_depth, levels, planes, channels, r, c, top, bottom, weights, histogram):  # type: ignore[no-untyped-def]
    """Return the weighted mean of what shares the median's level in the window of a pixel; `weights` is scratch."""
    height, width = inverse_depth.shape
    stride = levels.shape[0] // height
    left, right = max(c - _REACH_PX, 0), min(c + _REACH_PX + 1, width)
    here = r * stride + _REACH_PX + c
    histogram[:] = 0.0
    total = 0.0
    for i in range(top, bottom):
        first, row = (i - top) * 2 * LANES, i * stride + _REACH_PX + left
        _weigh_row(planes, channels, levels.shape[0], here, row, weights, first)
        for j in range(right - left):
            weight = get(weights, first + j)
            histogram[int(get(levels, row + j))] += weight
            total += weight
    reached, median = histogram[0], 0
    while reached < 0.5 * total and median < _LEVELS - 1:
        median += 1
        reached += histogram[median]
    if histogram[median] == 0.0:
        return inverse_depth[r, c]
    inside = 0.0
    for i in range(top, bottom):
        for j in range(right - left):
            if int(get(levels, i * stride + _REACH_PX + left + j)) == median:
                inside += get(weights, (i - top) * 2 * LANES + j) * inverse_depth[i, left + j]
    return np.float32(inside / histogram[median])


@helper()
def _weigh_row(planes, channels, apart, here, there, weights, first):  # type: ignore[no-untyped-def]
    """Write the similarity of a pixel's colour to those of 32 pixels of a row from `there`, to weights[first:]."""
    for half in range(0, 2 * LANES, LANES):
        squares = broadcast(_ZERO)
        for k in range(channels):
            difference = load(planes, k * apart + there + half) - get(planes, k * apart + here)
            squares = squares + difference * difference
        store(weights, first + half, exp2_blend(maximum(squares * _LOG2_PER_SQUARE, _LEAST_LOG2)))
