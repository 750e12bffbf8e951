"""Effects of modulators that do not switch at once.

- Mirror transition: mirrors need time to flip, so each mask begins as a mixture with the previous one.
- LCoS response: liquid crystals turn slowly, so each mask approaches its transmission exponentially.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.config import NotNegative
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import NOTHING, Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import Slices


@dataclass(frozen=True)
class MirrorTransition(EffectRecord):
    """Let the mask's transmission pass linearly from the old state to the new after each switch.

    Before the first mask, and after a dark gap, the old state is dark. A DMD's crossover takes about 3 us and its
    settling about 10 us (TI DLPA027 and the DLP6500 data sheet).

    Args:
        transition_s: How long it takes, 0 or more, at most an interval.
    """

    stage = LightStage.TIME
    cost_ns = 0.1

    transition_s: NotNegative = 13e-6

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Half of the transition's share of the interval belongs to the previous mask."""
        share = 0.5 * self._share(rig)
        apart = _masks_before(scene.shown, rig) - scene.shown
        return scene.of_masks(self, share * apart, apart).after(
            BoundStep("t", self.transition_s, "s", "transition of the mirrors"),
            BoundStep("T", rig.timing.interval_s, "s", "time on show of each mask"),
            BoundStep("c", share, "", "share of a mask's light that goes through the mask before", "t / (2 * T)"),
        )

    def modulation(self, scene: ViewPreview) -> float:
        """The share that belongs to the previous mask, and as much that comes from the next one."""
        return self._share(scene.rig)

    def apply(self, signal: Slices, rig: RigFigures, rng: Rng) -> Slices:
        """Mix the previous mask into the start of each mask's time."""
        if self._share(rig) == 0:
            return signal
        pieces = signal.split_at((signal.since_s + self.transition_s)[:, None])
        middle = 0.5 * (pieces.start_s + pieces.stop_s) - pieces.since_s
        new = np.clip(middle / self.transition_s, 0.0, 1.0)[:, None]
        old = np.zeros_like(pieces.mix)
        if rig.timing.dark_s == 0:
            after_first = np.flatnonzero(pieces.shown > 0)
            level = pieces.mix[after_first].sum(axis=1)
            old[after_first, pieces.shown[after_first] - 1] = level
        return replace(pieces, mix=new * pieces.mix + (1 - new) * old)

    def _share(self, rig: RigFigures) -> float:
        share = self.transition_s / rig.timing.interval_s
        if share > 1:
            raise InputError(
                f"mirrors that take {self.transition_s} s to flip, under masks of {rig.timing.interval_s} s",
                allowed=f"at most {rig.timing.interval_s} s",
                remedy="show each mask for longer",
            )
        return share


def _masks_before(masks: NDArray[np.floating], rig: RigFigures) -> F64:
    """Return the state that each mask replaces, [N, H, W]."""
    before = np.zeros(masks.shape)
    if rig.timing.dark_s == 0:
        before[1:] = masks[:-1]
    return before


# Where slices are cut, in time constants: the weight of the old mask falls by at most a quarter from cut to cut.
CUTS: Final = np.array([0.0625, 0.125, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0])


@dataclass(frozen=True)
class LcosResponse(EffectRecord):
    """Let the transmission relax from the old state to the new with a time constant.

    First-order relaxation of the director (Yeh and Gu, Optics of Liquid Crystal Displays, section 5.3), the same for
    both directions; before the first mask the modulator is dark. The rest of older masks persists, also in dark gaps.

    Args:
        tau_s: Time constant, 0 or more; display panels have 1 to 10 ms.
    """

    stage = LightStage.TIME
    cost_ns = 0.2

    tau_s: NotNegative

    def states(self, masks: int, rig: RigFigures) -> F64:
        """Return the modulator's state at the switch to each mask, as shares of all masks, [N, N]."""
        on = -np.expm1(-rig.timing.interval_s / self.tau_s)
        off = float(np.exp(-rig.timing.dark_s / self.tau_s))
        states = np.zeros((masks, masks))
        for n in range(1, masks):
            states[n] = states[n - 1] * (1 - on)
            states[n, n - 1] += on
            states[n] *= off
        return states

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The old state's mean weight over an interval, tau/T (1 - exp(-T/tau)), times its difference from the mask."""
        if self.tau_s == 0:
            return NOTHING.by("0")
        weight = self._weight(rig)
        old = np.tensordot(self.states(len(scene.masks), rig), scene.shown, axes=1)
        apart = old - scene.shown
        return scene.of_masks(self, weight * apart, apart).after(
            BoundStep("tau", self.tau_s, "s", "time constant"),
            BoundStep("T", rig.timing.interval_s, "s", "time on show of each mask"),
            BoundStep("c", weight, "", "mean weight of the older masks", "min(1, tau / T * (1 - exp(-T / tau)))"),
        )

    def modulation(self, scene: ViewPreview) -> float:
        """The share that belongs to older masks, and as much that comes from the next one."""
        return 2 * self._weight(scene.rig) if self.tau_s > 0 else 0.0

    def _weight(self, rig: RigFigures) -> float:
        """Return the mean weight of the old state over an interval."""
        ratio = self.tau_s / rig.timing.interval_s
        return min(1.0, float(-np.expm1(-1 / ratio) * ratio))

    def apply(self, signal: Slices, rig: RigFigures, rng: Rng) -> Slices:
        """Mix the rest of older masks into each mask's time."""
        if self.tau_s == 0:
            return signal
        pieces = signal.split_at(signal.since_s[:, None] + self.tau_s * CUTS)
        begin = (pieces.start_s - pieces.since_s) / self.tau_s
        length = np.maximum(pieces.duration_s / self.tau_s, 1e-300)
        # The mean of exp(-t / tau) over the piece.
        old = (np.exp(-begin) * -np.expm1(-length) / length)[:, None]
        states = self.states(signal.mix.shape[1], rig)[pieces.shown]
        level = pieces.mix.sum(axis=1, keepdims=True)
        return replace(pieces, mix=(1 - old) * pieces.mix + old * states * level)
