"""How much noise of the readings a decode weighs: as much as leaves least of the held-out pixels.

A decode that weighs too much lacks detail, and one that weighs too little shows noise: either predicts readings that it
has not seen less well.

Here: this search. Not here: how GAP-TV weighs noise (`pnp`), where it starts (`fusion`, `exposures.repeats`).
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.measurement.holdout import Holdout

# The noise is sought downwards in steps of this factor of power.
_STEP: Final = 4.0
_STEPS: Final = 7


def decode_weighing(holdouts: Sequence[Holdout], settings: GapTvSettings, most: F32) -> tuple[F32, F32]:
    """Decode measurements of the same views without their held-out pixels, which tell the noise of the readings.

    Args:
        holdouts: The measurements, with held-out pixels.
        settings: Of the decoder.
        most: Power of the noise in each reading at most, [H, W, C].

    Returns:
        The views, [N, H, W, C], and the noise that was weighed, [H, W, C].
    """
    seen, best, found = [one.seen for one in holdouts], math.inf, None
    for step in range(_STEPS):
        noise = most * np.float32(_STEP**-step)
        views = gap_tv(seen, settings, noise=noise)
        left = float(np.mean([(one.residual_rms(views) or math.inf) ** 2 for one in holdouts]))
        if found is not None and left >= best:
            break
        best, found = left, (views, noise)
    assert found is not None
    return found
