"""Where the greens of a colour mosaic stand, from coded readings.

In every Bayer pattern two greens stand on one diagonal of each 2 × 2 pixels, red and blue on the other. Readings over
open masks, summed over a block for each of the four places, agree on the diagonal of the greens and differ on the other
wherever something has a colour. Behind a sensor of one colour both differ alike, by what the masks do to texture.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64

GREENS_FALL: Final = "GRBG or GBRG"
"""The greens stand at the upper left and the lower right."""
GREENS_RISE: Final = "RGGB or BGGR"
# Blocks of so many pixels a side, the first of them that leaves enough of them.
_SIDES_PX: Final = (12, 4)
_ENOUGH: Final = 40
_FEWEST: Final = 4
# How many times as large the squared differences on the other diagonal are, and by how many standard errors. Of 60
# drawn pictures of one colour none exceeds 2.3, of mosaics without much noise nine in ten exceed 4.5.
_RATIO: Final = 2.0
_SIGMAS: Final = 4.5
# Differences below this share of the level are rounding.
_ROUNDING: Final = 1e-4


def greens_of(readings: F64, open_masks: F64) -> str | None:
    """Name the pair of mosaics that readings look like.

    Args:
        readings: Above the offset, [H, W].
        open_masks: How much is open at each pixel, in any unit, [H, W].

    Returns:
        `GREENS_FALL` or `GREENS_RISE`; None if they look like one colour, or where it cannot be told.
    """
    for side in _SIDES_PX:
        levels = _levels(readings, open_masks, side)
        if len(levels) >= (_FEWEST if side == _SIDES_PX[-1] else _ENOUGH):
            break
    else:
        return None
    typical = float(np.abs(levels).mean())
    if typical == 0:
        return None
    falling, rising = (np.square(levels[:, 0, k] - levels[:, 1, 1 - k]) for k in (0, 1))
    floor = (_ROUNDING * typical) ** 2
    means = float(falling.mean()) + floor, float(rising.mean()) + floor
    errors = (float(one.std()) / mean for one, mean in zip((falling, rising), means, strict=True))
    error = np.sqrt((sum(one**2 for one in errors) + 1) / len(levels))
    logarithm = np.log(means[0] / means[1])
    if abs(logarithm) < max(np.log(_RATIO), _SIGMAS * error):
        return None
    return GREENS_RISE if logarithm > 0 else GREENS_FALL


def _levels(readings: F64, open_masks: F64, side: int) -> F64:
    """Return readings over open masks by block and by place among 2 × 2 pixels, [B, 2, 2]."""
    rows, columns = (n // side for n in readings.shape)

    def sums(image: F64) -> F64:
        cut = image[: rows * side, : columns * side]
        return np.asarray(cut.reshape(rows, side // 2, 2, columns, side // 2, 2).sum(axis=(1, 4)))

    opened = sums(open_masks)
    lit = (opened > 0).all(axis=(1, 3))
    levels = sums(readings) / np.where(opened > 0, opened, 1)
    return np.asarray(levels.transpose(0, 2, 1, 3)[lit])
