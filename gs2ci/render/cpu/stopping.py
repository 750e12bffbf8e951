"""Where the light of each pixel is stopped: `gs2ci.render.stopping`, over the lists that a rendering made.

Here: what each Gaussian says of depth in each view, in numpy float64, and the kernel that finds the quantiles, 16
pixels at a time in float32. Neighbouring pixels see the same Gaussians, so that their lanes need about equally many
steps.
"""

from typing import Final

import numpy as np
from numba import prange

from gs2ci.core.arrays import F32, F64
from gs2ci.render.conventions import ALPHA_MAX, ALPHA_MIN, DILATION_PX2, LOG_SCALE_MAX, NEAR, QUATERNION_NORM_MIN
from gs2ci.render.cpu.compile import kernel
from gs2ci.render.cpu.layout import Layout
from gs2ci.render.cpu.lists import Lists
from gs2ci.render.cpu.passes import Inputs
from gs2ci.render.cpu.record import (
    ACROSS,
    ALONG,
    FIELDS,
    FOCAL_X,
    FOCAL_Y,
    LOG2_OPACITY,
    MEAN_X,
    MEAN_Y,
    SHEAR,
    U_HIGH,
    U_LOW,
    V_HIGH,
    V_LOW,
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

# What a Gaussian says of depth in a view.
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
_BEYOND = np.float32(2.5e-7)
# A bracket is halved at least every other step, so that these suffice for `RESOLUTION` whatever the profiles are.
_STEPS_MAX: Final = 60
_CELLS_PER_TASK: Final = 64
# In float64 the intermediate arrays of a Gaussian are ten times as large as what is kept of it.
_GAUSSIANS_AT_ONCE: Final = 2**16


def depth_fields(inputs: Inputs) -> F32:
    """Find each Gaussian's depth, its slopes on screen and its thickness in each view, [V, G, DEPTH_FIELDS]."""
    camera = inputs.camera.astype(np.float64)
    means = np.broadcast_to(inputs.means, (len(inputs.poses), inputs.count, 3))
    poses = inputs.poses.reshape(-1, 4, 4).astype(np.float64)
    fields = np.empty((len(inputs.poses), inputs.count, DEPTH_FIELDS), np.float32)
    for first in range(0, inputs.count, _GAUSSIANS_AT_ONCE):
        part = slice(first, first + _GAUSSIANS_AT_ONCE)
        scales = np.exp(np.minimum(inputs.log_scales[part].astype(np.float64), LOG_SCALE_MAX))
        factor = _rotations(inputs.quaternions[part]) * scales[:, None, :]
        for pose, centres, out in zip(poses, means[:, part].astype(np.float64), fields[:, part], strict=True):
            _fill_depth_fields(factor, centres, pose, camera, out)
    return fields


def _fill_depth_fields(factor: F64, centres: F64, pose: F64, camera: F64, out: F32) -> None:
    """Fill the fields of Gaussians, [G, DEPTH_FIELDS], in one view.

    Args:
        factor: Of their covariances, factor factorᵀ, [G, 3, 3].
        centres: [G, 3].
        pose: World to camera, [4, 4].
        camera: Its fields, as in `record`.
        out: Filled.
    """
    points = centres @ pose[:3, :3].T + pose[:3, 3]
    depth = np.maximum(points[:, 2], NEAR)
    slopes = np.clip(points[:, :2] / depth[:, None], camera[[U_LOW, V_LOW]], camera[[U_HIGH, V_HIGH]])
    shape = pose[:3, :3] @ factor
    along = shape[:, 2]
    focal = camera[[FOCAL_X, FOCAL_Y]]
    on_screen = (shape[:, :2] - slopes[:, :, None] * along[:, None]) * (focal / depth[:, None])[:, :, None]
    with_screen = np.einsum("gij,gj->gi", on_screen, along)
    covariance = on_screen @ on_screen.transpose(0, 2, 1) + DILATION_PX2 * np.eye(2)
    gain = np.linalg.solve(covariance, with_screen[:, :, None])[:, :, 0]
    variance = (along * along).sum(axis=1) - (gain * with_screen).sum(axis=1)
    out[:, CENTRE_DEPTH] = depth
    out[:, SLOPE_X : SLOPE_Y + 1] = gain / depth[:, None]
    out[:, SIGMA] = np.sqrt(np.maximum(variance, 0))


def _rotations(quaternions: F32) -> F64:
    """Turn quaternions (w, x, y, z) of any norm, [G, 4], into matrices, [G, 3, 3]; too short ones into the identity."""
    q = quaternions.astype(np.float64)
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    w, x, y, z = np.where(norm >= QUATERNION_NORM_MIN, q / np.maximum(norm, QUATERNION_NORM_MIN), [1.0, 0, 0, 0]).T
    rows = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


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
    _stop_light(
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


@kernel()
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


@kernel()
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


@kernel()
def _quantile(wanted, weights, depths, inverses, count, near, far):
    """Find at 16 pixels the nearest depth before which `wanted` is stopped.

    Newton's steps, kept between bounds that are halved at least every other step, until all lanes are done.
    """
    guess = _HALF * (near + far)
    for step in range(_STEPS_MAX):
        if not any_ge(far - near, _RESOLUTION * far):
            break
        total, density = _before(guess, weights, depths, inverses, count)
        far = where_ge(total, wanted, guess, far)
        near = where_ge(total, wanted, near, guess)
        middle = _HALF * (near + far)
        if step % 2 == 0:
            # A little beyond the root, so that both bounds close in on it.
            beyond = where_ge(total, wanted, -_BEYOND * far, _BEYOND * far)
            newton = guess + (wanted - total) / maximum(density, _TINY) + beyond
            inside = where_ge(near, newton, middle, where_ge(newton, far, middle, newton))
            guess = where_ge(density, _TINY, inside, middle)
        else:
            guess = middle
    return far


@kernel(parallel=True)
def _stop_light(records, cell_view, x, y, pixel, weight, start, entries, view_start, gaussians, fields, longest, maps):
    """Fill the maps, [MAPS, V, H * W]; `longest` is the length of the longest list, `fields` is flat."""
    cells = entries.shape[0]
    views = max(view_start.shape[0] - 1, 1)
    record_stride, field_stride = records.shape[0] // views, fields.shape[0] // views
    for task in prange((cells + _CELLS_PER_TASK - 1) // _CELLS_PER_TASK):
        weights = np.empty(LANES * longest, np.float32)
        depths, inverses = np.empty_like(weights), np.empty_like(weights)
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
            depth = _quantile(_HALF_SHARE * total, weights, depths, inverses, count, near, far)
            low = _quantile(_LOW_SHARE * total, weights, depths, inverses, count, near, depth)
            high = _quantile(_HIGH_SHARE * total, weights, depths, inverses, count, depth, far)
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
