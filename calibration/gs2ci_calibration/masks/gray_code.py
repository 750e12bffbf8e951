"""Gray code stripes: which modulator pixel each sensor pixel sees, to a few pixels, without prior knowledge.

No assumption about flips, rotations and pixel ratios is needed: every pixel decodes its own column and row from the
stripes. Here: the patterns and their decoding. Not here: sub-pixel registration, which starts from this
(`registration`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, U8, Bool
from gs2ci_calibration.masks.imaging import PixelMap
from gs2ci_calibration.refusals import CalibrationError, Reason

# A pixel's bit counts as clear if its value is at least this far from one half; next to an edge one bit is not clear.
CLEAR: Final = 0.2
# Fewest pixels from which an affine map is taken, as a share of the sensor.
SEEN_SHARE_MIN: Final = 0.05
# This many pixels suffice: each is known to a few modulator pixels, and a map accurate to one pixel is sufficient.
PIXELS_USED: Final = 20_000
# Residuals beyond this many stripe widths are misread pixels.
MISREAD_STRIPES: Final = 1.5


@dataclass(frozen=True)
class GrayCode:
    """Stripes for a modulator.

    Args:
        size: The modulator's height and width.
        finest: Width of the finest stripes in modulator pixels, at least 1.
    """

    size: tuple[int, int]
    finest: int = 8

    @property
    def bits(self) -> tuple[int, int]:
        """Get how many patterns encode rows and columns."""
        rows, columns = (max(int(np.ceil(np.log2(-(-side // self.finest)))), 1) for side in self.size)
        return rows, columns

    def patterns(self) -> U8:
        """Return the patterns, [B, Hm, Wm] of 0 and 1: first those of rows, then those of columns, coarsest first."""
        height, width = self.size
        rows, columns = self.bits
        across = [np.broadcast_to(_bit(height, self.finest, rows, b)[:, None], self.size) for b in range(rows)]
        along = [np.broadcast_to(_bit(width, self.finest, columns, b)[None, :], self.size) for b in range(columns)]
        return np.stack([*across, *along]).astype(np.uint8)

    def decode(self, shares: NDArray[np.floating], valid: Bool) -> tuple[F64, F64, Bool]:
        """Read the stripes at each pixel.

        Args:
            shares: Light at each pixel, between off (0) and on (1), [B, H, W] in the order of `patterns`.
            valid: Pixels that see the modulator, [H, W].

        Returns:
            Column u and row v of the stripes' crossing in modulator pixels, [H, W] each, and where they are readable.
        """
        rows, _ = self.bits
        is_open = shares > 0.5
        clear = np.abs(shares - 0.5) > CLEAR
        # Neighbouring codes differ in one bit: one that is not clear moves the code by one stripe at most.
        readable = valid & (np.sum(~clear[:rows], axis=0) <= 1) & (np.sum(~clear[rows:], axis=0) <= 1)
        v = (_number(is_open[:rows]) + 0.5) * self.finest
        u = (_number(is_open[rows:]) + 0.5) * self.finest
        readable &= (u < self.size[1]) & (v < self.size[0])
        return u, v, readable


def coarse_map(code: GrayCode, shares: NDArray[np.floating], valid: Bool) -> PixelMap:
    """Fit the map from sensor to modulator to the decoded stripes.

    Args:
        code: The stripes.
        shares: As `GrayCode.decode` takes them.
        valid: Pixels that see the modulator, [H, W].

    Returns:
        The affine map, or a cubic one if the pixels clearly show that it bends.

    Raises:
        CalibrationError: Too few pixels read the code, or all of them the same column or row.
    """
    u, v, readable = code.decode(shares, valid)
    height, width = valid.shape
    if readable.sum() < max(SEEN_SHARE_MIN * valid.size, 16):
        raise CalibrationError(
            "registration",
            Reason.NOT_REGISTERED,
            f"only {readable.mean():.1%} of the pixels can read the stripes on the modulator",
            allowed=f"{SEEN_SHARE_MIN:.0%} or more",
            remedy="focus the relay, open its aperture, and check that the modulator's image falls on the sensor",
        )
    # Chosen at random: a regular choice could interfere with the stripes.
    chosen = np.random.default_rng(0).permutation(np.flatnonzero(readable))[:PIXELS_USED]
    rows, columns = np.unravel_index(chosen, valid.shape)
    x, y = columns.astype(np.float64) + 0.5, rows.astype(np.float64) + 0.5
    read = np.column_stack([u.ravel()[chosen], v.ravel()[chosen]])
    _require_spread(x, y, read, code)
    fitted = _trimmed(PixelMap((height, width), np.zeros((3, 2))), x, y, read, code.finest)
    bent = _trimmed(PixelMap((height, width), np.zeros((10, 2))), x, y, read, code.finest)
    return bent[0] if bent[1] < 0.8 * fitted[1] else fitted[0]


def _bit(length: int, finest: int, bits: int, place: int) -> U8:
    number = np.arange(length) // finest
    return np.asarray((number ^ (number >> 1)) >> (bits - 1 - place) & 1, dtype=np.uint8)


def _number(is_open: Bool) -> F64:
    """Turn Gray bits [B, ...], the most significant first, into numbers."""
    binary = np.logical_xor.accumulate(is_open, axis=0)
    places = 2 ** np.arange(len(is_open) - 1, -1, -1)
    return np.tensordot(places, binary, axes=1).astype(np.float64)


def _require_spread(x: F64, y: F64, read: F64, code: GrayCode) -> None:
    for what, points in (("sensor pixels that read the code", np.column_stack([x, y])), ("their readings", read)):
        centred = points - points.mean(axis=0)
        least = float(np.sqrt(max(np.linalg.eigvalsh(centred.T @ centred / len(centred))[0], 0.0)))
        if least < (code.finest if what == "their readings" else 2.0):
            raise CalibrationError(
                "registration",
                Reason.NOT_REGISTERED,
                f"{what} lie on one line (they spread {least:.2g} px across it)",
                allowed="readings all over the sensor, which an affine map needs",
                remedy="light the whole field, and check that both row and column stripes are shown",
            )


def _trimmed(blank: PixelMap, x: F64, y: F64, read: F64, finest: int) -> tuple[PixelMap, float]:
    """Fit a map, then twice more without misread pixels; return it and its rms residual in modulator pixels."""
    basis = blank.basis(x, y)
    keep = np.ones(len(x), bool)
    fitted, rms = blank, np.inf
    for limit in (np.inf, 4 * MISREAD_STRIPES * finest, MISREAD_STRIPES * finest):
        distance = np.hypot(*(read - basis @ fitted.coefficients).T) if np.isfinite(limit) else np.zeros(len(x))
        median = float(np.median(distance))
        keep = distance <= max(limit, 3 * median)
        coefficients, *_ = np.linalg.lstsq(basis[keep], read[keep], rcond=None)
        fitted = PixelMap(blank.size, coefficients)
        rms = float(np.sqrt(np.mean(np.square(read - basis @ coefficients)[keep])))
    return fitted, rms
