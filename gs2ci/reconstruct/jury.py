"""When a fit ends: the pixels of the measurement that no stage sees, and what they say of the views.

Here: which pixels are held out, how views are judged by them, and the watch that follows the judgements. Not here:
the loop (`coarse.py`). For `gs2ci.reconstruct`.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.records import F32, F64, Shot
from gs2ci.reconstruct.coding import MOST_OUTLIERS, Coding, beyond_white

_HELDOUT_STREAM: Final = 0x4E1D  # keeps this draw apart from every other one of the same seed


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

    share: float = 0.02
    look_every: int = 50
    patience: int = 150
    growth_patience: int = 50
    improvement: float = 1e-3

    def check(self) -> "HoldOut":
        """Return self if the numbers make sense.

        Raises:
            InputError: A share outside [0, 0.5], or a count below 1.
        """
        if not 0 <= self.share <= 0.5 or min(self.look_every, self.patience, self.growth_patience) < 1:
            raise InputError(f"hold-out settings {self}", allowed="a share in [0, 0.5] and counts of at least 1")
        return self


def choose_heldout(shot: Shot, share: float, seed: int) -> NDArray[np.bool_]:
    """Choose the pixels to hold out, [H, W] bool.

    Only pixels that light reached through some mask and that are not saturated can judge a prediction. Nor do the few
    that read more than a white scene sends: a hot pixel or a lamp would outvote hundreds. (Where those are many, all
    judge alike.) Of the others a share is drawn, at least one and never more than half. With fewer than two of them,
    or a share of zero, none is held out.
    """
    useful = shot.masks[shot.weights > 0].any(axis=0)
    if shot.saturated is not None:
        useful &= ~shot.saturated
    odd = beyond_white(shot) & useful
    if odd.sum() <= MOST_OUTLIERS * useful.sum():
        useful &= ~odd
    candidates = np.flatnonzero(useful)
    heldout = np.zeros(shot.size, bool)
    if len(candidates) < 2 or share <= 0:
        return heldout
    count = min(max(1, round(share * len(candidates))), len(candidates) // 2)
    chosen = np.random.default_rng([seed, _HELDOUT_STREAM]).choice(candidates, count, replace=False)
    heldout.reshape(-1)[chosen] = True
    return heldout


class Jury:
    """The held-out pixels, and how views are judged by them.

    Args:
        shot: The whole measurement.
        heldout: Its held-out pixels, [H, W] bool.
    """

    def __init__(self, shot: Shot, heldout: NDArray[np.bool_]) -> None:
        self.shot = shot
        self.heldout = heldout
        self._coding = Coding.of(shot)

    @property
    def seen(self) -> Shot:
        """Get the shot with every mask closed over the held-out pixels, so that no stage can see them."""
        if not self.heldout.any():
            return self.shot
        return replace(
            self.shot,
            masks=self.shot.masks * ~self.heldout,
            measurement=self.shot.measurement * ~self.heldout[..., None],
        )

    def coded(self, views: F32) -> F32:
        """Return the measurement, [H, W, C], that views [N, H, W, C] would give."""
        coded: F32 = self._coding.forward(torch.from_numpy(views)).numpy()
        return coded

    def residual_rms(self, views: F32) -> float | None:
        """Return the residual of views [N, H, W, C] on the held-out pixels, in the measurement's unit.

        None where no pixel was held out; infinite where the views are not finite.
        """
        if not self.heldout.any():
            return None
        rms = float(np.sqrt(np.mean(self.squared_residuals(views))))
        return rms if np.isfinite(rms) else float("inf")

    def squared_residuals(self, views: F32) -> F64:
        """Return the mean squared residual of views [N, H, W, C] at each held-out pixel, [K] float64."""
        residual = (self.coded(views) - self.shot.measurement)[self.heldout].astype(np.float64)
        squared: F64 = np.mean(residual**2, axis=1)
        return squared

    def grey_rms(self) -> float | None:
        """Return the residual that the best even grey (or colour) leaves on the held-out pixels; None without any.

        It is what a decoder reaches that knows how many masks are open at a pixel, and nothing else.
        """
        if not self.heldout.any():
            return None
        white = np.ones((self.shot.views, *self.shot.size, self.shot.channels), np.float32)
        light = self.coded(white)[self.heldout].astype(np.float64)
        measured = self.shot.measurement[self.heldout].astype(np.float64)
        level = (light * measured).sum(axis=0) / np.maximum((light * light).sum(axis=0), np.finfo(np.float64).tiny)
        return float(np.sqrt(np.mean((measured - level * light) ** 2)))


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

    def may_grow(self, iteration: int) -> bool:
        """Tell whether the residual has improved lately, so that more Gaussians are worth having."""
        return iteration - self._reference_iteration <= self._settings.growth_patience

    def stalled(self, iteration: int) -> bool:
        """Tell whether nothing has improved for as long as patience lasts."""
        return iteration - self._reference_iteration >= self._settings.patience
