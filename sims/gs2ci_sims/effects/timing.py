"""Effects on when light is collected.

- Trigger timing: the exposure begins after a latency, with jitter.
- Clock drift: the clocks of modulator and sensor run at different rates.
- Rolling shutter: rows begin and end their exposure one after the other.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Final

import numpy as np
from pydantic import Field, FiniteFloat

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import Shutter, Slices

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

    stage = LightStage.TIME
    cost_ns = 0.1

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

    def apply(self, signal: Slices, rig: RigFigures, rng: Rng) -> Slices:
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


@dataclass(frozen=True)
class ClockDrift(EffectRecord):
    """Stretch the masks' schedule from the first mask on; the sensor closes by its own clock.

    Args:
        ppm: By how many parts per million the modulator's clock is slow, above -1e6 (crystals: 20 to 100).
    """

    stage = LightStage.TIME
    cost_ns = 0.1

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

    def apply(self, signal: Slices, rig: RigFigures, rng: Rng) -> Slices:
        """Stretch the slices and close the window; a rolling shutter closes every row by itself."""
        begin, stretch = -0.5 * rig.exposure_s, 1 + 1e-6 * self.ppm
        later = replace(
            signal,
            start_s=begin + (signal.start_s - begin) * stretch,
            stop_s=begin + (signal.stop_s - begin) * stretch,
            since_s=begin + (signal.since_s - begin) * stretch,
        )
        return later if signal.shutter is not None else within_window(later, -np.inf, 0.5 * rig.exposure_s)


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

    stage = LightStage.TIME
    cost_ns = 10.0

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

    def apply(self, signal: Slices, rig: RigFigures, rng: Rng) -> Slices:
        """Add the shutter to the slices; row 0 is not affected.

        It comes first among the effects on time: those that move the sensor's window move this shutter.
        """
        shutter = Shutter(float(signal.start_s.min()), float(signal.stop_s.max()), self.line_delay_s)
        return replace(signal.split(PARTS), shutter=shutter)
