"""Jumps of a depth map moved to the edges of its view: a median weighted by likeness of colour.

A sweep compares windows, and a fit paints the colours of an edge on both of its sides: what stands before a plain wall
comes out some pixels too wide. Here: the filter. Not here: the sweep (`sweep`). OpenCV's filter of this kind clusters
colours at random, so that no two of its results are alike.
"""

import cv2
import numba
import numpy as np

from gs2ci.core.arrays import F32

# How far an edge may be off: by somewhat less than half of this, as the majority of a window decides.
_REACH_PX = 10
_SIDE = 2 * _REACH_PX + 1
# The standard deviation of colours that are alike, in full scales.
_SIGMA = 0.04
_LEVELS = 256
_BLOCK = 128
# Of 2^x: beyond this no weight differs from zero, and shifted exponents stay in range.
_LEAST_LOG2 = np.float32(-120.0)
_MANTISSA_BITS = np.int32(23)
_EXPONENT_BIAS = np.int32(127)
# What the median moves by no more levels than these keeps its own value.
_KEPT_LEVELS = 2


def snapped(inverse_depth: F32, view: F32) -> F32:
    """Return a map, [H, W], with its jumps at the edges of its view, [H, W, C] in full scales.

    Weights are computed in float32, to 1e-5 of themselves.
    """
    low, high = float(inverse_depth.min()), float(inverse_depth.max())
    if not low < high:
        return inverse_depth
    levels = np.rint((inverse_depth - low) / (high - low) * (_LEVELS - 1)).astype(np.uint8)
    # What lies outside of the picture counts for neither bound.
    window = np.ones((_SIDE, _SIDE), np.uint8)
    still = cv2.dilate(levels, window) - cv2.erode(levels, window) <= _KEPT_LEVELS
    planes = np.ascontiguousarray(view.transpose(2, 0, 1), np.float32)
    found = np.array(inverse_depth, np.float32)
    _snap(np.ascontiguousarray(inverse_depth, np.float32), levels.astype(np.float32), planes, still, found)
    return found


@numba.njit(cache=True, fastmath={"contract", "nsz", "nnan"})
def _weigh(one, other, log2, exponent, out):  # type: ignore[no-untyped-def]
    """Write how alike colours are, K values of C channels each, to `out`, [K]; `log2` and `exponent` are scratch.

    `one` and `other` are planes, [C, H, W], row and first column.

    2^x is 2^n, put together from its bits, times a polynomial of degree 6 in the rest (Taylor's, 2e-7 of the value).
    """
    (planes, r, c), (others, i, d), count = one, other, out.shape[0]
    scale = np.float32(-1 / (2 * _SIGMA**2) / np.log(2))
    log2[:count] = np.float32(0)
    for k in range(planes.shape[0]):
        # Only slices of the last axis are known to be dense.
        here, there = planes[k, r, c : c + count], others[k, i, d : d + count]
        for j in range(count):
            difference = here[j] - there[j]
            log2[j] += difference * difference
    for j in range(count):
        x = max(scale * log2[j], _LEAST_LOG2)
        # No x is positive: so truncation rounds up what is half less, and the rest lies within half of zero.
        n = np.int32(x - np.float32(0.5))
        t = (x - np.float32(n)) * np.float32(0.6931472)
        p = np.float32(1 / 120) + t * np.float32(1 / 720)
        p = np.float32(1 / 24) + t * p
        p = np.float32(1 / 6) + t * p
        p = np.float32(0.5) + t * p
        p = np.float32(1) + t * p
        out[j] = np.float32(1) + t * p
        exponent[j] = (n + _EXPONENT_BIAS) << _MANTISSA_BITS
    powers = exponent.view(np.float32)
    for j in range(count):
        out[j] *= powers[j]


@numba.njit(cache=True, fastmath={"contract", "nsz", "nnan"})
def _add_up(levels, own, weights, below, kept, total):  # type: ignore[no-untyped-def]
    """Add weights, [K], to the sums of levels below those that a pixel may keep, of these, and of all."""
    for j in range(weights.shape[0]):
        lower = levels[j] < own[j] - np.float32(_KEPT_LEVELS)
        higher = levels[j] > own[j] + np.float32(_KEPT_LEVELS)
        below[j] += weights[j] if lower else np.float32(0)
        kept[j] += np.float32(0) if lower or higher else weights[j]
        total[j] += weights[j]


@numba.njit(cache=True, parallel=True)
def _snap(inverse_depth, levels, planes, still, found):  # type: ignore[no-untyped-def]
    """Move pixels of `found` to the weighted median of the levels around them.

    Whether the median is a level that the pixel may keep is found for a block of a row at once; only where it is not,
    which is at jumps, is there a histogram.

    Args:
        inverse_depth: [H, W] float32.
        levels: Of it, [H, W] float32.
        planes: Colours, [C, H, W] float32.
        still: Pixels around which all levels are those that they may keep, [H, W] bool.
        found: Changed, [H, W] float32.
    """
    _, height, width = planes.shape
    blocks = (width + _BLOCK - 1) // _BLOCK
    for r in numba.prange(height):
        log2, exponent = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.int32)
        weights, histogram = np.empty(max(_BLOCK, _SIDE**2), np.float32), np.empty(_LEVELS)
        sums = np.empty((3, _BLOCK), np.float32)
        top, bottom = max(r - _REACH_PX, 0), min(r + _REACH_PX + 1, height)
        for block in range(blocks):
            left, right = block * _BLOCK, min((block + 1) * _BLOCK, width)
            if still[r, left:right].all():
                continue
            sums[:] = np.float32(0)
            for i in range(top, bottom):
                for shift in range(-_REACH_PX, _REACH_PX + 1):
                    begin, end = max(left, -shift), min(right, width - shift)
                    if begin >= end:
                        continue
                    some, at, to = weights[: end - begin], begin - left, end - left
                    _weigh((planes, r, begin), (planes, i, begin + shift), log2, exponent, some)
                    _add_up(
                        levels[i, begin + shift : end + shift],
                        levels[r, begin:end],
                        some,
                        sums[0, at:to],
                        sums[1, at:to],
                        sums[2, at:to],
                    )
            for c in range(left, right):
                below, kept, total = sums[0, c - left], sums[1, c - left], sums[2, c - left]
                if below >= np.float32(0.5) * total or below + kept < np.float32(0.5) * total:
                    found[r, c] = _median(
                        inverse_depth, levels, planes, r, c, top, bottom, log2, exponent, weights, histogram
                    )


@numba.njit(cache=True)
def _median(inverse_depth, levels, planes, r, c, top, bottom, log2, exponent, weights, histogram):  # type: ignore[no-untyped-def]
    """Return the weighted mean of what shares the median's level in the window of a pixel; `weights` is scratch."""
    left, right = max(c - _REACH_PX, 0), min(c + _REACH_PX + 1, planes.shape[2])
    side = right - left
    here = np.empty((planes.shape[0], 1, side), np.float32)
    for k in range(planes.shape[0]):
        here[k] = planes[k, r, c]
    histogram[:] = 0.0
    total = 0.0
    for i in range(top, bottom):
        some, level = weights[(i - top) * side : (i - top + 1) * side], levels[i, left:right]
        _weigh((here, 0, 0), (planes, i, left), log2, exponent, some)
        for j in range(side):
            histogram[int(level[j])] += some[j]
            total += some[j]
    reached, median = histogram[0], 0
    while reached < 0.5 * total and median < _LEVELS - 1:
        median += 1
        reached += histogram[median]
    if histogram[median] == 0.0:
        return inverse_depth[r, c]
    inside = 0.0
    for i in range(top, bottom):
        for j in range(side):
            if int(levels[i, left + j]) == median:
                inside += weights[(i - top) * side + j] * inverse_depth[i, left + j]
    return np.float32(inside / histogram[median])
