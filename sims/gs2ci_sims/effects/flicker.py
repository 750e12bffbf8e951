"""Effects on how bright the light is over time.

- Illumination flicker: the light of lamps on the mains oscillates at twice its frequency.
- LCoS flicker: pulse-coded drive makes a panel's reflectance ripple.
- Illumination drift: a lamp that becomes brighter or darker during the exposure.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from pydantic import Field, FiniteFloat

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.config import Positive
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

    stage = LightStage.TIME
    cost_ns = 0.2

    depth: Annotated[float, Field(ge=0, le=1)]

    @abstractmethod
    def frequency(self) -> tuple[BoundStep, ...]:
        """Return how the frequency of the light follows from the parameters, the frequency itself as the last step."""

    @abstractmethod
    def phase(self, rig: RigFigures, rng: Rng) -> float:
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

    def apply(self, signal: Slices, rig: RigFigures, rng: Rng) -> Slices:
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


@dataclass(frozen=True)
class IlluminationFlicker(Oscillation):
    """Multiply the light by 1 + depth cos(2 pi 2 mains t + phase); the phase is random: nothing is locked to the mains.

    `depth` is percent flicker / 100, (max - min) / (max + min) (IEEE 1789-2015, section 3).

    Args:
        depth: 0 to 1.
        mains_hz: Frequency of the supply; light oscillates at twice that.
    """

    mains_hz: Positive = 50.0

    def frequency(self) -> tuple[BoundStep, ...]:
        """Return the mains' frequency and the light's."""
        mains = BoundStep("mains", self.mains_hz, "Hz", "frequency of the mains")
        return mains, BoundStep("f", 2 * self.mains_hz, "Hz", "frequency of the light", "2 * mains")

    def phase(self, rig: RigFigures, rng: Rng) -> float:
        """Draw the phase."""
        return float(rng.uniform(0, 2 * np.pi))


@dataclass(frozen=True)
class LcosFlicker(Oscillation):
    """Multiply all transmissions by 1 + depth cos(2 pi drive t), synchronous with the masks: they share a clock.

    The molecules follow the pulses of a digital drive (Hermerschmidt et al., Proc. SPIE 7723 (2010), on phase
    flicker); behind a polariser that is a ripple of the transmission.

    Args:
        depth: 0 to 1.
        drive_hz: Frequency of the pulse sequence.
    """

    drive_hz: Positive = 300.0

    def frequency(self) -> tuple[BoundStep, ...]:
        """Return the drive's frequency."""
        return (BoundStep("f", self.drive_hz, "Hz", "frequency of the drive"),)

    def phase(self, rig: RigFigures, rng: Rng) -> float:
        """Return the phase, which is 0 when the first mask is switched on."""
        begin = -0.5 * rig.exposure_s
        return -2 * np.pi * self.drive_hz * begin


@dataclass(frozen=True)
class IlluminationDrift(EffectRecord):
    """Multiply the light by 1 + rate t, with t = 0 in the middle of the exposure; never below 0.

    Args:
        rate_per_s: Relative change per second.
    """

    stage = LightStage.TIME
    cost_ns = 0.1

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

    def apply(self, signal: Slices, rig: RigFigures, rng: Rng) -> Slices:
        """Scale each slice by the drift at its middle, cut in four to follow it."""
        pieces = signal.split(4)
        return pieces.scaled(self._factor(0.5 * (pieces.start_s + pieces.stop_s)))

    def _factor(self, times_s: F64) -> F64:
        return np.maximum(1 + self.rate_per_s * times_s, 0.0)
