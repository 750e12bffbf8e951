"""Fits without the poses or points of the geometry stage, to measure what these are worth (paper, Table VII).

Here: first poses and first points without that knowledge. Not here: the geometry (`reconstruct.geometry`), the other
components that can be switched off (`paper.preset`).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.points import Seeds, seed_points

_FARTHEST: Final = 2.0
"""Points without a known depth are put within this factor of the median depth, nearer or farther."""
_STREAM: Final = 0x5EED  # makes these random draws independent of all others of the same seed


@dataclass(frozen=True)
class Withheld:
    """The part of the geometry that is withheld from the fit.

    Args:
        points: Points are scattered at random over what the reference view sees, in random colours.
        poses: All poses are that of the reference view.
    """

    points: bool = False
    poses: bool = False

    def first_poses(self, geometry: Geometry) -> Geometry:
        """Return the geometry, with all poses the same if they are withheld."""
        if not self.poses:
            return geometry
        own = geometry.world_to_camera[geometry.reference]
        alike = np.repeat(own[None], len(geometry.world_to_camera), axis=0)
        return replace(geometry, world_to_camera=alike, pose_errors=None, view_depths=())

    def first_points(self, geometry: Geometry, views: F32, stride: int, seed: int) -> Seeds:
        """Return the points that the geometry gives, or as many random ones if they are withheld.

        Args:
            geometry: Poses and depth.
            views: Decoded views, [N, H, W, C].
            stride: Step between pixels, along rows and columns.
            seed: Of the random points.
        """
        seeds = seed_points(geometry, views, stride)
        if not self.points:
            return seeds
        draw = np.random.default_rng([seed, _STREAM])
        count, (height, width) = len(seeds.positions), views.shape[1:3]
        pixels = draw.uniform((0, 0), (width, height), (count, 2))
        depth = 1 / draw.uniform(1 / _FARTHEST, _FARTHEST, count)
        focal, centre = geometry.intrinsics.diagonal()[:2], geometry.intrinsics[:2, 2]
        rays = np.concatenate([(pixels - centre) / focal, np.ones((count, 1))], axis=1)
        return Seeds(
            positions=(rays * depth[:, None]).astype(np.float32),
            colours=draw.random(seeds.colours.shape).astype(np.float32),
            spacing=(stride * depth / focal[0]).astype(np.float32),
        )
