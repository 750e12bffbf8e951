"""Bayer filter: every pixel sees one of three colours."""

from dataclasses import dataclass

import numpy as np

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.records import CfaPattern
from gs2ci_sims.effects.base import UNAVOIDABLE, Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class BayerFilter(EffectRecord):
    """Keep of each pixel's light the colour that its filter passes, [H, W, 3] -> [H, W, 1].

    Bayer, US patent 3 971 065 (1976). Light of the other colours never becomes charge, so the filter is the
    first to act on it.

    Args:
        pattern: Colours of the upper left two by two pixels, row by row.
    """

    stage = LightStage.CHARGE
    cost_ns = 5.0

    pattern: CfaPattern = "RGGB"

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Infinite: it decides what is recorded, one colour per pixel or three."""
        return UNAVOIDABLE.by("inf", BoundStep("c", 1.0, "", "colours that a pixel records, of three"))

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Select from electrons [H, W, 3]."""
        tile = np.array(["RGB".index(colour) for colour in self.pattern]).reshape(2, 2)
        rows, columns = np.indices(signal.shape[:2])
        return np.take_along_axis(signal, tile[rows % 2, columns % 2][..., None], axis=2)
