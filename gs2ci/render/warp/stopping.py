"""Kernels of depth: where the light of each pixel is stopped (`gs2ci.render.stopping` is the definition)."""

import warp as wp
from warp import float32, float64, vec3, vec3d, vec4

from gs2ci.render import conventions, stopping
from gs2ci.render.recording import Floats, Fours, Ints, Vectors
from gs2ci.render.warp.types import ALPHA_MAX, LN_ALPHA_MIN, Pose, Record, TiledCamera, ln_alpha

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
DILATION = wp.constant(float64(conventions.DILATION_PX2))
NEAR = wp.constant(float64(conventions.NEAR))
NORM2_MIN = wp.constant(float64(conventions.QUATERNION_NORM_MIN**2))
LOG_SCALE_MAX = wp.constant(float64(conventions.LOG_SCALE_MAX))
_0 = wp.constant(float64(0.0))
_1 = wp.constant(float64(1.0))
_2 = wp.constant(float64(2.0))


@wp.kernel
def depth_fields(
    means: Vectors,
    mean_stride: int,
    log_scales: Vectors,
    quaternions: Fours,
    poses: wp.array(dtype=Pose),
    camera: TiledCamera,
    fields: Fours,
):
    """Find each Gaussian's depth, its slopes by pixel and its thickness along the ray, in each view, in float64."""
    view, g = wp.tid()
    count = log_scales.shape[0]
    q = wp.vec4d(quaternions[g])
    n2 = wp.dot(q, q)
    inverse = _0
    if n2 >= NORM2_MIN:
        inverse = _1 / wp.sqrt(n2)
    w = q[0] * inverse
    x = q[1] * inverse
    y = q[2] * inverse
    z = q[3] * inverse
    s = vec3d(log_scales[g])
    scale = vec3d(
        wp.exp(wp.min(s[0], LOG_SCALE_MAX)), wp.exp(wp.min(s[1], LOG_SCALE_MAX)), wp.exp(wp.min(s[2], LOG_SCALE_MAX))
    )
    r = wp.mat33d(
        _1 - _2 * (y * y + z * z),
        _2 * (x * y - w * z),
        _2 * (x * z + w * y),
        _2 * (x * y + w * z),
        _1 - _2 * (x * x + z * z),
        _2 * (y * z - w * x),
        _2 * (x * z - w * y),
        _2 * (y * z + w * x),
        _1 - _2 * (x * x + y * y),
    )
    along = wp.transpose(r * wp.diag(scale))
    pose = poses[view]
    mean = vec3d(means[view * mean_stride + g])
    w0 = vec3d(vec3(pose[0, 0], pose[0, 1], pose[0, 2]))
    w1 = vec3d(vec3(pose[1, 0], pose[1, 1], pose[1, 2]))
    w2 = vec3d(vec3(pose[2, 0], pose[2, 1], pose[2, 2]))
    px = wp.dot(w0, mean) + float64(pose[0, 3])
    py = wp.dot(w1, mean) + float64(pose[1, 3])
    pz = wp.dot(w2, mean) + float64(pose[2, 3])
    iz = _1 / wp.max(pz, NEAR)
    u = wp.clamp(px * iz, float64(camera.u_low), float64(camera.u_high))
    v = wp.clamp(py * iz, float64(camera.v_low), float64(camera.v_high))
    a = along * ((w0 - w2 * u) * (float64(camera.fx) * iz))
    b = along * ((w1 - w2 * v) * (float64(camera.fy) * iz))
    c = along * w2
    aa = wp.dot(a, a)
    bb = wp.dot(b, b)
    ab = wp.dot(a, b)
    n = wp.cross(a, b)
    determinant = wp.dot(n, n) + DILATION * (aa + bb + DILATION)
    with_x = wp.dot(a, c)
    with_y = wp.dot(b, c)
    slope_x = ((bb + DILATION) * with_x - ab * with_y) / determinant
    slope_y = ((aa + DILATION) * with_y - ab * with_x) / determinant
    variance = wp.dot(c, c) - slope_x * with_x - slope_y * with_y
    fields[view * count + g] = vec4(
        float32(pz), float32(slope_x), float32(slope_y), float32(wp.sqrt(wp.max(variance, _0)))
    )


@wp.func
def along_ray(field: vec4, dx: float32, dy: float32):
    """Return the depth at which a Gaussian stops light at an offset from its centre, and its profile's reach."""
    share = (field[1] * dx + field[2] * dy) / field[0]
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
