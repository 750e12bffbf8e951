"""Open elements that are wider or narrower than stated, by over-etching, fringing fields or an exposure threshold.

Each open element reaches beyond its stated edges by the same length, or ends short of them. This differs from a blur,
which moves light from open to closed elements without changing its sum, and from a leak, which is the same far from any
edge.

Soft masks may be stated with noise, which cannot have open edges; what it takes from their sum looks like a blur.

Here: masks with such edges, their sum for any width, and what noise leaves of it. Not here: the estimation of the width
(`fine`, `proposals`).
"""

from functools import cached_property
from typing import Final

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter

from gs2ci.core.arrays import F32, F64

# What is found at this share of the highest frequencies along both axes is noise: soft masks hardly have any.
# If it is more than this share of all, the masks may be as rough.
_HIGHEST: Final = 0.25
_MOST_NOISE: Final = 0.5
# Powers are averaged over this share of the frequencies along each axis.
_SMOOTHED: Final = 0.05


def widened(masks: F64, px: float) -> F64:
    """Return transmissions, [N, H, W], of elements that reach `px` beyond their edges, or end short of them (below 0).

    A pixel is a square, and its transmission is the open share of its area: beside an open neighbour a strip of that
    width opens, at a corner the union of what the three neighbours open. Border values are repeated outside.

    Args:
        masks: Transmissions as stated, [N, H, W]; of elements aligned with the pixels, open or closed.
        px: Of at most `parameters.MOST_WIDENING_PX`, either way.
    """
    if px == 0:
        return masks
    return np.stack([_wider(one, _bands(one, px), px) for one in masks])


def _wider(stated: F64, bands: F64, px: float) -> F64:
    return stated + abs(px) * bands[0] + px * px * bands[1]


def _bands(mask: F64, px: float) -> F64:
    """Return the factors of |px| and px² in a mask, [H, W], with elements wider by px, or narrower: [2, H, W]."""
    height, width = mask.shape
    # If narrower, open and closed are exchanged: what closed neighbours close.
    opened = mask if px > 0 else 1 - mask
    padded = np.pad(opened, 1, mode="edge")

    def beside(down: int, right: int) -> F64:
        return padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    sides = (-1, 1)
    strips = sum(beside(k, 0) + beside(0, k) for k in sides)
    corners = sum(1 - (1 - beside(i, 0)) * (1 - beside(0, j)) * (1 - beside(i, j)) for i in sides for j in sides)
    return np.sign(px) * (1 - opened) * np.stack([strips, corners - 2 * strips])


def expected(total: F64) -> F64:
    """Return the sum of true soft masks, [H, W], that is expected if the stated ones, whose sum it is, have noise.

    Readings follow this sum (Wiener's), which has less of high frequencies than the stated one. Compared with that one,
    noise would be taken for a blur of the true masks, and what a blur explains badly for a leak or a black level.
    """
    mean = total.mean()
    spectrum = fft.dctn(total - mean, norm="ortho")
    power = spectrum**2
    noise = float(power[tuple(slice(round(-_HIGHEST * n), None) for n in total.shape)].mean())
    if noise > _MOST_NOISE * float(power.mean()):
        return total
    around = gaussian_filter(power, [_SMOOTHED * n for n in total.shape])
    kept = np.maximum(1 - noise / np.maximum(around, 1e-300), 0)
    return mean + fft.idctn(kept * spectrum, norm="ortho")


class MaskSum:
    """The weighted sum Σ wᵢ Mᵢ of a piece of the masks, for any width of their elements.

    Args:
        masks: Transmissions, [N, H, W].
        weights: Of the masks, [N].
        part: Rows and columns of the piece.
        is_soft: Whether they may have noise, and the sum is that which is expected of the true ones.
    """

    def __init__(
        self,
        masks: F32 | F64,
        weights: F32 | F64,
        part: tuple[slice, slice] = (slice(None), slice(None)),
        *,
        is_soft: bool = False,
    ):
        self._masks = masks[:, part[0], part[1]]
        self._weights = np.asarray(weights, np.float64)
        self._is_soft = is_soft

    @property
    def weight(self) -> float:
        """Get the sum of the weights, which is that of fully open masks."""
        return float(self._weights.sum())

    @cached_property
    def stated(self) -> F64:
        """Get the sum of the masks as stated, [H, W]."""
        total: F64 = np.ascontiguousarray(np.tensordot(self._weights, self._masks, axes=1), np.float64)
        return expected(total) if self._is_soft else total

    def widened(self, px: float) -> F64:
        """Return the sum of masks with wider elements, [H, W], from two pictures for all widths of one sign."""
        if px == 0:
            return self.stated
        return _wider(self.stated, self._bands[px > 0], px)

    @cached_property
    def _bands(self) -> dict[bool, F64]:
        """Get the factors of |px| and px², [2, H, W], if elements are wider and if they are not."""
        masks = self._masks.astype(np.float64)
        return {
            px > 0: sum(weight * _bands(one, px) for weight, one in zip(self._weights, masks, strict=True))
            for px in (1.0, -1.0)
        }
