"""Projection, backward: gradient records in, gradients of parameters and poses out.

The geometry and its names are those of `projection.py`. With G = dL/d ln(alpha) summed over pixels (S = sum G,
St = sum G t, ...), D the variance of x given y and Z = Cyy, the log of the 2D Gaussian is -t^2/(2D) - dy^2/(2Z),
t = dx - (Cxy/Z) dy, hence

    dL/d mean_x = St / D                 dL/d mean_y = SHEAR dL/d mean_x + Sy / Z
    dL/d D = Stt / (2 D^2)               dL/d SHEAR = -Sty / D               dL/d (1/Z) = -Syy / 2

and through C = A A^T + DILATION I, with rows a and b of A and the residual e = a + SHEAR b,

    dL/da = (Stt / D^2) e + h b,         h = Sty / (D Z)
    dL/db = SHEAR dL/da + h e + (Syy / Z^2) b.

e is what is left of a after projecting it on b: it is formed as (b x (a x b) + DILATION a) / Z, without the
subtraction.
"""

from typing import Any, NamedTuple

import numpy as np

from gs2ci.core.kernels import b1, f32_1, f32_2, f64_2, helper, i64, kernel
from gs2ci.render.conventions import DILATION_PX2
from gs2ci.render.cpu.project import BLOCKS_PER_TASK
from gs2ci.render.cpu.projection import (
    SCRATCH,
    cross,
    load_rotation,
    load_scales,
    load_singles,
    load_triples,
    matrix_times_column,
    row_times_matrix,
    shape_factor,
    view_centre,
    view_footprint,
)
from gs2ci.render.cpu.record import (
    ACROSS,
    ALONG,
    FIELDS,
    FOCAL_X,
    FOCAL_Y,
    SHEAR,
    SUM,
    SUM_BLUE,
    SUM_GREEN,
    SUM_RED,
    SUM_T,
    SUM_TT,
    SUM_TY,
    SUM_Y,
    SUM_YY,
    U_HIGH,
    U_LOW,
    V_HIGH,
    V_LOW,
    VISIBLE,
)
from gs2ci.render.cpu.shape_gradient import (
    add_outer,
    quaternion_gradient,
    scale_gradient,
    store_block,
    store_triples,
)
from gs2ci.render.cpu.sighting import add_sighting
from gs2ci.render.simd.elementary import LN2, exponential
from gs2ci.render.simd.lanes import load_transposed
from gs2ci.render.simd.vector import LANES, any_ge, broadcast, load, prefetch, store, where_ge

POSE_ENTRIES = 12
"""The upper three rows of a pose."""

_ZERO = np.float32(0)
_HALF = np.float32(0.5)
_TWO_LN2 = np.float32(2.0 * LN2)
_DILATION = np.float32(DILATION_PX2)


class ScreenGradient(NamedTuple):
    """Gradients of a Gaussian's screen position and of the rows a and b of A; zero where it is not visible."""

    x: Any
    y: Any
    a: Any
    b: Any


class ViewGradient(NamedTuple):
    """One view's part of the gradients: camera point, rows a and b of A, rows of J W, all triples."""

    point: Any
    a: Any
    b: Any
    jw_a: Any
    jw_b: Any


def tasks_for(blocks: int) -> int:
    """Return the number of tasks of `differentiate_project`, each with its own partial sum of the pose gradients."""
    return -(-blocks // BLOCKS_PER_TASK)


@helper()
def _sum_bands(sums, offset):
    """Add up the gradient records of all bands, in order; returns the nine sums as columns."""
    c = load_transposed(sums[0], offset)
    total = (c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
    for band in range(1, sums.shape[0]):
        c = load_transposed(sums[band], offset)
        total = (
            total[0] + c[0],
            total[1] + c[1],
            total[2] + c[2],
            total[3] + c[3],
            total[4] + c[4],
            total[5] + c[5],
            total[6] + c[6],
            total[7] + c[7],
            total[8] + c[8],
        )
    return total


@helper()
def _place(records, sums, block, blocks, view, views):
    """Return where a block begins in a view, and ask for what is read after it: views lie megabytes apart."""
    ahead = ((view + 1) * blocks + block if view + 1 < views else block + 1) * LANES * FIELDS
    if ahead + LANES * FIELDS <= records.shape[0]:
        for line in range(LANES):
            prefetch(records, ahead + line * FIELDS)
            prefetch(sums, ahead + line * FIELDS)
    return (view * blocks + block) * LANES * FIELDS


@helper()
def _scaled(triple, factor):
    return (triple[0] * factor, triple[1] * factor, triple[2] * factor)


@helper()
def _plus(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@helper()
def _where_visible(visible, triple):
    zero = broadcast(_ZERO)
    return (
        where_ge(visible, _HALF, triple[0], zero),
        where_ge(visible, _HALF, triple[1], zero),
        where_ge(visible, _HALF, triple[2], zero),
    )


@helper()
def _screen_gradient(fields, footprint, sums):
    """Carry sums over pixels to the screen position and to the rows of A (equations above)."""
    inverse_d = fields[ACROSS] * _TWO_LN2
    inverse_z = fields[ALONG] * _TWO_LN2
    shear, visible = fields[SHEAR], fields[VISIBLE]
    x = inverse_d * sums[SUM_T]
    y = shear * x + inverse_z * sums[SUM_Y]
    residual = _scaled(_plus(cross(footprint.b, footprint.normal), _scaled(footprint.a, _DILATION)), inverse_z)
    h = inverse_d * inverse_z * sums[SUM_TY]
    a = _plus(_scaled(residual, inverse_d * inverse_d * sums[SUM_TT]), _scaled(footprint.b, h))
    b = _plus(
        _plus(_scaled(a, shear), _scaled(residual, h)),
        _scaled(footprint.b, inverse_z * inverse_z * sums[SUM_YY]),
    )
    zero = broadcast(_ZERO)
    return ScreenGradient(
        where_ge(visible, _HALF, x, zero),
        where_ge(visible, _HALF, y, zero),
        _where_visible(visible, a),
        _where_visible(visible, b),
    )


@helper()
def _unless_clamped(value, low, high, gradient):
    zero = broadcast(_ZERO)
    return where_ge(low, value, zero, where_ge(value, high, zero, gradient))


@helper()
def _view_gradient(pose, camera, centre, factor, screen):
    """Carry the screen gradient through the camera: x = fx u + cx, and J W with J from the clamped slopes."""
    fx, fy = camera[FOCAL_X], camera[FOCAL_Y]
    jw_a = matrix_times_column(factor, screen.a)
    jw_b = matrix_times_column(factor, screen.b)
    # The entries of J: (j_x, 0, j_xz), (0, j_y, j_yz).
    d_jx = jw_a[0] * pose[0] + jw_a[1] * pose[1] + jw_a[2] * pose[2]
    d_jxz = jw_a[0] * pose[8] + jw_a[1] * pose[9] + jw_a[2] * pose[10]
    d_jy = jw_b[0] * pose[4] + jw_b[1] * pose[5] + jw_b[2] * pose[6]
    d_jyz = jw_b[0] * pose[8] + jw_b[1] * pose[9] + jw_b[2] * pose[10]
    inverse_z = centre.inverse_z
    d_u = fx * screen.x - _unless_clamped(centre.u, camera[U_LOW], camera[U_HIGH], fx * inverse_z * d_jxz)
    d_v = fy * screen.y - _unless_clamped(centre.v, camera[V_LOW], camera[V_HIGH], fy * inverse_z * d_jyz)
    d_inverse_z = (
        fx * (d_jx - centre.u_clamped * d_jxz)
        + fy * (d_jy - centre.v_clamped * d_jyz)
        + (d_u * centre.x + d_v * centre.y)
    )
    point = (d_u * inverse_z, d_v * inverse_z, -(d_inverse_z * inverse_z * inverse_z))
    return ViewGradient(point, screen.a, screen.b, jw_a, jw_b)


@helper()
def _add_pose_part(pose_sums, offset, camera, centre, mean, gradient):
    """Add dL/d(pose), per lane: a point's p = W m + t, and the rows of J W."""
    jx, jy = camera[FOCAL_X] * centre.inverse_z, camera[FOCAL_Y] * centre.inverse_z
    jxz, jyz = -(jx * centre.u_clamped), -(jy * centre.v_clamped)
    point, jw_a, jw_b = gradient.point, gradient.jw_a, gradient.jw_b
    for k in range(3):
        _add(pose_sums, offset + k * LANES, point[0] * mean[k] + jx * jw_a[k])
        _add(pose_sums, offset + (4 + k) * LANES, point[1] * mean[k] + jy * jw_b[k])
        _add(pose_sums, offset + (8 + k) * LANES, point[2] * mean[k] + jxz * jw_a[k] + jyz * jw_b[k])
        _add(pose_sums, offset + (4 * k + 3) * LANES, point[k])


@helper()
def _add(array, offset, value):
    store(array, offset, load(array, offset) + value)


@helper()
def _rotate_back(pose, point):
    """Return W^T point."""
    return row_times_matrix(point, (pose[0], pose[1], pose[2], pose[4], pose[5], pose[6], pose[8], pose[9], pose[10]))


@helper()
def _differentiate_block(block, inputs, poses, camera, records, sums, outputs, pose_sums, scratch):
    """Differentiate 16 Gaussians in all views; adds to `pose_sums` [V * 12 * 16] lane by lane."""
    means, means_differ, log_scales, quaternions, logits, colours_differ = inputs
    d_means, d_log_scales, d_quaternions, d_logits, d_colours, sightings = outputs
    count, views = logits.shape[0], poses.shape[0]
    blocks = (count + LANES - 1) // LANES
    first = block * LANES
    present = min(LANES, count - first)
    rotation = load_rotation(quaternions, first, present, scratch)
    scales = load_scales(log_scales, first, present, scratch)
    factor = shape_factor(rotation.matrix, scales)
    mean = load_triples(means, first, present, scratch)
    # 1 - sigmoid(x) = sigmoid(-x) keeps its digits where the opacity is nearly one.
    one_minus_opacity = 1.0 / (1.0 + exponential(load_singles(logits, first, present, scratch)))
    zero = broadcast(_ZERO)
    d_factor = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
    d_mean, d_colour, d_logit, seen = (zero, zero, zero), (zero, zero, zero), zero, (zero, zero, zero)
    for view in range(views):
        offset = _place(records, sums[0], block, blocks, view, views)
        view_sums = _sum_bands(sums, offset)
        colour_part = (view_sums[SUM_RED], view_sums[SUM_GREEN], view_sums[SUM_BLUE])
        if colours_differ:
            store_triples(d_colours, view * count + first, present, colour_part, scratch)
        else:
            d_colour = _plus(d_colour, colour_part)
        fields = load_transposed(records, offset)
        if not any_ge(fields[VISIBLE], _HALF):
            continue
        if means_differ:
            mean = load_triples(means, view * count + first, present, scratch)
        d_logit = d_logit + view_sums[SUM] * one_minus_opacity
        centre = view_centre(poses[view], camera, mean)
        footprint = view_footprint(poses[view], camera, centre, factor)
        screen = _screen_gradient(fields, footprint, view_sums)
        seen = add_sighting(seen, camera, fields[VISIBLE], footprint, screen)
        part = _view_gradient(poses[view], camera, centre, factor, screen)
        mean_part = _rotate_back(poses[view], part.point)
        if means_differ:
            store_triples(d_means, view * count + first, present, mean_part, scratch)
        else:
            d_mean = _plus(d_mean, mean_part)
        d_factor = add_outer(d_factor, footprint.jw_a, part.a)
        d_factor = add_outer(d_factor, footprint.jw_b, part.b)
        _add_pose_part(pose_sums, view * POSE_ENTRIES * LANES, camera, centre, mean, part)
    if not colours_differ:
        store_triples(d_colours, first, present, d_colour, scratch)
    store_triples(sightings, first, present, seen, scratch)
    d_log_scale = scale_gradient(d_factor, factor)
    d_quaternion = quaternion_gradient(d_factor, scales, rotation)
    if not means_differ:
        store_triples(d_means, first, present, d_mean, scratch)
    rows = (d_log_scales, d_quaternions, d_logits)
    store_block(rows, first, present, d_log_scale, d_quaternion, d_logit, scratch)


@kernel(
    *(i64, i64, f32_1, b1, f32_1, f32_1, f32_1, f32_1, b1, f32_2, f32_1, f32_1, f32_2),
    *(f32_1, f32_1, f32_1, f32_1, f32_1, f32_1, f64_2),
)
def differentiate_project(
    from_task,
    to_task,
    means,
    means_differ,
    log_scales,
    quaternions,
    logits,
    colours,
    colours_differ,
    poses,
    camera,
    records,
    sums,
    d_means,
    d_log_scales,
    d_quaternions,
    d_logits,
    d_colours,
    sightings,
    pose_parts,
):
    """Carry gradient records to all parameters and poses.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        means: As for `project`; likewise up to `camera`, and `records` as it left them.
        means_differ: See `means`.
        log_scales: See `means`.
        quaternions: See `means`.
        logits: See `means`.
        colours: See `means`.
        colours_differ: See `means`.
        poses: See `means`.
        camera: See `means`.
        records: See `means`.
        sums: The result of `differentiate_blend`, [bands, V * blocks * 256].
        d_means: Written: shaped like `means`; where these differ, zero before, as what is not seen writes nothing.
        d_log_scales: Written: [G * 3].
        d_quaternions: Written: [G * 4].
        d_logits: Written: [G].
        d_colours: Written: shaped like `colours`.
        sightings: Written: the columns of `sighting.py`, [G * 3].
        pose_parts: Written: [tasks, V * 12] float64. Tasks are cut by Gaussians alone, so adding the parts in
            order gives the same pose gradient whatever the number of threads.
    """
    views = poses.shape[0]
    blocks = (logits.shape[0] + LANES - 1) // LANES
    inputs = (means, means_differ, log_scales, quaternions, logits, colours_differ)
    outputs = (d_means, d_log_scales, d_quaternions, d_logits, d_colours, sightings)
    for task in range(from_task, to_task):
        scratch = np.empty(max(SCRATCH, LANES * LANES), np.float32)
        pose_sums = np.zeros(views * POSE_ENTRIES * LANES, np.float32)
        for block in range(task * BLOCKS_PER_TASK, min(blocks, (task + 1) * BLOCKS_PER_TASK)):
            _differentiate_block(block, inputs, poses, camera, records, sums, outputs, pose_sums, scratch)
        for entry in range(views * POSE_ENTRIES):
            total = 0.0
            for lane in range(LANES):
                total += np.float64(pose_sums[entry * LANES + lane])
            pose_parts[task, entry] = total
