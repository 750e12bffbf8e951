"""How readings grow with the open masks: in proportion, as light does, or along a curve.

A coded measurement of a scene that changes little over a few pixels and from view to view reads X(p) · a(p), where
a(p) = Σ wᵢ Mᵢ(p) says how much is open at p. So readings divided by their local mean, drawn over a(p) divided by its
own, lie on the diagonal whatever the scene. Texture and motion scatter them about it and do not bend it, because the
masks are independent of the scene; a leak, a black level or masks that are blurred or elsewhere turn the line and do
not bend it either. A display's gamma, a logarithm, readings divided by the masks' sum or a sum that overflowed bend it.

Here: that line, with standard errors. Not here: what it means for a file (`gs2ci.core.foreign.light`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gs2ci.core.arrays import F64

Undo = Callable[[F64, F64], F64]
"""Turns readings under so many open masks (a stack of planes alike) into what they would read if linear."""

# Local means are taken over so many pixels; texture is coarser than that as a rule, and the masks are not.
WINDOW_PX: Final = 9
# Blocks whose scatter gives the standard errors, so that texture, which is alike within one, is counted as what it is.
_BLOCK_PX: Final = 16
_FEWEST_BLOCKS: Final = 6
# More tells no more: the middle of larger pictures is asked.
LARGEST_SIDE_PX: Final = 320
# Parts of the scene darker than this share of its bright ones say little, and noise and black level rule there.
_DARKEST: Final = 0.1
# Where hardly any window is free of clipped readings, those with so few are asked, at pixels whose readings would lie
# so far below clipping if they were as bright as their neighbours.
_CLIPPED_NEAR: Final = 0.25
_CLEAR_OF_CLIPPING: Final = 0.7
# Masks whose sum varies by less than this (variance of a(p) / mean) say nothing.
_LEAST_CONTRAST: Final = 1e-4


@dataclass(frozen=True)
class Growth:
    """The curve of readings over open masks, both divided by their local means.

    Args:
        slope: Of the straight line: 1 where readings grow in proportion, 0 where they do not depend on the masks.
        slope_error: Its standard error.
        curvature: Coefficient of the square beside slope and constant: 0 for light; g (g - 1) / 2 for a power g.
        curvature_error: Its standard error.
        contrast: Variance of the open masks over their local mean.
        roughness: Variance of the readings over theirs.
        unexplained: What of it the curve leaves.
        is_biased: Whether clipped readings lie among those asked, because hardly any part of the picture is free of
            them: those beside them are selected for being dark, which bends the curve by up to a third.
    """

    slope: float
    slope_error: float
    curvature: float
    curvature_error: float
    contrast: float
    roughness: float
    unexplained: float
    is_biased: bool = False


def middle(image: NDArray[Any]) -> NDArray[Any]:
    """Cut a picture or stack, [..., H, W], to its middle, beginning at an even place, so that a mosaic stays one."""
    cuts = [slice(max(n - LARGEST_SIDE_PX, 0) // 4 * 2, None) for n in image.shape[-2:]]
    cut = image[..., cuts[0], cuts[1]]
    return cut[..., :LARGEST_SIDE_PX, :LARGEST_SIDE_PX]


def lattices(image: NDArray[Any], is_mosaic: bool) -> Iterator[NDArray[Any]]:
    """Yield the parts of a picture or stack, [..., H, W], that are of one colour each."""
    if not is_mosaic:
        yield image
        return
    for row in (0, 1):
        for column in (0, 1):
            yield image[..., row::2, column::2]


def local_mean(image: F64, window_px: int = WINDOW_PX) -> F64:
    """Average a picture or stack, [..., H, W], over a window about each pixel."""
    sizes = (0,) * (image.ndim - 2) + (window_px, window_px)
    return ndimage.uniform_filter(image, sizes)


def growth(
    image: F64, open_masks: F64, *, clip: float = np.inf, is_mosaic: bool = False, undo: Undo | None = None
) -> Growth | None:
    """Draw readings over open masks.

    Args:
        image: Readings above the offset, [H, W].
        open_masks: a(p), [H, W].
        clip: Readings from here on are clipped, in the unit of `image`.
        is_mosaic: Whether neighbouring pixels are of different colours.
        undo: What readings are turned into first.

    Returns:
        The curve, or None where the picture cannot tell: too few pixels, too dark, clipped, or masks without contrast.
    """
    for is_biased in (False, True) if np.isfinite(clip) else (False,):
        planes = zip(lattices(middle(image), is_mosaic), lattices(middle(open_masks), is_mosaic), strict=True)
        sums = [_sums(plane, opened, clip, undo, is_biased) for plane, opened in planes]
        blocks = np.concatenate([one for one in sums if one is not None] or [np.zeros((0, 9))])
        blocks = blocks[blocks[:, 0] > 0]
        if len(blocks) >= _FEWEST_BLOCKS and (found := _curve(blocks)) is not None:
            return replace(found, is_biased=is_biased)
    return None


def _sums(plane: F64, opened: F64, clip: float, undo: Undo | None, is_biased: bool) -> F64 | None:
    """Return for each block the weighted sums of 1, d, d², d³, d⁴, r, r d, r d², r²; d, r: over their local means."""
    readings = plane if undo is None else undo(plane, opened)
    mean_open = local_mean(opened)
    brightness = local_mean(readings) / np.maximum(mean_open, 1e-12)
    usable = mean_open > _DARKEST * float(mean_open.mean())
    if np.isfinite(clip):
        # Half a pixel: sums that run along with a window leave digits behind.
        most = _CLIPPED_NEAR if is_biased else 0.5 / WINDOW_PX**2
        usable &= (local_mean((plane >= clip).astype(np.float64)) < most) & (plane < clip)
        if is_biased:
            raw = local_mean(plane) / np.maximum(mean_open, 1e-12)
            usable &= raw * opened < _CLEAR_OF_CLIPPING * clip
    if not usable.any():
        return None
    bright = float(np.quantile(brightness[usable], 0.9))
    usable &= brightness > _DARKEST * bright
    if bright <= 0 or not usable.any():
        return None
    usual = np.where(usable, brightness * mean_open, 1.0)
    r = np.where(usable, readings / usual, 0.0)
    d = np.where(usable, opened / np.maximum(mean_open, 1e-12) - 1, 0.0)
    weight = np.where(usable, np.minimum(brightness / bright, 1.0) ** 2, 0.0)
    rows, columns = (-(-n // _BLOCK_PX) for n in plane.shape)
    block = (np.arange(plane.shape[0]) // _BLOCK_PX)[:, None] * columns + np.arange(plane.shape[1]) // _BLOCK_PX
    terms, power = [], weight
    for _ in range(5):
        terms.append(power)
        power = power * d
    terms += [terms[0] * r, terms[1] * r, terms[2] * r, terms[0] * r * r]
    flat = block.ravel()
    return np.stack([np.bincount(flat, term.ravel(), rows * columns) for term in terms], axis=1)


def _curve(blocks: F64) -> Growth | None:
    total = blocks.sum(axis=0)
    weight = total[0]
    contrast = float(total[2] / weight - (total[1] / weight) ** 2)
    if contrast < _LEAST_CONTRAST:
        return None
    (_, slope), (_, slope_error) = _fitted(blocks, 2)
    (_, _, curvature), (_, _, curvature_error) = coefficients, _ = _fitted(blocks, 3)
    roughness = float(total[8] / weight - (total[5] / weight) ** 2)
    unexplained = float((total[8] - coefficients @ total[5:8]) / weight)
    return Growth(slope, slope_error, curvature, curvature_error, contrast, roughness, unexplained)


def _fitted(blocks: F64, terms: int) -> tuple[F64, F64]:
    """Fit a polynomial of so many terms; return its coefficients and their errors from the scatter over blocks."""
    grams = np.stack([blocks[:, k : k + terms] for k in range(terms)], axis=1)
    right = blocks[:, 5 : 5 + terms]
    gram = grams.sum(axis=0)
    inverse = np.linalg.inv(gram + 1e-9 * np.trace(gram) * np.eye(terms))
    found = inverse @ right.sum(axis=0)
    scores = right - grams @ found
    spread = len(blocks) / max(len(blocks) - terms, 1)
    return found, np.sqrt(np.maximum(np.diag(inverse @ (scores.T @ scores) @ inverse) * spread, 0))
