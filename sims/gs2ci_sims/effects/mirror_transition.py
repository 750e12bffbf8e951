"""Mirror transition: mirrors need time to flip, so each mask begins as a mixture with the previous one."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
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

    stage: ClassVar[LightStage] = LightStage.TIME
    cost_ns: ClassVar[float] = 0.1

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

    def apply(self, signal: Slices, rig: RigFigures, rng: np.random.Generator) -> Slices:
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
