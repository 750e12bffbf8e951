"""From dL/dM, M = R(q) diag(exp s), to log scales and quaternions, and writing gradients of 16 Gaussians.

The second half of `project_backward.py`.
"""

import numpy as np

from gs2ci.core.kernels import helper
from gs2ci.render.cpu.projection import shape_factor
from gs2ci.render.simd.lanes import store_rows, transpose
from gs2ci.render.simd.vector import LANES, broadcast, get, put, store

_ZERO = np.float32(0)


@helper()
def add_outer(total, column, row):
    """Return total + column row^T, nine entries row by row."""
    return (
        total[0] + column[0] * row[0],
        total[1] + column[0] * row[1],
        total[2] + column[0] * row[2],
        total[3] + column[1] * row[0],
        total[4] + column[1] * row[1],
        total[5] + column[1] * row[2],
        total[6] + column[2] * row[0],
        total[7] + column[2] * row[1],
        total[8] + column[2] * row[2],
    )


@helper()
def scale_gradient(d_factor, factor):
    """Return dL/d log s_k = sum_i dL/dM_ik M_ik, for M = R diag(s)."""
    return (
        d_factor[0] * factor[0] + d_factor[3] * factor[3] + d_factor[6] * factor[6],
        d_factor[1] * factor[1] + d_factor[4] * factor[4] + d_factor[7] * factor[7],
        d_factor[2] * factor[2] + d_factor[5] * factor[5] + d_factor[8] * factor[8],
    )


@helper()
def quaternion_gradient(d_factor, scales, rotation):
    """Carry dL/dM through R(q) and the normalisation of q: the part along q itself is dropped."""
    r = shape_factor(d_factor, scales)  # dL/dR = dL/dM diag(s)
    w, x, y, z = rotation.quaternion
    dw = 2.0 * (x * (r[7] - r[5]) + y * (r[2] - r[6]) + z * (r[3] - r[1]))
    dx = 2.0 * (y * (r[1] + r[3]) + z * (r[2] + r[6]) + w * (r[7] - r[5]) - 2.0 * x * (r[4] + r[8]))
    dy = 2.0 * (x * (r[1] + r[3]) + z * (r[5] + r[7]) + w * (r[2] - r[6]) - 2.0 * y * (r[0] + r[8]))
    dz = 2.0 * (x * (r[2] + r[6]) + y * (r[5] + r[7]) + w * (r[3] - r[1]) - 2.0 * z * (r[0] + r[4]))
    along = dw * w + dx * x + dy * y + dz * z
    inverse_norm = rotation.inverse_norm
    return (
        (dw - along * w) * inverse_norm,
        (dx - along * x) * inverse_norm,
        (dy - along * y) * inverse_norm,
        (dz - along * z) * inverse_norm,
    )


@helper()
def store_triples(rows, first, count, triple, scratch):
    """Store three vectors as rows first ... first + count of a flat [*, 3] array."""
    for k in range(3):
        store(scratch, k * LANES, triple[k])
    for lane in range(count):
        for k in range(3):
            put(rows, 3 * (first + lane) + k, get(scratch, k * LANES + lane))


@helper()
def store_block(rows, first, count, d_log_scales, d_quaternions, d_logits, scratch):
    """Write the gradients of 16 Gaussians into `rows`: log scales, quaternions and logits, all flat."""
    out_log_scales, out_quaternions, out_logits = rows
    zero = broadcast(_ZERO)
    q0, q1, q2, q3 = d_quaternions
    columns = (
        d_log_scales[0],
        d_log_scales[1],
        d_log_scales[2],
        q0,
        q1,
        q2,
        q3,
        d_logits,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
        zero,
    )
    store_rows(scratch, 0, transpose(columns))
    for lane in range(count):
        row, source = first + lane, lane * LANES
        for k in range(3):
            put(out_log_scales, 3 * row + k, get(scratch, source + k))
        for k in range(4):
            put(out_quaternions, 4 * row + k, get(scratch, source + 3 + k))
        put(out_logits, row, get(scratch, source + 7))
