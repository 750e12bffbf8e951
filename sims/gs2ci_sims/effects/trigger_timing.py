"""Trigger timing: the exposure begins after a latency, with jitter."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from pydantic import FiniteFloat

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import Slices

# Jitter is taken to stay within so many standard deviations: one exposure in 370 does not.
JITTER_SIGMAS: Final = 3.0


@dataclass(frozen=True)
class TriggerTiming(EffectRecord):
    """Shift the sensor's window against the masks by a latency and a drawn jitter; its length stays.

    What the window misses of the first mask is lost; after the last mask the modulator is dark.

    Args:
        latency_s: Mean; negative if the sensor opens before the first mask.
        jitter_s: Standard deviation of the normal jitter, at least 0; a draw beyond three of them is cut to that.
    """

    stage: ClassVar[LightStage] = LightStage.TIME
    cost_ns: ClassVar[float] = 0.1

    latency_s: FiniteFloat = 0.0
    jitter_s: NotNegative = 0.0

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """What the latest, and the earliest, window cuts off of the masks."""
        losses = list(self._missed_shares(scene, rig))
        bounds = [scene.of_shares(self, lost, lost, 1.0) for lost in losses]
        worst = max(range(2), key=lambda window: bounds[window].rms_dn)
        bound = Bound(bounds[worst].rms_dn, max(b.peak_dn for b in bounds), steps=bounds[worst].steps)
        return bound.after(
            BoundStep("t", self.latency_s, "s", "latency"),
            BoundStep("j", self.jitter_s, "s", "jitter, standard deviation; three of them count"),
            BoundStep(
                "late",
                self.latency_s + (2 * worst - 1) * JITTER_SIGMAS * self.jitter_s,
                "s",
                "the worse of the earliest and the latest window",
                "t + 3 * j" if worst else "t - 3 * j",
            ),
            BoundStep("T", rig.timing.interval_s, "s", "time on show of each mask"),
            BoundStep("c", float(losses[worst].max()), "", "largest share of a mask's light that it misses"),
        )

    def modulation(self, scene: ViewPreview) -> float:
        """What the first or the last mask loses."""
        return max(float(lost.max()) for lost in self._missed_shares(scene, scene.rig))

    def _missed_shares(self, scene: ViewPreview, rig: RigFigures) -> Iterator[F64]:
        """Return which share of each mask's light the earliest window misses, and the latest, [N] each."""
        for sign in (-1, 1):
            late_s = self.latency_s + sign * JITTER_SIGMAS * self.jitter_s
            half = 0.5 * rig.exposure_s
            kept = np.clip(scene.intervals_s, late_s - half, late_s + half)
            yield 1 - (kept[:, 1] - kept[:, 0]) / rig.timing.interval_s

    def apply(self, signal: Slices, rig: RigFigures, rng: np.random.Generator) -> Slices:
        """Cut the slices to the window; behind a rolling shutter, shift the window of every row."""
        jitter = np.clip(rng.standard_normal(), -JITTER_SIGMAS, JITTER_SIGMAS)
        late_s = self.latency_s + self.jitter_s * float(jitter)
        if signal.shutter is not None:
            return replace(signal, shutter=signal.shutter.later(late_s))
        return within_window(signal, late_s - 0.5 * rig.exposure_s, late_s + 0.5 * rig.exposure_s)


def within_window(slices: Slices, opens_s: float, closes_s: float) -> Slices:
    """Return what of the slices lies between two times, with no light in the rest."""
    edges = np.broadcast_to(np.array([opens_s, closes_s]), (len(slices.start_s), 2))
    pieces = slices.split_at(edges)
    middle = 0.5 * (pieces.start_s + pieces.stop_s)
    return pieces.scaled(((middle > opens_s) & (middle < closes_s)).astype(np.float64))
