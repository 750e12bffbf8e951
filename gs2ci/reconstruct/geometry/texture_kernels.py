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
def _seen_through(texture, places, open_share, found):
    height, width = texture.shape
    for k in range(len(places)):
        total = 0.0
        for v in range(places.shape[1]):
            if open_share[k, v] == 0:
                continue
            c, x = _corner(places[k, v, 0], width)
            r, y = _corner(places[k, v, 1], height)
            above = (1 - x) * texture[r, c] + x * texture[r, c + 1]
            below = (1 - x) * texture[r + 1, c] + x * texture[r + 1, c + 1]
            total += open_share[k, v] * ((1 - y) * above + y * below)
        found[k] = total


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def _sent_back(values, seen, places, open_share, found):
    """Add the adjoint of `_seen_through`, of readings that are seen."""
    height, width = found.shape
    for k in range(len(places)):
        if not seen[k]:
            continue
        for v in range(places.shape[1]):
            if open_share[k, v] == 0:
                continue
            c, x = _corner(places[k, v, 0], width)
            r, y = _corner(places[k, v, 1], height)
            value = open_share[k, v] * values[k]
            found[r, c] += (1 - x) * (1 - y) * value
            found[r, c + 1] += x * (1 - y) * value
            found[r + 1, c] += (1 - x) * y * value
            found[r + 1, c + 1] += x * y * value


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
    against = np.zeros_like(texture)
    _sent_back(left, seen, places, open_share, against)
    along = against.copy()
    power = (against * against).sum()
    for _ in range(iterations):
        if power == 0:
            break
        _seen_through(along, places, open_share, coded)
        bent = np.zeros_like(texture)
        _sent_back(coded, seen, places, open_share, bent)
        _add_roughness(along, smooth, bent)
        step = power / (along * bent).sum()
        texture += step * along
        against -= step * bent
        before, power = power, (against * against).sum()
        along = against + power / before * along
    _seen_through(texture, places, open_share, coded)
    return left - coded
