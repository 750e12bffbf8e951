"""The motion of things in the picture: dense optical flow minus the flow by the camera's motion and the depth.

Here: the part of the flow from the reference view to the others that a scene at rest would show, and the velocity that
fits the rest. Not here: the flow between two pictures (`decode.patches.flow`), its use (`fit.scene.motion`).
"""

from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.decode.patches.flow import LEAST_SIDE_PX, flow_from
from gs2ci.reconstruct.geometry.depth.view_depths import grid
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.motion import predict_positions

# Flow would follow the residue of the masks in decoded views: more blur than for corners, which stand out from it.
_BLUR_PX: Final = 1.5
# Views nearer to the reference than this, in units of half the exposure, give a velocity that is mostly noise.
_LEAST_TIME: Final = 0.25


def velocity(views: F32, geometry: Geometry, times: F64) -> F32:
    """Estimate the velocity of each pixel of the reference view, [H, W, 2] float32 in px per unit of time.

    The camera's part is subtracted. It is the median over the other views, so that a few views with a wrong flow do not
    matter; zero if pictures are too small or too few.

    Args:
        views: Decoded or fitted views, [N, H, W, C] float32; what lies outside [0, 1] is clipped.
        geometry: Poses and depth of the reference view.
        times: When each view was seen, [N].
    """
    count, height, width, _ = views.shape
    reference = geometry.reference
    others = [i for i in range(count) if abs(times[i] - times[reference]) >= _LEAST_TIME]
    if not others or min(height, width) < LEAST_SIDE_PX:
        return np.zeros((height, width, 2), np.float32)
    grey = np.clip(views, 0, 1).mean(axis=3)
    smooth = [cv2.GaussianBlur((255 * view).astype(np.uint8), (0, 0), _BLUR_PX) for view in grey]
    rates = []
    for i in others:
        flow = flow_from(smooth[reference], smooth[i])
        rates.append((flow - still_flow(geometry, i)) / (times[i] - times[reference]))
    return np.median(rates, axis=0).astype(np.float32)


def still_flow(geometry: Geometry, view: int) -> F64:
    """Return the flow of a scene at rest from the reference view to another, [H, W, 2] in px."""
    depth, poses = geometry.inverse_depth.astype(np.float64), geometry.world_to_camera
    pixels = grid(depth.shape, 1)
    moved = poses[[view]] @ np.linalg.inv(poses[geometry.reference])
    flow = predict_positions(pixels, depth.ravel(), moved, geometry.intrinsics)[:, 0] - pixels
    return flow.reshape(*depth.shape, 2)
