"""Rolling shutter: rows begin and end their exposure one after the other."""

from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import Shutter, Slices

# A row that opens within a slice of time collects the slice's mean light times its share of the slice. So slices are
# cut into parts within which little moves; cutting them needs no further rendering.
PARTS: Final = 16


@dataclass(frozen=True)
class RollingShutter(EffectRecord):
    """Open and close row y by y line delays later than row 0, which has the nominal exposure.

    All rows expose for the same time; the modulator does not wait for them: rows that open late miss light of the
    first masks, and are still open in the dark after the last. For the timing see any data sheet of a CMOS sensor
    with electronic rolling shutter; Liang, Chang and Chen, IEEE Trans. Image Processing 17 (2008), section II.

    Args:
        line_delay_s: Delay from each row to the next, finite, at least 0.
    """

    stage: ClassVar[LightStage] = LightStage.TIME
    cost_ns: ClassVar[float] = 10.0

    line_delay_s: NotNegative

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The light of each mask that each row misses."""
        missed = self._missed(scene)
        return scene.of_masks(self, missed[..., None] * scene.shown, scene.shown).after(
            BoundStep("delay", self.line_delay_s, "s", "from each row to the next"),
            BoundStep("rows", float(scene.masks.shape[1]), "", "rows"),
            BoundStep(
                "late",
                self.line_delay_s * (scene.masks.shape[1] - 1),
                "s",
                "by what the last row is late",
                "delay * (rows - 1)",
            ),
            BoundStep("T", rig.timing.interval_s, "s", "time on show of each mask"),
            BoundStep("c", float(missed.max()), "", "largest share of a mask's light that a row misses"),
        )

    def modulation(self, scene: ViewPreview) -> float:
        """The share that the last row misses."""
        return float(self._missed(scene).max())

    def _missed(self, scene: ViewPreview) -> F64:
        """Return the share of each mask's light that each row misses, [N, H]."""
        start_s, stop_s = scene.intervals_s.T
        shutter = Shutter(float(start_s[0]), float(stop_s[-1]), self.line_delay_s)
        return 1 - shutter.open_share(start_s, stop_s, scene.masks.shape[1])

    def apply(self, signal: Slices, rig: RigFigures, rng: np.random.Generator) -> Slices:
        """Add the shutter to the slices; row 0 is not affected.

        It comes first among the effects on time: those that move the sensor's window move this shutter.
        """
        shutter = Shutter(float(signal.start_s.min()), float(signal.stop_s.max()), self.line_delay_s)
        return replace(signal.split(PARTS), shutter=shutter)
