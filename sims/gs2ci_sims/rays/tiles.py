"""Lists of the primitives that can be visible in each tile of an image: a ray is tested against these alone.

Here: exact bounds of spheres in a pinhole image, and lists by tile. Not here: the tracing (`gaussians`, `meshes`).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.core.kernels import i64, i64_1, i64_2, kernel

# Pixels per side of a tile.
TILE: Final = 8

Index = NDArray[Any]


def sphere_bounds(centres: F64, radii: F64, intrinsics: F64) -> F64:
    """Return the bounds of spheres in the image, [S, 4]: left, right, top, bottom in pixels.

    Seen from above, the lines of sight that touch a circle at angle a and distance h have the angles a +- asin(r / h),
    whose tangents are the image coordinates. A sphere that contains the camera covers the image; one behind it has no
    image (left > right).

    Args:
        centres: Centres in camera axes (z forward), [S, 3].
        radii: [S].
        intrinsics: [3, 3].
    """
    bounds = np.empty((len(centres), 4))
    for axis in (0, 1):
        distance = np.hypot(centres[:, axis], centres[:, 2])
        angle = np.arctan2(centres[:, axis], centres[:, 2])
        around = distance <= radii
        half = np.arcsin(np.where(around, 1.0, radii / np.where(around, 1.0, distance)))
        low, high = angle - half, angle + half
        quarter = 0.5 * np.pi - 1e-9
        # Angles beyond a quarter turn are beside the camera: the image is unbounded there.
        start = np.where(low <= -quarter, -np.inf, np.tan(np.clip(low, -quarter, quarter)))
        stop = np.where(high >= quarter, np.inf, np.tan(np.clip(high, -quarter, quarter)))
        # Half a turn is behind: larger angles are on the other side.
        behind = ~around & ((high <= -quarter) | (low >= quarter)) & (np.abs(angle) + half <= np.pi)
        wraps = ~around & (np.abs(angle) + half > np.pi)
        start, stop = np.where(wraps, -np.inf, start), np.where(wraps, np.inf, stop)
        start, stop = np.where(around, -np.inf, start), np.where(around, np.inf, stop)
        start, stop = np.where(behind, np.inf, start), np.where(behind, -np.inf, stop)
        bounds[:, 2 * axis] = start * intrinsics[axis, axis] + intrinsics[axis, 2]
        bounds[:, 2 * axis + 1] = stop * intrinsics[axis, axis] + intrinsics[axis, 2]
    gone = (bounds[:, 0] > bounds[:, 1]) | (bounds[:, 2] > bounds[:, 3]) | (centres[:, 2] + radii <= 0)
    bounds[gone] = [np.inf, -np.inf, np.inf, -np.inf]
    return bounds


def ellipsoid_bounds(centres: F64, spreads: F64, intrinsics: F64, otherwise: F64) -> F64:
    """Return the bounds in the image, [S, 4], of ellipsoids that lie in front of the camera or behind it.

    The plane x = u z through the camera touches the ellipsoid where (x_c - u z_c)^2 = S_xx - 2 u S_xz + u^2 S_zz: a
    quadratic equation in u, whose roots are the bounds if the ellipsoid does not reach the plane of the camera.

    Args:
        centres: Centres in camera axes, [S, 3].
        spreads: S, the matrices of the ellipsoids (p - c)^T S^-1 (p - c) <= 1, [S, 3, 3].
        intrinsics: [3, 3].
        otherwise: Wider bounds, which are used for the other ellipsoids.
    """
    bounds = otherwise.copy()
    depth = centres[:, 2]
    square = depth**2 - spreads[:, 2, 2]
    apart = (depth > 0) & (square > 1e-6 * depth**2)
    for axis in (0, 1):
        half = centres[:, axis] * depth - spreads[:, axis, 2]
        constant = centres[:, axis] ** 2 - spreads[:, axis, axis]
        root = np.sqrt(np.maximum(half**2 - square * constant, 0.0))
        safe = np.where(apart, square, 1.0)
        # A margin of a thousandth for rounding.
        slack = 1e-3 * root / safe
        ends = np.stack([(half - root) / safe - slack, (half + root) / safe + slack], axis=1)
        pixels = ends * intrinsics[axis, axis] + intrinsics[axis, 2]
        bounds[apart, 2 * axis : 2 * axis + 2] = pixels[apart]
    return bounds


def by_tile(bounds: F64, size: tuple[int, int]) -> tuple[Index, Index]:
    """List the items of each tile: the start [T + 1] of each tile's items in the list, row by row, and the list.

    Args:
        bounds: Left, right, top, bottom in pixels, [S, 4].
        size: Height and width of the image.
    """
    down, across = -(-size[0] // TILE), -(-size[1] // TILE)
    limits = np.array([across, across, down, down])
    finite = np.clip(bounds, -TILE, np.array([size[1], size[1], size[0], size[0]]) + TILE)
    places = np.floor(finite / TILE).astype(np.int64)
    seen = (bounds[:, 0] <= bounds[:, 1]) & (places[:, 1] >= 0) & (places[:, 3] >= 0)
    seen &= (places[:, 0] < across) & (places[:, 2] < down)
    places = np.clip(places, 0, limits - 1)
    places[~seen] = [1, 0, 1, 0]
    counts = np.zeros(down * across + 1, np.int64)
    _count(places, across, counts)
    begins = np.cumsum(counts)
    items = np.empty(begins[-1], np.int64)
    _list(places, across, begins[:-1].copy(), items)
    return begins, items


@kernel(i64_2, i64, i64_1)
def _count(places, across, counts):
    """Count the items of each tile, one place further on."""
    for index in range(len(places)):
        for row in range(places[index, 2], places[index, 3] + 1):
            for column in range(places[index, 0], places[index, 1] + 1):
                counts[row * across + column + 1] += 1


@kernel(i64_2, i64, i64_1, i64_1)
def _list(places, across, at, items):
    """List the items of each tile from its place `at` on, which moves behind them."""
    for index in range(len(places)):
        for row in range(places[index, 2], places[index, 3] + 1):
            for column in range(places[index, 0], places[index, 1] + 1):
                tile = row * across + column
                items[at[tile]] = index
                at[tile] += 1
