"""Where the light of each pixel is stopped: `gs2ci.render.stopping`, over the lists that a rendering made.

Here: the kernel that finds the quantiles, 16 pixels at a time in float32. Neighbouring pixels see the same Gaussians,
so that their lanes need about equally many steps.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import f32_1, f32_3, helper, i32_1, i64, i64_1, in_parts, kernel
from gs2ci.render.conventions import ALPHA_MAX, ALPHA_MIN
from gs2ci.render.cpu.layout import Layout
from gs2ci.render.cpu.lists import Lists
from gs2ci.render.cpu.record import (
    ACROSS,
    ALONG,
    FIELDS,
    LOG2_OPACITY,
    MEAN_X,
    MEAN_Y,
    SHEAR,
)
from gs2ci.render.simd.elementary import LN2, exponential
from gs2ci.render.simd.vector import (
    LANES,
    any_ge,
    broadcast,
    get,
    load,
    maximum,
    minimum,
    store,
    where_ge,
)
from gs2ci.render.stopping import (
    DEPTH_QUANTILE,
    NEARBY,
    PROFILE_REACH,
    PROFILE_SIGMA_RANGE,
    QUANTILE_SLACK,
    RATIO_MAX,
    RESOLUTION,
    SPREAD_QUANTILES,
)

# What a Gaussian says of depth in a view (`render.stopping.depth_fields`).
CENTRE_DEPTH: Final = 0
SLOPE_X: Final = 1  # of depth per px on screen, as a share of the centre's depth
SLOPE_Y: Final = 2
SIGMA: Final = 3  # along a ray, scene units
DEPTH_FIELDS: Final = 4

MAPS: Final = 4
"""Depth, spread, stopped, nearby: the order of `StoppedLight`."""

_ZERO, _QUARTER, _HALF, _THREE_QUARTERS, _ONE = (np.float32(k / 4) for k in range(5))
_MINUS_ONE, _INFINITY, _TINY = np.float32(-1), np.float32(np.inf), np.float32(1e-30)
_LN2 = np.float32(LN2)
_ALPHA_MAX = np.float32(ALPHA_MAX)
_LOG2_ALPHA_MIN = np.float32(np.log2(ALPHA_MIN))
_LOW_SHARE, _HALF_SHARE, _HIGH_SHARE = (
    np.float32(share - QUANTILE_SLACK) for share in (SPREAD_QUANTILES[0], DEPTH_QUANTILE, SPREAD_QUANTILES[1])
)
_SIGMA_MIN, _SIGMA_MAX = (np.float32(sigma) for sigma in PROFILE_SIGMA_RANGE)
_REACH = np.float32(PROFILE_REACH)
_LEAST_RATIO = np.float32(1 / RATIO_MAX)
_BEHIND, _AHEAD = np.float32(1 + NEARBY), np.float32(1 - NEARBY)
# Neighbouring numbers in single precision lie up to 1.2e-7 of themselves apart, and no bracket is narrower.
_RESOLUTION = np.float32(max(RESOLUTION, 2.5e-7))
# Two such steps are a bracket that is narrow enough.
_BEYOND = np.float32(1.2e-7)
# A bracket is halved in any three steps, so that these suffice for `RESOLUTION` whatever the profiles are.
_STEPS_MAX: Final = 80
_CELLS_PER_TASK: Final = 64
# Three numbers at 16 pixels of so many Gaussians are all that the processor's nearest cache holds.
_MANY: Final = 300
_SORT_OUT_EVERY: Final = 3


def stop_light(records: F32, lists: Lists, layout: Layout, fields: F32) -> F32:
    """Find the maps of `StoppedLight`, [MAPS, V, H, W], from a rendering's records and lists.

    Args:
        records: Projected Gaussians, [V, blocks * 256].
        lists: Those that touch a pixel of each cell.
        layout: The cells; every pixel is in one.
        fields: Of `depth_fields`.
    """
    maps = np.zeros((MAPS, layout.views, layout.size[0] * layout.size[1]), np.float32)
    longest = int(lists.entries.max()) if layout.cells else 0
    in_parts(
        _stop_light,
        -(-layout.cells // _CELLS_PER_TASK),
        records.reshape(-1),
        layout.cell_view,
        layout.x,
        layout.y,
        layout.pixel,
        layout.weight,
        lists.start,
        lists.entries,
        lists.view_start,
        lists.gaussians,
        fields.reshape(-1),
        longest,
        maps,
    )
    return maps.reshape(MAPS, layout.views, *layout.size)


@helper()
def _gather(records, base, gaussians, begin, count, fields, fields_base, x, y, weights, depths, inverses):
    """Write what stops light at 16 pixels, front to back: weights, depths and inverse reaches, [count * 16].

    Returns the weights' sum, the light that passes, and the bracket that holds all profiles (lanes that stop nothing:
    infinity to zero).
    """
    through, total = broadcast(_ONE), broadcast(_ZERO)
    near, far = broadcast(_INFINITY), broadcast(_ZERO)
    for i in range(count):
        gaussian = np.int64(get(gaussians, begin + i))
        at, field = base + gaussian * FIELDS, fields_base + gaussian * DEPTH_FIELDS
        dx, dy = x - get(records, at + MEAN_X), y - get(records, at + MEAN_Y)
        t = dx + get(records, at + SHEAR) * dy
        across = (get(records, at + ACROSS) * t) * t
        log2_alpha = get(records, at + LOG2_OPACITY) - across - (get(records, at + ALONG) * dy) * dy
        alpha = where_ge(log2_alpha, _LOG2_ALPHA_MIN, minimum(exponential(_LN2 * log2_alpha), _ALPHA_MAX), _ZERO)
        weight = alpha * through
        share = get(fields, field + SLOPE_X) * dx + get(fields, field + SLOPE_Y) * dy
        depth = get(fields, field + CENTRE_DEPTH) / maximum(_ONE - share, _LEAST_RATIO)
        sigma = minimum(maximum(_SIGMA_MIN * depth, get(fields, field + SIGMA)), _SIGMA_MAX * depth)
        reach = _REACH * sigma
        store(weights, i * LANES, weight)
        store(depths, i * LANES, depth)
        store(inverses, i * LANES, 1.0 / reach)
        near = where_ge(log2_alpha, _LOG2_ALPHA_MIN, minimum(near, depth - reach), near)
        far = where_ge(log2_alpha, _LOG2_ALPHA_MIN, maximum(far, depth + reach), far)
        total = total + weight
        through = through - weight
    return total, through, near, far


@helper()
def _before(limit, weights, depths, inverses, count):
    """Return what is stopped before a depth at 16 pixels, and its derivative."""
    total, density = broadcast(_ZERO), broadcast(_ZERO)
    for i in range(count):
        weight, inverse = load(weights, i * LANES), load(inverses, i * LANES)
        along = minimum(maximum((limit - load(depths, i * LANES)) * inverse, _MINUS_ONE), _ONE)
        square = along * along
        total = total + weight * (_HALF + along * (_THREE_QUARTERS - _QUARTER * square))
        density = density + (weight * inverse) * (_ONE - square)
    return total, _THREE_QUARTERS * density


@helper()
def _keep_open(weights, depths, inverses, count, near, far, closed, left_weights, left_depths, left_inverses):
    """Copy what may stop light between two depths at any of 16 pixels; in place, if the arrays are the same.

    Returns how many are left, and `closed` plus what is wholly stopped before the nearer depth.
    """
    left = 0
    for i in range(count):
        weight, depth, inverse = load(weights, i * LANES), load(depths, i * LANES), load(inverses, i * LANES)
        from_near, from_far = (near - depth) * inverse, (far - depth) * inverse
        inside = where_ge(_ZERO, weight, _ZERO, minimum(_ONE - from_near, _ONE + from_far))
        if any_ge(inside, _TINY):
            store(left_weights, left * LANES, weight)
            store(left_depths, left * LANES, depth)
            store(left_inverses, left * LANES, inverse)
            left += 1
        else:
            closed = closed + where_ge(from_near, _ONE, weight, _ZERO)
    return left, closed


@helper()
def _quantile(wanted, weights, depths, inverses, count, near, far, left_weights, left_depths, left_inverses):
    """Find at 16 pixels the nearest depth before which `wanted` is stopped; the last three arrays are overwritten.

    Newton's steps from the last guess, each a little beyond where it finds the root, so that the bounds close in from
    both sides. Where two of them have not halved the distance of the bounds, or lead out of them, the middle is next.
    """
    guess = _HALF * (near + far)
    last, before_last, closed = broadcast(_INFINITY), broadcast(_INFINITY), broadcast(_ZERO)
    for step in range(_STEPS_MAX):
        if not any_ge(far - near, _RESOLUTION * far):
            break
        if count > _MANY and step % _SORT_OUT_EVERY == _SORT_OUT_EVERY - 1:
            count, closed = _keep_open(
                weights, depths, inverses, count, near, far, closed, left_weights, left_depths, left_inverses
            )
            weights, depths, inverses = left_weights, left_depths, left_inverses
        total, density = _before(guess, weights, depths, inverses, count)
        total = closed + total
        far = where_ge(total, wanted, guess, far)
        near = where_ge(total, wanted, near, guess)
        beyond = where_ge(total, wanted, -_BEYOND * far, _BEYOND * far)
        newton = guess + (wanted - total) / maximum(density, _TINY) + beyond
        width, middle = far - near, _HALF * (near + far)
        guess = where_ge(near, newton, middle, where_ge(newton, far, middle, newton))
        guess = where_ge(density, _TINY, where_ge(_HALF * before_last, width, guess, middle), middle)
        last, before_last = width, last
    return far


@kernel(i64, i64, f32_1, i32_1, f32_1, f32_1, i32_1, f32_1, i32_1, i32_1, i64_1, i32_1, f32_1, i64, f32_3)
def _stop_light(
    from_task,
    to_task,
    records,
    cell_view,
    x,
    y,
    pixel,
    weight,
    start,
    entries,
    view_start,
    gaussians,
    fields,
    longest,
    maps,
):
    """Fill the maps, [MAPS, V, H * W]; `longest` is the length of the longest list, `fields` is flat."""
    cells = entries.shape[0]
    views = max(view_start.shape[0] - 1, 1)
    record_stride, field_stride = records.shape[0] // views, fields.shape[0] // views
    for task in range(from_task, to_task):
        weights = np.empty(LANES * longest, np.float32)
        depths, inverses = np.empty_like(weights), np.empty_like(weights)
        left = (np.empty_like(weights), np.empty_like(weights), np.empty_like(weights))
        found = np.empty(MAPS * LANES, np.float32)
        for cell in range(task * _CELLS_PER_TASK, min(cells, (task + 1) * _CELLS_PER_TASK)):
            view, count = cell_view[cell], np.int64(entries[cell])
            total, through, near, far = _gather(
                records,
                view * record_stride,
                gaussians,
                view_start[view] + start[cell],
                count,
                fields,
                view * field_stride,
                load(x, cell * LANES),
                load(y, cell * LANES),
                weights,
                depths,
                inverses,
            )
            # Where nothing is stopped: a bracket without width, which nothing waits for.
            near = where_ge(far, near, near, _ONE)
            far = maximum(far, near)
            depth = _quantile(_HALF_SHARE * total, weights, depths, inverses, count, near, far, *left)
            low = _quantile(_LOW_SHARE * total, weights, depths, inverses, count, near, depth, *left)
            high = _quantile(_HIGH_SHARE * total, weights, depths, inverses, count, depth, far, *left)
            behind, _ = _before(depth * _BEHIND, weights, depths, inverses, count)
            ahead, _ = _before(depth * _AHEAD, weights, depths, inverses, count)
            some = where_ge(_ZERO, total, _ZERO, broadcast(_ONE))
            store(found, 0, some * depth)
            store(found, LANES, some * (_HALF * (depth / low - depth / high)))
            store(found, 2 * LANES, _ONE - through)
            store(found, 3 * LANES, some * (behind - ahead))
            for lane in range(LANES):
                if weight[cell * LANES + lane] == 0.0:
                    continue
                for each in range(MAPS):
                    maps[each, view, pixel[cell * LANES + lane]] = found[each * LANES + lane]
