"""Open elements that are wider or narrower than stated, by over-etching, fringing fields or an exposure threshold.

Each open element reaches beyond its stated edges by the same length, or ends short of them. This differs from a blur,
which moves light from open to closed elements without changing its sum, and from a leak, which is the same far from any
edge.

Here: masks with such edges, and their sum for any width. Not here: the estimation of the width (`fine`, `proposals`).
"""

from functools import cached_property

import numpy as np

from gs2ci.core.arrays import F32, F64


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
    return np.asarray(stated + abs(px) * bands[0] + px * px * bands[1], np.float64)


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
    return np.asarray(np.sign(px) * (1 - opened) * np.stack([strips, corners - 2 * strips]), np.float64)


class MaskSum:
    """The weighted sum Σ wᵢ Mᵢ of a piece of the masks, for any width of their elements.

    Args:
        masks: Transmissions, [N, H, W].
        weights: Of the masks, [N].
        part: Rows and columns of the piece.
    """

    def __init__(self, masks: F32 | F64, weights: F32 | F64, part: tuple[slice, slice] = (slice(None), slice(None))):
        self._masks = masks[:, part[0], part[1]]
        self._weights = np.asarray(weights, np.float64)

    @property
    def weight(self) -> float:
        """Get the sum of the weights, which is that of fully open masks."""
        return float(self._weights.sum())

    @cached_property
    def stated(self) -> F64:
        """Get the sum of the masks as stated, [H, W]."""
        total: F64 = np.ascontiguousarray(np.tensordot(self._weights, self._masks, axes=1), np.float64)
        return total

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
