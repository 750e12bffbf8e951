"""The power of a scene's image by frequency and direction: what of it turns in phase, and how fast, while it moves.

A view holds more than its samples tell: what is finer than their spacing appears at a coarser frequency, but it turns
in phase with its own. So the image of a moving camera is looked at with twice the samples that the exposure has, and
counted with what the exposure's samples leave of it. Not here: which views (`preview`), how cosines turn (`waves`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.fft import dctn

from gs2ci.core.arrays import F32, F64

# Directions of frequencies are told apart in so many sectors of a quarter turn: a cosine transform does not know
# (right, down) from (right, up).
SECTORS: Final = 4
BINS: Final = 193
# Frequencies are binned in bands of so many rows, which bounds the memory that a large view takes.
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

    def missed(self, frequency: F64, shares: F64) -> tuple[float, float]:
        """Return the rms, radiance, of what is left of the image, and the largest share left of any cosine.

        Args:
            frequency: At which the shares are known, increasing, [F].
            shares: Of a cosine's amplitude, [F, SECTORS].
        """
        left = np.stack([np.interp(self.frequency, frequency, sector) for sector in shares.T], axis=1)
        return float(np.sqrt((self.power * np.square(left)).sum())), float(left.max())


def moving_spectrum(views: F32, samples: int, drawn: int, filter_px2: float) -> MovingSpectrum:
    """Measure the spectrum of the pixels of views that are drawn with fewer samples than those given.

    Args:
        views: Radiance, [V, H n, W n, 3].
        samples: n, per pixel side.
        drawn: Samples per pixel side of the views that are asked about, at most n; a pixel is their mean.
        filter_px2: Variance by which their samples are blurred more than those given, square pixels.
    """
    _, height, width, channels = views.shape
    # One plane after the other, and bands of frequencies: a large view is looked at in little more than its own memory.
    power = np.zeros((height, width), np.float32)
    for view in views:
        for channel in range(channels):
            power += np.square(dctn(view[..., channel], norm="ortho"))
    power /= views.size
    down = np.arange(height) / (2 * height) * samples
    right = np.arange(width) / (2 * width) * samples
    left_down, left_right = (np.square(_amplitude_left(side, drawn, filter_px2)) for side in (down, right))
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


def _amplitude_left(frequency: F64, drawn: int, filter_px2: float) -> F64:
    """Return what of a cosine's amplitude is left by the filter and by the mean of the samples of a pixel."""
    mean = np.sinc(frequency) / np.sinc(frequency / drawn)
    return np.asarray(mean * np.exp(-2 * np.pi**2 * filter_px2 * np.square(frequency)))
