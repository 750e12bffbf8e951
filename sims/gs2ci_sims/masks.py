"""Masks: random ones as a modulator shows them, binary or grey, and such as a laboratory's calibration sees them.

For exposures and tests. Not here: how optics change masks in general (effects of the light path).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.finite_contrast import FiniteContrast
from gs2ci_sims.effects.mask_edges import MaskEdges
from gs2ci_sims.effects.misregistration import Misregistration
from gs2ci_sims.rig import Rig

# Elements of two pixels, not quite on the pixel grid, blurred, and leaking. Leakage of 60:1 and what blur spills into
# closed elements make up the 25:1 that is measured in all.
LABORATORY: Final[tuple[Effect, ...]] = (
    MaskEdges(0.45),
    FiniteContrast(contrast=60.0),
    Misregistration(right_px=0.1, down_px=0.1),
)
LABORATORY_FEATURE_PX: Final = 2
# The calibration divides by a reference that blur has dimmed; what is brighter is clipped at 1.
LABORATORY_ON_LEVEL: Final = 0.85


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


def laboratory_masks(count: int, size: tuple[int, int], ratio: float, rng: np.random.Generator) -> F32:
    """Draw masks that look like calibrated ones of real systems, [N, H, W] in [0, 1], neither binary nor crisp.

    Made by effects of the light path, with figures that reproduce what was measured on two published sets of 660 x
    660 lithographic masks, 50 % open (the real data of TSA-Net and of SMEM): an off level of 0.04 (0.017 to 0.083
    from the 10th to the 90th percentile), 36 to 40 % of all pixels between 0.1 and 0.9, 26 to 33 % clipped at 1, and
    an autocorrelation of 0.61 to 0.65, 0.12 to 0.19 and 0.01 to 0.02 at lags of 1, 2 and 3 pixels.

    Raises:
        InputError: See `random_masks`.
    """
    masks = random_masks(count, size, ratio, rng, feature_px=LABORATORY_FEATURE_PX)
    rig = Rig()
    for effect in LABORATORY:
        masks = effect.apply(masks, rig, rng)
    return np.asarray(np.clip(masks / LABORATORY_ON_LEVEL, 0.0, 1.0), dtype=np.float32)
