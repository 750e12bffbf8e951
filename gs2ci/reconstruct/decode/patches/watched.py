"""A decode by similar patches that ends when the residual at held-out pixels no longer decreases.

The best length of a decode differs: most clips improve down to the lowest noise level, but a picture full of texture
starts to lose detail half way.

Here: the watch, and the decode under it. Not here: the schedule and the steps (`decoder`).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, patch_decode_from
from gs2ci.reconstruct.decode.planes import interleaved
from gs2ci.reconstruct.measurement.holdout import Holdout

# A lattice has at most four phases: after so many steps every position has been the reference of a group.
_LOOK_EVERY: Final = 4
# Groups are searched for again after three uses of each phase, so that the residual decreases in steps.
_ROUND: Final = 12
# A hurried decode continues as long as a round reduces the residual by at least this share.
LEAST_GAIN: Final = 0.02
# A few hundred pixels do not distinguish residuals that differ by less. On a piece of a clip (traffic) the held-out
# residual was smallest at step 32 of 96, and 3 % larger at step 72, whose views were 1.2 dB better; at step 96 it was
# 18 % larger, and the views were 1.4 dB worse again.
_ALIKE: Final = 0.05


@dataclass(frozen=True)
class Settled:
    """The result of a decode.

    Args:
        views: The latest with about the smallest held-out residual, [N, H, W, C] float32 in [0, 1].
        sigma: The noise level of their step, full scale 1.
        steps: How many steps were made.
    """

    views: F32
    sigma: float
    steps: int


class _Watch:
    """Keeps the latest views that are about the best, and decides when to stop.

    Args:
        holdout: The measurement, and its held-out pixels.
        least_gain: The share by which a round has to reduce the residual; None: it only must not be worse throughout.
    """

    def __init__(self, holdout: Holdout, least_gain: float | None) -> None:
        self._holdout, self._least_gain = holdout, least_gain
        self._left: list[float] = []
        self.steps = 0
        self.best: tuple[int, F32] | None = None

    def __call__(self, planes: F32) -> bool:
        """Judge the views, [N, C, H, W], of a step; tell whether it was the last."""
        self.steps += 1
        if self.steps % _LOOK_EVERY:
            return False
        views = np.clip(interleaved(planes), 0, 1)
        left = self._holdout.residual_rms(views)
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
    holdout: Holdout,
    start: F32,
    settings: PatchSettings,
    progress: Progress | None = None,
    least_gain: float | None = LEAST_GAIN,
) -> Settled:
    """Decode a measurement without its held-out pixels, as long as the residual at these decreases.

    Args:
        holdout: The measurement, and its held-out pixels. Without any, the whole schedule is run.
        start: The first views, [N, H, W, C] float32.
        settings: The whole schedule.
        progress: Receives each iteration and its relative residual.
        least_gain: The decode ends if a round of twelve steps reduces the residual by less than this share; None: it
            ends only if all steps of a round were clearly worse.

    Raises:
        InputError: The settings make no sense.
    """
    watch = _Watch(holdout, least_gain)
    last = patch_decode_from(holdout.seen, start, settings, progress, watch)
    if watch.best is None:
        return Settled(last, settings.last_sigma, watch.steps)
    step, views = watch.best
    return Settled(views, settings.sigmas[step - 1], watch.steps)


def seen_to_the_end(holdout: Holdout, blind: F32, sigma: float) -> F32:
    """Continue a decode with all pixels, by a few last steps at the noise level at which it ended.

    On crops of two clips eight steps were within 0.03 dB of a decode of all pixels, at a twelfth of its cost.

    Args:
        holdout: The measurement.
        blind: Views decoded without the held-out pixels, [N, H, W, C].
        sigma: That level, full scale 1.
    """
    return patch_decode_from(
        holdout.shot, blind, replace(PatchSettings.to_the_end(), first_sigma=sigma, last_sigma=sigma)
    )
