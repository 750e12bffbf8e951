"""LCoS flicker: pulse-coded drive makes a panel's reflectance ripple."""

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
class LcosFlicker(EffectRecord):
    """Multiply all transmissions by 1 + depth cos(2 pi drive t), synchronous with the masks: they share a clock.

    The molecules follow the pulses of a digital drive (Hermerschmidt et al., Proc. SPIE 7723 (2010), on phase
    flicker); behind a polariser that is a ripple of the transmission.

    Args:
        depth: 0 to 1.
        drive_hz: Frequency of the pulse sequence.
    """

    stage: ClassVar[Stage] = Stage.TIME
    cost_ns: ClassVar[float] = 0.2

    depth: Annotated[float, Field(ge=0, le=1)]
    drive_hz: Positive = 300.0

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """The ripple left in an interval's mean, depth |sin x / x|; the rest moves in time."""
        drive = BoundStep("f", self.drive_hz, "Hz", "frequency of the drive")
        steps = swing_left(self.depth, drive, rig.timing.interval_s)
        masks = len(scene.masks)
        kept, swing = np.full(masks, steps[-1].value), np.full(masks, self.depth)
        return scene.of_shares(self, kept, swing, self.depth).after(*steps)

    def brightest(self, scene: ViewPreview) -> float:
        """The maximum of the ripple."""
        return 1 + self.depth

    def modulation(self, scene: ViewPreview) -> float:
        """The ripple's depth."""
        return self.depth

    def apply(self, signal: Slices, rig: Rig, rng: np.random.Generator) -> Slices:
        """Ripple the light of the slices; the phase is 0 when the first mask is switched on."""
        begin = -0.5 * rig.exposure_s
        return swinging(signal, self.depth, self.drive_hz, -2 * np.pi * self.drive_hz * begin)
