"""Illumination flicker: the light of lamps on the mains oscillates at twice its frequency."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from gs2ci.core.config import Positive
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, Previewed, Stage, ViewPreview
from gs2ci_sims.effects.periodic import swing_left, swinging
from gs2ci_sims.rig import Rig
from gs2ci_sims.signals import Slices


@dataclass(frozen=True)
class IlluminationFlicker(EffectRecord):
    """Multiply the light by 1 + depth cos(2 pi 2 mains t + phase); the phase is random: nothing is locked to the mains.

    `depth` is percent flicker / 100, (max - min) / (max + min) (IEEE 1789-2015, section 3).

    Args:
        depth: 0 to 1.
        mains_hz: Frequency of the supply; light oscillates at twice that.
    """

    stage: ClassVar[Stage] = Stage.TIME
    cost_ns: ClassVar[float] = 0.2

    depth: Annotated[float, Field(ge=0, le=1)]
    mains_hz: Positive = 50.0

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """The oscillation left in an interval's mean, depth |sin x / x|, at the worst phase; the rest moves in time."""
        mains = BoundStep("mains", self.mains_hz, "Hz", "frequency of the mains")
        light = BoundStep("f", 2 * self.mains_hz, "Hz", "frequency of the light", "2 * mains")
        steps = mains, *swing_left(self.depth, light, rig.timing.interval_s)
        masks = len(scene.masks)
        kept, swing = np.full(masks, steps[-1].value), np.full(masks, self.depth)
        return scene.of_shares(self, kept, swing, self.depth).after(*steps)

    def brightest(self, scene: ViewPreview) -> float:
        """The maximum of the oscillation."""
        return 1 + self.depth

    def modulation(self, scene: ViewPreview) -> float:
        """The oscillation's depth."""
        return self.depth

    def apply(self, signal: Slices, rig: Rig, rng: np.random.Generator) -> Slices:
        """Modulate the light of the slices."""
        return swinging(signal, self.depth, 2 * self.mains_hz, float(rng.uniform(0, 2 * np.pi)))
