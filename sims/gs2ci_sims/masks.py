"""Masks that a modulator can show: random binary ones. For exposures and tests.

Not here: what the modulator's optics make of them (effects of the light path).
"""

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError

F32 = NDArray[np.float32]


def random_masks(
    count: int, size: tuple[int, int], ratio: float, rng: np.random.Generator, *, feature_px: int = 1
) -> F32:
    """Draw independent binary masks, [N, H, W] of 0 and 1.

    Args:
        count: N.
        size: Height and width in sensor pixels.
        ratio: Probability that a feature is open (share of ones), in (0, 1].
        rng: Where the draws come from.
        feature_px: Side of one square feature (modulator element) in sensor pixels.

    Raises:
        InputError: A count, size, ratio or feature is out of range, or all masks came out closed.
    """
    if count < 1 or min(size) < 1 or feature_px < 1 or not 0 < ratio <= 1:
        raise InputError(
            f"{count} masks of {size} with {ratio} ones and features of {feature_px} px",
            allowed="count, size and feature_px >= 1; 0 < ratio <= 1",
        )
    rows, columns = (-(-side // feature_px) for side in size)
    elements = rng.random((count, rows, columns)) < ratio
    masks = elements.repeat(feature_px, axis=1).repeat(feature_px, axis=2)[:, : size[0], : size[1]]
    if not masks.any():
        raise InputError(
            f"all {count} masks of {size} came out closed at a ratio of {ratio}",
            remedy="raise the ratio, the size or the number of masks",
        )
    return masks.astype(np.float32)
