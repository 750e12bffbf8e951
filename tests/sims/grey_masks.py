"""Masks of every grey, which no modulator of ours shows: for tests and tables of grey masks."""

import numpy as np

from gs2ci.core.arrays import F32


def random_grey_masks(
    count: int, size: tuple[int, int], ratio: float, rng: np.random.Generator, *, feature_px: int = 1
) -> F32:
    """Draw independent masks of every grey between closed and open, [N, H, W] in [0, 1], like `random_masks`.

    A feature's transmission follows the beta distribution with parameters 2 ratio and 2 (1 - ratio): uniform at a
    ratio of a half, and at every ratio with a third of the variance that binary masks of the same mean have. So they
    take as much light as those, and lose the same part of the contrast at every ratio.
    """
    rows, columns = (-(-side // feature_px) for side in size)
    elements = rng.beta(2 * ratio, 2 * (1 - ratio), (count, rows, columns))
    wide = elements.repeat(feature_px, axis=1).repeat(feature_px, axis=2)
    return wide[:, : size[0], : size[1]].astype(np.float32)
