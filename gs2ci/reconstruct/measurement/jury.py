"""The pixels of the measurement that no stage sees, and what they say of views.

Here: which pixels are held out, how views are judged by them, and when a difference is sure. Not here: what follows
from a judgement (`pipeline`, `fit/stopping.py`).
"""

import math
from typing import Final, Self

import numpy as np
import torch

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import MOST_OUTLIERS, Coding, beyond_white, without_pixels

_HELDOUT_STREAM: Final = 0x4E1D  # keeps this draw apart from every other one of the same seed
# Share of the eligible pixels that is held out by default: enough to judge by, too few to lose detail by.
HELDOUT_SHARE: Final = 0.02
# Of so many standard errors is what counts as sure.
SURE: Final = 2.0


def choose_heldout(shot: Shot, share: float, seed: int) -> Bool:
    """Choose the pixels to hold out, [H, W] bool.

    Only pixels that light reached through some mask and that are not saturated can judge a prediction. Nor do the few
    that read more than a white scene sends: a hot pixel or a lamp would outvote hundreds. (Where those are many, all
    judge alike.) Of the others a share is drawn, at least one and never more than half. With fewer than two of them,
    or a share of zero, none is held out.
    """
    useful = shot.lit
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

    def __init__(self, shot: Shot, heldout: Bool) -> None:
        self.shot = shot
        self.heldout = heldout
        self._coding = Coding.of(shot)

    @classmethod
    def of(cls, shot: Shot, share: float, seed: int) -> Self:
        """Hold out a share of a shot's pixels, drawn as `choose_heldout` says."""
        return cls(shot, choose_heldout(shot, share, seed))

    @property
    def seen(self) -> Shot:
        """Get the shot with every mask closed over the held-out pixels, so that no stage can see them."""
        if not self.heldout.any():
            return self.shot
        return without_pixels(self.shot, self.heldout)

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


def surely_larger(one: F64, other: F64) -> bool:
    """Tell whether the mean of the first exceeds that of the second by more than `SURE` standard errors.

    By squares, the mean of several predictions is never worse than they are on average; that one of them beats it on
    a few hundred pixels is often luck, and the luckiest was chosen.

    Args:
        one: Squared residuals, [K].
        other: Those of the same pixels, [K].
    """
    difference = one - other
    if len(difference) < 2:
        return False
    return bool(difference.mean() > SURE * difference.std(ddof=1) / math.sqrt(len(difference)))
