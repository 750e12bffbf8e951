"""Which Gaussians touch which cell, front to back.

Per view: the Gaussians that are visible, or nearly so, are sorted by depth (stable radix sort: equal depths keep the
order of the parameters). In that order, sixteen at a time, their spans are found: the cells that a footprint touches in
each strip of rows. One more pass over the spans appends each Gaussian to its cells' lists, which thus come out sorted
without ever sorting (cell, depth) pairs. Views are independent tasks.
"""

import numpy as np

from gs2ci.core.kernels import f32, f32_2, helper, i32_1, i32_2, i64, i64_1, kernel, u32_2, u32_3
from gs2ci.render.cpu.record import (
    ALONG,
    DEPTH,
    EXTENT_X,
    EXTENT_Y,
    FIELDS,
    INVERSE_ACROSS,
    LEVEL,
    MEAN_X,
    MEAN_Y,
    NEARLY,
    SHEAR,
    VISIBLE,
    WIDEST_DY,
)
from gs2ci.render.simd.lanes import gather_transposed
from gs2ci.render.simd.vector import (
    LANES,
    any_ge,
    ceil,
    floor,
    get,
    maximum,
    minimum,
    prefetch,
    put,
    square_root,
    store_as_int32,
    where_ge,
)

OVERFLOW = -1
SPAN = 3
"""Numbers in a span: the Gaussian, its first and its last cell in a strip."""

_HALF = np.float32(0.5)
_ZERO = np.float32(0)
_ONE = np.float32(1)
_MINUS_ONE = np.float32(-1)
# Spans may be too wide, never too narrow (blending tests each pixel itself): so rounding gets this much room, in
# px and as a share of the footprint.
_GUARD_PX = np.float32(1e-3)
_GUARD_SHARE = np.float32(1e-6)
_LISTED = np.float32(NEARLY)

_DIGIT_BITS = 11
_DIGITS = 3
_BUCKETS = 1 << _DIGIT_BITS
_DIGIT_MASK = np.uint32(_BUCKETS - 1)


@helper()
def _strip_range(fields, strip_rows, margin, height):
    """Find the pixel rows of 16 footprints, widened (first and last, as floats), and the strips these lie in.

    Lanes that touch no row get a last strip below the first.
    """
    mean_y, extent = fields[MEAN_Y], fields[EXTENT_Y]
    guard = _GUARD_PX + _GUARD_SHARE * extent + margin
    # Row r has its centre at r + 1/2. The bounds also keep what an unseen lane holds (NaN included) harmless.
    top = minimum(maximum(ceil(maximum(mean_y - extent - guard, _MINUS_ONE) - _HALF), _ZERO), height)
    bottom = minimum(floor(minimum(mean_y + extent + guard, height + _ONE) - _HALF), height - _ONE)
    # Half a row keeps the quotient away from whole numbers, where rounding could fall on either side.
    rows = np.float32(strip_rows)
    first = floor((top + _HALF) / rows)
    last = where_ge(bottom, top, floor((bottom + _HALF) / rows), first - _ONE)
    return top, bottom, first, where_ge(fields[VISIBLE], _LISTED, last, first - _ONE)


@helper()
def _columns_in_strip(fields, top, bottom, margin, width):
    """Find the first and last pixel column of 16 footprints, widened, between two pixel rows (one pair per lane).

    On a row at dy the footprint spans -SHEAR dy +- sqrt((LEVEL - ALONG dy^2) / ACROSS). Its right edge is a
    concave function of dy with its top at WIDEST_DY, its left edge the mirror image: so the extremes over the
    strip lie at +-WIDEST_DY, or at the strip's border nearest to it. Widening moves the footprint by up to the margin
    along both axes.
    """
    above, below = top + _HALF - fields[MEAN_Y] - margin, bottom + _HALF - fields[MEAN_Y] + margin
    widest = fields[WIDEST_DY]
    dy_right = minimum(maximum(widest, above), below)
    dy_left = minimum(maximum(-widest, above), below)
    right = fields[MEAN_X] - fields[SHEAR] * dy_right + _half_width(fields, dy_right)
    left = fields[MEAN_X] - fields[SHEAR] * dy_left - _half_width(fields, dy_left)
    guard = _GUARD_PX + _GUARD_SHARE * fields[EXTENT_X] + margin
    first = maximum(ceil(minimum(maximum(left - guard, _MINUS_ONE), width + _ONE) - _HALF), _ZERO)
    last = minimum(floor(maximum(minimum(right + guard, width + _ONE), _MINUS_ONE) - _HALF), width - _ONE)
    return first, last


@helper()
def _half_width(fields, dy):
    inside = maximum(fields[LEVEL] - fields[ALONG] * dy * dy, _ZERO)
    return square_root(inside * fields[INVERSE_ACROSS])


@helper()
def _measure_spans(fields, strip_rows, margin, height, width, first_strip, strip_count, columns):
    """Write the column intervals of 16 footprints, strip by strip, into `columns` [strips, 2, 16] int32."""
    top, bottom, first, last = _strip_range(fields, strip_rows, margin, height)
    rows = np.float32(strip_rows)
    store_as_int32(first_strip, 0, first)
    store_as_int32(strip_count, 0, last - first + _ONE)
    strip = 0
    while any_ge(last, first + np.float32(strip)):
        strip_top = (first + np.float32(strip)) * rows
        left, right = _columns_in_strip(
            fields, maximum(strip_top, top), minimum(strip_top + (rows - _ONE), bottom), margin, width
        )
        store_as_int32(columns, 2 * LANES * strip, left)
        store_as_int32(columns, 2 * LANES * strip + LANES, right)
        strip += 1


@helper()
def _list_visible(records, depth_bits, count, keys, indices):
    """List depth keys and indices of the Gaussians that one view is to list; returns how many there are."""
    listed = 0
    for gaussian in range(count):
        offset = gaussian * FIELDS
        # Written always, counted only if it is to be listed: no branch to mispredict.
        put(keys, listed, get(depth_bits, offset + DEPTH))
        put(indices, listed, np.int32(gaussian))
        listed += get(records, offset + VISIBLE) >= _LISTED
    return listed


@helper()
def _find_spans(records, by_depth, listed, size, strip_rows, margin, first, last, changes, spans):
    """List the cell spans of one view's Gaussians, front to back; returns how many there are, or OVERFLOW.

    Args:
        records: [blocks * 256] of this view.
        by_depth: Indices of the Gaussians to list, nearest first, [G + 16] int32.
        listed: How many those are.
        size: Height and width, px.
        strip_rows: Rows in a strip.
        margin: By which footprints are widened on all sides, px.
        first: Cell tables of `Layout`, this view's, [strips * W].
        last: Likewise.
        changes: Zeros [cells + 1] int32; gets the derivative of each cell's number of Gaussians.
        spans: Written: Gaussian, first and last cell of each span, [capacity * 3] int32.
    """
    height, width = size
    strips = (height + strip_rows - 1) // strip_rows
    capacity = spans.shape[0] // SPAN
    columns = np.empty(2 * LANES * strips, np.int32)
    first_strip = np.empty(LANES, np.int32)
    strip_count = np.empty(LANES, np.int32)
    for lane in range(LANES):
        by_depth[listed + lane] = by_depth[max(listed - 1, 0)]
    used = 0
    for group in range(0, listed, LANES):
        if used + LANES * strips > capacity:
            return OVERFLOW
        fields = gather_transposed(records, by_depth, group)
        for lane in range(LANES):
            prefetch(records, np.int64(get(by_depth, min(group + LANES + lane, listed))) * FIELDS)
        _measure_spans(
            fields, strip_rows, margin, np.float32(height), np.float32(width), first_strip, strip_count, columns
        )
        for lane in range(min(LANES, listed - group)):
            gaussian = get(by_depth, group + lane)
            table = np.int64(get(first_strip, lane)) * width
            for strip in range(get(strip_count, lane)):
                left = get(columns, 2 * LANES * strip + lane)
                right = get(columns, 2 * LANES * strip + LANES + lane)
                row = table + strip * width
                if right < left:
                    continue
                from_cell, to_cell = get(first, row + left), get(last, row + right)
                if to_cell < from_cell:
                    continue
                put(spans, SPAN * used, gaussian)
                put(spans, SPAN * used + 1, from_cell)
                put(spans, SPAN * used + 2, to_cell)
                put(changes, from_cell, get(changes, from_cell) + np.int32(1))
                put(changes, to_cell + 1, get(changes, to_cell + 1) - np.int32(1))
                used += 1
    return used


@helper()
def _sort_by_key(keys, values, count, spare_keys, spare_values):
    """Sort pairs by key, stably, three digits of eleven bits; the sorted values end in `spare_values`."""
    ends = np.empty(_BUCKETS, np.int32)
    for digit in range(_DIGITS):
        shift = np.uint32(_DIGIT_BITS * digit)
        ends[:] = 0
        for i in range(count):
            ends[(keys[i] >> shift) & _DIGIT_MASK] += 1
        start = 0
        for bucket in range(_BUCKETS):
            size = ends[bucket]
            ends[bucket] = start
            start += size
        for i in range(count):
            bucket = (keys[i] >> shift) & _DIGIT_MASK
            j = ends[bucket]
            ends[bucket] = j + 1
            spare_keys[j] = keys[i]
            spare_values[j] = values[i]
        keys, spare_keys = spare_keys, keys
        values, spare_values = spare_values, values


@kernel(
    *(i64, i64, f32_2, u32_2, i64, (i64, i64), i64, f32, i32_2, i32_2, i64_1),
    *(u32_3, i32_2, i64_1, i32_1, i32_1, i64_1),
)
def count_entries(
    from_task,
    to_task,
    records,
    depth_bits,
    count,
    size,
    strip_rows,
    margin,
    first,
    last,
    cell_start,
    work,
    spans,
    found,
    entries,
    entry_start,
    totals,
):
    """Find all spans, front to back, and count each cell's Gaussians.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        records: [V, blocks * 256] float32; `depth_bits` is the same memory as uint32.
        depth_bits: See `records`. Positive floats compare like their bits.
        count: G.
        size: Height and width, px.
        strip_rows: Rows in a strip.
        margin: By which footprints are widened on all sides, px, float32.
        first: Cell tables of `Layout`, [V, strips * W].
        last: Likewise.
        cell_start: Of `Layout`, [V + 1].
        work: Scratch, [V, 4, G + 16] uint32.
        spans: Written: [V, capacity * 3] int32.
        found: Written: spans per view, [V] int64, or OVERFLOW where the capacity did not suffice.
        entries: Written: Gaussians per cell, [cells] int32.
        entry_start: Written: where each cell's list begins within its view's, [cells] int32.
        totals: Written: entries per view, [V] int64.
    """
    for view in range(from_task, to_task):
        begin, end = cell_start[view], cell_start[view + 1]
        changes = np.zeros(end - begin + 1, np.int32)
        keys, spare_keys = work[view, 0], work[view, 1]
        indices, by_depth = work[view, 2].view(np.int32), work[view, 3].view(np.int32)
        listed = _list_visible(records[view], depth_bits[view], count, keys, indices)
        # An odd number of digits leaves the sorted indices in the spare array.
        _sort_by_key(keys, indices, listed, spare_keys, by_depth)
        found[view] = _find_spans(
            records[view], by_depth, listed, size, strip_rows, margin, first[view], last[view], changes, spans[view]
        )
        running = 0
        total = 0
        for cell in range(end - begin):
            running += changes[cell]
            entries[begin + cell] = running
            entry_start[begin + cell] = total
            total += running
        totals[view] = total


@kernel(i64, i64, i64_1, i32_2, i64_1, i32_1, i64_1, i32_1)
def fill_entries(from_task, to_task, cell_start, spans, found, entry_start, list_start, lists):
    """Append each Gaussian, front to back, to the lists of the cells it touches.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        cell_start: Of `Layout`, [V + 1].
        spans: As `count_entries` left it; likewise found and entry_start.
        found: See `spans`.
        entry_start: See `spans`.
        list_start: Where each view's lists begin, [V + 1] int64.
        lists: Written: indices of Gaussians, [entries in all] int32.
    """
    for view in range(from_task, to_task):
        next_entry = entry_start[cell_start[view] : cell_start[view + 1]].copy()
        view_spans, base = spans[view], list_start[view]
        for span in range(0, found[view] * SPAN, SPAN):
            gaussian = get(view_spans, span)
            for cell in range(get(view_spans, span + 1), get(view_spans, span + 2) + 1):
                position = get(next_entry, cell)
                put(next_entry, cell, position + np.int32(1))
                put(lists, base + position, gaussian)
