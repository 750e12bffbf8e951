"""A prior without weights that looks at one image at a time: non-local means.

Here: the strength. Not here: the filter (`decode.denoisers`). For `priors2d.choose`.
"""

from dataclasses import dataclass

import numpy as np
from skimage.restoration import estimate_sigma

from gs2ci.core.errors import InputError
from gs2ci.core.records import F32
from gs2ci.reconstruct.decode.denoisers import NonLocalMeans
from gs2ci.reconstruct.priors2d.base import Question, check_targets


@dataclass(frozen=True)
class NonLocalMeansPrior:
    """Means over patches that look alike, in each pseudo-view by itself.

    Args:
        strength: Noise that is assumed, in units of what the finest wavelets of the view show.
    """

    strength: float = 1.0
    name: str = "nlm"

    def __post_init__(self) -> None:
        if not 0 < self.strength < np.inf:
            raise InputError(f"strength {self.strength} of non-local means", allowed="a number above 0")

    def __call__(self, question: Question) -> F32:
        """Return the filtered pseudo-views; arguments as for `ImagePrior`."""
        images = question.pseudo.images
        denoise = NonLocalMeans()
        targets = np.empty_like(images)
        for target, image in zip(targets, images, strict=True):
            sigma = float(np.mean(estimate_sigma(image, channel_axis=-1)))
            planes = np.ascontiguousarray(image.transpose(2, 0, 1)[None])
            target[...] = denoise(planes, self.strength * sigma)[0].transpose(1, 2, 0) if sigma > 0 else image
        return check_targets(self.name, targets, images)
