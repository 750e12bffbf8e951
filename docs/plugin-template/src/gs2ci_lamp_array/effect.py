"""An effect of the simulated light path: a corner of the image gets less light. Its laws: `gs2ci_sims.effects.base`."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, EffectRecord, LightStage, Previewed
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import View


@dataclass(frozen=True)
class DimCorner(EffectRecord):
    """Take a share of the light from the upper left quarter of the image.

    Args:
        share: From 0 to 1.
    """

    stage: ClassVar[LightStage] = LightStage.RADIANCE
    cost_ns: ClassVar[float] = 10.0

    share: Annotated[float, Field(ge=0, le=1)] = 0.2

    def lost(self, size: tuple[int, int], margin: int = 0) -> F64:
        """Return the share that each pixel loses, [H, W]."""
        lost = np.zeros(size)
        rows, columns = (margin + (side - 2 * margin) // 2 for side in size)
        lost[:rows, :columns] = self.share
        return lost

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Return what leaving it out would change, at most."""
        return scene.of_masks(self, self.lost(scene.scene.size) * scene.most_open)

    def apply(self, signal: View, rig: RigFigures, rng: np.random.Generator) -> View:
        """Darken the corner."""
        height, width = signal.radiance.shape[:2]
        kept = 1 - self.lost((height, width), signal.margin)
        return View(signal.radiance * kept[..., None], signal.intrinsics, signal.margin, signal.depth)
