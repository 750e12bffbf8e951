"""Blending, forward and backward: a cell of 16 pixels against its list of Gaussians, front to back.

With alpha_i the opacity of Gaussian i at a pixel, T_i = prod_{j<i} (1 - alpha_j) the light that reaches it and w_i =
alpha_i T_i its weight, a pixel is sum_i w_i c_i over black, and its transmittance is T_end.

Gradient. With v = dL/d(pixel colour), u = dL/d(transmittance), q_i = c_i . v and R_i what a pixel sees behind Gaussian
i, weighed by its gradient and per light that arrives there,

    R_last = u,   R_{i-1} = R_i + alpha_i (q_i - R_i),   G_i = dL / d ln(alpha_i) = w_i (q_i - R_i).

So alpha and w are computed once more front to back and kept for one cell's list, and G then runs back to front: no
division, and no difference of sums.
"""

import numpy as np

from gs2ci.core.kernels import f32, f32_1, helper, i32_1, i64, i64_1, kernel
from gs2ci.render.conventions import ALPHA_MAX, ALPHA_MIN
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
from gs2ci.render.cpu.scratch import aligned_zeros
from gs2ci.render.simd.elementary import exp2_blend, exp2_blend_4
from gs2ci.render.simd.lanes import load_transposed, store_rows, transpose, weighted_sums_3, weighted_sums_6
from gs2ci.render.simd.vector import (
    LANES,
    any_ge,
    broadcast,
    get,
    load,
    minimum,
    prefetch,
    put,
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

CELLS_PER_TASK = 64
_TERMINATION_STRIDE = 8  # entries between two looks at the transmittance, a multiple of four
_AHEAD = 32  # entries between asking for a record and using it
_PIVOT = 7  # the lane about whose pixel a cell takes its moments

# Rows of the table by which a cell's gradients are summed, 16 pixels each.
_MONOMIALS = 0  # 1, x, y, xx, xy, yy about the pivot
_COLOUR_GRADIENTS = 6 * LANES
_TABLE = 9 * LANES


@helper()
def _log2_alpha(records, offset, x, y):
    """Return log2 alpha at 16 pixels of the Gaussian whose record starts at `offset`."""
    dx = x - get(records, offset + MEAN_X)
    dy = y - get(records, offset + MEAN_Y)
    t = dx + get(records, offset + SHEAR) * dy
    across = (get(records, offset + ACROSS) * t) * t
    return get(records, offset + LOG2_OPACITY) - across - (get(records, offset + ALONG) * dy) * dy


@helper()
def _log2_alpha_4(records, offsets, x, y):
    """Return `_log2_alpha` of four Gaussians, step by step of all, so that none waits for the step before."""
    a, b, c, d = offsets
    dya, dyb = y - get(records, a + MEAN_Y), y - get(records, b + MEAN_Y)
    dyc, dyd = y - get(records, c + MEAN_Y), y - get(records, d + MEAN_Y)
    ta, tb = x - get(records, a + MEAN_X), x - get(records, b + MEAN_X)
    tc, td = x - get(records, c + MEAN_X), x - get(records, d + MEAN_X)
    ta, tb = ta + get(records, a + SHEAR) * dya, tb + get(records, b + SHEAR) * dyb
    tc, td = tc + get(records, c + SHEAR) * dyc, td + get(records, d + SHEAR) * dyd
    ua, ub = get(records, a + ALONG) * dya, get(records, b + ALONG) * dyb
    uc, ud = get(records, c + ALONG) * dyc, get(records, d + ALONG) * dyd
    wa, wb = get(records, a + ACROSS) * ta, get(records, b + ACROSS) * tb
    wc, wd = get(records, c + ACROSS) * tc, get(records, d + ACROSS) * td
    va, vb = get(records, a + LOG2_OPACITY) - wa * ta, get(records, b + LOG2_OPACITY) - wb * tb
    vc, vd = get(records, c + LOG2_OPACITY) - wc * tc, get(records, d + LOG2_OPACITY) - wd * td
    return va - ua * dya, vb - ub * dyb, vc - uc * dyc, vd - ud * dyd


@helper()
def _alpha_of(log2_alpha, unclamped):
    """Cut alpha off at both ends."""
    return where_ge(log2_alpha, _LOG2_ALPHA_MIN, minimum(unclamped, _ALPHA_MAX), _ZERO)


@helper()
def _alpha_4(logs):
    """Return alpha of four Gaussians from the logarithms."""
    a, b, c, d = exp2_blend_4(logs[0], logs[1], logs[2], logs[3])
    return _alpha_of(logs[0], a), _alpha_of(logs[1], b), _alpha_of(logs[2], c), _alpha_of(logs[3], d)


@helper()
def _offset(base, lists, position):
    return base + np.int64(get(lists, position)) * FIELDS


@helper()
def _offsets_4(base, lists, position):
    return (
        _offset(base, lists, position),
        _offset(base, lists, position + 1),
        _offset(base, lists, position + 2),
        _offset(base, lists, position + 3),
    )


@helper()
def _behind(alpha, transmittance, pixel, records, offset):
    """Blend one Gaussian into 16 pixels; return the light behind it, and the pixels."""
    weight = alpha * transmittance
    red, green, blue = pixel
    blended = (
        red + weight * get(records, offset + RED),
        green + weight * get(records, offset + GREEN),
        blue + weight * get(records, offset + BLUE),
    )
    return transmittance - weight, blended


@helper()
def _prefetch_record(records, base, lists, position):
    prefetch(records, base + np.int64(get(lists, position)) * FIELDS)


@helper()
def _blend_cell(records, base, candidates, begin, count, x, y, termination, cell, lists, out):
    """Blend one cell; list the candidates that touched a pixel. Returns how many those are."""
    transmittance = broadcast(_ONE)
    pixel = (broadcast(_ZERO), broadcast(_ZERO), broadcast(_ZERO))
    for i in range(min(count, _AHEAD)):
        _prefetch_record(records, base, candidates, begin + i)
    kept = 0
    i = 0
    while i + 4 <= count:
        for k in range(4):
            _prefetch_record(records, base, candidates, begin + min(i + k + _AHEAD, count - 1))
        offsets = _offsets_4(base, candidates, begin + i)
        logs = _log2_alpha_4(records, offsets, x, y)
        alphas = _alpha_4(logs)
        transmittance, pixel = _behind(alphas[0], transmittance, pixel, records, offsets[0])
        transmittance, pixel = _behind(alphas[1], transmittance, pixel, records, offsets[1])
        transmittance, pixel = _behind(alphas[2], transmittance, pixel, records, offsets[2])
        transmittance, pixel = _behind(alphas[3], transmittance, pixel, records, offsets[3])
        # Written always, counted only if a pixel was touched: a compaction without a branch.
        g0, g1 = get(candidates, begin + i), get(candidates, begin + i + 1)
        g2, g3 = get(candidates, begin + i + 2), get(candidates, begin + i + 3)
        put(lists, begin + kept, g0)
        kept += any_ge(logs[0], _LOG2_ALPHA_MIN)
        put(lists, begin + kept, g1)
        kept += any_ge(logs[1], _LOG2_ALPHA_MIN)
        put(lists, begin + kept, g2)
        kept += any_ge(logs[2], _LOG2_ALPHA_MIN)
        put(lists, begin + kept, g3)
        kept += any_ge(logs[3], _LOG2_ALPHA_MIN)
        i += 4
        if i % _TERMINATION_STRIDE == 0 and not any_ge(transmittance, termination):
            count = i
    while i < count:
        gaussian = get(candidates, begin + i)
        offset = base + np.int64(gaussian) * FIELDS
        log2_alpha = _log2_alpha(records, offset, x, y)
        alpha = _alpha_of(log2_alpha, exp2_blend(log2_alpha))
        transmittance, pixel = _behind(alpha, transmittance, pixel, records, offset)
        put(lists, begin + kept, gaussian)
        kept += any_ge(log2_alpha, _LOG2_ALPHA_MIN)
        i += 1
    store(out, cell * CELL, pixel[0])
    store(out, cell * CELL + LANES, pixel[1])
    store(out, cell * CELL + 2 * LANES, pixel[2])
    store(out, cell * CELL + 3 * LANES, transmittance)
    return kept


@kernel(i64, i64, f32_1, i32_1, f32_1, f32_1, i32_1, i32_1, i64_1, i32_1, f32, i32_1, i32_1, f32_1)
def blend(
    from_task,
    to_task,
    records,
    cell_view,
    x,
    y,
    entry_start,
    entries,
    list_start,
    candidates,
    termination,
    kept,
    lists,
    out,
):
    """Blend all cells.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
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
    for task in range(from_task, to_task):
        for cell in range(task * CELLS_PER_TASK, min(cells, (task + 1) * CELLS_PER_TASK)):
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


@helper()
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


@helper()
def _sum_over_pixels(g, weights, first_weight, table, x_pivot, y_pivot, mean_x, mean_y, shear):
    """Turn [16 Gaussians, 16 pixels] of G and of blending weights into gradient records, one row per Gaussian.

    Moments are first taken about the pivot, a pixel of the cell, then moved to the Gaussian's (t, dy): taken
    about the image's origin they would cancel to three digits.
    """
    m0, mx, my, mxx, mxy, myy = weighted_sums_6(load_transposed(g, 0), table, _MONOMIALS)
    red, green, blue = weighted_sums_3(load_transposed(weights, first_weight), table, _COLOUR_GRADIENTS)
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


@helper()
def _weigh_again(records, base, lists, begin, count, x, y, alphas, weights):
    """Compute alpha and blending weight of a cell's Gaussians once more, front to back, [count * 16] each."""
    transmittance = broadcast(_ONE)
    for i in range(min(count, _AHEAD)):
        _prefetch_record(records, base, lists, begin + i)
    last = begin + count - 1
    i = 0
    while i + 4 <= count:
        for k in range(4):
            _prefetch_record(records, base, lists, min(begin + i + k + _AHEAD, last))
        four = _alpha_4(_log2_alpha_4(records, _offsets_4(base, lists, begin + i), x, y))
        transmittance = _store_weight(alphas, weights, i, four[0], transmittance)
        transmittance = _store_weight(alphas, weights, i + 1, four[1], transmittance)
        transmittance = _store_weight(alphas, weights, i + 2, four[2], transmittance)
        transmittance = _store_weight(alphas, weights, i + 3, four[3], transmittance)
        i += 4
    while i < count:
        log2_alpha = _log2_alpha(records, _offset(base, lists, begin + i), x, y)
        alpha = _alpha_of(log2_alpha, exp2_blend(log2_alpha))
        transmittance = _store_weight(alphas, weights, i, alpha, transmittance)
        i += 1


@helper()
def _store_weight(alphas, weights, i, alpha, transmittance):
    """Store alpha and weight of one Gaussian; return the light behind it."""
    weight = alpha * transmittance
    store(alphas, i * LANES, alpha)
    store(weights, i * LANES, weight)
    return transmittance - weight


@helper()
def _differentiate_cell(records, base, lists, begin, count, x, y, gradients, cell, sums, sums_base, kept, scratch):
    """Add one cell's part to the gradient records of the Gaussians that touched it."""
    g, table, rows, centres = scratch
    alphas, weights = kept
    x_pivot, y_pivot = _fill_table(x, y, gradients, cell, table)
    _weigh_again(
        records,
        base,
        lists,
        begin,
        count,
        load(x, cell * LANES),
        load(y, cell * LANES),
        alphas,
        weights,
    )
    red = load(table, _COLOUR_GRADIENTS)
    green = load(table, _COLOUR_GRADIENTS + LANES)
    blue = load(table, _COLOUR_GRADIENTS + 2 * LANES)
    behind = load(gradients, cell * CELL + 3 * LANES)
    groups = (count + LANES - 1) // LANES
    for k in range(groups):
        group = (groups - 1 - k) * LANES
        present = min(LANES, count - group)
        for i in range(present):
            j = present - 1 - i
            # Of the group after this one, which lies before it in the list.
            offset = base + np.int64(get(lists, begin + group + j)) * FIELDS
            put(centres, j, get(records, offset + MEAN_X))
            put(centres, LANES + j, get(records, offset + MEAN_Y))
            put(centres, 2 * LANES + j, get(records, offset + SHEAR))
            prefetch(sums, offset - base + sums_base)
            alpha = load(alphas, (group + j) * LANES)
            seen = get(records, offset + RED) * red
            seen = seen + get(records, offset + GREEN) * green
            seen = seen + get(records, offset + BLUE) * blue
            more = seen - behind
            behind = behind + alpha * more
            # Where alpha is cut off, nothing moves it.
            slope = where_ge(alpha, _ALPHA_MAX, _ZERO, load(weights, (group + j) * LANES) * more)
            store(g, j * LANES, slope)
        records_of_16 = _sum_over_pixels(
            g,
            weights,
            group * LANES,
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


@kernel(i64, i64, f32_1, i64_1, f32_1, f32_1, i32_1, i32_1, i64_1, i32_1, i64, f32_1, i64, f32_1)
def differentiate_blend(
    from_task, to_task, records, cell_start, x, y, entry_start, kept, list_start, lists, longest, gradients, bands, sums
):
    """Sum the gradients of all cells into one record per Gaussian, view and band.

    Each view's cells are cut into `bands` consecutive parts, and each (view, band) is one task with a record array
    of its own: no two tasks write to one place, and the order of all sums is fixed by `bands` alone, whatever the
    number of threads.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        records: As for `blend`; likewise x, y, entry_start, list_start, lists and kept as it left them.
        cell_start: Of `Layout`, [V + 1].
        x: See `records`.
        y: See `records`.
        entry_start: See `records`.
        kept: See `records`.
        list_start: See `records`.
        lists: See `records`.
        longest: Of all lists, how long.
        gradients: dL/d out, [cells * 64].
        bands: Parts per view.
        sums: Written: [bands, V, blocks * 256], flattened.
    """
    views = cell_start.shape[0] - 1
    record_stride = records.shape[0] // max(views, 1)
    for task in range(from_task, to_task):
        view, band = task // bands, task % bands
        begin = cell_start[view]
        cells = cell_start[view + 1] - begin
        sums_base = (band * views + view) * record_stride
        sums[sums_base : sums_base + record_stride] = _ZERO
        scratch = (
            # Rows beyond a short last group keep older, finite numbers, and their sums are not used.
            aligned_zeros(LANES * LANES),
            aligned_zeros(_TABLE),
            aligned_zeros(LANES * LANES),
            aligned_zeros(3 * LANES),
        )
        room = (longest + LANES) * LANES
        of_list = (aligned_zeros(room), aligned_zeros(room))
        for cell in range(begin + cells * band // bands, begin + cells * (band + 1) // bands):
            _differentiate_cell(
                records,
                view * record_stride,
                lists,
                list_start[view] + entry_start[cell],
                np.int64(kept[cell]),
                x,
                y,
                gradients,
                cell,
                sums,
                sums_base,
                of_list,
                scratch,
            )
