"""Where the places of a view lie in the middle view, by its depth: the inner loop of `evidence`.

A point's place in the middle view and the depth there depend on each other. The motion is small, so that a few steps
of fixed-point iteration settle both. Not here: looking the places up, and what is made of them.
"""

import numba
import numpy as np

from gs2ci.core.arrays import F32, F64

_STEPS = 4
# Farther outside than this, a coordinate says nothing more; OpenCV's fixed point would overflow.
_OUTSIDE_PX = 1e4
# A depth along a view's axis is at least this share of the middle view's: what is seen lies before the camera.
_LEAST_AHEAD = 1e-3


@numba.njit(cache=True, error_model="numpy")
def carried_places(places: F64, inverse_depth: F32, pose: F64, intrinsics: F64, rays_of_pixels: F64) -> F32:
    """Find where the middle view shows what a view shows at some places.

    Args:
        places: In the view, [P, 2] px; pixel centres at +0.5.
        inverse_depth: Of the middle view, [H, W].
        pose: The view's world_to_camera, [4, 4], the middle view's camera being the world.
        intrinsics: Camera matrix in px, [3, 3].
        rays_of_pixels: Its inverse, [3, 3].

    Returns:
        Places in the middle view, [P, 2] px, pixel centres at +0, as OpenCV counts. A point behind the middle view is
        nowhere in it: it stays where it was last.
    """
    height, width = inverse_depth.shape
    found = np.empty(places.shape, np.float32)
    ray, at_ray, seen = np.empty(3), np.empty(3), np.empty(3)
    for p in range(len(places)):
        x, y = places[p, 0], places[p, 1]
        for i in range(3):
            ray[i] = rays_of_pixels[i, 0] * x + rays_of_pixels[i, 1] * y + rays_of_pixels[i, 2]
        for _ in range(_STEPS):
            # Written so that a place that is no number takes the first column and row.
            column = min(int(x), width - 1) if x > 0 else 0
            row = min(int(y), height - 1) if y > 0 else 0
            depth = 1 / np.float64(inverse_depth[row, column])
            along = pose[2, 3]
            for i in range(3):
                at_ray[i] = rays_of_pixels[i, 0] * x + rays_of_pixels[i, 1] * y + rays_of_pixels[i, 2]
                along += pose[2, i] * at_ray[i] * depth
            along = max(along, _LEAST_AHEAD * depth)
            for j in range(3):
                seen[j] = 0.0
                for i in range(3):
                    seen[j] += (ray[i] * along - pose[i, 3]) * pose[i, j]
            ahead = intrinsics[2, 0] * seen[0] + intrinsics[2, 1] * seen[1] + intrinsics[2, 2] * seen[2]
            if ahead > 0:
                x = (intrinsics[0, 0] * seen[0] + intrinsics[0, 1] * seen[1] + intrinsics[0, 2] * seen[2]) / ahead
                y = (intrinsics[1, 0] * seen[0] + intrinsics[1, 1] * seen[1] + intrinsics[1, 2] * seen[2]) / ahead
                x = min(max(x, -_OUTSIDE_PX), _OUTSIDE_PX)
                y = min(max(y, -_OUTSIDE_PX), _OUTSIDE_PX)
        found[p, 0] = x - 0.5
        found[p, 1] = y - 0.5
    return found
