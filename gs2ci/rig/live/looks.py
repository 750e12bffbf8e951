"""Figures of one camera picture for alignment: histogram, saturation, sharpness, and the offset of a mask.

Here: the picture as it is shown, and these figures. Not here: taking pictures (`bench`), measuring a bench
(`gs2ci_calibration`).
"""

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np

from gs2ci.core.arrays import F64, U8, U16
from gs2ci.reconstruct.registration.coarse import element_px, find_tiles, fine_pattern, place_tiles

BINS: Final = 64
SHOWN_PX: Final = 960
"""Pictures are reduced for the page by a whole factor, until neither side is longer than this."""
SATURATED_RGB: Final = (255, 40, 40)
REACH_PX: Final = 12
"""Largest displacement of a mask that can be found."""
SMOOTHED_PX: Final = 1.0
"""Blur before sharpness is measured, so that it does not rise with noise."""


@dataclass(frozen=True)
class PictureFigures:
    """The figures of one picture.

    Args:
        histogram: Pixels by reading, `BINS` equal steps from 0 to the top.
        saturated: Share of pixels at or above the saturation level.
        mean_dn: Mean reading.
        peak_dn: Largest reading.
        sharpness: See `sharpness_of`.
    """

    histogram: tuple[int, ...]
    saturated: float
    mean_dn: float
    peak_dn: int
    sharpness: float


@dataclass(frozen=True)
class MaskResidual:
    """Displacement of a mask from its nominal position.

    Args:
        arrows: Row and column of a tile's middle, and the mask's displacement down and right there, px.
        down_px: Displacement down for the whole picture.
        right_px: Displacement to the right.
        rotation_deg: Rotation, clockwise.
        scale: Magnification minus 1.
        found: Whether the tiles agree; otherwise the four figures above are meaningless.
    """

    arrows: tuple[tuple[float, float, float, float], ...]
    down_px: float = 0.0
    right_px: float = 0.0
    rotation_deg: float = 0.0
    scale: float = 0.0
    found: bool = False


def figures_of(pixels: U16, top: int, saturation_dn: float, black_dn: float) -> PictureFigures:
    """Return the figures of a picture, [H, W]; `top` is the largest possible reading."""
    counts, _ = np.histogram(pixels, bins=BINS, range=(0, top + 1))
    return PictureFigures(
        histogram=tuple(int(count) for count in counts),
        saturated=float((pixels >= saturation_dn).mean()),
        mean_dn=float(pixels.mean()),
        peak_dn=int(pixels.max()),
        sharpness=sharpness_of(pixels, black_dn),
    )


def sharpness_of(pixels: U16, black_dn: float) -> float:
    """Return how sharp a picture is: mean squared gradient over the squared mean, after a slight blur (Tenengrad).

    It is largest in focus. Its value depends on the scene, so only values of the same scene can be compared.
    """
    light = cv2.GaussianBlur(np.maximum(pixels.astype(np.float64) - black_dn, 0.0), (0, 0), SMOOTHED_PX)
    mean = float(light.mean())
    if mean <= 0 or min(pixels.shape) < 3:
        return 0.0
    down, right = np.gradient(light / mean)
    return float((down**2 + right**2).mean())


def residual_of(pixels: U16, mask: F64, black_dn: float) -> MaskResidual:
    """Find the displacement of a mask, [H, W], in a picture that was taken through that mask only.

    Shifts beyond `REACH_PX` are not found. Arrows are returned if at least five tiles agree; a tile in which the
    pattern cannot be found with certainty has none.
    """
    seen = np.maximum(pixels.astype(np.float64) - black_dn, 0.0)
    width = element_px(mask)
    sought = fine_pattern(seen, width, relative=True)
    tiles = find_tiles(sought, fine_pattern(mask, width), np.zeros(2), REACH_PX, width)
    placed = place_tiles(tiles, (seen.shape[0], seen.shape[1]))
    if placed is None:
        return MaskResidual(())
    sure = [tile for tile in tiles if tile.peak.is_sure]
    arrows = tuple((*tile.middle, float(tile.peak.down_px), float(tile.peak.right_px)) for tile in sure)
    return MaskResidual(arrows, placed.down_px, placed.right_px, placed.rotation_deg, placed.scale, found=True)


def picture_png(pixels: U16, top: int, saturation_dn: float, black_dn: float) -> tuple[bytes, tuple[int, int]]:
    """Draw a picture from black to the top, saturated pixels red; return it as PNG, and its size before reduction."""
    height, width = pixels.shape
    shares = np.clip((pixels.astype(np.float64) - black_dn) / max(top - black_dn, 1.0), 0.0, 1.0)
    grey: U8 = np.rint(255 * shares**0.5).astype(np.uint8)  # half-tones as a screen shows them
    drawn = np.repeat(grey[:, :, None], 3, axis=2)
    drawn[pixels >= saturation_dn] = SATURATED_RGB
    return encode_png(drawn), (height, width)


def encode_png(picture: Any) -> bytes:
    """Return an RGB or grey picture as PNG, reduced if it is larger than the page shows."""
    step = -(-max(picture.shape[:2]) // SHOWN_PX)
    shown = np.ascontiguousarray(picture[::step, ::step])
    if shown.ndim == 3:
        shown = np.ascontiguousarray(shown[:, :, ::-1])
    return bytes(cv2.imencode(".png", shown, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])
