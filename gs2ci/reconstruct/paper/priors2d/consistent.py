"""A prior without weights that uses all views together: detail on which several cameras agree is kept.

The measurement's residual is decoded into every camera's view (`decode.gap_tv`). Part of it is texture that the
Gaussians have not resolved, part is residue of the decode. Texture lies on surfaces: warped to a pseudo-view by the
depth there, it falls on the same pixel from every camera; residue does not. So the median over the cameras keeps the
texture and drops the residue.

Here: the warp, its occlusion test and the median. Not here: the residual.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from gs2ci.core.arrays import F32, Bool
from gs2ci.core.cameras import camera_centres
from gs2ci.reconstruct.geometry.depth.carrying import DepthCamera
from gs2ci.reconstruct.measurement.lens import CENTRE_OFFSET
from gs2ci.reconstruct.paper.priors2d.base import Question, check_targets


@dataclass(frozen=True)
class ConsistentDetail:
    """The median over the cameras of the detail that each of them sees at a point.

    Args:
        neighbours: How many of the nearest cameras are used.
        depth_tolerance: Relative difference of depth from which on a camera sees something other than the point.
    """

    neighbours: int = 5
    depth_tolerance: float = 0.05
    name: str = "consistent"

    def __call__(self, question: Question) -> F32:
        """Return pseudo-views with the agreed detail added; arguments as for `ImagePrior`."""
        images = question.pseudo.images
        centres = camera_centres(question.recovered.world_to_camera)
        targets = images.copy()
        for i, here in enumerate(camera_centres(question.pseudo.world_to_camera)):
            nearest = np.argsort(np.linalg.norm(centres - here, axis=1), kind="stable")[: self.neighbours]
            details = np.stack([self._seen_from(question, i, int(camera)) for camera in nearest])
            targets[i] += _median(details)
        return check_targets(self.name, targets, images)

    def _seen_from(self, question: Question, view: int, camera: int) -> F32:
        """Warp a camera's detail into a pseudo-view, [H, W, 3]; NaN if it does not see the same point."""
        shown, pseudo = question.pseudo.depths[view].astype(np.float64), question.pseudo.world_to_camera[view]
        carrying = DepthCamera(question.intrinsics, question.distortion, (shown.shape[0], shown.shape[1]))
        moved = question.recovered.world_to_camera[camera] @ np.linalg.inv(pseudo)
        places, depth = carrying.carried(np.where(shown > 0, shown, np.nan), moved)
        # OpenCV's first pixel has its centre at 0, ours at 0.5; a place that is none lies outside.
        x, y = np.nan_to_num(places - CENTRE_OFFSET, nan=-2.0).astype(np.float32).transpose(2, 0, 1).copy()
        border = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": 0}
        found = cv2.remap(question.recovered.depths[camera], x, y, cv2.INTER_NEAREST, **border)
        detail: F32 = cv2.remap(question.details[camera], x, y, cv2.INTER_LINEAR, **border)
        # Depth 0, outside or where no light is stopped, never agrees; NaN compares as False.
        same: Bool = np.abs(found - depth) < self.depth_tolerance * depth
        return np.where(same[..., None], detail, np.float32(np.nan))


def _median(details: F32) -> F32:
    """Return the median of the values that are not NaN, [K, H, W, 3]; 0 if fewer than two cameras have one."""
    known = (~np.isnan(details[..., :1])).sum(axis=0)
    agreed: F32 = np.nanmedian(np.where(known >= 2, details, np.float32(0)), axis=0).astype(np.float32, copy=False)
    return agreed
