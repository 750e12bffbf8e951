"""How far the depth maps of several views agree: how much each of their pixels is to be trusted.

A pixel's point is compared with what the other maps show where they see it. Rows are the tasks that threads share, so
the result is the same for any number of them. Not here: the maps (`sweep`), what trust is for (`fit.surfaces`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.kernels import EXACT, f32_3, f64, f64_3, f64_4, i64, in_parts, kernel
from gs2ci.render.conventions import NEAR

# Maps that differ by at most so much parallax along the whole path, px, show the same surface.
_SAME_PX: Final = 1.5
# The share of the other maps that see a pixel's surface too: up to the first value its weight is 0, from the second
# on 1.
_FROM, _TO = 0.3, 0.8


def agreement(inverse_depth: F32, world_to_camera: F64, intrinsics: F64, parallax_px: float) -> F32:
    """Return weights by how far several maps of inverse depth agree, [K, H, W] in [0, 1].

    A single map, or a point that no other map sees, gets weight 0.

    Args:
        inverse_depth: [K, H, W].
        world_to_camera: Their poses, [K, 4, 4].
        intrinsics: [3, 3], px.
        parallax_px: The parallax along the whole path at an inverse depth of 1.
    """
    moved = world_to_camera[None] @ np.linalg.inv(world_to_camera)[:, None]
    # Place in another map, times its depth there over that here: turned @ [x, y, 1] + shift * inverse depth.
    turned = intrinsics @ moved[..., :3, :3] @ np.linalg.inv(intrinsics)
    shift = (intrinsics @ moved[..., :3, 3:])[..., 0]
    trust = np.empty_like(inverse_depth)
    tasks = inverse_depth.shape[0] * inverse_depth.shape[1]
    in_parts(_agree, tasks, inverse_depth, turned, shift, float(parallax_px), trust)
    return trust


@kernel(i64, i64, f32_3, f64_4, f64_3, f64, f32_3, fastmath=EXACT)
def _agree(from_task, to_task, inverse_depth, turned, shift, parallax_px, trust):
    count, height, width = inverse_depth.shape
    for task in range(from_task, to_task):
        k, row = task // height, task % height
        y = row + 0.5
        for column in range(width):
            x, rho = column + 0.5, inverse_depth[k, row, column]
            seeing = agreeing = 0
            for other in range(count):
                if other == k:
                    continue
                turn, far = turned[k, other], shift[k, other]
                z = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] + far[2] * rho
                if not z > NEAR:
                    continue
                c = np.floor((turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] + far[0] * rho) / z)
                r = np.floor((turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] + far[1] * rho) / z)
                if 0 <= c < width and 0 <= r < height:
                    seeing += 1
                    agreeing += abs(inverse_depth[other, int(r), int(c)] - rho / z) * parallax_px < _SAME_PX
            share = agreeing / max(seeing, 1)
            trust[k, row, column] = min(max((share - _FROM) / (_TO - _FROM), 0.0), 1.0)
