"""Which of a file's masks were shown during the exposure, by their traces in the readings.

The fine pattern of the readings is the sum of those of the masks that were shown, each as strong as its view is bright.
Least squares tells their shares: those of masks that were not shown are zero within their errors.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.linearity import lattices, local_mean

# Finer than this the pattern is the masks', coarser the scene's.
_FINE_PX: Final = 5
_SIDE_PX: Final = 160
_DARKEST: Final = 0.1
_CLIPPED_NEAR: Final = 0.4
# Readings of so many pixels for each mask leave something to judge by.
_PIXELS_PER_MASK: Final = 40
# A mask counts as not shown if its share is below this one of the others', by so many standard errors; the others'
# must stand out by as many.
_NOT_SHOWN: Final = 0.3
_SIGMAS: Final = 6.0
# Masks that were shown twice, or twice as long, among others that agree.
_TWICE: Final = 1.7
_ALIKE: Final = 0.2


@dataclass(frozen=True)
class Traces:
    """What each mask contributes to the readings.

    Args:
        shares: Relative to the typical one that was shown, [N].
        errors: Their standard errors, [N].
        unexplained: Share of the fine pattern's variance that all of them leave.
    """

    shares: F64
    errors: F64
    unexplained: float

    @property
    def shown(self) -> Bool:
        """Get which masks were shown, [N]; all of them where that cannot be told."""
        absent = (self.shares < _NOT_SHOWN) & (self.shares + _SIGMAS * self.errors < 1)
        clear = float(np.median(self.errors)) * _SIGMAS < 1
        return np.asarray(~absent) if clear and not absent.all() else np.ones(len(absent), bool)

    @property
    def twice(self) -> Bool:
        """Get which masks are so much stronger than the others that they were shown twice, [N]."""
        strong = (self.shares - _SIGMAS * self.errors > 1) & (self.shares > _TWICE)
        rest = self.shares[~strong & self.shown]
        alike = len(rest) > 1 and float(np.ptp(rest)) < _ALIKE * 2
        return np.asarray(strong) if alike and 2 * strong.sum() <= len(strong) else np.zeros(len(strong), bool)


def traces(image: F64, masks: F32, *, clip: float = np.inf, is_mosaic: bool = False) -> Traces | None:
    """Estimate the share of each mask in the readings.

    Args:
        image: Readings above the offset, [H, W].
        masks: Transmissions where they show in the readings, [N, H, W].
        clip: Readings from here on are clipped.
        is_mosaic: Whether neighbouring pixels are of different colours.

    Returns:
        The traces; None where nothing can be told: few pixels, none of them well lit, or masks alike.
    """
    count = len(masks)
    gram, right, total, pixels = np.zeros((count, count)), np.zeros(count), 0.0, 0
    for plane, stack in zip(
        lattices(_cut(image), is_mosaic), lattices(_cut(masks.astype(np.float64)), is_mosaic), strict=True
    ):
        level = local_mean(plane)
        bright = float(np.quantile(level, 0.9))
        used = level > max(_DARKEST * bright, 0)
        if np.isfinite(clip):
            used &= local_mean((plane >= clip).astype(np.float64)) < _CLIPPED_NEAR
        if bright <= 0 or not used.any():
            continue
        weight = np.where(used, np.minimum(level / bright, 1), 0)
        relative = np.where(used, plane / np.where(used, level, 1.0), 1.0)
        # A bright pixel must not outweigh all others.
        seen = (_fine(np.minimum(relative, 8.0)) * weight).ravel()
        known = (_fine(stack) * weight).reshape(count, -1)
        gram, right = gram + known @ known.T, right + known @ seen
        total, pixels = total + float(seen @ seen), pixels + int(used.sum())
    return _solved(gram, right, total, pixels)


def _solved(gram: F64, right: F64, total: float, pixels: int) -> Traces | None:
    count = len(gram)
    size = float(np.trace(gram)) / count
    if pixels < _PIXELS_PER_MASK * count or size <= 0 or total <= 0:
        return None
    if float(np.linalg.eigvalsh(gram)[0]) < 1e-4 * size:
        return None
    inverse = np.linalg.inv(gram)
    shares = inverse @ right
    left = max(total - float(shares @ right), 0.0)
    errors = np.sqrt(left / (pixels - count) * np.diag(inverse))
    if shares.max() <= 0:
        return None
    typical = float(np.median(shares[shares >= _NOT_SHOWN * shares.max()]))
    return Traces(shares / typical, errors / typical, left / total)


def _cut(image: NDArray[Any]) -> NDArray[Any]:
    cuts = [slice(max(n - _SIDE_PX, 0) // 4 * 2, None) for n in image.shape[-2:]]
    return image[..., cuts[0], cuts[1]][..., :_SIDE_PX, :_SIDE_PX]


def _fine(image: F64) -> F64:
    return image - local_mean(image, _FINE_PX)
