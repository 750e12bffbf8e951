"""Numba kernel: what a sensor pixel sees of a pattern of square mirrors. Only `imaging` imports this file.

The readable statement of the same in numpy float64 is in `tests/calibration/test_imaging.py`, which holds the kernel
to it. Every pixel is computed alone, so the result does not depend on the number of threads.
"""

import numba
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@numba.njit(cache=True)
def sample_boxes(pattern: F32, u: F64, v: F64, wide: float, high: float) -> tuple[F64, F64, F64]:
    """Average a pattern of unit squares over boxes, with derivatives.

    Args:
        pattern: Transmission of each mirror, [Hm, Wm]; beyond it nothing passes.
        u: Columns of the boxes' middles in modulator pixels (centres at +0.5), [H, W].
        v: Rows of the boxes' middles.
        wide: Width of the boxes in modulator pixels, more than 0.
        high: Their height.

    Returns:
        Mean transmission of each box, its derivative by u and by v, [H, W] each.
    """
    rows, columns = u.shape
    mean, by_u, by_v = np.zeros(u.shape), np.zeros(u.shape), np.zeros(u.shape)
    area = wide * high
    for i in range(rows):
        for j in range(columns):
            left, top = u[i, j] - 0.5 * wide, v[i, j] - 0.5 * high
            right, bottom = left + wide, top + high
            first_m, last_m = int(np.floor(left)), int(np.floor(right))
            first_n, last_n = int(np.floor(top)), int(np.floor(bottom))
            total, slope_u, slope_v = 0.0, 0.0, 0.0
            for n in range(max(first_n, 0), min(last_n, pattern.shape[0] - 1) + 1):
                tall = min(bottom, n + 1.0) - max(top, float(n))
                across, ends = 0.0, 0.0
                for m in range(max(first_m, 0), min(last_m, pattern.shape[1] - 1) + 1):
                    level = float(pattern[n, m])
                    across += level * (min(right, m + 1.0) - max(left, float(m)))
                    if m == last_m:
                        ends += level
                    if m == first_m:
                        ends -= level
                total += tall * across
                slope_u += tall * ends
                if n == last_n:
                    slope_v += across
                if n == first_n:
                    slope_v -= across
            mean[i, j] = total / area
            by_u[i, j] = slope_u / area
            by_v[i, j] = slope_v / area
    return mean, by_u, by_v
