"""Positions of a view warped to the middle view, the inner loop of `evidence`.

A point's position in the middle view and the depth there depend on each other. The motion is small, so
that a few steps of fixed-point iteration are enough. Not here: sampling at these positions, and its use.
"""

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.kernels import EXACT, f32_2, f64_1, f64_2, kernel
from gs2ci.reconstruct.geometry.path.adjustment_kernels import LEAST_RELATIVE_DEPTH

_STEPS = 4
# Coordinates are limited to this distance outside, beyond which OpenCV's fixed point would overflow.
_OUTSIDE_PX = 1e4


def carried_places(places: F64, inverse_depth: F32, pose: F64, intrinsics: F64, rays_of_pixels: F64) -> F32:
    """Find the positions in the middle view that correspond to positions in another view.

    Args:
        places: In the view, [P, 2] px; pixel centres at +0.5.
        inverse_depth: Of the middle view, [H, W].
        pose: The view's world_to_camera, [4, 4], with the middle view's camera as the world frame.
        intrinsics: Camera matrix in px, [3, 3].
        rays_of_pixels: Its inverse, [3, 3].

    Returns:
        Positions in the middle view, [P, 2] px, pixel centres at +0, as in OpenCV. A point behind the middle view's
        camera has no position in it; it keeps that of the last iteration.
    """
    # With R, t of the pose and K: a place whose point lies `along` the view's axis is seen at along K Rᵀ K⁻¹ (x, y, 1)
    # − K Rᵀ t, and `along` is t_z + depth (R K⁻¹)_z (x, y, 1) of the place that shows it.
    turned = intrinsics @ pose[:3, :3].T
    axis = np.append(pose[2, :3] @ rays_of_pixels, pose[2, 3])
    found = np.empty(places.shape, np.float32)
    _carry(places, inverse_depth, turned @ rays_of_pixels, turned @ pose[:3, 3], axis, found)
    return found


@kernel(f64_2, f32_2, f64_2, f64_1, f64_1, f32_2, fastmath=EXACT)
def _carry(places, inverse_depth, through, shift, axis, found):
    height, width = inverse_depth.shape
    for p in range(len(places)):
        x, y = places[p, 0], places[p, 1]
        a = through[0, 0] * x + through[0, 1] * y + through[0, 2]
        b = through[1, 0] * x + through[1, 1] * y + through[1, 2]
        c = through[2, 0] * x + through[2, 1] * y + through[2, 2]
        for _ in range(_STEPS):
            # Written so that NaN gives the first column and row.
            column = min(int(x), width - 1) if x > 0 else 0
            row = min(int(y), height - 1) if y > 0 else 0
            depth = 1 / np.float64(inverse_depth[row, column])
            along = axis[3] + (axis[0] * x + axis[1] * y + axis[2]) * depth
            along = max(along, LEAST_RELATIVE_DEPTH * depth)
            ahead = c * along - shift[2]
            if ahead > 0:
                per_ahead = 1 / ahead
                x = min(max((a * along - shift[0]) * per_ahead, -_OUTSIDE_PX), _OUTSIDE_PX)
                y = min(max((b * along - shift[1]) * per_ahead, -_OUTSIDE_PX), _OUTSIDE_PX)
        found[p, 0] = x - 0.5
        found[p, 1] = y - 0.5
