"""A decode by similar patches that ends when pixels that it has not seen gain no more.

How long a decode is worth going on differs: most clips gain down to the lowest noise level, a picture full of texture
begins to lose its detail half way.

Here: the watch, and the decode under it. Not here: the schedule and the steps (`decoder`).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, patch_decode_from
from gs2ci.reconstruct.measurement.jury import Jury

# A lattice has four phases at most: after so many steps every place has been the reference of a group.
_LOOK_EVERY: Final = 4
# Groups are sought again after three uses of each phase, which makes the residual fall in steps.
_ROUND: Final = 12
# A decode that presses for time goes on as long as a round takes so much off the residual.
LEAST_GAIN: Final = 0.02
# A few hundred pixels do not tell residuals apart that differ by less. On a piece of a clip (traffic) theirs was least
# at step 32 of 96, and 3 % more at step 72, whose views were 1.2 dB better; at 96, where it was 18 % more, those were
# 1.4 dB worse again.
_ALIKE: Final = 0.05


@dataclass(frozen=True)
class Settled:
    """What a decode came to.

    Args:
        views: The latest that left about the least of the held-out pixels, [N, H, W, C] float32 in [0, 1].
        sigma: The noise level at which they were found, full scale 1.
        steps: How many steps were made.
    """

    views: F32
    sigma: float
    steps: int


class _Watch:
    """Keeps the latest views that are about the best, and says when it is enough.

    Args:
        jury: The measurement, and its held-out pixels.
        least_gain: By which share a round has to lessen the residual; None: it has only not to be worse throughout.
    """

    def __init__(self, jury: Jury, least_gain: float | None) -> None:
        self._jury, self._least_gain = jury, least_gain
        self._left: list[float] = []
        self.steps = 0
        self.best: tuple[int, F32] | None = None

    def __call__(self, planar: F32) -> bool:
        """Look at views, [N, C, H, W], after a step; tell whether it was the last."""
        self.steps += 1
        if self.steps % _LOOK_EVERY:
            return False
        views = np.clip(np.ascontiguousarray(planar.transpose(0, 2, 3, 1)), 0, 1)
        left = self._jury.residual_rms(views)
        if left is None:
            return False
        self._left.append(left)
        most = (1 + _ALIKE) * min(self._left)
        if left <= most:
            self.best = self.steps, views
        looks = _ROUND // _LOOK_EVERY
        if len(self._left) <= looks:
            return False
        if self._least_gain is None:
            return all(one > most for one in self._left[-looks:])
        return left > (1 - self._least_gain) * self._left[-1 - looks]


def decode_until_settled(
    jury: Jury,
    start: F32,
    settings: PatchSettings,
    progress: Progress | None = None,
    least_gain: float | None = LEAST_GAIN,
) -> Settled:
    """Decode a measurement without its held-out pixels, for as long as these gain.

    Args:
        jury: The measurement, and its held-out pixels. Without any the schedule is gone through to its end.
        start: Views to begin with, [N, H, W, C] float32.
        settings: The whole schedule.
        progress: Hears of each iteration and its relative residual.
        least_gain: Where a round of twelve steps takes less than this share off the residual the decode ends; None: it
            ends only where all of a round has been clearly worse.

    Raises:
        InputError: The settings make no sense.
    """
    watch = _Watch(jury, least_gain)
    last = patch_decode_from(jury.seen, start, settings, progress, watch)
    if watch.best is None:
        return Settled(last, settings.last_sigma, watch.steps)
    step, views = watch.best
    return Settled(views, settings.sigmas[step - 1], watch.steps)


def seen_to_the_end(jury: Jury, blind: F32, sigma: float) -> F32:
    """Let a decode see all pixels, by a few last steps at the noise level at which it ended.

    On crops of two clips eight steps gave what a decode of all pixels gives, within 0.03 dB, for a twelfth of it.

    Args:
        jury: The measurement.
        blind: Views decoded without the held-out pixels, [N, H, W, C].
        sigma: That level, full scale 1.
    """
    return patch_decode_from(jury.shot, blind, replace(PatchSettings.to_the_end(), first_sigma=sigma, last_sigma=sigma))
