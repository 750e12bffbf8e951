"""The noise of the readings, and the level at which a decode ends, from pixels that it does not see.

GAP explains every reading that it sees, its noise included, so their residuals tell nothing of the noise. At held-out
pixels the residual is noise and what the views err there. Without noise it mostly decreases to the last step; if it
rises in the second half of the steps, the views have probably begun to follow noise. From then on the noise is what the
residual has beyond the error that belongs to the denoiser's level. Where the residual is smaller than the error that
belongs to the last level, a decode may go on to a lower level: the views, and so the readings, err less.

Here: these estimates. Not here: how a step weighs the noise (`pnp.ReadingNoise`), the noise that the views of a fitted
scene tell (`gs2ci.reconstruct.measurement.noise`).
"""

import math
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.patches.decoder import error_power
from gs2ci.reconstruct.decode.planes import interleaved
from gs2ci.reconstruct.measurement.holdout import HELDOUT_SHARE, Holdout

# Denoised views err at most about this share of the squared level in clips that patches explain. With 0.25, two clips
# gain 0.1 dB more in noise, but water without noise loses 0.6 dB instead of 0.2.
_ERROR_PER_LEVEL: Final = 1.0
# The residual's rise over its least value in the second half of the steps, from which on readings have noise that a
# decode follows. Most clips without noise decrease to the last step; water rose too, and loses 0.2 dB.
_LEAST_RISE: Final = 0.02
# Fewer views are not watched: much of what a pixel shows of one or two views is its own reading, so that a held-out
# pixel tells little of those that are seen. Nor are fewer steps: they end before noise is followed.
_LEAST_VIEWS: Final = 3
_LEAST_STEPS: Final = 24
# Steps whose residuals are averaged: every position is then the reference of a group once.
_AVERAGED: Final = 4
# The last steps see all pixels: one step in so many, and at least these.
_STEPS_PER_SEEING: Final = 6
_LEAST_SEEING: Final = 4
# A decode goes down at most to this share of its last level. With 0.5, a clip of 55 dB gains 3 dB more, but clips of 37
# to 41 dB are 0.02 to 0.16 dB worse.
_LEAST_LEVEL: Final = 2 / 3
# A power beside which a reading counts for nothing, far below float32's largest number.
_UNREAD: Final = np.float32(1e12)


class HeldoutNoise:
    """Updates the power of the noise after each step of a decode.

    Args:
        shot: The measurement.
        steps: How many are made at most.
        seed: Seed of the draw of the pixels that all but the last steps do not see.

    Attributes:
        power: σ² of each reading, [H, W, C] as the measurement, changed in place; so large at pixels not to be seen
            that a step does not use their readings.
    """

    def __init__(self, shot: Shot, steps: int, seed: int) -> None:
        watches = shot.views >= _LEAST_VIEWS and steps >= _LEAST_STEPS
        self._holdout = Holdout.of(shot, HELDOUT_SHARE if watches else 0.0, seed)
        pixels = self._holdout.pixels
        self._blind = bool(pixels.any())
        self._energy = (
            float((self._holdout.weighted.astype(np.float64) ** 2).sum(axis=0).mean()) if self._blind else 0.0
        )
        self._residuals: list[float] = []
        self._now, self._least, self._shows, self._noise = float("inf"), float("inf"), False, 0.0
        self.power: F32 = np.zeros_like(shot.measurement)
        self.power[pixels] = _UNREAD

    def after(self, planes: F32, sigma: float, done: int, left: int) -> None:
        """Update the power.

        Args:
            planes: The views of a step, [N, C, H, W].
            sigma: Its noise level, full scale 1.
            done: How many steps were made.
            left: How many will follow.
        """
        if not self._blind:
            return
        self._residuals.append((self._holdout.residual_rms(interleaved(planes)) or 0.0) ** 2)
        error = _ERROR_PER_LEVEL * self._energy * sigma**2
        self._now = now = float(np.mean(self._residuals[-_AVERAGED:]))
        if done > left:
            self._least = min(self._least, now)
            self._shows = self._shows or now > (1 + _LEAST_RISE) * self._least
        if self._shows:
            self._noise = max(0.0, now - error)
            self.power[:] = self._noise
        self._blind = left > max(_LEAST_SEEING, (done + left) // _STEPS_PER_SEEING)
        self.power[self._holdout.pixels] = _UNREAD if self._blind else self._noise

    def last_sigma(self, stated: float) -> float:
        """Return the noise level at which to end: the stated one, or that of the views' errors if these are smaller."""
        if np.isinf(self._now):
            return stated
        level = math.sqrt(self._now / (self._energy * error_power(1.0)))
        return min(stated, max(level, _LEAST_LEVEL * stated))
