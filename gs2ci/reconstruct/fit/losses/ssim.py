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

from typing import Any, Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.kernels import f32, f32_1, f32_2, f64_1, helper, i64, in_parts, kernel
from gs2ci.reconstruct.fit.kernels.lane_sum import sum_in_lanes
from gs2ci.render.simd.vector import LANES, broadcast, get, load, maximum, store

WINDOW: Final = 11  # pixels; Wang et al., "Image quality assessment" (IEEE TIP 2004), section III-B
SIGMA_PX: Final = 1.5  # of that window; others are scaled with it
LEAST_WINDOW: Final = 3  # a single pixel has no variance
C1: Final = 0.01**2  # stabilise the two quotients at a data range of one view's full scale; same source
C2: Final = 0.03**2

_AT_ONCE: Final = 2 * LANES
_C1: Final = np.float32(C1)
_C2: Final = np.float32(C2)
_LEAST_BOTTOM: Final = np.float32(0.5 * C2)
_ZERO: Final = np.float32(0)
_ONE: Final = np.float32(1)
_TWO: Final = np.float32(2)


def window_taps(window_px: int) -> F64:
    """Return the window from its middle outwards."""
    reach, sigma_px = window_px // 2, SIGMA_PX * window_px / WINDOW
    taps = np.exp(-(np.arange(reach + 1.0) ** 2) / (2 * sigma_px**2))
    return taps / (taps[0] + 2 * taps[1:].sum())


@helper()
def _filter_row(image: F32, y: int, height: int, taps: F32, channels: int, scratch: F32, out: F32) -> None:
    """Gaussian-filter row y of an image of so many rows, [H * P], into out [P]; zero outside of the image.

    The rims of `scratch`, as wide as the window reaches, hold zeros and keep them.
    """
    width, rim = len(out), (len(taps) - 1) * channels
    up, down = min(y, len(taps) - 1), min(height - 1 - y, len(taps) - 1)
    # Two vectors at a time: each weight is read once for both, and neither sum waits for the other.
    for b in range(0, width, _AT_ONCE):
        at = y * width + b
        one, two = load(image, at) * get(taps, 0), load(image, at + LANES) * get(taps, 0)
        for k in range(1, up + 1):
            row = at - k * width
            one, two = one + load(image, row) * get(taps, k), two + load(image, row + LANES) * get(taps, k)
        for k in range(1, down + 1):
            row = at + k * width
            one, two = one + load(image, row) * get(taps, k), two + load(image, row + LANES) * get(taps, k)
        store(scratch, rim + b, one)
        store(scratch, rim + b + LANES, two)
    for b in range(0, width, _AT_ONCE):
        at = rim + b
        one, two = load(scratch, at) * get(taps, 0), load(scratch, at + LANES) * get(taps, 0)
        for k in range(1, len(taps)):
            left, right = at - k * channels, at + k * channels
            one = one + (load(scratch, left) + load(scratch, right)) * get(taps, k)
            two = two + (load(scratch, left + LANES) + load(scratch, right + LANES)) * get(taps, k)
        store(out, b, one)
        store(out, b + LANES, two)


@helper()
def _compare_16(at: int, fe: Any, ee: Any, eb: Any, of_target: F32, partial: F32, apart: F32) -> None:
    """Turn filtered e, e² and eb of 16 values into 1 - similarity and the similarity's derivatives by them."""
    mb, cb = load(of_target[0], at), load(of_target[1], at)
    ma = mb + fe
    difference = maximum(ee - fe * fe, _ZERO)
    # Round-off can push a variance of a flat, very bright window below zero.
    bottom = load(of_target[2], at) * _TWO + (eb - fe * cb) * _TWO + difference + _C2
    per_bottom = broadcast(_ONE) / maximum(bottom, _LEAST_BOTTOM)
    unlike = difference * per_bottom
    per_means = broadcast(_ONE) / (ma * ma + mb * mb + _C1)
    darker = fe * fe * per_means
    luminance, structure = broadcast(_ONE) - darker, broadcast(_ONE) - unlike
    slope = luminance * per_bottom
    by_luminance = (darker * ma - fe) * _TWO * per_means
    store(apart, at, darker + unlike - darker * unlike)
    store(partial[0], at, structure * by_luminance + slope * _TWO * (fe - unlike * (cb + fe)))
    store(partial[1], at, -slope * structure)
    store(partial[2], at, slope * _TWO * unlike)


@kernel(i64, i64, i64, i64, f32_2, f32_2, f32_1, i64, f32_2, f32_1, f64_1)
def _compare(from_row, to_row, height, width, terms, of_target, taps, channels, partial, apart, sums):
    """Store 1 - similarity, its sums per row, and its derivatives by filtered e, e² and eb, [3, H * P]; P >= W * C."""
    padded = len(apart) // height
    filtered = np.empty((3, padded), np.float32)
    scratch = np.zeros(padded + 2 * (len(taps) - 1) * channels, np.float32)
    for y in range(from_row, to_row):
        for k in range(3):
            _filter_row(terms[k], y, height, taps, channels, scratch, filtered[k])
        for b in range(0, padded, LANES):
            of_e, of_ee, of_eb = load(filtered[0], b), load(filtered[1], b), load(filtered[2], b)
            _compare_16(y * padded + b, of_e, of_ee, of_eb, of_target, partial, apart)
        # What rounds rows up to whole vectors does not count.
        partial[:, y * padded + width : (y + 1) * padded] = _ZERO
        sums[y] = sum_in_lanes(apart[y * padded : y * padded + width])


@kernel(i64, i64, i64, f32_1, f32_1, f32_2, f32_1, i64, f32, f32_1)
def _gradient(from_row, to_row, height, error, target, partial, taps, channels, scale, out):
    """Chain the derivatives through the filter, which is its own adjoint under zero padding."""
    padded = len(error) // height
    by = np.empty((3, padded), np.float32)
    scratch = np.zeros(padded + 2 * (len(taps) - 1) * channels, np.float32)
    for y in range(from_row, to_row):
        for k in range(3):
            _filter_row(partial[k], y, height, taps, channels, scratch, by[k])
        for b in range(0, padded, LANES):
            at = y * padded + b
            chained = load(by[0], b) + load(error, at) * _TWO * load(by[1], b) + load(target, at) * load(by[2], b)
            store(out, at, chained * scale)


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
        self._width = target.shape[1] * target.shape[2]
        self._target = self._in_rows(target)
        exact = target.astype(np.float64)
        middle = exact.reshape(-1, target.shape[2]).mean(axis=0)
        window = np.concatenate([taps[:0:-1], taps])
        mean, mean_square = (
            cv2.sepFilter2D(each, cv2.CV_64F, window, window, borderType=cv2.BORDER_CONSTANT).reshape(exact.shape)
            for each in (exact, exact * exact)
        )
        of_target = (mean, mean - middle, mean_square - mean * mean)
        self._of_target = np.stack([self._in_rows(one.astype(np.float32)) for one in of_target])
        self._centred = self._in_rows((exact - middle).astype(np.float32))
        self._terms, self._partial = np.empty_like(self._of_target), np.empty_like(self._of_target)
        self._apart, self._gradient = np.empty_like(self._target), np.empty_like(self._target)

    def _in_rows(self, image: F32) -> F32:
        """Return an image, [H, W, C], with rows rounded up to whole vectors by zeros, [H * P]."""
        rows = np.ascontiguousarray(image, np.float32).reshape(self._shape[0], self._width)
        beyond = -self._width % _AT_ONCE
        return (np.pad(rows, ((0, 0), (0, beyond))) if beyond else rows).reshape(-1)

    def _as_image(self, rows: F32) -> F32:
        return rows.reshape(self._shape[0], -1)[:, : self._width].reshape(self._shape)

    @property
    def of_target(self) -> tuple[F32, ...]:
        """Get the target's filtered values, the same less their channel's mean, variances, and values less that mean.

        Each is [H, W, C].
        """
        return tuple(self._as_image(one) for one in (*self._of_target, self._centred))

    @property
    def taps(self) -> F32:
        """Get the window from its middle outwards."""
        return self._taps

    def dissimilarity(self, image: F32) -> F32:
        """Return 1 − SSIM at each pixel of an image [H, W, C], mean over the channels, [H, W]."""
        self._compare(self._error(image))
        return self._as_image(self._apart).mean(axis=2)

    def _error(self, image: F32) -> F32:
        return self._in_rows(image) - self._target

    def _compare(self, error: F32) -> float:
        """Compare as `_compare` does; return the sum of 1 − SSIM."""
        height = self._shape[0]
        sums = np.empty(height, np.float64)
        self._terms[0] = error
        with np.errstate(over="ignore", invalid="ignore"):  # what diverges has a loss that is not finite
            np.square(error, self._terms[1])
            np.multiply(error, self._centred, out=self._terms[2])
        given = (self._terms, self._of_target, self._taps, self._shape[2], self._partial, self._apart, sums)
        in_parts(_compare, height, height, self._width, *given)
        return float(sums.sum())

    def __call__(self, image: F32) -> tuple[float, F32]:
        """Return the mean similarity of an image [H, W, C] to the target, and its gradient [H, W, C]."""
        value, gradient = self._of_rows(self._error(image))
        return value, gradient.copy()

    def of_error(self, error: F32) -> tuple[float, F32]:
        """Return the same for the image less the target, [H, W, C].

        The gradient lies in memory that the next call writes to: fresh memory for each takes as long as the gradient.
        """
        return self._of_rows(self._in_rows(error))

    def _of_rows(self, error: F32) -> tuple[float, F32]:
        apart, size, height = self._compare(error), self._shape[0] * self._width, self._shape[0]
        given = (error, self._centred, self._partial, self._taps, self._shape[2], np.float32(1.0 / size))
        in_parts(_gradient, height, height, *given, self._gradient)
        return 1.0 - apart / size, self._as_image(self._gradient)
