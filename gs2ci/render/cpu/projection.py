"""The geometry of projecting 16 Gaussians at a time (lanes = Gaussians), shared by the pass and its gradient.

Covariance and camera enter as factors. With M = R(q) diag(exp s) the covariance is M M^T; with W the rotation of
the pose and J the Jacobian of the pinhole camera at the centre, the 2D covariance is

    C = A A^T + DILATION I,      A = J W M   [2, 3], rows a and b.

Its determinant is then a sum of squares, |a x b|^2 + DILATION (|a|^2 + |b|^2) + DILATION^2 (Cauchy-Binet), and cannot
cancel however thin the Gaussian is.
"""

from typing import Any, NamedTuple

import numpy as np

from gs2ci.core.kernels import helper
from gs2ci.render.conventions import DILATION_PX2, LOG_SCALE_MAX, NEAR, QUATERNION_NORM_MIN
from gs2ci.render.cpu.record import (
    CENTRE_X,
    CENTRE_Y,
    FOCAL_X,
    FOCAL_Y,
    U_HIGH,
    U_LOW,
    V_HIGH,
    V_LOW,
)
from gs2ci.render.simd.elementary import exponential
from gs2ci.render.simd.vector import LANES, broadcast, load, maximum, minimum, square_root, where_ge

SCRATCH = 4 * LANES
"""Floats of scratch memory that the loaders need."""

_NEAR = np.float32(NEAR)
_DILATION = np.float32(DILATION_PX2)
_LOG_SCALE_MAX = np.float32(LOG_SCALE_MAX)
_NORM2_MIN = np.float32(QUATERNION_NORM_MIN**2)


class Rotation(NamedTuple):
    """A rotation: its nine entries row by row, and the unit quaternion with 1/norm (0 for a zero quaternion)."""

    matrix: Any
    quaternion: Any
    inverse_norm: Any


class Centre(NamedTuple):
    """A Gaussian's centre in camera coordinates, its slopes u = x/z and v = y/z, and the slopes clamped."""

    x: Any
    y: Any
    z: Any
    inverse_z: Any
    u: Any
    v: Any
    u_clamped: Any
    v_clamped: Any


class Footprint(NamedTuple):
    """A = J W M with J W (rows `jw_a`, `jw_b`), the normal a x b, and the moments of C = A A^T + DILATION I."""

    jw_a: Any
    jw_b: Any
    a: Any
    b: Any
    normal: Any
    cov_xx: Any
    cov_xy: Any
    cov_yy: Any
    inverse_yy: Any
    variance_x_given_y: Any


@helper()
def load_triples(rows, first, count, scratch):
    """Load rows first ... first + count of a flat [*, 3] array as three vectors; spare lanes repeat the last."""
    for lane in range(LANES):
        row = 3 * (first + min(lane, count - 1))
        for k in range(3):
            scratch[k * LANES + lane] = rows[row + k]
    return load(scratch, 0), load(scratch, LANES), load(scratch, 2 * LANES)


@helper()
def load_singles(values, first, count, scratch):
    """Load values first ... first + count as one vector; spare lanes repeat the last one."""
    for lane in range(LANES):
        scratch[lane] = values[first + min(lane, count - 1)]
    return load(scratch, 0)


@helper()
def load_rotation(quaternions, first, count, scratch):
    """Load flat [*, 4] quaternions (w, x, y, z), normalise them and form the rotation matrices."""
    for lane in range(LANES):
        row = 4 * (first + min(lane, count - 1))
        for k in range(4):
            scratch[k * LANES + lane] = quaternions[row + k]
    w, x, y, z = load(scratch, 0), load(scratch, LANES), load(scratch, 2 * LANES), load(scratch, 3 * LANES)
    norm2 = w * w + x * x + y * y + z * z
    zero = broadcast(np.float32(0))
    # With inverse_norm = 0 the formula below gives the identity.
    inverse_norm = where_ge(norm2, _NORM2_MIN, 1.0 / square_root(maximum(norm2, _NORM2_MIN)), zero)
    w, x, y, z = w * inverse_norm, x * inverse_norm, y * inverse_norm, z * inverse_norm
    matrix = (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
    return Rotation(matrix, (w, x, y, z), inverse_norm)


@helper()
def load_scales(log_scales, first, count, scratch):
    """Load flat [*, 3] log scales and return the scales."""
    s0, s1, s2 = load_triples(log_scales, first, count, scratch)
    return (
        exponential(minimum(s0, _LOG_SCALE_MAX)),
        exponential(minimum(s1, _LOG_SCALE_MAX)),
        exponential(minimum(s2, _LOG_SCALE_MAX)),
    )


@helper()
def shape_factor(matrix, scales):
    """Form M = R diag(scales), row by row."""
    s0, s1, s2 = scales
    return (
        matrix[0] * s0,
        matrix[1] * s1,
        matrix[2] * s2,
        matrix[3] * s0,
        matrix[4] * s1,
        matrix[5] * s2,
        matrix[6] * s0,
        matrix[7] * s1,
        matrix[8] * s2,
    )


@helper()
def view_centre(pose, camera, means):
    """Bring centres into one camera; `pose` is its world_to_camera as 16 floats."""
    m0, m1, m2 = means
    x = pose[0] * m0 + pose[1] * m1 + pose[2] * m2 + pose[3]
    y = pose[4] * m0 + pose[5] * m1 + pose[6] * m2 + pose[7]
    z = pose[8] * m0 + pose[9] * m1 + pose[10] * m2 + pose[11]
    # Centres before the near plane are not drawn; the bound keeps their unused numbers finite.
    inverse_z = 1.0 / maximum(z, _NEAR)
    u, v = x * inverse_z, y * inverse_z
    u_clamped = minimum(maximum(u, camera[U_LOW]), camera[U_HIGH])
    v_clamped = minimum(maximum(v, camera[V_LOW]), camera[V_HIGH])
    return Centre(x, y, z, inverse_z, u, v, u_clamped, v_clamped)


@helper()
def view_footprint(pose, camera, centre, factor):
    """Project the shapes `factor` = M into one camera.

    J = [[fx/z, 0, -fx u/z], [0, fy/z, -fy v/z]] with the clamped slopes u and v.
    """
    jx = camera[FOCAL_X] * centre.inverse_z
    jy = camera[FOCAL_Y] * centre.inverse_z
    jxz, jyz = -(jx * centre.u_clamped), -(jy * centre.v_clamped)
    jw_a = (jx * pose[0] + jxz * pose[8], jx * pose[1] + jxz * pose[9], jx * pose[2] + jxz * pose[10])
    jw_b = (jy * pose[4] + jyz * pose[8], jy * pose[5] + jyz * pose[9], jy * pose[6] + jyz * pose[10])
    a = row_times_matrix(jw_a, factor)
    b = row_times_matrix(jw_b, factor)
    normal = cross(a, b)
    a2, b2 = dot(a, a), dot(b, b)
    cov_yy = b2 + _DILATION
    inverse_yy = 1.0 / cov_yy
    # D = det C / Cyy, with det C = |a x b|^2 + DILATION |a|^2 + DILATION Cyy.
    variance = (dot(normal, normal) + _DILATION * a2) * inverse_yy + _DILATION
    return Footprint(jw_a, jw_b, a, b, normal, a2 + _DILATION, dot(a, b), cov_yy, inverse_yy, variance)


@helper()
def screen_position(camera, centre):
    """Return the pixel coordinates of the centres."""
    return (
        camera[FOCAL_X] * centre.u + camera[CENTRE_X],
        camera[FOCAL_Y] * centre.v + camera[CENTRE_Y],
    )


@helper()
def dot(a, b):
    """Return a . b for triples of vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@helper()
def cross(a, b):
    """Return a x b for triples of vectors."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@helper()
def row_times_matrix(row, matrix):
    """Return row @ matrix for a triple and nine entries, row by row."""
    return (
        row[0] * matrix[0] + row[1] * matrix[3] + row[2] * matrix[6],
        row[0] * matrix[1] + row[1] * matrix[4] + row[2] * matrix[7],
        row[0] * matrix[2] + row[1] * matrix[5] + row[2] * matrix[8],
    )


@helper()
def matrix_times_column(matrix, column):
    """Return matrix @ column for nine entries, row by row, and a triple."""
    return (
        matrix[0] * column[0] + matrix[1] * column[1] + matrix[2] * column[2],
        matrix[3] * column[0] + matrix[4] * column[1] + matrix[5] * column[2],
        matrix[6] * column[0] + matrix[7] * column[1] + matrix[8] * column[2],
    )
