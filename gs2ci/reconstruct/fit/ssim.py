"""Structural similarity of a prediction with a fixed target, and its gradient, in two fused passes.

Here: the Numba kernels, several times faster than the same convolutions in torch. They compute in float64: over a
bright, flat part of a measurement the variances are differences of nearly equal squares, of which float32 would leave
no digit above C2. The readable definition they are held to is in `tests/reconstruct/fit/conftest.py`. Not here: the
losses around it (`losses`, `perceptual`, which are the only importers).
"""

import math
from typing import Any, Final

import numpy as np
from numba import njit, prange

from gs2ci.core.arrays import F32, F64

WINDOW: Final = 11  # pixels; Wang et al., "Image quality assessment" (IEEE TIP 2004), section III-B
SIGMA_PX: Final = 1.5  # of that window; others are scaled with it
LEAST_WINDOW: Final = 3  # a single pixel has no variance
C1: Final = 0.01**2  # stabilise the two quotients at a data range of one view's full scale; same source
C2: Final = 0.03**2


def _gaussian_taps(window_px: int) -> F64:
    reach, sigma_px = window_px // 2, SIGMA_PX * window_px / WINDOW
    taps = [math.exp(-(k * k) / (2 * sigma_px**2)) for k in range(-reach, reach + 1)]
    return np.array(taps) / sum(taps)


# Contraction to fused multiply-adds only: no reassociation, so that results do not depend on the vector width.
_JIT: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "fastmath": {"contract"}}


@njit(**_JIT)
def _row(image: F64, y: int, zeros: F64) -> F64:
    return image[y] if 0 <= y < image.shape[0] else zeros


@njit(**_JIT)
def _filter_row(source: F64, y: int, taps: F64, channels: int, scratch: F64, zeros: F64, out: F64) -> None:
    """Gaussian-filter row y of [H, W * C] into out [W * C]; pixels outside the image count as zero."""
    width, reach = source.shape[1], len(taps) // 2
    # Slices, because computed indices could be negative and stop vectorisation; the rims of scratch stay zero.
    inside = scratch[reach * channels : reach * channels + width]
    centre = source[y]
    for x in range(width):
        inside[x] = taps[reach] * centre[x]
    for k in range(1, reach + 1):  # the window is symmetric: two samples share a product
        tap, above, below = taps[reach - k], _row(source, y - k, zeros), _row(source, y + k, zeros)
        for x in range(width):
            inside[x] += tap * (above[x] + below[x])
    for x in range(width):
        out[x] = taps[reach] * inside[x]
    for k in range(1, reach + 1):
        tap, left, right = taps[reach - k], scratch[(reach - k) * channels :], scratch[(reach + k) * channels :]
        for x in range(width):
            out[x] += tap * (left[x] + right[x])


@njit(parallel=True, **_JIT)
def _filter_image(source: F64, taps: F64, channels: int, out: F64) -> None:
    for y in prange(source.shape[0]):
        scratch, zeros = np.zeros(source.shape[1] + (len(taps) - 1) * channels), np.zeros(source.shape[1])
        _filter_row(source, y, taps, channels, scratch, zeros, out[y])


@njit(parallel=True, **_JIT)
def _similarity(
    a: F64, b: F64, mean_b: F64, mean_bb: F64, taps: F64, channels: int, partial: F64, row_sums: F64
) -> None:
    """Sum the similarity per row, and store its derivatives by the filtered a, a² and ab in partial [3, H, W * C]."""
    height, width = a.shape
    squares = np.empty_like(a)
    products = np.empty_like(a)
    for y in prange(height):
        for x in range(width):
            squares[y, x] = a[y, x] * a[y, x]
            products[y, x] = a[y, x] * b[y, x]
    for y in prange(height):
        scratch, zeros = np.zeros(width + (len(taps) - 1) * channels), np.zeros(width)
        mean_a = np.empty(width, np.float64)
        mean_aa = np.empty(width, np.float64)
        mean_ab = np.empty(width, np.float64)
        _filter_row(a, y, taps, channels, scratch, zeros, mean_a)
        _filter_row(squares, y, taps, channels, scratch, zeros, mean_aa)
        _filter_row(products, y, taps, channels, scratch, zeros, mean_ab)
        total = 0.0
        for x in range(width):
            ma, mb = mean_a[x], mean_b[y, x]
            luminance_top = 2.0 * ma * mb + C1
            luminance_bottom = ma * ma + mb * mb + C1
            structure_top = 2.0 * (mean_ab[x] - ma * mb) + C2
            structure_bottom = (mean_aa[x] - ma * ma) + (mean_bb[y, x] - mb * mb) + C2
            # Round-off can push a variance of a flat, very bright window below zero.
            structure_bottom = max(structure_bottom, 0.5 * C2)
            luminance = luminance_top / luminance_bottom
            structure = structure_top / structure_bottom
            total += luminance * structure
            by_mean = structure * 2.0 * (mb - luminance * ma) / luminance_bottom
            by_structure = luminance / structure_bottom
            partial[0, y, x] = by_mean + 2.0 * by_structure * (structure * ma - mb)
            partial[1, y, x] = -by_structure * structure
            partial[2, y, x] = 2.0 * by_structure
        row_sums[y] = total


@njit(parallel=True, **_JIT)
def _gradient(a: F64, b: F64, partial: F64, taps: F64, channels: int, scale: float, out: F64) -> None:
    """Chain the derivatives through the filter, which is its own adjoint under zero padding."""
    height, width = a.shape
    for y in prange(height):
        scratch, zeros = np.zeros(width + (len(taps) - 1) * channels), np.zeros(width)
        by_a = np.empty(width, np.float64)
        by_aa = np.empty(width, np.float64)
        by_ab = np.empty(width, np.float64)
        _filter_row(partial[0], y, taps, channels, scratch, zeros, by_a)
        _filter_row(partial[1], y, taps, channels, scratch, zeros, by_aa)
        _filter_row(partial[2], y, taps, channels, scratch, zeros, by_ab)
        for x in range(width):
            value = by_a[x] + 2.0 * a[y, x] * by_aa[x] + b[y, x] * by_ab[x]
            out[y, x] = scale * value


class SimilarityTo:
    """Mean structural similarity to one target, [H, W, C] float32, whose statistics are computed once.

    11 × 11 Gaussian window of 1.5 px, or another of the same shape; zero padding, data range 1 (Wang et al. 2004).
    Thread-count independent: rows are summed apart, in float64, and then in order.

    Args:
        target: [H, W, C].
        window_px: The window's side, odd, >= `LEAST_WINDOW`.
    """

    def __init__(self, target: F32, window_px: int = WINDOW) -> None:
        self._taps = _gaussian_taps(window_px)
        self._shape = target.shape
        self._target = np.ascontiguousarray(target, np.float64).reshape(target.shape[0], -1)
        self._mean = np.empty_like(self._target)
        self._mean_square = np.empty_like(self._target)
        self._partial = np.empty((3, *self._target.shape), np.float64)
        _filter_image(self._target, self._taps, target.shape[2], self._mean)
        _filter_image(self._target * self._target, self._taps, target.shape[2], self._mean_square)

    def dissimilarity(self, image: F32) -> F32:
        """Return 1 − SSIM at each pixel of an image [H, W, C], mean over the channels, [H, W]."""
        channels = self._shape[2]
        a = np.ascontiguousarray(image, np.float64).reshape(self._target.shape)
        b, mean_b = self._target, self._mean
        mean_a, mean_aa, mean_ab = np.empty_like(a), np.empty_like(a), np.empty_like(a)
        for source, out in ((a, mean_a), (a * a, mean_aa), (a * b, mean_ab)):
            _filter_image(source, self._taps, channels, out)
        luminance = (2 * mean_a * mean_b + C1) / (mean_a**2 + mean_b**2 + C1)
        variances = (mean_aa - mean_a**2) + (self._mean_square - mean_b**2)
        structure = (2 * (mean_ab - mean_a * mean_b) + C2) / np.maximum(variances + C2, 0.5 * C2)
        result: F32 = (1 - luminance * structure).reshape(self._shape).mean(axis=2).astype(np.float32)
        return result

    def __call__(self, image: F32) -> tuple[float, F32]:
        """Return the mean similarity of an image [H, W, C] to the target, and its gradient [H, W, C]."""
        channels = self._shape[2]
        flat = np.ascontiguousarray(image, np.float64).reshape(self._target.shape)
        row_sums = np.empty(flat.shape[0], np.float64)
        _similarity(flat, self._target, self._mean, self._mean_square, self._taps, channels, self._partial, row_sums)
        gradient = np.empty_like(flat)
        _gradient(flat, self._target, self._partial, self._taps, channels, 1.0 / flat.size, gradient)
        return float(row_sums.sum() / flat.size), gradient.astype(np.float32).reshape(self._shape)
