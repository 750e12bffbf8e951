"""Where the readings of a measurement look through their open masks: in the picture of a reference view.

Most masks are closed at a reading, and every step passes through all that are not: so they are listed once. A reading
that looks at a surface (a plane, or a map of the reference view) from another view sees a place of the reference view's
picture there. Here: the list and the places, as kernels, in float64; each reading's are its own, so the result is the
same for any number of threads. Not here: what is compared at the places (`texture_kernels`, `plane_evidence`).
"""

from dataclasses import dataclass
from typing import Final, Self

import numba
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64

# Divisors nearer to zero are replaced by this: of a plane that is seen from its edge, and of points at or behind
# the reference camera. Their places lie far outside of the picture, whose border they then see.
_LEAST: Final = 1e-9
# In each round a place moves by what is still missing. More rounds moved places by less than 0.01 px.
_ROUNDS: Final = 5


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
        return cls(*_listed(open_share, rows, columns), rays)

    def on_planes(self, planes: F64, world_to_camera: F64, intrinsics: F64) -> F64:
        """Return the places on planes that are seen, column and row in the reference view's array, [P, E, 2].

        Args:
            planes: n with n . X = 1 in the reference view, [P, 3].
            world_to_camera: The views' poses relative to the reference view, [V, 4, 4].
            intrinsics: [3, 3], px.
        """
        turned, centres = _seen_from(world_to_camera)
        places = np.empty((len(planes), len(self.view), 2))
        _on_planes(self.begin, self.view, self.rays, turned, centres, planes, intrinsics, places)
        return places

    def on_map(self, inverse_depth: F32, world_to_camera: F64, intrinsics: F64) -> F64:
        """Return the same for the surface of a map of the reference view, [H, W]: [1, E, 2]."""
        places = np.empty((1, len(self.view), 2))
        poses, back = np.ascontiguousarray(world_to_camera[:, :3]), np.linalg.inv(intrinsics)
        _on_map(self.begin, self.view, self.rays, poses, inverse_depth, intrinsics, back, places[0])
        return places


def _seen_from(world_to_camera: F64) -> tuple[F64, F64]:
    """Return by what rays are turned to the reference view, [V, 3, 3], and the negative centres, R^T t, [V, 3]."""
    turned = np.ascontiguousarray(world_to_camera[:, :3, :3].transpose(0, 2, 1))
    return turned, np.ascontiguousarray((turned @ world_to_camera[:, :3, 3:])[..., 0])


@numba.njit(cache=True)
def corner(place, count):
    """Return the cell of a coordinate among `count` samples, and how far in it, 0 to 1; outside it is the border's."""
    cell = min(max(int(np.floor(place)), 0), count - 2)
    return cell, min(max(place - cell, 0.0), 1.0)


@numba.njit(cache=True)
def interpolated(picture, column, row):
    """Return a picture's value, [H, W], at a place; beyond its border it goes on as there."""
    c, x = corner(column, picture.shape[1])
    r, y = corner(row, picture.shape[0])
    above = (1 - x) * picture[r, c] + x * picture[r, c + 1]
    below = (1 - x) * picture[r + 1, c] + x * picture[r + 1, c + 1]
    return (1 - y) * above + y * below


@numba.njit(cache=True)
def _listed(open_share, rows, columns):
    count = 0
    begin = np.empty(len(rows) + 1, np.int64)
    for k in range(len(rows)):
        begin[k] = count
        for v in range(open_share.shape[0]):
            count += open_share[v, rows[k], columns[k]] != 0
    begin[-1] = count
    view, share = np.empty(count, np.int64), np.empty(count)
    e = 0
    for k in range(len(rows)):
        for v in range(open_share.shape[0]):
            if open_share[v, rows[k], columns[k]] != 0:
                view[e], share[e] = v, open_share[v, rows[k], columns[k]]
                e += 1
    return begin, view, share


@numba.njit(cache=True)
def _turned(matrix, x, y, z):
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


@numba.njit(cache=True)
def _at(intrinsics, x, y, z):
    """Project a point to the reference view's array: column and row."""
    u, v, w = _turned(intrinsics, x, y, z)
    w = max(w, _LEAST)
    return u / w - 0.5, v / w - 0.5


@numba.njit(cache=True, parallel=True)
def _on_planes(begin, view, rays, turned, centres, planes, intrinsics, places):
    for k in numba.prange(len(begin) - 1):
        for e in range(begin[k], begin[k + 1]):
            v = view[e]
            x, y, z = _turned(turned[v], rays[k, 0], rays[k, 1], rays[k, 2])
            a, b, c = centres[v, 0], centres[v, 1], centres[v, 2]
            for p in range(len(planes)):
                # X = s R^T ray - R^T t, and n . X = 1.
                along = planes[p, 0] * x + planes[p, 1] * y + planes[p, 2] * z
                along = along if abs(along) > _LEAST else _LEAST
                far = (1 + planes[p, 0] * a + planes[p, 1] * b + planes[p, 2] * c) / along
                places[p, e, 0], places[p, e, 1] = _at(intrinsics, far * x - a, far * y - b, far * z - c)


@numba.njit(cache=True, parallel=True)
def _on_map(begin, view, rays, poses, inverse_depth, intrinsics, back, places):
    for k in numba.prange(len(begin) - 1):
        own_column, own_row = _at(intrinsics, rays[k, 0], rays[k, 1], rays[k, 2])
        for e in range(begin[k], begin[k + 1]):
            pose = poses[view[e]]
            column, row = own_column, own_row
            for _ in range(_ROUNDS):
                depth = interpolated(inverse_depth, column, row)
                x, y, z = _turned(back, column + 0.5, row + 0.5, 1.0)
                x, y, z = _turned(pose, x, y, z)
                c, r = _at(
                    intrinsics, x + depth * pose[0, 3], y + depth * pose[1, 3], z + depth * pose[2, 3]
                )  # fmt: skip
                column += own_column - c
                row += own_row - r
            places[e, 0], places[e, 1] = column, row
