"""Square blocks of a picture, in each of which a residual is regressed by itself.

Here: how a picture is cut. Not here: the regressions (`moving`, `over_time`, `displacements`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64

BLOCK_PX: Final = 16


def in_blocks(picture: F32 | F64) -> F64:
    """Cut a picture, [H, W, C], into blocks, zero beyond the border: [B, B', pixels of a block, C]."""
    height, width, channels = picture.shape
    down, across = -(-height // BLOCK_PX), -(-width // BLOCK_PX)
    padded = np.zeros((down * BLOCK_PX, across * BLOCK_PX, channels))
    padded[:height, :width] = picture
    cut = padded.reshape(down, BLOCK_PX, across, BLOCK_PX, channels).swapaxes(1, 2)
    blocks: F64 = cut.reshape(down, across, BLOCK_PX**2, channels)
    return blocks
