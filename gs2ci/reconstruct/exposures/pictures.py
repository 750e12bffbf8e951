"""Pictures of an exposure in which features are found: the mean of its views, each warped onto one of them.

A decode leaves errors that differ from view to view: they hide most features of a single view, and average out. In
eight exposures of a room, decoded at 22 to 23 dB, the mean had four times as many right matches as the middle view.

Here: the pictures, their features, and points lifted by their depths. Not here: matches (`pairs`), corners that are
followed from one picture to another (`corners`).
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.cameras import in_world
from gs2ci.reconstruct.geometry.depth.view_depths import NEIGHBOURS, ViewDepth, grid, project, turns_far
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.motion import rays
from gs2ci.reconstruct.geometry.tracks.brightened import brightened
from gs2ci.reconstruct.geometry.tracks.features import find_features

# Depths of exposures are right to this share, planes where no depth was found to that.
_DEPTH_ERROR: Final = 0.12
_PLANE_ERROR: Final = 0.5


@dataclass(frozen=True, eq=False)
class MeanPicture:
    """The mean picture at one view.

    Args:
        image: [H, W, C].
        world_to_camera: Pose of the view, [4, 4], in the exposure's coordinates.
        intrinsics: [3, 3], px.
        inverse_depth: [H, W] float32, in the exposure's unit.
        depth_error: Standard error of the depths, as a share.
        places: Of features, [F, 2] px.
        descriptors: [F, 128].
    """

    image: F32
    world_to_camera: F64
    intrinsics: F64
    inverse_depth: F32
    depth_error: float
    places: F32
    descriptors: F32

    @property
    def centre(self) -> F64:
        """Get the centre of its camera, [3], in the exposure's coordinates."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def lifted(self, pixels: F64) -> F64:
        """Return what is seen at places in the picture, [P, 2] px, in the exposure's coordinates, [P, 3]."""
        height, width = self.inverse_depth.shape
        columns = pixels[:, 0].astype(int).clip(0, width - 1)
        rows = pixels[:, 1].astype(int).clip(0, height - 1)
        along = self.inverse_depth[rows, columns].astype(np.float64)
        return in_world(rays(pixels, self.intrinsics) / along[:, None], self.world_to_camera)


def depths_of(geometry: Geometry) -> tuple[ViewDepth, ...]:
    """Return the depths of a geometry, that of its reference view first."""
    return geometry.view_depths or (ViewDepth(geometry.reference, geometry.inverse_depth),)


def pictures_of(views: F32, geometry: Geometry) -> tuple[MeanPicture, ...]:
    """Make a picture at each view whose depth is known.

    Args:
        views: [N, H, W, C] in full scales.
        geometry: Of the exposure; a plane if it has no depth.
    """
    views, poses = brightened(views), geometry.world_to_camera
    far, error = turns_far(poses), _DEPTH_ERROR if geometry.has_path else _PLANE_ERROR
    found = []
    for depth in depths_of(geometry):
        likeness = poses[:, 2, :3] @ poses[depth.view, 2, :3]
        # Of views that turn far, the mean of those turned least against this one: the rest see other surfaces.
        chosen = np.argsort(-likeness, kind="stable")[: NEIGHBOURS + 1] if far else np.arange(len(views))
        pose, intrinsics = poses[depth.view], geometry.intrinsics
        image = _mean(views[chosen], poses[chosen], pose, intrinsics, depth.inverse_depth)
        found.append(MeanPicture(image, pose, intrinsics, depth.inverse_depth, error, *find_features(image)))
    return tuple(found)


def _mean(views: F32, world_to_camera: F64, pose: F64, intrinsics: F64, inverse_depth: F32) -> F32:
    """Return the mean of views, each warped onto the view of a depth."""
    size = inverse_depth.shape
    points = in_world(rays(grid(size, 1), intrinsics) / inverse_depth.reshape(-1, 1), pose)
    total: F32 = np.zeros(views.shape[1:], np.float32)
    count: F32 = np.zeros((*size, 1), np.float32)
    for view, seen_from in zip(views, world_to_camera, strict=True):
        places, _ = project(points, seen_from, intrinsics)
        warped, inside = sampled(view, places.reshape(*size, 2))
        total += np.where(inside[..., None], warped, np.float32(0))
        count += inside[..., None]
    return (total / np.maximum(count, 1)).astype(np.float32)


def sampled(image: F32, places: F64) -> tuple[F32, Bool]:
    """Sample an image, [H, W, C], at places, [h, w, 2] px: [h, w, C], and whether they lie inside, [h, w]."""
    height, width = image.shape[:2]
    inside: Bool = np.asarray(((places > 0) & (places < (width, height))).all(axis=2), bool)
    at = np.where(inside[..., None], places - 0.5, -1.0).astype(np.float32)
    found = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.reshape(*places.shape[:2], image.shape[2]), inside
