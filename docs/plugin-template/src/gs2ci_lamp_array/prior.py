"""A prior on images for the fine stage: the median of each 3 x 3 pixels."""

import cv2
import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.paper.priors2d.base import Question, check_targets


class MedianPrior:
    """Says that views have no lone pixels.

    Args:
        seed: For priors that draw at random; this one does not.
    """

    name = "median"

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def __call__(self, question: Question) -> F32:
        images = question.pseudo.images
        targets = np.stack([cv2.medianBlur(np.ascontiguousarray(image), 3) for image in images])
        return check_targets(self.name, targets, images)
