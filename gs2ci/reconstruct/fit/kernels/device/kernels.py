"""The kernels of a fit in Warp, one thread for each Gaussian or pixel; sums block by block, always in one order.

No float is added atomically. In float64 where the CPU's kernels of the same name are (`calls.py`), which say what is
computed and why. Here: the kernels. Not here: their launches (`calls.py`), those of the loss
(`losses/device_loss_kernels.py`).
"""

from typing import Any, Final

import warp as wp
from warp import float32, float64, mat44d, vec3, vec3d

from gs2ci.reconstruct.fit.kernels import distances
from gs2ci.render.recording import TILED, Doubles, Floats, Vectors

wp.set_module_options({"enable_backward": False})

SUMMED = wp.constant(256)
"""Threads of a block that sums."""
PER_THREAD = wp.constant(4)
"""Numbers that each of them takes."""

MOST_GROWTH = wp.constant(float64(distances.MOST_GROWTH))
FARTHEST = wp.constant(float64(distances.FARTHEST))
_0 = wp.constant(float64(0.0))
_1 = wp.constant(float64(1.0))
_2 = wp.constant(float64(2.0))
CHUNK = wp.constant(SUMMED * PER_THREAD)

Six = wp.types.vector(length=6, dtype=float32)


@wp.func
def sum_of_block(mine: float64):
    """Return the sum over the threads of a block; all of them have to ask, since on CUDA each waits for the others."""
    found = wp.tile_sum(wp.tile(mine))
    return found[0]


@wp.func
def most_growth(distance: float64):
    """See `distances.most_growth`."""
    return wp.min(MOST_GROWTH, wp.max(FARTHEST / distance - _1, _0))


@wp.func
def bounded(growth: float64, distance: float64):
    """See `distances.bounded`."""
    return wp.min(wp.max(growth, -MOST_GROWTH), most_growth(distance))


@wp.func
def enlarge(log_scales: Vectors, g: int, by: float64):
    """Add to the log sizes of a Gaussian."""
    larger = float32(by)
    log_scales[g] = log_scales[g] + vec3(larger, larger, larger)


# ---------------------------------------------------------------------------------------------------------- steps


@wp.kernel
def adam_step(parameter: Floats, gradient: Floats, mean: Floats, square: Floats, constants: Six):
    """See `gaussian_kernels.adam_step`."""
    i = wp.tid()
    m = mean[i] + constants[0] * (gradient[i] - mean[i])
    v = constants[1] * square[i] + constants[2] * gradient[i] * gradient[i]
    mean[i] = m
    square[i] = v
    parameter[i] = parameter[i] - constants[5] * m / (wp.sqrt(v) * constants[3] + constants[4])


@wp.func
def sum_of(v: vec3):
    """Return the sum of a vector's components in float64."""
    return float64(v[0]) + float64(v[1]) + float64(v[2])


@wp.kernel
def gradient_in_view(
    means: Vectors, by_means: Vectors, by_log_scales: Vectors, pose: mat44d, near: float64, gradient: Vectors
):
    """See `view_steps.gradient_in_view`."""
    g = wp.tid()
    seen = wp.transform_point(pose, vec3d(means[g]))
    d = wp.transform_vector(pose, vec3d(by_means[g]))
    z = seen[2]
    if z > near:
        d = vec3d(z * d[0], z * d[1], -z * (wp.dot(seen, d) + sum_of(by_log_scales[g])))
    gradient[g] = vec3(d)


@wp.kernel
def move_in_view(
    means: Vectors,
    log_scales: Vectors,
    steps: Vectors,
    pose: mat44d,
    near: float64,
    across: float64,
    inverse: float64,
):
    """See `view_steps.move_in_view`."""
    g = wp.tid()
    seen = wp.transform_point(pose, vec3d(means[g]))
    wanted = vec3d(steps[g])
    moved = across * wanted
    z = seen[2]
    if z > near:
        most = most_growth(z)
        change = wp.min(wp.max(z * inverse * wanted[2], -most / (_1 + most)), MOST_GROWTH)
        farther = _1 / (_1 + change)
        growth = farther - _1
        aside = z * farther * across
        moved = vec3d(growth * seen[0] + aside * wanted[0], growth * seen[1] + aside * wanted[1], growth * z)
        enlarge(log_scales, g, wp.log(farther))
    means[g] = vec3(vec3d(means[g]) + wp.transform_vector(wp.transpose(pose), moved))


# ----------------------------------------------------------------------------------------------------------- sums


@wp.kernel(module="unique", module_options=TILED)
def sum_values(parameter: Floats, share: float32, opacities: int, gradient: Floats, sums: Doubles):
    """Sum opacities, or sizes, block by block, and add a share of each one's slope to the gradient."""
    block, lane = wp.tid()
    total = float64(0.0)
    for k in range(PER_THREAD):
        i = block * CHUNK + k * SUMMED + lane
        if i < parameter.shape[0]:
            value = wp.exp(parameter[i])
            slope = value
            if opacities > 0:
                value = 1.0 / (1.0 + wp.exp(-parameter[i]))
                slope = value * (1.0 - value)
            gradient[i] = gradient[i] + share * slope
            total += float64(value)
    all_of_it = sum_of_block(total)
    if lane == 0:
        sums[block] = all_of_it


# ---------------------------------------------------------------------------------------------------- depth field


@wp.func
def place(at: float64, low: float64, step: float64, count: int):
    """Return the knot below a position and the fraction of the way to the next."""
    along = wp.min(wp.max((at - low) / step, _0), float64(count - 1))
    knot = wp.min(int(along), count - 2)
    return knot, along - float64(knot)


@wp.func
def share_of(upper: int, fraction: float64):
    """Return the weight of the lower or upper knot."""
    return wp.where(upper > 0, fraction, _1 - fraction)


@wp.func
def value(field: wp.array3d(dtype=float64), u: float64, v: float64, w: float64, low: vec3d, step: vec3d):
    """See `depth_field_kernels._value`."""
    i, a = place(u, low[0], step[0], field.shape[0])
    j, b = place(v, low[1], step[1], field.shape[1])
    k, c = place(w, low[2], step[2], field.shape[2])
    found = _0
    for corner in range(8):
        di = corner // 4
        dj = (corner // 2) % 2
        dk = corner % 2
        found += share_of(di, a) * share_of(dj, b) * share_of(dk, c) * field[i + di, j + dj, k + dk]
    return found


@wp.kernel
def move_gaussians(
    means: Vectors,
    log_scales: Vectors,
    pose: mat44d,
    near: float64,
    low: vec3d,
    step: vec3d,
    field: wp.array3d(dtype=float64),
):
    """See `depth_field_kernels.move_gaussians`."""
    g = wp.tid()
    seen = wp.transform_point(pose, vec3d(means[g]))
    z = seen[2]
    if z >= near:
        growth = bounded(-z * value(field, seen[0] / z, seen[1] / z, _1 / z, low, step), z)
        means[g] = vec3(vec3d(means[g]) + growth * wp.transform_vector(wp.transpose(pose), seen))
        enlarge(log_scales, g, growth)


@wp.kernel
def move_map(
    inverse_depth: Floats,
    pixels: wp.array(dtype=wp.int64),
    rays: wp.array(dtype=wp.vec2),
    to_reference: mat44d,
    low: vec3d,
    step: vec3d,
    field: wp.array3d(dtype=float64),
):
    """See `depth_field_kernels.move_map`."""
    at = int(pixels[wp.tid()])
    w = float64(inverse_depth[at])
    ray = vec3d(float64(rays[at][0]), float64(rays[at][1]), _1)
    # In units of the depth: X = R ray + t w.
    offset = vec3d(to_reference[0, 3], to_reference[1, 3], to_reference[2, 3])
    seen = wp.transform_vector(to_reference, ray) + w * offset
    z = seen[2]
    if w > _0 and z > _0:
        moved = w + value(field, seen[0] / z, seen[1] / z, w / z, low, step)
        inverse_depth[at] = float32(wp.max(moved, _0))


@wp.kernel
def find_changes(
    means: Vectors,
    by_means: Vectors,
    by_log_scales: Vectors,
    pose: mat44d,
    near: float64,
    low: vec3d,
    step: vec3d,
    most: vec3d,
    changes: wp.array(dtype=wp.vec4d),
):
    """Find where each Gaussian lies in a grid, in steps from its first knot, and its part in the gradient."""
    g = wp.tid()
    seen = wp.transform_point(pose, vec3d(means[g]))
    z = seen[2]
    change = wp.vec4d()
    if z >= near:
        change = wp.vec4d(
            wp.min(wp.max((seen[0] / z - low[0]) / step[0], _0), most[0]),
            wp.min(wp.max((seen[1] / z - low[1]) / step[1], _0), most[1]),
            wp.min(wp.max((_1 / z - low[2]) / step[2], _0), most[2]),
            -z * (wp.dot(wp.transform_vector(pose, vec3d(by_means[g])), seen) + sum_of(by_log_scales[g])),
        )
    changes[g] = change


@wp.kernel(module="unique", module_options=TILED)
def sum_at_knots(changes: wp.array(dtype=wp.vec4d), down: int, deep: int, gradient: Doubles):
    """Sum at one knot of a grid, [A, down, deep], what all Gaussians around it add, always in the same order."""
    knot, lane = wp.tid()
    i = float64(knot // (down * deep))
    j = float64((knot // deep) % down)
    k = float64(knot % deep)
    total = float64(0.0)
    for g in range(lane, changes.shape[0], wp.block_dim()):
        change = changes[g]
        a = _1 - wp.abs(change[0] - i)
        b = _1 - wp.abs(change[1] - j)
        c = _1 - wp.abs(change[2] - k)
        if a > _0 and b > _0 and c > _0:
            total += a * b * c * change[3]
    all_of_it = sum_of_block(total)
    if lane == 0:
        gradient[knot] = all_of_it


# -------------------------------------------------------------------------------------------------- surfaces' term


@wp.func
def depth_along(mean: vec3, ray: Floats):
    """Return the depth of a centre, given the third row of a pose."""
    return mean[0] * ray[0] + mean[1] * ray[1] + mean[2] * ray[2] + ray[3]


@wp.kernel
def parallax_moments(
    means: Vectors,
    ray: Floats,
    near: float32,
    parallax_px: float32,
    middle: float32,
    out: Vectors,
):
    """See `surface_kernels.parallax_moments`."""
    g = wp.tid()
    parallax = parallax_px / wp.max(depth_along(means[g], ray), near) - middle
    out[g] = vec3(1.0, parallax, parallax * parallax)


@wp.kernel
def add_mean_gradient(
    means: Vectors,
    ray: Floats,
    near: float32,
    parallax_px: float32,
    moments: Vectors,
    by_moments: Vectors,
    out: Vectors,
):
    """See `surface_kernels.add_mean_gradient`."""
    g = wp.tid()
    depth = depth_along(means[g], ray)
    if depth >= near:
        by_parallax = by_moments[g][1] + 2.0 * moments[g][1] * by_moments[g][2]
        by_depth = -(by_parallax * parallax_px / (depth * depth))
        out[g] = out[g] + by_depth * vec3(ray[0], ray[1], ray[2])


@wp.kernel(module="unique", module_options=TILED)
def sum_distances(
    image: Vectors,
    pixels: wp.array(dtype=wp.int64),
    inverse_depth: Floats,
    trust: Floats,
    all_trust: Doubles,
    parallax_px: float64,
    middle: float64,
    round_px: float64,
    weight: float64,
    gradient: Vectors,
    sums: Doubles,
):
    """Sum shares of the mean of `surface_kernels.distance_to_surface` block by block, and store its gradient."""
    block, lane = wp.tid()
    total = float64(0.0)
    for k in range(PER_THREAD):
        i = block * CHUNK + k * SUMMED + lane
        if i < pixels.shape[0]:
            at = int(pixels[i])
            seen = vec3d(image[at])
            sure = float64(trust[at]) / all_trust[0]
            p = parallax_px * float64(inverse_depth[at]) - middle
            square = seen[2] - _2 * p * seen[1] + p * p * seen[0]
            root = wp.sqrt(wp.max(square, _0) + round_px * round_px)
            total += sure * (root - round_px)
            slope = _0
            if square >= _0:
                slope = weight * sure / (_2 * root)
            gradient[at] = vec3(vec3d(slope * p * p, -_2 * slope * p, slope))
    all_of_it = sum_of_block(total)
    if lane == 0:
        sums[block] = all_of_it


BY_ELEMENTS: Final[tuple[Any, ...]] = (
    *(adam_step, gradient_in_view, move_in_view, move_gaussians, move_map, find_changes),
    *(parallax_moments, add_mean_gradient),
)
BY_BLOCKS: Final[tuple[Any, ...]] = (sum_values, sum_at_knots, sum_distances)
"""By how they are launched: a thread for each element, or `SUMMED` threads for each sum."""
ALL: Final = (*BY_ELEMENTS, *BY_BLOCKS)
"""For counts and for compiling in advance."""
