"""How far each part of the picture moves during the exposure, from the measurement and its masks alone.

If nothing moved, the measurement divided by the open share of the masks is a sharp picture, X. If a part of it is
displaced by d(t), the quotient differs from X, to first order, by −Σ wᵢ Mᵢ (∇X·d(tᵢ)) / Σ wᵢ Mᵢ: the picture's
gradient, with the fine pattern of the masks on it. The detail of a real picture knows nothing of that pattern. So the
quotient is regressed on it, block by block: displacements with their standard errors, from a few transforms of the
picture and neither a decode nor a fit. Both sides are whitened by the quotient's own spectrum, since the detail of
pictures, the noise of this regression, falls with frequency, and the pattern does not.

This is what decoded views cannot tell behind one pattern that is displaced from view to view, as in most laboratories:
what a decode leaves of the pattern moves with it, and points are tracked on that.

Here: the displacements. Not here: the path of the camera (`gs2ci.reconstruct.geometry.sources.displaced`).
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.special import chdtri

from gs2ci.core.arrays import F64, I64, Bool
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.blocks import BLOCK_PX, ELSEWHERE_PX, LEAST_PIXELS, in_blocks, ridged
from gs2ci.reconstruct.measurement.noise import MEDIAN_DEVIATE

# Standard deviation of the smoothing before gradients are taken: the pattern of the masks is removed, edges are kept.
_SMOOTH_PX: Final = 1.0
# White noise of variance 1, smoothed so, has gradients of this variance along each axis: 1 / (8 π σ⁴).
_NOISE_OF_GRADIENT: Final = 1 / (8 * np.pi * _SMOOTH_PX**4)
# Noise of the gradient makes displacements too small: by a fifth, if its power is a fifth of the whole. A block with
# less is not asked.
_LEAST_OVER_NOISE: Final = 5.0
# Pixels that see less than this share of the median light say little, and their quotient is noisy.
_LEAST_OPEN: Final = 0.3
# The spectrum is averaged over so many neighbouring frequencies along each axis, and never taken to be smaller than
# this share of its median.
_SPECTRUM_BINS: Final = 7
_LEAST_OF_SPECTRUM: Final = 1e-3
# Before the last round, so much of what is left is added to the displacements.
_ROUND_SHARE: Final = 0.8
# Displacements are of first order: they err by about so many px besides their standard errors.
FIRST_ORDER_PX: Final = 0.15
# Maps of blocks are smoothed over so many of them (standard deviation).
_FIELD_BLOCKS: Final = 0.7
# It is taken out in so many steps, of the picture smoothed by so much (standard deviation).
_STEPS_OUT: Final = 4
_SHARP_PX: Final = 0.6


@dataclass(frozen=True)
class BlockDisplacements:
    """Displacements of blocks during the exposure.

    Args:
        centres_px: Of the blocks, as (x, y), [B, 2].
        px: Over the exposure, [B, 2 F]: along x and y, for each row of `over_time`.
        covariance: Of their errors, [B, 2 F, 2 F].
        over_time: Displacement of each view for one of 1 px, [F, N]: even motion, then to and fro.
        block_px: Side of a block on the sensor.
    """

    centres_px: F64
    px: F64
    covariance: F64
    over_time: F64
    block_px: int


def displacements(shot: Shot, rounds: int = 0) -> BlockDisplacements | None:
    """Regress the measurement on displacements of blocks.

    The pixels of each colour of a mosaic are a picture of their own, and their regressions are added.

    Args:
        shot: The measurement; closed masks mark pixels that are not to be read.
        rounds: How often the displacements are taken out of the picture, and those that are left added to them. Without
            that, fine detail seems to move up to twice as far, since gradients are taken from a smoothed picture: of a
            camera that turns, finely textured things seem to be near. After three rounds all of a picture seems to move
            1.1 to 1.4 times as far as it does.

    Returns:
        Those of the blocks that tell; None if there are none, the shot has one view, or is smaller than a block.
    """
    every = 1 if shot.cfa is None else 2
    if len(shot.masks) < 2 or min(shot.size) < every * BLOCK_PX:
        return None
    height, width = (side // every * every for side in shot.size)
    times = _over_time(len(shot.masks))
    parts = [np.s_[down:height:every, right:width:every] for down in range(every) for right in range(every)]
    pictures = [
        _Picture(
            shot.measurement[part].mean(axis=2, dtype=np.float64),
            shot.weights[:, None, None].astype(np.float64) * shot.masks[:, *part],
            shot.usable[part],
            # A displacement by a pixel is one by half the distance of pixels of one colour.
            times / every,
        )
        for part in parts
    ]
    found = _regressed(pictures, None)
    for number in range(rounds):
        if found is None:
            break
        field = _field(*found)
        left = _regressed(pictures, field)
        if left is None:
            break
        places, px, covariance, grid = left
        share = _ROUND_SHARE if number < rounds - 1 else 1.0
        found = places, field[*places.T] + share * px, covariance, grid
    if found is None:
        return None
    places, px, covariance, _ = found
    side = BLOCK_PX * every
    centres_px: F64 = (places[:, ::-1].astype(np.float64) + 0.5) * side
    return BlockDisplacements(centres_px, px, covariance, times, side)


_Blocks = tuple[I64, F64, F64, tuple[int, ...]]
"""Row and column of each block that tells, [B, 2]; its displacements, [B, 2 F], and their covariance, [B, 2 F, 2 F];
and the numbers of rows and columns of blocks."""


def _regressed(pictures: list["_Picture"], field: F64 | None) -> _Blocks | None:
    """Regress pictures on displacements beside those of a field, [rows, columns, 2 F]; None if no block tells."""
    regressions = [picture.regression(field) for picture in pictures]
    gram, moment, power, pixels = (np.sum([one[part] for one in regressions], axis=0) for part in range(4))
    tells: Bool = np.all([one[4] for one in regressions], axis=0) & (pixels >= LEAST_PIXELS)
    if not tells.any():
        return None
    gram, moment, power, count = gram[tells], moment[tells], power[tells], pixels[tells]
    unknowns = gram.shape[-1]
    inverse = np.linalg.inv(ridged(gram))
    found = inverse @ moment
    freedom = np.maximum(count - unknowns, 1)[:, None]
    variance = np.maximum(power - (found * moment).sum(axis=1), 0) / freedom
    # The first residual is that of the block itself.
    with np.errstate(divide="ignore", invalid="ignore"):
        by_chance = ((found * moment).sum(axis=1) / variance)[:, 1:]
    by_chance = by_chance[np.isfinite(by_chance)]
    # The squared length of a normal vector of so many dimensions.
    expected = float(chdtri(unknowns, 0.5))
    inflated = max(1.0, float(np.median(by_chance)) / expected) if by_chance.size else 1.0
    covariance = inverse * (inflated * variance[:, 0])[:, None, None]
    return np.argwhere(tells), found[..., 0], covariance, tells.shape


def _field(places: I64, px: F64, covariance: F64, grid: tuple[int, ...]) -> F64:
    """Return smooth displacements of all blocks, [rows, columns, 2 F]; each known one counts by its precision."""
    unknowns = np.eye(px.shape[1])
    precision = np.linalg.inv(covariance + FIRST_ORDER_PX**2 * unknowns)
    known = np.einsum("bij,bj->bi", precision, px)
    mean = np.linalg.solve(precision.sum(axis=0), known.sum(axis=0))
    precisions, knowns = np.zeros((*grid, *unknowns.shape)), np.zeros((*grid, len(unknowns)))
    precisions[*places.T], knowns[*places.T] = precision, known
    # As precise as one displacement that is known to a pixel, the mean stands where nothing is known.
    total = over_blocks(precisions) + unknowns
    return np.asarray(np.linalg.solve(total, (over_blocks(knowns) + mean)[..., None])[..., 0], np.float64)


def over_blocks(blocks: F64) -> F64:
    """Smooth values of blocks, [rows, columns, ...], and add up those of neighbours."""
    flat = blocks.reshape(*blocks.shape[:2], -1)
    blurred = cv2.GaussianBlur(flat, (0, 0), _FIELD_BLOCKS, borderType=cv2.BORDER_CONSTANT)
    return blurred.reshape(blocks.shape)


class _Picture:
    """One picture: a measurement, or its pixels of one colour.

    Args:
        light: The measurement, [H, W].
        masks: With their weights, [N, H, W].
        usable: Which pixels may be read, [H, W].
        times: Displacement of each view for one of 1 px over the exposure, [F, N].
    """

    def __init__(self, light: F64, masks: F64, usable: Bool, times: F64) -> None:
        opened = masks.sum(axis=0)
        asked = usable & (opened > 0)
        if asked.any():
            asked &= opened >= _LEAST_OPEN * np.median(opened[asked])
        weight = asked * opened**2
        self._masks, self._times, self._asked = masks, times, asked
        self._opened = np.where(asked, opened, 1)
        self._patterns = np.tensordot(times, masks, axes=1) / self._opened * asked
        quotient = np.where(asked, light / self._opened, 0)
        smooth = _smooth(quotient * weight) / np.maximum(_smooth(weight), np.finfo(np.float32).tiny)
        self._quotient = np.where(asked, quotient, smooth)
        self._first = smooth

    def regression(self, field: F64 | None) -> tuple[F64, F64, F64, F64, Bool]:
        """Regress the picture on displacements beside those of a field, [rows, columns, 2 F], if there is one.

        Returns:
            For each block, [B, B'] first: gram matrix, [2 F, 2 F]; moments of the residual and of those of other
            places, [2 F, 1 + P]; their power, [1 + P]; number of pixels; and whether the block has enough texture.
        """
        asked = self._asked
        sharp = self._quotient if field is None else self._taken_out(field)
        smooth = self._first if field is None else _smooth(sharp)
        gain = _whitening(sharp)
        residual = _filtered(sharp, gain) * asked
        several = np.stack([residual, *(np.roll(residual, step, axis=(0, 1)) for step in ELSEWHERE_PX)], axis=-1)
        slopes = np.gradient(smooth, axis=1), np.gradient(smooth, axis=0)
        design = np.stack(
            [_filtered(-pattern * slope, gain) * asked for pattern in self._patterns for slope in slopes], -1
        )
        columns, left = in_blocks(design), in_blocks(several)
        pixels = in_blocks(asked[..., None].astype(np.float64)).sum(axis=(2, 3))
        noise = float(np.median((sharp - smooth)[asked] ** 2)) / MEDIAN_DEVIATE**2 if asked.any() else 0.0
        steep = in_blocks((asked * (slopes[0] ** 2 + slopes[1] ** 2))[..., None]).sum(axis=(2, 3))
        turned = columns.swapaxes(2, 3)
        clear: Bool = steep / np.maximum(pixels, 1) / 2 > _LEAST_OVER_NOISE * _NOISE_OF_GRADIENT * noise
        return turned @ columns, turned @ left, (left**2).sum(axis=2), pixels, clear

    def _taken_out(self, field: F64) -> F64:
        """Return the picture without what displacements by a field, [rows, columns, 2 F], print on it.

        That is the picture whose displaced views have this quotient; only what is smoother than a pixel is displaced,
        or detail finer than the displacements would be amplified from step to step.
        """
        height, width = self._quotient.shape
        dense = cv2.resize(field.astype(np.float32), None, fx=BLOCK_PX, fy=BLOCK_PX)[:height, :width]
        dense = dense.reshape(height, width, len(self._times), 2)
        rows, columns = np.mgrid[:height, :width].astype(np.float32)
        sharp = self._quotient
        for _ in range(_STEPS_OUT):
            still = cv2.GaussianBlur(sharp, (0, 0), _SHARP_PX).astype(np.float32)
            seen = np.zeros((height, width))
            for mask, time in zip(self._masks, self._times.T.astype(np.float32), strict=True):
                px = np.tensordot(dense, time, axes=(2, 0))
                places = columns - px[..., 0], rows - px[..., 1]
                seen += mask * cv2.remap(still, *places, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            sharp = np.where(self._asked, self._quotient + still - seen / self._opened, still)
        return sharp


def _over_time(count: int) -> F64:
    """Return displacements of so many views, [F, N]: even motion, and to and fro; of mean 0, they change by 1 px."""
    time = np.linspace(-1, 1, count)
    rows = np.stack([0.5 * time, time**2 - np.mean(time**2)])
    return rows[: count - 1]


def _whitening(picture: F64) -> F64:
    """Return the filter, by frequency, that makes the detail of a picture, [H, W], equally strong at all of them."""
    window = np.outer(np.hanning(picture.shape[0]), np.hanning(picture.shape[1]))
    power = np.fft.fftshift(np.abs(np.fft.fft2((picture - picture.mean()) * window)) ** 2)
    power = np.fft.ifftshift(cv2.blur(power, (_SPECTRUM_BINS, _SPECTRUM_BINS), borderType=cv2.BORDER_REFLECT))
    least = max(_LEAST_OF_SPECTRUM * float(np.median(power)), np.finfo(np.float64).tiny)
    gain: F64 = 1 / np.sqrt(power + least)
    gain[0, 0] = 0
    return gain


def _filtered(picture: F64, gain: F64) -> F64:
    return np.fft.ifft2(np.fft.fft2(picture) * gain).real


def _smooth(picture: F64) -> F64:
    return cv2.GaussianBlur(picture, (0, 0), _SMOOTH_PX)
