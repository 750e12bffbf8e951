"""The held-out pixels of the measurement, which no stage sees, and how they judge views.

Here: which pixels are held out, the residual of views at them, and when a difference is sure. Not here: what follows
from a judgement (`pipeline`, `fit/coarse/stopping.py`).
"""

import math
from collections.abc import Sequence
from typing import Final, Self

import numpy as np
import torch

from gs2ci.core.arrays import F32, F64, Bool, rms_of
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import (
    MOST_OUTLIERS,
    Coding,
    beyond_white,
    cfa_channels,
    without_pixels,
)

_HELDOUT_STREAM: Final = 0x4E1D  # makes this random draw independent of all others of the same seed
# Share of the eligible pixels held out by default: enough for a judgement, few enough to lose no detail.
HELDOUT_SHARE: Final = 0.02
# A difference of so many standard errors counts as sure.
SURE: Final = 2.0


def choose_heldout(shot: Shot, share: float, seed: int, averaged: Bool | None = None) -> Bool:
    """Choose the pixels to hold out, [H, W] bool.

    Args:
        shot: The measurement.
        share: Of the eligible pixels.
        seed: Of the draw.
        averaged: Pixels whose readings are averages over their neighbours, [H, W]: these predict each other, and are
            not eligible.

    Only pixels that got light through some mask and are not saturated can judge a prediction. The few that read more
    than a white scene sends are excluded too, since a hot pixel or a lamp would outweigh hundreds of others; if these
    are many, none is excluded. Of the eligible pixels a share is drawn, at least one and at most half. If there are
    fewer than two, or the share is zero, none is held out.
    """
    useful = shot.usable
    odd = beyond_white(shot) & useful
    if odd.sum() <= MOST_OUTLIERS * useful.sum():
        useful &= ~odd
    if averaged is not None:
        useful = useful & ~averaged
    candidates = np.flatnonzero(useful)
    heldout = np.zeros(shot.size, bool)
    if len(candidates) < 2 or share <= 0:
        return heldout
    count = min(max(1, round(share * len(candidates))), len(candidates) // 2)
    chosen = np.random.default_rng([seed, _HELDOUT_STREAM]).choice(candidates, count, replace=False)
    heldout.reshape(-1)[chosen] = True
    return heldout


class Holdout:
    """A measurement, its held-out pixels, and how views are judged by these.

    Args:
        shot: The whole measurement.
        pixels: Its held-out pixels, [H, W] bool.
        beside: Further measurements of the same views, which are decoded together with it; they do not judge it.

    `weighted` are the masks times their weights at these pixels, [N, K].
    """

    def __init__(self, shot: Shot, pixels: Bool, beside: "Sequence[Holdout]" = ()) -> None:
        self.shot = shot
        self.pixels = pixels
        self.beside = tuple(beside)
        self._flat = np.flatnonzero(pixels)
        whole = None if shot.cfa is None else cfa_channels(shot.cfa, shot.size)
        channels = None if whole is None else whole.reshape(-1)[self._flat][:, None]
        # As pictures of one column.
        self.weighted: F32 = shot.weights[:, None] * self.at_pixels(shot.masks)
        self._coding = Coding(torch.from_numpy(self.weighted[..., None]), channels)

    @classmethod
    def of(cls, shot: Shot, share: float, seed: int, averaged: Bool | None = None) -> Self:
        """Hold out a share of a shot's pixels, drawn as `choose_heldout` says."""
        return cls(shot, choose_heldout(shot, share, seed, averaged))

    @property
    def seen(self) -> Shot:
        """Get the shot with every mask closed over the held-out pixels, so that no stage can see them."""
        if not self.pixels.any():
            return self.shot
        return without_pixels(self.shot, self.pixels)

    @property
    def every_shot(self) -> tuple[Shot, ...]:
        """Get all measurements of these views, this one first."""
        return self.shot, *(one.shot for one in self.beside)

    @property
    def every_seen(self) -> tuple[Shot, ...]:
        """Get the same, each without its held-out pixels."""
        return self.seen, *(one.seen for one in self.beside)

    def coded(self, views: F32) -> F32:
        """Return the measurement, [H, W, C], that views [N, H, W, C] would give."""
        return Coding.of(self.shot).forward(torch.from_numpy(views)).numpy()

    def at_pixels(self, views: F32) -> F32:
        """Return the held-out pixels of views or masks, [N, H, W, ...], as [N, K, ...]."""
        count, height, width = views.shape[:3]
        return views.reshape(count, height * width, *views.shape[3:])[:, self._flat]

    def coded_at_pixels(self, views: F32) -> F64:
        """Return the readings of the held-out pixels, [K, C] float64, that views [N, H, W, C] would give."""
        return self._coded(self.at_pixels(views))

    def residual_at_pixels(self, views: F32) -> F64:
        """Return the readings of the held-out pixels, [K, C] float64, less those of views [N, H, W, C]."""
        return self.shot.measurement[self.pixels].astype(np.float64) - self.coded_at_pixels(views)

    def _coded(self, at_pixels: F32) -> F64:
        return self._coding.forward(torch.from_numpy(at_pixels[:, :, None]))[:, 0].double().numpy()

    def residual_rms(self, views: F32) -> float | None:
        """Return the residual of views [N, H, W, C] at the held-out pixels, in the measurement's unit.

        None if no pixel was held out; infinite if the views are not finite.
        """
        return self._rms(self.residual_at_pixels(views)) if self.pixels.any() else None

    def residual_rms_of(self, coded: F32, added: F32 | None) -> float | None:
        """Return the same of views that give the measurement `coded`, [H, W, C], with others, [N, H, W, C], added."""
        if not self.pixels.any():
            return None
        residual = (self.shot.measurement - coded)[self.pixels].astype(np.float64)
        return self._rms(residual if added is None else residual - self.coded_at_pixels(added))

    @staticmethod
    def _rms(residual: F64) -> float:
        rms = rms_of(residual)
        return rms if np.isfinite(rms) else float("inf")

    def squared_residuals(self, views: F32) -> F64:
        """Return the mean squared residual of views [N, H, W, C] at each held-out pixel, [K] float64."""
        return np.mean(self.residual_at_pixels(views) ** 2, axis=1)

    def grey_rms(self) -> float | None:
        """Return the residual of the best even grey (or colour) at the held-out pixels; None without any.

        A decoder that knows only how many masks are open at a pixel, and the colour of its filter, reaches the same.
        """
        if not self.pixels.any():
            return None
        light = self._coded(np.ones((self.shot.views, len(self._flat), self.shot.channels), np.float32))
        measured = self.shot.measurement[self.pixels].astype(np.float64)
        channels = self._coding.channels
        # Behind a colour filter array, which pixels see which colour; otherwise all pixels see all channels.
        sees = np.ones((len(light), 1)) if channels is None else channels.numpy() == np.arange(3)
        level = sees.T @ (light * measured) / np.maximum(sees.T @ (light * light), np.finfo(np.float64).tiny)
        return rms_of(measured - (sees @ level) * light)


def surely_larger(one: F64, other: F64) -> bool:
    """Tell whether the mean of the first exceeds that of the second by more than `SURE` standard errors.

    The squared error of the mean of several predictions is never larger than the average of their squared errors. If
    the best of them is better than the mean on a few hundred pixels, that is often chance, since it was selected on
    them.

    Args:
        one: Squared residuals, [K].
        other: Those of the same pixels, [K].
    """
    difference = one - other
    if len(difference) < 2:
        return False
    return bool(difference.mean() > SURE * difference.std(ddof=1) / math.sqrt(len(difference)))
