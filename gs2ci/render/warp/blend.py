"""Kernels, one block of threads for each block of pixels: blending, its gradient, and the coded sum."""

import warp as wp
from warp import float32, int32, vec3, vec4

from gs2ci.render.recording import TILED, Floats, Fours, Ints
from gs2ci.render.warp.types import ALPHA_MAX, LN_ALPHA_MIN, B, H, Held, Monomials, Record, Row, ln_alpha

wp.set_module_options({"enable_backward": False})


@wp.kernel(module="unique", module_options=TILED)
def blend(
    first: Ints,
    begin: Ints,
    end: Ints,
    rows: Ints,
    owner: Ints,
    records: wp.array(dtype=Record),
    xs: Floats,
    ys: Floats,
    termination: float32,
    out: Fours,
    last: Ints,
):
    """Blend a block's Gaussians front to back: colour and light left of each slot, and how many it has passed."""
    block, lane = wp.tid()
    present = first[block + 1] - first[block]
    slot = first[block] + wp.min(lane, present - 1)
    x = xs[slot]
    y = ys[slot]
    start = begin[block]
    count = end[block] - start
    light = float32(1.0)
    colour = vec3()
    mine = int32(0)
    for batch in range(0, count, B):
        index = int32(-1)
        if batch + lane < count:
            index = owner[rows[start + batch + lane]]
        shared = wp.tile_load_indexed(records, indices=wp.tile(index), shape=(B,), storage="shared")
        if light >= termination:
            for j in range(wp.min(B, count - batch)):
                record = shared[j]
                e = ln_alpha(record, x - record[0], y - record[1])
                if e >= LN_ALPHA_MIN and light >= termination:
                    weight = wp.min(wp.exp(e), ALPHA_MAX) * light
                    colour += weight * vec3(record[6], record[7], record[8])
                    light = light - weight
                    mine = batch + j + 1
        brightest = wp.tile_max(wp.tile(light))
        if brightest[0] < termination:
            break
    if lane < present:
        out[slot] = vec4(colour[0], colour[1], colour[2], light)
        last[slot] = mine


@wp.kernel
def gather(
    start: Ints,
    slots: Ints,
    weight: Floats,
    blended: Fours,
    out: Fours,
):
    """Sum the weighted colours of an output's slots in the order of views, and the light that they let pass."""
    into = wp.tid()
    total = vec4()
    for k in range(start[into], start[into + 1]):
        slot = slots[k]
        total += weight[slot] * blended[slot]
    out[into] = total


@wp.kernel(module="unique", module_options=TILED)
def blend_backward(
    first: Ints,
    begin: Ints,
    end: Ints,
    rows: Ints,
    owner: Ints,
    records: wp.array(dtype=Record),
    xs: Floats,
    ys: Floats,
    out: Fours,
    last: Ints,
    into: Ints,
    weight: Floats,
    gradient: Fours,
    sums: wp.array(dtype=Row),
):
    """Differentiate back to front, `HELD` Gaussians at a time.

    G and w of these stand in registers; two products with the monomials of the pixels' places and with their colour
    gradients replace nine sums over pixels for each Gaussian. Each entry of a list owns a row: nothing is added twice.
    """
    block, lane = wp.tid()
    present = first[block + 1] - first[block]
    slot = first[block] + wp.min(lane, present - 1)
    x = xs[slot]
    y = ys[slot]
    # Moments are taken about the block's first pixel, then moved to each Gaussian.
    px = xs[first[block]]
    py = ys[first[block]]
    v = vec3()
    behind = float32(0.0)
    mine = int32(0)
    light = out[slot][3]
    if lane < present:
        pulled = weight[slot] * gradient[into[slot]]
        v = vec3(pulled[0], pulled[1], pulled[2])
        behind = pulled[3]
        mine = last[slot]
    qx = x - px
    qy = y - py
    monomials = wp.tile_transpose(wp.tile(Monomials(1.0, qx, qy, qx * qx, qx * qy, qy * qy)))
    by_colour = wp.tile_transpose(wp.tile(v))
    start = begin[block]
    count = end[block] - start
    longest = wp.tile_max(wp.tile(mine))
    batches = (longest[0] + B - 1) // B
    # What lies behind the last batch has no light; its rows are written too, so that none keeps what it held before.
    for at in range(start + batches * B + lane, start + count, B):
        sums[rows[at]] = Row()
    for back in range(batches):
        batch = (batches - 1 - back) * B
        index = int32(-1)
        if batch + lane < count:
            index = owner[rows[start + batch + lane]]
        shared = wp.tile_load_indexed(records, indices=wp.tile(index), shape=(B,), storage="shared")
        for part in range(B // H):
            begun = B - H - part * H
            gs = Held()
            ws = Held()
            for k in range(H):
                j = H - 1 - k
                if batch + begun + j < mine:
                    record = shared[begun + j]
                    e = ln_alpha(record, x - record[0], y - record[1])
                    if e >= LN_ALPHA_MIN:
                        raw = wp.exp(e)
                        alpha = wp.min(raw, ALPHA_MAX)
                        light = light / (1.0 - alpha)
                        w = alpha * light
                        more = wp.dot(vec3(record[6], record[7], record[8]), v) - behind
                        behind += alpha * more
                        ws[j] = w
                        if raw < ALPHA_MAX:
                            gs[j] = w * more
            of_shape = wp.tile_matmul(wp.tile(gs), monomials)
            of_colour = wp.tile_matmul(wp.tile(ws), by_colour)
            if lane < H and batch + begun + lane < count:
                row = rows[start + batch + begun + lane]
                record = shared[begun + lane]
                m0 = of_shape[lane, 0]
                m1 = of_shape[lane, 1]
                m2 = of_shape[lane, 2]
                shear = record[3]
                ty = py - record[1]
                tt = (px - record[0]) + shear * ty
                mt = m1 + shear * m2
                mty = of_shape[lane, 4] + shear * of_shape[lane, 5]
                mtt = of_shape[lane, 3] + shear * (of_shape[lane, 4] + mty)
                st = mt + tt * m0
                sy = m2 + ty * m0
                sums[row] = Row(
                    m0,
                    st,
                    sy,
                    mtt + tt * (mt + st),
                    mty + tt * m2 + ty * st,
                    of_shape[lane, 5] + ty * (m2 + sy),
                    of_colour[lane, 0],
                    of_colour[lane, 1],
                    of_colour[lane, 2],
                )
