"""Kernels of depth: where the light of each pixel is stopped (`gs2ci.render.stopping` is the definition)."""

import warp as wp
from warp import float32, vec3, vec4

from gs2ci.render import stopping
from gs2ci.render.recording import Floats, Fours, Ints
from gs2ci.render.warp.types import ALPHA_MAX, LN_ALPHA_MIN, Record, ln_alpha

wp.set_module_options({"enable_backward": False})

RATIO_MIN = wp.constant(float32(1.0 / stopping.RATIO_MAX))
REACH = wp.constant(float32(stopping.PROFILE_REACH))
SIGMA_LOW = wp.constant(float32(stopping.PROFILE_SIGMA_RANGE[0]))
SIGMA_HIGH = wp.constant(float32(stopping.PROFILE_SIGMA_RANGE[1]))
SLACK = wp.constant(float32(stopping.QUANTILE_SLACK))
RESOLUTION = wp.constant(float32(2.5 * stopping.RESOLUTION))
"""float32 does not part depths much closer than this."""
MIDDLE = wp.constant(float32(stopping.DEPTH_QUANTILE))
BEFORE = wp.constant(float32(stopping.SPREAD_QUANTILES[0]))
BEYOND = wp.constant(float32(stopping.SPREAD_QUANTILES[1]))
NEARBY = wp.constant(float32(stopping.NEARBY))
MOST_STEPS = wp.constant(64)


@wp.func
def along_ray(field: vec4, dx: float32, dy: float32):
    """Return the depth at which a Gaussian stops light at an offset from its centre, and its profile's reach."""
    share = field[1] * dx + field[2] * dy
    depth = field[0] / wp.max(1.0 - share, RATIO_MIN)
    return depth, REACH * wp.clamp(field[3], SIGMA_LOW * depth, SIGMA_HIGH * depth)


@wp.func
def stopped_before(
    limit: float32,
    start: int,
    count: int,
    rows: Ints,
    owner: Ints,
    records: wp.array(dtype=Record),
    fields: Fours,
    x: float32,
    y: float32,
    termination: float32,
):
    """Return how much of a pixel's light is stopped before a depth."""
    light = float32(1.0)
    total = float32(0.0)
    for k in range(count):
        at = owner[rows[start + k]]
        record = records[at]
        dx = x - record[0]
        dy = y - record[1]
        e = ln_alpha(record, dx, dy)
        if e >= LN_ALPHA_MIN and light >= termination:
            weight = wp.min(wp.exp(e), ALPHA_MAX) * light
            light = light - weight
            depth, reach = along_ray(fields[at], dx, dy)
            t = wp.clamp((limit - depth) / reach, -1.0, 1.0)
            total += weight * (0.5 + 0.75 * t - 0.25 * t * t * t)
    return total


@wp.kernel
def stop_light(
    block_of: Ints,
    begin: Ints,
    end: Ints,
    rows: Ints,
    owner: Ints,
    records: wp.array(dtype=Record),
    fields: Fours,
    xs: Floats,
    ys: Floats,
    termination: float32,
    into: Ints,
    maps: Fours,
):
    """Find depth, spread, stopped and nearby light of each slot, by bisection."""
    slot = wp.tid()
    x = xs[slot]
    y = ys[slot]
    start = begin[block_of[slot]]
    count = end[block_of[slot]] - start
    light = float32(1.0)
    total = float32(0.0)
    nearest = float32(1e38)
    farthest = float32(0.0)
    for k in range(count):
        at = owner[rows[start + k]]
        record = records[at]
        dx = x - record[0]
        dy = y - record[1]
        e = ln_alpha(record, dx, dy)
        if e >= LN_ALPHA_MIN and light >= termination:
            weight = wp.min(wp.exp(e), ALPHA_MAX) * light
            light = light - weight
            total += weight
            depth, reach = along_ray(fields[at], dx, dy)
            nearest = wp.min(nearest, depth - reach)
            farthest = wp.max(farthest, depth + reach)
    found = vec4(0.0, 0.0, 1.0 - light, 0.0)
    if total > 0.0:
        quantiles = vec3()
        for which in range(3):
            share = MIDDLE
            if which == 1:
                share = BEFORE
            if which == 2:
                share = BEYOND
            goal = (share - SLACK) * total
            near = nearest
            far = farthest
            for _ in range(MOST_STEPS):
                if far - near > RESOLUTION * far:
                    middle = 0.5 * (near + far)
                    before = stopped_before(middle, start, count, rows, owner, records, fields, x, y, termination)
                    if before >= goal:
                        far = middle
                    else:
                        near = middle
            quantiles[which] = far
        depth = quantiles[0]
        beyond = stopped_before(depth * (1.0 + NEARBY), start, count, rows, owner, records, fields, x, y, termination)
        before = stopped_before(depth * (1.0 - NEARBY), start, count, rows, owner, records, fields, x, y, termination)
        spread = 0.5 * (depth / quantiles[1] - depth / quantiles[2])
        found = vec4(depth, spread, 1.0 - light, beyond - before)
    maps[into[slot]] = found
