"""Kernels, one thread for each Gaussian: projection into every view, and the gradient of that."""

import warp as wp
from warp import float32, float64, int32, vec3, vec4

from gs2ci.render.recording import TILED, Floats, Fours, Ints, Vectors
from gs2ci.render.warp.types import (
    DILATION,
    INERT,
    Pose,
    Record,
    Row,
    TiledCamera,
    factor_of,
    footprint,
    is_drawn,
    see,
    touches,
)

wp.set_module_options({"enable_backward": False})


@wp.kernel
def project(
    means: Vectors,
    mean_stride: int,
    log_scales: Vectors,
    quaternions: Fours,
    logits: Floats,
    colours: Vectors,
    colour_stride: int,
    poses: wp.array(dtype=Pose),
    camera: TiledCamera,
    margin: float32,
    blocks_before: Ints,
    records: wp.array(dtype=Record),
    boxes: wp.array(dtype=wp.vec4i),
    depths: Floats,
    counts: Ints,
):
    """Make the record of each Gaussian in each view, and count the blocks in whose lists it belongs."""
    view, g = wp.tid()
    count = logits.shape[0]
    at = view * count + g
    factor = factor_of(quaternions[g], log_scales[g])
    s = see(poses[view], camera, means[view * mean_stride + g], factor)
    inverse_opacity = 1.0 + wp.exp(-logits[g])
    log_opacity = -wp.log(inverse_opacity)
    n = int32(0)
    box = wp.vec4i(0, -1, 0, -1)
    record = Record()
    record[5] = INERT
    if is_drawn(s, inverse_opacity):
        colour = colours[view * colour_stride + g]
        record = Record(
            camera.fx * s.u + camera.cx,
            camera.fy * s.v + camera.cy,
            0.5 * s.inverse_x_given_y,
            s.shear,
            0.5 * s.inverse_y,
            log_opacity,
            colour[0],
            colour[1],
            colour[2],
        )
        edges = footprint(s, log_opacity, camera, margin)
        if touches(edges, camera):
            # Cut as floats first: the box of a very wide one leaves int32.
            x0 = int(wp.max(edges[0], 0.0)) // camera.tile_w
            x1 = wp.min(int(wp.min(edges[1], camera.width)) // camera.tile_w, camera.tiles_x - 1)
            y0 = int(wp.max(edges[2], 0.0)) // camera.tile_h
            y1 = wp.min(int(wp.min(edges[3], camera.height)) // camera.tile_h, camera.tiles_y - 1)
            box = wp.vec4i(x0, x1, y0, y1)
            base = view * camera.tiles_x * camera.tiles_y
            for ty in range(y0, y1 + 1):
                tile = base + ty * camera.tiles_x
                n += blocks_before[tile + x1 + 1] - blocks_before[tile + x0]
    records[at] = record
    depths[at] = s.p[2]
    boxes[at] = box
    counts[at] = n


@wp.func
def _seen(
    pose: Pose,
    camera: TiledCamera,
    mean: vec3,
    factor: wp.mat33,
    d_a: vec3,
    d_b: vec3,
    d_x: float32,
    d_y: float32,
):
    """Return the sum of a Gaussian's shape and place in a view times gradients by them: its slopes are those asked."""
    s = see(pose, camera, mean, factor)
    return wp.dot(s.a, d_a) + wp.dot(s.b, d_b) + camera.fx * s.u * d_x + camera.fy * s.v * d_y


@wp.func
def _shaped(quaternion: vec4, log_scales: vec3, d_factor: wp.mat33):
    """Return the sum of a Gaussian's shape times the gradient by it."""
    return wp.ddot(factor_of(quaternion, log_scales), d_factor)


@wp.kernel
def project_backward(
    means: Vectors,
    mean_stride: int,
    log_scales: Vectors,
    quaternions: Fours,
    logits: Floats,
    colour_stride: int,
    poses: wp.array(dtype=Pose),
    camera: TiledCamera,
    starts: Ints,
    sums: wp.array(dtype=Row),
    d_means: Vectors,
    d_log_scales: Vectors,
    d_quaternions: Fours,
    d_logits: Floats,
    d_colours: Vectors,
    sightings: Vectors,
    pose_parts: Floats,
):
    """Carry a Gaussian's sums, view after view, to its parameters and to each pose."""
    g = wp.tid()
    count = logits.shape[0]
    factor = factor_of(quaternions[g], log_scales[g])
    inverse_opacity = 1.0 + wp.exp(-logits[g])
    log_opacity = -wp.log(inverse_opacity)
    transparency = 1.0 / (1.0 + wp.exp(logits[g]))
    d_factor = wp.mat33()
    d_mean = vec3()
    d_colour = vec3()
    d_logit = float32(0.0)
    seen = vec3()
    for view in range(poses.shape[0]):
        at = view * count + g
        total = Row()
        for row in range(starts[at], starts[at + 1]):
            total += sums[row]
        own_colour = vec3(total[6], total[7], total[8])
        by_pose = Pose()
        by_mean = vec3()
        pose = poses[view]
        mean = means[view * mean_stride + g]
        s = see(pose, camera, mean, factor)
        if is_drawn(s, inverse_opacity) and touches(footprint(s, log_opacity, camera, float32(0.0)), camera):
            d_logit += total[0] * transparency
            dx = s.inverse_x_given_y * total[1]
            dy = s.shear * dx + s.inverse_y * total[2]
            e = (wp.cross(s.b, s.n) + DILATION * s.a) * s.inverse_y
            h = s.inverse_x_given_y * s.inverse_y * total[4]
            d_a = e * (s.inverse_x_given_y * s.inverse_x_given_y * total[3]) + s.b * h
            d_b = d_a * s.shear + e * h + s.b * (s.inverse_y * s.inverse_y * total[5])
            by_pose, _camera, by_mean, by_factor, _a, _b, _x, _y = wp.grad(_seen)(
                pose, camera, mean, factor, d_a, d_b, dx, dy
            )
            d_factor += by_factor
            sx = dx * 0.5 * camera.width
            sy = dy * 0.5 * camera.height
            half = 0.5 * (s.cxx - s.cyy)
            radius = 3.0 * wp.sqrt(0.5 * (s.cxx + s.cyy) + wp.sqrt(half * half + s.cxy * s.cxy))
            seen = vec3(seen[0] + wp.sqrt(sx * sx + sy * sy), seen[1] + 1.0, wp.max(seen[2], radius))
        for k in range(12):
            pose_parts[at * 12 + k] = by_pose[k // 4, k % 4]
        if mean_stride > 0:
            d_means[at] = by_mean
        d_mean += by_mean
        if colour_stride > 0:
            d_colours[at] = own_colour
        d_colour += own_colour
    if mean_stride == 0:
        d_means[g] = d_mean
    if colour_stride == 0:
        d_colours[g] = d_colour
    d_logits[g] = d_logit
    sightings[g] = seen
    by_quaternion, by_log_scale, _factor = wp.grad(_shaped)(quaternions[g], log_scales[g], d_factor)
    d_quaternions[g] = by_quaternion
    d_log_scales[g] = by_log_scale


@wp.kernel(module="unique", module_options=TILED)
def sum_poses(pose_parts: Floats, gaussians: int, out: Floats):
    """Sum one entry of one pose's gradient over all Gaussians, in float64 and always in the same order."""
    which, lane = wp.tid()
    view = which // 12
    entry = which - view * 12
    total = float64(0.0)
    for g in range(lane, gaussians, wp.block_dim()):
        total += float64(pose_parts[(view * gaussians + g) * 12 + entry])
    both = wp.tile_sum(wp.tile(total))
    all_of_it = both[0]
    if lane == 0:
        out[view * 16 + entry] = float32(all_of_it)
