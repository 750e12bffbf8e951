"""What the kernels hand to each other: the fields of a projected Gaussian, of its gradient, and of the camera.

A projected Gaussian fills one 64-byte cache line of 16 float32; so does its gradient. They are kept as [V, blocks, 16,
16]: for each view, blocks of 16 Gaussians, each with 16 fields.

The 2D covariance C = [[Cxx, Cxy], [Cxy, Cyy]] is never inverted. Its quadratic form is kept as the Gaussian of y
times the Gaussian of x given y:

    (dx, dy) C^-1 (dx, dy)^T  =  t^2 / D + dy^2 / Cyy,      t = dx + SHEAR dy,
    SHEAR = -Cxy / Cyy,   D = Cxx - Cxy^2 / Cyy  (the variance of x given y).

Both terms are positive, so a needle across the whole image loses nothing to cancellation; the textbook form
a dx^2 + 2 b dx dy + c dy^2 subtracts numbers a thousand times larger than their difference there. It costs the
same five multiplications. In powers of two, with o the opacity,

    log2 alpha = LOG2_OPACITY - ACROSS t^2 - ALONG dy^2.
"""

from typing import Final

FIELDS: Final = 16

# A projected Gaussian.
MEAN_X: Final = 0  # centre, px
MEAN_Y: Final = 1
ACROSS: Final = 2  # log2(e) / (2 D)
SHEAR: Final = 3
ALONG: Final = 4  # log2(e) / (2 Cyy)
LOG2_OPACITY: Final = 5
RED: Final = 6
GREEN: Final = 7
BLUE: Final = 8
LEVEL: Final = 9  # log2(opacity / ALPHA_MIN): the footprint is ACROSS t^2 + ALONG dy^2 <= LEVEL
EXTENT_X: Final = 10  # half the footprint's bounding box, px
EXTENT_Y: Final = 11
DEPTH: Final = 12
VISIBLE: Final = 13  # 1, NEARLY or 0
WIDEST_DY: Final = 14  # dy at which the footprint reaches dx = EXTENT_X; by symmetry -dy at -EXTENT_X
INVERSE_ACROSS: Final = 15

NEARLY: Final = 0.25
"""VISIBLE of a Gaussian that touches no pixel, but would if its footprint were wider by the margin of the lists."""
UNSEEN_LOG2: Final = -1e30
"""LOG2_OPACITY of what is not visible: lists that outlive a rendering may still hold it."""

# Its gradient: sums over pixels of G = dL/d ln(alpha), and of the blending weight times dL/d(pixel colour).
SUM: Final = 0
SUM_T: Final = 1
SUM_Y: Final = 2
SUM_TT: Final = 3
SUM_TY: Final = 4
SUM_YY: Final = 5
SUM_RED: Final = 6
SUM_GREEN: Final = 7
SUM_BLUE: Final = 8

# The camera, shared by all views.
FOCAL_X: Final = 0
FOCAL_Y: Final = 1
CENTRE_X: Final = 2
CENTRE_Y: Final = 3
WIDTH: Final = 4
HEIGHT: Final = 5
U_LOW: Final = 6  # bounds of x/z and y/z at which the projection is linearised
U_HIGH: Final = 7
V_LOW: Final = 8
V_HIGH: Final = 9
CAMERA_FIELDS: Final = 10
