"""What each of several exposures alone shows, and what would be lost without it; nothing is fitted again.

Here: the share of the points of an exposure's middle view that no view of another exposure shows. Not here: standard
errors (`reconstruct.uncertainty`), which exposures there are.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, I64, Bool
from gs2ci.core.cameras import SAME_SURFACE, in_camera, in_world
from gs2ci.core.lens import places_of, rays_of

# Points of each exposure's middle view, on a lattice.
_POINTS: Final = 800


@dataclass(frozen=True, eq=False)
class ViewsTogether:
    """The views of several exposures in common coordinates.

    Args:
        depth: Along the optical axis, [V, H, W]; 0 where there is none.
        world_to_camera: [V, 4, 4].
        intrinsics: [3, 3], px.
        distortion: Of the lens, [5]; None for a pinhole.
        exposure: Which exposure each view is of, [V], in order.
    """

    depth: F32
    world_to_camera: F64
    intrinsics: F64
    distortion: F64 | None
    exposure: I64

    def sees(self, view: int, points: F64) -> Bool:
        """Tell which points, [P, 3], a view shows: those in its picture that lie on its own surface, [P]."""
        height, width = self.depth.shape[1:]
        there = in_camera(points, self.world_to_camera[view])
        ahead = there[:, 2] > 0
        slopes = there[:, :2] / np.where(ahead, there[:, 2], 1.0)[:, None]
        pixels = places_of(slopes, self.intrinsics, self.distortion)
        inside = ahead & (pixels >= 0).all(axis=1) & (pixels < (width, height)).all(axis=1)
        column, row = np.where(inside[:, None], pixels, 0.0).astype(np.int64).T
        return inside & (np.abs(self.depth[view, row, column] - there[:, 2]) <= SAME_SURFACE * there[:, 2])

    def points(self, view: int) -> F64:
        """Return points that a view shows, [P, 3], on a lattice."""
        height, width = self.depth.shape[1:]
        step = max(1, int(np.ceil(np.sqrt(height * width / _POINTS))))
        rows, columns = (one.ravel() for one in np.mgrid[step // 2 : height : step, step // 2 : width : step])
        rays = rays_of(np.stack([columns, rows], axis=1) + 0.5, self.intrinsics, self.distortion)
        depth = self.depth[view, rows, columns].astype(np.float64)
        return in_world(rays * depth[:, None], self.world_to_camera[view])[depth > 0]


def seen_alone(views: ViewsTogether) -> tuple[float, ...]:
    """Return the share of what each exposure's middle view shows that no other one shows; 0 if it shows nothing."""
    found = []
    for number in range(int(views.exposure.max()) + 1):
        members = np.flatnonzero(views.exposure == number)
        points = views.points(int(members[len(members) // 2]))
        seen = np.zeros(len(points), bool)
        for view in np.flatnonzero(views.exposure != number):
            seen |= views.sees(int(view), points)
        found.append(float((~seen).mean()) if len(points) else 0.0)
    return tuple(found)
