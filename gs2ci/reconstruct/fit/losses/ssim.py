"""Structural similarity of a prediction with a fixed target, and its gradient, in two fused passes.

Here: the Numba kernels, several times faster than the same convolutions in torch. They compute in float32, 16 values at
a time, from the error e = a - b of the prediction a and the target b. With F the window's weighted sum,

    1 - structure = (F[ee] - F[e]^2) / D,     D = 2 var(b) + 2 (F[eb] - F[e] F[b]) + (F[ee] - F[e]^2) + C2,
    1 - luminance = F[e]^2 / (F[a]^2 + F[b]^2 + C1),

which is the usual pair of quotients, rewritten. Written the usual way, over a bright and flat part of a measurement the
variances are differences of nearly equal squares, of which float32 would leave no digit above C2; here every difference
is of terms that shrink with the error, and var(b) is computed once, in float64. (Of b, the covariance sees what its
channel's mean leaves.) Where b is flat and e constant, terms of the gradient as large as 2 e / C2 cancel, and rounding
leaves some 1e-7 of them. The readable definition they are held to is in `tests/reconstruct/fit/conftest.py`. Not here:
the losses around it (`objective`, `paper.perceptual`).
"""

from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.kernels import f32, f32_1, f32_2, f32_3, f64_1, helper, i64, in_parts, kernel
from gs2ci.reconstruct.fit.kernels.lane_sum import sum_in_lanes

WINDOW: Final = 11  # pixels; Wang et al., "Image quality assessment" (IEEE TIP 2004), section III-B
SIGMA_PX: Final = 1.5  # of that window; others are scaled with it
LEAST_WINDOW: Final = 3  # a single pixel has no variance
C1: Final = 0.01**2  # stabilise the two quotients at a data range of one view's full scale; same source
C2: Final = 0.03**2

_C1: Final = np.float32(C1)
_C2: Final = np.float32(C2)
_LEAST_BOTTOM: Final = np.float32(0.5 * C2)
_ZERO: Final = np.float32(0)
_ONE: Final = np.float32(1)
_TWO: Final = np.float32(2)

# More taps than that in one loop, and the compiler gives up telling their memory apart, and vectors with it.
_TAPS_AT_ONCE: Final = 3


def window_taps(window_px: int) -> F64:
    """Return the window from its middle outwards, then zeros up to a whole number of loops."""
    reach, sigma_px = window_px // 2, SIGMA_PX * window_px / WINDOW
    taps = np.exp(-(np.arange(reach + 1.0) ** 2) / (2 * sigma_px**2))
    taps /= taps[0] + 2 * taps[1:].sum()
    return np.pad(taps, (0, -len(taps) % _TAPS_AT_ONCE))


@helper()
def _row(image: F32, y: int, zeros: F32) -> F32:
    return image[y] if 0 <= y < image.shape[0] else zeros


@helper()
def _begin(out: F32, taps: F32, centre: F32, a1: F32, b1: F32, a2: F32, b2: F32) -> None:
    """Set a row to the sum of the window's inner taps."""
    for x in range(len(out)):
        out[x] = taps[0] * centre[x] + taps[1] * (a1[x] + b1[x]) + taps[2] * (a2[x] + b2[x])


@helper()
def _add(out: F32, taps: F32, k: int, a0: F32, b0: F32, a1: F32, b1: F32, a2: F32, b2: F32) -> None:
    """Add three further taps on either side."""
    for x in range(len(out)):
        out[x] += taps[k] * (a0[x] + b0[x]) + taps[k + 1] * (a1[x] + b1[x]) + taps[k + 2] * (a2[x] + b2[x])


@helper()
def _filter_row(source: F32, y: int, taps: F32, channels: int, scratch: F32, zeros: F32, out: F32) -> None:
    """Gaussian-filter row y of [H, W * C] into out [W * C]; pixels outside the image count as zero.

    The rims of `scratch`, as wide as the padded window reaches, hold zeros and keep them.
    """
    width, rim = source.shape[1], (len(taps) - 1) * channels
    inside = scratch[rim : rim + width]
    _begin(
        inside,
        taps,
        source[y],
        _row(source, y - 1, zeros),
        _row(source, y + 1, zeros),
        _row(source, y - 2, zeros),
        _row(source, y + 2, zeros),
    )
    for k in range(_TAPS_AT_ONCE, len(taps), _TAPS_AT_ONCE):
        _add(
            inside,
            taps,
            k,
            _row(source, y - k, zeros),
            _row(source, y + k, zeros),
            _row(source, y - k - 1, zeros),
            _row(source, y + k + 1, zeros),
            _row(source, y - k - 2, zeros),
            _row(source, y + k + 2, zeros),
        )
    left, right = scratch[: rim + width], scratch[rim:]
    _begin(
        out,
        taps,
        inside,
        left[rim - channels :],
        right[channels:],
        left[rim - 2 * channels :],
        right[2 * channels :],
    )
    for k in range(_TAPS_AT_ONCE, len(taps), _TAPS_AT_ONCE):
        _add(
            out,
            taps,
            k,
            left[rim - k * channels :],
            right[k * channels :],
            left[rim - (k + 1) * channels :],
            right[(k + 1) * channels :],
            left[rim - (k + 2) * channels :],
            right[(k + 2) * channels :],
        )


@helper()
def _compare_row(
    e: F32, ee: F32, eb: F32, mean: F32, centred: F32, variance: F32, by_e: F32, by_ee: F32, apart: F32
) -> None:
    """Turn filtered e, e² and eb of a row into 1 - similarity and, in place, into the similarity's derivatives."""
    for x in range(len(e)):
        fe, mb, cb = e[x], mean[x], centred[x]
        ma = mb + fe
        difference = max(ee[x] - fe * fe, _ZERO)
        # Round-off can push a variance of a flat, very bright window below zero.
        bottom = max(_TWO * variance[x] + _TWO * (eb[x] - fe * cb) + difference + _C2, _LEAST_BOTTOM)
        per_bottom = _ONE / bottom
        unlike = difference * per_bottom
        per_means = _ONE / (ma * ma + mb * mb + _C1)
        darker = fe * fe * per_means
        luminance, structure = _ONE - darker, _ONE - unlike
        slope = luminance * per_bottom
        by_luminance = _TWO * (darker * ma - fe) * per_means
        apart[x] = darker + unlike - darker * unlike
        by_e[x] = structure * by_luminance + _TWO * slope * (fe - unlike * (cb + fe))
        by_ee[x] = -slope * structure
        eb[x] = _TWO * slope * unlike


@kernel(i64, i64, f32_2, f32_2, f32_2, f32_2, f32_2, f32_2, f32_1, i64, f32_3, f32_2, f64_1)
def _compare(
    from_row: int,
    to_row: int,
    error: F32,
    squares: F32,
    products: F32,
    mean: F32,
    centred: F32,
    variance: F32,
    taps: F32,
    channels: int,
    partial: F32,
    apart: F32,
    sums: F64,
) -> None:
    """Store 1 - similarity, its sums per row, and its derivatives by filtered e, e² and eb, [3, H, W * C]."""
    width = error.shape[1]
    for y in range(from_row, to_row):
        scratch = np.zeros(width + 2 * (len(taps) - 1) * channels, np.float32)
        zeros = np.zeros(width, np.float32)
        e, ee = np.empty(width, np.float32), np.empty(width, np.float32)
        _filter_row(error, y, taps, channels, scratch, zeros, e)
        _filter_row(squares, y, taps, channels, scratch, zeros, ee)
        _filter_row(products, y, taps, channels, scratch, zeros, partial[2, y])
        _compare_row(e, ee, partial[2, y], mean[y], centred[y], variance[y], partial[0, y], partial[1, y], apart[y])
        sums[y] = sum_in_lanes(apart[y])


@helper()
def _chain_row(e: F32, b: F32, by_e: F32, by_ee: F32, by_eb: F32, scale: float, out: F32) -> None:
    for x in range(len(out)):
        out[x] = scale * (by_e[x] + _TWO * e[x] * by_ee[x] + b[x] * by_eb[x])


@kernel(i64, i64, f32_2, f32_2, f32_3, f32_1, i64, f32, f32_2)
def _gradient(
    from_row: int,
    to_row: int,
    error: F32,
    target: F32,
    partial: F32,
    taps: F32,
    channels: int,
    scale: float,
    out: F32,
) -> None:
    """Chain the derivatives through the filter, which is its own adjoint under zero padding."""
    width = error.shape[1]
    for y in range(from_row, to_row):
        scratch = np.zeros(width + 2 * (len(taps) - 1) * channels, np.float32)
        zeros = np.zeros(width, np.float32)
        by_e, by_ee = np.empty(width, np.float32), np.empty(width, np.float32)
        by_eb = np.empty(width, np.float32)
        _filter_row(partial[0], y, taps, channels, scratch, zeros, by_e)
        _filter_row(partial[1], y, taps, channels, scratch, zeros, by_ee)
        _filter_row(partial[2], y, taps, channels, scratch, zeros, by_eb)
        _chain_row(error[y], target[y], by_e, by_ee, by_eb, scale, out[y])


class SimilarityTo:
    """Mean structural similarity to one target, [H, W, C] float32, whose statistics are computed once.

    11 × 11 Gaussian window of 1.5 px, or another of the same shape; zero padding, data range 1 (Wang et al. 2004).
    Thread-count independent: rows are summed apart, in float64, and then in order.

    Args:
        target: [H, W, C].
        window_px: The window's side, odd, >= `LEAST_WINDOW`.
    """

    def __init__(self, target: F32, window_px: int = WINDOW) -> None:
        taps = window_taps(window_px)
        self._taps = taps.astype(np.float32)
        self._shape = target.shape
        self._target = np.ascontiguousarray(target, np.float32).reshape(target.shape[0], -1)
        exact = self._target.astype(np.float64)
        middle = np.tile(exact.reshape(-1, target.shape[2]).mean(axis=0), target.shape[1])
        window = np.concatenate([taps[:0:-1], taps])
        mean, mean_square = (
            cv2.sepFilter2D(
                each.reshape(target.shape), cv2.CV_64F, window, window, borderType=cv2.BORDER_CONSTANT
            ).reshape(exact.shape)
            for each in (exact, exact * exact)
        )
        self._mean, self._centred_mean = mean.astype(np.float32), (mean - middle).astype(np.float32)
        self._centred = (exact - middle).astype(np.float32)
        self._variance = (mean_square - mean * mean).astype(np.float32)
        self._partial = np.empty((3, *self._target.shape), np.float32)
        self._apart, self._gradient = np.empty_like(self._target), np.empty_like(self._target)

    @property
    def of_target(self) -> tuple[F32, F32, F32, F32]:
        """Get the target's filtered values, the same less their channel's mean, variances, and values less that mean.

        Each is [H, W * C].
        """
        return self._mean, self._centred_mean, self._variance, self._centred

    @property
    def taps(self) -> F32:
        """Get the window from its middle outwards, then zeros."""
        return self._taps

    def dissimilarity(self, image: F32) -> F32:
        """Return 1 − SSIM at each pixel of an image [H, W, C], mean over the channels, [H, W]."""
        self._compare(self._error(image))
        result: F32 = self._apart.reshape(self._shape).mean(axis=2)
        return result

    def _error(self, image: F32) -> F32:
        return np.ascontiguousarray(image, np.float32).reshape(self._target.shape) - self._target

    def _compare(self, error: F32) -> float:
        """Compare as `_compare` does; return the sum of 1 − SSIM."""
        sums = np.empty(error.shape[0], np.float64)
        of_target = (self._mean, self._centred_mean, self._variance)
        given = (error, error * error, error * self._centred, *of_target, self._taps, self._shape[2])
        in_parts(_compare, len(error), *given, self._partial, self._apart, sums)
        return float(sums.sum())

    def __call__(self, image: F32) -> tuple[float, F32]:
        """Return the mean similarity of an image [H, W, C] to the target, and its gradient [H, W, C]."""
        value, gradient = self.of_error(self._error(image))
        return value, gradient.copy()

    def of_error(self, error: F32) -> tuple[float, F32]:
        """Return the same for the image less the target, [H, W, C] in one piece of memory.

        The gradient lies in memory that the next call writes to: fresh memory for each takes as long as the gradient.
        """
        error = error.reshape(self._target.shape)
        apart = self._compare(error)
        scale = np.float32(1.0 / error.size)
        given = (error, self._centred, self._partial, self._taps, self._shape[2], scale)
        in_parts(_gradient, len(error), *given, self._gradient)
        return 1.0 - apart / error.size, self._gradient.reshape(self._shape)
