"""What the measurement itself says of a geometry, before anything is fitted.

The middle view, carried along the poses through its depth, should look like the other views; coded by the masks, it
should give the measurement. What is left over compares geometries of any origin on equal terms: wrong poses and wrong
depths smear it. Here: the carrying, and that number. Not here: the choice (`choose`). For `gs2ci.reconstruct`; tables
of first geometries print the number.
"""

from typing import Final

import cv2
import numpy as np
import torch

from gs2ci.core.arrays import F32, F64
from gs2ci.core.records import Shot
from gs2ci.reconstruct.coding import Coding
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.lens import Lens

# A pixel's place in the middle view and the depth there depend on each other; the motion is small, so they settle.
_STEPS: Final = 4
# Farther outside than this, a coordinate says nothing more; OpenCV's fixed point would overflow.
_OUTSIDE_PX: Final = 1e4


def unexplained(shot: Shot, views: F32, geometry: Geometry, lens: Lens | None = None) -> float:
    """Return the root mean square of the measurement that the carried middle view leaves, in the measurement's unit.

    Args:
        shot: The measurement as far as it may be seen.
        views: Proxy views, [N, H, W, C]; the middle one is looked at.
        geometry: What to judge. Pixels that it sends outside take the nearest at the rim, so that a path that looks
            elsewhere gains nothing by it.
        lens: Through which the measurement was taken; views and geometry are then its canvas's.
    """
    carried = carried_views(views, geometry, lens)
    left = Coding.of(shot).forward(torch.from_numpy(carried)).numpy() - shot.measurement
    coded = shot.lit
    if shot.saturated is not None:
        coded &= ~shot.saturated
    return float(np.sqrt(np.mean(left[coded] ** 2, dtype=np.float64))) if coded.any() else 0.0


def carried_views(views: F32, geometry: Geometry, lens: Lens | None = None) -> F32:
    """Show the middle one of views, [N, H, W, C], as the sensor should see it from every pose of a geometry.

    Behind a lens, views and geometry are its canvas's, and the result, [N, H, W, C], has the sensor's size.
    """
    carried = np.stack([carried_view(views[geometry.reference], geometry, i) for i in range(len(views))])
    return carried if lens is None else lens.bent(carried)


def carried_view(reference: F32, geometry: Geometry, view: int) -> F32:
    """Show the middle view, [H, W, C], as it should look from another pose, by its depth and without occlusion."""
    height, width = reference.shape[:2]
    y, x = np.mgrid[:height, :width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(geometry.intrinsics).T
    pose = geometry.world_to_camera[view]
    at = np.stack([x, y], axis=-1)
    for _ in range(_STEPS):
        depth = _depth_in_view(geometry.inverse_depth, at, pose, geometry.intrinsics)
        points = (rays * depth[..., None] - pose[:3, 3]) @ pose[:3, :3] @ geometry.intrinsics.T
        # A point behind the middle view is nowhere in it: it keeps its place.
        ahead = points[..., 2] > 0
        at = np.where(ahead[..., None], points[..., :2] / np.where(ahead, points[..., 2], 1.0)[..., None], at)
        at = np.clip(at, -_OUTSIDE_PX, _OUTSIDE_PX)
    # OpenCV's first pixel has its centre at 0, ours at 0.5.
    map_x, map_y = (np.ascontiguousarray(at[..., k] - 0.5, np.float32) for k in (0, 1))
    carried: F32 = cv2.remap(reference, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return carried.reshape(reference.shape)


def _depth_in_view(inverse_depth: F32, at: F64, pose: F64, intrinsics: F64) -> F64:
    """Take the depths at pixels of the middle view, [H, W, 2], along the axis of a view at `pose`; at least a hair."""
    height, width = inverse_depth.shape
    columns, rows = (at[..., 0].clip(0, width - 1).astype(int), at[..., 1].clip(0, height - 1).astype(int))
    depth = 1 / inverse_depth[rows, columns].astype(np.float64)
    homogeneous = np.concatenate([at, np.ones_like(at[..., :1])], axis=-1)
    points = homogeneous @ np.linalg.inv(intrinsics).T * depth[..., None]
    along: F64 = points @ pose[2, :3] + pose[2, 3]
    ahead: F64 = np.maximum(along, 1e-3 * depth)
    return ahead
