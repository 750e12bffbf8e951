"""A prior without weights on one image at a time: non-local means.

Here: the strength. Not here: the filter (`decode.denoisers`).
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.decode.denoisers import NonLocalMeans
from gs2ci.reconstruct.paper.priors2d.base import Question, check_targets

# Insensitive to planes and to straight edges along the axes; its taps' squares sum to 36 (Immerkær 1996).
_GRAIN_FILTER: Final = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)


@dataclass(frozen=True)
class NonLocalMeansPrior:
    """Means over patches that look alike, in each pseudo-view by itself; its fine grain is the noise (`grain`)."""

    name: str = "nlm"

    def __call__(self, question: Question) -> F32:
        """Return the filtered pseudo-views; arguments as for `ImagePrior`."""
        images = question.pseudo.images
        denoise = NonLocalMeans()
        targets = np.empty_like(images)
        for target, image in zip(targets, images, strict=True):
            sigma = grain(image)
            planes = np.ascontiguousarray(image.transpose(2, 0, 1)[None])
            target[...] = denoise(planes, sigma)[0].transpose(1, 2, 0) if sigma > 0 else image
        return check_targets(self.name, targets, images)


def grain(image: F32) -> float:
    """Estimate the standard deviation of white noise in an image, [H, W, C], by a median, robust against texture."""
    response = cv2.filter2D(image, -1, _GRAIN_FILTER, borderType=cv2.BORDER_REFLECT_101)
    return float(np.median(np.abs(response))) / (
        6 * 0.6745
    )  # the median of |x| of a normal variable, in standard deviations
