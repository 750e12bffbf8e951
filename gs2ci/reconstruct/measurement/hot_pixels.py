"""Single pixels that read more light than any scene sends: found, and left out.

Here: `close_hot_pixels`. Not here: dead rows and columns (`dead_lines`), the doubt about masks and unit if such
readings are many (`doubts`), pixels that a calibration knows to be bad (`gs2ci import --bad-pixels`).
"""

from typing import Final

import numpy as np
from scipy.ndimage import convolve

from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import MOST_OUTLIERS, beyond_white, without_pixels

# At most so many neighbours of a hot pixel may be hot as well: if one pixel in twenty is hot, 99 % of the hot pixels
# have no more. A region that is brighter than white because of a wrong unit or wrong masks has more, and is kept.
_NEIGHBOURS: Final = 2


def close_hot_pixels(shot: Shot) -> tuple[Shot, Findings]:
    """Close the masks over hot pixels, so that no stage uses their readings; report how many.

    No view can explain them, and a fit would make a bright Gaussian of each that disturbs all views. A reading known to
    be clipped is a lower bound and is not a hot pixel. If many pixels read too much, masks or unit are wrong, and none
    is closed.
    """
    odd = beyond_white(shot)
    if odd.mean() > MOST_OUTLIERS:
        return shot, ()
    if shot.saturated is not None:
        odd &= ~shot.saturated
    beside = convolve(odd.astype(np.int64), np.ones((3, 3), np.int64), mode="constant") - odd
    hot = odd & (beside <= _NEIGHBOURS)
    if not hot.any():
        return shot, ()
    count = int(hot.sum())
    pixels = f"{count} pixels read" if count > 1 else "1 pixel reads"
    return without_pixels(shot, hot), (finding(Code.HOT_PIXELS, pixels=pixels, count=count),)
