"""The kernels of a fit in Warp, one thread for each Gaussian or pixel; sums block by block, always in one order.

No float is added atomically. In float64 where the CPU's kernels of the same name are (`calls.py`), which say what is
computed and why. Here: the kernels. Not here: their launches (`calls.py`), those of the loss
(`losses/device_loss_kernels.py`).
"""

from typing import Any, Final

import warp as wp

from gs2ci.reconstruct.fit.kernels import distances
from gs2ci.render.recording import TILED

wp.set_module_options({"enable_backward": False})

SUMMED = wp.constant(256)
"""Threads of a block that sums."""
PER_THREAD = wp.constant(4)
"""Numbers that each of them takes."""

MOST_GROWTH = wp.constant(wp.float64(distances.MOST_GROWTH))
FARTHEST = wp.constant(wp.float64(distances.FARTHEST))
_0 = wp.constant(wp.float64(0.0))
_1 = wp.constant(wp.float64(1.0))
_2 = wp.constant(wp.float64(2.0))
CHUNK = wp.constant(SUMMED * PER_THREAD)
Steps = wp.types.vector(length=5, dtype=wp.float32)
"""One number for each of means, log scales, quaternions, opacity logits and colours."""


@wp.func
def sum_of_block(mine: wp.float64):
    """Return the sum over the threads of a block; all of them have to ask, since on CUDA each waits for the others."""
    found = wp.tile_sum(wp.tile(mine))
    return found[0]


@wp.func
def wide(v: wp.vec3):
    """Return a vector in float64."""
    return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))


@wp.func
def narrow(v: wp.vec3d):
    """Return a vector in float32."""
    return wp.vec3(wp.float32(v[0]), wp.float32(v[1]), wp.float32(v[2]))


@wp.func
def turned(pose: wp.mat44d, v: wp.vec3d):
    """Return a vector of the world in the axes of a camera."""
    return wp.vec3d(
        pose[0, 0] * v[0] + pose[0, 1] * v[1] + pose[0, 2] * v[2],
        pose[1, 0] * v[0] + pose[1, 1] * v[1] + pose[1, 2] * v[2],
        pose[2, 0] * v[0] + pose[2, 1] * v[1] + pose[2, 2] * v[2],
    )


@wp.func
def turned_back(pose: wp.mat44d, v: wp.vec3d):
    """Return a vector in a camera's axes in those of the world."""
    return wp.vec3d(
        pose[0, 0] * v[0] + pose[1, 0] * v[1] + pose[2, 0] * v[2],
        pose[0, 1] * v[0] + pose[1, 1] * v[1] + pose[2, 1] * v[2],
        pose[0, 2] * v[0] + pose[1, 2] * v[1] + pose[2, 2] * v[2],
    )


@wp.func
def seen_from(pose: wp.mat44d, mean: wp.vec3):
    """Return a centre in the coordinates of a camera."""
    return turned(pose, wide(mean)) + wp.vec3d(pose[0, 3], pose[1, 3], pose[2, 3])


@wp.func
def most_growth(distance: wp.float64):
    """See `distances.most_growth`."""
    return wp.min(MOST_GROWTH, wp.max(FARTHEST / distance - _1, _0))


@wp.func
def bounded(growth: wp.float64, distance: wp.float64):
    """See `distances.bounded`."""
    return wp.min(wp.max(growth, -MOST_GROWTH), most_growth(distance))


# ---------------------------------------------------------------------------------------------------------- steps


@wp.func
def mean_after(mean: wp.float32, gradient: wp.float32, taken: wp.float32):
    """Return the first moment after a gradient."""
    return mean + taken * (gradient - mean)


@wp.func
def square_after(square: wp.float32, gradient: wp.float32, decay: wp.float32, fresh: wp.float32):
    """Return the second moment after a gradient."""
    return decay * square + fresh * gradient * gradient


@wp.kernel
def adam_step(
    parameter: wp.array(dtype=wp.float32),
    gradient: wp.array(dtype=wp.float32),
    mean: wp.array(dtype=wp.float32),
    square: wp.array(dtype=wp.float32),
    taken: wp.float32,
    decay: wp.float32,
    fresh: wp.float32,
    scale: wp.float32,
    least: wp.float32,
    step: wp.float32,
):
    """See `gaussian_kernels.adam_step`."""
    i = wp.tid()
    m = mean_after(mean[i], gradient[i], taken)
    v = square_after(square[i], gradient[i], decay, fresh)
    mean[i] = m
    square[i] = v
    parameter[i] = parameter[i] - step * m / (wp.sqrt(v) * scale + least)


@wp.func
def in_view(seen: wp.vec3d, by_mean: wp.vec3, by_log_scale: wp.vec3, pose: wp.mat44d, near: wp.float64):
    """Return a row of `view_steps.gradient_in_view`."""
    d = turned(pose, wide(by_mean))
    z = seen[2]
    if z > near:
        sizes = wp.float64(by_log_scale[0]) + wp.float64(by_log_scale[1]) + wp.float64(by_log_scale[2])
        d = wp.vec3d(z * d[0], z * d[1], -z * (wp.dot(seen, d) + sizes))
    return narrow(d)


@wp.func
def moved_in_view(seen: wp.vec3d, step: wp.vec3, near: wp.float64, across: wp.float64, inverse: wp.float64):
    """Return how a step of `view_steps.move_in_view` moves a centre, in the camera's axes, and the growth of sizes."""
    wanted = wide(step)
    moved = across * wanted
    larger = _0
    z = seen[2]
    if z > near:
        most = most_growth(z)
        change = wp.min(wp.max(z * inverse * wanted[2], -most / (_1 + most)), MOST_GROWTH)
        farther = _1 / (_1 + change)
        growth = farther - _1
        aside = z * farther * across
        moved = wp.vec3d(growth * seen[0] + aside * wanted[0], growth * seen[1] + aside * wanted[1], growth * z)
        larger = wp.log(farther)
    return moved, wp.float32(larger)


@wp.kernel
def gradient_in_view(
    means: wp.array(dtype=wp.vec3),
    by_means: wp.array(dtype=wp.vec3),
    by_log_scales: wp.array(dtype=wp.vec3),
    pose: wp.mat44d,
    near: wp.float64,
    gradient: wp.array(dtype=wp.vec3),
):
    """See `view_steps.gradient_in_view`."""
    g = wp.tid()
    gradient[g] = in_view(seen_from(pose, means[g]), by_means[g], by_log_scales[g], pose, near)


@wp.kernel
def move_in_view(
    means: wp.array(dtype=wp.vec3),
    log_scales: wp.array(dtype=wp.vec3),
    steps: wp.array(dtype=wp.vec3),
    pose: wp.mat44d,
    near: wp.float64,
    across: wp.float64,
    inverse: wp.float64,
):
    """See `view_steps.move_in_view`."""
    g = wp.tid()
    moved, larger = moved_in_view(seen_from(pose, means[g]), steps[g], near, across, inverse)
    means[g] = narrow(wide(means[g]) + turned_back(pose, moved))
    log_scales[g] = log_scales[g] + wp.vec3(larger, larger, larger)


@wp.func
def step_of_three(
    gradient: wp.vec3,
    mean: wp.array(dtype=wp.vec3),
    square: wp.array(dtype=wp.vec3),
    g: int,
    taken: wp.float32,
    decay: wp.float32,
    fresh: wp.float32,
    scale: wp.float32,
    least: wp.float32,
    step: wp.float32,
):
    """Update the moments of a parameter of three numbers, and return what `adam_step` adds to it."""
    m = mean[g] + taken * (gradient - mean[g])
    v = decay * square[g] + fresh * wp.cw_mul(gradient, gradient)
    mean[g] = m
    square[g] = v
    return wp.vec3(
        -(step * m[0] / (wp.sqrt(v[0]) * scale + least)),
        -(step * m[1] / (wp.sqrt(v[1]) * scale + least)),
        -(step * m[2] / (wp.sqrt(v[2]) * scale + least)),
    )


@wp.kernel
def step_together(
    means: wp.array(dtype=wp.vec3),
    log_scales: wp.array(dtype=wp.vec3),
    quaternions: wp.array(dtype=wp.vec4),
    logits: wp.array(dtype=wp.float32),
    colours: wp.array(dtype=wp.vec3),
    by_means: wp.array(dtype=wp.vec3),
    by_log_scales: wp.array(dtype=wp.vec3),
    by_quaternions: wp.array(dtype=wp.vec4),
    by_logits: wp.array(dtype=wp.float32),
    by_colours: wp.array(dtype=wp.vec3),
    mean_of_means: wp.array(dtype=wp.vec3),
    mean_of_log_scales: wp.array(dtype=wp.vec3),
    mean_of_quaternions: wp.array(dtype=wp.vec4),
    mean_of_logits: wp.array(dtype=wp.float32),
    mean_of_colours: wp.array(dtype=wp.vec3),
    square_of_means: wp.array(dtype=wp.vec3),
    square_of_log_scales: wp.array(dtype=wp.vec3),
    square_of_quaternions: wp.array(dtype=wp.vec4),
    square_of_logits: wp.array(dtype=wp.float32),
    square_of_colours: wp.array(dtype=wp.vec3),
    taken: wp.float32,
    decay: wp.float32,
    fresh: wp.float32,
    least: wp.float32,
    scales: Steps,
    steps: Steps,
    viewed: int,
    pose: wp.mat44d,
    near: wp.float64,
    across: wp.float64,
    inverse: wp.float64,
):
    """Make a whole step of one Gaussian: `adam_step` of five parameters, positions in the coordinates of a view."""
    g = wp.tid()
    seen = seen_from(pose, means[g])
    by_mean = by_means[g]
    if viewed > 0:
        by_mean = in_view(seen, by_means[g], by_log_scales[g], pose, near)
    step = step_of_three(by_mean, mean_of_means, square_of_means, g, taken, decay, fresh, scales[0], least, steps[0])
    size = log_scales[g]
    if viewed > 0:
        moved, larger = moved_in_view(seen, step, near, across, inverse)
        means[g] = narrow(wide(means[g]) + turned_back(pose, moved))
        size += wp.vec3(larger, larger, larger)
    else:
        means[g] = means[g] + step
    log_scales[g] = size + step_of_three(
        by_log_scales[g], mean_of_log_scales, square_of_log_scales, g, taken, decay, fresh, scales[1], least, steps[1]
    )
    m4 = mean_of_quaternions[g] + taken * (by_quaternions[g] - mean_of_quaternions[g])
    v4 = decay * square_of_quaternions[g] + fresh * wp.cw_mul(by_quaternions[g], by_quaternions[g])
    mean_of_quaternions[g] = m4
    square_of_quaternions[g] = v4
    q = quaternions[g]
    for k in range(4):
        q[k] = q[k] - steps[2] * m4[k] / (wp.sqrt(v4[k]) * scales[2] + least)
    quaternions[g] = q
    m1 = mean_after(mean_of_logits[g], by_logits[g], taken)
    v1 = square_after(square_of_logits[g], by_logits[g], decay, fresh)
    mean_of_logits[g] = m1
    square_of_logits[g] = v1
    logits[g] = logits[g] - steps[3] * m1 / (wp.sqrt(v1) * scales[3] + least)
    colours[g] = colours[g] + step_of_three(
        by_colours[g], mean_of_colours, square_of_colours, g, taken, decay, fresh, scales[4], least, steps[4]
    )


# ----------------------------------------------------------------------------------------------------------- sums


@wp.kernel(module="unique", module_options=TILED)
def sum_opacities(
    logits: wp.array(dtype=wp.float32),
    share: wp.float32,
    gradient: wp.array(dtype=wp.float32),
    sums: wp.array(dtype=wp.float64),
):
    """Sum opacities block by block, and add a share of each one's slope to the gradient."""
    block, lane = wp.tid()
    total = wp.float64(0.0)
    for k in range(PER_THREAD):
        i = block * CHUNK + k * SUMMED + lane
        if i < logits.shape[0]:
            opacity = 1.0 / (1.0 + wp.exp(-logits[i]))
            gradient[i] = gradient[i] + share * opacity * (1.0 - opacity)
            total += wp.float64(opacity)
    all_of_it = sum_of_block(total)
    if lane == 0:
        sums[block] = all_of_it


@wp.kernel(module="unique", module_options=TILED)
def sum_sizes(
    log_scales: wp.array(dtype=wp.float32),
    share: wp.float32,
    gradient: wp.array(dtype=wp.float32),
    sums: wp.array(dtype=wp.float64),
):
    """Sum sizes block by block, and add a share of each one's slope to the gradient."""
    block, lane = wp.tid()
    total = wp.float64(0.0)
    for k in range(PER_THREAD):
        i = block * CHUNK + k * SUMMED + lane
        if i < log_scales.shape[0]:
            size = wp.exp(log_scales[i])
            gradient[i] = gradient[i] + share * size
            total += wp.float64(size)
    all_of_it = sum_of_block(total)
    if lane == 0:
        sums[block] = all_of_it


@wp.kernel(module="unique", module_options=TILED)
def sum_products(
    gradient: wp.array2d(dtype=wp.float32),
    step: wp.array2d(dtype=wp.float32),
    sums: wp.array(dtype=wp.float64),
):
    """Sum products of gradients and steps block by block; a step of one column counts for every column."""
    block, lane = wp.tid()
    total = wp.float64(0.0)
    for k in range(PER_THREAD):
        g = block * CHUNK + k * SUMMED + lane
        if g < gradient.shape[0]:
            for j in range(gradient.shape[1]):
                total += wp.float64(gradient[g, j]) * wp.float64(step[g, wp.min(j, step.shape[1] - 1)])
    all_of_it = sum_of_block(total)
    if lane == 0:
        sums[block] = all_of_it


# --------------------------------------------------------------------- exchange of turning for travel, depth field


@wp.kernel
def find_distances(
    means: wp.array(dtype=wp.vec3),
    pose: wp.mat44d,
    bend: wp.vec2d,
    near: wp.float64,
    widest: wp.float64,
    nearer: wp.array(dtype=wp.float32),
):
    """See `relief_kernels._find_distances`."""
    g = wp.tid()
    seen = seen_from(pose, means[g])
    depth = wp.max(seen[2], near)
    slant = wp.min(wp.max((seen[0] * bend[0] + seen[1] * bend[1]) / depth, -widest), widest)
    nearer[g] = wp.float32(depth * (_1 + slant * slant))


@wp.kernel
def differentiate_step(
    means: wp.array(dtype=wp.vec3),
    pose: wp.mat44d,
    shrink: wp.array(dtype=wp.float32),
    by_means: wp.array(dtype=wp.vec3),
    by_sizes: wp.array(dtype=wp.float32),
):
    """See `relief_kernels._differentiate_step`."""
    g = wp.tid()
    growth = shrink[0] - by_sizes[g]
    by_means[g] = narrow(wp.float64(growth) * turned_back(pose, seen_from(pose, means[g])))
    by_sizes[g] = growth


@wp.kernel
def take_step(
    means: wp.array(dtype=wp.vec3),
    log_scales: wp.array(dtype=wp.vec3),
    by_means: wp.array(dtype=wp.vec3),
    by_sizes: wp.array(dtype=wp.float32),
    beta: wp.float64,
):
    """See `relief_kernels.take_step`."""
    g = wp.tid()
    size = wp.float64(by_sizes[g])
    if size != _0:
        growth = bounded(beta * size, wp.length(wide(by_means[g])) / wp.abs(size))
        means[g] = narrow(wide(means[g]) + (growth / size) * wide(by_means[g]))
        larger = wp.float32(growth)
        log_scales[g] = log_scales[g] + wp.vec3(larger, larger, larger)


@wp.func
def place(at: wp.float64, low: wp.float64, step: wp.float64, count: int):
    """Return the knot below a position and the fraction of the way to the next."""
    along = wp.min(wp.max((at - low) / step, _0), wp.float64(count - 1))
    knot = wp.min(int(along), count - 2)
    return knot, along - wp.float64(knot)


@wp.func
def share_of(upper: int, fraction: wp.float64):
    """Return the weight of the lower or upper knot."""
    return wp.where(upper > 0, fraction, _1 - fraction)


@wp.kernel
def move_gaussians(
    means: wp.array(dtype=wp.vec3),
    log_scales: wp.array(dtype=wp.vec3),
    pose: wp.mat44d,
    near: wp.float64,
    low: wp.vec3d,
    step: wp.vec3d,
    field: wp.array3d(dtype=wp.float64),
):
    """See `depth_field_kernels.move_gaussians`."""
    g = wp.tid()
    seen = seen_from(pose, means[g])
    z = seen[2]
    if z >= near:
        i, a = place(seen[0] / z, low[0], step[0], field.shape[0])
        j, b = place(seen[1] / z, low[1], step[1], field.shape[1])
        k, c = place(_1 / z, low[2], step[2], field.shape[2])
        found = _0
        for corner in range(8):
            di = corner // 4
            dj = (corner // 2) % 2
            dk = corner % 2
            found += share_of(di, a) * share_of(dj, b) * share_of(dk, c) * field[i + di, j + dj, k + dk]
        growth = bounded(-z * found, z)
        means[g] = narrow(wide(means[g]) + growth * turned_back(pose, seen))
        larger = wp.float32(growth)
        log_scales[g] = log_scales[g] + wp.vec3(larger, larger, larger)


@wp.kernel
def find_changes(
    means: wp.array(dtype=wp.vec3),
    by_means: wp.array(dtype=wp.vec3),
    by_log_scales: wp.array(dtype=wp.vec3),
    pose: wp.mat44d,
    near: wp.float64,
    low: wp.vec3d,
    step: wp.vec3d,
    most: wp.vec3d,
    changes: wp.array(dtype=wp.vec4d),
):
    """Find where each Gaussian lies in a grid, in steps from its first knot, and its part in the gradient."""
    g = wp.tid()
    seen = seen_from(pose, means[g])
    z = seen[2]
    change = wp.vec4d()
    if z >= near:
        sizes = wp.float64(by_log_scales[g][0]) + wp.float64(by_log_scales[g][1]) + wp.float64(by_log_scales[g][2])
        change = wp.vec4d(
            wp.min(wp.max((seen[0] / z - low[0]) / step[0], _0), most[0]),
            wp.min(wp.max((seen[1] / z - low[1]) / step[1], _0), most[1]),
            wp.min(wp.max((_1 / z - low[2]) / step[2], _0), most[2]),
            -z * (wp.dot(turned(pose, wide(by_means[g])), seen) + sizes),
        )
    changes[g] = change


@wp.kernel(module="unique", module_options=TILED)
def sum_at_knots(changes: wp.array(dtype=wp.vec4d), down: int, deep: int, gradient: wp.array(dtype=wp.float64)):
    """Sum at one knot of a grid, [A, down, deep], what all Gaussians around it add, always in the same order."""
    knot, lane = wp.tid()
    i = wp.float64(knot // (down * deep))
    j = wp.float64((knot // deep) % down)
    k = wp.float64(knot % deep)
    total = wp.float64(0.0)
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
def depth_along(mean: wp.vec3, ray: wp.array(dtype=wp.float32)):
    """Return the depth of a centre, given the third row of a pose."""
    return mean[0] * ray[0] + mean[1] * ray[1] + mean[2] * ray[2] + ray[3]


@wp.kernel
def parallax_moments(
    means: wp.array(dtype=wp.vec3),
    ray: wp.array(dtype=wp.float32),
    near: wp.float32,
    parallax_px: wp.float32,
    middle: wp.float32,
    out: wp.array(dtype=wp.vec3),
):
    """See `surface_kernels.parallax_moments`."""
    g = wp.tid()
    parallax = parallax_px / wp.max(depth_along(means[g], ray), near) - middle
    out[g] = wp.vec3(1.0, parallax, parallax * parallax)


@wp.kernel
def add_mean_gradient(
    means: wp.array(dtype=wp.vec3),
    ray: wp.array(dtype=wp.float32),
    near: wp.float32,
    parallax_px: wp.float32,
    moments: wp.array(dtype=wp.vec3),
    by_moments: wp.array(dtype=wp.vec3),
    out: wp.array(dtype=wp.vec3),
):
    """See `surface_kernels.add_mean_gradient`."""
    g = wp.tid()
    depth = depth_along(means[g], ray)
    if depth >= near:
        by_parallax = by_moments[g][1] + 2.0 * moments[g][1] * by_moments[g][2]
        by_depth = -(by_parallax * parallax_px / (depth * depth))
        out[g] = out[g] + by_depth * wp.vec3(ray[0], ray[1], ray[2])


@wp.kernel(module="unique", module_options=TILED)
def sum_trust(pixels: wp.array(dtype=wp.int64), trust: wp.array(dtype=wp.float32), sums: wp.array(dtype=wp.float64)):
    """Sum the weights of the term's pixels by one block; 1 at least."""
    _block, lane = wp.tid()
    total = wp.float64(0.0)
    for i in range(lane, pixels.shape[0], wp.block_dim()):
        total += wp.float64(trust[int(pixels[i])])
    all_of_it = sum_of_block(total)
    if lane == 0:
        sums[0] = wp.max(all_of_it, _1)


@wp.kernel(module="unique", module_options=TILED)
def sum_distances(
    image: wp.array(dtype=wp.vec3),
    pixels: wp.array(dtype=wp.int64),
    inverse_depth: wp.array(dtype=wp.float32),
    trust: wp.array(dtype=wp.float32),
    all_trust: wp.array(dtype=wp.float64),
    parallax_px: wp.float64,
    middle: wp.float64,
    round_px: wp.float64,
    weight: wp.float64,
    gradient: wp.array(dtype=wp.vec3),
    sums: wp.array(dtype=wp.float64),
):
    """Sum shares of the mean of `surface_kernels.distance_to_surface` block by block, and store its gradient."""
    block, lane = wp.tid()
    total = wp.float64(0.0)
    for k in range(PER_THREAD):
        i = block * CHUNK + k * SUMMED + lane
        if i < pixels.shape[0]:
            at = int(pixels[i])
            seen = wide(image[at])
            sure = wp.float64(trust[at]) / all_trust[0]
            p = parallax_px * wp.float64(inverse_depth[at]) - middle
            square = seen[2] - _2 * p * seen[1] + p * p * seen[0]
            root = wp.sqrt(wp.max(square, _0) + round_px * round_px)
            total += sure * (root - round_px)
            slope = _0
            if square >= _0:
                slope = weight * sure / (_2 * root)
            gradient[at] = narrow(wp.vec3d(slope * p * p, -_2 * slope * p, slope))
    all_of_it = sum_of_block(total)
    if lane == 0:
        sums[block] = all_of_it


ALL: Final[tuple[Any, ...]] = (
    *(adam_step, gradient_in_view, move_in_view, step_together, sum_opacities, sum_sizes, sum_products),
    *(find_distances, differentiate_step, take_step, move_gaussians, find_changes, sum_at_knots),
    *(parallax_moments, add_mean_gradient, sum_trust, sum_distances),
)
"""For counts and for compiling in advance."""
