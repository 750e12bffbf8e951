"""From cells to images or to the coded sum, and gradients the other way.

Rendered cells hold the pixels that a mask opens, in the order of the layout.
"""

import numpy as np

from gs2ci.core.kernels import f32_1, f32_2, i32_1, i32_3, i64, i64_1, kernel
from gs2ci.render.cpu.blend import CELL
from gs2ci.render.simd.vector import LANES, get, put

_ZERO = np.float32(0)
_ONE = np.float32(1)


@kernel(i64, i64, f32_1, i32_1, i64_1, f32_2, f32_2)
def cells_to_views(from_task, to_task, out, pixel, cell_start, images, alphas):
    """Write cells into images.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        out: [cells * 64].
        pixel: Of `Layout`, [cells * 16]. Spare lanes repeat a pixel and write the same value twice.
        cell_start: Of `Layout`, [V + 1].
        images: Written: [V, H * W * 3].
        alphas: Written: [V, H * W]; 1 - transmittance.
    """
    for view in range(from_task, to_task):
        image, alpha = images[view], alphas[view]
        for cell in range(cell_start[view], cell_start[view + 1]):
            for lane in range(LANES):
                at, source = np.int64(get(pixel, cell * LANES + lane)), cell * CELL + lane
                put(image, 3 * at, get(out, source))
                put(image, 3 * at + 1, get(out, source + LANES))
                put(image, 3 * at + 2, get(out, source + 2 * LANES))
                put(alpha, at, _ONE - get(out, source + 3 * LANES))


@kernel(i64, i64, f32_2, f32_2, i32_1, f32_1, i64_1, f32_1)
def view_gradients_to_cells(from_task, to_task, image_gradients, alpha_gradients, pixel, weight, cell_start, gradients):
    """Collect dL/d(cells) from dL/d(images) [V, H * W * 3] and dL/d(alphas) [V, H * W]; spare lanes get 0."""
    for view in range(from_task, to_task):
        image, alpha = image_gradients[view], alpha_gradients[view]
        for cell in range(cell_start[view], cell_start[view + 1]):
            for lane in range(LANES):
                at, target = np.int64(get(pixel, cell * LANES + lane)), cell * CELL + lane
                real = get(weight, cell * LANES + lane)
                put(gradients, target, real * get(image, 3 * at))
                put(gradients, target + LANES, real * get(image, 3 * at + 1))
                put(gradients, target + 2 * LANES, real * get(image, 3 * at + 2))
                put(gradients, target + 3 * LANES, -real * get(alpha, at))


@kernel(i64, i64, f32_1, i32_1, f32_1, i64_1, i32_3, i32_3, f32_1)
def cells_to_coded(from_task, to_task, out, pixel, weight, cell_start, first, last, coded):
    """Add up mask value times pixel over all views: Y = sum_i M_i * X_i.

    A strip owns its pixel rows in every view, so strips are independent tasks and views are added in order.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        out: [cells * 64].
        pixel: Of `Layout`, [cells * 16].
        weight: Mask values, [cells * 16]; 0 in spare lanes.
        cell_start: Of `Layout`, [V + 1].
        first: Of `Layout`, [V, strips, W].
        last: Likewise.
        coded: Zeros [H * W * 3]; written.
    """
    views, _, width = first.shape
    for strip in range(from_task, to_task):
        for view in range(views):
            begin = cell_start[view] + first[view, strip, 0]
            end = cell_start[view] + last[view, strip, width - 1] + 1
            for lane in range(begin * LANES, end * LANES):
                at, mask = 3 * np.int64(get(pixel, lane)), get(weight, lane)
                source = (lane // LANES) * CELL + lane % LANES
                put(coded, at, get(coded, at) + mask * get(out, source))
                put(coded, at + 1, get(coded, at + 1) + mask * get(out, source + LANES))
                put(coded, at + 2, get(coded, at + 2) + mask * get(out, source + 2 * LANES))


@kernel(i64, i64, f32_1, i32_1, f32_1, i64_1, f32_1)
def coded_gradient_to_cells(from_task, to_task, coded_gradient, pixel, weight, cell_start, gradients):
    """Collect dL/d(cells) from dL/dY [H * W * 3]; the coded sum does not see transmittance."""
    for view in range(from_task, to_task):
        for lane in range(cell_start[view] * LANES, cell_start[view + 1] * LANES):
            at, mask = 3 * np.int64(get(pixel, lane)), get(weight, lane)
            target = (lane // LANES) * CELL + lane % LANES
            put(gradients, target, mask * get(coded_gradient, at))
            put(gradients, target + LANES, mask * get(coded_gradient, at + 1))
            put(gradients, target + 2 * LANES, mask * get(coded_gradient, at + 2))
            put(gradients, target + 3 * LANES, _ZERO)
