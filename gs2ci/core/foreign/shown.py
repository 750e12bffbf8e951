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
# Squares of residuals beyond so many times their median, five standard deviations, are of defects.
_OUTLYING: Final = 55.0


@dataclass(frozen=True)
class Traces:
    """What each mask contributes to the readings.

    Args:
        shares: Relative to the typical one that was shown, [N].
        errors: Their standard errors, [N].
        unexplained: Share of the fine pattern's variance that neither they nor the texture of what they show explain:
            that of masks which are missing, and of noise.
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
    parts = [
        part
        for plane, stack in zip(
            lattices(_cut(image), is_mosaic), lattices(_cut(masks.astype(np.float64)), is_mosaic), strict=True
        )
        if (part := _part(plane, stack, clip)) is not None
    ]
    return _solved(parts, len(masks)) if parts else None


@dataclass(frozen=True)
class _Part:
    """Pixels of one colour.

    Args:
        seen: The fine pattern of the readings, weighted, [P].
        known: Those of the masks, weighted alike, [N, P].
        opened: How much the masks let through, relative to the mean, [P].
        weight: [P]; 0 where a pixel tells nothing.
    """

    seen: F64
    known: F64
    opened: F64
    weight: F64


def _part(plane: F64, stack: F64, clip: float) -> _Part | None:
    level = local_mean(plane)
    bright = float(np.quantile(level, 0.9))
    used = level > max(_DARKEST * bright, 0)
    if np.isfinite(clip):
        used &= local_mean((plane >= clip).astype(np.float64)) < _CLIPPED_NEAR
    if bright <= 0 or not used.any():
        return None
    weight = np.where(used, np.minimum(level / bright, 1), 0)
    relative = np.where(used, plane / np.where(used, level, 1.0), 1.0)
    opened = stack.sum(axis=0)
    return _Part(
        # A bright pixel must not outweigh all others.
        (_fine(np.minimum(relative, 8.0)) * weight).ravel(),
        (_fine(stack) * weight).reshape(len(stack), -1),
        (opened / max(float(opened.mean()), 1e-12)).ravel(),
        weight.ravel(),
    )


def _solved(parts: list[_Part], count: int) -> Traces | None:
    gram = sum((part.known @ part.known.T for part in parts), np.zeros((count, count)))
    right = sum((part.known @ part.seen for part in parts), np.zeros(count))
    total = sum(float(part.seen @ part.seen) for part in parts)
    pixels = sum(int((part.weight > 0).sum()) for part in parts)
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
    return Traces(shares / typical, errors / typical, _of_no_mask(parts, shares) / total)


def _of_no_mask(parts: list[_Part], shares: F64) -> float:
    """Return how much of the squared residual does not grow with what the masks let through.

    Texture, and its motion from view to view, shows where masks are open and as the square of how much they are; a mask
    that is missing shows wherever it was open itself. Hot pixels, which stand out by more than any mask, count little.
    """
    squares = np.concatenate([(part.seen - shares @ part.known) ** 2 for part in parts])
    constant = np.concatenate([part.weight**2 for part in parts])
    squares = np.minimum(squares, _OUTLYING * float(np.median(squares[constant > 0])))
    growing = constant * np.concatenate([part.opened**2 for part in parts])
    terms = np.stack([constant, growing])
    found = np.linalg.lstsq(terms @ terms.T, terms @ squares, rcond=None)[0]
    return max(float(found[0] * constant.sum()), 0.0)


def _cut(image: NDArray[Any]) -> NDArray[Any]:
    cuts = [slice(max(n - _SIDE_PX, 0) // 4 * 2, None) for n in image.shape[-2:]]
    return image[..., cuts[0], cuts[1]][..., :_SIDE_PX, :_SIDE_PX]


def _fine(image: F64) -> F64:
    return image - local_mean(image, _FINE_PX)
