"""Full colour from a mosaic by bilinear green and bilinear colour differences.

Linear, so that a decoder may call it in each iteration.
"""

import cv2
import numpy as np

from gs2ci.core.arrays import F32, I64

_GREEN_KERNEL = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32)
_COLOUR_KERNEL = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32)


class Demosaicer:
    """Fills the two missing colours of every pixel of one colour filter array.

    Args:
        channels: Channel index of each pixel, [H, W] integer.
    """

    def __init__(self, channels: I64) -> None:
        self._sees = [(channels == c).astype(np.float32) for c in range(3)]
        kernels = (_COLOUR_KERNEL, _GREEN_KERNEL, _COLOUR_KERNEL)
        weights = [_filter(seen, kernel) for seen, kernel in zip(self._sees, kernels, strict=True)]
        # An image one pixel high or wide may not see a colour at all: then that colour difference is taken as 0.
        self._normal = [np.where(w > 0, 1 / np.maximum(w, 1e-6), 0).astype(np.float32) for w in weights]

    def __call__(self, mosaic: F32) -> F32:
        """Interpolate a mosaic, [H, W], to planar colour, [3, H, W]."""
        red, green, blue = self._sees
        full_green = _filter(mosaic * green, _GREEN_KERNEL) * self._normal[1]
        full_green = np.where(green > 0, mosaic, full_green)
        planes = [full_green, full_green, full_green]
        for c, seen in ((0, red), (2, blue)):
            difference = _filter((mosaic - full_green) * seen, _COLOUR_KERNEL)
            planes[c] = full_green + difference * self._normal[c]
        return np.stack(planes)


def _filter(image: F32, kernel: F32) -> F32:
    # Reflection about the border pixel keeps the parity of the mosaic.
    return cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REFLECT_101)
