"""Numba kernels of the registration: sampling pictures at other places, and undoing an interpolation.

Every task is a row and no sum crosses tasks, so the result is bitwise the same for any number of threads.
"""

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.kernels import EXACT, b1, f64, f64_1, f64_2, f64_3, f64_4, helper, i64, in_parts, kernel


def sample(stack: F64, inverse: F64, shift: F64, field: F64, wrapped: bool) -> F64:
    """Interpolate each picture at c + A⁻¹ (p − c − t − f(p − c)), with coordinates clamped to it or wrapped around.

    Args:
        stack: Pictures, [N, H, W].
        inverse: A⁻¹, [2, 2], for (row, column).
        shift: t, [2].
        field: Of f, [8]: outwards by the cube of the distance; down and right by (row², row · column, column²);
            outwards by the fifth power of the distance.
        wrapped: Whether a picture is continued periodically.
    """
    stack = np.ascontiguousarray(stack, np.float64)
    out = np.empty_like(stack)
    in_parts(_sample, stack.shape[1], stack, inverse, shift, field, wrapped, out)
    return out


@kernel(i64, i64, f64_3, f64_2, f64_1, f64_1, b1, f64_3, fastmath=EXACT)
def _sample(from_row, to_row, stack, inverse, shift, field, wrapped, out):
    count, height, width = stack.shape
    middle_row, middle_column = (height - 1) / 2, (width - 1) / 2
    for r in range(from_row, to_row):
        for c in range(width):
            y, x = r - middle_row, c - middle_column
            squared = y * y + x * x
            outwards = (field[0] + field[7] * squared) * squared
            down = y - shift[0] - (outwards * y + field[1] * y * y + field[2] * y * x + field[3] * x * x)
            right = x - shift[1] - (outwards * x + field[4] * y * y + field[5] * y * x + field[6] * x * x)
            row = middle_row + inverse[0, 0] * down + inverse[0, 1] * right
            column = middle_column + inverse[1, 0] * down + inverse[1, 1] * right
            if wrapped:
                row, column = row % height, column % width
                top, left = int(row) % height, int(column) % width
                below, beside = (top + 1) % height, (left + 1) % width
            else:
                row, column = min(max(row, 0.0), height - 1.0), min(max(column, 0.0), width - 1.0)
                top, left = min(int(row), max(height - 2, 0)), min(int(column), max(width - 2, 0))
                below, beside = min(top + 1, height - 1), min(left + 1, width - 1)
            v, u = (
                row - np.floor(row) if wrapped else row - top,
                column - np.floor(column) if wrapped else column - left,
            )
            for n in range(count):
                upper = (1 - u) * stack[n, top, left] + u * stack[n, top, beside]
                lower = (1 - u) * stack[n, below, left] + u * stack[n, below, beside]
                out[n, r, c] = (1 - v) * upper + v * lower


def undo(masks: F64, fraction: float) -> F64:
    """Solve B[i] = (1 − f) M[i] + f M[i − 1] along the rows' index, from the end from which values were shifted."""
    f = min(abs(fraction), 0.5)
    out = np.empty(masks.shape)
    given, found = (masks, out) if fraction >= 0 else (masks[:, ::-1], out[:, ::-1])
    for k in range(masks.shape[1]):
        last = found[:, k - 1] if k else given[:, 0]
        # Transmissions outside [0, 1] are rounding errors, which would propagate.
        found[:, k] = np.clip((given[:, k] - f * last) / (1 - f), 0.0, 1.0)
    return out


@helper(fastmath=EXACT)
def _opened(masks: F64, n: int, r: int, c: int, sign: float) -> tuple[float, float]:
    """Return the areas of a pixel that its open neighbours open: strips along its sides, and corners outside these.

    If sign is −1, open and closed are exchanged: the areas that closed neighbours close.
    """
    height, width = masks.shape[1], masks.shape[2]
    strips, corners = 0.0, 0.0
    for dr in (-1, 1):
        row = min(max(r + dr, 0), height - 1)
        upright = masks[n, row, c] if sign > 0 else 1 - masks[n, row, c]
        level = masks[n, r, min(max(c + dr, 0), width - 1)]
        strips += upright + (level if sign > 0 else 1 - level)
        for dc in (-1, 1):
            column = min(max(c + dc, 0), width - 1)
            beside, across = masks[n, r, column], masks[n, row, column]
            if sign < 0:
                beside, across = 1 - beside, 1 - across
            corners += 1 - (1 - upright) * (1 - beside) * (1 - across)
    return strips, corners - 2 * strips


def widen(masks: F64, px: float) -> F64:
    """Return the open share of each pixel, [N, H, W], if open elements reach so far beyond their edges."""
    out = np.empty_like(masks)
    in_parts(_widen, masks.shape[1], masks, float(px), out)
    return out


@kernel(i64, i64, f64_3, f64, f64_3, fastmath=EXACT)
def _widen(from_row, to_row, masks, px, out):
    count, _, width = masks.shape
    sign = 1.0 if px > 0 else -1.0
    for r in range(from_row, to_row):
        for n in range(count):
            for c in range(width):
                strips, corners = _opened(masks, n, r, c, sign)
                other = 1 - masks[n, r, c] if px > 0 else masks[n, r, c]
                out[n, r, c] = masks[n, r, c] + sign * other * (abs(px) * strips + px * px * corners)


def edge_bands(masks: F64, weights: F64) -> F64:
    """Return the factors of |px| and px² in the sum of `widen`'s masks, [2, 2, H, W]: wider, then narrower."""
    out = np.zeros((2, 2, *masks.shape[1:]))
    in_parts(_edge_bands, masks.shape[1], masks, np.ascontiguousarray(weights, np.float64), out)
    return out


@kernel(i64, i64, f64_3, f64_1, f64_4, fastmath=EXACT)
def _edge_bands(from_row, to_row, masks, weights, out):
    count, _, width = masks.shape
    for r in range(from_row, to_row):
        for c in range(width):
            for n in range(count):
                opened, closed = _opened(masks, n, r, c, 1.0), _opened(masks, n, r, c, -1.0)
                for k in range(2):
                    out[0, k, r, c] += weights[n] * (1 - masks[n, r, c]) * opened[k]
                    out[1, k, r, c] -= weights[n] * masks[n, r, c] * closed[k]
