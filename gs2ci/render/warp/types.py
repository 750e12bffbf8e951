"""Types and constants that all kernels of this folder share.

A block is at most `BLOCK` open pixels of one tile of one view; threads of a block take one pixel each. Everything is
float32 but for sums over all Gaussians and the fields of depth.
"""

import math
from typing import Final

import warp as wp

from gs2ci.render import conventions

BLOCK: Final = 32
"""Pixels of a block, and Gaussians that it loads at once."""
HELD: Final = 8
"""Gaussians whose factors a thread of the backward pass holds in registers: 8 take 122 of them, 32 spill."""

Record = wp.types.vector(length=9, dtype=wp.float32)
"""One Gaussian in one view: centre x, y, half the inverse variance of x given y, shear, half the inverse variance of y,
log opacity, colour."""
Row = wp.types.vector(length=9, dtype=wp.float32)
"""Sums over a block's pixels of the gradient by one Gaussian: six moments of its shape, colour."""
Held = wp.types.vector(length=HELD, dtype=wp.float32)
Monomials = wp.types.vector(length=6, dtype=wp.float32)
Pose = wp.types.matrix(shape=(4, 4), dtype=wp.float32)

LN_ALPHA_MIN = wp.constant(wp.float32(math.log(conventions.ALPHA_MIN)))
ALPHA_MIN = wp.constant(wp.float32(conventions.ALPHA_MIN))
ALPHA_MAX = wp.constant(wp.float32(conventions.ALPHA_MAX))
NEAR = wp.constant(wp.float32(conventions.NEAR))
DILATION = wp.constant(wp.float32(conventions.DILATION_PX2))
VARIANCE_MAX = wp.constant(wp.float32(conventions.SCREEN_SIGMA_MAX_PX**2))
LOG_SCALE_MAX = wp.constant(wp.float32(conventions.LOG_SCALE_MAX))
NORM2_MIN = wp.constant(wp.float32(conventions.QUATERNION_NORM_MIN**2))
INERT = wp.constant(wp.float32(-1e30))
"""Log opacity of a Gaussian that is not drawn: no pixel blends it."""
B = wp.constant(BLOCK)
H = wp.constant(HELD)
LEAST_TRANSMITTANCE: Final = 1e-30
"""Where blending never stops early it stops here, before float32 loses the light: the backward pass divides by it."""


@wp.struct
class TiledCamera:
    """A pinhole, the frame it projects to, and the frame's tiles; lengths in pixels, slopes of the clamp."""

    fx: wp.float32
    fy: wp.float32
    cx: wp.float32
    cy: wp.float32
    width: wp.float32
    height: wp.float32
    u_low: wp.float32
    u_high: wp.float32
    v_low: wp.float32
    v_high: wp.float32
    tile_w: wp.int32
    tile_h: wp.int32
    tiles_x: wp.int32
    tiles_y: wp.int32


@wp.struct
class Splat:
    """What one view makes of one Gaussian."""

    p: wp.vec3
    inverse_z: wp.float32
    u: wp.float32
    v: wp.float32
    u_clamped: wp.float32
    v_clamped: wp.float32
    jx: wp.float32
    jy: wp.float32
    a: wp.vec3
    b: wp.vec3
    n: wp.vec3
    cxx: wp.float32
    cxy: wp.float32
    cyy: wp.float32
    shear: wp.float32
    inverse_x_given_y: wp.float32
    inverse_y: wp.float32


@wp.func
def factor_of(q: wp.vec4, log_scales: wp.vec3):
    """Return a Gaussian's rotation, of a quaternion (w, x, y, z) of any norm (0: none), times its scales, cut."""
    n2 = wp.dot(q, q)
    inverse = wp.float32(0.0)
    if n2 >= NORM2_MIN:
        inverse = 1.0 / wp.sqrt(n2)
    w = q[0] * inverse
    x = q[1] * inverse
    y = q[2] * inverse
    z = q[3] * inverse
    matrix = wp.mat33(
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
    x_scale = wp.exp(wp.min(log_scales[0], LOG_SCALE_MAX))
    y_scale = wp.exp(wp.min(log_scales[1], LOG_SCALE_MAX))
    z_scale = wp.exp(wp.min(log_scales[2], LOG_SCALE_MAX))
    return matrix * wp.diag(wp.vec3(x_scale, y_scale, z_scale))


@wp.func
def see(pose: Pose, camera: TiledCamera, mean: wp.vec3, factor: wp.mat33):
    """Project a Gaussian; `factor` is its rotation times its scales."""
    s = Splat()
    # Written out: of a function that is called from here, `wp.grad` leaves the gradient out without a word (warp 1.19).
    w0 = wp.vec3(pose[0, 0], pose[0, 1], pose[0, 2])
    w1 = wp.vec3(pose[1, 0], pose[1, 1], pose[1, 2])
    w2 = wp.vec3(pose[2, 0], pose[2, 1], pose[2, 2])
    s.p = wp.vec3(wp.dot(w0, mean) + pose[0, 3], wp.dot(w1, mean) + pose[1, 3], wp.dot(w2, mean) + pose[2, 3])
    s.inverse_z = 1.0 / wp.max(s.p[2], NEAR)
    s.u = s.p[0] * s.inverse_z
    s.v = s.p[1] * s.inverse_z
    s.u_clamped = wp.clamp(s.u, camera.u_low, camera.u_high)
    s.v_clamped = wp.clamp(s.v, camera.v_low, camera.v_high)
    s.jx = camera.fx * s.inverse_z
    s.jy = camera.fy * s.inverse_z
    along = wp.transpose(factor)
    s.a = along * ((w0 - w2 * s.u_clamped) * s.jx)
    s.b = along * ((w1 - w2 * s.v_clamped) * s.jy)
    s.n = wp.cross(s.a, s.b)
    aa = wp.dot(s.a, s.a)
    bb = wp.dot(s.b, s.b)
    s.cxx = aa + DILATION
    s.cyy = bb + DILATION
    s.cxy = wp.dot(s.a, s.b)
    s.inverse_y = 1.0 / s.cyy
    # |a x b|^2 + d (|a|^2 + |b|^2) + d^2 over the variance of y: nothing cancels.
    given = wp.dot(s.n, s.n) * s.inverse_y + DILATION * (aa + bb + DILATION) * s.inverse_y
    s.inverse_x_given_y = 1.0 / given
    s.shear = -(s.cxy * s.inverse_y)
    return s


@wp.func
def is_drawn(s: Splat, inverse_opacity: wp.float32):
    """Tell whether a Gaussian is drawn at all."""
    return s.p[2] > NEAR and ALPHA_MIN * inverse_opacity <= 1.0 and s.cxx <= VARIANCE_MAX and s.cyy <= VARIANCE_MAX


@wp.func
def footprint(s: Splat, log_opacity: wp.float32, camera: TiledCamera, margin: wp.float32):
    """Return the box where alpha reaches its least value, widened by a margin: left, right, top, bottom, px."""
    reach = 2.0 * wp.max(log_opacity - LN_ALPHA_MIN, 0.0)
    ex = wp.sqrt(reach * s.cxx) + margin
    ey = wp.sqrt(reach * s.cyy) + margin
    x = camera.fx * s.u + camera.cx
    y = camera.fy * s.v + camera.cy
    return wp.vec4(x - ex, x + ex, y - ey, y + ey)


@wp.func
def touches(box: wp.vec4, camera: TiledCamera):
    """Tell whether a box touches the frame."""
    return box[1] >= 0.0 and box[3] >= 0.0 and box[0] <= camera.width and box[2] <= camera.height


@wp.func
def ln_alpha(record: Record, dx: wp.float32, dy: wp.float32):
    """Return the logarithm of a Gaussian's alpha at an offset from its centre."""
    t = dx + record[3] * dy
    return record[5] - record[2] * t * t - record[4] * dy * dy
