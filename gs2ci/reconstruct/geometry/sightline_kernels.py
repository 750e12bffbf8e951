"""Kernels that list the open masks of readings, and find the places at which these look through them.

In float64. Each reading's places are its own, so the result is the same for any number of threads. The tests hold them
to the homographies of the plane sweep. Not here: what the places are for (`sightlines`).
"""

from typing import Final

import numpy as np

from gs2ci.core.kernels import EXACT, f32_2, f32_3, f64_2, f64_3, helper, i64, i64_1, kernel

# Divisors nearer to zero are replaced by this: of a plane that is seen from its edge, and of points at or behind
# the reference camera. Their places lie far outside of the picture, whose border they then see.
_LEAST: Final = 1e-9
# In each round a place moves by what is still missing. More rounds moved places by less than 0.01 px.
_ROUNDS: Final = 5


@helper(fastmath=EXACT)
def corner(place, count):
    """Return the cell of a coordinate among `count` samples, and how far in it, 0 to 1; outside it is the border's."""
    cell = min(max(int(np.floor(place)), 0), count - 2)
    return cell, min(max(place - cell, 0.0), 1.0)


@helper(fastmath=EXACT)
def interpolated(picture, column, row):
    """Return a picture's value, [H, W], at a place; beyond its border it goes on as there."""
    c, x = corner(column, picture.shape[1])
    r, y = corner(row, picture.shape[0])
    above = (1 - x) * picture[r, c] + x * picture[r, c + 1]
    below = (1 - x) * picture[r + 1, c] + x * picture[r + 1, c + 1]
    return (1 - y) * above + y * below


@kernel(f32_3, i64_1, i64_1, fastmath=EXACT)
def list_open(open_share, rows, columns):
    """Return where the open masks of each reading begin, [K + 1], their views, [E], and transmissions, [E].

    Args:
        open_share: Transmissions, [V, H, W].
        rows: Of the readings, [K].
        columns: Of the readings, [K].
    """
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


@helper(fastmath=EXACT)
def _turned(matrix, x, y, z):
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


@helper(fastmath=EXACT)
def _at(intrinsics, x, y, z):
    """Project a point to the reference view's array: column and row."""
    u, v, w = _turned(intrinsics, x, y, z)
    w = max(w, _LEAST)
    return u / w - 0.5, v / w - 0.5


@kernel(i64, i64, i64_1, i64_1, f64_2, f64_3, f64_2, f64_2, f64_2, f64_3, fastmath=EXACT)
def places_on_planes(from_task, to_task, begin, view, rays, turned, centres, planes, intrinsics, places):
    """Find the places on planes.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        begin: Of the open masks of each reading, [K + 1].
        view: Of each open mask, [E].
        rays: Of the readings, [K, 3].
        turned: Rotations from the views to the reference view, R^T, [V, 3, 3].
        centres: The views' centres there, negative, R^T t, [V, 3].
        planes: n with n . X = 1, [P, 3].
        intrinsics: [3, 3], px.
        places: Written: column and row, [P, E, 2].
    """
    for k in range(from_task, to_task):
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


@kernel(i64, i64, i64_1, i64_1, f64_2, f64_3, f32_2, f64_2, f64_2, f64_2, fastmath=EXACT)
def places_on_map(from_task, to_task, begin, view, rays, poses, inverse_depth, intrinsics, back, places):
    """Find the places on a map's surface, by moving each until it is seen where the reading is.

    Args:
        from_task: The first task of this part.
        to_task: The end of them.
        begin: As above.
        view: As above.
        rays: As above.
        poses: From the reference view to the views, [V, 3, 4].
        inverse_depth: The map, [H, W]; H, W >= 2.
        intrinsics: [3, 3], px.
        back: Its inverse.
        places: Written: column and row, [E, 2].
    """
    for k in range(from_task, to_task):
        own_column, own_row = _at(intrinsics, rays[k, 0], rays[k, 1], rays[k, 2])
        for e in range(begin[k], begin[k + 1]):
            pose = poses[view[e]]
            column, row = own_column, own_row
            for _ in range(_ROUNDS):
                depth = interpolated(inverse_depth, column, row)
                x, y, z = _turned(back, column + 0.5, row + 0.5, 1.0)
                x, y, z = _turned(pose, x, y, z)
                x, y, z = x + depth * pose[0, 3], y + depth * pose[1, 3], z + depth * pose[2, 3]
                c, r = _at(intrinsics, x, y, z)
                column += own_column - c
                row += own_row - r
            places[e, 0], places[e, 1] = column, row
