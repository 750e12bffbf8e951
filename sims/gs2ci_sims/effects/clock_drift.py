"""Clock drift: the clocks of modulator and sensor run at different rates."""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, FiniteFloat

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.effects.trigger_timing import within_window
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import Slices


@dataclass(frozen=True)
class ClockDrift(EffectRecord):
    """Stretch the masks' schedule from the first mask on; the sensor closes by its own clock.

    Args:
        ppm: By how many parts per million the modulator's clock is slow, above -1e6 (crystals: 20 to 100).
    """

    stage: ClassVar[LightStage] = LightStage.TIME
    cost_ns: ClassVar[float] = 0.1

    ppm: Annotated[FiniteFloat, Field(gt=-1e6)]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Each mask's weight changes by the stretch, the last one's by the part cut off, and its light comes later.

        The time removed from its own interval and the time added after it are together at most twice the delay.
        """
        change, swing, taken_s = self._changes(scene, rig)
        return scene.of_shares(self, change, swing, 1.0, taken_s).after(
            BoundStep("ppm", self.ppm, "1e-6", "slowness of the modulator's clock"),
            BoundStep("t", rig.exposure_s, "s", "exposure"),
            BoundStep("late", 1e-6 * self.ppm * rig.exposure_s, "s", "lateness at the end", "1e-6 * ppm * t"),
            BoundStep("T", rig.timing.interval_s, "s", "time on show of each mask"),
            BoundStep("c", float(np.abs(change).max()), "", "largest share that a mask's light changes by"),
            BoundStep("w", float(swing.max()), "", "largest share that comes at another time"),
        )

    def modulation(self, scene: ViewPreview) -> float:
        """The share of the last mask's light that changes, or moves in time."""
        return float(self._changes(scene, scene.rig)[1].max())

    def _changes(self, scene: ViewPreview, rig: RigFigures) -> tuple[F64, F64, F64]:
        """Return the change of each mask's light, its magnitude in time [N], and the interval of the change [N, 2]."""
        stretch = 1e-6 * self.ppm
        begin = scene.intervals_s[0, 0]
        stretched = begin + (scene.intervals_s - begin) * (1 + stretch)
        kept = np.minimum(stretched, scene.intervals_s[-1, 1])
        share = kept / rig.timing.interval_s
        own = scene.intervals_s / rig.timing.interval_s
        change = share[:, 1] - share[:, 0] - 1
        swing = np.minimum(np.abs(share - own).sum(axis=1), share[:, 1] - share[:, 0] + 1)
        both = np.stack([np.minimum(kept, scene.intervals_s)[:, 0], np.maximum(kept, scene.intervals_s)[:, 1]], axis=1)
        return change, swing, both

    def brightest(self, scene: ViewPreview) -> float:
        """The stretch."""
        return 1 + 1e-6 * self.ppm

    def apply(self, signal: Slices, rig: RigFigures, rng: np.random.Generator) -> Slices:
        """Stretch the slices and close the window; a rolling shutter closes every row by itself."""
        begin, stretch = -0.5 * rig.exposure_s, 1 + 1e-6 * self.ppm
        later = replace(
            signal,
            start_s=begin + (signal.start_s - begin) * stretch,
            stop_s=begin + (signal.stop_s - begin) * stretch,
            since_s=begin + (signal.since_s - begin) * stretch,
        )
        return later if signal.shutter is not None else within_window(later, -np.inf, 0.5 * rig.exposure_s)
