"""Masks as a laboratory's calibration measures them, made by effects of the light path."""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.masks import FiniteContrast, MaskEdges, Misregistration
from gs2ci_sims.masks import random_masks
from gs2ci_sims.rig import RigFigures

# Elements of two pixels, not quite on the pixel grid, blurred, and leaking. Leakage of 60:1 and what blur spills into
# closed elements make up the 25:1 that is measured in all.
LABORATORY: Final[tuple[Effect, ...]] = (
    MaskEdges(0.45),
    FiniteContrast(contrast=60.0),
    Misregistration(right_px=0.1, down_px=0.1),
)
LABORATORY_FEATURE_PX: Final = 2
# The calibration divides by a reference that blur has dimmed; what is brighter is clipped at 1.
LABORATORY_ON_LEVEL: Final = 0.85


def laboratory_masks(count: int, size: tuple[int, int], ratio: float, rng: np.random.Generator) -> F32:
    """Draw masks that look like calibrated ones of real systems, [N, H, W] in [0, 1], neither binary nor crisp.

    Made by effects of the light path, with figures that reproduce what was measured on two published sets of 660 x
    660 lithographic masks, 50 % open (the real data of TSA-Net and of SMEM): an off level of 0.04 (0.017 to 0.083
    from the 10th to the 90th percentile), 36 to 40 % of all pixels between 0.1 and 0.9, 26 to 33 % clipped at 1, and
    an autocorrelation of 0.61 to 0.65, 0.12 to 0.19 and 0.01 to 0.02 at lags of 1, 2 and 3 pixels.

    Raises:
        InputError: See `random_masks`.
    """
    masks = random_masks(count, size, ratio, rng, feature_px=LABORATORY_FEATURE_PX)
    rig = RigFigures()
    for effect in LABORATORY:
        masks = effect.apply(masks, rig, rng)
    return np.asarray(np.clip(masks / LABORATORY_ON_LEVEL, 0.0, 1.0), dtype=np.float32)
