"""Numba kernel: what a sensor pixel sees of a pattern of square mirrors.

The readable statement of the same in numpy float64 is in `tests/calibration/masks/test_imaging.py`, which holds the
kernel to it. Every pixel is computed alone, so the result does not depend on the number of threads.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.kernels import EXACT, f32_2, f64, f64_2, helper, i64, in_parts, kernel

SMOOTHED: Final = 0.05
"""Half the width, in boxes, over which derivatives are averaged. They jump where an edge of the box meets an edge of
a mirror, on a bench without misalignment everywhere at once; a fit that follows them would swing to and fro there."""


@helper(fastmath=EXACT)
def _overlap(first: float, last: float, index: int) -> float:
    """Return how much of an interval lies in [index, index + 1]."""
    return max(min(last, index + 1.0) - max(first, float(index)), 0.0)


def sample_boxes(pattern: F32, u: F64, v: F64, wide: float, high: float) -> tuple[F64, F64, F64]:
    """Average a pattern of unit squares over boxes, with derivatives.

    Args:
        pattern: Transmission of each mirror, [Hm, Wm]; beyond it nothing passes.
        u: Columns of the boxes' middles in modulator pixels (centres at +0.5), [H, W].
        v: Rows of the boxes' middles.
        wide: Width of the boxes in modulator pixels, more than 0.
        high: Their height.

    Returns:
        Mean transmission of each box, its derivative by u and by v, [H, W] each; the derivatives are means over
        boxes moved by up to `SMOOTHED` of their size.
    """
    mean, by_u, by_v = np.empty(u.shape), np.empty(u.shape), np.empty(u.shape)
    places = (np.ascontiguousarray(u, np.float64), np.ascontiguousarray(v, np.float64))
    pattern = np.ascontiguousarray(pattern, np.float32)
    in_parts(_sample, len(u), pattern, *places, float(wide), float(high), mean, by_u, by_v)
    return mean, by_u, by_v


@kernel(i64, i64, f32_2, f64_2, f64_2, f64, f64, f64_2, f64_2, f64_2, fastmath=EXACT)
def _sample(from_row, to_row, pattern, u, v, wide, high, mean, by_u, by_v):
    columns = u.shape[1]
    area = wide * high
    du, dv = SMOOTHED * wide, SMOOTHED * high
    for i in range(from_row, to_row):
        for j in range(columns):
            left, top = u[i, j] - 0.5 * wide, v[i, j] - 0.5 * high
            right, bottom = left + wide, top + high
            first_m, last_m = int(np.floor(left - du)), int(np.floor(right + du))
            first_n, last_n = int(np.floor(top - dv)), int(np.floor(bottom + dv))
            total, slope_u, slope_v = 0.0, 0.0, 0.0
            for n in range(max(first_n, 0), min(last_n, pattern.shape[0] - 1) + 1):
                across, ends = 0.0, 0.0
                for m in range(max(first_m, 0), min(last_m, pattern.shape[1] - 1) + 1):
                    level = float(pattern[n, m])
                    across += level * _overlap(left, right, m)
                    ends += level * (_overlap(right - du, right + du, m) - _overlap(left - du, left + du, m))
                tall = _overlap(top, bottom, n)
                total += tall * across
                slope_u += tall * ends / (2 * du)
                slope_v += (_overlap(bottom - dv, bottom + dv, n) - _overlap(top - dv, top + dv, n)) / (2 * dv) * across
            mean[i, j] = total / area
            by_u[i, j] = slope_u / area
            by_v[i, j] = slope_v / area
