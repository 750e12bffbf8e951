"""Where the brightness of views surely errs over time, although their coded sum explains the measurement.

A scene that cannot follow something that moves may still explain the measurement: where masks of neighbouring pixels
are alike (blurred masks, or one pattern that is displaced from view to view, as in most laboratories), fine detail that
follows the masks gives any coded sum, and held-out pixels, whose masks are like those of their neighbours, hardly show
that it is wrong. But the detail of a real scene is independent of the masks. So views are smoothed, which removes all
fine detail, and what their coded sum leaves of the measurement is regressed, block by block, on the masks of the single
views: real detail follows none of them, and a view that is too dark over a block follows its own. One number for each
of a few temporal frequencies, for some hundred pixels; no fit, and a tenth of a second.

Errors that all views have in common are not looked for, nor those of whole views, which a lamp that flickers or wrong
weights cause.

Here: the test, and the soft picture of where one set of views fails it and another does not. Not here: what follows
from it (`hypotheses.moving`, `fusion`).
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.special import fdtrc, fdtri

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.reconstruct.measurement.blocks import BLOCK_PX, CHANCE, ELSEWHERE_PX, LEAST_PIXELS, in_blocks, ridged
from gs2ci.reconstruct.measurement.holdout import Holdout

# Blocks begin at every half of a block, down and to the right: a place belongs to four, fewer at the border.
_STEP_PX: Final = BLOCK_PX // 2
# A place counts if so many of its blocks do.
_VOTES: Final = 2
# Standard deviation of the smoothing: wider than the detail that masks of a laboratory leave in common (their edges are
# soft over one or two pixels), narrower than a block.
_SMOOTH_PX: Final = 2.0
# So many temporal frequencies at most: things move smoothly, and each frequency costs a degree of freedom.
_FREQUENCIES: Final = 8
# This quantile of the test's ratios with residuals of other places shows how much too large they are.
_QUANTILE: Final = 0.95
# Smaller errors (root mean square over the views, full scale 1) are not worth replacing views.
VISIBLE: Final = 0.02
# The brightness of blocks holds about half of the squared error of views that cannot follow what moves (0.43 to 0.55 of
# it in six scenes). Views are replaced if that error is more than half of the squared difference from the other views,
# so that these err less.
_LEAST_OF_DIFFERENCE: Final = 0.25
# Less of the picture is left as it is: one block in a thousand is wrong by chance.
_LEAST_SHARE: Final = 0.01
# Masks whose differences have less of their power are alike but for rounding.
_ALIKE: Final = 1e-9
# By so much the places are widened, since the border of what moves lies between blocks; and the standard deviation of
# the transition, px.
_WIDENED_PX: Final = 4
_SOFT_PX: Final = 3.0


def errors_over_time(holdout: Holdout, views: F32) -> F32:
    """Return how much views surely and visibly err over time, [H, W]; 0 where they do not.

    Args:
        holdout: The measurement; its held-out pixels are not read.
        views: [N, H, W, C], full scale 1.

    Returns:
        Squared errors of the brightness of blocks, summed over the views: no more than the squared errors of pixels.
    """
    height, width = holdout.shot.size
    if len(views) < 2 or min(height, width) < _STEP_PX or not np.isfinite(views).all():
        return np.zeros((height, width), np.float32)
    weighted = holdout.shot.transmissions
    smoothed = np.stack([cv2.GaussianBlur(view, (0, 0), _SMOOTH_PX).reshape(view.shape) for view in views])
    left = (holdout.shot.measurement - holdout.coded(smoothed)).mean(axis=2)
    asked = holdout.shot.usable & ~holdout.pixels
    left = np.where(asked, left - _of_whole_views(left, weighted * smoothed.mean(axis=3), asked), 0)
    # Each block is also tested with residuals of other places, which know nothing of its masks.
    several = np.stack([left, *(np.roll(left, step, axis=(0, 1)) for step in ELSEWHERE_PX)])
    tested = _tested_blocks(several * asked, weighted * asked, asked)
    by_chance = np.concatenate([one.by_chance.reshape(-1) for one in tested])
    inflated = max(1.0, float(np.quantile(by_chance, _QUANTILE))) if len(by_chance) else 1.0
    wrong = np.stack([one.wrong(inflated) for one in tested])
    power = np.where(wrong, [one.sure_power(inflated) for one in tested], 0).astype(np.float32)
    votes = _of_four(wrong.astype(np.float32))
    sure = np.where(votes >= _VOTES, _of_four(power) / np.maximum(votes, 1), 0).astype(np.float32)
    return sure.repeat(_STEP_PX, axis=0)[:height].repeat(_STEP_PX, axis=1)[:, :width]


def errs_over_time(holdout: Holdout, views: F32) -> Bool:
    """Tell where views, [N, H, W, C], surely and visibly err over time, [H, W]."""
    return errors_over_time(holdout, views) > 0


def followed_by_other_alone(holdout: Holdout, views: F32, other: F32) -> F32:
    """Return where views err over time and others, both [N, H, W, C], do not: [H, W] from 0 to 1, with soft borders.

    Others that do not err over time may lack more detail than the views are wrong; so places do not count if the error
    explains too little of the difference between the two.
    """
    errors = errors_over_time(holdout, views)
    wrong = errors > 0
    if wrong.any():
        apart = ((views - other) ** 2).sum(axis=0).mean(axis=2)
        wrong &= errors >= _LEAST_OF_DIFFERENCE * cv2.blur(apart, (BLOCK_PX, BLOCK_PX))
        wrong &= ~errs_over_time(holdout, other)
    if wrong.mean() < _LEAST_SHARE:
        return np.zeros(wrong.shape, np.float32)
    size = 2 * _WIDENED_PX + 1
    widened = cv2.dilate(wrong.astype(np.float32), np.ones((size, size), np.uint8))
    return cv2.GaussianBlur(widened, (0, 0), _SOFT_PX)


def replaced(views: F32, other: F32, where: F32) -> F32:
    """Return views, [N, H, W, C], with others in their place by a share for each pixel, [H, W]."""
    share = where[None, :, :, None]
    return views + share * (other - views)


def _of_whole_views(left: F32, coded: F32, asked: Bool) -> F32:
    """Return the part of a residual, [H, W], that brighter or darker whole views explain; their light: [N, H, W]."""
    light = coded[:, asked].astype(np.float64)
    gains = np.linalg.solve(ridged(light @ light.T), light @ left[asked].astype(np.float64))
    return np.tensordot(gains.astype(np.float32), coded, axes=1)


@dataclass(frozen=True)
class _Tested:
    """The test of a row of blocks.

    Args:
        ratio: Of Fisher's test, [B].
        freedom: Its degrees of freedom: unknowns, and pixels beyond them, [B].
        power: Squared offsets of a block's views, summed over the views, [B].
        visible: Whether a block has enough pixels, and errors large enough to be visible, [B].
        by_chance: The ratios with residuals of other places, as multiples of the quantile that they should have.
    """

    ratio: F64
    freedom: tuple[int, F64]
    power: F64
    visible: Bool
    by_chance: F64

    def wrong(self, inflated: float) -> Bool:
        """Tell in which blocks, [B], views are wrong, if ratios are so many times too large by chance."""
        return self.visible & (fdtrc(*self.freedom, self.ratio / inflated) < CHANCE)

    def sure_power(self, inflated: float) -> F64:
        """Return the power of the offsets, [B], without what chance adds to it."""
        return self.power * (1 - np.minimum(1, inflated / np.maximum(self.ratio, np.finfo(np.float64).tiny)))


def _tested_blocks(several: F32, masks: F32, asked: Bool) -> list[_Tested]:
    """Regress residuals on the masks of single views in blocks that begin at every half of a block, row by row.

    A quarter of a block belongs to four of them: what a regression needs, the products of all pairs of pictures, is
    summed once over each quarter.

    Args:
        several: The residual of smoothed views, then residuals of other places, [K, H, W], 0 where not asked.
        masks: With their weights, [N, H, W], likewise.
        asked: Which pixels are usable, [H, W].
    """
    pictures = np.moveaxis(np.concatenate([masks, several, asked[None]]), 0, -1)
    above, tested = _products(pictures[:_STEP_PX]), []
    for top in range(_STEP_PX, asked.shape[0] + _STEP_PX, _STEP_PX):
        below = _products(pictures[top : top + _STEP_PX])
        products, pixels = (_with_next(one + other) for one, other in zip(above, below, strict=True))
        tested.append(_test(products, pixels, len(masks)))
        above = below
    return tested


def _products(pictures: F32) -> tuple[F64, F64]:
    """Sum the products of all pairs of pictures but the last, [at most 8 rows, W, M], over quarters of blocks.

    Returns:
        These, [B, M - 1, M - 1], and the sums of the last picture, [B]; zero below the border.
    """
    if not len(pictures):
        pictures = np.zeros((1, *pictures.shape[1:]), np.float32)
    cut = in_blocks(pictures, _STEP_PX)[0]
    return cut[..., :-1].swapaxes(1, 2) @ cut[..., :-1], cut[..., -1].sum(axis=1)


def _with_next(sums: F64) -> F64:
    """Add to the sums of each of a row's places, [B, ...], those of the place to its right."""
    joined = sums.copy()
    joined[:-1] += sums[1:]
    return joined


def _of_four(values: F32) -> F32:
    """Sum over the four blocks to which each quarter of a block belongs; [B, B'], by the first quarter of blocks."""
    border = cv2.BORDER_CONSTANT
    return cv2.boxFilter(values, -1, (2, 2), anchor=(1, 1), normalize=False, borderType=border)


def _test(products: F64, pixels: F64, count: int) -> _Tested:
    """Regress the residuals of a row of blocks on the masks of single views.

    Args:
        products: Sums over each block of the products of all pairs of masks and residuals, [B, N + K, N + K].
        pixels: How many of each count, [B].
        count: Number of views, N.
    """
    basis = _frequencies(count)
    unknowns = basis.shape[1]
    # What all views have in common explains what it can first.
    with_common = products[:, :count].sum(axis=1)
    power = np.maximum(with_common[:, :count].sum(axis=1), np.finfo(np.float64).tiny)[:, None, None]
    rest_of = products - with_common[:, :, None] * with_common[:, None] / power
    gram = basis.T @ rest_of[:, :count, :count] @ basis
    moments = basis.T @ rest_of[:, :count, count:]
    # Where all masks are alike, nothing but rounding is left of them.
    told = np.trace(gram, axis1=1, axis2=2) > _ALIKE * np.trace(products[:, :count, :count], axis1=1, axis2=2)
    gram = np.where(told[:, None, None], gram, np.eye(unknowns))
    offsets = np.linalg.solve(ridged(gram), moments)
    gained, whole = (offsets * moments).sum(axis=1), np.diagonal(rest_of, axis1=1, axis2=2)[:, count:].clip(0)
    freedom = np.maximum(pixels - unknowns - 1, 1)
    testable = (pixels >= max(LEAST_PIXELS, 2 * unknowns)) & told
    rest = np.maximum(whole - gained, np.finfo(np.float64).eps * whole)
    ratio = np.where(whole > 0, gained / unknowns * freedom[:, None] / np.where(whole > 0, rest, 1), 0).clip(0)
    power_of_offsets = (offsets[..., 0] ** 2).sum(axis=1)
    visible = testable & (power_of_offsets >= VISIBLE**2 * count)
    by_chance = (ratio[:, 1:] / fdtri(unknowns, freedom, _QUANTILE)[:, None])[testable]
    return _Tested(ratio[:, 0], (unknowns, freedom), power_of_offsets, visible, by_chance)


def _frequencies(count: int) -> F64:
    """Return the lowest temporal frequencies of so many views but the constant one, orthonormal, [N, F]."""
    rows = np.arange(1, min(count - 1, _FREQUENCIES) + 1)
    return np.cos(np.pi * (np.arange(count)[:, None] + 0.5) * rows / count) * np.sqrt(2 / count)
