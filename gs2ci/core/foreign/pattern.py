"""Where a measurement shows the pattern of its masks: turned, shifted, or not at all.

A coded measurement carries the fine pattern of its masks' sum. Correlated with it at every shift and in every
orientation, it tells masks that lie elsewhere, which a reconstruction moves, from masks of another measurement, which
nothing mends.
Here: that trace. Not here: fractions of a pixel and what follows (`gs2ci.reconstruct.registration`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import fft, ndimage

from gs2ci.core.arrays import F32, F64

# Correlations of the fine pattern seen on real and simulated files: 0.68 to 0.92 where masks fit, below 0.01 where
# they do not.
FITS_WELL: Final = 0.6
FITS_NOT: Final = 0.1
# Of that many standard deviations of chance, the largest of 100,000 places has hardly 5.
_CHANCE: Final = 8.0
_REACH_PX: Final = 64
# Beyond so many times its typical size, fine pattern is of a lamp or a glint, and must not outweigh all others.
_GLARING: Final = 8.0
# Halves of a pixel show in the places beside the peak.
_OFF_PX: Final = 0.1

TURNS: Final[dict[str, Callable[[F64], F64]]] = {
    "": lambda image: image,
    "upside down": lambda image: image[::-1],
    "mirrored left to right": lambda image: image[:, ::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "transposed (rows and columns exchanged)": lambda image: image.T,
    "transposed and upside down": lambda image: image.T[::-1],
    "transposed and mirrored": lambda image: image.T[:, ::-1],
    "transposed and turned by 180 degrees": lambda image: image.T[::-1, ::-1],
}


@dataclass(frozen=True)
class PatternTrace:
    """The place and orientation at which the pattern shows best.

    Args:
        turn: How the masks are turned, a key of `TURNS`; empty for upright.
        down_px: Shift along the columns, to a fraction as far as the peak's neighbours tell.
        right_px: Shift along the rows.
        correlation: There.
        upright: The correlation of the masks as given.
        chance: What the best of all places reaches by chance.
    """

    turn: str
    down_px: float
    right_px: float
    correlation: float
    upright: float
    chance: float

    @property
    def shows(self) -> bool:
        """Get whether the pattern shows at all."""
        return self.correlation >= max(FITS_NOT, self.chance)

    @property
    def is_in_place(self) -> bool:
        """Get whether it shows where the masks are stated to be."""
        return not self.turn and max(abs(self.down_px), abs(self.right_px)) <= _OFF_PX

    @property
    def can_be_mended(self) -> bool:
        """Get whether masks that do not explain the readings may do so once they are moved.

        Masks in their place whose pattern shows but faintly are too few, or others: nothing mends them.
        """
        return self.shows and (not self.is_in_place or self.correlation >= FITS_WELL)

    def moved(self, multiplicity: F64) -> F64:
        """Return the sum of masks, [H, W], as it shows in the measurement: turned, and shifted by whole pixels."""
        if not self.shows:
            return multiplicity
        return np.roll(TURNS[self.turn](multiplicity), (round(self.down_px), round(self.right_px)), axis=(0, 1))

    def placed(self, masks: F32) -> F32:
        """Return masks, [N, H, W], as they show in the measurement: turned, and shifted by whole pixels."""
        if not self.shows or self.is_in_place:
            return masks
        return np.stack([self.moved(mask.astype(np.float64)) for mask in masks]).astype(np.float32)


def trace(image: F64, multiplicity: F64) -> PatternTrace:
    """Find the trace of the sum of masks, [H, W], in a measurement, [H, W]."""
    seen, known = _without_glare(fine_of(image)), fine_of(multiplicity)
    norm = float(np.linalg.norm(seen) * np.linalg.norm(known))
    if norm == 0:
        return PatternTrace("", 0.0, 0.0, 0.0, 0.0, np.inf)
    reach = tuple(min(_REACH_PX, n // 2) for n in seen.shape)
    shape = tuple(fft.next_fast_len(n + r + 1, real=True) for n, r in zip(seen.shape, reach, strict=True))
    spectrum = fft.rfft2(seen, shape)
    best: tuple[float, str, F64] | None = None
    upright = float((seen * known).sum()) / norm
    for name, turn in TURNS.items():
        turned = turn(known)
        if turned.shape != seen.shape:
            continue
        match = fft.irfft2(spectrum * np.conj(fft.rfft2(turned, shape)), shape)
        rows, columns = (np.arange(-r, r + 1) % n for r, n in zip(reach, shape, strict=True))
        near = match[np.ix_(rows, columns)] / norm
        highest = float(near.max())
        if best is None or highest > best[0]:
            best = highest, name, near
        if highest >= FITS_WELL:  # by chance no other orientation comes close
            break
    assert best is not None
    correlation, name, near = best
    at = np.unravel_index(int(near.argmax()), near.shape)
    down, right = (
        float(at[axis]) - reach[axis] + _peak_offset(np.take(near, at[1 - axis], axis=1 - axis), int(at[axis]))
        for axis in (0, 1)
    )
    return PatternTrace(name, down, right, correlation, upright, _CHANCE / np.sqrt(image.size))


def _peak_offset(line: F64, peak: int) -> float:
    """Return by how much the top of a peak lies beside its highest place: what its neighbours pull it by."""
    if not 0 < peak < len(line) - 1:
        return 0.0
    before, top, after = (max(float(line[peak + step]), 0.0) for step in (-1, 0, 1))
    return (after - before) / max(before + top + after, 1e-300)


def _without_glare(fine: F64) -> F64:
    """Return the fine pattern with what lamps and glints stand out by limited."""
    size = np.abs(fine)
    typical = float(np.median(size[size > 0])) if size.any() else 0.0
    return np.clip(fine, -_GLARING * typical, _GLARING * typical)


def fine_of(image: F64) -> F64:
    """Return an image, [H, W], without what neighbouring pixels have in common."""
    return image - ndimage.uniform_filter(image, 5)
