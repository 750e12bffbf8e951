"""Blending, forward and backward: a cell of 16 pixels against its list of Gaussians, front to back.

With alpha_i the opacity of Gaussian i at a pixel, T_i = prod_{j<i} (1 - alpha_j) the light that reaches it and w_i =
alpha_i T_i its weight, a pixel is sum_i w_i c_i over black, and its transmittance is T_end.

Gradient. With v = dL/d(pixel colour), u = dL/d(transmittance), q_i = c_i . v and the light still to come
S_i = sum_{j>i} w_j q_j + T_end u,

    G_i = dL / d ln(alpha_i) = w_i q_i - S_i alpha_i / (1 - alpha_i).

S_0 is known from the forward result, so the backward pass runs front to back too: T by multiplication, S by
subtraction, no division to recover T.
"""

import numpy as np
from numba import prange

from gs2ci.render.conventions import ALPHA_MAX, ALPHA_MIN
from gs2ci.render.cpu.compile import kernel
from gs2ci.render.cpu.elementary import exp2_blend
from gs2ci.render.cpu.lanes import load_transposed, store_rows, transpose, weighted_sums_3, weighted_sums_6
from gs2ci.render.cpu.record import (
    ACROSS,
    ALONG,
    BLUE,
    FIELDS,
    GREEN,
    LOG2_OPACITY,
    MEAN_X,
    MEAN_Y,
    RED,
    SHEAR,
)
from gs2ci.render.cpu.vector import (
    LANES,
    any_ge,
    broadcast,
    fused,
    get,
    load,
    minimum,
    prefetch,
    put,
    quick_reciprocal,
    store,
    where_ge,
)

CHANNELS = 4
"""A cell's pixels are kept as 16 reds, 16 greens, 16 blues, 16 transmittances."""
CELL = CHANNELS * LANES

_LOG2_ALPHA_MIN = np.float32(np.log2(ALPHA_MIN))
_ALPHA_MAX = np.float32(ALPHA_MAX)
_ZERO = np.float32(0)
_ONE = np.float32(1)

_CELLS_PER_TASK = 64
_TERMINATION_STRIDE = 8  # entries between two looks at the transmittance
_AHEAD = 8  # entries between asking for a record and using it
_PIVOT = 7  # the lane about whose pixel a cell takes its moments

# Rows of the table by which a cell's gradients are summed, 16 pixels each.
_MONOMIALS = 0  # 1, x, y, xx, xy, yy about the pivot
_COLOUR_GRADIENTS = 6 * LANES
_TABLE = 9 * LANES


@kernel()
def _log2_alpha(records, offset, x, y):
    """Return log2 alpha at 16 pixels of the Gaussian whose record starts at `offset`."""
    dx = x - get(records, offset + MEAN_X)
    dy = y - get(records, offset + MEAN_Y)
    t = dx + get(records, offset + SHEAR) * dy
    across = (get(records, offset + ACROSS) * t) * t
    return get(records, offset + LOG2_OPACITY) - across - (get(records, offset + ALONG) * dy) * dy


@kernel()
def _prefetch_record(records, base, lists, position):
    prefetch(records, base + np.int64(get(lists, position)) * FIELDS)


@kernel()
def _blend_cell(records, base, candidates, begin, count, x, y, termination, cell, lists, out):
    """Blend one cell; list the candidates that touched a pixel. Returns how many those are."""
    transmittance = broadcast(_ONE)
    red, green, blue = broadcast(_ZERO), broadcast(_ZERO), broadcast(_ZERO)
    for i in range(min(count, _AHEAD)):
        _prefetch_record(records, base, candidates, begin + i)
    kept = 0
    i = 0
    while i < count:
        pause = min(count, i + _TERMINATION_STRIDE)
        while i < pause:
            gaussian = get(candidates, begin + i)
            _prefetch_record(records, base, candidates, begin + min(i + _AHEAD, count - 1))
            offset = base + np.int64(gaussian) * FIELDS
            log2_alpha = _log2_alpha(records, offset, x, y)
            alpha = where_ge(log2_alpha, _LOG2_ALPHA_MIN, minimum(exp2_blend(log2_alpha), _ALPHA_MAX), _ZERO)
            weight = alpha * transmittance
            transmittance = transmittance - weight
            red = red + weight * get(records, offset + RED)
            green = green + weight * get(records, offset + GREEN)
            blue = blue + weight * get(records, offset + BLUE)
            # Written always, counted only if a pixel was touched: a compaction without a branch.
            put(lists, begin + kept, gaussian)
            kept += any_ge(log2_alpha, _LOG2_ALPHA_MIN)
            i += 1
        if not any_ge(transmittance, termination):
            break
    store(out, cell * CELL, red)
    store(out, cell * CELL + LANES, green)
    store(out, cell * CELL + 2 * LANES, blue)
    store(out, cell * CELL + 3 * LANES, transmittance)
    return kept


@kernel(parallel=True)
def blend(records, cell_view, x, y, entry_start, entries, list_start, candidates, termination, kept, lists, out):
    """Blend all cells.

    Args:
        records: [V, blocks * 256] float32, flattened.
        cell_view: The view of each cell, [cells] int32.
        x: Pixel centres, [cells * 16] float32.
        y: Likewise.
        entry_start: Where each cell's list begins within its view's lists, [cells] int32.
        entries: Its length, [cells] int32.
        list_start: Where each view's lists begin, [V + 1] int64.
        candidates: Indices of Gaussians that may touch a pixel of the cell.
        termination: A cell stops once the transmittance of all its pixels is below this.
        kept: Written: length of each list in `lists`, [cells] int32.
        lists: Written: those that do touch one; laid out as `candidates`, and may be the same memory.
        out: Written: [cells * 64]: red, green, blue and transmittance of the cell's 16 pixels.
    """
    cells = entries.shape[0]
    record_stride = records.shape[0] // max(list_start.shape[0] - 1, 1)
    for task in prange((cells + _CELLS_PER_TASK - 1) // _CELLS_PER_TASK):
        for cell in range(task * _CELLS_PER_TASK, min(cells, (task + 1) * _CELLS_PER_TASK)):
            view = cell_view[cell]
            kept[cell] = _blend_cell(
                records,
                view * record_stride,
                candidates,
                list_start[view] + entry_start[cell],
                np.int64(entries[cell]),
                load(x, cell * LANES),
                load(y, cell * LANES),
                termination,
                cell,
                lists,
                out,
            )


@kernel()
def _fill_table(x, y, gradients, cell, table):
    """Tabulate, for a cell's 16 pixels, the monomials about its pivot and the colour gradients."""
    x_pivot, y_pivot = get(x, cell * LANES + _PIVOT), get(y, cell * LANES + _PIVOT)
    dx, dy = load(x, cell * LANES) - x_pivot, load(y, cell * LANES) - y_pivot
    store(table, 0, broadcast(_ONE))
    store(table, LANES, dx)
    store(table, 2 * LANES, dy)
    store(table, 3 * LANES, dx * dx)
    store(table, 4 * LANES, dx * dy)
    store(table, 5 * LANES, dy * dy)
    for channel in range(3):
        store(table, _COLOUR_GRADIENTS + channel * LANES, load(gradients, cell * CELL + channel * LANES))
    return x_pivot, y_pivot


@kernel()
def _sum_over_pixels(g, weights, table, x_pivot, y_pivot, mean_x, mean_y, shear):
    """Turn [16 Gaussians, 16 pixels] of G and of blending weights into gradient records, one row per Gaussian.

    Moments are first taken about the pivot, a pixel of the cell, then moved to the Gaussian's (t, dy): taken
    about the image's origin they would cancel to three digits.
    """
    m0, mx, my, mxx, mxy, myy = weighted_sums_6(load_transposed(g, 0), table, _MONOMIALS)
    red, green, blue = weighted_sums_3(load_transposed(weights, 0), table, _COLOUR_GRADIENTS)
    pivot_dy = y_pivot - mean_y
    pivot_t = (x_pivot - mean_x) + shear * pivot_dy
    mt = mx + shear * my
    mty = mxy + shear * myy
    mtt = mxx + shear * (mxy + mty)
    sum_t = mt + pivot_t * m0
    sum_y = my + pivot_dy * m0
    zero = broadcast(_ZERO)
    return transpose(
        (
            m0,
            sum_t,
            sum_y,
            mtt + pivot_t * (mt + sum_t),
            mty + pivot_t * my + pivot_dy * sum_t,
            myy + pivot_dy * (my + sum_y),
            red,
            green,
            blue,
            zero,
            zero,
            zero,
            zero,
            zero,
            zero,
            zero,
        )
    )


@kernel()
def _light_to_come(out, gradients, cell):
    """Return S_0: the whole pixel seen through its gradient."""
    total = load(out, cell * CELL) * load(gradients, cell * CELL)
    for channel in range(1, CHANNELS):
        offset = cell * CELL + channel * LANES
        # Of a b + c d a compiler may fuse either product, and the process that compiles this kernel chose otherwise
        # than those that later found it on disk.
        total = fused(load(out, offset), load(gradients, offset), total)
    return total


@kernel()
def _differentiate_entry(records, offset, x, y, pixel_gradient, transmittance, to_come):
    """Take one step front to back at 16 pixels; returns weight, G, and what is left of transmittance and S."""
    red, green, blue = pixel_gradient
    log2_alpha = _log2_alpha(records, offset, x, y)
    unclamped = exp2_blend(log2_alpha)
    alpha = where_ge(log2_alpha, _LOG2_ALPHA_MIN, minimum(unclamped, _ALPHA_MAX), _ZERO)
    weight = alpha * transmittance
    seen = weight * (
        get(records, offset + RED) * red + get(records, offset + GREEN) * green + get(records, offset + BLUE) * blue
    )
    to_come = to_come - seen
    slope = seen - to_come * alpha * quick_reciprocal(_ONE - alpha)
    return weight, where_ge(unclamped, _ALPHA_MAX, _ZERO, slope), transmittance - weight, to_come


@kernel()
def _differentiate_cell(records, base, lists, begin, count, x, y, out, gradients, cell, sums, sums_base, scratch):
    """Add one cell's part to the gradient records of the Gaussians that touched it."""
    g, weights, table, rows, centres = scratch
    x_pivot, y_pivot = _fill_table(x, y, gradients, cell, table)
    cell_x, cell_y = load(x, cell * LANES), load(y, cell * LANES)
    pixel_gradient = (
        load(table, _COLOUR_GRADIENTS),
        load(table, _COLOUR_GRADIENTS + LANES),
        load(table, _COLOUR_GRADIENTS + 2 * LANES),
    )
    to_come = _light_to_come(out, gradients, cell)
    transmittance = broadcast(_ONE)
    for group in range(0, count, LANES):
        present = min(LANES, count - group)
        for j in range(present):
            position = begin + group + j
            soon = np.int64(get(lists, begin + min(group + j + _AHEAD, count - 1))) * FIELDS
            prefetch(records, base + soon)
            prefetch(sums, sums_base + soon)
            offset = base + np.int64(get(lists, position)) * FIELDS
            put(centres, j, get(records, offset + MEAN_X))
            put(centres, LANES + j, get(records, offset + MEAN_Y))
            put(centres, 2 * LANES + j, get(records, offset + SHEAR))
            weight, slope, transmittance, to_come = _differentiate_entry(
                records, offset, cell_x, cell_y, pixel_gradient, transmittance, to_come
            )
            store(g, j * LANES, slope)
            store(weights, j * LANES, weight)
        records_of_16 = _sum_over_pixels(
            g,
            weights,
            table,
            x_pivot,
            y_pivot,
            load(centres, 0),
            load(centres, LANES),
            load(centres, 2 * LANES),
        )
        store_rows(rows, 0, records_of_16)
        for j in range(present):
            offset = sums_base + np.int64(get(lists, begin + group + j)) * FIELDS
            store(sums, offset, load(sums, offset) + load(rows, j * LANES))


@kernel(parallel=True)
def differentiate_blend(records, cell_start, x, y, entry_start, kept, list_start, lists, out, gradients, bands, sums):
    """Sum the gradients of all cells into one record per Gaussian, view and band.

    Each view's cells are cut into `bands` consecutive parts, and each (view, band) is one task with a record array
    of its own: no two tasks write to one place, and the order of all sums is fixed by `bands` alone, whatever the
    number of threads.

    Args:
        records: As for `blend`; likewise x, y, entry_start, list_start, lists and kept as it left them.
        cell_start: Of `Layout`, [V + 1].
        x: See `records`.
        y: See `records`.
        entry_start: See `records`.
        kept: See `records`.
        list_start: See `records`.
        lists: See `records`.
        out: The result of `blend`.
        gradients: dL/d out, [cells * 64].
        bands: Parts per view.
        sums: Written: [bands, V, blocks * 256], flattened.
    """
    views = cell_start.shape[0] - 1
    record_stride = records.shape[0] // max(views, 1)
    for task in prange(views * bands):
        view, band = task // bands, task % bands
        begin = cell_start[view]
        cells = cell_start[view + 1] - begin
        sums_base = (band * views + view) * record_stride
        sums[sums_base : sums_base + record_stride] = _ZERO
        scratch = (
            # Rows beyond a short last group keep older, finite numbers, and their sums are not used.
            np.zeros(LANES * LANES, np.float32),
            np.zeros(LANES * LANES, np.float32),
            np.zeros(_TABLE, np.float32),
            np.zeros(LANES * LANES, np.float32),
            np.zeros(3 * LANES, np.float32),
        )
        for cell in range(begin + cells * band // bands, begin + cells * (band + 1) // bands):
            _differentiate_cell(
                records,
                view * record_stride,
                lists,
                list_start[view] + entry_start[cell],
                np.int64(kept[cell]),
                x,
                y,
                out,
                gradients,
                cell,
                sums,
                sums_base,
                scratch,
            )
