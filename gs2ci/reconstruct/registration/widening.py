"""Open elements that are wider or narrower than stated, by over-etching, fringing fields or an exposure threshold.

Each open element reaches beyond its stated edges by the same length, or ends short of them. This differs from a blur,
which moves light from open to closed elements without changing its sum, and from a leak, which is the same far from any
edge.

Here: masks with such edges, and their sum for any width. Not here: the estimation of the width (`fine`, `proposals`).
"""

from functools import cached_property

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.registration.kernels import edge_bands, widen


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
    wider: F64 = widen(np.ascontiguousarray(masks, np.float64), float(px))
    return wider


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
        strips, corners = self._bands[0 if px > 0 else 1]
        wider: F64 = self.stated + abs(px) * strips + px * px * corners
        return wider

    @cached_property
    def _bands(self) -> F64:
        return np.asarray(edge_bands(np.ascontiguousarray(self._masks, np.float64), self._weights), np.float64)
