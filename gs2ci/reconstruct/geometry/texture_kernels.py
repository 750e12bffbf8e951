"""Prediction errors of a surface's readings, by a texture estimated from other readings of it.

A reading is the sum, over the views whose masks are open there, of the texture at the place that the pixel sees. The
texture is the least-squares solution with a penalty on differences between neighbours, by conjugate gradients.
Here: kernels, in float64. Surfaces and folds are the tasks that threads share, and each writes its own errors, so that
the result is the same for any number of threads. Not here: the places (`sightlines`), what follows (`plane_evidence`).
"""

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.core.kernels import EXACT, f32_3, f64_1, f64_2, f64_3, helper, i64, i64_1, in_parts, kernel
from gs2ci.reconstruct.geometry.sightline_kernels import corner, interpolated
from gs2ci.reconstruct.geometry.sightlines import Sightlines

# More iterations changed the residual by less than a tenth of the difference between two planes.
_ITERATIONS = 6


def prediction_errors(
    places: F64,
    sightlines: Sightlines,
    light: F64,
    slow: F32,
    channel: NDArray[np.int64],
    fold: NDArray[np.int64],
    folds: int,
    smooth: F64,
) -> F64:
    """Return the squared errors of readings predicted from those of other folds, [P, K]; 0 where none is asked for.

    Args:
        places: Column and row that are seen along each line, for each surface, [P, E, 2]; outside of the picture they
            see its border.
        sightlines: Of the readings.
        light: The readings, [K].
        slow: What is known of the reference view, of which the texture is the rest, [C, H, W]; H, W >= 2.
        channel: Which of its channels each reading sees, [K].
        fold: Of each reading, [K].
        folds: How many of the folds are predicted, the first ones.
        smooth: Weight of the squared differences between neighbours of each texture, above 0, [P].
    """
    found = np.zeros((len(places), len(light)))
    lines = (sightlines.begin, sightlines.share)
    in_parts(
        _predict, len(places) * folds, places, *lines, light, slow, channel, fold, folds, smooth, _ITERATIONS, found
    )
    return found


@kernel(i64, i64, f64_3, i64_1, f64_1, f64_1, f32_3, i64_1, i64_1, i64, f64_1, i64, f64_2, fastmath=EXACT)
def _predict(from_task, to_task, places, begin, share, light, slow, channel, fold, folds, smooth, iterations, found):
    for task in range(from_task, to_task):
        surface, out = task // folds, task % folds
        _predict_fold(
            places[surface], begin, share, light, slow, channel, fold, out, smooth[surface], iterations, found[surface]
        )


@helper(fastmath=EXACT)
def _predict_fold(places, begin, share, light, slow, channel, fold, out, smooth, iterations, found):
    """Enter the squared errors of the readings of one fold, [K]."""
    seen = np.empty(len(fold), np.bool_)
    for k in range(len(fold)):
        seen[k] = fold[k] != out
    left = without_slow(places, begin, share, light, slow, channel)
    low, size = _extent(places, slow.shape)
    left = left_over(places, low, begin, share, left, seen, np.zeros(size), smooth, iterations)
    for k in range(len(left)):
        if not seen[k]:
            found[k] = left[k] ** 2


@kernel(f64_2, i64_1, f64_1, f64_1, f32_3, i64_1)
def without_slow(places, begin, share, light, slow, channel):
    """Return the readings without what the known part of the view contributes, [K]; places are of one surface, [E, 2].

    Other arguments are those of `prediction_errors`, with the parts of its sightlines.
    """
    left = light.copy()
    for k in range(len(left)):
        for e in range(begin[k], begin[k + 1]):
            left[k] -= share[e] * interpolated(slow[channel[k]], places[e, 0], places[e, 1])
    return left


@helper(fastmath=EXACT)
def _extent(places, shape):
    """Return the first column and row of a texture that covers the places, and its height and width.

    They are between 2 and thrice the picture's, which has the shape [C, H, W].
    """
    low, high = np.empty(2), np.empty(2)
    for axis in range(2):
        limit = float(shape[2 - axis])
        least, most = 0.0, 0.0
        for e in range(len(places)):
            place = places[e, axis]
            least = place if e == 0 else min(least, place)
            most = place if e == 0 else max(most, place)
        low[axis] = min(max(np.floor(least) - 1, -limit), limit)
        high[axis] = min(max(np.ceil(most) + 2, 2 - limit), 2 * limit)
    return low, (int(high[1] - low[1]), int(high[0] - low[0]))


@helper()
def _cells(places, low, size):
    """Return the flat index of the cell of each place, unsigned since negative indices cost a test each, [E].

    Also how far in it the place is, column and row, [E, 2].
    """
    cells, inside = np.empty(len(places), np.uint64), np.empty((len(places), 2))
    for e in range(len(places)):
        column, inside[e, 0] = corner(places[e, 0] - low[0], size[1])
        row, inside[e, 1] = corner(places[e, 1] - low[1], size[0])
        cells[e] = row * size[1] + column
    return cells, inside


@helper()
def _seen_through(texture, begin, share, cells, inside, found):
    flat, one, row = texture.ravel(), np.uint64(1), np.uint64(texture.shape[1])
    for k in range(len(found)):
        total = 0.0
        for e in range(begin[k], begin[k + 1]):
            at, x, y = cells[e], inside[e, 0], inside[e, 1]
            above = (1 - x) * flat[at] + x * flat[at + one]
            below = (1 - x) * flat[at + row] + x * flat[at + row + one]
            total += share[e] * ((1 - y) * above + y * below)
        found[k] = total


@helper()
def _sent_back(values, seen, begin, share, cells, inside, found):
    """Add the adjoint of `_seen_through`, of readings that are seen."""
    flat, one, row = found.ravel(), np.uint64(1), np.uint64(found.shape[1])
    for k in range(len(values)):
        if not seen[k]:
            continue
        for e in range(begin[k], begin[k + 1]):
            at, x, y, value = cells[e], inside[e, 0], inside[e, 1], share[e] * values[k]
            flat[at] += (1 - x) * (1 - y) * value
            flat[at + one] += x * (1 - y) * value
            flat[at + row] += (1 - x) * y * value
            flat[at + row + one] += x * y * value


@helper()
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


@helper()
def left_over(places, low, begin, share, light, seen, texture, smooth, iterations):
    """Return the residuals of readings, [K], by a texture estimated from those that are seen.

    Args:
        places: Column and row that is seen along each line, [E, 2].
        low: Column and row of the texture's first pixel, [2].
        begin: Where the lines of each reading begin, [K + 1].
        share: Transmission of each, [E].
        light: The readings, [K].
        seen: Those from which the texture is estimated, [K].
        texture: Where it is estimated, from zeros; sides of at least 2.
        smooth: Weight of the squared differences between neighbours, above 0.
        iterations: Of conjugate gradients.
    """
    left, coded = light.copy(), np.empty_like(light)
    cells, inside = _cells(places, low, texture.shape)
    against = np.zeros_like(texture)
    _sent_back(left, seen, begin, share, cells, inside, against)
    along = against.copy()
    power = _dot(against, against)
    for _ in range(iterations):
        if power == 0:
            break
        _seen_through(along, begin, share, cells, inside, coded)
        bent = np.zeros_like(texture)
        _sent_back(coded, seen, begin, share, cells, inside, bent)
        _add_roughness(along, smooth, bent)
        step = power / _dot(along, bent)
        _add_scaled(texture, along, step)
        _add_scaled(against, bent, -step)
        before, power = power, _dot(against, against)
        _add_scaled_to(along, against, power / before)
    _seen_through(texture, begin, share, cells, inside, coded)
    _add_scaled(left.reshape(1, -1), coded.reshape(1, -1), -1.0)
    return left


@helper(fastmath=EXACT)
def _dot(a, b):
    """Sum the products of two textures, row by row."""
    total = 0.0
    for r in range(a.shape[0]):
        for c in range(a.shape[1]):
            total += a[r, c] * b[r, c]
    return total


@helper()
def _add_scaled(values, more, factor):
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            values[r, c] += factor * more[r, c]


@helper()
def _add_scaled_to(values, more, factor):
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            values[r, c] = more[r, c] + factor * values[r, c]
