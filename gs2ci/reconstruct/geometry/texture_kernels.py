"""Prediction errors of a surface's readings, by a texture estimated from other readings of it.

A reading is the sum, over the views whose masks are open there, of the texture at the point that the pixel sees. The
texture is the least-squares solution with a penalty on differences between neighbours, by conjugate gradients.
Here: kernels. Not here: the points that pixels see, and what follows from the errors (`plane_evidence`).
"""

import numba
import numpy as np

from gs2ci.core.arrays import F64, Bool


def left_over(places: F64, open_share: F64, light: F64, seen: Bool, size: tuple[int, int], smooth: float) -> F64:
    """Return the residuals of readings, [K], by a texture estimated from some of them.

    Args:
        places: Column and row in the texture, px, that each reading sees in each view, [K, N, 2]; positions outside see
            its border.
        open_share: Transmission of each reading's pixel in each view, [K, N].
        light: The readings, [K].
        seen: The readings from which the texture is estimated, [K].
        size: Height and width of the texture, both at least 2.
        smooth: Weight of the squared differences between neighbours, above 0.
    """
    found: F64 = _left_over(places, open_share, light, seen, np.zeros(size), smooth, _ITERATIONS)
    return found


# More iterations changed the residual by less than a tenth of the difference between two planes.
_ITERATIONS = 6


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def _corner(place, count):
    """Return the cell of a coordinate, and how far in it, 0 to 1."""
    cell = min(max(int(np.floor(place)), 0), count - 2)
    return cell, min(max(place - cell, 0.0), 1.0)


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def _open_places(places, open_share, size):
    """List what readings see through open masks, since most are closed, and every iteration passes through all.

    Returns:
        Where each reading's places begin in the list, [K + 1]; the flat index of the cells, unsigned since negative
        indices cost a test each, [E]; how far in them, column and row, and the transmissions, [E, 3].
    """
    count = 0
    begin = np.empty(len(places) + 1, np.int64)
    for k in range(len(places)):
        begin[k] = count
        for v in range(places.shape[1]):
            count += open_share[k, v] != 0
    begin[-1] = count
    cells, inside = np.empty(count, np.uint64), np.empty((count, 3))
    e = 0
    for k in range(len(places)):
        for v in range(places.shape[1]):
            if open_share[k, v] != 0:
                column, inside[e, 0] = _corner(places[k, v, 0], size[1])
                row, inside[e, 1] = _corner(places[k, v, 1], size[0])
                cells[e], inside[e, 2] = row * size[1] + column, open_share[k, v]
                e += 1
    return begin, cells, inside


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def _seen_through(texture, begin, cells, inside, found):
    flat, one, row = texture.ravel(), np.uint64(1), np.uint64(texture.shape[1])
    for k in range(len(found)):
        total = 0.0
        for e in range(begin[k], begin[k + 1]):
            at, x, y = cells[e], inside[e, 0], inside[e, 1]
            above = (1 - x) * flat[at] + x * flat[at + one]
            below = (1 - x) * flat[at + row] + x * flat[at + row + one]
            total += inside[e, 2] * ((1 - y) * above + y * below)
        found[k] = total


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def _sent_back(values, seen, begin, cells, inside, found):
    """Add the adjoint of `_seen_through`, of readings that are seen."""
    flat, one, row = found.ravel(), np.uint64(1), np.uint64(found.shape[1])
    for k in range(len(values)):
        if not seen[k]:
            continue
        for e in range(begin[k], begin[k + 1]):
            at, x, y, value = cells[e], inside[e, 0], inside[e, 1], inside[e, 2] * values[k]
            flat[at] += (1 - x) * (1 - y) * value
            flat[at + one] += x * (1 - y) * value
            flat[at + row] += (1 - x) * y * value
            flat[at + row + one] += x * y * value


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def _add_roughness(texture, smooth, found):
    """Add half the gradient of `smooth` times the squared differences between neighbours."""
    height, width = texture.shape
    for r in range(height):
        for c in range(width):
            if c + 1 < width:
                step = smooth * (texture[r, c + 1] - texture[r, c])
                found[r, c] -= step
                found[r, c + 1] += step
            if r + 1 < height:
                step = smooth * (texture[r + 1, c] - texture[r, c])
                found[r, c] -= step
                found[r + 1, c] += step


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def _left_over(places, open_share, light, seen, texture, smooth, iterations):
    left, coded = light.copy(), np.empty_like(light)
    begin, cells, inside = _open_places(places, open_share, texture.shape)
    against = np.zeros_like(texture)
    _sent_back(left, seen, begin, cells, inside, against)
    along = against.copy()
    power = (against * against).sum()
    for _ in range(iterations):
        if power == 0:
            break
        _seen_through(along, begin, cells, inside, coded)
        bent = np.zeros_like(texture)
        _sent_back(coded, seen, begin, cells, inside, bent)
        _add_roughness(along, smooth, bent)
        step = power / (along * bent).sum()
        texture += step * along
        against -= step * bent
        before, power = power, (against * against).sum()
        along = against + power / before * along
    _seen_through(texture, begin, cells, inside, coded)
    return left - coded
