"""Square blocks of a picture: in each a residual is regressed by itself, or scores are summed for standard errors.

Here: how a picture is cut, and the covariance of such sums. Not here: the regressions (`moving`, `over_time`,
`displacements`, `brightness`, `doubts`).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64

BLOCK_PX: Final = 16
# A block with fewer usable pixels is not asked.
LEAST_PIXELS: Final = BLOCK_PX**2 // 4
# Residuals are no independent numbers: what views lack is as wide as the elements of the masks. By how much that makes
# ratios of tests too large and standard errors too small is seen with residuals displaced by so much (down and right),
# which know nothing of a block's masks: farther than elements are wide, and along no direction in which a pattern may
# be displaced from view to view.
ELSEWHERE_PX: Final = ((9, 21), (21, -9), (-9, -21), (-21, 9))
# Significance level of a block: the probability of such a result if there is nothing to find.
CHANCE: Final = 1e-3
# Keeps regressions defined; relative to the mean of the diagonal, over a block.
RIDGE: Final = 1e-6


def ridged(gram: F64) -> F64:
    """Return the matrices of normal equations, [..., K, K], raised so far that each can be inverted."""
    size = gram.shape[-1]
    least = np.maximum(RIDGE * np.trace(gram, axis1=-2, axis2=-1) / size, np.finfo(np.float64).tiny)
    return gram + np.eye(size) * least[..., None, None]


def in_blocks(picture: F32 | F64, side_px: int = BLOCK_PX) -> F64:
    """Cut a picture, [H, W, C], into blocks, zero beyond the border: [B, B', pixels of a block, C]."""
    height, width, channels = picture.shape
    down, across = -(-height // side_px), -(-width // side_px)
    padded = np.zeros((down * side_px, across * side_px, channels))
    padded[:height, :width] = picture
    cut = padded.reshape(down, side_px, across, side_px, channels).swapaxes(1, 2)
    return cut.reshape(down, across, side_px**2, channels)


def block_sums(values: F64, side_px: int) -> F64:
    """Sum over blocks of this side, smaller ones at the end: [..., H, W] to [..., B, B']."""
    rows, columns = (np.arange(0, length, side_px) for length in values.shape[-2:])
    return np.add.reduceat(np.add.reduceat(values, rows, axis=-2), columns, axis=-1)


def block_numbers(row: NDArray[np.intp], column: NDArray[np.intp], side_px: int) -> NDArray[np.intp]:
    """Return the number of the block of this side to which each pixel belongs, [P], from 0 without gaps.

    There may be no pixels: a wholly saturated measurement has none that counts.
    """
    down, across = row // side_px, column // side_px
    number = down * (across.max(initial=0) + 1) + across
    # Sorting all pixels would take ten times as long.
    return (np.cumsum(np.bincount(number) > 0) - 1)[number]


def scores_over_blocks(scores: F64, block: NDArray[np.intp]) -> F64:
    """Return the covariance of the sums of pixels' scores, [L, P], over blocks, whose numbers are given, [P]; [L, L].

    Residuals within a block may be correlated in any way (Liang and Zeger 1986, eq. 2.5).
    """
    sums = np.stack([np.bincount(block, weights=one) for one in scores], axis=1)
    return np.asarray(sums.T @ sums * (len(sums) / max(len(sums) - 1, 1)), np.float64)
