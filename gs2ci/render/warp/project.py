"""Kernels, one thread for each Gaussian: projection into every view, and the gradient of that."""

import warp as wp
from warp import float32, float64, int32, vec3, vec4

from gs2ci.render.recording import TILED, Floats, Fours, Ints, Vectors
from gs2ci.render.warp.types import (
    DILATION,
    INERT,
    LOG_SCALE_MAX,
    Pose,
    PosePart,
    Record,
    Row,
    TiledCamera,
    footprint,
    is_drawn,
    rotation,
    row_of,
    scales_of,
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
    matrix, _inverse = rotation(quaternions[g])
    factor = matrix * wp.diag(scales_of(log_scales[g]))
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
    q = quaternions[g]
    r, inverse_norm = rotation(q)
    scale = scales_of(log_scales[g])
    factor = r * wp.diag(scale)
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
        part = PosePart()
        point = vec3()
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
            w0 = row_of(pose, 0)
            w1 = row_of(pose, 1)
            w2 = row_of(pose, 2)
            jxz = -(s.jx * s.u_clamped)
            jyz = -(s.jy * s.v_clamped)
            d_factor += wp.outer(w0 * s.jx + w2 * jxz, d_a) + wp.outer(w1 * s.jy + w2 * jyz, d_b)
            g_a = factor * d_a
            g_b = factor * d_b
            d_jxz = wp.dot(g_a, w2)
            d_jyz = wp.dot(g_b, w2)
            d_u = camera.fx * dx
            d_v = camera.fy * dy
            if s.u > camera.u_low and s.u < camera.u_high:
                d_u -= s.jx * d_jxz
            if s.v > camera.v_low and s.v < camera.v_high:
                d_v -= s.jy * d_jyz
            of_jx = camera.fx * (wp.dot(g_a, w0) - s.u_clamped * d_jxz)
            of_jy = camera.fy * (wp.dot(g_b, w1) - s.v_clamped * d_jyz)
            d_inverse_z = of_jx + of_jy + d_u * s.p[0] + d_v * s.p[1]
            point = vec3(d_u * s.inverse_z, d_v * s.inverse_z, -(d_inverse_z * s.inverse_z * s.inverse_z))
            r0 = mean * point[0] + g_a * s.jx
            r1 = mean * point[1] + g_b * s.jy
            r2 = mean * point[2] + g_a * jxz + g_b * jyz
            part = PosePart(r0[0], r0[1], r0[2], point[0], r1[0], r1[1], r1[2], point[1], r2[0], r2[1], r2[2], point[2])
            sx = dx * 0.5 * camera.width
            sy = dy * 0.5 * camera.height
            half = 0.5 * (s.cxx - s.cyy)
            radius = 3.0 * wp.sqrt(0.5 * (s.cxx + s.cyy) + wp.sqrt(half * half + s.cxy * s.cxy))
            seen = vec3(seen[0] + wp.sqrt(sx * sx + sy * sy), seen[1] + 1.0, wp.max(seen[2], radius))
            point = w0 * point[0] + w1 * point[1] + w2 * point[2]
        for k in range(12):
            pose_parts[at * 12 + k] = part[k]
        if mean_stride > 0:
            d_means[at] = point
        d_mean += point
        if colour_stride > 0:
            d_colours[at] = own_colour
        d_colour += own_colour
    if mean_stride == 0:
        d_means[g] = d_mean
    if colour_stride == 0:
        d_colours[g] = d_colour
    d_logits[g] = d_logit
    sightings[g] = seen
    d_r = d_factor * wp.diag(scale)
    d_scale = vec3()
    for k in range(3):
        along = d_factor[0, k] * r[0, k] + d_factor[1, k] * r[1, k] + d_factor[2, k] * r[2, k]
        if log_scales[g][k] <= LOG_SCALE_MAX:
            d_scale[k] = along * scale[k]
    d_log_scales[g] = d_scale
    w = q[0] * inverse_norm
    x = q[1] * inverse_norm
    y = q[2] * inverse_norm
    z = q[3] * inverse_norm
    s01 = d_r[0, 1] + d_r[1, 0]
    s02 = d_r[0, 2] + d_r[2, 0]
    s12 = d_r[1, 2] + d_r[2, 1]
    a01 = d_r[1, 0] - d_r[0, 1]
    a02 = d_r[0, 2] - d_r[2, 0]
    a12 = d_r[2, 1] - d_r[1, 2]
    dq = 2.0 * vec4(
        x * a12 + y * a02 + z * a01,
        w * a12 + y * s01 + z * s02 - 2.0 * x * (d_r[1, 1] + d_r[2, 2]),
        w * a02 + x * s01 + z * s12 - 2.0 * y * (d_r[0, 0] + d_r[2, 2]),
        w * a01 + x * s02 + y * s12 - 2.0 * z * (d_r[0, 0] + d_r[1, 1]),
    )
    unit = vec4(w, x, y, z)
    d_quaternions[g] = (dq - unit * wp.dot(unit, dq)) * inverse_norm


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
