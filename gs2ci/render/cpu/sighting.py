"""What one view shows of 16 Gaussians on the screen; see `gs2ci.render.screen`."""

import numpy as np

from gs2ci.core.kernels import helper
from gs2ci.render.cpu.record import HEIGHT, WIDTH
from gs2ci.render.screen import RADIUS_SIGMAS
from gs2ci.render.simd.vector import broadcast, maximum, square_root, where_ge

COLUMNS = 3
"""Sum of the gradient's norms, number of sightings, largest radius."""

_ZERO = np.float32(0)
_HALF = np.float32(0.5)
_ONE = np.float32(1)
_SIGMAS = np.float32(RADIUS_SIGMAS)


@helper()
def add_sighting(total, camera, visible, footprint, screen):
    """Add one view to the three columns; the screen gradient is zero where `visible`, of `record.py`, is not 1."""
    x, y = screen.x * (_HALF * camera[WIDTH]), screen.y * (_HALF * camera[HEIGHT])
    half_difference = _HALF * (footprint.cov_xx - footprint.cov_yy)
    # The larger eigenvalue of the covariance; under the root stand squares only, so nothing cancels.
    root = square_root(half_difference * half_difference + footprint.cov_xy * footprint.cov_xy)
    variance = _HALF * (footprint.cov_xx + footprint.cov_yy) + root
    radius = where_ge(visible, _HALF, _SIGMAS * square_root(variance), broadcast(_ZERO))
    seen = where_ge(visible, _HALF, broadcast(_ONE), broadcast(_ZERO))
    return (total[0] + square_root(x * x + y * y), total[1] + seen, maximum(total[2], radius))
