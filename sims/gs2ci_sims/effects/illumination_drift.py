"""Illumination drift: a lamp that becomes brighter or darker during the exposure."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import FiniteFloat

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import Slices


@dataclass(frozen=True)
class IlluminationDrift(EffectRecord):
    """Multiply the light by 1 + rate t, with t = 0 in the middle of the exposure; never below 0.

    Args:
        rate_per_s: Relative change per second.
    """

    stage: ClassVar[LightStage] = LightStage.TIME
    cost_ns: ClassVar[float] = 0.1

    rate_per_s: FiniteFloat

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Each mask's light changes by the mean of the drift; if the drift changes sign, by the mean magnitude."""
        parts = np.linspace(0, 1, 65)
        times_s = scene.intervals_s[:, :1] + np.diff(scene.intervals_s, axis=1) * parts
        change = self._factor(times_s) - 1
        return scene.of_shares(self, change.mean(axis=1), np.abs(change).mean(axis=1), self.modulation(scene)).after(
            BoundStep("r", self.rate_per_s, "1/s", "relative change of the light"),
            BoundStep("t", rig.exposure_s, "s", "exposure"),
            BoundStep(
                "c", float(np.abs(change.mean(axis=1)).max()), "", "largest share that a mask's light changes by"
            ),
        )

    def brightest(self, scene: ViewPreview) -> float:
        """The drift at the end of the exposure."""
        return float(self._factor(scene.intervals_s).max())

    def modulation(self, scene: ViewPreview) -> float:
        """The drift at either end of the exposure."""
        return float(np.abs(self._factor(scene.intervals_s) - 1).max())

    def apply(self, signal: Slices, rig: RigFigures, rng: np.random.Generator) -> Slices:
        """Scale each slice by the drift at its middle, cut in four to follow it."""
        pieces = signal.split(4)
        return pieces.scaled(self._factor(0.5 * (pieces.start_s + pieces.stop_s)))

    def _factor(self, times_s: F64) -> F64:
        return np.maximum(1 + self.rate_per_s * times_s, 0.0)
