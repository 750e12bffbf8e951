"""Random masks as a modulator shows them, binary or grey. Not here: how optics change them (`effects`)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError


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
    rows, columns = _elements(count, size, ratio, feature_px)
    return _shown(rng.random((count, rows, columns)) < ratio, size, ratio, feature_px)


def random_grey_masks(
    count: int, size: tuple[int, int], ratio: float, rng: np.random.Generator, *, feature_px: int = 1
) -> F32:
    """Draw independent masks of every grey between closed and open, [N, H, W] in [0, 1].

    A feature's transmission follows the beta distribution with parameters 2 ratio and 2 (1 - ratio): uniform at a
    ratio of a half, and at every ratio with a third of the variance that binary masks of the same mean have. So they
    take as much light as those, and lose the same part of the contrast at every ratio.

    Args:
        count: N.
        size: Height and width in sensor pixels.
        ratio: Mean transmission, in (0, 1): what lets all light through is not grey.
        rng: Where the draws come from.
        feature_px: Side of one square feature (modulator element) in sensor pixels.

    Raises:
        InputError: A count, size, ratio or feature is out of range, or all masks came out closed.
    """
    rows, columns = _elements(count, size, ratio, feature_px)
    if ratio == 1:
        raise InputError("grey masks with a mean transmission of 1", allowed="more than 0, less than 1")
    return _shown(rng.beta(2 * ratio, 2 * (1 - ratio), (count, rows, columns)), size, ratio, feature_px)


def _elements(count: int, size: tuple[int, int], ratio: float, feature_px: int) -> tuple[int, int]:
    """Return how many rows and columns of features cover the sensor."""
    if count < 1 or min(size) < 1 or feature_px < 1 or not 0 < ratio <= 1:
        raise InputError(
            f"{count} masks of {size} with {ratio} ones and features of {feature_px} px",
            allowed="count, size and feature_px >= 1; 0 < ratio <= 1",
        )
    return -(-size[0] // feature_px), -(-size[1] // feature_px)


def _shown(elements: NDArray[Any], size: tuple[int, int], ratio: float, feature_px: int) -> F32:
    """Spread features over the sensor's pixels."""
    masks = elements.repeat(feature_px, axis=1).repeat(feature_px, axis=2)[:, : size[0], : size[1]].astype(np.float32)
    if not masks.any():
        raise InputError(
            f"all {len(masks)} masks of {size} came out closed at a ratio of {ratio}",
            remedy="raise the ratio, the size or the number of masks",
        )
    return np.asarray(masks)
