"""When a fit ends: how long it waits for the held-out pixels, and the watch that follows what they say.

Here: the settings, the watch that follows what they say, and the rival that a fit has to keep up with. Not here: the
pixels and their judgement (`gs2ci.reconstruct.measurement.jury`), the loop (`coarse.py`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.measurement.jury import HELDOUT_SHARE


@dataclass(frozen=True)
class HoldOut:
    """How much of the measurement is held out, and how long the fit waits for it.

    Args:
        share: Share of the coded pixels that no stage sees.
        look_every: Iterations between looks at them.
        patience: Iterations without improvement after which the fit ends.
        growth_patience: Iterations without improvement after which the population no longer grows: more Gaussians
            would only fit what the loss sees.
        improvement: Relative decrease of the residual that counts as one.
    """

    share: float = HELDOUT_SHARE
    look_every: int = 50
    patience: int = 150
    growth_patience: int = 50
    improvement: float = 1e-3

    def looking(self, every: int) -> "HoldOut":
        """Return the settings with looks every so many iterations, and patience for as many looks as by default."""
        looks, growth_looks = HoldOut.patience // HoldOut.look_every, HoldOut.growth_patience // HoldOut.look_every
        return replace(self, look_every=every, patience=looks * every, growth_patience=growth_looks * every)

    def check(self) -> "HoldOut":
        """Return self if the numbers make sense.

        Raises:
            InputError: A share outside [0, 0.5], or a count below 1.
        """
        if not 0 <= self.share <= 0.5 or min(self.look_every, self.patience, self.growth_patience) < 1:
            raise InputError(f"hold-out settings {self}", allowed="a share in [0, 0.5] and counts of at least 1")
        return self


# What a fit of a quarter of the schedule leaves tells enough of what it will leave in the end: fits from rest left 1.38
# times what those along a path left on the real fan, and 1.4 times in the end; 0.99 and 0.99 times on two others, where
# they ended with 0.6 and 0.97 of it. Earlier the latter had left up to 1.2 times as much.
_FAIR_SHARE: Final = 0.25
_BEHIND: Final = 1.2


@dataclass(frozen=True)
class Rival:
    """Another fit of the same schedule to the same measurement, which a fit is not to fall far behind.

    Args:
        heldout: What it left of the held-out pixels, by the number of iterations.
        iterations: Of the schedule.
    """

    heldout: Mapping[int, float]
    iterations: int

    def is_out_of_reach(self, residual_rms: float | None, iteration: int) -> bool:
        """Tell whether a fit that leaves so much after so many iterations is worth going on with no more."""
        other = self.heldout.get(iteration)
        if residual_rms is None or other is None or iteration < _FAIR_SHARE * self.iterations:
            return False
        return residual_rms > _BEHIND * other


class Watch:
    """Follows the held-out residual: tells a new best, and when it has stopped improving."""

    def __init__(self, settings: HoldOut) -> None:
        self._settings = settings
        self._best = float("inf")
        self.best_iteration = 0
        self._reference = float("inf")
        self._reference_iteration = 0

    def note(self, residual_rms: float | None, iteration: int) -> bool:
        """Take a look's residual; return True if it is the best so far (always, where nothing is held out)."""
        if residual_rms is None:
            self.best_iteration = self._reference_iteration = iteration
            return True
        if residual_rms < self._reference * (1 - self._settings.improvement):
            self._reference, self._reference_iteration = residual_rms, iteration
        if residual_rms < self._best:
            self._best, self.best_iteration = residual_rms, iteration
            return True
        return False

    def set_back(self, iteration: int) -> None:
        """Expect the residual to rise now and to recover: improvement counts anew, the best state stays the best."""
        self._reference, self._reference_iteration = float("inf"), iteration

    def begin_again(self, iteration: int) -> None:
        """Forget all that was found: what comes now is what is wanted, be its residual larger."""
        self.set_back(iteration)
        self._best = float("inf")

    def may_grow(self, iteration: int) -> bool:
        """Tell whether the residual has improved lately, so that more Gaussians are worth having."""
        return iteration - self._reference_iteration <= self._settings.growth_patience

    def stalled(self, iteration: int) -> bool:
        """Tell whether nothing has improved for as long as patience lasts."""
        return iteration - self._reference_iteration >= self._settings.patience
