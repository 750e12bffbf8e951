"""Views of a dark scene, brightened for what looks at pictures of 8 bits.

Here: by how much. Not here: the pictures (`tracks`, `wide`), the sweep that looks at the same views (`sweep`).
"""

import numpy as np

from gs2ci.core.arrays import F32

# Dark views would keep too few of the 256 levels of 8 bits: a scene whose brightest hundredth is below the first of
# these shares of full scale is brightened; one below the second shows nothing that could be tracked.
_BRIGHTEST_PERCENT = 99.0
_DARK, _BLACK = 1 / 8, 1e-6


def brightened(views: F32) -> F32:
    """Return views, [N, H, W, C] in full scales, those of a dark scene times one power of two, for 8-bit pictures."""
    # Every fourth pixel: the percentile of all would take longer than the tracks of large views.
    brightest = float(np.percentile(views[:, ::2, ::2], _BRIGHTEST_PERCENT))
    if not _BLACK <= brightest < _DARK:
        return views
    return views * np.float32(2.0 ** np.floor(-np.log2(brightest)))
