"""Where the readings of a measurement look through their open masks: in the picture of a reference view.

Most masks are closed at a reading, and every step passes through all that are not: so they are listed once. A reading
that looks at a surface (a plane, or a map of the reference view) from another view sees a place of the reference view's
picture there. Here: the list and the places. Not here: their kernels (`sightline_kernels`), what is compared at the
places (`texture_kernels`, `plane_evidence`).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.core.kernels import in_parts
from gs2ci.reconstruct.geometry.sightline_kernels import list_open, places_on_map, places_on_planes


@dataclass(frozen=True)
class Sightlines:
    """The open masks of readings.

    Args:
        begin: Where those of each reading begin, [K + 1].
        view: The view of each, [E].
        share: Its transmission, not 0, [E].
        rays: Of the readings' pixels, at z = 1, [K, 3].
    """

    begin: NDArray[np.int64]
    view: NDArray[np.int64]
    share: F64
    rays: F64

    @classmethod
    def of(cls, open_share: F32, rows: NDArray[np.int64], columns: NDArray[np.int64], rays: F64) -> Self:
        """List those of readings at rows and columns, [K] each, of transmissions [V, H, W]."""
        begin, view, share = list_open(open_share, rows, columns)
        return cls(begin, view, share, rays)

    def on_planes(self, planes: F64, world_to_camera: F64, intrinsics: F64) -> F64:
        """Return the places on planes that are seen, column and row in the reference view's array, [P, E, 2].

        Args:
            planes: n with n . X = 1 in the reference view, [P, 3].
            world_to_camera: The views' poses relative to the reference view, [V, 4, 4].
            intrinsics: [3, 3], px.
        """
        turned, centres = _seen_from(world_to_camera)
        places = np.empty((len(planes), len(self.view), 2))
        in_parts(
            places_on_planes,
            len(self.rays),
            self.begin,
            self.view,
            self.rays,
            turned,
            centres,
            planes,
            intrinsics,
            places,
        )
        return places

    def on_map(self, inverse_depth: F32, world_to_camera: F64, intrinsics: F64) -> F64:
        """Return the same for the surface of a map of the reference view, [H, W]: [1, E, 2]."""
        places = np.empty((1, len(self.view), 2))
        poses, back = np.ascontiguousarray(world_to_camera[:, :3]), np.linalg.inv(intrinsics)
        in_parts(
            places_on_map,
            len(self.rays),
            self.begin,
            self.view,
            self.rays,
            poses,
            inverse_depth,
            intrinsics,
            back,
            places[0],
        )
        return places


def _seen_from(world_to_camera: F64) -> tuple[F64, F64]:
    """Return by what rays are turned to the reference view, [V, 3, 3], and the negative centres, R^T t, [V, 3]."""
    turned = np.ascontiguousarray(world_to_camera[:, :3, :3].transpose(0, 2, 1))
    return turned, np.ascontiguousarray((turned @ world_to_camera[:, :3, 3:])[..., 0])
