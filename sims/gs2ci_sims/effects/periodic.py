"""Light that oscillates periodically, integrated over slices of time: the base of flicker of lamps and of panels."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np
from pydantic import Field

from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import Slices

# Pieces per period, so that an oscillation is followed within a mask; for oscillations much faster than the masks only
# the mean over each piece matters, and that is exact.
PIECES_PER_PERIOD: Final = 12
PIECES_MAX: Final = 96


@dataclass(frozen=True)
class Oscillation(EffectRecord):
    """Light that oscillates about its mean by the share `depth`, 0 to 1."""

    stage: ClassVar[LightStage] = LightStage.TIME
    cost_ns: ClassVar[float] = 0.2

    depth: Annotated[float, Field(ge=0, le=1)]

    @abstractmethod
    def frequency(self) -> tuple[BoundStep, ...]:
        """Return how the frequency of the light follows from the parameters, the frequency itself as the last step."""

    @abstractmethod
    def phase(self, rig: RigFigures, rng: np.random.Generator) -> float:
        """Return the phase in the middle of the exposure, radians."""

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The oscillation left in an interval's mean, depth |sin x / x|, at the worst phase; the rest moves in time."""
        *before, light = self.frequency()
        steps = (*before, *swing_left(self.depth, light, rig.timing.interval_s))
        masks = len(scene.masks)
        kept, swing = np.full(masks, steps[-1].value), np.full(masks, self.depth)
        return scene.of_shares(self, kept, swing, self.depth).after(*steps)

    def brightest(self, scene: ViewPreview) -> float:
        """The maximum of the oscillation."""
        return 1 + self.depth

    def modulation(self, scene: ViewPreview) -> float:
        """The oscillation's depth."""
        return self.depth

    def apply(self, signal: Slices, rig: RigFigures, rng: np.random.Generator) -> Slices:
        """Modulate the light of the slices."""
        return swinging(signal, self.depth, self.frequency()[-1].value, self.phase(rig, rng))


def swinging(slices: Slices, depth: float, hertz: float, phase: float) -> Slices:
    """Return the slices under a light of 1 + depth cos(2 pi hertz t + phase), cut finely enough to follow it."""
    longest = float(slices.duration_s.max(initial=0.0))
    parts = int(np.clip(np.ceil(longest * hertz * PIECES_PER_PERIOD), 1, PIECES_MAX))
    pieces = slices.split(parts)
    middle = 0.5 * (pieces.start_s + pieces.stop_s)
    mean = np.cos(2 * np.pi * hertz * middle + phase) * np.sinc(hertz * pieces.duration_s)
    return pieces.scaled(1 + depth * mean)


def swing_left(depth: float, frequency: BoundStep, interval_s: float) -> tuple[BoundStep, ...]:
    """Return how far the mean over an interval can be from 1, depth |sin x / x|, x = pi f interval, as the last step.

    Args:
        depth: Depth of the oscillation.
        frequency: The step that gives f, Hz.
        interval_s: The interval over which the light is averaged.
    """
    left = float(depth * np.abs(np.sinc(frequency.value * interval_s)))
    return (
        BoundStep("depth", depth, "", "swing of the light about its mean"),
        frequency,
        BoundStep("T", interval_s, "s", "time on show of each mask"),
        BoundStep(
            "c",
            left,
            "",
            "swing that an interval's mean keeps; sinc(x) = sin(pi x) / (pi x)",
            "depth * abs(sinc(f * T))",
        ),
    )
