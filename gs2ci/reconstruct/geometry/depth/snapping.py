"""Jumps of a depth map moved to the edges of its view: a median weighted by similarity of colour.

A sweep compares windows, and a fit shows the colours of an edge on both of its sides: things in front of a plain wall
get some pixels too wide. Here: the filter. Not here: the sweep (`sweep`). OpenCV's filter of this kind clusters colours
at random, so that its results are not reproducible.
"""

from typing import Any, Final

import numpy as np
import torch

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import EXACT, f32_1, helper, i64, in_parts, kernel
from gs2ci.reconstruct.geometry.depth.device_sweep import AT_ONCE
from gs2ci.render.places import working_device
from gs2ci.render.simd.elementary import exponential
from gs2ci.render.simd.vector import LANES, broadcast, floor, load, maximum, minimum, store, where_ge

# Radius of the window. An edge is corrected over somewhat less than half of it, since the majority of a window decides.
_REACH_PX: Final = 10
_SIDE: Final = 2 * _REACH_PX + 1
_OFFSETS: Final = _SIDE**2
# -1/(2 s^2), s: the standard deviation of similar colours, 0.04 full scales.
_LOG_PER_SQUARE: Final = np.float32(-1 / (2 * 0.04**2))
# What lies outside of the view resembles nothing in it.
_OUTSIDE: Final = 1e3
_LEVEL_BITS: Final = 8
_HIGHEST: Final = np.float32(2**_LEVEL_BITS - 1)
# A pixel that the median would move by at most so many levels keeps its value.
_KEPT_LEVELS: Final = 2
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)


def snapped(inverse_depth: F32, view: F32) -> F32:
    """Return a map, [H, W], with its jumps at the edges of its view, [H, W, C] in full scales."""
    low, high = float(inverse_depth.min()), float(inverse_depth.max())
    if not low < high:
        return inverse_depth
    height, width = inverse_depth.shape
    depths = np.ascontiguousarray(inverse_depth, np.float32)
    levels = np.rint((depths - low) / (high - low) * _HIGHEST).astype(np.float32)
    # Whole vectors of pixels, and the window around the last of them.
    across = -(-width // LANES) * LANES
    rims = ((_REACH_PX, _REACH_PX), (_REACH_PX, _REACH_PX + across - width))
    colours = np.pad(view.astype(np.float32).transpose(2, 0, 1), ((0, 0), *rims), constant_values=_OUTSIDE)
    given, device = (np.pad(depths, rims), np.pad(levels, rims), colours), working_device()
    if device is not None:
        median, mean = _snap_on_device(*given, device)
    else:
        median, mean = np.empty((2, height, across), np.float32)
        flat = (one.reshape(-1) for one in given)
        in_parts(_snap, height, height, across, *flat, median.reshape(-1), mean.reshape(-1))
    moves = np.abs(median[:, :width] - levels) > _KEPT_LEVELS
    found: F32 = np.where(moves, mean[:, :width], depths)
    return found


def _snap_on_device(inverse_depth: F32, levels: F32, colours: F32, device: torch.device) -> tuple[F32, F32]:
    """Do as `_snap`, in torch on a device, some rows at once; never run on a GPU so far.

    Args:
        inverse_depth: With rims, [H, W].
        levels: Likewise.
        colours: Likewise, [C, H, W].
        device: Where.

    Returns:
        The medians and means, without rims.
    """
    depths, level, colour = (
        torch.from_numpy(one).to(device).unfold(-2, _SIDE, 1).unfold(-2, _SIDE, 1)
        for one in (inverse_depth, levels, colours)
    )
    found = []
    some = max(1, AT_ONCE // depths[0].numel())
    for depth, here, near in zip(*(torch.split(one, some, dim=-4) for one in (depths, level, colour)), strict=True):
        own = near[..., _REACH_PX, _REACH_PX, None, None]
        weights = ((near - own).square().sum(dim=0) * float(_LOG_PER_SQUARE)).exp()
        half = 0.5 * weights.sum(dim=(-2, -1))
        low, high = torch.zeros_like(half), torch.full_like(half, float(_HIGHEST))
        for _ in range(_LEVEL_BITS):
            middle = ((low + high) / 2).floor()
            met = torch.where(here <= middle[..., None, None], weights, 0.0).sum(dim=(-2, -1)) >= half
            low, high = torch.where(met, low, torch.minimum(middle + 1, high)), torch.where(met, middle, high)
        same = torch.where(here == high[..., None, None], weights, 0.0)
        found.append(torch.stack([high, (same * depth).sum(dim=(-2, -1)) / same.sum(dim=(-2, -1))]))
    median, mean = torch.cat(found, dim=1).cpu().numpy()
    return median, mean


@helper(fastmath=EXACT)
def _weigh(colours: F32, plane: int, at: int, stride: int, weights: F32) -> Any:
    """Store how alike 16 pixels from `at` on are to those of each offset of their windows; return half of the sums."""
    corner, half = at - _REACH_PX * (stride + 1), broadcast(_ZERO)
    for n in range(_OFFSETS):
        there, squares = corner + n // _SIDE * stride + n % _SIDE, broadcast(_ZERO)
        for channel in range(0, len(colours), plane):
            difference = load(colours, channel + there) - load(colours, channel + at)
            squares = squares + difference * difference
        weight = exponential(squares * _LOG_PER_SQUARE)
        store(weights, n * LANES, weight)
        half = half + weight * _HALF
    return half


@helper(fastmath=EXACT)
def _median(levels: F32, at: int, stride: int, weights: F32, half: Any) -> Any:
    """Return the lowest level up to which windows have half of their weight, by halving the levels."""
    corner, low, high = at - _REACH_PX * (stride + 1), broadcast(_ZERO), broadcast(_HIGHEST)
    for _ in range(_LEVEL_BITS):
        middle, reached = floor((low + high) * _HALF), broadcast(_ZERO)
        for n in range(_OFFSETS):
            level = load(levels, corner + n // _SIDE * stride + n % _SIDE)
            reached = reached + where_ge(middle, level, load(weights, n * LANES), _ZERO)
        low = where_ge(reached, half, low, minimum(middle + _ONE, high))
        high = where_ge(reached, half, middle, high)
    return high


@kernel(i64, i64, i64, i64, f32_1, f32_1, f32_1, f32_1, f32_1, fastmath=EXACT)
def _snap(
    from_task: int,
    to_task: int,
    height: int,
    width: int,
    inverse_depth: F32,
    levels: F32,
    colours: F32,
    median: F32,
    mean: F32,
) -> None:
    """Write the weighted median of the levels around each pixel, and the mean of what shares it.

    Args:
        from_task: The first row.
        to_task: The end of them.
        height: H.
        width: W, whole vectors.
        inverse_depth: With a rim as wide as windows reach, [H + 2 R, W + 2 R].
        levels: Of it, whole numbers from 0 to 255, likewise.
        colours: Of the view, [C, H + 2 R, W + 2 R].
        median: Written: [H, W].
        mean: Written: [H, W].
    """
    stride = width + 2 * _REACH_PX
    plane = (height + 2 * _REACH_PX) * stride
    weights = np.empty(_OFFSETS * LANES, np.float32)
    for r in range(from_task, to_task):
        for c in range(0, width, LANES):
            at = (r + _REACH_PX) * stride + c + _REACH_PX
            half = _weigh(colours, plane, at, stride, weights)
            found = _median(levels, at, stride, weights, half)
            corner, share, total = at - _REACH_PX * (stride + 1), broadcast(_ZERO), broadcast(_ZERO)
            for n in range(_OFFSETS):
                there = corner + n // _SIDE * stride + n % _SIDE
                level = load(levels, there)
                weight = where_ge(found, level, load(weights, n * LANES), _ZERO)
                weight = where_ge(level, found, weight, _ZERO)
                share = share + weight
                total = total + weight * load(inverse_depth, there)
            store(median, r * width + c, found)
            store(mean, r * width + c, total / maximum(share, np.float32(1e-30)))
