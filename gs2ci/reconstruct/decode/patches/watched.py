"""A decode by similar patches that ends when pixels that it has not seen gain no more.

How long a decode is worth going on differs: a clip gains down to the lowest noise level, a picture full of texture
begins to lose its detail half way. The residual on the held-out pixels follows the error of the views in both.

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
# A decode goes on as long as a round takes so much off the residual.
LEAST_GAIN: Final = 0.02


@dataclass(frozen=True)
class Settled:
    """What a decode came to.

    Args:
        views: Those that left least of the held-out pixels, [N, H, W, C] float32 in [0, 1].
        sigma: The noise level at which they were found, full scale 1.
        steps: How many steps were made.
    """

    views: F32
    sigma: float
    steps: int


class _Watch:
    """Keeps the best views, and says when a round has gained too little."""

    def __init__(self, jury: Jury) -> None:
        self._jury = jury
        self._left: list[float] = []
        self.steps = 0
        self.best: tuple[float, int, F32] | None = None

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
        if self.best is None or left < self.best[0]:
            self.best = left, self.steps, views
        looks = _ROUND // _LOOK_EVERY
        return len(self._left) > looks and left > (1 - LEAST_GAIN) * self._left[-1 - looks]


def decode_until_settled(jury: Jury, start: F32, settings: PatchSettings, progress: Progress | None = None) -> Settled:
    """Decode a measurement without its held-out pixels, for as long as these gain.

    Args:
        jury: The measurement, and its held-out pixels. Without any the schedule is gone through to its end.
        start: Views to begin with, [N, H, W, C] float32.
        settings: The whole schedule.
        progress: Hears of each iteration and its relative residual.

    Raises:
        InputError: The settings make no sense.
    """
    watch = _Watch(jury)
    last = patch_decode_from(jury.seen, start, settings, progress, watch)
    if watch.best is None:
        return Settled(last, settings.last_sigma, watch.steps)
    _, step, views = watch.best
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
