"""Projection, forward: Gaussians and poses in, one record per Gaussian and view out.

Sixteen Gaussians at a time, all views in the inner loop, so that parameters are read once. The geometry is in
`projection.py`, the record in `record.py`.
"""

import numpy as np

from gs2ci.core.kernels import b1, f32, f32_1, f32_2, helper, i64, kernel
from gs2ci.render.conventions import ALPHA_MIN, NEAR, SCREEN_SIGMA_MAX_PX
from gs2ci.render.cpu.projection import (
    SCRATCH,
    load_rotation,
    load_scales,
    load_singles,
    load_triples,
    screen_position,
    shape_factor,
    view_centre,
    view_footprint,
)
from gs2ci.render.cpu.record import FIELDS, HEIGHT, NEARLY, UNSEEN_LOG2, VISIBLE, WIDTH
from gs2ci.render.simd.elementary import LN2, LOG2E, exponential, logarithm
from gs2ci.render.simd.lanes import store_rows, transpose
from gs2ci.render.simd.vector import LANES, broadcast, maximum, square_root, where_ge

BLOCKS_PER_TASK = 32

_ZERO = np.float32(0)
_ONE = np.float32(1)
_HALF = np.float32(0.5)
_NEARLY = np.float32(NEARLY)
_UNSEEN_LOG2 = np.float32(UNSEEN_LOG2)
_NEAR = np.float32(NEAR)
_ALPHA_MIN = np.float32(ALPHA_MIN)
_LOG_ALPHA_MIN = np.float32(np.log(ALPHA_MIN))
_HALF_LOG2E = np.float32(0.5 * LOG2E)
_LOG2E = np.float32(LOG2E)
_TWO_LN2 = np.float32(2.0 * LN2)
_VARIANCE_MAX = np.float32(SCREEN_SIGMA_MAX_PX**2)


@helper()
def _in_frame(camera, position, extent_x, extent_y, inside, outside):
    """Return `inside` in the lanes whose box can touch a pixel, else `outside`; NaN counts as outside."""
    x, y = position
    inside = where_ge(x + extent_x, _ZERO, inside, outside)
    inside = where_ge(y + extent_y, _ZERO, inside, outside)
    inside = where_ge(camera[WIDTH], x - extent_x, inside, outside)
    return where_ge(camera[HEIGHT], y - extent_y, inside, outside)


@helper()
def _visible(camera, centre, footprint, opacity, position, extent, margin):
    """Return 1 in the lanes whose Gaussian can touch a pixel, NEARLY where it could if it were wider, else 0."""
    zero, one = broadcast(_ZERO), broadcast(_ONE)
    # What can never be drawn, NaN included.
    drawn = where_ge(_NEAR, centre.z, zero, where_ge(opacity, _ALPHA_MIN, one, zero))
    drawn = where_ge(_VARIANCE_MAX, footprint.cov_xx, drawn, zero)
    drawn = where_ge(_VARIANCE_MAX, footprint.cov_yy, drawn, zero)
    nearly = _in_frame(camera, position, extent[0] + margin, extent[1] + margin, broadcast(_NEARLY), zero)
    return where_ge(drawn, _HALF, _in_frame(camera, position, extent[0], extent[1], one, nearly), zero)


@helper()
def _footprint_record(camera, centre, footprint, opacity, log_opacity, colour, margin):
    """Form the sixteen record fields, in the order of `record.py`."""
    position = screen_position(camera, centre)
    # alpha >= ALPHA_MIN inside the ellipse of squared Mahalanobis radius 2 ln(opacity / ALPHA_MIN).
    log_range = maximum(log_opacity - _LOG_ALPHA_MIN, _ZERO)
    extent_x = square_root(2.0 * log_range * footprint.cov_xx)
    extent_y = square_root(2.0 * log_range * footprint.cov_yy)
    visible = _visible(camera, centre, footprint, opacity, position, (extent_x, extent_y), margin)
    return (
        position[0],
        position[1],
        _HALF_LOG2E / footprint.variance_x_given_y,
        -(footprint.cov_xy * footprint.inverse_yy),
        _HALF_LOG2E * footprint.inverse_yy,
        where_ge(visible, _HALF, _LOG2E * log_opacity, broadcast(_UNSEEN_LOG2)),
        colour[0],
        colour[1],
        colour[2],
        _LOG2E * log_range,
        extent_x,
        extent_y,
        centre.z,
        visible,
        extent_x * footprint.cov_xy / footprint.cov_xx,
        _TWO_LN2 * footprint.variance_x_given_y,
    )


@kernel(i64, i64, f32_1, b1, f32_1, f32_1, f32_1, f32_1, b1, f32_2, f32_1, f32, f32_1)
def project(
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
    margin,
    records,
):
    """Project G Gaussians into V views.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        means: [G * 3] float32, or [V * G * 3] if `means_differ` between the views.
        means_differ: See `means`.
        log_scales: [G * 3].
        quaternions: [G * 4].
        logits: [G].
        colours: [G * 3], or [V * G * 3] if `colours_differ` between the views.
        colours_differ: See `colours`.
        poses: world_to_camera, [V, 16].
        camera: The fields of `record.py`.
        margin: By which footprints are widened where lists are to outlive this rendering, px, float32.
        records: Written: [V * blocks * 256].
    """
    count = logits.shape[0]
    blocks = (count + LANES - 1) // LANES
    for task in range(from_task, to_task):
        scratch = np.empty(SCRATCH, np.float32)
        for block in range(task * BLOCKS_PER_TASK, min(blocks, (task + 1) * BLOCKS_PER_TASK)):
            first = block * LANES
            present = min(LANES, count - first)
            rotation = load_rotation(quaternions, first, present, scratch)
            factor = shape_factor(rotation.matrix, load_scales(log_scales, first, present, scratch))
            mean = load_triples(means, first, present, scratch)
            inverse_opacity = 1.0 + exponential(-load_singles(logits, first, present, scratch))
            colour = load_triples(colours, first, present, scratch)
            for view in range(poses.shape[0]):
                if means_differ:
                    mean = load_triples(means, view * count + first, present, scratch)
                if colours_differ:
                    colour = load_triples(colours, view * count + first, present, scratch)
                centre = view_centre(poses[view], camera, mean)
                footprint = view_footprint(poses[view], camera, centre, factor)
                fields = _footprint_record(
                    camera, centre, footprint, 1.0 / inverse_opacity, -logarithm(inverse_opacity), colour, margin
                )
                offset = (view * blocks + block) * LANES * FIELDS
                store_rows(records, offset, transpose(fields))
                for lane in range(present, LANES):
                    records[offset + lane * FIELDS + VISIBLE] = _ZERO
