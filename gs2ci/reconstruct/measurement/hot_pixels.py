"""Single pixels that read more light than any scene sends: found, and left out.

Here: `close_hot_pixels`. Not here: dead rows and columns (`dead_lines`), what many such readings tell of masks and unit
(`doubts`), pixels that a calibration knows to be bad (`gs2ci import --bad-pixels`).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from gs2ci.core.arrays import Bool
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import MOST_OUTLIERS, beyond_white, without_pixels

_SIDE: Final = 3
# Of the pixels around, so many may be hot as well: with one in twenty hot, all but one in a hundred of the hot ones
# have no more. A region that is brighter than white because the unit or the masks are wrong has more, and stays.
_NEIGHBOURS: Final = 2


def close_hot_pixels(shot: Shot) -> tuple[Shot, tuple[Finding, ...]]:
    """Close the masks over hot pixels, so that nothing is concluded from their readings; say how many.

    No view can explain them, and left to the fit each is a bright Gaussian that stands in the way of all views. A
    reading that is known to be clipped says «at least» and is no hot pixel. Where many read too much, masks or unit are
    wrong, and none is closed.
    """
    odd = beyond_white(shot)
    if odd.mean() > MOST_OUTLIERS:
        return shot, ()
    if shot.saturated is not None:
        odd &= ~shot.saturated
    hot = odd & (_count_in_square(odd) <= _NEIGHBOURS + 1)
    if not hot.any():
        return shot, ()
    count = int(hot.sum())
    pixels = f"{count} pixels read" if count > 1 else "1 pixel reads"
    return without_pixels(shot, hot), (finding(Code.HOT_PIXELS, pixels=pixels, count=count),)


def _count_in_square(odd: Bool) -> NDArray[np.int64]:
    """Count the odd ones in the square around each pixel, itself included."""
    share = uniform_filter(odd.astype(np.float64), _SIDE, mode="constant")
    return np.rint(share * _SIDE**2).astype(np.int64)
