"""Which Gaussians touch which cell, front to back.

Per view: spans (the cells that a Gaussian's footprint touches in each strip of rows), a stable radix sort of the
visible Gaussians by depth, then one pass in depth order that appends each Gaussian to its cells' lists. The lists
come out sorted without ever sorting (cell, depth) pairs. Equal depths keep the order of the parameters. Views are
independent tasks. Only `gs2ci.render.cpu` imports this file.
"""

import numpy as np
from numba import prange

from gs2ci.render.cpu.compile import kernel
from gs2ci.render.cpu.lanes import load_transposed
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
    SHEAR,
    VISIBLE,
    WIDEST_DY,
)
from gs2ci.render.cpu.vector import (
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

_HALF = np.float32(0.5)
_ZERO = np.float32(0)
_ONE = np.float32(1)
_MINUS_ONE = np.float32(-1)
# Spans may be too wide, never too narrow (blending tests each pixel itself): so rounding gets this much room, in
# px and as a share of the footprint.
_GUARD_PX = np.float32(1e-3)
_GUARD_SHARE = np.float32(1e-6)

_DIGIT_BITS = 11
_DIGITS = 3
_BUCKETS = 1 << _DIGIT_BITS
_DIGIT_MASK = np.uint32(_BUCKETS - 1)


@kernel()
def _strip_range(fields, strip_rows, height):
    """Find the pixel rows of 16 footprints (first and last, as floats) and the strips these lie in.

    Lanes that touch no row get a last strip below the first.
    """
    mean_y, extent = fields[MEAN_Y], fields[EXTENT_Y]
    guard = _GUARD_PX + _GUARD_SHARE * extent
    # Row r has its centre at r + 1/2. The bounds also keep what an unseen lane holds (NaN included) harmless.
    top = minimum(maximum(ceil(maximum(mean_y - extent - guard, _MINUS_ONE) - _HALF), _ZERO), height)
    bottom = minimum(floor(minimum(mean_y + extent + guard, height + _ONE) - _HALF), height - _ONE)
    # Half a row keeps the quotient away from whole numbers, where rounding could fall on either side.
    rows = np.float32(strip_rows)
    first = floor((top + _HALF) / rows)
    last = where_ge(bottom, top, floor((bottom + _HALF) / rows), first - _ONE)
    return top, bottom, first, where_ge(fields[VISIBLE], _HALF, last, first - _ONE)


@kernel()
def _columns_in_strip(fields, top, bottom, width):
    """Find the first and last pixel column of 16 footprints between two pixel rows (one pair per lane).

    On a row at dy the footprint spans -SHEAR dy +- sqrt((LEVEL - ALONG dy^2) / ACROSS). Its right edge is a
    concave function of dy with its top at WIDEST_DY, its left edge the mirror image: so the extremes over the
    strip lie at +-WIDEST_DY, or at the strip's border nearest to it.
    """
    above, below = top + _HALF - fields[MEAN_Y], bottom + _HALF - fields[MEAN_Y]
    widest = fields[WIDEST_DY]
    dy_right = minimum(maximum(widest, above), below)
    dy_left = minimum(maximum(-widest, above), below)
    right = fields[MEAN_X] - fields[SHEAR] * dy_right + _half_width(fields, dy_right)
    left = fields[MEAN_X] - fields[SHEAR] * dy_left - _half_width(fields, dy_left)
    guard = _GUARD_PX + _GUARD_SHARE * fields[EXTENT_X]
    first = maximum(ceil(minimum(maximum(left - guard, _MINUS_ONE), width + _ONE) - _HALF), _ZERO)
    last = minimum(floor(maximum(minimum(right + guard, width + _ONE), _MINUS_ONE) - _HALF), width - _ONE)
    return first, last


@kernel()
def _half_width(fields, dy):
    inside = maximum(fields[LEVEL] - fields[ALONG] * dy * dy, _ZERO)
    return square_root(inside * fields[INVERSE_ACROSS])


@kernel()
def _measure_spans(fields, strip_rows, height, width, first_strip, strip_count, columns):
    """Write the column intervals of 16 footprints, strip by strip, into `columns` [strips, 2, 16] int32."""
    top, bottom, first, last = _strip_range(fields, strip_rows, height)
    rows = np.float32(strip_rows)
    store_as_int32(first_strip, 0, first)
    store_as_int32(strip_count, 0, last - first + _ONE)
    strip = 0
    while any_ge(last, first + np.float32(strip)):
        strip_top = (first + np.float32(strip)) * rows
        left, right = _columns_in_strip(
            fields, maximum(strip_top, top), minimum(strip_top + (rows - _ONE), bottom), width
        )
        store_as_int32(columns, 2 * LANES * strip, left)
        store_as_int32(columns, 2 * LANES * strip + LANES, right)
        strip += 1


@kernel()
def _find_spans(records, depth_bits, size, strip_rows, first, last, changes, spans, span_start, keys, order):
    """List the cell spans of one view's Gaussians; return how many Gaussians have any, or OVERFLOW.

    Args:
        records: [blocks * 256] of this view.
        depth_bits: The same memory as uint32: positive floats compare like their bits.
        size: Height and width, px.
        strip_rows: Rows in a strip.
        first: Cell tables of `Layout`, this view's, [strips, W] flattened.
        last: Likewise.
        changes: Zeros [cells + 1] int32; gets the derivative of each cell's number of Gaussians.
        spans: Written: first and last cell of each span, [capacity * 2] int32.
        span_start: Written: where each Gaussian's spans begin, [G + 1] int32.
        keys: Written: depths of the Gaussians with spans, [G] uint32.
        order: Written: their indices, [G] int32.
    """
    height, width = size
    strips = (height + strip_rows - 1) // strip_rows
    count = span_start.shape[0] - 1
    columns = np.empty(2 * LANES * strips, np.int32)
    first_strip = np.empty(LANES, np.int32)
    strip_count = np.empty(LANES, np.int32)
    capacity = spans.shape[0] // 2
    used = 0
    listed = 0
    for block in range((count + LANES - 1) // LANES):
        offset = block * LANES * FIELDS
        _measure_spans(
            load_transposed(records, offset),
            strip_rows,
            np.float32(height),
            np.float32(width),
            first_strip,
            strip_count,
            columns,
        )
        if used + LANES * strips > capacity:
            return OVERFLOW
        for lane in range(min(LANES, count - block * LANES)):
            put(span_start, block * LANES + lane, np.int32(used))
            before = used
            for strip in range(get(strip_count, lane)):
                left = get(columns, 2 * LANES * strip + lane)
                right = get(columns, 2 * LANES * strip + LANES + lane)
                if right < left:
                    continue
                row = (get(first_strip, lane) + strip) * width
                from_cell, to_cell = get(first, row + left), get(last, row + right)
                if to_cell < from_cell:
                    continue
                put(spans, 2 * used, from_cell)
                put(spans, 2 * used + 1, to_cell)
                put(changes, from_cell, get(changes, from_cell) + np.int32(1))
                put(changes, to_cell + 1, get(changes, to_cell + 1) - np.int32(1))
                used += 1
            if used > before:
                put(keys, listed, get(depth_bits, offset + lane * FIELDS + DEPTH))
                put(order, listed, np.int32(block * LANES + lane))
                listed += 1
    span_start[count] = used
    return listed


@kernel()
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


@kernel(parallel=True)
def count_entries(
    records,
    depth_bits,
    size,
    strip_rows,
    first,
    last,
    cell_start,
    spans,
    span_start,
    work,
    order,
    listed,
    entries,
    entry_start,
    totals,
):
    """Find all spans, count each cell's Gaussians and sort the Gaussians of each view by depth.

    Args:
        records: [V, blocks * 256] float32; `depth_bits` is the same memory as uint32.
        depth_bits: See `records`.
        size: Height and width, px.
        strip_rows: Rows in a strip.
        first: Cell tables of `Layout`, [V, strips * W].
        last: Likewise.
        cell_start: Of `Layout`, [V + 1].
        spans: Written: [V, capacity * 2] int32.
        span_start: Written: [V, G + 1] int32.
        work: Scratch, [V, 3, G] uint32.
        order: Written: Gaussians with spans by depth, [V, G] int32, the first listed[v] of each row.
        listed: Written: [V] int64.
        entries: Written: Gaussians per cell, [cells] int32.
        entry_start: Written: where each cell's list begins within its view's, [cells] int32.
        totals: Written: entries per view, [V] int64, or OVERFLOW where the span capacity did not suffice.
    """
    for view in prange(records.shape[0]):
        begin, end = cell_start[view], cell_start[view + 1]
        changes = np.zeros(end - begin + 1, np.int32)
        indices = work[view, 1].view(np.int32)
        found = _find_spans(
            records[view],
            depth_bits[view],
            size,
            strip_rows,
            first[view],
            last[view],
            changes,
            spans[view],
            span_start[view],
            work[view, 0],
            indices,
        )
        if found == OVERFLOW:
            totals[view] = OVERFLOW
            continue
        # An odd number of digits leaves the sorted indices in the spare array, where they are wanted.
        _sort_by_key(work[view, 0], indices, found, work[view, 2], order[view])
        listed[view] = found
        running = 0
        total = 0
        for cell in range(end - begin):
            running += changes[cell]
            entries[begin + cell] = running
            entry_start[begin + cell] = total
            total += running
        totals[view] = total


@kernel(parallel=True)
def fill_entries(cell_start, spans, span_start, order, listed, entry_start, list_start, lists):
    """Append each Gaussian, front to back, to the lists of the cells it touches.

    Args:
        cell_start: Of `Layout`, [V + 1].
        spans: As `count_entries` left it; likewise span_start, order, listed and entry_start.
        span_start: See `spans`.
        order: See `spans`.
        listed: See `spans`.
        entry_start: See `spans`.
        list_start: Where each view's lists begin, [V + 1] int64.
        lists: Written: indices of Gaussians, [entries in all] int32.
    """
    ahead_of_starts, ahead_of_spans = 16, 8
    for view in prange(order.shape[0]):
        next_entry = entry_start[cell_start[view] : cell_start[view + 1]].copy()
        starts, view_spans, by_depth = span_start[view], spans[view], order[view]
        base, count = list_start[view], listed[view]
        for i in range(count):
            gaussian = get(by_depth, i)
            prefetch(starts, np.int64(get(by_depth, min(i + ahead_of_starts, count - 1))))
            soon = get(by_depth, min(i + ahead_of_spans, count - 1))
            prefetch(view_spans, 2 * np.int64(get(starts, soon)))
            for span in range(get(starts, gaussian), get(starts, gaussian + 1)):
                for cell in range(get(view_spans, 2 * span), get(view_spans, 2 * span + 1) + 1):
                    position = get(next_entry, cell)
                    put(next_entry, cell, position + np.int32(1))
                    put(lists, base + position, gaussian)
