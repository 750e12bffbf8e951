"""The power of a scene's image by frequency and direction, which determines how fast its phases rotate while it moves.

Details finer than the spacing of a view's samples appear at a coarser frequency by aliasing, but their phase rotates
with their own frequency. So the image of a moving camera is measured with twice the samples of the exposure, and
weighted with the amplitude that the exposure's samples transmit. Not here: the views (`preview`), the rotation of
cosines (`waves`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.fft import dctn

from gs2ci.core.arrays import F32, F64

# Number of sectors of a quarter turn for the directions of frequencies: a cosine transform does not distinguish
# (right, down) from (right, up).
SECTORS: Final = 4
BINS: Final = 193
# Frequencies are binned in bands of this many rows, which bounds the memory for a large view.
ROWS_AT_ONCE: Final = 128


@dataclass(frozen=True)
class MovingSpectrum:
    """Mean power of the pixels' radiance by frequency and direction.

    Args:
        frequency: Upper ends of the bins, cycles per pixel, [BINS].
        power: [BINS, SECTORS], radiance squared; sectors from across to down.
    """

    frequency: F64
    power: F64

    def missed(self, frequency: F64, shares: F64) -> tuple[F64, F64]:
        """Return the rms, radiance, of the image weighted by shares, and the largest share of its cosines, [...] each.

        Args:
            frequency: Frequencies of the shares, increasing, [F].
            shares: Shares of a cosine's amplitude, [..., F, SECTORS].
        """
        # As `np.interp` has it, but for all at once.
        below = np.searchsorted(frequency, self.frequency, side="right").clip(1, len(frequency)) - 1
        past = np.minimum(np.maximum(self.frequency, frequency[0]), frequency[-1]) - frequency[below]
        slopes = np.diff(shares, axis=-2) / np.diff(frequency)[:, None]
        left = slopes[..., np.minimum(below, len(frequency) - 2), :] * past[:, None] + shares[..., below, :]
        squares = (self.power * np.square(left)).reshape(*shares.shape[:-2], -1)
        return np.sqrt(squares.sum(axis=-1)), left.max(axis=(-2, -1))


def moving_spectrum(views: F32, samples: int, drawn: int, filter_px2: float, pixels: int) -> MovingSpectrum:
    """Measure the spectrum of the pixels of views with fewer samples than the given ones.

    Args:
        views: Radiance, [V, H n, W n, 3].
        samples: n, per pixel side.
        drawn: Samples per pixel side of the views in question, at most n; a pixel is their mean.
        filter_px2: Variance by which their samples are blurred more than the given ones, square pixels.
        pixels: How many the sensor has. What the views show beside them counts in full: it may lie anywhere.
    """
    _, height, width, channels = views.shape
    # Planes one after the other, frequencies in bands: a large view then needs little more than its own memory.
    power = np.zeros((height, width), np.float32)
    for view in views:
        for channel in range(channels):
            power += np.square(dctn(view[..., channel], norm="ortho"))
    power /= len(views) * channels * pixels * samples**2
    down = np.arange(height) / (2 * height) * samples
    right = np.arange(width) / (2 * width) * samples
    left_down, left_right = (np.square(amplitude_left(side, drawn, filter_px2)) for side in (down, right))
    ends = np.linspace(0, samples * np.sqrt(0.5), BINS)
    binned = np.zeros(BINS * SECTORS)
    for first in range(0, height, ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        frequency = np.hypot(down[rows, None], right)
        place = np.searchsorted(ends, frequency.ravel()).clip(max=BINS - 1)
        turn = np.arctan2(*np.broadcast_arrays(down[rows, None], right)) / (np.pi / 2)
        sector = (turn * SECTORS).astype(np.intp).clip(max=SECTORS - 1).ravel()
        left = power[rows] * left_down[rows, None] * left_right
        binned += np.bincount(place * SECTORS + sector, left.ravel(), BINS * SECTORS)
    return MovingSpectrum(ends, binned.reshape(BINS, SECTORS))


def amplitude_left(frequency: F64, drawn: int, filter_px2: float) -> F64:
    """Return the share of a cosine's amplitude after the filter and the mean over the samples of a pixel."""
    mean = np.sinc(frequency) / np.sinc(frequency / drawn)
    return mean * np.exp(-2 * np.pi**2 * filter_px2 * np.square(frequency))
