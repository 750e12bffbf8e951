"""The displacement of the masks' pattern in a measurement, in whole pixels: one correlation, whatever the scene.

The measurement, high-passed and divided by its local level, correlates with the high-passed sum of the masks at a
single displacement. The peak is accepted if it is clearly higher than the thirtieth highest value elsewhere, which
measures chance; a sum without pattern, darkness and noise give no such peak, and nothing is concluded. Here: shift,
orientation, and the displacement of single tiles. Not here: fractions of a pixel (`fine`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy import fft

from gs2ci.core.arrays import F64, Size, rms_of
from gs2ci.core.records import Shot
from gs2ci.reconstruct.registration.local_scene import Seen, blurred
from gs2ci.reconstruct.registration.placement import Placement

# Values within the peak's own width are not counted as elsewhere. The n-th highest of the others measures chance.
_RANK: Final = 30
# Among 4000 measurements with masks other than those stated, no peak reached 1.9 times the thirtieth highest value.
SURE_PEAK: Final = 2.5
# Among few independent shifts the thirtieth highest value is low: a peak must also exceed so many times the root mean
# square of the values elsewhere. Of 1500 measurements of 24 x 24 elements with other masks the highest reached 7.2, of
# 150 with right ones the lowest 26.
_SURE_DEVIATIONS: Final = 7.5
# The autocorrelation of the pattern is examined up to this distance, so that wider elements are not recognised.
_WIDEST_ELEMENT_PX: Final = 16
_HIGH_PASS_ELEMENTS: Final = 3.0
_LEVEL_PX: Final = 8.0
# Tiles are so many elements wide and overlap by half; at most this many along each side of the picture.
_TILE_ELEMENTS: Final = 48
_MOST_TILES: Final = 9
# Tolerance of tiles: their peaks are in whole pixels, and a rotation smears them.
_AGREEMENT_PX: Final = 1.5
# A sum of masks that varies by less has no usable pattern.
_LEAST_PATTERN: Final = 1e-3

ORIENTATIONS: Final[dict[str, Callable[[F64], F64]]] = {
    "as given": lambda image: image,
    "upside down": lambda image: image[..., ::-1, :],
    "mirrored left to right": lambda image: image[..., ::-1],
    "turned by 180 degrees": lambda image: image[..., ::-1, ::-1],
    "transposed": lambda image: image.swapaxes(-1, -2),
    "turned by 90 degrees clockwise": lambda image: image.swapaxes(-1, -2)[..., ::-1],
    "turned by 90 degrees anticlockwise": lambda image: image.swapaxes(-1, -2)[..., ::-1, :],
    "transposed and turned by 180 degrees": lambda image: image.swapaxes(-1, -2)[..., ::-1, ::-1],
}


def element_px(total: F64) -> float:
    """Return the width of a pattern's elements, [H, W], from the lag at which its autocorrelation falls to half."""
    fine = total - total.mean()
    power = float((fine * fine).mean())
    if power <= 0:
        return 1.0
    for lag in range(1, _WIDEST_ELEMENT_PX):
        if lag >= min(fine.shape) // 2:
            return float(lag)
        along = float((fine[lag:] * fine[:-lag]).mean() + (fine[:, lag:] * fine[:, :-lag]).mean()) / 2
        if along < 0.5 * power:
            # Square elements of width d correlate by 1 − lag / d.
            return float(lag)
    return float(_WIDEST_ELEMENT_PX)


def fine_pattern(image: F64, element: float, *, relative: bool = False) -> F64:
    """High-pass a picture, [H, W]; relative: divided by its local level, so that bright parts do not dominate."""
    sigma = _HIGH_PASS_ELEMENTS * element
    fine: F64 = image - blurred(image, sigma)
    if relative:
        level = np.abs(blurred(image, max(_LEVEL_PX, sigma)))
        # Includes the deviation of the pattern itself: the level may be zero if too high a black level was subtracted.
        level = np.sqrt(level**2 + blurred(fine**2, max(_LEVEL_PX, sigma)))
        fine = fine / np.maximum(level, 1e-9 * max(float(np.abs(image).max()), 1e-300))
        spread = float(fine.std())
        if spread > 0:
            fine = np.clip(fine, -4 * spread, 4 * spread)
    return fine


def is_flat(total: F64) -> bool:
    """Tell whether a sum of masks, [H, W], has no pattern."""
    return float(total.std()) <= _LEAST_PATTERN * float(np.abs(total).max())


def readable(shot: Shot, element: float) -> F64:
    """Return the fine pattern of a measurement, [H, W]: colours of a mosaic equalised, clipped readings left out."""
    seen = Seen.of(shot, element)
    patterns = np.zeros(shot.size)
    for plane, counts in zip(seen.planes, seen.counts, strict=True):
        around = np.maximum(seen.blur(counts), 1e-9)
        level = seen.blur(counts * plane) / around
        filled = np.where(counts > 0, plane, level)
        patterns += counts * fine_pattern(filled, element, relative=True)
    return patterns


@dataclass(frozen=True)
class Peak:
    """The displacement at which a pattern correlates.

    Args:
        down_px: Shift along the columns.
        right_px: Shift along the rows.
        ratio: The peak divided by the thirtieth highest value elsewhere; 0 if nothing can be concluded.
        deviations: The peak divided by the root mean square of the values elsewhere.
    """

    down_px: float = 0.0
    right_px: float = 0.0
    ratio: float = 0.0
    deviations: float = 0.0

    @property
    def is_sure(self) -> bool:
        """Get whether chance does not explain it."""
        return self.ratio >= SURE_PEAK and self.deviations >= _SURE_DEVIATIONS


def find_peak(seen: F64, known: F64, reach: Size, element: float) -> Peak:
    """Find the shift of `known` in `seen`, both high-passed, [H, W].

    Args:
        seen: From the measurement; 0 at pixels that do not count.
        known: From the masks.
        reach: Largest shift along rows and columns, px.
        element: Width of the masks' elements, px.
    """
    shape = tuple(fft.next_fast_len(a + r + 1, real=True) for a, r in zip(seen.shape, reach, strict=True))
    match = fft.irfft2(fft.rfft2(seen, shape) * np.conj(fft.rfft2(known, shape)), shape)
    rows, columns = (np.arange(-r, r + 1) for r in reach)
    near = match[np.ix_(rows % shape[0], columns % shape[1])]
    at = np.unravel_index(int(near.argmax()), near.shape)
    down, right = int(rows[at[0]]), int(columns[at[1]])
    wide = int(np.ceil(2 * element)) + 1
    apart = (np.abs(rows - down)[:, None] > wide) | (np.abs(columns - right)[None, :] > wide)
    others = near[apart]
    if others.size < 2 * _RANK:
        return Peak()
    chance = float(np.partition(others, -_RANK)[-_RANK])
    peak = float(near[at])
    ratio = peak / chance if chance > 0 else 0.0
    deviations = peak / max(rms_of(others), 1e-300)
    return Peak(float(down), float(right), ratio, deviations)


@dataclass(frozen=True)
class Tile:
    """One tile of the picture: its middle as (row, column), and the displacement there."""

    middle: tuple[float, float]
    peak: Peak


def find_tiles(
    seen: F64,
    known: F64,
    shift: F64,
    reach: int,
    element: float,
    elements: int = _TILE_ELEMENTS,
) -> list[Tile]:
    """Find the displacement of every tile about an expected one.

    Args:
        seen: From the measurement, high-passed, [H, W].
        known: From the masks, [H, W].
        shift: The expected displacement (down, right), px.
        reach: Largest deviation from it, px.
        element: Width of the masks' elements, px.
        elements: How many of them a tile is wide.
    """
    side = elements * max(1, round(element))
    about = np.rint(shift).astype(int)
    margin = side + 2 * reach + int(np.abs(about).max())
    padded, found = np.pad(known, margin), []
    for top in _starts(seen.shape[0], side):
        for left in _starts(seen.shape[1], side):
            piece = seen[top : top + side, left : left + side]
            middle = np.array([top + (piece.shape[0] - 1) / 2, left + (piece.shape[1] - 1) / 2])
            row, column = np.array([top, left]) - about - reach + margin
            window = padded[row : row + piece.shape[0] + 2 * reach, column : column + piece.shape[1] + 2 * reach]
            peak = find_peak(np.pad(piece, reach), window, (reach, reach), element)
            # Whether tiles are right, others beside them tell: too few shifts are tried to measure chance.
            shifted = replace(
                peak, down_px=peak.down_px + about[0], right_px=peak.right_px + about[1], deviations=np.inf
            )
            found.append(Tile((float(middle[0]), float(middle[1])), shifted))
    return found


def _starts(length: int, side: int) -> list[int]:
    if length <= side:
        return [0]
    count = min(_MOST_TILES, int(np.ceil((length - side) / (side / 2))) + 1)
    return [round(start) for start in np.linspace(0, length - side, max(2, count))]


def place_tiles(found: list[Tile], size: Size) -> Placement | None:
    """Find the affine placement on which the sure tiles agree; None if too few do."""

    def affine(places: F64) -> F64:
        design = np.column_stack([np.ones(len(places)), places])
        return np.einsum("kr,de->rdke", design, np.eye(2)).reshape(-1, len(places), 2)

    solution = agreed(found, size, affine)
    if solution is None:
        return None
    shift, *rows = solution.reshape(3, 2)
    return Placement.from_affine(np.eye(2) + np.transpose(rows), shift)


def agreed(found: list[Tile], size: Size, design: Callable[[F64], F64]) -> F64 | None:
    """Find the displacement on which sure tiles agree; those that deviate from the others are dropped, the worst first.

    Nearly twice as many tiles must be left as determine the unknowns.

    Args:
        found: The tiles.
        size: Height and width of the picture, px.
        design: Displacements of positions from the middle, [K, 2], by a unit of each unknown, [P, K, 2].

    Returns:
        The unknowns, [P]; None if too few tiles agree, or they do not determine them.
    """
    sure = [tile for tile in found if tile.peak.is_sure]
    while sure:
        unit = design(np.array([tile.middle for tile in sure]) - (np.array(size) - 1) / 2)
        if len(sure) < len(unit) - 1:
            return None
        moved = np.array([(tile.peak.down_px, tile.peak.right_px) for tile in sure])
        solution, _, rank, _ = np.linalg.lstsq(unit.reshape(len(unit), -1).T, moved.ravel(), rcond=None)
        if rank < len(unit):
            return None
        apart = np.linalg.norm(moved - np.tensordot(solution, unit, axes=1), axis=1)
        worst = int(apart.argmax())
        if apart[worst] <= _AGREEMENT_PX:
            return solution
        del sure[worst]
    return None
