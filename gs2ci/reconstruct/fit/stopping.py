"""When a fit ends: the pixels of the measurement that the loss never sees, and what they say.

Here: which pixels are held out, and the watch that follows their residual. Not here: the loop (`coarse.py`).
For `gs2ci.reconstruct`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.records import F32


@dataclass(frozen=True)
class HoldOut:
    """How much of the measurement is held out, and how long the fit waits for it.

    Args:
        share: Share of the coded pixels that the loss never sees.
        window: Iterations whose held-out residuals are averaged before they are compared.
        patience: Iterations without improvement after which the fit anneals, and then ends.
        growth_patience: Iterations without improvement after which the population no longer grows: more Gaussians
            would only fit what the loss sees.
        improvement: Relative decrease that counts as one.
    """

    share: float = 0.02
    window: int = 25
    patience: int = 150
    growth_patience: int = 50
    improvement: float = 1e-3


def choose_heldout(masks: F32, saturated: NDArray[np.bool_] | None, share: float, seed: int) -> NDArray[np.bool_]:
    """Choose the pixels to hold out, [H, W] bool.

    Only pixels that some mask opens and that are not saturated can judge a prediction; of these a share is drawn, at
    least one and never more than half. The generator is the seed's own, apart from every other draw.
    """
    useful = masks.any(axis=0)
    if saturated is not None:
        useful &= ~saturated
    candidates = np.flatnonzero(useful)
    heldout = np.zeros(masks.shape[1:], bool)
    if len(candidates) < 2 or share <= 0:
        return heldout
    count = min(max(1, round(share * len(candidates))), len(candidates) // 2)
    chosen = np.random.default_rng([seed, 0x4E1D]).choice(candidates, count, replace=False)
    heldout.reshape(-1)[chosen] = True
    return heldout


class HeldOutWatch:
    """Follows the held-out residual and tells when a new best is reached and when it stopped improving."""

    def __init__(self, settings: HoldOut) -> None:
        self._settings = settings
        self._recent: list[float] = []
        self.latest = float("inf")
        self.best = float("inf")
        self.best_iteration = 0
        self._reference = float("inf")
        self._reference_iteration = 0

    def note(self, residual: float, iteration: int) -> bool:
        """Take one iteration's residual; return True when a window closes on a new best."""
        self._recent.append(residual)
        if len(self._recent) < self._settings.window:
            return False
        self.latest = float(np.mean(self._recent))
        self._recent.clear()
        if self.latest < self._reference * (1 - self._settings.improvement):
            self._reference, self._reference_iteration = self.latest, iteration
        if self.latest < self.best:
            self.best, self.best_iteration = self.latest, iteration
            return True
        return False

    def may_grow(self, iteration: int) -> bool:
        """Tell whether the residual has improved lately, so that more Gaussians are worth having."""
        return iteration - self._reference_iteration <= self._settings.growth_patience

    def stalled(self, iteration: int) -> bool:
        """Tell whether nothing has improved for as long as patience lasts."""
        return iteration - self._reference_iteration >= self._settings.patience

    def restart_patience(self, iteration: int) -> None:
        """Count patience from here, as when annealing begins."""
        self._reference_iteration = iteration
